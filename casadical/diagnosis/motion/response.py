"""Identified response of joints to commands: servo gain, friction, damping, inertia, delay.

J q'' + b q' + F sign(q') + g(c) + o = kp (c(t - delay) - q), and a joint sticks where the remaining
torque is within F: droop under gravity, hysteresis over the command's history, lag and delay, as a
simulator's joint has them. It is stepped by the implicit midpoint rule, dry friction as in Moreau's
(1988) time stepping. Parameters are fitted by Levenberg-Marquardt steps with priors and less weight
on outliers, without the samples in contact with a surface; masses are those of the robot file.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.drive import Drive
from casadical.core.levenberg_marquardt import Evaluated, levenberg_marquardt
from casadical.diagnosis.motion.floor import (
    CONTACT_MARGIN_M,
    INDEPENDENT_SAMPLE_FRACTION,
    OUTLIER_SIGMAS,
    Floor,
    Stop,
    floor_of,
    stops_of,
)
from casadical.diagnosis.motion.signals import (
    MAX_RATE_HZ,
    Arm,
    arm_of,
    delayed,
    resampled,
    smoothed,
    torque_of,
)
from casadical.measurements.logs.log import JointLog
from casadical.robot.dynamics import Dynamics
from casadical.robot.robot import Robot

PIECE_DURATION_S = 30.0  # runs are divided into pieces of about this duration for the fit [s]
# Prior standard deviation of the logarithms of damping / gain, inertia / gain and delay.
SIGMA_LOG_TIMES = 1.5
# A joint is lightly loaded if its rms gravity torque, divided by the largest one of all joints, is
# below this: its log cannot show the compliance.
LIGHT_LOAD_SHARE = 0.1
DIFFERENCE_STEP = 1e-4  # step of finite differences of the parameters, logarithms or [rad]
# Decimals to which a Levenberg-Marquardt step is rounded. Where the cost has kinks (a delay that
# passes a sample, a joint that sticks), steps amplify rounding errors, and processors would arrive
# at different parameters.
STEP_DECIMALS = 6
MIN_ROTOR_SHARE = 0.05  # smallest rotor inertia, divided by the joint's inertia
# Number of parameters of each joint: logarithm of the compliance, offset, logarithms of friction,
# damping and inertia (all three divided by the gain) and of the delay.
PARAMETERS_PER_JOINT = 6
_LOG_PARAMETERS = [0, 2, 3, 4, 5]  # indices of a joint's parameters that are logarithms


@dataclass(frozen=True, eq=False)
class Piece:
    """Uniform samples of a part of a run.

    command, position : commanded and measured angles, shape (samples, joints) [rad]
    step : time between samples [s]
    """

    command: Array
    position: Array
    step: float


@dataclass(frozen=True, eq=False)
class Response:
    """Identified response of all joints to their commands; fields have the shape (joints,).

    dynamics : inverse dynamics of the robot
    gain : gain of the servo [N m/rad]; bias : constant torque [N m]; friction : dry friction [N m]
    damping : viscous damping [N m s/rad]; delay : delay of the command [s]
    inertia : inertia of the joint, rotor included [kg m^2]; fitted : sources of the logs
    moved : mask of the joints that moved in them; the others have the priors' typical response
    floor : surface on which the tool came to rest, or None
    gravity : whether gravity loads the joints
    log_values : natural logarithms of gain, friction / gain, damping / gain, inertia / gain and
        delay [SI], shape (joints, 5)
    log_covariance : their covariance for each joint, shape (joints, 5, 5)
    log_widths : their prior standard deviations, shape (joints, 5)
    stops : angles at which joints stop while commands go on
    """

    dynamics: Dynamics
    gain: Array
    bias: Array
    friction: Array
    damping: Array
    inertia: Array
    delay: Array
    fitted: tuple[str, ...]
    moved: Array
    floor: Floor | None = None
    gravity: bool = True
    log_values: Array | None = None
    log_covariance: Array | None = None
    log_widths: Array | None = None
    stops: tuple[Stop, ...] = ()

    def predicted(self, log: JointLog) -> Array:
        """Return the positions simulated from a log's commands, shape (rows, joints) [rad].

        Each run begins at its first reading; no later reading is used.
        """
        out = []
        for run in log.runs():
            (piece,) = pieces_of(run, np.inf)
            load = self.gravity * self.dynamics.torque(piece.command, *[np.zeros_like(piece.command)] * 2)
            friction, lag, inertia = (each / self.gain for each in (self.friction, self.damping, self.inertia))
            balance = delayed(piece.command, self.delay / piece.step) - (load + self.bias) / self.gain
            q = simulated(
                _midpoints(balance),
                len(balance) - 1,
                piece.position[0],
                np.array(piece.step),
                friction,
                lag,
                inertia,
                self.floor,
                self.gain,
                limits_of(self.stops, len(self.gain)),
            )
            t = run.time[0] + piece.step * np.arange(len(q))
            out.append(np.column_stack([np.interp(run.time, t, column) for column in q.T]))
        return np.concatenate(out)

    def friction_of(self, run: JointLog) -> tuple[Array, Array]:
        """Return speed [rad/s] and friction torque [N m] in a run, from the servo's equation.

        Both have shape (samples, joints), at uniform times.
        """
        (piece,) = pieces_of(run, np.inf)
        q = smoothed(piece.position, np.hanning(9)[1:-1] / 4)
        v = np.gradient(q, piece.step, axis=0)
        load = self.dynamics.torque(q, *[np.zeros_like(q)] * 2)
        wanted = delayed(piece.command, self.delay / piece.step)
        inertia = self.inertia * np.gradient(v, piece.step, axis=0)
        return v, self.gain * (wanted - q) - load - self.bias - inertia

    def robot(self) -> Robot:
        """Return the given robot with the identified parameters as its drives."""
        return replace(self.dynamics.given, drive=self.drive())

    @cached_property
    def armature(self) -> Array:
        """Return the rotor inertia at each joint, shape (joints,) [kg m^2].

        It is the joint's inertia minus that of the links (`link_inertia`), and at least
        `MIN_ROTOR_SHARE` of the former.
        """
        return np.asarray(np.maximum(self.inertia - link_inertia(self.dynamics), MIN_ROTOR_SHARE * self.inertia))

    def drive(self) -> Drive:
        """Return the given robot's drive with identified parameters, stops and surface, rounded."""
        numbers = {
            "kp": self.gain,
            "bias": self.bias,
            "friction": self.friction,
            "damping": self.damping,
            "rotor_inertia_at_joint": self.armature,
            "delay": self.delay,
        }
        rounded: dict[str, Any] = {name: [float(f"{v:.4g}") for v in each] for name, each in numbers.items()}
        if limits := limits_of(self.stops, len(self.gain)):
            # Joints without a stop get the range of an exported model, 2 % beyond the declared one.
            beyond = 0.02 * np.ptp(self.dynamics.robot.limits, axis=0)
            for name, end, own, way in zip(
                ("lower_stop", "upper_stop"), limits, self.dynamics.robot.limits, (-1, 1), strict=True
            ):
                rounded[name] = np.where(np.isfinite(end), end, own + way * beyond).round(4).tolist()
        if self.floor:
            rounded["floor"] = round(self.floor.height, 4)
        return (self.dynamics.given.drive or Drive()).model_copy(update=rounded)


