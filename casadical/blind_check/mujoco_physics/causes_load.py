"""Causes by load in the joints: play, friction, hardening, springs, hoses, cables, rubber."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from casadical.blind_check.mujoco_physics.cause import Cause, JointCause, rated_torque, settle
from casadical.blind_check.mujoco_physics.mechanism import Body, Cord, Joint, Mechanism, Shaft
from casadical.blind_check.mujoco_physics.plant import Array, Plant
from casadical.blind_check.mujoco_physics.robot import SLOW, spring
from casadical.blind_check.mujoco_physics.stops import Stops, only


@dataclass(frozen=True)
class Backlash(JointCause):
    """Play of +-``size`` [rad] between gear and link: a hinge between hard stops.

    The link's bearing rubs a little, with the torque that would wind the joint's spring by the share ``friction`` of
    ``size``: where its load is less, the link is left behind where the motion took it; elsewhere the load takes up the
    play.
    """

    travels: ClassVar[bool] = True

    friction: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        name, stiffness = f"joint{self.joint}", float(plant.stiffness[self.joint - 1])
        k = 0.1 * stiffness
        play = Joint(f"play{self.joint}", limits=(-self.size, self.size), inertia=k * SLOW**2, damping=k * SLOW)
        rub = Shaft(f"bearing{self.joint}", {name: 1.0, play.name: 1.0}, friction=self.friction * self.size * stiffness)
        mechanism = mechanism.with_more(name, after=(play,))
        return replace(mechanism, shafts=(*mechanism.shafts, rub))


@dataclass(frozen=True)
class FrictionWindup(JointCause):
    """Dry friction in the joint: its spring stays wound by up to ``size`` [rad] against the last motion.

    The rated torque adds the share ``load_share`` to the friction of the idle joint.
    """

    travels: ClassVar[bool] = True

    load_share: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        j, held = self.joint - 1, mechanism.joint(f"joint{self.joint}")
        idle = self.size * float(plant.stiffness[j])
        rubbing = self.load_share * idle / float(rated_torque(plant)[j])
        return mechanism.with_joint(replace(held, friction=idle, rubbing=rubbing))


@dataclass(frozen=True)
class NonlinearStiffness(JointCause):
    """A strain-wave gear, soft at small torques: with ``knee`` > 0 a second spring grips beyond that share of the rated
    torque, else the gear has a flexible wheel in series with torque a x + b x^3.

    ``size`` [rad] is what it gives at the rated torque beyond the joint's own spring; ``linear`` the share of that
    torque which the flexible wheel carries linearly there.
    """

    knee: float
    linear: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        name, rated = f"joint{self.joint}", rated_torque(plant)[self.joint - 1]
        held = mechanism.joint(name)
        if self.knee > 0:
            k, at = held.stiffness, self.knee * rated
            soft = at * k / (self.size * k + at)
            second = Shaft(f"second{self.joint}", {name: 1.0}, k - soft, motor=self.joint, slack=at / soft)
            calm = spring(name, soft, inertia_of=max(3 * soft, k / 16))
            mechanism = mechanism.with_joint(replace(held, stiffness=soft, inertia=calm.inertia, damping=calm.damping))
            return replace(mechanism, shafts=(*mechanism.shafts, second))
        a, b = self.linear * rated / self.size, (1 - self.linear) * rated / self.size**3
        wheel = spring(f"flexible{self.joint}", a, hardening=b, inertia_of=3 * a)
        return mechanism.with_more(name, after=(wheel,))


@dataclass(frozen=True)
class GravityCompensator(Cause):
    """A spring from a post above joint 2 to the upper arm; it carries up to the share ``size`` of the rated torque.

    The post stands ``post`` times as far from the joint as the spring's lug on the arm, so that the spring never
    folds; unstretched it is four fifths as long as where the two pass each other.
    """

    size: float
    lean: float
    post: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        shoulder, arm = plant.centres[1], plant.centres[2] - plant.centres[1]
        lever = 0.2 * float(np.linalg.norm(arm))
        axis = plant.axes[1]
        back = np.cross(axis, [0.0, 0.0, 1.0])
        post = self.post * lever * (np.cos(self.lean) * np.array([0, 0, 1.0]) + np.sin(self.lean) * back)
        mechanism = mark(mechanism, plant, 1, "post", shoulder + post)
        mechanism = mark(mechanism, plant, 2, "lug", shoulder + 0.2 * arm)
        rest = 0.8 * (self.post - 1) * lever
        stiffness = self.size * rated_torque(plant)[1] / self.greatest(lever, rest)
        return replace(mechanism, cords=(*mechanism.cords, Cord("balancer", "post", "lug", stiffness, (0.0, rest))))

    def greatest(self, lever: float, rest: float) -> float:
        """Greatest torque per stiffness over all angles between post and lug [m^2]."""
        angle = np.linspace(0, np.pi, 181)
        length = lever * np.sqrt(1 + self.post**2 - 2 * self.post * np.cos(angle))
        return float(np.max(self.post * lever**2 * np.sin(angle) * (1 - rest / length)))


@dataclass(frozen=True)
class HosePull(Cause):
    """A hose from the forearm to the tool, slack at first, pulls when it is drawn out; on no list.

    ``size`` [rad] is about the windup of joint 5 when the hose is drawn out by a third of its length.
    """

    size: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        wrist, end = plant.centres[4], plant.at_home(plant.n, plant.reflector)
        forearm = plant.centres[2] - wrist
        clip = wrist + 0.3 * forearm + 0.15 * float(np.linalg.norm(forearm)) * plant.axes[2]
        mechanism = mark(mechanism, plant, 3, "clip", clip)
        mechanism = mechanism.with_body(
            replace(mechanism.body("tool"), marks={**mechanism.body("tool").marks, "hose_end": 1.1 * plant.reflector})
        )
        usual, lever = float(np.linalg.norm(end - clip)), float(np.linalg.norm(end - wrist))
        stiffness = self.size * plant.stiffness[4] / (lever * usual / 3)
        hose = Cord("hose", "clip", "hose_end", stiffness, (0.0, 0.85 * usual))
        return replace(mechanism, cords=(*mechanism.cords, hose))


@dataclass(frozen=True)
class TightCable(JointCause):
    """A cable package too short for its joint: it tightens towards both ends of the joint's range; on no list.

    ``size`` [rad] is how far it winds the joint at either end, ``free`` the share of the range in which it is slack.
    """

    free: float

    def built(self, mechanism: Mechanism, plant: Plant) -> Mechanism:
        j, half = self.joint - 1, float(np.ptp(plant.ranges[self.joint - 1])) / 2
        k = self.size * float(plant.stiffness[j]) / ((1 - self.free) * half)
        cable = Shaft(f"cable{self.joint}", {f"joint{self.joint}": 1.0}, k, slack=self.free * half)
        return replace(mechanism, shafts=(*mechanism.shafts, cable))


@dataclass(frozen=True)
class RubberCoupling(JointCause):
    """A rubber coupling creeps, depending on the loads of the previous poses; on no list.

    ``size`` [rad] is what it gives under the rated torque in the end, beyond the joint's own spring; it gets there with
    the time constant ``lag_minutes``. The robot starts unloaded, and waits at each pose until it is measured.
    """

    lag_minutes: float

    def motors(self, plant: Plant, stops: Stops) -> Array:
        j = self.joint - 1
        end = self.size * settle(plant, stops).load[:, j] / rated_torque(plant)[j]
        share = -np.expm1(-np.diff(stops.time_s, prepend=0.0) / 60 / self.lag_minutes)
        crept, given = 0.0, np.empty(len(stops))
        for k in range(len(stops)):
            crept += (end[k] - crept) * share[k]
            given[k] = crept
        return only(self.joint, given, plant.n)


def mark(mechanism: Mechanism, plant: Plant, link: int, name: str, home: Array) -> Mechanism:
    """The mechanism with a mark on ``link``, given where it is (3,) [m] in the base at zero readings."""
    body: Body = mechanism.body(f"link{link}")
    frame = plant.home[link - 1]
    return mechanism.with_body(
        replace(body, marks={**body.marks, name: frame[:3, :3].T @ (np.asarray(home) - frame[:3, 3])})
    )
