"""Convert a robot to an MJCF model of MuJoCo: geometry, masses, springs, four-bars, effects.

Drives are position actuators whose gain is the joint's stiffness: the link comes to rest where the
spring carries its weight. Links and bars have the robot's exact lengths and angles; inertias,
damping and armature are placeholders: the model is right about positions at rest, not about motion.

A flexible link consists of three pieces with springs at the two Gauss points of its length. The
bending moment is linear from root to end; slope and deflection of the end are integrals of the
moment times at most the remaining length, a quadratic function, which two Gauss points integrate
exactly. The link's own mass is distributed over the pieces so that each spring has the moment of
the beam, and the sum has the link's mass and centre of mass.

A balancing spring is a tendon between two sites with a spring of rest length zero and a constant
pull. The torque of `GravityCompensator`, T (S sin t + C cos t + P sin t / l), is that of a spring
without rest length, k a b sin(t + phase), and that of a constant pull F along the line from anchor
to lever, F a b sin t / length.

A four-bar is a closed chain: crank, coupler and rocker with the robot's lengths, closed by equality
constraints. The loop lies in the plane of the carrier's axis, as in `casadical.robot.kinematics`;
the driven link rotates with the rocker (a second equality), so that a driven axis that is not
exactly parallel to the carrier's is as in the robot.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from xml.etree import ElementTree as ET

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import Body, FourBar, Joint
from casadical.core.transforms import frame, quaternion
from casadical.effects.base import Balancer, Counterparts, Drive, Omission
from casadical.robot.axes import row_matrix
from casadical.robot.robot import Robot

# Time constant with which every spring joint alone comes to rest [s]. It is arbitrary, as statics
# depend neither on inertia nor on damping.
SPRING_TIME_CONSTANT_S = 0.02
# Unit vectors x, y, z as the text of MJCF attributes.
AXIS_VECTORS = ("1 0 0", "0 1 0", "0 0 1")
# Length of a balancing spring's lever [m]. It is arbitrary, as stiffness and pull scale with it.
LEVER_M = 0.3


def numbers(*values: float) -> str:
    """Return numbers as the text of an MJCF attribute, separated by spaces, exact to the bit."""
    return " ".join(repr(float(v)) for v in values)


def place(T: Array) -> dict[str, str]:
    """Return the MJCF attributes pos and quat of a pose T, shape (4, 4) [m], rounded to 1e-12.

    Later digits are rounding errors.
    """
    return {"pos": numbers(*T[:3, 3].round(12)), "quat": numbers(*quaternion(T[:3, :3]).round(12))}


def add_body(parent: ET.Element, name: str, T: Array) -> ET.Element:
    """Add a body with the pose T, shape (4, 4) [m], in its parent's frame, and return it."""
    return ET.SubElement(parent, "body", {"name": name, **place(T)})


def add_mass(body: ET.Element, mass: float, com: Array) -> None:
    """Add mass and mass centre to a body; the inertia is a placeholder.

    mass : mass [kg], raised to 1e-6 if less; com : mass centre in the body's frame, shape (3,) [m]
    """
    mass = max(mass, 1e-6)  # kg; MuJoCo cannot move a body without mass
    moment = mass * (0.1 + 0.3 * float(np.linalg.norm(com))) ** 2
    ET.SubElement(body, "inertial", pos=numbers(*com), mass=numbers(mass), diaginertia=numbers(moment, moment, moment))


def add_spring(body: ET.Element, name: str, axis: str, stiffness: float, cubic: float = 0.0) -> ET.Element:
    """Add a spring hinge to a body: torque = -(stiffness x + cubic x^3) at the angle x; return it.

    name : name of the joint; axis : its unit vector in the body's frame, as MJCF text
    stiffness : linear stiffness [N m/rad]; cubic : cubic stiffness [N m/rad^3]
    """
    text = numbers(stiffness, 0.0, cubic) if cubic else numbers(stiffness)
    return ET.SubElement(
        body, "joint", {"name": name, "axis": axis, "stiffness": text, **armature_and_damping(stiffness)}
    )


def armature_and_damping(stiffness: float) -> dict[str, str]:
    """Return MJCF attributes armature and damping of a spring joint, for `SPRING_TIME_CONSTANT_S`.

    stiffness : stiffness of the spring [N m/rad or N/m]
    """
    return {
        "armature": numbers(stiffness * SPRING_TIME_CONSTANT_S**2),
        "damping": numbers(2 * stiffness * SPRING_TIME_CONSTANT_S),
    }


def add_pieces(
    body: ET.Element, name: str, mass: Body, end: Array, stiffness: tuple[float, float, float], spread: bool
) -> tuple[ET.Element, Array]:
    """Add the pieces of a flexible link; return the last and the link's frame in it, (4, 4) [m].

    body : body of the link's first piece; name : name of the link
    mass : mass properties of the link
    end : position of the next joint in the link's frame, shape (3,) [m]
    stiffness : stiffness of the whole link about its axes x, y, z [N m/rad]; infinite: rigid
    spread : whether its weight bends it as distributed along the link; otherwise as at its centre
        of mass
    """
    # Positions of the two Gauss points along a link, divided by its length.
    gauss_points = (0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3))
    s1, s2 = gauss_points
    com = np.asarray(mass.com)
    # Each piece has a third of the mass. Their centres follow from the moments that the springs
    # must carry, (1 - s) m com or (1 - s)^2 m end / 2.
    lever1, lever2 = ((1 - s) ** 2 * end / 2 if spread else (1 - s) * com for s in gauss_points)
    c2 = s2 * end + 3 * lever2
    c1 = s1 * end + 3 * lever1 - (c2 - s1 * end)
    c0 = 3 * com - c1 - c2
    third = mass.mass / 3
    add_mass(body, third, c0)
    before = np.zeros(3)
    for k, (share, centre) in enumerate(zip(gauss_points, (c1, c2), strict=True), 1):
        body = add_body(body, f"{name}_piece{k}", frame(np.eye(3), share * end - before))
        before = share * end
        for axis, words, link_stiffness in zip("xyz", AXIS_VECTORS, stiffness, strict=True):
            if np.isfinite(link_stiffness):
                add_spring(body, f"{name}_bend{k}{axis}", words, 2 * link_stiffness)
        add_mass(body, third, centre - before)
    return body, frame(np.eye(3), -before)


