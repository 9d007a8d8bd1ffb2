"""Build what is exported as C for a robot controller from robot files: command, network or curves.

Each product consists of CasADi functions of the nominal and of the calibrated robot.

Both robots are expressed in the robot's own base frame. The pose of the instrument is not an error
of the robot: the identified base is removed, and so is a first row with all six numbers, which is
the base (paper, Table 1). A first row of four numbers on a declared base stays: its joint offset is
the robot's. Both robots have the same tool unless declared otherwise: the measured point is usually
a reflector, and where it is mounted is not an error of the robot either.
"""

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast, get_args

import casadi as ca
import numpy as np

from casadical.compensator import Compensator, load_compensator
from casadical.core.basics import Array, InputError
from casadical.core.parts import Body, Placement
from casadical.core.reading import read_bytes
from casadical.effects.base import Omission
from casadical.export.c.products import Command, CurveFunction, Limits, NetworkFunction, Product, mapped
from casadical.export.c.write import Export, write_c
from casadical.export.controller.correction import (
    deflected_function,
    joint_curves,
    tool_function,
    variables_of,
    without_curves,
)
from casadical.export.controller.inverse import SINGULAR_BELOW_M_PER_RAD, freedom_of
from casadical.export.omission import left_out
from casadical.project.problem import read_campaign_robot
from casadical.project.problem_file import problem_file, result_in
from casadical.robot.axes import row_matrix
from casadical.robot.robot import Knowledge, Robot

# Whether both robots have one tool or each its own, see `Sources.tool`.
Tool = Literal["shared", "own"]


@dataclass(frozen=True, eq=False)
class Sources:
    """Robot files, or robots, of which a product for a controller is made.

    robot : the calibrated robot; a file, a folder of results or a `Robot`, such as
        `diagnosis.apply()` with its causes in the model
    nominal : the robot with which the controller computes; a file, a problem folder or a `Robot`
    compensator : the network trained on the calibrated robot's residuals; a file or a `Compensator`
    payload_kg : mass on the flange [kg]; None: as declared
    tool : "shared": both robots have the calibrated robot's tool; "own": each has its own, so that
        the difference is corrected too, for a measured point that is the controller's tool centre
        point itself
    leave_out : whether effects that a controller cannot evaluate are omitted from the robot;
        otherwise they are refused
    Raises InputError: `tool` is neither of the two.

    Examples
    --------
    >>> sources = casadical.export.Sources(found.robot, robot, payload_kg=0.0)
    >>> sources.tool
    'shared'
    """

    robot: Path | Robot
    nominal: Path | Robot | None = None
    compensator: Path | Compensator | None = None
    payload_kg: float | None = None
    tool: Tool = "shared"
    leave_out: bool = False

    def __post_init__(self) -> None:
        if self.tool not in get_args(Tool):
            raise InputError(f"--tool {self.tool}: unknown; allowed: {', '.join(get_args(Tool))}")


