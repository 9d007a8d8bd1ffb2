"""Mechanism in the terms of a physics engine: bodies, joints, a loop, cords and shafts.

That of a robot as built has links on springs, and four-bar and payload as bodies.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

import numpy as np

from casadical.blind_check.mujoco_physics.plant import (
    Array,
    FourBar,
    Plant,
    close_loop,
    crank_angle,
    pivot,
    slide,
    turn,
)

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


# Time constant with which every spring joint alone comes to rest in the simulation [s].
SPRING_TIME_CONSTANT_S = 0.1


def mechanism(plant: Plant) -> Mechanism:
    """Return the mechanism of a robot as built.

    Bodies are ``pedestal``, ``link1`` .., ``tool`` and ``payload``, joints are ``joint1`` ..

    A four-bar that drives joint 3 adds the bodies ``crank`` (turned by ``joint3`` on the axis of
    joint 2) and ``coupler``, and the free hinge ``elbow`` between links 2 and 3; the coupler ends
    in a ball joint on link 3; so for other driven joints. `ref` is the middle of the joint ranges.
    """
    middle = np.mean(plant.ranges, 1)
    bodies = [Body("pedestal", "world", plant.base)]
    parent, before = "pedestal", np.eye(4)
    for i in range(plant.n):
        kind = "slide" if i + 1 in plant.slides else "hinge"
        joint = spring(f"joint{i + 1}", plant.stiffness[i], motor=i + 1, ref=float(middle[i]), kind=kind)
        if plant.four_bar is not None and i + 1 == plant.four_bar.driven:
            elbow = float(close_loop(plant, crank_angle(plant, middle[None])).passive[0])
            joint = free("elbow", plant.stiffness[i], ref=elbow)
        place = np.linalg.solve(before, plant.home[i])
        size = float(np.linalg.norm(place[:3, 3])) + 0.1
        bodies.append(
            Body(f"link{i + 1}", parent, _moved(place, joint), (joint,), plant.mass[i], tuple(plant.com[i]), 0.3 * size)
        )
        parent, before = f"link{i + 1}", plant.home[i]
    bodies.append(Body("tool", f"link{plant.n}", np.eye(4), marks={"reflector": plant.reflector}))
    bodies.append(Body("payload", "tool", slide(plant.payload_com), mass=plant.payload_kg))
    plain = Mechanism(tuple(bodies))
    return plain if plant.four_bar is None else _with_four_bar(plain, plant, plant.four_bar, middle)


def start(plant: Plant, angles: Array) -> dict[str, float]:
    """Return joint coordinates by joint name at which the search for the equilibrium starts.

    The small joints of effects are omitted; they start at zero.

    angles : coordinates of the motors, shape (joints,) [rad or m]
    """
    first = {f"joint{i + 1}": float(angles[i]) for i in range(plant.n)}
    if plant.four_bar is not None:
        loop = close_loop(plant, crank_angle(plant, angles[None]))
        first |= {"elbow": float(loop.passive[0]), "coupler_turn": _coupler(plant, angles), "coupler_tilt": 0.0}
    return first


def spring(name: str, stiffness: float, *, inertia_of: float | None = None, **more: object) -> Joint:
    """Return a joint on a spring, critically damped with the time constant `SPRING_TIME_CONSTANT_S`.

    Its inertia and damping are chosen for that; they do not change the equilibrium.

    name : name of the joint; stiffness : stiffness of the spring [N m/rad or N/m]
    inertia_of : stiffness for which inertia and damping are chosen, between the softest and the
        hardest of a spring that hardens; None: `stiffness`
    more : further fields of the `Joint`
    """
    k = float(stiffness if inertia_of is None else inertia_of)
    joint = Joint(
        name, stiffness=float(stiffness), inertia=k * SPRING_TIME_CONSTANT_S**2, damping=2 * k * SPRING_TIME_CONSTANT_S
    )
    return replace(joint, **more)  # type: ignore[arg-type]


def springs(name: str, stiffness: float, limit: float, axes: str, **more: Any) -> tuple[Joint, ...]:
    """Return a joint on a spring along each of some axes, named NAME_x and so on.

    stiffness : [N m/rad or N/m]; limit : hard stops of each joint are at +-limit [rad or m]
    axes : letters of the axes, such as "xy"; more : as of `spring`
    """
    limits, along = (-limit, limit), {"x": X, "y": Y, "z": Z}
    return tuple(spring(f"{name}_{c}", stiffness, axis=along[c], limits=limits, **more) for c in axes)


def free(name: str, like: float, **more: object) -> Joint:
    """Return a joint without a spring, with a tenth of the inertia of a spring joint.

    like : stiffness of that spring joint [N m/rad or N/m]; more : further fields of the `Joint`
    """
    return replace(Joint(name, inertia=0.1 * float(like) * SPRING_TIME_CONSTANT_S**2), **more)  # type: ignore[arg-type]


def _with_four_bar(plain: Mechanism, plant: Plant, bar: FourBar, middle: Array) -> Mechanism:
    """Return the mechanism with crank and coupler of a four-bar added.

    middle : middle of the joint ranges, shape (joints,) [rad or m], at which joints have their
        reference
    """
    d = bar.driven
    k, before = plant.stiffness[d - 1], np.eye(4) if d == 2 else plant.home[d - 3]
    axis = np.linalg.solve(before, plant.home[d - 2])
    crank = spring(f"joint{d}", k, motor=d, ref=float(middle[d - 1]))
    end = bar.crank_m * np.array([np.cos(bar.crank_zero_rad), np.sin(bar.crank_zero_rad), 0.0])
    hinge, tilt = free("coupler_turn", k, ref=_coupler(plant, middle)), free("coupler_tilt", k, axis=(0.0, 1.0, 0.0))
    ends = {"coupler_end": np.array([bar.coupler_m, 0.0, 0.0])}
    bodies = (
        Body("crank", "pedestal" if d == 2 else f"link{d - 2}", _moved(axis, crank), (crank,), mass=1e-3),
        Body("coupler", "crank", _moved(slide(end), hinge), (hinge, tilt), mass=1e-3, marks=ends),
    )
    link = plain.body(f"link{d}")
    direction = np.array([np.cos(bar.passive_offset_rad), -np.sin(bar.passive_offset_rad)])
    end_home = plant.at_home(d - 1, np.append(pivot(plant) + bar.rocker_m * direction, 0.0))
    mark = plant.home[d - 1, :3, :3].T @ (end_home - plant.home[d - 1, :3, 3])
    plain = plain.with_body(replace(link, marks={"rocker_end": mark}))
    return replace(plain, bodies=plain.bodies + bodies, loop=("coupler_end", "rocker_end"))


def _coupler(plant: Plant, angles: Array) -> float:
    """Return the angle of the coupler relative to the crank [rad], from -pi to pi.

    angles : coordinates of the motors, shape (joints,) [rad or m]
    """
    crank = crank_angle(plant, angles[None])
    loop = close_loop(plant, crank)
    x, y = (loop.coupler_end - loop.crank_end)[0]
    return float((np.arctan2(y, x) - crank[0] + np.pi) % (2 * np.pi) - np.pi)


def _moved(place: Array, joint: Joint) -> Array:
    """Return the pose of a body in its parent with its joint at its reference, shape (4, 4) [m].

    place : pose with the joint at zero, shape (4, 4) [m]
    """
    up, by = np.array([0.0, 0.0, 1.0]), np.array(joint.ref)
    return np.asarray(place @ (slide(joint.ref * up) if joint.kind == "slide" else turn(up, np.zeros(3), by)))
