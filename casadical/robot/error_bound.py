"""A bound of the error that a calibrated robot still has, pose by pose.

The robot departs from its model by unknown errors x of its parameters and of each joint's first harmonic, which no
calibration identifies. They move the measured point by J(q) x; with the second moment M of x the mean square of the
distance is rest^2 + tr(J M J'), and the bound is that times a factor, taken from poses that were held out: split
conformal prediction with a scale of its own (Lei et al. 2018, section 5.2). Away from the measured poses J M J' grows.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.effects import JointErrorCurve
from casadical.effects.joint_error_curve import USUAL
from casadical.robot.knowledge import ErrorBound
from casadical.robot.robot import Robot


def doubted(robot: Robot, orders: int = 1) -> Robot:
    """The robot with what a bound doubts beside its parameters: the first harmonics of each turning joint's error."""
    spread = tuple(USUAL * (j in robot.revolute) for j in robot.numbers)
    bare = robot.with_only(e for e in robot.effects if not isinstance(e, JointErrorCurve))
    return bare.with_effect(JointErrorCurve(None, spread, orders=orders))


def refuse_other(robot: Robot, bound: ErrorBound) -> None:
    """Raises InputError where the robot lacks a parameter, and so is not the one that the bound was learnt of."""
    known = doubted(robot).parameters.names
    for name in bound.names:
        if name not in known:
            raise InputError(f"bound: no parameter {name!r}; there are {', '.join(known)}")


def bound_function(robot: Robot, bound: ErrorBound) -> ca.Function:
    """bound:(q[n] rad or m)->(b[1] mm): 95 % of the robot's errors at q are below b.

    robot : the one that the bound was learnt of; it may carry another load and another tool
    Raises InputError where the robot lacks a parameter.
    """
    refuse_other(robot, bound)
    other = doubted(robot)
    q, phi = ca.SX.sym("q", robot.n), ca.SX.sym("phi", len(other.parameters.values))
    J = ca.jacobian(other.position(q, phi), phi)[:, [other.parameters.index_of(name) for name in bound.names]]
    J = ca.densify(ca.substitute(J, phi, ca.DM(other.parameters.values)))
    x = ca.SX.sym("x", len(bound.names))
    # called, so that an export can write a loop over a matrix instead of thousands of operations
    weighed = ca.Function("weighed", [x], [ca.mtimes(ca.DM(bound.factor).T, x)], {"never_inline": True})
    size = 1e3 * bound.times * ca.sqrt(bound.rest**2 + sum(ca.sumsqr(weighed(J[i, :].T)) for i in range(3)))
    return ca.Function("bound", [q], [ca.densify(size)], ["q"], ["bound_mm"])


def bound_at(robot: Robot, q: Array) -> Array:
    """The bound of a robot that has one, at readings q, shape (k, n) [rad or m]; shape (k,) [m].

    Raises InputError for a robot without a bound.
    """
    if robot.bound is None:
        raise InputError(
            f"{robot.name}: the error that remains has no bound; `casadical calibrate` writes one into the robot file"
        )
    return np.asarray(1e-3 * bound_function(robot, robot.bound).map(len(q))(q.T).full()[0])
