"""Errors of several models at every pose, with figures by pose, distribution and workspace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.reporting.drawing import CAMERA_EYE
from casadical.core.reporting.figure import Axis, Figure, Note, Rule, Series
from casadical.identification.accuracy import predicted
from casadical.identification.result import LeftOut
from casadical.measurements.measurements import Measurements
from casadical.robot.kinematics import link_frames
from casadical.robot.model import base_frame
from casadical.robot.robot import Robot

# Name of a set of poses -> its title in figures.
SET_TITLES = {
    "report": "Held-out poses",
    "identify": "Poses that identified",
    "train": "Poses networks learnt",
    "choose": "Poses that judged networks",
}
# Colour, symbol and dash with which figures draw a model.
Style = tuple[str, str, str]
# Name of a model -> its style; models in one figure do not differ by colour alone.
MODEL_STYLES: dict[str, Style] = {
    "before": ("grey", "x-thin-open", "dot"),
    "KM": ("orange", "square", "dash"),
    "SKCM": ("blue", "circle", "solid"),
    "with causes": ("blue", "circle", "solid"),
    "base model": ("grey", "x-thin-open", "dot"),
}


@dataclass(frozen=True, eq=False)
class ModelErrors:
    """Position errors of one model at the poses of a set.

    model : its name
    length : size of the error at each pose [m], shape (n,)
    vector : measured minus computed position in the measuring frame [m], shape (n, 3); None without
        positions
    note : remark on this model in the legend, such as "refused"; empty: none
    shown : whether it is drawn initially, or only when a reader selects it
    network : style of a network; None for other models
    """

    model: str
    length: Array
    vector: Array | None = None
    note: str = ""
    shown: bool = True
    network: Style | None = None

    @property
    def words(self) -> str:
        """The model's entry in a legend: its name, and its note if it has one."""
        return f"{self.model}, {self.note}" if self.note else self.model

    @property
    def style(self) -> Style:
        """Colour, symbol and dash; a model without a style of its own has that of SKCM."""
        return self.network or MODEL_STYLES.get(self.model, MODEL_STYLES["SKCM"])


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of every model at the poses of one set, without outliers.

    name : of the set; held_out : whether no model was fitted to it
    row : row of each pose in the source file, shape (n,)
    q : joint variables, shape (n, joints) [rad or m]
    position : measured in the measuring frame, shape (n, 3) [m], or None
    models : in the order of the legend
    source : the file; left_out : poses of it that are outliers and in no figure of the set
    """

    name: str
    held_out: bool
    row: Array
    q: Array
    position: Array | None
    models: tuple[ModelErrors, ...]
    source: str = ""
    left_out: tuple[LeftOut, ...] = ()

    def __len__(self) -> int:
        return len(self.row)

    @property
    def words(self) -> str:
        """The title of the set of poses in figures."""
        name, *more = self.name.split("/")
        return SET_TITLES.get(name, name) + (f" ({', '.join(more)})" if more else "")

    def thinned(self, most: int) -> PoseErrors:
        """Return the errors at no more than `most` of the poses, evenly spaced in their order."""
        if len(self) <= most:
            return self
        k = np.linspace(0, len(self) - 1, most).round().astype(int)
        models = tuple(
            replace(x, length=x.length[k], vector=None if x.vector is None else x.vector[k]) for x in self.models
        )
        position = None if self.position is None else self.position[k]
        return replace(self, row=self.row[k], q=self.q[k], position=position, models=models)


def errors_by_pose(poses: PoseErrors, name: str = "errors", caption: str = "", floor: float | None = None) -> Figure:
    """Return the figure of the position error [mm] of every pose for each model, by row.

    Points, not lines: neighbouring rows need not be neighbouring poses. Outliers are crosses.
    Source: paper, Figs. 6 and 7.

    floor : mean error due to noise alone [m], drawn as a line
    """
    # More than 400 poses are thinned, which the title says: they would only enlarge the file.
    some = poses.thinned(400)
    drawn = [model for model in some.models if model.shown]
    low, top, log = _limits([model.length for model in drawn])
    low = min(low, 0.8 * floor) if floor else low
    size = 6 if len(some) <= 80 else 4.5
    series = [_points(some, model, low, top, size) for model in some.models]
    if poses.left_out:
        error = np.array([out.error for out in poses.left_out])
        series.append(
            Series(
                "points",
                [out.row for out in poses.left_out],
                1e3 * np.clip(error, low, top),
                colour="red",
                symbol="x",
                size=8,
                name="left out as outlier",
                facts=1e3 * error,
                tip="<b>left out</b>, row %{x}: %{customdata:.3f} mm",
            )
        )
    rows = [*poses.row, *(out.row for out in poses.left_out)]
    room = 0.02 * (max(rows) - min(rows)) + 1
    ends = (min(rows) - room, max(rows) + room)
    if floor:
        words = f"mean of noise alone, {1e3 * floor:.3f} mm"
        series.append(Series("line", ends, [1e3 * floor] * 2, name=words, colour="ink", width=1.4, dash="dot"))
    beyond = sorted({int(row) for model in drawn for row in some.row[model.length > top]})
    marks = []
    if beyond:
        more = f" and {len(beyond) - 4} more" if beyond[4:] else ""
        text = f"triangles: beyond the axis, row{'s' if beyond[1:] else ''} {', '.join(map(str, beyond[:4]))}{more}"
        marks.append(Note(text, 0, 1, "xy", "above", colour="muted", size=11))
    title = f"row, {len(some)} of {len(poses)} drawn" if len(some) < len(poses) else f"row of {_short(poses.source)}"
    x, y = Axis(title, ends, count=8, whole=True, grid=False), Axis("error [mm]", (0, 1.06e3 * top))
    if log:
        y = Axis("error [mm], logarithmic", (0.9e3 * low, 1.12e3 * top), log=True)
    return Figure(name, f"{poses.words}: error of each", series, x, y, 380, caption, marks=marks)


def _points(some: PoseErrors, model: ModelErrors, low: float, top: float, size: float) -> Series:
    """Return one model's errors [mm] by row as points; errors above the axis are triangles.

    low, top : ends of the error axis [m], to which errors are clipped; size : of a symbol [px]
    """
    colour, symbol, _ = model.style
    far = model.length > top
    return Series(
        "points",
        some.row,
        1e3 * np.clip(model.length, low, top).round(8),
        name=model.words,
        colour=colour,
        symbol=["triangle-up-open" if f else symbol for f in far] if far.any() else symbol,
        size=size,
        shown=model.shown,
        facts=1e3 * model.length.round(8),
        tip=f"<b>{model.words}</b>, row %{{x}}: %{{customdata:.3f}} mm",
    )


def _short(source: str) -> str:
    """Return a file's name, shortened to fit on a phone."""
    name = Path(source).name or "the file"
    return name if len(name) <= 26 else f"{name[:17]}...{name[-6:]}"


