"""Derived columns that effects use, from readings, time, temperature and order of measuring."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import accumulate

import numpy as np

from casadical.core.basics import Array
from casadical.measurements.measurements import Measurements

# Logged column of the time at which each pose was measured [s].
TIME_COLUMN = "time_s"
# Minimum displacement of the measured point across the beam [m] that counts as a rotation of the
# instrument's head; the direction of shorter ones is dominated by noise.
MIN_WAY_M = 0.01
# Function that returns the gravity torques as shares of the joints' peak ones, shape (n, joints),
# from joint variables, shape (n, joints) [rad or m], and logged columns (see `Robot.loads`).
Loads = Callable[[Array, Mapping[str, Array]], Array]


def derive(m: Measurements, names: Iterable[str], loads: Loads | None = None) -> tuple[Measurements, tuple[str, ...]]:
    """Return the measurements with the named columns added, and the names that cannot be derived.

    A column cannot be derived where a logged column or joint that it needs is missing; logged ones
    stay. Columns, all in the order of measuring (by time_s, else pose, else rows):

    - progress: place in this order, 0 to 1
    - warmth_600s: temperature_degC through a first-order lag of 600 s, less its mean [K]
    - approach2: direction of joint 2's last motion, -1 or 1; 0 before the first one
    - move2: joint 2's change since the pose before, 0 for the first pose [rad or m]
    - memory2_300mrad: hysteresis state of joint 2, -1 to 1, that approaches the direction of
      motion exponentially over 0.3 rad (Dahl 1968)
    - play2_300mrad: position of a part that joint 2 drives through a play of 0.3 rad to each
      side [rad or m]; a relay with play is a step function of it
    - heat2_600s: square of joint 2's load, as a share of its peak, after a lag of 600 s
    - head_1500_m200_0mm: sense of the last rotation, -1 or 1, 0 before the first, of the head of
      an instrument at [1.5, -0.2, 0] m in the measuring frame that follows the measured point;
      motions of the point of less than 10 mm across the beam are ignored

    m : campaign with its logged columns
    names : columns to derive, of the forms above with other joints and numbers
    loads : function that returns the joint loads of the robot, needed for heat columns

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
    """Return a derived column (see `derive`) in the order of rows, shape (n,), or None.

    None where the name is no derived column, or a column or joint that it needs is missing.

    loads : function that returns the joint loads, needed for heat columns; None without
    """
    order = np.argsort(
        next((m.conditions[c] for c in (TIME_COLUMN, "pose") if c in m.conditions), m.row), kind="stable"
    )
    if name == "progress":
        return _in_row_order(np.arange(len(m)) / max(1, len(m) - 1), order)
    if lag := re.fullmatch(r"warmth_(\d+)s", name):
        return _warmth(m, float(lag[1]), order)
    if heat := re.fullmatch(r"heat(\d+)_(\d+)s", name):
        joint, seconds = int(heat[1]), float(heat[2])
        time = m.conditions.get(TIME_COLUMN)
        if loads is None or time is None or not 1 <= joint <= m.q.shape[1] or not seconds:
            return None
        square = np.nan_to_num(loads(m.q, m.conditions)[:, joint - 1]) ** 2
        return _in_row_order(_lagged(square[order], time[order], seconds), order)
    # Pattern of a whole number of millimetres in a column's name; "m" stands for a minus sign.
    integer_mm = r"(m?\d+)"
    if station := re.fullmatch(rf"head_{integer_mm}_{integer_mm}_{integer_mm}mm", name):
        if m.position is None or not m.position.any():  # of several tables together
            return None
        at_mm = [float(mm.replace("m", "-")) for mm in station.groups()]
        beam = m.position[order] - 1e-3 * np.array(at_mm)
        turns = np.diff(np.unwrap(np.arctan2(beam[:, 1], beam[:, 0])), prepend=0.0)
        turns[0] = 0.0
        return _in_row_order(last_sense(turns * np.hypot(beam[:, 0], beam[:, 1]), MIN_WAY_M), order)
    # Moves below 1e-9 are rounding of one reading, not motion; lengths in names are in mrad or mm.
    of_joints: Mapping[str, Callable[..., Array]] = {
        r"approach(\d+)": lambda q: last_sense(_moves(q), 1e-9),
        r"move(\d+)": _moves,
        r"memory(\d+)_(\d+)mrad": _memory,
        r"play(\d+)_(\d+)mrad": _play,
    }
    for pattern, of_joint in of_joints.items():
        if match := re.fullmatch(pattern, name):
            joint, *way = map(int, match.groups())
            exists = 1 <= joint <= m.q.shape[1]
            return _in_row_order(of_joint(m.q[order, joint - 1], *(1e-3 * w for w in way)), order) if exists else None
    return None


