"""Columns that effects need and that follow from logged ones: progress, lagged warmth, approach directions."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array
from casadical.measurements.measurements import Measurements

COLUMN = "time_s"
# Less is no motion but rounding of the same reading [rad or m].
AT_REST = 1e-9


def derive(m: Measurements, names: Iterable[str]) -> tuple[Measurements, tuple[str, ...]]:
    """The measurements with the named columns added, and the names that do not follow from what was logged.

    Columns: progress, the place in the order of measuring, 0 to 1 (column pose or time_s; else the order of the rows);
    warmth_600s, temperature_degC behind a first-order lag of 600 s, less its mean [K]; approach2, direction of joint
    2's last motion, -1 or 1, from the order of the poses where it was not logged; move2, joint 2's way from the pose
    before, 0 for the first [rad or m]; memory2_300mrad, a state between -1 and 1 that goes to the direction of motion
    within 0.3 rad of it (Dahl 1968); play2_300mrad, joint 2's reading as what it takes along with a play of 0.3 rad to
    each side has it (a relay with play is a step of it).

    m : campaign with its logged columns
    names : columns to derive: progress, warmth_600s, approach2, move2, memory2_300mrad, play2_300mrad and their like

    Examples
    --------
    >>> more, without = casadical.measurements.derive(poses, ["progress", "warmth_600s"])
    >>> float(more.conditions["progress"][-1]), without
    (1.0, ('warmth_600s',))
    """
    columns, missing = dict(m.conditions), []
    for name in dict.fromkeys(names):
        made = columns[name] if name in columns else _derived(m, name)
        if made is None:
            missing.append(name)
        else:
            columns[name] = made
    return replace(m, conditions=columns), tuple(missing)


def _derived(m: Measurements, name: str) -> Array | None:
    order = np.argsort(next((m.conditions[c] for c in (COLUMN, "pose") if c in m.conditions), m.row), kind="stable")
    if name == "progress":
        return _back(np.arange(len(m)) / max(1, len(m) - 1), order)
    if lag := re.fullmatch(r"warmth_(\d+)s", name):
        return _warmth(m, float(lag[1]), order)
    for pattern, of_joint in _OF_JOINT.items():
        if match := re.fullmatch(pattern, name):
            joint, *way = map(int, match.groups())
            known = 1 <= joint <= m.q.shape[1]
            return _back(of_joint(m.q[order, joint - 1], *(1e-3 * w for w in way)), order) if known else None
    return None


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
    time, felt = m.conditions[COLUMN][order], sensor[order]
    behind = np.empty(len(m))
    behind[0] = felt[0]
    for k in range(1, len(m)):
        # The sensor runs straight between two readings: the exact solution of the first-order lag.
        step = (time[k] - time[k - 1]) / lag
        decay = np.exp(-step)
        slope = (felt[k] - felt[k - 1]) / step if step > 0 else 0.0
        behind[k] = felt[k] - slope * (1 - decay) + (behind[k - 1] - felt[k - 1]) * decay
    warmth = _back(behind, order)
    return np.asarray(warmth - warmth.mean())


def _moves(q: Array) -> Array:
    return np.diff(q, prepend=q[0])


def _approach(q: Array) -> Array:
    motion = np.sign(np.where(np.abs(_moves(q)) > AT_REST, _moves(q), 0.0))
    for k in range(1, len(motion)):
        motion[k] = motion[k] or motion[k - 1]
    return motion


def _memory(q: Array, way: float) -> Array:
    """What is left of each motion fades along those after it; the way before the first pose is not known."""
    state, states = 0.0, []
    for move in _moves(q):
        state = float(np.sign(move) + (state - np.sign(move)) * np.exp(-abs(move) / way)) if move else state
        states.append(state)
    return np.array(states)


def _play(q: Array, half: float) -> Array:
    """What follows the joint with play stays where it is until it is taken along; it begins in the middle."""
    state, states = float(q[0]), []
    for reading in q:
        state = float(np.clip(state, reading - half, reading + half))
        states.append(state)
    return np.array(states)


# Columns of a joint, in the order of measuring, from its readings and a way [rad].
_OF_JOINT: Mapping[str, Callable[..., Array]] = {
    r"approach(\d+)": _approach,
    r"move(\d+)": _moves,
    r"memory(\d+)_(\d+)mrad": _memory,
    r"play(\d+)_(\d+)mrad": _play,
}
# A clock was set where it jumps by more than a week [s] and by so many times the usual step.
LONG, TIMES = 7 * 86400.0, 100.0
# Where more of the steps go back, the rows are not in the order of measuring.
SHUFFLED = 0.1


def clock_faults(m: Measurements) -> tuple[str, ...]:
    """Sentences about `time_s`, each with rows and values; none without that column, or for rows in another order."""
    if COLUMN not in m.conditions or len(m) < 3:
        return ()
    time, row = m.conditions[COLUMN], m.row
    by_row = np.argsort(row, kind="stable")
    time, row = time[by_row], row[by_row]
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if len(back) > max(1, SHUFFLED * len(steps)):
        return ()
    usual = float(np.median(np.abs(steps)))
    far = np.flatnonzero(steps > max(LONG, TIMES * usual))
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
