"""The declared masses and mass centres of the links are wrong."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from casadical.core.arm import Arm
from casadical.core.parts import Body
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect
from casadical.effects.counterparts import Counterparts


@dataclass(frozen=True)
class LinkMasses(Effect):
    """share, centre : one sigma of each link's mass as a share of the declared one, and of each coordinate of its mass
    centre [m]; zero for a link without declared mass, and where both are known exactly (see `Arm.body_width`)
    """

    share: tuple[float, ...] = (0.2,) * 6
    centre: tuple[float, ...] = (0.03,) * 6

    name = "link_masses"
    on_list = "standard"
    signature = "torque errors of the links' own weight (masses and mass centres of the robot file)"
    # The widths are what the user says of the declared values, not the size of a usual effect.
    held = 1.0
    physics = (
        "Gravity on the true links differs from that on the declared ones; it acts through the joints' springs. Masses "
        "and mass centres of data sheets and of drawings without cables are off by a tenth and some centimetres."
    )
    confused_with = "nonlinear_stiffness and gravity_compensator; payload_error where the payload never changes"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        width = arm.body_width
        there = [bool(j.body and j.body.mass > 0) for j in arm.joints]
        share = tuple(width.share * yes for yes in there)
        centre = tuple(max(width.centre, _undeclared(arm, i)) * yes for i, yes in enumerate(there))
        compliant = any(j.compliance is not None for j in arm.joints)
        return (cls(None, share, centre),) if compliant and (any(share) or (width.centre and any(centre))) else ()

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        masses = {f"m{i}": (size, "kg/kg") for i, size in enumerate(self.share, 1) if size}
        return masses | {f"{c}{i}": (size, "m") for i, size in enumerate(self.centre, 1) if size for c in "xyz"}

    @property
    def summary(self) -> tuple[tuple[str, str, str], ...]:
        centres = ", ".join(f"{1e3 * size:.0f}" for size in self.centre)
        return (
            ("one sigma of each mass", ", ".join(f"{100 * size:.0f}" for size in self.share), "%"),
            ("of each coordinate of a mass centre", centres, "mm"),
        )

    def energy(self, context: Context) -> Symbolic:
        total: Symbolic = 0.0
        for i, (joint, T) in enumerate(zip(context.arm.joints, context.frames, strict=True), 1):
            if joint.body and (self.share[i - 1] or self.centre[i - 1]):
                more = self.value(context, f"m{i}") if self.share[i - 1] else 0.0
                shift = ca.vertcat(*(self.value(context, f"{c}{i}") for c in "xyz")) if self.centre[i - 1] else 0.0
                first_moment = T[:3, :3] @ (more * ca.DM(joint.body.com) + shift) + more * T[:3, 3]
                total = total - joint.body.mass * ca.dot(context.gravity, first_moment)
        return total

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        """True masses, and the centres whose first moments are those of the effect."""
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
        return replace(simulator, bodies=tuple(bodies)).noted(f"link_masses: {masses} kg, mass centres moved")


def _undeclared(arm: Arm, row: int) -> float:
    """Half of a link's length [m] where its mass centre stands at its frame's origin, as if nobody had declared it."""
    body = arm.joints[row].body
    if body is None or np.any(body.com):
        return 0.0
    if row + 1 == arm.n:
        return 0.5 * float(np.linalg.norm(arm.tool.T[:3, 3]))
    following = arm.joints[row + 1]
    return 0.5 * float(np.hypot(following.a, following.d))
