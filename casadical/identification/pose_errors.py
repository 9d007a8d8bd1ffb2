"""What models leave at every pose, and its figures: pose by pose, as a distribution, and in the workspace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.telling.drawing import CAMERA_EYE
from casadical.core.telling.figure import Axis, Figure, Note, Rule, Series
from casadical.identification.result import LeftOut
from casadical.robot.kinematics import link_frames
from casadical.robot.model import base_frame
from casadical.robot.robot import Robot

LONGEST_NAME = 26
SETS = {
    "report": "Held-out poses",
    "identify": "Poses that identified",
    "train": "Poses networks learnt",
    "choose": "Poses that judged networks",
}
# Model: colour, symbol, dash. No two of them differ by colour alone.
Style = tuple[str, str, str]
STYLES: dict[str, Style] = {
    "before": ("grey", "x-thin-open", "dot"),
    "KM": ("orange", "square", "dash"),
    "SKCM": ("blue", "circle", "solid"),
    "with causes": ("blue", "circle", "solid"),
    "base model": ("grey", "x-thin-open", "dot"),
}


@dataclass(frozen=True, eq=False)
class ModelErrors:
    """What one model leaves.

    length : of each pose [m], shape (n,); vector : measured less computed [m], shape (n, 3), where positions are known
    note : what a reader must know of this model ("refused"); shown : whether it is drawn before it is asked for
    network : its colour, symbol and dash, of a network
    """

    model: str
    length: Array
    vector: Array | None = None
    note: str = ""
    shown: bool = True
    network: Style | None = None

    @property
    def words(self) -> str:
        """How a legend names it."""
        return f"{self.model}, {self.note}" if self.note else self.model

    @property
    def style(self) -> Style:
        """Colour, symbol and dash; of a model that is not listed, those of SKCM."""
        return self.network or STYLES.get(self.model, STYLES["SKCM"])


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """What every model leaves at the poses of one set, outliers left out.

    name : of the set; held_out : whether no model saw it; row : line of the source file, shape (n,)
    q : shape (n, joints) [rad or m]; position : measured, shape (n, 3) [m], or None; models : in order of reading
    source : the file; left_out : its poses that are in no figure of the set
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
        """How a title names the set."""
        name, *more = self.name.split("/")
        return SETS.get(name, name) + (f" ({', '.join(more)})" if more else "")

    def thinned(self, most: int) -> PoseErrors:
        """At most so many of the poses, evenly spaced in their order."""
        if len(self) <= most:
            return self
        k = np.linspace(0, len(self) - 1, most).round().astype(int)
        models = tuple(
            replace(x, length=x.length[k], vector=None if x.vector is None else x.vector[k]) for x in self.models
        )
        position = None if self.position is None else self.position[k]
        return replace(self, row=self.row[k], q=self.q[k], position=position, models=models)


def errors_by_pose(poses: PoseErrors, name: str = "errors", caption: str = "", floor: float | None = None) -> Figure:
    """Position error [mm] of every pose for each model (paper, Figs. 6 and 7), over the row of its file.

    Points, not lines: neighbouring rows need not be neighbouring poses. Poses that were left out are crosses.
    floor : mean error that noise alone leaves [m], drawn as a line
    """
    # More poses than this are drawn evenly thinned (and said to be), or the file grows and the eye
    # gains nothing.
    some = poses.thinned(400)
    drawn = [left for left in some.models if left.shown]
    low, top, log = _limits([left.length for left in drawn])
    low = min(low, 0.8 * floor) if floor else low
    size = 6 if len(some) <= 80 else 4.5
    series = [_points(some, left, low, top, size) for left in some.models]
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
    beyond = sorted({int(row) for left in drawn for row in some.row[left.length > top]})
    marks = []
    if beyond:
        text = f"triangles: beyond the axis, row{'s' if beyond[1:] else ''} {_few(beyond)}"
        marks.append(Note(text, 0, 1, "xy", "above", colour="muted", size=11))
    title = f"row, {len(some)} of {len(poses)} drawn" if len(some) < len(poses) else f"row of {_short(poses.source)}"
    x, y = Axis(title, ends, count=8, whole=True, grid=False), Axis("error [mm]", (0, 1.06e3 * top))
    if log:
        y = Axis("error [mm], logarithmic", (0.9e3 * low, 1.12e3 * top), log=True)
    return Figure(name, f"{poses.words}: error of each", series, x, y, 380, caption, marks=marks)


def _points(some: PoseErrors, left: ModelErrors, low: float, top: float, size: float) -> Series:
    """One model at every pose; what lies beyond the axis stands at its edge, as a triangle."""
    colour, symbol, _ = left.style
    far = left.length > top
    return Series(
        "points",
        some.row,
        1e3 * np.clip(left.length, low, top).round(8),
        name=left.words,
        colour=colour,
        symbol=["triangle-up-open" if f else symbol for f in far] if far.any() else symbol,
        size=size,
        shown=left.shown,
        facts=1e3 * left.length.round(8),
        tip=f"<b>{left.words}</b>, row %{{x}}: %{{customdata:.3f}} mm",
    )


def _few(rows: Sequence[int], most: int = 4) -> str:
    return ", ".join(map(str, rows[:most])) + (f" and {len(rows) - most} more" if len(rows) > most else "")


