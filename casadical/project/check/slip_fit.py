"""A fast fit of many slip hypotheses to one table, with base and tool by linear least squares.

p(q) = M y + c - R(q) t with flange position p, orientation R, measured y: linear in M (9 numbers),
c and t (3 each). M is a rotation where nothing is wrong with the positions; its columns show wrong
units, its determinant a left-handed frame. Therefore only what is wrong with readings and rows must
be searched for.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from casadical.core.basics import Array
from casadical.core.levenberg_marquardt import Evaluated, levenberg_marquardt
from casadical.core.parts import Joint
from casadical.core.transforms import nearest_rotation
from casadical.identification.placement import solve_placement


class Hypothesis(NamedTuple):
    """What may be wrong with the readings and the robot's rows.

    reading[i] = own[i] + add[i] * own[i - 1], own = sign * factor * column[source] + zero

    source, sign, factor, zero, add : of each joint, as above; zero in rad or m
    shift : number of rows by which the readings precede their positions
    rows : index of the DH rows that are meant
    lengths : (name, joint index, departure [m]) of wrong link lengths
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
        """Return the hypothesis that nothing is wrong with n joints."""
        return Hypothesis(tuple(range(n)), (1,) * n, (1.0,) * n, (0.0,) * n, (0,) * n)

    @property
    def slips(self) -> int:
        """Return the number of slips.

        Two swapped columns are one, as are all joints in another unit.
        """
        factors = [f for f in self.factor if f != 1.0]
        units = 1 if len(factors) > 2 and len(set(factors)) == 1 else len(factors)
        moved = sum(s != k for k, s in enumerate(self.source))
        signs = sum(s < 0 for s in self.sign)
        offsets = sum(z != 0 for z in self.zero) + sum(a != 0 for a in self.add)
        shifts = (self.shift != 0) + (self.rows != 0)
        return (moved + 1) // 2 + signs + units + offsets + shifts + len(self.lengths)

    @property
    def cost(self) -> float:
        """Return how improbable the hypothesis is, as an equivalent number of slips.

        Joints that count the other way occur together, and together with coupled readings.
        """
        reversed_ = sum(s < 0 for s in self.sign)
        together = sum(s < 0 and a != 0 for s, a in zip(self.sign, self.add, strict=True))
        # Each further reversed joint costs 0.6 slips less; a reversed and coupled one 0.5 less.
        return self.slips - 0.6 * max(0, reversed_ - 1) - 0.5 * together

    def at(self, what: str, i: int, value: float) -> Hypothesis:
        """Return the hypothesis with another value of a field for the joint of index i, from 0.

        what : name of the field, such as "sign" or "zero"
        """
        entries = list(getattr(self, what))
        entries[i] = value
        entry: dict[str, Any] = {what: tuple(entries)}
        return self._replace(**entry)

    def readings(self, q: Array) -> Array:
        """Return the readings with the slips undone, shape (n, joints) [rad or m].

        q : readings of the table, of the same shape
        """
        return np.asarray(_readings([self], q)[0])


@dataclass(frozen=True, eq=False)
class Fit:
    """The fit of one hypothesis, base and tool placed.

    hypothesis : what is undone
    error : median error [m], or, of `SlipFit.placed`, a third of the 80 % quantile if that is
        greater; infinite where the fit was not made
    scale : factors that correct the units of the measured x, y, z
    mirrored : whether y is mirrored
    turn : median angle between measured and modelled orientations [rad], 0 where none were measured
    """

    hypothesis: Hypothesis
    error: float
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    mirrored: bool = False
    turn: float = 0.0

    @property
    def cost(self) -> float:
        """Return how improbable the fit is, as an equivalent number of slips.

        A mirrored frame counts as half a slip more, as no instrument's frame is left-handed.
        """
        return self.slips - self.hypothesis.slips + self.hypothesis.cost + 0.5 * self.mirrored

    @property
    def slips(self) -> int:
        """Return the number of slips, those of the positions included."""
        scaled = [s for s in self.scale if s != 1.0]
        units = 1 if len(scaled) == 3 and len(set(scaled)) == 1 else len(scaled)
        return self.hypothesis.slips + units + self.mirrored


