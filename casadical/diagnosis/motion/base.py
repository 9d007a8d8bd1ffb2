"""Baseline regressors of every arm: rigid bodies, hysteretic friction and the position servo.

Torques are divided by each joint's peak torque in the log. Friction depends on the history of the
angle (play operators of several widths), grows with speed and load, drops at low speed (Stribeck
effect) and relaxes at rest.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import best_of
from casadical.diagnosis.motion.signals import Arm, Motion, lagged, servo_error

# Half-widths [rad] of the play operators (see `play_operator`) of measured angles that model
# hysteretic friction.
MEASURED_PLAY_WIDTHS_RAD = (3e-4, 3e-3, 2e-2)
# Half-widths [rad] of the play operators of commanded angles, for logs without torque.
COMMANDED_PLAY_WIDTHS_RAD = (4e-3, 1.2e-2, 3e-2, 6e-2, 1e-1)
# Speeds [rad/s] at which the excess of friction at rest has fallen to 1/e (Stribeck effect).
DIP_SPEEDS_RAD_S = (0.05, 0.3)
RELAXATION_TIMES_S = (0.3, 2.0)  # time constants [s] with which friction relaxes at rest
# Prior standard deviation of each friction coefficient, divided by the joint's peak torque.
SIGMA_FRICTION = 0.3
# Prior standard deviation of a constant torque, divided by the joint's peak torque.
SIGMA_TORQUE_OFFSET = 0.1
SIGMA_TORQUE_SCALE = 0.02  # prior standard deviation of the relative scale error of a logged torque
SIGMA_DECLARED_ROTOR = 0.05  # relative prior standard deviation of a declared rotor inertia
# Relative prior standard deviation of a roughly estimated rotor inertia.
SIGMA_ESTIMATED_ROTOR = 1.0
SIGMA_SERVO_GAIN = 0.15  # relative prior standard deviation of a servo's gain
SIGMA_GEAR_STIFFNESS = 0.5  # relative prior standard deviation of a gear's stiffness
# Prior standard deviation of the error of a declared command delay [s].
SIGMA_DECLARED_DELAY_S = 1e-3
SIGMA_UNKNOWN_DELAY_S = 0.03  # prior standard deviation of an undeclared command delay [s]
SIGMA_FILTER_S2 = 2e-4  # prior standard deviation of a command filter's squared time constant [s^2]
SIGMA_CONSTANT_ERROR_RAD = 1e-3  # prior standard deviation of a constant position error [rad]
# Prior standard deviation of the coefficient of a position error that is proportional to the
# direction of motion or to the load divided by the peak torque [rad].
SIGMA_DIRECTION_ERROR_RAD = 2e-4
SIGMA_UNKNOWN_FILTER_S2 = 2e-3  # the same as SIGMA_FILTER_S2 [s^2], for logs without torque
# Relative prior standard deviation of the scale of a torque that was computed from the position
# error with a declared gain.
SIGMA_ROUGH_TORQUE_SCALE = 0.2
# Mass of an undeclared payload that counts as one unit, divided by the arm's mass.
UNDECLARED_PAYLOAD_SHARE = 0.05
# Distance of an undeclared payload's centre of mass from the flange that counts as one unit [m].
PAYLOAD_LEVER_M = 0.1
# A torque or speed is at its limit above this fraction of its largest absolute value in the log.
LIMIT_SHARE = 0.97
AFTER_LIMIT_S = 0.15  # time constant [s] with which the effect of a reached limit decays


@dataclass(frozen=True, eq=False)
class BaseColumn:
    """A column of the base at one joint.

    kind : name of the effect that it models; joint : number of the joint, 0-based
    size : prior standard deviation of its coefficient
    samples : value at each sample, shape (samples,), torque divided by peak torque, or [rad]
    response : whether it acts on the position error; otherwise on the torque
    """

    kind: str
    joint: int
    size: float
    samples: Array
    response: bool = False

    @property
    def key(self) -> tuple[str, int, bool]:
        """Return kind, joint and row (torque or position error), which identify the column."""
        return self.kind, self.joint, self.response


@dataclass(frozen=True, eq=False)
class LogView:
    """Residuals of a log by the arm's nominal model, and the variables on which causes depend.

    motion, arm : signals of the log; bodies and drives
    peak_torque : peak torque of each joint, shape (joints,) [N m]
    torque : torque residual divided by peak torque, shape (samples, joints)
    response : residual of the position error, shape (samples, joints) [rad]; None unless both
        torques and commands were logged
    variables : arguments of effects' formulas by name, shape (samples, joints)
    Y : regressor of the rigid bodies, shape (samples, joints, 10 joints) [SI]
    gain : gain of each servo, shape (joints,) [N m/rad]; ones where torques were logged and no gain
        is declared
    frictions : friction torques fitted by the base, divided by peak torque, by name, shape
        (samples, joints)
    """

    motion: Motion
    arm: Arm
    peak_torque: Array
    torque: Array
    response: Array | None
    variables: Mapping[str, Array]
    Y: Array
    gain: Array
    frictions: Mapping[str, Array] = field(default_factory=dict)

    def as_torque(self, error: Array, joint: int) -> Array:
        """Return the servo's torque at a joint's position error, divided by the peak torque.

        error : shape (samples,) [rad], as the result; joint : 0-based
        """
        every = np.zeros_like(self.motion.q)
        every[:, joint] = error
        return np.asarray(_servo_torque(self.motion, self.arm, self.gain, every)[:, joint] / self.peak_torque[joint])

    def by_angle(self, joint: int) -> Array:
        """Return the derivative of all torques by one joint's angle [1/rad], (samples, joints).

        The torques are those of the bodies, divided by the peak torques. joint : 0-based
        """
        m, arm = self.motion, self.arm
        step, bodies = np.zeros(arm.joints), np.append(arm.inertial, np.zeros(arm.joints))
        step[joint] = 5e-5
        more, less = (arm.dynamics.torque(m.q + s, m.v, m.a, bodies) for s in (step, -step))
        return np.asarray((more - less) / 1e-4 / self.peak_torque)


def log_view(motion: Motion, arm: Arm, peak_torque: Array | None = None) -> LogView:
    """Return residuals and variables of a log.

    peak_torque : peak torque of each joint [N m]; None: the 99 % quantile of this log's torques
    """
    m = motion
    Y = arm.regressor(m.q, m.v, m.a)
    model = Y @ arm.inertial
    servo, kp = None, np.ones(arm.joints) if arm.kp is None else arm.kp
    if m.torque is not None:
        torque = m.torque
    else:
        assert m.command is not None
        kp = _servo_gains(m, model, arm)
        error = m.command - m.position
        torque = _servo_torque(m, arm, kp, error)
        servo = _servo_error_of(m, arm, _servo_error_of(m, arm, model) * kp) if arm.kp is not None else model / kp
    peak_torque = np.quantile(np.abs(torque), 0.99, axis=0) + 1e-9 if peak_torque is None else peak_torque
    response = None
    if m.torque is not None and m.command is not None:
        response, servo = _response_residual(m, arm, torque)
    variables = _variables(m, arm, peak_torque, torque, model, Y)
    if servo is not None:
        variables["servo"] = servo
    residual = (torque - model - arm.rotor * m.a) / peak_torque
    return LogView(m, arm, peak_torque, residual, response, variables, Y, kp)


def _servo_torque(m: Motion, arm: Arm, kp: Array, error: Array) -> Array:
    """Return the torque of each servo at a position error, kp e + kd e' [N m].

    kp : shape (joints,) [N m/rad]; error : shape (samples, joints) [rad], as the result
    """
    kd = 0.0 if arm.kp is None or arm.kd is None else arm.kd
    return np.asarray(kp * error + kd * m.by_run(lambda e: np.gradient(e, m.step, axis=0), error))


def _servo_error_of(m: Motion, arm: Arm, torque: Array) -> Array:
    """Return the position error [rad] at which each servo gives a torque [N m], run by run.

    torque : shape (samples, joints), as the result; see `servo_error`
    """
    assert arm.kp is not None
    return m.by_run(lambda u: servo_error(u, arm, m.step, u[0] / arm.kp), torque)


def _servo_gains(m: Motion, model: Array, arm: Arm) -> Array:
    """Return the gain of each servo, declared or estimated, shape (joints,) [N m/rad].

    Undeclared gains follow from the position error and the model's torque, by least squares.
    model : torque of the bodies, shape (samples, joints) [N m]
    """
    if arm.kp is not None:
        return arm.kp
    assert m.command is not None
    error = m.command - m.position
    slope = (error * model).sum(axis=0) / np.maximum((model**2).sum(axis=0), 1e-12)
    good = slope > 0
    usual = np.median(slope[good]) if good.any() else 1.0
    return np.asarray(1 / np.where(good, slope, usual))


def _response_residual(m: Motion, arm: Arm, torque: Array) -> tuple[Array, Array | None]:
    """Return the residual of the position error, and its part by the servo's equation.

    Both have shape (samples, joints) [rad]; the second is None where the gain is not declared. The
    deflection of the gears, if their stiffness is declared, is subtracted, too.
    """
    assert m.command is not None
    assert m.command_v is not None
    assert m.command_a is not None
    n, residual = arm.joints, m.command - m.position
    if arm.joint_stiffness is not None:
        residual = residual - torque / arm.joint_stiffness
    if arm.kp is None:
        return residual, None
    forward = arm.regressor(m.command, m.command_v, m.command_a) @ arm.inertial
    by_torque, ahead = (
        m.by_run(lambda u: servo_error(u[:, :n], arm, m.step, u[0, n:]), np.hstack([u, residual]))
        for u in (torque, torque - forward)
    )
    # The smaller residual shows whether the drive has a feed-forward of the model's torque.
    fed = best_of((by_torque, ahead), lambda e: -float((((residual - e) - (residual - e).mean(axis=0)) ** 2).sum()))
    return residual - fed, fed


def _variables(m: Motion, arm: Arm, peak_torque: Array, torque: Array, model: Array, Y: Array) -> dict[str, Array]:
    """Return the variables of effects' formulas by name, shape (samples, joints) each.

    torque, model : torques, logged or by the servo, and of the bodies, (samples, joints) [N m]
    Y : regressor of the bodies [SI]
    """
    n = len(m.time)
    ones = np.ones((n, arm.joints))
    fast = np.quantile(np.abs(m.v), 0.99, axis=0) + 1e-9
    slip = next(iter(m.memory.values()))
    variables = {
        "q": m.q,
        "v": m.v,
        "a": m.a,
        "speed": m.v / fast,
        "slip": slip,
        "load": model / peak_torque,
        "turned": (m.q - m.q.mean(axis=0)) / (np.abs(m.q - m.q.mean(axis=0)).max(axis=0) + 1e-9),
        "time": m.time[:, None] * ones,
        "t": (m.time / m.time[-1])[:, None] * ones,
        "run": m.run[:, None] * ones,
        "side": np.tanh(20 * (model if m.torque is None else torque) / peak_torque),
        "rest": m.rest,
    }
    variables["inertia"] = arm.rotor * m.a / peak_torque
    if m.torque is not None:  # the model's torque, as the measured one would explain its own noise
        variables["tau"] = variables["load"] + variables["inertia"]
    if m.heat is not None:
        variables["heat"] = m.heat
    if arm.gear_ratio is not None:
        variables["motor"] = arm.gear_ratio * m.q
    if m.command is not None:
        assert m.command_v is not None
        assert m.command_a is not None
        variables |= {"command_speed": m.command_v, "command_acceleration": m.command_a}
    kg = UNDECLARED_PAYLOAD_SHARE * float(arm.inertial[::10].sum())
    for k, name in enumerate(("mass", "mass_x", "mass_y", "mass_z")):
        variables[name] = kg * (PAYLOAD_LEVER_M if k else 1.0) * Y[:, :, 10 * arm.joints - 10 + k] / peak_torque
    for name, of in (("limit", m.torque), ("speed_limit", m.v)):
        if of is not None:
            at = np.sign(of) * (np.abs(of) > LIMIT_SHARE * np.abs(of).max(axis=0))
            variables |= {f"at_{name}": at, f"after_{name}": m.by_run(lambda u: lagged(u, AFTER_LIMIT_S, m.step), at)}
    return variables


def base_columns(log_view: LogView) -> list[BaseColumn]:
    """Return the base's columns of a log, without those of the rigid bodies."""
    parts = [p for j in range(log_view.arm.joints) for p in _torque_columns(log_view, j)]
    if log_view.response is not None:
        parts += [p for j in range(log_view.arm.joints) for p in _servo_columns(log_view, j)]
    return parts