def _in_row_order(values: Array, order: Array) -> Array:
    """Return values given in the order of measuring, rearranged to the order of the rows, (n,).

    order : row index of each value, shape (n,)
    """
    rows = np.empty(len(order))
    rows[order] = values
    return rows


def _warmth(m: Measurements, lag: float, order: Array) -> Array | None:
    """Return the temperature behind a first-order lag minus its mean, shape (n,) [K].

    None if the column of temperature or time is missing.

    lag : time constant of the lag [s]; 0 for none; order : rows in the order of measuring
    """
    if "temperature_degC" not in m.conditions or (lag and TIME_COLUMN not in m.conditions):
        return None
    sensor = m.conditions["temperature_degC"]
    if not lag:
        return np.asarray(sensor - sensor.mean())
    warmth = _in_row_order(_lagged(sensor[order], m.conditions[TIME_COLUMN][order], lag), order)
    return np.asarray(warmth - warmth.mean())


def _lagged(felt: Array, time: Array, lag: float) -> Array:
    """Return values after a first-order lag, shape (n,), in their unit and order.

    The lag starts in steady state at the first value.

    felt : values in the order of measuring, shape (n,); time : of each [s]; lag : time constant [s]
    """
    behind = np.empty(len(felt))
    behind[0] = felt[0]
    for k in range(1, len(felt)):
        # Exact solution of the first-order lag for an input that is linear between two readings.
        step = (time[k] - time[k - 1]) / lag
        decay = np.exp(-step)
        slope = (felt[k] - felt[k - 1]) / step if step > 0 else 0.0
        behind[k] = felt[k] - slope * (1 - decay) + (behind[k - 1] - felt[k - 1]) * decay
    return behind


def _moves(q: Array) -> Array:
    """Return the changes of a joint's variable q, (n,), since the pose before, (n,), first 0."""
    return np.diff(q, prepend=q[0])


def last_sense(ways: Array, least: float) -> Array:
    """Return the sign of the last motion longer than `least` up to each element, shape (n,).

    It is -1 or 1, and 0 before the first such motion.

    ways : signed lengths of the motions, in order, shape (n,); least : in their unit
    """
    motion = np.sign(np.where(np.abs(ways) > least, ways, 0.0))
    for k in range(1, len(motion)):
        motion[k] = motion[k] or motion[k - 1]
    return np.asarray(motion)


def _memory(q: Array, travel: float) -> Array:
    """Return the hysteresis state of one joint at each pose, shape (n,), -1 to 1.

    It approaches the direction of each motion exponentially, and begins at zero, because the
    motion before the first pose is unknown.

    q : the joint's variable in the order of measuring, shape (n,) [rad or m]
    travel : path over which the distance from the direction falls to 1/e [rad or m]
    """
    state, states = 0.0, []
    for move in _moves(q):
        state = float(np.sign(move) + (state - np.sign(move)) * np.exp(-abs(move) / travel)) if move else state
        states.append(state)
    return np.array(states)


def _play(q: Array, half: float) -> Array:
    """Return the position of a part that one joint drives through play, shape (n,) [rad or m].

    The part stands still until the joint takes it along; at the first pose the play is centred.

    q : the joint's variable in the order of measuring, shape (n,) [rad or m]
    half : play to each side [rad or m]
    """
    taken = accumulate(q, lambda state, reading: float(np.clip(state, reading - half, reading + half)))
    return np.array([*taken])


def clock_faults(m: Measurements) -> tuple[str, ...]:
    """Return sentences on steps back and jumps of the column `time_s`, with rows and values.

    There are none without that column, and where the rows are not in the order of measuring.
    """
    if TIME_COLUMN not in m.conditions or len(m) < 3:
        return ()
    time, row = m.conditions[TIME_COLUMN], m.row
    by_row = np.argsort(row, kind="stable")
    time, row = time[by_row], row[by_row]
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    # If more than a tenth of the steps go back, the rows are not in the order of measuring.
    if len(back) > max(1, 0.1 * len(steps)):
        return ()
    usual = float(np.median(np.abs(steps)))
    # A jump by more than a week and by 100 times the median step [s] means that the clock was set.
    far = np.flatnonzero(steps > max(7 * 86400.0, 100.0 * usual))
    said = []
    for at, what in ((back, "goes back"), (far, "jumps")):
        if len(at):
            where = ", ".join(f"from {time[k]:.10g} to {time[k + 1]:.10g} s at row {row[k + 1]}" for k in at[:3])
            more = f" and {len(at) - 3} times more" if len(at) > 3 else ""
            said.append(
                f"{m.source}: {TIME_COLUMN} {what} {where}{more}: a clock was set or started "
                "again; correct the column or leave it out, else what follows time or temperature "
                "is judged by it"
            )
    return tuple(said)
