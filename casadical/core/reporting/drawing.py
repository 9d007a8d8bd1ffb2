"""Figures drawn by plotly, with one palette for colour-blind readers and common settings.

A figure is drawn in the light colours; each has a dark counterpart (`dark`, and the page's script).
"""

import html
from collections.abc import Sequence
from math import log10
from typing import TYPE_CHECKING, Any, TypeAlias

from casadical.core.basics import optional
from casadical.core.reporting.figure import Axis, Figure, Note, Rule, Series, ticks_of_decades

# Only type checkers import plotly here; it is loaded when a figure is drawn.
if TYPE_CHECKING:
    from plotly.graph_objects import Figure as PlotlyFigure

    Picture: TypeAlias = PlotlyFigure
else:
    Picture = Any

# Message of the InputError where plotly is not installed.
MISSING_PLOTLY = "a report needs plotly, which is not installed: pip install 'casadical[report]'"
# Colours on a light and on a dark background, by role. The hues are of Okabe and Ito (2008),
# shifted for contrast on both backgrounds.
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
# Colour on a dark background, by that on a light background.
DARK_BY_LIGHT = dict(COLOURS.values())
# Colours of a figure on a light background; a dark page replaces them by `DARK_BY_LIGHT`.
INK_COLOUR = COLOURS["ink"][0]  # titles and labels
MUTED_COLOUR = COLOURS["muted"][0]  # text of axes and legends
LINE_COLOUR = COLOURS["line"][0]  # axes and frames
# Settings of plotly that all axes share.
AXIS_DEFAULTS = {"gridcolor": COLOURS["grid"][0], "zeroline": False, "linecolor": LINE_COLOUR, "automargin": True}
# Position of the camera when a 3D figure is first shown, in edge lengths of the drawn box.
CAMERA_EYE = (1.15, 1.3, 0.55)
# Height reserved for the title of a figure whose panels have titles [px].
TITLE_HEIGHT_PX = 76
# Height reserved for the legend of a figure whose panels have titles [px].
LEGEND_HEIGHT_PX = 100


def plain(text: object) -> str:
    """Return a user's text escaped for plotly, which interprets some HTML; lines stay lines."""
    return html.escape(str(text), quote=False).replace("\n", "<br>")


def draw(figure: Figure) -> Picture:
    """Return a figure drawn by plotly. Raises InputError where plotly is not installed."""
    picture = optional("plotly.graph_objects", MISSING_PLOTLY).Figure()
    families = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'
    font = {"family": families, "size": 12.5}
    at_top = {"x": 0, "xref": "container", "y": 1, "yref": "container", "yanchor": "top"}
    title_font = {"size": 15, "color": INK_COLOUR, "weight": 600}
    label = {"align": "left", "namelength": -1, "bgcolor": COLOURS["paper"][0], "bordercolor": LINE_COLOUR}
    picture.update_layout(
        template=None,
        height=figure.height,
        dragmode="zoom",
        font=font | {"color": MUTED_COLOUR},
        title={"text": plain(figure.title), **at_top, "pad": {"t": 14}, "font": title_font},
        paper_bgcolor=COLOURS["paper"][0],
        plot_bgcolor=COLOURS["paper"][0],
        margin={"l": 8, "r": figure.right, "t": 48, "b": 8},
        hoverlabel={"font": font | {"color": INK_COLOUR}} | label,
        legend={"orientation": "h"} | at_top | {"y": 0, "yanchor": "bottom"},
    )
    if any(s.z is not None for s in figure.series):
        # Set up a 3D scene that is rotated with the mouse.
        axis = {
            "gridcolor": COLOURS["grid"][0],
            "zerolinecolor": LINE_COLOUR,
            "showbackground": False,
            "linecolor": LINE_COLOUR,
            "color": MUTED_COLOUR,
        }
        axes = {f"{c}axis": {**axis, "title": {"text": f"{c} [m]"}, "nticks": 6, "showspikes": False} for c in "xyz"}
        camera = {"eye": dict(zip("xyz", CAMERA_EYE, strict=True)), "center": {"x": 0, "y": 0, "z": -0.22}}
        scene = {**axes, "aspectmode": "data", "camera": camera, "dragmode": "turntable"}
        picture.update_layout(scene=scene, margin={"l": 0, "r": 0, "t": 44, "b": 0})
    elif figure.panels:
        _panels(picture, figure)
    else:
        picture.update_xaxes(**_axis(figure.x), showline=True)
        picture.update_yaxes(**(_rows(figure.rows) if figure.rows else _axis(figure.y)))
    if figure.over:
        picture.update_layout(hovermode="y unified").update_yaxes(unifiedhovertitle_text=figure.over)
    for series in figure.series:
        _add(picture, figure, series)
    if figure.shaded is not None:
        first, last = figure.shaded
        picture.add_vrect(x0=first, x1=last, fillcolor=_colour("orange"), opacity=0.2, line_width=0)
    for mark in figure.marks:
        _mark(picture, figure, mark)
    return picture