def link_inertia(dynamics: Dynamics) -> Array:
    """Return the links' inertia at each joint, all at mid range, shape (joints,) [kg m^2]."""
    n = dynamics.robot.n
    middle, none = np.tile(np.mean(dynamics.robot.limits, axis=0), (n, 1)), np.zeros((n, n))
    values = np.append(dynamics.values[: 10 * n], np.zeros(n))
    return np.diag(dynamics.torque(middle, none, np.eye(n), values, np.zeros(3)))


def response_of(robot: Robot) -> Response:
    """Return the response that the drives of a robot declare; undeclared parameters are zero."""
    drive, dynamics, n = robot.drive or Drive(), arm_of(robot).dynamics, robot.n
    names = ("kp", "bias", "friction", "damping", "rotor_inertia_at_joint", "delay")
    values = (drive.of_joints(name, n) for name in names)
    gain, bias, friction, damping, rotor, delay = (np.zeros(n) if v is None else v for v in values)
    ends = [(way, drive.of_joints(name, n)) for way, name in ((-1, "lower_stop"), (1, "upper_stop"))]
    stops = [Stop(j, way, float(a), 0, 0, None) for way, e in ends if e is not None for j, a in enumerate(e)]
    floor, inertia = None if drive.floor is None else Floor(dynamics, drive.floor), rotor + link_inertia(dynamics)
    moved = np.ones(n, dtype=bool)
    return Response(dynamics, gain, bias, friction, damping, inertia, delay, (), moved, floor=floor, stops=tuple(stops))


