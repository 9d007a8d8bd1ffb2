"""What stands between a joint's command and its link: spring, play, dry friction, ratio; out of compliance and effects.

An effect that MuJoCo has a counterpart of becomes that counterpart; `Counterparts.left_out` names the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from casadical.core.arrays import Array
from casadical.effects import (
    Backlash,
    BaseCompliance,
    CubicStiffness,
    Effect,
    FrameDrift,
    FrictionWindup,
    GravityCompensator,
    JointScale,
    LinkFlexure,
    MissingCompliance,
    NonlinearStiffness,
    PayloadError,
    Refraction,
    SmrOffset,
    TargetShift,
    TrackerScale,
)
from casadical.export.mjcf.balancer import Balancer
from casadical.robot.robot import Body, Robot

OF_THE_MEASUREMENT = (FrameDrift, Refraction, SmrOffset, TargetShift, TrackerScale)
HAVE_ONE = (Backlash, FrictionWindup, GravityCompensator, MissingCompliance, NonlinearStiffness)
# tanh(x) is nearest to SLOPE x that stops at STOP, off by OFF at most.
SLOPE, STOP, OFF = 0.76, 0.92, 0.083
# Of a joint that does not give way [N m/rad or N/m]: 10 kN m turn it by 1e-8 rad.
RIGID = 1e12


@dataclass(frozen=True)
class Drive:
    """One actuated joint.

    compliance : of its spring [rad/(N m)], 0 for none
    k1, k3 : of a spring k1 d + k3 d^3 in its place [N m/rad, N m/rad^3]
    give, give_stiffness : half range [rad] and stiffness [N m/rad] of a second spring in series that ends at stops
    ratio : turn of the joint per turn commanded; play : half of it [rad]; play_friction, friction : dry [N m]
    """

    compliance: float = 0.0
    k1: float = 0.0
    k3: float = 0.0
    give: float = 0.0
    give_stiffness: float = 0.0
    ratio: float = 1.0
    play: float = 0.0
    play_friction: float = 0.0
    friction: float = 0.0

    @property
    def stiffness(self) -> float:
        """Of the actuator [N m/rad]; a joint that hardens has its spring beside the actuator."""
        return RIGID if self.k1 or not self.compliance else 1 / self.compliance


@dataclass(frozen=True)
class Counterparts:
    """A robot's compliances and effects as a simulator knows them.

    drives : of each joint; base : stiffness about the base frame's x and y [N m/rad], infinite where it is rigid
    flexures : of a link (1-based), stiffness [N m/rad] about its axes of the whole link as a beam
    balancers : springs between a link and the one before it
    payload : the true one; written : what became of each effect, in words; left_out : why others have none
    """

    drives: tuple[Drive, ...]
    base: tuple[float, float] = (np.inf, np.inf)
    flexures: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
    balancers: tuple[Balancer, ...] = ()
    payload: Body | None = None
    payload_factor: float = 1.0
    written: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    def with_drive(self, joint: int | None, **change: object) -> Counterparts:
        """With one joint's drive changed."""
        assert joint is not None
        drives = list(self.drives)
        drives[joint - 1] = replace(drives[joint - 1], **change)  # type: ignore[arg-type]
        return replace(self, drives=tuple(drives))

    def noted(self, text: str) -> Counterparts:
        return replace(self, written=(*self.written, text))

    def without(self, text: str) -> Counterparts:
        return replace(self, left_out=(*self.left_out, text))


def counterparts(robot: Robot) -> Counterparts:
    """Springs for the compliances, then what each effect has for a counterpart."""
    drives = tuple(Drive(compliance=j.compliance or 0.0) for j in robot.joints)
    found = Counterparts(drives, payload=robot.payload)
    # Linear springs first: others bend around them.
    for effect in sorted(robot.effects, key=lambda e: not isinstance(e, MissingCompliance)):
        found = _added(found, robot, effect)
    return found


