"""The commands `casadical export c` and `casadical export model`."""

from pathlib import Path

from typer import Argument, Context, Option

from casadical.cli import options as o
from casadical.cli import terminal as t


def export_c(
    context: Context,
    robot: Path = Argument(
        ..., metavar="ROBOT.toml", callback=o.robot_of, help="Calibrated robot file, or its folder."
    ),
    out: Path = Option(..., "--out", metavar="DIR", help="Folder for the files; other files in it stay."),
    what: str = Option(
        "command",
        "--what",
        metavar="network|command|curves",
        help="The network alone, the correction of joint commands, or the joints' error curves alone.",
    ),
    nominal: o.Nominal = None,
    compensator: o.Compensator = None,
    real: str = Option("double", metavar="float|double", help="Number type of the C."),
    steps: o.Steps = None,
    correct: o.What = "position",
    cycle: float | None = Option(None, metavar="MS", help="Time between two calls of NAME_step [ms]; default: 4."),
    rate: float | None = Option(
        None, metavar="RAD_PER_S", help="Largest rate of a joint's correction; default: 0.5 rad/s."
    ),
    ramp: float | None = Option(None, metavar="S", help="Time to switch on or off [s]; default: 1."),
    payload: o.Payload = None,
    tool: o.Tool = "shared",
    leave_out: o.LeaveOut = False,
    name: str | None = Option(
        None, "--name", metavar="PREFIX", help="Prefix of C names and files; default: robot's name."
    ),
    language: str | None = Option(
        None,
        "--language",
        metavar="NAMES",
        autocompletion=o.languages,
        help="Languages to write besides the C, by commas; default: structured text.",
    ),
    overwrite: bool = Option(
        False, "--overwrite", help="Replace files that were changed, or not written by casadical."
    ),
    details: o.Details = False,
    json_file: o.Json = None,
    quiet: o.Quiet = False,
) -> None:
    """Write guarded C99 for a controller; it is compiled and compared with its reference before it is stored.

    Precondition: the controller's own absolute-accuracy option is off.

    Example: casadical export c results/SKCM.robot.toml --nominal robot.toml --out c

    Exit codes: 0 done, 2 bad input, 70 a bug in casadical.
    """
    from casadical.export.controller import commands

    # Parameters that only some products have.
    product_options = {
        "--what command": [
            *("nominal", "compensator", "steps", "correct", "payload", "tool", "leave_out"),
            *("cycle", "rate", "ramp"),
        ],
        "--what network": ("compensator",),
        "--what curves": (),
    }
    if (product := f"--what {what}") in product_options:
        o.refuse_of_others(context, product, product_options)
    times = {"cycle_s": None if cycle is None else 1e-3 * cycle, "rate_rad_s": rate, "ramp_s": ramp}
    written = commands.export_c(
        commands.Sources(robot, nominal, compensator, payload, tool, leave_out),  # type: ignore[arg-type]
        out,
        what,
        steps=steps or 2,
        correct=correct,
        limits={key: value for key, value in times.items() if value is not None},
        name=name,
        real=real,
        languages=language.split(",") if language else None,
        overwrite=overwrite,
        also=lambda written: t.with_json({}, json_file, written.to_json()),
    )
    console = t.wrapped(quiet)
    t.print_result(console, written.blocks(), details)
    t.print_written(json_file, console)
    if what == "command":
        command = ("correct", out, "program.csv", "--out", "corrected.csv")
        t.suggest(console, "to correct an offline program by it", *command)
    else:
        words = ("export", "c", robot, "--nominal", "robot.toml", "--out", "c")
        t.suggest(console, "to have the correction of joint commands", *words)


def export_model(
    source: Path = Argument(
        ...,
        metavar="PROBLEM_DIR_OR_ROBOT.toml",
        callback=o.robot_of,
        help="A problem folder, which is calibrated, a calibrated robot file, or a folder of results.",
    ),
    out: Path = Option(..., metavar="FILE", help="Where the model goes."),
    form: str | None = Option(
        None,
        "--to",
        metavar="FORM",
        autocompletion=o.forms,
        help="mjcf (MuJoCo), urdf; actuators (JSON of the drives by joint names); kinematics of "
        "a driver: ur (YAML of the UR ROS 2 description), standard_dh, modified_dh (CSV), "
        "xacro (properties of joint origins). Default: by the ending of FILE.",
    ),
    nominal: o.Nominal = None,
    campaign: Path | None = Option(
        None,
        metavar="CAMPAIGN.csv",
        help="For mjcf: measured positions, from which the robot is calibrated and diagnosed; "
        "the causes found go into the model. Or a joint log, which the model replays in MuJoCo.",
    ),
    effects: o.Effects = None,
    into: Path | None = Option(
        None,
        metavar="YOURS.xml",
        help="For mjcf: a MuJoCo model of the nominal robot: its bodies get the calibrated "
        "geometry, the rest stays. Needs --joints.",
    ),
    joints: str | None = Option(
        None, metavar="NAMES", help="The arm's joints in YOURS.xml, from base to tool, by commas."
    ),
    springs: bool = Option(False, "--springs", help="With --into: a spring next to each compliant joint, NAME_spring."),
    checksum: str = Option(
        "", "--hash", metavar="WORD", help="For ur: hash of the controller's calibration, calib_..."
    ),
    leave_out: o.LeaveOut = False,
    overwrite: o.Overwrite = False,
    details: o.Details = False,
    json_file: o.Json = None,
    quiet: o.Quiet = False,
) -> None:
    """Write a calibrated robot as another program reads it: a MuJoCo model, a URDF, a driver's kinematics.

    A MuJoCo model holds geometry, masses, joint springs, closed loops and diagnosed effects, and,
    where [drive] of the robot file says how joints follow their commands, their motion; a URDF
    geometry, masses, damping and friction; a driver's kinematics the geometry. What that leaves out
    is printed in millimetres.

    Example: casadical export model results/SKCM.robot.toml --out arm.urdf

    Exit codes: 0 written, 2 bad input, 3 no optimum found, 70 a bug in casadical.
    """
    from casadical.export.model_file import form_of, robot_model

    o.refuse_taken(out, overwrite)
    with t.working(quiet, "reading") as show:
        made = robot_model(
            source,
            form_of(form, out),
            nominal=nominal,
            campaign=campaign,
            effects=effects,
            into=into,
            joints=joints,
            springs=springs,
            checksum=checksum,
            leave_out=leave_out,
            show=show,
        )
    console = t.wrapped(quiet)
    t.print_result(console, made.blocks(), details)
    t.save(
        t.with_json({out: made.text}, json_file, {"file": str(out), **made.to_json()}),
        console,
        {out: made.about},
    )
    if source.is_dir():
        command = ("calibrate", source, "--out", "results")
        t.suggest(console, "to keep the robot file and its accuracy", *command)
    else:
        t.suggest_later(console, source)
