"""The base of all hidden causes: where in the engine one may act. Each does nothing unless it is given."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from casadical.blind_check.mujoco_physics.equilibrium import Setting
from casadical.blind_check.mujoco_physics.fourbar import close_loop, crank_angle
from casadical.blind_check.mujoco_physics.mechanism import Mechanism
from casadical.blind_check.mujoco_physics.plant import Plant
from casadical.blind_check.mujoco_physics.rigid import Array
from casadical.blind_check.mujoco_physics.stops import Stops


@dataclass(frozen=True)
class Cause:
    """One thing about a robot or its measurement that geometry and linear joint springs do not contain.

    ``travels`` says that where the robot rests depends on where it comes from, ``last`` that others are built in first.
    """

    travels: ClassVar[bool] = False
    last: ClassVar[bool] = False

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        """The mechanism with it."""
        return mechanism

    @property
    def payload_factor(self) -> float:
        """True over declared mass of the payload."""
        return 1.0

    def motors(self, plant: Plant, stops: Stops) -> Array | float:
        """Where the motors stop beyond the readings, (n, joints) [rad]."""
        return 0.0

    def settings(self, plant: Plant, stops: Stops) -> Sequence[Setting]:
        """What is not as built, with values (n, 3) for the n poses."""
        return ()

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
        """What the instrument makes of the positions ``xyz`` (n, 3) [m]."""
        return xyz


@dataclass(frozen=True)
class JointCause(Cause):
    """A cause in a joint (1-based), by so many radians if nothing else is said."""

    joint: int
    size: float


def turned(plant: Plant, stops: Stops, joint: int) -> Array:
    """How far the link beyond ``joint`` is turned in the one before it, (n,) [rad], by the readings."""
    if plant.four_bar is not None and joint == plant.four_bar.driven:
        return close_loop(plant, crank_angle(plant, stops.q)).passive
    return stops.q[:, joint - 1]


def into_parent(plant: Plant, link: int) -> Array:
    """Rotation (3, 3) from the axes of ``link`` (1-based), at zero readings, to those of the link before it."""
    before = np.eye(3) if link == 1 else plant.home[link - 2, :3, :3]
    rotation: Array = before.T @ plant.home[link - 1, :3, :3]
    return rotation


def warmth_inside(stops: Stops, lag_minutes: float) -> Array:
    """Warmth (n,) [K] inside a casting: heat passes through its wall (a third of the lag) into its core (the rest)."""
    steps = np.diff(stops.time_s, prepend=0.0) / 60.0
    wall = core = 0.0
    inside, before = np.empty(len(stops)), 0.0
    for k, (minutes, surface) in enumerate(zip(steps, stops.warmth_K, strict=True)):
        pieces = max(1, int(np.ceil(8 * minutes / max(lag_minutes, 1e-9))))
        for piece in range(1, pieces + 1):
            outside = before + (surface - before) * piece / pieces
            wall += (outside - wall) * -np.expm1(-3 * minutes / pieces / lag_minutes)
            core += (wall - core) * -np.expm1(-1.5 * minutes / pieces / lag_minutes)
        inside[k], before = core, surface
    return inside


def length_of(plant: Plant, link: int) -> Array:
    """From the joint of ``link`` to the next, (3,) [m] in its own axes."""
    frame = plant.home[link - 1]
    length: Array = frame[:3, :3].T @ (plant.stations[link + 1] - frame[:3, 3])
    return length


def beam_axes(length: Array) -> tuple[Array, Array, Array]:
    """Unit vectors (3,) along a beam and across it."""
    e = length / np.linalg.norm(length)
    across = np.cross(e, np.eye(3)[np.argmin(np.abs(e))])
    across /= np.linalg.norm(across)
    return e, across, np.cross(e, across)


def triple(v: Array) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in v)
    return x, y, z
