"""Stations at which a camera should see its target, and the accuracy to expect of their number.

Stations are chosen one by one, each by the largest reduction of the mean variance of the target's
place in the camera over all candidates (V-optimality, `experimental_design`), for base, tool and
geometry with the prior that a calibration has found: of the stations so far, or of simulated ones
with the nominal arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError
from casadical.core.reporting.blocks import Block, Table, Words
from casadical.core.reporting.plain import Key
from casadical.core.reporting.result import Result
from casadical.core.transforms import frame
from casadical.identification.accuracy import predicted
from casadical.identification.identification import identify
from casadical.identification.least_squares import LeastSquares
from casadical.identification.pose_selection.candidates import draw
from casadical.identification.pose_selection.experimental_design import Design, grow_to
from casadical.identification.pose_selection.selection import readings_table, short_tour, travel_distances
from casadical.identification.pose_selection.workspace import Workspace
from casadical.identification.prior import DRAWN_GROUPS
from casadical.identification.result import Identification
from casadical.measurements.camera_noise import Camera, CameraNoise, lines_of_sight, whitening
from casadical.measurements.measurements import Measurements, unmeasured
from casadical.robot.robot import Robot

# Nearest and farthest distance of a target [m], and its largest angles off the camera's axis and
# between line of sight and board's normal [rad].
View = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class CameraStations(Result):
    """Stations at which a camera sees its target, in an order with short travel.

    robot : calibrated on the stations so far; q : joint variables, shape (n, joints) [rad or m]
    source : origin of the view, in words
    visible : the camera's view, given or as the stations so far show it (see `View`)
    forecast : a row for each number of new stations, with expected rms errors of the target's place
        (over the candidates) and of the hand-eye translation [mm]; the first is of those so far
    """

    line: ClassVar[str] = " {{ it.q | length }} stations"
    derived: ClassVar[tuple[Key, ...]] = (Key("forecast", lambda it: it.forecast), Key("q", lambda it: it.q))

    robot: Robot
    q: Array
    visible: View
    forecast: pd.DataFrame
    source: str = "in the stations so far"

    @property
    def table(self) -> pd.DataFrame:
        """Return the controller's readings of each station, as of `readings_table`."""
        return readings_table(self.robot, self.q)

    def blocks(self) -> Sequence[Block]:
        """Return what the camera sees, and a table of the expected errors."""
        near, far, off, oblique = self.visible
        rows = [
            (str(r["stations"]), f"{r['place_mm']:.2g}", f"{r['hand_eye_mm']:.2g}")
            for r in self.forecast.to_dict("records")
        ]
        return [
            Words(
                f"The target is taken as visible from {near:.2f} to {far:.2f} m, up to {np.rad2deg(off):.0f} deg off "
                f"the camera's axis and {np.rad2deg(oblique):.0f} deg oblique, as {self.source}."
            ),
            Table("Expected errors [mm]", ("stations", "place of the target", "hand-eye"), rows, frozenset({0, 1, 2})),
        ]


def camera_stations(
    found: Identification, n: int = 25, workspace: Workspace | None = None, seed: int = 0, view: View | None = None
) -> CameraStations:
    """Return n stations for a new calibration of an arm and its camera.

    found : calibration of the stations so far, from which view, noise and frames follow
    workspace : where poses may lie; None: within the robot's limits
    view : None: 2 % and 98 % quantiles of the stations so far
    Raises InputError where no camera measured full poses, there are several sets, or fewer than 2 n
    of 16000 random poses see the target.
    """
    m, robot = found.problem.sets[0], found.robot
    if m.noise is None or len(found.problem.sets) > 1:
        raise InputError(
            f"{m.source}: no full poses of a camera; measure about ten stations, with the board at several distances "
            'and turned, and calibrate first (camera = "in hand" or "to base" in problem.toml says where it is)'
        )
    rng, where = np.random.default_rng(seed), workspace or Workspace()
    away, off, oblique = _view(m)
    of_stations = zip((away, away, off, oblique), (0.02, 0.98, 0.98, 0.98), strict=True)
    near, far, *angles = (float(np.quantile(part, share)) for part, share in of_stations)
    visible = view or (near, far, angles[0], angles[1])
    # Near the stations so far most poses see the target, elsewhere few do.
    close = robot.coupled(m.q[rng.integers(len(m), size=8_000)] + rng.normal(0, 0.3, (8_000, robot.n)))
    q = np.concatenate([close, draw(robot, 8_000, where, rng)])
    q = q[where.allows(robot, q)]
    q = q[_visible(_exact(robot, q, m.camera, m.noise), visible)][:1_500]
    if len(q) < 2 * n:
        raise InputError(
            f"{m.source}: only {len(q)} of 16000 readings see the target; allowed: twice as many as -n {n}"
        )
    J, lengths = _columns(found, robot, _exact(robot, q, m.camera, m.noise))
    own, _ = _columns(found, robot, m)
    names = found.names
    drawn = np.array([robot.parameters[name].group in DRAWN_GROUPS for name in names])
    size = found.departure.prior or found.departure.size if found.departure else 1.0
    prior = np.diag(np.where(drawn, 1 / max(size, 0.01) ** 2, 1e-8))
    mean = np.einsum("nip,niq->pq", lengths, lengths) / len(q)
    tool = [k for k, name in enumerate(names) if name in ("tool_x", "tool_y", "tool_z")]

    def row(stations: int, C: Array) -> tuple[int, float, float]:
        """Return a row of the forecast for a covariance C of the parameters in units of scale."""
        place, hand = float(np.sum(mean * C)), float(np.trace(C[np.ix_(tool, tool)]))
        return stations, 1e3 * float(np.sqrt(place)), float(np.sqrt(hand))

    rows = [row(len(m), np.linalg.inv(prior + np.einsum("nip,niq->pq", own, own)))]
    design = Design(mean, J, prior, q, 0.0, q[:0])
    for size in sorted({10, 15, 25, 40, n}):
        grow_to(design, size)
        rows.append(row(len(design.chosen), design.C))
    best = q[design.chosen[:n]]
    forecast = pd.DataFrame(rows, columns=["stations", "place_mm", "hand_eye_mm"])
    order = short_tour(travel_distances(robot, best))
    said = CameraStations.source if view is None else "was given; the first row is of 15 simulated stations"
    return CameraStations(robot, best[order], visible, forecast, said)


