"""More causes on no list: loose cargo, a tight cable, lost bits, rubber that creeps, a wrong length of the beam."""

# ruff: noqa: ARG002 - every cause is called with the same arguments, whether it needs them or not

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.blind_check.mujoco_physics.cause import Cause
from casadical.blind_check.mujoco_physics.equilibrium import Setting
from casadical.blind_check.mujoco_physics.mechanism import Mechanism, Shaft, X, Y, Z
from casadical.blind_check.mujoco_physics.robot import spring
from casadical.blind_check.numpy_physics.state import GRAVITY
from casadical.blind_check.numpy_physics.statics import positions, rated_torque, settle
from casadical.blind_check.synthetic.plant import Plant
from casadical.blind_check.synthetic.rigid import Array
from casadical.blind_check.synthetic.stops import Stops, only


@dataclass(frozen=True)
class LooseCargo(Cause):
    """The payload lies loose in its crate and slides against whichever walls are lowest; on no list.

    ``size`` [rad] is the windup of joint 5 by half the crate's clearance: the slide is ``size`` times the joint's
    stiffness over the payload's weight. A pad holds it in the middle until a tenth of its weight pushes.
    """

    size: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        weight = GRAVITY * plant.payload_kg
        slide = self.size * float(plant.stiffness[4]) / weight
        pad = 0.1 * weight / slide
        slides = tuple(
            spring(f"cargo_{n}", pad, inertia_of=3 * pad, kind="slide", axis=axis, limits=(-slide, slide))
            for n, axis in (("x", X), ("y", Y), ("z", Z))
        )
        return mechanism.with_body(replace(mechanism.body("payload"), joints=slides))


@dataclass(frozen=True)
class TightCable(Cause):
    """A cable package too short for its joint: it tightens towards both ends of the joint's range; on no list.

    ``size`` [rad] is how far it winds the joint at either end, ``free`` the share of the range in which it is slack.
    """

    joint: int
    size: float
    free: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        j, half = self.joint - 1, float(np.ptp(plant.ranges[self.joint - 1])) / 2
        k = self.size * float(plant.stiffness[j]) / ((1 - self.free) * half)
        cable = Shaft(f"cable{self.joint}", {f"joint{self.joint}": 1.0}, k, slack=self.free * half)
        return replace(mechanism, shafts=(*mechanism.shafts, cable))


@dataclass(frozen=True)
class LostBits(Cause):
    """An encoder that lost its low bits: the joint stops in the middle of a step of ``size`` [rad]; on no list.

    One of the middles is at ``at_rad``.
    """

    joint: int
    size: float
    at_rad: float

    def motors(self, plant: Plant, stops: Stops) -> Array:
        q = stops.q[:, self.joint - 1] - self.at_rad
        return only(self.joint, self.size * np.round(q / self.size) - q)


@dataclass(frozen=True)
class RubberCoupling(Cause):
    """A rubber coupling creeps, depending on the loads of the previous poses; on no list.

    ``size`` [rad] is what it gives under the rated torque in the end, beyond the joint's own spring; it gets there with
    the time constant ``lag_minutes``. The robot starts unloaded, and waits at each pose until it is measured.
    """

    joint: int
    size: float
    lag_minutes: float

    def motors(self, plant: Plant, stops: Stops) -> Array:
        j = self.joint - 1
        end = self.size * settle(plant, stops).load[:, j] / rated_torque(plant)[j]
        share = -np.expm1(-np.diff(stops.time_s, prepend=0.0) / 60 / self.lag_minutes)
        crept, given = 0.0, np.empty(len(stops))
        for k in range(len(stops)):
            crept += (end[k] - crept) * share[k]
            given[k] = crept
        return only(self.joint, given)


@dataclass(frozen=True)
class RangeOffset(Cause):
    """The tracker, standing at ``stand_m`` (3,), reads every distance too long by ``size`` [m]; on no list."""

    size: float
    stand_m: tuple[float, float, float]

    def settings(self, plant: Plant, stops: Stops) -> Sequence[Setting]:
        sight = positions(plant, (), stops) - np.array(self.stand_m)
        away = sight / np.linalg.norm(sight, axis=1, keepdims=True)
        return (Setting("shift", "tracker", -self.size * away),)
