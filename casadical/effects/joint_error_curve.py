"""Each revolute joint's own error as a periodic curve of its own angle, of all joints at once."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import Arm
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Counterparts, Effect

# One sigma of a harmonic of a joint about which nothing is known yet [rad].
USUAL = 60e-6
# Up to this order harmonics are alike in size; beyond it they fall with the order.
KNEE = 17
# Harmonics of each curve; from so many poses on there are enough readings for more.
ORDERS, MANY, DENSE = 60, 400, 90


@dataclass(frozen=True)
class JointErrorCurve(Effect):
    """spread : one sigma of a harmonic up to the knee, of each joint [rad]; 0 for a joint that has no curve (prismatic)
    orders : the highest harmonic of a joint's turn; knee : see above
    """

    spread: tuple[float, ...] = (USUAL,) * 6
    orders: int = ORDERS
    knee: int = KNEE

    name = "joint_error_curve"
    on_list = "standard"
    signature = "each joint's own error as a periodic curve of its angle (wave generators, gear teeth, encoder discs)"
    held = 1.0
    covers = frozenset({"gear_eccentricity", "transmission_ripple", "unknown_of_own_angle"})
    physics = (
        "A joint's encoder and its link differ by a function that repeats every turn. The wave generator and the teeth "
        "of a strain-wave gear give lines at multiples of the ratio (Tuttle and Seering 1996; Ghorbel, Gandhi and "
        "Alpeter 2001), an encoder disc off its centre the first order, its graduation and interpolation the high ones "
        "(Sanchez-Brea and Morlanes 2008). The curve alone does not tell which: a line at a known ratio suggests the "
        "gear, no more."
    )
    confused_with = (
        "gear_eccentricity and transmission_ripple, which are one or two of its harmonics in one joint; joint_scale "
        "over less than a turn"
    )

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(None, tuple(USUAL * (j in arm.revolute) for j in arm.numbers)),) if arm.revolute else ()

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {
            f"{wave}{order}_q{joint}": (spread * min(1.0, self.knee / order), "rad")
            for joint, spread in enumerate(self.spread, 1)
            if spread > 0
            for order in range(1, self.orders + 1)
            for wave in "sc"
        }

    def for_poses(self, count: int) -> "JointErrorCurve":
        return replace(self, orders=DENSE) if count >= MANY and self.orders == ORDERS else self

    @property
    def parts(self) -> dict[int, Array]:
        """Indices, shape (k,), of each joint's parameters among all of the effect's, by joint."""
        joints = [j for j, spread in enumerate(self.spread, 1) if spread > 0]
        return {j: np.arange(2 * self.orders * k, 2 * self.orders * (k + 1)) for k, j in enumerate(joints)}

    @property
    def summary(self) -> tuple[tuple[str, str, str], ...]:
        sizes = ", ".join(f"{1e6 * spread:.0f}" for spread in self.spread)
        return ("harmonics of each joint", str(self.orders), ""), ("one sigma of each, joint by joint", sizes, "urad")

    def with_sizes(self, factors: Mapping[int, float]) -> "JointErrorCurve":
        """The effect with the size of each joint's curve times a factor; factors : by joint."""
        return replace(self, spread=tuple(s * factors.get(j, 1.0) for j, s in enumerate(self.spread, 1)))

    def joint_angle(self, context: Context) -> Symbolic:
        moved = ca.SX.zeros(context.arm.n)
        for joint in self.parts:
            values = [
                [self.value(context, f"{wave}{order}_q{joint}") for order in range(1, self.orders + 1)] for wave in "sc"
            ]
            moved[joint - 1] = series(context.q[joint - 1], *values)
        return moved

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        why = "a MuJoCo joint has no error that follows its own angle; add dq of `export c --what curves` to ctrl"
        return simulator.without(self.label, why) if any(v.values()) else simulator.noted(f"{self.label}: zero")


def series(q: Symbolic, sines: Sequence[Symbolic], cosines: Sequence[Symbolic]) -> Symbolic:
    """Sum of sines and cosines of the multiples 1, 2, ... of an angle, by adding the angle once for each order."""
    s1, c1 = ca.sin(q), ca.cos(q)
    s, c, total = s1, c1, ca.SX(0)
    for a, b in zip(sines, cosines, strict=True):
        total += a * s + b * c
        s, c = s * c1 + c * s1, c * c1 - s * s1
    return total
