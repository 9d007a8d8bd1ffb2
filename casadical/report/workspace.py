"""The workspace in three dimensions, with the error vector of each pose drawn longer by a stated factor."""

from typing import Any

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.project.remaining_errors import ModelErrors, PoseErrors
from casadical.report.style import COLOURS, GRID, INK, LINE, MUTED, STYLES, Figure, new_figure, plain, style
from casadical.robot.kinematics import link_frames
from casadical.robot.model import base_frame
from casadical.robot.robot import Robot

MOST_DRAWN = 500
# An error of the 95th percentile is drawn as long as this share of the workspace.
LENGTH = 0.16
# Of the first view, in lengths of the drawn box.
EYE = (1.15, 1.3, 0.55)


def workspace(poses: PoseErrors, robot: Robot | None = None) -> Figure:
    """Measured points with what each model leaves there, to be turned and hovered over.

    Each model's vectors are drawn longer by its own factor, which its name in the legend states. robot : drawn as a
    skeleton at one of the poses. Needs measured positions.
    """
    some = poses.thinned(MOST_DRAWN)
    assert some.position is not None
    figure = new_figure(f"{plain(poses.words)}: error vectors", height=560)
    figure.update_layout(scene=_scene(), margin={"l": 0, "r": 0, "t": 44, "b": 0})
    shown = _main(some)
    extent = float(np.linalg.norm(np.ptp(some.position, axis=0)))
    for left in some.models:
        if left.vector is not None and not left.note:
            factor = round_factor(LENGTH * extent / max(float(np.quantile(left.length, 0.95)), 1e-12))
            _add_vectors(figure, some, left, factor, left.model == shown)
    if robot is not None:
        _add_robot(figure, robot, some)
    return figure


def _main(poses: PoseErrors) -> str:
    """The model that is drawn at first: the last that is no network."""
    names = [x.model for x in poses.models if x.model in STYLES]
    return names[-1] if names else poses.models[-1].model


def round_factor(factor: float) -> float:
    """The next lower number of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(factor, 1.0)))
    return float(max(step * power for step in (1, 2, 5) if step * power <= max(factor, 1.0)))


def _add_vectors(figure: Figure, poses: PoseErrors, left: ModelErrors, factor: float, shown: bool) -> None:
    """A line for each pose from the measured point, and its tip coloured by the error."""
    assert poses.position is not None
    assert left.vector is not None
    tip = poses.position + factor * left.vector
    gap = np.full_like(tip, np.nan)
    lines = np.stack([poses.position, tip, gap], axis=1).reshape(-1, 3)
    colour = style(left.model)[0]
    visible: bool | str = True if shown else "legendonly"
    name = f"{plain(left.words)}, drawn {factor:g} × longer"
    shared: dict[str, Any] = {"legendgroup": left.model, "visible": visible}
    figure.add_scatter3d(
        **_xyz(lines), mode="lines", line={"color": colour, "width": 3}, hoverinfo="skip", name=name, **shared
    )
    size = 1e3 * left.length
    figure.add_scatter3d(
        **_xyz(tip),
        mode="markers",
        showlegend=False,
        name=name,
        marker={"size": 2.6, "color": colour, "line": {"width": 0}},
        customdata=np.column_stack([poses.row, size, 1e3 * left.vector, poses.position]).round(5),
        hovertemplate=(
            f"<b>%{{customdata[1]:.3f}} mm</b>, {plain(left.model)}, row %{{customdata[0]:d}}<br>"
            "dx %{customdata[2]:+.3f}, dy %{customdata[3]:+.3f}, dz %{customdata[4]:+.3f} mm<br>"
            "at x %{customdata[5]:.3f}, y %{customdata[6]:.3f}, z %{customdata[7]:.3f} m<extra></extra>"
        ),
        **shared,
    )


def _add_robot(figure: Figure, robot: Robot, poses: PoseErrors) -> None:
    points = skeleton(robot, poses.q[_from_the_side(robot, poses)])
    figure.add_scatter3d(
        **_xyz(points),
        mode="lines+markers",
        name="robot, at one pose",
        line={"color": COLOURS["grey"][0], "width": 9},
        marker={"size": 4.5, "color": INK},
        hoverinfo="skip",
    )


def skeleton(robot: Robot, q: Array) -> Array:
    """Origins of base, links and tool in the measuring frame at one reading, shape (joints + 2, 3) [m]; rigid."""
    values = {p.name: ca.DM(p.value) for p in robot.parameters}
    T = np.array(ca.DM(base_frame(robot, values, ca.DM(robot.base.T))))
    frames = [np.eye(4), *(np.array(ca.DM(ca.evalf(f))) for f in link_frames(robot, list(ca.DM(q).nz), values))]
    origins = [(T @ f)[:3, 3] for f in frames]
    tool, _ = robot.model.evaluate(("p", "R"), q[None], robot.declared[None], robot.parameters.values)
    return np.array([*origins, tool[:, 0]])


def _from_the_side(robot: Robot, poses: PoseErrors) -> int:
    """The pose that the first view shows most from the side."""
    assert poses.position is not None
    out = poses.position - robot.base.T[:3, 3]
    return int(np.argmax(out[:, 0] * EYE[1] - out[:, 1] * EYE[0]))


def _xyz(points: Array) -> dict[str, Array]:
    return dict(zip("xyz", np.round(points, 6).T, strict=True))


def _scene() -> dict[str, Any]:
    axis = {"gridcolor": GRID, "zerolinecolor": LINE, "showbackground": False, "linecolor": LINE, "color": MUTED}
    axes = {f"{c}axis": {**axis, "title": {"text": f"{c} [m]"}, "nticks": 6, "showspikes": False} for c in "xyz"}
    camera = {"eye": dict(zip("xyz", EYE, strict=True)), "center": {"x": 0, "y": 0, "z": -0.22}}
    return {**axes, "aspectmode": "data", "camera": camera, "dragmode": "turntable"}
