"""Rows of a log with torques: friction, rigid bodies and the servo's equation.

Rows of torques are those in which a joint slides; at rest, and within a few mrad behind a reversal,
friction may be any torque up to its limit.
"""

from collections.abc import Sequence

import numpy as np

from casadical.core.basics import Array
from casadical.diagnosis.motion.engine import LogProblem, Rows
from casadical.diagnosis.motion.view import LogView

MIN_SLIDING_RAD = 3e-3  # distance behind a reversal from which a joint slides [rad]
STRIBECK_SPEED_RAD_S = 0.05  # speed at which the excess of friction at low speed has fallen to 1/e
# Groups of friction torques that change by a common factor from day to day.
FRICTION_GROUPS = (("slip", "dip"), ("viscous", "curved"), ("loaded", "by side"), ("warm", "warm viscous"))
WARM_UP_TIME_S = 40.0  # typical time in which an arm warms up [s]
# Prior sigmas of other coefficients' daily changes, by name: delay [s], gain (a number in the
# drive) relative, else by the peak torque.
DAILY_SIGMAS = {"offset": 0.01, "scale": 0.003, "rotor": 0.01, "delay": 5e-4, "gain": 5e-3}
DAILY_SIGMAS |= {"cold": 0.01, "cold viscous": 0.01}


def sliding(view: LogView) -> Array:
    """Return the mask of the samples at which each joint slides, shape (samples, joints).

    It moves and is more than `MIN_SLIDING_RAD` from its last reversal or the run's start.
    """
    m = view.motion
    way, at = np.sign(m.v), np.arange(len(m.q))[:, None]
    begins = np.ones_like(way, dtype=bool)
    begins[1:] = (way[1:] != way[:-1]) | (np.diff(m.run) != 0)[:, None]
    start = np.maximum.accumulate(np.where(begins, at, 0), axis=0)
    return np.asarray((np.abs(m.q - np.take_along_axis(m.q, start, axis=0)) > MIN_SLIDING_RAD) & (m.rest == 0))


def _torque_columns(view: LogView, j: int) -> dict[str, tuple[Array, float]]:
    """Return (column, prior sigma) of joint j's (0-based) torque / peak torque, by name."""
    variables, m = view.variables, view.motion
    speed, load, slip = variables["speed"][:, j], variables["load"][:, j], np.sign(m.v[:, j])
    columns = {
        "slip": (slip, 0.3),
        "viscous": (speed, 0.3),
        "curved": (speed * np.abs(speed), 0.1),
        "loaded": (slip * np.abs(load), 0.15),
        "dip": (slip * np.exp(-np.abs(m.v[:, j]) / STRIBECK_SPEED_RAD_S), 0.1),
        "by side": ((slip > 0) * np.abs(load), 0.02),
        "offset": (np.ones_like(speed), 0.05),
        "scale": (load, 0.02),
        "rotor": (variables["inertia"][:, j], 0.05 if view.arm.rotor_known else 1.0),
    }
    cold = np.exp(-m.time / WARM_UP_TIME_S)
    columns |= {"cold": (slip * cold, 0.01), "cold viscous": (speed * cold, 0.01)}
    if m.heat is not None:
        columns |= {"warm": (slip * m.heat[:, j] / 10, 0.05), "warm viscous": (speed * m.heat[:, j] / 10, 0.05)}
    return columns


def _servo_columns(view: LogView, j: int) -> dict[str, tuple[Array, float]]:
    """Return (column, prior sigma) of joint j's (0-based) position error [rad], by name."""
    m, arm, variables = view.motion, view.arm, view.variables
    assert m.torque is not None
    columns = {
        "delay": (variables["command_speed"][:, j], 1e-3 if arm.delay is not None else 0.03),
        "filter": (variables["command_acceleration"][:, j], 2e-4),
        "constant": (np.ones(len(m.q)), 1e-3),
        "load": (variables["load"][:, j], 2e-4),
    }
    if "servo" in variables:
        columns["gain"] = variables["servo"][:, j], 0.05
    else:
        columns["yields"] = m.torque[:, j] / view.peak_torque[j], 5e-3
    if arm.joint_stiffness is not None and np.isfinite(arm.joint_stiffness[j]):
        load = variables["load"][:, j] * view.peak_torque[j]
        columns["gear"] = load / arm.joint_stiffness[j], 0.3
        columns["gear friction"] = (m.torque[:, j] - load) / arm.joint_stiffness[j], 0.3
    return columns | {"side": (np.sign(m.v[:, j]), 2e-4)}


