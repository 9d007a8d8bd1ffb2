"""Hidden causes that depend on load in the joints: play, friction, springs, cables, rubber."""

from dataclasses import replace

import numpy as np

from casadical.blind_check.mujoco_physics.cause import acts, rated_torque, settle
from casadical.blind_check.mujoco_physics.mechanism import Cord, Joint, Mechanism, Shaft
from casadical.blind_check.mujoco_physics.plant import Array, Plant
from casadical.blind_check.mujoco_physics.robot import SETTLING_TIME_S, spring
from casadical.blind_check.mujoco_physics.stops import Stops


@acts("built")
def backlash(mechanism: Mechanism, plant: Plant, *, joint: int, size: float, friction: float) -> Mechanism:
    """Return the mechanism with play of +-``size`` [rad] between a joint's gear and its link.

    The play is a hinge between hard stops. The link's bearing has dry friction: the torque that
    would wind the joint's spring by the share ``friction`` of ``size``. Where the load is less, the
    link lags behind the motion; elsewhere the load takes up the play.
    """
    name, stiffness = f"joint{joint}", float(plant.stiffness[joint - 1])
    k = 0.1 * stiffness
    play = Joint(f"play{joint}", limits=(-size, size), inertia=k * SETTLING_TIME_S**2, damping=k * SETTLING_TIME_S)
    rub = Shaft(f"bearing{joint}", {name: 1.0, play.name: 1.0}, friction=friction * size * stiffness)
    mechanism = mechanism.with_joints(name, mechanism.joint(name), play)
    return replace(mechanism, shafts=(*mechanism.shafts, rub), travels=True)


@acts("built")
def friction_windup(mechanism: Mechanism, plant: Plant, *, joint: int, size: float, load_share: float) -> Mechanism:
    """Return the mechanism with dry friction in a joint.

    The joint's spring stays wound by up to ``size`` [rad] against the last motion. The rated torque
    adds the share ``load_share`` to the friction of the idle joint.
    """
    j, held = joint - 1, mechanism.joint(f"joint{joint}")
    idle = size * float(plant.stiffness[j])
    held = replace(held, friction=idle, rubbing=load_share * idle / float(rated_torque(plant)[j]))
    return replace(mechanism.with_joints(held.name, held), travels=True)


@acts("built")
def nonlinear_stiffness(
    mechanism: Mechanism, plant: Plant, *, joint: int, size: float, knee: float, linear: float
) -> Mechanism:
    """Return the mechanism with a strain-wave gear, which is soft at small torques.

    With ``knee`` > 0 a second spring engages beyond that share of the rated torque; otherwise the
    gear has a flexible wheel in series with the torque a x + b x^3. ``size`` [rad] is its
    deflection at the rated torque beyond that of the joint's own spring; ``linear`` is the share of
    that torque which the flexible wheel carries linearly there.
    """
    name, rated = f"joint{joint}", rated_torque(plant)[joint - 1]
    held = mechanism.joint(name)
    if knee > 0:
        k, at = held.stiffness, knee * rated
        soft = at * k / (size * k + at)
        second = Shaft(f"second{joint}", {name: 1.0}, k - soft, motor=joint, slack=at / soft)
        calm = spring(name, soft, inertia_of=max(3 * soft, k / 16))
        held = replace(held, stiffness=soft, inertia=calm.inertia, damping=calm.damping)
        return replace(mechanism.with_joints(name, held), shafts=(*mechanism.shafts, second))
    a, b = linear * rated / size, (1 - linear) * rated / size**3
    wheel = spring(f"flexible{joint}", a, hardening=b, inertia_of=3 * a)
    return mechanism.with_joints(name, held, wheel)


@acts("built")
def gravity_compensator(mechanism: Mechanism, plant: Plant, *, size: float, lean: float, post: float) -> Mechanism:
    """Return the mechanism with a balancing spring from a post above joint 2 to the upper arm.

    The spring carries up to the share ``size`` of the rated torque. The post stands ``post`` times
    as far from the joint as the spring's lug on the arm, so that the spring never folds, and leans
    by ``lean`` [rad]. The unstretched spring is four fifths as long as where the two pass each
    other.
    """
    shoulder, arm = plant.centres[1], plant.centres[2] - plant.centres[1]
    lever = 0.2 * float(np.linalg.norm(arm))
    back = np.cross(plant.axes[1], [0.0, 0.0, 1.0])
    foot = shoulder + post * lever * (np.cos(lean) * np.array([0, 0, 1.0]) + np.sin(lean) * back)
    mechanism = mark(mechanism, plant, 1, "post", foot)
    mechanism = mark(mechanism, plant, 2, "lug", shoulder + 0.2 * arm)
    rest = 0.8 * (post - 1) * lever
    stiffness = size * rated_torque(plant)[1] / greatest_torque(lever, post, rest)
    return replace(mechanism, cords=(*mechanism.cords, Cord("balancer", "post", "lug", stiffness, (0.0, rest))))


def greatest_torque(lever: float, post: float, rest: float) -> float:
    """Return the greatest torque per stiffness of a balancing spring over all angles [m^2]."""
    angle = np.linspace(0, np.pi, 181)
    length = lever * np.sqrt(1 + post**2 - 2 * post * np.cos(angle))
    return float(np.max(post * lever**2 * np.sin(angle) * (1 - rest / length)))


@acts("built")
def hose_pull(mechanism: Mechanism, plant: Plant, *, size: float) -> Mechanism:
    """Return the mechanism with a hose from the forearm to the tool; not a listed effect.

    The hose is slack at first, and pulls when it is drawn out. ``size`` [rad] is roughly the windup
    of joint 5 when the hose is drawn out by a third of its length.
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

    It tightens towards both ends of the joint's range: ``size`` [rad] is the windup of the joint at
    either end, ``free`` the share of the range in which it is slack.
    """
    half = float(np.ptp(plant.ranges[joint - 1])) / 2
    k = size * float(plant.stiffness[joint - 1]) / ((1 - free) * half)
    cable = Shaft(f"cable{joint}", {f"joint{joint}": 1.0}, k, slack=free * half)
    return replace(mechanism, shafts=(*mechanism.shafts, cable))


@acts("motors")
def rubber_coupling(plant: Plant, stops: Stops, *, joint: int, size: float, lag_minutes: float) -> Array:
    """Return the joint error of a rubber coupling that creeps under load; not listed.

    The error has shape (n,) [rad].

    It depends on the loads of the previous poses. ``size`` [rad] is the final deflection under the
    rated torque, beyond that of the joint's own spring; its time constant is ``lag_minutes``. The
    robot starts unloaded, and waits at each pose until it is measured.
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
    """Return the mechanism with a named point on ``link``.

    home : the point in the base at zero readings, shape (3,) [m]
    """
    body, frame = mechanism.body(f"link{link}"), plant.home[link - 1]
    there = frame[:3, :3].T @ (np.asarray(home) - frame[:3, 3])
    return mechanism.with_body(replace(body, marks={**body.marks, name: there}))
