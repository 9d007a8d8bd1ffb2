"""Counterparts in a simulator that a definition may name, each for effects with the parameters that it reads."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from casadical.core.parts import Body
from casadical.effects.base import Counterparts, Effect

# tanh(x) is nearest to SLOPE x that stops at STOP, off by OFF at most.
SLOPE, STOP, OFF = 0.76, 0.92, 0.083


def gear_ratio(effect: Effect, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Of an effect with `k`, the share by which the joint turns too much."""
    return simulator.with_drive(effect.joint, ratio=1 + v["k"]).noted(f"{effect.label}: gear of the drive")


def foot_hinges(effect: Effect, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Of an effect with `rx` and `ry`, the tilt of the foot under the greatest moment [rad]."""
    return simulator.with_springs(effect.label, v, 0)


def joint_spring(effect: Effect, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Of an effect with `deflection`, under the joint's great torque [rad]."""
    if v["deflection"] <= 0:
        return simulator.without_sign(effect.label)
    soft = simulator.drive(effect.joint).compliance + v["deflection"] / simulator.great(effect.joint)
    return simulator.with_drive(effect.joint, compliance=soft).noted(f"{effect.label}: spring of joint {effect.joint}")


def dry_friction(effect: Effect, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Of an effect with `constant`, a windup [rad], and `load`, what the great torque adds to it [rad]."""
    soft = simulator.drive(effect.joint).compliance
    if soft <= 0:
        return simulator.without_sign(effect.label)
    assert effect.joint is not None
    wound = v["constant"] + v["load"] * float(simulator.mean_load[effect.joint - 1])
    if wound <= 0:
        return simulator.without(effect.label, "its friction came out negative")
    simulator = simulator.with_drive(effect.joint, friction=wound / soft)
    return simulator.noted(f"{effect.label}: dry friction of {wound / soft:.4g} N m, at its mean load")


def soft_spring(effect: Any, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Of an effect with `bend`, at which the deflection saturates [rad], and the setting `knee`, the torque there."""
    if v["bend"] <= 0:
        return simulator.without_sign(effect.label)
    stiffness = effect.knee * simulator.great(effect.joint) / (SLOPE * v["bend"])
    simulator = simulator.with_drive(effect.joint, give=STOP * v["bend"], give_stiffness=stiffness)
    spring = f"joint{effect.joint}_bed, a soft spring between stops"
    return simulator.noted(f"{effect.label}: {spring}, within {1e6 * OFF * v['bend']:.1f} urad")


def hardening_spring(effect: Effect, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Of an effect with `bend`: the spring k1 d + k3 d^3 nearest to the deflection c tau - bend (tau / great)^3."""
    great, load = simulator.great(effect.joint), np.linspace(-1.2, 1.2, 97)
    d = simulator.drive(effect.joint).compliance * great * load - v["bend"] * load**3
    if (np.diff(d) <= 0).any():
        return simulator.without(effect.label, "the deflection would decrease with the load")
    scale = np.array([np.abs(d).max(), np.abs(d).max() ** 3])
    k1, k3 = np.linalg.lstsq(np.column_stack([d, d**3]) / scale, great * load, rcond=None)[0] / scale
    off = 1e6 * float(np.abs(great * load - k1 * d - k3 * d**3).max() / k1)
    spring = f"joint{effect.joint}_give with the spring k1 d + k3 d^3"
    return simulator.with_drive(effect.joint, k1=float(k1), k3=float(k3)).noted(
        f"{effect.label}: {spring}, within {off:.1f} urad"
    )


def payload(effect: Effect, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Of an effect with `mass`, a share, and `x`, `y`, `z`: the true mass, and the centre of the same first moment."""
    declared = simulator.payload
    if declared is None:
        return simulator.without(effect.label, "no counterpart in MuJoCo")
    factor = 1 + v["mass"]
    centre = declared.com + np.array([v[c] for c in "xyz"]) / factor
    simulator = replace(simulator, payload=Body(declared.mass * factor, centre), payload_factor=factor)
    masses = f"{declared.mass * factor:.4g} kg in place of {declared.mass:.4g} kg"
    return simulator.noted(f"{effect.label}: {masses}, centre moved")


COUNTERPARTS: Mapping[str, Callable[[Effect, Counterparts, Mapping[str, float]], Counterparts]] = {
    "gear ratio": gear_ratio,
    "foot hinges": foot_hinges,
    "joint spring": joint_spring,
    "dry friction": dry_friction,
    "soft spring": soft_spring,
    "hardening spring": hardening_spring,
    "payload": payload,
}
