"""A balancing spring in MuJoCo: a tendon between two sites with a zero-length spring and a constant pull.

The torque of `GravityCompensator`, T (S sin t + C cos t + P sin t / l), is that of a spring without rest length, k a b
sin(t + phase), and that of a constant pull F along the line from anchor to lever, F a b sin t / length.
"""

from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np

from casadical.core.arrays import Array
from casadical.core.parts import Joint
from casadical.effects.counterparts import Balancer
from casadical.export.mjcf.elements import numbers
from casadical.robot.axes import row_matrix

# Length of the lever [m]: arbitrary, as stiffness and pull are scaled by it.
LEVER = 0.3


def add_sites(balancer: Balancer, before: ET.Element, behind: Array, link: ET.Element, row: Joint) -> None:
    """The ends of the tendons: anchors on the body before the joint (link frame at `behind`), the lever on the link."""
    name, b = f"balancer{balancer.joint}", balancer.anchor * LEVER
    T = behind @ row_matrix(replace(row, theta=0.0))
    for suffix, angle in (("spring", balancer.phase - balancer.ahead + np.pi), ("pull", balancer.phase + np.pi)):
        at = T @ np.array([b * np.cos(angle), b * np.sin(angle), 0.0, 1.0])
        ET.SubElement(before, "site", name=f"{name}_{suffix}", pos=numbers(*at[:3]))
    ET.SubElement(link, "site", name=f"{name}_lever", pos=numbers(LEVER, 0, 0))


def add_tendons(balancer: Balancer, tendons: ET.Element, actuators: ET.Element) -> None:
    """The spring and, where there is preload, the pull: an actuator whose command does nothing."""
    name, b = f"balancer{balancer.joint}", balancer.anchor * LEVER
    stiffness = balancer.swing / (LEVER * b)
    for suffix in ("spring", "pull"):
        node = ET.SubElement(tendons, "spatial", name=f"{name}_{suffix}")
        if suffix == "spring":
            node.set("stiffness", numbers(stiffness))
            node.set("springlength", "0 0")
        for end in (f"{name}_{suffix}", f"{name}_lever"):
            ET.SubElement(node, "site", site=end)
    # l is measured in anchor lengths there: T P sin t / (length / b) = F a b sin t / length.
    pull = {"biastype": "affine", "gainprm": "0", "biasprm": numbers(-balancer.pull / LEVER, 0, 0)}
    ET.SubElement(actuators, "general", {"name": f"{name}_pull", "tendon": f"{name}_pull", **pull})