def dark(picture: Picture) -> Picture:
    """Return the same picture in the dark colours, for a dark notebook or page."""
    text = picture.to_json()
    for light, its_dark in DARK_BY_LIGHT.items():
        text = text.replace(light, its_dark)
    return optional("plotly.io", MISSING_PLOTLY).from_json(text)


def _colour(role: str | Sequence[str]) -> str | list[str]:
    """Return the colour on a light background of a role, or a list of those of several roles."""
    return COLOURS[role][0] if isinstance(role, str) else [COLOURS[r][0] for r in role]


def _escaped(facts: Any) -> Any:
    """Return values of tooltips (nested lists or one value) with their texts escaped for HTML."""
    if isinstance(facts, str):
        return plain(facts)
    return [_escaped(fact) for fact in facts] if isinstance(facts, list | tuple) else facts


def _values(values: Any) -> Any:
    """Return values as plotly takes them: ranges and tuples as lists, others unchanged."""
    return list(values) if isinstance(values, range | tuple) else values


def _add(picture: Picture, figure: Figure, s: Series) -> None:
    """Add a series of a figure to the picture."""
    colour = _colour(s.colour)
    trace: dict[str, Any] = {"x": _values(s.x), "y": _values(s.y), "opacity": s.opacity}
    trace |= {"showlegend": bool(s.name) and s.listed, "visible": True if s.shown else "legendonly"}
    trace |= {"name": plain(s.name)} if s.name else {}
    trace |= {"legendgroup": s.group} if s.group else {}
    trace |= {"customdata": _escaped(s.facts)} if s.facts is not None else {}
    end = "" if figure.over else "<extra></extra>"
    trace |= {"hovertemplate": s.tip + end} if s.tip else {"hoverinfo": "skip"}
    if len(s.text):
        position = {"textposition": "outside"} if s.kind == "bars" else {"textposition": "top center"}
        trace |= {"text": [plain(t) for t in s.text], **position, "cliponaxis": False}
        trace |= {"textfont": {"color": INK_COLOUR, "size": 12}}
    # Light grey, the colour of error bars.
    grey_colour = COLOURS["grey"][0]
    if s.more is not None:
        bars = (
            {"color": INK_COLOUR, "thickness": 1.4, "width": 4}
            if s.kind == "bars"
            else {"color": grey_colour, "thickness": 2}
        )
        ends = {"array": s.more, "arrayminus": s.less if s.less is not None else s.more, "symmetric": False}
        trace["error_x" if figure.rows else "error_y"] = {"type": "data", "width": 0, **bars, **ends}
    place = {}
    if figure.panels:
        place = {"row": figure.panels[s.panel].row, "col": figure.panels[s.panel].column}
    if s.kind == "bars":
        trace |= {"marker": {"color": colour, "line": {"width": 0}}, "orientation": "h", "width": s.width}
        picture.add_bar(**trace, **place)
        return
    marker = {"color": colour, "symbol": s.symbol, "size": s.size}
    line = {"color": colour, "width": s.width, "dash": s.dash}
    mode_by_kind = {"points": "markers", "line": "lines", "linked": "lines+markers", "area": "lines"}
    trace["mode"] = mode_by_kind[s.kind] + ("+text" if len(s.text) else "")
    if s.kind == "area":
        trace |= {"fill": "toself", "fillcolor": _colour(s.fill or s.colour)}
        trace["line"] = {"color": colour, "width": s.width if s.fill else 0}
    if s.z is not None:
        line.pop("dash")
        marker = {"color": colour, "size": s.size, "line": {"width": 0}}
        trace = {k: v for k, v in trace.items() if k != "opacity"}
        picture.add_scatter3d(**trace, z=s.z, marker=marker, line=line)
        return
    trace |= {"marker": marker} if s.kind in ("points", "linked") else {}
    trace |= {"line": {**line, "shape": s.shape}} if s.kind in ("line", "linked") else {}
    picture.add_scatter(**trace, **place)


