"""Causes on no list: what is loose, worn or cracked, and slips, rocks or opens between stops."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from casadical.blind_check.mujoco_physics.cause import Cause, JointCause, beam_axes, length_of, triple
from casadical.blind_check.mujoco_physics.mechanism import Body, Mechanism
from casadical.blind_check.mujoco_physics.plant import Plant
from casadical.blind_check.mujoco_physics.robot import SLOW, spring, springs
from casadical.blind_check.mujoco_physics.statics import stretched_moments


@dataclass(frozen=True)
class BearingPlay(JointCause):
    """The joint's bearing is worn: its ring drops up to ``size`` [m] across its axis, between stops; on no list."""

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        weight = plant.weight * (plant.mass[self.joint - 1 :].sum() + plant.payload_kg)
        k = 0.1 * weight / self.size
        slides = springs(f"worn{self.joint}", k, self.size, "xy", kind="slide")
        name = next(
            j.name for j in mechanism.body(f"link{self.joint}").joints if j.name in (f"joint{self.joint}", "elbow")
        )
        return mechanism.with_more(name, before=slides)


@dataclass(frozen=True)
class CrackedLink(Cause):
    """A crack in link ``link`` opens under load from one side and closes under load from the other; on no list.

    ``size`` [rad] is how far it opens if all beyond hung at full stretch; ``towards`` is where around the beam it is.
    """

    link: int
    size: float
    towards: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        length = length_of(plant, self.link)
        _, across, aside = beam_axes(length)
        axis = np.cos(self.towards) * across + np.sin(self.towards) * aside
        place = np.eye(4)
        place[:3, 3] = 0.3 * length
        hinge = spring(
            "crack", stretched_moments(plant, self.link)[1] / self.size, axis=triple(axis), limits=(0.0, 20 * self.size)
        )
        return mechanism.with_body_after(f"link{self.link}", Body("beyond_crack", "", place, (hinge,)))


@dataclass(frozen=True)
class LooseAnchor(Cause):
    """One anchor of the pedestal is loose: it tips by +-``size`` [rad] about the line of the others; on no list."""

    size: float
    towards: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        moment = 0.3 * stretched_moments(plant, 0)[1]
        axis = (float(np.cos(self.towards)), float(np.sin(self.towards)), 0.0)
        tip = spring("tip", 0.2 * moment / self.size, axis=axis, limits=(-self.size, self.size))
        return mechanism.with_body_after("pedestal", Body("tipping", "", np.eye(4), (tip,)))


@dataclass(frozen=True)
class LooseFlange(Cause):
    """Loose bolts: the payload tips the tool by up to ``size`` [rad] about each axis of the flange; on no list."""

    size: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        moment = plant.weight * plant.payload_kg * float(np.linalg.norm(plant.payload_com))
        hinges = springs("flange", 0.3 * moment / self.size, self.size, "xy")
        tool = mechanism.body("tool")
        return mechanism.with_body(replace(tool, joints=hinges))


@dataclass(frozen=True)
class ToolSlip(Cause):
    """The tool plate slips on the flange, within its bolt holes (+-``size`` [m]), once its weight overcomes friction.

    It stays where it slipped to until it slips again; on no list. ``grip`` is the friction over the payload's weight.
    """

    travels: ClassVar[bool] = True

    size: float
    grip: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        weight = plant.weight * plant.payload_kg
        k = weight / self.size
        heavy = 10 * k * SLOW**2  # for what sticks in the engine creeps the less
        sticking = {"friction": self.grip * weight, "inertia": heavy, "damping": k * SLOW, "keeps": True}
        slides = springs("plate", 0.0, self.size, "xy", kind="slide", **sticking)
        tool = mechanism.body("tool")
        return mechanism.with_body(replace(tool, joints=slides))


@dataclass(frozen=True)
class LooseCargo(Cause):
    """The payload is loose in its crate and slides against the lowest walls; on no list.

    ``size`` [rad] is the windup of joint 5 by half the crate's clearance: the slide is ``size`` times the joint's
    stiffness over the payload's weight. A pad holds it in the middle until a tenth of its weight pushes.
    """

    size: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        weight = plant.weight * plant.payload_kg
        slide = self.size * float(plant.stiffness[min(4, plant.n - 1)]) / weight
        pad = 0.1 * weight / slide
        slides = springs("cargo", pad, slide, "xyz", inertia_of=3 * pad, kind="slide")
        return mechanism.with_body(replace(mechanism.body("payload"), joints=slides))
