"""Pairs of counterpart_pairs.py in the structure and in the measurement."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from counterpart_pairs import Bench, Pair, named, progress, without_mass, without_tool

from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.cause import stretched_moments
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

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # for the simulator in numpy

from numpy_physics import disturbances
from numpy_physics.disturbance import Disturbance


def wobble(b: Bench) -> Pair:
    """An ellipse that turns `cycles` times with the joint's angle, as seen from the link before."""
    s, shift, cycles, p, flat = 40e-6, 20e-6, 2, 0.8, 0.3
    v = {
        "rx_cos": s * np.cos(p), "rx_sin": -s * np.sin(p),
        "ry_sin": s * flat * np.cos(p), "ry_cos": s * flat * np.sin(p),
        "x_sin": shift * flat * np.cos(p), "x_cos": shift * flat * np.sin(p),
        "y_cos": -shift * np.cos(p), "y_sin": shift * np.sin(p),
    }  # fmt: skip
    there = disturbances.AxisWobble(4, s, shift, 0.0, cycles, p, flat)
    return Pair(b, [AxisWobble(4, cycles, still=True)], named("axis_wobble@4", v), numpy=[there])


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
    return Pair(b, [AxisWobble(4, c, still=True)], named("axis_wobble@4", v), mujoco=[there])


def beam(b: Bench) -> Pair:
    """Turn of the whole link, which weighs nothing, about each of its axes under the great torque at its ends."""
    return _beam(without_mass(b, 2), LinkFlexure(None, 2))


def heavy_beam(b: Bench) -> Pair:
    """The same of a link whose weight is spread along it."""
    return _beam(b, LinkFlexure(None, 2, spread=True))


def _beam(b: Bench, effect: LinkFlexure) -> Pair:
    s, torsion = 60e-6, 0.8
    bent = s / stretched_moments(b.plant, 2)[0] * float(b.great[1:3].max())
    v = dict(zip(("rx2", "ry2", "rz2"), bent * (1 - b.along(2) + b.along(2) / torsion), strict=True))
    there = disturbances.LinkFlexure(2, s, torsion)
    engine = Hidden("link_flexure", None, {"link": 2, "size": s, "torsion": torsion})
    return Pair(b, [effect], named("link_flexure", v), numpy=[there], mujoco=[engine])


def pedestal(b: Bench) -> Pair:
    """A foot that turns about axes below the base."""
    return _pedestal(b, 0.4)


def flange(b: Bench) -> Pair:
    """A foot that turns at the base."""
    return _pedestal(b, 0.0)


def _pedestal(b: Bench, below: float) -> Pair:
    s, across = 50e-6, 0.6
    rx = s * float(b.great.max()) / stretched_moments(b.plant, 0)[1]
    v, there = {"rx": rx, "ry": across * rx}, disturbances.PedestalTilt(s, across)
    engine = Hidden("base_compliance", None, {"size": s, "across": across, "height_m": below})
    return Pair(b, [BaseCompliance(None, below)], named("base_compliance", v), numpy=[there], mujoco=[engine])


def sag(b: Bench) -> Pair:
    there = disturbances.BearingSag(3, 30e-6)
    values = {"bearing_play@3.rock": 0.0, "bearing_play@3.drop": 30e-6}
    return Pair(b, [BearingPlay(3)], values, numpy=[there])


def rocking_flange(b: Bench) -> Pair:
    """tanh(moment / (soft full)): the effect's moment is a share of the greater torque of the last two joints."""
    b, s, taken_up = without_mass(b, 6), 60e-6, 0.3
    full = 9.81 * b.plant.payload_kg * float(np.linalg.norm(b.plant.payload_com))
    soft = taken_up * full / float(b.great[4:].max())
    values = {"bearing_play@6.rock": s * np.tanh(1 / soft), "bearing_play@6.drop": 0.0}
    return Pair(b, [BearingPlay(6, soft)], values, numpy=[disturbances.LooseFlange(s, taken_up)])


