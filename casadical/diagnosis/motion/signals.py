"""Smooth signals of a joint log on a uniform time grid, with derivatives; faults of the log.

The faults are those of the instrument that wrote the log: its clock, lost or repeated samples, a
current without sign. The arm that moved is described by its bodies and drives, one number a joint,
None where nothing is declared.

All signals are smoothed by one symmetric kernel, so that none is delayed against another.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.drive import Drive
from casadical.measurements.logs.log import JointLog
from casadical.robot.dynamics import Dynamics
from casadical.robot.robot import Robot

SMOOTHING_WIDTH_S = 0.08  # full width of the smoothing kernel (Hann window), usually [s]
# Faster logs are thinned by a whole number to about this sample rate, at most twice as much [Hz].
MAX_RATE_HZ = 62.5
PAUSE_BETWEEN_RUNS_S = 10.0  # assumed time between the end of a run and the next one [s]
FILTER_BLOCK_SAMPLES = 64  # number of samples that the low-pass filter computes at a time
REGRESSOR_BLOCK_SAMPLES = 4000  # number of samples at which the regressor is computed at a time
MIN_QUANTUM_RAD = 1e-6  # smaller changes of a reading are not taken as its resolution [rad]
MIN_GAP_STEPS = 1.6  # a time step is a gap above this multiple of the usual step
MIN_MOVING_QUANTA = 3.0  # a joint moves if its mean change a sample exceeds this many quanta


@dataclass(frozen=True, eq=False)
class Arm:
    """Bodies and drives of an arm, as far as the robot file declares them.

    All arrays by joint have the shape (n,) and are None where nothing is declared.
    inertial : ten inertial parameters of each link (`Dynamics.names`), the declared payload
        included in the last link's, shape (10 n,) [SI]
    spread : change of `inertial` by one prior standard deviation of each of k independent
        parameters of the bodies, shape (10 n, k) [SI]
    rotor : rotor inertia at the joint [kg m^2], estimated where `rotor_known` is False
    per_ampere : torque at the joint per current [N m/A]
    delay : time from the logged command to the servo, filters included [s]
    kp, kd, ki : gains of the servo [N m/rad, N m s/rad, N m/(rad s)]
    joint_stiffness : stiffness of the gear [N m/rad]
    gear_ratio : turns of the motor per turn of the joint; log_rate : declared sample rate [Hz]
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
        """Return the number of joints."""
        return len(self.rotor)

    def regressor(self, q: Array, v: Array, a: Array) -> Array:
        """Return the regressor of the torques by `inertial`, shape (n, joints, 10 joints) [SI].

        q, v, a : angles, velocities and accelerations, shape (n, joints) [rad, rad/s, rad/s^2]
        """
        out = np.empty((*q.shape, 10 * self.joints))
        for k in range(0, len(q), REGRESSOR_BLOCK_SAMPLES):
            s = slice(k, k + REGRESSOR_BLOCK_SAMPLES)
            out[s] = self.dynamics.regressor(q[s], v[s], a[s])[:, :, : 10 * self.joints]
        return out


@lru_cache(maxsize=4)
def arm_of(robot: Robot) -> Arm:
    """Return bodies and drives of a robot; what its file does not declare is None."""
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


@dataclass(frozen=True, eq=False)
class Motion:
    """Smoothed signals of a log, each of shape (n, joints) [SI] unless stated otherwise.

    time : time since the log began, with `PAUSE_BETWEEN_RUNS_S` between runs, shape (n,) [s]
    run : number of each sample's run, from 1, shape (n,)
    position : measured angles [rad]; q, v, a : the same, velocity and acceleration
    command, command_v, command_a : command after the declared delay, and derivatives; or None
    torque : torque at the joints [N m], current [A] without a declared torque constant, or None
    heat : temperature above its minimum in the log [K], or None
    memory : play operators of the angle, -1 to 1, by half-width [rad] (see `play_operator`)
    rest : time since the joint stopped, 0 in motion [s]
    quantum : resolution of each joint's readings, shape (joints,) [rad]
    """

    time: Array
    run: Array
    position: Array
    q: Array
    v: Array
    a: Array
    memory: Mapping[float, Array]
    rest: Array
    quantum: Array
    command: Array | None = None
    command_v: Array | None = None
    command_a: Array | None = None
    torque: Array | None = None
    heat: Array | None = None

    @property
    def step(self) -> float:
        """Return the median time between samples [s]."""
        return float(np.median(np.diff(self.time)))

    def by_run(self, change: Callable[[Array], Array], values: Array) -> Array:
        """Return the results of an operation on a signal, applied to each run and concatenated.

        change : operation that depends on earlier samples; values : shape (n, ...)
        """
        ends = [0, *(np.flatnonzero(np.diff(self.run)) + 1).tolist(), len(self.run)]
        return np.concatenate([change(values[a:b]) for a, b in pairwise(ends)])


