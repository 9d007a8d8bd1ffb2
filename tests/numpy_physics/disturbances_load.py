"""Disturbances by load in the joints: play, friction, hardening, springs, hoses."""

from dataclasses import dataclass

import numpy as np

from casadical.blind_check.mujoco_physics.plant import Array, back, motion, move
from casadical.blind_check.mujoco_physics.stops import only
from numpy_physics.disturbance import Disturbance
from numpy_physics.state import GRAVITY, State


@dataclass(frozen=True)
class Backlash(Disturbance):
    """Play of +-``size`` [rad] between soft flanks, taken up by the torque, or near none by what the approach left.

    ``soft`` is the share of the rated torque that closes the play.
    """

    joint: int
    size: float = 60e-6
    soft: float = 0.05

    def twist(self, state: State) -> Array:
        j = self.joint - 1
        closing = state.load[:, j] / (self.soft * state.rated[j]) - state.stops.approach[:, j]
        return only(self.joint, self.size * np.tanh(closing))


@dataclass(frozen=True)
class FrictionWindup(Disturbance):
    """Coulomb friction keeps the joint wound up by ``size`` [rad] behind its last motion, the more the higher its load.

    ``load_share`` is what the rated torque adds to the friction of the idle joint.
    """

    joint: int
    size: float = 40e-6
    load_share: float = 0.8

    def twist(self, state: State) -> Array:
        j = self.joint - 1
        friction = np.hypot(1.0, self.load_share * state.load[:, j] / state.rated[j])
        return only(self.joint, -self.size * friction * state.stops.approach[:, j])


@dataclass(frozen=True)
class HardeningSpring(Disturbance):
    """A second spring in the joint with torque a x + b x^3, wound by ``size`` [rad] at the rated torque.

    ``linear`` is the share of the rated torque that the linear part carries then: the smaller, the softer at the start.
    """

    joint: int
    size: float = 120e-6
    linear: float = 0.15

    def twist(self, state: State) -> Array:
        j = self.joint - 1
        b = 1 - self.linear
        p, r = self.linear / b, state.load[:, j] / state.rated[j] / b
        stretch = 2 * np.sqrt(p / 3)
        return only(self.joint, self.size * stretch * np.sinh(np.arcsinh(1.5 * r / p * np.sqrt(3 / p)) / 3))


@dataclass(frozen=True)
class SpringBalancer(Disturbance):
    """A spring from a post above joint 2 to the upper arm; it carries up to the share ``size`` of the rated torque."""

    size: float = 0.2
    free_length_m: float = 0.1

    def torque(self, state: State) -> Array:
        plant = state.plant
        shoulder, arm = plant.centres[1], plant.centres[2] - plant.centres[1]
        reach = 0.35 * np.linalg.norm(arm)
        post = move(state.bodies[0], shoulder + np.array([0.0, 0.0, reach]))
        lug = move(state.bodies[1], shoulder + 0.35 * arm)
        pull = post - lug
        length = np.linalg.norm(pull, axis=-1, keepdims=True)
        force = self.size * state.rated[1] / reach**2 * (length - self.free_length_m * reach) * pull / length
        axis, centre = state.axis(2)
        return only(2, np.sum(axis * np.cross(lug - centre, force), -1))


@dataclass(frozen=True)
class HoseDrag(Disturbance):
    """A hose from the forearm to the flange tightens as it is drawn out; on no list.

    ``size`` [rad] is the windup of joint 5 by its usual pull at the reflector's reach.
    """

    size: float = 150e-6

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


@dataclass(frozen=True)
class LooseFlange(Disturbance):
    """The tool flange rocks by up to ``size`` [rad] the way the weight of the payload tips it; on no list."""

    size: float = 60e-6
    soft: float = 0.3

    def outboard(self, link: int, state: State) -> Array | None:
        if link != 6:
            return None
        plant, flange = state.plant, state.plant.home[5, :3, 3]
        G = state.bodies[6]
        _, tip = state.wrench_beyond(6, move(G, flange))
        local = back(G, tip)
        local -= np.outer(local @ plant.axes[5], plant.axes[5])
        full = GRAVITY * max(plant.payload_kg, 1e-9) * max(float(np.linalg.norm(plant.payload_com)), 1e-9)
        size = np.linalg.norm(local, axis=-1, keepdims=True)
        rock = self.size * np.tanh(size / (self.soft * full)) * local / np.maximum(size, 1e-12)
        return motion(rock, np.zeros(3), flange)
