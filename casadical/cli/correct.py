"""The command `casadical correct`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from casadical.cli.options import (
    Compensator,
    Json,
    LeaveOut,
    Limit,
    Nominal,
    Overwrite,
    Payload,
    Quiet,
    What,
    poses_of,
    unreached,
    wants_pose,
)
from casadical.cli.terminal import plain, refuse_taken, with_json
from casadical.core.errors import InputError

if TYPE_CHECKING:
    from casadical.export.controller.commands import Sources
    from casadical.export.controller.correction import Corrector
    from casadical.export.controller.programs.correction import Cell
    from casadical.export.controller.programs.program import TargetProgram

_Frames = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[NAME=]NUMBERS",
        help="The numbers of a tool or base as the controller shows them, with commas, where the program does not hold "
        "them; NAME is its number or name in the program, without it the only one. Repeat it for others.",
    ),
]
_Pose = Annotated[
    str | None,
    typer.Option(
        metavar="NUMBERS",
        help="The controller's root frame in the robot file's base frame, its flange in the last link's frame; "
        "default: the same.",
    ),
]


def correct(
    model: Annotated[
        Path, typer.Argument(metavar="DIR_OR_MODEL", help="A folder that `casadical export c` wrote, or a robot file.")
    ],
    program: Annotated[
        Path,
        typer.Argument(
            metavar="PROGRAM",
            help="A CSV with joint targets q1_deg .. (or q1_rad ..; q1_mm or q1_m of a linear joint), or a program of "
            "KUKA (.src, .dat), ABB (.mod), Universal Robots (.script) or FANUC (.ls).",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the corrected program goes.")],
    nominal: Nominal = None,
    compensator: Compensator = None,
    steps: Annotated[
        int | None, typer.Option(min=1, max=10, help="Least-squares steps of the correction; default: 2.")
    ] = None,
    what: What = "position",
    limit: Limit = None,
    payload: Payload = None,
    tool: Annotated[
        str | None, typer.Option(metavar="shared|own", help="As in `casadical export c`; default: shared.")
    ] = None,
    leave_out: LeaveOut = False,
    trust: Annotated[
        bool, typer.Option("--trust", help="Compile and run the C of a folder that you did not export on this machine.")
    ] = False,
    tcp: _Frames = None,
    base: _Frames = None,
    root: _Pose = None,
    flange: _Pose = None,
    data: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Another file of the program, with tools and bases. Repeat it for others."),
    ] = None,
    nearest: Annotated[
        bool,
        typer.Option(
            "--nearest",
            help="A pose without a configuration is reached as near as possible to the target before it in the file.",
        ),
    ] = False,
    external_still: Annotated[
        bool, typer.Option("--external-still", help="External axes carry neither the robot nor its bases.")
    ] = False,
    accuracy_off: Annotated[
        bool, typer.Option("--accuracy-off", help="The controller's own absolute accuracy has been switched off.")
    ] = False,
    overwrite: Overwrite = False,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Rewrite the targets of a program so that the real tool reaches the nominal tool's positions, or poses.

    Every target gets a status; one whose status is not OK keeps its numbers and is listed. A folder has
    the options of its export; with a robot file, give --nominal and the other options of `casadical export c`.
    A program in a controller's language gets a report beside it, FILE.correction.csv; every other byte stays.

    Example: casadical correct results/SKCM.robot.toml program.csv --nominal robot.toml --out corrected.csv

    Exit codes: 0 written, with or without refused targets; 2 bad input; 70 a bug in casadical.
    """
    from casadical.export.controller.commands import bound_of, followed, measured_range
    from casadical.robot.robot_file import read_robot

    refuse_taken(out, overwrite)
    oriented = wants_pose(what)
    if not model.exists():
        raise InputError(f"{model}: no such folder or robot file")
    corrector = sources = None
    lines: tuple[str, ...] = ()
    if model.is_dir():
        decided: dict[str, Any] = {
            "--nominal": nominal,
            "--compensator": compensator,
            "--payload": payload,
            "--steps": steps,
            "--correct": None if what == "position" else what,
            "--limit": limit,
            "--tool": tool,
            "--leave-out": leave_out or None,
            "--root": root,
            "--flange": flange,
        }
        corrector = _of_folder(model, decided, trust)
    else:
        sources = _of_robot(model, nominal, compensator, payload, tool, leave_out, trust)
        lines = tuple(f"LEFT OUT {line}" for line in followed(sources)[1])
        about = read_robot(model)
        lines += tuple(filter(None, [poses_of(about) if oriented else "", unreached(about)]))
        lines += measured_range(about)
        lines += tuple(f"NO BOUND of the error that remains: {why}" for why in [bound_of(sources)[1]] if why)
    of_language = {"--tcp": tcp, "--base": base, "--root": root, "--flange": flange, "--data": data}
    flags = {"--nearest": nearest, "--external-still": external_still, "--accuracy-off": accuracy_off}
    console = plain(quiet)
    if program.suffix.lower() == ".csv":
        for option, value in {**of_language, **flags}.items():
            if value:
                raise InputError(f"{option}: is for programs in a controller's language; {program} is a CSV")
        texts = _correct_table(program, out, json_file, corrector, sources, steps or 2, oriented, limit)
    else:
        from casadical.export.controller.programs.correction import Cell

        read, frames = _read(program, Cell(sources, folder=corrector).units, tcp, base, root, flange, data)
        cell = Cell(
            sources,
            steps or 2,
            oriented,
            limit,
            root=frames[0],
            flange=frames[1],
            nearest=nearest,
            external_still=external_still,
            folder=corrector,
        )
        texts = _correct_program(read, out, json_file, cell, accuracy_off)
    for text in (*texts, *lines):
        console.print(text)
    if model.is_dir():
        console.print(_stated(model))
    for path in filter(None, (out, json_file)):
        console.print(f"wrote {path}")


