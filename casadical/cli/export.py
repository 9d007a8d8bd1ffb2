"""The commands `casadical export ...`."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from casadical.cli import completion as words
from casadical.cli.export_driver import export_driver
from casadical.cli.export_model import export_mjcf, export_urdf
from casadical.cli.options import (
    Compensator,
    Json,
    LeaveOut,
    Limit,
    Nominal,
    Payload,
    Quiet,
    Tool,
    What,
    poses_of,
    unreached,
    wants_pose,
)
from casadical.cli.outputs import guarded
from casadical.cli.terminal import plain, print_written, with_json
from casadical.core.errors import InputError

if TYPE_CHECKING:
    from casadical.export import Command
    from casadical.export.controller.commands import Sources

export_app = typer.Typer(
    help="Turn a calibrated robot into code for its controller, or into a model for a simulator.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

_Steps = Annotated[int, typer.Option(min=1, max=10, help="Least-squares steps of the correction.")]


@export_app.callback()
def _group() -> None:
    pass


@export_app.command("c")
@guarded
def export_c(
    robot: Annotated[Path, typer.Argument(metavar="ROBOT.toml", help="A calibrated robot file.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files; other files in it stay.")],
    what: Annotated[
        str,
        typer.Option(
            metavar="network|command|curves",
            help="The network alone, the correction of joint commands, or the joints' error curves alone.",
        ),
    ] = "command",
    nominal: Nominal = None,
    compensator: Compensator = None,
    real: Annotated[str, typer.Option(metavar="float|double", help="Number type of the C.")] = "double",
    steps: _Steps = 2,
    correct: What = "position",
    cycle: Annotated[
        float | None, typer.Option(metavar="MS", help="Time between two calls of NAME_step [ms]; default: 4.")
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(metavar="RAD_PER_S", help="Rate at which a joint's correction may change; default: 0.5 rad/s."),
    ] = None,
    ramp: Annotated[
        float | None,
        typer.Option(metavar="S", help="Time in which the correction is switched on and off [s]; default: 1."),
    ] = None,
    precise: Annotated[
        bool,
        typer.Option(
            "--precise",
            help="Compare nominal and real robot without rounding errors of their positions, at about twice the "
            "operations: for --real float.",
        ),
    ] = False,
    limit: Limit = None,
    payload: Payload = None,
    tool: Tool = "shared",
    leave_out: LeaveOut = False,
    name: Annotated[
        str | None,
        typer.Option(metavar="PREFIX", help="Prefix of C functions and files; default: from the robot's name."),
    ] = None,
    language: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            autocompletion=words.languages,
            help="Languages to write besides the C, by commas; default: an FMU and structured text.",
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace files that casadical did not write or that were changed.")
    ] = False,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Write guarded C99 for a controller; it is compiled and compared with its reference before it is kept.

    Precondition: the controller's own absolute-accuracy option is off.

    Example: casadical export c results/SKCM.robot.toml --nominal robot.toml --out c

    Exit codes: 0 done, 2 bad input, 70 a bug in casadical.
    """
    from casadical.export import Command, write_c
    from casadical.export.controller.commands import Sources, command_of, curves_of, network_of
    from casadical.robot.robot_file import read_robot

    if what not in ("network", "command", "curves"):
        raise InputError(f"--what {what}: not known; allowed: network, command, curves")
    if real not in ("float", "double"):
        raise InputError(f"--real {real}: not known; allowed: float, double")
    if what == "network" and (nominal or payload is not None):
        raise InputError("--nominal and --payload have no part in a network alone; remove them, or give --what command")
    if what == "curves" and (nominal or compensator or payload is not None):
        raise InputError("--nominal, --compensator and --payload have no part in curves alone; remove them")
    oriented = wants_pose(correct)
    if oriented and what != "command":
        raise InputError(f"--correct {correct}: is for --what command; {what} corrects nothing")
    timing = {"cycle_s": None if cycle is None else 1e-3 * cycle, "rate_rad_s": rate, "ramp_s": ramp}
    given = {key: value for key, value in timing.items() if value is not None}
    if given and what != "command":
        raise InputError(f"--cycle, --rate and --ramp have no part in {what} alone; remove them")
    if precise and what != "command":
        raise InputError(f"--precise: is for --what command; {what} compares no robots")
    if limit is not None and what != "command":
        raise InputError(f"--limit {limit:g}: is for --what command; {what} has no bound")
    sources = Sources(robot, nominal, compensator, payload, tool, leave_out)  # type: ignore[arg-type]
    product = (
        command_of(sources, steps, orientation=oriented, limit_mm=limit, precise=precise)
        if what == "command"
        else (curves_of if what == "curves" else network_of)(sources)
    )
    if isinstance(product, Command):
        product = replace(product, limits=replace(product.limits, **given))
    try:
        written = write_c(
            product,
            out,
            name=name or prefix_of(read_robot(robot).name),
            real=real,  # type: ignore[arg-type]
            model_sha256=_sha256(robot),
            data_sha256=_sha256(compensator) if compensator else "not given",
            languages=language.split(",") if language else None,
            overwrite=overwrite,
            also=lambda written: with_json({}, json_file, written.to_json()),
        )
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror}") from error
    console = plain(quiet)
    console.print(f"{what} of {robot}, {real}")
    if oriented:
        console.print(poses_of(read_robot(robot)))
    if what == "command" and (lost := unreached(read_robot(robot))):
        console.print(lost)
    for line in _about(sources, what, getattr(product, "network", product) is not None):
        console.print(line)
    if isinstance(product, Command):
        console.print(_timing(product))
    console.print(written.report())
    console.print("precondition: the controller's own absolute-accuracy option is off")
    print_written(json_file, console)