@dataclass(frozen=True, eq=False)
class SlipFit:
    """One table of positions, and the robots that may be meant.

    q : joint variables by the table, shape (n, joints) [rad or m]
    y : measured positions, shape (n, 3) [m]
    rows : DH rows, one sequence of joints for each convention that may be meant
    reach : reach of the robot [m]
    orientation : measured orientations, shape (n, 3, 3), None without
    """

    q: Array
    y: Array
    rows: Sequence[Sequence[Joint]]
    reach: float
    orientation: Array | None = None
    # Number of poses by which hypotheses are scored.
    scored: ClassVar[int] = 40
    # Number of hypotheses that are continued on each level of the search.
    beam: ClassVar[int] = 800

    def aligned(self, shift: int) -> tuple[Array, Array]:
        """Return readings (k, joints) and positions (k, 3) that belong together after a shift.

        shift : number of rows by which the readings precede their positions
        """
        n = len(self.q)
        if shift >= 0:
            return self.q[shift:], self.y[: n - shift]
        return self.q[: n + shift], self.y[-shift:]

    def _flange(self, q: Array, joints: Sequence[Joint], a: Array, d: Array) -> tuple[Array, Array, Array, Array]:
        """Return the flange poses in the base frame, and the directions of all lengths a and d.

        q : readings of k hypotheses, shape (k, n, joints) [rad or m]; joints : the DH rows
        a, d : link lengths, shape (k, joints) [m]
        Returns positions (k, n, 3) [m], orientations (k, n, 3, 3), and for a and d each the
        directions in which they move the flange, (k, joints, n, 3)
        """
        count, n, size = q.shape
        p = np.zeros((count, n, 3))
        x, y, z = (np.broadcast_to(axis, (count, n, 3)) for axis in np.eye(3))  # columns of R
        along_a, along_d = np.empty((count, size, n, 3)), np.empty((count, size, n, 3))
        for i, joint in enumerate(joints):
            along_a[:, i] = x
            p = p + a[:, i, None, None] * x
            y, z = _rotated(y, z, joint.alpha)
            if joint.beta:
                z, x = _rotated(z, x, joint.beta)
            turns = joint.kind == "revolute"
            x, y = _rotated(x, y, joint.theta + q[..., i] if turns else joint.theta)
            along_d[:, i] = z
            p = p + (d[:, i, None] + (0.0 if turns else q[..., i]))[..., None] * z
        return p, np.stack([x, y, z], axis=3), along_a, along_d

    def shares(self, hypotheses: Sequence[Hypothesis]) -> Array:
        """Return the share of the motion that each of k hypotheses does not explain, shape (k,).

        It is the rms residual of the best three quarters of the rows over the extent of the flange
        positions, with base and tool fitted.
        """
        share = np.empty(len(hypotheses))
        for part, y, p, R, _ in self._parts(hypotheses):
            residual, turn, _ = _project_out_frame(y, p, R)
            residual = residual - (turn @ _least_squares(turn, residual[..., None]))[..., 0]
            spread = np.sqrt(((p - p.mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2)) / len(y)) + 1e-3 * self.reach
            square = np.sort((residual.reshape(len(residual), -1, 3) ** 2).sum(axis=2), axis=1)
            counted = square[:, : max(1, int(0.75 * square.shape[1]))]
            share[part] = np.sqrt(counted.mean(axis=1)) / spread
        return share

    def departures(self, hypotheses: Sequence[Hypothesis]) -> Array:
        """Return the effect of freeing each link length under each of k hypotheses.

        The shape is (k, 2 joints, 2), all a before all d: the remaining error over that without
        freeing, and the departure of the length [m].
        """
        departures = np.empty((len(hypotheses), 2 * self.q.shape[1], 2))
        for part, y, p, R, along in self._parts(hypotheses):
            residual, turn, extra = _project_out_frame(y, p, R, np.moveaxis(np.concatenate(along, axis=1), 1, 3))
            residual = residual - (turn @ _least_squares(turn, residual[..., None]))[..., 0]
            extra = extra - turn @ _least_squares(turn, extra)
            norms = np.maximum((extra**2).sum(axis=1), 1e-6 * len(y))
            products = (extra * residual[..., None]).sum(axis=1)
            whole = (residual**2).sum(axis=1)[:, None]
            after = np.maximum(whole - products**2 / norms, 0)
            departures[part] = np.stack([np.sqrt(after / np.maximum(whole, 1e-18)), -products / norms], axis=2)
        return departures

    def zeros(self, hypotheses: Sequence[Hypothesis], joint: int) -> Array:
        """Return the correction of a revolute joint's zero that fits best, shape (k,) [rad].

        Poses are linear in its cosine and sine, so that p + R t is linear in both, in t and in
        their products, which are taken as independent unknowns of a linear least-squares problem.

        hypotheses : k of them; joint : index of the joint, from 0
        """
        zeros = np.empty(len(hypotheses))
        turned = [[h.at("zero", joint, h.zero[joint] + z) for h in hypotheses] for z in (0.0, np.pi / 2, np.pi)]
        for (part, y, p0, R0, _), (_, _, p1, R1, _), (_, _, p2, R2, _) in zip(*map(self._parts, turned), strict=True):
            constant, x0 = (p0 + p2) / 2, (R0 + R2) / 2
            parts = [
                _project_out_frame(y, *pR)
                for pR in ((constant, x0), (p0 - constant, R0 - x0), (p1 - constant, R1 - x0))
            ]
            (fixed, R, _), (cosine, R_cos, _), (sine, R_sin, _) = parts
            A = np.concatenate([cosine[..., None], sine[..., None], R, R_cos, R_sin], axis=2)
            w = -_least_squares(A, fixed[..., None])[..., 0]
            zeros[part] = np.arctan2(w[:, 1], w[:, 0])
        return zeros

    def _parts(
        self, hypotheses: Sequence[Hypothesis]
    ) -> Iterator[tuple[list[int], Array, Array, Array, tuple[Array, Array]]]:
        """Yield hypotheses of equal shift and rows in batches, with their flange poses.

        A batch has their indices, the measured positions (n, 3), and flange positions, orientations
        and directions of the lengths as of `_flange`.
        """
        keys = [(h.shift, h.rows) for h in hypotheses]
        for shift, rows in dict.fromkeys(keys):
            index = [k for k, key in enumerate(keys) if key == (shift, rows)]
            q, y = (part[: self.scored] for part in self.aligned(shift))
            for first in range(0, len(index), 128):
                part = index[first : first + 128]
                some = [hypotheses[k] for k in part]
                p, R, *along = self._flange(_readings(some, q), self.rows[rows], *self._lengths(some, rows))
                yield part, y, p, R, (along[0], along[1])

    def _lengths(self, hypotheses: Sequence[Hypothesis], rows: int) -> tuple[Array, Array]:
        """Return the link lengths a and d under each of k hypotheses, shapes (k, joints) [m]."""
        a, d = (np.tile([getattr(j, name) for j in self.rows[rows]], (len(hypotheses), 1)) for name in ("a", "d"))
        for k, h in enumerate(hypotheses):
            for name, i, departure in h.lengths:
                (a if name == "a" else d)[k, i] += departure
        return a, d

    def placed(self, h: Hypothesis, as_given: bool = False) -> Fit:
        """Return the fit of a hypothesis, with base and tool fitted as frames in closed form.

        as_given : whether the positions are taken to be right in unit and handedness, which are
            fitted otherwise
        """
        q, y = self.aligned(h.shift)
        p, R, _, _ = self._flange(_readings([h], q), self.rows[h.rows], *self._lengths([h], h.rows))
        inliers = np.ones(len(y), dtype=bool)
        scale, mirrored, error = (1.0, 1.0, 1.0), False, np.inf
        for _ in range(3):  # far rows bias the fit
            if not as_given:
                scale, mirrored = _units_and_hand(_frame_matrix(p[0][inliers], R[0][inliers], y[inliers]))
            meant = y * np.array(scale) * [1, -1 if mirrored else 1, 1]
            T, t = solve_placement(p[0][inliers], R[0][inliers], meant[inliers], None, np.eye(4), np.zeros(3))
            e = np.linalg.norm((p[0] + R[0] @ t) @ T[:3, :3].T + T[:3, 3] - meant, axis=1)
            error = max(float(np.median(e)), float(np.quantile(e, 0.8)) / 3.0)
            inliers = e <= 5 * np.median(e)
        if not as_given:  # positions that are scaled down fit every model
            error *= max(1.0, _spread(p[0]) / max(_spread(meant), 1e-12))
        return Fit(h, error, scale, mirrored, self._turn(h.shift, T[:3, :3] @ R[0]))

    def _turn(self, shift: int, R: Array) -> float:
        """Return the median orientation error [rad], the tool rotated to fit; 0 if not measured.

        shift : of the rows; R : modelled orientations, shape (n, 3, 3)
        """
        if self.orientation is None:
            return 0.0
        n = len(R)
        seen = self.orientation[:n] if shift >= 0 else self.orientation[-n:]
        own = np.swapaxes(R, 1, 2) @ seen
        trace = np.einsum("ij,nij->n", nearest_rotation(np.median(own, axis=0)), own)
        return float(np.median(np.arccos(np.clip((trace - 1) / 2, -1, 1))))