def _limits(lengths: Sequence[Array]) -> tuple[float, float, bool]:
    """Return lower and upper end of the error axis [m], and whether it is logarithmic.

    A few large errors do not extend the axis; a linear one begins at zero.

    lengths : errors of each model, shape (n,) each [m]
    """
    medians = [float(np.median(length)) for length in lengths]
    # The axis is logarithmic if the medians of two models differ by more than this factor.
    log = min(medians) > 0 and max(medians) > 4.0 * min(medians)
    # The axis ends at 2.5 times the 95th percentile; errors beyond it are drawn at its edge.
    top = max(min(float(x.max()), 2.5 * float(np.quantile(x, 0.95))) for x in lengths)
    # A logarithmic axis begins at this percentile of the smallest errors.
    low = min(float(np.quantile(x, 0.02)) for x in lengths) if log else 0.0
    return max(low, 1e-3 * top) if log else 0.0, max(top, 1e-9), log


def error_distribution(poses: PoseErrors, name: str = "distribution", caption: str = "") -> Figure:
    """Return the figure of each model's share of poses [%] with an error below x [mm]."""
    share = np.linspace(0, 1, min(201, len(poses) + 1))
    series = [
        Series(
            "line",
            np.round(1e3 * np.quantile(model.length, share), 5),
            100 * share,
            name=model.words,
            colour=model.style[0],
            dash=model.style[2],
            shown=model.shown and not model.note,
            tip="%{x:.3f} mm",
        )
        for model in poses.models
    ]
    _, top, log = _limits([model.length for model in poses.models if model.shown and not model.note])
    x = Axis("error [mm]", (0, 1e3 * top))
    return Figure(
        name,
        f"{poses.words}: share below an error",
        series,
        Axis("error [mm], logarithmic", log=True, count=8) if log else x,
        Axis("share of poses [%]", (0, 101)),
        340,
        caption,
        marks=[Rule("y", percent, "grid", "solid") for percent in (50, 95)],
        over="%{y:.0f} % of the poses are below",
    )