def export_c(
    sources: Sources,
    folder: Path,
    what: str = "command",
    *,
    steps: int = 2,
    correct: str = "position",
    limits: Mapping[str, float] | None = None,
    name: str | None = None,
    real: str = "double",
    languages: Sequence[str] | None = None,
    overwrite: bool = False,
    also: Callable[[Export], Mapping[Path, str]] = lambda _written: {},
) -> Export:
    """Write the C of a correction, a network or curves from robot files, compiled and compared.

    sources : robot files and compensator file; the calibrated robot must be a file or a folder
    folder : folder in which the C is written
    what : "command", the correction of commands; "network" or "curves", the compensator or the
        joints' error curves alone
    correct : "position" or "pose", what a command corrects
    limits : values that replace the defaults of `Limits`, by name
    name : prefix of the C functions; None: from the robot's name
    Returns the export, whose `about` says in words what was made and omitted
    Raises InputError: an option or a source that cannot be used; CasadicalError as of `write_c`.
    """
    if real not in ("float", "double"):
        raise InputError(f"--real {real}: unknown; allowed: float, double")
    product: Product
    if what == "command":
        command = command_of(sources, steps, orientation=wants_pose(correct))
        product = replace(command, limits=replace(command.limits, **(limits or {})))
    elif what in ("network", "curves"):
        product = (network_of if what == "network" else curves_of)(sources)
    else:
        raise InputError(f"--what {what}: unknown; allowed: network, command, curves")
    robot = robot_of(sources.robot)
    files = {"robot": sources.robot, "nominal": sources.nominal, "compensator": sources.compensator}
    hashes = {
        label: hashlib.sha256(read_bytes(_file_of(path) if label != "compensator" else path)).hexdigest()
        for label, path in files.items()
        if isinstance(path, Path)
    }
    try:
        written = write_c(
            product,
            folder,
            name=name or prefix_of(robot.name),
            real=cast(Any, real),
            model_sha256=hashes["robot"],
            data_sha256=hashes.get("compensator", "not given"),
            languages=languages,
            overwrite=overwrite,
            also=also,
        )
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from error
    lines = [f"{what} of {sources.robot}, {real}"]
    lines += filter(None, [poses_of(robot) if wants_pose(correct) else ""])
    lines += filter(None, [unreached(robot) if what == "command" else ""])
    for label, digest in hashes.items():
        if what == "command" or label != "nominal":
            lines.append(f"{label}: {files[label]}, sha256 {digest}")
    if sources.compensator and getattr(product, "network", product) is None:
        lines.append("the compensator was refused when it was trained: it corrects nothing and is omitted")
    if what == "curves":
        lines.append("the joints' error curves alone: a joint read as q stands at q + dq, so command q - dq(q)")
    if isinstance(product, Command):
        lines += _command_in_words(sources, product.limits, robot)
    return replace(written, about=tuple(lines))


def _command_in_words(sources: Sources, limits: Limits, robot: Robot) -> list[str]:
    """Return sentences on omissions, joint range, payload, frame and times of a command."""
    lines = [f"LEFT OUT {line}" for line in followed(sources)[1]]
    lines.append("readings within the joint limits of the robot file are corrected, others are CLAMPED")
    if robot.counts_otherwise:
        lines.append(f"joints in and out are the controller's readings J; of the robot file {robot.readings_in_words}")
    lines += measured_range(_with_payload(robot, sources.payload_kg))
    if robot.gravity_frame == "logged":
        lines.append("LEFT OUT the tilt of the base: gravity is as the robot file declares it, the base level")
    return [
        *lines,
        f"tool: {sources.tool}; positions in the robot's own base frame",
        f"cycle {1e3 * limits.cycle_s:g} ms, rate {limits.rate_rad_s:g} rad/s, ramp "
        f"{limits.ramp_s:g} s: switched on in {limits.ramp_s / limits.cycle_s:.0f} calls of the "
        "step function",
    ]


def command_of(sources: Sources, steps: int = 2, *, orientation: bool = False) -> Command:
    """Return the correction that moves the real tool to where the nominal robot has it.

    The nominal robot is rigid and without effects, as a controller computes. Commands and box are
    the controller's readings [rad or m]. The box is the calibrated robot's joint limits, within the
    range of the compensator's training; the measured poses may cover less of it.

    Joints change by the least that is needed; a metre of a linear joint counts as a radian of the
    others. Errors in directions in which the joints cannot move the tool (`freedom_of`) remain.

    sources : robots, network and payload
    steps : least-squares steps, 1 to 10
    orientation : whether the tool's orientation is to be corrected as well, by the least change of
        the joints; fewer than six joints correct the position, and of the orientation what they can
        at that position
    Raises InputError: where the files are not of one robot, or the robot cannot be corrected; see
    `followed`.

    Examples
    --------
    >>> command = casadical.export.command_of(casadical.export.Sources(found.robot, robot))
    >>> command.lower.round(2)
    array([-3.14, -3.14])
    """
    real, nominal, turn = own_robots(sources)
    freedom = freedom_of(nominal)
    orientation = orientation and freedom[1] > 0
    network = _network(sources, real.n)
    box = real
    if network is not None:
        ends = zip(np.maximum(real.limits[0], network.lower), np.minimum(real.limits[1], network.upper), strict=True)
        box = replace(
            real, joints=tuple(replace(j, lower=a, upper=b) for j, (a, b) in zip(real.joints, ends, strict=True))
        )
    lower, upper = box.reading_limits
    counted = f"the network alone takes the robot file's q, not the controller's readings J: {real.readings_in_words}"
    command = Command(
        nominal=tool_function(nominal, "nominal", orientation),
        calibrated=tool_function(real, "calibrated", orientation, turn, network),
        lower=lower,
        upper=upper,
        jacobian_of=tool_function(without_curves(real).rigid, "chain", orientation),
        jacobian_at=deflected_function(real) if any(j.compliance for j in real.joints) else None,
        network=network,
        limits=Limits(singular_m_per_rad=SINGULAR_BELOW_M_PER_RAD) if orientation else Limits(),
        steps=steps,
        units=real.units,
        freedom=freedom,
        notes=(
            *real.notes,
            *measured_range(_with_payload(robot_of(sources.robot), sources.payload_kg)),
            *[counted] * (network is not None and real.counts_otherwise),
        ),
    )
    q = np.random.default_rng(0).uniform(command.lower, command.upper, (200, len(command.lower)))
    away = mapped(command.calibrated, q) - mapped(command.nominal, q)
    apart = np.linalg.norm(away[:, :3], axis=1)
    if np.isnan(apart).all() or np.nanmedian(apart) > 0.1:
        raise InputError(
            f"{_source_name(sources.nominal)}: its tool is {1e3 * np.nanmedian(apart):.0f} mm from "
            f"that of {_source_name(sources.robot)} (median over the joints' ranges); at most 100 "
            "mm can be corrected: are both files of one robot, and with --tool own, is the nominal "
            "tool really the one that the controller holds?"
        )
    return command


