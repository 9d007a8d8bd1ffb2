"""Hidden causes in the measurement, in the drives, and those that depend on load in the joints.

Measurement: a creeping frame, a moved reflector, outliers, offsets; drives: gears, encoders, belts,
bevels, zeros; load: play, friction, springs, cables, rubber.
"""

from dataclasses import replace

import numpy as np

from casadical.blind_check.mujoco_physics.cause import Vector, acts, rated_torque, reflector, settle, warmth_inside
from casadical.blind_check.mujoco_physics.equilibrium import Setting
from casadical.blind_check.mujoco_physics.mechanism import SPRING_TIME_CONSTANT_S, Cord, Joint, Mechanism, Shaft, spring
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


@acts("built")
def backlash(mechanism: Mechanism, plant: Plant, *, joint: int, size: float, friction: float) -> Mechanism:
    """Return the mechanism with play between a joint's gear and its link.

    The play is a hinge between hard stops. The link's bearing has dry friction. Where the load is
    less than that, the link lags behind the motion; elsewhere the load takes up the play.

    joint : number of the joint, from 1
    size : half of the play [rad]
    friction : deflection of the joint's spring by the friction torque, divided by `size`
    """
    name, stiffness = f"joint{joint}", float(plant.stiffness[joint - 1])
    k = 0.1 * stiffness
    play = Joint(
        f"play{joint}", limits=(-size, size), inertia=k * SPRING_TIME_CONSTANT_S**2, damping=k * SPRING_TIME_CONSTANT_S
    )
    rub = Shaft(f"bearing{joint}", {name: 1.0, play.name: 1.0}, friction=friction * size * stiffness)
    mechanism = mechanism.with_joints(name, mechanism.joint(name), play)
    return replace(mechanism, shafts=(*mechanism.shafts, rub), travels=True)


@acts("built")
def friction_windup(mechanism: Mechanism, plant: Plant, *, joint: int, size: float, load_share: float) -> Mechanism:
    """Return the mechanism with dry friction in a joint, whose spring stays wound after a motion.

    joint : number of the joint, from 1
    size : largest deflection of the spring by the friction of the joint without load [rad]
    load_share : relative increase of the friction at the rated torque
    """
    j, sprung = joint - 1, mechanism.joint(f"joint{joint}")
    idle = size * float(plant.stiffness[j])
    sprung = replace(sprung, friction=idle, rubbing=load_share * idle / float(rated_torque(plant)[j]))
    return replace(mechanism.with_joints(sprung.name, sprung), travels=True)


@acts("built")
def nonlinear_stiffness(
    mechanism: Mechanism, plant: Plant, *, joint: int, size: float, knee: float, linear: float
) -> Mechanism:
    """Return the mechanism with a strain-wave gear in a joint, which is soft at small torques.

    Either a second spring engages at some torque, or a flexible wheel with the torque a x + b x^3
    is in series.

    joint : number of the joint, from 1
    size : deflection at the rated torque beyond that of the joint's own spring [rad]
    knee : torque at which the second spring engages, divided by the rated torque; 0: there is a
        flexible wheel instead
    linear : linear part a x of the flexible wheel's torque at the rated torque, divided by it
    """
    name, rated = f"joint{joint}", rated_torque(plant)[joint - 1]
    sprung = mechanism.joint(name)
    if knee > 0:
        k, at = sprung.stiffness, knee * rated
        soft = at * k / (size * k + at)
        second = Shaft(f"second{joint}", {name: 1.0}, k - soft, motor=joint, slack=at / soft)
        calm = spring(name, soft, inertia_of=max(3 * soft, k / 16))
        sprung = replace(sprung, stiffness=soft, inertia=calm.inertia, damping=calm.damping)
        return replace(mechanism.with_joints(name, sprung), shafts=(*mechanism.shafts, second))
    a, b = linear * rated / size, (1 - linear) * rated / size**3
    wheel = spring(f"flexible{joint}", a, hardening=b, inertia_of=3 * a)
    return mechanism.with_joints(name, sprung, wheel)


