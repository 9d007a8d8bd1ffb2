"""Read a program file, a CSV or one in a controller's language, and correct its targets."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.files import csv_text
from casadical.core.reading import missing, read_bytes
from casadical.core.reporting.blocks import Table, Words
from casadical.core.reporting.plain import Key, plain
from casadical.core.reporting.result import Result
from casadical.export.c.kernel import Manifest
from casadical.export.controller.commands import (
    Sources,
    followed,
    measured_range,
    poses_of,
    robot_of,
    unreached,
    wants_pose,
)
from casadical.export.controller.correction import CORRECTED_STATUSES, STATUS_MEANINGS, kernel_corrector, position_only
from casadical.export.controller.programs import correction as c
from casadical.export.controller.programs.correction import Cell, refuse_accuracy
from casadical.export.controller.programs.csv_table import CsvTable
from casadical.export.controller.programs.fanuc import Fanuc
from casadical.export.controller.programs.krl import Krl
from casadical.export.controller.programs.language import ProgramLanguage, text_of
from casadical.export.controller.programs.rapid import Rapid
from casadical.export.controller.programs.target import Given, Target
from casadical.export.controller.programs.urscript import UrScript

# Supported languages; a new one is a class in a module of its own and an entry here.
PROGRAM_LANGUAGES: tuple[type[ProgramLanguage], ...] = (Krl, Rapid, UrScript, Fanuc, CsvTable)
# Reason, in words, why a target with this status is not corrected; for joints and for poses.
_REFUSAL_MEANINGS = STATUS_MEANINGS | {
    "LEFT": "unchanged",
    "NO_TOOL": "its tool or base is unknown: give --tcp or --base",
    "NO_CONFIGURATION": "the program does not say with which arm configuration; with --nearest it is the one "
    "nearest to the target before it",
    "UNREACHABLE": "the nominal robot does not reach it in the configuration that the program says",
    "AMBIGUOUS": "the nominal robot reaches it in several ways with the same configuration",
    "CONFIGURATION_CHANGES": "the corrected joints would have another arm configuration",
    "EXTERNAL_AXIS": "an external axis is off its zero; if none carries the robot or its base, give --external-still",
    "NEEDS_ROBOT_FILE": "a pose needs the nominal robot: give the robot file and --nominal in place of the folder",
}


@dataclass(frozen=True, eq=False)
class TargetProgram(Result):
    """A program with its targets and, once it is corrected, the correction of each of them.

    source : path of the program
    language : language of the program
    text : content of the program before the correction, one character for each byte
    targets : targets in their order, those that must stay unchanged included
    results : correction of each target, in their order
    units : "rad" or "m" of each joint's reading
    assumed : sentences on assumptions of the correction
    said : sentences on what else a user must know
    texts : contents of the files that are to be written, by path
    """

    file_stem: ClassVar[str] = "correction"
    derived: ClassVar[tuple[Key, ...]] = (
        Key("language", "language.name"),
        Key("targets", lambda made: len(made.results)),
        Key("corrected", lambda made: len(made.fine)),
        Key(
            "refused",
            lambda made: [
                {"line": r.target.line, "name": r.target.name, "status": r.status, "why": r.why} for r in made.refused
            ],
        ),
    )

    source: str
    language: ProgramLanguage
    text: str
    targets: tuple[Target, ...]
    results: tuple[c.CorrectedTarget, ...] = ()
    units: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    said: tuple[str, ...] = ()
    texts: Mapping[Path, str | bytes] = field(default_factory=dict)

    @property
    def fine(self) -> list[c.CorrectedTarget]:
        """Return the corrected targets."""
        return [r for r in self.results if r.fine]

    @property
    def refused(self) -> list[c.CorrectedTarget]:
        """Return the targets that remain unchanged."""
        return [r for r in self.results if not r.fine]

    def content(self) -> bytes:
        """Return the program's bytes with the new numbers in place of the old ones."""
        return self.language.written(self.source, self.text, self.results)

    def to_csv(self) -> str:
        """Return the report, one row per target, as CSV text."""
        head = ["line", "target", "kind", "status", "why", "frames", "was", "is"]
        head += ["moved_mm", "off_mm_before", "off_mm_after", "off_deg_before", "off_deg_after"]
        return csv_text([head, *map(_row, self.results)])

    @property
    def changes(self) -> dict[str, dict[str, float]]:
        """Return figures of the corrected targets by name, for the JSON file [mm, deg].

        They are mean and maximum of moved_mm, and the maxima of the real tool's deviation before
        and after (off_nominal_mm_max, off_nominal_deg_max); unknown ones are missing.
        """
        figures: dict[str, dict[str, float]] = {}
        for name, table in _figures(self.fine).items():
            if table.ndim == 1:
                figures[name] = {"mean": float(table.mean()), "max": float(table.max())}
            else:
                before, after = table.max(axis=0)
                figures[f"off_nominal_{name[4:]}_max"] = {"before": float(before), "after": float(after)}
        return figures

    def to_json(self) -> dict[str, Any]:
        """Return the summary: targets, corrected ones, refused ones by line, and `changes`."""
        return {**plain(self), **self.changes}

    def blocks(self) -> list[Words | Table]:
        """Return the report: number of corrected targets, reasons of others (20), motions."""
        fine, refused, language = self.fine, self.refused, self.language
        head = f"{language.name}: {len(fine)} of {len(self.results)} targets corrected"
        head += position_only(tuple(r.status for r in fine))
        blocks = [Words(head + (f", {len(refused)} LEFT as they were:" if refused else ""), "verdict")]
        for r in refused[:20]:
            named = ", ".join(filter(None, (f"{language.place} {r.target.line}", r.target.name)))
            blocks.append(Words(f"  {named}: {r.status}, {r.why or _REFUSAL_MEANINGS[r.status]}"))
        if len(refused) > 20:
            where = "report" if language.report_beside else "status column"
            blocks.append(Words(f"  and {len(refused) - 20} more; see the {where}"))
        moved = _moved(fine, self.units) if fine else [Words("nothing moved")]
        assumed = (Words(line, mark="ASSUMED") for line in self.assumed)
        return [*blocks, *moved, *assumed, *map(Words, self.said)]


