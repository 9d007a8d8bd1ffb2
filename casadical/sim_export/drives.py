"""What stands between a joint's command and its link: spring, play, dry friction, ratio; out of compliance and effects.

An effect that MuJoCo has a counterpart of becomes that counterpart; `Counterparts.left_out` names the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects import (
    Backlash,
    BaseCompliance,
    CubicStiffness,
    Effect,
    FrictionWindup,
    JointScale,
    LinkFlexure,
    MissingCompliance,
    NonlinearStiffness,
    PayloadError,
)
from ..robot import Body, Robot
from ..transforms import Array

# Of a joint that does not give way [N m/rad or N/m]: 10 kN m turn it by 1e-8 rad.
RIGID = 1e12


@dataclass(frozen=True)
class Drive:
    """One actuated joint.

    compliance : of its linear spring [rad/(N m)], 0 for none; bend : of a joint that hardens, deflection against torque
        at `torques` (what is not linear, compliance included), empty where it is linear
    ratio : turn of the joint per turn commanded; play : half of it [rad]; play_friction, friction : dry [N m]
    """

    compliance: float = 0.0
    torques: tuple[float, ...] = ()
    bend: tuple[float, ...] = ()
    ratio: float = 1.0
    play: float = 0.0
    play_friction: float = 0.0
    friction: float = 0.0

    @property
    def stiffness(self) -> float:
        """Of the actuator [N m/rad]; a joint that hardens has its spring beside the actuator."""
        return RIGID if self.bend or not self.compliance else 1 / self.compliance

    @property
    def hardening(self) -> tuple[float, float]:
        """k1, k3 of the spring torque k1 d + k3 d^3 that comes nearest to the bend, k3 >= 0."""
        d, tau = np.array(self.bend), np.array(self.torques)
        A = np.column_stack([d, d**3])
        scale = np.linalg.norm(A, axis=0)
        k1, k3 = np.linalg.lstsq(A / scale, tau, rcond=None)[0] / scale
        return (float(k1), float(k3)) if k3 > 0 else (float(d @ tau / (d @ d)), 0.0)


@dataclass(frozen=True)
class Counterparts:
    """A robot's compliances and effects as a simulator knows them.

    drives : of each joint; base : stiffness about the base frame's x and y [N m/rad], infinite where it is rigid
    flexures : of a link (1-based), stiffness [N m/rad] about its axes of the whole link as a beam
    payload : the true one; written : what became of each effect, in words; left_out : why others have none
    """

    drives: tuple[Drive, ...]
    base: tuple[float, float] = (np.inf, np.inf)
    flexures: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
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
        case NonlinearStiffness() | CubicStiffness():
            return _bent(found, effect, v["bend"], great)
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
        case PayloadError() if robot.payload:
            return _payload(found, robot.payload, v)
        case BaseCompliance():
            return _springs(found, effect.label, v, great, 0)
        case LinkFlexure():
            return _springs(found, effect.label, v, great, effect.member)
    return found.without(f"{effect.label}: no counterpart in MuJoCo, or a sign that no spring has")


def _bent(found: Counterparts, effect: Effect, bend: float, great: float) -> Counterparts:
    assert effect.joint is not None
    drive = found.drives[effect.joint - 1]
    load = np.linspace(-1.2, 1.2, 97)
    shape = np.tanh(load / effect.knee) if isinstance(effect, NonlinearStiffness) else -(load**3)
    d = drive.compliance * great * load + bend * shape
    if (np.diff(d) <= 0).any():
        return found.without(f"{effect.label}: the joint would give way the less the more it is loaded")
    made = replace(drive, torques=tuple(great * load), bend=tuple(d))
    k1, k3 = made.hardening
    off = float(np.abs(great * load - k1 * d - k3 * d**3).max() / k1)
    found = found.with_drive(effect.joint, torques=made.torques, bend=made.bend)
    return found.noted(
        f"{effect.label}: joint{effect.joint}_give with the spring k1 d + k3 d^3, within {1e6 * off:.1f} urad"
    )


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