def _of_folder(folder: Path, given: dict[str, Any], trust: bool) -> Corrector:
    from casadical.export.controller.correction import kernel_corrector

    for option, value in given.items():
        if value is not None:
            raise InputError(f"{option} was decided when {folder} was exported; give it with a robot file only")
    return kernel_corrector(folder, trust=trust)


def _of_robot(
    model: Path,
    nominal: Path | None,
    compensator: Path | None,
    payload: float | None,
    tool: str | None,
    leave_out: bool,
    trust: bool,
) -> Sources:
    from casadical.export.controller.commands import Sources

    if trust:
        raise InputError(f"--trust: is for a folder with C; {model} is a file, and nothing is compiled")
    return Sources(model, nominal, compensator, payload, tool or "shared", leave_out)  # type: ignore[arg-type]


def _correct_table(
    program: Path,
    out: Path,
    json_file: Path | None,
    corrector: Corrector | None,
    sources: Sources | None,
    steps: int,
    oriented: bool,
    limit: float | None,
) -> list[str]:
    """Write the corrected CSV; what to print."""
    from casadical.core.files import write_together
    from casadical.export.controller.commands import command_of
    from casadical.export.controller.correction import corrected, model_corrector
    from casadical.export.controller.offline_program import read_program

    if corrector is None:
        assert sources is not None
        instead = model_corrector(command_of(sources, steps, limit_mm=limit)) if oriented else None
        corrector = model_corrector(command_of(sources, steps, orientation=oriented, limit_mm=limit), instead)
    result = corrected(corrector, read_program(program, corrector.joints, corrector.units))
    write_together(with_json({out: result.to_csv()}, json_file, result.to_json()))
    return [result.report()]


def _read(
    program: Path,
    units: tuple[str, ...],
    tcp: list[str] | None,
    base: list[str] | None,
    root: str | None,
    flange: str | None,
    data: list[Path] | None,
) -> tuple[TargetProgram, list[Any]]:
    """The program, and the transforms of root and flange."""
    import numpy as np

    from casadical.core.files import read_bytes
    from casadical.export.controller.programs.language import text_of
    from casadical.export.controller.programs.program import read_target_program
    from casadical.export.controller.programs.registry import language_of
    from casadical.export.controller.programs.target import Given

    language = language_of(program)

    def named(option: str, entries: list[str] | None) -> dict[str, Any]:
        pairs = [entry.rpartition("=")[::2] for entry in entries or []]
        return {name.strip(): language.transform(option, numbers) for name, numbers in pairs}

    texts = {str(path): text_of(str(path), read_bytes(path)) for path in data or []}
    given = Given(named("--tcp", tcp), named("--base", base), texts, units)
    read = read_target_program(program, given, len(units))
    poses = (("--root", root), ("--flange", flange))
    return read, [np.eye(4) if text is None else language.transform(option, text) for option, text in poses]


def _correct_program(
    read: TargetProgram, out: Path, json_file: Path | None, cell: Cell, accuracy_off: bool
) -> list[str]:
    """Write the corrected program and its report; what to print."""
    from casadical.core.files import write_together
    from casadical.export.controller.programs.correction import refuse_accuracy
    from casadical.export.controller.programs.program import assumptions, corrected_program, report_of

    if not accuracy_off:
        refuse_accuracy(read.source, list(read.targets))
    result = corrected_program(read, cell)
    files: dict[Path, Any] = {out: result.content(), report_of(out): result.to_csv()}
    write_together(with_json(files, json_file, result.to_json()))
    said = [f"ASSUMED {line}" for line in assumptions(result, cell)]
    return [result.report(), *said, f"wrote {report_of(out)}"]


def _stated(folder: Path) -> str:
    """The remaining error that was measured when a folder was exported."""
    from casadical.export.c.manifest import read_manifest

    figures = read_manifest(folder).figures
    median, worst = figures.get("rest_um_median"), figures.get("rest_um_worst")
    if median is None or worst is None:
        return "remaining error: not measured"
    return f"remaining error, measured at export on random poses: median {median:g} um, worst {worst:g} um"
