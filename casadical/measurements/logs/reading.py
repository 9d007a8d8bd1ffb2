"""Readers of joint logs: tables in casadical's form and files of other systems."""

import gzip
import re
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.parts import Arm
from casadical.measurements.columns import FULL_TURN_RAD
from casadical.measurements.logs.columns import (
    LENGTH_UNITS,
    NAMING_ADVICE,
    SI_FACTORS,
    Logged,
    has_lists,
    is_number,
    logged,
    meaning,
    tells_time,
)
from casadical.measurements.logs.findings import found_in, refuse_frozen, refuse_other_units, with_signs
from casadical.measurements.logs.log import CHANNELS, JointLog
from casadical.measurements.logs.systems import LEROBOT_CHANNELS, SAGE_STATE_FILE, bag, is_bag, lerobot, sage
from casadical.measurements.raw_table import plain_headings, read_table

# Channels of the joints' motion, in units of an angle or a length, or of these per second.
MOTION_CHANNELS = {"position", "command", "speed", "command_speed"}


def read_log(
    path: str | Path,
    robot: Arm | None = None,
    *,
    unit: Literal["deg", "rad", "percent"] | None = None,
    effort: Literal["torque", "current"] | None = None,
) -> JointLog:
    """Return the joint log in a file of a controller, a simulator or a recorder.

    path : table (csv, csv.gz, parquet; docs/log-files.md has the columns, RTDE's names are known,
        too), a folder of SAGE, a Parquet file of a LeRobot dataset, a ROS bag (.db3, .mcap, .bag,
        or the folder with metadata.yaml)
    robot : its joints, by their names or their order, are those of the log, as variables of its
        rows; others are dropped
    unit : of angles whose unit the file does not state; percent: of half a joint's range about its
        middle; None: as [drive] of the robot states
    effort : quantity in the field effort; None: as [drive] of the robot states, else torque
    Returns the log in SI; its findings say what was understood, and what is unusual.
    Raises InputError: a file that cannot be used; it names file, row and column, and what to do.
    """
    path = Path(path)
    if robot and robot.drive:
        unit, effort = unit or robot.drive.log_angles, effort or robot.drive.log_effort
    names = [name for j in robot.joints for name in (j.name, j.leader[0] if j.leader else "")] if robot else []
    log = _logged(path, [name for name in names if name], unit)
    if effort == "current" and "torque" in log.channels:
        channels = {("current" if name == "torque" else name): columns for name, columns in log.channels.items()}
        log = replace(log, channels=channels, notes=tuple(n for n in log.notes if "effort is read" not in n))
    made = assembled(log, robot, unit)
    refuse_other_units(made, robot)
    refuse_frozen(made)
    made = with_signs(made)
    return replace(made, findings=(*made.findings, *found_in(made)))


def is_log(path: str | Path) -> bool:
    """Return whether a file is a log of joints in motion, by its form or its headings.

    A table is one if it has a time, joint positions, and commands, torques or currents, but no
    measured points or distances; one with a time and motion alone counts too, so that the reader
    can say what it lacks.
    """
    path = Path(path)
    if path.name == SAGE_STATE_FILE or is_bag(path) or (path / SAGE_STATE_FILE).exists():
        return True
    try:
        headings = _plain_headings(path)
        lists: tuple[str, ...] = ()
        if not headings:
            raw = read_table(path, keep_text=False)
            headings, lists = raw.header, tuple(c for c in ("position", "torque", "current") if has_lists(raw, c))
    except InputError:
        return False
    if {"x_mm", "x_m", "distance_mm"} & {*headings}:  # measured poses
        return False
    channels = {meaning(heading, ())[0] for heading in headings} | {
        LEROBOT_CHANNELS.get(heading, "") for heading in headings
    }
    channels |= {*lists}
    timed = [heading for heading in headings if tells_time(heading)]
    motion_alone = all(meaning(heading, ())[0] for heading in headings if heading not in ("run", *timed))
    driven = bool(channels & {"command", "torque", "current"})
    return bool(timed) and "position" in channels and (driven or motion_alone)


def _plain_headings(path: Path) -> tuple[str, ...]:
    """Return the headings of a table of plain numbers by its first lines; empty for others."""
    if not path.is_file() or path.suffix.lower() not in (".csv", ".gz"):
        return ()
    try:
        with (gzip.open if path.suffix.lower() == ".gz" else open)(path, "rb") as file:
            head, first = (file.readline(100_000) for _ in range(2))  # of longer lines no more is looked at
        [float(cell.strip() or "nan") for cell in first.decode("ascii").split(",")]
    except (OSError, EOFError, zlib.error, ValueError):
        return ()
    return plain_headings(head)


