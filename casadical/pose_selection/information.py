"""Information of poses about the parameters: exact scaled Jacobians, noise, identifiability.

Scaled means millimetres per unit of a parameter's scale (1 mm, 1 mrad, a deflection of 1 mrad).
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import casadi as ca
import numpy as np

from casadical.core.basics import M_PER_MM, Array, InputError
from casadical.core.linear_gaussian.noise import NoiseModel
from casadical.identification.identifiability import Unidentifiable, drop_poor
from casadical.identification.least_squares import LeastSquares
from casadical.identification.prior import Prior
from casadical.identification.reduction import independent_parameters
from casadical.measurements.measurements import Measurements, Noise
from casadical.robot.robot import Robot

# Largest number of poses whose Jacobians are computed at a time: larger problems would be compiled
# for a single use. As many candidates show which parameters are identifiable.
MAX_POSES_PER_PART = 1000


def scaled_jacobian(robot: Robot, names: Sequence[str], m: Measurements) -> Array:
    """Return the Jacobian of the measured point by p parameters, shape (n, 3, p).

    It is taken at the robot's values, in the measuring frame, in mm per unit of scale.

    names : the p parameters; m : poses, whose measured values do not count
    """
    parts = [
        m[np.arange(start, min(start + MAX_POSES_PER_PART, len(m)))] for start in range(0, len(m), MAX_POSES_PER_PART)
    ]
    problems = (LeastSquares(robot, (part,), tuple(names), "linear", False, ((M_PER_MM, M_PER_MM),)) for part in parts)
    jacobians = [problem.evaluate(np.zeros(len(names)))[1] for problem in problems]
    return np.asarray(np.concatenate(jacobians).reshape(len(m), 3, -1))


@lru_cache(maxsize=16)
def _joint_jacobian(robot: Robot) -> ca.Function:
    """Return the CasADi function (q, w, phi) -> J[3, n]: the point's derivative by joint variables.

    w are conditions of a pose, phi the parameters; J is in m/rad or m/m, in the measuring frame.
    """
    model = robot.model
    J = ca.densify(ca.jacobian(model.p, model.q))
    return ca.Function("by_joints", [model.q, model.w, model.phi], [J], ["q", "w", "phi"], ["J"])


def joint_jacobian(robot: Robot, m: Measurements) -> Array:
    """Return the derivative of the measured point by the joint variables, shape (n, 3, joints).

    It is in the measuring frame [m/rad or m/m].
    """
    w = m.condition_matrix(robot.conditions, robot.declared)
    J = _joint_jacobian(robot).map(len(m))(m.q.T, w.T, robot.parameters.values).full()
    return np.asarray(J.reshape(3, len(m), robot.n).transpose(1, 0, 2))


def noise_covariance(robot: Robot, m: Measurements, noise: Noise) -> Array:
    """Return the noise covariance of each measured point, shape (n, 3, 3) [mm^2].

    It is the sum of the instrument's and of the joint repeatability's, in the measuring frame.
    """
    joints = {"repeatability": joint_jacobian(robot, m)} if noise.repeatability else {}
    ratios = dict.fromkeys(joints, noise.repeatability / M_PER_MM)
    return NoiseModel((len(m), 3), joints).covariance(ratios, noise.sigma / M_PER_MM)


def independent(
    robot: Robot,
    names: Sequence[str],
    sets: Sequence[Measurements],
    information: Callable[[Sequence[str]], Array],
    prior: Prior | None = None,
) -> tuple[tuple[str, ...], tuple[Unidentifiable, ...]]:
    """Return the parameters that an identification from such poses would keep, and the others.

    The others have their reasons. Dependent parameters are omitted first, then, one by one, those
    that the data would determine less accurately than their own priors (as in
    `reduction.reduce_and_solve`). With the prior of another campaign, which constrains them, the
    second step is omitted.

    names : parameters to choose from
    sets : measurements at some of the poses
    information : function from names of k parameters to their information matrix, shape (k + u,
        k + u), in units of scale; u coordinates of unknown points are at its end
    prior : prior of another campaign
    Raises InputError: no parameter remains.
    """
    problem = LeastSquares(robot, tuple(sets), tuple(names), "linear", False, ((M_PER_MM, M_PER_MM),) * len(sets))
    analysis = independent_parameters(problem)
    identifiable = list(analysis.independent)
    if prior is not None:
        return tuple(identifiable), analysis.unidentifiable
    determined, poor, _ = drop_poor([robot.parameters[n] for n in identifiable], information(identifiable))
    if not determined:
        raise InputError(f"{robot.name}: poses like these determine none of {', '.join(names)}; free other parameters")
    return tuple(identifiable[k] for k in determined), (*analysis.unidentifiable, *poor)


def prior_information(robot: Robot, names: Sequence[str], prior: Prior | None, size: int = 0) -> Array:
    """Return the prior information matrix of parameters, shape (size, size), in units of scale.

    It is that which `identify` uses; rows and columns beyond the parameters are zero.

    names : the parameters; prior : prior of another campaign
    size : number of all variables; less than the number of parameters: that number
    """
    means, covariances = (prior.means, prior.covariances) if prior is not None else (False, ())
    matrix = LeastSquares(robot, (), tuple(names), "linear", means, (), correlated=covariances).prior_matrix
    return np.pad(matrix, (0, max(0, size - len(names))))
