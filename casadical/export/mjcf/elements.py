"""Elements of MJCF models: frames, spring joints, flexible links, balancing springs, four-bars.

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
constraints. The loop lies in the plane of the carrier's axis, as in `casadical.robot.fourbar`; the
driven link rotates with the rocker (a second equality), so that a driven axis that is not exactly
parallel to the carrier's is as in the robot.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import Body, FourBar, Joint
from casadical.core.transforms import frame, quaternion
from casadical.effects.base import Balancer, Drive
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
