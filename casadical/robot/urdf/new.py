"""A new URDF of a robot that came from none: links, joints and masses of its rows, the measured point as a link."""

from xml.etree import ElementTree as ET

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.core.transforms import to_rpy
from casadical.robot.axes import row_matrix
from casadical.robot.robot import Robot

TIP = "measured"
# A URDF asks for them; they say nothing here.
EFFORT, VELOCITY = "1e4", "10"


def new_urdf(robot: Robot) -> str:
    """The text of a URDF: base_link is the robot's base frame, the joints are joint1 .. jointN.

    Where the base stands in the measuring frame, compliances and effects have no place in a URDF: a comment says so.

    Parameters
    ----------
    robot : Robot
        calibrated or nominal

    Returns
    -------
    str
        XML

    Raises
    ------
    InputError
        a robot with a closed loop

    Examples
    --------
    >>> casadical.robot.urdf.new_urdf(found.robot)[:21]
    '<?xml version="1.0" e'
    """
    if robot.loops:
        raise InputError(
            f"{robot.name!r} has a closed loop, a URDF is a tree; write it with: casadical export model --to mjcf"
        )
    root = ET.Element("robot", name=robot.name)
    root.append(ET.Comment(_about(robot)))
    ET.SubElement(root, "link", name="base_link")
    parent = "base_link"
    for i, row in enumerate(robot.joints, 1):
        link = ET.SubElement(root, "link", name=f"link{i}")
        if row.body and row.body.mass > 0:
            _mass(link, row.body.mass, row.body.com)
        kind = "revolute" if row.kind == "revolute" else "prismatic"
        joint = _joint(root, f"joint{i}", kind, parent, f"link{i}", row_matrix(row))
        ET.SubElement(joint, "axis", xyz="0 0 1")
        ends = {"lower": repr(float(row.lower)), "upper": repr(float(row.upper))}
        ET.SubElement(joint, "limit", {**ends, "effort": EFFORT, "velocity": VELOCITY})
        parent = f"link{i}"
    ET.SubElement(root, "link", name=TIP)
    _joint(root, f"{TIP}_joint", "fixed", parent, TIP, robot.tool.T)
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _about(robot: Robot) -> str:
    springs = [f"{i}" for i, j in enumerate(robot.joints, 1) if j.compliance]
    lines = ["Written by casadical: geometry and masses; inertias are placeholders."]
    if springs:
        lines.append(f"The springs of joints {', '.join(springs)} have no place in a URDF: the arm is rigid here.")
    lines += [f"The effect {e.label} has no place in a URDF." for e in robot.effects]
    return "\n  " + "\n  ".join(line.replace("--", "- -") for line in lines) + "\n"


def _joint(root: ET.Element, name: str, kind: str, parent: str, child: str, T: Array) -> ET.Element:
    joint = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=_text(T[:3, 3]), rpy=_text(to_rpy(T[:3, :3])))
    return joint


def _mass(link: ET.Element, mass: float, com: Array) -> None:
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_text(com), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(float(mass)))
    moment = repr(float(mass * (0.1 + 0.3 * np.linalg.norm(com)) ** 2))
    zero = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
    ET.SubElement(inertial, "inertia", {"ixx": moment, "iyy": moment, "izz": moment, **zero})


def _text(values: Array) -> str:
    return " ".join(repr(float(v)) for v in values)
