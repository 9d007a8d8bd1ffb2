"""Residuals and Jacobians of measurement sets of any kind, by each kind's own residual.

All rows that were read at one stop of the robot (see `Stops`) form one pose with all their numbers:
they share the joint repeatability error, as the coordinates of a position do, but not the
instruments' noise. Arrays have as many numbers a pose as the pose with the most; numbers that were
not measured are zero. They are scaled so that the noise of all sets is equal to that of a length of
the first set: an angle of a full pose is multiplied by the ratio of the two sigmas, a set's lengths
by the ratio of the sets' sigmas. An unknown point, which poses share, is three more parameters of
the base model.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from casadical.core.basics import Array
from casadical.diagnosis.linearisation import POINT_VARIABLES, READING_MARK, Linearisation, condition_of_reading
from casadical.diagnosis.seams import observed_at_seams, over_poses, seams_of
from casadical.identification.result import Identification
from casadical.measurements.kinds.position import Position
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements, same_readings
from casadical.robot.model import constants_of
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Stops:
    """Assignment of the rows of all measurement sets to the stops at which they were read.

    A stop is a pose at which the robot stood while one or more rows were measured; rows are those
    of the concatenated table of all sets.
    of : index of each row's stop, shape (rows,)
    turn : number of rows of the same stop before each row, shape (rows,)
    rows : index of the first row of each stop, shape (stops,)
    """

    of: Array
    turn: Array
    rows: Array

    @property
    def most(self) -> int:
        """Return the largest number of rows at one stop."""
        return int(self.turn.max()) + 1

    def indices_among(self, mask: Array) -> Array:
        """Return, for each row at a selected stop, the stop's index among the selected, shape (k,).

        mask : selected stops, shape (stops,)
        """
        return np.asarray((np.cumsum(mask) - 1)[self.of[mask[self.of]]])


# Noise standard deviations of a length [m] and of an angle [rad] of every set. Only their ratios
# matter.
Sigmas = tuple[tuple[float, float], ...]


def scales_of(sigmas: Sigmas, k: int) -> tuple[float, float]:
    """Return the factors that scale the lengths and the angles of set k to equal noise.

    The scaled noise is that of a length of the first set; units are 1 and m/rad.
    """
    length, angle = sigmas[k]
    return sigmas[0][0] / length, sigmas[0][0] / angle


@dataclass(frozen=True, eq=False)
class Observations:
    """Residuals and Jacobians of measurement sets at the base model that was calibrated on them.

    m : all n poses as one table; sets : the measurement sets, with the conditions of m
    sigmas : noise of the sets by which r and all Jacobians are scaled
    layout : positions of the sets' rows among the numbers of the poses
    r : measured minus modelled numbers, shape (n, numbers) [m, angles scaled to m]
    linear : derivatives of the modelled numbers
    U : Jacobian by the unknown points in units of their prior, shape (n, numbers, 3 points)
    mean : prior mean of these points minus their estimate, in the same units, shape (3 points,)
    measured : mask of the numbers that were measured, shape (n, numbers)
    size : factors from r to the reported error, zero for angles, shape (n, numbers)
    alike : index of the unknown points at which each pose was measured, equal for equal points,
        shape (n,); None without such points
    apart : index of the targets of each pose, for the comparison of repeated poses, shape (n,)
    Jq : Jacobian by the joint variables, for joint repeatability, shape (n, numbers, joints)
    """

    m: Measurements
    sets: tuple[Measurements, ...]
    sigmas: Sigmas
    layout: Layout
    r: Array
    linear: Linearisation
    U: Array
    mean: Array
    measured: Array
    size: Array
    alike: Array | None
    apart: Array
    Jq: Array

    @property
    def plain(self) -> bool:
        """Return whether there is a single set, and its kind of measurement is positions."""
        return len(self.sets) == 1 and self.sets[0].kind == Position.name

    @property
    def stops(self) -> Stops:
        """Return the assignment of the sets' rows to stops; the stops are the n poses."""
        return self.layout.stops


