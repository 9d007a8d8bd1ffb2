"""Remaining errors of a calibrated robot, estimated from the residuals of its identification.

The result is the second moment of their posterior, mean included, given the residuals (see
`casadical.robot.robot.RemainingErrors`). Parameters have the robot's priors, the first harmonic of
each joint a prior standard deviation that the residuals determine (Tipping 2001, by expectation
maximisation).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from casadical.core.basics import M_PER_MM, Array, InputError
from casadical.core.linear_gaussian.normal_equations import NormalSums, normal_sums, scaled_inverse
from casadical.identification.reduction import MIN_NOISE_FREEDOM
from casadical.identification.residuals import make_block
from casadical.identification.result import Identification
from casadical.measurements.measurements import Measurements, unmeasured
from casadical.robot.robot import RemainingErrors, Robot, with_joint_harmonics

# Number of iterations of expectation maximisation; prior variances that the poses do not determine
# are still near their initial values then.
EM_ITERATIONS = 12


@dataclass(frozen=True, eq=False)
class UncertainParameters:
    """Parameters that are uncertain, identified or not, with their priors.

    names : of the k parameters
    sigma : prior standard deviation of each in units of its scale, shape (k,)
    solved : indices of those that were identified, shape (s,)
    joints : groups of indices of joint harmonics; each group has one prior variance, estimated from
        the residuals
    """

    names: tuple[str, ...]
    sigma: Array
    solved: Array
    joints: tuple[Array, ...]


def learn_remaining(found: Identification, most: int = 20_000) -> RemainingErrors:
    """Return the remaining errors of a calibrated robot, from the used poses with positions.

    most : approximate maximum number of poses, drawn at random; more only need more memory
    Raises InputError: fewer than 30 poses, or error curves were identified.
    """
    sets = [m.positions_alone() for m in found.used if m.position is not None]
    poses = sum(map(len, sets))
    # Fewer poses do not show the errors that no parameter explains.
    if poses < 30:
        raise InputError(f"the errors that remain need 30 poses with a measured position; there are {poses}")
    if poses > most:
        share = most / poses
        sets = [m.split({"some": share})["some"] for m in sets if share * len(m) >= 1]
        poses = sum(map(len, sets))
    robot = with_joint_harmonics(found.robot)
    gone = [n for n in found.names if n not in robot.parameters.names]
    if gone:
        raise InputError(f"the errors that remain cannot hold the curve that {gone[0]} is part of")
    doubts = uncertain_parameters_of(robot, found.names)
    r, J = residuals_and_jacobian(robot, sets, doubts.names)
    whole = normal_sums(r, J)
    s2, mean, S, _ = posterior_of(whole, doubts)
    M = np.outer(mean, mean) + S
    # The truncated factor also holds at random poses within the joint limits, where they exist.
    q = np.random.default_rng(0).uniform(*robot.limits, (500, robot.n))
    anywhere = residuals_and_jacobian(robot, [unmeasured(q)], doubts.names)[1]
    anywhere = anywhere[np.isfinite(anywhere).all(axis=(1, 2))]
    factor = _truncated_factor(M, 3 * s2, np.concatenate([J, anywhere]))
    scale = np.array([robot.parameters[n].scale for n in doubts.names])
    return RemainingErrors(doubts.names, scale[:, None] * factor, float(M_PER_MM * np.sqrt(3 * s2)), poses)


def uncertain_parameters_of(robot: Robot, solved: Sequence[str]) -> UncertainParameters:
    """Return all parameters of a robot that have a prior width, as uncertain parameters.

    robot : its last effect is the curve of joint harmonics (`with_joint_harmonics`)
    solved : names of those that were identified
    """
    names = tuple(p.name for p in robot.parameters if p.prior > 0)
    curve = robot.effects[-1]
    own = [f"{curve.label}.{name}" for name in curve.sizes()]
    return UncertainParameters(
        names,
        np.array([robot.parameters[n].prior / robot.parameters[n].scale for n in names]),
        np.array([names.index(n) for n in solved], dtype=int),
        tuple(np.array([names.index(own[k]) for k in part]) for part in curve.parts.values()),
    )


def residuals_and_jacobian(robot: Robot, sets: Iterable[Measurements], names: tuple[str, ...]) -> tuple[Array, Array]:
    """Return position residuals of all sets, shape (n, 3) [mm], and their Jacobian, (n, 3, k).

    Residuals are computed minus measured positions in the measuring frame, times the root of the
    pose's weight; the Jacobian is in mm per unit of a parameter's scale.

    sets : measurements of the poses, n in all; names : the k parameters
    """
    none = np.zeros((0, 3))
    blocks = (make_block(robot, m, names, M_PER_MM, 1.0, none, np.zeros(len(m), dtype=int)) for m in sets)
    both = zip(*(block.evaluate(np.zeros(len(names)), none) for block in blocks), strict=True)
    r, J = map(np.concatenate, both)
    return r, J


def posterior_of(
    sums: NormalSums, doubts: UncertainParameters, rounds: int = EM_ITERATIONS
) -> tuple[float, Array, Array, Array]:
    """Return noise variance, posterior mean and covariance, and prior variances of parameters.

    The first is the noise variance of a coordinate [mm^2]; the others are in units of the
    parameters' scales, with shapes (k,), (k, k) and (k,). Few poses leave fewer than
    MIN_NOISE_FREEDOM degrees of freedom: the missing ones get the variance of the residuals of the
    identified parameters alone. Otherwise all residuals would be explained, and the poses be taken
    as exact, down to a micrometre.

    sums : normal equations of all parameters [mm]; rounds : number of iterations of expectation
        maximisation
    """
    least = 1e-3  # noise of a coordinate [mm], below any instrument's; simulated poses may have none
    s2 = max(float(sums.square / sums.count), least**2)
    alone: float = sums.square / max(1, sums.count - len(doubts.solved))
    variance = doubts.sigma**2
    mean, S = np.zeros(len(variance)), np.zeros((len(variance), len(variance)))
    for _ in range(rounds):
        S = scaled_inverse(sums.H / s2 + np.diag(1 / variance))
        mean = -S @ sums.g / s2
        determined = len(variance) - float(np.sum(np.diag(S) / variance))
        square = float(sums.moved(mean).square)
        missing = max(0.0, MIN_NOISE_FREEDOM - (sums.count - determined))
        s2 = max((square + missing * alone) / (sums.count - determined + missing), least**2)
        for joint in doubts.joints:
            variance[joint] = np.mean(mean[joint] ** 2 + np.diag(S)[joint])
    return s2, mean, S, variance


def _mean_squares(J: Array, M: Array) -> Array:
    """Return tr(J M J') of each pose, shape (n,); J : shape (n, rows, k), M : (k, k)."""
    return np.asarray(np.einsum("nip,pq,niq->n", J, M, J, optimize=True))


def _truncated_factor(M: Array, rest: float, J: Array) -> Array:
    """Return F, shape (k, r), with M nearly F F' and the fewest columns r.

    At every pose at most 5 % of the mean square error tr(J M J') + rest is lost.

    M : second moment of the parameters in units of scale, shape (k, k)
    rest : mean square error of a pose that no parameter explains [mm^2]
    J : Jacobians of the poses by the parameters, shape (n, 3, k) [mm]
    """
    scale = np.sqrt(np.diag(M))
    values, V = np.linalg.eigh(M / np.outer(scale, scale))
    whole = scale[:, None] * V * np.sqrt(np.maximum(values, 0.0))
    moved = J @ whole
    _, _, turn = np.linalg.svd(np.linalg.qr(moved.reshape(-1, moved.shape[2]), mode="r"))
    squares = np.cumsum(((moved @ turn.T) ** 2).sum(axis=1), axis=1)
    # The truncation may lose 5 % of the mean square at a pose.
    enough = (squares[:, -1:] - squares <= 0.05 * (rest + squares[:, -1:])).all(axis=0)
    factor = np.asarray(whole @ turn.T[:, : int(np.argmax(enough)) + 1])
    # The sign of a column is arbitrary in a singular value decomposition: its largest entry is made
    # positive.
    factor = factor * np.sign(np.take_along_axis(factor, np.abs(factor).argmax(axis=0)[None], 0))
    # Further digits depend on the rounding of the processor; adding zero removes the sign of zeros.
    return np.asarray(factor.round(4 - math.floor(math.log10(np.abs(factor).max() or 1.0))) + 0.0)
