"""Elements between a joint's command and its link in MuJoCo: springs for compliances, counterparts of effects."""

import numpy as np

from casadical.core.arrays import Array
from casadical.effects.counterparts import Counterparts, Drive
from casadical.robot.robot import Robot


def counterparts(robot: Robot) -> Counterparts:
    """Springs for the compliances, then what each effect has for a counterpart; `left_out` names those without one."""
    drives = tuple(Drive(compliance=j.compliance or 0.0) for j in robot.joints)
    scale = robot.torque_scale
    load = _mean_torque(robot) / scale if robot.effects else np.zeros(robot.n)
    moment = float(max((scale[j - 1] for j in robot.revolute), default=scale.max()))
    found = Counterparts(drives, scale, load, moment, tuple(j.body for j in robot.joints), robot.payload)
    # Linear springs first: others bend around them.
    for effect in sorted(robot.effects, key=lambda e: not e.simulated_first):
        found = effect.counterpart(found, effect.own_values(robot.effect_values))
    return found


def _mean_torque(robot: Robot) -> Array:
    """Mean size of each joint's gravity torque over its range, shape (n,) [N m or N]."""
    bare = robot.with_only(())
    lower, upper = robot.limits
    q = np.random.default_rng(0).uniform(lower, upper, (256, robot.n))
    tau: Array = bare.torque.map(256)(q.T, bare.parameters.values).full()
    return np.array([np.nanmean(np.abs(row)) for row in tau])
