"""Quality of a joint log: rate, jitter, lost and repeated samples, encoder quanta and delays.

Faults in units, signs and order of the joints are detected too.
"""

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.parts import Arm
from casadical.measurements.columns import MAX_TURNS
from casadical.measurements.logs.log import JointLog

# Length of a time step from which on it is a gap with lost samples, as a multiple of the median
# step.
MIN_GAP_STEPS = 1.5
# Minimum range, or standard deviation, of the positions of a moving joint [rad or m].
MIN_MOVEMENT = 1e-4


def quantum(column: Array) -> float:
    """Return the quantization step of a column, in the column's unit; 0 if none is visible.

    column : values, shape (n,), NaN where missing
    """
    levels = np.unique(column[np.isfinite(column)])
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * max(float(np.abs(levels).max(initial=0.0)), 1e-12)]
    if not len(steps):
        return 0.0
    least = float(np.median(steps[steps < 1.5 * steps.min()]))
    near = steps[steps < 20 * least] / least
    # By chance, 30 % of all numbers are within 0.15 of a whole one.
    enough = len(near) >= 8 or len(column) >= 10 * len(levels)
    return least if enough and np.mean(np.abs(near - near.round()) < 0.15) > 0.9 else 0.0


def found_in(log: JointLog) -> tuple[str, ...]:
    """Return sentences on a log's quality: channels, then what is unusual, with remedies.

    They concern clock, positions, and the agreement of channels.
    """
    return (*_understood(log), *_clock(log), *_readings(log), *_between(log))


def _understood(log: JointLog) -> Iterator[str]:
    """Yield sentences on names and joints, and on what missing names leave undetermined."""
    units = {"rad": "rad"} | {unit: unit for k in range(len(log.joints)) for unit in (log.unit("position", k),)}
    names = [name.replace("_", " ") for name in log.arrays]
    if log.current_unsigned:
        names[names.index("current")] = "current (unsigned)"
    kinds = "" if len(units) == 1 else f" ({', '.join(log.kinds)})"
    yield f"{len(log)} rows of {len(log.joints)} joints{kinds}, {', '.join(log.joints)}: {', '.join(names)}; SI units"
    if log.torque is None and (log.current is None or log.current_unsigned):
        yield (
            "no torque and no signed current: causes are identified from the response to commands alone; "
            "torque scale, masses and rotor inertias are not. Log the motors' currents with their "
            "signs"
        )
    elif log.command is None:
        yield (
            "no commands: friction, load and inertia are identified from the torque; delay, lag, servo "
            "gains and limits are not. Log the commanded positions beside the readings"
        )


def _clock(log: JointLog) -> Iterator[str]:
    """Yield sentences on runs, sampling rate, gaps and repeated rows."""
    runs, steps = list(log.runs()), np.diff(log.time)[np.diff(log.run) == 0]
    seconds = [float(run.time[-1] - run.time[0]) for run in runs]
    usual = steps[steps < MIN_GAP_STEPS * log.step]
    spread = f"{min(seconds):.1f} to {max(seconds):.1f} s" if len(runs) > 1 else f"{seconds[0]:.1f} s"
    yield (
        f"{len(runs)} run{'s' if len(runs) > 1 else ''} of {spread} at {1 / log.step:.2f} Hz; "
        f"steps differ by {1e3 * float(np.std(usual)):.2g} ms (one sigma)"
    )
    gaps = steps[steps >= MIN_GAP_STEPS * log.step]
    if len(gaps):
        lost = int(np.sum(np.round(gaps / log.step) - 1))
        share = 100 * lost / (lost + len(log))
        yield (
            f"{lost} samples are lost ({share:.2g} %) in {len(gaps)} gaps, the longest "
            f"{1e3 * gaps.max():.0f} ms: speeds over a gap are left out"
        )
    repeated = repeated_rows(log)
    if repeated.any():
        rows = ", ".join(str(row) for row in log.row[repeated][:5])
        yield (
            f"{repeated.sum()} rows repeat the reading before while the arm moves "
            f"({100 * repeated.mean():.2g} %; rows {rows}{' ...' if repeated.sum() > 5 else ''}): "
            "the log took the same sample twice. Log at the rate of the controller, or slower"
        )


