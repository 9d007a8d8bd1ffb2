"""Meaning of a log's columns: channel, joint and unit, from headings of several systems."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from casadical.core.basics import Array, InputError, shown
from casadical.core.reading import json_of
from casadical.measurements.columns import in_seconds, numbers_of
from casadical.measurements.headings import words_of
from casadical.measurements.raw_table import RawTable
from casadical.measurements.vocabulary import UNITS, WORDS

# Pattern of casadical's own column names: channel, joint and unit.
_CANONICAL_NAME = re.compile(
    r"(command_v|command|q|v|torque|current|temperature)(\d+)_(rad_s|deg_s|m_s|mm_s|rad|deg|mm|m|Nm|N|A|mA|abs|degC)"
)
# Unit (suffix of a column) -> factor to SI; a unit that is not listed has the factor 1.
SI_FACTORS = {"deg": np.pi / 180, "deg_s": np.pi / 180, "mm": 1e-3, "mm_s": 1e-3, "mA": 1e-3}
# Units (suffixes of columns) by which a channel is recognised as that of a prismatic joint.
LENGTH_UNITS = ("m", "mm", "m_s", "mm_s", "N")
# Channel -> words of headings. A column belongs to the first channel of which its heading has a
# word; the empty channel collects quantities that are not used.
_QUANTITIES: Mapping[str, frozenset[str]] = {
    "": WORDS["log_others"],
    "temperature": WORDS["temperature"] | WORDS["log_temperature"],
    **{channel: WORDS[f"log_{channel}"] for channel in ("torque", "speed", "position", "current")},
}
# Words that mark a channel as commanded.
_COMMANDED = WORDS["nominal"] | WORDS["log_commanded"]
# End of messages about columns that are missing.
NAMING_ADVICE = "Name them time_s, q1_rad, q2_rad, ... (_deg, _m, _mm), commands command1_rad, torque1_Nm or current1_A"


@dataclass(frozen=True, eq=False)
class Logged:
    """A log as it stands in a file, before its joints are put in the robot's order.

    time : shape (n,) [s]
    channels : channel -> joint -> column, shape (n,), in the unit of `units`
    units : (channel, joint) -> unit; empty if it is unknown
    row : line of the source, shape (n,)
    source : its name
    scalars : "voltage" [V], "payload" [kg] and "run" -> column, shape (n,), as far as logged
    notes : sentences on how the file was read
    """

    time: Array
    channels: Mapping[str, Mapping[str, Array]]
    units: Mapping[tuple[str, str], str]
    row: Array
    source: str
    scalars: Mapping[str, Array] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def logged(raw: RawTable, names: Sequence[str] = (), listed: Sequence[str] = ()) -> Logged:
    """Return the log in a table, its columns in the file's units and order of joints.

    names : of the robot's joints; listed : of the joints in columns whose cells are lists
    Raises InputError: no time, no channel, a cell that is no number, two columns of casadical's own
    names for one channel of a joint, or lists of other lengths than the names.
    """
    source, frame = raw.path.name, raw.frame
    below = dict(zip(raw.header, raw.form.units, strict=False))
    channels: dict[str, dict[str, Array]] = {}
    units: dict[tuple[str, str], str] = {}
    scalars: dict[str, Array] = {}
    headings: dict[tuple[str, str], str] = {}
    notes: list[str] = []
    if not listed:  # names in a column of lists, as ROS writes JointState
        named = [h for h in raw.header if {*words_of(h)[0]} & {"name", "names"}]
        alike = next((raw.frame[h] for h in named if len({*raw.frame[h].astype(str)}) == 1), None)
        listed = [] if alike is None else re.findall(r"[\w./-]+", str(alike.iloc[0]))
    for heading in raw.header:
        if heading.startswith("time_") or heading not in frame:  # a column without a heading
            continue
        said = {*words_of(heading)[0]}
        if said & {"name", "names"}:
            continue
        if scalar := next((name for name in ("voltage", "payload", "run") if said & WORDS[f"log_{name}"]), ""):
            scalars.setdefault(scalar, numbers_of(frame[heading]))
            continue
        lists = _lists(frame[heading], raw)
        parts = [(*meaning(heading, names), frame[heading])] if lists is None else []
        if lists is not None and (channel := _channel(words_of(heading)[0])):
            those = listed or [str(k) for k in range(1, lists.shape[1] + 1)]
            if len(those) != lists.shape[1]:
                raise InputError(
                    f"{source}: column {heading!r}: lists of {lists.shape[1]} numbers, {len(those)} joints"
                )
            parts = [(channel, joint, "", column) for joint, column in zip(those, lists.T, strict=True)]
        for channel, joint, unit, cells in parts:
            values = numbers_of(pd.Series(cells))
            if not channel or not np.isfinite(values).any():
                words = pd.Series(cells).dropna()
                if channel and len(words) and _CANONICAL_NAME.fullmatch(heading.strip()):
                    raise InputError(f"{source}: column {heading!r}: {shown(words.iloc[0])} is no number")
                continue
            if len(wrong := np.flatnonzero(np.isnan(values) & pd.notna(cells))):
                where = f"row {raw.line[wrong[0]]}, column {heading!r}: {shown(np.asarray(cells)[wrong[0]])}"
                raise InputError(f"{source}: {where} is no number; correct or empty the cell")
            first = headings.setdefault((channel, joint), heading)
            if first == heading:
                channels.setdefault(channel, {})[joint] = values
                units[channel, joint] = unit or _si_name(below.get(heading, ""))
            elif all(_CANONICAL_NAME.fullmatch(name.strip()) for name in (first, heading)):
                raise InputError(f"{source}: columns {first} and {heading} are the {channel} of one joint; keep one")
            else:
                notes.append(f"column {heading} is not used, for {first} is the {channel} of joint {joint}")
    if not channels:
        raise InputError(
            f"{source}: no column holds what joints did; there are {', '.join(raw.header[:40])}. {NAMING_ADVICE}"
        )
    return Logged(_time(raw), channels, units, np.asarray(raw.line), source, scalars, tuple(notes))


def _lists(cells: pd.Series, raw: RawTable) -> Array | None:
    """Return a column of lists (JSON or Parquet) as an array, shape (n, k); None for others."""
    if is_numeric_dtype(cells):
        return None
    cells = cells.map(lambda cell: _as_json(cell) if isinstance(cell, str) else cell)
    first = cells.iloc[0]
    if isinstance(first, str) and first.lstrip().startswith("["):
        rows = json_of(f"[{','.join(map(str, cells))}]", raw.path.name, list)
    elif isinstance(first, np.ndarray | list) and np.ndim(first) == 1:
        rows = list(cells)
    else:
        return None
    if len(rows) != len(cells):  # a cell with two lists, or with none
        raise InputError(
            f"{raw.path.name}: column {cells.name!r}: {len(rows)} lists in {len(cells)} rows; one is needed"
        )
    wanted = (np.size(rows[0]),)
    for k, line in enumerate(raw.line):
        try:
            shape = np.asarray(rows[k], dtype=float).shape
            wrong = "" if shape == wanted else f"a list of {np.size(rows[k])} numbers"
        except (TypeError, ValueError, OverflowError):
            wrong = "no list of numbers"
        if wrong:
            raise InputError(
                f"{raw.path.name}: row {line}, column {cells.name!r}: {wrong}, {wanted[0]} in the first row; correct it"
            )
    return np.array(rows, dtype=float)


def _as_json(cell: str) -> str:
    """Return a list as Python writes it, array('d', [1.0]) or (1.0,), in brackets; others unchanged."""
    text = re.sub(r"^\s*array\('\w',\s*(.*)\)\s*$", r"\1", cell)
    return re.sub(r"^\s*\((.*?),?\s*\)\s*$", r"[\1]", text)


def tells_time(heading: str) -> bool:
    """Return whether a column is a time: by a word, or t alone."""
    words = words_of(heading)[0]
    return words == ["t"] or bool({*words} & WORDS["time"])


def has_lists(raw: RawTable, channel: str) -> bool:
    """Return whether cells of a column of this channel are lists."""
    return any(
        _channel(words_of(heading)[0]) == channel and _as_json(str(raw.frame[heading].iloc[0])).startswith("[")
        for heading in raw.header
        if heading in raw.frame
    )


def meaning(heading: str, names: Sequence[str]) -> tuple[str, str, str]:
    """Return channel, joint (a number or a name) and unit that a column's heading states.

    All are empty if it names no channel or no joint; the unit is empty where none is stated.

    names : of the robot's joints
    """
    if ours := _CANONICAL_NAME.fullmatch(heading.strip()):
        return {"command_v": "command_speed", "q": "position", "v": "speed"}.get(ours[1], ours[1]), ours[2], ours[3]
    words, unit = words_of(heading)
    joint, rest = _joint(words, names)
    channel = _channel(rest)
    if not channel and {*rest} <= WORDS["joint"] and len(rest) < 2 and (is_number(joint) or joint in names):
        channel = "position"  # J1 or joint_1 alone, or the name of a joint
    return (channel, joint, _si_name(unit)) if channel and joint else ("", "", "")


def _channel(words: Sequence[str]) -> str:
    """Return the channel of `CHANNELS` that the words of a heading name; empty if none."""
    said = {*words}
    channel = next((name for name, telling in _QUANTITIES.items() if said & telling), "")
    if said & _COMMANDED:
        alone = "command" if said <= _COMMANDED | WORDS["joint"] else ""  # "elbow command"
        return {"position": "command", "speed": "command_speed", "": alone}.get(channel, "")
    return channel


def _joint(words: Sequence[str], names: Sequence[str]) -> tuple[str, list[str]]:
    """Return the joint that the words of a heading name, and the other words.

    It is one of `names`, else the words without another meaning, such as a number; or empty.
    """
    for name in sorted(names, key=len, reverse=True):
        part = words_of(name)[0]
        at = next((k for k in range(len(words) - len(part) + 1) if list(words[k : k + len(part)]) == part), None)
        if part and at is not None:
            return name, [*words[:at], *words[at + len(part) :]]
    # Words without a meaning of their own in a heading.
    filler_words = WORDS["filler"] | WORDS["measured"] | WORDS["joint"] | WORDS["log_filler"]
    understood = filler_words | _COMMANDED | frozenset().union(*_QUANTITIES.values())
    remaining = [word for word in words if word not in understood]
    return " ".join(str(int(w)) if is_number(w) else w for w in remaining), [w for w in words if w not in remaining]


def is_number(word: str) -> bool:
    """Return whether a word may be the number of a joint: at most 9 digits."""
    return word.isdecimal() and len(word) <= 9


def _si_name(unit: str) -> str:
    """Return the suffix (deg, rad, mm, m) of casadical's columns for a word of a unit, or ""."""
    ours, factor = UNITS.get(unit, ("", 1.0))
    return {("deg", 1.0): "deg", ("rad", 1.0): "rad", ("mm", 1.0): "mm", ("mm", 1e3): "m"}.get((ours, factor), "")