def motion_of(log: JointLog, arm: Arm, widths: tuple[float, ...] = (), max_samples: int | None = None) -> Motion:
    """Return the smoothed signals of a log; runs of less than two seconds are excluded.

    widths : half-widths of the play operators [rad]
    max_samples : approximate number to which long logs are thinned; None: by `MAX_RATE_HZ` alone
    Raises InputError for a log without a run of two seconds.
    """
    parts: list[dict[str, Array]] = []
    start, torque = 0.0, torque_of(log, arm)
    steps_of = np.abs(np.diff(log.position, axis=0))
    smallest = np.where(steps_of > MIN_QUANTUM_RAD, steps_of, np.inf).min(axis=0)
    quantum = np.where(np.isfinite(smallest), smallest, MIN_QUANTUM_RAD)
    # Noise of accelerations goes with quantum / width^2.5. With torques it biases the inertia to
    # zero; it is held at that of .2 mrad.
    coarse = 1.0 if torque is None else max(1.0, float(np.median(quantum)) / 2e-4)
    kernel = smoothing_kernel(log.step, SMOOTHING_WIDTH_S * coarse**0.4)
    rows = max(1.0, 1 / (max(log.step, 1e-9) * MAX_RATE_HZ), len(log) / (max_samples or len(log)))
    for number, run in enumerate(log.runs(), 1):
        own = None if torque is None else torque[log.run == run.run[0]]
        part = _run(_with_delayed_commands(run, arm), log.step, own, widths, round(rows), kernel)
        if part is not None:
            part["time"] = part["time"] + start
            part["run"] = np.full(len(part["time"]), float(number))
            parts.append(part)
        start += float(run.time[-1] - run.time[0]) + PAUSE_BETWEEN_RUNS_S
    if not parts:
        raise InputError(f"{log.source}: no run of two seconds or more; log 20 s or more of motion")
    signals = {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}
    memory = {w: signals.pop(f"memory {w}") for w in widths}
    if "heat" in signals:
        signals["heat"] = signals["heat"] - signals["heat"].min(axis=0)
    return Motion(**signals, memory=memory, quantum=quantum)


def _with_delayed_commands(run: JointLog, arm: Arm) -> JointLog:
    """Return a run with the commands shifted by the declared delay, as the servos receive them."""
    if run.command is None or arm.delay is None:
        return run
    delayed = np.array(run.command)
    for c, d in zip(delayed.T, arm.delay, strict=True):
        finite = np.isfinite(c)
        if finite.any():
            c[:] = np.interp(run.time - d, run.time[finite], c[finite])
    return replace(run, command=delayed)


def torque_of(log: JointLog, arm: Arm) -> Array | None:
    """Return the logged torque, or that computed from the current, shape (rows, joints) [N m].

    It is the current itself [A] where the torque constant is not declared; None where neither was
    logged, or the current without a sign.
    """
    if log.torque is not None:
        return log.torque
    if log.current is None or log.current_unsigned:
        return None
    return np.asarray(log.current * (1.0 if arm.per_ampere is None else arm.per_ampere))


