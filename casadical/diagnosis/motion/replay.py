"""Open-loop replay of joint logs: whole runs predicted from their commands, and its figures.

Errors without and with the identified response are shown over time, and as friction and hysteresis
curves.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from casadical.core.basics import Array, Show, silent
from casadical.core.reporting.blocks import Block, Table
from casadical.core.reporting.figure import Axis, Figure, Panel, Series
from casadical.core.reporting.plain import WRITTEN, Key
from casadical.core.reporting.result import Result
from casadical.core.statistics import best_of, first_of_best
from casadical.diagnosis.motion.against import Arbitration, arbitrated, arbitration_tables
from casadical.diagnosis.motion.effect_table import EffectTable, effect_table
from casadical.diagnosis.motion.friction_laws import FrictionLaws, friction_laws
from casadical.diagnosis.motion.response import Response, fitted
from casadical.diagnosis.motion.signals import arm_of, torque_of
from casadical.identification.figures import banded
from casadical.measurements.logs.log import JointLog, joined
from casadical.robot.robot import Robot
from casadical.robot.robot_file import to_toml

MIN_COMMAND_SPAN_RAD = 5e-3  # a joint moves if its commands span more than this [rad]


@dataclass(frozen=True, eq=False)
class Replay(Result):
    """Runs replayed from the first reading of each and their commands.

    response : response identified from all logs that may be fitted
    runs : the replayed runs; responses : the response that predicts each run
    predicted : predicted positions of each run, shape (rows, joints) [rad]
    held_out : whether no run was used to identify the response that predicts it
    against : comparisons with published parameters of files
    """

    file_stem: ClassVar[str] = "replay"
    report: ClassVar[str] = "replay.j2"

    derived: ClassVar[tuple[Key, ...]] = (
        Key("runs", lambda replay: [run.source for run in replay.runs]),
        Key("fitted", "response.fitted"),
        Key(
            "joints",
            lambda replay: [
                {"joint": name, "before_rad": b, "after_rad": a}
                for name, b, a in zip(replay.runs[0].joints, replay.before, replay.after, strict=True)
            ],
        ),
        Key("effects", "effects.without"),
        Key("summary", "effects.sentence"),
        Key("friction_law", lambda replay: replay.friction_laws.plain["laws"] if replay.friction_laws else {}),
        Key("against", lambda replay: [a.plain(replay.runs[0].joints) for a in replay.against]),
        Key("drive", lambda replay: replay.response.drive().table()),
    )

    response: Response
    runs: tuple[JointLog, ...]
    responses: tuple[Response, ...]
    predicted: tuple[Array, ...]
    held_out: bool = field(metadata=WRITTEN)
    against: tuple[Arbitration, ...] = ()

    @cached_property
    def before(self) -> Array:
        """Return the rms of reading minus command of each joint, shape (joints,) [rad]."""
        return self._rms([run.command for run in self.runs if run.command is not None])

    @cached_property
    def after(self) -> Array:
        """Return the rms of reading minus prediction of each joint, shape (joints,) [rad]."""
        return self._rms(self.predicted)

    @cached_property
    def effects(self) -> EffectTable:
        """Return the rms errors of replays with one effect removed at a time."""
        return effect_table(self.runs, self.predicted, self.responses, self.before)

    @cached_property
    def friction_laws(self) -> FrictionLaws | None:
        """Return friction laws by the servos' torques, gain times position error, in the runs.

        None where a torque was logged, from which the diagnosis of the logs has them.
        """
        log, arm = joined(self.runs), arm_of(self.response.robot())
        known = log.torque is not None or arm.per_ampere is not None
        logged = known and torque_of(log, arm) is not None
        return None if logged else friction_laws(log, arm, self.response.floor)

    @cached_property
    def moves(self) -> Array:
        """Return the mask of the joints whose commands move them, shape (joints,)."""
        spans = [np.ptp(run.command, axis=0) for run in self.runs if run.command is not None]
        return np.asarray(np.max(spans, axis=0) > MIN_COMMAND_SPAN_RAD)

    def residual(self, run: int, *, before: bool) -> Array:
        """Return reading minus command, or reading minus prediction, shape (rows, joints) [rad].

        run : index of the run; before : whether the command is subtracted
        """
        log = self.runs[run]
        assert log.command is not None
        return np.asarray(log.position - (log.command if before else self.predicted[run]))

    @cached_property
    def friction_samples(self) -> tuple[Array, Array]:
        """Return speed [rad/s] and friction torque [N m] of all samples, shapes (samples, joints).

        Friction is the servo's torque minus gravity, constant torque and inertia.
        """
        parts = [self.response.friction_of(run) for run in self.runs]
        return np.concatenate([v for v, _ in parts]), np.concatenate([torque for _, torque in parts])

    def _rms(self, angles: Sequence[Array]) -> Array:
        """Return the rms over all runs of reading minus given angles, shape (joints,) [rad].

        angles : of each run, shape (rows, joints) [rad]
        """
        residual = np.concatenate([run.position - own for run, own in zip(self.runs, angles, strict=True)])
        return np.asarray(np.sqrt(np.nanmean(residual**2, axis=0)))

    def blocks(self) -> list[Block]:
        """Return the report of the replay as blocks: verdict, tables, unmoved joints, figures."""
        joints = self.runs[0].joints
        before, after = (1e3 * float(np.sqrt((v**2).mean())) for v in (self.before, self.after))
        commands = np.concatenate([run.command for run in self.runs if run.command is not None])
        load = np.abs(self.response.dynamics.torque(commands, *[np.zeros_like(commands)] * 2)).max(axis=0)
        return self._report_blocks(
            before=before,
            after=after,
            seconds=sum(float(run.time[-1] - run.time[0]) for run in self.runs),
            tables=[*self._tables()],
            summary=self.effects.sentence,
            friction=self.friction_laws,
            against=[(Path(a.source).name, a, 1e3 * float(np.sqrt((a.rms**2).mean()))) for a in self.against],
            still=[name for name, moved in zip(joints, self.response.moved, strict=True) if not moved],
            dead_band=self._held(self.response.friction),
            droop=self._held(load),
            worse=[name for name, b, a in zip(joints, self.before, self.after, strict=True) if a > b],
            figures=[*replay_figures(self)],
        )

    def _held(self, torque: Array) -> list[tuple[str, float]]:
        """Return the joints that a torque keeps farthest from their commands, with its angle [mrad].

        They are those with at least half of the largest angle, which is the first, at most three,
        if that exceeds the joint's residual.
        torque : of each joint [N m]
        """
        angle = np.where(self.response.moved, torque / self.response.gain, 0.0)
        far = np.argsort(-angle, kind="stable")[:3] if (angle > self.after)[first_of_best(angle)] else ()
        return [(self.runs[0].joints[j], 1e3 * float(angle[j])) for j in far if angle[j] >= angle.max() / 2]

    def _tables(self) -> Iterator[Table]:
        """Yield the report's tables, those of friction laws and files where they exist.

        The others are of errors without one effect at a time, and of the response.
        """
        joints, r = self.runs[0].joints, self.response
        yield self.effects.table()
        parts = (r.gain, r.friction, r.friction / r.gain * 1e3, r.damping, r.armature, r.delay * 1e3, r.bias)
        drives = [(name, *(f"{v:.3g}" for v in own)) for name, own in zip(joints, np.column_stack(parts), strict=True)]
        if self.against:
            yield from arbitration_tables(joints, self.after, self.against)
        if self.friction_laws:
            yield self.friction_laws.tables()[-1]
        title = (
            "Response of each joint, torques by the masses of the robot file: gain kp [N m/rad], dry friction F [N m], "
            "F / kp [mrad], damping b [N m s/rad], rotor inertia [kg m^2], delay [ms], constant torque [N m]"
        )
        columns = ("joint", "kp", "F", "F / kp", "b", "rotor", "delay", "const")
        yield Table(title, columns, drives, frozenset(range(1, 8)))

    def files(self, folder: str | Path) -> Mapping[Path, str | bytes]:
        """Return the text of each file by path: plain data, report, and robot with its drives."""
        comment = "[drive]: response of the joints to their commands, by casadical diagnose"
        made = to_toml(self.response.robot(), comment)
        return {**super().files(folder), Path(folder) / "diagnosed.robot.toml": made}


def replayed(
    robot: Robot,
    logs: Sequence[JointLog],
    withheld: Sequence[JointLog] = (),
    show: Show = silent,
    against: Sequence[Path] = (),
) -> Replay:
    """Return runs replayed by the response of each joint that is identified from other runs.

    logs : logs from which the response is identified
    withheld : logs that are replayed only; if there are none, the runs are held out in turn, and a
        single run is replayed by its own fit
    against : files of published parameters that are replayed, too (see `arbitrated`)
    Raises InputError: logs without commands or without a run of two seconds.
    """
    show("response of each joint")
    own, withheld_runs = ([run for log in each for run in log.runs()] for each in (logs, withheld))
    if withheld_runs or len(own) == 1:
        (response,), runs = fitted(robot, own), withheld_runs or own
        predicted = tuple(response.predicted(run) for run in runs)
        sets = tuple(arbitrated(robot, against, own, runs, response)) if against else ()
        return Replay(response, tuple(runs), (response,) * len(runs), predicted, bool(withheld_runs), sets)
    # Largest number of folds of the runs if no log is withheld.
    folds = min(4, len(own))
    parts = [own, *([run for i, run in enumerate(own) if i % folds != k] for k in range(folds))]
    response, *others = fitted(robot, *parts)
    show("replay")
    responses = tuple(others[i % folds] for i in range(len(own)))
    predicted = tuple(r.predicted(run) for r, run in zip(responses, own, strict=True))
    sets = tuple(arbitrated(robot, against, own, own, response)) if against else ()
    return Replay(response, tuple(own), responses, predicted, True, sets)


def replay_figures(replay: Replay) -> Iterator[Figure]:
    """Yield the figures: errors and hysteresis of the worst run, and friction.

    The worst run is that with the largest mean square of reading minus command.
    """
    run = best_of(range(len(replay.runs)), lambda k: float(np.nanmean(replay.residual(k, before=True) ** 2)))
    log, command, source = replay.runs[run], replay.runs[run].command, replay.runs[run].source
    assert command is not None
    there = replay.moves & (np.ptp(command, axis=0) > MIN_COMMAND_SPAN_RAD)
    before, after = (1e3 * replay.residual(run, before=b) for b in (True, False))
    errors = {"before: less command": before, "after: less prediction": after}
    loops = {"reading": before, "prediction": 1e3 * (replay.predicted[run] - command)}
    yield _panels(
        replay,
        there,
        "replay/errors",
        f"{source}: reading less command, and less prediction",
        "time [s]",
        "mrad",
        lambda j, panel: _lines(log.time - log.time[0], errors, j, panel),
    )
    yield _panels(
        replay,
        replay.moves,
        "replay/friction",
        "Friction: what the servo gives beyond load and inertia, over speed",
        "speed [rad/s]",
        "N m",
        lambda j, panel: _friction(replay, j, panel),
    )
    yield _panels(
        replay,
        there,
        "replay/hysteresis",
        f"{source}: hysteresis, reading less command over the command",
        "command [rad]",
        "mrad",
        lambda j, panel: _lines(command[:, j], loops, j, panel),
    )


def _panels(
    replay: Replay, moved: Array, name: str, title: str, x: str, y: str, drawn: Callable[[int, int], list[Series]]
) -> Figure:
    """Return a figure with a panel for each joint that moved, two in a row.

    moved : mask of these joints; x, y : titles of the axes
    drawn : function of joint (0-based) and panel that returns its lines
    """
    joints = np.flatnonzero(moved).tolist()
    series = [s for panel, j in enumerate(joints) for s in drawn(j, panel)]
    panels = [
        Panel(k // 2 + 1, k % 2 + 1, replay.runs[0].joints[j], Axis(x if k >= len(joints) - 2 else ""), Axis(y))
        for k, j in enumerate(joints)
    ]
    # Height of each row of panels of a figure [px].
    return Figure(name, title, series, height=180 + 200 * ((len(joints) + 1) // 2), panels=panels)


def _lines(x: Array, lines: Mapping[str, Array], joint: int, panel: int) -> list[Series]:
    """Return two thinned lines of a panel, the first in grey, the second in blue.

    x : shape (n,); lines : values by name of the line, shape (n, joints); joint : 0-based
    """
    some = slice(None, None, max(1, len(x) // 700))  # 700 to 1400 points a line are enough to see
    styles: tuple[dict[str, Any], ...] = ({"colour": "grey", "width": 1}, {"colour": "blue", "width": 1.4})
    return [
        Series("line", x[some].round(4), y[some, joint].round(4), name=name, listed=not panel, panel=panel, **style)
        for (name, y), style in zip(lines.items(), styles, strict=True)
    ]


def _friction(replay: Replay, j: int, panel: int) -> list[Series]:
    """Return the 10 to 90 % band of friction [N m] over speed, and the identified friction curve.

    j : joint, 0-based; panel : index of the panel
    """
    v, torque = replay.friction_samples
    v, torque = v[:, j], torque[:, j]
    largest = float(np.quantile(np.abs(v), 0.99)) + 1e-6
    # A friction figure has 24 speed bins.
    edges = np.linspace(-largest, largest, 25)
    parts = [torque[(v >= a) & (v < b)] for a, b in pairwise(edges)]
    # Speed bins of a friction figure with fewer samples are not drawn.
    filled = [k for k, part in enumerate(parts) if len(part) >= 15]
    middle = (edges[1:] + edges[:-1])[filled] / 2
    low, high = (np.array([np.quantile(parts[k], share) for k in filled]) for share in (0.1, 0.9))
    r = replay.response
    ends = np.array([-largest, -1e-9, 1e-9, largest])
    law = r.friction[j] * np.sign(ends) + r.damping[j] * ends
    place: dict[str, Any] = {"panel": panel, "listed": not panel}
    return [
        banded(middle.round(4), low.round(4), high.round(4), name="samples, 10 to 90 %", colour="grid", **place),
        Series("line", ends.round(4), law.round(4), name="found", colour="blue", **place),
    ]
