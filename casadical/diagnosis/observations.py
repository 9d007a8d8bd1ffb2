"""The linear problem of any kinds of measurement, several sets together: by each kind's own residual.

Every pose has as many rows as the kind with the most numbers has; rows that were not measured are zero. Rows are in
units in which the noise of all sets is alike, that of a length of the first set: an angle of a full pose is multiplied
by the ratio of the two sigmas, a set's lengths by the ratio of the sets'. An unknown point, which poses share, is three
more parameters of the base model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from casadical.core.arrays import Array
from casadical.core.casadi_buffers import call
from casadical.diagnosis.linearisation import BLOCK, Linearisation
from casadical.diagnosis.seams import observed_at_seams, seams_of
from casadical.effects.distance_faults import FAR, FLAGS, WIRES
from casadical.identification.identification import Identification
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.model import constants_of
from casadical.robot.robot import Robot

# One sigma of an unknown point about where the base fit has it [m]: wide beside what a cause moves it.
POINT_WIDTH = 0.1


@dataclass(frozen=True)
class Ratios:
    """Sigmas of a length [m] and of an angle [rad] of every set, of which their ratios count."""

    sigmas: tuple[tuple[float, float], ...]

    def of_set(self, k: int) -> tuple[float, float]:
        """What makes a set's lengths and angles lengths of the first set, as noisy as those."""
        length, angle = self.sigmas[k]
        return self.sigmas[0][0] / length, self.sigmas[0][0] / angle


@dataclass(frozen=True, eq=False)
class Observations:
    """What sets of measurements tell, at the base model calibrated on them.

    m : all poses as one table; sets : as given, with the conditions of m; ratios : of their noise
    r : measured less modelled, shape (n, numbers); linear : its derivatives
    U : by the unknown points in units of what is known of them, shape (n, numbers, points), and mean, shape (points,)
    measured, size, alike : see `Evidence`; apart : number of what each pose was measured to, for repeats, shape (n,)
    Jq : by the joint variables, as the joints' repeatability acts, shape (n, numbers, joints)
    """

    m: Measurements
    sets: tuple[Measurements, ...]
    ratios: Ratios
    r: Array
    linear: Linearisation
    U: Array
    mean: Array
    measured: Array
    size: Array
    alike: Array | None
    apart: Array
    Jq: Array


def joined(sets: Sequence[Measurements], robot: Robot) -> Measurements:
    """All poses as one table, of those columns that every set has; what the robot's model needs is as declared else.

    Its positions are not those of a measurement, unless it is one set.
    """
    if len(sets) == 1:
        return sets[0]
    declared = dict(zip(robot.conditions, robot.declared, strict=True))
    names = [n for n in sets[0].conditions if all(n in m.conditions for m in sets)]
    names += [n for n in declared if n not in names]
    conditions = {
        n: np.concatenate([m.conditions.get(n, np.full(len(m), declared.get(n, 0.0))) for m in sets]) for n in names
    }
    q = np.concatenate([m.q for m in sets])
    row = np.concatenate([m.row for m in sets])
    copies = tuple(c for m in sets for c in m.copies)
    return Measurements(
        q=q,
        kind="position",
        position=np.zeros((len(q), 3)),
        conditions=conditions,
        row=row,
        source=", ".join(m.source for m in sets),
        copies=copies,
    )


