"""Daily touches: choice of informative poses, and the verdict on a calibrated robot from them.

Five touched points a day decide whether the calibration is still valid, what changed, and whether a
correction helps.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pandas as pd
from scipy.special import chdtri

from casadical.core.basics import Array, InputError
from casadical.core.files import csv_text
from casadical.core.reading import load_json
from casadical.core.reporting.blocks import Block, Page, Section, Table, Tile, Words, mm, next_step
from casadical.core.reporting.figure import Axis, Figure, Rule, Series
from casadical.core.reporting.plain import IN_MM, WRITTEN, Key
from casadical.core.reporting.result import Result
from casadical.core.statistics import best_of, first_of_best
from casadical.fleet.campaigns import day_of, without_copies
from casadical.fleet.estimates import date_text
from casadical.fleet.touch_model import CHANGE_FREQUENCY, CRASH, GROWTH_PER_K, MM_PER_M, UNKNOWN, Draws, TouchModel
from casadical.identification.pose_selection.planning import poses_of_changes
from casadical.identification.prior import Prior
from casadical.measurements.measurements import Measurements, Noise
from casadical.project.acceptance.verification import without_instrument
from casadical.project.problem import read_campaign
from casadical.project.problem_file import result_in
from casadical.robot.robot import RemainingErrors, Robot
from casadical.robot.robot_file import read_robot, to_toml

# Smallest probability of an error within the tolerance at which the calibration is reported as
# valid.
MIN_PROBABILITY_VALID = 0.99
# Columns of the control chart, of which `Touches.rows` returns one row per day.
_CHART_COLUMNS = ("day", "table", "touches", "rms_mm", "T2", "limit", "temperature_degC", "within")
# Verdict on the calibration: still valid, not decided by these touches, or no longer valid.
Verdict = Literal["valid", "open", "changed"]


@dataclass(frozen=True, eq=False)
class Touches(Result):
    """Verdict of touches of one or several days on a calibrated robot.

    given : robot as its file describes it
    model : model of the robot and of all days, the last of which is judged
    draws : posterior samples of changes and remaining errors
    tolerance : largest rms error over the task's poses of a valid calibration [m]
    more : poses of additional touches, a row each; None where the touches decide
    notes : sentences on what was assumed of the tables
    sources : robot file, then the table of each day
    update : file to which the corrected robot is to be written, if it is better; None: none
    """

    report: ClassVar[str] = "touches.j2"
    derived: ClassVar[tuple[Key, ...]] = (
        Key("touches", lambda found: len(found.model.days[-1])),
        Key("robot", "given.name"),
        Key("verdict"),
        Key("probability"),
        Key("error", lambda found: np.quantile(found.errors, [0.025, 0.975]), "mm"),
        Key("stated_mm", "model.stated"),
        Key("changes", "outcomes"),
        Key(
            "moved",
            lambda found: [dict(zip(("name", "value", "std_error", "unit"), row, strict=True)) for row in found.moved],
        ),
        Key("correction"),
        Key(
            "more_deg_or_mm",
            lambda found: [list(map(float, row)) for table in found.more_touches for row in table.rows],
        ),
        Key("chart", lambda found: [dict(zip(_CHART_COLUMNS, row, strict=True)) for row in found.rows()]),
        Key("next", "commands"),
    )

    given: Robot
    model: TouchModel
    draws: Draws
    tolerance: float = field(metadata=IN_MM)
    more: pd.DataFrame | None = None
    notes: tuple[str, ...] = field(default=(), metadata=WRITTEN)
    sources: tuple[Path, ...] = ()
    update: Path | None = None

    @cached_property
    def errors(self) -> Array:
        """Return posterior samples of today's rms error over the task's poses, shape (draws,) [m].

        It includes the unexplained error of the file, as a measurement would show it.
        """
        whole = self.model.size_of(self.draws.d + self.draws.x, self.draws.extra)
        return np.asarray(np.hypot(self.model.rest, whole) / MM_PER_M)

    @cached_property
    def change(self) -> Array:
        """Return posterior samples of the rms change since the calibration, shape (draws,) [m].

        It is the displacement over the task's poses.
        """
        return self.model.size_of(self.draws.d, self.draws.extra) / MM_PER_M

    @property
    def probability(self) -> float:
        """Return the posterior probability that today's rms error is within the tolerance."""
        return float(np.mean(self.errors <= self.tolerance))

    @property
    def verdict(self) -> Verdict:
        """Return "valid" from a `probability` of 0.99 on, "changed" up to 0.1, else "open"."""
        if self.probability >= MIN_PROBABILITY_VALID:
            return "valid"
        # The calibration is reported as no longer valid where an error above the tolerance is this
        # probable.
        return "changed" if 1 - self.probability >= 0.9 else "open"

    @property
    def label(self) -> str:
        """Return the label of the most probable change, such as joint_zero@3; "" for no change."""
        labels, counts = np.unique(self.draws.label.astype(str), return_counts=True)
        return str(labels[first_of_best(counts)])

    @cached_property
    def departure(self) -> tuple[Array, Array]:
        """Return the posterior mean, (p,), and covariance, (p, p), of the parameters' changes.

        They are in units of scale; samples with an unknown change are excluded.
        """
        draws = self.draws.d[self.draws.label != UNKNOWN]
        return draws.mean(axis=0), np.atleast_2d(np.cov(draws.T))

    @cached_property
    def gain(self) -> tuple[float, float, float]:
        """Return (before, after, probability): the effect of a correction by the mean deviation.

        The first two are the rms change since the calibration without and with the correction [m];
        the third is the probability that the correction makes the change smaller.
        """
        d = self.departure[0]
        before, after = self.change, self.model.size_of(self.draws.d - d, self.draws.extra) / MM_PER_M
        return float(np.sqrt(np.mean(before**2))), float(np.sqrt(np.mean(after**2))), float(np.mean(after < before))

    @property
    def better(self) -> bool:
        """Return whether the correction is accepted: probably better, see `gain`, and by enough."""
        before, after, sure = self.gain
        # It must make the change smaller with a probability of 0.95, and the rms change smaller by
        # more than 20 % of the rms error that the robot file states.
        return sure >= 0.95 and before - after > 0.2 * self.model.stated / MM_PER_M

    @cached_property
    def moved(self) -> list[tuple[str, float, float, str]]:
        """Return (name, amount, std error, unit) of each parameter of the most probable change.

        The most significant one is first; for the change "lengths" one row holds the common growth
        [um/m]. It is empty for no change or an unknown one.
        """
        if self.label in ("", UNKNOWN):
            return []
        own = self.draws.d[self.draws.label == self.label]
        rows = []
        for k, name in enumerate(self.model.names):
            if np.any(own[:, k]):
                p = self.model.robot.parameters[name]
                mean, std = (p.readable(float(v) * p.scale) for v in (own[:, k].mean(), own[:, k].std()))
                rows.append((name, mean, std, p.readable_unit))
        if self.label == "lengths":  # all grow by the same share
            p = best_of((self.model.robot.parameters[r[0]] for r in rows), lambda p: abs(p.value))
            share = own[:, self.model.names.index(p.name)] * p.scale / p.value
            return [("all lengths", 1e6 * float(share.mean()), 1e6 * float(share.std()), "um/m")]
        return sorted(rows, key=lambda r: -abs(r[1]) / max(r[2], 1e-12))

    def corrected(self) -> Robot:
        """Return the robot corrected by the posterior mean deviation.

        It has a note on this; covariance and remaining errors are widened by the posterior's.
        """
        d, C = self.departure
        scale = np.array([self.model.robot.parameters[n].scale for n in self.model.names])
        values = {
            n: self.given.parameters[n].value + v
            for n, v in zip(self.model.names, d * scale, strict=True)
            if v and n in self.given.parameters.names
        }
        note = f"Corrected by touches of {self.model.days[-1].source}: {self.change_in_words}"
        knowledge, names = self.given.knowledge, self.model.names
        if knowledge is not None:
            wide = [b.matrix.copy() for b in knowledge.covariance]
            for block, matrix in zip(knowledge.covariance, wide, strict=True):
                here = [k for k, n in enumerate(block.names) if n in names]
                at = [names.index(block.names[k]) for k in here]
                matrix[np.ix_(here, here)] += (C * np.outer(scale, scale))[np.ix_(at, at)]
            blocks = zip(knowledge.covariance, wide, strict=True)
            knowledge = replace(knowledge, covariance=tuple(replace(b, matrix=m) for b, m in blocks))
        return replace(
            self.given.with_values(values),
            notes=(*self.given.notes, note),
            knowledge=knowledge,
            remaining=_widened_remaining(self.given.remaining, names, C, scale),
        )

    @property
    def why_not_updated(self) -> str:
        """Return a sentence why the robot is not corrected, with the change before and after."""
        before, after, sure = self.gain
        remaining = f"of a change of {mm(before)} mm {mm(after)} mm would remain, less with a probability of {sure:.2f}"
        return f"{remaining}; leaving it is as good"

    def updated_text(self) -> str:
        """Return the text of the corrected robot's TOML file.

        Raises InputError: the correction is not better, see `better`.
        """
        if not self.better:
            raise InputError(f"no corrected robot is written: {self.why_not_updated}")
        return to_toml(self.corrected(), f"Corrected by casadical from {len(self.model.days[-1])} touches.")

    @property
    def change_in_words(self) -> str:
        """Return the most probable change, its probability and the table that first shows it, in words."""
        label = self.label
        sure = f"probability {self.draws.probability(label):.2f}"
        if not label:
            return f"nothing changed that these touches show ({sure})"
        # Words for labels of changes in reports; other labels are written with spaces.
        change_words = {
            CRASH: "zeros and tool together, as after a crash",
            UNKNOWN: "nothing that usually changes explains it",
            "lengths": "all lengths, as by warmth",
            "joint_zero": "zero",
        }
        words = change_words.get(label, label.replace("@", " of joint ").replace("_", " "))
        since = int(np.median(self.draws.since[self.draws.label == label]))
        return f"{words} ({sure}, since {self.model.days[since - 1].source})"

    def blocks(self) -> list[Block]:
        """Return the report as blocks of text and tables."""
        return self._report_blocks(quantiles=np.quantile(self.errors, [0.025, 0.975, MIN_PROBABILITY_VALID]))

    @property
    def what_moved(self) -> list[Table]:
        """Return a list of one table with the eight most significant parameters of `moved`, or of none."""
        rows = [(n, f"{v:+.4g}", f"{s:.2g}", unit) for n, v, s, unit in self.moved[:8]]
        return [Table("What moved", ("parameter", "by", "std error", "unit"), rows, frozenset({1, 2}))] if rows else []

    @property
    def more_touches(self) -> list[Table]:
        """Return a list of one table with the readings of additional touches, or of none."""
        if self.more is None:
            return []
        keys = list(self.given.reading_units)
        rows = [tuple(f"{v:.3f}" for v in row) for row in self.more[keys].to_numpy(dtype=float)]
        title = f"These are not enough to decide; touch {len(rows)} more and add them to the table"
        return [Table(title, tuple(keys), rows, frozenset(range(len(keys))))]

    @property
    def next(self) -> tuple[Words, ...]:
        """Return the suggested next command in a tuple of one; empty if there is none."""
        if (self.verdict == "valid" and not self.better) or not self.sources:
            return ()
        robot, *tables = self.sources
        asked = ("--touches",)
        if self.better and self.update:
            return (next_step("on later days", "verify", self.update, "DAY.csv", *asked),)
        if self.better:
            written = ("--update", "corrected.robot.toml")
            return (next_step("to correct it", "verify", robot, *tables, *asked, *written),)
        if self.verdict == "open":
            return ()
        return (next_step("when ten poses are measured anywhere", "compare", robot, "TEN.csv"),)

    @property
    def outcomes(self) -> dict[str, float]:
        """Return the posterior probability of each change, by label, and of none, "nothing".

        They are fractions of the posterior samples and add up to one; changes without a sample are
        missing.
        """
        labels, counts = np.unique(self.draws.label.astype(str), return_counts=True)
        return {str(n) or "nothing": float(c / counts.sum()) for n, c in zip(labels, counts, strict=True)}

    @property
    def correction(self) -> dict[str, float | bool]:
        """Return the effect of a correction for the JSON file, as of `gain` in mm.

        The keys are before_mm, after_mm, better (probability of a smaller change) and written
        (whether the correction is accepted).
        """
        before, after, sure = self.gain
        return {"before_mm": MM_PER_M * before, "after_mm": MM_PER_M * after, "better": sure, "written": self.better}

    def rows(self) -> list[tuple[str, str, int, float, float, float, float | str, str]]:
        """Return the rows of the control chart, one per day: see `_CHART_COLUMNS`."""
        T2, lines = self.model.control_chart(), []
        for k, m in enumerate(self.model.days):
            own = self.model.residual_mm[(self.model.day == k + 1)[::3]]
            limit = float(chdtri(3 * len(m), 1 / 370))  # exceeded once in 370 days without a change
            T = float(self.model.temperatures[k])
            rms = float(np.sqrt((own**2).sum(axis=1).mean()))
            day = date_text(self.model.dates[k] if self.model.dates else None)
            within = "yes" if T2[k] <= limit else "no"
            lines.append((day, m.source, len(m), rms, float(T2[k]), limit, T if np.isfinite(T) else "", within))
        return lines

    def chart_csv(self) -> str:
        """Return the control chart as CSV text."""
        return csv_text(
            [_CHART_COLUMNS, *([f"{v:.5g}" if isinstance(v, float) else v for v in row] for row in self.rows())]
        )

    def page(self) -> Page:
        """Return the page of `verify --touches --report`: verdict, and T2 / limit by day."""
        rows = self.rows()
        x = list(range(1, len(rows) + 1))
        colour = ["blue" if row[-1] == "yes" else "red" for row in rows]
        tip = "%{customdata}<br>T2 / limit %{y:.2f}"
        points = Series(
            "points",
            x,
            [r[4] / r[5] for r in rows],
            colour=colour,
            size=9,
            facts=[f"{r[0]} {r[1]}" for r in rows],
            tip=tip,
        )
        course = Series("line", x, [r[4] / r[5] for r in rows], colour="grey", width=1)
        centre = float(np.mean([3 * r[2] / r[5] for r in rows]))
        marks = [Rule("y", 1.0, "red", "solid", 1.5), Rule("y", centre, "green", "dot", 1.5)]
        caption = (
            "What each day's touches depart from what the robot file and the days before say, T2 "
            "over its limit, which is passed once in 370 days while nothing changes: the red line. "
            "Dotted: what is usual."
        )
        many = len(rows) > 12
        axis = Axis("day", whole=True) if many else Axis("day", ticks=x, labels=[r[0] or r[1] for r in rows])
        chart = Figure(
            "chart",
            "Touches day by day",
            [course, points],
            axis,
            Axis("T2 / limit", begins=True),
            340,
            caption,
            marks=marks,
        )
        table = Table(
            "Every day",
            [c.replace("_", " ") for c in _CHART_COLUMNS],
            [[f"{v:.4g}" if isinstance(v, float) else str(v) for v in r] for r in rows],
            frozenset({2, 3, 4, 5, 6}),
            folded=many,
        )
        tiles = (
            Tile("Valid", f"{100 * self.probability:.1f}", "%", f"within {mm(self.tolerance)} mm"),
            Tile("Change", mm(float(np.sqrt(np.mean(self.change**2)))), "mm", "rms over the task, expected"),
        )
        sections = (Section("Today", self.blocks()), Section("Control chart", [chart, table]))
        return Page("Touches", self.given.name, f"{len(rows)} days", sections, tiles, (), self.sources)