def _timing(command: Command) -> str:
    limits = command.limits
    return (
        f"cycle {1e3 * limits.cycle_s:g} ms, rate {limits.rate_rad_s:g} rad/s, ramp {limits.ramp_s:g} s: switched on "
        f"in {limits.ramp_s / limits.cycle_s:.0f} calls of the step function"
    )


def prefix_of(name: str) -> str:
    """A C prefix from a robot's name: lower case, at most 24 characters."""
    words = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    return (words if words[:1].isalpha() else f"robot_{words}")[:24].rstrip("_")


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _about(sources: Sources, what: str, networked: bool) -> list[str]:
    """The files that the export was made from, with hashes, and the effects that are not in it."""
    from casadical.export.controller.commands import bound_of, followed, measured_range, robot_of

    files = {"robot": sources.robot, "nominal": sources.nominal, "compensator": sources.compensator}
    used = list(files) if what == "command" else ["robot", "compensator"]
    lines = [
        f"{label}: {path}, sha256 {_sha256(path)}"
        for label, path in files.items()
        if isinstance(path, Path) and label in used
    ]
    if sources.compensator and not networked:
        lines.append("the compensator was refused when it was trained: it corrects nothing and is left out")
    if what == "curves":
        lines.append("the joints' error curves alone: a joint read as q stands at q + dq, so command q - dq(q)")
    if what == "command":
        mass = "as declared" if sources.payload_kg is None else f"{sources.payload_kg:g} kg"
        lines += [f"LEFT OUT {line}" for line in followed(sources)[1]]
        lines += [f"NO BOUND of the error that remains: {why}" for why in [bound_of(sources)[1]] if why]
        lines.append("readings within the joint limits of the robot file are corrected, others are CLAMPED")
        lines += measured_range(arm := robot_of(sources.robot))
        if arm.gravity_frame == "logged":
            lines.append("LEFT OUT the tilt of the base: gravity is as the robot file declares it, the base level")
        lines.append(f"payload: {mass}; tool: {sources.tool}; positions in the robot's own base frame")
    return lines


export_app.command("mjcf")(guarded(export_mjcf))
export_app.command("urdf")(guarded(export_urdf))
export_app.command("driver")(guarded(export_driver))
