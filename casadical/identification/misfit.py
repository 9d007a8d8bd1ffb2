"""How much less an identification determines than its covariance says, where residuals are not independent noise.

The fit is repeated in one linear step with all parameters and the first harmonics of each turning joint's error, which
are in no base model. What is left may still have something in common at poses that follow each other or have similar
readings: gear errors of higher order, slow drifts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.noise import NoiseModel
from casadical.core.linear_gaussian.normal_equations import NormalSums, normal_sums
from casadical.core.statistics import first_of_best
from casadical.identification.identifiability import scaled_inverse
from casadical.identification.remaining_errors import ROUNDS, Doubts, doubts_of, posterior_of
from casadical.identification.residuals import make_block
from casadical.identification.result import Identification
from casadical.measurements.kinds.registry import find_kind
from casadical.robot.remaining_errors import doubted
from casadical.robot.robot import Robot

# Harmonics of each joint's error: those that are compared between campaigns, and those that only widen what is known.
ORDERS, FURTHER = 2, 6
# Directions of unknown points that are seen by a smaller share of the best seen one are not seen.
POINT = 1e-9
# Repeatability of the joints over the noise of a coordinate [rad/m].
RHOS = (0.0, 0.3, 0.5, 0.8, 1.3, 2.0)
# So many poses are kept with their Jacobians.
KEPT = 10_000
_MM = 1e-3


@dataclass(frozen=True, eq=False)
class _Rows:
    """Some poses of a fit at its values, each with as many rows as the kind with the most numbers has.

    Lengths in mm; what is more or less accurate than the lengths of the first set is in units of its noise. r : shape
    (n, numbers); J : (n, numbers, k); U : by the unknown points, (n, numbers, 3 points); Jq : how each turning joint
    moves what is measured, as its zero does, (n, numbers, joints) [mm/mrad]
    """

    r: Array
    J: Array
    Jq: Array
    U: Array


class _Poses:
    """All poses of a fit; few are kept, and many are evaluated each time that they are asked for.

    q : readings, shape (n, joints); joints : how many of them turn
    count : of numbers measured beside those that determine the unknown points
    """

    def __init__(self, found: Identification, robot: Robot, names: tuple[str, ...], kept: int) -> None:
        self.q = np.concatenate([m.q for m in found.used])
        self.joints = sum(name.startswith("theta") for name in names)
        self.count = sum(m.q.shape[0] * find_kind(m.kind).numbers for m in found.used) - 3 * len(found.unknown_points)
        self._made = partial(_rows, found, robot, names)
        self._kept = list(self._made()) if len(self) <= kept else []

    def __len__(self) -> int:
        return len(self.q)

    def __iter__(self) -> Iterator[_Rows]:
        return iter(self._kept or self._made())


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """The fit where each joint repeats to so many times the noise of a coordinate.

    log_likelihood : with the s2 and the variances that fit best; sums : over the poses, at the fit's values, whitened
    s2 : variance of a coordinate that nothing explains, repeatability of the joints left aside [mm^2]
    variance : of each parameter before the data, shape (k,); of the harmonics as the residuals show it
    """

    log_likelihood: float
    sums: NormalSums
    s2: float
    variance: Array


@dataclass(frozen=True, eq=False)
class WideFit:
    """Of all parameters that are not known exactly, and the harmonics; lengths in mm.

    robot : calibrated, with harmonics of zero size; best : with the most probable of RHOS for all joints alike
    misfit : how many times more than independent noise residuals of similar poses push the parameters, at least 1
    left : standard deviation of a coordinate that nothing explains [m]; freedom : its degrees of freedom
    """

    robot: Robot
    doubts: Doubts
    poses: _Poses
    best: NoiseFit
    misfit: float
    left: float
    freedom: float
    _tried: dict[tuple[float, ...], float] = field(default_factory=dict, repr=False)
    _last: dict[tuple[float, ...], NoiseFit] = field(default_factory=dict, repr=False)

    @property
    def joints(self) -> int:
        """How many joints turn."""
        return self.poses.joints

    def at(self, rhos: tuple[float, ...]) -> NoiseFit:
        """The fit with a repeatability of each turning joint."""
        if rhos not in self._last:
            self._last.clear()
            self._last[rhos] = _at(rhos, self.poses, self.doubts)[0]
        return self._last[rhos]

    def log_likelihood(self, rhos: tuple[float, ...]) -> float:
        """Of such a fit, begun at the variances of the best one."""
        if rhos not in self._tried:
            doubts = replace(self.doubts, sigma=np.sqrt(self.best.variance))
            # Rounds of a fit that begins at the variances of another one.
            self._tried[rhos] = _at(rhos, self.poses, doubts, 4)[0].log_likelihood
        return self._tried[rhos]


def wide_fit(found: Identification, kept: int = KEPT) -> WideFit:
    """The fit of all that an identification used. Raises InputError for known distances between touched points.

    kept : poses whose rows are kept; those of more are evaluated each time that they are needed
    """
    robot = doubted(found.robot, FURTHER)
    doubts = doubts_of(robot, found.names)
    low = [joint[: 2 * ORDERS] for joint in doubts.joints]
    doubts = replace(doubts, joints=(*low, *(joint[2 * ORDERS :] for joint in doubts.joints)))
    poses = _Poses(found, robot, doubts.names, kept)
    rhos, best, mean = _most_probable(poses, doubts)
    n = len(poses)
    # Residuals are summed up over so many parts of the poses, by their order and by the region of
    # the joints.
    parts = [_sums(rhos, poses, part)[0] for part in (np.arange(n) * min(12, n) // n, _by_region(poses.q))]
    times = _misfit(parts, mean, best.s2, best.variance)
    # A parameter with a prior counts as far as the data determine it (Hastie 1990); with few poses the last round of
    # `posterior_of` still moved s2.
    M = scaled_inverse(best.sums.H / best.s2 + np.diag(1 / best.variance)) @ best.sums.H / best.s2
    fitted = float(2 * np.trace(M) - np.sum(M * M.T))
    plain = _sums((0.0,) * poses.joints, poses)[0][0].moved(mean)
    freedom = max(1.0, poses.count - fitted)
    return WideFit(robot, doubts, poses, best, times, _MM * float(np.sqrt(plain.square / freedom)), freedom)


def _rows(found: Identification, robot: Robot, names: tuple[str, ...]) -> Iterator[_Rows]:
    """Some poses at a time; all at once where points are unknown, which several of them may tell of.

    Raises InputError for known distances between touched points.
    """
    sets = [m.positions_alone() if m.kind == "position_covariance" else m for m in found.used]
    if any(m.separations for m in sets):
        raise InputError(
            f"{sets[0].source}: known distances between touched points cannot be compared yet; leave them out"
        )
    where = found.unknown_points
    number = {name: k for k, name in enumerate(where)}
    points = np.array([*where.values()]).reshape(-1, 3)
    zeros = [k for k, name in enumerate(names) if name.startswith("theta")]
    width = max(find_kind(m.kind).numbers for m in sets)
    (first, _) = found.problem.sigmas[0]
    together: list[tuple[Array, ...]] = []
    for k, (m, sigmas) in enumerate(zip(sets, found.problem.sigmas, strict=True)):
        at = np.array([number[f"{k}/{name}"] for name in find_kind(m.kind).point_names(m.arrays)], dtype=int)
        length, angle = (_MM * sigma / first for sigma in sigmas)
        group = at if at.size else np.zeros(len(m), dtype=int)
        block = make_block(robot, m, names, length, angle, points, group)
        for some, r, J in block.parts(np.zeros(len(names)), np.zeros_like(points)):
            U = np.zeros((*r.shape, points.size))
            for i, point in enumerate(at[some]):
                U[i, :, 3 * point : 3 * point + 3] = J[i, :, len(names) :]
            out = [(0, 0), (0, width - r.shape[1])]
            r, J, U = (np.pad(value, [*out, (0, 0)][: value.ndim]) for value in (r, J[:, :, : len(names)], U))
            if not points.size:
                yield _Rows(r, J, J[:, :, zeros], U)
            else:
                together.append((r, J, J[:, :, zeros], U))
    if together:
        yield _Rows(*map(np.concatenate, zip(*together, strict=True)))


def _without_points(r: Array, J: Array, U: Array) -> tuple[Array, Array, float]:
    """Residuals and Jacobians of which the unknown points are projected out, and the log of what these are seen by."""
    if not U.shape[2]:
        return r, J, 0.0
    Q, seen, _ = np.linalg.svd(U.reshape(-1, U.shape[2]), full_matrices=False)
    Q, seen = Q[:, seen > POINT * seen[0]], seen[seen > POINT * seen[0]]
    both = np.concatenate([r[:, :, None], J], axis=2)
    flat = both.reshape(-1, both.shape[2])
    both = (flat - Q @ (Q.T @ flat)).reshape(both.shape)
    return both[:, :, 0], both[:, :, 1:], float(np.log(seen).sum())


_Fit = tuple[tuple[float, ...], NoiseFit, Array]


def _most_probable(poses: _Poses, doubts: Doubts) -> _Fit:
    """With the rho of all joints from which a step along RHOS makes the data less probable; these, and their fit."""
    tried: dict[int, _Fit] = {}
    best, at = -1, len(RHOS) // 2
    while best != at:
        best = at
        near = range(max(0, best - 1), min(len(RHOS), best + 2))
        rhos = {k: (RHOS[k],) * poses.joints for k in near if k not in tried}
        tried |= {k: (each, *_at(each, poses, doubts)) for k, each in rhos.items()}
        at = near[first_of_best([tried[k][1].log_likelihood for k in near], logs=True)]
    return tried[best]


def _at(rhos: tuple[float, ...], poses: _Poses, doubts: Doubts, rounds: int = ROUNDS) -> tuple[NoiseFit, Array]:
    """The fit with noise s2 (I + Jq Jq'), and the mean; Jq : as of `_sums`."""
    (sums,), spread = _sums(rhos, poses)
    sums = replace(sums, count=poses.count)
    s2, mean, S, variance = posterior_of(sums, doubts, rounds)
    root = np.sqrt(np.diag(S))
    log_det = float(np.log(variance).sum() - 2 * np.log(root).sum() - np.linalg.slogdet(S / np.outer(root, root))[1])
    square = float(sums.moved(mean).square / s2 + np.sum(mean**2 / variance))
    log_likelihood = -0.5 * (sums.count * np.log(s2) + square + log_det) - spread
    return NoiseFit(log_likelihood, sums, s2, variance), mean


def _sums(rhos: tuple[float, ...], poses: _Poses, part: Array | None = None) -> tuple[list[NormalSums], float]:
    """Sums over the poses, or over each part of them, with the noise I + Jq Jq' whitened; log of that one's root.

    Jq : how each joint moves what is measured, times its rho; part : number of each pose's part, shape (n,)
    """
    sums_of: dict[int, NormalSums] = {}
    spread, done = 0.0, 0
    for rows in poses:
        n, numbers = rows.r.shape
        joints = NoiseModel((n, numbers), {"repeatability": rows.Jq})
        whitening = joints.whitening({"repeatability": np.array(rhos)})
        white, Jw, U = (whitening @ some for some in (rows.r[:, :, None], rows.J, rows.U))
        white, Jw, seen = _without_points(white[:, :, 0], Jw, U)
        spread += 0.5 * whitening.log_det + seen
        own = np.zeros(len(white), dtype=int) if part is None else part[done : done + len(white)]
        done += len(white)
        for k in np.unique(own).tolist():
            sums = normal_sums(white[own == k], Jw[own == k])
            sums_of[k] = sums_of[k].plus(sums) if k in sums_of else sums
    return list(sums_of.values()), spread


def misfit_of(found: Identification) -> float:
    """By how much the variances of an identification are to be multiplied, at least 1; 1 where it is not known.

    As a mean over the directions of its parameters, each in units of the variance that the identification states.
    """
    try:
        fit = wide_fit(found)
    except InputError:
        return 1.0
    known = np.flatnonzero(np.isfinite(np.diag(found.covariance)))  # a parameter at its bound has no variance
    at = fit.doubts.solved[known]
    scale = np.array([fit.robot.parameters[fit.doubts.names[k]].scale for k in at])
    own = found.covariance[np.ix_(known, known)] / np.outer(scale, scale)
    here = fit.best.sums.H[np.ix_(at, at)] / (fit.best.s2 * fit.misfit)
    return float(max(1.0, len(at) / np.sum(own * here)))


def _misfit(of_parts: Sequence[Sequence[NormalSums]], mean: Array, s2: float, variance: Array) -> float:
    """How many times more than independent noise the residuals of similar poses push the parameters.

    The sums J'e over parts of the poses, which follow each other or have similar readings, with the residuals e of the
    fit, are compared with what independent noise of variance s2 would give; at least 1.
    """
    whole = reduce(NormalSums.plus, of_parts[0])
    inverse = scaled_inverse(whole.H + s2 * np.diag(1 / variance))
    freedom = max(1.0, whole.count - float(np.sum(inverse * whole.H)))
    # So many standard deviations of the misfit factor are taken for chance.
    chance = 2.0 * np.sqrt(2 / freedom)
    factor = 1.0
    for parts in of_parts:
        pushed = usual = 0.0
        for sums in parts:
            push, seen = sums.moved(mean).g, inverse @ sums.H
            pushed += float(push @ inverse @ push) / s2
            usual += float(np.trace(seen) - np.sum(seen * seen.T))
        if usual > 0:
            factor = max(factor, pushed / usual - chance)
    return factor


def _by_region(q: Array) -> Array:
    """A number for the region of the joints in which each pose lies: cells of equal count along two directions."""
    centred = (q - q.mean(axis=0)) / np.maximum(q.std(axis=0), 1e-9)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][:2].T
    rank = along.argsort(axis=0).argsort(axis=0) / len(q)
    across = rank[:, 1] if rank.shape[1] > 1 else np.zeros(len(q))
    return np.asarray((4 * rank[:, 0]).astype(int) * 3 + (3 * across).astype(int))