def language_named(word: str) -> ProgramLanguage:
    """Return the first language of this suffix or word in its class name. Raises InputError."""
    for kind in PROGRAM_LANGUAGES:
        if word.lower() in kind.__name__.lower() or f".{word.lower()}" in kind.suffixes:
            return kind()
    allowed = ", ".join(kind.name for kind in PROGRAM_LANGUAGES)
    raise InputError(f"{word!r}: no such language of programs; allowed: {allowed}")


def language_of(path: Path) -> ProgramLanguage:
    """Return a new object of the language of a file, by its suffix.

    Raises InputError: no language has this suffix; the message lists them all.
    """
    for kind in PROGRAM_LANGUAGES:
        if path.suffix.lower() in kind.suffixes:
            return kind()
    listed = ", ".join(f"{'/'.join(kind.suffixes)} ({kind.name})" for kind in PROGRAM_LANGUAGES)
    raise InputError(f"{path}: programs with the suffix {path.suffix!r} cannot be read; allowed: {listed}")


def read_target_program(path: Path, given: Given, joints: int) -> TargetProgram:
    """Return a program with its targets, read in the language of its suffix.

    given : tools, bases and units from outside the program; joints : number of joints
    Raises InputError: the program cannot be read, has no targets, or was corrected before.
    """
    language = language_of(path)
    text = language.decoded(str(path), read_bytes(path))
    try:
        targets = language.targets(str(path), text, given, joints)
    except RecursionError:
        raise InputError(f"{path}: brackets are nested too deeply for a {language.name} program") from None
    if not targets:
        raise InputError(f"{path}: has no target that {language.name} programs have; is it the right file?")
    targets = [t if np.isfinite(t.si).all() else t.leave("has a number that is too large") for t in targets]
    _refuse_corrected(path, targets)
    return TargetProgram(str(path), language, text, tuple(targets))


def corrected_program(program: TargetProgram, cell: c.Cell) -> TargetProgram:
    """Return a program with each target corrected, or with the reason why it is not.

    cell : robots and frames
    Raises InputError: the nominal robot does not reach poses and `leave_unreached` is not set.
    """
    try:
        results = tuple(c.corrected_targets(program.language, program.targets, cell))
    except InputError as error:
        raise InputError(f"{program.source}: {error}") from None
    return replace(program, results=results, units=cell.units)