def torque_problem(views: Sequence[LogView]) -> LogProblem:
    """Return the problem of a log, the first of the views, with the reference as its prior."""
    bodies = [view.Y / view.peak_torque[:, None] @ view.arm.spread for view in views]
    every = np.concatenate([b[::4].reshape(-1, b.shape[2]) for b in bodies])
    # Thirty combinations of the bodies' parameters: those that logs determine best.
    turn = np.linalg.svd(np.linalg.qr(every)[1])[2][:30].T
    problem = _problem(views[0], bodies[0] @ turn)
    if len(views) < 2:
        return problem
    reference = _problem(views[1], bodies[1] @ turn)
    fit = reference.fit
    covariance = np.linalg.inv(fit.precision) + _daily(problem, fit.x)
    rows = tuple(
        Rows(r.kind, r.joint, r.used, r.r, r.J, r.own, float(np.sqrt(s2)), r.fold, r.rate)
        for r, s2 in zip(problem.rows, fit.variance, strict=True)
    )
    return LogProblem(rows, fit.x, covariance, problem.names)


def _problem(view: LogView, bodies: Array) -> LogProblem:
    """Return the problem of one log with wide priors. bodies : (samples, joints, parameters)"""
    m, n = view.motion, view.arm.joints
    names: list[tuple[str, ...]] = [("body", "", str(k)) for k in range(bodies.shape[2])]
    sigmas, rows, slides = [1.0] * len(names), [], sliding(view)
    fold = m.run if len(np.unique(m.run)) > 1 else np.floor(3 * np.arange(len(m.q)) / len(m.q))
    for kind in ("torque", "position") if view.response is not None else ("torque",):
        for j in range(n):
            torque = kind == "torque"
            columns = _torque_columns(view, j) if torque else _servo_columns(view, j)
            own = len(names) + np.arange(len(columns))
            names += [(kind, str(j), name) for name in columns]
            sigmas += [sigma for _, sigma in columns.values()]
            J = np.stack([values for values, _ in columns.values()], axis=1)
            used = slides[:, j] if torque else np.ones(len(m.q), dtype=bool)
            # Typical sigma of a torque's noise / peak torque, see `log_view`.
            sigma = 0.01
            if torque:
                J, own = np.hstack([bodies[:, j], J]), np.concatenate([np.arange(bodies.shape[2]), own])
            else:
                # Time shift of the motion that gives the typical noise of angles [s].
                sigma = float(np.hypot(m.quantum[j] / 3.5, 5e-4 * np.sqrt((m.v[:, j] ** 2).mean())))
            residual = view.torque if torque else view.response
            assert residual is not None
            rows.append(Rows(kind, j, used, residual[used, j], J[used], own, sigma, fold[used], 1 / m.step))
    return LogProblem(tuple(rows), np.zeros(len(names)), np.diag(np.square(sigmas)), tuple(names))


def _daily(problem: LogProblem, x: Array) -> Array:
    """Return the prior covariance of the changes of the base since the day of the reference.

    x : the base's parameters on that day
    """
    names, out = problem.names, np.zeros_like(problem.covariance)
    grouped = {name for group in FRICTION_GROUPS for name in group}

    def together(values: list[float], share: float) -> Array:
        """Return the covariance of a common relative change of some parameters."""
        return share**2 * np.outer(values, values)

    for j in {joint for _, joint, _ in names if joint}:
        friction = [
            v if (k, i) == ("torque", j) and name in grouped else 0.0 for v, (k, i, name) in zip(x, names, strict=True)
        ]
        # Prior sigma of the relative daily change of all frictions of a joint.
        out += together(friction, 0.07)
        for group in FRICTION_GROUPS:
            # Prior sigma of the relative daily change of a joint's group of frictions.
            out += together([f if name in group else 0.0 for f, (*_, name) in zip(friction, names, strict=True)], 0.13)
    # Prior standard deviation of the change of all delays from log to log [s].
    out += together([float((kind, name) == ("position", "delay")) for kind, _, name in names], 4e-3)
    sigmas = []
    for (kind, joint, name), usual in zip(names, np.sqrt(np.diag(problem.covariance)), strict=True):
        # Of a friction it is by the peak torque, of coefficients of position errors by their prior.
        own = DAILY_SIGMAS.get(name, 0.004 if kind == "torque" else 0.1 * usual)
        sigmas.append(min(own, usual) if joint else 1e-3)
    return np.asarray(out + np.diag(np.square(sigmas)))
