"""Whether a calibrated robot still is as accurate as it was said to be, from a few poses measured later."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.special import chdtri

from casadical.core.basics import Array, InputError, shown
from casadical.core.reading import load_json, number_fault
from casadical.core.telling.blocks import Words, next_step
from casadical.core.telling.plain import IN_MM, WRITTEN, Key, written
from casadical.identification.accuracy import errors
from casadical.identification.identification import Prepared, calibrated, prepare
from casadical.identification.result import LeftOut, rows_in_words
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.reading import refuse_shared_rows
from casadical.project.acceptance.acceptance import Acceptance
from casadical.project.acceptance.iso9283 import Iso9283, evaluated_table
from casadical.project.problem import read_campaign
from casadical.project.problem_file import result_in
from casadical.project.targets import with_targets_of_rows
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot

POSITION = "position"
# So many numbers must be left to judge by.
SPARE = 6


@dataclass(frozen=True)
class Verification(Acceptance):
    """What a check with later poses says.

    promised : rms position error on held-out poses of the calibration [m]
    found : now, base and tool fitted again, the fit's own share made up for [m]; limit : what it may be by chance [m]
    n : poses; far : those far off; without : `found` without the far ones, where it is not valid with them
    lost : rows in which a cell is no number; again : what was fitted again, in words
    gone : labels of effects of the instrument, left out; notes : what was assumed of the tables
    seen : error that these poses show to be too great in nine of ten cases [m]
    sources : robot file and tables, as they were given

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
        """Whether the error still is what was promised."""
        return self.found <= self.limit

    report: ClassVar[str] = "verification.j2"

    @property
    def accepted(self) -> bool:
        return self.valid

    @property
    def far_rows(self) -> str:
        """Return the rows that are far off, with their errors."""
        return rows_in_words(self.far, of=self.tables)

    @property
    def next(self) -> tuple[Words, ...]:
        """What to do now, where it is known of which files this is."""
        if not self.sources:
            return ()
        robot, *tables = self.sources
        if self.valid and problem_of(robot):
            return (next_step("to state how accurate it is", "certificate", robot.parent),)
        if self.valid:
            return (next_step("when some ten poses are measured again", "verify", robot, "LATER.csv",
                              "--promised-mm", f"{1e3 * self.promised:.4g}"),)  # fmt: skip
        # Of so large a share of the poses a few are far off; more are no bad rows.
        few = len(self.far) <= max(1, 0.1 * self.n)
        if few and self.without is not None and self.without <= self.limit:
            return (next_step("when the rows that are far off are measured again", "verify", *self.sources),)
        return (next_step("to learn what changed", "compare", problem_of(robot) or robot, *tables),)