@dataclass(frozen=True, eq=False)
class LengthFit(SlipFit):
    """One table of lengths from the tool to a few unknown fixed points.

    y has the length [m] and the index of the point. Lengths show neither the rotation of a frame
    nor its hand, so that only readings and rows are searched for. Tool and points are fitted by
    damped Gauss-Newton steps (Levenberg 1944; Marquardt 1963), which start with the tool at the
    flange.
    """

    scored: ClassVar[int] = 60
    beam: ClassVar[int] = 60

    def shares(self, hypotheses: Sequence[Hypothesis]) -> Array:
        """Return the share of the motion that each of k hypotheses does not explain, shape (k,).

        It is the rms residual of the best three quarters of the lengths over the extent of the
        flange positions.
        """
        share = np.empty(len(hypotheses))
        for part, y, p, R, _ in self._parts(hypotheses):
            square = np.sort(self._residuals(p, R, y) ** 2, axis=1)[:, : max(1, int(0.75 * len(y)))]
            share[part] = np.sqrt(square.mean(axis=1)) / (np.std(p, axis=1).sum(axis=1) + 1e-3 * self.reach)
        return share

    def departures(self, hypotheses: Sequence[Hypothesis]) -> Array:
        """Return ratios of 1 and departures of 0, shape (k, 2 joints, 2): no length is freed."""
        return np.tile([1.0, 0.0], (len(hypotheses), 2 * self.q.shape[1], 1))

    def zeros(self, hypotheses: Sequence[Hypothesis], joint: int) -> Array:  # noqa: ARG002
        """Return corrections of 0, shape (k,): only quarter turns of zeros are searched for."""
        return np.zeros(len(hypotheses))

    def placed(self, h: Hypothesis, as_given: bool = False) -> Fit:  # noqa: ARG002
        """Return the fit of a hypothesis h, its error [m] with tool and points fitted.

        as_given : not used, as lengths show neither unit nor handedness
        """
        q, y = self.aligned(h.shift)
        p, R, _, _ = self._flange(_readings([h], q), self.rows[h.rows], *self._lengths([h], h.rows))
        inliers, e = np.ones(len(y), dtype=bool), np.zeros(len(y))
        for _ in range(3):  # far rows bias the fit
            e = np.abs(self._residuals(p, R, y, inliers, 40)[0])
            inliers = e <= 5 * np.median(e)
        return Fit(h, max(float(np.median(e)), float(np.quantile(e, 0.8)) / 3.0))

    def _residuals(self, p: Array, R: Array, y: Array, inliers: Array | None = None, steps: int = 12) -> Array:
        """Return the residuals of the lengths after the fit of tool and points, shape (k, n) [m].

        p, R : flange poses of each hypothesis, shapes (k, n, 3) and (k, n, 3, 3); y : lengths and
            indices of points, shape (n, 2)
        inliers : mask of the rows that are fitted, all by default; steps : of the fit
        """
        length, place = y[:, 0], np.eye(int(y[:, 1].max()) + 1)[y[:, 1].astype(int)]
        weight = np.ones(len(y)) if inliers is None else inliers.astype(float)

        def lines(x: Array) -> tuple[Array, Array]:
            """Return the vectors from the points to the tool, (k, n, 3) [m], and lengths (k, n)."""
            line = p + (R @ x[:, None, :3, None])[..., 0] - place @ x[:, 3:].reshape(len(p), -1, 3)
            return line, np.maximum(np.linalg.norm(line, axis=2), 1e-9)

        def evaluate(x: Array) -> Evaluated:
            """Return the cost of each hypothesis, shape (k,), and a function of normal equations.

            x : tool and points of each hypothesis, shape (k, 3 + 3 K) [m]
            """
            line, size = lines(x)
            residual = length - size

            def sums(better: Array) -> tuple[Array, Array]:
                """Return J' J (k, x, x) and J' r (k, x) of the hypotheses that `better` selects."""
                along = (weight[:, None] * line / size[..., None])[better]
                of_places = [-(along * place[:, [k]]) for k in range(place.shape[1])]
                J = np.concatenate([np.einsum("kni,knij->knj", along, R[better]), *of_places], axis=2)
                return np.swapaxes(J, 1, 2) @ J, (np.swapaxes(J, 1, 2) @ residual[better][..., None])[..., 0]

            return (weight * residual**2).sum(axis=1), sums

        # The floor regularises what no length determines, as a part of the tool of a planar arm.
        start, floor = self._start(p, length, place), 1e-6 * len(y)
        *_, end = levenberg_marquardt(evaluate, start, steps, scale=lambda diagonal: diagonal + floor)
        return np.asarray(length - lines(end.point)[1])

    @staticmethod
    def _start(p: Array, length: Array, place: Array) -> Array:
        """Return the start of the fit, shape (k, 3 + 3 K) [m]: tool at the flange, points fitted.

        The distance of a point from the plane of a planar arm follows from its square alone.
        """
        x = [np.zeros((len(p), 3))]
        for own in place.T > 0:
            local = p[:, own] - p[:, own].mean(axis=1, keepdims=True)
            A = np.concatenate([2 * local, -np.ones((*local.shape[:2], 1))], axis=2)
            solved = _least_squares(A, ((local**2).sum(axis=2) - length[own] ** 2)[..., None])[..., 0]
            spread, axes = np.linalg.eigh(np.swapaxes(local, 1, 2) @ local)
            offset = np.sqrt(np.maximum(solved[:, 3] - (solved[:, :3] ** 2).sum(axis=1), 0.0))
            offset[spread[:, 0] > 1e-6 * spread[:, 2]] = 0.0
            x.append(solved[:, :3] + axes[:, :, 0] * offset[:, None] + p[:, own].mean(axis=1))
        return np.concatenate(x, axis=1)


