"""The motion to log next: of some simple ones, the one that would tell most of what a log leaves open.

A planned motion goes through the same linear problem as a log: rows of its commands as if they were followed, noise as
it was found in the log, columns of base and causes. Expected log evidence of a cause of size theta is half the square
of what it does beside the base, in units of the noise; between two causes, of what the other cannot do either.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError, Show, silent
from casadical.core.statistics import first_of_best
from casadical.core.telling.blocks import Block, Table, Words
from casadical.core.telling.result import Result
from casadical.diagnosis.motion.base import Look, look
from casadical.diagnosis.motion.problem import Following, MotionCase, coefficients, motion_case
from casadical.diagnosis.motion.result import LogDiagnosis
from casadical.diagnosis.motion.search import NAMED
from casadical.diagnosis.motion.signals import motion_of
from casadical.effects import Effect
from casadical.effects.definition import DefinedEffect
from casadical.measurements.logs.log import JointLog

# A motion lasts so long [s], and its commands come so many times a second.
SECONDS, RATE = 30.0, 125.0
# Of what the log went through: shares of its range and of its greatest speed; pauses where a joint turns round [s]; a
# known load, as a share of the arm's mass, and how far from the last joint [m].
RANGES, SPEEDS, PAUSES, LOAD, AWAY = (0.15, 0.5, 1.0), (0.1, 0.4, 1.0), (0.0, 0.5), 0.05, 0.1
# Causes that are in question, at most; one that the log shows less than so is planned for at its usual size [nats].
QUESTIONS, SEEN = 4, 10.0
# A load is worth its mounting where it tells so many times as much.
WORTH = 1.1
# Joints that move together never turn round together for long: each takes longer by this share.
LONGER = 0.13
# Of each cause, log evidence against none, and against the other one in question that is most like it [nats].
Expected = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Course:
    """A motion: joints (0-based) that go to and fro through a share of their range, at a share of their speed.

    pause : where they turn round [s]; load : at the flange, known [kg]
    """

    joints: tuple[int, ...]
    range: float
    speed: float
    pause: float
    load: float

    def commands(self, log: JointLog) -> Array:
        """Within what the log went through, the other joints in the middle of it, shape (samples, joints) [rad]."""
        q = np.nan_to_num(log.position)
        low, high = np.quantile(q, [0.02, 0.98], axis=0)
        step = np.maximum(log.step, 1e-4)
        fast = np.quantile(np.abs(np.gradient(q, axis=0)) / step, 0.98, axis=0) + 1e-3
        t = np.arange(0, SECONDS, 1 / RATE)
        out = np.tile((low + high) / 2, (len(t), 1))
        for i, j in enumerate(self.joints):
            wide = self.range * (high[j] - low[j])
            takes = (1 + LONGER * i) * max(1.875 * wide / (self.speed * fast[j]), 0.4)  # a quintic's greatest speed
            turn, part = np.divmod(t, takes + self.pause)
            s = np.minimum(part / takes, 1.0)
            s = s**3 * (10 - 15 * s + 6 * s**2)
            out[:, j] += wide * (np.where(turn % 2 == 0, s, 1 - s) - 0.5)
        return out


@dataclass(frozen=True, eq=False)
class Proposal(Result):
    """A motion that is worth logging, and what it is expected to tell.

    asked : causes in question, by label, and how large they are taken: as they seem in the log, or as usual
    course, command : the best, and its commands, shape (samples, joints) [rad]
    expected : of each cause, log evidence against no cause and against the one in question that is most like it
    same : the same figures of as many seconds more of the motion that was logged
    """

    kept_as: ClassVar[str] = "proposal"

    log: JointLog
    asked: Mapping[str, str]
    course: Course
    command: Array
    expected: Expected
    same: Expected

    def blocks(self) -> Sequence[Block]:
        """As `casadical plan ARM --motion LOG` prints it."""
        c, names = self.course, self.log.joints
        spans, fast = np.ptp(self.command, axis=0), np.abs(np.gradient(self.command, axis=0)).max(axis=0) * RATE
        moved = [f"{names[j]} through {spans[j]:.2g} rad at up to {fast[j]:.2g} rad/s" for j in c.joints]
        turned = [int((np.diff(np.sign(np.diff(self.command[:, j])[np.diff(self.command[:, j]) != 0])) != 0).sum())
                  for j in c.joints]  # fmt: skip
        said = f"Log next, {SECONDS:.0f} s: {'; '.join(moved)}; {', '.join(map(str, turned))} reversals"
        said += f", pauses of {c.pause:.1f} s there" if c.pause else ", without pauses"
        said += f"; {c.load:.2g} kg at the flange, declared ([payload])" if c.load else ""
        rows = [
            (label, size, *(f"{v:.0f}" for v in (*self.expected[label], *self.same[label])))
            for label, size in self.asked.items()
        ]
        heads = ("cause", "size", "evidence", "against the likest", "as logged", "against the likest")
        same = f"{SECONDS:.0f} s more of the same"
        title = f"Log evidence to expect [nats; {NAMED:.0f} are wanted]: by this motion, and by {same}"
        return [Words(said + ".", "verdict"), Table(title, heads, rows, frozenset({2, 3, 4, 5}))]

    def to_json(self) -> dict[str, Any]:
        c = self.course
        return {
            "motion": {
                "joints": [j + 1 for j in c.joints], "range_share": c.range, "speed_share": c.speed,
                "pause_s": c.pause, "payload_kg": c.load, "seconds": SECONDS,
            },
            "expected": {k: {"nats": v[0], "against_likest": v[1]} for k, v in self.expected.items()},
            "as_logged": {k: {"nats": v[0], "against_likest": v[1]} for k, v in self.same.items()},
        }  # fmt: skip

    def files(self, folder: str | Path) -> Mapping[Path, str]:
        """The commands, as a table; folder : that table's path."""
        table = {"time_s": (np.arange(len(self.command)) / RATE).round(4)}
        table |= {f"command{j + 1}_rad": column.round(6) for j, column in enumerate(self.command.T)}
        return {Path(folder): pd.DataFrame(table).to_csv(index=False)}