def add_sites(balancer: Balancer, before: ET.Element, behind: Array, link: ET.Element, row: Joint) -> None:
    """Add the sites of a balancing spring: two anchors before its joint, the lever on its link.

    before : body before the joint
    behind : pose of the frame of the link before the joint in that body, shape (4, 4) [m]
    link : body of the joint's link; row : the joint's DH row
    """
    name, b = f"balancer{balancer.joint}", balancer.anchor * LEVER_M
    T = behind @ row_matrix(replace(row, theta=0.0))
    for suffix, angle in (("spring", balancer.phase - balancer.ahead + np.pi), ("pull", balancer.phase + np.pi)):
        at = T @ np.array([b * np.cos(angle), b * np.sin(angle), 0.0, 1.0])
        ET.SubElement(before, "site", name=f"{name}_{suffix}", pos=numbers(*at[:3]))
    ET.SubElement(link, "site", name=f"{name}_lever", pos=numbers(LEVER_M, 0, 0))


def add_tendons(balancer: Balancer, tendons: ET.Element, actuators: ET.Element) -> None:
    """Add a balancing spring's tendons: the spring, and the constant pull of its preload.

    The pull is an actuator of constant force, whose command has no effect.

    tendons, actuators : elements of the model to which they are added
    """
    name, b = f"balancer{balancer.joint}", balancer.anchor * LEVER_M
    stiffness = balancer.swing / (LEVER_M * b)
    for suffix, spring in (("spring", {"stiffness": numbers(stiffness), "springlength": "0 0"}), ("pull", {})):
        node = ET.SubElement(tendons, "spatial", {"name": f"{name}_{suffix}", **spring})
        for end in (f"{name}_{suffix}", f"{name}_lever"):
            ET.SubElement(node, "site", site=end)
    # There l is in units of the anchor's length: T P sin t / (length / b) = F a b sin t / length.
    pull = {"biastype": "affine", "gainprm": "0", "biasprm": numbers(-balancer.pull / LEVER_M, 0, 0)}
    ET.SubElement(actuators, "general", {"name": f"{name}_pull", "tendon": f"{name}_pull", **pull})


def add_loop(
    robot: Robot,
    loop: FourBar,
    ends: Sequence[tuple[ET.Element, Array]],
    links: Mapping[str, ET.Element],
    drive: Drive,
    drive_joints: Callable[[ET.Element, str, Joint, Drive], None],
) -> None:
    """Add the bars of a four-bar, and the driven link's passive hinge.

    ends : for the base and each link the body that carries the next joint, and the pose of the
        link's frame in it, shape (4, 4) [m]
    links : bodies of the links by name
    drive : drive of the crank
    drive_joints : function that adds the joints of the drive to the crank
    """
    carrier, row = robot.joints[loop.carrier - 1], robot.joints[loop.driven - 1]
    d = loop.driven
    before, behind = ends[loop.carrier - 1]
    crank = add_body(before, f"crank{d}", behind @ row_matrix(replace(carrier, theta=row.theta)))
    drive_joints(crank, f"joint{d}", row, drive)
    coupler = add_body(crank, f"coupler{d}", frame(np.eye(3), np.array([loop.crank, 0.0, 0.0])))
    rocker = add_body(links[f"link{loop.carrier}"], f"rocker{d}", frame(np.eye(3), np.array([row.a, 0.0, 0.0])))
    # A tenth of the drive's armature, as less makes the constraints soft. Bars have no weight.
    heavy = numbers(0.1 * drive.stiffness * SPRING_TIME_CONSTANT_S**2)
    for body, name in ((coupler, "coupler"), (rocker, "rocker")):
        ET.SubElement(body, "joint", name=f"{name}{d}", axis="0 0 1", armature=heavy)
    for body in (crank, coupler, rocker):
        add_mass(body, 0.0, np.zeros(3))
    ET.SubElement(coupler, "site", name=f"coupler{d}_end", pos=numbers(loop.coupler, 0, 0))
    ET.SubElement(rocker, "site", name=f"rocker{d}_end", pos=numbers(loop.rocker, 0, 0))
    ET.SubElement(links[f"link{d}"], "joint", name=f"joint{d}_driven", axis="0 0 1", armature=heavy)


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
            add_tendons(balancer, tendons, actuators)
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
            add_loop(robot, loop, ends, links, drive, _drive_joints)
        else:
            _drive_joints(body, f"joint{i}", row, drive)
        for balancer in parts.balancers:
            if balancer.joint == i:
                add_sites(balancer, *ends[-1], body, row)
        mass = parts.bodies[i - 1] or Body(0.0, np.zeros(3))
        parent, behind = body, np.eye(4)
        if i in parts.flexures and i < robot.n:
            end = row_matrix(robot.joints[i])[:3, 3]
            parent, behind = add_pieces(body, f"link{i}", mass, end, *parts.flexures[i])
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
