"""Parameters in which the remaining errors of a calibrated robot are expressed."""

from casadical.core.basics import InputError
from casadical.effects import JointErrorCurve
from casadical.effects.joint_error_curve import TYPICAL_HARMONIC_RAD
from casadical.robot.robot import RemainingErrors, Robot


def with_joint_harmonics(robot: Robot, orders: int = 1) -> Robot:
    """Return the robot with one added effect: harmonics of each revolute joint's error, all zero.

    Joint error curves that it had, and its remaining errors with them, are removed.

    orders : highest harmonic; their prior standard deviation is TYPICAL_HARMONIC_RAD [rad]
    """
    spread = tuple(TYPICAL_HARMONIC_RAD * (j in robot.revolute) for j in robot.numbers)
    bare = robot.with_only(e for e in robot.effects if not isinstance(e, JointErrorCurve))
    return bare.with_effect(JointErrorCurve(None, spread, orders=orders))


def refuse_other(robot: Robot, remaining: RemainingErrors) -> None:
    """Refuse remaining errors with parameters that the robot lacks. Raises InputError."""
    allowed = with_joint_harmonics(robot).parameters.names
    for name in remaining.names:
        if name not in allowed:
            raise InputError(f"remaining: no parameter {name!r}; there are {', '.join(allowed)}")
