"""The errors that a calibrated robot may still have, in terms of its parameters and of its joints."""

from casadical.core.basics import InputError
from casadical.effects import JointErrorCurve
from casadical.effects.joint_error_curve import TYPICAL_HARMONIC_RAD
from casadical.robot.robot import RemainingErrors, Robot


def doubted(robot: Robot, orders: int = 1) -> Robot:
    """Return the robot with the first harmonics of each turning joint's error beside its own parameters."""
    spread = tuple(TYPICAL_HARMONIC_RAD * (j in robot.revolute) for j in robot.numbers)
    bare = robot.with_only(e for e in robot.effects if not isinstance(e, JointErrorCurve))
    return bare.with_effect(JointErrorCurve(None, spread, orders=orders))


def refuse_other(robot: Robot, remaining: RemainingErrors) -> None:
    """Raises InputError where the robot lacks a parameter, and so is not the one that the errors were learnt of."""
    known = doubted(robot).parameters.names
    for name in remaining.names:
        if name not in known:
            raise InputError(f"remaining: no parameter {name!r}; there are {', '.join(known)}")
