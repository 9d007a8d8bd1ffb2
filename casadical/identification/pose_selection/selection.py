"""Result of a pose selection: poses to measure in order, and the expected accuracy.

The order of measurement is by pass, then part of the campaign's time, then payload.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import pandas as pd

from casadical.core.basics import M_PER_MM, Array
from casadical.core.parts import GRAVITY_COLUMNS
from casadical.core.reporting.result import Shown
from casadical.core.statistics import TIE_TOLERANCE, first_of_best
from casadical.identification.pose_selection.candidates import (
    SOCKET_COLUMN,
    Candidates,
    Circumstances,
    expected,
    noise_covariance,
    prior_information,
    scaled_jacobian,
    timeline,
)
from casadical.identification.pose_selection.design_problem import DesignProblem, jacobian_of
from casadical.identification.pose_selection.experimental_design import inverse
from casadical.measurements.measurements import SESSION_PREFIX, Measurements
from casadical.robot.robot import Robot

# Number of parts of equal time into which a campaign is divided; poses that are planned for a
# certain time are reordered within their part only.
TIME_PARTS = 4


def travel_distances(robot: Robot, q: Array) -> Array:
    """Return the travel between each pair of n poses, shape (n, n) [rad].

    It is that of the joint that moves most; a full stroke of a prismatic joint counts as pi.

    q : joint variables, shape (n, joints) [rad or m]
    """
    unit = np.array([1.0 if j.kind == "revolute" else np.pi / (j.upper - j.lower) for j in robot.joints])
    return np.asarray(np.abs(unit * (q[:, None] - q[None])).max(axis=2))


def travel(robot: Robot, q: Array) -> float:
    """Return the sum, over successive poses, of the travel of the joint that moves most [rad].

    A full stroke of a prismatic joint counts as pi.

    q : joint variables, shape (n, joints) [rad or m]
    """
    D = travel_distances(robot, q)
    return float(D[np.arange(len(q) - 1), np.arange(1, len(q))].sum())


def short_tour(D: Array, before: Array | None = None) -> Array:
    """Return the indices of n poses in an order with a short path, shape (n,).

    It is the shortest of the nearest-neighbour paths from up to twelve starts of least `before`.

    D : distances between the poses, shape (n, n), in any unit
    before : distances from the pose before them, shape (n,); None: any start is as good
    """
    n = len(D)
    first = np.zeros(n) if before is None else before
    best: tuple[float, list[int]] | None = None
    for start in np.argsort(first, kind="stable")[:12]:
        path, away = [int(start)], D.copy()
        away[:, start] = np.inf
        while len(path) < n:
            path.append(first_of_best(-away[path[-1]]))
            away[:, path[-1]] = np.inf
        length = float(first[path[0]] + D[path[:-1], path[1:]].sum())
        if best is None or length < (1 - TIE_TOLERANCE) * best[0]:
            best = (length, path)
    assert best is not None
    return np.array(best[1])


def in_measuring_order(robot: Robot, chosen: Candidates, circumstances: Circumstances, *, travel: bool) -> Measurements:
    """Return the chosen poses as measurements by the model, in measuring order.

    The order is by pass, part of the campaign and payload. Columns that depend on the order, such
    as the time, are computed again.

    travel : whether poses of equal pass, part and payload are ordered for short travel
    """
    rows = {n: v.ravel() for n, v in chosen.conditions.items()}
    q = np.repeat(chosen.q, chosen.size, axis=0)
    parts = [np.tile(chosen.turn, len(chosen))]
    if "progress" in rows:
        parts.append(np.minimum(TIME_PARTS * rows["progress"], TIME_PARTS - 1).astype(int))
    if "payload_kg" in rows:
        parts.append(rows["payload_kg"])
    _, part = np.unique(np.stack(parts, axis=1), axis=0, return_inverse=True)
    part = part.ravel()
    order: list[int] = []
    for number in range(part.max() + 1):
        block = np.flatnonzero(part == number)
        if travel:
            D = travel_distances(robot, q[[*block, *order[-1:]]])
            size = len(block)
            block = block[short_tour(D[:size, :size], D[size, :size] if order else None)]
        order += block.tolist()
    # Columns of conditions that are chosen with a pose and do not depend on the order.
    pose_columns = ("payload_kg", SOCKET_COLUMN, *GRAVITY_COLUMNS)
    given = {n: v[order] for n, v in rows.items() if n in pose_columns or n.startswith(("approach", SESSION_PREFIX))}
    timed = [n for n in robot.conditions if n not in pose_columns and not n.startswith(("approach", SESSION_PREFIX))]
    if timed:
        given |= timeline(timed, np.arange(len(q)) / max(1, len(q) - 1), len(q), circumstances)
    return expected(robot, q[order], given, "plan")


@dataclass(frozen=True, eq=False, kw_only=True)
class Selection(DesignProblem, Shown):
    """Poses to measure in order, the input of the search that chose them, and expected accuracy.

    chosen : chosen poses with their circumstances
    m : one row per measurement in measuring order, at the positions that the model gives

    Examples
    --------
    >>> plan = casadical.select_poses(robot, None, 12, pool=200, restarts=1).ordered()
    >>> plan.q.shape, plan.expected_error(poses).shape
    ((12, 2), (40,))
    >>> print(f"{1e3 * plan.accuracy:.3f} mm to expect over the task")
    0.017 mm to expect over the task
    """

    line: ClassVar[str] = (
        " of {{ it.m | length }} poses of {{ it.robot.name | repr }}: {{ it.names | length }} parameters"
    )

    chosen: Candidates
    m: Measurements

    def __len__(self) -> int:
        return len(self.m)

    @property
    def q(self) -> Array:
        """Return the joint variables in measuring order, shape (n, joints) [rad or m]."""
        return self.m.q

    def ordered(self) -> Selection:
        """Return the selection; poses of equal pass, part and payload are in a short tour."""
        return replace(self, m=in_measuring_order(self.robot, self.chosen, self.circumstances, travel=True))

    @cached_property
    def _sets(self) -> tuple[Measurements, ...]:
        """Return the planned poses and, if there are any, the poses measured before."""
        return (self.m,) if self.measured is None else (self.m, self.measured)

    @cached_property
    def jacobian(self) -> Array:
        """Return the Jacobian of positions by p parameters, (n, 3, p) [mm per unit of scale].

        Poses measured before are at its end.
        """
        return np.concatenate([scaled_jacobian(self.robot, self.names, m) for m in self._sets])

    @cached_property
    def _covariance(self) -> Array:
        """Return the expected covariance of the p parameters in units of scale, (p, p).

        It is H (sum J'N J / s^4 + P) H, H = (sum J'J / s^2 + P)^-1, N each pose's noise covariance,
        s^2 their mean variance, P the prior's information; with an instrument, the inverse of the
        information of its readings, its unknown places included.
        """
        if self.instrument is not None:
            rows = self.instrument.rows(self.robot, self.names, self.m, self.noise)
            A = rows.reshape(-1, rows.shape[2])
            M = A.T @ A + self.instrument.before(A.shape[1], self.noise)
            M += prior_information(self.robot, self.names, self.prior, len(M))
            p, idle = len(self.names), np.flatnonzero(np.diag(M) == 0)  # sockets that no pose was chosen for
            M[idle, idle] = 1.0
            return inverse(M)[:p, :p]
        J = self.jacobian
        noise = np.concatenate([noise_covariance(self.robot, m, self.noise) for m in self._sets])
        s2, P = np.trace(noise.mean(axis=0)) / 3, prior_information(self.robot, self.names, self.prior)
        H = inverse(np.einsum("kip,kiq->pq", J, J) / s2 + P)
        return np.asarray(H @ (np.einsum("kip,kij,kjq->pq", J, noise, J, optimize=True) / s2**2 + P) @ H)

    @cached_property
    def scale(self) -> Array:
        """Return each parameter's scale, its unit in the solver, shape (p,) [SI]."""
        return np.array([self.robot.parameters[n].scale for n in self.names])

    @property
    def covariance(self) -> Array:
        """Return the expected covariance of the parameters, shape (p, p) [SI]."""
        return np.asarray(self._covariance * np.outer(self.scale, self.scale))

    @property
    def standard_errors(self) -> Array:
        """Return the expected standard errors of the parameters, shape (p,) [SI]."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def expected_error(self, m: Measurements | None = None) -> Array:
        """Return the expected rms position error of the calibrated robot at n poses, (n,) [m].

        It is that due to noise of the calibration. Where the places of an instrument are not
        measured, the base is assumed to be fitted again at these poses.

        m : the poses; None: the task
        """
        J = jacobian_of(self.robot, self.names, self.task if m is None else m, self.instrument)
        return np.asarray(M_PER_MM * np.sqrt(np.einsum("kip,pq,kiq->k", J, self._covariance, J, optimize=True)))

    @cached_property
    def accuracy(self) -> float:
        """Return the expected position error of the calibrated robot, rms over the task [m]."""
        return float(np.sqrt(np.mean(self.expected_error() ** 2)))

    @cached_property
    def reading_error(self) -> float | None:
        """Return the expected rms distance of measured from predicted points over the task [m].

        It includes the measurement's noise. It is None for wires and sockets.
        """
        if self.instrument is not None:
            return None
        noise = M_PER_MM**2 * np.trace(noise_covariance(self.robot, self.task, self.noise), axis1=1, axis2=2).mean()
        return float(np.sqrt(self.accuracy**2 + noise))

    @property
    def parameters(self) -> pd.DataFrame:
        """Return a table of expected standard errors in readable units, a row per parameter.

        Parameters that would not be identified are listed with NaN and the reason.
        """
        rows = [
            (name, p.group, p.readable(error), p.readable_unit, "")
            for name, error in zip(self.names, self.standard_errors, strict=True)
            for p in (self.robot.parameters[name],)
        ]
        given = self.robot.parameters
        rows += [(name, given[name].group, np.nan, "", why) for name, why in self.unidentifiable.items()]
        return pd.DataFrame(rows, columns=["name", "group", "expected_std_error", "unit", "not_identifiable"])

    @property
    def error_map(self) -> pd.DataFrame:
        """Return the expected error [mm] at every pose of the task, with position and readings.

        Positions are in the measuring frame [mm], readings are the controller's.
        """
        assert self.task.position is not None
        table = pd.DataFrame(1e3 * self.task.position, columns=["x_mm", "y_mm", "z_mm"])
        table["expected_error_mm"] = 1e3 * self.expected_error()
        return pd.concat([table, readings_table(self.robot, self.task.q)], axis=1)

    @property
    def table(self) -> pd.DataFrame:
        """Return the measuring plan as a table with one row per measurement.

        It has the row's number, payload, approach, the instrument's columns, readings (q1_deg,
        ...) and the model's position in the measuring frame. The columns nominal_x_mm ... help to
        find the reflector; they are not measurements.
        """
        assert self.m.position is not None
        table = pd.DataFrame({"pose": np.arange(1, len(self.m) + 1)})
        for name, values in self.m.conditions.items():
            if name == "payload_kg" or name.startswith("approach"):
                table[name] = values if name == "payload_kg" else values.astype(int)
        nominal = pd.DataFrame(1e3 * self.m.position, columns=[f"nominal_{c}_mm" for c in "xyz"])
        if self.instrument is not None:
            table = pd.concat([table, self.instrument.table(self.m)], axis=1)
        return pd.concat([table, readings_table(self.robot, self.m.q), nominal.round(3)], axis=1)


def readings_table(robot: Robot, q: Array) -> pd.DataFrame:
    """Return the controller's readings as a table, q1_deg, q2_mm, ..., rounded to 1e-6 deg or mm.

    q : variables of the rows, shape (n, joints) [rad or m]
    """
    columns = robot.reading_units
    return pd.DataFrame(np.round(robot.readings_of(q) / list(columns.values()), 6), columns=list(columns))
