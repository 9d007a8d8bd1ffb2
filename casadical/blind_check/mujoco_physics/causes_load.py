"""Hidden causes in the measurement, and those that depend on load in the joints.

A creeping frame, a moved reflector, outliers, offsets; play, friction, springs, cables, rubber.
"""

from dataclasses import replace

import numpy as np

from casadical.blind_check.mujoco_physics.cause import Vector, acts, rated_torque, reflector, settle
from casadical.blind_check.mujoco_physics.equilibrium import Setting
from casadical.blind_check.mujoco_physics.mechanism import Cord, Joint, Mechanism, Shaft
from casadical.blind_check.mujoco_physics.plant import Array, Plant
from casadical.blind_check.mujoco_physics.robot import SPRING_TIME_CONSTANT_S, spring
from casadical.blind_check.mujoco_physics.stops import Stops


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
