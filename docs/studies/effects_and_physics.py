"""nice python docs/studies/effects_and_physics.py [POSES] > docs/studies/effects_and_physics.txt

Each effect beside its counterpart in the simulators of the blind check, which share no formula with it: the same
parameters, computed here from what the counterpart's docstring says, nothing is fitted. What is compared is how far
they move the tool at 200 poses of three robots, each against its own simulation without the effect.

The column `apart` is |effect - counterpart| / |counterpart| over all poses and coordinates. Most counterparts are the
same physics and agree to second order. Some are built otherwise on purpose (a skewed wave, hinges in place of a beam,
another law of a spring): their limit is wider, and says by how much a right formula may differ from them.
"""

from __future__ import annotations

import importlib.util
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from casadical import Placement, Robot, read_campaign_robot
from casadical.blind_check import mujoco_physics
from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.cause import warmth_inside
from casadical.blind_check.numpy_physics import Plant, disturbances, disturbances_rare
from casadical.blind_check.numpy_physics.disturbance import Disturbance
from casadical.blind_check.numpy_physics.statics import (
    positions,
    rated_torque,
    settle,
    stretched_moments,
)
from casadical.blind_check.synthetic.fourbar import unfolded
from casadical.blind_check.synthetic.rigid import motion, move, slide
from casadical.blind_check.synthetic.stops import Stops, Warmup, draw_poses, draw_stops, only
from casadical.core.arrays import Array
from casadical.core.transforms import frame
from casadical.effects import (
    AxisWobble,
    Backlash,
    BaseCompliance,
    BearingPlay,
    CrossCoupling,
    CubicStiffness,
    Effect,
    FrameDrift,
    FrameStep,
    FrictionMemory,
    FrictionWindup,
    GearEccentricity,
    GearMesh,
    GravityCompensator,
    HoseDrag,
    JointCoupling,
    JointErrorCurve,
    JointScale,
    JointZeroStep,
    LinkFlexure,
    LinkMasses,
    LoadHysteresis,
    MissingCompliance,
    NonlinearStiffness,
    PayloadError,
    Refraction,
    SettlingLag,
    SmrOffset,
    TargetShift,
    ThermalBend,
    ThermalGrowth,
    ThermalZeroDrift,
    TrackerScale,
    TransmissionRipple,
)
from casadical.effects.registry import BacklashByLoad, FrameSettling
from casadical.identification.accuracy import predicted
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import unmeasured

ROOT = Path(__file__).parents[2]
ROBOTS = ("hh800", "kr210", "ur10e")
Values = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Bench:
    """One robot in both worlds, and poses. plant : its drawing; robot : its model of the same numbers."""

    name: str
    plant: Plant
    robot: Robot
    stops: Stops

    @cached_property
    def rated(self) -> Array:
        """Rated torque of each joint as the numpy physics means it, shape (6,) [N m]."""
        return rated_torque(self.plant)

    @cached_property
    def great(self) -> Array:
        """Great torque of each joint as the effects mean it, shape (6,) [N m]."""
        return self.robot.torque_scale

    def along(self, link: int) -> Array:
        """Share of a link's own three axes along it (1) and across it (0), shape (3,)."""
        T = self.plant.home[link - 1]
        way = T[:3, :3].T @ (self.plant.stations[link + 1] - self.plant.stations[link])
        return np.asarray((np.abs(way) > 0.99 * np.linalg.norm(way)).astype(float))

    def length(self, link: int) -> float:
        return float(np.linalg.norm(self.plant.stations[link + 1] - self.plant.stations[link]))

    def changed(self, plant: Mapping[str, Any], robot: Robot) -> Bench:
        return replace(self, plant=replace(self.plant, **plant), robot=robot)


