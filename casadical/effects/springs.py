"""Effects of springs (balancer, hose), wrong link masses, and elastic links and pedestals."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import groupby

import casadi as ca
import numpy as np

from casadical.core.basics import InputError
from casadical.core.parts import Arm, Body
from casadical.core.transforms import Symbolic, apply, small_frame, translate
from casadical.effects.base import Balancer, Context, Counterparts, Effect, setting


@dataclass(frozen=True)
class GravityCompensator(Effect):
    """A balancing spring on the joint that gravity loads most, which the base model omits.

    anchor : distance of the spring's fixed end from the joint, divided by the distance of its end
        on the arm from the joint
    phase : variable plus theta of the joint where the spring is longest, in line with it [rad]
    """

    # The closer to 1, the more sharply the torque changes where the spring is shortest.
    anchor: float = setting(2.0, (1.6, 3.0, 1.15, 1.02))
    # The candidates' phases are in steps of 30 degrees.
    phase: float = setting(0.0, tuple(np.deg2rad(np.arange(0, 360, 30)).tolist()), steps=True, signed=True)

    name = "gravity_compensator"
    on_list = "standard"
    signature = "a smooth torque on the joint that gravity loads most, the shoulder (spring, gas balancer)"
    physics = "A spring across the shoulder pulls it by k a b sin(g) (1 - l0/l(g)) (Klimchik et al. 2013)."
    confused_with = "gear_eccentricity of the same joint, completely, unless payload or spring pressure change"
    # Typical coefficients of the spring's torque, divided by the joint's peak gravity torque.
    size = {"sin": (0.3, ""), "cos": (0.3, ""), "preload": (0.3, "")}

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return the effect at the shoulder, once for each combination of grid settings.

        The shoulder is the revolute joint with the largest peak gravity torque: joint 2 of an arm
        on the floor, joint 1 of one on a wall. An arm without masses has none.
        """
        torque = dict(zip(arm.numbers, getattr(arm, "torque_scale", ()), strict=False))
        shoulder = max((j for j in arm.revolute if torque.get(j, 0.0) > 1e-6), key=torque.__getitem__, default=None)
        return (effect for effect in super().candidates(arm) if effect.joint == shoulder)

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        """Return the deflection of the joint by the spring's torque [rad]; 0 without compliance.

        It can hide the joint's compliance, which counts as 0.3 mrad at peak torque at least.
        q : variable of the joint [rad]
        """
        assert self.joint is not None
        turn = q + context.values[f"theta{self.joint}"] - self.phase
        length = ca.sqrt(1 + self.anchor**2 + 2 * self.anchor * ca.cos(turn)) / self.anchor
        share = self.value(context, "sin") * ca.sin(turn) + self.value(context, "cos") * ca.cos(turn)
        share = share + self.value(context, "preload") * ca.sin(turn) / length
        compliance = context.values.get(f"c{self.joint}")
        peak = context.torque_scale[self.joint - 1]
        return 0.0 if compliance is None else ca.fmax(compliance * peak, 3e-4) * share

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        """Return a simulator's counterparts with a balancing spring.

        v : `sin`, `cos` and `preload`, torques divided by the joint's peak gravity torque
        It is an omission where the joint has no compliance.
        """
        if not self.joint or simulator.drive(self.joint).compliance <= 0:
            return simulator.without_sign(self.label)
        peak = simulator.peak_torque(self.joint)
        swing, ahead = peak * float(np.hypot(v["sin"], v["cos"])), float(np.arctan2(v["cos"], v["sin"]))
        made = Balancer(self.joint, self.anchor, self.phase, swing, ahead, peak * v["preload"])
        text = f"{self.label}: tendon from link to link before, {swing:.4g} N m at its greatest"
        return simulator.noted(text, balancers=(*simulator.balancers, made))


