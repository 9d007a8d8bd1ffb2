"""Causes in the drives that do not depend on load: gears, encoders, belts, bevels, zeros."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from casadical.blind_check.mujoco_physics.cause import Cause, JointCause, warmth_inside
from casadical.blind_check.mujoco_physics.mechanism import Mechanism, Shaft
from casadical.blind_check.mujoco_physics.plant import Array, Plant
from casadical.blind_check.mujoco_physics.stops import Stops, only


@dataclass(frozen=True)
class GearEccentricity(JointCause):
    """A wheel whose centre is ``size`` radii off its shaft, and oval by ``oval``, rolls on a pinion that is read.

    The pinion turns by the rolled length of the rim, the integral of the rim's distance from the shaft.
    """

    towards: float
    oval: float
    oval_towards: float

    def motors(self, plant: Plant, stops: Stops) -> Array:
        angle = np.linspace(-2 * np.pi, 2 * np.pi, 8001)
        along = angle - self.towards
        off = self.size * np.cos(along) + np.sqrt(1 - (self.size * np.sin(along)) ** 2)
        long, short = 1 + 2 * self.oval, 1 - 2 * self.oval
        turned = angle - self.oval_towards
        rim = off * long * short / np.hypot(short * np.cos(turned), long * np.sin(turned))
        rolled = np.concatenate([[0.0], np.cumsum((rim[1:] + rim[:-1]) / 2 * np.diff(angle))])
        rolled *= 4 * np.pi / rolled[-1]
        lag = angle - (rolled - 2 * np.pi)
        q = stops.q[:, self.joint - 1]
        return only(self.joint, np.interp(q, rolled - 2 * np.pi, lag), plant.n)


@dataclass(frozen=True)
class TransmissionRipple(JointCause):
    """Teeth pass ``cycles`` a turn; each carries a little ahead while it enters and behind while it leaves."""

    cycles: int
    phase: float

    def motors(self, plant: Plant, stops: Stops) -> Array:
        mesh = self.cycles * stops.q[:, self.joint - 1] + self.phase
        flank = np.arcsin(0.95 * np.sin(mesh)) / np.arcsin(0.95)
        return only(self.joint, self.size * flank, plant.n)


@dataclass(frozen=True)
class JointScale(JointCause):
    """A pulley larger than drawn by the share ``size``."""

    def motors(self, plant: Plant, stops: Stops) -> Array:
        return only(self.joint, self.size * stops.q[:, self.joint - 1], plant.n)


@dataclass(frozen=True)
class JointCoupling(Cause):
    """Bevel gears: the springs of the joint wind between its motor and the joint less ``size`` times joint ``source``.

    A torque in the joint then works back on the source, too.
    """

    last: ClassVar[bool] = True

    joint: int
    source: int
    size: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        name, source = f"joint{self.joint}", f"joint{self.source}"
        held = mechanism.joint(name)
        bevel = Shaft(f"bevel{self.joint}", {name: 1.0, source: -self.size}, held.stiffness, motor=self.joint)
        loose = replace(held, stiffness=0.0, motor=None)
        shafts = [
            replace(s, joints={**s.joints, source: -self.size}) if s.motor == self.joint else s
            for s in mechanism.shafts
        ]
        return replace(mechanism.with_joint(loose), shafts=(*shafts, bevel))


@dataclass(frozen=True)
class JointZeroStep(JointCause):
    """The joint's zero jumps by ``size`` [rad] at the time ``at_s``."""

    at_s: float

    def motors(self, plant: Plant, stops: Stops) -> Array:
        return only(self.joint, np.where(stops.time_s >= self.at_s, self.size, 0.0), plant.n)


@dataclass(frozen=True)
class ThermalZeroDrift(JointCause):
    """The joint's zero follows the warmth inside its gear by ``size`` [rad/K]."""

    lag_minutes: float

    def motors(self, plant: Plant, stops: Stops) -> Array:
        return only(self.joint, self.size * warmth_inside(stops, self.lag_minutes), plant.n)


@dataclass(frozen=True)
class EncoderPit(JointCause):
    """A scratched encoder disc: the joint is off by up to ``size`` within ``width_rad`` of ``at_rad``; on no list."""

    at_rad: float
    width_rad: float

    def motors(self, plant: Plant, stops: Stops) -> Array:
        q = stops.q[:, self.joint - 1]
        beside = np.abs((q - self.at_rad + np.pi) % (2 * np.pi) - np.pi) / self.width_rad
        return only(self.joint, self.size * np.where(beside < 1, (1 - beside**2) ** 2, 0.0), plant.n)


@dataclass(frozen=True)
class DamagedTooth(JointCause):
    """A worn tooth of a pinion: the joint jumps back by ``size`` [rad] for a tenth of each pinion turn; on no list.

    ``ratio`` is the number of pinion turns in one of the joint.
    """

    ratio: float
    at_rad: float

    def motors(self, plant: Plant, stops: Stops) -> Array:
        pinion = (self.ratio * stops.q[:, self.joint - 1] - self.at_rad) % (2 * np.pi) / (2 * np.pi)
        return only(self.joint, np.where(pinion < 0.1, -self.size, 0.0), plant.n)


@dataclass(frozen=True)
class LostBits(JointCause):
    """An encoder that lost its low bits: the joint stops in the middle of a step of ``size`` [rad]; on no list.

    One of the middles is at ``at_rad``.
    """

    at_rad: float

    def motors(self, plant: Plant, stops: Stops) -> Array:
        q = stops.q[:, self.joint - 1] - self.at_rad
        return only(self.joint, self.size * np.round(q / self.size) - q, plant.n)
