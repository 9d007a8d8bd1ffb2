"""Convert a robot to an MJCF model of MuJoCo: geometry, masses, springs, four-bars, effects.

Drives are position actuators whose gain is the joint's stiffness: the link comes to rest where the
spring carries its weight. Links and bars have the robot's exact lengths and angles; inertias,
damping and armature are placeholders: the model is right about positions at rest, not about motion.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from xml.etree import ElementTree as ET

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import Body, Joint
from casadical.core.transforms import frame
from casadical.effects.base import Counterparts, Drive, Omission
from casadical.export.mjcf import elements
from casadical.export.mjcf.elements import (
    AXIS_VECTORS,
    SPRING_TIME_CONSTANT_S,
    add_body,
    add_mass,
    add_spring,
    armature_and_damping,
    numbers,
    place,
)
from casadical.robot.axes import row_matrix
from casadical.robot.robot import Robot

# Time step of the exported model's simulation [s].
TIME_STEP_S = 0.002
# MJCF attributes of the stiffest constraints that MuJoCo allows.
HARDEST_IMPEDANCE = {"solref": numbers(2 * TIME_STEP_S, 1), "solimp": "0.9999 0.9999 0.001 0.5 2"}
# Name of the model's site, and of the sensor of its position, at the measured point.
MEASURED_SITE = "measured"


@dataclass(frozen=True, eq=False)
class MjcfExport:
    """A robot as a MuJoCo model.

    text : XML text of the model
    written : sentences on how each effect is represented
    omitted : effects without a counterpart, with reasons
    notes : sentences on what else is omitted
    """

    text: str
    written: tuple[str, ...]
    omitted: tuple[Omission, ...]
    notes: tuple[str, ...] = ()

    @property
    def left_out(self) -> tuple[str, ...]:
        """Return sentences on all that the model omits."""
        return (*map(str, self.omitted), *self.notes)


def mjcf(robot: Robot, *, named: bool = True) -> MjcfExport:
    """Return a robot with its compliances and effects as a MuJoCo model, and what it omits.

    Its world is the measuring frame. Bodies are base, link1 .. linkN, payload; joints joint1 .. (of
    a four-bar joint3 is the crank, joint3_driven the link); actuators drive1 .. take the joint
    variable [rad or m] as `ctrl`; the site and sensor `measured` are the measured point.

    named : whether joints and actuators get the robot's own names, see `name_joints`
    """
    parts = counterparts(robot)
    root = ET.Element("mujoco", model=robot.name)
    # First lines of the comment at the beginning of a model.
    model_comment = (
        "Written by casadical. Statics are exact: geometry, masses, joint springs. Inertias, damping and armature are",
        f"placeholders (every spring comes to rest in some {SPRING_TIME_CONSTANT_S:g} s). ctrl takes the "
        "joint readings [rad or m].",
    )
    describe(root, model_comment, parts.written, map(str, parts.left_out))
    ET.SubElement(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true")
    R = robot.base.T[:3, :3] if robot.gravity_frame != "measuring" else np.eye(3)
    gravity = numbers(*(R @ robot.gravity))
    ET.SubElement(root, "option", timestep=numbers(TIME_STEP_S), integrator="implicitfast", gravity=gravity)
    default = ET.SubElement(root, "default")
    limits = {"solreflimit": HARDEST_IMPEDANCE["solref"], "solimplimit": HARDEST_IMPEDANCE["solimp"]}
    friction = {"solreffriction": HARDEST_IMPEDANCE["solref"], "solimpfriction": HARDEST_IMPEDANCE["solimp"]}
    ET.SubElement(default, "joint", {**limits, **friction})
    ET.SubElement(default, "equality", HARDEST_IMPEDANCE)
    last = _bodies(ET.SubElement(root, "worldbody"), robot, parts)
    _tool(last, robot, parts.payload)
    if robot.loops:
        equality = ET.SubElement(root, "equality")
        for d in (loop.driven for loop in robot.loops):  # coupler to rocker, and driven link to rocker
            ET.SubElement(equality, "connect", name=f"four_bar{d}", site1=f"coupler{d}_end", site2=f"rocker{d}_end")
            joints = {"joint1": f"joint{d}_driven", "joint2": f"rocker{d}", "polycoef": "0 1 0 0 0"}
            ET.SubElement(equality, "joint", {"name": f"driven{d}"} | joints)
    actuators = ET.SubElement(root, "actuator")
    for i, (joint, drive) in enumerate(zip(robot.joints, parts.drives, strict=True), 1):
        _actuator(actuators, i, joint, drive)
    if parts.balancers:
        tendons = ET.SubElement(root, "tendon")
        for balancer in parts.balancers:
            elements.add_tendons(balancer, tendons, actuators)
    sensor = ET.SubElement(root, "sensor")
    ET.SubElement(sensor, "framepos", name=MEASURED_SITE, objtype="site", objname=MEASURED_SITE)
    if named:
        name_joints(root, robot)
    return MjcfExport(xml_text(root), parts.written, parts.left_out)


def name_joints(root: ET.Element, robot: Robot) -> None:
    """Rename joints and actuators as the robot's joints if all have names, distinct and unused."""
    names = [row.name for row in robot.joints]
    taken = {str(node.get("name")) for node in root.iter("joint")} - {f"joint{i}" for i in robot.numbers}
    if not all(names) or len(set(names)) < robot.n or taken & set(names):
        return
    joint_names = {f"joint{i}": name for i, name in enumerate(names, 1)}
    drives = {f"drive{i}": name for i, name in enumerate(names, 1)}
    for node in root.iter():
        for attribute, mapping in (
            ("joint", joint_names),
            ("name", joint_names if node.tag == "joint" else {}),
            ("actuator", drives),
        ):
            if (name := mapping.get(str(node.get(attribute)))) is not None:
                node.set(attribute, name)
    for node in root.iterfind("actuator/*"):
        node.set("name", drives.get(str(node.get("name")), str(node.get("name"))))