def with_far_ends(m: Measurements, sets: Sequence[Measurements], where: Mapping[str, Array]) -> Measurements:
    """The table of all sets with columns of the instruments that read distances, where there are some.

    far_x_m .. : the known far end, or where the base fit has it (see `Identification.unknown_points`); wire1 .. : 1
    where the first such instrument read, else 0. Far ends of one table are those of one instrument each, up to WIRES.
    """
    far, wire, count = np.zeros((len(m), 3)), np.zeros(len(m), dtype=np.int64), 0
    for k, (part, at) in enumerate(zip(sets, edges_of(sets), strict=True)):
        if part.distance is None or part.other is not None:
            continue
        names = [f"{k}/{name}" for name in find_kind(part.kind).point_names(part.arrays)]
        far[at] = part.target if part.target is not None else np.array([where[name] for name in names])
        _, which = np.unique(far[at], axis=0, return_inverse=True)
        wire[at] = 1 + count + which.ravel()
        count = int(wire[at].max())
    if not 0 < count <= WIRES:
        return m
    columns = {f: (wire == k).astype(float) for k, f in enumerate(FLAGS, 1)}
    columns |= dict(zip(FAR, far.T, strict=True))
    return replace(m, conditions={**m.conditions, **columns})


def edges_of(sets: Sequence[Measurements]) -> list[slice]:
    """Where each set stands in the table of all."""
    ends = np.cumsum([0, *(len(m) for m in sets)]).tolist()
    return [slice(a, b) for a, b in pairwise(ends)]


def separated(sets: Sequence[Measurements], m: Measurements) -> tuple[Measurements, ...]:
    """The sets with the conditions of the table of all."""
    return tuple(
        replace(part, conditions={name: values[at] for name, values in m.conditions.items()})
        for part, at in zip(sets, edges_of(sets), strict=True)
    )


def observe(
    identification: Identification, m: Measurements, sets: Sequence[Measurements], values: Array, ratios: Ratios
) -> Observations:
    """The sets at the base model's values, shape (P,) [SI]; m : of `joined`, with every condition that is needed."""
    robot = identification.given
    sets = separated(sets, m)
    where = identification.unknown_points
    numbers = max(find_kind(part.kind).numbers for part in sets)
    found = [_of_set(robot, part, k, values, where, ratios, numbers) for k, part in enumerate(sets)]
    ends = max(part.ends for part in found)
    S = np.concatenate([part.widened(ends) for part in found])
    far: tuple[Array, Array] | None = None
    if ends > 1:
        far = np.concatenate([part.q[-1] for part in found]), np.concatenate([part.seen[-1] for part in found])
    linear = Linearisation(
        robot,
        seams_of(robot),
        values,
        m.q,
        dict(m.conditions),
        np.concatenate([part.J for part in found]),
        S,
        np.concatenate([part.seen[0] for part in found]),
        constants_of(robot, robot.torque_scale),
        far,
    )
    arms = S.reshape(*S.shape[:2], ends, -1)[:, :, :, : robot.n]
    Jq = arms[:, :, 0] if ends == 1 else np.sqrt((arms**2).sum(axis=2))
    U = np.zeros((*S.shape[:2], 3 * len(where)))
    point, offset = np.full(len(m), -1), 0
    for part in found:
        for i, k in enumerate(part.point):
            if k >= 0:
                U[offset + i, :, 3 * k : 3 * k + 3] = part.U[i]
        point[offset : offset + len(part.point)] = part.point
        offset += len(part.point)
    root, mean = _known_points(identification, where)
    apart = [np.full(len(part), k) for k, part in enumerate(sets)]
    _, number = np.unique(
        np.column_stack([np.concatenate(apart), point, _other_ends(sets)]), axis=0, return_inverse=True
    )
    return Observations(
        m=m,
        sets=sets,
        ratios=ratios,
        r=np.concatenate([part.r for part in found]),
        linear=linear,
        U=U @ root,
        mean=mean,
        measured=np.concatenate([part.measured for part in found]),
        size=np.concatenate([part.size for part in found]),
        # What has no unknown point is spread over folds as if each pose were alone.
        alike=np.where(point < 0, len(where), point) if len(where) else None,
        apart=number.ravel(),
        Jq=Jq,
    )