def _widened_remaining(
    remaining: RemainingErrors | None, names: Sequence[str], C: Array, scale: Array
) -> RemainingErrors | None:
    """Return the remaining errors with the covariance of a correction added to their second moment.

    C : covariance of the correction, shape (p, p), in units of scale
    scale : unit of each corrected parameter, shape (p,) [SI]
    """
    if remaining is None:
        return None
    values, V = np.linalg.eigh(C)
    relevant = values > 1e-9 * max(values.max(), 1e-300)
    own = V[:, relevant] * np.sqrt(values[relevant])
    wide = np.zeros((len(remaining.names), own.shape[1]))
    for n, row in zip(names, scale[:, None] * own, strict=True):
        if n in remaining.names:
            wide[remaining.names.index(n)] = row
    return replace(remaining, factor=np.hstack([remaining.factor, wide]))


def changes_in_fleet(path: Path) -> Mapping[str, float]:
    """Return the relative frequency of each kind of change, learnt from a fleet.

    It is `CHANGE_FREQUENCY` plus the number of times that the fleet's changes name the kind.

    path : JSON file that `casadical fleet --json` wrote
    Raises InputError: the file holds no robots.
    """
    robots = load_json(path).get("robots")
    if not isinstance(robots, list):
        raise InputError(f"{path}: holds no robots; give what `casadical fleet PLANT --json FILE` wrote")
    changes = [text for row in robots if isinstance(row, dict) for text in str(row.get("changes", "")).split("; ")]
    # Labels of the causes, such as tool or joint_zero@2, precede the first comma.
    causes = [label.split("@")[0] for text in changes for label in text.split(", ")[0].split(" or ")]
    return {kind: often + causes.count(kind) for kind, often in CHANGE_FREQUENCY.items()}