def _run(
    run: JointLog,
    step: float,
    torque: Array | None,
    widths: tuple[float, ...],
    every: int,
    kernel: Array,
) -> dict[str, Array] | None:
    """Return the signals of a run by name of the field of `Motion`; None if under two seconds.

    step : time between samples [s]; torque : shape (rows, joints) or None; widths : see `motion_of`
    every : number of samples of which one is taken; kernel : smooths all signals
    """
    t = np.arange(run.time[0], run.time[-1], step) if step else np.zeros(0)
    if len(t) < 2.0 / max(step, 1e-9):
        return None
    # Time at both ends of each run that is excluded [s].
    edge = int(0.15 / step)
    samples = slice(edge, len(t) - edge, every)

    def smooth(values: Array) -> Array:
        """Return columns at the uniform times, smoothed."""
        return smoothed(resampled(values, run.time, t), kernel)

    def rate(values: Array) -> Array:
        """Return the time derivative of columns at the uniform times [1/s]."""
        return np.asarray(np.gradient(values, step, axis=0))

    signals: dict[str, Array] = {}
    position = smooth(run.position)
    if run.command is not None:
        c = smooth(run.command)
        signals |= {"command": c, "command_v": rate(c), "command_a": rate(rate(c))}
    q, v = position, rate(position)
    signals |= {"position": position, "q": q, "v": v, "a": rate(v)}
    if torque is not None:
        signals["torque"] = smooth(torque)
    if run.temperature is not None and np.isfinite(run.temperature).any(axis=0).all():
        signals["heat"] = smooth(run.temperature)
    # A joint is at rest below 2 % of its rms speed, or 2 mrad/s if it moves slowly.
    stands = np.abs(v) < np.maximum(0.02 * np.sqrt((v**2).mean(axis=0)), 2e-3)
    at = np.arange(len(t))[:, None]
    signals["rest"] = step * (at - np.maximum.accumulate(np.where(stands, -1, at), axis=0))
    used = {"time": t[samples] - t[0], **{k: values[samples] for k, values in signals.items()}}
    # The play's memory is that of the used samples alone, from the first of the run.
    rows = slice(edge // every, edge // every + len(used["time"]))
    return used | {f"memory {w}": play_operator(q[edge % every :: every], w)[rows] for w in widths}


def resampled(values: Array, time: Array, t: Array) -> Array:
    """Return columns linearly interpolated at the times t [s], shape (len(t), columns).

    values : at the times `time` [s], shape (len(time), columns); values that are not finite are
        ignored, and columns without finite ones are zero
    """
    there = np.isfinite(values).T
    columns = (
        np.interp(t, time[k], c[k]) if k.any() else np.zeros(len(t)) for c, k in zip(values.T, there, strict=True)
    )
    return np.column_stack([*columns])


def smoothing_kernel(step: float, width: float = SMOOTHING_WIDTH_S) -> Array:
    """Return the kernel that smooths all signals of a log, symmetric, of sum one.

    step : time between samples [s]; width : of the kernel [s]
    """
    half = max(1, round(width / step / 2))
    kernel = np.hanning(2 * half + 3)[1:-1]
    return np.asarray(kernel / kernel.sum())


def smoothed(values: Array, kernel: Array) -> Array:
    """Return columns of uniform samples convolved with a kernel, shape (n, columns)."""
    padded = np.pad(values, ((len(kernel) // 2,) * 2, (0, 0)), "edge")
    return np.column_stack([np.convolve(column, kernel, "valid") for column in padded.T])


def play_operator(q: Array, width: float) -> Array:
    """Return the position of an angle within a play that it drags along, -1 to 1, shape of q.

    It is a hysteresis state that models the memory of dry friction (Iwan 1966).
    q : angles in time order, shape (n, joints) [rad]; width : half-width of the play [rad]
    """
    out, centre = np.empty_like(q), q[0].copy()
    for row, low, high in zip(out, q - width, q + width, strict=True):
        np.maximum(centre, low, out=centre)
        np.minimum(centre, high, out=centre)
        row[:] = centre
    return np.asarray((q - out) / width)


def lagged(values: Array, within: float, step: float) -> Array:
    """Return values after a first-order low-pass filter, shape (n, ...).

    values : in time order, shape (n, ...)
    within : time constant of the filter [s]; step : time between samples [s]
    """
    out, keeps = np.empty_like(values), within / (within + step)
    k = np.arange(min(FILTER_BLOCK_SAMPLES, len(values)))
    weight = (1 - keeps) * np.tril(keeps ** np.abs(k[:, None] - k))
    now = values[0]
    for start in range(0, len(values), FILTER_BLOCK_SAMPLES):
        part = values[start : start + FILTER_BLOCK_SAMPLES]
        own = slice(start, start + len(part))
        out[own] = weight[: len(part), : len(part)] @ part + keeps ** (k[: len(part), None] + 1) * now
        now = out[own][-1]
    return out


def delayed(values: Array, samples: Array | float) -> Array:
    """Return the columns of a run delayed in time, shape (n, columns).

    samples : delay in samples, of all columns or of each, shape (columns,); may be fractional
    """
    at, each = np.arange(len(values)), np.broadcast_to(samples, values.shape[1])
    return np.column_stack([np.interp(at - d, at, v) for v, d in zip(values.T, each, strict=True)])


def servo_error(torque: Array, arm: Arm, step: float, start: Array) -> Array:
    """Return the position error e at which each servo gives a torque, (samples, joints) [rad].

    It solves kd e' + kp e + ki int e dt = torque.
    torque : shape (samples, joints) [N m]; step : time between samples [s]
    start : error at the first sample, shape (joints,) [rad]
    """
    assert arm.kp is not None
    n = torque.shape[1]
    kp, kd, ki = arm.kp, np.zeros(n) if arm.kd is None else arm.kd, np.zeros(n) if arm.ki is None else arm.ki
    e, out = np.array(start), np.empty_like(torque)
    integral = np.where(ki > 0, torque[0] - kp * start, 0.0)
    for k, now in enumerate(torque):
        e = (now - integral + kd / step * e) / (kd / step + kp + ki * step)
        integral = integral + ki * step * e
        out[k] = e
    return out


@dataclass(frozen=True)
class Fault:
    """A fault of the log itself, not of the arm.

    name : identifier in JSON; sentence : description of the fault; remedy : advice to the user
    """

    name: str
    sentence: str
    remedy: str


def faults_of(log: JointLog, arm: Arm, reference: JointLog | None) -> Iterator[Fault]:
    """Yield the faults of the log itself: clock, lost or repeated samples, current without sign.

    reference : a healthy log, whose sample rate is the true one if the arm declares none
    """
    step = _mean_step(log)
    rate = arm.log_rate or (1 / _mean_step(reference) if reference else None)
    # Relative error of the sample rate above which the clock is faulty.
    if rate and abs((factor := step * rate) - 1) > 0.005:
        yield Fault(
            "clock_scale",
            f"the clock of the log runs wrong by a factor of {factor:.3f} ({1 / step:.4g} rows a second, "
            f"{rate:.4g} expected)",
            f"Divide time_s by {factor:.3f}, or state the true rate as log_rate_Hz in [drive].",
        )
    steps = np.diff(log.time)[np.diff(log.run) == 0] / max(log.step, 1e-12)
    lost = float(np.round(steps[steps > MIN_GAP_STEPS] - 1).sum() / max(steps.sum(), 1.0))
    repeated = _repeated_share(log)
    # Fractions of missing samples, and of repeated ones in motion, above which a log is faulty.
    if lost > 0.01 or repeated > 0.02:
        yield Fault(
            "lost_samples",
            f"samples are missing ({100 * lost:.1f} %) or repeated ({100 * repeated:.1f} %)",
            "Log over a wired link, at a rate that the link carries; rows that are missing are interpolated here.",
        )
    if log.signs_lost:
        yield Fault(
            "unsigned_current",
            f"the {log.signs_lost} is logged without its sign",
            "Until it has one, friction and load are identified by the response to commands.",
        )


def _mean_step(log: JointLog) -> float:
    """Return the mean time between rows without gaps [s], exact where times are rounded."""
    steps = np.diff(log.time)[np.diff(log.run) == 0]
    return float(steps[steps < MIN_GAP_STEPS * log.step].mean())


def _repeated_share(log: JointLog) -> float:
    """Return the fraction of rows in motion at which no joint's reading changes, 0 to 1.

    In motion, some joint's mean change over nine rows exceeds `MIN_MOVING_QUANTA` times its smallest
    change. The fraction is 0 for less than 10 such rows.
    """
    step = np.abs(np.diff(log.position, axis=0))
    step[np.diff(log.run) != 0] = np.nan
    smallest = np.where(step > 0, step, np.inf).min(axis=0)
    usual = np.array([np.convolve(np.nan_to_num(column), np.ones(9) / 9, "same") for column in step.T]).T
    moving = (usual > MIN_MOVING_QUANTA * np.where(np.isfinite(smallest), smallest, np.inf)).any(axis=1)
    same = (step == 0).all(axis=1)
    return float((same & moving).sum() / moving.sum()) if moving.sum() >= 10 else 0.0