@dataclass(frozen=True, eq=False)
class Pair:
    """An effect and its counterpart with the same parameters.

    effects, values : in the model; columns : what was logged besides the payload
    numpy, mujoco : counterparts in each simulator; bench : with which they are compared
    """

    bench: Bench
    effects: Sequence[Effect]
    values: Values
    columns: Mapping[str, Array] = field(default_factory=dict)
    numpy: Sequence[Disturbance] = ()
    mujoco: Sequence[Hidden] = ()

    def moved(self) -> Array:
        """How far the effects move the tool of the model, shape (n, 3) [m]."""
        b = self.bench
        with_them = b.robot.with_effect(*self.effects).with_values(self.values)
        m = unmeasured(b.stops.q, {"payload_kg": b.stops.payload_kg, **self.columns})
        return np.asarray(predicted(with_them, m)[0] - predicted(b.robot, m)[0])

    def moved_there(self) -> Array:
        """How far the counterpart moves it, shape (n, 3) [m]."""
        b = self.bench
        if self.mujoco:
            there = mujoco_physics.campaigns.positions
            return np.asarray(there(b.plant, self.mujoco, b.stops) - there(b.plant, (), b.stops))
        clean = positions(b.plant, (), b.stops)
        rng = np.random.default_rng(0)
        seen = positions(b.plant, self.numpy, b.stops)
        for d in self.numpy:
            seen = d.measured(seen, b.stops, rng)
        return np.asarray(seen - clean)

    def apart(self) -> tuple[float, float]:
        """Relative distance of the two, and the greatest motion of the counterpart [m]."""
        here, there = self.moved(), self.moved_there()
        return float(np.linalg.norm(here - there) / np.linalg.norm(there)), float(np.linalg.norm(there, axis=1).max())


@dataclass(frozen=True)
class Case:
    """limit : how far the two may be apart; why : where that is more than second order; robots : that it holds for."""

    name: str
    make: Callable[[Bench], Pair]
    limit: float = 0.01
    why: str = ""
    robots: tuple[str, ...] = ROBOTS


def bench(name: str, poses: int, seed: int = 1) -> Bench:
    plant = Plant.from_dict(json.loads((ROOT / f"data/campaigns/robots/{name}.json").read_text(encoding="utf-8")))
    q = draw_poses(plant, poses, np.random.default_rng(seed), plant.ranges, unfolded(plant))
    seeds = np.random.SeedSequence(seed).spawn(2)
    stops = draw_stops(q, seeds, [plant.payload_kg, plant.payload_kg / 2], Warmup(), approach="chance")
    return Bench(name, plant, read_campaign_robot(ROOT / "problems" / name), stops)


def approach(b: Bench, joint: int) -> dict[str, Array]:
    return {f"approach{joint}": b.stops.approach[:, joint - 1]}


def without_mass(b: Bench, link: int) -> Bench:
    """The same robot, one link of which weighs nothing: its own weight is another load case of a beam or flange."""
    mass = b.plant.mass.copy()
    mass[link - 1] = 1e-6
    joints = list(b.robot.joints)
    body = joints[link - 1].body
    assert body is not None
    joints[link - 1] = replace(joints[link - 1], body=replace(body, mass=1e-6))
    return b.changed({"mass": mass}, replace(b.robot, joints=tuple(joints)))


def without_tool(b: Bench) -> Bench:
    robot = replace(b.robot, tool=Placement(frame(b.robot.tool.T[:3, :3], np.zeros(3)), b.robot.tool.unknown))
    return b.changed({"reflector": np.zeros(3)}, robot)


# --- the drives


def eccentric(b: Bench) -> Pair:
    """The angle seen from (size, phase) off the centre: q + size sin(phase - q); an ellipse adds oval sin 2(q + p)."""
    s, p, o, op = 80e-6, 0.6, 50e-6, 1.1
    v = {"sin1": -s * np.cos(p), "cos1": s * np.sin(p), "sin2": o * np.cos(2 * op), "cos2": o * np.sin(2 * op)}
    there = disturbances.GearEccentricity(5, s, p, o, op)
    return Pair(b, [GearEccentricity(5)], named("gear_eccentricity@5", v), numpy=[there])


def eccentric_wheel(b: Bench) -> Pair:
    """The rim rolls: the lag is - size (sin(q - t) + sin t) - oval (sin 2(q - ot) + sin 2 ot), with a zero offset."""
    s, t, o, ot = 80e-6, 0.6, 50e-6, 1.1
    v = {"sin1": -s * np.cos(t), "cos1": s * np.sin(t), "sin2": -o * np.cos(2 * ot), "cos2": o * np.sin(2 * ot)}
    offset = {"step": -s * np.sin(t) - o * np.sin(2 * ot)}
    there = Hidden("gear_eccentricity", 5, {"size": s, "towards": t, "oval": o, "oval_towards": ot})
    values = {**named("gear_eccentricity@5", v), **named("joint_zero_step@5", offset)}
    return Pair(b, [GearEccentricity(5), JointZeroStep(5, -1.0)], values, progress(b), mujoco=[there])


