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

from ..parameters import Parameter
from ..transforms import Symbolic


@dataclass(frozen=True)
class Context:
    """What an effect may look at; every entry is symbolic.

    q : joint readings, shape (n,) [rad or m]
    conditions : logged columns by name (payload_kg, temperature_degC, time_s, approach1, ...)
    values : the value of every parameter of the model, by name [SI]
    frames : T_01..T_0n, the rigid links' frames in the robot's base frame, each (4, 4)
    gravity : in the robot's base frame, shape (3,) [m/s^2]
    torque : of gravity on the actuated joints, shape (n,) [N m or N]; None at the seam `energy`, which makes it
    """

    q: Symbolic
    conditions: Mapping[str, Symbolic]
    values: Mapping[str, Symbolic]
    frames: tuple[Symbolic, ...]
    gravity: Symbolic
    torque: Symbolic = None


class Effect:
    """One unmodelled effect. Subclass, name it, and override `parameters` and the seams it acts at."""

    name: ClassVar[str] = "none"
    conditions: tuple[str, ...] = ()

    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters; zero must mean: no effect."""
        return ()

    def energy(self, context: Context) -> Symbolic:
        """Potential energy that it adds [J]."""
        return 0.0

    def joint_angle(self, context: Context) -> Symbolic:
        """What it adds to the joint variables, shape (n,) [rad or m]."""
        return ca.SX.zeros(context.q.numel())

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