def repeated_rows(log: JointLog) -> Array:
    """Return the mask of rows equal to the row before although joints move, shape (n,)."""
    q, same = log.position, np.zeros(len(log), dtype=bool)
    inner = slice(1, -1)
    measured = [values for values in (q, log.speed, log.current, log.torque) if values is not None]
    same[inner] = np.all([((v[1:-1] == v[:-2]) | np.isnan(v[1:-1])).all(axis=1) for v in measured], axis=0)
    steps = np.maximum([quantum(column) for column in q.T], 1e-9)
    with np.errstate(invalid="ignore"):
        # If a joint moves by more than four quanta over two rows, equal positions are repeated
        # samples.
        moving = (np.abs(q[2:] - q[:-2]) > 4.0 * steps).any(axis=1)
    same[inner] &= (
        moving & (log.run[2:] == log.run[:-2]) & (log.time[2:] - log.time[:-2] < 2 * MIN_GAP_STEPS * log.step)
    )
    return same


def _readings(log: JointLog) -> Iterator[str]:
    """Yield sentences on encoder quanta, and on joints whose motion carries little information."""
    steps = np.array([quantum(column) for column in log.position.T])
    for kind, unit in (("revolute", "mrad"), ("prismatic", "mm")):
        own = [f"{1e3 * steps[k]:.4g}" if steps[k] else "none" for k, each in enumerate(log.kinds) if each == kind]
        if {*own} == {"none"}:
            yield "no step is seen in positions: the encoders' quanta are below the noise, or were filtered away"
        elif own:
            yield f"positions come in steps of {own[0] if len({*own}) == 1 else ', '.join(own)} {unit}"
    # Minimum range of a joint's positions [encoder quanta]; of a joint that covers less, only the
    # hysteresis is determined, which is reported.
    min_quanta_covered = 50.0
    # Smallest maximum speed of a joint [rad/s or m/s] at which effects that depend on speed can be
    # identified; slower joints are reported.
    min_speed = 0.02
    for k, name in enumerate(log.joints):
        column = log.position[:, k]
        covered = float(np.nanmax(column) - np.nanmin(column))
        unit = "mrad" if log.kinds[k] == "revolute" else "mm"
        # A joint moves if it covers three quanta, or MIN_MOVEMENT where no quantum is seen.
        if covered <= max(3.0 * steps[k], MIN_MOVEMENT):
            yield (
                f"{name} never moves ({1e3 * covered:.2g} {unit}): of it only the load that it "
                "holds is identified, no friction, inertia, play or delay. Move it to and fro, fast and "
                "slowly"
            )
        elif covered < min_quanta_covered * steps[k]:
            yield (
                f"{name} moves by {covered / steps[k]:.0f} steps of its encoder "
                f"({1e3 * covered:.3g} {unit}): too little to tell more than its hysteresis. Move "
                f"it by {1e3 * min_quanta_covered * steps[k]:.0f} {unit} or more"
            )
        elif (fastest := _fastest(log, k)) < min_speed:
            yield (
                f"{name} moves at {1e3 * fastest:.2g} {unit}/s at most: too slow to tell viscous "
                "friction, lag or inertia; dry friction and load are identified. Move it at "
                f"{1e3 * 10 * min_speed:.0f} {unit}/s or more"
            )
        for channel in ("torque", "current"):
            values = getattr(log, channel)
            if values is not None and np.isfinite(values[:, k]).any() and np.nanstd(values[:, k]) == 0:
                yield f"{channel} of {name} is {np.nanmean(values[:, k]):.4g} in every row: it is not measured. Log it"
    first = {re.split(r"[_\W]", name)[0].casefold() for name in log.joints}
    if {"left", "right"} <= first or {"l", "r"} <= first:
        yield (
            "joints of two arms stand in one log: each is judged as if the other were not there. "
            "Name the robot's own joints by its model, and give one log to each arm"
        )


def _fastest(log: JointLog, k: int) -> float:
    """Return the 99 % quantile of joint k's absolute speed, averaged over 0.1 s [rad/s or m/s].

    k : index of the joint, from 0; 0 is returned where no speed can be computed
    """
    rows = max(1, min(len(log) - 1, round(0.1 / max(log.step, 1e-9))))
    q, t = log.position[:, k], log.time
    with np.errstate(invalid="ignore", divide="ignore"):
        speed = np.abs(q[rows:] - q[:-rows]) / (t[rows:] - t[:-rows])
    speed = speed[(log.run[rows:] == log.run[:-rows]) & np.isfinite(speed)]
    return float(np.quantile(speed, 0.99)) if len(speed) else 0.0


