"""The command `casadical correct`."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Context, Option

from casadical.cli import options as o
from casadical.cli.terminal import print_result, save, suggest, suggest_later, with_json, wrapped

Frames = Annotated[
    list[str] | None,
    Option(
        metavar="[NAME=]NUMBERS",
        help="The numbers of a tool or base as the controller shows them, with commas, where the program does not hold "
        "them; NAME is its number or name in the program, without it the only one. Repeat it for others.",
    ),
]
Pose = Annotated[
    str | None,
    Option(
        metavar="NUMBERS",
        help="The controller's root frame in the robot file's base frame, its flange in the last link's frame; "
        "default: the same.",
    ),
]


def correct(
    context: Context,
    model: Path = Argument(
        ...,
        metavar="DIR_OR_MODEL",
        callback=o.robot_of,
        help="A folder that `casadical export c` wrote, a robot file, or a folder of results.",
    ),
    program: Path = Argument(
        ...,
        metavar="PROGRAM",
        help="A CSV with joint targets q1_deg .. (or q1_rad .., Joint 1 [deg] ..; q1_mm or q1_m of "
        "a linear joint), or a program of KUKA (.src, .dat), ABB (.mod), Universal Robots "
        "(.script) or FANUC (.ls).",
    ),
    out: Path = Option(..., metavar="FILE", help="Where the corrected program goes."),
    nominal: o.Nominal = None,
    compensator: o.Compensator = None,
    steps: o.Steps = None,
    what: o.What = "position",
    payload: o.Payload = None,
    tool: str | None = Option(None, metavar="shared|own", help="As in `casadical export c`; default: shared."),
    leave_out: o.LeaveOut = False,
    trust: bool = Option(False, "--trust", help="Compile and run a folder's C from elsewhere."),
    tcp: Frames = None,
    base: Frames = None,
    root: Pose = None,
    flange: Pose = None,
    data: list[Path] | None = Option(
        None, metavar="FILE", help="Another file of the program, with tools and bases; repeatable."
    ),
    nearest: bool = Option(
        False,
        "--nearest",
        help="A pose without a configuration is reached as near as possible to the target before it in the file.",
    ),
    external_still: bool = Option(
        False, "--external-still", help="External axes carry neither the robot nor its bases."
    ),
    leave_unreached: bool = Option(
        False,
        "--leave-unreached",
        help="Leave poses that the nominal robot does not reach, and correct the others; for right frames only.",
    ),
    accuracy_off: bool = Option(
        False, "--accuracy-off", help="The controller's own absolute accuracy is switched off."
    ),
    overwrite: o.Overwrite = False,
    details: o.Details = False,
    json_file: o.Json = None,
    quiet: o.Quiet = False,
) -> None:
    """Rewrite the targets of a program so that the real tool reaches the nominal tool's positions, or poses.

    Every target gets a status; one whose status is not OK keeps its numbers and is listed. A folder has
    the options of its export; with a robot file, give --nominal and the other options of `casadical export c`.
    A program in a controller's language gets a report next to it, FILE.correction.csv; every other byte stays.
    Nothing is written while poses are not reached: then the controller's frames differ from those of the robot file.

    Example: casadical correct results/SKCM.robot.toml program.csv --nominal robot.toml --out corrected.csv

    Exit codes: 0 written, with or without refused targets; 2 bad input, or poses that are not reached; 70 a bug in
    casadical.
    """
    from casadical.export.controller.commands import Sources
    from casadical.export.controller.programs.csv_table import CsvTable
    from casadical.export.controller.programs.program import correct_file, language_of

    o.refuse_taken(out, overwrite)
    # Parameters that only one kind of robot, or of program, has.
    model_options = {
        "a robot file": ["nominal", "compensator", "steps", "what", "payload", "tool", "leave_out", "root", "flange"],
        "a folder, which was exported with it": ("trust",),
    }
    o.refuse_of_others(context, [*model_options][model.is_dir()], model_options)
    program_options = {
        "a program in a controller's language": (
            ["tcp", "base", "root", "flange", "data", "nearest", "external_still", "leave_unreached", "accuracy_off"]
        ),
        "a CSV": (),
    }
    o.refuse_of_others(context, [*program_options][isinstance(language_of(program), CsvTable)], program_options)
    sources = Sources(model, nominal, compensator, payload, tool or "shared", leave_out)  # type: ignore[arg-type]
    made = correct_file(
        sources,
        program,
        out,
        steps=steps or 2,
        correct=what,
        trust=trust,
        tcp=tcp or (),
        base=base or (),
        root=root,
        flange=flange,
        data=data or (),
        nearest=nearest,
        external_still=external_still,
        leave_unreached=leave_unreached,
        accuracy_off=accuracy_off,
    )
    console = wrapped(quiet)
    print_result(console, made.blocks(), details)
    save(with_json(made.texts, json_file, made.to_json()), console)
    if model.is_file():
        suggest_later(console, model)
    else:
        command = ("correct", model, "next.csv", "--out", "next-corrected.csv")
        suggest(console, "for the next program", *command)
