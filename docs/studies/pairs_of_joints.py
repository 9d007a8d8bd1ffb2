"""Pairs of counterpart_pairs.py in the joints: drives, springs, friction, and what loads them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from acting import Disturbance, State
from counterpart_pairs import Bench, Pair, approach, named, progress

from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.cause import settle, warmth_inside
from casadical.blind_check.mujoco_physics.hidden import cause
from casadical.blind_check.mujoco_physics.plant import move
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


def eccentric_wheel(b: Bench) -> Pair:
    """The rim rolls: the lag is - size (sin(q - t) + sin t) - oval (sin 2(q - ot) + sin 2 ot), with a zero offset."""
    s, t, o, ot = 80e-6, 0.6, 50e-6, 1.1
    v = {"sin1": -s * np.cos(t), "cos1": s * np.sin(t), "sin2": -o * np.cos(2 * ot), "cos2": o * np.sin(2 * ot)}
    offset = {"step": -s * np.sin(t) - o * np.sin(2 * ot)}
    there = Hidden("gear_eccentricity", 5, {"size": s, "towards": t, "oval": o, "oval_towards": ot})
    values = {**named("gear_eccentricity@5", v), **named("joint_zero_step@5", offset)}
    return Pair(b, [GearEccentricity(5), JointZeroStep(5, -1.0)], values, progress(b), hidden=[there])


def tooth_ripple(b: Bench) -> Pair:
    s, c, p = 60e-6, 4, 0.3
    wave = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
    first = 2 * np.mean(np.arcsin(0.95 * np.sin(wave)) / np.arcsin(0.95) * np.sin(wave))
    v = {"sin": first * s * np.cos(p), "cos": first * s * np.sin(p)}
    there = Hidden("transmission_ripple", 5, {"size": s, "cycles": c, "phase": p})
    return Pair(b, [TransmissionRipple(5, 4.0)], named("transmission_ripple@5", v), hidden=[there])


def mesh(b: Bench) -> Pair:
    """Once a turn of a shaft that turns 80 times as fast, by a ripple of so many cycles."""
    pair = tooth_ripple(b)
    values = {name.replace("transmission_ripple@5.", "gear_mesh@5.") + "1": v for name, v in pair.values.items()}
    there = Hidden("transmission_ripple", 5, {"size": 60e-6, "cycles": 80, "phase": 0.3})
    values |= {"gear_mesh@5.sin2": 0.0, "gear_mesh@5.cos2": 0.0}
    return Pair(b, [GearMesh(5, 80.0)], values, hidden=[there])


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
    return Pair(b, [JointErrorCurve(orders=orders), JointZeroStep(2, -1.0)], values, progress(b), hidden=there)


def scale(b: Bench) -> Pair:
    engine = Hidden("joint_scale", 4, {"size": 60e-6})
    return Pair(b, [JointScale(4)], {"joint_scale@4.k": 60e-6}, hidden=[engine])


def coupling(b: Bench) -> Pair:
    engine = Hidden("joint_coupling", 5, {"source": 4, "size": 80e-6})
    return Pair(b, [JointCoupling(5, 4)], {"joint_coupling@5.k4": 80e-6}, hidden=[engine])


def jump(b: Bench) -> Pair:
    at = float(b.stops.time_s[len(b.stops) // 2])
    late = {"progress": (b.stops.time_s >= at).astype(float)}
    there = Hidden("joint_zero_step", 3, {"size": 40e-6, "at_s": at})
    return Pair(b, [JointZeroStep(3, 0.5)], {"joint_zero_step@3.step": 40e-6}, late, hidden=[there])


def warm_gear(b: Bench) -> Pair:
    there, warmth = Hidden("thermal_zero_drift", 2, {"size": 10e-6, "lag_minutes": 8.0}), warmth_inside(b.stops, 8.0)
    values = {"thermal_zero_drift@2.drift": 10e-6}
    return Pair(b, [ThermalZeroDrift(2)], values, {"warmth_600s": warmth}, hidden=[there])


# --- loads


def soft(b: Bench) -> Pair:
    """A joint half as stiff as drawn."""
    k, deflection = b.plant.stiffness.copy(), b.great[4] / b.plant.stiffness[4]
    k[4] /= 2
    values = {"missing_compliance@5.deflection": deflection}
    return Pair(b, [MissingCompliance(5)], values, other={"stiffness": k})


def stops_of_play(b: Bench) -> Pair:
    there = Hidden("backlash", 4, {"size": 60e-6, "friction": 0.02})
    share = 0.02 * 60e-6 * b.plant.stiffness[3] / b.great[3]
    return Pair(b, [Backlash(4, share, 0.1 * share)], {"backlash@4.half": 60e-6}, approach(b, 4), hidden=[there])


def windup(b: Bench) -> Pair:
    engine = Hidden("friction_windup", 3, {"size": 40e-6, "load_share": 0.0})
    values = {"friction_windup@3.constant": 40e-6, "friction_windup@3.load": 0.0}
    return Pair(b, [FrictionWindup(3)], values, approach(b, 3), hidden=[engine])


def windup_by_load(b: Bench) -> Pair:
    """Nearly all of the friction by the load."""
    there = Hidden("friction_windup", 3, {"size": 1e-6, "load_share": 60.0})
    values = {"friction_windup@3.constant": 0.0, "friction_windup@3.load": 60e-6 * b.great[2] / b.rated[2]}
    return Pair(b, [FrictionWindup(3)], values, approach(b, 3), hidden=[there])


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
    return Pair(b, [NonlinearStiffness(4, knee), MissingCompliance(4)], values, hidden=[there])


def cubic(b: Bench) -> Pair:
    """Nearly linear: size (load - 0.05 load^3) to first order in the cubic part."""
    there = Hidden("nonlinear_stiffness", 4, {"size": 120e-6, "knee": 0.0, "linear": 0.95})
    size, r = 120e-6, b.great[3] / b.rated[3]
    bend = size * 0.05 / 0.95**4 * r**3
    values = {"cubic_stiffness@4.bend": bend, "missing_compliance@4.deflection": size / 0.95 * r}
    return Pair(b, [CubicStiffness(4), MissingCompliance(4)], values, hidden=[there])


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
    return Pair(b, [GravityCompensator(2, post, phase)], named("gravity_compensator@2", v), hidden=[there])


def payload(b: Bench) -> Pair:
    s, shift = 0.08, np.array([0.03, -0.02, 0.025])
    v = {"mass": s, **{c: (1 + s) * d for c, d in zip("xyz", shift, strict=True)}}
    engine = Hidden("payload_error", None, {"size": s, "shift_m": tuple(shift)})
    return Pair(b, [PayloadError()], named("payload_error", v), hidden=[engine])


def links(b: Bench) -> Pair:
    """Links heavier or lighter than declared, by other mass centres: m (1 + s) (c + d) is m (c + s c + (1 + s) d)."""
    rng = np.random.default_rng(3)
    share, shift = rng.uniform(-0.2, 0.2, 6), rng.uniform(-0.03, 0.03, (6, 3))
    v = {f"m{i}": s for i, s in enumerate(share, 1)}
    moments = (1 + share)[:, None] * shift
    v |= {f"{c}{i}": x for i, d in enumerate(moments, 1) for c, x in zip("xyz", d, strict=True)}
    other = {"mass": b.plant.mass * (1 + share), "com": b.plant.com + shift}
    return Pair(b, [LinkMasses()], named("link_masses", v), other=other)


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
    return Pair(b, [HoseDrag(None, 0.7, 0.1)], named("hose_drag", v), hidden=[there])