def verify(
    robot: str | Path, tables: str | Path | Sequence[str | Path], promised_mm: float | None = None
) -> Verification:
    """Check a calibrated robot by poses that were measured later; base and tool are fitted again.

    With `found` of c n - k degrees of freedom, c numbers a pose (3 of a position), k those of base, tool and unknown
    points, its limit is the 99 % quantile of chi-squared. Base and tool may stand elsewhere
    in each session. Effects of the instrument that was there are left out.

    robot : file as `casadical calibrate --out` writes it, or that folder (the method that counts)
    tables : measured poses, one table or several of one kind
    promised_mm : rms error [mm] of this kind; None: of the held-out poses, see `promised_rms`
    Raises InputError: too few poses, several kinds of measurement, or no promise is known.

    Examples
    --------
    >>> casadical.verify("results", "data/planar/planar.csv").valid
    True
    """
    place, given = result_in(Path(robot)), [tables] if isinstance(tables, str | Path) else list(tables)
    arm, gone = without_instrument(read_robot(place))
    sets = [read_campaign(place, table, arm, later=True, words=True) for table in given]
    refuse_shared_rows(sets)
    kind, *others = sorted({m.kind if m.position is None else POSITION for m in sets})  # full poses by their positions
    if others:
        kinds = ", ".join([kind, *others])
        raise InputError(f"{', '.join(m.source for m in sets)}: tables of kinds {kinds}; check one at a time")
    promised = promised_rms(place, kind) if promised_mm is None else _in_metres(promised_mm, "promised_mm")
    arm, named, notes = with_targets_of_rows(arm, sets)
    prepared = prepare(arm, [m.positions_alone() if m.position is not None else m for m in named])
    placing = _Placing.needed_by(prepared)
    placing.refuse_too_few(", ".join(map(str, given)))
    placed, k = prepared.robot, 0
    if placing.groups:
        fitted = calibrated(prepared, placing.groups)
        placed, k = fitted.robot, len(fitted.names)  # contacts do not tell where the base is
    e = np.concatenate([errors(placed, m) for m in prepared.sets])
    at = [(m.source, int(row)) for m in prepared.sets for row in m.row]
    freedom = placing.freedom(len(e), k)
    # A robot that keeps its promise is said to break it once in a hundred checks.
    found, limit = placing.scatter(e, k), promised * float(np.sqrt(chdtri(freedom, 0.01) / freedom))
    # A pose with more than so many times the promised error is named.
    far = [LeftOut(at[i][0], at[i][1], float(e[i])) for i in np.argsort(-e) if e[i] > 4.0 * promised]
    without = None
    if found > limit and placing.groups:  # a few gross errors draw base and tool, and so all others, towards themselves
        robust = calibrated(prepared, placing.groups, loss="huber")
        if 0 < len(robust.outliers) <= len(e) // 3:
            kept = np.concatenate([errors(robust.robot, m) for m in robust.used])
            far, without = list(robust.left_out), placing.scatter(kept, k)
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
    """The robot without effects of the instrument that measured it, and their labels."""
    gone = tuple(e.label for e in robot.effects if e.from_kind)
    return robot.with_only(e for e in robot.effects if not e.from_kind) if gone else robot, gone


def iso9283(robot: str | Path, tables: Sequence[str | Path]) -> Iso9283:
    """What a table of a test by ISO 9283 says, beside what the calibration states.

    robot : as of `verify`; tables : one, as `casadical plan --iso9283` plans it
    Raises InputError: several tables, or what is wrong in the one.
    """
    if len(tables) != 1:
        raise InputError(f"{len(tables)} tables; a test by ISO 9283 is one")
    place, stated = result_in(Path(robot)), None
    with suppress(InputError):
        stated = promised_rms(place)
    return evaluated_table(Path(tables[0]), read_robot(place), stated)