def _logged(path: Path, names: Sequence[str], unit: str | None) -> Logged:
    """Return the log of a file in its own units and order of joints, read by the file's form."""
    if is_bag(path):
        return bag(path)
    if path.name == SAGE_STATE_FILE or (path / SAGE_STATE_FILE).exists():
        return sage(path.parent if path.name == SAGE_STATE_FILE else path)
    if path.is_dir():
        raise InputError(
            f"{path}: a folder without {SAGE_STATE_FILE} (SAGE) and metadata.yaml (ROS 2); name the file of the log"
        )
    table = read_table(path, keep_text=False)
    if LEROBOT_CHANNELS.keys() & {*table.header}:
        return lerobot(path, table, unit)
    return logged(table, names)


def assembled(log: Logged, robot: Arm | None, unit: str | None = None) -> JointLog:
    """Return a log as read from a file in SI, with joints in the robot's order and runs numbered.

    Coupled joints are computed, and the controller's readings become the variables of the rows.

    Raises InputError without positions of the robot's joints.
    """
    if "position" not in log.channels:
        there = ", ".join(log.channels)
        raise InputError(f"{log.source}: no column holds the positions of joints; there are {there}. {NAMING_ADVICE}")
    keys, names, notes = _joints(log, robot)
    kinds = _kinds(log, keys, robot)
    time, run, used, odd = _clock(log)
    arrays: dict[str, Any] = {}
    for channel in CHANNELS:
        if columns := log.channels.get(channel):
            none = np.full(len(log.time), np.nan)
            arrays[channel] = np.column_stack([columns.get(key, none) for key in keys])[used]
            lost = np.isnan(arrays[channel]).all(axis=0)
            if channel in MOTION_CHANNELS:  # readings of coupled joints are computed
                lost &= np.array([key != "" for key in keys])
            # The diagnosis needs commands, torques and currents of all joints of a robot, or of
            # none.
            driven = channel in ("command", "torque", "current")
            apart = robot is not None and driven and bool(lost.any())
            if apart and not lost.all():
                without = ", ".join(names[k] for k in np.flatnonzero(lost))
                notes += (f"{channel} is left out, for there is none of {without}. Log it of every joint",)
            if apart or lost.all():
                del arrays[channel]
    if "position" not in arrays:
        raise InputError(f"{log.source}: the positions of the robot's joints have no number in any row")
    notes += _into_si(log, keys, arrays, kinds, unit, robot)
    for k, joint in enumerate(robot.joints if robot else ()):
        if joint.leader and _plain(keys[k]) == _plain(joint.leader[0]) != _plain(joint.name):
            for channel in MOTION_CHANNELS & {*arrays}:
                offset = joint.leader[3] * (channel in ("position", "command"))
                arrays[channel][:, k] = joint.leader[2] * arrays[channel][:, k] + offset
            notes += (f"{joint.name} as {keys[k]}, which it mimics",)
    if robot is not None and "" in keys:
        for channel in MOTION_CHANNELS & {*arrays}:
            made, still = (robot.coupled(q, readings=True) for q in (arrays[channel], np.zeros((1, robot.n))))
            led = made if channel in ("position", "command") else made - still
            arrays[channel] = np.where([key == "" for key in keys], led, arrays[channel])
        lacking = ", ".join(name for name, key in zip(names, keys, strict=True) if not key)
        notes += (f"{lacking}: not in the log, and computed from the joints that it follows",)
    if robot is not None and robot.counts_otherwise:
        A = robot.reading_map[0]
        for channel in ("position", "command"):
            arrays |= {channel: robot.variables_of(arrays[channel])} if channel in arrays else {}
        arrays |= {channel: arrays[channel] @ A.T for channel in ("speed", "command_speed") if channel in arrays}
        # Powers are the same: the efforts at the rows' variables are those at the readings times A^-1.
        efforts = [channel for channel in ("torque", "current") if channel in arrays]
        arrays |= {channel: arrays[channel] @ np.linalg.inv(A) for channel in efforts}
        notes += (f"the rows' angles q are made of the controller's readings J: {robot.readings_in_words}",)
    arrays |= {name: log.scalars[name][used] for name in ("voltage", "payload") if name in log.scalars}
    arrays["current_unsigned"] = "abs" in {log.units.get(("current", key)) for key in keys}
    said = (*log.notes, *notes, *odd)
    return JointLog(time, names, **arrays, run=run, kinds=kinds, row=log.row[used], source=log.source, findings=said)


