"""A program corrected, file for file: a CSV of joint targets or one in a controller's language."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from casadical.core.basics import Array
from casadical.core.reading import missing, read_bytes
from casadical.export.c.manifest import read_manifest
from casadical.export.controller.c_export import no_bound, poses_of, unreached, wants_pose
from casadical.export.controller.commands import Sources, Tool, about_tool, followed, measured_range, robot_of
from casadical.export.controller.correction import kernel_corrector
from casadical.export.controller.programs.correction import Cell, refuse_accuracy
from casadical.export.controller.programs.language import ProgramLanguage, text_of
from casadical.export.controller.programs.program import assumptions, corrected_program, read_target_program, report_of
from casadical.export.controller.programs.registry import language_of
from casadical.export.controller.programs.target import Given


@dataclass(frozen=True)
class WithRobot:
    """What a correction by robot files needs; in a folder of an export all of it was decided. None: the usual.

    As of `Sources` and `command_of`; correct : position or pose
    """

    nominal: Path | None = None
    compensator: Path | None = None
    payload: float | None = None
    steps: int | None = None
    correct: str = "position"
    limit: float | None = None
    tool: str | None = None
    leave_out: bool = False
    tcp_mm: float | None = None

    def sources(self, model: Path) -> Sources:
        tool = cast(Tool, self.tool or "shared")
        return Sources(model, self.nominal, self.compensator, self.payload, tool, self.leave_out, self.tcp_mm)


@dataclass(frozen=True)
class OfLanguage:
    """What a program in a controller's language does not say of its frames.

    tcp, base : numbers of tools and bases, NAME=NUMBERS, as the controller shows them; data : files that hold more
    root, flange : the controller's frames in those of the robot file
    nearest, external_still, leave_unreached : as of `Cell`
    accuracy_off : whether the controller's own absolute accuracy is off
    """

    tcp: Sequence[str] | None = None
    base: Sequence[str] | None = None
    root: str | None = None
    flange: str | None = None
    data: Sequence[Path] | None = None
    nearest: bool = False
    external_still: bool = False
    leave_unreached: bool = False
    accuracy_off: bool = False


@dataclass(frozen=True, eq=False)
class CorrectedFile:
    """A corrected program: what to say of it, its files, and its figures as plain data."""

    lines: tuple[str, ...]
    files: Mapping[Path, str | bytes]
    figures: Mapping[str, Any] = field(default_factory=dict)


def correct_file(
    model: Path,
    program: Path,
    out: Path,
    robot: WithRobot | None = None,
    language: OfLanguage | None = None,
    *,
    trust: bool = False,
) -> CorrectedFile:
    """Correct the targets of a program so that the real tool reaches what the nominal one would.

    model : folder that `write_c` wrote, or a robot file; out : where the corrected program is to be
    trust : whether C of a folder that was exported elsewhere is compiled and run
    Raises InputError.
    """
    robot, language = robot or WithRobot(), language or OfLanguage()
    oriented = wants_pose(robot.correct)
    if not model.exists():
        raise missing(model, "folder or robot file")
    folder = kernel_corrector(model, trust=trust) if model.is_dir() else None
    sources = None if folder else robot.sources(model)
    spoken = language_of(program)
    cell = Cell(
        sources,
        robot.steps or 2,
        oriented,
        robot.limit,
        root=_frame(spoken, "--root", language.root),
        flange=_frame(spoken, "--flange", language.flange),
        nearest=language.nearest,
        external_still=language.external_still,
        leave_unreached=language.leave_unreached,
        folder=folder,
    )
    texts = {str(path): text_of(str(path), read_bytes(path)) for path in language.data or []}
    tools, bases = (_transforms(spoken, f"--{k}", v) for k, v in (("tcp", language.tcp), ("base", language.base)))
    read = read_target_program(program, Given(tools, bases, texts, cell.units), len(cell.units))
    if not language.accuracy_off:
        refuse_accuracy(read.source, read.targets)
    result = corrected_program(read, cell)
    said = _of_sources(sources, oriented) if sources else [_stated(model)]
    lines = (result.report(), *(f"ASSUMED {line}" for line in assumptions(result, cell)), *said)
    beside: dict[Path, str | bytes] = {report_of(out): result.to_csv()} if spoken.report_beside else {}
    return CorrectedFile(lines, {**beside, out: result.content()}, result.to_json())


def _of_sources(sources: Sources, oriented: bool) -> list[str]:
    """What is said of the robot files that a correction is made from."""
    robot = robot_of(sources.robot)
    lines = [f"LEFT OUT {line}" for line in followed(sources)[1]]
    lines += filter(None, [poses_of(robot) if oriented else "", unreached(robot)])
    return [*lines, *measured_range(robot), *about_tool(sources), *no_bound(sources)]


def _transforms(language: ProgramLanguage, option: str, entries: Sequence[str] | None) -> dict[str, Array]:
    pairs = [entry.rpartition("=")[::2] for entry in entries or []]
    return {name.strip(): language.transform(option, numbers) for name, numbers in pairs}


def _frame(language: ProgramLanguage, option: str, text: str | None) -> Array:
    return np.eye(4) if text is None else language.transform(option, text)


def _stated(folder: Path) -> str:
    """The remaining error that was measured when a folder was exported."""
    figures = read_manifest(folder).figures
    median, worst = figures.get("rest_um_median"), figures.get("rest_um_worst")
    if median is None or worst is None:
        return "remaining error: not measured"
    return f"remaining error, measured at export on random poses: median {median:g} um, worst {worst:g} um"
