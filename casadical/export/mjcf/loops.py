"""A four-bar as a closed chain: crank, coupler and rocker with the robot's lengths, closed by equality constraints.

The loop lies in the plane of the carrier's axis, as in `casadical.robot.fourbar`; the driven link turns with the rocker
(a second equality), so that a driven axis that is not exactly parallel to the carrier's is as in the robot.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np

from casadical.core.arrays import Array
from casadical.core.parts import FourBar, Joint
from casadical.effects.counterparts import Drive
from casadical.export.mjcf.elements import SLOW, add_body, add_mass, numbers
from casadical.robot.axes import row_matrix
from casadical.robot.robot import Robot

# Armature of a bar as a share of the drive's; a smaller one makes the constraints soft. Bars have no weight.
BAR = 0.1


def add_loop(
    robot: Robot,
    loop: FourBar,
    ends: Sequence[tuple[ET.Element, Array]],
    links: Mapping[str, ET.Element],
    drive: Drive,
    drive_joints: Callable[[ET.Element, str, Joint, Drive], None],
) -> None:
    """The bars of a loop, and the free hinge of the driven link; links : bodies by name, up to the driven one.

    ends : of base and links, the body on which the next joint stands, and the link's frame in it, shape (4, 4)
    """
    carrier, row = robot.joints[loop.carrier - 1], robot.joints[loop.driven - 1]
    d = loop.driven
    before, behind = ends[loop.carrier - 1]
    crank = add_body(before, f"crank{d}", behind @ row_matrix(replace(carrier, theta=row.theta)))
    drive_joints(crank, f"joint{d}", row, drive)
    coupler = add_body(crank, f"coupler{d}", _along(loop.crank))
    rocker = add_body(links[f"link{loop.carrier}"], f"rocker{d}", _along(row.a))
    heavy = numbers(BAR * drive.stiffness * SLOW**2)
    for body, name in ((coupler, "coupler"), (rocker, "rocker")):
        ET.SubElement(body, "joint", name=f"{name}{d}", axis="0 0 1", armature=heavy)
    for body in (crank, coupler, rocker):
        add_mass(body, 0.0, np.zeros(3))
    ET.SubElement(coupler, "site", name=f"coupler{d}_end", pos=numbers(loop.coupler, 0, 0))
    ET.SubElement(rocker, "site", name=f"rocker{d}_end", pos=numbers(loop.rocker, 0, 0))
    hinge = {"name": f"joint{d}_driven", "axis": "0 0 1", "armature": heavy}
    ET.SubElement(links[f"link{d}"], "joint", hinge)


def closed(equality: ET.Element, loop: FourBar) -> None:
    """The constraints of a loop."""
    d = loop.driven
    ET.SubElement(equality, "connect", name=f"four_bar{d}", site1=f"coupler{d}_end", site2=f"rocker{d}_end")
    ET.SubElement(
        equality, "joint", name=f"driven{d}", joint1=f"joint{d}_driven", joint2=f"rocker{d}", polycoef="0 1 0 0 0"
    )


def _along(length: float) -> Array:
    T = np.eye(4)
    T[0, 3] = length
    return T
