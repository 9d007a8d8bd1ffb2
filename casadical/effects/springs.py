"""Springs beside those of the joints: a balancer, a hose."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from casadical.core.arm import Arm
from casadical.core.transforms import Symbolic, apply
from casadical.effects.base import Context, Effect, setting
from casadical.effects.counterparts import Balancer, Counterparts

PHASES = tuple(float(p) for p in np.deg2rad(np.arange(0, 360, 30)))


@dataclass(frozen=True)
class GravityCompensator(Effect):
    """An unmodelled balancing spring on joint 2.

    anchor : distance of the spring's fixed end from the joint, as a multiple of its lever on the arm

    phase : reading at which spring, joint and lever lie in line [rad]
    """

    anchor: float = setting(2.0, (1.2, 2.0, 4.0))
    phase: float = setting(0.0, PHASES, steps=True, signed=True)

    name = "gravity_compensator"
    on_list = "standard"
    signature = "a smooth torque on joint 2 (spring, gas balancer)"
    physics = (
        "A spring between base and arm pulls joint 2 by k a b sin(g) (1 - l0/l(g)): without preload a sine, with "
        "preload the sine over the spring's length (Klimchik et al. 2013)."
    )
    confused_with = "gear_eccentricity of joint 2, completely, unless payload or spring pressure change"
    # Shares of the joint's great torque.
    size = {"sin": (0.3, ""), "cos": (0.3, ""), "preload": (0.3, "")}

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (effect for effect in super().candidates(arm) if effect.joint == 2)

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        assert self.joint is not None
        turn = q + context.values[f"theta{self.joint}"] - self.phase
        length = ca.sqrt(1 + self.anchor**2 + 2 * self.anchor * ca.cos(turn)) / self.anchor
        share = self.value(context, "sin") * ca.sin(turn) + self.value(context, "cos") * ca.cos(turn)
        share = share + self.value(context, "preload") * ca.sin(turn) / length
        return context.values.get(f"c{self.joint}", 0.0) * context.torque_scale[self.joint - 1] * share

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        if not self.joint or simulator.drive(self.joint).compliance <= 0:
            return simulator.without_sign(self.label)
        great = simulator.great(self.joint)
        swing, ahead = great * float(np.hypot(v["sin"], v["cos"])), float(np.arctan2(v["cos"], v["sin"]))
        made = Balancer(self.joint, self.anchor, self.phase, swing, ahead, great * v["preload"])
        simulator = replace(simulator, balancers=(*simulator.balancers, made))
        return simulator.noted(f"{self.label}: tendon from link to link before, {swing:.4g} N m at its greatest")


@dataclass(frozen=True)
class HoseDrag(Effect):
    """A hose or cable from the forearm to the tool pulls at the wrist.

    clip : where the hose is held, as a share of the way from the elbow to the wrist

    side : how far beside the forearm, as a share of its length
    """

    clip: float = setting(0.7, (0.3, 0.6, 0.9))
    side: float = setting(0.1, (0.0, 0.2))

    name = "hose_drag"
    on_list = "extended"
    signature = "a pull at the wrist that grows as hose or cable is drawn out"
    physics = (
        "A dress pack is a weak spring with some tension from its clip on the forearm to the load; its pull turns the "
        "wrist joints through their own springs, by the slope of its length."
    )
    confused_with = "gear_eccentricity and joint_scale of joint 5; any smooth error of the wrist"
    # Torque at the last joint but one, as a share of its great torques.
    size = {"tension": (0.1, ""), "spring": (0.2, "")}

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return super().candidates(arm) if arm.n >= 6 else ()

    def energy(self, context: Context) -> Symbolic:
        arm, n = context.arm, context.arm.n
        elbow, wrist = context.frames[n - 4], context.frames[n - 3][:3, 3]
        forearm = wrist - elbow[:3, 3]
        beside = elbow[:3, 2] * self.side * ca.sqrt(ca.sumsqr(forearm))
        clip = elbow[:3, 3] + self.clip * forearm + beside
        end = arm.payload.com if arm.payload else [0.0, 0.0, 0.0]
        length = ca.sqrt(ca.sumsqr(apply(context.frames[-1], ca.DM(end)) - clip) + 1e-6)
        rows = context.values[f"d{n - 1}"] ** 2 + context.values[f"d{n}"] ** 2 + float(np.dot(end, end))
        usual = ca.sqrt(rows + 1e-3) + (1 - self.clip) * ca.sqrt(ca.sumsqr(forearm))
        drawn = length / usual - 1
        pull = context.torque_scale[n - 2]
        return pull * (self.value(context, "tension") * drawn + self.value(context, "spring") * drawn**2)