def pieces_of(run: JointLog, length: float = PIECE_DURATION_S) -> list[Piece]:
    """Return a run resampled at uniform times and divided into pieces of about equal length.

    length : duration of a piece [s]; infinite: one piece. Else runs of less than two seconds, and
        any with a single row, give no piece
    Raises InputError: the run has no commands.
    """
    if run.command is None:
        raise InputError(f"{run.source}: no commands, and so no replay; log command1_rad ...")
    seconds = float(run.time[-1] - run.time[0])
    if not run.step or (seconds < 2 and length < np.inf):
        return []
    step = run.step * max(1, int(1 / (run.step * MAX_RATE_HZ)))
    t = np.arange(run.time[0], run.time[-1] + step / 2, step)
    command, position = (resampled(values, run.time, t) for values in (run.command, run.position))
    count = max(1, round(seconds / length)) if length < np.inf else 1
    ends = np.linspace(0, len(t), count + 1).astype(int)
    return [Piece(command[a:b], position[a:b], step) for a, b in pairwise(ends.tolist())]


def _midpoints(values: Array) -> Array:
    """Return the means of each row and the next one, shape (rows - 1, ...)."""
    return np.asarray((values[1:] + values[:-1]) / 2)


def simulated(
    balance: Iterable[Array],
    steps: int,
    start: Array,
    step: Array,
    friction: Array,
    lag: Array,
    inertia: Array,
    floor: Floor | None = None,
    gain: Array | None = None,
    limits: tuple[Array, Array] | None = None,
    commands: Iterable[Array] | None = None,
    capacity: Array | None = None,
) -> Array:
    """Return simulated joint angles, shape (1 + steps, ...) [rad]; the first ones are `start`.

    balance : for each step the angle [rad] at which each joint would come to rest, in the middle of
        the step; arrays (...) that are overwritten
    step : time between samples [s]
    friction, lag, inertia : dry friction [rad], damping [s] and inertia [s^2], divided by the
        servo's gain; friction may be of each sample, shape (1 + steps, ...)
    floor : surface above which the tool stays, for arrays (joints,) only; needs `gain` [N m/rad]
    limits : smallest and largest angle of each joint, by its stops [rad]
    commands : command for each step, in its middle [rad], for `capacity`, the largest position
        error that the servo acts on [rad]
    """
    keeps, gives = 2 * inertia / step, 1 / (2 * inertia / step + lag + step / 2)
    shape = np.broadcast_shapes(start.shape, gives.shape)
    out, q, v = np.empty((1 + steps, *shape)), np.broadcast_to(start, shape).astype(float), np.zeros(shape)
    pushed, resisted, wanted = 0.0, np.empty(shape), iter(commands if commands is not None else ())
    levels = friction if friction.ndim > len(shape) else np.broadcast_to(friction, (1 + steps, *friction.shape))
    band = [levels[0]]

    def slid(push: Array) -> Array:
        """Return the mean joint velocities in a step, computed in place of `push` [rad/s].

        push : torques divided by the gain [rad]; dry friction reduces them by up to its limit
        """
        np.minimum(push, band[0], out=resisted)
        np.maximum(resisted, -band[0], out=resisted)
        push -= resisted
        push *= gives
        return push

    def ends(q: Array, push: Array, torque: Array) -> Array:
        """Return the angles [rad] at the end of a step with additional joint torques [N m]."""
        return np.asarray(q + step * slid(push + torque / gain))

    out[0] = q
    for k, push in enumerate(balance, 1):
        push -= q
        if capacity is not None:
            error = next(wanted) - q
            push -= error - np.clip(error, -capacity, capacity)
        push += keeps * v
        band[0] = levels[k]
        if floor is not None and gain is not None:
            torque, pushed = floor.contact(partial(ends, q, push), step * gives / gain, pushed)
            push += torque / gain
        slid(push)
        v = push.copy() if pushed else (2 * push - v) * (push != 0)
        q = np.add(q, step * push, out=out[k])
        if limits is not None:
            v *= (q >= limits[0]) & (q <= limits[1])
            q = np.clip(q, *limits, out=q)
    return out


