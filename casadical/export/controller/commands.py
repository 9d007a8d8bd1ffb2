"""A calibrated robot as a product of the exporter: CasADi functions of the nominal and of the real robot.

Both robots are given in the robot's own base frame. The position of the instrument is not an error of the robot: the
identified base is removed, and so is a first row with all six numbers, which is the base (paper, Table 1). A first row
of four numbers on a known base stays: its joint offset is the robot's. Both have the same tool unless told otherwise:
the measured point is usually a reflector, and where it is mounted is not an error of the robot either.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import casadi as ca
import numpy as np

from casadical.compensator import Compensator, load_compensator
from casadical.core.basics import Array, InputError
from casadical.core.parts import Body, Placement
from casadical.effects import Effect
from casadical.effects.base import Omission
from casadical.export.c.products import Command, CurveFunction, Limits, NetworkFunction, mapped
from casadical.export.controller import functions
from casadical.export.controller.inverse import SINGULAR_POSE, freedom_of
from casadical.export.omission import geometry_of, left_out, rigid
from casadical.robot.axes import row_matrix
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot

Tool = Literal["shared", "own"]

SAME_ROBOT = 0.1  # m between nominal and calibrated tool, median: above it the files are not of one robot


@dataclass(frozen=True, eq=False)
class Sources:
    """What a product is made of.

    robot : the calibrated robot; a file or a `Robot`, such as `diagnosis.apply()` with its causes in the model
    nominal : the one that the controller computes with; a file or a `Robot`
    compensator : the network trained on the calibrated robot's residuals; a file or a `Compensator`
    payload_kg : mass on the flange [kg]; None: as declared
    tool : "shared": both robots have the calibrated robot's tool. "own": each has its own, so that the difference is
        corrected too, for a measured point that is the controller's tool centre point itself
    leave_out : whether effects that a controller cannot follow are left out of the robot; else they are refused
    Raises InputError: another word as tool.

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
            raise InputError(f"--tool {self.tool}: not known; allowed: {', '.join(get_args(Tool))}")


def command_of(sources: Sources, steps: int = 2, *, orientation: bool = False) -> Command:
    """The correction that moves the real tool to the position of the nominal robot's, in the robot's own base frame.

    The nominal robot is rigid and without effects, as a controller computes. The box is the calibrated robot's joint
    limits [rad or m], within the readings that the compensator's training saw; the measured poses may cover less of it.

    Joints change by the least that is needed; a metre of a linear joint counts as a radian of the others. What the
    joints cannot move (`freedom_of`) is left.

    sources : robots, network and payload
    steps : least-squares steps, 1 to 10
    orientation : whether the tool's orientation is to be reached as well, by the least change of the joints; fewer than
        six joints reach the position, and of the orientation what they can beside it
    Raises InputError: where the files are not of one robot, or the robot cannot be corrected; see `followed`.

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
    lower, upper = real.limits
    if network is not None:
        lower, upper = np.maximum(lower, network.lower), np.minimum(upper, network.upper)
    command = Command(
        nominal=functions.tool_function(nominal, "nominal", orientation),
        calibrated=functions.tool_function(real, "calibrated", orientation, turn, network),
        lower=lower,
        upper=upper,
        jacobian_of=functions.tool_function(rigid(functions.without_curves(real)), "chain", orientation),
        jacobian_at=functions.bent_function(real) if any(j.compliance for j in real.joints) else None,
        network=network,
        limits=Limits(singular_m_per_rad=SINGULAR_POSE) if orientation else Limits(),
        steps=steps,
        units=real.units,
        freedom=freedom,
        notes=(*real.notes, *measured_range(robot_of(sources.robot))),
    )
    _refuse_far_apart(command, sources)
    return command


def own_robots(sources: Sources) -> tuple[Robot, Robot, Array]:
    """Real and nominal robot in their own base frame, and the rotation into it, (3, 3). Raises InputError."""
    if sources.nominal is None:
        raise InputError(
            "a command needs the controller's model of the robot: give --nominal NOMINAL.toml, "
            "the robot file from before the calibration"
        )
    real, _ = followed(sources)
    nominal = geometry_of(robot_of(sources.nominal))
    _refuse_other_robot(real, nominal, sources)
    if sources.tool == "shared":
        nominal = replace(nominal, tool=real.tool)
    real, turn = in_own_frame(real, nominal)
    return real, in_own_frame(nominal, nominal)[0], turn


def network_of(sources: Sources) -> NetworkFunction:
    """The compensator alone: joints [rad] -> what to add to the computed position [mm], in the measuring frame.

    Raises InputError: where `sources` names no compensator, or one that was refused when it was trained.
    """
    if sources.compensator is None:
        raise InputError("a network needs its file: give --compensator NET.json, as calibrate --out wrote it")
    robot = robot_of(sources.robot)
    network = _network(sources, robot.n)
    if network is None:
        raise InputError(
            f"{_word(sources.compensator)}: this network does not help and was refused when it was trained; there is "
            "nothing to export"
        )
    return replace(network, units=robot.units)


def curves_of(sources: Sources) -> CurveFunction:
    """The error curves of the joints alone: joints [rad] -> what each joint turns beyond its reading [rad].

    For a controller that has the rest of the calibration in its own kinematics. The box is the robot's joint limits.
    Raises InputError: where the robot has no `joint_error_curve`.
    """
    robot = robot_of(sources.robot)
    curves = functions.joint_curves(robot)
    if curves is None:
        raise InputError(
            f"{_word(sources.robot)}: it has no joint_error_curve; there is nothing to export. `casadical diagnose` "
            "finds the curves; Diagnosis.apply() and write_robot put them into a robot file"
        )
    q = ca.SX.sym("q", robot.n)
    lower, upper = robot.limits
    return CurveFunction(ca.Function("curves", [q], [curves(q)], ["q"], ["dq"]), lower, upper, robot.units)


def in_own_frame(robot: Robot, nominal: Robot) -> tuple[Robot, Array]:
    """The robot seen from its own base frame, and the rotation into it from the measuring frame, shape (3, 3).

    A first row that is the base becomes the nominal robot's. Gravity keeps its direction against the arm.
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
    """The readings that the robot file was learnt from, in a sentence; none where the file does not say it."""
    known = robot.knowledge.readings if robot.knowledge else np.zeros((0, 2))
    factors = [(1e3, "mm") if unit == "m" else (180 / np.pi, "deg") for unit in robot.units]
    spans = [
        f"{i}: {low * factor:.3g} to {high * factor:.3g} {unit}"
        for i, ((low, high), (factor, unit)) in enumerate(zip(known, factors, strict=False), 1)
    ]
    text = f"the model was learnt from readings of joint {', '.join(spans)}; elsewhere it is extrapolated"
    return (text,) if spans else ()


