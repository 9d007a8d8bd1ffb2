"""Pairs of counterpart_pairs.py in the structure and in the measurement."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from acting import Disturbance, State
from counterpart_pairs import Bench, Pair, named, without_mass, without_tool

from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.cause import stretched_moments
from casadical.blind_check.mujoco_physics.plant import back, motion, move, slide
from casadical.blind_check.mujoco_physics.stops import Stops
from casadical.core.basics import Array
from casadical.effects import (
    AxisWobble,
    BaseCompliance,
    BearingPlay,
    FrameDrift,
    LinkFlexure,
    Refraction,
    TargetShift,
    ThermalGrowth,
    TrackerScale,
)


def pads(b: Bench) -> Pair:
    """Three pads at 0, 2 and 4.2 rad on a waving track; the plane through them tilts, and they shift the ring."""
    s, shift, c, p = 40e-6, 20e-6, 2, 0.8
    at = np.array([0.0, 2.0, 4.2])
    plane = np.linalg.inv(np.column_stack([np.cos(at), np.sin(at), np.ones(3)]))
    cos, sin = np.cos(p - c * at[:2]), -np.sin(p - c * at[:2])
    v = {
        "rx_cos": s * plane[1, :2] @ cos, "rx_sin": s * plane[1, :2] @ sin,
        "ry_cos": -s * plane[0, :2] @ cos, "ry_sin": -s * plane[0, :2] @ sin,
        "x_cos": shift * cos[0], "x_sin": shift * sin[0], "y_cos": shift * cos[1], "y_sin": shift * sin[1],
    }  # fmt: skip
    there = Hidden("axis_wobble", 4, {"size": s, "shift_m": shift, "cycles": c, "phase": p})
    return Pair(b, [AxisWobble(4, c, still=True)], named("axis_wobble@4", v), hidden=[there])


def beam(b: Bench) -> Pair:
    """Turn of the whole link, which weighs nothing, about each of its axes under the peak torque at its ends."""
    b, s, torsion = without_mass(b, 2), 60e-6, 0.8
    bent = s / stretched_moments(b.plant, 2)[0] * float(b.great[1:3].max())
    v = dict(zip(("rx2", "ry2", "rz2"), bent * (1 - b.along(2) + b.along(2) / torsion), strict=True))
    engine = Hidden("link_flexure", None, {"link": 2, "size": s, "torsion": torsion})
    return Pair(b, [LinkFlexure(None, 2)], named("link_flexure", v), hidden=[engine])


def pedestal(b: Bench) -> Pair:
    """A foot that turns about axes below the base."""
    s, across, below = 50e-6, 0.6, 0.4
    rx = s * float(b.great.max()) / stretched_moments(b.plant, 0)[1]
    v = {"rx": rx, "ry": across * rx}
    engine = Hidden("base_compliance", None, {"size": s, "across": across, "height_m": below})
    return Pair(b, [BaseCompliance(None, below)], named("base_compliance", v), hidden=[engine])


@dataclass(frozen=True)
class BearingSag(Disturbance):
    """Radial play: the joint's inner ring drops by up to ``size`` [m] along the load, across the axis."""

    joint: int
    size: float

    def outboard(self, link: int, state: State) -> Array | None:
        if link != self.joint - 1:
            return None
        axis = state.plant.axes[self.joint - 1]
        before = state.bodies[link - 1] if link else np.broadcast_to(state.plant.base, (len(state.stops), 4, 4))
        down = back(before, np.array([0.0, 0.0, -1.0]))
        across = down - np.outer(down @ axis, axis)
        return slide(self.size * across / np.sqrt(0.01 + np.sum(across**2, -1, keepdims=True)))


def sag(b: Bench) -> Pair:
    there = BearingSag(3, 30e-6)
    values = {"bearing_play@3.rock": 0.0, "bearing_play@3.drop": 30e-6}
    return Pair(b, [BearingPlay(3)], values, hidden=[there])


