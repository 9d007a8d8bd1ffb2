"""A program file in a controller's language: read, corrected, and written with a report of its targets beside it."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from casadical.core.errors import InputError
from casadical.core.files import csv_text
from casadical.core.reading import read_bytes
from casadical.export.controller.correction import FINE, MEANINGS, SHOWN, mean_and_max, position_only
from casadical.export.controller.programs import correction as c
from casadical.export.controller.programs.language import ProgramLanguage, text_of
from casadical.export.controller.programs.registry import language_of
from casadical.export.controller.programs.target import Given, Target

REPORT = ".correction.csv"  # after the name of a corrected program
_HEADER = (
    "line", "target", "kind", "status", "why", "frames", "was", "is", "moved_mm", "off_mm_before", "off_mm_after",
    "off_deg_before", "off_deg_after", "bound_mm",
)  # fmt: skip
_MEANINGS = MEANINGS | {
    c.LEFT: "left as it is",
    c.NO_TOOL: "its tool or base is not known: give --tcp or --base",
    c.NO_CONFIGURATION: "the program does not say with which arm configuration; with --nearest it is the one "
    "nearest to the target before it",
    c.UNREACHABLE: "the nominal robot does not reach it in the configuration that the program says",
    c.AMBIGUOUS: "the nominal robot reaches it in several ways with the same configuration",
    c.CONFIGURATION_CHANGES: "the corrected joints would have another arm configuration",
    c.EXTERNAL_AXIS: "an external axis is off its zero; if none carries the robot or its base, give --external-still",
    c.NEEDS_ROBOT_FILE: "a pose needs the nominal robot: give the robot file and --nominal in place of the folder",
}


@dataclass(frozen=True, eq=False)
class TargetProgram:
    """A program and its targets. text : one character for each byte."""

    source: str
    language: ProgramLanguage
    text: str
    targets: tuple[Target, ...]


@dataclass(frozen=True, eq=False)
class CorrectedProgram:
    """A program and what became of its targets."""

    program: TargetProgram
    results: tuple[c.Result, ...]

    def content(self) -> bytes:
        """The program's bytes, with the new numbers in place of the old ones."""
        new: list[tuple[int, int, str]] = []
        for r in self.results:
            if r.fine:
                places = (*r.target.numbers, *r.target.turn_text)[: len(r.texts)]
                new += [
                    (n.start, n.stop, text) for n, text in zip(places, r.texts, strict=True) if _differs(n.text, text)
                ]
        pieces, end = [], 0
        for start, stop, text in sorted(new):
            pieces += [self.program.text[end:start], text]
            end = stop
        return "".join([*pieces, self.program.text[end:]]).encode("latin-1")

    def to_csv(self) -> str:
        """The report: a row for each target, corrected or not."""
        return csv_text([_HEADER, *(_row(r) for r in self.results)])

    def to_json(self) -> dict[str, Any]:
        """The summary as plain data."""
        return {"language": self.program.language.name, **c.summary(list(self.results))}

    def report(self) -> str:
        """The number of corrected targets, the others with their reasons, and how far off the tool was and is."""
        fine, refused = [r for r in self.results if r.fine], [r for r in self.results if not r.fine]
        lines = [f"{self.program.language.name}: {len(fine)} of {len(self.results)} targets corrected"]
        lines[0] += position_only(tuple(r.status for r in fine))
        if refused:
            lines[0] += f", {len(refused)} LEFT as they were:"
        for r in refused[:SHOWN]:
            lines.append(f"  line {r.target.line}, {r.target.name}: {r.status}, {r.why or _MEANINGS[r.status]}")
        if len(refused) > SHOWN:
            lines.append(f"  and {len(refused) - SHOWN} more; see the report")
        return "\n".join([*lines, *_errors(fine)])


def read_target_program(path: Path, given: Given, joints: int) -> TargetProgram:
    """A program in the language of its suffix, for a robot with some joints.

    Raises InputError that names the line: a program that cannot be corrected, or one that was corrected before.
    """
    language = language_of(path)
    text = text_of(str(path), read_bytes(path))
    targets = language.targets(str(path), text, given, joints)
    if not targets:
        raise InputError(f"{path}: has no target that {language.name} programs have; is it the right file?")
    targets = [t if np.isfinite(t.si).all() else t.leave("has a number that is too large") for t in targets]
    _refuse_corrected(path, targets)
    return TargetProgram(str(path), language, text, tuple(targets))


def corrected_program(program: TargetProgram, cell: c.Cell) -> CorrectedProgram:
    """Correct every target of a program on its own."""
    return CorrectedProgram(program, tuple(c.corrected_targets(program.language, list(program.targets), cell)))


def report_of(path: Path) -> Path:
    """Where the report of a corrected program goes."""
    return path.with_name(path.name + REPORT)


def _refuse_corrected(path: Path, targets: list[Target]) -> None:
    """Raises InputError for a program that has targets which the report beside it says were written by a correction."""
    if not report_of(path).exists():
        return
    rows = csv.DictReader(io.StringIO(read_bytes(report_of(path)).decode("utf-8", "replace")))
    written = {(row.get("target"), row.get("is")) for row in rows if row.get("status") in FINE}
    for target in targets:
        if (target.name, _numbers(target)) in written:
            raise InputError(
                f"{path}: line {target.line}: {target.name} was corrected before, says {report_of(path).name}; "
                "correct the original"
            )


def _numbers(target: Target) -> str:
    return " ".join(number.text for number in target.numbers)


def _differs(old: str, new: str) -> bool:
    return old.startswith("'") or new.startswith("'") or float(old) != float(new)


def _row(r: c.Result) -> list[str]:
    texts = [n.text if not _differs(n.text, t) else t for n, t in zip(r.target.numbers, r.texts, strict=False)]
    figures = [r.moved_mm, *(r.off_mm or (None, None)), *(r.off_deg or (None, None)), r.bound_mm]
    return [
        str(r.target.line), r.target.name, "joints" if r.target.joints else "pose", r.status,
        "" if r.fine else r.why or _MEANINGS[r.status], r.target.about, _numbers(r.target), " ".join(texts),
        *("" if f is None else f"{f:.5f}" for f in figures),
    ]  # fmt: skip


def _errors(fine: list[c.Result]) -> list[str]:
    known = [(*r.off_mm, *r.off_deg) for r in fine if r.off_mm and r.off_deg]
    if not known:
        return []
    table = np.array(known)
    lines = ["the real tool off the nominal one, by the model, with the numbers as written"]
    for label, k, factor in (
        ("before [mm]", 0, 1.0), ("after [um]", 1, 1e3), ("before [mdeg]", 2, 1e3), ("after [mdeg]", 3, 1e3),
    ):  # fmt: skip
        lines.append(mean_and_max(label, factor * table[:, k]))
    lines[0] = f"{lines[0]}: mean, max"
    return lines


def assumptions(corrected: CorrectedProgram, cell: c.Cell) -> list[str]:
    """What was assumed, in words."""
    lines = [
        "the controller's own absolute-accuracy option is off, and joint values are the readings of the robot file"
    ]
    results, identity = corrected.results, np.eye(4)
    if any(not r.target.joints for r in results if r.fine):
        for what, T, of in (("root frame", cell.root, "base frame"), ("flange", cell.flange, "last link's frame")):
            if np.array_equal(T, identity):
                lines.append(f"the controller's {what} is the robot file's {of}")
    if any(r.target.joints and (r.target.tool is None or cell.sources is None) for r in results if r.fine):
        held = "the tool of the export" if cell.sources is None else "the tool of the robot file"
        lines.append(f"where joint targets have no known tool, {held} is held")
    return lines
