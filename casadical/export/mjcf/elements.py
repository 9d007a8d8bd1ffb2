"""Elements of MJCF: frames, joints on springs, bodies; every number with all its digits."""

from xml.etree import ElementTree as ET

import numpy as np

from casadical.core.arrays import Array
from casadical.core.transforms import quaternion

# Time constant [s] with which every spring alone comes to rest; statics depend neither on inertia nor on damping.
SLOW = 0.02
# Mass [kg] of a body that has none: MuJoCo moves no body without mass.
LEAST_MASS = 1e-6


def numbers(*values: float) -> str:
    """Numbers as MJCF takes them."""
    return " ".join(repr(float(v)) for v in values)


def add_body(parent: ET.Element, name: str, T: Array) -> ET.Element:
    """A body at T, shape (4, 4), in its parent."""
    return ET.SubElement(parent, "body", name=name, pos=numbers(*T[:3, 3]), quat=numbers(*quaternion(T[:3, :3])))


def add_mass(body: ET.Element, mass: float, com: Array) -> None:
    """Mass and mass centre; the inertia is a placeholder."""
    mass = max(mass, LEAST_MASS)
    moment = mass * (0.1 + 0.3 * float(np.linalg.norm(com))) ** 2
    ET.SubElement(body, "inertial", pos=numbers(*com), mass=numbers(mass), diaginertia=numbers(moment, moment, moment))


def add_spring(body: ET.Element, name: str, axis: str, stiffness: float, cubic: float = 0.0) -> ET.Element:
    """A hinge held by a spring."""
    text = numbers(stiffness, 0.0, cubic) if cubic else numbers(stiffness)
    return ET.SubElement(body, "joint", {"name": name, "axis": axis, "stiffness": text, **inert(stiffness)})


def inert(stiffness: float) -> dict[str, str]:
    """Armature and damping of a joint on a spring, by which it comes to rest in `SLOW`."""
    return {"armature": numbers(stiffness * SLOW**2), "damping": numbers(2 * stiffness * SLOW)}