def xml_text(root: ET.Element) -> str:
    """Return an XML tree as indented text."""
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def describe(root: ET.Element, lines: Iterable[str], written: Iterable[str], left_out: Iterable[str]) -> None:
    """Insert a comment that says what a model is, how each effect is represented, what it omits.

    root : root element of the model; lines : first lines of the comment
    written : sentences on represented effects; left_out : sentences on what is omitted
    """
    every = (*lines, *(f"effect {text}" for text in written), *(f"left out: {text}" for text in left_out))
    root.insert(0, ET.Comment("\n  " + "\n  ".join(line.replace("--", "- -") for line in every) + "\n"))


def counterparts(robot: Robot) -> Counterparts:
    """Return the elements of a simulator that represent a robot's springs and effects.

    Its field `left_out` names the effects that cannot be represented.
    """
    drives = tuple(Drive(compliance=j.compliance or 0.0) for j in robot.joints)
    scale = robot.torque_scale
    load = np.zeros(robot.n)
    if robot.effects:  # mean magnitude of each joint's gravity torque divided by its peak
        bare = robot.with_only(())
        q = np.random.default_rng(0).uniform(*robot.limits, (256, robot.n))
        tau: Array = bare.torque.map(256)(q.T, bare.parameters.values).full()
        load = np.array([np.nanmean(np.abs(row)) for row in tau]) / scale
    parts = Counterparts(drives, scale, load, robot.revolute, tuple(j.body for j in robot.joints), robot.payload)
    # Linear springs come first, as the other effects act in series with them.
    for effect in sorted(robot.effects, key=lambda e: not e.simulated_first):
        parts = effect.counterpart(parts, effect.own_values(robot.effect_values))
    return parts