def workspace(poses: PoseErrors, robot: Robot | None = None, more: str = "") -> Figure:
    """Return the 3D figure of the measured points with each model's error vectors.

    Points and vectors are in the measuring frame [m]. Each model's vectors are enlarged by its own
    factor, which the legend states; models with a note have none. Measured positions are required.

    robot : drawn as a skeleton at one of the poses; None: not drawn
    more : what the caption says in addition
    """
    caption = (
        "Turn it with the mouse; point at the dot that ends a vector for its error. Each line runs "
        "from the measured point in the direction of the error (measured less computed), longer "
        f"than it by the factor in the legend. {more}"
    )
    some = poses.thinned(500)
    assert some.position is not None
    # Initially the last model that is no network is drawn.
    first = next((x for x in reversed(some.models) if x.network is None), some.models[-1])
    extent = float(np.linalg.norm(np.ptp(some.position, axis=0)))
    series: list[Series] = []
    for model in some.models:
        if model.vector is not None and not model.note:
            # The 95th percentile of the errors is drawn as 16 % of the workspace's extent.
            factor = round_factor(0.16 * extent / max(float(np.quantile(model.length, 0.95)), 1e-12))
            series += _vectors(some, model, factor, model is first)
    if robot is not None:
        out = some.position - robot.base.T[:3, 3]
        from_the_side = int(
            np.argmax(out[:, 0] * CAMERA_EYE[1] - out[:, 1] * CAMERA_EYE[0])
        )  # as the first view shows it
        points = skeleton(robot, some.q[from_the_side])
        series.append(Series("linked", **_xyz(points), name="robot, at one pose", colour="grey", width=9, size=4.5))
    title = f"{poses.words}: error vectors"
    return Figure("workspace", title, series, height=560, caption=caption.rstrip())


