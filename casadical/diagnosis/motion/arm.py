"""What is known of an arm that moves: its bodies and its drives, one number a joint, None where nothing is known."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from casadical.core.basics import Array
from casadical.core.drive import Drive
from casadical.robot.dynamics import Dynamics
from casadical.robot.robot import Robot

# States of which the regressor is made at a time.
AT_ONCE = 4000


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm as the diagnosis of its logs sees it.

    inertial : ten numbers a link by the file, the declared payload with the last, shape (10 n,) [SI]
    spread : what one sigma of each coordinate of the bodies does to them, shape (10 n, k)
    rotor : inertia at the joint [kg m^2], estimated where `rotor_known` is False
    per_ampere : torque at the joint by current; delay : from the logged command to the servo, filters included [s]
    """

    dynamics: Dynamics
    inertial: Array
    spread: Array
    rotor: Array
    rotor_known: bool
    per_ampere: Array | None = None
    delay: Array | None = None
    kp: Array | None = None
    kd: Array | None = None
    ki: Array | None = None
    joint_stiffness: Array | None = None
    gear_ratio: Array | None = None
    log_rate: float | None = None

    @property
    def joints(self) -> int:
        """How many."""
        return len(self.rotor)

    def regressor(self, q: Array, v: Array, a: Array) -> Array:
        """Of the bodies, shape (n, joints, 10 joints); q, v, a : shape (n, joints)."""
        out = np.empty((*q.shape, 10 * self.joints))
        for k in range(0, len(q), AT_ONCE):
            s = slice(k, k + AT_ONCE)
            out[s] = self.dynamics.regressor(q[s], v[s], a[s])[:, :, : 10 * self.joints]
        return out


@lru_cache(maxsize=4)
def arm_of(robot: Robot) -> Arm:
    """What a robot file says of an arm that moves."""
    dynamics, drive, n = Dynamics(robot), robot.drive or Drive(), robot.n
    own = slice(0, 10 * n)
    times = [t for t in (drive.of_joints(k, n) for k in ("delay", "command_filter")) if t is not None]
    return Arm(
        dynamics,
        dynamics.values[own],
        (dynamics.tangent * dynamics.sigma)[own, own],
        np.asarray(dynamics.rotors),
        drive.inertia_at_joint(n) is not None,
        drive.torque_per_ampere(n),
        sum(times[1:], times[0]) if times else None,
        log_rate=drive.log_rate_Hz,
        **{name: drive.of_joints(name, n) for name in ("kp", "kd", "ki", "joint_stiffness", "gear_ratio")},
    )