def _bodies(world: ET.Element, robot: Robot, parts: Counterparts) -> ET.Element:
    """Add the bodies of base and links, with joints and masses, to an MJCF element.

    world : the element of the world body; parts : what effects add to the model
    Returns the element that carries the tool: the body of the last link
    """
    base = add_body(world, "base", robot.base.T)
    if np.isfinite(parts.base).any():
        add_mass(base, 0.0, np.zeros(3))
        for axis, words, k in zip("xy", AXIS_VECTORS[:2], parts.base, strict=True):
            if np.isfinite(k):
                add_spring(base, f"base_{axis}", words, k).set("pos", numbers(0.0, 0.0, -parts.base_below))
    driven = {loop.driven: loop for loop in robot.loops}
    parent, behind = base, np.eye(4)
    ends = [(parent, behind)]  # for each link, the body that carries the next joint, and its frame
    for i, (row, drive) in enumerate(zip(robot.joints, parts.drives, strict=True), 1):
        loop = driven.get(i)
        # The theta of a loop is the crank's; the link that it drives rotates with the rocker,
        # starting at the offset.
        place = row_matrix(replace(row, theta=loop.offset) if loop else row)
        body = add_body(parent, f"link{i}", behind @ place)
        if loop is not None:
            links = {str(node.get("name")): node for node in world.iter("body")}
            elements.add_loop(robot, loop, ends, links, drive, _drive_joints)
        else:
            _drive_joints(body, f"joint{i}", row, drive)
        for balancer in parts.balancers:
            if balancer.joint == i:
                elements.add_sites(balancer, *ends[-1], body, row)
        mass = parts.bodies[i - 1] or Body(0.0, np.zeros(3))
        parent, behind = body, np.eye(4)
        if i in parts.flexures and i < robot.n:
            end = row_matrix(robot.joints[i])[:3, 3]
            parent, behind = elements.add_pieces(body, f"link{i}", mass, end, *parts.flexures[i])
        else:
            add_mass(body, mass.mass, mass.com)
        ends.append((parent, behind))
    return parent


def _drive_joints(body: ET.Element, name: str, row: Joint, drive: Drive) -> None:
    """Add a drive's joints to a body: the actuated one, cubic and limited springs, and backlash.

    name : name of the actuated joint; row : the joint's DH row
    """
    margin = 0.02 * (row.upper - row.lower)
    kind = "hinge" if row.kind == "revolute" else "slide"
    joint = ET.SubElement(
        body, "joint", {"name": name, "type": kind, "axis": "0 0 1", **armature_and_damping(drive.stiffness)}
    )
    joint.set("range", numbers(row.lower - margin, row.upper + margin))
    if drive.friction:
        joint.set("frictionloss", numbers(drive.friction))
    if drive.k1:
        add_spring(body, f"{name}_give", "0 0 1", drive.k1, drive.k3)
    if drive.give:
        add_spring(body, f"{name}_bed", "0 0 1", drive.give_stiffness).set("range", numbers(-drive.give, drive.give))
    if drive.play:
        also = {"name": f"{name}_play", "type": kind, "axis": "0 0 1", **armature_and_damping(drive.stiffness)}
        play = ET.SubElement(body, "joint", also)
        play.set("range", numbers(-drive.play, drive.play))
        if drive.play_friction:
            play.set("frictionloss", numbers(drive.play_friction))


def _tool(last: ET.Element, robot: Robot, payload: Body | None) -> None:
    """Add the measured point's site and the payload, if not None, to the last link's body."""
    ET.SubElement(last, "site", {"name": MEASURED_SITE, **place(robot.tool.T)})
    if payload is not None:
        body = add_body(last, "payload", frame(np.eye(3), np.asarray(payload.com)))
        add_mass(body, payload.mass, np.zeros(3))


def _actuator(actuators: ET.Element, i: int, joint: Joint, drive: Drive) -> None:
    """Add the position servo of joint i, from 1: force = kp (ctrl - gear q) with gear = 1 / ratio.

    So q = ratio ctrl at rest without load.

    actuators : element to which it is added; joint : the joint's DH row, for its limits
    drive : stiffness and ratio
    """
    servo = ET.SubElement(actuators, "position", name=f"drive{i}", joint=f"joint{i}")
    servo.set("kp", numbers(drive.stiffness * drive.ratio**2))
    if drive.ratio != 1:
        servo.set("gear", numbers(1 / drive.ratio))
    servo.set("ctrlrange", numbers(joint.lower, joint.upper))