def growth(b: Bench) -> Pair:
    b = without_tool(b)
    b = replace(b, stops=replace(b.stops, warmth_K=np.full(len(b.stops), 5.0)))
    warm = {"warmth_600s": b.stops.warmth_K}
    there = disturbances.ThermalGrowth(11.5e-6, 1e-9)
    engine = Hidden("thermal_growth", None, {"size": 11.5e-6, "lag_minutes": 1e-3})
    return Pair(b, [ThermalGrowth()], {"thermal_growth.alpha": 11.5e-6}, warm, numpy=[there], mujoco=[engine])


# --- the measurement


def creep(b: Bench) -> Pair:
    """The points move as the frame creeps, turned about its origin."""
    shift, turn, towards, about = 50e-6, 40e-6, (0.6, -0.64, 0.48), (0.48, 0.6, 0.64)
    there = disturbances.FrameDrift(shift, turn, towards, about, 15.0)
    crept = np.log1p(b.stops.time_s / 900) / np.log1p(b.stops.time_s[-1] / 900)
    v = {c: shift * t for c, t in zip("xyz", towards, strict=True)}
    v |= {f"r{c}": turn * t for c, t in zip("xyz", about, strict=True)}
    return Pair(b, [FrameDrift()], named("frame_drift", v), {"progress": crept}, numpy=[there])


def settling_stand(b: Bench) -> Pair:
    """The tracker moves: the points move the other way in its frame."""
    shift, turn = np.array([30e-6, -32e-6, 24e-6]), np.array([19e-6, 24e-6, 26e-6])
    there = Hidden("frame_drift", None, {"shift_m": tuple(shift), "turn_rad": tuple(turn), "settling_minutes": 30.0})
    crept = np.expm1(-b.stops.time_s / 1800) / np.expm1(-2.0)
    v = {**dict(zip("xyz", -shift, strict=True)), **{f"r{c}": -t for c, t in zip("xyz", turn, strict=True)}}
    return Pair(b, [FrameDrift()], named("frame_drift", v), {"progress": crept}, mujoco=[there])


def nest(b: Bench) -> Pair:
    shift = (30e-6, -30e-6, 25e-6)
    there = disturbances.TargetShift(shift, 0.5)
    values = named("target_shift", dict(zip("xyz", shift, strict=True)))
    return Pair(b, [TargetShift(None, 0.4999)], values, progress(b), numpy=[there])


def knocked(b: Bench) -> Pair:
    shift, at = (30e-6, -30e-6, 25e-6), float(b.stops.time_s[len(b.stops) // 2])
    there = Hidden("target_shift", None, {"shift_m": shift, "at_s": at})
    late = {"progress": (b.stops.time_s >= at).astype(float)}
    values = named("target_shift", dict(zip("xyz", shift, strict=True)))
    return Pair(b, [TargetShift(None, 0.5)], values, late, mujoco=[there])


def beam_of_light(b: Bench) -> Pair:
    """A tracker in the origin: distances long by a share, the beam sags with the square of the way."""
    there = disturbances.BeamRefraction(5e-6, 2.0, (0.0, 0.0, 0.0))
    values = {"tracker_scale.k": 5e-6, "refraction.bend": 1e-6, "refraction.slope_x": 0.0, "refraction.slope_y": 0.0}
    return Pair(b, [TrackerScale(), Refraction()], values, numpy=[there])


def beam_from_afar(b: Bench) -> Pair:
    """A tracker elsewhere: the square of the way has slopes, and a constant, which is taken off."""
    station = np.array([5.0, -4.0, 0.0])
    there = disturbances.BeamRefraction(0.0, 2.0, tuple(station))
    values = {
        "refraction.bend": 1e-6,
        "refraction.slope_x": -2e-6 * station[0],
        "refraction.slope_y": -2e-6 * station[1],
    }
    sag = np.array([0.0, 0.0, 1e-6 * float(station @ station)])

    class Straightened(Disturbance):
        def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
            return there.measured(xyz, stops, rng) - sag

    return Pair(b, [Refraction()], values, numpy=[Straightened()])
