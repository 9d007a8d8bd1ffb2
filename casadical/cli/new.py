"""The command `casadical new`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from casadical.cli.options import Json, Quiet
from casadical.cli.terminal import keep_json


def new(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The new folder; nothing is overwritten.")],
    urdf: Annotated[Path | None, typer.Option(metavar="FILE", help="Take the robot from this URDF.")] = None,
    base_link: Annotated[
        str | None, typer.Option(metavar="LINK", help="First link of the arm in the URDF; default: its root.")
    ] = None,
    tip_link: Annotated[
        str | None, typer.Option(metavar="LINK", help="Last link of the arm; default: the only moving end.")
    ] = None,
    dh: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Take the robot from this table, one row per joint: a_mm, alpha_deg, d_mm, theta_deg, ...",
        ),
    ] = None,
    convention: Annotated[
        str, typer.Option(metavar="WORD", help="Convention of the DH table: modified (Craig) or standard.")
    ] = "modified",
    data: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Measured poses: q1_deg .., x_mm, y_mm, z_mm; default: synthetic ones, marked as such.",
        ),
    ] = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Write a commented problem folder that runs: from a URDF, a DH table, or as an example.

    Exit codes: 0 written, 2 bad input (then nothing was written), 70 a bug in casadical.
    """
    from casadical.project.new import new_problem

    problem = new_problem(
        folder, urdf=urdf, base_link=base_link, tip_link=tip_link, dh=dh, convention=convention, data=data
    )
    console = Console(quiet=quiet)
    files = sorted(str(p) for p in folder.iterdir() if p.is_file())
    console.print(f"{folder}: {problem.robot.name}, {problem.robot.n} joints, {problem.origin}", soft_wrap=True)
    for path in files:
        console.print(f"wrote {path}", soft_wrap=True)
    console.print(f"next: casadical check {folder}; casadical calibrate {folder}", soft_wrap=True)
    figures = {"problem": problem.folder.name, "robot": problem.robot.name, "data": problem.data, "files": files}
    keep_json(json_file, figures, console)
