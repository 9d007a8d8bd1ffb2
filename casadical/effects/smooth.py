"""What is on no list: smooth errors of all joints in one joint, in two, in time; of the point in the measuring frame.

Each is a Gaussian process written as harmonics whose size falls with their order, so that it is an effect like any
other and its marginal likelihood competes with those of named causes on equal terms.
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

SIZE = 30e-6
SIZE_LENGTH = 30e-6


@dataclass(frozen=True)
class _Smooth(Effect):
    on_list = "unknown"
    # Its label, with the places of settings in it.
    words: ClassVar[str] = ""

    @property
    def label(self) -> str:
        return self.words.format(**vars(self))

    def _harmonics(self, context: Context, q: Symbolic) -> Symbolic:
        """Sum of the parameters s1, c1, s2 .. times sine and cosine of the multiples of an angle."""
        waves = {"s": ca.sin, "c": ca.cos}
        return sum(self.value(context, n) * waves[n[0]](int(n[1:]) * q) for n in self.sizes())


@dataclass(frozen=True)
class _Series(_Smooth):
    """Errors of all joint variables as a series; `terms` gives its functions and their share of the size."""

    moved: int = 6

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(None, arm.n),)

    def terms(self, context: Context | None) -> list[tuple[str, float, Symbolic]]:
        raise NotImplementedError

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        names = [(n, s) for n, s, _ in self.terms(None)]
        return {f"q{i}_{n}": (SIZE * s, "rad") for i in range(1, self.moved + 1) for n, s in names}

    def joint_angle(self, context: Context) -> Symbolic:
        terms = self.terms(context)
        return ca.vertcat(
            *(sum(self.value(context, f"q{i}_{n}") * f for n, _, f in terms) for i in range(1, self.moved + 1))
        )


@dataclass(frozen=True)
class SmoothInJoint(_Series):
    """A smooth function of joint `driver`."""

    driver: int = setting(1, joint=True)

    name = "unknown_in_joint"
    words = "smooth in q{driver}"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(None, arm.n, i) for i in arm.numbers)

    def terms(self, context: Context | None) -> list[tuple[str, float, Symbolic]]:
        q = context.q[self.driver - 1] if context else 0.0
        return [(f"{name}{h}", 1 / h, f(h * q)) for h in (1, 2, 3, 4) for name, f in (("s", ca.sin), ("c", ca.cos))]


@dataclass(frozen=True)
class AnyOfOwnAngle(_Smooth):
    """An error of one joint that is any function of its own angle, as a damaged tooth or a stained disc gives."""

    orders: int = 12

    name = "unknown_of_own_angle"
    acts_at = "turning joints"
    words = "any function of q{joint} in joint {joint}"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {f"{n}{h}": (SIZE, "rad") for h in range(1, self.orders + 1) for n in "sc"}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return self._harmonics(context, q)


@dataclass(frozen=True)
class AnyOfOtherAngle(_Smooth):
    """An error of one joint that is any function of another joint's angle, as a belt, a cable or a hose gives."""

    driver: int = setting(1, joint=True)
    orders: int = 4

    name = "unknown_of_other_angle"
    words = "any function of q{driver} in joint {joint}"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(j, i) for j in arm.numbers for i in arm.revolute if i != j)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {f"{n}{h}": (2 * SIZE / h, "rad") for h in range(1, self.orders + 1) for n in "sc"}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        return self._harmonics(context, context.q[self.driver - 1])


@dataclass(frozen=True)
class SmoothInJoints(_Series):
    """A smooth function of two joints together."""

    first: int = setting(1, joint=True)
    second: int = setting(2, joint=True)

    name = "unknown_in_joints"
    words = "smooth in q{first} and q{second}"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(None, arm.n, i, j) for i, j in combinations(arm.numbers, 2))

    def terms(self, context: Context | None) -> list[tuple[str, float, Symbolic]]:
        a, b = (context.q[self.first - 1], context.q[self.second - 1]) if context else (0.0, 0.0)
        parts = (("s", ca.sin), ("c", ca.cos))
        return [(f"{m}{n}", 1.0, f(a) * g(b)) for m, f in parts for n, g in parts]


@dataclass(frozen=True)
class SmoothInTime(_Series):
    """A smooth function of time, of the joints, the measuring frame and the tool."""

    name = "unknown_in_time"
    words = "smooth in time"
    needs = ("progress",)

    def terms(self, context: Context | None) -> list[tuple[str, float, Symbolic]]:
        t = context.conditions["progress"] if context else 0.0
        return [(f"t{h}", 1 / h, ca.cos(ca.pi * h * t)) for h in (1, 2, 3, 4, 5, 6)]

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        points = {
            f"{w}{c}_{n}": (SIZE_LENGTH * s, "m") for w in ("m", "e") for c in "xyz" for n, s, _ in self.terms(None)
        }
        return {**super().sizes(), **points}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        return point + self._moved(context, "m")

    def tool(self, context: Context) -> Symbolic:
        T = ca.SX.eye(4)
        T[:3, 3] = self._moved(context, "e")
        return T

    def _moved(self, context: Context, what: str) -> Symbolic:
        terms = self.terms(context)
        return ca.vertcat(*(sum(self.value(context, f"{what}{c}_{n}") * f for n, _, f in terms) for c in "xyz"))


@dataclass(frozen=True)
class WarmUp(_Smooth):
    """The arm warms up exponentially, though nobody measured it: zeros drift and links grow.

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
        return (cls(None, arm.n, s) for s in (0.1, 0.3, 1.0))

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {f"q{i}": (SIZE, "rad") for i in range(1, self.moved + 1)} | {"growth": (8e-5, "m/m")}

    def _warmth(self, context: Context) -> Symbolic:
        return 1 - ca.exp(-context.conditions["progress"] / self.settles)

    def joint_angle(self, context: Context) -> Symbolic:
        return self._warmth(context) * ca.vertcat(*(self.value(context, f"q{i}") for i in range(1, self.moved + 1)))

    def link(self, number: int, context: Context) -> Symbolic:
        return grown_link(number, context, self.value(context, "growth") * self._warmth(context))


@dataclass(frozen=True)
class SmoothInSpace(_Smooth):
    """A quadratic distortion of the measuring space, as an instrument's scale or refraction error gives."""

    reach: float = 2.0

    name = "unknown_in_space"
    words = "smooth in the measured space"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(None, max(arm.reach, 0.1)),)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        products = [a + b for k, a in enumerate("xyz") for b in "xyz"[k:]]
        return {f"{c}_{p}": (SIZE_LENGTH, "m") for c in "xyz" for p in ("x", "y", "z", *products)}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
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
    """Errors of all joints that follow the direction of gravity in the flange and the approach directions."""

    name = "unknown_in_load"
    words = "smooth in load and approach"

    @property
    def conditions(self) -> tuple[str, ...]:
        return tuple(f"approach{i}" for i in range(1, self.moved + 1))

    def terms(self, context: Context | None) -> list[tuple[str, float, Symbolic]]:
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
