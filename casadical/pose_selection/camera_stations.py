"""Stations at which a camera should see its target, and the accuracy to expect of so many.

Stations are chosen one by one, each by the largest reduction of the mean variance of the target's place in the camera
over all candidates (V-optimality), for base, tool and geometry with the prior that a calibration has found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError
from casadical.core.reporting.blocks import Block, Table, Words
from casadical.core.reporting.plain import Key
from casadical.core.reporting.result import Result
from casadical.core.statistics import first_of_best
from casadical.identification.accuracy import predicted
from casadical.identification.departure import DRAWN_GROUPS
from casadical.identification.least_squares import LeastSquares
from casadical.identification.result import Identification
from casadical.measurements.camera_noise import lines_of_sight
from casadical.measurements.measurements import Measurements, unmeasured
from casadical.pose_selection.candidates import draw
from casadical.pose_selection.selection import readings_table, short_tour, travel_distances
from casadical.pose_selection.workspace import Workspace
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class CameraStations(Result):
    """Stations at which a camera sees its target, in an order with short travel.

    robot : calibrated on the stations so far; q : readings, shape (n, joints) [rad or m]
    visible : what the stations so far show of the camera's view: distances [m], largest angles off its axis and
        between line of sight and board's normal [rad]
    forecast : a row for each number of stations, with expected errors of the target's place (rms over the candidates)
        and of the hand-eye transform [mm]; the first row is of the stations so far
    """

    line: ClassVar[str] = " {{ it.q | length }} stations"
    derived: ClassVar[tuple[Key, ...]] = (Key("forecast", lambda it: it.forecast), Key("q", lambda it: it.q))

    robot: Robot
    q: Array
    visible: tuple[float, float, float, float]
    forecast: pd.DataFrame

    @property
    def table(self) -> pd.DataFrame:
        """The controller's readings of each station."""
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
                f"the camera's axis and {np.rad2deg(oblique):.0f} deg oblique, as in the stations so far."
            ),
            Table("Expected errors [mm]", ("stations", "place of the target", "hand-eye"), rows, frozenset({0, 1, 2})),
        ]


def camera_stations(
    found: Identification, n: int = 25, workspace: Workspace | None = None, seed: int = 0
) -> CameraStations:
    """Return n stations for a new calibration of an arm and its camera.

    found : calibration of the stations so far, which tell the view, the noise, and the frames; workspace : where poses
        may lie, None: the robot's limits
    Raises InputError where no camera measured full poses, or too few stations are visible.
    """
    m, robot = found.problem.sets[0], found.robot
    if m.noise is None or len(found.problem.sets) > 1:
        raise InputError(
            f"{m.source}: no full poses of a camera; measure about ten stations, with the board at several distances "
            'and turned, and calibrate first (camera = "in hand" or "to base" in problem.toml says where it is)'
        )
    rng, where = np.random.default_rng(seed), workspace or Workspace()
    limits = zip(_view(m)[[0, 0, 1, 2]], (0.02, 0.98, 0.98, 0.98), strict=True)
    near, far, off, oblique = (float(np.quantile(part, share)) for part, share in limits)
    # Near the stations so far most readings see the target, elsewhere few do.
    close = m.q[rng.integers(len(m), size=8_000)] + rng.normal(0, 0.3, (8_000, robot.n))
    q = np.concatenate([close, draw(robot, 8_000, where, rng)])
    q = q[where.allows(robot, q)]
    away, angle, slant = _view(_exact(robot, q, m))
    q = q[(away > near) & (away < far) & (angle < off) & (slant < oblique)][:1_500]
    if len(q) < 2 * n:
        raise InputError(
            f"{m.source}: only {len(q)} of 16000 readings see the target; allowed: twice as many as -n {n}"
        )
    J, lengths = _columns(found, robot, _exact(robot, q, m))
    own, _ = _columns(found, robot, m)
    names = found.names
    drawn = np.array([robot.parameters[name].group in DRAWN_GROUPS for name in names])
    size = found.departure.prior or found.departure.size if found.departure else 1.0
    prior = np.diag(np.where(drawn, 1 / max(size, 0.01) ** 2, 1e-8))
    mean = np.einsum("nip,niq->pq", lengths, lengths) / len(q)
    tool = [k for k, name in enumerate(names) if name in ("tool_x", "tool_y", "tool_z")]

    def row(stations: int, C: Array) -> tuple[int, float, float]:
        place, hand = float(np.sum(mean * C)), float(np.trace(C[np.ix_(tool, tool)]))
        return stations, 1e3 * float(np.sqrt(place)), float(np.sqrt(hand))

    rows = [row(len(m), np.linalg.inv(prior + np.einsum("nip,niq->pq", own, own)))]
    C, chosen = np.linalg.inv(prior), list[int]()
    while len(chosen) < max(n, 40):
        D = J @ C
        S = np.eye(6) + D @ J.transpose(0, 2, 1)
        gain = np.einsum("nip,pq,niq->n", np.linalg.solve(S, D), mean, D)
        gain[chosen] = -np.inf
        k = first_of_best(gain)
        chosen.append(k)
        C = C - D[k].T @ np.linalg.solve(S[k], D[k])
        if len(chosen) in (10, 15, 25, 40, n):
            rows.append(row(len(chosen), C))
    best = q[chosen[:n]]
    forecast = pd.DataFrame(rows, columns=["stations", "place_mm", "hand_eye_mm"])
    order = short_tour(travel_distances(robot, best))
    return CameraStations(robot, best[order], (near, far, off, oblique), forecast)


def _exact(robot: Robot, q: Array, m: Measurements) -> Measurements:
    """Return the poses that the robot's model has at readings q, with the camera and noise of m."""
    p, R = predicted(robot, unmeasured(q))
    return Measurements(q, "pose", position=p, orientation=R, camera=m.camera, noise=m.noise)


def _view(m: Measurements) -> Array:
    """Return distance [m], angle off the camera's axis and of the board's normal [rad], shape (3, n)."""
    assert m.noise is not None
    axes, away = lines_of_sight(m.view, m.noise)
    line = axes[:, 2]
    slant = np.arccos(np.clip(np.abs((line * m.view.R[:, :, 2]).sum(axis=1)), 0, 1))
    return np.stack([away, np.arccos(np.clip(line[:, 2], -1, 1)), slant])


def _columns(found: Identification, robot: Robot, m: Measurements) -> tuple[Array, Array]:
    """Return derivatives of whitened residuals (n, 6, p) and of the target's place [m] (n, 3, p)."""
    assert m.noise is not None
    problem = LeastSquares(robot, (m,), found.names, "linear", False, (found.problem.sigmas[0],))
    J = problem.evaluate(np.zeros(problem.size))[1].reshape(len(m), 6, -1)
    unit = m.noise.relative(lines_of_sight(m.view, m.noise)[1])[:, :3] * found.problem.sigmas[0][0]
    return J, J[:, :3] * unit[:, :, None]
