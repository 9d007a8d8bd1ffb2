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

    name : name, unique in the mechanism
    kind : hinge or slide
    axis : unit vector of its axis in the body's frame
    at : a point on its axis in the body's frame [m]
    ref : coordinate at which the body is at its `place` [rad or m]
    stiffness, hardening : k and h of the spring's torque k x + h x^3 [N m, or N of a slide] at the
        deflection x from its rest
    motor : number, from 1, of the motor whose coordinate is the spring's rest; None: the rest is 0
    friction : dry friction without load [N m or N]
    rubbing : increase of the friction per unit of the spring's torque
    limits : coordinates of the hard stops [rad or m]; None: there are none
    inertia : inertia of the joint itself, as of a rotor behind its gear [kg m^2 or kg]
    damping : viscous damping of the joint [N m s/rad or N s/m]
    keeps : whether the coordinate at one pose is that at which the motion to the next one begins
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

    name : name of the body
    parent : name of its parent
    place : pose in the parent's frame with all joints at their `ref`, shape (4, 4) [m]
    joints : joints by which it moves in its parent
    mass : mass [kg]
    com : mass centre in the body's frame, shape (3,) [m]
    gyration : radius of gyration about the mass centre, the same for all axes [m]
    marks : points in the body's frame by name, shape (3,) [m]
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
    """A spring between two named points of bodies.

    name : name of the spring; first, second : names of the points
    stiffness : stiffness outside of `rest` [N/m]
    rest : lower and upper length between which there is no force [m]
    """

    name: str
    first: str
    second: str
    stiffness: float
    rest: tuple[float, float]


@dataclass(frozen=True)
class Shaft:
    """A torsion spring, dry friction and damping on a weighted sum of joint coordinates.

    name : name of the shaft
    joints : weight of each joint's coordinate by the joint's name
    stiffness : stiffness of the spring [N m/rad]
    motor : number, from 1, of the motor whose angle is the spring's rest; None: the sum of the
        joints' `ref` is
    slack : deflection from the rest up to which there is no torque [rad]
    friction : dry friction [N m]; damping : viscous damping [N m s/rad]
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

    bodies : bodies, parents before their children
    loop : names of two points that form a ball joint, which closes a chain of bodies; None: none
    cords : springs between two bodies
    shafts : springs and friction on sums of joint coordinates
    travels : whether the equilibrium depends on the motion before it, as with friction and play
    payload_factor : true mass of the payload divided by the declared one
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
        by_joint = [[j] if j.name != name else joints for j in body.joints]
        return self.with_body(replace(body, joints=tuple(j for some in by_joint for j in some)))

    def with_body_after(self, name: str, new: Body) -> Self:
        """Return the mechanism with a new body between a body and all its children.

        The children keep their poses; the parent of `new` becomes the body.

        name : name of the body; new : new body, with its place in the body's frame
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
