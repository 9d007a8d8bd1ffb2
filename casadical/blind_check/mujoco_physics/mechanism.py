"""Mechanism in the terms of a physics engine: bodies, joints, a loop, cords and shafts."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, Self

import numpy as np

from casadical.blind_check.mujoco_physics.plant import Array

# Unit vector of a body's x axis, in its own frame.
X = (1.0, 0.0, 0.0)
# Unit vector of a body's y axis, in its own frame.
Y = (0.0, 1.0, 0.0)
# Unit vector of a body's z axis, in its own frame.
Z = (0.0, 0.0, 1.0)
# Origin of a body's frame [m].
ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Joint:
    """A hinge or a slide of a body in its parent.

    The joints of one body act in their order, the first at the parent.

    name : unique in the mechanism
    kind, axis, at : hinge or slide, its direction and a point on it [m], in the body's frame
    ref : coordinate at which the body is at its ``place`` [rad or m]
    stiffness, hardening : spring torque ``stiffness x + hardening x^3`` [N m, N] at the deflection
        ``x`` from its rest
    motor : 1-based number of the motor whose angle is the spring's rest; None: the rest is 0
    friction, rubbing : dry friction [N m, N], and its increase per unit of the spring's torque
    limits : coordinates of hard stops, or None
    inertia, damping : of the joint itself (a rotor behind its gear) [kg m^2, kg] and [N m s/rad, N
        s/m]
    keeps : whether the coordinate at one pose is where the motion to the next begins
    """

    name: str
    kind: Literal["hinge", "slide"] = "hinge"
    axis: tuple[float, float, float] = Z
    at: tuple[float, float, float] = ORIGIN
    ref: float = 0.0
    stiffness: float = 0.0
    hardening: float = 0.0
    motor: int | None = None
    friction: float = 0.0
    rubbing: float = 0.0
    limits: tuple[float, float] | None = None
    inertia: float = 0.0
    damping: float = 0.0
    keeps: bool = False


@dataclass(frozen=True)
class Body:
    """A rigid body; without joints it is fixed to its parent.

    name, parent : of the body
    place : in its parent, shape (4, 4) [m]
    joints : by which it moves
    mass : [kg]
    com : mass centre in the body's frame, shape (3,) [m]
    gyration : radius of gyration about the mass centre [m]
    marks : named points in the body's frame, shape (3,) [m]
    """

    name: str
    parent: str
    place: Array
    joints: tuple[Joint, ...] = ()
    mass: float = 0.0
    com: tuple[float, float, float] = ORIGIN
    gyration: float = 0.1
    marks: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Cord:
    """A spring between two named points.

    There is no force while its length is within ``rest`` [m]; beyond, the stiffness is
    ``stiffness`` [N/m].
    """

    name: str
    first: str
    second: str
    stiffness: float
    rest: tuple[float, float]


@dataclass(frozen=True)
class Shaft:
    """A torsion spring or dry friction on a weighted sum of joint coordinates.

    The spring's rest is the angle of ``motor``; there is no torque within ``slack`` [rad] of it.
    """

    name: str
    joints: Mapping[str, float]
    stiffness: float = 0.0
    motor: int | None = None
    slack: float = 0.0
    friction: float = 0.0
    damping: float = 0.0


@dataclass(frozen=True)
class Mechanism:
    """Bodies, parents before their children, and what connects them apart from their joints.

    bodies : of the mechanism
    loop : two named points that form a ball joint, which closes a chain of bodies
    cords : springs between two bodies
    shafts : couplings between joints
    travels : whether the equilibrium depends on the motion before it, as with friction and play
    payload_factor : true over declared mass of the payload
    """

    bodies: tuple[Body, ...]
    loop: tuple[str, str] | None = None
    cords: tuple[Cord, ...] = ()
    shafts: tuple[Shaft, ...] = ()
    travels: bool = False
    payload_factor: float = 1.0

    def body(self, name: str) -> Body:
        """Return the body of this name."""
        return next(b for b in self.bodies if b.name == name)

    def holder(self, joint: str) -> Body:
        """Return the body that has the joint of this name."""
        return next(b for b in self.bodies if any(j.name == joint for j in b.joints))

    def joint(self, name: str) -> Joint:
        """Return the joint of this name."""
        return next(j for j in self.holder(name).joints if j.name == name)

    def with_body(self, changed: Body) -> Self:
        """Return the mechanism with a changed body in place of the one of its name."""
        return replace(self, bodies=tuple(changed if b.name == changed.name else b for b in self.bodies))

    def with_joints(self, name: str, *joints: Joint) -> Self:
        """Return the mechanism with these joints in place of the one of that name."""
        body = self.holder(name)
        kept = [[j] if j.name != name else joints for j in body.joints]
        return self.with_body(replace(body, joints=tuple(j for some in kept for j in some)))

    def with_body_after(self, name: str, new: Body) -> Self:
        """Return the mechanism with ``new`` between the body ``name`` and all that it carried.

        Nothing is moved by that.
        """
        bodies: list[Body] = []
        for body in self.bodies:
            if body.parent == name:
                place: Array = np.linalg.inv(new.place) @ body.place
                body = replace(body, parent=new.name, place=place)
            bodies.append(body)
            if body.name == name:
                bodies.append(replace(new, parent=name))
        return replace(self, bodies=tuple(bodies))
