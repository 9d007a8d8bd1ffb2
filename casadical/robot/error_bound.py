"""A bound of the error that a calibrated robot still has, pose by pose.

The robot departs from its model by unknown errors x of its parameters and of each joint's first harmonic, which no
calibration identifies. They move the measured point by J(q) x; with the second moment M of x the mean square of the
distance is rest^2 + tr(J M J'), and the bound is that times a factor, taken from poses that were held out: split
conformal prediction with a scale of its own (Lei et al. 2018, section 5.2). Away from the measured poses J M J' grows.
"""

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.effects import JointErrorCurve
from casadical.effects.joint_error_curve import USUAL
from casadical.robot.robot import ErrorBound, Robot

_DIGITS = 6  # of the numbers of a bound's factor
_SAMPLES, _SAME = 200, 1e-9  # poses at which columns are compared, and what is left of those that others make up


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


def bound_function(robot: Robot, bound: ErrorBound, torque: ca.Function | None = None) -> ca.Function:
    """bound:(q[n] rad or m)->(b[1] mm): 95 % of the robot's errors at q are below b.

    robot : the one that the bound was learnt of; it may carry another load and another tool
    torque : q -> its gravity torques, where they are computed already; None: by its own model
    Raises InputError where the robot lacks a parameter.
    """
    refuse_other(robot, bound)
    q = ca.SX.sym("q", robot.n)
    J = _slopes(
        doubted(robot), bound.names, q, robot.torque(q, robot.parameters.values) if torque is None else torque(q)
    )
    kept, factor = _independent(ca.Function("J", [q], [J]), robot.limits, bound.factor)
    x = ca.SX.sym("x", len(kept))
    # called, so that an export can write a loop over a matrix instead of thousands of operations
    weighed = ca.Function("weighed", [x], [ca.mtimes(_triangle(factor), x)], {"never_inline": True})
    size = 1e3 * bound.times * ca.sqrt(bound.rest**2 + sum(ca.sumsqr(weighed(J[i, kept].T)) for i in range(3)))
    return ca.Function("bound", [q], [ca.densify(size)], ["q"], ["bound_mm"])


def _independent(J: ca.Function, limits: tuple[Array, Array], factor: Array) -> tuple[list[int], Array]:
    """Columns of J:(q)->(3, k) that make up all others wherever the robot is, and the factor for these alone.

    The first row moves the arm as the base does, the last one the point as the tool does.
    """
    q = np.random.default_rng(0).uniform(*limits, (_SAMPLES, len(limits[0])))
    columns = J.map(_SAMPLES)(q.T).full().reshape(3, _SAMPLES, -1)
    columns = columns[:, np.isfinite(columns).all(axis=(0, 2))].reshape(-1, columns.shape[2])
    scale = np.linalg.norm(columns, axis=0)
    kept: list[int] = []
    factor = factor.copy()
    for k, size in enumerate(scale):
        share = np.linalg.lstsq(columns[:, kept] / scale[kept], columns[:, k] / (size or 1.0), rcond=None)[0]
        share[abs(share) < _SAME] = 0.0
        if np.linalg.norm(columns[:, k] / (size or 1.0) - columns[:, kept] / scale[kept] @ share) > _SAME:
            kept.append(k)
        else:
            factor[kept] += np.outer(share * size / scale[kept], factor[k])
    return kept, factor[kept]


def _triangle(factor: Array) -> ca.DM:
    """R with R' R = F F', zero below its diagonal, with so many digits as a bound can use."""
    R = np.linalg.qr(factor.T, mode="r")
    return ca.DM(np.array([[float(f"{v:.{_DIGITS}g}") for v in row] for row in R]))


def _slopes(robot: Robot, names: Sequence[str], q: ca.SX, tau: ca.SX) -> ca.SX:
    """How the measured point moves with parameters, shape (3, k) [m a unit]; tau : gravity torques, shape (n,).

    That of the geometry is that of a rigid arm at the readings to which gravity bends this one: what an error of a
    length changes of the loads is less by the ratio of the deflection to the arm, a hundredth at most.
    """
    rigid = robot.with_only(e for e in robot.effects if isinstance(e, JointErrorCurve))
    rigid = replace(rigid, joints=tuple(replace(j, compliance=None) for j in rigid.joints))
    soft = {i: j.compliance for i, j in enumerate(robot.joints) if j.compliance is not None}
    bent = q + ca.vertcat(*[soft.get(i, 0.0) * tau[i] for i in range(robot.n)])
    x, columns = ca.SX.sym("x", robot.n), dict[str, ca.SX]()
    turned = ca.jacobian(rigid.position(x, rigid.parameters.values), x)
    turned = ca.substitute(turned, x, bent)
    columns |= {f"c{i + 1}": turned[:, i] * tau[i] for i in soft}
    for arm, at in ((rigid, bent), (robot, q)):
        own = [name for name in names if name in arm.parameters.names and name not in columns]
        phi = ca.SX.sym("phi", len(arm.parameters.values))
        J = ca.jacobian(arm.position(at, phi), phi)[:, [arm.parameters.index_of(name) for name in own]]
        J = ca.densify(ca.substitute(J, phi, ca.DM(arm.parameters.values)))
        columns |= dict(zip(own, ca.horzsplit(J) if own else [], strict=True))
    return ca.densify(ca.horzcat(*[columns[name] for name in names]))


def bound_at(robot: Robot, q: Array) -> Array:
    """The robot's bound, shape (k,) [m], at readings q, (k, n) [rad or m]. Raises InputError where it has none."""
    if robot.bound is None:
        raise InputError(
            f"{robot.name}: the error that remains has no bound; `casadical calibrate` writes one into the robot file"
        )
    return np.asarray(1e-3 * bound_function(robot, robot.bound).map(len(q))(q.T).full()[0])