def plan_touches(
    robot: str | Path,
    n: int = 5,
    *,
    noise_mm: float | None = None,
    room: Path | None = None,
    touched: Measurements | None = None,
    seed: int = 0,
) -> pd.DataFrame:
    """Return the poses that determine usual changes (joint zeros, tool, base) best.

    robot : file as `calibrate --out` writes it, or its folder
    noise_mm : standard deviation of a coordinate [mm], to which the unexplained error of the file's
        [remaining] is added; None: that error alone, or 0.1 mm without one
    room : workspace file; None: the robot's joint limits
    touched : touches of today, to which these are added
    seed : random seed of the search
    Returns a table with one row per touch: readings of the joints and predicted position
    Raises InputError: a file cannot be used, or the workspace allows too few poses.
    """
    arm, _ = without_instrument(read_robot(result_in(Path(robot))))
    rest = MM_PER_M * arm.remaining.rest / np.sqrt(3) if arm.remaining else 0.0
    noise = Noise(1e-3 * float(np.hypot((0.0 if rest else 0.1) if noise_mm is None else noise_mm, rest)))
    model = TouchModel(arm, (), tuple(p.name for p in arm.parameters if p.prior > 0), np.zeros((0, 0)), 0.0)
    sizes = {
        name: float(s) * arm.parameters[name].scale
        for c in model.usual_candidates
        if c.kind != "lengths"
        for name, s in zip(c.names, c.sizes, strict=True)
    }
    usual = Prior(tuple(sizes), {name: (arm.parameters[name].value, s) for name, s in sizes.items()})
    return poses_of_changes(arm, n, usual, noise, room, touched, seed)


