"""A figure as data: what is drawn, over which axes, in which role; a drawer turns it into a picture.

Colours are roles of the palette (`drawing.COLOURS`). Text may hold what a user wrote; the drawer escapes it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

Values = Any  # numbers, days or words, one for each entry


@dataclass(frozen=True, eq=False)
class Series:
    """One series of a figure; x, y, z : of each entry (z : in space).

    name : in the legend, if it is `listed`; series of one `group` are shown and hidden together
    symbol, size, colour : of all or of each entry; less, more : how far the interval of each entry goes [as the axis]
    text : beside each entry; tip : of the tooltip, with %{x:.3f}, %{y}, %{customdata[0]} of `facts`; empty: none
    map : cells z, shape (y, x), in shades of the colour from none to `size`
    fill : of an area with an edge, its colour; shown : whether it is drawn before the reader asks for it
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
    """An axis; ends : of what is shown; ticks : where, `labels` what they say, `count` how many instead.

    whole : ticks are whole numbers; zero : whether a line marks it; begins : whether it begins at zero
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
    """A line across the figure where `axis` has a value; text : at its end."""

    axis: Literal["x", "y"]
    at: float
    colour: str = "muted"
    dash: str = "dot"
    width: float = 1
    text: str = ""


@dataclass(frozen=True)
class Span:
    """A shaded stretch of the axis x."""

    first: Any
    last: Any
    colour: str = "orange"


@dataclass(frozen=True)
class Note:
    """Words in a figure, at x, y of the axes, or of the frame (0 to 1) where it is named.

    side : of the place on which the words stand; gap : between both [px]
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
    """One of the plots that share a figure, at a row and column from 1."""

    row: int
    column: int
    title: str = ""
    x: Axis = Axis()
    y: Axis = Axis()


@dataclass(frozen=True, eq=False)
class Figure:
    """A picture and the words beneath it.

    name : as "errors/report"; rows : words on the axis y, from the top, in place of numbers; right : margin [px]
    over : what a tooltip of all series at one y says; shared : with panels, the axes that all have alike
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
    """Ticks of a logarithmic axis: 0.1, 0.2, 0.5, 1."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)))
    return [float(f"{step}e{power}") for power in decades for step in steps]
