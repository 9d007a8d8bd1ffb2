"""Disturbances of the measurement: frame, reflector, beam, wrong points."""

from dataclasses import dataclass

import numpy as np

from casadical.blind_check.mujoco_physics.plant import Array, motion, move
from casadical.blind_check.mujoco_physics.stops import Stops
from numpy_physics.disturbance import Disturbance


@dataclass(frozen=True)
class FrameDrift(Disturbance):
    """The instrument's stand settles: the frame creeps by ``shift_m`` and turns by ``turn_rad`` until the end.

    The creep is fast at first (logarithmic in time); ``towards`` and ``about`` give the directions.
    """

    shift_m: float = 50e-6
    turn_rad: float = 20e-6
    towards: tuple[float, float, float] = (0.6, -0.64, 0.48)
    about: tuple[float, float, float] = (0.48, 0.6, 0.64)
    minutes: float = 15.0

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
        minute = 60 * self.minutes
        crept = np.log1p(stops.time_s / minute) / np.log1p(stops.time_s[-1] / minute)
        turn = np.outer(self.turn_rad * crept, self.about)
        return move(motion(turn, np.outer(self.shift_m * crept, self.towards), np.zeros(3)), xyz)


@dataclass(frozen=True)
class TargetShift(Disturbance):
    """The reflector moves in its nest by ``shift_m`` (3,) in frame 6 when the share ``at`` of the poses is over."""

    shift_m: tuple[float, float, float] = (30e-6, -30e-6, 25e-6)
    at: float = 0.5

    def reflector(self, stops: Stops) -> Array:
        return np.outer(stops.progress >= self.at, self.shift_m)


@dataclass(frozen=True)
class BeamRefraction(Disturbance):
    """Warm air: the tracker at ``station_m`` reads distances long by the share ``size`` and its beam sags; on no list.

    ``gradient_K_per_m`` is how much warmer the air gets with height; the index of refraction falls by 1e-6 a kelvin.
    """

    size: float = 5e-6
    gradient_K_per_m: float = 1.0
    station_m: tuple[float, float, float] = (5.0, -4.0, 1.2)

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
        beam = xyz - np.array(self.station_m)
        sag = np.zeros_like(xyz)
        sag[:, 2] = 0.5e-6 * self.gradient_K_per_m * np.sum(beam[:, :2] ** 2, -1)
        bent: Array = xyz + self.size * beam + sag
        return bent


@dataclass(frozen=True)
class Outliers(Disturbance):
    """The share ``share`` of the points is wrong by a length around ``size`` [m] in any direction, some by far more."""

    share: float = 0.03
    size: float = 1e-3

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
        direction = rng.standard_normal(xyz.shape)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        length = self.size * rng.lognormal(0.0, 0.6, len(xyz))
        hit = rng.random(len(xyz)) < self.share
        return xyz + np.where(hit, length, 0.0)[:, None] * direction