def own_robots(sources: Sources) -> tuple[Robot, Robot, Array]:
    """Return real and nominal robot in their own base frame, and the rotation into it, (3, 3).

    The rotation is from the measuring frame. The real robot is the calibrated one with the effects
    that a controller can evaluate, the nominal one is rigid and without effects. Both have the same
    readings of the controller, and the real tool if it is shared.

    Raises InputError: no nominal robot, one of other joints, or as of `followed`.
    """
    if sources.nominal is None:
        raise InputError(
            "a command needs the controller's model of the robot: give --nominal NOMINAL.toml, "
            "the robot file from before the calibration"
        )
    real, _ = followed(sources)
    nominal = robot_of(sources.nominal).with_only(()).rigid
    _refuse_other_robot(real, nominal, sources)
    if not nominal.counts_otherwise:  # how the controller counts is no error of the robot
        counted = zip(nominal.joints, real.joints, strict=True)
        nominal = replace(nominal, joints=tuple(replace(j, readings=own.readings) for j, own in counted))
    if sources.tool == "shared":
        nominal = replace(nominal, tool=real.tool)
    real, turn = in_own_frame(real, nominal)
    return real, in_own_frame(nominal, nominal)[0], turn


def network_of(sources: Sources) -> NetworkFunction:
    """Return the compensator: joints [rad or m] -> position correction [mm] in the measuring frame.

    The joints are the variables of the robot file's rows, even where a controller counts otherwise.

    Raises InputError: where `sources` names no compensator, or one that was refused when it was
    trained.
    """
    if sources.compensator is None:
        raise InputError("a network needs its file: give --compensator NET.json, as calibrate --out wrote it")
    robot = robot_of(sources.robot)
    network = _network(sources, robot.n)
    if network is None:
        raise InputError(
            f"{_source_name(sources.compensator)}: this network does not help and was refused when "
            "it was trained; there is nothing to export"
        )
    return replace(network, units=robot.units)


def curves_of(sources: Sources) -> CurveFunction:
    """Return the joints' error curves: controller's readings -> true ones minus these [rad or m].

    They serve a controller that has the rest of the calibration in its own kinematics. The box is
    the robot's joint limits, in readings.
    Raises InputError: the robot has no `joint_error_curve`.
    """
    robot = robot_of(sources.robot)
    curves = joint_curves(robot)
    if curves is None:
        raise InputError(
            f"{_source_name(sources.robot)}: it has no joint_error_curve; there is nothing to "
            "export. `casadical diagnose` finds the curves; Diagnosis.apply() and write_robot put "
            "them into a robot file"
        )
    q = ca.SX.sym("q", robot.n)
    lower, upper = robot.reading_limits
    dq = curves(variables_of(robot, q))
    if robot.counts_otherwise:
        dq = ca.sparsify(ca.DM(np.linalg.inv(robot.reading_map[0]))) @ dq
    return CurveFunction(ca.Function("curves", [q], [dq], ["q"], ["dq"]), lower, upper, robot.units)


