"""Elements of MJCF: frames, joints on springs, bodies; every number with all its digits."""

from xml.etree import ElementTree as ET

import numpy as np

from casadical.core.arrays import Array

# Time constant [s] with which every spring alone comes to rest; statics depend neither on inertia nor on damping.
SLOW = 0.02
# Mass [kg] of a body that has none: MuJoCo moves no body without mass.
LEAST_MASS = 1e-6


def numbers(*values: float) -> str:
    """Numbers as MJCF takes them."""
    return " ".join(repr(float(v)) for v in values)


def quaternion(R: Array) -> Array:
    """Unit quaternion, shape (4,), scalar first and not negative, of a rotation, shape (3, 3)."""
    # The greatest eigenvector of a symmetric matrix (Bar-Itzhack 2000), which needs no case distinctions.
    K = np.zeros((4, 4))
    K[0, 1:] = K[1:, 0] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    K[1:, 1:] = R + R.T - np.trace(R) * np.eye(3)
    K[0, 0] = np.trace(R)
    q = np.linalg.eigh(K)[1][:, -1]
    return np.asarray(q if q[0] >= 0 else -q)


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