def _short(source: str) -> str:
    """A file's name, of a length that a phone shows."""
    name = Path(source).name or "the file"
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 9]}...{name[-6:]}"


def _limits(lengths: Sequence[Array]) -> tuple[float, float, bool]:
    """Ends of the axis of errors [m] that a few far poses do not move, and whether it is logarithmic."""
    medians = [float(np.median(length)) for length in lengths]
    # Where the medians of two models differ by more, the axis is logarithmic.
    log = min(medians) > 0 and max(medians) > 4.0 * min(medians)
    # An axis ends at so many times the 95th percentile; what lies beyond is drawn at its edge, with
    # its value.
    top = max(min(float(x.max()), 2.5 * float(np.quantile(x, 0.95))) for x in lengths)
    # A logarithmic axis begins at this percentile of the smallest errors.
    low = min(float(np.quantile(x, 0.02)) for x in lengths) if log else 0.0
    return max(low, 1e-3 * top) if log else 0.0, max(top, 1e-9), log


def error_distribution(poses: PoseErrors, name: str = "distribution", caption: str = "") -> Figure:
    """Share of the poses [%] with an error below x [mm], of all poses of the set."""
    share = np.linspace(0, 1, min(201, len(poses) + 1))
    series = [
        Series(
            "line",
            np.round(1e3 * np.quantile(left.length, share), 5),
            100 * share,
            name=left.words,
            colour=left.style[0],
            dash=left.style[2],
            shown=left.shown and not left.note,
            tip="%{x:.3f} mm",
        )
        for left in poses.models
    ]
    _, top, log = _limits([left.length for left in poses.models if left.shown and not left.note])
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


def workspace(poses: PoseErrors, robot: Robot | None = None, caption: str = "") -> Figure:
    """Measured points with what each model leaves there, to be turned and hovered over.

    Each model's vectors are drawn longer by its own factor, which its name in the legend states. robot : drawn as a
    skeleton at one of the poses. Needs measured positions.
    """
    some = poses.thinned(500)
    assert some.position is not None
    # At first the last model is drawn that is no network.
    first = next((x for x in reversed(some.models) if x.network is None), some.models[-1])
    extent = float(np.linalg.norm(np.ptp(some.position, axis=0)))
    series: list[Series] = []
    for left in some.models:
        if left.vector is not None and not left.note:
            # In the workspace, an error of the 95th percentile is drawn as long as this share of
            # it.
            factor = round_factor(0.16 * extent / max(float(np.quantile(left.length, 0.95)), 1e-12))
            series += _vectors(some, left, factor, left is first)
    if robot is not None:
        out = some.position - robot.base.T[:3, 3]
        from_the_side = int(
            np.argmax(out[:, 0] * CAMERA_EYE[1] - out[:, 1] * CAMERA_EYE[0])
        )  # as the first view shows it
        points = skeleton(robot, some.q[from_the_side])
        series.append(Series("linked", **_xyz(points), name="robot, at one pose", colour="grey", width=9, size=4.5))
    return Figure("workspace", f"{poses.words}: error vectors", series, height=560, caption=caption)


def round_factor(factor: float) -> float:
    """The next lower number of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(factor, 1.0)))
    return float(max(step * power for step in (1, 2, 5) if step * power <= max(factor, 1.0)))


def _vectors(poses: PoseErrors, left: ModelErrors, factor: float, shown: bool) -> list[Series]:
    """A line for each pose from the measured point, and its tip coloured by the error."""
    assert poses.position is not None
    assert left.vector is not None
    tip = poses.position + factor * left.vector
    lines = np.stack([poses.position, tip, np.full_like(tip, np.nan)], axis=1).reshape(-1, 3)
    alike: dict[str, Any] = {
        "name": f"{left.words}, drawn {factor:g} × longer",
        "colour": left.style[0],
        "group": left.model,
        "shown": shown,
    }
    facts = np.column_stack([poses.row, 1e3 * left.length, 1e3 * left.vector, poses.position]).round(5)
    words = (
        f"<b>%{{customdata[1]:.3f}} mm</b>, {left.model}, row %{{customdata[0]:d}}<br>"
        "dx %{customdata[2]:+.3f}, dy %{customdata[3]:+.3f}, dz %{customdata[4]:+.3f} mm<br>"
        "at x %{customdata[5]:.3f}, y %{customdata[6]:.3f}, z %{customdata[7]:.3f} m"
    )
    return [
        Series("line", **_xyz(lines), width=3, **alike),
        Series("points", **_xyz(tip), size=2.6, listed=False, facts=facts, tip=words, **alike),
    ]


def skeleton(robot: Robot, q: Array) -> Array:
    """Origins of base, links and tool in the measuring frame at one reading, shape (joints + 2, 3) [m]; rigid."""
    values = {p.name: ca.DM(p.value) for p in robot.parameters}
    T = np.array(ca.DM(base_frame(robot, values, ca.DM(robot.base.T))))
    frames = [np.eye(4), *(np.array(ca.DM(ca.evalf(f))) for f in link_frames(robot, list(ca.DM(q).nz), values))]
    origins = [(T @ f)[:3, 3] for f in frames]
    tool, _ = robot.model.evaluate(("p", "R"), q[None], robot.declared[None], robot.parameters.values)
    return np.array([*origins, tool[:, 0]])


def _xyz(points: Array) -> dict[str, Any]:
    return dict(zip("xyz", np.round(points, 6).T, strict=True))