def _between(log: JointLog) -> Iterator[str]:
    """Yield sentences on how channels agree: delays, units, signs, order of the joints."""
    if log.speed is not None and (fitted := _speed_delay(log)) is not None:
        delay, scale = fitted
        if abs(delay) > 0.25 * log.step:
            way = "behind" if delay > 0 else "ahead of"
            yield f"speeds are {1e3 * abs(delay):.1f} ms {way} positions: the delay of the log's own filter"
        if not 0.8 < scale < 1.25:
            yield (
                f"speeds are {scale:.3g} times the slope of positions: their unit is another than "
                "their name says. Correct the name of the column; here slopes of positions are "
                "taken"
            )
    if log.command is None:
        return
    if np.array_equal(log.command, log.position, equal_nan=True):
        yield (
            "commands are the readings to the last digit: the log holds one of them twice, so the "
            "response is not identified. Log what was sent to the drives"
        )
        return
    alike = _alike(log)
    for k, name in enumerate(log.joints):
        if not np.isfinite(alike[k, k]):
            continue
        if alike[k, k] < -0.8:
            yield (
                f"{name}: command and reading count in opposite directions (correlation "
                f"{alike[k, k]:.2f}): turn the sign of one of the columns; until then its response "
                "is not identified"
            )
            continue
        best = int(np.nanargmax(np.abs(alike[k])))
        if best != k and abs(alike[k, k]) < 0.5 and abs(alike[k, best]) > 0.98:
            yield (
                f"the command of {name} moves as the reading of {log.joints[best]} does "
                f"(correlation {alike[k, best]:.3f}, with its own {alike[k, k]:.2f}): joints stand "
                "in another order in the commands. Name the columns by their joints"
            )


def _alike(log: JointLog) -> Array:
    """Return correlations of each joint's command (row) with each joint's position (column).

    The shape is (joints, joints); NaN for joints at rest, and for fewer than three complete rows.
    """
    assert log.command is not None
    good = np.isfinite(log.command).all(axis=1) & np.isfinite(log.position).all(axis=1)
    out = np.full((len(log.joints),) * 2, np.nan)
    if good.sum() < 3:
        return out
    c, q = (values[good] - values[good].mean(axis=0) for values in (log.command, log.position))
    sizes = [np.sqrt((values**2).mean(axis=0)) for values in (c, q)]
    moves = np.outer(sizes[0] > MIN_MOVEMENT, sizes[1] > MIN_MOVEMENT)
    np.divide(c.T @ q / len(c), np.outer(*sizes), out=out, where=moves)
    return out


def _speed_delay(log: JointLog) -> tuple[float, float] | None:
    """Return the delay [s] of logged speeds behind the slope of positions, and their scale factor.

    To first order v(t) = scale (q'(t) - delay q''(t)); both by least squares over all joints. None
    where the motion does not determine them, or the scale is not positive.
    """
    assert log.speed is not None
    whole = np.zeros((2, 2))
    right = np.zeros(2)
    for run in log.runs():
        if len(run) < 8 or run.speed is None:
            continue
        for q, v in zip(run.position.T, run.speed.T, strict=True):
            slope = (q[4:] - q[:-4]) / (run.time[4:] - run.time[:-4])
            bend = (slope[2:] - slope[:-2]) / (run.time[4:-2] - run.time[2:-4])
            A = np.column_stack([slope[1:-1], -bend])
            seen = v[3:-3]
            good = np.isfinite(A).all(axis=1) & np.isfinite(seen)
            whole, right = whole + A[good].T @ A[good], right + A[good].T @ seen[good]
    if np.linalg.matrix_rank(whole) < 2 or right[0] <= 0:
        return None
    scale, delayed = np.linalg.solve(whole, right)
    return (float(delayed / scale), float(scale)) if scale > 0 else None