def ripple(b: Bench) -> Pair:
    s, c, p = 60e-6, 4, 0.3
    wave = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
    first = 2 * np.mean(np.sin(wave + 0.4 * np.sin(wave)) * np.sin(wave))
    v = {"sin": first * s * np.cos(p), "cos": first * s * np.sin(p)}
    there = disturbances.TransmissionRipple(5, s, c, p)
    return Pair(b, [TransmissionRipple(5, 4.0)], named("transmission_ripple@5", v), numpy=[there])


def tooth_ripple(b: Bench) -> Pair:
    s, c, p = 60e-6, 4, 0.3
    wave = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
    first = 2 * np.mean(np.arcsin(0.95 * np.sin(wave)) / np.arcsin(0.95) * np.sin(wave))
    v = {"sin": first * s * np.cos(p), "cos": first * s * np.sin(p)}
    there = Hidden("transmission_ripple", 5, {"size": s, "cycles": c, "phase": p})
    return Pair(b, [TransmissionRipple(5, 4.0)], named("transmission_ripple@5", v), mujoco=[there])


def mesh(b: Bench) -> Pair:
    """Once and twice a turn of a shaft that turns 80 times as fast, each by a ripple of so many cycles."""
    s, p = 60e-6, 0.3
    v: dict[str, float] = {}
    wave = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
    for n in (1, 2):
        part = 2 * np.mean(np.sin(wave + 0.4 * np.sin(wave)) * np.sin(n * wave))
        v |= {f"sin{n}": part * s * np.cos(n * p), f"cos{n}": part * s * np.sin(n * p)}
    there = disturbances.TransmissionRipple(5, s, 80, p)
    return Pair(b, [GearMesh(5, 80.0)], named("gear_mesh@5", v), numpy=[there])


def curve(b: Bench) -> Pair:
    """Harmonics of two joints' errors over a turn of their readings, by numerical Fourier integrals."""
    there = [
        disturbances.TransmissionRipple(5, 60e-6, 4, 0.3),
        disturbances.GearEccentricity(2, 80e-6, 0.6, 50e-6, 1.1),
    ]
    turn, orders = np.linspace(0, 2 * np.pi, 512, endpoint=False), 24
    q, n = np.tile(turn[:, None], 6), len(turn)
    still = Stops(q, np.arange(float(n)), np.zeros(n), np.zeros(n), np.ones_like(q))
    error = sum(d.misread(still) for d in there)
    values = {
        f"joint_error_curve.{wave}{k}_q{j}": float(2 * np.mean(error[:, j - 1] * f(k * turn)))
        for j in range(1, 7) for k in range(1, orders + 1) for wave, f in (("s", np.sin), ("c", np.cos))
    }  # fmt: skip
    return Pair(b, [JointErrorCurve(orders=orders)], values, numpy=there)


def scale(b: Bench) -> Pair:
    there = disturbances.JointScale(4, 60e-6)
    return Pair(b, [JointScale(4)], {"joint_scale@4.k": 60e-6}, numpy=[there])


def pulley(b: Bench) -> Pair:
    return Pair(b, [JointScale(4)], {"joint_scale@4.k": 60e-6}, mujoco=[Hidden("joint_scale", 4, {"size": 60e-6})])


def coupling(b: Bench) -> Pair:
    there = disturbances.JointCoupling(5, 4, 80e-6)
    return Pair(b, [JointCoupling(5, 4)], {"joint_coupling@5.k4": 80e-6}, numpy=[there])


def bevel(b: Bench) -> Pair:
    there = Hidden("joint_coupling", 5, {"source": 4, "size": 80e-6})
    return Pair(b, [JointCoupling(5, 4)], {"joint_coupling@5.k4": 80e-6}, mujoco=[there])


def zero_step(b: Bench) -> Pair:
    there = disturbances.JointZeroStep(3, 40e-6, 0.5)
    late = progress(b)
    return Pair(b, [JointZeroStep(3, 0.4999)], {"joint_zero_step@3.step": 0.95 * 40e-6}, late, numpy=[there])


