"""Writing URDFs: a calibrated robot into its own file, and a new file for any robot."""

import re
from pathlib import Path
from typing import Literal
from xml.dom import minidom
from xml.etree import ElementTree as ET

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.transforms import frame, from_rpy, to_rpy
from casadical.robot.axes import row_matrix
from casadical.robot.robot import Robot
from casadical.robot.urdf.reading import UrdfChain, read_chain
from casadical.robot.urdf.tree import parse_xml

# Largest change of an origin [m, or entry of a rotation matrix] that leaves its text unchanged.
UNCHANGED_TOLERANCE = 1e-13


def calibrated_urdf_text(
    robot_before: Robot,
    robot_calibrated: Robot,
    path_in: str | Path,
    base_link: str | None = None,
    tip_link: str | None = None,
    base: Literal["robot", "measuring"] = "robot",
    measured_link: str | None = None,
    measuring_link: str | None = None,
) -> str:
    """Return the text of the URDF `path_in` with the calibrated geometry.

    From base link to measured point the new file's kinematics are those of the calibrated robot
    without compliance and effects, for which a URDF has no place: a comment in the file says so.
    Users of the file who do not add the deflections get better accuracy from a robot identified as
    rigid (method KM), whose geometry compensates part of them. Meshes, inertias and limits are
    unchanged; <dynamics> has the damping and friction of the robot's drive, if declared; every link
    keeps its pose relative to its own joint's axis.

    robot_before : as read from the file; robot_calibrated : to be written
    base : what the base link is: the robot's base or the measuring frame
    measured_link : name of a new link at the measured point, with further targets as further links;
        None: the tip link is moved there
    measuring_link : name of a new link on the base link at the measuring frame, such as a camera
        that stands still; None: none
    Raises InputError: another robot than that of the file, a closed loop, a tool that has moved
    where no fixed joint can take it, a taken name; and what `read_urdf` raises.
    """
    path_in = Path(path_in)
    chain = read_chain(path_in, base_link, tip_link)
    _refuse_other_robot(chain, robot_before, robot_calibrated, str(path_in))
    document = parse_xml(path_in)
    T_link0 = chain.base if base == "robot" else robot_calibrated.base.T
    for name, T in _joint_origins(chain, robot_calibrated, T_link0).items():
        _write_frame(_part(document, name, "origin"), T)
    for i, moving in enumerate(chain.moving, 1):
        for name, value in _dynamics(robot_calibrated, i).items():
            _part(document, moving.name, "dynamics").setAttribute(name, value)
    if measured_link:
        tip = np.linalg.inv(chain.tool)
        _add_link(document, chain.tip_link, measured_link, tip @ robot_calibrated.tool.T)
        for target in robot_calibrated.targets:
            name = f"{measured_link}_{re.sub(r'[^A-Za-z0-9_]', '_', target.name)}"
            _add_link(document, chain.tip_link, name, tip @ frame(robot_calibrated.tool.T[:3, :3], target.point))
    else:
        _move_tip(document, chain, robot_calibrated.tool.T, str(path_in))
    if measuring_link:
        _add_link(document, chain.base_link, measuring_link, T_link0 @ np.linalg.inv(robot_calibrated.base.T))
    _comment(document, robot_calibrated, chain, base)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + "\n".join(node.toxml() for node in document.childNodes) + "\n"


def _refuse_other_robot(chain: UrdfChain, before: Robot, after: Robot, source: str) -> None:
    """Refuse another chain than the file's, or a calibrated robot with a closed loop.

    The DH rows before calibration are compared with the file's. Raises InputError.
    """
    if after.loops:
        raise InputError(f"{source}: {after.name!r} has a closed loop, a URDF is a tree; write it with write_robot")
    for robot in (before, after):
        if robot.n != len(chain.moving):
            raise InputError(f"{source}: {len(chain.moving)} joints in the chain, {robot.n} in robot {robot.name!r}")
    for i, (row, joint) in enumerate(zip(chain.rows, before.joints, strict=True), 1):
        # The tolerance is in m or rad.
        if not np.allclose(row_matrix(row), row_matrix(joint), rtol=0, atol=1e-9):
            raise InputError(
                f"{source}: row {i} of robot_before is not that of the file between "
                f"{chain.base_link!r} and {chain.tip_link!r}; hand in what read_urdf gave for the "
                "same file, base_link and tip_link"
            )


def _joint_origins(chain: UrdfChain, robot: Robot, T_link0: Array) -> dict[str, Array]:
    """Return the new <origin> of every moving joint, name -> shape (4, 4) [m].

    A URDF link is at C_k in our frame k, before and after calibration; between two links are the DH
    row and, before the joint, the fixed joints.

    chain : of the file; robot : calibrated; T_link0 : frame 0 in the base link's, (4, 4) [m]
    """
    origins = {}
    behind, link = T_link0, chain.base_link  # behind: our frame k-1 in that of the URDF link k-1
    for row, joint, T in zip(robot.joints, chain.moving, chain.link_frames, strict=True):
        C = np.linalg.inv(T) @ chain.frames[joint.child]
        fixed = np.linalg.inv(chain.frames[link]) @ chain.frames[joint.parent]
        origins[joint.name] = np.linalg.inv(fixed) @ behind @ row_matrix(row) @ C
        behind, link = np.linalg.inv(C), joint.child
    return origins