def proposed(found: LogDiagnosis, looks: Sequence[Look], names: Sequence[str] = (), show: Show = silent) -> Proposal:
    """The motion that tells most of the causes that a diagnosed log leaves open, or of some that are named.

    looks : of the diagnosed log and its reference, as of `looks_of`; names : causes, such as lag or lag@4
    Raises InputError: a name that is no cause, or none that such a log could show.
    """
    case, seconds = found.outcome.case, sum(float(np.ptp(run.time)) for run in found.log.runs())
    sizes = {label: _size(found, label) for label in _in_question(found, names)}
    known = coefficients(motion_case(looks[1:])) if len(looks) > 1 else None
    made = [effect for label in sizes for (effect,) in case.by_label[label].variants]
    kinds = list(dict.fromkeys(type(effect) for effect in made if isinstance(effect, DefinedEffect)))

    def tried(course: Course) -> tuple[float, Course, Array, Expected]:
        show(f"range {course.range:.0%}, speed {course.speed:.0%}, pause {course.pause} s, load {course.load:.2g} kg")
        command = course.commands(found.log)
        own = motion_case([_planned(found.log, looks[0], course, command), *looks[1:]], known, kinds)
        expected = _expected(replace(own, noise=_noise_as(case, own)), sizes)
        # What is certain is not worth more than what is enough.
        score = sum(min(against, NAMED) + 0.01 * min(alone, NAMED) for alone, against in expected.values())
        return score, course, command, expected

    joints = sorted({int(label.partition("@")[2] or 0) - 1 for label in sizes})
    joints = list(range(looks[0].arm.joints)) if joints[0] < 0 else joints
    plain = [Course(tuple(joints), *each, 0.0) for each in product(RANGES, SPEEDS, PAUSES)]
    each = [tried(course) for course in plain]
    best = each[first_of_best([score for score, *_ in each])]  # the same motion on every processor
    if looks[0].motion.torque is not None:
        load = float(f"{LOAD * looks[0].arm.inertial[::10].sum():.1g}")
        loaded = tried(replace(best[1], load=load))
        best = loaded if loaded[0] > WORTH * best[0] else best
    words = {label: "as it seems" if size.seen else "usual" for label, size in sizes.items()}
    same = {k: (v[0] * SECONDS / seconds, v[1] * SECONDS / seconds) for k, v in _expected(case, sizes).items()}
    return Proposal(found.log, words, *best[1:], same)