def limits_of(stops: Sequence[Stop], joints: int) -> tuple[Array, Array] | None:
    """Return the smallest and largest angle of each joint, shape (joints,) each [rad].

    They are infinite without a stop; None without any.
    """
    limits = np.full(joints, -np.inf), np.full(joints, np.inf)
    for stop in stops:
        limits[stop.way > 0][stop.joint] = stop.angle
    return limits if stops else None


@dataclass(frozen=True, eq=False)
class _Problem:
    """Pieces of runs in arrays (steps, pieces, joints), with priors of the parameters.

    command, position : commanded and measured angles [rad]
    weight : weight of each sample, 0 behind a piece's end
    load : gravity torque along the command [N m]
    step : time between samples, shape (pieces, joints) [s]
    middle, width : prior means and standard deviations of the parameters, logarithms and offset, in
        the order described at `PARAMETERS_PER_JOINT`, shape (joints, PARAMETERS_PER_JOINT)
    limits : smallest and largest angles (see `limits_of`)
    """

    command: Array
    position: Array
    weight: Array
    load: Array
    step: Array
    middle: Array
    width: Array
    limits: tuple[Array, Array] | None = None

    def angles(self, x: Array) -> Array:
        """Return simulated angles for variants of the parameters.

        Their shape is (steps, pieces, joints, variants) [rad].
        x : parameters, shape (joints, PARAMETERS_PER_JOINT, variants); all variants but the last
            one must have equal delays
        """
        x = x.copy()
        x[:, _LOG_PARAMETERS] = np.exp(x[:, _LOG_PARAMETERS])
        yields, offset, friction, lag, inertia, delay = x.transpose(1, 0, 2)
        # Only the last of the variants has another delay.
        first, last = (
            _midpoints(
                np.stack([delayed(c, d / h) for c, h in zip(self.command.swapaxes(0, 1), self.step, strict=True)], 1)
            )
            for d in (delay[:, 0], delay[:, -1])
        )

        def balance() -> Iterator[Array]:
            """Yield, for each step, the angles at which the joints would come to rest [rad]."""
            for command, more, load in zip(first, last - first, _midpoints(self.load), strict=True):
                rest = command[..., None] - yields * load[..., None]
                rest -= offset
                rest[..., -1] += more
                yield rest

        limits = None if self.limits is None else (self.limits[0][:, None], self.limits[1][:, None])
        return simulated(
            balance(),
            len(first),
            self.position[0][..., None],
            self.step[..., None],
            friction,
            lag,
            inertia,
            limits=limits,
        )

    def residual(self, x: Array) -> tuple[Array, Array]:
        """Return measured minus simulated angles, and the latter's derivatives by the parameters.

        Shapes are (steps, pieces, joints) [rad] and (steps, pieces, joints, PARAMETERS_PER_JOINT).
        x : parameters, shape (joints, PARAMETERS_PER_JOINT)
        """
        variants = np.repeat(x[:, :, None], 1 + PARAMETERS_PER_JOINT, axis=2)
        variants[:, np.arange(PARAMETERS_PER_JOINT), 1 + np.arange(PARAMETERS_PER_JOINT)] += DIFFERENCE_STEP
        angles = self.angles(variants)
        return self.position - angles[..., 0], (angles[..., 1:] - angles[..., :1]) / DIFFERENCE_STEP


def fitted(robot: Robot, *parts: Sequence[JointLog]) -> list[Response]:
    """Return the response of all joints identified from each set of logs, one for each set.

    All sets are simulated together, which costs little more than one.
    parts : sets of logs
    Raises InputError: logs without commands, or without a run of two seconds.
    """
    arm = arm_of(robot)
    runs = [[run for log in logs for run in log.runs()] for logs in parts]
    pieces = [[piece for run in each for piece in pieces_of(run)] for each in runs]
    for logs, each in zip(parts, pieces, strict=True):
        if not each:
            raise InputError(f"{logs[0].source}: no run of two seconds or more; log 20 s or more of motion")
    stops = [tuple(stops_of(arm.dynamics, each)) for each in runs]
    problems = [
        replace(_problem(arm.dynamics, p, _gains_by_torque(r, arm)), limits=limits_of(own, arm.joints))
        for p, r, own in zip(pieces, runs, stops, strict=True)
    ]
    responses = []
    solutions = zip(_solved_with_floors(arm.dynamics, problems), problems, parts, pieces, stops, strict=True)
    for (x, covariance, floor), problem, logs, p, own in solutions:
        gain = np.exp(-x[:, 0])
        friction, lag, inertia, delay = np.exp(x[:, 2:]).T
        sources = tuple(log.source for log in logs)
        responses.append(
            Response(
                arm.dynamics,
                gain,
                gain * x[:, 1],
                gain * friction,
                gain * lag,
                gain * inertia,
                delay,
                sources,
                _moves(p),
                floor,
                True,
                np.column_stack([-x[:, 0], x[:, 2:]]),
                covariance,
                problem.width[:, _LOG_PARAMETERS],
                own,
            )
        )
    return responses