def report_of(path: Path) -> Path:
    """Return the path of the report next to a corrected program: NAME.correction.csv."""
    return path.with_name(f"{path.name}.correction.csv")


def _refuse_corrected(path: Path, targets: list[Target]) -> None:
    """Check that no target was corrected before, by the report next to it. Raises InputError."""
    if not report_of(path).exists():
        return
    rows = csv.DictReader(io.StringIO(read_bytes(report_of(path)).decode("utf-8", "replace")))
    written = {(row.get("target"), row.get("is")) for row in rows if row.get("status") in CORRECTED_STATUSES}
    for target in targets:
        if (target.name, _numbers(target)) in written:
            raise InputError(
                f"{path}: line {target.line}: {target.name} was corrected before, says "
                f"{report_of(path).name}; correct the original"
            )


def _numbers(target: Target) -> str:
    """Return the texts of a target's numbers, separated by spaces."""
    return " ".join(number.text for number in target.numbers)


def _row(r: c.CorrectedTarget) -> list[str]:
    """Return the cells of one target's row in the CSV report, in the columns of `to_csv`."""
    texts = [t if n.differs(t) else n.text for n, t in zip(r.target.numbers, r.texts, strict=False)]
    figures = [r.moved_mm, *(r.off_mm or (None, None)), *(r.off_deg or (None, None))]
    why = "" if r.fine else r.why or _REFUSAL_MEANINGS[r.status]
    head = [str(r.target.line), r.target.name, "joints" if r.target.joints else "pose", r.status, why]
    head += [r.target.about, _numbers(r.target), " ".join(texts)]
    return [*head, *("" if f is None else f"{f:.5f}" for f in figures)]


def _figures(fine: Sequence[c.CorrectedTarget]) -> dict[str, Array]:
    """Return the computed figures of corrected targets by name, each (k,) or (k, 2) [mm, deg].

    They are moved_mm, off_mm and off_deg of `CorrectedTarget`, without unknown ones.
    """
    tables = {name: [getattr(r, name) for r in fine] for name in ("moved_mm", "off_mm", "off_deg")}
    figures = {name: [v for v in values if v is not None] for name, values in tables.items()}
    return {name: np.array(values) for name, values in figures.items() if values}


def _moved(fine: Sequence[c.CorrectedTarget], units: Sequence[str]) -> list[Table]:
    """Return tables (mean, maximum) of the tool's deviation, if known, and of targets' moves."""
    joints = np.array([abs(new - old) for old, new in (r.q for r in fine if r.q)])
    figures, moved = _figures(fine), dict[str, Array]()
    for i, (column, unit) in enumerate(zip(joints.T, units, strict=True), 1):
        word, factor = ("mm", 1e3) if unit == "m" else ("deg", 180 / np.pi)
        moved[f"joint {i} [{word}]"] = factor * column
    made = [_table("", "moved by", {**moved, "tool [mm]": figures["moved_mm"]})]
    if "off_mm" in figures:
        (before, after), turned = figures["off_mm"].T, 1e3 * figures["off_deg"].T
        title = "the real tool off the nominal one, by the model, with the numbers as written"
        off = {"before [mm]": before, "after [um]": 1e3 * after}
        made.append(_table(title, "off by", {**off, "before [mdeg]": turned[0], "after [mdeg]": turned[1]}))
    return made[::-1]  # remaining deviation first


def _table(title: str, what: str, rows: Mapping[str, Array]) -> Table:
    """Return a table with mean and maximum of each row's values."""
    cells = [(name, f"{v.mean():.4f}", f"{v.max():.4f}") for name, v in rows.items()]
    return Table(title, (what, "mean", "max"), cells, frozenset({1, 2}))