def _joints(log: Logged, robot: Arm | None) -> tuple[list[str], tuple[str, ...], tuple[str, ...]]:
    """Return the log's names (keys) of the joints, the robot's names, sentences on dropped joints.

    Both lists are in the robot's order; the name of a coupled joint that the log lacks is empty.
    """
    there = list(log.channels["position"])
    numbered = all(is_number(key) for key in there)
    if numbered:
        there.sort(key=int)
    if robot is None:
        return there, tuple(f"joint {int(k) + ('0' in there)}" if is_number(k) else k for k in there), ()
    own = [joint.name or f"joint {i}" for i, joint in enumerate(robot.joints, 1)]
    free = [joint.coupling is None for joint in robot.joints]
    if numbered and sum(free) == len(there) < robot.n:
        keys = [there[sum(free[:i])] if alone else "" for i, alone in enumerate(free)]
    else:
        keys = there[: robot.n] if numbered else _by_name(there, robot)
    if len(keys) < robot.n:
        raise InputError(
            f"{log.source}: positions of {len(there)} joints ({', '.join(there)}), the robot "
            f"{robot.name!r} has {robot.n} ({', '.join(own)}); take the model of this arm, or name "
            "the columns as its joints"
        )
    unread = [key for key in there if key not in keys]
    said = f"{'columns of joints' if numbered else 'joints'} {', '.join(unread)} are not of the robot {robot.name!r}"
    return keys, tuple(own), (f"{said} and were left out",) if unread else ()


def _by_name(there: Sequence[str], robot: Arm) -> list[str]:
    """Return the log's name of each of the robot's joints, fewer where one is missing.

    Where no name fits, the joints are taken in order. The name of a joint that follows others is
    empty where the log lacks it; of one with a leader outside of the chain it may be the leader's.
    """
    keys_of, keys = {_plain(key): key for key in there}, []
    for i, joint in enumerate(robot.joints, 1):
        names = (joint.name or f"joint {i}", joint.leader[0] if joint.leader else "")
        key = next((keys_of[_plain(name)] for name in names if _plain(name) in keys_of), "")
        keys += [key] if key or joint.coupling else []
    return keys if any(keys) else list(there[: robot.n])


def _plain(name: str) -> str:
    """Return a joint's name without signs, capitals and the word joint."""
    return re.sub(r"[\W_]+|joint", "", name.casefold())


def _kinds(log: Logged, keys: Sequence[str], robot: Arm | None) -> tuple[str, ...]:
    """Return each joint's kind ("revolute", "prismatic"), by the robot or its position's unit."""
    if robot:
        return tuple(joint.kind for joint in robot.joints)
    return tuple("prismatic" if log.units["position", key] in LENGTH_UNITS else "revolute" for key in keys)