def _solved_with_floors(dynamics: Dynamics, problems: Sequence[_Problem]) -> list[tuple[Array, Array, Floor | None]]:
    """Return for each problem the parameters of all joints, `log_covariance`, and the surface.

    The surface is the one found in the logs, or else the one that the drives declare, or None.
    """
    free, declared = Floor(dynamics), (dynamics.given.drive or Drive()).floor
    heights = [free.above(p.position) for p in problems]

    def solved(there: Mapping[int, Array], starts: Mapping[int, Array]) -> dict[int, tuple[Array, Array]]:
        """Return parameters and covariances of some problems, fitted to the samples off the surface.

        there : by index of the problem, the mask of samples off the surface, shape (steps, pieces)
        starts : initial parameters, by index of the problem
        """
        parts = [replace(problems[k], weight=problems[k].weight * rows[..., None]) for k, rows in there.items()]
        both = _solved(_together(parts), np.concatenate([starts[k] for k in there]))
        return dict(zip(there, zip(*(np.split(each, len(parts)) for each in both), strict=True), strict=True))

    def surface(k: int) -> Floor | None:
        """Return the surface found from problem k with its present parameters, or None."""
        p, seen = problems[k], problems[k].weight[..., 0] > 0
        return floor_of(dynamics, p.position[seen], p.angles(x[k][0][:, :, None])[..., 0][seen])

    off = {}
    for k, (z, p) in enumerate(zip(heights, problems, strict=True)):
        low = z[p.weight[..., 0] > 0].min()
        off[k] = (z > low + CONTACT_MARGIN_M) | (free.above(p.command) > low - CONTACT_MARGIN_M)
    x = solved(off, {k: p.middle for k, p in enumerate(problems)})
    floors = {k: floor for k in x if (floor := surface(k))}
    if floors:
        x |= solved(
            {k: heights[k] > floor.height + CONTACT_MARGIN_M for k, floor in floors.items()},
            {k: x[k][0] for k in floors},
        )
        floors = {k: surface(k) or floor for k, floor in floors.items()}
    usual = None if declared is None else Floor(dynamics, declared)
    return [(*x[k], floors.get(k, usual)) for k in x]


def _together(problems: Sequence[_Problem]) -> _Problem:
    """Return several problems as one, concatenated along the axis of the joints.

    Steps and pieces are padded, with weight zero.
    """
    steps, pieces = (max(p.command.shape[k] for p in problems) for k in (0, 1))

    def wide(of: Callable[[_Problem], Array]) -> Array:
        """Return an array of all problems, (steps, pieces, all joints), padded with zeros."""
        parts = [np.pad(of(p), ((0, steps - len(of(p))), (0, pieces - of(p).shape[1]), (0, 0))) for p in problems]
        return np.concatenate(parts, axis=2)

    none = [(np.full(len(p.middle), -np.inf), np.full(len(p.middle), np.inf)) for p in problems]
    both = [p.limits or each for p, each in zip(problems, none, strict=True)]
    limits = (np.concatenate([low for low, _ in both]), np.concatenate([high for _, high in both]))
    every = [np.pad(p.step, ((0, pieces - len(p.step)), (0, 0)), "edge") for p in problems]
    return _Problem(
        wide(lambda p: p.command),
        wide(lambda p: p.position),
        wide(lambda p: p.weight),
        wide(lambda p: p.load),
        np.concatenate(every, axis=1),
        np.concatenate([p.middle for p in problems]),
        np.concatenate([p.width for p in problems]),
        limits if any(p.limits for p in problems) else None,
    )


