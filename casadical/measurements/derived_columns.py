"""Columns that effects need and that follow from logged ones: progress, lagged warmth, directions of motion."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np

from casadical.core.basics import Array
from casadical.measurements.measurements import Measurements

COLUMN = "time_s"
# A shorter way between measured points would follow their noise [m].
HELD_STILL = 0.01
# Loads of the joints, shape (n, joints), from readings and logged columns (see `Robot.loads`).
Loads = Callable[[Array, Mapping[str, Array]], Array]


def derive(m: Measurements, names: Iterable[str], loads: Loads | None = None) -> tuple[Measurements, tuple[str, ...]]:
    """The measurements with the named columns added, and the names that do not follow from what was logged.

    Columns: progress, the place in the order of measuring, 0 to 1 (column pose or time_s; else the order of the rows);
    warmth_600s, temperature_degC behind a first-order lag of 600 s, less its mean [K]; approach2, direction of joint
    2's last motion, -1 or 1, from the order of the poses where it was not logged; move2, joint 2's way from the pose
    before, 0 for the first [rad or m]; memory2_300mrad, a state between -1 and 1 that goes to the direction of motion
    within 0.3 rad of it (Dahl 1968); play2_300mrad, joint 2's reading as what it takes along with a play of 0.3 rad to
    each side has it (a relay with play is a step of it); heat2_600s, the square of joint 2's load behind a first-order
    lag of 600 s; head_1500_m200_0mm, the sense of the last turn, -1 or 1, of the head of an instrument that stands at
    [1.5, -0.2, 0] m and follows the measured point, where that went 10 mm aside or more.

    m : campaign with its logged columns
    names : columns to derive: progress, warmth_600s, approach2, move2, memory2_300mrad, play2_300mrad and their like
    loads : of a robot, for heat2_600s

    Examples
    --------
    >>> more, without = casadical.measurements.derive(poses, ["progress", "warmth_600s"])
    >>> float(more.conditions["progress"][-1]), without
    (1.0, ('warmth_600s',))
    """
    columns, missing = dict(m.conditions), []
    for name in dict.fromkeys(names):
        made = columns[name] if name in columns else _derived(m, name, loads)
        if made is None:
            missing.append(name)
        else:
            columns[name] = made
    return replace(m, conditions=columns), tuple(missing)


def _derived(m: Measurements, name: str, loads: Loads | None) -> Array | None:
    order = np.argsort(next((m.conditions[c] for c in (COLUMN, "pose") if c in m.conditions), m.row), kind="stable")
    if name == "progress":
        return _back(np.arange(len(m)) / max(1, len(m) - 1), order)
    if lag := re.fullmatch(r"warmth_(\d+)s", name):
        return _warmth(m, float(lag[1]), order)
    if heat := re.fullmatch(r"heat(\d+)_(\d+)s", name):
        return _heat(m, int(heat[1]), float(heat[2]), order, loads)
    if station := re.fullmatch(rf"head_{_MM}_{_MM}_{_MM}mm", name):
        return _head(m, [1e-3 * float(mm.replace("m", "-")) for mm in station.groups()], order)
    for pattern, of_joint in _OF_JOINT.items():
        if match := re.fullmatch(pattern, name):
            joint, *way = map(int, match.groups())
            known = 1 <= joint <= m.q.shape[1]
            return _back(of_joint(m.q[order, joint - 1], *(1e-3 * w for w in way)), order) if known else None
    return None


# A whole number in a name.
_MM = r"(m?\d+)"


def _back(values: Array, order: Array) -> Array:
    """Values in the order of measuring, in that of the rows."""
    rows = np.empty(len(order))
    rows[order] = values
    return rows


def _warmth(m: Measurements, lag: float, order: Array) -> Array | None:
    if "temperature_degC" not in m.conditions or (lag and COLUMN not in m.conditions):
        return None
    sensor = m.conditions["temperature_degC"]
    if not lag:
        return np.asarray(sensor - sensor.mean())
    warmth = _back(_behind(sensor[order], m.conditions[COLUMN][order], lag), order)
    return np.asarray(warmth - warmth.mean())


def _behind(felt: Array, time: Array, lag: float) -> Array:
    """Values in the order of measuring behind a first-order lag [s]; at rest before the first."""
    behind = np.empty(len(felt))
    behind[0] = felt[0]
    for k in range(1, len(felt)):
        # They run straight between two readings: the exact solution of the first-order lag.
        step = (time[k] - time[k - 1]) / lag
        decay = np.exp(-step)
        slope = (felt[k] - felt[k - 1]) / step if step > 0 else 0.0
        behind[k] = felt[k] - slope * (1 - decay) + (behind[k - 1] - felt[k - 1]) * decay
    return behind


def _heat(m: Measurements, joint: int, lag: float, order: Array, loads: Loads | None) -> Array | None:
    """What a motor's current makes in its winding; of joints that take no load in any pose nothing."""
    if loads is None or COLUMN not in m.conditions or not 1 <= joint <= m.q.shape[1] or not lag:
        return None
    square = np.nan_to_num(loads(m.q, m.conditions)[:, joint - 1]) ** 2
    return _back(_behind(square[order], m.conditions[COLUMN][order], lag), order)


