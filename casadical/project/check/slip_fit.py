"""A fast fit of many hypotheses on one table: rows of plain numpy, base and tool by linear least squares.

p(q) = M y + c - R(q) t with flange position p, orientation R, measured y: linear in M (9 numbers), c and t (3 each). M
is a rotation where nothing is wrong with the positions; its columns show wrong units, its determinant a left-handed
frame. So only what is wrong with readings and rows must be searched for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from casadical.core.arrays import Array
from casadical.core.parts import Joint
from casadical.identification.placement import solve_placement

# Of each hypothesis the best rows count: a few gross errors are no slip.
COUNTED = 0.75
# So many poses distinguish hypotheses.
SCORED = 40


@dataclass(frozen=True)
class Hypothesis:
    """What the readings and rows of the robot are, if they are not what they seem.

    reading i = sign * factor * column[source] + zero + add * (column i - 1); shift : rows that the readings lie before
    rows : index of the DH rows that are meant; lengths : (name, joint, departure [m]) of wrong link lengths
    """

    source: tuple[int, ...]
    sign: tuple[int, ...]
    factor: tuple[float, ...]
    zero: tuple[float, ...]
    add: tuple[int, ...]
    shift: int = 0
    rows: int = 0
    lengths: tuple[tuple[str, int, float], ...] = ()

    @staticmethod
    def none(n: int) -> Hypothesis:
        """Nothing is wrong."""
        return Hypothesis(tuple(range(n)), (1,) * n, (1.0,) * n, (0.0,) * n, (0,) * n)

    @property
    def slips(self) -> int:
        """How many things are wrong; two columns that are swapped are one, as are all joints in another unit."""
        factors = [f for f in self.factor if f != 1.0]
        units = 1 if len(factors) > 2 and len(set(factors)) == 1 else len(factors)
        moved = sum(s != k for k, s in enumerate(self.source))
        return (
            (moved + 1) // 2 + sum(s < 0 for s in self.sign) + units + sum(z != 0 for z in self.zero)
            + sum(a != 0 for a in self.add) + (self.shift != 0) + (self.rows != 0) + len(self.lengths)
        )  # fmt: skip

    def at(self, what: str, i: int, value: float) -> Hypothesis:
        """With another entry of one joint."""
        entries = list(getattr(self, what))
        entries[i] = value
        return replace(self, **{what: tuple(entries)})  # type: ignore[arg-type]

    def readings(self, q: Array) -> Array:
        """Readings as meant, shape (n, joints); q : as they stand in the table."""
        found = q[:, list(self.source)] * np.array(self.sign) * np.array(self.factor) + np.array(self.zero)
        found[:, 1:] += np.array(self.add[1:]) * q[:, :-1]
        return np.asarray(found)


@dataclass(frozen=True, eq=False)
class Fit:
    """Of one hypothesis: median error with base and tool placed [m], factors of x, y, z, whether y is mirrored."""

    hypothesis: Hypothesis
    error: float
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    mirrored: bool = False

    @property
    def slips(self) -> int:
        """How many things are wrong, those of the positions included."""
        scaled = [s for s in self.scale if s != 1.0]
        units = 1 if len(scaled) == 3 and len(set(scaled)) == 1 else len(scaled)
        return self.hypothesis.slips + units + self.mirrored


@dataclass(frozen=True, eq=False)
class SlipFit:
    """One table and the rows that may be meant.

    q : readings as they stand, shape (n, joints) [rad or m]; y : measured positions, shape (n, 3) [m]
    rows : DH rows, one sequence of joints for each convention that may be meant
    """

    q: Array
    y: Array
    rows: Sequence[Sequence[Joint]]
    reach: float
    _frames: Mapping[int, Array] = field(default_factory=dict, repr=False)

    def _aligned(self, shift: int) -> tuple[Array, Array]:
        """Readings and positions of the rows that belong together if the readings lie `shift` rows before."""
        n = len(self.q)
        if shift >= 0:
            return self.q[shift:], self.y[: n - shift]
        return self.q[: n + shift], self.y[-shift:]

    def _flange(self, q: Array, joints: Sequence[Joint], a: Array, d: Array) -> tuple[Array, Array, Array, Array]:
        """Positions (k, n, 3), orientations (k, n, 3, 3), directions of the a and of the d (k, joints, n, 3)."""
        count, n, size = q.shape
        p = np.zeros((count, n, 3))
        x, y, z = (np.broadcast_to(axis, (count, n, 3)) for axis in np.eye(3))  # columns of the orientation
        along_a, along_d = np.empty((count, size, n, 3)), np.empty((count, size, n, 3))
        for i, joint in enumerate(joints):
            along_a[:, i] = x
            p = p + a[:, i, None, None] * x
            y, z = _turned(y, z, joint.alpha)
            if joint.beta:
                z, x = _turned(z, x, joint.beta)
            turns = joint.kind == "revolute"
            x, y = _turned(x, y, joint.theta + q[..., i] if turns else joint.theta)
            along_d[:, i] = z
            p = p + (d[:, i, None] + (0.0 if turns else q[..., i]))[..., None] * z
        return p, np.stack([x, y, z], axis=3), along_a, along_d

    def scores(self, hypotheses: Sequence[Hypothesis]) -> tuple[Array, Array]:
        """Share of the motion that each leaves unexplained, shape (k,), and departures of the lengths that would
        explain most of it, one at a time: shape (k, 2 joints, 2) [share of that, metres], the a first.
        """
        share = np.empty(len(hypotheses))
        lengths = np.empty((len(hypotheses), 2 * self.q.shape[1], 2))
        keys = [(h.shift, h.rows) for h in hypotheses]
        for key in set(keys):
            index = [k for k, other in enumerate(keys) if other == key]
            for part in np.array_split(index, -(-len(index) // 128)):
                share[part], lengths[part] = self._scores([hypotheses[k] for k in part], *key)
        return share, lengths

    def _scores(self, hypotheses: Sequence[Hypothesis], shift: int, rows: int) -> tuple[Array, Array]:
        q, y = (part[:SCORED] for part in self._aligned(shift))
        joints = self.rows[rows]
        readings = np.stack([h.readings(q) for h in hypotheses])
        a, d = (np.tile([getattr(j, name) for j in joints], (len(hypotheses), 1)) for name in ("a", "d"))
        for k, h in enumerate(hypotheses):
            for name, i, departure in h.lengths:
                (a if name == "a" else d)[k, i] += departure
        p, R, along_a, along_d = self._flange(readings, joints, a, d)
        basis = np.linalg.qr(np.column_stack([y - y.mean(axis=0), np.ones(len(y))]))[0]

        def without(x: Array) -> Array:
            """Less what positions explain; x : shape (k, n, ...)."""
            flat = x.reshape(len(x), len(y), -1)
            return np.asarray((flat - basis @ (basis.T @ flat)).reshape(len(x), -1, *x.shape[3:]))

        left, turn = without(p), without(R)  # (k, 3 n), (k, 3 n, 3)
        gram = np.swapaxes(turn, 1, 2) @ turn + 1e-9 * np.eye(3)
        left = left - (turn @ np.linalg.solve(gram, np.swapaxes(turn, 1, 2) @ left[..., None]))[..., 0]
        spread = np.sqrt(((p - p.mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2)) / len(y)) + 1e-3 * self.reach
        share = self._trimmed(left) / spread
        columns = np.moveaxis(np.concatenate([along_a, along_d], axis=1), 1, 3)  # (k, n, 3, 2 joints)
        extra = without(columns)
        extra = extra - turn @ np.linalg.solve(gram, np.swapaxes(turn, 1, 2) @ extra)
        norms = (extra**2).sum(axis=1)
        products = (extra * left[..., None]).sum(axis=1)
        size = -products / np.maximum(norms, 1e-6 * len(y))
        after = np.maximum((left**2).sum(axis=1)[:, None] - products**2 / np.maximum(norms, 1e-6 * len(y)), 0)
        rest = np.sqrt(after / np.maximum((left**2).sum(axis=1)[:, None], 1e-18))
        return share, np.stack([rest, size], axis=2)

    @staticmethod
    def _trimmed(left: Array) -> Array:
        square = (left.reshape(len(left), -1, 3) ** 2).sum(axis=2)
        counted = np.sort(square, axis=1)[:, : max(1, int(COUNTED * square.shape[1]))]
        return np.asarray(np.sqrt(counted.mean(axis=1)))

    def placed(self, h: Hypothesis) -> Fit:
        """The hypothesis with base and tool as frames: its error, and what is wrong with the positions."""
        q, y = self._aligned(h.shift)
        joints = self.rows[h.rows]
        a, d = (np.array([[getattr(j, name) for j in joints]]) for name in ("a", "d"))
        for name, i, departure in h.lengths:
            (a if name == "a" else d)[0, i] += departure
        p, R, _, _ = self._flange(h.readings(q)[None], joints, a, d)
        kept = np.ones(len(y), dtype=bool)
        scale, mirrored, error = (1.0, 1.0, 1.0), False, np.inf
        for _ in range(3):  # far rows draw the fit towards themselves
            scale, mirrored = _shape(_linear(p[0][kept], R[0][kept], y[kept]))
            meant = y * np.array(scale) * [1, -1 if mirrored else 1, 1]
            T, t = solve_placement(p[0][kept], R[0][kept], meant[kept], None, np.eye(4), np.zeros(3))
            e = np.linalg.norm((p[0] + R[0] @ t) @ T[:3, :3].T + T[:3, 3] - meant, axis=1)
            error = float(np.median(e))
            kept = e <= 5 * error
        # Positions that are made small fit everything.
        error *= max(1.0, _spread(p[0]) / max(_spread(meant), 1e-12))
        return Fit(h, error, scale, mirrored)


def _spread(p: Array) -> float:
    return float(np.linalg.norm(p - p.mean(axis=0)))


def _turned(first: Array, second: Array, angle: Array | float) -> tuple[Array, Array]:
    """Two axes, shape (k, n, 3), turned about the third from the first to the second."""
    c, s = (f(angle)[..., None] if isinstance(angle, np.ndarray) else f(angle) for f in (np.cos, np.sin))
    return c * first + s * second, c * second - s * first


def _linear(p: Array, R: Array, y: Array) -> Array:
    """M of p = M y + c - R t, shape (3, 3), by least squares."""
    n = len(p)
    A = np.zeros((n, 3, 15))
    for row in range(3):
        A[:, row, 3 * row : 3 * row + 3] = y - y.mean(axis=0)
        A[:, row, 9 + row] = 1.0
    A[:, :, 12:] = -R
    return np.asarray(np.linalg.lstsq(A.reshape(3 * n, -1), p.ravel(), rcond=None)[0][:9].reshape(3, 3))


# Units that a length may be in, as factors to the one that its name says.
SCALES = (1.0, 1e3, 1e-3, 25.4, 1 / 25.4, 10.0, 0.1, 1e2, 1e-2, 1e3 / 25.4, 25.4e-3)


def _shape(M: Array) -> tuple[tuple[float, float, float], bool]:
    """Factors of x, y and z that make M a rotation, where they are units, and whether M mirrors."""
    norms = np.linalg.norm(M, axis=0)
    found = [min(SCALES, key=lambda s: abs(np.log(norm / s))) if norm > 0 else 1.0 for norm in norms]
    sure = [abs(np.log(max(norm, 1e-12) / s)) < 0.2 for norm, s in zip(norms, found, strict=True)]
    x, y, z = (s if ok else 1.0 for s, ok in zip(found, sure, strict=True))
    return (x, y, z), bool(np.linalg.det(M) < 0)
