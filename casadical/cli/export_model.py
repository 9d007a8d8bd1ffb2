"""The commands `casadical export mjcf` and `casadical export urdf`."""

from pathlib import Path
from typing import Annotated

import typer

from casadical.cli.options import Effects, Json, LeaveOut, Nominal, Overwrite, Quiet
from casadical.cli.progress import working
from casadical.cli.terminal import plain, print_written, refuse_taken, with_json
from casadical.core.errors import InputError

_Source = Annotated[
    Path,
    typer.Argument(
        metavar="PROBLEM_DIR_OR_ROBOT.toml", help="A problem folder, which is calibrated, or a calibrated robot file."
    ),
]
_Out = Annotated[Path, typer.Option(metavar="FILE", help="Where the model goes.")]


def export_mjcf(
    source: _Source,
    out: _Out,
    campaign: Annotated[
        Path | None,
        typer.Option(
            metavar="CAMPAIGN.csv",
            help="Measured positions: the robot is calibrated from them and diagnosed, and the "
            "causes found go into the model.",
        ),
    ] = None,
    effects: Effects = None,
    into: Annotated[
        Path | None,
        typer.Option(
            metavar="YOURS.xml",
            help="A MuJoCo model of the nominal robot: its bodies get the calibrated geometry, the rest stays. Needs "
            "--joints.",
        ),
    ] = None,
    joints: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES", help="Names of the arm's joints in YOURS.xml, from the base to the tool, by commas."
        ),
    ] = None,
    springs: Annotated[
        bool, typer.Option("--springs", help="With --into: a spring beside each compliant joint, NAME_spring.")
    ] = False,
    nominal: Nominal = None,
    leave_out: LeaveOut = False,
    overwrite: Overwrite = False,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Write a calibrated robot as a MuJoCo model: geometry, masses, joint springs, closed loops, diagnosed effects.

    Example: casadical export mjcf problems/hh800 --campaign CAMPAIGN.csv --out hh800.xml

    Exit codes: 0 written, 2 bad input, 3 no optimum found, 70 a bug in casadical.
    """
    from casadical.core.files import write_together
    from casadical.export.mjcf.mjcf import mjcf
    from casadical.export.mjcf.sources import into_users, robot_to_write
    from casadical.export.omission import left_out

    refuse_taken(out, overwrite)
    if (into is None) != (joints is None) or (into is None and (springs or nominal)):
        raise InputError("--into and --joints belong together; --springs and --nominal belong to them")
    with working(quiet, "calibrating") as show:
        robot, _ = robot_to_write(source, campaign, effects, show)
    made = mjcf(robot) if into is None else into_users(source, campaign, nominal, robot, into, joints or "", springs)
    lines = (*left_out(robot, made.omitted, "a MuJoCo model", leave_out), *made.notes)
    kept = {"file": str(out), "robot": robot.name, "written": list(made.written), "left_out": list(lines)}
    write_together(with_json({out: made.text}, json_file, kept))
    console = plain(quiet)
    for text in made.written:
        console.print(f"effect {text}")
    for text in lines:
        console.print(f"LEFT OUT {text}")
    console.print(f"wrote {out}: {robot.name}, {robot.n} joints")
    print_written(json_file, console)


def export_urdf(
    source: _Source,
    out: _Out,
    leave_out: LeaveOut = False,
    overwrite: Overwrite = False,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Write a calibrated robot as a URDF: the problem's own URDF with new numbers, or a new one if it has none.

    A URDF holds geometry and masses, but no springs and effects: what that costs is printed in millimetres. For closed
    loops use `export mjcf`.

    Example: casadical export urdf results/SKCM.robot.toml --out arm.urdf

    Exit codes: 0 written, 2 bad input, 3 no optimum found, 70 a bug in casadical.
    """
    from casadical.core.files import write_together
    from casadical.effects.counterparts import Omission
    from casadical.export.mjcf.sources import calibrated, robot_to_write
    from casadical.export.omission import geometry_alone, left_out, rest_of_rigid
    from casadical.robot.urdf import new_urdf

    refuse_taken(out, overwrite)
    into, figures = None, None
    with working(quiet, "calibrating"):
        if source.is_dir():
            calibration = calibrated(source)
            robot, into, figures = calibration.robot, calibration.problem.urdf, geometry_alone(calibration)
        else:
            robot, _ = robot_to_write(source)
    omissions = [Omission(e.label, "a URDF holds geometry and masses only") for e in robot.effects]
    lines = (*left_out(robot, omissions, "a URDF", leave_out), *rest_of_rigid(robot))
    text = calibration.problem.calibrated_urdf(robot) if into else new_urdf(robot)
    kept = {"file": str(out), "robot": robot.name, "into": into[0].name if into else None, "left_out": list(lines)}
    write_together(with_json({out: text}, json_file, {**kept, "mean_errors": figures}))
    console = plain(quiet)
    for line in lines:
        console.print(f"LEFT OUT {line}")
    if not lines:
        console.print("nothing is left out: the robot is rigid and has no effects")
    if figures:
        poses = "held-out poses" if figures["set"] == "report" else "poses that were identified from"
        console.print(
            f"mean error at {figures['poses']} {poses}: nominal, base and tool fitted, {figures['nominal_mm']:.3f} mm; "
            f"this URDF alone {figures['geometry_mm']:.3f} mm; the whole model {figures['model_mm']:.3f} mm"
        )
    if lines:
        console.print(
            "a robot that is calibrated as rigid (method KM) loses less as a URDF; `export mjcf` keeps the springs"
        )
    console.print(f"wrote {out}: {robot.name}, {robot.n} joints" + (f", after {into[0].name}" if into else ""))
    print_written(json_file, console)
