"""What every arm's torques and position errors have: rigid bodies, friction with memory, the servo; and its variables.

Torques are in shares of each joint's great torque in the log. Friction remembers where the angle was (play operators
of several widths), grows with speed and load, dips at low speed and relaxes at rest.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import best_of
from casadical.diagnosis.motion.signals import Arm, Motion, lagged, servo_error

# Widths of the friction's memory: over the measured angle, and over the command of a servo that yields [rad].
MEASURED, COMMANDED = (3e-4, 3e-3, 2e-2), (4e-3, 1.2e-2, 3e-2, 6e-2, 1e-1)
# Speeds at which friction dips [rad/s], and how fast it relaxes at rest [s].
DIPS, RELAXES = (0.05, 0.3), (0.3, 2.0)
# One sigma of a friction's coefficient, in great torques; of an offset; of the torque and the rotor as known.
FRICTION, OFFSET, SCALE, ROTOR, ANY_ROTOR = 0.3, 0.1, 0.02, 0.05, 1.0
# Of the servo: share of its gain, and of the gear's stiffness; delay that is known and that is not [s]; square of a
# filter's time [s^2]; a constant, and what changes with direction [rad].
GAIN, GEAR, DELAY, ANY_DELAY, FILTER, CONSTANT, SIDE = 0.15, 0.5, 1e-3, 0.03, 2e-4, 1e-3, 2e-4
ANY_FILTER = 2e-3
# Of a servo whose gain is roughly known and whose torque nobody logged.
ROUGH = 0.2
# A payload that nobody declared, as a share of the arm's mass; where its mass centre is [m].
LOAD, AWAY = 0.05, 0.1
# Torque or speed within this of its greatest is at a limit; what it does lasts so long [s].
NEAR_LIMIT, AFTER = 0.97, 0.15


@dataclass(frozen=True, eq=False)
class Part:
    """A column of the base at one joint, 0-based: its kind, one sigma, and values of each sample, shape (samples,)."""

    kind: str
    joint: int
    size: float
    samples: Array
    response: bool = False

    @property
    def key(self) -> tuple[str, int, bool]:
        """What it is."""
        return self.kind, self.joint, self.response


@dataclass(frozen=True, eq=False)
class Look:
    """One log seen through the arm's model.

    torque : residual, shape (samples, joints), in great torques; response : of the position error [rad], or None
    names : variables of formulas, shape (samples, joints); great : torque of each joint [N m]
    """

    motion: Motion
    arm: Arm
    great: Array
    torque: Array
    response: Array | None
    names: Mapping[str, Array]
    Y: Array
    gain: Array
    frictions: Mapping[str, Array] = field(default_factory=dict)

    def as_torque(self, error: Array, joint: int) -> Array:
        """What a position error of one joint is in the rows of a log without torque, shape (samples,), [rad]."""
        every = np.zeros_like(self.motion.q)
        every[:, joint] = error
        return np.asarray(_served(self.motion, self.arm, self.gain, every)[:, joint] / self.great[joint])

    def by_angle(self, joint: int) -> Array:
        """Derivative of the torques by one joint's angle, shape (samples, joints), in great torques."""
        m, arm = self.motion, self.arm
        step, bodies = np.zeros(arm.joints), np.append(arm.inertial, np.zeros(arm.joints))
        step[joint] = 5e-5
        more, less = (arm.dynamics.torque(m.q + s, m.v, m.a, bodies) for s in (step, -step))
        return np.asarray((more - less) / 1e-4 / self.great)


def look(motion: Motion, arm: Arm, great: Array | None = None) -> Look:
    """Residuals and variables of a log; great : torque of each joint, by default that of this log [N m]."""
    m = motion
    Y = arm.regressor(m.q, m.v, m.a)
    model = Y @ arm.inertial
    servo, kp = None, np.ones(arm.joints) if arm.kp is None else arm.kp
    if m.torque is not None:
        torque = m.torque
    else:
        assert m.command is not None
        kp = _gain(m, model, arm)
        error = m.command - m.position
        torque = _served(m, arm, kp, error)
        servo = _yielded(m, arm, _yielded(m, arm, model) * kp) if arm.kp is not None else model / kp
    great = np.quantile(np.abs(torque), 0.99, axis=0) + 1e-9 if great is None else great
    response = None
    if m.torque is not None and m.command is not None:
        response, servo = _response(m, arm, torque)
    names = _variables(m, arm, great, torque, model, Y)
    if servo is not None:
        names["servo"] = servo
    residual = (torque - model - arm.rotor * m.a) / great
    return Look(m, arm, great, residual, response, names, Y, kp)


