"""Style of the figures: one palette for colour-blind readers, light and dark, and common settings.

A figure is made in light colours; the dark ones stand for them one by one (`dark`, and the page's script).
"""

from __future__ import annotations

import html
from typing import TYPE_CHECKING, Any

from casadical.compensator import network_methods
from casadical.report.optional_imports import plotly

# plotly is imported when a figure is made.
if TYPE_CHECKING:
    from plotly.graph_objects import Figure as Figure
else:
    Figure = Any

# Role: light, dark. The methods' colours are those of Okabe and Ito (2008), shifted to be read on either ground.
COLOURS: dict[str, tuple[str, str]] = {
    "paper": ("#ffffff", "#171c23"),
    "ink": ("#1c2530", "#e4e9ef"),
    "muted": ("#5d6875", "#9aa6b3"),
    "line": ("#c9d0d8", "#46505c"),
    "grid": ("#e6eaef", "#2a323c"),
    "blue": ("#0072b2", "#56b4e9"),
    "orange": ("#d98200", "#f0a830"),
    "green": ("#008f6b", "#2cc79d"),
    "red": ("#c84e00", "#f0763a"),
    "pink": ("#b8608f", "#dd8fbd"),
    "sky": ("#3d95c9", "#8cc9ee"),
    "grey": ("#868f9a", "#78838f"),
}
DARK = dict(COLOURS.values())
PAPER, INK, MUTED, LINE, GRID = (COLOURS[k][0] for k in ("paper", "ink", "muted", "line", "grid"))
BLUE, ORANGE, GREEN, RED, GREY = (COLOURS[k][0] for k in ("blue", "orange", "green", "red", "grey"))
FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'

# Model: colour, marker, dash. No two of them differ by colour alone.
STYLES: dict[str, tuple[str, str, str]] = {
    "before": (COLOURS["grey"][0], "x-thin-open", "dot"),
    "KM": (COLOURS["orange"][0], "square", "dash"),
    "SKCM": (COLOURS["blue"][0], "circle", "solid"),
    "with causes": (COLOURS["blue"][0], "circle", "solid"),
    "base model": (COLOURS["grey"][0], "x-thin-open", "dot"),
}
# Of networks, in the order of their trainers; those of many plug-ins share some.
NETWORK_STYLES = (
    (COLOURS["pink"][0], "triangle-up", "dot"),
    (COLOURS["green"][0], "diamond", "solid"),
    (COLOURS["sky"][0], "triangle-down", "dashdot"),
    (COLOURS["muted"][0], "cross", "longdash"),
    (COLOURS["red"][0], "star", "dash"),
    (COLOURS["pink"][0], "hexagon", "longdashdot"),
    (COLOURS["green"][0], "triangle-left", "dashdot"),
)


def style(model: str) -> tuple[str, str, str]:
    """Colour, marker and dash of a model; of one that is neither listed nor a network, those of SKCM."""
    networks = list(network_methods())
    if model in networks:
        return NETWORK_STYLES[networks.index(model) % len(NETWORK_STYLES)]
    return STYLES.get(model, STYLES["SKCM"])


def plain(text: object) -> str:
    """A user's text inside of a figure, which would take some HTML as such."""
    return html.escape(str(text), quote=False)


def new_figure(title: str, x: str = "", y: str = "", height: int = 360, **layout: Any) -> Figure:
    """An empty figure in the common style; x, y : what the axes show, with units."""
    figure = plotly().Figure()
    axis = {
        "gridcolor": GRID,
        "zeroline": False,
        "linecolor": LINE,
        "automargin": True,
        "title": {"standoff": 10, "font": {"size": 13}},
    }
    figure.update_layout(
        template=None,
        height=height,
        title={
            "text": title,
            "x": 0,
            "xref": "container",
            "y": 1,
            "yref": "container",
            "yanchor": "top",
            "pad": {"t": 14},
        },
        title_font={"size": 15, "color": INK, "weight": 600},
        font={"family": FONT, "size": 12.5, "color": MUTED},
        paper_bgcolor=PAPER,
        plot_bgcolor=PAPER,
        margin={"l": 8, "r": 12, "t": 48, "b": 8},
        hoverlabel={"font": {"family": FONT, "size": 12.5, "color": INK}, "align": "left", "namelength": -1},
        hoverlabel_bgcolor=PAPER,
        hoverlabel_bordercolor=LINE,
        legend={"orientation": "h", "x": 0, "xref": "container", "y": 0, "yref": "container", "yanchor": "bottom"},
        xaxis={**axis, "showline": True, "title_text": x},
        yaxis={**axis, "title_text": y},
        dragmode="zoom",
    )
    return figure.update_layout(**layout)


def log_ticks() -> dict[str, Any]:
    """Of a logarithmic axis whose ticks are whole numbers: 0.1, 0.2, 0.5, 1."""
    ticks = [float(f"{step}e{power}") for power in range(-9, 6) for step in (1, 2, 5)]
    return {"type": "log", "tickvals": ticks, "ticktext": [f"{v:g}" for v in ticks]}


def dark(figure: Figure) -> Figure:
    """The same figure in the dark colours, for a dark notebook or page.

    Parameters
    ----------
    figure : Figure
        of a report

    Returns
    -------
    Figure
        another figure

    Examples
    --------
    >>> figure = casadical.plot(calibration, "errors/report")
    >>> len(casadical.report.dark(figure).data) == len(figure.data)
    True
    """
    text = figure.to_json()
    for light, its_dark in DARK.items():
        text = text.replace(light, its_dark)
    import plotly.io

    return plotly.io.from_json(text)
