"""Verification by a few later poses: whether a calibrated robot is still as accurate as promised."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.special import chdtri, fdtri

from casadical.core.basics import Array, InputError, shown
from casadical.core.reading import load_json, number_fault
from casadical.core.reporting.blocks import Words, next_step
from casadical.core.reporting.plain import IN_MM, WRITTEN, Key, written
from casadical.core.reporting.result import Result
from casadical.identification.accuracy import errors
from casadical.identification.identification import Prepared, calibrated, prepare
from casadical.identification.result import LeftOut, rows_in_words
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.reading import refuse_shared_rows
from casadical.project.acceptance.iso9283 import Iso9283, evaluated_table
from casadical.project.problem import read_campaign
from casadical.project.problem_file import result_in
from casadical.project.targets import with_targets_of_rows
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot

# Kind of measurement as which full poses are verified, too: by their positions alone.
POSITION_KIND = "position"


@dataclass(frozen=True)
class Verification(Result):
    """The result of a check of a calibrated robot with later poses.

    robot : name of the robot
    promised : rms error on the held-out poses of the calibration [m]
    found : rms error now, base and tool fitted again, corrected for the degrees of freedom of that
        fit [m]
    limit : largest `found` with which the robot is valid, 99 % quantile of chance [m]
    n : number of poses
    far : poses with more than four times the promised error, or outliers of a robust fit; at most
        a third of all, the one with the largest error first
    without : `found` without outliers, where the robot is not valid with them [m]; None: not
        computed
    lost : file and row of each row that was excluded because a cell is no number
    tables : names of the tables
    again : beginning of a sentence on the frames that were fitted again
    gone : labels of effects of the instrument, which are removed from the model
    seen : true rms error that these poses reveal as too large in nine of ten cases [m]
    sources : robot file and tables, as they were given
    notes : assumptions about the tables, in words

    Examples
    --------
    >>> check = casadical.verify("results", "data/planar/planar.csv")
    >>> check.valid, check.to_json()["poses"], check.blocks()[0].text[:11]
    (True, 40, 'STILL VALID')
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("valid"),
        Key("left_out", lambda check: [row for _, row in check.lost]),
        Key("next", "commands"),
    )

    robot: str = field(metadata=WRITTEN)
    promised: float = field(metadata=written("promised_rms", "mm"))
    found: float = field(metadata=written("found_rms", "mm"))
    limit: float = field(metadata=IN_MM)
    n: int = field(metadata=written("poses"))
    far: tuple[LeftOut, ...] = field(metadata=WRITTEN)
    without: float | None = field(default=None, metadata=written("without_far", "mm"))
    lost: tuple[tuple[str, int], ...] = ()
    tables: tuple[str, ...] = field(default=(), metadata=WRITTEN)
    again: str = "Base and tool were"
    gone: tuple[str, ...] = field(default=(), metadata=written("without_effects"))
    seen: float = field(default=float("nan"), metadata=written("seen_from", "mm"))
    sources: tuple[Path, ...] = ()
    notes: tuple[str, ...] = field(default=(), metadata=WRITTEN)

    @property
    def valid(self) -> bool:
        """Return whether the error is still as promised, within chance."""
        return self.found <= self.limit

    report: ClassVar[str] = "verification.j2"

    @property
    def far_rows(self) -> str:
        """Return the rows of the poses `far` with their errors, as text."""
        return rows_in_words(self.far, of=self.tables)

    @property
    def next(self) -> tuple[Words, ...]:
        """Return the command to run next, if the result has the files of the check."""
        if not self.sources:
            return ()
        robot, *tables = self.sources
        if self.valid and problem_of(robot):
            return (next_step("to state how accurate it is", "certificate", robot.parent),)
        if self.valid:
            promised = ("--promised-mm", f"{1e3 * self.promised:.4g}")
            when = "when some ten poses are measured again"
            return (next_step(when, "verify", robot, "LATER.csv", *promised),)
        # Poses far off are taken as bad rows only up to this share of all poses.
        few = len(self.far) <= max(1, 0.1 * self.n)
        if few and self.without is not None and self.without <= self.limit:
            return (next_step("when the rows that are far off are measured again", "verify", *self.sources),)
        return (next_step("to learn what changed", "compare", problem_of(robot) or robot, *tables),)


