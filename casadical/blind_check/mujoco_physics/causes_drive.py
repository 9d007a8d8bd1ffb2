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
    """Return the joint error of an eccentric, oval gear wheel at each of n stops, shape (n,) [rad].

    It is the true angle less the reading. The wheel rolls on a pinion, whose angle the encoder
    measures: the integral of the rim's distance from the shaft. The error is zero at reading zero
    and periodic; to first order its first harmonic has the amplitude `size` and
    its second `oval` [rad].

    joint : number of the joint, from 1
    size : distance of the wheel's centre from its shaft, divided by its radius
    oval : a quarter of the relative difference of the wheel's semi-axes
    towards, oval_towards : directions of the eccentricity and of the long axis [rad]
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
    return np.interp(np.fmod(stops.q[:, joint - 1], 2 * np.pi), rolled - 2 * np.pi, lag)


@acts("motors")
def transmission_ripple(plant: Plant, stops: Stops, *, joint: int, size: float, cycles: int, phase: float) -> Array:
    """Return the joint error of a gear's teeth at each of n stops, shape (n,) [rad].

    It is the true angle less the reading. Each tooth moves the joint ahead while it enters the
    mesh, and back while it leaves.

    joint : number of the joint, from 1
    size : amplitude of the error [rad]; cycles : number of teeth per turn of the joint
    phase : phase of the mesh at reading zero [rad]
    """
    mesh = cycles * stops.q[:, joint - 1] + phase
    return np.asarray(size * (np.arcsin(0.95 * np.sin(mesh)) / np.arcsin(0.95)))


@acts("motors")
def joint_scale(plant: Plant, stops: Stops, *, joint: int, size: float) -> Array:
    """Return the joint error of a pulley of a wrong diameter at each of n stops, shape (n,) [rad].

    It is the true angle less the reading and proportional to the reading.

    joint : number of the joint, from 1
    size : relative error of the transmission ratio
    """
    return size * stops.q[:, joint - 1]


@acts("built")
def joint_coupling(mechanism: Mechanism, plant: Plant, *, joint: int, source: int, size: float) -> Mechanism:
    """Return the mechanism with bevel gears that couple a joint to another one.

    The springs of the joint are between its motor and the joint's angle less `size` times that of
    joint `source`, so that a torque in the joint also acts on the source.

    joint, source : numbers of the joints, from 1; size : ratio of the coupling
    """
    name, other = f"joint{joint}", f"joint{source}"
    bare = mechanism.joint(name)
    bevel = Shaft(f"bevel{joint}", {name: 1.0, other: -size}, bare.stiffness, motor=joint)
    loose = replace(bare, stiffness=0.0, motor=None)
    shafts = [replace(s, joints={**s.joints, other: -size}) if s.motor == joint else s for s in mechanism.shafts]
    return replace(mechanism.with_joints(name, loose), shafts=(*shafts, bevel))


@acts("motors")
def joint_zero_step(plant: Plant, stops: Stops, *, joint: int, size: float, at_s: float) -> Array:
    """Return the joint error of a zero that jumps once at each of n stops, shape (n,) [rad].

    It is the true angle less the reading.

    joint : number of the joint, from 1
    size : size of the jump [rad]; at_s : time of the jump [s]
    """
    return np.where(stops.time_s >= at_s, size, 0.0)


@acts("motors")
def thermal_zero_drift(plant: Plant, stops: Stops, *, joint: int, size: float, lag_minutes: float) -> Array:
    """Return the joint error of a zero that drifts thermally at each of n stops, shape (n,) [rad].

    It is the true angle less the reading, and follows the temperature inside the gear, which lags
    behind that of the surface.

    joint : number of the joint, from 1
    size : drift per temperature rise [rad/K]; lag_minutes : time constant of the lag [min]
    """
    return size * warmth_inside(stops, lag_minutes)


@acts("motors")
def encoder_pit(plant: Plant, stops: Stops, *, joint: int, size: float, at_rad: float, width_rad: float) -> Array:
    """Return the joint error of a scratched encoder disc at each of n stops, shape (n,) [rad].

    It is the true angle less the reading. The effect is not on the diagnosis' list.

    joint : number of the joint, from 1
    size : largest error [rad]; at_rad : reading at which it occurs [rad]
    width_rad : distance in reading from there at which the error vanishes [rad]
    """
    q = stops.q[:, joint - 1]
    distance = np.abs((q - at_rad + np.pi) % (2 * np.pi) - np.pi) / width_rad
    return size * np.where(distance < 1, (1 - distance**2) ** 2, 0.0)


@acts("motors")
def damaged_tooth(plant: Plant, stops: Stops, *, joint: int, size: float, ratio: float, at_rad: float) -> Array:
    """Return the joint error of a pinion with a worn tooth at each of n stops, shape (n,) [rad].

    It is the true angle less the reading: the joint jumps back for a tenth of each turn of the
    pinion. The effect is not on the diagnosis' list.

    joint : number of the joint, from 1
    size : size of the jump [rad]; ratio : turns of the pinion per turn of the joint
    at_rad : angle of the pinion at which the jump begins [rad]
    """
    pinion = (ratio * stops.q[:, joint - 1] - at_rad) % (2 * np.pi) / (2 * np.pi)
    return np.where(pinion < 0.1, -size, 0.0)


@acts("motors")
def lost_bits(plant: Plant, stops: Stops, *, joint: int, size: float, at_rad: float) -> Array:
    """Return the joint error of an encoder without its low bits at each of n stops, (n,) [rad].

    It is the true angle less the reading: the joint stops in the middle of a step. The effect is
    not on the diagnosis' list.

    joint : number of the joint, from 1
    size : width of a step [rad]; at_rad : middle of one of the steps [rad]
    """
    q = stops.q[:, joint - 1] - at_rad
    return size * np.round(q / size) - q