def assumptions(corrected: TargetProgram, cell: c.Cell) -> list[str]:
    """Return the assumptions under which a program was corrected, as sentences."""
    lines = [
        "the controller's own absolute-accuracy option is off, and joint values are the readings of the robot file"
    ]
    results, identity = corrected.results, np.eye(4)
    if any(not r.target.joints for r in results if r.fine):
        for what, T, of in (("root frame", cell.root, "base frame"), ("flange", cell.flange, "last link's frame")):
            if np.array_equal(T, identity):
                lines.append(f"the controller's {what} is the robot file's {of}")
    if any(r.target.joints and (r.target.tool is None or cell.sources is None) for r in results if r.fine):
        tool_words = "the tool of the export" if cell.sources is None else "the tool of the robot file"
        lines.append(f"where the tool of joint targets is unknown, {tool_words} is assumed")
    return lines


def correct_file(
    sources: Sources,
    program: Path,
    out: Path,
    *,
    steps: int = 2,
    correct: str = "position",
    trust: bool = False,
    tcp: Sequence[str] = (),
    base: Sequence[str] = (),
    root: str | None = None,
    flange: str | None = None,
    data: Sequence[Path] = (),
    nearest: bool = False,
    external_still: bool = False,
    leave_unreached: bool = False,
    accuracy_off: bool = False,
) -> TargetProgram:
    """Return a program with targets at which the real tool is where the nominal one would be.

    Nothing is written.

    sources : robot file and its others, or in place of the robot a folder that `write_c` wrote,
        which holds all other choices; a folder is always taken for such an export
    out : path of the corrected program
    trust : whether C of a folder that was exported elsewhere is compiled and run
    tcp, base : tools and bases as NAME=NUMBERS, with the numbers that the controller shows
    root, flange : numbers of the controller's root frame in the robot file's base frame, and of its
        flange in the last link's frame; None: they are the same
    data : files of the program in which tools and bases are looked up
    accuracy_off : whether the controller's own absolute accuracy is off; else targets that were
        taught with it on are refused
    Raises InputError: an option, a file or the program cannot be used.
    """
    model, oriented = Path(cast(Path, sources.robot)), wants_pose(correct)
    if not model.exists():
        raise missing(model, "folder or robot file")
    folder = kernel_corrector(model, trust=trust) if model.is_dir() else None
    spoken = language_of(program)
    cell = Cell(
        None if folder else sources,
        steps,
        oriented,
        root=np.eye(4) if root is None else spoken.transform("--root", root),
        flange=np.eye(4) if flange is None else spoken.transform("--flange", flange),
        nearest=nearest,
        external_still=external_still,
        leave_unreached=leave_unreached,
        folder=folder,
    )
    texts = {str(path): text_of(str(path), read_bytes(path)) for path in data}
    tools, bases = _transforms(spoken, "--tcp", tcp), _transforms(spoken, "--base", base)
    read = read_target_program(program, Given(tools, bases, texts, cell.units), len(cell.units))
    if not accuracy_off:
        refuse_accuracy(read.source, read.targets)
    result = corrected_program(read, cell)
    if folder:
        figures, said = Manifest.read(model).figures, ["remaining error: not measured"]
        median, worst = figures.get("rest_um_median"), figures.get("rest_um_worst")
        if median is not None and worst is not None:
            said = [f"remaining error, measured at export on random poses: median {median:g} um, worst {worst:g} um"]
    else:
        said = [f"LEFT OUT {line}" for line in followed(sources)[1]]
        robot = robot_of(sources.robot)
        said += filter(None, [poses_of(robot) if oriented else "", unreached(robot)])
        said += measured_range(robot)
    reports: dict[Path, str | bytes] = {report_of(out): result.to_csv()} if spoken.report_beside else {}
    return replace(
        result,
        assumed=tuple(assumptions(result, cell)),
        said=tuple(said),
        texts={**reports, out: result.content()},
    )


def _transforms(language: ProgramLanguage, option: str, entries: Sequence[str]) -> dict[str, Array]:
    """Return the transforms, shape (4, 4) [m], by name, of an option's entries NAME=NUMBERS."""
    pairs = [entry.rpartition("=")[::2] for entry in entries]
    names = [name.strip() for name, _ in pairs]
    if twice := next((text for name, (_, text) in zip(names, pairs, strict=True) if names.count(name) > 1), ""):
        raise InputError(f"{option} {twice}: one of this name is given twice; keep one")
    return {name: language.transform(option, numbers) for name, (_, numbers) in zip(names, pairs, strict=True)}
