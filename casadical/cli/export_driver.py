"""The command `casadical export driver`."""

from pathlib import Path
from typing import Annotated

import typer

from casadical.cli.options import NOMINAL, Json, Overwrite, Quiet
from casadical.cli.terminal import plain, refuse_taken, with_json


def export_driver(
    robot: Annotated[Path, typer.Argument(metavar="ROBOT.toml", help="A calibrated robot file.")],
    nominal: Annotated[Path, NOMINAL],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the kinematics go.")],
    form: Annotated[
        str,
        typer.Option(
            metavar="ur|standard_dh|modified_dh|xacro",
            help="Kinematics YAML of the UR ROS 2 description, a DH table as CSV, or properties of joint origins.",
        ),
    ] = "ur",
    checksum: Annotated[
        str,
        typer.Option("--hash", metavar="WORD", help="For ur: the hash of the controller's own calibration, calib_..."),
    ] = "",
    overwrite: Overwrite = False,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Write the calibrated geometry as a driver or a controller reads it, and what is left out, in millimetres.

    Example: casadical export driver results/SKCM.robot.toml --nominal robot.toml --form standard_dh --out dh.csv

    Exit codes: 0 written; 2 bad input; 70 a bug in casadical.
    """
    from casadical.core.files import write_together
    from casadical.export.controller.commands import Sources
    from casadical.export.controller.drivers import driver_file

    refuse_taken(out, overwrite)
    made = driver_file(Sources(robot, nominal), form, checksum)
    kept = {"file": str(out), "form": form, "left_out": list(made.lines)}
    write_together(with_json({out: made.text}, json_file, kept))
    console = plain(quiet)
    for line in made.lines:
        console.print(f"LEFT OUT {line}")
    for path in filter(None, (out, json_file)):
        console.print(f"wrote {path}")
