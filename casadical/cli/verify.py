"""The command `casadical verify`."""

from pathlib import Path
from typing import Annotated

import typer

from casadical.cli.options import Json, Quiet
from casadical.cli.progress import working
from casadical.cli.terminal import NOT_VALID, keep_json, wrapped
from casadical.core.telling.terminal import terminal


def verify(
    robot: Annotated[
        Path,
        typer.Argument(
            metavar="ROBOT.toml",
            help="A calibrated robot, as `casadical calibrate --out` writes it, or that folder (the method that "
            "counts).",
        ),
    ],
    tables: Annotated[
        list[Path],
        typer.Argument(
            metavar="TEN.csv...",
            help="Some ten poses measured later, in any usual form; several count together.",
        ),
    ],
    promised_mm: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            metavar="MM",
            help="Promised rms position error as the instrument reads it, its noise included; default: of the held-out "
            "poses, from result.json or diagnosis.json beside the robot file.",
        ),
    ] = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Check with a few poses whether a calibrated robot still is as accurate as it was.

    Base and tool are fitted again, because the instrument stands elsewhere. The rms error is compared with that of the
    held-out poses of the calibration.

    Example: casadical verify results/KM.robot.toml ten.csv

    Exit codes: 0 still valid, 2 bad input, 3 no optimum found, 5 no longer valid, 70 a bug in casadical.
    """
    from casadical.project import verification

    console = wrapped(quiet)
    with working(quiet, "fitting base and tool", tables[0].name):
        found = verification.verify(robot, tables, promised_mm)
    console.print(terminal(found.blocks()))
    keep_json(json_file, found.to_json(), console)
    if not found.valid:
        raise typer.Exit(NOT_VALID)