def _move_tip(document: minidom.Document, chain: UrdfChain, tool: Array, source: str) -> None:
    """Set the origin of the fixed joint at the tip so that the tip link is at the tool.

    tool : in the last link's modified DH frame, shape (4, 4) [m].
    """
    if np.allclose(tool, chain.tool, rtol=0, atol=UNCHANGED_TOLERANCE):
        return
    if chain.fixed_tip is None:
        raise InputError(
            f"{source}: the calibrated tool is not at {chain.tip_link!r}, which turns on joint "
            f"{chain.moving[-1].name!r} itself; name a new link for the measured point as "
            "measured_link"
        )
    before = np.linalg.inv(chain.link_frames[-1]) @ chain.frames[chain.fixed_tip.parent]
    _write_frame(_part(document, chain.fixed_tip.name, "origin"), np.linalg.inv(before) @ tool)


def _children(element: minidom.Element, tag: str) -> list[minidom.Element]:
    """Return the direct child elements with a tag."""
    return [c for c in element.childNodes if isinstance(c, minidom.Element) and c.tagName == tag]


def _root(document: minidom.Document) -> minidom.Element:
    """Return the root element of the XML."""
    assert document.documentElement is not None
    return document.documentElement


def _part(document: minidom.Document, joint: str, tag: str) -> minidom.Element:
    """Return the element with a tag of the joint of this name, created if there is none.

    A new <origin> becomes the first child, others the last.
    """
    element = next(j for j in _children(_root(document), "joint") if j.getAttribute("name") == joint)
    if parts := _children(element, tag):
        return parts[0]
    made = document.createElement(tag)
    element.insertBefore(made, element.firstChild if tag == "origin" else None)
    return made


def _write_frame(origin: minidom.Element, T: Array) -> None:
    """Write T, shape (4, 4) [m], as the attributes xyz and rpy where these have changed."""
    xyz, rpy = (np.array([float(v) for v in (origin.getAttribute(k) or "0 0 0").split()]) for k in ("xyz", "rpy"))
    if np.abs(T[:3, 3] - xyz).max() > UNCHANGED_TOLERANCE:
        origin.setAttribute("xyz", _text(T[:3, 3]))
    if np.abs(T[:3, :3] - from_rpy(rpy)).max() > UNCHANGED_TOLERANCE:
        origin.setAttribute("rpy", _text(to_rpy(T[:3, :3])))


def _text(values: Array) -> str:
    """Return numbers as text with full precision."""
    return " ".join(repr(float(v)) for v in values)


def _comment_text(text: str) -> str:
    """Return the text without two adjacent dashes, which a comment must not contain."""
    return re.sub("-(?=-)", "- ", text)


def _add_link(document: minidom.Document, parent: str, name: str, T: Array) -> None:
    """Add a link on a fixed joint with the origin T in the parent link, shape (4, 4) [m]."""
    root = _root(document)
    joint_name = f"{name}_joint"
    taken = {e.getAttribute("name") for tag in ("link", "joint") for e in _children(root, tag)}
    if taken & {name, joint_name}:
        raise InputError(f"measured_link {name!r}: a link or joint of this name is there already; choose another")
    link, joint = document.createElement("link"), document.createElement("joint")
    link.setAttribute("name", name)
    joint.setAttribute("name", joint_name)
    joint.setAttribute("type", "fixed")
    for tag, attribute, value in (("parent", "link", parent), ("child", "link", name)):
        end = document.createElement(tag)
        end.setAttribute(attribute, value)
        joint.appendChild(end)
    origin = document.createElement("origin")
    _write_frame(origin, T)
    joint.appendChild(origin)
    for element in (link, joint):
        root.appendChild(element)
        root.appendChild(document.createTextNode("\n"))


def _comment(document: minidom.Document, robot: Robot, chain: UrdfChain, base: str) -> None:
    """Add a comment on what the calibrated URDF contains and what it lacks."""
    frame = "the robot's base frame" if base == "robot" else "the measuring frame"
    text = (
        f" Calibrated by casadical: the joint origins from {chain.base_link} to the measured point "
        f"carry the identified geometry; {chain.base_link} is {frame}. "
    )
    soft = [f"c{i} = {j.compliance:.6g}" for i, j in enumerate(robot.joints, 1) if j.compliance]
    if soft:
        text += (
            "Joint compliance has no place in a URDF and is NOT in this file: add c_i tau_i of the "
            f"gravity torque tau to each reading ({', '.join(soft)} rad/(N m) or m/N). "
        )
    if robot.effects:
        text += f"Effects that are NOT in this file either: {', '.join(e.name for e in robot.effects)}. "
    root = _root(document)
    root.insertBefore(document.createComment(_comment_text(text)), root.firstChild)
    root.insertBefore(document.createTextNode("\n  "), root.firstChild)


