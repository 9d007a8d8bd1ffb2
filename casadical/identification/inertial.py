"""What a joint log with torques tells of an arm's bodies, and where it contradicts the arm's model.

Dependent columns of the regressor along the logged motion are found as those of a pose model are (`identifiability`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import without_masses
from casadical.core.statistics import best_of
from casadical.identification.identifiability import Identifiability, analyse
from casadical.measurements.logs.log import JointLog
from casadical.robot.dynamics import Dynamics
from casadical.robot.robot import Robot

# Torques so many times smaller than the model's stand at the motor's side.
GEARED = 8.0


@dataclass(frozen=True, eq=False)
class States:
    """Of a log with its torques, shape (N, joints) each: q, v, a [rad or m, per s, per s^2], tau [N m, N or A]."""

    q: Array
    v: Array
    a: Array
    tau: Array

    def turned(self, joint: int, *, torque_alone: bool = False) -> "States":
        """With joint and torque, or the torque alone, counted the other way."""
        sign = np.where(np.arange(self.q.shape[1]) == joint, -1.0, 1.0)
        q, v, a = (each if torque_alone else sign * each for each in (self.q, self.v, self.a))
        return States(q, v, a, sign * self.tau)

    def swapped(self, first: int, second: int) -> "States":
        """With the columns of two joints exchanged."""
        order = np.arange(self.q.shape[1])
        order[[first, second]] = second, first
        return States(*(each[:, order] for each in (self.q, self.v, self.a, self.tau)))


def states_of(log: JointLog) -> States | None:
    """States in the middle of windows of a log, with the mean torque in each; None without a signed torque."""
    torque = log.torque if log.torque is not None else None if log.current_unsigned else log.current
    if torque is None:
        return None
    # Speeds and accelerations are those of parabolas over this time [s]; so many states at most are
    # looked at.
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
    """Which inertial parameters (names of `Dynamics`) the motion in a log determines; None without a signed torque.

    Beside an offset, Coulomb and viscous friction of each joint, which every drive has; preferred are those of the
    last links, and masses before moments.
    """
    states = states_of(log)
    if states is None:
        return None
    dynamics, n = Dynamics(robot), robot.n
    Y = dynamics.regressor(states.q, states.v, states.a)
    friction = np.zeros((*states.q.shape, 3 * n))
    for k in range(n):
        friction[:, k, 3 * k : 3 * k + 3] = _friction(states.v[:, k])
    unit = np.linalg.norm(Y, axis=(0, 2)).clip(1e-9)[None, :, None]
    order = [*sorted(range(10 * n), key=lambda k: (-(k // 10), k % 10)), *range(10 * n, 11 * n)]
    felt = np.linalg.norm(friction, axis=(0, 1)) > 1e-6  # a joint at rest has no friction of motion
    J = np.concatenate([friction[:, :, felt], Y[:, :, order]], axis=2) / unit
    names = [dynamics.names[k] for k in order]
    return analyse(J.reshape(-1, J.shape[2]), names, int(felt.sum()), {}, "loads the joints")


def _friction(v: Array) -> Array:
    # Coulomb friction turns its sign over such a speed [rad/s or m/s].
    return np.column_stack([np.ones(len(v)), np.tanh(v / 0.01), v])


def contradictions(robot: Robot, log: JointLog) -> tuple[str, ...]:
    """Sentences: what a robot file does not say that the log would need, and joints in another order or sign."""
    states = None if without_masses(robot) else states_of(log)
    ends = () if states is None else (*_side(robot, log, states), *_order(robot, log, states))
    return (*_missing(robot, log), *ends)


def _missing(robot: Robot, log: JointLog) -> Iterator[str]:
    """What is not known of arm and drives, with what is told all the same."""
    signed = log.torque is not None or (log.current is not None and not log.current_unsigned)
    if without_masses(robot) or robot.masses == "estimated":
        yield (
            f"{robot.name!r} states no masses: estimates from its reach stand in their place, so friction, delay and "
            "play are told, payload and mass errors are not. Give its URDF with <inertial>, or a body of each [[joint]]"
        )
    elif bare := [str(i) for i, j in enumerate(robot.joints, 1) if j.body and j.body.inertia is None]:
        yield f"inertias of links {', '.join(bare)} are unknown: usual ones are taken with wide priors"
    if log.torque is None and signed and (robot.drive is None or robot.drive.torque_per_ampere(robot.n) is None):
        yield (
            "currents stand at the motors, and no gear ratio or torque constant is known: friction and its causes are "
            "told in ampere; masses and the scale of torque are one unknown. Give gear_ratio and "
            "torque_constant_Nm_per_A in [drive], or log one run with a known payload"
        )
    for k, joint in enumerate(robot.joints):
        low, high = np.nanmin(log.position[:, k]), np.nanmax(log.position[:, k])
        if low < joint.lower - 0.05 or high > joint.upper + 0.05:
            yield (
                f"{log.joints[k]} reads {low:.3g} to {high:.3g}, its range is {joint.lower:.3g} to {joint.upper:.3g} "
                f"{robot.units[k]}: its zero, sign or place is another than the model's, or the range is. Correct it"
            )


def _side(robot: Robot, log: JointLog, states: States) -> Iterator[str]:
    """Torques that are so much smaller than the model's as a gear makes them, or so much greater."""
    if log.torque is None:
        return
    model = Dynamics(robot).torque(states.q, states.v, states.a)
    sizes = [np.abs(each).mean(axis=0) for each in (model, states.tau)]
    strong = (sizes[0] > 0.2 * sizes[0].max()) & (sizes[1] > 0)
    ratio = float(np.median(sizes[0][strong] / sizes[1][strong])) if strong.any() else 1.0
    if not 1 / GEARED < ratio < GEARED:
        yield (
            f"torques are {1 / ratio:.2g} times the model's: at the motor's side of the gears, or in another unit, and "
            "no ratio is known; friction and its causes are told in the log's own unit, payload and masses are not. "
            "Multiply the columns by the gear ratio, or log currents and give gear_ratio in [drive]"
        )


