"""Information of poses about the parameters: exact scaled Jacobians, noise, and which parameters are identifiable.

Scaled means millimetres per unit of a parameter's scale (1 mm, 1 mrad, or the deflection of 1 mrad): what `identify`
computes with.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.noise import NoiseModel
from casadical.identification.identifiability import Unidentifiable, drop_poor
from casadical.identification.least_squares import LeastSquares
from casadical.identification.prior import Prior
from casadical.identification.reduction import independent_parameters
from casadical.measurements.measurements import Measurements, Noise
from casadical.robot.robot import Robot

MM = 1e-3
# Jacobians of more poses than this are computed in parts, which keeps them from being compiled for one use.
PART = 1000


def scaled_jacobian(robot: Robot, names: Sequence[str], m: Measurements) -> Array:
    """Jacobian of the positions by these parameters, at the robot's values, shape (n, 3, p) [mm per unit of scale]."""
    parts = [m[np.arange(start, min(start + PART, len(m)))] for start in range(0, len(m), PART)]
    problems = (LeastSquares(robot, (part,), tuple(names), "linear", False, ((MM, MM),)) for part in parts)
    jacobians = [problem.evaluate(np.zeros(len(names)))[1] for problem in problems]
    return np.asarray(np.concatenate(jacobians).reshape(len(m), 3, -1))


@lru_cache(maxsize=16)
def _by_joints(robot: Robot) -> ca.Function:
    """by_joints:(q, w, phi)->(J[3, n]), the point's derivative by the joint variables."""
    model = robot.model
    J = ca.densify(ca.jacobian(model.p, model.q))
    return ca.Function("by_joints", [model.q, model.w, model.phi], [J], ["q", "w", "phi"], ["J"])


def by_joints(robot: Robot, m: Measurements) -> Array:
    """Derivative of the position by the joint variables, shape (n, 3, joints) [m/rad or 1]."""
    w = m.condition_matrix(robot.conditions, robot.declared)
    J = _by_joints(robot).map(len(m))(m.q.T, w.T, robot.parameters.values).full()
    return np.asarray(J.reshape(3, len(m), robot.n).transpose(1, 0, 2))


def noise_covariance(robot: Robot, m: Measurements, noise: Noise) -> Array:
    """Covariance of each measured point, shape (n, 3, 3) [mm^2], from the instrument and the joints' repeatability."""
    joints = {"repeatability": by_joints(robot, m)} if noise.repeatability else {}
    ratios = dict.fromkeys(joints, noise.repeatability / MM)
    return NoiseModel((len(m), 3), joints).covariance(ratios, noise.sigma / MM)


def independent(
    robot: Robot,
    names: Sequence[str],
    sets: Sequence[Measurements],
    information: Callable[[Sequence[str]], Array],
    prior: Prior | None = None,
) -> tuple[tuple[str, ...], tuple[Unidentifiable, ...]]:
    """Names that an identification from poses like these would keep, and the others with the reason.

    First the independent ones; then, one by one, those are held that the data would determine less accurately than the
    prior (as in `reduction.reduce_and_solve`); none with the prior of another campaign, which holds them back.
    sets : what would be measured at some of them
    information : of such names, and of unknown points behind them, in units of scale. Raises InputError: none is left.
    """
    problem = LeastSquares(robot, tuple(sets), tuple(names), "linear", False, ((MM, MM),) * len(sets))
    analysis = independent_parameters(problem)
    kept = list(analysis.independent)
    if prior is not None:
        return tuple(kept), analysis.held
    left, poor, _ = drop_poor([robot.parameters[n] for n in kept], information(kept))
    if not left:
        raise InputError(f"{robot.name}: poses like these determine none of {', '.join(names)}; free other parameters")
    return tuple(kept[k] for k in left), (*analysis.held, *poor)


def known_before(robot: Robot, names: Sequence[str], prior: Prior | None, size: int = 0) -> Array:
    """Information of priors on these parameters, as `identify` takes it, in units of scale, shape (size, size)."""
    means, known = (prior.means, prior.known) if prior is not None else (False, ())
    matrix = LeastSquares(robot, (), tuple(names), "linear", means, (), known=known).prior_matrix
    return np.pad(matrix, (0, max(0, size - len(names))))
