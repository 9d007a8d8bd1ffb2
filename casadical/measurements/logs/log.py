"""Joint log: what a controller recorded of every joint while the arm moved.

It is one immutable, checked object in SI units.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from casadical.core.basics import Array, Fault, FaultsError, InputError
from casadical.core.reading import LARGEST_NUMBER
from casadical.core.reporting.blocks import Table, Words
from casadical.core.reporting.result import Shown, html
from casadical.measurements.columns import POSSIBLE_RANGES

# Channel that is logged for each joint -> its unit for revolute and for prismatic joints.
CHANNELS = {
    "command": ("rad", "m"),
    "command_speed": ("rad/s", "m/s"),
    "position": ("rad", "m"),
    "speed": ("rad/s", "m/s"),
    "torque": ("N m", "N"),
    "current": ("A", "A"),
    "temperature": ("degC", "degC"),
}


@dataclass(frozen=True, eq=False)
class JointLog(Shown):
    """What was logged of an arm in motion, row by row; SI units, NaN where a cell is missing.

    time : shape (n,) [s]: grows within a run, and may begin again in the next one
    joints : names, in the order of the columns of the channels, each of shape (n, joints)
    position, command : measured and commanded joint variables [rad or m]
    speed, command_speed : measured and commanded speed of these [rad/s or m/s]
    torque : of the drive, as the controller reports it, at these variables [N m or N]
    current : of the motor [A], at these variables, too, where the controller counts otherwise
    temperature : [degC]
    current_unsigned : whether the current is an absolute value, or a raw one of unknown sign
    signs_lost : channel (torque, current) whose heading promises a sign that its numbers lack; or
        empty
    voltage : shape (n,) [V]
    payload : shape (n,) [kg]
    run : number of each row's run, shape (n,); the rows of a run are contiguous
    kinds : of each joint, revolute or prismatic; all revolute where none are given
    row : line of the source, shape (n,), for messages
    source : file name or description
    findings : sentences: what was understood, and what is unusual
    Raises InputError: arrays that do not fit each other, a time that does not grow, or nothing to
    diagnose.
    """

    time: Array
    joints: tuple[str, ...]
    position: Array
    command: Array | None = None
    command_speed: Array | None = None
    speed: Array | None = None
    torque: Array | None = None
    current: Array | None = None
    temperature: Array | None = None
    current_unsigned: bool = False
    signs_lost: str = ""
    voltage: Array | None = None
    payload: Array | None = None
    run: Array = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    kinds: tuple[str, ...] = ()
    row: Array = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    source: str = "log"
    findings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.time)
        if not len(self.run):
            object.__setattr__(self, "run", np.ones(n, dtype=np.int64))
        if not len(self.row):
            object.__setattr__(self, "row", np.arange(n) + 2)
        if not self.kinds:
            object.__setattr__(self, "kinds", ("revolute",) * len(self.joints))
        for name in ("time", "run", "row", *self.arrays):
            view = np.asarray(getattr(self, name)).view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)
        _refuse_malformed(self)

    @property
    def _line(self) -> str:
        """Return the summary in the repr: source, numbers of rows and joints, duration [s], channels."""
        seconds = sum(run.time[-1] - run.time[0] for run in self.runs())
        channels = ", ".join(name.replace("_", " ") for name in self.arrays)
        return f" {self.source}: {len(self)} rows, {seconds:.1f} s, {len(self.joints)} joints: {channels}"

    def _repr_html_(self) -> str:
        """Return HTML for a notebook: the findings, and the ranges of all channels."""
        rows = []
        for name, values in self.arrays.items():
            for k, column in enumerate(values.T if values.ndim == 2 else [values]):
                unit = self.unit(name, k) if name in CHANNELS else {"voltage": "V", "payload": "kg"}[name]
                label = f"{name.replace('_', ' ')} {self.joints[k] if values.ndim == 2 else ''} [{unit}]"
                if np.isfinite(column).any():
                    rows.append((label, f"{np.nanmin(column):.4g}", f"{np.nanmax(column):.4g}"))
        table = Table("Ranges", ("channel", "least", "greatest"), rows, frozenset({1, 2}))
        return html([*(Words(text, "note") for text in self.findings), table], title=repr(self)[1:-1])

    def __len__(self) -> int:
        return len(self.time)

    @property
    def arrays(self) -> dict[str, Array]:
        """The logged arrays by name [SI]: channels (n, joints), voltage and payload (n,)."""
        names = (*CHANNELS, "voltage", "payload")
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    def unit(self, channel: str, joint: int) -> str:
        """Return the unit of a channel of `CHANNELS` for a joint, given by its index from 0."""
        return CHANNELS[channel][self.kinds[joint] == "prismatic"]

    def __getitem__(self, which: Array | slice | Sequence[int]) -> JointLog:
        """Return the rows chosen by a mask, a slice or indices."""
        given: dict[str, Any] = {name: values[which] for name, values in self.arrays.items()}
        return replace(self, time=self.time[which], run=self.run[which], row=self.row[which], **given)

    def runs(self) -> Iterator[JointLog]:
        """Yield each run of two rows or more as a log of its own, sharing this one's arrays."""
        ends = [0, *(np.flatnonzero(np.diff(self.run)) + 1), len(self)]
        return (self[start:end] for start, end in pairwise(ends) if end > start + 1)

    @cached_property
    def step(self) -> float:
        """The median time between two rows of a run [s]; 0 without such rows."""
        steps = np.diff(self.time)[np.diff(self.run) == 0]
        return float(np.median(steps)) if len(steps) else 0.0


