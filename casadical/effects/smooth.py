"""Unlisted effects: smooth errors in joints, load and time, and of points in the measuring frame.

Each is a Gaussian process written as harmonics whose prior size falls with their order, so that it
is an effect like any other and its marginal likelihood is comparable with those of named causes.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import casadi as ca

from casadical.core.parts import Arm
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect, setting
from casadical.effects.formula_effect import grown_link

# Prior standard deviation of the first term of a smooth joint error.
TYPICAL_ANGLE_RAD = 30e-6
# Prior standard deviation of the first term of a smooth displacement.
TYPICAL_LENGTH_M = 30e-6


@dataclass(frozen=True)
class _Smooth(Effect):
    """Base of effects that name no cause."""

    on_list = "unknown"
    # Template of its label, with settings in braces.
    words: ClassVar[str] = ""

    @property
    def label(self) -> str:
        return self.words.format(**vars(self))

    def _harmonics(self, context: Context, q: Symbolic) -> Symbolic:
        """Return the Fourier series of an angle with the parameters s1, c1, s2 and so on."""
        waves = {"s": ca.sin, "c": ca.cos}
        return sum(self.value(context, n) * waves[n[0]](int(n[1:]) * q) for n in self.sizes())


@dataclass(frozen=True)
class _Series(_Smooth):
    """Errors of all joint variables as a series in the functions that `terms` gives.

    moved : number of joints
    """

    moved: int = 6

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(None, arm.n),)

    def terms(self, context: Context | None) -> list[tuple[str, float, Symbolic]]:
        """Return name, share of the size, and value of each function.

        Without context the values are meaningless; names and shares count.
        """
        raise NotImplementedError

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        names = [(n, s) for n, s, _ in self.terms(None)]
        return {f"q{i}_{n}": (TYPICAL_ANGLE_RAD * s, "rad") for i in range(1, self.moved + 1) for n, s in names}

    def joint_angle(self, context: Context) -> Symbolic:
        """Return the error of every joint by its series, shape (n,) [rad]."""
        terms = self.terms(context)
        return ca.vertcat(
            *(sum(self.value(context, f"q{i}_{n}") * f for n, _, f in terms) for i in range(1, self.moved + 1))
        )


@dataclass(frozen=True)
class SmoothInJoint(_Series):
    """Errors of all joints that are a smooth function of the angle of joint `driver`."""

    driver: int = setting(1, joint=True)

    name = "unknown_in_joint"
    words = "smooth in q{driver}"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return the effect for every joint as the driver."""
        return (cls(None, arm.n, i) for i in arm.numbers)

    def terms(self, context: Context | None) -> list[tuple[str, float, Symbolic]]:
        """Return sines and cosines of the driver's angle up to the fourth harmonic."""
        q = context.q[self.driver - 1] if context else 0.0
        return [(f"{name}{h}", 1 / h, f(h * q)) for h in (1, 2, 3, 4) for name, f in (("s", ca.sin), ("c", ca.cos))]


@dataclass(frozen=True)
class AnyOfOwnAngle(_Smooth):
    """An error of one joint that is any function of its own angle (damaged tooth, stained disc)."""

    orders: int = 12

    name = "unknown_of_own_angle"
    acts_at = "turning joints"
    words = "any function of q{joint} in joint {joint}"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of each harmonic."""
        return {f"{n}{h}": (TYPICAL_ANGLE_RAD, "rad") for h in range(1, self.orders + 1) for n in "sc"}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        """Return the error of its joint [rad], a Fourier series of its own angle q."""
        return self._harmonics(context, q)


@dataclass(frozen=True)
class AnyOfOtherAngle(_Smooth):
    """An error of one joint that is any function of another joint's angle (belt, cable, hose)."""

    driver: int = setting(1, joint=True)
    orders: int = 4

    name = "unknown_of_other_angle"
    words = "any function of q{driver} in joint {joint}"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return the effect for every joint, with every other revolute joint as the driver."""
        return (cls(j, i) for j in arm.numbers for i in arm.revolute if i != j)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of each harmonic."""
        return {f"{n}{h}": (2 * TYPICAL_ANGLE_RAD / h, "rad") for h in range(1, self.orders + 1) for n in "sc"}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        """Return the error of its joint [rad], a Fourier series of the driver's angle."""
        return self._harmonics(context, context.q[self.driver - 1])


