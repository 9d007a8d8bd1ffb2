"""Pairs of counterpart_pairs.py: effects of joints and loads, of structure and measurement, and by published laws.

Counterparts of the last kind are written from the source that the effect names, since no simulator draws them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from acting import Disturbance, State
from counterpart_pairs import Bench, Pair, approach, named, progress, without_mass, without_tool

from casadical import effects
from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.cause import settle, stretched_moments, warmth_inside
from casadical.blind_check.mujoco_physics.hidden import cause
from casadical.blind_check.mujoco_physics.plant import back, motion, move, slide
from casadical.blind_check.mujoco_physics.stops import Stops, in_column
from casadical.core.basics import Array
from casadical.effects import registry
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import unmeasured


def eccentric_wheel(b: Bench) -> Pair:
    """The rim rolls: the lag is - size (sin(q - t) + sin t) - oval (sin 2(q - ot) + sin 2 ot), with a zero offset."""
    s, t, o, ot = 80e-6, 0.6, 50e-6, 1.1
    v = {"sin1": -s * np.cos(t), "cos1": s * np.sin(t), "sin2": -o * np.cos(2 * ot), "cos2": o * np.sin(2 * ot)}
    offset = {"step": -s * np.sin(t) - o * np.sin(2 * ot)}
    there = Hidden("gear_eccentricity", 5, {"size": s, "towards": t, "oval": o, "oval_towards": ot})
    values = {**named("gear_eccentricity@5", v), **named("joint_zero_step@5", offset)}
    return Pair(b, [effects.GearEccentricity(5), effects.JointZeroStep(5, -1.0)], values, progress(b), hidden=[there])


def tooth_ripple(b: Bench) -> Pair:
    s, c, p = 60e-6, 4, 0.3
    wave = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
    first = 2 * np.mean(np.arcsin(0.95 * np.sin(wave)) / np.arcsin(0.95) * np.sin(wave))
    v = {"sin": first * s * np.cos(p), "cos": first * s * np.sin(p)}
    there = Hidden("transmission_ripple", 5, {"size": s, "cycles": c, "phase": p})
    return Pair(b, [effects.TransmissionRipple(5, 4.0)], named("transmission_ripple@5", v), hidden=[there])


def mesh(b: Bench) -> Pair:
    """Once a turn of a shaft that turns 80 times as fast, by a ripple of so many cycles."""
    pair = tooth_ripple(b)
    values = {name.replace("transmission_ripple@5.", "gear_mesh@5.") + "1": v for name, v in pair.values.items()}
    there = Hidden("transmission_ripple", 5, {"size": 60e-6, "cycles": 80, "phase": 0.3})
    values |= {"gear_mesh@5.sin2": 0.0, "gear_mesh@5.cos2": 0.0}
    return Pair(b, [effects.GearMesh(5, 80.0)], values, hidden=[there])


def curve(b: Bench) -> Pair:
    """Harmonics of two joints' errors over a turn of their readings, by numerical Fourier integrals."""
    there = [
        Hidden("transmission_ripple", 5, {"size": 60e-6, "cycles": 4, "phase": 0.3}),
        Hidden("gear_eccentricity", 2, {"size": 80e-6, "towards": 0.6, "oval": 50e-6, "oval_towards": 1.1}),
    ]
    turn, orders = np.linspace(0, 2 * np.pi, 512, endpoint=False), 48
    q, n = np.tile(turn[:, None], 6), len(turn)
    still = Stops(q, np.arange(float(n)), np.zeros(n), np.zeros(n), np.ones_like(q))
    error = sum(cause(h).motors(b.plant, still) for h in there)
    values = {
        f"joint_error_curve.{wave}{k}_q{j}": float(2 * np.mean(error[:, j - 1] * f(k * turn)))
        for j in range(1, 7) for k in range(1, orders + 1) for wave, f in (("s", np.sin), ("c", np.cos))
    }  # fmt: skip
    # The mean of the second joint's error is no harmonic, but an offset.
    values |= {"joint_zero_step@2.step": float(error[:, 1].mean())}
    return Pair(
        b, [effects.JointErrorCurve(orders=orders), effects.JointZeroStep(2, -1.0)], values, progress(b), hidden=there
    )


def scale(b: Bench) -> Pair:
    engine = Hidden("joint_scale", 4, {"size": 60e-6})
    return Pair(b, [effects.JointScale(4)], {"joint_scale@4.k": 60e-6}, hidden=[engine])


