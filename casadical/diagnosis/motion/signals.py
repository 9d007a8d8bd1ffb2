"""A joint log as smooth signals on a uniform time, with their derivatives, and averages over short windows; and faults
of the instrument that wrote it: its clock, lost or repeated samples, a current without sign. And what is known of the
arm that moved: its bodies and its drives, one number a joint, None where nothing is known.

Everything is smoothed alike, by one symmetric kernel, so that no signal is late against another.
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

# Width of the smoothing kernel, of a window, and of what is left out at the ends of a run [s].
SMOOTHED, WINDOW, EDGE = 0.08, 0.1, 0.15
# Most samples a second, and most windows, that are judged; between runs there is about so much time [s].
RATE, MOST_WINDOWS, PAUSE = 62.5, 1500, 10.0
# A joint below this share of its usual speed, or this speed [rad/s], stands.
STANDS, SLOW = 0.02, 2e-3
# Samples that a filter takes at a time, and states of which the regressor is made.
AT_ONCE, STATES = 64, 4000
# No reading is finer than this [rad].
LEAST_QUANTUM = 1e-6
# A rate that is off by this share; shares of samples that are lost or repeated which every log has.
CLOCK, USUAL_LOST, USUAL_REPEATED = 0.01, 0.01, 0.02
# A gap is longer than so many steps; a joint moves by more than so many quanta a step.
GAP, MOVES = 1.6, 3.0


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
        for k in range(0, len(q), STATES):
            s = slice(k, k + STATES)
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


@dataclass(frozen=True, eq=False)
class Motion:
    """Signals of a log, shape (n, joints) each unless said otherwise; SI units.

    time : since the log began, pauses included, shape (n,); run : number of each sample's, 1 ..., shape (n,)
    position : measured; q, v, a : measured too, or commanded where the motion is taken from there
    command, command_v, command_a : late by the delay that is known; or None
    torque : at the joints, or None; heat : temperature above the least, or None
    memory : play operators of the angle, by width, -1 to 1; widths : of them [rad]
    rest : time since the joint stood still; unmoved : 1 until it first moved in its run
    quantum : smallest step of each joint's readings, shape (joints,)
    windows : samples of each window, shape (windows, k); first : whether it is the first of its run
    """

    time: Array
    run: Array
    position: Array
    q: Array
    v: Array
    a: Array
    memory: Mapping[float, Array]
    rest: Array
    unmoved: Array
    quantum: Array
    windows: Array
    first: Array
    command: Array | None = None
    command_v: Array | None = None
    command_a: Array | None = None
    torque: Array | None = None
    heat: Array | None = None

    def averaged(self, values: Array) -> Array:
        """Over each window, shape (windows, ...); values : of each sample, shape (n, ...)."""
        return np.asarray(values[self.windows].mean(axis=1))

    @property
    def step(self) -> float:
        """Between samples [s]."""
        return float(np.median(np.diff(self.time)))

    def by_run(self, change: Callable[[Array], Array], values: Array) -> Array:
        """Something that has a memory, run by run."""
        ends = [0, *(np.flatnonzero(np.diff(self.run)) + 1).tolist(), len(self.run)]
        return np.concatenate([change(values[a:b]) for a, b in pairwise(ends)])


def motion_of(log: JointLog, arm: Arm, widths: tuple[float, ...], *, of_command: bool = False) -> Motion:
    """The signals of a log; widths : of the memory [rad]; of_command : q is the command, for a log without torque.

    Raises InputError for a log that is too short.
    """
    parts: list[dict[str, Array]] = []
    start, torque = 0.0, torque_of(log, arm)
    for number, run in enumerate(log.runs(), 1):
        own = None if torque is None else torque[log.run == run.run[0]]
        part = _run(_in_time(run, arm), log.step, own, widths, of_command)
        if part is not None:
            part["time"] = part["time"] + start
            part["run"] = np.full(len(part["time"]), float(number))
            parts.append(part)
        start += float(run.time[-1] - run.time[0]) + PAUSE
    if not parts:
        raise InputError(f"{log.source}: no run of two seconds or more; log 20 s or more of motion")
    steps = [float(np.median(np.diff(p["time"]))) for p in parts]
    seconds = sum(len(p["time"]) * s for p, s in zip(parts, steps, strict=True))
    size = max(1, round(max(WINDOW, seconds / MOST_WINDOWS) / steps[0]))
    windows, first, at = [], [], 0
    for part in parts:
        count = len(part["time"]) // size
        windows.append(at + size * np.arange(count)[:, None] + np.arange(size))
        first.append(np.arange(count) == 0)
        at += len(part["time"])
    whole = {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}
    memory = {w: whole.pop(f"memory {w}") for w in widths}
    if "heat" in whole:
        whole["heat"] = whole["heat"] - whole["heat"].min(axis=0)
    steps_of = np.abs(np.diff(log.position, axis=0))
    smallest = np.where(steps_of > LEAST_QUANTUM, steps_of, np.inf).min(axis=0)
    return Motion(
        **whole,
        memory=memory,
        quantum=np.where(np.isfinite(smallest), smallest, LEAST_QUANTUM),
        windows=np.concatenate(windows),
        first=np.concatenate(first),
    )


def _in_time(run: JointLog, arm: Arm) -> JointLog:
    """A run with the commands as the servos have them, late by the delay that is known."""
    if run.command is None or arm.delay is None:
        return run
    late = np.array(run.command)
    for c, d in zip(late.T, arm.delay, strict=True):
        known = np.isfinite(c)
        if known.any():
            c[:] = np.interp(run.time - d, run.time[known], c[known])
    return replace(run, command=late)


def torque_of(log: JointLog, arm: Arm) -> Array | None:
    """As logged, or by the current: in N m where the drive's constant is known, else in A; shape (rows, joints)."""
    if log.torque is not None:
        return log.torque
    if log.current is None or log.current_unsigned:
        return None
    return np.asarray(log.current * (1.0 if arm.per_ampere is None else arm.per_ampere))


