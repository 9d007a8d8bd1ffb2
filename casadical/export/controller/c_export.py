"""The export of a robot file as C: what is made of it, and what must be said of the files that are written."""

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from casadical.core.basics import InputError
from casadical.core.reading import read_bytes
from casadical.export.c.coefficients import Real
from casadical.export.c.products import Command, Product
from casadical.export.c.write import Export, write_c
from casadical.export.controller import commands
from casadical.export.controller.inverse import freedom_of
from casadical.robot.robot import Robot


@dataclass(frozen=True)
class OfCommand:
    """What only the correction of a command has; as of `command_of`, and times of its step function, None: the usual.

    correct : position or pose; cycle_ms, rate_rad_s, ramp_s : as of `Limits`
    """

    steps: int = 2
    correct: str = "position"
    cycle_ms: float | None = None
    rate_rad_s: float | None = None
    ramp_s: float | None = None


def export_c(
    sources: commands.Sources,
    folder: Path,
    what: str = "command",
    asked: OfCommand | None = None,
    *,
    name: str | None = None,
    real: str = "double",
    languages: Sequence[str] | None = None,
    overwrite: bool = False,
    also: Callable[[Export], Mapping[Path, str]] = lambda _written: {},
) -> Export:
    """Write what a controller needs of a robot file, compiled and compared before it is kept.

    sources : files, not objects; what : see `product_of`; name : of C functions, None: from the robot's name
    real, languages, overwrite, also : as of `write_c`
    Raises InputError.
    """
    asked = asked or OfCommand()
    if real not in ("float", "double"):
        raise InputError(f"--real {real}: not known; allowed: float, double")
    product = product_of(sources, what, asked)
    try:
        written = write_c(
            product,
            folder,
            name=name or prefix_of(commands.robot_of(sources.robot).name),
            real=cast(Real, real),
            model_sha256=_sha256(cast(Path, sources.robot)),
            data_sha256=_sha256(sources.compensator) if isinstance(sources.compensator, Path) else "not given",
            languages=languages,
            overwrite=overwrite,
            also=also,
        )
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from error
    robot = commands.robot_of(sources.robot)
    reach = (poses_of(robot) if wants_pose(asked.correct) else "", unreached(robot) if what == "command" else "")
    lines = [f"{what} of {sources.robot}, {real}", *filter(None, reach), *_sources_in_words(sources, what, product)]
    return replace(written, about=(*lines, *_command_in_words(sources, product, robot)))


def _sources_in_words(sources: commands.Sources, what: str, product: Product) -> list[str]:
    """The files that an export was made from, with hashes, and what of them is not in it."""
    files = {"robot": sources.robot, "nominal": sources.nominal, "compensator": sources.compensator}
    lines = [
        f"{label}: {path}, sha256 {_sha256(path)}"
        for label, path in files.items()
        if isinstance(path, Path) and (what == "command" or label != "nominal")
    ]
    if sources.compensator and getattr(product, "network", product) is None:
        lines.append("the compensator was refused when it was trained: it corrects nothing and is left out")
    if what == "curves":
        lines.append("the joints' error curves alone: a joint read as q stands at q + dq, so command q - dq(q)")
    return lines


def _command_in_words(sources: commands.Sources, product: Product, robot: Robot) -> list[str]:
    """The effects that are not in a command, where it holds, and its times; none of another product."""
    if not isinstance(product, Command):
        return []
    mass = "as declared" if sources.payload_kg is None else f"{sources.payload_kg:g} kg"
    lines = [f"LEFT OUT {line}" for line in commands.followed(sources)[1]]
    lines.append("readings within the joint limits of the robot file are corrected, others are CLAMPED")
    lines += commands.measured_range(robot)
    if robot.gravity_frame == "logged":
        lines.append("LEFT OUT the tilt of the base: gravity is as the robot file declares it, the base level")
    limits = product.limits
    return [
        *lines,
        f"payload: {mass}; tool: {sources.tool}; positions in the robot's own base frame",
        f"cycle {1e3 * limits.cycle_s:g} ms, rate {limits.rate_rad_s:g} rad/s, ramp {limits.ramp_s:g} s: "
        f"switched on in {limits.ramp_s / limits.cycle_s:.0f} calls of the step function",
    ]


def product_of(sources: commands.Sources, what: str, asked: OfCommand) -> Product:
    """The correction of commands, the network alone, or the joints' error curves alone. Raises InputError."""
    if what not in ("network", "command", "curves"):
        raise InputError(f"--what {what}: not known; allowed: network, command, curves")
    if what == "command":
        oriented = wants_pose(asked.correct)
        command = commands.command_of(sources, asked.steps, orientation=oriented)
        cycle_s = None if asked.cycle_ms is None else 1e-3 * asked.cycle_ms
        times = {"cycle_s": cycle_s, "rate_rad_s": asked.rate_rad_s, "ramp_s": asked.ramp_s}
        given = {name: value for name, value in times.items() if value is not None}
        return replace(command, limits=replace(command.limits, **given))
    return commands.network_of(sources) if what == "network" else commands.curves_of(sources)


def prefix_of(name: str) -> str:
    """A C prefix from a robot's name: lower case, at most 24 characters."""
    words = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    return (words if words[:1].isalpha() else f"robot_{words}")[:24].rstrip("_")


def wants_pose(word: str) -> bool:
    """Whether --correct asks for the orientation. Raises InputError for another word."""
    if word not in ("position", "pose"):
        raise InputError(f"--correct {word}: not known; allowed: position, pose")
    return word == "pose"


def poses_of(robot: Robot) -> str:
    """What --correct pose does for an arm, in words."""
    moved, turned = freedom_of(robot)
    if (moved, turned) == (3, 3):
        return "position and orientation are corrected, by the least change of the joints"
    position = "the position" if moved == 3 else f"the position in {moved} of 3 directions"
    if not turned:
        return f"--correct pose: {robot.n} joints cannot turn the tool beside moving it; {position} alone is corrected"
    return (
        f"--correct pose: {robot.n} joints reach {position} and, beside it, the orientation in {turned} of 3 "
        "directions; what is left of it stays"
    )


def unreached(robot: Robot) -> str:
    """What the joints of an arm cannot move at all, in words; empty for most arms."""
    moved = freedom_of(robot)[0]
    return "" if moved == 3 else f"NOT REACHED: the joints move the tool in {moved} of 3 directions; errors across stay"


def _sha256(path: Path) -> str:
    return hashlib.sha256(read_bytes(path)).hexdigest()