def _readings(hypotheses: Sequence[Hypothesis], q: Array) -> Array:
    """Return the readings with the slips of each of k hypotheses undone, shape (k, n, joints).

    q : readings of the table, shape (n, joints) [rad or m]
    """
    source, sign, factor, zero, add = (
        np.array([getattr(h, name) for h in hypotheses]) for name in ("source", "sign", "factor", "zero", "add")
    )
    own = q.T[source].swapaxes(1, 2) * (sign * factor)[:, None, :] + zero[:, None, :]
    meant = own.copy()
    meant[..., 1:] += add[:, None, 1:] * own[..., :-1]
    return np.asarray(meant)


def _project_out_frame(y: Array, p: Array, R: Array, more: Array | None = None) -> tuple[Array, Array, Array]:
    """Return p, R and further columns minus their least-squares fit by M y + c, without the frame.

    The results have shapes (k, 3 n), (k, 3 n, 3) and (k, 3 n, columns).

    y : measured positions, shape (n, 3); p, R, more : shapes (k, n, 3), (k, n, 3, 3) and (k, n, 3,
        columns)
    """
    basis = np.linalg.qr(np.column_stack([y - y.mean(axis=0), np.ones(len(y))]))[0]
    x = np.concatenate([R, p[..., None], *([] if more is None else [more])], axis=3)
    flat = x.reshape(*x.shape[:2], -1)
    x = (flat - basis @ (basis.T @ flat)).reshape(len(x), -1, x.shape[3])
    return x[..., 3], x[..., :3], x[..., 4:]