def judge_touches(
    robot: str | Path,
    tables: Sequence[str | Path],
    *,
    tolerance_mm: float | None = None,
    noise_mm: float | None = None,
    fleet: str | Path | None = None,
    seed: int = 0,
) -> Touches:
    """Return the verdict whether a robot's calibration is still valid, from touches of some days.

    The points are positions in the measuring frame of the calibration.

    tables : touched points, a file per day; the last one is judged (by date, if all have one), the
        others are its history; of more than 30 the last 30 are used
    tolerance_mm : largest rms error over the joint ranges on which the robot was learnt [mm]; None:
        twice what the file states
    noise_mm : standard deviation of a touched coordinate [mm]; None: unknown
    fleet : JSON file of `casadical fleet --json`, from which frequencies of changes are learnt;
        None: those of `CHANGE_FREQUENCY`
    seed : random seed of the posterior samples
    Returns the verdict; where the touches do not decide, with the poses of two more
    Raises InputError: no positions or fewer than two on a day, another frame or robot, a file that
        states no errors.
    """
    place = result_in(Path(robot))
    arm, _ = without_instrument(read_robot(place))
    paths = [Path(t) for t in tables]
    days = [(p, read_campaign(place, p, arm, later=True, words=True)) for p in paths]
    notes: list[str] = []
    # Smallest number of touched points per day.
    min_touches = 2
    for p, m in days:
        if m.position is None:
            raise InputError(f"{p}: measurements of kind {m.kind}; touches are positions, or poses")
        if len(m) < min_touches:
            raise InputError(f"{p}: {len(m)} touch; {min_touches} or more are needed")
        if m.lost:
            notes.append(f"{m.source}: row {', '.join(map(str, m.lost))} left out, a cell is no number")

    def same(first: tuple[Path, Measurements], other: tuple[Path, Measurements]) -> bool:
        """Return whether two days have equal readings and equal columns, to the last digit."""
        a, b = first[1], other[1]
        return np.array_equal(a.q, b.q) and all(np.array_equal(v, a.arrays[name]) for name, v in b.arrays.items())

    distinct, copies = without_copies([(p, m.positions_alone()) for p, m in days], same)
    notes += [
        f"{p.name} is left out: the same readings as {first.name}, to the last digit" for (p, _), (first, _) in copies
    ]
    if all(day_of(p) is not None for p, _ in distinct):
        distinct.sort(key=lambda day: day_of(day[0]) or 0.0)
        if distinct[-1][0] != paths[-1]:
            notes.append(f"by its date {distinct[-1][0].name} is the last day, which is judged")
    else:
        notes.append("no date in every table's name: the days are in the order given")
    distinct = distinct[-30:]  # older days are not used
    weights = CHANGE_FREQUENCY if fleet is None else changes_in_fleet(Path(fleet))
    model = TouchModel.of_robot(
        arm,
        [m for _, m in distinct],
        None if noise_mm is None else 1e-3 * noise_mm,
        weights=weights,
        dates=tuple(day_of(p) for p, _ in distinct),
    )
    residual_m = 1e-3 * np.linalg.norm(model.residual_mm, axis=1)
    today = residual_m[(model.day == len(distinct))[::3]]
    # A greater median distance from the predictions shows another frame or another robot [m].
    if (far := float(np.median(today))) > 0.03:
        raise InputError(
            f"{distinct[-1][0]}: the touches are {mm(far)} mm (median) from where {place.name} has "
            "them: the instrument stands elsewhere, or it is another robot; touch in the frame of "
            "the calibration, or measure ten poses anywhere and leave --touches out"
        )
    if np.isfinite(model.temperatures).any():
        today = f"{1e6 * GROWTH_PER_K * model.warming[-1]:+.0f} um/m today, which goes as it cools and is not corrected"
        notes.append(f"temperature is logged: lengths are taken to grow by 12 +- 6 um/m a kelvin, by {today}")
    tolerance = 1e-3 * tolerance_mm if tolerance_mm else 2.0 * model.stated / MM_PER_M
    sources = (place, *(p for p, _ in distinct))
    touches = Touches(arm, model, model.drawn(seed), tolerance, None, tuple(notes), sources)
    named = not touches.label or touches.draws.probability(touches.label) >= 0.9
    if touches.verdict == "open" or (touches.verdict == "changed" and not named):
        # Two additional touches are proposed where those of the last day do not decide.
        more = plan_touches(place, 2, noise_mm=noise_mm, touched=distinct[-1][1], seed=seed)
        return replace(touches, more=more)
    return touches