def _added(found: Counterparts, robot: Robot, effect: Effect) -> Counterparts:
    v = {name: robot.effect_values.get(f"{effect.label}.{name}", 0.0) for name in effect.sizes()}
    j = effect.joint
    great = float(robot.torque_scale[j - 1]) if j else float(robot.torque_scale.max())
    drive = found.drives[j - 1] if j else Drive()
    match effect:
        case MissingCompliance() if v["deflection"] > 0:
            found = found.with_drive(j, compliance=drive.compliance + v["deflection"] / great)
            return found.noted(f"{effect.label}: spring of joint {j}")
        case NonlinearStiffness() if v["bend"] > 0:
            give, stiffness = STOP * v["bend"], effect.knee * great / (SLOPE * v["bend"])
            found = found.with_drive(j, give=give, give_stiffness=stiffness)
            off = 1e6 * OFF * v["bend"]
            return found.noted(f"{effect.label}: joint{j}_bed, a soft spring between stops, within {off:.1f} urad")
        case CubicStiffness():
            return _hardened(found, effect, v["bend"], great)
        case Backlash() if v["half"] > 0:
            found = found.with_drive(j, play=v["half"], play_friction=effect.friction * great)
            return found.noted(f"{effect.label}: joint{j}_play with limits of +-{1e6 * v['half']:.1f} urad")
        case FrictionWindup() if drive.compliance > 0:
            wound = v["constant"] + v["load"] * _mean_load(robot, effect)
            if wound <= 0:
                return found.without(f"{effect.label}: its friction came out negative")
            found = found.with_drive(j, friction=wound / drive.compliance)
            return found.noted(f"{effect.label}: dry friction of {wound / drive.compliance:.4g} N m, at its mean load")
        case JointScale():
            return found.with_drive(j, ratio=1 + v["k"]).noted(f"{effect.label}: gear of the drive")
        case GravityCompensator() if j and drive.compliance > 0:
            swing, ahead = great * float(np.hypot(v["sin"], v["cos"])), float(np.arctan2(v["cos"], v["sin"]))
            made = Balancer(j, effect.anchor, effect.phase, swing, ahead, great * v["preload"])
            found = replace(found, balancers=(*found.balancers, made))
            return found.noted(f"{effect.label}: tendon from link to link before, {swing:.4g} N m at its greatest")
        case PayloadError() if robot.payload:
            return _payload(found, robot.payload, v)
        case BaseCompliance():
            return _springs(found, effect.label, v, great, 0)
        case LinkFlexure():
            return _springs(found, effect.label, v, great, effect.member)
    if isinstance(effect, OF_THE_MEASUREMENT):
        return found.without(f"{effect.label}: an effect of the measurement, not of the robot")
    if any(isinstance(effect, kind) for kind in HAVE_ONE):
        return found.without(f"{effect.label}: no counterpart, for its value or its spring has the wrong sign")
    return found.without(f"{effect.label}: no counterpart in MuJoCo")


def _hardened(found: Counterparts, effect: Effect, bend: float, great: float) -> Counterparts:
    """The spring torque k1 d + k3 d^3 that comes nearest to the deflection c tau - b (tau / great)^3."""
    drive = found.drives[(effect.joint or 1) - 1]
    load = np.linspace(-1.2, 1.2, 97)
    d = drive.compliance * great * load - bend * load**3
    if (np.diff(d) <= 0).any():
        return found.without(f"{effect.label}: the joint would give way the less the more it is loaded")
    scale = np.array([np.abs(d).max(), np.abs(d).max() ** 3])
    k1, k3 = np.linalg.lstsq(np.column_stack([d, d**3]) / scale, great * load, rcond=None)[0] / scale
    off = 1e6 * float(np.abs(great * load - k1 * d - k3 * d**3).max() / k1)
    found = found.with_drive(effect.joint, k1=float(k1), k3=float(k3))
    return found.noted(f"{effect.label}: joint{effect.joint}_give with the spring k1 d + k3 d^3, within {off:.1f} urad")


def _mean_load(robot: Robot, effect: Effect) -> float:
    """Mean size of the joint's torque over its range, as a share of its great torques."""
    assert effect.joint is not None
    bare = replace(robot, effects=(), effect_values={})
    lower, upper = np.array([(j.lower, j.upper) for j in robot.joints]).T
    q = np.random.default_rng(0).uniform(lower, upper, (256, robot.n))
    tau: Array = bare.torque.map(256)(q.T, bare.parameters.values).full()[effect.joint - 1]
    return float(np.nanmean(np.abs(tau)) / robot.torque_scale[effect.joint - 1])


def _payload(found: Counterparts, declared: Body, v: Mapping[str, float]) -> Counterparts:
    """The true mass, and the centre whose first moment is that of the effect."""
    factor = 1 + v["mass"]
    centre = declared.com + np.array([v[c] for c in "xyz"]) / factor
    found = replace(found, payload=Body(declared.mass * factor, centre), payload_factor=factor)
    return found.noted(
        f"payload_error: {declared.mass * factor:.4g} kg in place of {declared.mass:.4g} kg, centre moved"
    )


def _springs(found: Counterparts, label: str, v: Mapping[str, float], great: float, link: int) -> Counterparts:
    """Hinges of the foot (link 0) or of a link; an axis that came out negative stays rigid."""
    k = tuple(great / size if size > 0 else np.inf for size in v.values())
    wrong = [name for name, size in v.items() if size < 0]
    if wrong:
        found = found.without(f"{label}: {', '.join(wrong)} came out negative: rigid there")
    if all(np.isinf(k)):
        return found
    stiff = ", ".join(f"{s:.4g}" for s in k)
    if not link:
        return replace(found, base=k).noted(f"{label}: hinges of the foot, {stiff} N m/rad")  # type: ignore[arg-type]
    found = replace(found, flexures={**found.flexures, link: k})  # type: ignore[dict-item]
    return found.noted(f"{label}: link {link} in three pieces between hinges, {stiff} N m/rad in all")
