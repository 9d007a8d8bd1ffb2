"""Hidden causes in the drives that do not depend on load: gears, encoders, belts, bevels, zeros."""

from dataclasses import replace

import numpy as np

from casadical.blind_check.mujoco_physics.cause import acts, warmth_inside
from casadical.blind_check.mujoco_physics.mechanism import Mechanism, Shaft
from casadical.blind_check.mujoco_physics.plant import Array, Plant
from casadical.blind_check.mujoco_physics.stops import Stops


@acts("motors")
def gear_eccentricity(
    plant: Plant, stops: Stops, *, joint: int, size: float, towards: float, oval: float, oval_towards: float
) -> Array:
    """A wheel whose centre is ``size`` radii off its shaft, and oval by ``oval``, rolls on a pinion that is read.

    The pinion turns by the rolled length of the rim, the integral of the rim's distance from the shaft.
    """
    angle = np.linspace(-2 * np.pi, 2 * np.pi, 8001)
    along = angle - towards
    off = size * np.cos(along) + np.sqrt(1 - (size * np.sin(along)) ** 2)
    long, short = 1 + 2 * oval, 1 - 2 * oval
    turned = angle - oval_towards
    rim = off * long * short / np.hypot(short * np.cos(turned), long * np.sin(turned))
    rolled = np.concatenate([[0.0], np.cumsum((rim[1:] + rim[:-1]) / 2 * np.diff(angle))])
    rolled *= 4 * np.pi / rolled[-1]
    lag = angle - (rolled - 2 * np.pi)
    return np.interp(stops.q[:, joint - 1], rolled - 2 * np.pi, lag)


@acts("motors")
def transmission_ripple(plant: Plant, stops: Stops, *, joint: int, size: float, cycles: int, phase: float) -> Array:
    """Teeth pass ``cycles`` a turn; each carries a little ahead while it enters and behind while it leaves."""
    mesh = cycles * stops.q[:, joint - 1] + phase
    return np.asarray(size * (np.arcsin(0.95 * np.sin(mesh)) / np.arcsin(0.95)))


@acts("motors")
def joint_scale(plant: Plant, stops: Stops, *, joint: int, size: float) -> Array:
    """A pulley larger than drawn by the share ``size``."""
    return size * stops.q[:, joint - 1]


@acts("built")
def joint_coupling(mechanism: Mechanism, plant: Plant, *, joint: int, source: int, size: float) -> Mechanism:
    """Bevel gears: the springs of the joint wind between its motor and the joint less ``size`` times joint ``source``.

    A torque in the joint then works back on the source, too.
    """
    name, other = f"joint{joint}", f"joint{source}"
    held = mechanism.joint(name)
    bevel = Shaft(f"bevel{joint}", {name: 1.0, other: -size}, held.stiffness, motor=joint)
    loose = replace(held, stiffness=0.0, motor=None)
    shafts = [replace(s, joints={**s.joints, other: -size}) if s.motor == joint else s for s in mechanism.shafts]
    return replace(mechanism.with_joints(name, loose), shafts=(*shafts, bevel))


@acts("motors")
def joint_zero_step(plant: Plant, stops: Stops, *, joint: int, size: float, at_s: float) -> Array:
    """The joint's zero jumps by ``size`` [rad] at the time ``at_s``."""
    return np.where(stops.time_s >= at_s, size, 0.0)


@acts("motors")
def thermal_zero_drift(plant: Plant, stops: Stops, *, joint: int, size: float, lag_minutes: float) -> Array:
    """The joint's zero follows the warmth inside its gear by ``size`` [rad/K]."""
    return size * warmth_inside(stops, lag_minutes)


@acts("motors")
def encoder_pit(plant: Plant, stops: Stops, *, joint: int, size: float, at_rad: float, width_rad: float) -> Array:
    """A scratched encoder disc: the joint is off by up to ``size`` within ``width_rad`` of ``at_rad``; on no list."""
    q = stops.q[:, joint - 1]
    beside = np.abs((q - at_rad + np.pi) % (2 * np.pi) - np.pi) / width_rad
    return size * np.where(beside < 1, (1 - beside**2) ** 2, 0.0)


@acts("motors")
def damaged_tooth(plant: Plant, stops: Stops, *, joint: int, size: float, ratio: float, at_rad: float) -> Array:
    """A worn tooth of a pinion: the joint jumps back by ``size`` [rad] for a tenth of each pinion turn; on no list.

    ``ratio`` is the number of pinion turns in one of the joint.
    """
    pinion = (ratio * stops.q[:, joint - 1] - at_rad) % (2 * np.pi) / (2 * np.pi)
    return np.where(pinion < 0.1, -size, 0.0)


@acts("motors")
def lost_bits(plant: Plant, stops: Stops, *, joint: int, size: float, at_rad: float) -> Array:
    """An encoder that lost its low bits: the joint stops in the middle of a step of ``size`` [rad]; on no list.

    One of the middles is at ``at_rad``.
    """
    q = stops.q[:, joint - 1] - at_rad
    return size * np.round(q / size) - q