def new_urdf(robot: Robot) -> str:
    """Return the text of a URDF of any robot without loops.

    base_link is the robot's base frame, the joints have their names, else joint1 .. jointN, and
    <mimic> where they follow one other joint. Compliances, other couplings and effects have no
    place in a URDF: a comment says so. The base's pose and further targets are omitted.

    robot : calibrated or nominal
    Raises InputError: a robot with a closed loop.
    """
    if robot.loops:
        raise InputError(
            f"{robot.name!r} has a closed loop, a URDF is a tree; write it with: casadical export model --to mjcf"
        )
    root = ET.Element("robot", name=robot.name)
    root.append(ET.Comment(_about(robot)))
    ET.SubElement(root, "link", name="base_link")
    parent, names = "base_link", [joint.name for joint in robot.joints]
    measured = "measured"  # name of the link at the measured point
    if not all(names) or len(set(names)) < robot.n or f"{measured}_joint" in names:
        names = [f"joint{i}" for i in robot.numbers]
    for i, row in enumerate(robot.joints, 1):
        link = ET.SubElement(root, "link", name=f"link{i}")
        if row.body and row.body.mass > 0:
            inertial = ET.SubElement(link, "inertial")
            ET.SubElement(inertial, "origin", xyz=_text(row.body.com), rpy="0 0 0")
            ET.SubElement(inertial, "mass", value=repr(float(row.body.mass)))
            moments = row.body.likely_inertia[np.triu_indices(3)]
            named = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), moments, strict=True)
            ET.SubElement(inertial, "inertia", {name: repr(float(value)) for name, value in named})
        kind = "revolute" if row.kind == "revolute" else "prismatic"
        joint = _joint(root, names[i - 1], kind, parent, f"link{i}", row_matrix(row))
        ET.SubElement(joint, "axis", xyz="0 0 1")
        ends = {"lower": repr(float(row.lower)), "upper": repr(float(row.upper))}
        # Placeholder for the effort limit [N m or N] that a URDF requires.
        # Placeholder for the velocity limit [rad/s or m/s] that a URDF requires.
        ET.SubElement(joint, "limit", {**ends, "effort": "1e4", "velocity": "10"})
        if dynamics := _dynamics(robot, i):
            ET.SubElement(joint, "dynamics", dynamics)
        if row.coupling and len(row.coupling.follows) == 1:
            ((other, times),) = row.coupling.follows
            how = {"multiplier": repr(times), "offset": repr(float(row.coupling.at))}
            ET.SubElement(joint, "mimic", {"joint": names[other - 1], **how})
        parent = f"link{i}"
    ET.SubElement(root, "link", name=measured)
    _joint(root, f"{measured}_joint", "fixed", parent, measured, robot.tool.T)
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def no_urdf_place(robot: Robot) -> list[str]:
    """Return sentences on how joints move or count that has no place in a URDF; [] if none has."""
    odd = [i for i, j in enumerate(robot.joints, 1) if j.coupling and len(j.coupling.follows) != 1]
    led = [i for i, j in enumerate(robot.joints, 1) if j.leader]
    lines = [f"joint {i} follows others, or is locked: it moves by itself here" for i in odd]
    lines += [f"joint {i} mimics a joint that is not in this file: it moves by itself here" for i in led]
    if robot.counts_otherwise:
        lines.append(f"its angles q are not the controller's readings J: {robot.readings_in_words}")
    return lines


def _dynamics(robot: Robot, joint: int) -> dict[str, str]:
    """Return attribute ("damping", "friction") -> value as text, as far as [drive] has them.

    They are in [N m s/rad] and [N m] (prismatic: [N s/m] and [N]). joint : number, from 1
    """
    if robot.drive is None:
        return {}
    declared = {name: robot.drive.of_joints(name, robot.n) for name in ("damping", "friction")}
    return {name: repr(float(values[joint - 1])) for name, values in declared.items() if values is not None}


def _about(robot: Robot) -> str:
    """Return the text of a new URDF's comment: what it contains and what has no place in it."""
    springs = [f"{i}" for i, j in enumerate(robot.joints, 1) if j.compliance]
    guessed = [f"{i}" for i, j in enumerate(robot.joints, 1) if j.body and j.body.inertia is None]
    lines = [f"Written by casadical: geometry{', masses and inertias' if any(j.body for j in robot.joints) else ''}."]
    if guessed:
        lines.append(f"Inertias of links {', '.join(guessed)} are unknown: placeholders stand here.")
    if springs:
        lines.append(f"The springs of joints {', '.join(springs)} have no place in a URDF: the arm is rigid here.")
    lines += [f"The effect {e.label} has no place in a URDF." for e in robot.effects]
    lines += [f"{line[0].upper()}{line[1:]}." for line in no_urdf_place(robot)]
    return "\n  " + "\n  ".join(map(_comment_text, lines)) + "\n"


def _joint(root: ET.Element, name: str, kind: str, parent: str, child: str, T: Array) -> ET.Element:
    """Add a joint with the origin T in the parent link, shape (4, 4) [m]; return its element."""
    joint = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=_text(T[:3, 3]), rpy=_text(to_rpy(T[:3, :3])))
    return joint