def read_view(text: str) -> View:
    """Return the view [m, rad] of a text NEAR,FAR,OFF,OBLIQUE [m, deg]. Raises InputError."""
    try:
        near, far, off, oblique = (float(number) for number in text.split(","))
    except ValueError:
        near = far = off = oblique = 0.0
    if not (0 < near < far and 0 < off < 90 and 0 < oblique < 90):
        raise InputError(f"--view {text}: allowed: NEAR,FAR,OFF,OBLIQUE, two rising distances [m] and two angles [deg]")
    return near, far, float(np.deg2rad(off)), float(np.deg2rad(oblique))


def simulated_stations(robot: Robot, view: View, sigma: float = 1e-3, seed: int = 0) -> Identification:
    """Return the calibration of a nominal arm from 15 simulated stations of a camera at its tool.

    The camera looks along the tool's z axis at a board in front of it, at the mean of the view's
    distances. Its noise is sigma [m] across the line of sight, three times as much along it, and 2
    mrad (0.7 mrad about it).

    view : see `View`. Raises InputError: too few poses see the board.
    """
    from scipy.spatial.transform import Rotation

    rng, noise = np.random.default_rng(seed), CameraNoise((1.0, 3.0, 1.0, 0.35), distance=(view[0] + view[1]) / 2)
    arm = robot.with_unknown(base="pose", tool="pose")
    for middle in draw(robot, 50, Workspace(), rng):
        near = np.clip(middle + rng.normal(0, 0.3, (4_000, robot.n)), *robot.limits)
        q = np.vstack([middle, robot.coupled(near)])
        p, R = predicted(robot, unmeasured(q))
        board = frame(R[0] @ np.diag([1.0, -1.0, -1.0]), p[0] + noise.distance * R[0][:, 2])
        placed = replace(arm, base=replace(arm.base, T=np.linalg.inv(board) @ arm.base.T))
        m = _exact(placed, q, "in hand", noise)
        if len(seen := np.flatnonzero(_visible(m, view))) >= 15:
            break
    else:
        raise InputError(
            f"{robot.name}: no 15 readings see a board from {view[0]:g} to {view[1]:g} m; give another view"
        )
    m = m[seen[:15]]
    white = np.repeat([sigma, 2e-3], 3) * rng.normal(size=(15, 6))
    off = np.linalg.solve(whitening(m.view, noise), white[..., None])[..., 0]
    assert m.position is not None
    turned = m.orientation @ Rotation.from_rotvec(-off[:, 3:]).as_matrix()
    return identify(placed, replace(m, position=m.position - off[:, :3], orientation=turned, noise=None), ["kinematic"])


def _visible(m: Measurements, view: View) -> Array:
    """Return a mask of the poses at which the target is in the view, shape (n,)."""
    (away, angle, slant), (near, far, off, oblique) = _view(m), view
    return np.asarray((away > near) & (away < far) & (angle < off) & (slant < oblique))


def _exact(robot: Robot, q: Array, camera: Camera, noise: CameraNoise) -> Measurements:
    """Return the model's poses at joint variables q without noise, as a camera's with `noise`."""
    p, R = predicted(robot, unmeasured(q))
    return Measurements(q, "pose", position=p, orientation=R, camera=camera, noise=noise)


def _view(m: Measurements) -> Array:
    """Return distance [m] and angles of sight line to camera's axis and board's normal, (3, n)."""
    assert m.noise is not None
    axes, away = lines_of_sight(m.view, m.noise)
    line = axes[:, 2]
    slant = np.arccos(np.clip(np.abs((line * m.view.R[:, :, 2]).sum(axis=1)), 0, 1))
    return np.stack([away, np.arccos(np.clip(line[:, 2], -1, 1)), slant])


def _columns(found: Identification, robot: Robot, m: Measurements) -> tuple[Array, Array]:
    """Return derivatives of whitened residuals (n, 6, p) and of the target's place [m] (n, 3, p).

    They are per unit of scale, in the axes of the camera's noise.
    """
    assert m.noise is not None
    problem = LeastSquares(robot, (m,), found.names, "linear", False, (found.problem.sigmas[0],))
    J = problem.evaluate(np.zeros(problem.size))[1].reshape(len(m), 6, -1)
    unit = m.noise.relative(lines_of_sight(m.view, m.noise)[1])[:, :3] * found.problem.sigmas[0][0]
    return J, J[:, :3] * unit[:, :, None]