@dataclass(frozen=True, eq=False)
class _OfSet:
    """One set: rows with zeros where it has fewer numbers than others; of q and seen, one for each end."""

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

    def widened(self, ends: int) -> Array:
        """S with seams of further ends, which do nothing."""
        more = np.zeros((*self.S.shape[:2], self.S.shape[2] // self.ends * (ends - self.ends)))
        return np.concatenate([self.S, more], axis=2)


def _of_set(
    robot: Robot,
    m: Measurements,
    k: int,
    values: Array,
    where: Mapping[str, Array],
    ratios: Ratios,
    numbers: int,
) -> _OfSet:
    kind, n = find_kind(m.kind), len(m)
    names = [f"{k}/{name}" for name in kind.point_names(m.arrays)]
    number = {name: i for i, name in enumerate(where)}
    at = observed_at_seams(robot, kind, bool(names))
    arrays = {**m.arrays, "point": np.array([where[name] for name in names])}
    data = np.concatenate([np.asarray(arrays[name], dtype=float).reshape(n, -1) for name in at.data], axis=1)
    w, constants = m.condition_matrix(robot.conditions, robot.declared), constants_of(robot, robot.torque_scale)
    parts: list[list[Array]] = [[] for _ in range(6)]
    for first in range(0, n, BLOCK):
        some = slice(first, first + BLOCK)
        found = call(at.mapped(len(m.q[some])), m.q[some].T, w[some].T, values, constants, data[some].T)
        for part, value in zip(parts, found, strict=True):
            here = len(m.q[some])
            part.append(value.reshape(value.shape[0], here, value.shape[1] // here).transpose(1, 0, 2))
    r, J, S, U, seen, q = (np.concatenate(part) for part in parts)
    length, angle = ratios.of_set(k)
    scale = np.concatenate([np.full(kind.lengths, length), np.full(kind.angles, angle)])
    rows = scale * np.sqrt(m.weight)[:, None]
    out = [(0, 0), (0, numbers - kind.numbers)]
    size = np.concatenate([np.full(kind.lengths, 1 / length), np.zeros(kind.angles)])
    return _OfSet(
        r=np.pad(-r[:, :, 0] * rows, out),
        J=np.pad(J * rows[:, :, None], [*out, (0, 0)]),
        S=np.pad(S * rows[:, :, None], [*out, (0, 0)]),
        U=np.pad(U * rows[:, :, None], [*out, (0, 0)]),
        seen=tuple(seen[:, :, i] for i in (0, at.ends - 1)),
        q=tuple(q[:, :, i] for i in (0, at.ends - 1)),
        measured=np.pad(np.broadcast_to((m.weight > 0)[:, None], (n, kind.numbers)), out),
        size=np.pad(np.broadcast_to(size, (n, kind.numbers)), out),
        point=np.array([number[name] for name in names] or [-1] * n),
        ends=at.ends,
    )


def _known_points(identification: Identification, where: Mapping[str, Array]) -> tuple[Array, Array]:
    """Root of the covariance of what is known of the points beside the poses, and its mean in these units.

    They lie near where the base fit has them, and known distances are between some.
    """
    number, p = {name: i for i, name in enumerate(where)}, np.array([*where.values()]).reshape(-1, 3)
    precision, right = np.eye(p.size) / POINT_WIDTH**2, np.zeros(p.size)
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
    # Of the inverse L^-T L^-1 the root is L^-T.
    return np.linalg.inv(L).T, np.linalg.solve(L, right)


def _other_ends(sets: Sequence[Measurements]) -> Array:
    """What else each pose was measured to, as numbers, shape (n, k): a known point, or readings at the other end."""
    width = max((3 if m.target is not None else 0) + (m.other.shape[1] if m.other is not None else 0) for m in sets)
    found = []
    for m in sets:
        own = [np.zeros((len(m), 0)), *(a for a in (m.target, m.other) if a is not None)]
        own_ends = np.round(np.concatenate(own, axis=1), 4)
        found.append(np.pad(own_ends, [(0, 0), (0, width - own_ends.shape[1])]))
    return np.concatenate(found)