def in_own_frame(robot: Robot, nominal: Robot) -> tuple[Robot, Array]:
    """Return the robot in its own base frame, and the rotation from the measuring frame, (3, 3).

    Its base is the identity. A first row with six numbers, which is the base, is replaced by the
    nominal robot's. Gravity keeps its direction relative to the arm.
    """
    turn = robot.base.T[:3, :3].T
    gravity = turn @ robot.gravity if robot.gravity_frame == "measuring" else robot.gravity
    joints = robot.joints
    if joints[0].b is not None:
        first = nominal.joints[0]
        same = row_matrix(first)[:3, :3] @ row_matrix(joints[0])[:3, :3].T
        turn, gravity = same @ turn, same @ gravity
        placed = {k: getattr(first, k) for k in ("alpha", "a", "beta", "b", "theta", "d")}
        joints = (replace(joints[0], **placed), *joints[1:])
    own = replace(
        robot, joints=joints, base=Placement(np.eye(4)), gravity=gravity, gravity_frame="base", knowledge=None
    )
    return own, turn


def measured_range(robot: Robot) -> tuple[str, ...]:
    """Return sentences on the joint ranges [deg or mm, readings] learnt from, and on the payload."""
    known = robot.knowledge or Knowledge()
    ranges = known.readings
    if len(ranges):
        learnt = (replace(j, lower=a, upper=b) for j, (a, b) in zip(robot.joints, ranges, strict=True))
        ranges = np.column_stack(replace(robot, joints=tuple(learnt), loops=()).reading_limits)
    factors = [(1e3, "mm") if unit == "m" else (180 / np.pi, "deg") for unit in robot.units]
    spans = [
        f"{i}: {low * factor:.3g} to {high * factor:.3g} {unit}"
        for i, ((low, high), (factor, unit)) in enumerate(zip(ranges, factors, strict=False), 1)
    ]
    text = f"the model was learnt from readings of joint {', '.join(spans)}; elsewhere it is extrapolated"
    load, logged = robot.payload, known.conditions.get("payload_kg")
    payload = "payload in the model: none; it holds for what the flange carried when it was measured"
    if load:
        at = ", ".join(f"{1e3 * c:g}" for c in load.com)
        payload = f"payload in the model: {load.mass:g} kg, mass centre {at} mm in the last link's frame"
        payload += f"; learnt with {logged[0]:g} to {logged[1]:g} kg" if logged else ""
    soft = robot.effects or any(j.compliance for j in robot.joints)
    return (*[text] * bool(spans), *[payload] * bool(soft))


def robot_of(source: Path | Robot) -> Robot:
    """Return a robot unchanged, or that of a file or folder (see `_file_of`). Raises InputError."""
    return source if isinstance(source, Robot) else read_campaign_robot(_file_of(source))


def _file_of(source: Path) -> Path:
    """Return the robot file of a problem folder or of a folder of results; a file unchanged."""
    if (source / "problem.toml").is_file():
        return source / problem_file(source).robot
    return result_in(source)


def _source_name(source: Path | Robot | Compensator | None) -> str:
    """Return the name of a source for messages: a file's path or a robot's name."""
    if isinstance(source, Compensator):
        return "the compensator"
    return source.name if isinstance(source, Robot) else str(source)


def followed(sources: Sources) -> tuple[Robot, tuple[str, ...]]:
    """Return the calibrated robot with the effects that a controller can evaluate, and omissions.

    The omissions are a sentence on each effect of the measurement and on each that has other
    conditions than joints and payload, the only ones that a controller knows. The robot has the
    payload of `sources`.

    Raises InputError: robot effects are omitted without `leave_out`, or a payload is not allowed.
    """
    robot = _with_payload(robot_of(sources.robot), sources.payload_kg)
    omissions = []
    for e in robot.effects:
        unknown = ", ".join(c for c in e.conditions if c != "payload_kg")
        if e.of_measurement:
            omissions.append(Omission(e.label, "an effect of the measurement, not of the robot"))
        elif unknown:
            omissions.append(Omission(e.label, f"follows {unknown}, which a controller does not know"))
    lines = left_out(robot, omissions, "the correction of a joint command", sources.leave_out)
    gone = {o.label for o in omissions}
    return robot.with_only(e for e in robot.effects if e.label not in gone), lines