def _clock(log: Logged) -> tuple[Array, Array, Array, tuple[str, ...]]:
    """Return time (k,) [s] and run number (k,) of the used rows, their indices, and sentences.

    Times that start above 1e6 s are counted from the first. The sentences are on new runs that were
    inferred, and on omitted rows. Raises InputError for a clock that cannot be used.
    """
    run = log.scalars.get("run")
    numbers = np.zeros(len(log.time)) if run is None else run
    whole = (numbers == np.round(numbers)) & (np.abs(numbers) < 2**53)
    for name, values, usable, wanted in (
        ("time", log.time, np.isfinite(log.time), "finite number"),
        ("run", numbers, whole, "whole number below 2^53"),
    ):
        if not usable.all():
            bad = int(np.argmin(usable))
            raise InputError(
                f"{log.source}: row {log.row[bad]}, column {name!r}: {values[bad]:g} is no "
                f"{wanted}; correct or delete the row"
            )
    changes, steps = np.diff(numbers) != 0, np.diff(log.time)
    back = ~changes & (steps < 0)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    if usual > 0.5:  # [s]
        raise InputError(
            f"{log.source}: rows lie {usual:.3g} s apart; a motion is logged some times a second. "
            "If the time is in another unit, name its column so: time_ms, time_us, time_ns"
        )
    if len(steps) and not (~changes & (steps > 0)).any():
        raise InputError(
            f"{log.source}: time grows in none of its {len(log.time)} rows from the row before in "
            "its run; log a clock that grows, and let the column run number runs, not rows"
        )
    ahead = ~changes & (steps > 600.0)  # after so long a pause [s] another run begins
    stands = np.concatenate([[False], ~changes & (steps == 0)])
    starts = np.cumsum(np.concatenate([[False], changes | back | ahead]))
    said = []
    if ahead.any():
        k = int(np.flatnonzero(ahead)[0]) + 1
        said.append(
            f"row {log.row[k]}: {steps[k - 1]:.4g} s after the row before"
            f"{f' ({ahead.sum()} such)' if ahead.sum() > 1 else ''}: read as a new run from there"
        )
    if back.any():
        k = int(np.flatnonzero(back)[0]) + 1
        said.append(
            f"row {log.row[k]}: time jumps back from {log.time[k - 1]:.6g} to {log.time[k]:.6g} s"
            f"{f' ({back.sum()} such)' if back.sum() > 1 else ''}: read as a new run from there; "
            "nothing that goes over the jump (delay, warm-up) is identified from it. Log one monotonic "
            "clock, or number runs in column run"
        )
    if stands.any():
        k = int(np.flatnonzero(stands)[0])
        said.append(f"row {log.row[k]}: the time of the row before, as {stands.sum()} rows: left out as repeated")
    used = np.flatnonzero(~stands)
    several = np.bincount(starts[used])[starts[used]] > 1
    if several.any() and not several.all():
        lone = log.row[used[~several]]
        said.append(f"row {lone[0]}: a run of its own ({len(lone)} such): left out, a motion has two rows at least")
        used = used[several]
    given = numbers[used].astype(np.int64) if run is not None and not (back | ahead).any() else starts[used] + 1
    start = log.time[0] if abs(log.time[0]) > 1e6 else 0.0
    return log.time[used] - start, given, used, tuple(said)


def _into_si(
    log: Logged, keys: Sequence[str], arrays: dict[str, Any], kinds: Sequence[str], given: str | None, robot: Arm | None
) -> tuple[str, ...]:
    """Convert the arrays to SI in place; return sentences on units that no heading states.

    arrays : channel -> shape (n, joints)
    given : unit of angles that is declared, None: it is inferred from their size
    """
    guessed: dict[str, list[str]] = {}
    for channel, values in arrays.items():
        for k, key in enumerate(keys):
            unit = log.units.get((channel, key), "")
            if not unit and channel in MOTION_CHANNELS and kinds[k] == "revolute":
                unit = given or ""
                if not given:
                    # Commanded channels are judged by the commands if these are logged, others by
                    # the positions.
                    base = "command" if channel.startswith("command") and "command" in log.channels else "position"
                    sizes = [np.nanmax(np.abs(log.channels[base][key])) for key in keys if key in log.channels[base]]
                    unit = "deg" if max(sizes, default=0.0) > FULL_TURN_RAD + 1 else "rad"
                    guessed.setdefault(unit, []).append(f"{channel} {key}")
            if unit == "percent" and channel in MOTION_CHANNELS:
                values[:, k] = _from_percent(values[:, k], robot, k, channel, log.source)
            else:
                values[:, k] *= SI_FACTORS.get(unit, 1.0)
    return tuple(f"no heading tells the unit of {', '.join(c)}: by their size read as {u}" for u, c in guessed.items())


def _from_percent(values: Array, robot: Arm | None, k: int, channel: str, source: str) -> Array:
    """Return angles [rad] or speeds [rad/s] of joint k, logged in percent of half its range.

    An angle of 0 % is the middle of the range. A gripper's are percentages of the whole range, from
    its lower end. Raises InputError without a robot.

    values : percentages, shape (n,); k : index of the joint, from 0
    """
    if robot is None:
        raise InputError(f'{source}: unit = "percent" needs the ranges of the joints: give the robot, too')
    lower, upper = (ends[k] for ends in robot.limits)
    half = (upper - lower) / 200
    if channel.endswith("speed"):
        return np.asarray(values * half)
    whole = "gripper" in robot.joints[k].name and np.nanmin(values) >= 0
    return np.asarray(lower + values * 2 * half if whole else (lower + upper) / 2 + values * half)