def body_columns(log_view: LogView) -> Array:
    """Return the columns of the rigid bodies' parameters, shape (windows, joints, parameters).

    Each is the torque, divided by peak torque, by one prior standard deviation of a parameter.
    """
    return np.asarray(log_view.motion.averaged(log_view.Y) / log_view.peak_torque[:, None] @ log_view.arm.spread)


def _torque_columns(log_view: LogView, j: int) -> list[BaseColumn]:
    """Return the torque columns of joint j (0-based): friction, offset, scale and rotor.

    Columns of the servo are among them if no torque was logged.
    """
    m, variables = log_view.motion, log_view.variables
    slip, speed, load = (variables[k][:, j] for k in ("slip", "speed", "load"))
    u, load_size = np.abs(speed), np.abs(load)
    columns: dict[str, Array] = {f"slip {w}": memory[:, j] for w, memory in m.memory.items()}
    columns |= {"viscous": speed, "root": slip * np.sqrt(u), "absolute": u, "curved": speed * u}
    columns |= {"loaded": slip * load_size}
    columns |= {f"dip {w}": slip * np.exp(-np.abs(m.v[:, j]) / w) for w in DIP_SPEEDS_RAD_S}
    columns |= {"by side": (slip > 0) * load_size}
    rest = m.rest[:, j]
    columns |= {f"at rest {s}": slip * (rest > 0) * np.exp(-rest / s) for s in RELAXATION_TIMES_S}
    if m.heat is not None:
        columns |= {"warm": slip * m.heat[:, j] / 10, "warm viscous": speed * m.heat[:, j] / 10}
    if m.torque is None:
        loaded = {f"loaded {w}": memory[:, j] * load_size for w, memory in m.memory.items()}
        columns |= {**loaded, "accelerated": m.a[:, j] / (np.abs(m.a[:, j]).max() + 1e-9)}
    parts = [BaseColumn(kind, j, SIGMA_FRICTION, values) for kind, values in columns.items()]
    if m.torque is None:
        served = {"delay": (SIGMA_UNKNOWN_DELAY_S, variables["command_speed"][:, j])}
        if log_view.arm.kp is not None:
            served["gain"] = SIGMA_SERVO_GAIN, variables["servo"][:, j]
        rounded = variables["command_acceleration"][:, j]
        served["filter"] = SIGMA_UNKNOWN_FILTER_S2, rounded
        served["jerk"] = SIGMA_UNKNOWN_DELAY_S**3, m.by_run(lambda u: np.gradient(u, m.step), rounded)
        parts += [BaseColumn(kind, j, size, log_view.as_torque(error, j)) for kind, (size, error) in served.items()]
    starts = ((r, m.unmoved[:, j] * (m.run == r)) for r in np.unique(m.run))
    parts += [BaseColumn(f"before run {r:.0f} moves", j, SIGMA_FRICTION, start) for r, start in starts if start.any()]
    scale = (
        SIGMA_TORQUE_SCALE if m.torque is not None else SIGMA_ROUGH_TORQUE_SCALE if log_view.arm.kp is not None else 1.0
    )
    return [
        *parts,
        BaseColumn("offset", j, SIGMA_TORQUE_OFFSET, np.ones(len(speed))),
        BaseColumn("scale", j, scale, variables["load"][:, j]),
        BaseColumn(
            "rotor",
            j,
            SIGMA_DECLARED_ROTOR if log_view.arm.rotor_known else SIGMA_ESTIMATED_ROTOR,
            variables["inertia"][:, j],
        ),
    ]


