"""The error of each revolute joint as a periodic curve of its own angle, for all joints at once."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import Arm
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Counterparts, Effect

# Prior standard deviation of the sine and of the cosine amplitude of each harmonic up to the knee
# of a joint's error curve [rad], until the data give another one.
TYPICAL_HARMONIC_RAD = 60e-6
# Order of the highest harmonic of each joint's curve in campaigns of fewer than 400 poses.
DEFAULT_ORDERS = 60
# Order of the highest harmonic of each joint's curve in campaigns of 400 poses or more.
EXTENDED_ORDERS = 90


@dataclass(frozen=True)
class JointErrorCurve(Effect):
    """A periodic error curve of each revolute joint: a Fourier series in its own angle.

    spread : prior standard deviation of a harmonic's amplitudes up to the knee, of each joint
        [rad]; 0 for a joint without a curve (prismatic)
    orders : order of the highest harmonic
    knee : order above which the prior size of a harmonic is inversely proportional to its order
    """

    spread: tuple[float, ...] = (TYPICAL_HARMONIC_RAD,) * 6
    orders: int = DEFAULT_ORDERS
    # Above this order the prior size of a harmonic is inversely proportional to its order.
    knee: int = 17

    name = "joint_error_curve"
    on_list = "standard"
    signature = "each joint's own error as a periodic curve of its angle (wave generators, gear teeth, encoder discs)"
    prior_sigma = 1.0
    covers = frozenset({"gear_eccentricity", "transmission_ripple", "unknown_of_own_angle"})
    physics = (
        "A strain-wave gear gives lines at multiples of its ratio (Tuttle and Seering 1996; "
        "Ghorbel, Gandhi and Alpeter 2001), an eccentric encoder disc the first order, its "
        "graduation the high ones (Sanchez-Brea and Morlanes 2008)."
    )
    confused_with = (
        "gear_eccentricity and transmission_ripple, which are one or two of its harmonics in one joint; joint_scale "
        "over less than a turn"
    )

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return one candidate, with curves of all revolute joints; none if there are none."""
        return (
            (cls(None, tuple(TYPICAL_HARMONIC_RAD * (j in arm.revolute) for j in arm.numbers)),) if arm.revolute else ()
        )

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return prior standard deviation and unit of every amplitude of every joint.

        s3_q2 is that of the sine of order 3 of joint 2, c3_q2 that of the cosine.
        """
        return {
            f"{wave}{order}_q{joint}": (spread * min(1.0, self.knee / order), "rad")
            for joint, spread in enumerate(self.spread, 1)
            if spread > 0
            for order in range(1, self.orders + 1)
            for wave in "sc"
        }

    def for_poses(self, count: int, distinct: Sequence[int] = ()) -> "JointErrorCurve":
        """Return the effect with `EXTENDED_ORDERS` for `DEFAULT_ORDERS` from 400 poses on.

        A joint with k distinct angles, fewer than half of the poses, has no curve if they do not
        determine all orders, at most (k - 1) / 2: values between the angles would be arbitrary.
        distinct : number of distinct readings of each joint
        """
        # The readings of so many poses determine more harmonics.
        orders = EXTENDED_ORDERS if count >= 400 and self.orders == DEFAULT_ORDERS else self.orders
        few = [2 * k < count and (k - 1) // 2 < orders for k in distinct] or [False] * len(self.spread)
        spread = tuple(0.0 if repeats else s for s, repeats in zip(self.spread, few, strict=True))
        return self if (spread, orders) == (self.spread, self.orders) else replace(self, spread=spread, orders=orders)

    @property
    def parts(self) -> dict[int, Array]:
        """Return the indices in `sizes` of each joint's amplitudes, shape (2 orders,), by joint."""
        joints = [j for j, spread in enumerate(self.spread, 1) if spread > 0]
        return {j: np.arange(2 * self.orders * k, 2 * self.orders * (k + 1)) for k, j in enumerate(joints)}

    @property
    def summary(self) -> tuple[tuple[str, str, str], ...]:
        """Return lines (name, value, unit) of the order and of each joint's prior size [urad].

        Reports show them in place of the parameters.
        """
        sizes = ", ".join(f"{1e6 * spread:.0f}" for spread in self.spread)
        return ("harmonics of each joint", str(self.orders), ""), ("one sigma of each, joint by joint", sizes, "urad")

    def with_sizes(self, factors: Mapping[int, float]) -> "JointErrorCurve":
        """Return the effect with the prior size of each joint's curve multiplied by a factor.

        factors : dimensionless, by joint; 1 for missing ones
        """
        return replace(self, spread=tuple(s * factors.get(j, 1.0) for j, s in enumerate(self.spread, 1)))

    def joint_angle(self, context: Context) -> Symbolic:
        """Return the error of every joint by its curve, shape (n,) [rad]; 0 without a curve."""
        moved = ca.SX.zeros(context.arm.n)
        for joint in self.parts:
            values = [
                [self.value(context, f"{wave}{order}_q{joint}") for order in range(1, self.orders + 1)] for wave in "sc"
            ]
            moved[joint - 1] = series(context.q[joint - 1], *values)
        return moved

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        """Return a simulator's counterparts with an omission of these curves.

        v : values of the amplitudes by short name [rad]; if all are zero, nothing is omitted
        """
        why = "a MuJoCo joint has no error that follows its own angle; add dq of `export c --what curves` to ctrl"
        return simulator.without(self.label, why) if any(v.values()) else simulator.noted(f"{self.label}: zero")


def series(q: Symbolic, sines: Sequence[Symbolic], cosines: Sequence[Symbolic]) -> Symbolic:
    """Return a Fourier series of an angle q [rad] without a constant term.

    sines, cosines : amplitudes of the orders 1, 2, ..., in the unit of the result
    Sine and cosine of multiples of q follow from those of q by addition formulas.
    """
    s1, c1 = ca.sin(q), ca.cos(q)
    s, c, total = s1, c1, ca.SX(0)
    for a, b in zip(sines, cosines, strict=True):
        total += a * s + b * c
        s, c = s * c1 + c * s1, c * c1 - s * s1
    return total
