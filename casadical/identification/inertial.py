"""Inertial parameters from a joint log with torques: which ones it determines, and contradictions.

Contradictions are those between the log and the arm's model. Dependent columns of the torque
regressor along the logged motion are found as those of a pose model are (`identifiability`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import lacks_masses
from casadical.core.statistics import best_of
from casadical.identification.identifiability import Identifiability, analyse
from casadical.measurements.logs.log import JointLog
from casadical.robot.dynamics import Dynamics
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class States:
    """Joint states of a log with their torques, shape (N, joints) each.

    q, v, a : positions, velocities and accelerations [rad or m, per s, per s^2]
    tau : torques [N m or N] or motor currents [A]
    """

    q: Array
    v: Array
    a: Array
    tau: Array

    def turned(self, joint: int, *, torque_alone: bool = False) -> "States":
        """Return the states with the sign of one joint's motion and torque reversed.

        joint : index, from 0; torque_alone : whether the torque alone is reversed
        """
        sign = np.where(np.arange(self.q.shape[1]) == joint, -1.0, 1.0)
        q, v, a = (each if torque_alone else sign * each for each in (self.q, self.v, self.a))
        return States(q, v, a, sign * self.tau)

    def swapped(self, first: int, second: int) -> "States":
        """Return the states with the columns of two joints (indices from 0) exchanged."""
        order = np.arange(self.q.shape[1])
        order[[first, second]] = second, first
        return States(*(each[:, order] for each in (self.q, self.v, self.a, self.tau)))


def states_of(log: JointLog) -> States | None:
    """Return at most 1,000 states of a log, evenly spaced, each with the mean torque of its window.

    None without signed torques or currents, or with too few states. States are those at the middle
    of windows, by the least squares parabola through the positions.
    """
    torque = log.torque if log.torque is not None else None if log.current_unsigned else log.current
    if torque is None:
        return None
    # Positions, speeds and accelerations are those of parabolas fitted over windows of 0.15 s.
    half = max(2, round(0.15 / max(log.step, 1e-9) / 2))
    t = np.arange(-half, half + 1) * log.step
    fit = np.linalg.pinv(np.vander(t, 3, increasing=True)) * np.array([[1.0], [1.0], [2.0]])
    centres = np.arange(half, len(log) - half)
    spans = log.time[centres + half] - log.time[centres - half]
    whole = (log.run[centres + half] == log.run[centres - half]) & (np.abs(spans / (2 * half * log.step) - 1) < 0.1)
    centres = centres[whole]
    centres = centres[:: max(1, len(centres) // 500)]
    if not len(centres):
        return None
    rows = centres[:, None] + np.arange(-half, half + 1)
    q, v, a = np.einsum("dk,nkj->dnj", fit, log.position[rows])
    tau = torque[rows].mean(axis=1)
    good = np.isfinite(np.hstack([q, tau])).all(axis=1)
    return States(q[good], v[good], a[good], tau[good]) if good.sum() > 20 else None


def determined(robot: Robot, log: JointLog) -> Identifiability | None:
    """Return which inertial parameters (names of `Dynamics`) the motion in a log determines.

    None without signed torques or currents, or with too few states. Each joint also has an offset,
    Coulomb and viscous friction, as every drive does. The parameters of the last links are
    preferred, and masses to moments.
    """
    states = states_of(log)
    if states is None:
        return None
    dynamics, n = Dynamics(robot), robot.n
    Y = dynamics.regressor(states.q, states.v, states.a)
    friction = np.zeros((*states.q.shape, 3 * n))
    for k in range(n):
        friction[:, k, 3 * k : 3 * k + 3] = _friction_columns(states.v[:, k])
    unit = np.linalg.norm(Y, axis=(0, 2)).clip(1e-9)[None, :, None]
    order = [*sorted(range(10 * n), key=lambda k: (-(k // 10), k % 10)), *range(10 * n, 11 * n)]
    felt = np.linalg.norm(friction, axis=(0, 1)) > 1e-6  # a joint at rest has no friction of motion
    J = np.concatenate([friction[:, :, felt], Y[:, :, order]], axis=2) / unit
    names = [dynamics.names[k] for k in order]
    return analyse(J.reshape(-1, J.shape[2]), names, int(felt.sum()), {}, "loads the joints")


def _friction_columns(v: Array) -> Array:
    """Return regressors of offset, Coulomb and viscous friction of one joint, shape (N, 3).

    v : its velocities, shape (N,) [rad/s or m/s]
    """
    # Coulomb friction changes its sign smoothly over 0.01 rad/s or m/s.
    return np.column_stack([np.ones(len(v)), np.tanh(v / 0.01), v])


def contradictions(robot: Robot, log: JointLog) -> tuple[str, ...]:
    """Return sentences on contradictions between a log and the arm's model, each with a remedy.

    They concern missing masses or motor data, joints out of range, and, of a robot with masses,
    torques in another unit and joints in another order or sign.
    """
    states = None if lacks_masses(robot) else states_of(log)
    ends = () if states is None else (*_torque_scale_faults(robot, log, states), *_column_faults(robot, log, states))
    return (*_missing_data(robot, log), *ends)


def _missing_data(robot: Robot, log: JointLog) -> Iterator[str]:
    """Yield a sentence for each datum of arm or drives that the log's evaluation lacks.

    Joints whose logged positions are outside of their range are reported, too.
    """
    signed = log.torque is not None or (log.current is not None and not log.current_unsigned)
    if lacks_masses(robot) or robot.masses == "estimated":
        yield (
            f"{robot.name!r} states no masses: estimates from its reach stand in their place, so friction, delay and "
            "play are identified, payload and mass errors are not. Give its URDF with "
            "<inertial>, or a body of each [[joint]]"
        )
    elif bare := [str(i) for i, j in enumerate(robot.joints, 1) if j.body and j.body.inertia is None]:
        yield f"inertias of links {', '.join(bare)} are unknown: usual ones are taken with wide priors"
    if log.torque is None and signed and (robot.drive is None or robot.drive.torque_per_ampere(robot.n) is None):
        yield (
            "currents stand at the motors, and no gear ratio or torque constant is known: friction and its causes are "
            "identified in ampere; masses and the scale of torque are one unknown. Give gear_ratio and "
            "torque_constant_Nm_per_A in [drive], or log one run with a known payload"
        )
    for k, joint in enumerate(robot.joints):
        low, high = np.nanmin(log.position[:, k]), np.nanmax(log.position[:, k])
        if low < joint.lower - 0.05 or high > joint.upper + 0.05:
            yield (
                f"{log.joints[k]} reads {low:.3g} to {high:.3g}, its range is {joint.lower:.3g} to {joint.upper:.3g} "
                f"{robot.units[k]}: its zero, sign or place is another than the model's, or the range is. Correct it"
            )


def _torque_scale_faults(robot: Robot, log: JointLog, states: States) -> Iterator[str]:
    """Yield a sentence if logged and model torques differ by a factor of 8 (median ratio)."""
    if log.torque is None:
        return
    model = Dynamics(robot).torque(states.q, states.v, states.a)
    sizes = [np.abs(each).mean(axis=0) for each in (model, states.tau)]
    strong = (sizes[0] > 0.2 * sizes[0].max()) & (sizes[1] > 0)
    ratio = float(np.median(sizes[0][strong] / sizes[1][strong])) if strong.any() else 1.0
    # Beyond, they are probably those of the motors, before the gears, or in another unit.
    most = 8.0
    if not 1 / most < ratio < most:
        yield (
            f"torques are {1 / ratio:.2g} times the model's: at the motor's side of the gears, "
            "or in another unit, and no ratio is known; "
            "friction and its causes are identified in the log's own unit, payload and masses are not. "
            "Multiply the columns by the gear ratio, or log currents and give gear_ratio in [drive]"
        )


def _column_faults(robot: Robot, log: JointLog, states: States) -> Iterator[str]:
    """Yield sentences on a joint with reversed sign, or two exchanged joints, by their torques."""
    dynamics, n, names = Dynamics(robot), robot.n, log.joints
    against = "the torque or current of {} counts against its angle"
    plain = _unexplained_shares(dynamics, states)
    tries = {f"{names[k]} counts the other way than the model, torque included": states.turned(k) for k in range(n)}
    tries |= {against.format(names[k]): states.turned(k, torque_alone=True) for k in range(n)}
    tries |= {
        f"{names[i]} and {names[k]} stand in each other's columns": states.swapped(i, k)
        for i, k in combinations(range(n), 2)
    }
    unexplained = {words: _unexplained_shares(dynamics, other) for words, other in tries.items()}
    words, rest = best_of(unexplained.items(), lambda each: float(np.log(plain / each[1]).sum()))
    # Another order or sign must lower the sum of the logarithms of the unexplained shares of torque
    # by 0.8: correct models gained at most 0.37 in 40 logs.
    if np.log(plain / rest).sum() > 0.8:
        k = int(np.argmax(plain / rest))
        yield (
            f"{words}: so the model explains {100 * (1 - rest[k]):.0f} % of the torque of {names[k]} without friction, "
            f"as it stands {100 * (1 - plain[k]):.0f} %. Turn the sign or the order of columns (or of the model's axes)"
        )
    # Friction that drives a joint contradicts physics: the sign of torque or speed is wrong. It is
    # reported from 20 % of the variance of the joint's torque.
    model = dynamics.torque(states.q, states.v, states.a)
    for k, name in enumerate(names):
        v, tau = states.v[:, k], states.tau[:, k]
        A = np.column_stack([_friction_columns(v), model[:, k]])
        size = np.linalg.norm(A, axis=0).clip(1e-12)
        friction = A[:, 1:3] @ (np.linalg.lstsq(A / size, tau, rcond=None)[0] / size)[1:3]
        varying, drives = float(np.var(tau)), float(friction @ v) < 0
        share = float(np.var(friction)) / varying if varying > 0 and drives else 0.0
        if share > 0.2 and words != against.format(name):
            yield (
                f"{against.format(name)}: its friction would drive it ({100 * share:.0f} % of what it moves by). Turn "
                "the sign of the column; until then its friction and load are not identified"
            )


def _unexplained_shares(dynamics: Dynamics, states: States) -> Array:
    """Return the share of each joint's torque variance that the model leaves, shape (joints,).

    Variance that friction and an offset explain is removed first (1: the model explains nothing; at
    least 1e-6). The model's torque is scaled by the best positive factor.
    """
    model = dynamics.torque(states.q, states.v, states.a)
    shares = np.ones(states.q.shape[1])
    for k in range(len(shares)):
        friction = np.linalg.qr(_friction_columns(states.v[:, k]))[0]
        seen, wanted = (x - friction @ (friction.T @ x) for x in (states.tau[:, k], model[:, k]))
        both, size = float(seen @ wanted), float(seen @ seen) * float(wanted @ wanted)
        if both > 0 and size > 0:
            shares[k] = max(1 - both**2 / size, 1e-6)
    return shares