@dataclass(frozen=True)
class SmoothInJoints(_Series):
    """Errors of all joints that are a smooth function of the angles of two joints."""

    first: int = setting(1, joint=True)
    second: int = setting(2, joint=True)

    name = "unknown_in_joints"
    words = "smooth in q{first} and q{second}"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return the effect for every pair of joints."""
        return (cls(None, arm.n, i, j) for i, j in combinations(arm.numbers, 2))

    def terms(self, context: Context | None) -> list[tuple[str, float, Symbolic]]:
        """Return the products of sines and cosines of both angles."""
        a, b = (context.q[self.first - 1], context.q[self.second - 1]) if context else (0.0, 0.0)
        parts = (("s", ca.sin), ("c", ca.cos))
        return [(f"{m}{n}", 1.0, f(a) * g(b)) for m, f in parts for n, g in parts]


@dataclass(frozen=True)
class SmoothInTime(_Series):
    """Errors of joints, measuring frame and tool that are smooth functions of time."""

    name = "unknown_in_time"
    words = "smooth in time"
    needs = ("progress",)

    def terms(self, context: Context | None) -> list[tuple[str, float, Symbolic]]:
        """Return cosines of time up to the sixth harmonic."""
        t = context.conditions["progress"] if context else 0.0
        return [(f"t{h}", 1 / h, ca.cos(ca.pi * h * t)) for h in (1, 2, 3, 4, 5, 6)]

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of each term, for joints, measuring frame and tool."""
        points = {
            f"{w}{c}_{n}": (TYPICAL_LENGTH_M * s, "m")
            for w in ("m", "e")
            for c in "xyz"
            for n, s, _ in self.terms(None)
        }
        return {**super().sizes(), **points}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """Return the point (3,) [m] displaced with the measuring frame."""
        return point + self._moved(context, "m")

    def tool(self, context: Context) -> Symbolic:
        """Return the displacement of the tool as a transform (4, 4) [m]."""
        T = ca.SX.eye(4)
        T[:3, 3] = self._moved(context, "e")
        return T

    def _moved(self, context: Context, what: str) -> Symbolic:
        """Return the displacement, shape (3,) [m], of the measuring frame (m) or the tool (e)."""
        terms = self.terms(context)
        return ca.vertcat(*(sum(self.value(context, f"{what}{c}_{n}") * f for n, _, f in terms) for c in "xyz"))


@dataclass(frozen=True)
class WarmUp(_Smooth):
    """Exponential warm-up of an arm without measured temperature: zeros drift and links grow.

    moved : number of joints

    settles : time constant as a share of the campaign
    """

    moved: int = 6
    settles: float = setting(0.3, (0.1, 0.3, 1.0))

    name = "unknown_warm_up"
    words = "a warm-up that was not measured"
    needs = ("progress",)
    only_without = ("temperature_degC",)

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return the effect with several time constants."""
        return (cls(None, arm.n, s) for s in (0.1, 0.3, 1.0))

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of the drift of each zero and of the growth of links."""
        return {f"q{i}": (TYPICAL_ANGLE_RAD, "rad") for i in range(1, self.moved + 1)} | {"growth": (8e-5, "m/m")}

    def _warmth(self, context: Context) -> Symbolic:
        """Return the share of the warm-up that has happened, 0 to 1."""
        return 1 - ca.exp(-context.conditions["progress"] / self.settles)

    def joint_angle(self, context: Context) -> Symbolic:
        """Return the drift of all joint zeros so far, shape (n,) [rad or m]."""
        return self._warmth(context) * ca.vertcat(*(self.value(context, f"q{i}") for i in range(1, self.moved + 1)))

    def link(self, number: int, context: Context) -> Symbolic:
        """Return the growth of a link so far as a transform (4, 4) [m]."""
        return grown_link(number, context, self.value(context, "growth") * self._warmth(context))


@dataclass(frozen=True)
class SmoothInSpace(_Smooth):
    """A quadratic distortion of the measuring space (scale or refraction of an instrument).

    reach : length that scales the coordinates [m]
    """

    reach: float = 2.0

    name = "unknown_in_space"
    words = "smooth in the measured space"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return one candidate, scaled by the reach of the arm."""
        return (cls(None, max(arm.reach, 0.1)),)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of each coefficient of the quadratic polynomials."""
        products = [a + b for k, a in enumerate("xyz") for b in "xyz"[k:]]
        return {f"{c}_{p}": (TYPICAL_LENGTH_M, "m") for c in "xyz" for p in ("x", "y", "z", *products)}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """Return the point (3,) [m] displaced by a quadratic polynomial of itself."""
        x = dict(zip("xyz", ca.vertsplit(point / self.reach), strict=True))
        moved = ca.SX.zeros(3)
        for name in self.sizes():
            axis, product = name.split("_")
            term = self.value(context, name)
            for c in product:
                term = term * x[c]
            moved["xyz".index(axis)] += term
        return point + moved


@dataclass(frozen=True)
class SmoothInLoad(_Series):
    """Errors of all joints that depend on gravity in the flange, loads and approach directions."""

    name = "unknown_in_load"
    words = "smooth in load and approach"

    @property
    def conditions(self) -> tuple[str, ...]:
        """Return the names of the columns of the directions of approach of all joints."""
        return tuple(f"approach{i}" for i in range(1, self.moved + 1))

    def terms(self, context: Context | None) -> list[tuple[str, float, Symbolic]]:
        """Return gravity in the flange frame, saturating loads, and directions of approach."""
        if context is None:
            down, loads, sides = [0.0] * 3, [0.0] * self.moved, [0.0] * self.moved
        else:
            turn = context.frames[-1][:3, :3]
            down = ca.vertsplit(turn.T @ context.gravity / 9.81)
            loads = [ca.tanh(2 * context.load(i)) for i in range(1, self.moved + 1)]
            sides = [context.conditions[c] for c in self.conditions]
        return [
            *((f"g{c}", 1.0, d) for c, d in zip("xyz", down, strict=True)),
            *((f"l{i}", 1.0, load) for i, load in enumerate(loads, 1)),
            *((f"a{i}", 0.7, side) for i, side in enumerate(sides, 1)),
        ]
