"""Residuals of a joint log by the arm's nominal model, and the signals on which causes depend.

Torques are divided by each joint's peak torque in the log.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import best_of
from casadical.diagnosis.motion.signals import Arm, Motion, delayed, lagged, servo_error
from casadical.effects.definition import DefinedEffect
from casadical.effects.formula_effect import MOTION_NAME_OF_JOINT, MOTION_SEAMS
from casadical.effects.motion import motion_columns

# Mass of an undeclared payload that counts as one unit, divided by the arm's mass.
UNDECLARED_PAYLOAD_SHARE = 0.05
# Signals of a cause at the samples, by what they act on ("torque" or "position") and joint.
Signals = dict[tuple[str, int], Array]


@dataclass(frozen=True, eq=False)
class LogView:
    """Residuals of a log by the arm's nominal model, and the variables on which causes depend.

    motion, arm : signals of the log; bodies and drives
    peak_torque : peak torque of each joint, see `log_view`, shape (joints,) [N m]
    torque : torque residual divided by peak torque, shape (samples, joints)
    response : residual of the position error, shape (samples, joints) [rad]; None unless both
        torques and commands were logged
    variables : arguments of effects' formulas by name, shape (samples, joints)
    Y : regressor of the rigid bodies, shape (samples, joints, 10 joints) [SI]
    gain : gain of each servo, shape (joints,) [N m/rad]; ones where torques were logged and no gain
        is declared
    frictions : friction torques of the base / peak torque, by name, shape (samples, joints) each
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

    @cached_property
    def by_angle(self) -> Array:
        """Return the derivatives of all torques by each joint's angle, (joints, samples, joints).

        The torques are those of the bodies, divided by the peak torques [1/rad].
        """
        m, arm = self.motion, self.arm
        bodies = np.append(arm.inertial, np.zeros(arm.joints))
        ends = [
            [arm.dynamics.torque(m.q + s, m.v, m.a, bodies) for s in (step, -step)]
            for step in 5e-5 * np.eye(arm.joints)
        ]
        return np.stack([(more - less) / 1e-4 / self.peak_torque for more, less in ends])


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
        torque, servo = kp * (m.command - m.position), model / kp
    peak_torque = np.quantile(np.abs(torque), 0.99, axis=0) + 1e-9 if peak_torque is None else peak_torque
    response = None
    if m.torque is not None and m.command is not None:
        response, servo = _response_residual(m, arm, torque, model)
    variables = _variables(m, arm, peak_torque, torque, model, Y)
    if servo is not None:
        variables["servo"] = servo
    residual = (torque - model - arm.rotor * m.a) / peak_torque
    return LogView(m, arm, peak_torque, residual, response, variables, Y, kp)


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


def _response_residual(m: Motion, arm: Arm, torque: Array, model: Array) -> tuple[Array, Array | None]:
    """Return the residual of the position error, and its part by the servo's equation.

    Both have shape (samples, joints) [rad]; the second is None where the gain is not declared. The
    deflection of the gears, if their stiffness is declared, is subtracted, too. Gears transmit the
    torque of the bodies; friction acts in front of them, at the motor.
    torque, model : torques, logged and of the bodies, shape (samples, joints) [N m]
    """
    assert m.command is not None
    assert m.command_v is not None
    assert m.command_a is not None
    n, residual = arm.joints, m.command - m.position
    if arm.joint_stiffness is not None:
        residual = residual - model / arm.joint_stiffness
    if arm.kp is None:
        return residual, None
    forward = arm.regressor(m.command, m.command_v, m.command_a) @ arm.inertial
    by_torque, ahead = (
        m.by_run(lambda u: servo_error(u[:, :n], arm, m.step, u[0, n:]), np.hstack([u, residual]))
        for u in (torque, torque - forward)
    )
    # The smaller residual shows whether the drive has a feed-forward of the model's torque; in
    # logarithms, as a joint that a limit of its torque leaves behind would outweigh all others.
    both = (by_torque, ahead)
    fed = best_of(both, lambda e: -float(np.log((residual - e).var(axis=0) + 1e-18).sum()))
    return residual - fed, fed