def image_plane(m: Measurements, robots: Mapping[str, Robot], caption: str = "") -> Figure:
    """Return the figure of where a camera saw its target, with each robot's residuals in the image.

    Coordinates are x/z and y/z in the camera's frame, y downwards as in an image; a line runs from
    the measured place of the target's middle in the direction of the error (measured less computed).

    m : full poses of a camera; robots : model -> robot
    """
    middle = np.array(m.noise.point if m.noise else (0.0, 0.0, 0.0))

    def places(m: Measurements) -> Array:
        return np.asarray(m.view.t + m.view.R @ middle)

    t = places(m)
    at = t[:, :2] / t[:, 2:]
    extent, series = float(np.linalg.norm(np.ptp(at, axis=0))), list[Series]()
    for model, robot in robots.items():
        p, R = predicted(robot, m)
        off = t - places(replace(m, position=p, orientation=R))
        image = off[:, :2] / t[:, 2:]
        length = np.linalg.norm(image, axis=1)
        factor = round_factor(0.16 * extent / max(float(np.quantile(length, 0.95)), 1e-12))
        tip, colour = at + factor * image, MODEL_STYLES.get(model, MODEL_STYLES["SKCM"])[0]
        lines = np.stack([at, tip, np.full_like(at, np.nan)], axis=1).reshape(-1, 2)
        alike: dict[str, Any] = {"name": f"{model}, drawn {factor:g} × longer", "colour": colour, "group": model}
        facts = np.column_stack([m.row, 1e3 * np.linalg.norm(off[:, :2], axis=1), 1e3 * off[:, 2], t[:, 2]]).round(4)
        words = "across %{customdata[1]:.3f} mm, depth %{customdata[2]:+.3f} mm, at %{customdata[3]:.2f} m"
        series += [
            Series("line", lines[:, 0].round(6), lines[:, 1].round(6), width=1.6, **alike),
            Series(
                "points",
                tip[:, 0].round(6),
                tip[:, 1].round(6),
                size=4,
                listed=False,
                facts=facts,
                tip=f"<b>{model}</b>, row %{{customdata[0]:d}}<br>{words}",
                **alike,
            ),
        ]
    low, top = at.min(axis=0) - 0.1 * extent, at.max(axis=0) + 0.1 * extent
    axes = Axis("x/z in the camera", (low[0], top[0])), Axis("y/z in the camera, downwards", (top[1], low[1]))
    return Figure("image", "Stations in the image, with residuals", series, *axes, 460, caption)


def round_factor(factor: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, ... that is not above the factor, at least 1."""
    power = 10.0 ** np.floor(np.log10(max(factor, 1.0)))
    return float(max(step * power for step in (1, 2, 5) if step * power <= max(factor, 1.0)))


def _vectors(poses: PoseErrors, model: ModelErrors, factor: float, shown: bool) -> list[Series]:
    """Return a model's error vectors as two series: lines from the measured points, and their ends.

    factor : by which the vectors are enlarged; shown : whether they are drawn initially
    """
    assert poses.position is not None
    assert model.vector is not None
    tip = poses.position + factor * model.vector
    lines = np.stack([poses.position, tip, np.full_like(tip, np.nan)], axis=1).reshape(-1, 3)
    alike: dict[str, Any] = {
        "name": f"{model.words}, drawn {factor:g} × longer",
        "colour": model.style[0],
        "group": model.model,
        "shown": shown,
    }
    facts = np.column_stack([poses.row, 1e3 * model.length, 1e3 * model.vector, poses.position]).round(5)
    words = (
        f"<b>%{{customdata[1]:.3f}} mm</b>, {model.model}, row %{{customdata[0]:d}}<br>"
        "dx %{customdata[2]:+.3f}, dy %{customdata[3]:+.3f}, dz %{customdata[4]:+.3f} mm<br>"
        "at x %{customdata[5]:.3f}, y %{customdata[6]:.3f}, z %{customdata[7]:.3f} m"
    )
    return [
        Series("line", **_xyz(lines), width=3, **alike),
        Series("points", **_xyz(tip), size=2.6, listed=False, facts=facts, tip=words, **alike),
    ]


def skeleton(robot: Robot, q: Array) -> Array:
    """Return the origins of base, links and tool in the measuring frame, (joints + 2, 3) [m].

    Links are without deflections and effects; the tool is the model's, with both.

    q : joint variables of one pose, shape (joints,) [rad or m]
    """
    values = {p.name: ca.DM(p.value) for p in robot.parameters}
    T = np.array(ca.DM(base_frame(robot, values, ca.DM(robot.base.T))))
    frames = [np.eye(4), *(np.array(ca.DM(ca.evalf(f))) for f in link_frames(robot, list(ca.DM(q).nz), values))]
    origins = [(T @ f)[:3, 3] for f in frames]
    tool, _ = robot.model.evaluate(("p", "R"), q[None], robot.declared[None], robot.parameters.values)
    return np.array([*origins, tool[:, 0]])


def _xyz(points: Array) -> dict[str, Any]:
    """Return the coordinates of points, shape (n, 3) [m], by the keys x, y, z, each shape (n,)."""
    return dict(zip("xyz", np.round(points, 6).T, strict=True))