@acts("built")
def gravity_compensator(mechanism: Mechanism, plant: Plant, *, size: float, lean: float, post: float) -> Mechanism:
    """Return the mechanism with a balancing spring from a post above joint 2 to the upper arm.

    The length of the unstretched spring is four fifths of that at which post and lug are closest.

    size : largest torque of the spring on joint 2 at any angle, divided by the rated torque
    lean : angle of the post from the vertical [rad]
    post : distance of the post from joint 2, divided by that of the spring's lug on the arm; above
        1, so that the spring never folds
    """
    shoulder, arm = plant.centres[1], plant.centres[2] - plant.centres[1]
    lever = 0.2 * float(np.linalg.norm(arm))
    back = np.cross(plant.axes[1], [0.0, 0.0, 1.0])
    anchor = shoulder + post * lever * (np.cos(lean) * np.array([0, 0, 1.0]) + np.sin(lean) * back)
    mechanism = mark(mechanism, plant, 1, "post", anchor)
    mechanism = mark(mechanism, plant, 2, "lug", shoulder + 0.2 * arm)
    rest = 0.8 * (post - 1) * lever
    angle = np.linspace(0, np.pi, 181)
    length = lever * np.sqrt(1 + post**2 - 2 * post * np.cos(angle))
    # The spring's largest torque over all angles, divided by its stiffness [m^2].
    peak = float(np.max(post * lever**2 * np.sin(angle) * (1 - rest / length)))
    stiffness = size * rated_torque(plant)[1] / peak
    return replace(mechanism, cords=(*mechanism.cords, Cord("balancer", "post", "lug", stiffness, (0.0, rest))))


@acts("built")
def hose_pull(mechanism: Mechanism, plant: Plant, *, size: float) -> Mechanism:
    """Return the mechanism with a hose from the forearm to the tool; not a listed effect.

    The hose pulls where its length exceeds 85 % of about that at zero readings.

    size : deflection of joint 5, about, where it is stretched by a third of that length [rad]
    """
    wrist, end = plant.centres[4], plant.at_home(plant.n, plant.reflector)
    forearm = plant.centres[2] - wrist
    clip = wrist + 0.3 * forearm + 0.15 * float(np.linalg.norm(forearm)) * plant.axes[2]
    mechanism = mark(mechanism, plant, 3, "clip", clip)
    tool = mechanism.body("tool")
    mechanism = mechanism.with_body(replace(tool, marks={**tool.marks, "hose_end": 1.1 * plant.reflector}))
    usual, lever = float(np.linalg.norm(end - clip)), float(np.linalg.norm(end - wrist))
    stiffness = size * plant.stiffness[4] / (lever * usual / 3)
    hose = Cord("hose", "clip", "hose_end", stiffness, (0.0, 0.85 * usual))
    return replace(mechanism, cords=(*mechanism.cords, hose))


@acts("built")
def tight_cable(mechanism: Mechanism, plant: Plant, *, joint: int, size: float, free: float) -> Mechanism:
    """Return the mechanism with a cable package that is too short for its joint; not listed.

    It tightens towards both ends of the joint's range.

    joint : number of the joint, from 1
    size : deflection of the joint's spring at either end of the range [rad]
    free : part of the range in which the cable is slack, 0 to 1
    """
    half = float(np.ptp(plant.ranges[joint - 1])) / 2
    k = size * float(plant.stiffness[joint - 1]) / ((1 - free) * half)
    cable = Shaft(f"cable{joint}", {f"joint{joint}": 1.0}, k, slack=free * half)
    return replace(mechanism, shafts=(*mechanism.shafts, cable))