def _with_payload(robot: Robot, payload_kg: float | None) -> Robot:
    """Return the robot with another payload mass, at the declared centre of mass.

    payload_kg : mass of the payload [kg]; None: as declared
    """
    if payload_kg is None:
        return robot
    if not (np.isfinite(payload_kg) and payload_kg >= 0):
        raise InputError(f"--payload {payload_kg}: it must be a finite mass in kg, zero or more")
    if robot.payload is None:
        raise InputError(
            f"--payload {payload_kg:g}: robot {robot.name!r} declares no payload, so its mass "
            "centre is unknown; add [payload] with mass_kg and com_mm to the robot file"
        )
    return replace(robot, payload=Body(payload_kg, robot.payload.com))


def _refuse_other_robot(real: Robot, nominal: Robot, sources: Sources) -> None:
    """Check that both robots have equal joints and closed loops. Raises InputError if not."""
    loops = [[(loop.driven, loop.carrier) for loop in robot.loops] for robot in (real, nominal)]
    for i, (a, b) in enumerate(zip(real.units, nominal.units, strict=False), 1):
        if a != b:
            kinds = {"rad": "revolute", "m": "prismatic"}
            raise InputError(
                f"{_source_name(sources.nominal)}: joint {i} is {kinds[b]}, in "
                f"{_source_name(sources.robot)} {kinds[a]}: both files must be of one robot"
            )
    if real.n != nominal.n or loops[0] != loops[1]:
        raise InputError(
            f"{_source_name(sources.nominal)}: {nominal.n} joints, {len(nominal.loops)} four-bars; "
            f"{_source_name(sources.robot)} has {real.n} and {len(real.loops)}: both files must be "
            "of one robot"
        )


def _network(sources: Sources, joints: int) -> NetworkFunction | None:
    """Return the compensator's network with its training ranges.

    It is None without a compensator, or if the network was refused when it was trained.
    """
    if sources.compensator is None:
        return None
    source = sources.compensator
    compensator = source if isinstance(source, Compensator) else load_compensator(source)
    layout, box = compensator.layout, compensator.trained_box
    if (layout.joints, layout.outputs) != (joints, 3):
        raise InputError(
            f"{_source_name(source)}: {layout.joints} joints in and {layout.outputs} numbers out; "
            f"this robot needs {joints} joints and a position of 3"
        )
    if not compensator.helps:
        return None
    return NetworkFunction(compensator.function(), np.array(box.lower), np.array(box.upper))


def prefix_of(name: str) -> str:
    """Return a C prefix made of a robot's name: a letter, then a-z, 0-9 or _, at most 24."""
    words = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    return (words if words[:1].isalpha() else f"robot_{words}")[:24].rstrip("_")


def wants_pose(word: str) -> bool:
    """Return True for --correct pose, False for position. Raises InputError for any other word."""
    if word not in ("position", "pose"):
        raise InputError(f"--correct {word}: unknown; allowed: position, pose")
    return word == "pose"


def poses_of(robot: Robot) -> str:
    """Return a sentence on the directions that the option --correct pose corrects of this robot."""
    moved, turned = freedom_of(robot)
    if (moved, turned) == (3, 3):
        return "position and orientation are corrected, by the least change of the joints"
    position = "the position" if moved == 3 else f"the position in {moved} of 3 directions"
    if not turned:
        return f"--correct pose: {robot.n} joints cannot turn the tool and move it; {position} alone is corrected"
    return (
        f"--correct pose: {robot.n} joints reach {position} and, in addition, the orientation in "
        f"{turned} of 3 directions; its remainder stays"
    )


def unreached(robot: Robot) -> str:
    """Return a sentence on the directions in which the joints cannot move the tool; "" if none."""
    moved = freedom_of(robot)[0]
    return "" if moved == 3 else f"NOT REACHED: the joints move the tool in {moved} of 3 directions; errors across stay"