def _served(m: Motion, arm: Arm, kp: Array, error: Array) -> Array:
    """Torque that a servo gives at a position error, shape as the error."""
    kd = 0.0 if arm.kp is None or arm.kd is None else arm.kd
    return np.asarray(kp * error + kd * m.by_run(lambda e: np.gradient(e, m.step, axis=0), error))


def _yielded(m: Motion, arm: Arm, torque: Array) -> Array:
    """Position error at which a servo gives a torque, shape as the torque."""
    assert arm.kp is not None
    return m.by_run(lambda u: servo_error(u, arm, m.step, u[0] / arm.kp), torque)


def _gain(m: Motion, model: Array, arm: Arm) -> Array:
    """Of each servo [N m/rad]; where it is not known, that at which it droops as the model's gravity says."""
    if arm.kp is not None:
        return arm.kp
    assert m.command is not None
    error = m.command - m.position
    slope = (error * model).sum(axis=0) / np.maximum((model**2).sum(axis=0), 1e-12)
    good = slope > 0
    usual = np.median(slope[good]) if good.any() else 1.0
    return np.asarray(1 / np.where(good, slope, usual))


def _response(m: Motion, arm: Arm, torque: Array) -> tuple[Array, Array | None]:
    """What the servo's own law leaves of the position error, and its part that yields to the torque, if it is known."""
    assert m.command is not None
    assert m.command_v is not None
    assert m.command_a is not None
    n, left = arm.joints, m.command - m.position
    if arm.joint_stiffness is not None:
        left = left - torque / arm.joint_stiffness
    if arm.kp is None:
        return left, None
    forward = arm.regressor(m.command, m.command_v, m.command_a) @ arm.inertial
    by_torque, ahead = (
        m.by_run(lambda u: servo_error(u[:, :n], arm, m.step, u[0, n:]), np.hstack([u, left]))
        for u in (torque, torque - forward)
    )
    # Whether the drive feeds the model's torque forward is seen at once.
    fed = best_of((by_torque, ahead), lambda e: -float((((left - e) - (left - e).mean(axis=0)) ** 2).sum()))
    return left - fed, fed


def _variables(m: Motion, arm: Arm, great: Array, torque: Array, model: Array, Y: Array) -> dict[str, Array]:
    """What formulas may name, of every sample and joint."""
    n = len(m.time)
    ones = np.ones((n, arm.joints))
    fast = np.quantile(np.abs(m.v), 0.99, axis=0) + 1e-9
    slip = next(iter(m.memory.values()))
    known = {
        "q": m.q, "v": m.v, "a": m.a, "speed": m.v / fast, "slip": slip, "load": model / great,
        "turned": (m.q - m.q.mean(axis=0)) / (np.abs(m.q - m.q.mean(axis=0)).max(axis=0) + 1e-9),
        "time": m.time[:, None] * ones, "t": (m.time / m.time[-1])[:, None] * ones, "run": m.run[:, None] * ones,
        "side": np.tanh(20 * (model if m.torque is None else torque) / great), "rest": m.rest,
    }  # fmt: skip
    known["inertia"] = arm.rotor * m.a / great
    if m.torque is not None:  # not the measured one, which would explain its own noise
        known["tau"] = known["load"] + known["inertia"]
    if m.heat is not None:
        known["heat"] = m.heat
    if arm.gear_ratio is not None:
        known["motor"] = arm.gear_ratio * m.q
    if m.command is not None:
        assert m.command_v is not None
        assert m.command_a is not None
        known |= {"command_speed": m.command_v, "command_acceleration": m.command_a}
    kg = LOAD * float(arm.inertial[::10].sum())
    for k, name in enumerate(("mass", "mass_x", "mass_y", "mass_z")):
        known[name] = kg * (AWAY if k else 1.0) * Y[:, :, 10 * arm.joints - 10 + k] / great
    for name, of in (("limit", m.torque), ("speed_limit", m.v)):
        if of is not None:
            at = np.sign(of) * (np.abs(of) > NEAR_LIMIT * np.abs(of).max(axis=0))
            known |= {f"at_{name}": at, f"after_{name}": m.by_run(lambda u: lagged(u, AFTER, m.step), at)}
    return known