def coupling(b: Bench) -> Pair:
    engine = Hidden("joint_coupling", 5, {"source": 4, "size": 80e-6})
    return Pair(b, [effects.JointCoupling(5, 4)], {"joint_coupling@5.k4": 80e-6}, hidden=[engine])


def jump(b: Bench) -> Pair:
    at = float(b.stops.time_s[len(b.stops) // 2])
    late = {"progress": (b.stops.time_s >= at).astype(float)}
    there = Hidden("joint_zero_step", 3, {"size": 40e-6, "at_s": at})
    return Pair(b, [effects.JointZeroStep(3, 0.5)], {"joint_zero_step@3.step": 40e-6}, late, hidden=[there])


def warm_gear(b: Bench) -> Pair:
    there, warmth = Hidden("thermal_zero_drift", 2, {"size": 10e-6, "lag_minutes": 8.0}), warmth_inside(b.stops, 8.0)
    values = {"thermal_zero_drift@2.drift": 10e-6}
    return Pair(b, [effects.ThermalZeroDrift(2)], values, {"warmth_600s": warmth}, hidden=[there])


# --- loads


def soft(b: Bench) -> Pair:
    """A joint half as stiff as drawn."""
    k, deflection = b.plant.stiffness.copy(), b.great[4] / b.plant.stiffness[4]
    k[4] /= 2
    values = {"missing_compliance@5.deflection": deflection}
    return Pair(b, [effects.MissingCompliance(5)], values, other={"stiffness": k})


def stops_of_play(b: Bench) -> Pair:
    there = Hidden("backlash", 4, {"size": 60e-6, "friction": 0.02})
    share = 0.02 * 60e-6 * b.plant.stiffness[3] / b.great[3]
    return Pair(
        b, [effects.Backlash(4, share, 0.1 * share)], {"backlash@4.half": 60e-6}, approach(b, 4), hidden=[there]
    )


def windup(b: Bench) -> Pair:
    engine = Hidden("friction_windup", 3, {"size": 40e-6, "load_share": 0.0})
    values = {"friction_windup@3.constant": 40e-6, "friction_windup@3.load": 0.0}
    return Pair(b, [effects.FrictionWindup(3)], values, approach(b, 3), hidden=[engine])


def windup_by_load(b: Bench) -> Pair:
    """Nearly all of the friction by the load."""
    there = Hidden("friction_windup", 3, {"size": 1e-6, "load_share": 60.0})
    values = {"friction_windup@3.constant": 0.0, "friction_windup@3.load": 60e-6 * b.great[2] / b.rated[2]}
    return Pair(b, [effects.FrictionWindup(3)], values, approach(b, 3), hidden=[there])


def hardening(b: Bench) -> Pair:
    """A spring of linear x + (1 - linear) x^3 = load: soft at first, so that it is near a tanh and a straight line."""
    there = Hidden("nonlinear_stiffness", 4, {"size": 120e-6, "knee": 0.0, "linear": 0.15})
    load = np.linspace(-1, 1, 201) * b.great[3] / b.rated[3]
    turn = np.array([np.roots([0.85, 0, 0.15, -r])[np.argmin(np.abs(np.roots([0.85, 0, 0.15, -r]).imag))].real
                     for r in load])  # fmt: skip
    share = np.linspace(-1, 1, 201)
    knee = 0.1
    columns = np.column_stack([np.tanh(share / knee), share])
    bend, straight = 120e-6 * np.linalg.lstsq(columns, turn, rcond=None)[0]
    values = {"nonlinear_stiffness@4.bend": bend, "missing_compliance@4.deflection": straight}
    return Pair(b, [effects.NonlinearStiffness(4, knee), effects.MissingCompliance(4)], values, hidden=[there])


def cubic(b: Bench) -> Pair:
    """Nearly linear: size (load - 0.05 load^3) to first order in the cubic part."""
    there = Hidden("nonlinear_stiffness", 4, {"size": 120e-6, "knee": 0.0, "linear": 0.95})
    size, r = 120e-6, b.great[3] / b.rated[3]
    bend = size * 0.05 / 0.95**4 * r**3
    values = {"cubic_stiffness@4.bend": bend, "missing_compliance@4.deflection": size / 0.95 * r}
    return Pair(b, [effects.CubicStiffness(4), effects.MissingCompliance(4)], values, hidden=[there])


def up_to_arm(b: Bench, post: Array) -> float:
    """Angle [rad] about axis 2 from a post's direction (3,) to the upper arm at zero readings."""
    axis, arm = b.plant.axes[1], b.plant.centres[2] - b.plant.centres[1]
    return float(np.arctan2(axis @ np.cross(post, arm), post @ arm))


def tendon(b: Bench) -> Pair:
    """k post lever^2 sin(turn) (1 - rest / length), the spring post - 1 to post + 1 levers long."""
    s, lean, post = 0.2, 0.3, 2.0
    back = np.cross(b.plant.axes[1], [0.0, 0.0, 1.0])
    direction = np.cos(lean) * np.array([0.0, 0.0, 1.0]) + np.sin(lean) * back
    phase = b.robot.joints[1].theta - up_to_arm(b, direction) + np.pi
    turn = np.linspace(0, np.pi, 1801)
    length = np.sqrt(1 + post**2 - 2 * post * np.cos(turn))
    rest = 0.8 * (post - 1)
    pull = s * b.rated[1] / np.max(np.sin(turn) * (1 - rest / length)) / b.great[1]
    v = {"sin": pull, "cos": 0.0, "preload": -pull * rest / post}
    there = Hidden("gravity_compensator", None, {"size": s, "lean": lean, "post": post})
    return Pair(b, [effects.GravityCompensator(2, post, phase)], named("gravity_compensator@2", v), hidden=[there])


def payload(b: Bench) -> Pair:
    s, shift = 0.08, np.array([0.03, -0.02, 0.025])
    v = {"mass": s, **{c: (1 + s) * d for c, d in zip("xyz", shift, strict=True)}}
    engine = Hidden("payload_error", None, {"size": s, "shift_m": tuple(shift)})
    return Pair(b, [effects.PayloadError()], named("payload_error", v), hidden=[engine])


def links(b: Bench) -> Pair:
    """Links heavier or lighter than declared, by other mass centres: m (1 + s) (c + d) is m (c + s c + (1 + s) d)."""
    rng = np.random.default_rng(3)
    share, shift = rng.uniform(-0.2, 0.2, 6), rng.uniform(-0.03, 0.03, (6, 3))
    v = {f"m{i}": s for i, s in enumerate(share, 1)}
    moments = (1 + share)[:, None] * shift
    v |= {f"{c}{i}": x for i, d in enumerate(moments, 1) for c, x in zip("xyz", d, strict=True)}
    other = {"mass": b.plant.mass * (1 + share), "com": b.plant.com + shift}
    return Pair(b, [effects.LinkMasses()], named("link_masses", v), other=other)


@dataclass(frozen=True)
class DressPack(Disturbance):
    """A hose from the forearm to the flange tightens as it is drawn out.

    ``size`` [rad] is the windup of joint 5 by its usual pull at the reflector's reach.
    """

    size: float

    def torque(self, state: State) -> Array:
        plant = state.plant
        wrist, flange = plant.centres[4], plant.at_home(6, plant.reflector)
        forearm = plant.centres[2] - wrist
        clip_home = wrist + 0.3 * forearm + 0.1 * np.linalg.norm(forearm) * plant.axes[2]
        usual = float(np.linalg.norm(flange - clip_home))
        clip, end = move(state.bodies[2], clip_home), move(state.bodies[6], flange)
        pull = clip - end
        length = np.linalg.norm(pull, axis=-1, keepdims=True)
        strain = np.logaddexp(0.0, 6 * (length / usual - 1)) / np.log(2)
        force = self.size * plant.stiffness[4] / float(np.linalg.norm(flange - wrist)) * strain * pull / length
        torque = np.zeros((len(state.stops), 6))
        for joint in (4, 5, 6):
            axis, centre = state.axis(joint)
            torque[:, joint - 1] = np.sum(axis * np.cross(end - centre, force), -1)
        return torque


def hose(b: Bench) -> Pair:
    """The pull of the other hose, over the lengths that occur, as a straight line in the length."""
    end = b.plant.reflector
    held = b.robot.payload
    assert held is not None
    b = b.changed({"payload_com": end}, replace(b.robot, payload=replace(held, com=end)))
    there = DressPack(150e-6)
    bodies = settle(b.plant, b.stops).bodies
    wrist = b.plant.centres[4]
    forearm = b.plant.centres[2] - wrist
    clip_home = wrist + 0.3 * forearm + 0.1 * np.linalg.norm(forearm) * b.plant.axes[2]
    flange = b.plant.at_home(6, end)
    clip, tip = (G[:, :3, :3] @ x + G[:, :3, 3] for G, x in ((bodies[2], clip_home), (bodies[6], flange)))
    length, usual_there = np.linalg.norm(clip - tip, axis=1), float(np.linalg.norm(flange - clip_home))
    force = np.logaddexp(0.0, 6 * (length / usual_there - 1)) / np.log(2)
    force *= 150e-6 * b.plant.stiffness[4] / np.linalg.norm(flange - wrist)
    rows = b.robot.joints[4].d ** 2 + b.robot.joints[5].d ** 2 + end @ end
    usual = np.sqrt(rows + 1e-3) + 0.3 * np.linalg.norm(forearm)
    line = np.column_stack([np.ones_like(length), 2 * (length / usual - 1)]) * b.great[4] / usual
    tension, spring = np.linalg.lstsq(line, force, rcond=None)[0]
    v = {"tension": tension, "spring": spring}
    return Pair(b, [effects.HoseDrag(None, 0.7, 0.1)], named("hose_drag", v), hidden=[there])


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
    return Pair(b, [effects.AxisWobble(4, c, still=True)], named("axis_wobble@4", v), hidden=[there])


def beam(b: Bench) -> Pair:
    """Turn of the whole link, which weighs nothing, about each of its axes under the peak torque at its ends."""
    b, s, torsion = without_mass(b, 2), 60e-6, 0.8
    bent = s / stretched_moments(b.plant, 2)[0] * float(b.great[1:3].max())
    v = dict(zip(("rx2", "ry2", "rz2"), bent * (1 - b.along(2) + b.along(2) / torsion), strict=True))
    engine = Hidden("link_flexure", None, {"link": 2, "size": s, "torsion": torsion})
    return Pair(b, [effects.LinkFlexure(None, 2)], named("link_flexure", v), hidden=[engine])


def pedestal(b: Bench) -> Pair:
    """A foot that turns about axes below the base."""
    s, across, below = 50e-6, 0.6, 0.4
    rx = s * float(b.great.max()) / stretched_moments(b.plant, 0)[1]
    v = {"rx": rx, "ry": across * rx}
    engine = Hidden("base_compliance", None, {"size": s, "across": across, "height_m": below})
    return Pair(b, [effects.BaseCompliance(None, below)], named("base_compliance", v), hidden=[engine])


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
    return Pair(b, [effects.BearingPlay(3)], values, hidden=[there])


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
    return Pair(b, [effects.BearingPlay(6, soft)], values, hidden=[LooseFlange(s, taken_up)])


def growth(b: Bench) -> Pair:
    b = without_tool(b)
    b = replace(b, stops=replace(b.stops, warmth_K=np.full(len(b.stops), 5.0)))
    warm = {"warmth_600s": b.stops.warmth_K}
    engine = Hidden("thermal_growth", None, {"size": 11.5e-6, "lag_minutes": 1e-3})
    return Pair(b, [effects.ThermalGrowth()], {"thermal_growth.alpha": 11.5e-6}, warm, hidden=[engine])


# --- the measurement


def settling_stand(b: Bench) -> Pair:
    """The tracker moves: the points move the other way in its frame."""
    shift, turn = np.array([30e-6, -32e-6, 24e-6]), np.array([19e-6, 24e-6, 26e-6])
    there = Hidden("frame_drift", None, {"shift_m": tuple(shift), "turn_rad": tuple(turn), "settling_minutes": 30.0})
    crept = np.expm1(-b.stops.time_s / 1800) / np.expm1(-2.0)
    v = {**dict(zip("xyz", -shift, strict=True)), **{f"r{c}": -t for c, t in zip("xyz", turn, strict=True)}}
    return Pair(b, [effects.FrameDrift()], named("frame_drift", v), {"progress": crept}, hidden=[there])


def knocked(b: Bench) -> Pair:
    shift, at = (30e-6, -30e-6, 25e-6), float(b.stops.time_s[len(b.stops) // 2])
    there = Hidden("target_shift", None, {"shift_m": shift, "at_s": at})
    late = {"progress": (b.stops.time_s >= at).astype(float)}
    values = named("target_shift", dict(zip("xyz", shift, strict=True)))
    return Pair(b, [effects.TargetShift(None, 0.5)], values, late, hidden=[there])


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
    return Pair(b, [effects.TrackerScale(), effects.Refraction()], values, hidden=[there])


def beam_from_afar(b: Bench) -> Pair:
    """A tracker elsewhere: the square of the way has slopes, and a constant, which is taken off."""
    station = np.array([5.0, -4.0, 0.0])
    there = BeamRefraction(0.0, 1e-6, tuple(station))
    values = {
        "refraction.bend": 1e-6,
        "refraction.slope_x": -2e-6 * station[0],
        "refraction.slope_y": -2e-6 * station[1],
    }
    return Pair(b, [effects.Refraction()], values, hidden=[there])


class FootSlip(Disturbance):
    """The foot slips once, in all directions: from then on everything is shifted and turned."""

    shift, turn = 60e-6 * np.array([0.6, -0.64, 0.48]), 30e-6 * np.array([0.48, 0.6, -0.64])

    def outboard(self, link: int, state: State) -> Array | None:
        when = (state.stops.progress > 0.5).astype(float)
        return motion(np.outer(when, self.turn), np.outer(when, self.shift), np.zeros(3)) if link == 0 else None


def slipped_foot(b: Bench) -> Pair:
    """A body's motion about the robot's origin, seen in the measuring frame: the frame moves with the base."""
    there = FootSlip()
    base = b.plant.base
    turn, shift = base[:3, :3] @ there.turn, base[:3, :3] @ there.shift
    shift = shift - np.cross(turn, base[:3, 3])
    v = dict(zip(("x", "y", "z", "rx", "ry", "rz"), (*shift, *turn), strict=True))
    return Pair(b, [effects.FrameStep(None, 0.5)], named("frame_step", v), progress(b), hidden=[there])


@dataclass(frozen=True)
class Displaced(Disturbance):
    """What is beyond a link's joint turns about the axes of the link's frame, and shifts along them, by a course."""

    link: int
    shift: Array
    turn: Array
    course: Array

    def outboard(self, link: int, state: Any) -> Array | None:
        if link != self.link:
            return None
        home = state.plant.home[link - 1]
        shift, turn = home[:3, :3] @ self.shift, home[:3, :3] @ self.turn
        return np.asarray(motion(np.outer(self.course, turn), np.outer(self.course, shift), home[:3, 3]))


def slipped_flange(b: Bench) -> Pair:
    shift, turn = np.array([30e-6, -32e-6, 24e-6]), np.array([19e-6, 24e-6, 26e-6])
    v = dict(zip(("x", "y", "z", "rx", "ry", "rz"), (*shift, *turn), strict=True))
    there = Displaced(3, shift, turn, (b.stops.progress > 0.5).astype(float))
    return Pair(b, [effects.FrameStep(3, 0.5)], named("frame_step@3", v), progress(b), hidden=[there])


def bent_link(b: Bench) -> Pair:
    """A bar that is warmer on one side bends to a circle: its end tilts by alpha length difference / height."""
    length, height, share = b.length(2), 0.1, 0.2
    per_K = 11.5e-6 * length * share / height
    warmth = b.stops.warmth_after(10.0)
    there = Displaced(2, np.zeros(3), per_K * np.array([0.8, -0.6, 0.0]), warmth)
    v = {"rx": 0.8 * per_K, "ry": -0.6 * per_K}
    return Pair(b, [effects.ThermalBend(2)], named("thermal_bend@2", v), {"warmth_600s": warmth}, hidden=[there])


@dataclass(frozen=True)
class Misread(Disturbance):
    """A joint that is off its reading by these angles."""

    joint: int
    by: Array

    def misread(self, stops: Stops) -> Array:  # noqa: ARG002
        return in_column(self.joint, self.by)


def derived(b: Bench, name: str) -> dict[str, Array]:
    """The column as the package derives it from readings and times."""
    m = unmeasured(b.stops.q, {"time_s": b.stops.time_s})
    return {name: derive(m, [name])[0].conditions[name]}


def too_soon(b: Bench) -> Pair:
    """A drive of the first order is measured after 8 time constants: its way is integrated in small steps."""
    left, steps, q = np.zeros(len(b.stops)), 100_000, b.stops.q[:, 2]
    for k in range(1, len(q)):
        left[k] = (left[k - 1] + q[k - 1] - q[k]) * (1 - 8.0 / steps) ** steps
    values = {"settling_lag@3.share": float(np.exp(-8.0))}
    return Pair(b, [effects.SettlingLag(3)], values, derived(b, "move3"), hidden=[Misread(3, left)])


def presliding(b: Bench) -> Pair:
    """Dahl: d state = (direction - state) |d angle| / way, integrated along each motion in small steps."""
    half, way, steps = 40e-6, 1.0, 100_000
    states, q = np.zeros(len(b.stops)), b.stops.q[:, 2]
    for k in range(1, len(q)):
        move_by = q[k] - q[k - 1]
        states[k] = np.sign(move_by) + (states[k - 1] - np.sign(move_by)) * (1 - abs(move_by) / way / steps) ** steps
    there = Misread(3, -half * states)
    values = {"friction_memory@3.half": half}
    return Pair(b, [effects.FrictionMemory(3, 1000)], values, derived(b, "memory3_1000mrad"), hidden=[there])


def play_by_load(b: Bench) -> Pair:
    """Play between soft flanks, approached from either side: its mean without friction."""
    width = 0.1 * b.rated[3] / b.great[3]
    there = Given(4, lambda s: 60e-6 * np.tanh(s.load[:, 3] / (0.1 * s.rated[3])))
    effect = registry.BacklashByLoad(4, 0.0, width)
    return Pair(b, [effect], {"backlash_by_load@4.half": 60e-6}, hidden=[there])


def hysteresis(b: Bench) -> Pair:
    """Friction in proportion to the load: the part of the simulator's windup that grows with it."""
    there = Hidden("friction_windup", 3, {"size": 1e-6, "load_share": 60.0})
    values = {"load_hysteresis@3.half": 60e-6 * b.great[2] / b.rated[2]}
    return Pair(b, [effects.LoadHysteresis(3, 1)], values, approach(b, 3), hidden=[there])


@dataclass(frozen=True)
class Given(Disturbance):
    """A joint's twist as a function of the state."""

    joint: int
    law: Callable[[Any], Array]

    def twist(self, state: Any) -> Array:
        return in_column(self.joint, self.law(state))


def inner_friction(b: Bench) -> Pair:
    """Rayleigh: the branches of a loop lie apart by the square of the load."""
    there = Given(3, lambda s: -40e-6 * s.stops.approach[:, 2] * (s.load[:, 2] / b.great[2]) ** 2)
    values = {"load_hysteresis@3.half": 40e-6}
    return Pair(b, [effects.LoadHysteresis(3, 2)], values, approach(b, 3), hidden=[there])


def off_diagonal(b: Bench) -> Pair:
    """A compliance matrix with a term off its diagonal [rad/(N m)]."""
    per_Nm = 60e-6 / b.great[1]
    there = Given(3, lambda s: per_Nm * s.load[:, 1])
    return Pair(b, [effects.CrossCoupling(3, 2)], {"cross_coupling@3.k2": 60e-6}, hidden=[there])


class Newton(Disturbance):
    """The measuring frame follows a stand that cools by Newton's law, integrated in small steps; a motion of points."""

    settles, shift, turn = 0.12, np.array([30e-6, -32e-6, 24e-6]), np.array([19e-6, 24e-6, 26e-6])

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:  # noqa: ARG002
        fine = np.linspace(0.0, 1.0, 100_001)
        rest = np.cumprod(np.r_[1.0, np.full(len(fine) - 1, 1 - (fine[1] - fine[0]) / self.settles)])
        moved = 1 - np.interp(stops.progress, fine, rest)
        return move(motion(np.outer(moved, self.turn), np.outer(moved, self.shift), np.zeros(3)), xyz)


def settling_frame(b: Bench) -> Pair:
    v = dict(zip("xyz", Newton.shift, strict=True)) | {f"r{c}": t for c, t in zip("xyz", Newton.turn, strict=True)}
    effect = registry.FrameSettling(None, settles=Newton.settles)
    return Pair(b, [effect], named("frame_settling", v), progress(b), hidden=[Newton()])


class OffCentre(Disturbance):
    """A reflector's offset in its own axes, turned to face the instrument by azimuth, then elevation."""

    offset, station = (12e-6, -9e-6, 15e-6), np.array([3.0, -2.5, 0.4])

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:  # noqa: ARG002
        x, y, z = (xyz - self.station).T
        azimuth, elevation = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
        flat = slide(np.broadcast_to(np.array(self.offset), xyz.shape))
        raised = motion(np.outer(-elevation, (0.0, 1.0, 0.0)), np.zeros(3), np.zeros(3))
        turned = motion(np.outer(azimuth, (0.0, 0.0, 1.0)), np.zeros(3), np.zeros(3))
        return xyz + move(turned @ raised @ flat, np.zeros(3))


def reflector(b: Bench) -> Pair:
    v = dict(zip(("along", "across", "above"), OffCentre.offset, strict=True))
    effect = effects.SmrOffset(None, tuple(float(x) for x in OffCentre.station))
    return Pair(b, [effect], named("smr_offset", v), hidden=[OffCentre()])