def _moves(pieces: Sequence[Piece]) -> Array:
    """Return the mask of the joints whose commands moved them, shape (joints,)."""
    # A joint whose commands span less than 0.02 rad carries no information on its response.
    return np.asarray(np.max([np.ptp(piece.command, axis=0) for piece in pieces], axis=0) > 0.02)


def _gains_by_torque(runs: Sequence[JointLog], arm: Arm) -> Array:
    """Return the servos' gains estimated from logged torques, shape (joints,) [N m/rad].

    They are the ratio of torque to position error, NaN where the two are not proportional or no
    torque [N m] was logged.
    """
    runs = [r for r in runs if r.step]
    torques = [None if r.torque is None and arm.per_ampere is None else torque_of(r, arm) for r in runs]
    # Correlation coefficient above which a logged torque counts as proportional to the position
    # error.
    best, gains = np.full(arm.joints, 0.95), np.full(arm.joints, np.nan)
    # Of these delays of the command [s] that with the largest correlation of torque and position error
    # is used.
    for delay in (0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06) if all(t is not None for t in torques) else ():
        errors = [delayed(np.asarray(r.command), delay / r.step) - r.position for r in runs]
        e, torque = (np.concatenate([np.asarray(v) for v in each]) for each in (errors, torques))
        e, torque = (v - np.nansum(v, axis=0) / np.maximum(np.isfinite(v).sum(axis=0), 1) for v in (e, torque))
        both, ee, tt = (np.nansum(v, axis=0) + 1e-30 for v in (e * torque, e * e, torque * torque))
        better = both / np.sqrt(ee * tt) > best
        best, gains = np.where(better, both / np.sqrt(ee * tt), best), np.where(better, both / ee, gains)
    return gains


def _problem(dynamics: Dynamics, pieces: Sequence[Piece], measured_gains: Array) -> _Problem:
    """Return the problem of some pieces, with priors from the robot's drives and from the data.

    measured_gains : as of `_gains_by_torque`, shape (joints,) [N m/rad]
    """
    n, longest = dynamics.robot.n, max(len(piece.command) for piece in pieces)
    command, position, weight = (np.zeros((longest, len(pieces), n)) for _ in range(3))
    for s, piece in enumerate(pieces):
        size = len(piece.command)
        for of, values in ((command, piece.command), (position, piece.position)):
            of[:, s] = np.pad(values, ((0, longest - size), (0, 0)), "edge")
        weight[:size, s] = 1.0
    flat = command.reshape(-1, n)
    load = dynamics.torque(flat, *[np.zeros_like(flat)] * 2)
    error = np.sqrt((weight * (position - command) ** 2).sum(axis=(0, 1)) / weight.sum(axis=(0, 1))) + 1e-5
    heavy = np.sqrt((load**2).mean(axis=0)) + 1e-9
    drive = dynamics.given.drive or Drive()
    gain, delay = (drive.of_joints(name, n) for name in ("kp", "delay"))
    middle = np.zeros((n, PARAMETERS_PER_JOINT))
    middle[:, 0] = (
        np.log(np.median((error / heavy)[heavy > LIGHT_LOAD_SHARE * heavy.max()])) if gain is None else -np.log(gain)
    )
    if gain is None:
        middle[:, 0] = np.where(np.isfinite(measured_gains), -np.log(measured_gains), middle[:, 0])
    # Prior medians of damping / gain [s], of inertia / gain [s^2] and of the command's delay [s].
    middle[:, 2:] = np.log(np.column_stack([error / 3, *(np.full(n, v) for v in (0.05, 0.002, 0.02))]))
    if delay is not None:
        middle[:, 5] = np.log(np.maximum(delay, 1e-4))
    # Drives identified from an earlier log are prior medians; joints that do not move keep them.
    yields = np.exp(middle[:, 0])
    for k, name in ((2, "friction"), (3, "damping"), (1, "bias")):
        if (declared := drive.of_joints(name, n)) is not None:
            middle[:, k] = declared * yields if k == 1 else np.log(np.maximum(declared * yields, 1e-6))
    light = heavy < LIGHT_LOAD_SHARE * heavy.max()
    # Prior standard deviations of the logarithm of a servo's compliance, one over its gain, which may
    # be declared; of a constant position error [rad]; and of the logarithms of the others.
    width = np.tile(
        [
            0.5 if gain is None else 0.1,
            0.05,
            1.5,
            SIGMA_LOG_TIMES,
            SIGMA_LOG_TIMES,
            SIGMA_LOG_TIMES,
        ],
        (n, 1),
    )
    if gain is None:
        # Prior standard deviation of the logarithm of a lightly loaded joint's gain, about the
        # median one.
        width[light, 0] = 0.25
        # Prior standard deviation of the logarithm of a gain estimated from logged torques.
        width[np.isfinite(measured_gains), 0] = 0.02
    # Prior standard deviation of the logarithmic parameters of a joint that does not move.
    width[np.ix_(~_moves(pieces), np.array(_LOG_PARAMETERS))] = 0.05
    steps = np.repeat([[piece.step] for piece in pieces], n, axis=1)
    return _Problem(command, position, weight, load.reshape(command.shape), steps, middle, width)


