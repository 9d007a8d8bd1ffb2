"""The base of all effects and the seams at which one may enter the model.

In the order in which a pose is computed: `energy` (a spring or a mass: it loads the joints), `joint_angle` (added to
the reading), `link` (behind the joint's own motion), `base`, `tool`, `measurement`. An effect overrides the seams it
needs; the defaults leave the model as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from casadical.core.arm import Arm
from casadical.core.parameters import Parameter
from casadical.core.transforms import Array, Symbolic, apply


@dataclass(frozen=True)
class Context:
    """What an effect may look at; every entry but the first two is symbolic.

    arm : rows, masses, limits, loops, payload
    torque_scale : great gravity torques on each joint, shape (n,) [N m or N] (see `Robot.torque_scale`)
    q : joint readings, shape (n,) [rad or m]
    conditions : logged columns by name (payload_kg, temperature_degC, progress, approach1, ...)
    values : the value of every parameter of the model, by name [SI]
    frames : T_01..T_0n, the rigid links' frames in the robot's base frame, each (4, 4)
    gravity : in the robot's base frame, shape (3,) [m/s^2]
    torque : of gravity on the actuated joints, shape (n,) [N m or N]; None at the seam `energy`, which makes it
    """

    arm: Arm
    torque_scale: Array
    q: Symbolic
    conditions: Mapping[str, Symbolic]
    values: Mapping[str, Symbolic]
    frames: tuple[Symbolic, ...]
    gravity: Symbolic
    torque: Symbolic = None

    def load(self, joint: int) -> Symbolic:
        """Gravity torque on a joint (1-based) as a share of its great torques."""
        return self.torque[joint - 1] / self.torque_scale[joint - 1]

    def moment(self, link: int) -> Symbolic:
        """Moment [N m] of all weight from a link (1-based) on, about its origin; in the base frame, shape (3,)."""
        origin = self.frames[link - 1][:3, 3]
        joints = self.arm.joints
        loads = [(j.body.mass, apply(T, ca.DM(j.body.com))) for j, T in zip(joints, self.frames, strict=True) if j.body]
        loads = loads[sum(1 for j in joints[: link - 1] if j.body) :]
        if self.arm.payload:
            mass = self.conditions.get("payload_kg", self.arm.payload.mass)
            loads.append((mass, apply(self.frames[-1], ca.DM(self.arm.payload.com))))
        total = ca.SX.zeros(3)
        for mass, centre in loads:
            total = total + ca.cross(centre - origin, mass * self.gravity)
        return total

    @property
    def great_moment(self) -> float:
        """The greatest of the joints' great torques [N m]."""
        return float(self.torque_scale.max())


# One sigma, in realistic sizes, of an effect once it is in a model: wide, for somebody had a reason to put it there,
# and a robot's own may be many times the usual.
CHOSEN = 8.0


@dataclass(frozen=True)
class Effect:
    """One unmodelled effect. Subclass it, name it, give its parameters, and override the seams it acts at.

    joint : 1-based, of effects that belong to a joint
    """

    joint: int | None = None

    name: ClassVar[str] = "none"
    # One sigma of each parameter once the effect is in a model, in sizes.
    held: ClassVar[float] = CHOSEN
    # Columns that must have been logged.
    needs: ClassVar[tuple[str, ...]] = ()
    # What to say about its physics, its source, and what it is confused with.
    physics: ClassVar[str] = ""
    confused_with: ClassVar[str] = ""

    @property
    def label(self) -> str:
        """name, or name@joint."""
        return self.name if self.joint is None else f"{self.name}@{self.joint}"

    @property
    def conditions(self) -> tuple[str, ...]:
        """Columns that the model needs, logged or derived from logged ones (see `derived_columns`)."""
        return self.needs

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Its parameters: name -> (realistic size, one sigma; unit). Zero must mean: no effect."""
        return {}

    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters, named label.name, without bounds that matter and with a prior that hardly holds them back."""
        return tuple(
            Parameter(f"{self.label}.{name}", self.label, unit, 0.0, size, -1e3 * size, 1e3 * size, CHOSEN * size)
            for name, (size, unit) in self.sizes().items()
        )

    def value(self, context: Context, name: str) -> Symbolic:
        """The symbol of one of its parameters."""
        return context.values[f"{self.label}.{name}"]

    def energy(self, context: Context) -> Symbolic:
        """Potential energy that it adds [J]."""
        return 0.0

    def joint_angle(self, context: Context) -> Symbolic:
        """What it adds to the joint variables, shape (n,) [rad or m]; by default `angle`, at its own joint."""
        moved = ca.SX.zeros(context.arm.n)
        if self.joint is not None:
            moved[self.joint - 1] = self.angle(context, context.q[self.joint - 1])
        return moved

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        """What it adds to its own joint, whose reading is q [rad or m]."""
        return 0.0

    def link(self, number: int, context: Context) -> Symbolic:
        """Transform (4, 4) behind link `number` (1-based), in that link's frame."""
        return ca.SX.eye(4)

    def base(self, context: Context) -> Symbolic:
        """Transform (4, 4) of the robot's foot, in the base frame."""
        return ca.SX.eye(4)

    def tool(self, context: Context) -> Symbolic:
        """Transform (4, 4) in front of the tool, in the flange frame."""
        return ca.SX.eye(4)

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """The measured point, shape (3,) [m], as the instrument reports it."""
        return point
