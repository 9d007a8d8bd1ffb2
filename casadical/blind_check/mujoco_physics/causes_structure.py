"""Causes in the structure: links and pedestal that bend, grow, wobble, are loose, or carry another load."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from casadical.blind_check.mujoco_physics.cause import (
    Cause,
    JointCause,
    beam_axes,
    into_parent,
    length_of,
    stretched_moments,
    triple,
    turned,
    warmth_inside,
)
from casadical.blind_check.mujoco_physics.equilibrium import Setting
from casadical.blind_check.mujoco_physics.mechanism import Body, Mechanism, X, Y
from casadical.blind_check.mujoco_physics.plant import Array, Plant
from casadical.blind_check.mujoco_physics.robot import SLOW, spring, springs
from casadical.blind_check.mujoco_physics.stops import Stops


@dataclass(frozen=True)
class LinkFlexure(Cause):
    """Link ``link`` is a beam: cut at a quarter and at three quarters of its length, with three sprung hinges each.

    ``size`` [rad] is the slope of its end by the moment there if all beyond hung at full stretch; ``torsion`` is twist
    over bend stiffness.
    """

    link: int
    size: float
    torsion: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        name = f"link{self.link}"
        whole, length = mechanism.body(name), length_of(plant, self.link)
        e, across, aside = beam_axes(length)
        bend = 2 * stretched_moments(plant, self.link)[0] / self.size
        hinges = [("up", across, bend), ("side", aside, bend), ("twist", e, self.torsion * bend)]
        for cut, at in (("b", 0.75), ("a", 0.25)):
            joints = tuple(spring(f"{name}{cut}_{n}", k, axis=triple(axis)) for n, axis, k in hinges)
            place = np.eye(4)
            place[:3, 3] = at * length
            part = Body(f"{name}{cut}", name, place, joints)
            if cut == "a":  # the middle piece carries the link's weight
                part = replace(part, mass=whole.mass, com=triple(np.array(whole.com) - place[:3, 3]))
            mechanism = mechanism.with_body_after(name, part)
        return mechanism.with_body(replace(mechanism.body(name), mass=0.0))


@dataclass(frozen=True)
class BaseCompliance(Cause):
    """The pedestal stands on compliant anchors: it tilts about two axes ``height_m`` below the base, and sinks.

    ``size`` [rad] is its tilt by the full overturning moment, ``across`` the share of that across its foot.
    """

    size: float
    across: float
    height_m: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        k, at = stretched_moments(plant, 0)[1] / self.size, (0.0, 0.0, -self.height_m)
        width = 0.15 * float(np.linalg.norm(np.diff(plant.stations, axis=0), axis=-1).sum())
        joints = (
            spring("anchors_x", k, axis=X, at=at),
            spring("anchors_y", k / self.across, axis=Y, at=at),
            spring("anchors_z", 2 * k / width**2, kind="slide"),
        )
        return mechanism.with_body_after("pedestal", Body("column", "pedestal", np.eye(4), joints))


@dataclass(frozen=True)
class AxisWobble(JointCause):
    """A joint's turning ring rests on three pads; its track waves ``cycles`` times a turn over two of them.

    ``size`` [rad] is about the tilt of the plane through the pads when one of them is on a crest; the ring also shifts
    by up to ``shift_m`` sideways.
    """

    shift_m: float
    cycles: int
    phase: float

    def settings(self, plant: Plant, stops: Stops) -> Sequence[Setting]:
        pads = np.array([0.0, 2.0, 4.2])
        track = self.cycles * (turned(plant, stops, self.joint)[:, None] - pads) + self.phase
        height = np.cos(track) * np.array([1.0, 1.0, 0.0])
        plane = height @ np.linalg.inv(np.column_stack([np.cos(pads), np.sin(pads), np.ones(3)])).T
        tilt = self.size * np.column_stack([plane[:, 1], -plane[:, 0], np.zeros(len(stops))])
        shift = self.shift_m * np.column_stack([height[:, 0], height[:, 1], np.zeros(len(stops))])
        R, link = into_parent(plant, self.joint), f"link{self.joint}"
        return Setting("turn", link, tilt @ R.T), Setting("shift", link, shift @ R.T)


@dataclass(frozen=True)
class ThermalGrowth(Cause):
    """All links lengthen by ``size`` [1/K]; the cores of the first are the last to get warm, the tool stays cooler."""

    size: float
    lag_minutes: float

    def settings(self, plant: Plant, stops: Stops) -> Sequence[Setting]:
        n = plant.n
        warm = [warmth_inside(stops, self.lag_minutes * max(1.6 - 0.2 * i, 0.2)) for i in range(n + 1)]
        settings = [Setting("shift", "link1", self._longer(warm[0], plant.home[0, :3, 3]))]
        settings += [Setting("shift", f"link{i + 1}", self._longer(warm[i], length_of(plant, i))) for i in range(1, n)]
        settings.append(Setting("mark", "reflector", self._longer(0.3 * warm[n], plant.reflector)))
        if plant.four_bar is not None:
            bar, angle = plant.four_bar, plant.four_bar.crank_zero_rad
            end = bar.crank_m * np.array([np.cos(angle), np.sin(angle), 0.0])
            rocker = bar.rocker_m * np.array([np.cos(bar.passive_offset_rad), -np.sin(bar.passive_offset_rad), 0.0])
            d = bar.driven
            rocker = plant.home[d - 1, :3, :3].T @ plant.home[d - 2, :3, :3] @ rocker
            settings += [
                Setting("shift", "crank", self._longer(warm[d - 2], length_of(plant, d - 2))),
                Setting("shift", "coupler", self._longer(warm[d - 1], end)),
                Setting("mark", "coupler_end", self._longer(warm[d - 1], np.array([bar.coupler_m, 0.0, 0.0]))),
                Setting("mark", "rocker_end", self._longer(warm[d], rocker)),
            ]
        return settings

    def _longer(self, warmth: Array, length: Array) -> Array:
        return np.outer(self.size * warmth, length)


@dataclass(frozen=True)
class PayloadError(Cause):
    """The payload is heavier than declared by the share ``size``, its mass centre off by ``shift_m`` on the flange."""

    size: float
    shift_m: tuple[float, float, float]

    @property
    def payload_factor(self) -> float:
        return 1 + self.size

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        body = mechanism.body("payload")
        place = body.place.copy()
        place[:3, 3] += self.shift_m
        return mechanism.with_body(replace(body, place=place))


@dataclass(frozen=True)
class ThermalBend(Cause):
    """The column is warmed from one side: it leans by ``size`` [rad/K] towards ``towards``; on no list."""

    size: float
    towards: float
    lag_minutes: float

    def settings(self, plant: Plant, stops: Stops) -> Sequence[Setting]:
        lean = np.array([np.cos(self.towards), np.sin(self.towards), 0.0])
        difference = stops.warmth_K - warmth_inside(stops, self.lag_minutes)
        turn = np.outer(self.size * difference, lean) @ plant.home[0, :3, :3]
        sideways = np.cross(turn, length_of(plant, 1)) / 2
        bar = plant.four_bar
        links = ("link2", "crank") if bar is not None and bar.driven == 3 else ("link2",)
        return [Setting("turn", link, turn) for link in links] + [Setting("shift", link, sideways) for link in links]


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
