"""The command `casadical correct`."""

from pathlib import Path
from typing import Annotated

import typer

from casadical.cli.options import Compensator, Json, LeaveOut, Nominal, Overwrite, Payload, Quiet
from casadical.cli.terminal import plain, refuse_taken, with_json
from casadical.core.errors import InputError


def correct(
    model: Annotated[
        Path, typer.Argument(metavar="DIR_OR_MODEL", help="A folder that `casadical export c` wrote, or a robot file.")
    ],
    program: Annotated[
        Path, typer.Argument(metavar="PROGRAM.csv", help="Joint targets q1_deg .. (or q1_rad ..), and other columns.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE.csv", help="Where the corrected program goes.")],
    nominal: Nominal = None,
    compensator: Compensator = None,
    steps: Annotated[
        int | None, typer.Option(min=1, max=10, help="Least-squares steps of the correction; default: 2.")
    ] = None,
    payload: Payload = None,
    tool: Annotated[
        str | None, typer.Option(metavar="shared|own", help="As in `casadical export c`; default: shared.")
    ] = None,
    leave_out: LeaveOut = False,
    trust: Annotated[
        bool, typer.Option("--trust", help="Compile and run the C of a folder that you did not export on this machine.")
    ] = False,
    overwrite: Overwrite = False,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Rewrite the joint targets of an offline program so that the real tool reaches the nominal tool's positions.

    Every row gets a status; a row whose status is not OK keeps its targets and is listed. A folder has
    the options of its export; with a robot file, give --nominal and the other options of `casadical export c`.

    Exit codes: 0 written, with or without refused rows; 2 bad input; 70 a bug in casadical.
    """
    from casadical.core.files import write_together
    from casadical.export.controller.commands import Sources, command_of, followed
    from casadical.export.controller.correction import corrected, kernel_corrector, model_corrector
    from casadical.export.controller.offline_program import read_program

    refuse_taken(out, overwrite)
    if not model.exists():
        raise InputError(f"{model}: no such folder or robot file")
    lines: tuple[str, ...] = ()
    if model.is_dir():
        given = {
            "--nominal": nominal,
            "--compensator": compensator,
            "--payload": payload,
            "--steps": steps,
            "--tool": tool,
            "--leave-out": leave_out or None,
        }
        for option, value in given.items():
            if value is not None:
                raise InputError(f"{option} was decided when {model} was exported; give it with a robot file only")
        corrector = kernel_corrector(model, trust=trust)
    else:
        if trust:
            raise InputError(f"--trust: is for a folder with C; {model} is a file, and nothing is compiled")
        sources = Sources(model, nominal, compensator, payload, tool or "shared", leave_out)  # type: ignore[arg-type]
        corrector, (_, lines) = model_corrector(command_of(sources, steps or 2)), followed(sources)
    result = corrected(corrector, read_program(program, corrector.joints))
    write_together(with_json({out: result.to_csv()}, json_file, result.to_json()))
    console = plain(quiet)
    console.print(result.report())
    for line in lines:
        console.print(f"LEFT OUT {line}")
    if model.is_dir():
        console.print(_stated(model))
    for path in filter(None, (out, json_file)):
        console.print(f"wrote {path}")


def _stated(folder: Path) -> str:
    """The remaining error that was measured when a folder was exported."""
    from casadical.export.c.manifest import read_manifest

    figures = read_manifest(folder).figures
    median, worst = figures.get("rest_um_median"), figures.get("rest_um_worst")
    if median is None or worst is None:
        return "remaining error: not measured"
    return f"remaining error, measured at export on random poses: median {median:g} um, worst {worst:g} um"
