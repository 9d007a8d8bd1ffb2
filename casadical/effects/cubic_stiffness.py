"""A joint's torque is a polynomial of its deflection: linear and cubic (the paper's outlook)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect
from casadical.effects.counterparts import Counterparts


@dataclass(frozen=True)
class CubicStiffness(Effect):
    name = "cubic_stiffness"
    on_list = "standard"
    answers_as = "nonlinear_stiffness"
    signature = "deflection that grows less than the torque (hardening)"
    physics = "tau = k1 d + k3 d^3, solved for d to first order: d = c tau - b (tau / great torque)^3 (paper, 3)."
    confused_with = "nonlinear_stiffness, of which it is one form"
    size = {"bend": (60e-6, "rad")}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return -self.value(context, "bend") * context.load(self.joint) ** 3

    def counterpart(self, found: Counterparts, v: Mapping[str, float]) -> Counterparts:
        """The spring torque k1 d + k3 d^3 that comes nearest to the deflection c tau - b (tau / great)^3."""
        great, load = found.great(self.joint), np.linspace(-1.2, 1.2, 97)
        d = found.drive(self.joint).compliance * great * load - v["bend"] * load**3
        if (np.diff(d) <= 0).any():
            return found.without(self.label, "the deflection would decrease with the load")
        scale = np.array([np.abs(d).max(), np.abs(d).max() ** 3])
        k1, k3 = np.linalg.lstsq(np.column_stack([d, d**3]) / scale, great * load, rcond=None)[0] / scale
        off = 1e6 * float(np.abs(great * load - k1 * d - k3 * d**3).max() / k1)
        spring = f"joint{self.joint}_give with the spring k1 d + k3 d^3"
        found = found.with_drive(self.joint, k1=float(k1), k3=float(k3))
        return found.noted(f"{self.label}: {spring}, within {off:.1f} urad")