def _servo_columns(log_view: LogView, j: int) -> list[BaseColumn]:
    """Return the position-error columns of joint j (0-based), for logs with torque and commands."""
    m, arm, variables = log_view.motion, log_view.arm, log_view.variables
    assert m.torque is not None
    delay = SIGMA_DECLARED_DELAY_S if arm.delay is not None else SIGMA_UNKNOWN_DELAY_S
    columns = {
        "delay": (variables["command_speed"], delay),
        "filter": (variables["command_acceleration"], SIGMA_FILTER_S2),
        "constant": (np.ones_like(m.q), SIGMA_CONSTANT_ERROR_RAD),
        "side": (variables["slip"], SIGMA_DIRECTION_ERROR_RAD),
        "load": (variables["load"], SIGMA_DIRECTION_ERROR_RAD),
        "play": (variables["side"], SIGMA_DIRECTION_ERROR_RAD),
        "squared load": (variables["load"] * np.abs(variables["load"]), SIGMA_DIRECTION_ERROR_RAD),
    }
    if "servo" in variables:
        columns["gain"] = (variables["servo"], SIGMA_SERVO_GAIN)
    else:
        for s in (0.0, 0.03, 0.1, 0.4):
            yielded = m.by_run(lambda u, s=s: lagged(u, s, m.step), m.torque)  # type: ignore[misc]
            columns[f"yields {s}"] = (yielded / log_view.peak_torque, 5e-3)
    if arm.joint_stiffness is not None and np.isfinite(arm.joint_stiffness[j]):
        columns["gear"] = (m.torque / arm.joint_stiffness, SIGMA_GEAR_STIFFNESS)
        # The gear does not transmit the friction between itself and the motor.
        columns["gear by load"] = (variables["load"] * log_view.peak_torque / arm.joint_stiffness, SIGMA_GEAR_STIFFNESS)
    return [BaseColumn(kind, j, size, values[:, j], True) for kind, (values, size) in columns.items()]