def _head(m: Measurements, station: Sequence[float], order: Array) -> Array | None:
    if m.position is None or not m.position.any():  # of several tables together
        return None
    beam = m.position[order] - np.array(station)
    turns = np.diff(np.unwrap(np.arctan2(beam[:, 1], beam[:, 0])), prepend=0.0)
    turns[0] = 0.0
    return _back(last_sense(turns * np.hypot(beam[:, 0], beam[:, 1]), HELD_STILL), order)


def _moves(q: Array) -> Array:
    return np.diff(q, prepend=q[0])


def last_sense(ways: Array, least: float) -> Array:
    """Sense of the last way that was longer than the least one, -1, 0 or 1."""
    motion = np.sign(np.where(np.abs(ways) > least, ways, 0.0))
    for k in range(1, len(motion)):
        motion[k] = motion[k] or motion[k - 1]
    return np.asarray(motion)


def _memory(q: Array, way: float) -> Array:
    """What is left of each motion fades along those after it; the way before the first pose is not known."""
    state, states = 0.0, []
    for move in _moves(q):
        state = float(np.sign(move) + (state - np.sign(move)) * np.exp(-abs(move) / way)) if move else state
        states.append(state)
    return np.array(states)


def _play(q: Array, half: float) -> Array:
    """What follows the joint with play stays where it is until it is taken along; it begins in the middle."""
    taken = accumulate(q, lambda state, reading: float(np.clip(state, reading - half, reading + half)))
    return np.array([*taken])


# Columns of a joint, in the order of measuring, from its readings and a way [rad].
# Less is no motion but rounding of the same reading [rad or m].
_OF_JOINT: Mapping[str, Callable[..., Array]] = {
    r"approach(\d+)": lambda q: last_sense(_moves(q), 1e-9),
    r"move(\d+)": _moves,
    r"memory(\d+)_(\d+)mrad": _memory,
    r"play(\d+)_(\d+)mrad": _play,
}


def clock_faults(m: Measurements) -> tuple[str, ...]:
    """Sentences about `time_s`, each with rows and values; none without that column, or for rows in another order."""
    if COLUMN not in m.conditions or len(m) < 3:
        return ()
    time, row = m.conditions[COLUMN], m.row
    by_row = np.argsort(row, kind="stable")
    time, row = time[by_row], row[by_row]
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    # Where more of the steps go back, the rows are not in the order of measuring.
    if len(back) > max(1, 0.1 * len(steps)):
        return ()
    usual = float(np.median(np.abs(steps)))
    # A clock was set where it jumps by more than a week [s] and by 100 times the usual step.
    far = np.flatnonzero(steps > max(7 * 86400.0, 100.0 * usual))
    said = []
    for at, what in ((back, "goes back"), (far, "jumps")):
        if len(at):
            where = ", ".join(f"from {time[k]:.10g} to {time[k + 1]:.10g} s at row {row[k + 1]}" for k in at[:3])
            more = f" and {len(at) - 3} times more" if len(at) > 3 else ""
            said.append(
                f"{m.source}: {COLUMN} {what} {where}{more}: a clock was set or started again; correct the column or "
                "leave it out, else what follows time or temperature is judged by it"
            )
    return tuple(said)
