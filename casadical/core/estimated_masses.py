"""Masses of links whose masses nobody knows, estimated from the reach.

Between light arms (UR10e, Panda: 4 to 7 kg) and heavy ones (KR 210, HH800: 16 to 19 kg a cubic metre of reach) the
moving links weigh 10 kg times the cube of all link lengths, each link half of the one before, its mass centre in its
middle; one sigma is twice the mass. Gravity deflects joints by compliance times torque, so a wrong scale of all
masses is the joints' stiffness: such masses do not determine it, but the deflection.
"""

from dataclasses import replace
from typing import TypeVar

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import Arm, Body, BodyWidth

# Of the moving links together, by the cube of the reach [kg/m^3]; of each link, as a share of the one before.
DENSITY = 10.0
TAPER = 0.5
# One sigma of each mass as a share, and of coordinates of mass centres as a share of the reach.
SHARE, CENTRE = 2.0, 0.1

A = TypeVar("A", bound=Arm)


def without_masses(arm: Arm) -> bool:
    return not any(j.body and j.body.mass > 0 for j in arm.joints)


def with_estimated_masses(robot: A) -> A:
    """The robot with masses of all links estimated from its reach, and marked as estimates."""
    shares = TAPER ** np.arange(robot.n)
    masses = DENSITY * robot.reach**3 * shares / shares.sum()
    joints = tuple(
        replace(joint, body=Body(float(f"{mass:.3g}"), _middle(robot, i)))
        for i, (joint, mass) in enumerate(zip(robot.joints, masses, strict=True))
    )
    width = BodyWidth(SHARE, float(f"{CENTRE * robot.reach:.2g}"))
    return replace(robot, joints=joints, masses="estimated", body_width=width)


def with_payload(robot: A, mass: float) -> A:
    """The robot with a payload of this mass [kg] whose centre lies between flange and measured point."""
    return replace(robot, payload=Body(mass, robot.tool.T[:3, 3] / 2))


def _middle(robot: Arm, i: int) -> Array:
    """Half way from a link's frame to the next one's, or to the measured point, in the link's frame [m]."""
    if i + 1 == robot.n:
        return np.asarray(robot.tool.T[:3, 3] / 2)
    after = robot.joints[i + 1]
    return np.array([after.a, -np.sin(after.alpha) * after.d, np.cos(after.alpha) * after.d]) / 2