@dataclass(frozen=True)
class HoseDrag(Effect):
    """The pull of a hose or cable, from a clip on the forearm to the load, on the wrist.

    clip : position of the clip along the forearm, 0 at the elbow, 1 at the wrist
    side : distance of the clip from the forearm's line, divided by the forearm's length
    """

    clip: float = setting(0.7, (0.3, 0.6, 0.9))
    side: float = setting(0.1, (0.0, 0.2))

    name = "hose_drag"
    on_list = "extended"
    signature = "a pull at the wrist that grows as a hose or cable is extended"
    physics = "A dress pack is a weak, pretensioned spring from the forearm to the load."
    confused_with = "gear_eccentricity and joint_scale of joint 5; any smooth error of the wrist"
    # Typical parts of the energy at twice the usual length of the hose, divided by the peak gravity
    # torque of the last joint but one.
    size = {"tension": (0.1, ""), "spring": (0.2, "")}

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return `HoseDrag` for each combination of settings; none for less than six joints."""
        return super().candidates(arm) if arm.n >= 6 else ()

    def energy(self, context: Context) -> Symbolic:
        """Return the potential energy [J] of the hose from the clip to the load or last frame."""
        arm, n = context.arm, context.arm.n
        elbow, wrist = context.frames[n - 4], context.frames[n - 3][:3, 3]
        forearm = wrist - elbow[:3, 3]
        sideways = elbow[:3, 2] * self.side * ca.sqrt(ca.sumsqr(forearm))
        clip = elbow[:3, 3] + self.clip * forearm + sideways
        end = arm.payload.com if arm.payload else [0.0, 0.0, 0.0]
        length = ca.sqrt(ca.sumsqr(apply(context.frames[-1], ca.DM(end)) - clip) + 1e-6)
        rows = context.values[f"d{n - 1}"] ** 2 + context.values[f"d{n}"] ** 2 + float(np.dot(end, end))
        usual = ca.sqrt(rows + 1e-3) + (1 - self.clip) * ca.sqrt(ca.sumsqr(forearm))
        drawn = length / usual - 1
        pull = context.torque_scale[n - 2]
        return pull * (self.value(context, "tension") * drawn + self.value(context, "spring") * drawn**2)


@dataclass(frozen=True)
class LinkMasses(Effect):
    """Errors of the declared masses and mass centres of the links.

    share : prior standard deviation of each link's mass, divided by the declared mass
    centre : prior standard deviation of each coordinate of a link's mass centre [m]
    Both are zero for a link without declared mass, and where they are exact (see
    `Arm.body_width`).
    """

    share: tuple[float, ...] = (0.2,) * 6
    centre: tuple[float, ...] = (0.03,) * 6

    name = "link_masses"
    on_list = "standard"
    signature = "gravity torque errors by the robot file's masses and mass centres"
    # The standard deviations are declared by the user and need no wider prior.
    prior_sigma = 1.0
    physics = "Gravity on the true links differs from that on the declared ones and acts through the joints' springs."
    confused_with = "nonlinear_stiffness and gravity_compensator; payload_error where the payload never changes"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return one `LinkMasses` if the arm has elastic joints and uncertain bodies, else none."""
        width = arm.body_width
        there = [bool(j.body and j.body.mass > 0) for j in arm.joints]
        share = tuple(width.mass_share * yes for yes in there)
        centre = tuple(max(width.com, _undeclared(arm, i)) * yes for i, yes in enumerate(there))
        compliant = any(j.compliance is not None for j in arm.joints)
        return (cls(None, share, centre),) if compliant and (any(share) or (width.com and any(centre))) else ()

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return prior sigma and unit of each error of a mass or mass centre, by name.

        m2 is the error of link 2's mass divided by the declared mass; x2, y2, z2 are the error of
        its first moment in its frame, divided by the declared mass [m].
        """
        masses = {f"m{i}": (size, "kg/kg") for i, size in enumerate(self.share, 1) if size}
        return masses | {f"{c}{i}": (size, "m") for i, size in enumerate(self.centre, 1) if size for c in "xyz"}

    @property
    def summary(self) -> tuple[tuple[str, str, str], ...]:
        """Return lines (name, value, unit) of the prior standard deviations, one value a link.

        Reports show them in place of the parameters.
        """
        centres = ", ".join(f"{1e3 * size:.0f}" for size in self.centre)
        return (
            ("one sigma of each mass", ", ".join(f"{100 * size:.0f}" for size in self.share), "%"),
            ("of each coordinate of a mass centre", centres, "mm"),
        )

    def energy(self, context: Context) -> Symbolic:
        """Return the potential energy [J] of true minus declared masses and mass centres."""
        total: Symbolic = 0.0
        for i, (joint, T) in enumerate(zip(context.arm.joints, context.frames, strict=True), 1):
            if joint.body and (self.share[i - 1] or self.centre[i - 1]):
                more = self.value(context, f"m{i}") if self.share[i - 1] else 0.0
                shift = ca.vertcat(*(self.value(context, f"{c}{i}") for c in "xyz")) if self.centre[i - 1] else 0.0
                first_moment = T[:3, :3] @ (more * ca.DM(joint.body.com) + shift) + more * T[:3, 3]
                total = total - joint.body.mass * ca.dot(context.gravity, first_moment)
        return total

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        """Return a simulator's counterparts with the identified masses and mass centres.

        v : values of the parameters by short name (see `sizes`)
        It is an omission where a mass is not positive.
        """
        bodies = list(simulator.bodies)
        for k, body in enumerate(bodies):
            factor = 1 + v.get(f"m{k + 1}", 0.0)
            if body is None or not (self.share[k] or self.centre[k]):
                continue
            if factor <= 0:
                return simulator.without(self.label, f"the mass of link {k + 1} came out negative")
            shift = np.array([v.get(f"{c}{k + 1}", 0.0) for c in "xyz"])
            bodies[k] = Body(body.mass * factor, body.com + shift / factor)
        masses = ", ".join("-" if b is None else f"{b.mass:.4g}" for b in bodies)
        return simulator.noted(f"link_masses: {masses} kg, mass centres moved", bodies=tuple(bodies))


def _undeclared(arm: Arm, row: int) -> float:
    """Return half of a link's length [m] if its mass centre is at its frame's origin, else 0.

    Such a mass centre was probably not declared. 0 without a body. row : index of the link, from 0
    """
    body = arm.joints[row].body
    if body is None or np.any(body.com):
        return 0.0
    if row + 1 == arm.n:
        return 0.5 * float(np.linalg.norm(arm.tool.T[:3, 3]))
    following = arm.joints[row + 1]
    return 0.5 * float(np.hypot(following.a, following.d))


@dataclass(frozen=True)
class BaseCompliance(Effect):
    """Elastic tilt of the pedestal under the overturning moment.

    below : distance of the tilt axes below the base's origin [m]
    """

    below: float = setting(0.0, (0.0, 0.25, 1.0))

    name = "base_compliance"
    on_list = "standard"
    acts_at = "arm"
    signature = "a pedestal that tilts under the overturning moment"
    physics = "Foundation and pedestal are a rotary spring about two horizontal axes: tilt = moment / stiffness."
    confused_with = "axis_wobble of joint 1; link_flexure of the first link"
    size = {"rx": (60e-6, "rad"), "ry": (60e-6, "rad")}

    def base(self, context: Context) -> Symbolic:
        """Return the tilt of the pedestal as a transform (4, 4) [m] in the base frame.

        It is proportional to the moment of the weight of all links and the payload about a point
        `below` the base's origin. Parameters: tilt about x and y under the arm's peak moment.
        """
        moment = context.moment(1, ca.vertcat(0, 0, -self.below)) / context.peak_moment
        rx, ry = (self.value(context, name) * moment[k] for k, name in enumerate(("rx", "ry")))
        return translate(0, 0, -self.below) @ small_frame(0, 0, 0, rx, ry, 0) @ translate(0, 0, self.below)

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        """Return a simulator's counterparts with elastic hinges of the pedestal.

        v : `rx` and `ry`, tilts under the maximum peak gravity torque of the revolute joints [rad]
        """
        return replace(simulator.with_springs(self.label, v, 0), base_below=self.below)


@dataclass(frozen=True)
class LinkFlexure(Effect):
    """Elastic bending and torsion of a link under the weight beyond it.

    Its parameters are the rotations of the link's end about the axes of its frame under a constant
    moment, the larger of the peak gravity torques of the joints at its two ends.
    member : the link (1-based) that bends, not the last one
    spread : whether its own weight is distributed along it rather than at its mass centre
    """

    member: int = setting(2, joint=True)
    spread: bool = setting(False)

    name = "link_flexure"
    on_list = "standard"
    signature = "a link that bends under the weight beyond it"
    physics = (
        "A beam under a moment turns its end by M l / (E I) about each axis (Klimchik, Pashkevich and Chablat 2013)."
    )
    confused_with = "cross_coupling of torques; base_compliance for the first link"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable["LinkFlexure"]:
        """Return `LinkFlexure` for each long link but the last: the sag is cubic in the length.

        If one of these links has a declared mass, each is a candidate twice: with weights at the
        mass centres and with weights distributed along the links (`spread`).
        """
        lengths = np.array([np.hypot(j.a, j.d) for j in arm.joints[1:]])
        # A link of less than 0.3 of the longest one's length sags by less than a thirtieth of it.
        links = (np.flatnonzero(lengths >= 0.3 * lengths.max(initial=0.0)) + 1).tolist()
        bodies = (arm.joints[k - 1].body for k in links)
        heavy = any(body.mass > 0 for body in bodies if body)
        return (cls(None, k, spread) for spread in (False, True)[: 1 + heavy] for k in links)

    @classmethod
    def variants(cls, arm: Arm) -> Iterable[tuple[Effect, ...]]:
        """Yield sets of effects, each compared as one cause: every link alone, then all together.

        This is repeated for each value of `spread`.
        """
        for _, beams in groupby(cls.candidates(arm), key=lambda e: e.spread):
            links = tuple(beams)
            yield from (*((e,) for e in links), links)

    def refuse_joints(self, arm: Arm) -> None:
        """Check that the bending link exists and is not the last one. Raises InputError."""
        super().refuse_joints(arm)
        if self.member == arm.n:
            raise InputError(f"{self.name}: member = {arm.n} is the last link; allowed: links between two joints")

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of the rotation of the link's end about each axis, by name.

        rx2, ry2, rz2 are about the axes of link 2's frame, under a peak moment (see the class).
        """
        return {f"{c}{self.member}": (60e-6, "rad") for c in ("rx", "ry", "rz")}

    def link(self, number: int, context: Context) -> Symbolic:
        """Return slope and sag of the end of link `number` as a transform (4, 4) [m].

        It is in the frame of that link (1-based), and the identity for all links but `member`.
        """
        if number != self.member:
            return ca.SX.eye(4)
        turn = context.frames[number - 1][:3, :3].T
        peak = context.greatest(number, number + 1)
        root, end = (turn @ context.moment(k) / peak for k in (number, number + 1))
        k = ca.vertcat(*(self.value(context, f"{c}{self.member}") for c in ("rx", "ry", "rz")))
        far = turn @ (context.frames[number][:3, 3] - context.frames[number - 1][:3, 3])
        body = context.arm.joints[number - 1].body
        even: Symbolic = ca.SX.zeros(3)
        if self.spread and body:
            weight = body.mass * (turn @ context.gravity) / peak
            root, even = root - ca.cross(ca.DM(body.com), weight), ca.cross(far, weight)
        # Slope and deflection at the end of a beam under a linear moment, and under its distributed
        # weight.
        slope, sag = k * ((root + end) / 2 + even / 6), k * ((2 * root + end) / 6 + even / 8)
        shift = far + ca.cross(sag, far)
        return (
            translate(*ca.vertsplit(shift))
            @ small_frame(0, 0, 0, *ca.vertsplit(slope))
            @ translate(*ca.vertsplit(-far))
        )

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        """Return a simulator's counterparts with elastic hinges in the link.

        v : rotations under the peak moment by short name [rad] (see `sizes`)
        """
        return simulator.with_springs(self.label, v, self.member, spread=self.spread)
