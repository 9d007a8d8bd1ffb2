"""Disturbances of the structure: bearings, links and pedestal that bend, wobble, grow or carry another load."""

from dataclasses import dataclass, replace

import numpy as np

from casadical.blind_check.mujoco_physics.cause import stretched_moments
from casadical.blind_check.mujoco_physics.plant import Array, Plant, back, motion, move, slide
from numpy_physics.disturbance import Disturbance
from numpy_physics.state import GRAVITY, State


@dataclass(frozen=True)
class AxisWobble(Disturbance):
    """The joint's axis tilts by ``size`` [rad] and shifts by ``shift_m`` on an ellipse, ``cycles`` times a turn.

    A large slewing ring on an uneven plate also runs out along its axis, by ``lift_m``.
    """

    joint: int
    size: float = 25e-6
    shift_m: float = 10e-6
    lift_m: float = 0.0
    cycles: int = 1
    phase: float = 0.8
    flatness: float = 0.3

    def outboard(self, link: int, state: State) -> Array | None:
        if link != self.joint - 1:
            return None
        home = state.plant.home[self.joint - 1]
        turn = self.cycles * state.angles[:, self.joint - 1] + self.phase
        wide, narrow = np.cos(turn), self.flatness * np.sin(turn)
        tilt = self.size * (np.outer(wide, home[:3, 0]) + np.outer(narrow, home[:3, 1]))
        shift = self.shift_m * (np.outer(narrow, home[:3, 0]) - np.outer(wide, home[:3, 1]))
        lift = self.lift_m * np.outer(np.sin(turn), home[:3, 2])
        return motion(tilt, shift + lift, home[:3, 3])


@dataclass(frozen=True)
class LinkFlexure(Disturbance):
    """Link ``link`` is a beam, clamped at its joint: the load on its end and its own weight bend and twist it.

    ``size`` [rad] is the slope of its end if all beyond hung at full stretch; ``torsion`` is twist over bend stiffness.
    """

    link: int = 2
    size: float = 60e-6
    torsion: float = 0.8

    def outboard(self, link: int, state: State) -> Array | None:
        if link != self.link:
            return None
        plant, G = state.plant, state.bodies[link - 1]
        root, tip = plant.stations[link], plant.stations[link + 1]
        length = float(np.linalg.norm(tip - root))
        e = (tip - root) / length
        stretched, _ = stretched_moments(plant, link)
        bend = self.size / (stretched * length)
        force, moment = (back(G, w) for w in state.wrench_beyond(link, move(G, tip)))
        own = back(G, np.array([0.0, 0.0, -GRAVITY * plant.mass[link - 1]]))
        across, own = force - np.outer(force @ e, e), own - np.outer(own @ e, e)
        along = np.outer(moment @ e, e)
        slope = np.cross(e, across) * length**2 / 2 + np.cross(e, own) * length**2 / 6
        slope += (moment - along) * length + along * length / self.torsion
        sag = across * length**3 / 3 + own * length**3 / 8 + np.cross(moment, e) * length**2 / 2
        return motion(bend * slope, bend * sag, tip)


@dataclass(frozen=True)
class PedestalTilt(Disturbance):
    """The pedestal rocks on its anchors by ``size`` [rad] under the full overturning moment, less across its foot."""

    size: float = 50e-6
    across: float = 0.6

    def outboard(self, link: int, state: State) -> Array | None:
        if link != 0:
            return None
        _, stretched = stretched_moments(state.plant, 0)
        base = state.plant.base
        _, moment = state.wrench_beyond(0, base[:3, 3])
        rock = back(base, moment) * np.array([1.0, self.across, 0.0]) * self.size / stretched
        return motion(rock, np.zeros(3), np.zeros(3))


@dataclass(frozen=True)
class BearingSag(Disturbance):
    """Radial play: the joint's inner ring drops by up to ``size`` [m] along the load, across the axis; on no list."""

    joint: int
    size: float = 30e-6

    def outboard(self, link: int, state: State) -> Array | None:
        if link != self.joint - 1:
            return None
        axis = state.plant.axes[self.joint - 1]
        before = state.bodies[link - 1] if link else np.broadcast_to(state.plant.base, (len(state.stops), 4, 4))
        down = back(before, np.array([0.0, 0.0, -1.0]))
        across = down - np.outer(down @ axis, axis)
        return slide(self.size * across / np.sqrt(0.01 + np.sum(across**2, -1, keepdims=True)))


@dataclass(frozen=True)
class ThermalGrowth(Disturbance):
    """Every link grows by ``size`` [1/K] along its length; heavy links follow the surface later, the tool is cool."""

    size: float = 11.5e-6
    lag_minutes: float = 6.0

    def outboard(self, link: int, state: State) -> Array | None:
        ends = state.plant.stations
        share, lag = (0.3, 20.0) if link == 6 else (1.0, self.lag_minutes * (2 - link / 5))
        return slide(np.outer(self.size * share * state.stops.warmth_after(lag), ends[link + 1] - ends[link]))


@dataclass(frozen=True)
class PayloadError(Disturbance):
    """The payload is heavier than declared by the share ``size``, and its mass centre lies off by ``shift_m`` (3,)."""

    size: float = 0.05
    shift_m: tuple[float, float, float] = (0.02, -0.01, 0.02)

    def altered(self, plant: Plant) -> Plant:
        return replace(plant, payload_factor=1 + self.size, payload_com=plant.payload_com + np.array(self.shift_m))