@acts("motors")
def rubber_coupling(plant: Plant, stops: Stops, *, joint: int, size: float, lag_minutes: float) -> Array:
    """Return the joint error of a creeping rubber coupling at each of n stops, shape (n,) [rad].

    It is the true angle less the reading. The coupling creeps under load, so that the error depends
    on the loads of the previous poses. The robot starts unloaded, and waits at each pose until it
    is measured. The effect is not on the diagnosis' list.

    joint : number of the joint, from 1
    size : final deflection under the rated torque, beyond that of the joint's own spring [rad]
    lag_minutes : time constant of the creep [min]
    """
    j = joint - 1
    end = size * settle(plant, stops).load[:, j] / rated_torque(plant)[j]
    share = -np.expm1(-np.diff(stops.time_s, prepend=0.0) / 60 / lag_minutes)
    crept, given = 0.0, np.empty(len(stops))
    for k in range(len(stops)):
        crept += (end[k] - crept) * share[k]
        given[k] = crept
    return given


def mark(mechanism: Mechanism, plant: Plant, link: int, name: str, home: Array) -> Mechanism:
    """Return the mechanism with a named point added to a link.

    link : number of the link, from 1; name : name of the point
    home : the point in the base frame at zero readings, shape (3,) [m]
    """
    body, frame = mechanism.body(f"link{link}"), plant.home[link - 1]
    there = frame[:3, :3].T @ (np.asarray(home) - frame[:3, 3])
    return mechanism.with_body(replace(body, marks={**body.marks, name: there}))


@acts("settings")
def frame_drift(
    plant: Plant, stops: Stops, *, shift_m: Vector, turn_rad: Vector, settling_minutes: float
) -> list[Setting]:
    """Return the settings, at each stop, of a tracker whose stand creeps and turns, fast at first.

    shift_m : displacement in one hour in the measuring frame, shape (3,) [m]
    turn_rad : rotation vector in one hour in the measuring frame, shape (3,) [rad]
    settling_minutes : time constant of both [min]
    """
    crept = np.expm1(-stops.time_s / 60 / settling_minutes) / np.expm1(-60 / settling_minutes)
    shift, turn = np.outer(crept, shift_m), np.outer(crept, turn_rad)
    return [Setting("shift", "tracker", shift), Setting("turn", "tracker", turn)]


@acts("settings")
def target_shift(plant: Plant, stops: Stops, *, shift_m: Vector, at_s: float) -> list[Setting]:
    """Return the settings, at each stop, of a reflector that moves in its nest at one time.

    shift_m : displacement in the last link's frame, shape (3,) [m]
    at_s : time of the displacement [s]
    """
    return [Setting("mark", "reflector", np.outer(stops.time_s >= at_s, shift_m))]


@acts("measured")
def outliers(xyz: Array, stops: Stops, rng: np.random.Generator, *, share: float, size: float) -> Array:
    """Return measured positions some of which are displaced at random, shape (n, 3) [m].

    The distances are Pareto distributed from half of `size` on, in random directions.

    xyz : positions, shape (n, 3) [m]
    share : probability that a point is displaced; size : median distance, about [m]
    """
    direction = rng.standard_normal(xyz.shape)
    length = size * (0.5 + rng.pareto(2.0, len(xyz)))
    length /= np.linalg.norm(direction, axis=-1)
    hit = rng.random(len(xyz)) < share
    return xyz + np.where(hit, length, 0.0)[:, None] * direction


@acts("settings")
def range_offset(plant: Plant, stops: Stops, *, size: float, stand_m: Vector) -> list[Setting]:
    """Return the settings of a tracker that measures every distance too long; not listed.

    size : range offset [m]; below zero: distances are too short
    stand_m : position of the tracker in the measuring frame, shape (3,) [m]
    """
    sight = reflector(settle(plant, stops)) - np.array(stand_m)
    away = sight / np.linalg.norm(sight, axis=1, keepdims=True)
    return [Setting("shift", "tracker", -size * away)]
