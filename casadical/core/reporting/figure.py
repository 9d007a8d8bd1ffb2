"""Figures as data: series, axes, marks and panels, which `drawing` turns into a picture.

Colours are roles of the palette (`drawing.COLOURS`). Text may be a user's; `drawing` escapes it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

# Type of coordinates: numbers, ISO dates or words, one for each entry of a series.
Values = Any


@dataclass(frozen=True, eq=False)
class Series:
    """One series of a figure.

    kind : how it is drawn: markers, a line, both, horizontal bars, or a filled area
        z, shape (y, x), in shades of the colour from 0 to `size`
    x, y, z : coordinates of each entry, z for a 3D figure
    name : name in the legend; empty: it is not in the legend
    colour : role of the palette, of all entries or of each
    symbol : plotly's name of the marker, of all entries or of each
    size : diameter of the markers [px], of all entries or of each
    width : width of the line [px], or of the bars in units of the axis
    dash : line style; shape : connection of consecutive points, straight or in steps
    opacity : opacity, 0 to 1
    fill : colour of an area that has an outline
    less, more : lengths of each entry's error bar below and above it, in the unit of the axis; less
        None: as more
    text : label of each entry
    tip : template of the tooltip, with %{x:.3f}, %{y}, %{customdata[0]} of `facts`; empty: none
    facts : values of each entry for the tooltip
    group : series of one group are shown and hidden together; empty: none
    listed : whether the legend shows its name
    shown : whether it is visible before the reader selects it in the legend
    panel : index of the panel in which it is drawn
    """

    kind: Literal["points", "line", "linked", "bars", "area"]
    x: Values
    y: Values
    z: Values | None = None
    name: str = ""
    colour: str | Sequence[str] = "blue"
    symbol: str | Sequence[str] = "circle"
    size: float | Values = 6
    width: float = 2
    dash: str = "solid"
    shape: Literal["linear", "hvh"] = "linear"
    opacity: float = 1
    fill: str = ""
    less: Values | None = None
    more: Values | None = None
    text: Sequence[str] = ()
    tip: str = ""
    facts: Any = None
    group: str = ""
    listed: bool = True
    shown: bool = True
    panel: int = 0


@dataclass(frozen=True, eq=False)
class Axis:
    """An axis of a figure.

    title : title with the unit
    ends : lower and upper end of the range that is shown; None: automatic
    log : whether the scale is logarithmic
    ticks : positions of the ticks; None: automatic, 1, 2, 5 of each decade if `log` without `count`
    labels : texts of the ticks; None: their numbers
    count : largest number of automatic ticks
    step : distance between ticks, the first at 1
    whole : whether ticks are whole numbers
    zero : whether a line marks zero
    begins : whether the range includes zero
    grid : whether grid lines are drawn
    """

    title: str = ""
    ends: tuple[float, float] | None = None
    log: bool = False
    ticks: Values | None = None
    labels: Sequence[str] | None = None
    count: int | None = None
    step: float | None = None
    whole: bool = False
    zero: bool = False
    begins: bool = False
    grid: bool = True


@dataclass(frozen=True)
class Rule:
    """A line across the figure at the value `at` of an axis.

    width : width of the line [px]; text : label at the top of a line across the x axis
    """

    axis: Literal["x", "y"]
    at: float
    colour: str = "muted"
    dash: str = "dot"
    width: float = 1
    text: str = ""


@dataclass(frozen=True)
class Note:
    """A text in a figure.

    x, y : its position, in units of the axes, or of the frame (0 to 1) for axes named by `frame`
    side : side of the position on which the text is
    gap : distance between position and a text at its left or right [px]
    size : size of the letters [px]
    panel : index of the panel in which it is drawn
    """

    text: str
    x: Any
    y: Any
    frame: Literal["", "x", "xy"] = ""
    side: Literal["left", "right", "above", "below right", "below left"] = "right"
    gap: int = 0
    colour: str = "ink"
    size: float = 12
    panel: int = 0


@dataclass(frozen=True, eq=False)
class Panel:
    """One of several plots in a figure, with its row and column, counted from 1, and its axes."""

    row: int
    column: int
    title: str = ""
    x: Axis = Axis()
    y: Axis = Axis()


@dataclass(frozen=True, eq=False)
class Figure:
    """A figure with its caption.

    name : identifier, such as "errors/report"
    x, y : axes; with panels their titles are those of the whole figure
    height : height [px]
    rows : words on the y axis, from the top, in place of numbers
    marks : rules and notes in the figure
    shaded : ends of a shaded interval of the x axis, in its unit; None: nothing is shaded
    panels : plots of a figure with several of them
    shared : axes that the panels share: "x", "y", "xy" or ""
    right : margin at the right [px]
    over : title of a common tooltip for all series at one y; empty: each series has its own
    """

    name: str
    title: str
    series: Sequence[Series]
    x: Axis = Axis()
    y: Axis = Axis()
    height: int = 360
    caption: str = ""
    rows: Sequence[str] = ()
    marks: Sequence[Rule | Note] = ()
    shaded: tuple[Any, Any] | None = None
    panels: Sequence[Panel] = ()
    shared: str = ""
    right: int = 12
    over: str = ""


def ticks_of_decades(low: float = 1e-9, high: float = 5e5, steps: Sequence[int] = (1, 2, 5)) -> list[float]:
    """Return the ticks of a logarithmic axis, such as 0.1, 0.2, 0.5, 1, in the decades of a range.

    low, high : ends of the range, about; steps : ticks of each decade
    """
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)))
    return [float(f"{step}e{power}") for power in decades for step in steps]