def _run(
    run: JointLog, step: float, torque: Array | None, widths: tuple[float, ...], of_command: bool
) -> dict[str, Array] | None:
    t = np.arange(run.time[0], run.time[-1], step) if step else np.zeros(0)
    if len(t) < 2.0 / max(step, 1e-9):
        return None
    edge, every = int(EDGE / step), max(1, round(1 / (step * RATE)))
    kept = slice(edge, len(t) - edge, every)

    def smooth(values: Array) -> Array:
        return smoothed(even(values, run.time, t), kernel_of(step))

    def rate(values: Array) -> Array:
        return np.asarray(np.gradient(values, step, axis=0))

    signals: dict[str, Array] = {}
    position = smooth(run.position)
    if run.command is not None:
        c = smooth(run.command)
        signals |= {"command": c, "command_v": rate(c), "command_a": rate(rate(c))}
    q = signals["command"] if of_command else position
    v = rate(q)
    signals |= {"position": position, "q": q, "v": v, "a": rate(v)}
    if torque is not None:
        signals["torque"] = smooth(torque)
    if run.temperature is not None and np.isfinite(run.temperature).any(axis=0).all():
        signals["heat"] = smooth(run.temperature)
    signals |= {f"memory {w}": play(q, w) for w in widths}
    stands = np.abs(v) < np.maximum(STANDS * np.sqrt((v**2).mean(axis=0)), SLOW)
    at = np.arange(len(t))[:, None]
    signals["rest"] = step * (at - np.maximum.accumulate(np.where(stands, -1, at), axis=0))
    # A joint has not moved in a run while it is within this of where it began [rad].
    signals["unmoved"] = np.minimum.accumulate(np.abs(q - q[0]) < 5e-3, axis=0) * 1.0
    return {"time": t[kept] - t[0], **{k: values[kept] for k, values in signals.items()}}


def even(values: Array, time: Array, t: Array) -> Array:
    """Columns at other times, where they are known; values : shape (len(time), columns)."""
    there = np.isfinite(values).T
    columns = (
        np.interp(t, time[k], c[k]) if k.any() else np.zeros(len(t)) for c, k in zip(values.T, there, strict=True)
    )
    return np.column_stack([*columns])


def kernel_of(step: float) -> Array:
    """By which all signals of a log are smoothed; step : between samples [s]."""
    half = max(1, round(SMOOTHED / step / 2))
    kernel = np.hanning(2 * half + 3)[1:-1]
    return np.asarray(kernel / kernel.sum())


