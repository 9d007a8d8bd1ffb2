"""Errors pose by pose (the paper's Figs. 6 and 7), and what share of the poses stays below which error."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from casadical.core.arrays import Array
from casadical.project.remaining_errors import PoseErrors
from casadical.report.style import GRID, INK, MUTED, RED, Figure, log_ticks, new_figure, plain, style

# More poses than this are drawn evenly thinned (and said to be), or the file grows and the eye gains nothing.
MOST_DRAWN = 400
FEW = 80
QUANTILES = 201
LONGEST_NAME = 26
# Where the medians of two models differ by more, the axis is logarithmic.
WIDE_APART = 4.0
# An axis ends at so many times the 95th percentile; what lies beyond is drawn at its edge, with its value.
BEYOND = 2.5
# A logarithmic axis begins at this percentile of the smallest errors.
LEAST = 0.02


def errors_by_pose(poses: PoseErrors, floor: float | None = None) -> Figure:
    """Position error [mm] of every pose for each model (paper, Figs. 6 and 7), over the row of its file.

    Points, not lines: neighbouring rows need not be neighbouring poses. Poses that were left out are crosses.
    floor : mean error that noise alone leaves [m], drawn as a line
    """
    some = poses.thinned(MOST_DRAWN)
    figure = new_figure(
        f"{plain(poses.words)}: error of each",
        f"row, {len(some)} of {len(poses)} drawn" if len(some) < len(poses) else f"row of {_short(poses.source)}",
        "position error [mm]",
        height=380,
        hovermode="closest",
    )
    shown = [left for left in some.models if left.shown]
    low, top, log = _limits([left.length for left in shown])
    low = min(low, 0.8 * floor) if floor else low
    for left in some.models:
        colour, marker, _ = style(left.model)
        far = left.length > top
        figure.add_scatter(
            x=some.row,
            y=1e3 * np.clip(left.length, low, top).round(8),
            name=plain(left.words),
            mode="markers",
            marker={
                "size": 6 if len(some) <= FEW else 4.5,
                "symbol": ["triangle-up-open" if f else marker for f in far] if far.any() else marker,
                "color": colour,
                "line": {"width": 1.2, "color": colour},
            },
            visible=True if left.shown else "legendonly",
            customdata=1e3 * left.length.round(8),
            hovertemplate=f"<b>{plain(left.words)}</b>, row %{{x}}: %{{customdata:.3f}} mm<extra></extra>",
        )
    _add_left_out(figure, poses, low, top)
    beyond = sorted({int(row) for left in shown for row in some.row[left.length > top]})
    if beyond:
        text = f"triangles: beyond the axis, row{'s' if beyond[1:] else ''} {_few(beyond)}"
        figure.add_annotation(text=text, x=0, xref="x domain", xanchor="left", y=1, yref="y domain", yanchor="bottom",
                              showarrow=False, font={"size": 11, "color": MUTED})  # fmt: skip
    rows = [*poses.row, *(out.row for out in poses.left_out)]
    room = 0.02 * (max(rows) - min(rows)) + 1
    figure.update_xaxes(range=[min(rows) - room, max(rows) + room], tickformat="d", nticks=8, showgrid=False)
    if floor:
        figure.add_scatter(
            x=[min(rows) - room, max(rows) + room], y=[1e3 * floor] * 2, mode="lines", hoverinfo="skip",
            line={"color": INK, "width": 1.4, "dash": "dot"}, name=f"mean of noise alone, {1e3 * floor:.3f} mm",
        )  # fmt: skip
    return _error_axis(figure, low, top, log)


def _few(rows: Sequence[int], most: int = 4) -> str:
    return ", ".join(map(str, rows[:most])) + (f" and {len(rows) - most} more" if len(rows) > most else "")


def _short(source: str) -> str:
    """A file's name, of a length that a phone shows."""
    name = Path(source).name or "the file"
    return plain(name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 9]}...{name[-6:]}")


def _limits(lengths: Sequence[Array]) -> tuple[float, float, bool]:
    """Ends of the axis of errors [m] that a few far poses do not move, and whether it is logarithmic."""
    medians = [float(np.median(length)) for length in lengths]
    log = min(medians) > 0 and max(medians) > WIDE_APART * min(medians)
    top = max(min(float(x.max()), BEYOND * float(np.quantile(x, 0.95))) for x in lengths)
    low = min(float(np.quantile(x, LEAST)) for x in lengths) if log else 0.0
    return max(low, 1e-3 * top) if log else 0.0, max(top, 1e-9), log


def _error_axis(figure: Figure, low: float, top: float, log: bool) -> Figure:
    if not log:
        return figure.update_yaxes(range=[0, 1.06e3 * top])
    ends = [float(np.log10(0.9e3 * low)), float(np.log10(1.12e3 * top))]
    return figure.update_yaxes(**log_ticks(), range=ends, title_text="position error [mm], logarithmic")


def _add_left_out(figure: Figure, poses: PoseErrors, low: float, top: float) -> None:
    """Crosses for the poses that were left out, with their error."""
    if not poses.left_out:
        return
    error = np.array([out.error for out in poses.left_out])
    figure.add_scatter(
        x=[out.row for out in poses.left_out], y=1e3 * np.clip(error, low, top), name="left out as outlier",
        mode="markers", marker={"size": 8, "symbol": "x", "color": RED}, customdata=1e3 * error,
        hovertemplate="<b>left out</b>, row %{x}: %{customdata:.3f} mm<extra></extra>",
    )  # fmt: skip


def error_distribution(poses: PoseErrors) -> Figure:
    """Share of the poses [%] with an error below x [mm], of all poses of the set."""
    figure = new_figure(
        f"{plain(poses.words)}: share below an error",
        "position error [mm]",
        "share of poses [%]",
        height=340,
        hovermode="y unified",
    )
    share = np.linspace(0, 1, min(QUANTILES, len(poses) + 1))
    for left in poses.models:
        colour, _, dash = style(left.model)
        figure.add_scatter(
            x=np.round(1e3 * np.quantile(left.length, share), 5),
            y=100 * share,
            name=plain(left.words),
            mode="lines",
            line={"width": 2, "dash": dash, "color": colour},
            visible=True if left.shown and not left.note else "legendonly",
            hovertemplate="%{x:.3f} mm",
        )
    _, top, log = _limits([left.length for left in poses.models if left.shown and not left.note])
    if log:
        figure.update_xaxes(type="log", title_text="position error [mm], logarithmic", nticks=8)
    else:
        figure.update_xaxes(range=[0, 1e3 * top])
    figure.update_yaxes(range=[0, 101], unifiedhovertitle_text="%{y:.0f} % of the poses are below")
    for percent in (50, 95):
        figure.add_hline(y=percent, line={"color": GRID, "width": 1})
    return figure
