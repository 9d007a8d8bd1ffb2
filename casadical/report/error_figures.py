"""Errors pose by pose (the paper's Figs. 6 and 7), and what share of the poses stays below which error."""

import numpy as np

from casadical.project.remaining_errors import BEFORE, ModelErrors, PoseErrors
from casadical.report.style import GRID, MUTED, PAPER, Figure, new_figure, plain, style

# More poses than this are drawn evenly thinned (and said to be), or the file grows and the eye gains nothing.
MOST_DRAWN = 400
LINES_UP_TO = 80
QUANTILES = 201


def errors_by_pose(poses: PoseErrors) -> Figure:
    """Position error [mm] of every pose for each model (paper, Figs. 6 and 7); "before" waits in the legend."""
    some = poses.thinned(MOST_DRAWN)
    drawn = "" if len(some) == len(poses) else f", {len(some)} of {len(poses)} drawn"
    figure = new_figure(
        f"{plain(poses.words)}: error of each",
        f"pose of the set, in the order of the file{drawn}",
        "position error [mm]",
        height=380,
        hovermode="x unified",
    )
    number = np.linspace(1, len(poses), len(some)).round().astype(int)
    mode = "lines+markers" if len(some) <= LINES_UP_TO else "markers"
    for left in some.models:
        colour, _, dash = style(left.model)
        figure.add_scatter(
            x=number,
            y=np.round(1e3 * left.length, 5),
            name=plain(left.words),
            mode=mode,
            line={"width": 1.4, "dash": dash, "color": colour},
            marker=_marker(left, 6 if len(some) <= LINES_UP_TO else 4.5),
            visible=True if left.shown else "legendonly",
            hovertemplate="%{y:.3f} mm",
        )
    figure.update_xaxes(range=[0, len(poses) + 1], hoverformat="d", unifiedhovertitle_text="pose %{x}", showgrid=False)
    return figure.update_yaxes(rangemode="tozero")


def _marker(left: ModelErrors, size: float) -> dict[str, object]:
    colour, marker, _ = style(left.model)
    return {"size": size, "symbol": marker, "color": colour, "line": {"width": 1.2, "color": colour}}


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
    figure.update_xaxes(rangemode="tozero")
    figure.update_yaxes(range=[0, 101], unifiedhovertitle_text="%{y:.0f} % of the poses are below")
    for percent in (50, 95):
        figure.add_hline(y=percent, line={"color": GRID, "width": 1})
    return figure


def before_after(poses: PoseErrors, floor: float | None = None) -> Figure:
    """Held-out error of each pose [mm] without and with the causes; floor : of the noise [m], drawn as a line."""
    figure = errors_by_pose(poses)
    for trace in figure.data:
        trace.visible = True
        if trace.name.startswith(BEFORE):
            trace.name = "base model"
    if floor is not None:
        figure.add_hline(y=1e3 * floor, line={"color": MUTED, "width": 1, "dash": "dot"})
        figure.add_annotation(
            text=f"mean of noise alone {1e3 * floor:.3f} mm", x=1, xref="x domain", xanchor="right", y=1e3 * floor,
            yanchor="bottom", showarrow=False, font={"size": 11, "color": MUTED}, bgcolor=PAPER, opacity=0.85,
        )  # fmt: skip
    return figure