def jump(b: Bench) -> Pair:
    at = float(b.stops.time_s[len(b.stops) // 2])
    late = {"progress": (b.stops.time_s >= at).astype(float)}
    there = Hidden("joint_zero_step", 3, {"size": 40e-6, "at_s": at})
    return Pair(b, [JointZeroStep(3, 0.5)], {"joint_zero_step@3.step": 40e-6}, late, mujoco=[there])


def zero_drift(b: Bench) -> Pair:
    there, warmth = disturbances.ThermalZeroDrift(2, 10e-6, 8.0), b.stops.warmth_after(8.0)
    values = {"thermal_zero_drift@2.drift": 10e-6}
    return Pair(b, [ThermalZeroDrift(2)], values, {"warmth_600s": warmth}, numpy=[there])


def warm_gear(b: Bench) -> Pair:
    there, warmth = Hidden("thermal_zero_drift", 2, {"size": 10e-6, "lag_minutes": 8.0}), warmth_inside(b.stops, 8.0)
    values = {"thermal_zero_drift@2.drift": 10e-6}
    return Pair(b, [ThermalZeroDrift(2)], values, {"warmth_600s": warmth}, mujoco=[there])


# --- loads


def soft(b: Bench) -> Pair:
    """A joint half as stiff as drawn."""
    k, deflection = b.plant.stiffness.copy(), b.great[4] / b.plant.stiffness[4]
    k[4] /= 2
    values = {"missing_compliance@5.deflection": deflection}
    return Pair(b, [MissingCompliance(5)], values, numpy=[OtherPlant({"stiffness": k})])


def play(b: Bench) -> Pair:
    there = disturbances.Backlash(4, 60e-6, 0.05)
    share = 0.05 * b.rated[3] / b.great[3]
    return Pair(b, [Backlash(4, share, share)], {"backlash@4.half": 60e-6}, approach(b, 4), numpy=[there])


def stops_of_play(b: Bench) -> Pair:
    there = Hidden("backlash", 4, {"size": 60e-6, "friction": 0.02})
    share = 0.02 * 60e-6 * b.plant.stiffness[3] / b.great[3]
    return Pair(b, [Backlash(4, share, 0.1 * share)], {"backlash@4.half": 60e-6}, approach(b, 4), mujoco=[there])


def windup(b: Bench) -> Pair:
    there = disturbances.FrictionWindup(3, 40e-6, 0.0)
    values = {"friction_windup@3.constant": 40e-6, "friction_windup@3.load": 0.0}
    return Pair(b, [FrictionWindup(3)], values, approach(b, 3), numpy=[there])


def windup_by_load(b: Bench) -> Pair:
    """Nearly all of the friction by the load."""
    there = disturbances.FrictionWindup(3, 1e-6, 60.0)
    values = {"friction_windup@3.constant": 0.0, "friction_windup@3.load": 60e-6 * b.great[2] / b.rated[2]}
    return Pair(b, [FrictionWindup(3)], values, approach(b, 3), numpy=[there])


def dry_friction(b: Bench) -> Pair:
    there = Hidden("friction_windup", 3, {"size": 40e-6, "load_share": 0.0})
    values = {"friction_windup@3.constant": 40e-6, "friction_windup@3.load": 0.0}
    return Pair(b, [FrictionWindup(3)], values, approach(b, 3), mujoco=[there])


def hardening(b: Bench) -> Pair:
    """A spring of linear x + (1 - linear) x^3 = load: soft at first, so that it is near a tanh and a straight line."""
    there = disturbances.HardeningSpring(4, 120e-6, 0.15)
    load = np.linspace(-1, 1, 201) * b.great[3] / b.rated[3]
    turn = np.array([np.roots([0.85, 0, 0.15, -r])[np.argmin(np.abs(np.roots([0.85, 0, 0.15, -r]).imag))].real
                     for r in load])  # fmt: skip
    share = np.linspace(-1, 1, 201)
    knee = 0.1
    columns = np.column_stack([np.tanh(share / knee), share])
    bend, straight = 120e-6 * np.linalg.lstsq(columns, turn, rcond=None)[0]
    values = {"nonlinear_stiffness@4.bend": bend, "missing_compliance@4.deflection": straight}
    return Pair(b, [NonlinearStiffness(4, knee), MissingCompliance(4)], values, numpy=[there])


def cubic(b: Bench) -> Pair:
    """Nearly linear: size (load - 0.05 load^3) to first order in the cubic part."""
    there = disturbances.HardeningSpring(4, 120e-6, 0.95)
    size, r = 120e-6, b.great[3] / b.rated[3]
    bend = size * 0.05 / 0.95**4 * r**3
    values = {"cubic_stiffness@4.bend": bend, "missing_compliance@4.deflection": size / 0.95 * r}
    return Pair(b, [CubicStiffness(4), MissingCompliance(4)], values, numpy=[there])


def cubic_alone(b: Bench) -> Pair:
    """The cubic part of such a spring: what is left of it without its linear part."""
    pair = cubic(b)
    there = pair.numpy[0]

    class Rest(Disturbance):
        def twist(self, state: Any) -> Array:
            found = np.array(there.twist(state))
            found[:, 3] -= 120e-6 / 0.95 * state.load[:, 3] / state.rated[3]
            return found

    return replace(
        pair, effects=[CubicStiffness(4)], numpy=[Rest()], values={k: v for k, v in pair.values.items() if "cubic" in k}
    )


def up_to_arm(b: Bench, post: Array) -> float:
    """Angle [rad] about axis 2 from a post's direction (3,) to the upper arm at zero readings."""
    axis, arm = b.plant.axes[1], b.plant.centres[2] - b.plant.centres[1]
    return float(np.arctan2(axis @ np.cross(post, arm), post @ arm))


def balancer(b: Bench) -> Pair:
    """Post and lug are equally far from the joint: torque size rated sin(turn) (1 - free / length), turn from below."""
    s, free = 0.2, 0.1
    phase = b.robot.joints[1].theta - up_to_arm(b, np.array([0.0, 0.0, 1.0])) + np.pi
    pull = s * b.rated[1] / b.great[1]
    v = {"sin": pull, "cos": 0.0, "preload": -free * pull}
    there = disturbances.SpringBalancer(s, free)
    return Pair(b, [GravityCompensator(2, 1.0, phase)], named("gravity_compensator@2", v), numpy=[there])


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
    return Pair(b, [GravityCompensator(2, post, phase)], named("gravity_compensator@2", v), mujoco=[there])


def payload(b: Bench) -> Pair:
    s, shift = 0.08, np.array([0.03, -0.02, 0.025])
    v = {"mass": s, **{c: (1 + s) * d for c, d in zip("xyz", shift, strict=True)}}
    there = disturbances.PayloadError(s, tuple(shift))
    return Pair(b, [PayloadError()], named("payload_error", v), numpy=[there])


@dataclass(frozen=True)
class OtherPlant(Disturbance):
    """Another robot, with these of its fields changed."""

    change: Mapping[str, Any]

    def altered(self, plant: Plant) -> Plant:
        return replace(plant, **self.change)


def links(b: Bench) -> Pair:
    """Links heavier or lighter than declared, by other mass centres: m (1 + s) (c + d) is m (c + s c + (1 + s) d)."""
    rng = np.random.default_rng(3)
    share, shift = rng.uniform(-0.2, 0.2, 6), rng.uniform(-0.03, 0.03, (6, 3))
    v = {f"m{i}": s for i, s in enumerate(share, 1)}
    moments = (1 + share)[:, None] * shift
    v |= {f"{c}{i}": x for i, d in enumerate(moments, 1) for c, x in zip("xyz", d, strict=True)}
    there = OtherPlant({"mass": b.plant.mass * (1 + share), "com": b.plant.com + shift})
    return Pair(b, [LinkMasses()], named("link_masses", v), numpy=[there])


def cargo(b: Bench) -> Pair:
    s, shift = 0.08, (0.03, -0.02, 0.025)
    v = {"mass": s, **{c: (1 + s) * d for c, d in zip("xyz", shift, strict=True)}}
    there = Hidden("payload_error", None, {"size": s, "shift_m": shift})
    return Pair(b, [PayloadError()], named("payload_error", v), mujoco=[there])


def hose(b: Bench) -> Pair:
    """The pull of the other hose, over the lengths that occur, as a straight line in the length."""
    end = b.plant.reflector
    held = b.robot.payload
    assert held is not None
    b = b.changed({"payload_com": end}, replace(b.robot, payload=replace(held, com=end)))
    there = disturbances.HoseDrag(150e-6)
    bodies = settle(b.plant, b.stops, [there]).bodies
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
    return Pair(b, [HoseDrag(None, 0.7, 0.1)], named("hose_drag", v), numpy=[there])


# --- the structure


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


def flexure_values(b: Bench, link: int, per_moment: float, torsion: float) -> Values:
    """Turn of the whole link about each of its axes under the great moment, bent by `per_moment` [rad/(N m)]."""
    k = per_moment * float(b.great.max()) * (1 - b.along(link) + b.along(link) / torsion)
    return {f"link_flexure.{c}{link}": float(x) for c, x in zip(("rx", "ry", "rz"), k, strict=True)}


def beam(b: Bench) -> Pair:
    b, s = without_mass(b, 2), 60e-6
    values = flexure_values(b, 2, s / stretched_moments(b.plant, 2)[0], 0.8)
    return Pair(b, [LinkFlexure(None, 2)], values, numpy=[disturbances.LinkFlexure(2, s, 0.8)])


def hinged_beam(b: Bench) -> Pair:
    b, s = without_mass(b, 2), 60e-6
    values = flexure_values(b, 2, s / stretched_moments(b.plant, 2)[0], 0.8)
    there = Hidden("link_flexure", None, {"link": 2, "size": s, "torsion": 0.8})
    return Pair(b, [LinkFlexure(None, 2)], values, mujoco=[there])


def pedestal(b: Bench) -> Pair:
    s, across = 50e-6, 0.6
    rx = s * float(b.great.max()) / stretched_moments(b.plant, 0)[1]
    v = {"rx": rx, "ry": across * rx}
    return Pair(b, [BaseCompliance()], named("base_compliance", v), numpy=[disturbances.PedestalTilt(s, across)])


def anchors(b: Bench) -> Pair:
    s, across = 50e-6, 0.6
    rx = s * float(b.great.max()) / stretched_moments(b.plant, 0)[1]
    there = Hidden("base_compliance", None, {"size": s, "across": across, "height_m": 0.0})
    return Pair(b, [BaseCompliance()], named("base_compliance", {"rx": rx, "ry": across * rx}), mujoco=[there])


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
    return Pair(b, [ThermalGrowth()], {"thermal_growth.alpha": 11.5e-6}, warm, numpy=[there])


def warm_links(b: Bench) -> Pair:
    b = without_tool(b)
    b = replace(b, stops=replace(b.stops, warmth_K=np.full(len(b.stops), 5.0)))
    warm = {"warmth_600s": b.stops.warmth_K}
    there = Hidden("thermal_growth", None, {"size": 11.5e-6, "lag_minutes": 1e-3})
    return Pair(b, [ThermalGrowth()], {"thermal_growth.alpha": 11.5e-6}, warm, mujoco=[there])


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


# --- laws that no simulator draws: written here from the source that the effect names, in the simulator's own geometry


def slipped_foot(b: Bench) -> Pair:
    """A body's motion about the robot's origin, seen in the measuring frame: the frame moves with the base."""
    there = disturbances_rare.FootSlip(0, 60e-6, (0.6, -0.64, 0.48), 0.5)
    x, y, z = there.towards
    base = b.plant.base
    turn = base[:3, :3] @ (30e-6 * np.array((z, x, y)))
    shift = base[:3, :3] @ (60e-6 * np.array(there.towards))
    shift = shift - np.cross(turn, base[:3, 3])
    v = dict(zip(("x", "y", "z", "rx", "ry", "rz"), (*shift, *turn), strict=True))
    return Pair(b, [FrameStep(None, 0.5)], named("frame_step", v), progress(b), numpy=[there])


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
    return Pair(b, [FrameStep(3, 0.5)], named("frame_step@3", v), progress(b), numpy=[there])


def bent_link(b: Bench) -> Pair:
    """A bar that is warmer on one side bends to a circle: its end tilts by alpha length difference / height."""
    length, height, share = b.length(2), 0.1, 0.2
    per_K = 11.5e-6 * length * share / height
    warmth = b.stops.warmth_after(10.0)
    there = Displaced(2, np.zeros(3), per_K * np.array([0.8, -0.6, 0.0]), warmth)
    v = {"rx": 0.8 * per_K, "ry": -0.6 * per_K}
    return Pair(b, [ThermalBend(2)], named("thermal_bend@2", v), {"warmth_600s": warmth}, numpy=[there])


@dataclass(frozen=True)
class Misread(Disturbance):
    """A joint that is off its reading by these angles."""

    joint: int
    by: Array

    def misread(self, stops: Stops) -> Array:  # noqa: ARG002
        return only(self.joint, self.by)


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
    return Pair(b, [SettlingLag(3)], values, derived(b, "move3"), numpy=[Misread(3, left)])


def presliding(b: Bench) -> Pair:
    """Dahl: d state = (direction - state) |d angle| / way, integrated along each motion in small steps."""
    half, way, steps = 40e-6, 1.0, 100_000
    states, q = np.zeros(len(b.stops)), b.stops.q[:, 2]
    for k in range(1, len(q)):
        move_by = q[k] - q[k - 1]
        states[k] = np.sign(move_by) + (states[k - 1] - np.sign(move_by)) * (1 - abs(move_by) / way / steps) ** steps
    there = Misread(3, -half * states)
    values = {"friction_memory@3.half": half}
    return Pair(b, [FrictionMemory(3, 1000)], values, derived(b, "memory3_1000mrad"), numpy=[there])


def play_by_load(b: Bench) -> Pair:
    """The simulator's backlash, approached from either side: its mean without friction."""
    there, width = disturbances.Backlash(4, 60e-6, 0.1), 0.1 * b.rated[3] / b.great[3]

    class Either(Disturbance):
        def twist(self, state: Any) -> Array:
            zero = replace(state, stops=replace(state.stops, approach=np.zeros_like(state.stops.approach)))
            return there.twist(zero)

    effect = BacklashByLoad(4, 0.0, width)
    return Pair(b, [effect], {"backlash_by_load@4.half": 60e-6}, numpy=[Either()])


def hysteresis(b: Bench) -> Pair:
    """Friction in proportion to the load: the part of the simulator's windup that grows with it."""
    there = disturbances.FrictionWindup(3, 1e-6, 60.0)
    values = {"load_hysteresis@3.half": 60e-6 * b.great[2] / b.rated[2]}
    return Pair(b, [LoadHysteresis(3, 1)], values, approach(b, 3), numpy=[there])


@dataclass(frozen=True)
class Given(Disturbance):
    """A joint's twist as a function of the state."""

    joint: int
    law: Callable[[Any], Array]

    def twist(self, state: Any) -> Array:
        return only(self.joint, self.law(state))


def inner_friction(b: Bench) -> Pair:
    """Rayleigh: the branches of a loop lie apart by the square of the load."""
    there = Given(3, lambda s: -40e-6 * s.stops.approach[:, 2] * (s.load[:, 2] / b.great[2]) ** 2)
    values = {"load_hysteresis@3.half": 40e-6}
    return Pair(b, [LoadHysteresis(3, 2)], values, approach(b, 3), numpy=[there])


def off_diagonal(b: Bench) -> Pair:
    """A compliance matrix with a term off its diagonal [rad/(N m)]."""
    per_Nm = 60e-6 / b.great[1]
    there = Given(3, lambda s: per_Nm * s.load[:, 1])
    return Pair(b, [CrossCoupling(3, 2)], {"cross_coupling@3.k2": 60e-6}, numpy=[there])


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
    effect = FrameSettling(None, settles=Newton.settles)
    return Pair(b, [effect], named("frame_settling", v), progress(b), numpy=[Newton()])


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
    effect = SmrOffset(None, tuple(float(x) for x in OffCentre.station))
    return Pair(b, [effect], named("smr_offset", v), numpy=[OffCentre()])


def named(label: str, values: Values) -> dict[str, float]:
    return {f"{label}.{name}": float(value) for name, value in values.items()}


def progress(b: Bench) -> dict[str, Array]:
    return {"progress": b.stops.progress}


# Limits of what is built otherwise: half as much again as what a right formula shows, rounded up.
SKEWED, LAW = "the wave is skewed", "another law"
NUMPY = (
    Case("gear_eccentricity", eccentric),
    Case("transmission_ripple", ripple, 0.4, SKEWED),
    Case("gear_mesh", mesh, 0.3, SKEWED),
    Case("joint_error_curve", curve),
    Case("joint_scale", scale),
    Case("joint_coupling", coupling, 0.17, "less far from zero"),
    Case("joint_zero_step", zero_step, 0.06, "a tenth creeps back"),
    Case("thermal_zero_drift", zero_drift, 0.2, "more when it is hot"),
    Case("thermal_growth", growth),
    Case("target_shift", nest),
    Case("frame_drift", creep),
    Case("tracker_scale, refraction", beam_of_light),
    Case("refraction", beam_from_afar),
    Case("payload_error", payload),
    Case("link_masses", links),
    Case("missing_compliance", soft),
    Case("backlash", play),
    Case("friction_windup", windup),
    Case("friction_windup, by load", windup_by_load),
    Case("nonlinear_stiffness", hardening, 0.06, LAW),
    Case("cubic_stiffness", cubic),
    Case("cubic_stiffness, alone", cubic_alone, 0.2, "first order in the cubic part"),
    Case("gravity_compensator", balancer, 0.03, "acts at the deflected pose"),
    Case("hose_drag", hose, 0.3, f"{LAW}; axes 4 to 6 meet", ("hh800", "kr210")),
    Case("axis_wobble", wobble),
    Case("link_flexure", beam),
    Case("base_compliance", pedestal),
    Case("bearing_play, drop", sag),
    Case("bearing_play, rock", rocking_flange),
    Case("frame_step", slipped_foot),
    Case("frame_step, link", slipped_flange),
    Case("thermal_bend", bent_link),
    Case("settling_lag", too_soon),
    Case("friction_memory", presliding),
    Case("backlash_by_load", play_by_load),
    Case("load_hysteresis", hysteresis),
    Case("load_hysteresis, square", inner_friction),
    Case("cross_coupling", off_diagonal),
    Case("frame_settling", settling_frame),
    Case("smr_offset", reflector),
)
MUJOCO = (
    Case("gear_eccentricity", eccentric_wheel),
    Case("transmission_ripple", tooth_ripple, 0.15, SKEWED),
    Case("joint_scale", pulley),
    Case("joint_coupling", bevel),
    Case("joint_zero_step", jump),
    Case("thermal_zero_drift", warm_gear),
    Case("thermal_growth", warm_links),
    Case("target_shift", knocked),
    Case("frame_drift", settling_stand),
    Case("payload_error", cargo),
    Case("backlash", stops_of_play, 0.1, "some poses lie at the threshold"),
    Case("friction_windup", dry_friction, 0.1, "rubs in the loop's bearings"),
    Case("gravity_compensator", tendon, 0.03, "acts at the deflected pose"),
    Case("axis_wobble", pads),
    # In the engine a parallelogram holds the link's end: the loop carries what the open chain of the effect does not.
    Case("link_flexure", hinged_beam, 0.03, "two hinges; no loop", ("kr210", "ur10e")),
    Case("base_compliance", anchors, 0.2, "the foot sinks, too"),
)


def main() -> None:
    poses = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    worlds: dict[str, tuple[Case, ...]] = {"numpy": NUMPY}
    if importlib.util.find_spec("mujoco"):
        worlds["MuJoCo"] = MUJOCO
    benches = {name: bench(name, poses) for name in ROBOTS}
    rows, within = [], 0
    for world, cases in worlds.items():
        for case in cases:
            found = {name: case.make(benches[name]).apart() for name in case.robots}
            within += all(apart <= case.limit for apart, _ in found.values())
            apart = "".join(f"{found[name][0]:9.5f}" if name in found else 8 * " " + "-" for name in ROBOTS)
            moved = "".join(f"{1e3 * found[name][1]:8.3f}" if name in found else 7 * " " + "-" for name in ROBOTS)
            rows.append(f"{world:7s} {case.name:26s}{apart}  {case.limit:6.3f} {moved}  {case.why}".rstrip())
    print(f"{within} of {len(rows)} counterparts agree with their effects at {poses} poses of {', '.join(ROBOTS)}")
    print()
    print(f"{'physics':7s} {'effect':26s}{'apart':>9s}{'':18s}   limit  greatest motion [mm]    wider because")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