def joined(logs: Sequence[JointLog]) -> JointLog:
    """Return several logs of one arm as one, each run with a number of its own.

    Channels that not every log has are dropped, and so are the findings, which are of single logs;
    a single log is returned unchanged.
    Raises InputError: logs of other joints.
    """
    first, *others = logs
    if other := next((log for log in others if log.joints != first.joints), None):
        raise InputError(f"{other.source}: joints {', '.join(other.joints)}; {first.source}: {', '.join(first.joints)}")
    if not others:
        return first
    shared: dict[str, Any] = dict.fromkeys(first.arrays)
    for name in shared:
        parts = [log.arrays.get(name) for log in logs]
        present = [part for part in parts if part is not None]
        shared[name] = np.concatenate(present) if len(present) == len(logs) else None
    counts = np.cumsum([0, *(int(log.run.max()) for log in logs)])
    shared |= {name: np.concatenate([getattr(log, name) for log in logs]) for name in ("time", "row")}
    shared["run"] = np.concatenate([log.run + before for log, before in zip(logs, counts, strict=False)])
    shared["signs_lost"] = max(log.signs_lost for log in logs)
    shared["findings"] = ()
    shared["current_unsigned"] = any(log.current_unsigned for log in logs)
    return replace(first, **shared, source=", ".join(log.source for log in logs))


def _refuse_malformed(log: JointLog) -> None:
    """Check shapes, values, times and runs."""
    n, joints = len(log.time), len(log.joints)
    if n < 2 or not joints:
        raise InputError(f"{log.source}: {n} rows of {joints} joints; at least two rows of one joint are needed")
    if twice := next((name for name in log.joints if log.joints.count(name) > 1), None):
        raise InputError(f"{log.source}: joint {twice!r} is there twice; each needs a name of its own")
    shapes = {"time": (n,), "run": (n,), "row": (n,), "kinds": (joints,)}
    for name in (*shapes, *log.arrays):
        wanted = shapes.get(name, (n, joints) if name in CHANNELS else (n,))
        if np.shape(getattr(log, name)) != wanted:
            raise InputError(f"{log.source}: {name} has the shape {np.shape(getattr(log, name))}; allowed: {wanted}")
    if log.command is None and log.torque is None and log.current is None:
        raise InputError(
            f"{log.source}: neither commands nor a torque or current, so nothing says what the "
            "joints should have done; only their motion is known. Log the commanded positions "
            "(command1_rad ...) or the currents (current1_A ...) beside q1_rad ..."
        )
    faults = [
        fault for name, values in (("time", log.time), *log.arrays.items()) for fault in _cells(log, name, values)
    ]
    if faults:
        raise FaultsError(faults)
    ends = np.flatnonzero(np.diff(log.run))
    starts = log.run[np.concatenate([[0], ends + 1])]
    if len(set(starts.tolist())) < len(starts):
        raise InputError(f"{log.source}: rows of one run stand apart; number the runs in their order in column run")
    stands = np.flatnonzero((np.diff(log.time) <= 0) & (np.diff(log.run) == 0))
    if len(stands):
        k = stands[0] + 1
        raise InputError(
            f"{log.source}: row {log.row[k]}, column 'time_s': {log.time[k]:.9g} s follows "
            f"{log.time[k - 1]:.9g} s; allowed: times that grow within a run; correct the clock, "
            "or number the runs in column run"
        )


def _cells(log: JointLog, name: str, values: Array) -> Iterator[Fault]:
    """Yield a fault for the impossible values of a channel, one for each joint.

    NaN is a missing cell, a fault only in times and where a joint has no position at all.
    name : of the array; values : shape (n, joints) or (n,) [SI]
    """
    for k, column in enumerate(values.T if values.ndim == 2 else [values]):
        label = f"{name} {log.joints[k]}" if values.ndim == 2 else name
        limited = {"payload": "payload_kg", "temperature": "temperature_degC"}.get(name, "")
        least, most = POSSIBLE_RANGES.get(limited, (-LARGEST_NUMBER, LARGEST_NUMBER))
        wrong, allowed = (column < least) | (column > most), f"{least:g} to {most:g}" if limited else "finite numbers"
        if name == "time":
            wrong |= np.isnan(column)
        elif np.isnan(column).all() and name == "position":
            yield Fault(log.source, (), label, "", "has no reading", "", "log it, or name a robot without this joint")
        elif name == "current" and log.current_unsigned:
            wrong, allowed = wrong | (column < 0), "absolute values; name a signed current current1_A ..."
        rows = tuple(map(int, log.row[wrong]))
        if rows:
            value = f"{column[np.argmax(wrong)]:g}"
            yield Fault(log.source, rows, label, value, "is not possible", allowed, "correct or empty the cell")