@dataclass(frozen=True)
class _Placing:
    """What is fitted again: `numbers` of these groups, `points` coordinates of unknown places; n : poses."""

    groups: tuple[str, ...]
    numbers: int
    points: int
    n: int
    lengths: int
    base: bool
    touched: bool

    @classmethod
    def needed_by(cls, prepared: Prepared) -> _Placing:
        robot, sets = prepared.robot, prepared.sets
        kind = find_kind(sets[0].kind)
        # Readings to unknown places alone do not tell where the base is.
        base = any(kind.at_rest(m.arrays) for m in sets)
        wanted = (*(["base"] if base else []), "tool", *prepared.free)
        groups = tuple(g for g in wanted if g in robot.parameters.groups)
        numbers = len(robot.parameters.select(groups)) if groups else 0
        points = sum(3 * len(set(kind.point_names(m.arrays))) for m in sets)
        return cls(groups, numbers, points, sum(map(len, sets)), kind.lengths, base, kind.name != "distance")

    def refuse_too_few(self, tables: str) -> None:
        """Raises InputError where fewer than six numbers are left to judge by."""
        if self.freedom(self.n, self.numbers) >= SPARE:
            return
        have = f"base and tool have {self.numbers} numbers" if self.base else f"the tool has {self.numbers} numbers"
        needed = -(-(self.numbers + self.points + SPARE) // self.lengths)
        points = f", the points {self.points}" if self.points else ""
        raise InputError(f"{tables}: {self.n} poses; {have}{points}: measure {needed} or more")

    def freedom(self, n: int, k: int) -> int:
        """Numbers of n poses that k fitted parameters, and the points, leave."""
        return self.lengths * n - self.points - k

    def scatter(self, e: Array, k: int) -> float:
        """Rms [m] of errors, shape (n,), after a fit of k parameters; the fit's own share is made up for."""
        # Touched points, which are many for few poses, lower the promised error alike; far ends of distances hardly do.
        made_up = k if self.touched else self.points + k
        freedom = self.freedom(len(e), k)
        return float(np.sqrt(np.mean(e**2) * (freedom + made_up) / freedom))

    @property
    def again(self) -> str:
        """What was fitted again, as the beginning of a sentence."""
        if self.base:
            return "Base and tool were"
        return "The tool was" if not self.points else "The tool and the unknown places were"


def promised_rms(robot: Path, kind: str = POSITION) -> float:
    """Rms error of held-out poses [m] that the file beside METHOD.robot.toml or diagnosed.robot.toml states.

    kind : of measurement; full poses are judged by their positions Of result.json it is that of the report set, without
        poses that were far off; diagnosis.json and discovery.json state a mean, which is taken for that of normally
        distributed errors. Raises InputError.
    """
    for name, stated in (("diagnosed", "diagnosis"), ("discovered", "discovery")):
        if robot.name == f"{name}.robot.toml":
            path, mean = robot.parent / f"{stated}.json", None
            with suppress(OSError, ValueError, KeyError, TypeError):
                gap = load_json(path)
                mean = gap["gap_mm"][gap.get("kept", "after")]
            if mean is not None:
                remedy = "; diagnose again, or give the promised rms error with --promised-mm"
                # Of the length of a normally distributed error in three coordinates.
                return float(np.sqrt(3 * np.pi / 8)) * _in_metres(mean, f"{path}: gap_mm", remedy)
    path = robot.parent / "result.json"
    remedy = "give the promised rms error with --promised-mm"
    alike = (POSITION, "pose", "position_covariance") if kind == POSITION else (kind,)
    try:
        stated = load_json(path)
        sets = dict(stated["methods"]).get(robot.name.removesuffix(".robot.toml"), {}).get("sets", {})
        kinds = stated.get("kinds", {})
        held = [
            figures.get("without_far_off", figures)["rms_mm"]
            for name, figures in sets.items()
            if name.split("/")[0] == "report" and kinds.get(name, kind) in alike
        ]
    except (ValueError, KeyError, TypeError, AttributeError) as error:  # no such file; figures of other kinds
        why = f" ({error})" if isinstance(error, InputError) and path.is_file() else ""
        raise InputError(f"{path}: no figures of a calibration{why}; {remedy}") from None
    if not held:
        raise InputError(f"{path}: no held-out poses of {robot.name} (kind {kind}); {remedy}")
    return _in_metres(
        held[0], f"{path}: no figures of a calibration: rms_mm of {robot.name}", f"; calibrate again, or {remedy}"
    )


def _in_metres(stated: Any, place: str, remedy: str = "") -> float:
    """An rms error that is stated [mm], in m. Raises InputError for what is no number above 0."""
    if not isinstance(stated, int | float) or isinstance(stated, bool) or stated <= 0 or number_fault(stated):
        raise InputError(f"{place} is {shown(repr(stated))}; allowed: a number above 0{remedy}")
    return 1e-3 * float(stated)


def problem_of(robot: Path) -> Path | None:
    """The problem folder of a calibration, beside its results or here: its poses tell more than its robot file."""
    results = robot.parent
    with suppress(OSError, ValueError, KeyError, TypeError):
        name = str(load_json(results / "result.json")["problem"])
        return next((p for p in (Path(name), results.parent / name) if (p / "problem.toml").exists()), None)
    return None