def with_signs(log: JointLog) -> JointLog:
    """Return the log with a torque or current that has lost its sign declared an unsigned current.

    It has if it is never negative, although at least two joints move both ways whose smallest value
    is below 10 % of their largest. A torque then is the current, and the log has no torque.
    """
    for channel in ("torque", "current"):
        values = getattr(log, channel)
        if values is None or (channel == "current" and log.current_unsigned) or np.nanmin(values) < 0:
            continue
        turned = np.diff(log.position, axis=0)
        fro = (turned > 0).any(axis=0) & (turned < 0).any(axis=0)
        # Absolute values come near to zero; a load that never changes its sign need not.
        seen = np.nan_to_num(values)
        sizes = seen.min(axis=0) < 0.1 * seen.max(axis=0)
        both = int((fro & sizes).sum())
        if both < 2:
            continue
        said = (
            f"{channel} is never negative, though {both} joints move to and fro: read as the "
            "absolute value of a current, which tells friction and load by size alone. Log it with "
            "its sign"
        )
        changed: dict[str, Array | None] = {"torque": None if channel == "torque" else log.torque, "current": values}
        lost = {"current_unsigned": True, "signs_lost": channel, "findings": (*log.findings, said)}
        return replace(log, **changed, **lost)  # type: ignore[arg-type]
    return log


def refuse_other_units(log: JointLog, robot: Arm | None) -> None:
    """Refuse a log in which degrees are given as radians, in all rows or in some.

    robot : its joint limits are used, if given. Raises InputError.
    """
    # Tolerance beyond a joint's range for readings in a correct unit [rad].
    range_margin_rad = 0.3
    degrees = float(np.rad2deg(1.0))  # of a radian
    for k, name in enumerate(log.joints):
        if log.kinds[k] != "revolute":
            continue
        column = log.position[:, k]
        top = int(np.nanargmax(np.abs(column)))
        largest, place = abs(float(column[top])), f"{log.source}: row {log.row[top]}, position of {name}"
        beyond = largest > MAX_TURNS * 2 * np.pi
        if robot and not beyond:
            lower, upper = (float(ends[k]) for ends in robot.limits)
            inside = (lower - range_margin_rad <= np.deg2rad(column)) & (np.deg2rad(column) <= upper + range_margin_rad)
            reach = max(abs(lower), abs(upper))
            beyond = (
                largest > 2 * reach + range_margin_rad and largest > np.pi and bool(inside[np.isfinite(column)].all())
            )
        if beyond:
            raise InputError(f"{place}: {largest:.6g} rad; such angles are degrees: name the columns q{k + 1}_deg")
        column = log.position[:, k]
        before, after = np.abs(column[:-1]), np.abs(column[1:])
        small = np.minimum(before, after)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratios = np.maximum(before, after) / small
        at = np.flatnonzero((small > 0.02) & (np.abs(ratios / degrees - 1) < 0.1))
        if len(at):
            row = int(at[0])
            raise InputError(
                f"{log.source}: row {log.row[row + 1]}, position of {log.joints[k]}: "
                f"{column[row + 1]:.5g} follows {column[row]:.5g}, {ratios[row]:.1f} times: the unit "
                "changes there (degrees and radians); convert the rows of one of them, or give one "
                "file to each"
            )
        command = np.zeros(0) if log.command is None else log.command[:, k]
        if np.isfinite(command).any() and np.nanstd(column) > MIN_MOVEMENT and np.nanstd(command) > MIN_MOVEMENT:
            ratio = float(np.nanstd(command) / np.nanstd(column))
            for factor, words in (
                (degrees, ("commands", "readings")),
                (1 / degrees, ("readings", "commands")),
            ):
                if abs(ratio / factor - 1) < 0.15:
                    raise InputError(
                        f"{log.source}: {words[0]} of {name} are {degrees:.1f} times "
                        f"its {words[1]}: degrees called radians; name the columns of the "
                        f"{words[0]} with _deg"
                    )


def refuse_frozen(log: JointLog) -> None:
    """Refuse a log in which no joint moves, or one is constant while its commands move.

    Raises InputError.
    """
    still = np.flatnonzero(np.nanmin(log.position, axis=0) == np.nanmax(log.position, axis=0))
    if len(still) == len(log.joints):
        raise InputError(
            f"{log.source}: no joint moves, each reading is one number in all {len(log)} rows; log a motion"
        )
    for k in still:
        commands = np.zeros(0) if log.command is None else log.command[np.isfinite(log.command[:, k]), k]
        # Commands that move by more, while the reading is constant, show a dead encoder [rad or m].
        if len(commands) and np.ptp(commands) > 0.1:
            unit, value = log.unit("position", int(k)), float(np.nanmax(log.position[:, k]))
            raise InputError(
                f"{log.source}: position of {log.joints[k]}: {value:.6g} {unit} in all {len(log)} "
                f"rows, though its commands move by {np.ptp(commands):.3g} {unit}: it was not "
                "measured, or the joint is blocked. Log its encoder"
            )