def verify(
    robot: str | Path, tables: str | Path | Sequence[str | Path], promised_mm: float | None = None
) -> Verification:
    """Return whether a calibrated robot is as accurate as promised at poses measured later.

    Base and tool are fitted again. With c n - k degrees of freedom of `found`, c numbers a pose (3
    of a position), k those of base, tool and unknown points, the limit is the 99 % quantile of
    Fisher's F, for the promise is that of some held-out poses, else of chi-squared. Base and tool
    may stand elsewhere in each session. Effects of the instrument that was there are omitted.

    robot : file as `casadical calibrate --out` writes it, or that folder (the last method counts)
    tables : measured poses, one table or several of one kind
    promised_mm : rms error [mm] of this kind; None: of the held-out poses, see `promised_rms`
    Raises InputError: too few poses, several kinds of measurement, or no promise.

    Examples
    --------
    >>> casadical.verify("results", "data/planar/planar.csv").valid
    True
    """
    place, given = result_in(Path(robot)), [tables] if isinstance(tables, str | Path) else list(tables)
    arm, gone = without_instrument(read_robot(place))
    sets = [read_campaign(place, table, arm, later=True, words=True) for table in given]
    refuse_shared_rows(sets)
    kind, *others = sorted({m.kind if m.position is None else POSITION_KIND for m in sets})  # full poses count as these
    if others:
        kinds = ", ".join([kind, *others])
        raise InputError(f"{', '.join(m.source for m in sets)}: tables of kinds {kinds}; check one at a time")
    promise = (_in_metres(promised_mm, "promised_mm"), 0) if promised_mm is not None else promised_rms(place, kind)
    promised, judged = promise
    arm, named, notes = with_targets_of_rows(arm, sets)
    prepared = prepare(arm, [m.positions_alone() if m.position is not None else m for m in named])
    placing = _Refit.needed_by(prepared)
    placing.refuse_too_few(", ".join(map(str, given)))
    placed, k = prepared.robot, 0
    if placing.groups:
        fitted = calibrated(prepared, placing.groups)
        # Only identifiable parameters count: contacts, for one, do not determine the base.
        placed, k = fitted.robot, len(fitted.names)
    e = np.concatenate([errors(placed, m) for m in prepared.sets])
    at = [(m.source, int(row)) for m in prepared.sets for row in m.row]
    freedom = placing.freedom(len(e), k)
    # A robot as accurate as promised fails one check in a hundred.
    # The promise is that of a number of poses, too: both scatter (Fisher's F).
    quantile = fdtri(freedom, placing.lengths * judged, 0.99) if judged else chdtri(freedom, 0.01) / freedom
    found, limit = placing.scatter(e, k), promised * float(np.sqrt(quantile))
    # A pose with more than four times the promised error is named.
    far = [LeftOut(at[i][0], at[i][1], float(e[i])) for i in np.argsort(-e) if e[i] > 4.0 * promised]
    without = None
    if found > limit and placing.groups:  # a few gross errors bias base and tool, and so all errors
        robust = calibrated(prepared, placing.groups, loss="huber")
        if 0 < len(robust.outliers) <= len(e) // 3:
            inlier_errors = np.concatenate([errors(robust.robot, m) for m in robust.used])
            far, without = list(robust.left_out), placing.scatter(inlier_errors, k)
    return Verification(
        robot=arm.name,
        promised=promised,
        found=found,
        limit=limit,
        n=len(e),
        far=tuple(far[: len(e) // 3]),
        without=without,
        lost=tuple((m.source, row) for m in sets for row in m.lost),
        tables=tuple(m.source for m in sets),
        again=placing.again,
        gone=gone,
        seen=limit / float(np.sqrt(chdtri(freedom, 0.9) / freedom)),
        sources=(place, *map(Path, given)),
        notes=notes,
    )


def without_instrument(robot: Robot) -> tuple[Robot, tuple[str, ...]]:
    """Return the robot without effects of the measuring instrument, and the labels of these."""
    gone = tuple(e.label for e in robot.effects if e.from_kind)
    return robot.with_only(e for e in robot.effects if not e.from_kind) if gone else robot, gone


def iso9283(robot: str | Path, tables: Sequence[str | Path]) -> Iso9283:
    """Return the figures of a test table by ISO 9283, and what the calibration states.

    tables : a single one, as `casadical plan --iso9283` plans it
    Raises InputError: several tables, or what is wrong in the one.
    """
    if len(tables) != 1:
        raise InputError(f"{len(tables)} tables; a test by ISO 9283 is one")
    place, stated = result_in(Path(robot)), None
    with suppress(InputError):
        stated, _ = promised_rms(place)
    return evaluated_table(Path(tables[0]), read_robot(place), stated)


@dataclass(frozen=True)
class _Refit:
    """The frames and points that are fitted again to the later poses.

    groups : groups of parameters (base, tool, sessions)
    numbers : number of their parameters
    points : number of coordinates of unknown points
    n : number of poses
    lengths : number of lengths that are observed at each pose
    base : whether the base is one of the groups
    touched : whether unknown points are touched, and not anchors of distances
    """

    groups: tuple[str, ...]
    numbers: int
    points: int
    n: int
    lengths: int
    base: bool
    touched: bool

    @classmethod
    def needed_by(cls, prepared: Prepared) -> _Refit:
        """Return the frames and points that must be fitted again for a prepared problem's sets.

        They are the tool, sessions, unknown points and, if any set determines it, the base.
        """
        robot, sets = prepared.robot, prepared.sets
        kind = find_kind(sets[0].kind)
        base = any(kind.at_rest(m.arrays) for m in sets)
        wanted = (*(["base"] if base else []), "tool", *prepared.free)
        groups = tuple(g for g in wanted if g in robot.parameters.groups)
        numbers = len(robot.parameters.select(groups)) if groups else 0
        points = sum(3 * len(set(kind.point_names(m.arrays))) for m in sets)
        return cls(groups, numbers, points, sum(map(len, sets)), kind.lengths, base, kind.name != "distance")

    def refuse_too_few(self, tables: str) -> None:
        """Refuse poses that leave fewer than six degrees of freedom. Raises InputError."""
        # The judgement needs at least this many degrees of freedom.
        min_freedom = 6
        if self.freedom(self.n, self.numbers) >= min_freedom:
            return
        have = f"base and tool have {self.numbers} numbers" if self.base else f"the tool has {self.numbers} numbers"
        needed = -(-(self.numbers + self.points + min_freedom) // self.lengths)
        points = f", the points {self.points}" if self.points else ""
        raise InputError(f"{tables}: {self.n} poses; {have}{points}: measure {needed} or more")

    def freedom(self, n: int, k: int) -> int:
        """Return the degrees of freedom of n poses after a fit of k parameters and the points."""
        return self.lengths * n - self.points - k

    def scatter(self, e: Array, k: int) -> float:
        """Return the rms of errors e, shape (n,) [m], corrected for the fit of k parameters [m]."""
        # Touched points, many for few poses, lower the promised error in the same way; anchors of
        # distances hardly do.
        made_up = k if self.touched else self.points + k
        freedom = self.freedom(len(e), k)
        return float(np.sqrt(np.mean(e**2) * (freedom + made_up) / freedom))

    @property
    def again(self) -> str:
        """Return the beginning of a sentence on what was fitted again, such as "The tool was"."""
        if self.base:
            return "Base and tool were"
        return "The tool was" if not self.points else "The tool and the unknown places were"


def promised_rms(robot: Path, kind: str = POSITION_KIND) -> tuple[float, int]:
    """Return the rms error of held-out poses [m] that a robot file's results state, and their number.

    The number is 0 where it is not stated.
    Of METHOD.robot.toml it is that of the report set in result.json, which counts no outliers. Of
    diagnosed.robot.toml and discovered.robot.toml, diagnosis.json and discovery.json state a mean,
    which is converted as that of normally distributed errors.

    robot : robot file in the folder of results
    kind : kind of measurement; full poses are judged by their positions
    Raises InputError: no results are found next to the file, or they state no error of this kind.
    """
    for name, stated in (("diagnosed", "diagnosis"), ("discovered", "discovery")):
        if robot.name == f"{name}.robot.toml":
            path, mean = robot.parent / f"{stated}.json", None
            with suppress(OSError, ValueError, KeyError, TypeError):
                gap = load_json(path)
                mean = gap["gap_mm"][gap.get("best_model", "after")]
            if mean is not None:
                remedy = "; diagnose again, or give the promised rms error with --promised-mm"
                # The ratio of rms to mean length of a normally distributed error in three axes.
                return float(np.sqrt(3 * np.pi / 8)) * _in_metres(mean, f"{path}: gap_mm", remedy), 0
    path = robot.parent / "result.json"
    remedy = "give the promised rms error with --promised-mm"
    alike = (POSITION_KIND, "pose", "position_covariance") if kind == POSITION_KIND else (kind,)
    try:
        stated = load_json(path)
        sets = dict(stated["methods"]).get(robot.name.removesuffix(".robot.toml"), {}).get("sets", {})
        kinds = stated.get("kinds", {})
        held_out_rms = [
            (figures["rms_mm"], figures.get("n", 0))
            for name, figures in sets.items()
            if name.split("/")[0] == "report" and kinds.get(name, kind) in alike
        ]
    except (ValueError, KeyError, TypeError, AttributeError) as error:  # no file, or other types
        why = f" ({error})" if isinstance(error, InputError) and path.is_file() else ""
        raise InputError(f"{path}: no figures of a calibration{why}; {remedy}") from None
    if not held_out_rms:
        raise InputError(f"{path}: no held-out poses of {robot.name} (kind {kind}); {remedy}")
    rms, n = held_out_rms[0]
    fault = f"{path}: no figures of a calibration: rms_mm of {robot.name}"
    return _in_metres(rms, fault, f"; calibrate again, or {remedy}"), n if type(n) is int and n > 0 else 0


def _in_metres(stated: Any, place: str, remedy: str = "") -> float:
    """Return a stated rms error [mm] in metres. Raises InputError for what is no number above 0."""
    if not isinstance(stated, int | float) or isinstance(stated, bool) or stated <= 0 or number_fault(stated):
        raise InputError(f"{place} is {shown(repr(stated))}; allowed: a number above 0{remedy}")
    return 1e-3 * float(stated)


def problem_of(robot: Path) -> Path | None:
    """Return the problem folder of a calibration; None where it is not found.

    It is looked for in the working directory and next to the results.

    robot : robot file in the folder of results
    """
    results = robot.parent
    with suppress(OSError, ValueError, KeyError, TypeError):
        name = str(load_json(results / "result.json")["problem"])
        return next((p for p in (Path(name), results.parent / name) if (p / "problem.toml").exists()), None)
    return None