def base_of(look: Look) -> list[Part]:
    """The base's columns of a log, in great torques and rad, without the rigid bodies."""
    parts = [p for j in range(look.arm.joints) for p in _friction(look, j)]
    if look.response is not None:
        parts += [p for j in range(look.arm.joints) for p in _servo(look, j)]
    return parts


def bodies_of(look: Look) -> Array:
    """What one sigma of each inertial parameter does to each window's torques, shape (windows, joints, parameters)."""
    return np.asarray(look.motion.averaged(look.Y) / look.great[:, None] @ look.arm.spread)


def _friction(look: Look, j: int) -> list[Part]:
    m, names = look.motion, look.names
    slip, speed, load = (names[k][:, j] for k in ("slip", "speed", "load"))
    u, load_size = np.abs(speed), np.abs(load)
    columns: dict[str, Array] = {f"slip {w}": memory[:, j] for w, memory in m.memory.items()}
    columns |= {"viscous": speed, "root": slip * np.sqrt(u), "absolute": u, "curved": speed * u}
    columns |= {"loaded": slip * load_size}
    columns |= {f"dip {w}": slip * np.exp(-np.abs(m.v[:, j]) / w) for w in DIPS}
    columns |= {"by side": (slip > 0) * load_size}
    rest = m.rest[:, j]
    columns |= {f"at rest {s}": slip * (rest > 0) * np.exp(-rest / s) for s in RELAXES}
    if m.heat is not None:
        columns |= {"warm": slip * m.heat[:, j] / 10, "warm viscous": speed * m.heat[:, j] / 10}
    if m.torque is None:
        loaded = {f"loaded {w}": memory[:, j] * load_size for w, memory in m.memory.items()}
        columns |= {**loaded, "accelerated": m.a[:, j] / (np.abs(m.a[:, j]).max() + 1e-9)}
    parts = [Part(kind, j, FRICTION, values) for kind, values in columns.items()]
    if m.torque is None:
        served = {"delay": (ANY_DELAY, names["command_speed"][:, j])}
        if look.arm.kp is not None:
            served["gain"] = GAIN, names["servo"][:, j]
        rounded = names["command_acceleration"][:, j]
        served["filter"] = ANY_FILTER, rounded
        served["jerk"] = ANY_DELAY**3, m.by_run(lambda u: np.gradient(u, m.step), rounded)
        parts += [Part(kind, j, size, look.as_torque(error, j)) for kind, (size, error) in served.items()]
    starts = ((r, m.unmoved[:, j] * (m.run == r)) for r in np.unique(m.run))
    parts += [Part(f"before run {r:.0f} moves", j, FRICTION, start) for r, start in starts if start.any()]
    scale = SCALE if m.torque is not None else ROUGH if look.arm.kp is not None else 1.0
    return [
        *parts,
        Part("offset", j, OFFSET, np.ones(len(speed))),
        Part("scale", j, scale, names["load"][:, j]),
        Part("rotor", j, ROTOR if look.arm.rotor_known else ANY_ROTOR, names["inertia"][:, j]),
    ]


def _servo(look: Look, j: int) -> list[Part]:
    m, arm, names = look.motion, look.arm, look.names
    assert m.torque is not None
    delay = DELAY if arm.delay is not None else ANY_DELAY
    columns = {
        "delay": (names["command_speed"], delay), "filter": (names["command_acceleration"], FILTER),
        "constant": (np.ones_like(m.q), CONSTANT), "side": (names["slip"], SIDE), "load": (names["load"], SIDE),
        "play": (names["side"], SIDE), "squared load": (names["load"] * np.abs(names["load"]), SIDE),
    }  # fmt: skip
    if "servo" in names:
        columns["gain"] = (names["servo"], GAIN)
    else:
        for s in (0.0, 0.03, 0.1, 0.4):
            yielded = m.by_run(lambda u, s=s: lagged(u, s, m.step), m.torque)  # type: ignore[misc]
            columns[f"yields {s}"] = (yielded / look.great, 5e-3)
    if arm.joint_stiffness is not None and np.isfinite(arm.joint_stiffness[j]):
        columns["gear"] = (m.torque / arm.joint_stiffness, GEAR)
        # Friction between motor and gear is not transmitted.
        columns["gear by load"] = (names["load"] * look.great / arm.joint_stiffness, GEAR)
    return [Part(kind, j, size, values[:, j], True) for kind, (values, size) in columns.items()]