def _axis(axis: Axis) -> dict[str, Any]:
    """Return plotly's settings of an axis, by name."""
    settings: dict[str, Any] = {**AXIS_DEFAULTS, "showgrid": axis.grid}
    settings["title"] = {"text": plain(axis.title), "standoff": 10, "font": {"size": 13}}
    settings |= {"zeroline": True, "zerolinewidth": 1.5, "zerolinecolor": MUTED_COLOUR} if axis.zero else {}
    settings |= {"rangemode": "tozero"} if axis.begins else {}
    settings |= {"tickformat": "d"} if axis.whole else {}
    settings |= {"tick0": 1, "dtick": axis.step} if axis.step else {}
    settings |= {"nticks": axis.count} if axis.count else {}
    ticks = axis.ticks
    if axis.log:
        settings["type"] = "log"
        ticks = ticks_of_decades() if ticks is None and axis.count is None else ticks
    if axis.ends:
        settings["range"] = [log10(v) for v in axis.ends] if axis.log else list(axis.ends)
    if ticks is not None:
        labels = [f"{v:g}" for v in ticks] if axis.labels is None else [plain(v) for v in axis.labels]
        settings |= {"tickvals": list(ticks), "ticktext": labels}
    return settings


def _rows(rows: Sequence[str]) -> dict[str, Any]:
    """Return plotly's settings of a y axis whose ticks are words, the first on top."""
    ends = [len(rows) - 0.4, -0.6]
    words = [plain(row) for row in rows]
    return {**AXIS_DEFAULTS, "tickvals": list(range(len(rows))), "ticktext": words, "range": ends, "showgrid": False}


def _panels(picture: Picture, figure: Figure) -> None:
    """Lay out panels in rows and columns, with room for their titles and a common legend."""
    panels = figure.panels
    rows, columns = max(p.row for p in panels), max(p.column for p in panels)
    titled = any(p.title for p in panels)
    room = {"horizontal_spacing": 0.04, "vertical_spacing": 0.04}
    if titled:
        gap = 30 if "x" in figure.shared or not any(p.x.title for p in panels) else 50  # the gap also holds the ticks
        room = {
            "horizontal_spacing": 0.1,
            "vertical_spacing": gap / (figure.height - TITLE_HEIGHT_PX - LEGEND_HEIGHT_PX),
        }
    both = {f"shared_{axis}axes": "all" for axis in "xy" if axis in figure.shared}
    titles = {f"{axis}_title": getattr(figure, axis).title for axis in "xy" if getattr(figure, axis).title}
    picture.set_subplots(rows, columns, subplot_titles=[p.title for p in panels], **room, **both, **titles)
    picture.update_annotations(font={"size": 12, "color": MUTED_COLOUR})
    if titled:
        picture.update_layout(margin={"l": 56, "r": figure.right, "t": TITLE_HEIGHT_PX, "b": LEGEND_HEIGHT_PX})
    for panel in panels:
        place = {"row": panel.row, "col": panel.column}
        picture.update_xaxes(**_axis(panel.x), showline=True, **place)
        picture.update_yaxes(**_axis(panel.y), **place)


def _mark(picture: Picture, figure: Figure, mark: Rule | Note) -> None:
    """Add a rule or a note to the picture."""
    if isinstance(mark, Rule):
        line = {"color": _colour(mark.colour), "width": mark.width, "dash": mark.dash}
        (picture.add_vline if mark.axis == "x" else picture.add_hline)(**{mark.axis: mark.at}, line=line)
        if mark.text:
            at = log10(mark.at) if figure.x.log else mark.at
            words = {"text": plain(mark.text), "font": {"size": 11, "color": _colour(mark.colour)}}
            picture.add_annotation(**words, x=at, y=1, yref="y domain", yanchor="bottom", showarrow=False)
    else:
        anchors, way = _SIDES[mark.side]
        number = "" if mark.panel == 0 else str(mark.panel + 1)
        refs: dict[str, Any] = {"xref": f"x{number}", "yref": f"y{number}"}
        refs |= {axis + "ref": f"{axis}{number} domain" for axis in "xy" if axis in mark.frame}
        x, y = (
            log10(value) if getattr(figure, axis).log and axis not in mark.frame else value
            for axis, value in (("x", mark.x), ("y", mark.y))
        )
        refs |= {"xshift": way * mark.gap, "showarrow": False, "text": plain(mark.text)}
        font = {"size": mark.size, "color": _colour(mark.colour)}
        picture.add_annotation(x=x, y=y, font=font, **refs, **anchors)


# Plotly's anchors of a note, and the sign of its shift along x, by the side of its position on
# which its text is.
_SIDES: dict[str, tuple[dict[str, str], int]] = {
    "right": ({"xanchor": "left"}, 1),
    "left": ({"xanchor": "right"}, -1),
    "above": ({"xanchor": "left", "yanchor": "bottom"}, 0),
    "below right": ({"xanchor": "left", "yanchor": "top"}, 0),
    "below left": ({"xanchor": "right", "yanchor": "top"}, 0),
}