@dataclass(frozen=True)
class LooseFlange(Disturbance):
    """The tool flange rocks by up to ``size`` [rad] the way the weight of the payload tips it."""

    size: float
    soft: float

    def outboard(self, link: int, state: State) -> Array | None:
        if link != 6:
            return None
        plant, flange = state.plant, state.plant.home[5, :3, 3]
        G = state.bodies[6]
        local = back(G, state.wrench_beyond(6, move(G, flange))[1])
        local -= np.outer(local @ plant.axes[5], plant.axes[5])
        full = 9.81 * plant.payload_kg * float(np.linalg.norm(plant.payload_com))
        size = np.linalg.norm(local, axis=-1, keepdims=True)
        rock = self.size * np.tanh(size / (self.soft * full)) * local / np.maximum(size, 1e-12)
        return motion(rock, np.zeros(3), flange)


def rocking_flange(b: Bench) -> Pair:
    """tanh(moment / (soft full)): the effect's moment is a share of the greater torque of the last two joints."""
    b, s, taken_up = without_mass(b, 6), 60e-6, 0.3
    full = 9.81 * b.plant.payload_kg * float(np.linalg.norm(b.plant.payload_com))
    soft = taken_up * full / float(b.great[4:].max())
    values = {"bearing_play@6.rock": s * np.tanh(1 / soft), "bearing_play@6.drop": 0.0}
    return Pair(b, [BearingPlay(6, soft)], values, hidden=[LooseFlange(s, taken_up)])


def growth(b: Bench) -> Pair:
    b = without_tool(b)
    b = replace(b, stops=replace(b.stops, warmth_K=np.full(len(b.stops), 5.0)))
    warm = {"warmth_600s": b.stops.warmth_K}
    engine = Hidden("thermal_growth", None, {"size": 11.5e-6, "lag_minutes": 1e-3})
    return Pair(b, [ThermalGrowth()], {"thermal_growth.alpha": 11.5e-6}, warm, hidden=[engine])


# --- the measurement


def settling_stand(b: Bench) -> Pair:
    """The tracker moves: the points move the other way in its frame."""
    shift, turn = np.array([30e-6, -32e-6, 24e-6]), np.array([19e-6, 24e-6, 26e-6])
    there = Hidden("frame_drift", None, {"shift_m": tuple(shift), "turn_rad": tuple(turn), "settling_minutes": 30.0})
    crept = np.expm1(-b.stops.time_s / 1800) / np.expm1(-2.0)
    v = {**dict(zip("xyz", -shift, strict=True)), **{f"r{c}": -t for c, t in zip("xyz", turn, strict=True)}}
    return Pair(b, [FrameDrift()], named("frame_drift", v), {"progress": crept}, hidden=[there])


def knocked(b: Bench) -> Pair:
    shift, at = (30e-6, -30e-6, 25e-6), float(b.stops.time_s[len(b.stops) // 2])
    there = Hidden("target_shift", None, {"shift_m": shift, "at_s": at})
    late = {"progress": (b.stops.time_s >= at).astype(float)}
    values = named("target_shift", dict(zip("xyz", shift, strict=True)))
    return Pair(b, [TargetShift(None, 0.5)], values, late, hidden=[there])


@dataclass(frozen=True)
class BeamRefraction(Disturbance):
    """A tracker at ``station_m`` reads distances long by a share, and its beam sags with the square of the way."""

    share: float
    bend: float
    station_m: tuple[float, float, float]

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:  # noqa: ARG002
        beam = xyz - np.array(self.station_m)
        sag = self.bend * (np.sum(beam[:, :2] ** 2, -1) - np.sum(np.square(self.station_m[:2])))
        return xyz + self.share * beam + np.outer(sag, [0.0, 0.0, 1.0])


def beam_of_light(b: Bench) -> Pair:
    """A tracker in the origin: distances long by a share, the beam sags with the square of the way."""
    there = BeamRefraction(5e-6, 1e-6, (0.0, 0.0, 0.0))
    values = {"tracker_scale.k": 5e-6, "refraction.bend": 1e-6, "refraction.slope_x": 0.0, "refraction.slope_y": 0.0}
    return Pair(b, [TrackerScale(), Refraction()], values, hidden=[there])


def beam_from_afar(b: Bench) -> Pair:
    """A tracker elsewhere: the square of the way has slopes, and a constant, which is taken off."""
    station = np.array([5.0, -4.0, 0.0])
    there = BeamRefraction(0.0, 1e-6, tuple(station))
    values = {
        "refraction.bend": 1e-6,
        "refraction.slope_x": -2e-6 * station[0],
        "refraction.slope_y": -2e-6 * station[1],
    }
    return Pair(b, [Refraction()], values, hidden=[there])
