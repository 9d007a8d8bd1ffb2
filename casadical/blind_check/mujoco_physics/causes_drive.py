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
    """Return the joint error of an eccentric, oval gear wheel, shape (n,) [rad].

    A wheel whose centre is ``size`` radii off its shaft, and which is oval by ``oval``, rolls on a
    pinion whose angle is read. The pinion turns by the rolled length of the rim, the integral of
    the rim's distance from the shaft.
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
    """Return the joint error of a gear's teeth, shape (n,) [rad].

    There are ``cycles`` teeth a turn; each moves the joint a little ahead while it enters the mesh,
    and behind while it leaves.
    """
    mesh = cycles * stops.q[:, joint - 1] + phase
    return np.asarray(size * (np.arcsin(0.95 * np.sin(mesh)) / np.arcsin(0.95)))


@acts("motors")
def joint_scale(plant: Plant, stops: Stops, *, joint: int, size: float) -> Array:
    """Return the joint error of a pulley that is too large by the share ``size``, (n,) [rad]."""
    return size * stops.q[:, joint - 1]


@acts("built")
def joint_coupling(mechanism: Mechanism, plant: Plant, *, joint: int, source: int, size: float) -> Mechanism:
    """Return the mechanism with bevel gears that couple a joint to another one.

    The springs of the joint wind between its motor and the joint less ``size`` times joint
    ``source``. A torque in the joint then also acts on the source.
    """
    name, other = f"joint{joint}", f"joint{source}"
    held = mechanism.joint(name)
    bevel = Shaft(f"bevel{joint}", {name: 1.0, other: -size}, held.stiffness, motor=joint)
    loose = replace(held, stiffness=0.0, motor=None)
    shafts = [replace(s, joints={**s.joints, other: -size}) if s.motor == joint else s for s in mechanism.shafts]
    return replace(mechanism.with_joints(name, loose), shafts=(*shafts, bevel))


@acts("motors")
def joint_zero_step(plant: Plant, stops: Stops, *, joint: int, size: float, at_s: float) -> Array:
    """Return the joint error of a zero that jumps by ``size`` [rad] at time ``at_s``, (n,)."""
    return np.where(stops.time_s >= at_s, size, 0.0)


@acts("motors")
def thermal_zero_drift(plant: Plant, stops: Stops, *, joint: int, size: float, lag_minutes: float) -> Array:
    """Return the joint error of a zero that drifts with temperature, shape (n,) [rad].

    It follows the temperature inside the gear by ``size`` [rad/K], with a lag."""
    return size * warmth_inside(stops, lag_minutes)


@acts("motors")
def encoder_pit(plant: Plant, stops: Stops, *, joint: int, size: float, at_rad: float, width_rad: float) -> Array:
    """Return the joint error of a scratched encoder disc, shape (n,) [rad]; not a listed effect.

    It is up to ``size`` [rad] within ``width_rad`` of ``at_rad``.
    """
    q = stops.q[:, joint - 1]
    beside = np.abs((q - at_rad + np.pi) % (2 * np.pi) - np.pi) / width_rad
    return size * np.where(beside < 1, (1 - beside**2) ** 2, 0.0)


@acts("motors")
def damaged_tooth(plant: Plant, stops: Stops, *, joint: int, size: float, ratio: float, at_rad: float) -> Array:
    """Return the joint error of a pinion with a worn tooth, shape (n,) [rad]; not a listed effect.

    The joint jumps back by ``size`` [rad] for a tenth of each turn of the pinion, which makes
    ``ratio`` turns in one of the joint.
    """
    pinion = (ratio * stops.q[:, joint - 1] - at_rad) % (2 * np.pi) / (2 * np.pi)
    return np.where(pinion < 0.1, -size, 0.0)


@acts("motors")
def lost_bits(plant: Plant, stops: Stops, *, joint: int, size: float, at_rad: float) -> Array:
    """Return the joint error of an encoder that lost its low bits, shape (n,) [rad]; not listed.

    The joint stops in the middle of a step of ``size`` [rad]; one of the middles is at ``at_rad``.
    """
    q = stops.q[:, joint - 1] - at_rad
    return size * np.round(q / size) - q