def _least_squares(A: Array, b: Array) -> Array:
    """Return the regularised least-squares solutions of A x = b, shape (k, x, c).

    A, b : shapes (k, rows, x) and (k, rows, c)
    """
    At = np.swapaxes(A, 1, 2)
    return np.asarray(np.linalg.solve(At @ A + 1e-9 * np.eye(A.shape[2]), At @ b))


def _spread(p: Array) -> float:
    """Return the root of the sum of squared distances of points (n, 3) from their mean [m]."""
    return float(np.linalg.norm(p - p.mean(axis=0)))


def _rotated(first: Array, second: Array, angle: Array | float) -> tuple[Array, Array]:
    """Return two axes of frames, shape (k, n, 3) each, rotated in their plane by an angle.

    angle : [rad], from the first to the second axis; a number or shape (k, n)
    """
    c, s = (f(angle)[..., None] if isinstance(angle, np.ndarray) else f(angle) for f in (np.cos, np.sin))
    return c * first + s * second, c * second - s * first


def _frame_matrix(p: Array, R: Array, y: Array) -> Array:
    """Return M, shape (3, 3), of p = M y + c - R t by least squares, from measuring to base frame.

    Lengths of its columns show wrong units of length, its determinant a mirrored frame.
    p, R : flange poses in the base frame, shapes (n, 3) and (n, 3, 3)
    y : measured positions, shape (n, 3)
    """
    n = len(p)
    A = np.zeros((n, 3, 15))
    for row in range(3):
        A[:, row, 3 * row : 3 * row + 3] = y - y.mean(axis=0)
        A[:, row, 9 + row] = 1.0
    A[:, :, 12:] = -R
    return np.asarray(np.linalg.lstsq(A.reshape(3 * n, -1), p.ravel(), rcond=None)[0][:9].reshape(3, 3))


def _units_and_hand(M: Array) -> tuple[tuple[float, float, float], bool]:
    """Return the unit factors of x, y and z by the columns of M, and whether M mirrors.

    M : from the measuring to the base frame, shape (3, 3), as of `_frame_matrix`

    A factor that is near no unit is 1.
    """
    norms = np.linalg.norm(M, axis=0)
    # Factors between the units that a length may be in and the one that its name states.
    unit_factors = (1.0, 1e3, 1e-3, 25.4, 1 / 25.4, 10.0, 0.1, 1e2, 1e-2, 1e3 / 25.4, 25.4e-3)
    nearest = [min(unit_factors, key=lambda s: abs(np.log(norm / s))) if norm > 0 else 1.0 for norm in norms]
    sure = [abs(np.log(max(norm, 1e-12) / s)) < 0.2 for norm, s in zip(norms, nearest, strict=True)]
    x, y, z = (s if ok else 1.0 for s, ok in zip(nearest, sure, strict=True))
    return (x, y, z), bool(np.linalg.det(M) < 0)