def _variables(m: Motion, arm: Arm, peak_torque: Array, torque: Array, model: Array, Y: Array) -> dict[str, Array]:
    """Return the variables of effects' formulas by name, shape (samples, joints) each.

    torque, model : torques, logged or by the servo, and of the bodies, (samples, joints) [N m]
    Y : regressor of the bodies [SI]
    """
    n = len(m.time)
    ones = np.ones((n, arm.joints))
    fast = np.quantile(np.abs(m.v), 0.99, axis=0) + 1e-9
    slip = np.sign(m.v)
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
        # A distance of 0.1 m of an undeclared payload's mass centre from the flange is one unit.
        variables[name] = kg * (0.1 if k else 1.0) * Y[:, :, 10 * arm.joints - 10 + k] / peak_torque
    for name, of in (("limit", m.torque), ("speed_limit", m.v)):
        if of is not None:
            # Fraction of the largest torque or speed in a log above which `at_limit`,
            # `at_speed_limit` are set.
            at = np.sign(of) * (np.abs(of) > 0.97 * np.abs(of).max(axis=0))
            # Time constant [s] with which the effect of a reached limit decays.
            variables |= {f"at_{name}": at, f"after_{name}": m.by_run(lambda u: lagged(u, 0.15, m.step), at)}
    return variables


def signals_of(log_view: LogView, effect: DefinedEffect, sliding: float | None = None) -> list[Signals]:
    """Return, for each parameter of a cause, its signals at the parameter's typical size.

    Signals without any effect are omitted. [] where variables of the cause were not logged.
    sliding : a direction, 1 or -1, in which all joints slide; None: that of the motion
    """
    out = [Signals() for _ in effect.sizes()]
    available = {**log_view.variables, **own_variables(log_view, effect)}
    if sliding is not None:
        available["slip"] = np.full_like(log_view.motion.q, sliding)
        available |= {k: sliding * np.abs(v) for k, v in available.items() if k == "friction"}
    for seam in MOTION_SEAMS:
        if seam not in effect.formulas:
            continue
        numbered = {name: match for name in effect.drivers if (match := MOTION_NAME_OF_JOINT.fullmatch(name))}
        if not {numbered[k][1] if k in numbered else k for k in effect.drivers} <= available.keys():
            return []
        kind = "position" if seam.startswith("response") else "torque"
        for j in range(log_view.arm.joints) if seam.endswith("s") else [(effect.joint or 1) - 1]:
            variables = {k: available[k][:, j] for k in effect.drivers if k not in numbered}
            variables |= {k: available[of[1]][:, int(of[2]) - 1] for k, of in numbered.items()}
            variables = variables or {"none": np.zeros(len(log_view.motion.time))}
            for k, values in enumerate(motion_columns(effect, seam, variables)):
                if np.abs(values).max() > 0:
                    out[k][kind, j] = values
    return [signals for signals in out if signals]


def own_variables(log_view: LogView, effect: DefinedEffect) -> dict[str, Array]:
    """Return the variables that belong to a cause's own link, joint or settings, by name.

    Each has the shape (samples, joints); only those that its formulas use are returned.
    """
    variables: dict[str, Array] = {}
    if "link" in effect.drivers and effect.joint:
        own = slice(10 * effect.joint - 10, 10 * effect.joint)
        variables["link"] = log_view.Y[:, :, own] @ log_view.arm.inertial[own] / log_view.peak_torque
    if "zero" in effect.drivers and effect.joint:
        variables["zero"] = log_view.by_angle[effect.joint - 1]
    m = log_view.motion
    if "delayed" in effect.drivers and m.command is not None:
        variables["delayed"] = m.by_run(lambda c: c - delayed(c, effect.late / m.step), m.command)
    if "filtered" in effect.drivers and m.command is not None:
        variables["filtered"] = m.by_run(lambda c: c - lagged(c, effect.within, m.step), m.command)
    if "wound" in effect.drivers and "servo" in log_view.variables:
        variables["wound"] = m.by_run(lambda e: lagged(e, effect.within, m.step), log_view.variables["servo"])
    return variables | {k: v for k, v in log_view.frictions.items() if k in effect.drivers}