def robot_of(source: Path | Robot) -> Robot:
    return source if isinstance(source, Robot) else read_robot(source)


def _word(source: Path | Robot | Compensator | None) -> str:
    if isinstance(source, Compensator):
        return "the compensator"
    return source.name if isinstance(source, Robot) else str(source)


def followed(sources: Sources) -> tuple[Robot, tuple[str, ...]]:
    """The real robot with the effects that joints and payload decide, and a line on each effect that is left out.

    Effects of the measurement always are. Raises InputError that says what would be lost, unless `leave_out` is given.
    """
    robot = _loaded(robot_of(sources.robot), sources.payload_kg)
    omissions = [o for e in robot.effects if (o := _not_followed(e))]
    lines = left_out(robot, omissions, "the correction of a joint command", sources.leave_out)
    gone = {o.label for o in omissions}
    return robot.with_only(e for e in robot.effects if e.label not in gone), lines


def _not_followed(effect: Effect) -> Omission | None:
    lost = [c for c in effect.conditions if c != "payload_kg"]
    if effect.of_measurement:
        return Omission(effect.label, "an effect of the measurement, not of the robot")
    return Omission(effect.label, f"follows {', '.join(lost)}, which a controller does not know") if lost else None


def _loaded(robot: Robot, payload_kg: float | None) -> Robot:
    """The robot with another mass on its flange, at the declared mass centre."""
    if payload_kg is None:
        return robot
    if not (np.isfinite(payload_kg) and payload_kg >= 0):
        raise InputError(f"--payload {payload_kg}: it must be a finite mass in kg, zero or more")
    if robot.payload is None:
        raise InputError(
            f"--payload {payload_kg:g}: robot {robot.name!r} declares no payload, so its mass centre is not known; "
            "add [payload] with mass_kg and com_mm to the robot file"
        )
    return replace(robot, payload=Body(payload_kg, robot.payload.com))


def _refuse_other_robot(real: Robot, nominal: Robot, sources: Sources) -> None:
    loops = [[(loop.driven, loop.carrier) for loop in robot.loops] for robot in (real, nominal)]
    for i, (a, b) in enumerate(zip(real.units, nominal.units, strict=False), 1):
        if a != b:
            kinds = {"rad": "revolute", "m": "prismatic"}
            raise InputError(
                f"{_word(sources.nominal)}: joint {i} is {kinds[b]}, in {_word(sources.robot)} {kinds[a]}: both files "
                "must be of one robot"
            )
    if real.n != nominal.n or loops[0] != loops[1]:
        raise InputError(
            f"{_word(sources.nominal)}: {nominal.n} joints, {len(nominal.loops)} four-bars; {_word(sources.robot)} has "
            f"{real.n} and {len(real.loops)}: both files must be of one robot"
        )


def _refuse_far_apart(command: Command, sources: Sources) -> None:
    q = np.random.default_rng(0).uniform(command.lower, command.upper, (200, len(command.lower)))
    apart = np.linalg.norm((mapped(command.calibrated, q) - mapped(command.nominal, q))[:, :3], axis=1)
    if np.isnan(apart).all() or np.nanmedian(apart) > SAME_ROBOT:
        raise InputError(
            f"{_word(sources.nominal)}: its tool is {1e3 * np.nanmedian(apart):.0f} mm from that of "
            f"{_word(sources.robot)} (median "
            f"over the joints' ranges); at most {1e3 * SAME_ROBOT:.0f} mm can be corrected: are both files of one "
            "robot, and with --tool own, is the nominal tool really the one that the controller holds?"
        )


def _network(sources: Sources, joints: int) -> NetworkFunction | None:
    """The compensator's network in the box of its training; None without one, or where it was refused."""
    if sources.compensator is None:
        return None
    source = sources.compensator
    compensator = source if isinstance(source, Compensator) else load_compensator(source)
    layout, box = compensator.layout, compensator.trained_box
    if (layout.joints, layout.outputs) != (joints, 3):
        raise InputError(
            f"{_word(source)}: {layout.joints} joints in and {layout.outputs} numbers out; this robot needs "
            f"{joints} joints and a position of 3"
        )
    if not compensator.helps:
        return None
    return NetworkFunction(compensator.function(), np.array(box.lower), np.array(box.upper))