def combined_table(sets: Sequence[Measurements], robot: Robot, stops: Stops) -> Measurements:
    """Return one table with a row for each stop and the logged columns that every set has.

    A single set keeps all that it has. Of several, conditions that the robot's model needs take the
    declared value where a set lacks them, and the positions are zeros, not measurements.
    """
    if len(sets) == 1:
        return sets[0] if len(stops.rows) == len(sets[0]) else sets[0][stops.rows]
    declared = dict(zip(robot.conditions, robot.declared, strict=True))
    names = [n for n in sets[0].conditions if all(n in m.conditions for m in sets)]
    names += [n for n in declared if n not in names]
    conditions = {
        n: np.concatenate([m.conditions.get(n, np.full(len(m), declared.get(n, 0.0))) for m in sets]) for n in names
    }
    q, row = (np.concatenate([getattr(m, name) for m in sets]) for name in ("q", "row"))
    source, copies = ", ".join(dict.fromkeys(m.source for m in sets)), tuple(c for m in sets for c in m.copies)
    whole = Measurements(
        q, "position", position=np.zeros((len(q), 3)), conditions=conditions, row=row, source=source, copies=copies
    )
    return whole[stops.rows]


def stops_in(sets: Sequence[Measurements]) -> Stops:
    """Return the stops at which the rows of the sets were read, in the order of their first rows.

    Rows at equal joint variables and circumstances belong to one stop, unless a row at others lies
    between them by the logged time, else by the logged pose number. Two measurements of the same
    target are two stops, and so is each distance between two poses; in a single set with one target
    each row is a stop of its own.
    """
    points = [m.label if m.label is not None else np.full(len(m), "") for m in sets]
    measured_to = _target_indices(sets, np.unique(np.concatenate(points).astype(str), return_inverse=True)[1])
    n = len(measured_to)
    if len(sets) == 1 and sets[0].other is None and len(np.unique(measured_to)) == 1:
        return Stops(np.arange(n), np.zeros(n, dtype=np.int64), np.arange(n))
    shared = [c for c in sets[0].conditions if all(c in m.conditions for m in sets)]
    logged = {c: np.concatenate([m.conditions[c] for m in sets]) for c in shared}
    q = np.concatenate([m.q for m in sets])
    # These logged columns belong to the stop and not to a single reading.
    own = (values for c, values in logged.items() if re.fullmatch(r"payload_kg|approach\d+|(tool|session)_.*", c))
    key = _distinct_indices(np.column_stack([same_readings(q), *own]))
    clock = next((logged[c] for c in ("time_s", "pose") if c in logged), None)
    if clock is not None:
        order = np.lexsort((key, clock))
        runs = np.empty(n, dtype=np.int64)
        runs[order] = np.cumsum(np.diff(key[order], prepend=key[order[0]]) != 0)
        key = runs
    alone = np.concatenate([np.full(len(m), m.other is not None) for m in sets])
    again = _equal_rows_before(np.column_stack([key, measured_to]))
    again[alone] = 1 + n + np.flatnonzero(alone)
    _, first, stop = np.unique(np.column_stack([key, again]), axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    of = rank[stop.ravel()]
    return Stops(of, _equal_rows_before(of[:, None]), np.sort(first))


def row_slices(sets: Sequence[Measurements]) -> list[slice]:
    """Return, for each set, the slice of its rows in the concatenated table of all sets."""
    ends = np.cumsum([0, *(len(m) for m in sets)]).tolist()
    return [slice(a, b) for a, b in pairwise(ends)]


def with_combined_conditions(sets: Sequence[Measurements], m: Measurements, stops: Stops) -> tuple[Measurements, ...]:
    """Return copies of the sets whose conditions are those of the combined table m at their stops.

    An additional reading at a stop has a condition of its own where m has one (see
    `condition_of_reading`).
    """
    own = [name for name in m.conditions if READING_MARK not in name]
    columns = {name: m.conditions[name][stops.of] for name in own}
    for name in own:
        for turn in range(1, stops.most):
            at = np.flatnonzero(stops.turn == turn)
            if (further := condition_of_reading(name, turn)) in m.conditions:
                columns[name][at] = m.conditions[further][stops.of[at]]
    return tuple(
        replace(part, conditions={name: values[at] for name, values in columns.items()})
        for part, at in zip(sets, row_slices(sets), strict=True)
    )


@dataclass(frozen=True, eq=False)
class Layout:
    """Positions of the sets' rows in an array of poses by numbers.

    stops : assignment of the rows to poses
    rows : slice of each set's rows in the concatenated table of all sets
    poses : for each set the index of the pose of each row, shape (rows, 1)
    places : for each set the second indices of each row's numbers, shape (rows, numbers)
    """

    stops: Stops
    rows: list[slice]
    poses: list[Array]
    places: list[Array]

    @property
    def alone(self) -> bool:
        """Return whether there is a single set, and its rows in order are the poses."""
        return len(self.rows) == 1 and np.array_equal(self.stops.of, np.arange(len(self.stops.rows)))

    @property
    def shape(self) -> tuple[int, int]:
        """Return the number of poses and the largest number of measured numbers at one pose."""
        return len(self.stops.rows), max(int(places.max()) + 1 for places in self.places)

    def together(self, parts: Sequence[Array]) -> Array:
        """Return one array with the sets' numbers by pose, shape (poses, numbers, ...).

        Numbers that were not measured are zero.
        parts : array of each set, shape (rows, numbers, ...)
        """
        if self.alone:
            return parts[0]
        out = np.zeros((*self.shape, *parts[0].shape[2:]))
        for poses, places, part in zip(self.poses, self.places, parts, strict=True):
            out[poses, places] = part
        return out


def observe(
    identification: Identification,
    m: Measurements,
    sets: Sequence[Measurements],
    values: Array,
    sigmas: Sigmas,
    stops: Stops,
) -> Observations:
    """Return residuals and Jacobians of the sets at given parameters of the base model.

    m : table of `combined_table` with every condition that the effects need
    values : parameters of the base model, shape (P,) [SI]
    sigmas : noise of the sets, for scaling; stops : see `stops_in`
    """
    robot, where = identification.given, identification.unknown_points
    sets = with_combined_conditions(sets, m, stops)
    parts = [_observe_set(robot, part, k, values, where, sigmas) for k, part in enumerate(sets)]
    rows, numbers = row_slices(sets), [find_kind(m.kind).numbers for m in sets]
    counts = np.repeat(numbers, [len(m) for m in sets])
    order, first = np.lexsort((stops.turn, stops.of)), np.zeros(len(counts), dtype=np.int64)
    # The count of numbers of all rows before each, in the order of the stops.
    before = np.cumsum(counts[order]) - counts[order]
    first[order] = before - before[np.searchsorted(stops.of[order], stops.of[order])]
    own = [first[at, None] + np.arange(k) for at, k in zip(rows, numbers, strict=True)]
    layout = Layout(stops, rows, [stops.of[at, None] for at in rows], own)
    ends = max(part.ends for part in parts)
    S = _seam_jacobian(parts, layout, ends)
    seen, q = (np.concatenate([np.asarray(getattr(part, name)) for part in parts], axis=1) for name in ("seen", "q"))
    J, constants = layout.together([part.J for part in parts]), constants_of(robot, robot.torque_scale)
    far = (q[1, stops.rows], seen[1, stops.rows]) if ends > 1 else None
    linear = Linearisation(
        robot,
        seams_of(robot),
        values,
        m.q,
        dict(m.conditions),
        J,
        S,
        seen[0, stops.rows],
        constants,
        far,
        stops.most - 1,
    )
    U = np.zeros((*layout.shape, 3 * len(where)))
    for part, poses, places in zip(parts, layout.poses, layout.places, strict=True):
        for i in np.flatnonzero(part.point >= 0):
            k = 3 * part.point[i]
            U[poses[i], places[i], k : k + 3] = part.U[i]
    root, mean = _point_prior(identification, where)
    return Observations(
        m=m,
        sets=sets,
        sigmas=sigmas,
        layout=layout,
        r=layout.together([part.r for part in parts]),
        linear=linear,
        U=U @ root,
        mean=mean,
        measured=layout.together([part.measured for part in parts]) > 0,
        size=layout.together([part.size for part in parts]),
        alike=_distinct_indices(_by_stop(stops, np.concatenate([part.point for part in parts])))
        if len(where)
        else None,
        apart=_distinct_indices(_by_stop(stops, _target_indices(sets, np.concatenate([part.point for part in parts])))),
        Jq=_joint_jacobian(S, ends, parts[0].S.shape[2] // parts[0].ends, robot.n),
    )


def _seam_jacobian(parts: Sequence[_SetObservations], layout: Layout, ends: int) -> Array:
    """Return the Jacobian by all variables where effects enter (seams), (poses, numbers, seams).

    An instrument's effect on its own reading leaves the other readings at the stop unchanged: each
    additional reading has its own variables of the measured point, after all other seam variables.
    ends : largest number of poses that a measurement involves, one or two
    """
    stops, seams = layout.stops, parts[0].S.shape[2] // parts[0].ends
    if layout.alone:
        return parts[0].S
    S = np.zeros((*layout.shape, ends * seams + POINT_VARIABLES * (stops.most - 1)))
    for part, at, poses, places in zip(parts, layout.rows, layout.poses, layout.places, strict=True):
        S[poses, places, : part.S.shape[2]] = part.S
        for turn in range(1, stops.most):
            own = np.flatnonzero(stops.turn[at] == turn)
            to = ends * seams + POINT_VARIABLES * (turn - 1)
            S[poses[own], places[own], to : to + POINT_VARIABLES] = part.S[own, :, seams - POINT_VARIABLES : seams]
            S[poses[own], places[own], seams - POINT_VARIABLES : seams] = 0.0
    return S


def _joint_jacobian(S: Array, ends: int, seams: int, joints: int) -> Array:
    """Return the Jacobian by the joints' repeatability errors, shape (poses, numbers, joints).

    Those at the two ends of a distance between poses are independent, so that its row is the root
    of the sum of squares over both ends.
    S : Jacobian by all seam variables; ends : number of ends; seams : seam variables of one end
    """
    arms = S[:, :, : ends * seams].reshape(*S.shape[:2], ends, seams)[:, :, :, :joints]
    return np.asarray(arms[:, :, 0] if ends == 1 else np.sqrt((arms**2).sum(axis=2)))


def _by_stop(stops: Stops, numbers: Array) -> Array:
    """Return an integer of each row arranged by stop, shape (stops, turns); -1 where no row is.

    numbers : the integers, shape (rows,); turns : largest number of rows at one stop
    """
    out = np.full((len(stops.rows), stops.most), -1)
    out[stops.of, stops.turn] = numbers
    return out


def _distinct_indices(keys: Array) -> Array:
    """Return the index of each row of `keys` among its sorted distinct rows, shape (n,)."""
    return np.asarray(np.unique(keys, axis=0, return_inverse=True)[1].ravel())


def _equal_rows_before(keys: Array) -> Array:
    """Return the number of earlier rows of `keys` that are equal to each row, shape (n,)."""
    number = _distinct_indices(keys)
    order = np.argsort(number, kind="stable")
    places = np.empty(len(number), dtype=np.int64)
    places[order] = np.arange(len(number)) - np.searchsorted(number[order], number[order])
    return places


class _SetObservations(NamedTuple):
    """Residuals and Jacobians of one measurement set, scaled to equal noise of all sets.

    r : measured minus modelled numbers, times the root of a row's weight, shape (rows, numbers)
    J, S, U : Jacobians of the modelled numbers, scaled alike, by base parameters, seam variables of
        all ends and unknown point, shapes (rows, numbers, P or seams or 3); U: 0 without a point
    seen : at each end, the quantities that effects depend on, shape (rows, quantities)
    q : at each end, the joint variables, shape (rows, joints) [rad or m]
    measured : mask of the numbers of rows with positive weight, shape (rows, numbers)
    size : factors from scaled to own lengths [m], zero for angles, shape (rows, numbers)
    point : index of each row's unknown point, -1 without one, shape (rows,)
    ends : number of poses that a measurement involves, one or two
    """

    r: Array
    J: Array
    S: Array
    U: Array
    seen: tuple[Array, ...]
    q: tuple[Array, ...]
    measured: Array
    size: Array
    point: Array
    ends: int


def _observe_set(
    robot: Robot, m: Measurements, k: int, values: Array, where: Mapping[str, Array], sigmas: Sigmas
) -> _SetObservations:
    """Return residuals and Jacobians of set m, of index k, scaled to equal noise of all sets.

    values : parameters of the base model, shape (P,) [SI]
    where : estimate of each unknown point in the measuring frame, by name, shape (3,) [m]
    """
    kind, n = find_kind(m.kind), len(m)
    names = [f"{k}/{name}" for name in kind.point_names(m.arrays)]
    number = {name: i for i, name in enumerate(where)}
    function, observed = observed_at_seams(robot, kind, bool(names))
    arrays = {**m.arrays, "point": np.array([where[name] for name in names])}
    data = np.concatenate([np.asarray(arrays[name], dtype=float).reshape(n, -1) for name in observed], axis=1)
    w, constants = m.condition_matrix(robot.conditions, robot.declared), constants_of(robot, robot.torque_scale)
    r, J, S, U, seen, q = over_poses(function, m.q, w, (values, constants), data)
    length, angle = scales_of(sigmas, k)
    scale = np.repeat([length, angle], [kind.lengths, kind.angles])
    rows, size = scale * np.sqrt(m.weight)[:, None], np.repeat([1 / length, 0.0], [kind.lengths, kind.angles])
    for each in (J, S, U):
        each *= rows[:, :, None]
    there, sizes = (np.broadcast_to(a, (n, kind.numbers)) for a in ((m.weight > 0)[:, None], size))
    points = np.array([number[name] for name in names] or [-1] * n)
    seen_at, q_at = ((a[:, :, 0], a[:, :, -1]) for a in (seen, q))
    return _SetObservations(-r[:, :, 0] * rows, J, S, U, seen_at, q_at, there, sizes, points, q.shape[2])


def _point_prior(identification: Identification, where: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return a root of the unknown points' prior covariance [m], and the prior mean in its units.

    Shapes are (3 points, 3 points) and (3 points,); the mean is relative to the estimates of the
    base fit, at which the prior is centred. Given distances between points narrow and move it.
    where : estimate of each point in the measuring frame, by name, shape (3,) [m]
    """
    number, p = {name: i for i, name in enumerate(where)}, np.array([*where.values()]).reshape(-1, 3)
    # The prior standard deviation of an unknown point about its estimate is 0.1 m: wide compared
    # with the displacements that causes produce.
    precision, right = np.eye(p.size) / 0.1**2, np.zeros(p.size)
    for k, m in enumerate(identification.measurements):
        for first, second, length in m.separations:
            i, j = number[f"{k}/{first}"], number[f"{k}/{second}"]
            line = p[i] - p[j]
            apart = float(np.linalg.norm(line))
            g = np.zeros((len(p), 3))
            g[i], g[j] = line / apart, -line / apart
            precision += np.outer(g, g) / m.separation_sigma**2
            right += g.ravel() * (length - apart) / m.separation_sigma**2
    L = np.linalg.cholesky(precision)
    # The covariance is the inverse L^-T L^-1 of the precision, so that its root is L^-T.
    return np.linalg.inv(L).T, np.linalg.solve(L, right)


def _target_indices(sets: Sequence[Measurements], point: Array) -> Array:
    """Return the index of each row's target, shape (rows,).

    Targets differ by set, unknown point, given target and other pose.
    point : index of each row's unknown point, shape (rows,)
    """
    number = np.concatenate([np.full(len(m), k) for k, m in enumerate(sets)])
    width = max((3 if m.target is not None else 0) + (m.other.shape[1] if m.other is not None else 0) for m in sets)
    far_ends = []
    for m in sets:
        own = [np.zeros((len(m), 0)), *(a for a in (m.target, m.other) if a is not None)]
        own_ends = np.round(np.concatenate(own, axis=1), 4)
        far_ends.append(np.pad(own_ends, [(0, 0), (0, width - own_ends.shape[1])]))
    return _distinct_indices(np.column_stack([number, point, np.concatenate(far_ends)]))