def smoothed(values: Array, kernel: Array) -> Array:
    """Columns of even samples through a kernel."""
    padded = np.pad(values, ((len(kernel) // 2,) * 2, (0, 0)), "edge")
    return np.column_stack([np.convolve(column, kernel, "valid") for column in padded.T])


def play(q: Array, width: float) -> Array:
    """Where an angle lies in a play that it drags along, -1 to 1: the memory of dry friction (Iwan 1966)."""
    out, centre = np.empty_like(q), q[0].copy()
    for row, low, high in zip(out, q - width, q + width, strict=True):
        np.maximum(centre, low, out=centre)
        np.minimum(centre, high, out=centre)
        row[:] = centre
    return np.asarray((q - out) / width)


def lagged(values: Array, within: float, step: float) -> Array:
    """Values through a first-order filter."""
    out, keeps = np.empty_like(values), within / (within + step)
    k = np.arange(min(AT_ONCE, len(values)))
    weight = (1 - keeps) * np.tril(keeps ** np.abs(k[:, None] - k))
    now = values[0]
    for start in range(0, len(values), AT_ONCE):
        part = values[start : start + AT_ONCE]
        own = slice(start, start + len(part))
        out[own] = weight[: len(part), : len(part)] @ part + keeps ** (k[: len(part), None] + 1) * now
        now = out[own][-1]
    return out


def late(values: Array, samples: Array | float) -> Array:
    """Columns of a run that come so many samples later, shape (n, columns); samples : of all, or shape (columns,)."""
    at, each = np.arange(len(values)), np.broadcast_to(samples, values.shape[1])
    return np.column_stack([np.interp(at - d, at, v) for v, d in zip(values.T, each, strict=True)])


def servo_error(torque: Array, arm: Arm, step: float, start: Array) -> Array:
    """Position error e that makes a servo give a torque, kd e' + kp e + ki int e dt = torque; shape as the torque.

    start : at the first sample, shape (joints,)
    """
    assert arm.kp is not None
    n = torque.shape[1]
    kp, kd, ki = arm.kp, np.zeros(n) if arm.kd is None else arm.kd, np.zeros(n) if arm.ki is None else arm.ki
    e, out = np.array(start), np.empty_like(torque)
    held = np.where(ki > 0, torque[0] - kp * start, 0.0)
    for k, now in enumerate(torque):
        e = (now - held + kd / step * e) / (kd / step + kp + ki * step)
        held = held + ki * step * e
        out[k] = e
    return out


@dataclass(frozen=True)
class Fault:
    """A fault of the instrument. name : by which answers name it; sentence : what was found; remedy : what to do"""

    name: str
    sentence: str
    remedy: str


def faults_of(log: JointLog, arm: Arm, reference: JointLog | None) -> Iterator[Fault]:
    """What is wrong with the log itself."""
    rate = arm.log_rate or (1 / reference.step if reference else None)
    if rate and abs((factor := log.step * rate) - 1) > CLOCK:
        yield Fault(
            "clock_scale",
            f"the clock of the log runs wrong by a factor of {factor:.3f} ({1 / log.step:.4g} rows a second, "
            f"{rate:.4g} are known)",
            f"Divide time_s by {factor:.3f}, or state the true rate as log_rate_Hz in [drive].",
        )
    steps = np.diff(log.time)[np.diff(log.run) == 0] / max(log.step, 1e-12)
    lost = float(np.round(steps[steps > GAP] - 1).sum() / max(steps.sum(), 1.0))
    repeated = _repeated_share(log)
    if lost > USUAL_LOST or repeated > USUAL_REPEATED:
        yield Fault(
            "lost_samples",
            f"samples are missing ({100 * lost:.1f} %) or repeated ({100 * repeated:.1f} %)",
            "Log over a wired link, at a rate that the link carries; rows that are missing are interpolated here.",
        )
    if log.signs_lost:
        yield Fault(
            "unsigned_current",
            f"the {log.signs_lost} is logged without its sign",
            "Until it has one, friction and load are told by the response to commands.",
        )


def _repeated_share(log: JointLog) -> float:
    """Share of the rows in which all joints read as before although some move by many quanta a step around them."""
    step = np.abs(np.diff(log.position, axis=0))
    step[np.diff(log.run) != 0] = np.nan
    smallest = np.where(step > 0, step, np.inf).min(axis=0)
    usual = np.array([np.convolve(np.nan_to_num(column), np.ones(9) / 9, "same") for column in step.T]).T
    moving = (usual > MOVES * np.where(np.isfinite(smallest), smallest, np.inf)).any(axis=1)
    same = (step == 0).all(axis=1)
    return float((same & moving).sum() / moving.sum()) if moving.sum() >= 10 else 0.0
