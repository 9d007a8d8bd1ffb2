"""Learns the errors that may remain after an identification (see `casadical.robot.robot.RemainingErrors`).

Their second moment is that of their posterior, mean included, given the residuals: parameters have
the robot's priors, the first harmonic of each joint a prior size that the residuals show (Tipping
2001, by expectation and maximisation).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.normal_equations import NormalSums, normal_sums
from casadical.identification.identifiability import scaled_inverse
from casadical.identification.reduction import TELLING
from casadical.identification.residuals import make_block
from casadical.identification.result import Identification
from casadical.measurements.measurements import Measurements, unmeasured
from casadical.robot.remaining_errors import doubted
from casadical.robot.robot import RemainingErrors, Robot

LEAST = 30  # poses; fewer do not tell what no parameter explains
# What no instrument falls short of at a coordinate [mm]; poses that were made up without noise do.
EXACT = 1e-3
MOST = 20_000  # poses: so many, drawn at random, tell the errors as well as more, in less memory
ROUNDS = 12  # of expectation and maximisation: sizes that the poses do not determine are still of usual size then
_MM = 1e-3


@dataclass(frozen=True, eq=False)
class Doubts:
    """What may be off: parameters by name, one sigma of each in solver units, indices of those that are identified.

    joints : indices of the harmonics of each joint, whose size is estimated
    """

    names: tuple[str, ...]
    sigma: Array
    solved: Array
    joints: tuple[Array, ...]


def learn_remaining(found: Identification, most: int = MOST) -> RemainingErrors:
    """Return the errors that remain, from the poses with a measured position that were used.

    most : poses, drawn at random from more
    Raises InputError where they are too few, nothing measured a position, or error curves were
    identified.
    """
    sets = [m.positions_alone() for m in found.used if m.position is not None]
    poses = sum(map(len, sets))
    if poses < LEAST:
        raise InputError(f"the errors that remain need {LEAST} poses with a measured position; there are {poses}")
    if poses > most:
        share = most / poses
        sets = [m.split({"some": share})["some"] for m in sets if share * len(m) >= 1]
        poses = sum(map(len, sets))
    robot = doubted(found.robot)
    gone = [n for n in found.names if n not in robot.parameters.names]
    if gone:
        raise InputError(f"the errors that remain cannot hold the curve that {gone[0]} is part of")
    doubts = doubts_of(robot, found.names)
    r, J = evaluated(robot, sets, doubts.names)
    whole = normal_sums(r, J)
    s2, mean, S, _ = posterior_of(whole, doubts)
    M = np.outer(mean, mean) + S
    # Random poses within the joint limits at which the cut factor holds, where the robot has a pose.
    q = np.random.default_rng(0).uniform(*robot.limits, (500, robot.n))
    anywhere = evaluated(robot, [unmeasured(q)], doubts.names)[1]
    anywhere = anywhere[np.isfinite(anywhere).all(axis=(1, 2))]
    factor = _cut(M, 3 * s2, np.concatenate([J, anywhere]))
    scale = np.array([robot.parameters[n].scale for n in doubts.names])
    return RemainingErrors(doubts.names, scale[:, None] * factor, float(_MM * np.sqrt(3 * s2)), poses)


def doubts_of(robot: Robot, solved: Sequence[str]) -> Doubts:
    names = tuple(p.name for p in robot.parameters if p.prior > 0)
    curve = robot.effects[-1]
    own = [f"{curve.label}.{name}" for name in curve.sizes()]
    return Doubts(
        names,
        np.array([robot.parameters[n].prior / robot.parameters[n].scale for n in names]),
        np.array([names.index(n) for n in solved], dtype=int),
        tuple(np.array([names.index(own[k]) for k in part]) for part in curve.parts.values()),
    )


def evaluated(robot: Robot, sets: Iterable[Measurements], names: tuple[str, ...]) -> tuple[Array, Array]:
    """Residuals, shape (n, 3) [mm], and Jacobians, shape (n, 3, k) [mm a unit of solver scale]."""
    none = np.zeros((0, 3))
    blocks = (make_block(robot, m, names, _MM, 1.0, none, np.zeros(len(m), dtype=int)) for m in sets)
    both = zip(*(block.evaluate(np.zeros(len(names)), none) for block in blocks), strict=True)
    r, J = map(np.concatenate, both)
    return r, J


def posterior_of(sums: NormalSums, doubts: Doubts, rounds: int = ROUNDS) -> tuple[float, Array, Array, Array]:
    """Variance of a coordinate that nothing explains [mm^2]; mean, shape (k,), covariance, and prior variances.

    Few poses leave less than TELLING degrees of freedom: those that miss have the variance that the
    identified parameters alone leave. Otherwise all would be explained, and the poses be taken for
    exact; so no less than EXACT.
    """
    s2 = max(float(sums.square / sums.count), EXACT**2)
    alone: float = sums.square / max(1, sums.count - len(doubts.solved))
    variance = doubts.sigma**2
    mean, S = np.zeros(len(variance)), np.zeros((len(variance), len(variance)))
    for _ in range(rounds):
        S = scaled_inverse(sums.H / s2 + np.diag(1 / variance))
        mean = -S @ sums.g / s2
        known = len(variance) - float(np.sum(np.diag(S) / variance))
        left = float(sums.square + 2 * mean @ sums.g + mean @ sums.H @ mean)
        missing = max(0.0, TELLING - (sums.count - known))
        s2 = max((left + missing * alone) / (sums.count - known + missing), EXACT**2)
        for joint in doubts.joints:
            variance[joint] = np.mean(mean[joint] ** 2 + np.diag(S)[joint])
    return s2, mean, S, variance


def _spread(J: Array, M: Array) -> Array:
    """tr(J M J') of each pose."""
    return np.asarray(np.einsum("nip,pq,niq->n", J, M, J, optimize=True))


def _cut(M: Array, rest: float, J: Array) -> Array:
    """A factor of M with as few columns as keep all but five per cent of each pose's mean square."""
    scale = np.sqrt(np.diag(M))
    values, V = np.linalg.eigh(M / np.outer(scale, scale))
    whole = scale[:, None] * V * np.sqrt(np.maximum(values, 0.0))
    moved = J @ whole
    _, _, turn = np.linalg.svd(np.linalg.qr(moved.reshape(-1, moved.shape[2]), mode="r"))
    squares = np.cumsum(((moved @ turn.T) ** 2).sum(axis=1), axis=1)
    # share of the mean square that may be lost at a pose where the factor of the moment is cut
    enough = (squares[:, -1:] - squares <= 0.05 * (rest + squares[:, -1:])).all(axis=0)
    factor = np.asarray(whole @ turn.T[:, : int(np.argmax(enough)) + 1])
    # Columns that the svd leaves free in sign: the greatest entry is positive. Behind some digits
    # is rounding, and so is the sign of a zero.
    factor = factor * np.sign(np.take_along_axis(factor, np.abs(factor).argmax(axis=0)[None], 0))
    # of a factor, behind the first one of its greatest entry: more were a processor's rounding
    return np.asarray(factor.round(4 - math.floor(math.log10(np.abs(factor).max() or 1.0))) + 0.0)