def _order(robot: Robot, log: JointLog, states: States) -> Iterator[str]:
    """A joint that counts the other way than the model, or two that stand in each other's place, by the torques."""
    dynamics, n, names = Dynamics(robot), robot.n, log.joints
    against = "the torque or current of {} counts against its angle"
    plain = _left(dynamics, states)
    tries = {f"{names[k]} counts the other way than the model, torque included": states.turned(k) for k in range(n)}
    tries |= {against.format(names[k]): states.turned(k, torque_alone=True) for k in range(n)}
    tries |= {
        f"{names[i]} and {names[k]} stand in each other's columns": states.swapped(i, k)
        for i, k in combinations(range(n), 2)
    }
    left = {words: _left(dynamics, other) for words, other in tries.items()}
    words, rest = best_of(left.items(), lambda each: float(np.log(plain / each[1]).sum()))
    # Joints in another order or sign must lower the sum of logarithms of the shares of torque that
    # are left by this much: true models gained at most .37 in 40 logs. Friction that drives must be
    # so great a share of a joint's torque.
    if np.log(plain / rest).sum() > 0.8:
        k = int(np.argmax(plain / rest))
        yield (
            f"{words}: so the model explains {100 * (1 - rest[k]):.0f} % of the torque of {names[k]} beside friction, "
            f"as it stands {100 * (1 - plain[k]):.0f} %. Turn the sign or the order of columns (or of the model's axes)"
        )
    model = dynamics.torque(states.q, states.v, states.a)
    for k, name in enumerate(names):
        share = _driving(states.v[:, k], states.tau[:, k], model[:, k])
        if share > 0.2 and words != against.format(name):
            yield (
                f"{against.format(name)}: its friction would drive it ({100 * share:.0f} % of what it moves by). Turn "
                "the sign of the column; until then its friction and load are not told"
            )


def _driving(v: Array, tau: Array, model: Array) -> float:
    """Share of a joint's torque that goes with its speed and its sign where that is against friction, else 0."""
    A = np.column_stack([_friction(v), model])
    x = np.linalg.lstsq(A / (size := np.linalg.norm(A, axis=0).clip(1e-12)), tau, rcond=None)[0] / size
    friction = A[:, 1:3] @ x[1:3]
    varying = float(np.var(tau))
    return float(np.var(friction)) / varying if varying > 0 and float(friction @ v) < 0 else 0.0


def _left(dynamics: Dynamics, states: States) -> Array:
    """Share of each joint's torque, beside friction, that the model's torque (times a positive factor) leaves, (n,)."""
    model = dynamics.torque(states.q, states.v, states.a)
    shares = np.ones(states.q.shape[1])
    for k in range(len(shares)):
        friction = np.linalg.qr(_friction(states.v[:, k]))[0]
        seen, wanted = (x - friction @ (friction.T @ x) for x in (states.tau[:, k], model[:, k]))
        both, size = float(seen @ wanted), float(seen @ seen) * float(wanted @ wanted)
        if both > 0 and size > 0:
            shares[k] = max(1 - both**2 / size, 1e-6)
    return shares
