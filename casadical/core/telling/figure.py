"""Figures as data: series, axes, marks and panels, which `drawing` turns into a picture.

Colours are roles of the palette (`drawing.COLOURS`). Text may be a user's; `drawing` escapes it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

Values = Any  # numbers, days or words, one for each entry


@dataclass(frozen=True, eq=False)
class Series:
    """One series of a figure.

    kind : how it is drawn; a "map" has cells z, shape (y, x), in shades of the colour from 0 to
        `size`
    x, y, z : coordinates of each entry, z for a 3D figure
    name : in the legend, if it is `listed`; series of one `group` are shown and hidden together
    colour, symbol, size : of all entries or of each; size and width in px
    dash, shape : line style, and how consecutive points are connected
    fill : colour of an area that has an outline
    less, more : length of each entry's error bar below and above it, in the unit of the axis
    text : label of each entry
    tip : template of the tooltip, with %{x:.3f}, %{y}, %{customdata[0]} of `facts`; none if empty
    shown : whether it is visible before the reader asks for it
    panel : index of the panel that it is drawn in
    """

    kind: Literal["points", "line", "linked", "bars", "area", "map"]
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

    ends : range that is shown; log : whether the scale is logarithmic
    ticks : positions of ticks; labels : their texts; count : number of ticks instead
    step : distance of ticks, the first at 1; whole : whether ticks are whole numbers
    zero : whether a line marks zero; begins : whether the range begins at zero
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
    """A line across the figure at the value `at` of an axis; text : label at its end."""

    axis: Literal["x", "y"]
    at: float
    colour: str = "muted"
    dash: str = "dot"
    width: float = 1
    text: str = ""


@dataclass(frozen=True)
class Span:
    """A shaded interval of the x axis, from `first` to `last`."""

    first: Any
    last: Any
    colour: str = "orange"


@dataclass(frozen=True)
class Note:
    """A text in a figure.

    x, y : its position, in units of the axes, or of the frame (0 to 1) for axes named by `frame`
    side : the side of the position on which the text stands; gap : distance between both [px]
    size : of the letters [px]
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
    """One of several plots in a figure, at a row and column counted from 1."""

    row: int
    column: int
    title: str = ""
    x: Axis = Axis()
    y: Axis = Axis()


@dataclass(frozen=True, eq=False)
class Figure:
    """A figure with its caption.

    name : identifier, such as "errors/report"
    height : [px]; right : margin at the right [px]
    rows : words on the y axis, from the top, in place of numbers
    marks : rules, spans and notes in the figure
    panels : plots of a figure with several; shared : the axes, "x", "y" or "xy", that they share
    over : title of one tooltip for all series at one y; a tooltip for each if empty
    """

    name: str
    title: str
    series: Sequence[Series]
    x: Axis = Axis()
    y: Axis = Axis()
    height: int = 360
    caption: str = ""
    rows: Sequence[str] = ()
    marks: Sequence[Rule | Span | Note] = ()
    panels: Sequence[Panel] = ()
    shared: str = ""
    right: int = 12
    over: str = ""


def ticks_of_decades(low: float = 1e-9, high: float = 5e5, steps: Sequence[int] = (1, 2, 5)) -> list[float]:
    """Return the ticks of a logarithmic axis: 0.1, 0.2, 0.5, 1 and so on."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)))
    return [float(f"{step}e{power}") for power in decades for step in steps]