def _time(raw: RawTable) -> Array:
    """Return the time of each row, shape (n,) [s], from its column or columns."""
    frame = raw.frame
    if "time_s" in frame:
        return numbers_of(frame["time_s"])
    named = [(name, *words_of(name)) for name in raw.header]
    clocks = [(name, words, unit) for name, words, unit in named if tells_time(name) or unit == "nanosec"]
    if not clocks:
        raise InputError(
            f"{raw.path.name}: no column holds the time; name it time_s; there are {', '.join(raw.header)}"
        )
    whole = next((each for each in clocks if UNITS.get(each[2], ("", 1.0))[1] != 1e-9), clocks[0])
    values = in_seconds(frame[whole[0]])
    fine = [name for name, _, unit in clocks if name != whole[0] and UNITS.get(unit, ("", 1.0))[1] == 1e-9]
    if fine:
        return np.asarray(values + 1e-9 * numbers_of(frame[fine[0]]))
    if UNITS.get(whole[2], ("",))[0] == "s":
        return np.asarray(values * UNITS[whole[2]][1])
    # The largest factor to seconds with which rows come at 2 Hz or faster.
    step = float(np.nanmedian(np.abs(np.diff(values)))) if len(values) > 1 else 0.0
    factor = next((factor for factor in (1.0, 1e-3, 1e-6) if step * factor <= 0.5), 1e-9)
    return np.asarray(values * factor)