def _solved(p: _Problem, start: Array) -> tuple[Array, Array]:
    """Return the parameters of least cost, (joints, PARAMETERS_PER_JOINT), and `log_covariance`.

    Joints are independent of each other. start : initial parameters
    """
    x, damping = start.round(STEP_DECIMALS), np.full(len(start), 1e-3)
    best, sigma = p.residual(x), np.zeros(len(start))  # residuals and slopes at x
    trial = best

    def evaluate(x: Array) -> Evaluated:
        """Return cost and normal equations of all joints at x."""
        nonlocal trial
        trial = next(known, None) or p.residual(x)
        cost, H, b = _normal(p, sigma, x, *trial)
        return cost, lambda of: (H[of], b[of])

    # Number of rounds of the fit, each with the noise re-estimated.
    for _ in range(4):
        typical = [np.median(np.abs(e[w > 0])) for e, w in zip(best[0].T, p.weight.T, strict=True)]
        # Added to the estimated standard deviation of a joint's residual [rad].
        sigma, known = 1.4826 * np.array(typical) + 5e-4, iter([best])
        # Largest number of Levenberg-Marquardt steps with one noise.
        for end in levenberg_marquardt(
            evaluate,
            x,
            1 + 6,
            solve=lambda _, damped, right: np.linalg.solve(damped, right[..., None])[..., 0].round(STEP_DECIMALS),
            first=damping,
            factors=(5, 8),
        ):
            for own, values in zip(best, trial, strict=True):
                own[:, :, end.gain > 0] = values[:, :, end.gain > 0]
            # Relative decrease of the cost below which a round ends.
            if (np.abs(end.gain) < 1e-3 * (end.cost + np.maximum(end.gain, 0))).all():
                break
        x, damping = end.point, end.damping
    covariance = np.linalg.inv(_normal(p, sigma, x, *best)[1])[:, _LOG_PARAMETERS][:, :, _LOG_PARAMETERS]
    way = np.array([-1.0, 1.0, 1.0, 1.0, 1.0])  # the compliance is one over the gain
    return x, covariance * way * way[:, None]


def _normal(p: _Problem, sigma: Array, x: Array, residual: Array, slope: Array) -> tuple[Array, Array, Array]:
    """Return cost (joints,) and normal equations of each joint, H (joints, 6, 6) and b (joints, 6).

    The cost has pseudo-Huber residuals, by which outliers have less weight, and priors.
    sigma : noise, shape (joints,) [rad]; residual, slope : as of `_Problem.residual`
    """
    n, aside = residual.shape[2], (x - p.middle) / p.width
    root = np.sqrt(1 + (residual / (OUTLIER_SIGMAS * sigma)) ** 2)
    rows = INDEPENDENT_SAMPLE_FRACTION * p.weight
    cost = (rows * 2 * OUTLIER_SIGMAS**2 * (root - 1)).sum(axis=(0, 1)) + (aside**2).sum(axis=1)
    A = slope.reshape(-1, n, PARAMETERS_PER_JOINT).transpose(1, 2, 0)
    weighted = A * (rows / (sigma**2 * root)).reshape(-1, n).T[:, None]
    b = (weighted @ residual.reshape(-1, n).T[..., None])[..., 0] - aside / p.width
    return cost, weighted @ A.transpose(0, 2, 1) + np.eye(PARAMETERS_PER_JOINT) / p.width[:, None, :] ** 2, b
