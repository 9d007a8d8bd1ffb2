"""Disturbances of the drives that need no load: gears, encoders, couplings, zeros."""

from dataclasses import dataclass

import numpy as np

from casadical.blind_check.mujoco_physics.plant import Array
from casadical.blind_check.mujoco_physics.stops import Stops, only
from numpy_physics.disturbance import Disturbance


@dataclass(frozen=True)
class GearEccentricity(Disturbance):
    """The joint is read on a disc off its centre by ``size`` radii, and oval by ``oval``: the angle seen from there."""

    joint: int
    size: float = 40e-6
    phase: float = 0.6
    oval: float = 30e-6
    oval_phase: float = 1.1

    def misread(self, stops: Stops) -> Array:
        q = stops.q[:, self.joint - 1]
        centred = np.arctan2(np.sin(q) + self.size * np.sin(self.phase), np.cos(q) + self.size * np.cos(self.phase))
        turned = q + self.oval_phase
        rounded = np.arctan2((1 + 2 * self.oval) * np.sin(turned), np.cos(turned))
        return only(self.joint, _wrapped(centred - q) + _wrapped(rounded - turned))


@dataclass(frozen=True)
class TransmissionRipple(Disturbance):
    """Teeth pass ``cycles`` a turn: a skewed wave of ``size`` [rad], stronger on one side of the wheel."""

    joint: int
    size: float = 20e-6
    cycles: int = 4
    phase: float = 0.3

    def misread(self, stops: Stops) -> Array:
        q = stops.q[:, self.joint - 1]
        mesh = self.cycles * q + self.phase
        return only(self.joint, self.size * (1 + 0.3 * np.cos(q - self.phase)) * np.sin(mesh + 0.4 * np.sin(mesh)))


@dataclass(frozen=True)
class JointScale(Disturbance):
    """A belt pulley too large by the share ``size``: the joint turns by that much more than it reads."""

    joint: int
    size: float = 60e-6

    def misread(self, stops: Stops) -> Array:
        return only(self.joint, stops.q[:, self.joint - 1] * self.size)


@dataclass(frozen=True)
class JointCoupling(Disturbance):
    """Bevel gears carry the share ``size`` of joint ``source`` over to the joint, a little less far from zero."""

    joint: int
    source: int
    size: float = 80e-6

    def misread(self, stops: Stops) -> Array:
        return only(self.joint, self.size * 4 * np.arctan(stops.q[:, self.source - 1] / 4))


@dataclass(frozen=True)
class JointZeroStep(Disturbance):
    """The joint slips by ``size`` [rad] when the share ``at`` of the poses is over; a tenth creeps back in minutes."""

    joint: int
    size: float = 40e-6
    at: float = 0.5

    def misread(self, stops: Stops) -> Array:
        after = stops.progress >= self.at
        since = stops.time_s - (stops.time_s[after][0] if after.any() else 0.0)
        slipped = self.size * (0.9 + 0.1 * np.exp(-np.maximum(since, 0.0) / 300.0))
        return only(self.joint, np.where(after, slipped, 0.0))


@dataclass(frozen=True)
class ThermalZeroDrift(Disturbance):
    """The joint's zero follows the gear housing's warmth by ``size`` [rad/K], a little more when it is hot."""

    joint: int
    size: float = 5e-6
    lag_minutes: float = 8.0

    def misread(self, stops: Stops) -> Array:
        warmth = stops.warmth_after(self.lag_minutes)
        return only(self.joint, self.size * warmth * (1 + 0.03 * warmth))


def _wrapped(angle: Array) -> Array:
    return (angle + np.pi) % (2 * np.pi) - np.pi
