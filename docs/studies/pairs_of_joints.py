"""Pairs of counterpart_pairs.py in the joints: drives, springs, friction, and what loads them."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from counterpart_pairs import Bench, Pair, approach, named, progress

from casadical.blind_check.mujoco_physics import Hidden, Plant
from casadical.blind_check.mujoco_physics.cause import warmth_inside
from casadical.blind_check.mujoco_physics.stops import Stops
from casadical.core.basics import Array
from casadical.effects import (
    Backlash,
    CubicStiffness,
    FrictionWindup,
    GearEccentricity,
    GearMesh,
    GravityCompensator,
    HoseDrag,
    JointCoupling,
    JointErrorCurve,
    JointScale,
    JointZeroStep,
    LinkMasses,
    MissingCompliance,
    NonlinearStiffness,
    PayloadError,
    ThermalZeroDrift,
    TransmissionRipple,
)

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # for the simulator in numpy

from numpy_physics import disturbances
from numpy_physics.disturbance import Disturbance
from numpy_physics.statics import settle


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
    there, engine = disturbances.JointScale(4, 60e-6), Hidden("joint_scale", 4, {"size": 60e-6})
    return Pair(b, [JointScale(4)], {"joint_scale@4.k": 60e-6}, numpy=[there], mujoco=[engine])


def coupling(b: Bench) -> Pair:
    there, engine = disturbances.JointCoupling(5, 4, 80e-6), Hidden("joint_coupling", 5, {"source": 4, "size": 80e-6})
    return Pair(b, [JointCoupling(5, 4)], {"joint_coupling@5.k4": 80e-6}, numpy=[there], mujoco=[engine])


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
    engine = Hidden("friction_windup", 3, {"size": 40e-6, "load_share": 0.0})
    values = {"friction_windup@3.constant": 40e-6, "friction_windup@3.load": 0.0}
    return Pair(b, [FrictionWindup(3)], values, approach(b, 3), numpy=[there], mujoco=[engine])


def windup_by_load(b: Bench) -> Pair:
    """Nearly all of the friction by the load."""
    there = disturbances.FrictionWindup(3, 1e-6, 60.0)
    values = {"friction_windup@3.constant": 0.0, "friction_windup@3.load": 60e-6 * b.great[2] / b.rated[2]}
    return Pair(b, [FrictionWindup(3)], values, approach(b, 3), numpy=[there])


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
    engine = Hidden("payload_error", None, {"size": s, "shift_m": tuple(shift)})
    return Pair(b, [PayloadError()], named("payload_error", v), numpy=[there], mujoco=[engine])


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