@dataclass(frozen=True, eq=False)
class _Size:
    """How large a cause is taken. effect : of its variant; theta : in sizes; seen : whether it is so in the log"""

    effect: Effect
    theta: Array
    seen: bool


def _in_question(found: LogDiagnosis, names: Sequence[str]) -> list[str]:
    """Labels of causes that are named by the user, that a log does not distinguish, or that fit it best."""
    case, ranking = found.outcome.case, found.outcome.rankings[0]
    listed = [k for k in ranking.order if case.by_label[k].listed]
    for name in names:
        if not any(name in (k, case.by_label[k].name) for k in listed):
            kinds = sorted({case.by_label[k].name for k in listed})
            raise InputError(f"{name!r}: no cause that such a log could show; there are {', '.join(kinds)}")
    if names:
        return [k for k in listed if {k, case.by_label[k].name} & set(names)]
    alike = [k for k, _ in found.outcome.alike]
    return (alike or [k for k in listed if ranking.log_factor[k] > SEEN] or listed[:2])[:QUESTIONS]


def _size(found: LogDiagnosis, label: str) -> _Size:
    case, ranking = found.outcome.case, found.outcome.rankings[0]
    own, seen = case.group(label, ranking.variant[label]), ranking.log_factor[label] > SEEN
    theta = case.fitted(own)[1] if seen else np.full(len(own), len(own) ** -0.5)
    return _Size(case.by_label[label].variants[ranking.variant[label]][0], theta, seen)


def _planned(log: JointLog, here: Look, course: Course, command: Array) -> Look:
    """A motion as if it were followed, through the model of the arm with the known load."""
    arm, t = here.arm, np.arange(len(command)) / RATE
    if course.load:
        m, d = course.load, AWAY
        inertial = arm.inertial.copy()
        inertial[-10:] += m * np.array([1.0, 0.0, 0.0, d, d**2, 0.0, 0.0, d**2, 0.0, 0.0])
        arm = replace(arm, inertial=inertial)
    v = np.gradient(command, t, axis=0)
    a = np.gradient(v, t, axis=0)
    known = command if here.motion.command is not None else None
    torque = None
    if here.motion.torque is not None:
        torque = arm.regressor(command, v, a) @ arm.inertial + arm.rotor * a
    planned = JointLog(t, log.joints, command, command=known, torque=torque, run=np.ones(len(t)), source="planned")
    return look(motion_of(planned, arm, tuple(here.motion.memory), of_command=torque is None), arm, here.great)


def _noise_as(case: MotionCase, own: MotionCase) -> Following:
    """The noise of a log that was diagnosed, for a motion that is planned."""
    of_log, behind = np.flatnonzero(case.of_log)[0], np.flatnonzero(~case.of_log)
    other = behind[0] if len(behind) else of_log
    sigma, stays = (np.where(own.of_log[:, None], v[of_log], v[other]) for v in (case.noise.sigma, case.noise.stays))
    return Following(sigma, stays, own.trust)


def _expected(case: MotionCase, sizes: Mapping[str, _Size]) -> Expected:
    """Of each cause, log evidence against none, and against the other one that does most of what it does [nats]."""
    projection, does = case.white.projection(0.0), dict[str, tuple[Array, Array]]()
    for label, size in sizes.items():
        variants = case.by_label[label].variants if label in case.by_label else ()
        at = next((k for k, effects in enumerate(variants) if effects[0] == size.effect), None)
        if at is not None:
            visible = projection.columns(case.white.take(own := case.group(label, at)))
            theta = size.theta if len(size.theta) == len(own) else np.full(len(own), len(own) ** -0.5)
            does[label] = visible, visible @ theta
    out = {}
    for label in sizes:
        if label not in does:
            out[label] = 0.0, 0.0
            continue
        own = does[label][1]
        alone = float(own @ own) / 2
        others = [R for k, (R, _) in does.items() if k != label]
        taken = [float((b := R.T @ own) @ np.linalg.solve(np.eye(R.shape[1]) + R.T @ R, b)) / 2 for R in others]
        out[label] = alone, alone - max(taken, default=0.0)
    return out
