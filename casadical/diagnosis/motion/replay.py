"""Open-loop replay of joint logs: whole runs predicted from their commands alone, before and after the response."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from casadical.core.arrays import Array
from casadical.core.progress import Show, silent
from casadical.core.telling.blocks import Block, Table, Words
from casadical.core.telling.result import Result
from casadical.diagnosis.motion.replay_figures import replay_figures
from casadical.diagnosis.motion.response import Response, fitted
from casadical.measurements.logs.log import JointLog
from casadical.robot.robot import Robot
from casadical.robot.robot_file import to_toml

# Logs are withheld in so many parts where none are kept apart; a joint that moves less is not counted [rad].
FOLDS, MOVED = 4, 5e-3


@dataclass(frozen=True, eq=False)
class Replay(Result):
    """Runs that were replayed from the first reading of each and their commands.

    response : fitted to all logs that may be fitted; runs : that were replayed
    predicted : of each, positions, shape (rows, joints) [rad]; held_out : whether no run was fitted by what predicts it
    """

    kept_as: ClassVar[str] = "replay"

    response: Response
    runs: tuple[JointLog, ...]
    predicted: tuple[Array, ...]
    held_out: bool

    @cached_property
    def before(self) -> Array:
        """Rms of reading less command of each joint, shape (joints,) [rad]."""
        return self._rms([run.command for run in self.runs if run.command is not None])

    @cached_property
    def after(self) -> Array:
        """Rms of reading less prediction of each joint, shape (joints,) [rad]."""
        return self._rms(self.predicted)

    @cached_property
    def moves(self) -> Array:
        """Which joints do, shape (joints,)."""
        spans = [np.ptp(run.command, axis=0) for run in self.runs if run.command is not None]
        return np.asarray(np.max(spans, axis=0) > MOVED)

    def left(self, run: int, *, before: bool) -> Array:
        """Reading less command, or less prediction, of a run, shape (rows, joints) [rad]."""
        log = self.runs[run]
        assert log.command is not None
        return np.asarray(log.position - (log.command if before else self.predicted[run]))

    def by_time(self, cells: int) -> tuple[Array, tuple[Array, Array]]:
        """Middles of so many parts of the time of all runs [s], and rms in each, before and after, (cells, joints)."""
        ends = np.cumsum([0.0, *(float(run.time[-1] - run.time[0]) for run in self.runs)])
        t = np.concatenate([run.time - run.time[0] + a for run, a in zip(self.runs, ends, strict=False)])
        edges = np.linspace(0, ends[-1], cells + 1)
        part = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, cells - 1)
        found = []
        for before in (True, False):
            squares = np.concatenate([self.left(k, before=before) for k in range(len(self.runs))]) ** 2
            mean = [squares[part == k].mean(axis=0) if (part == k).any() else squares[0] * np.nan for k in range(cells)]
            found.append(np.sqrt(np.array(mean)))
        return (edges[1:] + edges[:-1]) / 2, (found[0], found[1])

    @cached_property
    def friction_samples(self) -> tuple[Array, Array]:
        """Speed and friction torque of all samples, shapes (rows, joints): what the servo gives beyond load."""
        parts = [self.response.friction_of(run) for run in self.runs]
        return np.concatenate([v for v, _ in parts]), np.concatenate([torque for _, torque in parts])

    def _rms(self, angles: Sequence[Array]) -> Array:
        left = np.concatenate([run.position - own for run, own in zip(self.runs, angles, strict=True)])
        return np.asarray(np.sqrt(np.nanmean(left**2, axis=0)))

    def blocks(self) -> Sequence[Block]:
        """As `casadical diagnose ARM LOG` prints it."""
        return [
            Words(self._sentence(), "verdict"),
            self._table(),
            self._drives(),
            *self._notes(),
            *replay_figures(self),
        ]

    def _notes(self) -> Iterator[Words]:
        joints = self.runs[0].joints
        if still := ", ".join(name for name, moved in zip(joints, self.response.moved, strict=True) if not moved):
            yield Words(
                f"Did not move in the fitted runs: {still}; the response there is a usual one, not found.", "note"
            )
        worse = [name for name, b, a in zip(joints, self.before, self.after, strict=True) if a > b]
        if worse:
            yield Words(f"Worse than position = command: {', '.join(worse)}; log more motions of it.", "warning")

    def _sentence(self) -> str:
        what = "not fitted" if self.held_out else "fitted, for there is no other (log a second motion)"
        seconds = sum(float(run.time[-1] - run.time[0]) for run in self.runs)
        before, after = (1e3 * float(np.sqrt((v**2).mean())) for v in (self.before, self.after))
        return (
            f"Replay of {len(self.runs)} runs ({seconds:.0f} s) that were {what}, from the first reading and the "
            f"commands alone: {before:.3g} mrad rms before, {after:.3g} mrad with the response of each joint."
        )

    def _table(self) -> Table:
        rows = [
            (name, f"{1e3 * b:.3g}", f"{1e3 * a:.3g}", f"{100 * (1 - a / b):.0f} %" if b > 0 else "")
            for name, b, a in zip(self.runs[0].joints, self.before, self.after, strict=True)
        ]
        title = "Open-loop replay, rms of each joint [mrad]: position = command, and with its response"
        return Table(title, ("joint", "before", "after", "less"), rows, frozenset({1, 2, 3}))

    def _drives(self) -> Table:
        r = self.response
        parts = (r.gain, r.friction, r.friction / r.gain * 1e3, r.damping, r.armature, r.delay * 1e3, r.bias)
        rows = [
            (name, *(f"{v:.3g}" for v in each))
            for name, each in zip(self.runs[0].joints, np.column_stack(parts), strict=True)
        ]
        columns = ("joint", "kp", "F", "F / kp", "b", "rotor", "delay", "const")
        title = (
            "Response of each joint, torques by the masses of the robot file: gain kp [N m/rad], dry friction F [N m], "
            "F / kp [mrad], damping b [N m s/rad], rotor inertia [kg m^2], delay [ms], constant torque [N m]"
        )
        return Table(title, columns, rows, frozenset(range(1, 8)))

    def to_json(self) -> dict[str, Any]:
        return {
            "held_out": self.held_out,
            "runs": [run.source for run in self.runs],
            "fitted": list(self.response.fitted),
            "joints": [
                {"joint": name, "before_rad": float(b), "after_rad": float(a)}
                for name, b, a in zip(self.runs[0].joints, self.before, self.after, strict=True)
            ],
            "drive": self.response.drive().table(),
        }

    def files(self, folder: str | Path) -> Mapping[Path, str]:
        """Plain data, words, and the robot with its drives."""
        made = to_toml(
            self.response.robot(), "[drive]: response of the joints to their commands, by casadical diagnose"
        )
        return {**super().files(folder), Path(folder) / "diagnosed.robot.toml": made}


def replayed(robot: Robot, logs: Sequence[JointLog], withheld: Sequence[JointLog] = (), show: Show = silent) -> Replay:
    """Fit the response of each joint to some logs, and replay runs that were not fitted.

    withheld : logs that are not fitted; with none the runs are withheld in turn, and a single run is replayed itself
    Raises InputError: logs without commands or without a run of two seconds.
    """
    show("response of each joint")
    own, kept = ([run for log in each for run in log.runs()] for each in (logs, withheld))
    response = fitted(robot, own)
    if kept or len(own) == 1:
        runs = kept or own
        return Replay(response, tuple(runs), tuple(response.predicted(run) for run in runs), bool(kept))
    folds = min(FOLDS, len(own))
    predicted: dict[int, Array] = {}
    for k in range(folds):
        show(f"replay, part {k + 1} of {folds}")
        other = fitted(robot, [run for i, run in enumerate(own) if i % folds != k])
        predicted |= {i: other.predicted(own[i]) for i in range(k, len(own), folds)}
    return Replay(response, tuple(own), tuple(predicted[i] for i in range(len(own))), True)
