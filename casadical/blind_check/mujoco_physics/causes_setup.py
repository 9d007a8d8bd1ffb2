"""Causes in the measurement: a frame that creeps, a reflector that moves, wrong points, wrong distances."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casadical.blind_check.mujoco_physics.cause import Cause, reflector, settle
from casadical.blind_check.mujoco_physics.equilibrium import Setting
from casadical.blind_check.mujoco_physics.plant import Array, Plant
from casadical.blind_check.mujoco_physics.stops import Stops


@dataclass(frozen=True)
class FrameDrift(Cause):
    """The tracker's stand creeps and turns, by ``shift_m`` (3,) and ``turn_rad`` (3,) in an hour, fast at first."""

    shift_m: tuple[float, float, float]
    turn_rad: tuple[float, float, float]
    settling_minutes: float

    def settings(self, plant: Plant, stops: Stops) -> Sequence[Setting]:
        crept = np.expm1(-stops.time_s / 60 / self.settling_minutes) / np.expm1(-60 / self.settling_minutes)
        return (
            Setting("shift", "tracker", np.outer(crept, self.shift_m)),
            Setting("turn", "tracker", np.outer(crept, self.turn_rad)),
        )


@dataclass(frozen=True)
class TargetShift(Cause):
    """The reflector moves in its nest by ``shift_m`` (3,) in the last frame at the time ``at_s``."""

    shift_m: tuple[float, float, float]
    at_s: float

    def settings(self, plant: Plant, stops: Stops) -> Sequence[Setting]:
        return (Setting("mark", "reflector", np.outer(stops.time_s >= self.at_s, self.shift_m)),)


@dataclass(frozen=True)
class Outliers(Cause):
    """The share ``share`` of the points is wrong by some ``size`` [m], half of them by far more."""

    share: float
    size: float

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
        direction = rng.standard_normal(xyz.shape)
        length = self.size * (0.5 + rng.pareto(2.0, len(xyz)))
        length /= np.linalg.norm(direction, axis=-1)
        hit = rng.random(len(xyz)) < self.share
        return xyz + np.where(hit, length, 0.0)[:, None] * direction


@dataclass(frozen=True)
class RangeOffset(Cause):
    """The tracker, standing at ``stand_m`` (3,), reads every distance too long by ``size`` [m]; on no list."""

    size: float
    stand_m: tuple[float, float, float]

    def settings(self, plant: Plant, stops: Stops) -> Sequence[Setting]:
        sight = reflector(settle(plant, stops)) - np.array(self.stand_m)
        away = sight / np.linalg.norm(sight, axis=1, keepdims=True)
        return (Setting("shift", "tracker", -self.size * away),)
