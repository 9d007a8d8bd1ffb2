"""Unlisted effects: smooth errors in joints, load and time, and of points in the measuring frame.

Time is the column `progress`: place in the order of measuring, 0 at the first pose, 1 at the last.

Each is a Gaussian process written as harmonics whose prior size falls with their order, so that it
is an effect like any other and its marginal likelihood is comparable with those of named causes.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import casadi as ca

from casadical.core.parts import Arm
from casadical.core.transforms import Symbolic, small_frame, translate
from casadical.effects.base import Context, Effect, setting
from casadical.effects.formula_effect import grown_link

# Typical coefficient of a smooth joint error [rad]; each term of its series has a multiple of it.
TYPICAL_ANGLE_RAD = 30e-6
# Typical coefficient of a smooth displacement [m]; each term of its series has a multiple of it.
TYPICAL_LENGTH_M = 30e-6
# Functions of a series: name, relative prior size, dimensionless value.
Terms = list[tuple[str, float, Symbolic]]


def _harmonics(q: Symbolic, orders: int, size: float = 1.0, falls: int = 0) -> Terms:
    """Return sine and cosine of multiples of an angle q [rad]: s1, c1, s2, ...

    Their relative prior size is `size` divided by the order, to the power `falls`.
    """
    waves = (("s", ca.sin), ("c", ca.cos))
    return [(f"{n}{h}", size / h**falls, f(h * q)) for h in range(1, orders + 1) for n, f in waves]


def _walk(context: Context | None, orders: int, size: float) -> Terms:
    """Return the cosines of order pi t, of relative size `size` / order; t is the progress."""
    t = context.conditions["progress"] if context else 0.0
    return [(f"t{h}", size / h, ca.cos(ca.pi * h * t)) for h in range(1, orders + 1)]


@dataclass(frozen=True)
class _Smooth(Effect):
    """Base of effects that name no cause and model an error as a smooth function."""

    on_list = "unknown"
    # Template of the effect's label, with names of fields in braces.
    words: ClassVar[str] = ""

    @property
    def label(self) -> str:
        return self.words.format(**vars(self))

    def terms(self, context: Context | None) -> Terms:
        """Return (name, relative prior size, dimensionless value) of each function of a series.

        The typical size of a function's coefficient is the relative size multiplied by
        `TYPICAL_ANGLE_RAD` or `TYPICAL_LENGTH_M`. If `context` is None, the values are
        placeholders.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class _Series(_Smooth):
    """Errors of all joint variables as linear combinations of the functions that `terms` returns.

    moved : number of joints
    """

    moved: int = 6

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        return (cls(None, arm.n),)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        names = [(n, s) for n, s, _ in self.terms(None)]
        return {f"q{i}_{n}": (TYPICAL_ANGLE_RAD * s, "rad") for i in range(1, self.moved + 1) for n, s in names}

    def joint_angle(self, context: Context) -> Symbolic:
        """Return the error of every joint variable as a series of `terms`, (n,) [rad or m]."""
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
        """Return one effect for every joint as `driver`."""
        return (cls(None, arm.n, i) for i in arm.numbers)

    def terms(self, context: Context | None) -> Terms:
        """Return (name, 1 / order, value) of sines and cosines of the angle, orders 1 to 4."""
        return _harmonics(context.q[self.driver - 1] if context else 0.0, 4, falls=1)


@dataclass(frozen=True)
class _OfOneJoint(_Smooth):
    """Base of errors of one joint that follow a driver without a form: a series of `terms`."""

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of the coefficient of each function, by name."""
        return {name: (TYPICAL_ANGLE_RAD * share, "rad") for name, share, _ in self.terms(None)}

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        """Return the error of the effect's joint [rad or m]; q : its variable, not used."""
        return sum(self.value(context, name) * value for name, _, value in self.terms(context))


@dataclass(frozen=True)
class AnyOfOwnAngle(_OfOneJoint):
    """An error of one joint that is any function of its own angle (damaged tooth, stained disc).

    orders : highest harmonic of the Fourier series
    """

    orders: int = 12

    name = "unknown_of_own_angle"
    acts_at = "turning joints"
    words = "any function of q{joint} in joint {joint}"

    def terms(self, context: Context | None) -> Terms:
        """Return (name, 1, value) of sine and cosine of each harmonic of the joint's angle."""
        assert self.joint is not None
        return _harmonics(context.q[self.joint - 1] if context else 0.0, self.orders)


@dataclass(frozen=True)
class AnyOfOtherAngle(_OfOneJoint):
    """An error of one joint that is any function of another joint's angle (belt, cable, hose).

    driver : number of the other joint, 1-based; orders : highest harmonic of the Fourier series
    """

    driver: int = setting(1, joint=True)
    orders: int = 4

    name = "unknown_of_other_angle"
    words = "any function of q{driver} in joint {joint}"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return one effect for every joint and every other revolute joint as `driver`."""
        return (cls(j, i) for j in arm.numbers for i in arm.revolute if i != j)

    def terms(self, context: Context | None) -> Terms:
        """Return (name, 2 / order, value) of sine and cosine of the driver's harmonics."""
        return _harmonics(context.q[self.driver - 1] if context else 0.0, self.orders, 2.0, 1)


@dataclass(frozen=True)
class AnyOfTime(_OfOneJoint):
    """An error of one joint that walks at random in time (creep, slips, warmth of its own).

    Its cosines are the Karhunen-Loeve expansion of a Brownian motion whose mean the zero takes up.
    """

    name = "unknown_of_time"
    acts_at = "joints"
    words = "any course in time of joint {joint}"
    needs = ("progress",)

    def terms(self, context: Context | None) -> Terms:
        """Return (name, 3 / order, cosine of order pi t), orders 1 to 8; t is 0 to 1."""
        return _walk(context, 8, 3.0)


@dataclass(frozen=True)
class AnyOfLoad(_OfOneJoint):
    """An error of one joint that is any function of its own load and approach, on either side."""

    name = "unknown_of_load"
    acts_at = "joints"
    words = "any function of load and approach in joint {joint}"

    @property
    def conditions(self) -> tuple[str, ...]:
        """Return the name of the column of the joint's direction of approach, in a tuple."""
        return (f"approach{self.joint}",)

    def terms(self, context: Context | None) -> Terms:
        """Return (name, prior size, value) of load functions, the approach, and their products.

        Of the four functions of load two are odd and saturate, two are even: its smoothed absolute
        value and its square. The linear one is omitted, as the joint's compliance represents it.
        """
        load, side = (context.load(self.joint), context.conditions[self.conditions[0]]) if context else (0.0, 0.0)
        of_load = {"s": ca.tanh(8 * load), "t": ca.tanh(2 * load), "e": ca.sqrt(load**2 + 1e-4), "q": load**2}
        terms = [(name, 1.0, value) for name, value in of_load.items()]
        return [*terms, ("a", 1.0, side), *((f"a{name}", 1.0, side * value) for name, _, value in terms)]


@dataclass(frozen=True)
class AnyOfAngleAndLoad(_OfOneJoint):
    """An error of one joint that follows its own angle with a size that follows its load.

    orders : highest harmonic of the angle
    """

    orders: int = 6

    name = "unknown_of_angle_and_load"
    acts_at = "turning joints"
    words = "any function of q{joint} and load in joint {joint}"

    def terms(self, context: Context | None) -> Terms:
        """Return (name, 1, value) of sine and cosine of each harmonic of the angle times the load."""
        assert self.joint is not None
        load, q = (context.load(self.joint), context.q[self.joint - 1]) if context else (0.0, 0.0)
        return [(name, size, load * value) for name, size, value in _harmonics(q, self.orders)]


@dataclass(frozen=True)
class _OfPlace(_Smooth):
    """Base of displacements and rotations of one place that follow drivers without a form.

    moves : components of the place's displacement (x, y, z) and rotation (rx, ry, rz)
    """

    moves: ClassVar[tuple[str, ...]] = ("x", "y", "z", "rx", "ry", "rz")

    def terms(self, context: Context | None) -> Terms:
        """Return the functions of the drivers, by default those of a random walk in time."""
        return _walk(context, 6, 2.0)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of each coefficient: x_t2 (component, function)."""
        return {
            f"{c}_{n}": (TYPICAL_ANGLE_RAD * s, "rad") if c[0] == "r" else (TYPICAL_LENGTH_M * s, "m")
            for c in self.moves
            for n, s, _ in self.terms(None)
        }

    def moved(self, context: Context) -> list[Symbolic]:
        """Return the six components of the motion at a pose [m, rad]; those without `moves` are 0."""
        terms = self.terms(context)
        every = ("x", "y", "z", "rx", "ry", "rz")
        return [sum(self.value(context, f"{c}_{n}") * f for n, _, f in terms) if c in self.moves else 0 for c in every]


@dataclass(frozen=True)
class FrameInTime(_OfPlace):
    """A measuring frame that walks at random against the robot's base."""

    name = "unknown_of_frame_in_time"
    words = "any course in time of the measuring frame"
    needs = ("progress",)

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """Return the point, shape (3,) [m], displaced by the frame's motion; both are in it."""
        moved = self.moved(context)
        return point + ca.vertcat(*moved[:3]) + ca.cross(ca.vertcat(*moved[3:]), point)


@dataclass(frozen=True)
class ToolInTime(_OfPlace):
    """A target that walks at random against the flange (slips in its nest, creeping glue)."""

    name = "unknown_of_tool_in_time"
    words = "any course in time of the tool"
    needs = ("progress",)
    moves = ("x", "y", "z")

    def tool(self, context: Context) -> Symbolic:
        """Return the displacement of the tool as a translation (4, 4) [m] in the flange frame."""
        return translate(*self.moved(context)[:3])


@dataclass(frozen=True)
class BaseByMoment(_OfPlace):
    """A pedestal that tilts and sinks as any function of the overturning moment, on either side."""

    name = "unknown_of_base_by_moment"
    words = "any function of the overturning moment in the base"
    moves = ("z", "rx", "ry")

    def terms(self, context: Context | None) -> Terms:
        """Return (name, 1, value) of linear, even, mixed and saturating functions of the moment."""
        mx, my = ca.vertsplit(context.moment(1)[:2] / context.peak_moment) if context else (0.0, 0.0)
        one_sided = {"ax": ca.sqrt(mx**2 + 1e-4), "ay": ca.sqrt(my**2 + 1e-4), "xy": mx * my}
        values = {"x": mx, "y": my, **one_sided, "tx": ca.tanh(6 * mx), "ty": ca.tanh(6 * my)}
        return [(name, 1.0, value) for name, value in values.items()]

    def base(self, context: Context) -> Symbolic:
        """Return the motion of the pedestal as a transform (4, 4) [m] in the base frame."""
        return small_frame(*self.moved(context))


@dataclass(frozen=True)
class AxisByAngle(_OfPlace):
    """A joint's axis that tilts and shifts as any function of the joint's angle (a dented raceway)."""

    name = "unknown_of_axis"
    acts_at = "turning joints"
    words = "any motion of the axis of joint {joint} over q{joint}"
    moves = ("x", "y", "rx", "ry")

    def terms(self, context: Context | None) -> Terms:
        """Return (name, 0.8, value) of sine and cosine of the angle's harmonics 1 to 4."""
        return _harmonics(context.turned(self.joint or 0) if context else 0.0, 4, 0.8)

    def link(self, number: int, context: Context) -> Symbolic:
        """Return tilt and shift of the axis as a transform (4, 4) [m] in the link's frame.

        It is the identity where `number`, the link (1-based), is not that of the joint.
        """
        return small_frame(*self.moved(context)) if number == self.joint else ca.SX.eye(4)


@dataclass(frozen=True)
class SmoothInJoints(_Series):
    """Errors of all joints that are a smooth function of the angles of two joints."""

    first: int = setting(1, joint=True)
    second: int = setting(2, joint=True)

    name = "unknown_in_joints"
    words = "smooth in q{first} and q{second}"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return one effect for every pair of joints."""
        return (cls(None, arm.n, i, j) for i, j in combinations(arm.numbers, 2))

    def terms(self, context: Context | None) -> Terms:
        """Return (name, 1, value) of the four products of a sine or cosine of each angle."""
        a, b = (context.q[self.first - 1], context.q[self.second - 1]) if context else (0.0, 0.0)
        parts = (("s", ca.sin), ("c", ca.cos))
        return [(f"{m}{n}", 1.0, f(a) * g(b)) for m, f in parts for n, g in parts]


@dataclass(frozen=True)
class SmoothInTime(_Series):
    """Errors of joints, measuring frame and tool that are smooth functions of time."""

    name = "unknown_in_time"
    words = "smooth in time"
    needs = ("progress",)

    def terms(self, context: Context | None) -> Terms:
        """Return (name, 1 / order, cosine of order pi t), orders 1 to 6; t is the progress."""
        return _walk(context, 6, 1.0)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of each coefficient, of joints, measuring frame and tool.

        Names are q1_t2 (joint, order), mx_t2 (measuring frame, axis), ex_t2 (tool, axis).
        """
        points = {
            f"{w}{c}_{n}": (TYPICAL_LENGTH_M * s, "m")
            for w in ("m", "e")
            for c in "xyz"
            for n, s, _ in self.terms(None)
        }
        return {**super().sizes(), **points}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """Return the point displaced by the motion of the measuring frame, shape (3,) [m].

        point : without the effect, shape (3,) [m]; both are in the measuring frame
        """
        return point + self._moved(context, "m")

    def tool(self, context: Context) -> Symbolic:
        """Return the displacement of the tool as a translation (4, 4) [m] in the flange frame."""
        T = ca.SX.eye(4)
        T[:3, 3] = self._moved(context, "e")
        return T

    def _moved(self, context: Context, what: str) -> Symbolic:
        """Return a displacement, shape (3,) [m], by the series in time."""
        terms = self.terms(context)
        return ca.vertcat(*(sum(self.value(context, f"{what}{c}_{n}") * f for n, _, f in terms) for c in "xyz"))


@dataclass(frozen=True)
class WarmUp(_Smooth):
    """Exponential warm-up of an arm without measured temperature: zeros drift and links grow.

    moved : number of joints; settles : constant of decay in units of `progress`
    """

    moved: int = 6
    settles: float = setting(0.3, (0.1, 0.3, 1.0))

    name = "unknown_warm_up"
    words = "a warm-up that was not measured"
    needs = ("progress",)
    only_without = ("temperature_degC",)

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return `WarmUp` for each of three constants of decay."""
        return (cls(None, arm.n, s) for s in (0.1, 0.3, 1.0))

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of each joint zero's drift (q1, ...) and of the growth.

        Both are final values; the growth is that of every link, divided by its length.
        """
        return {f"q{i}": (TYPICAL_ANGLE_RAD, "rad") for i in range(1, self.moved + 1)} | {"growth": (8e-5, "m/m")}

    def _warmth(self, context: Context) -> Symbolic:
        """Return the warm-up at a pose, divided by the whole one at infinite progress, 0 to 1."""
        return 1 - ca.exp(-context.conditions["progress"] / self.settles)

    def joint_angle(self, context: Context) -> Symbolic:
        """Return the drift of all joint zeros at a pose, shape (n,) [rad or m]."""
        return self._warmth(context) * ca.vertcat(*(self.value(context, f"q{i}") for i in range(1, self.moved + 1)))

    def link(self, number: int, context: Context) -> Symbolic:
        """Return the growth of link `number` (1-based) at a pose as a translation (4, 4) [m].

        It is in the link's frame.
        """
        return grown_link(number, context, self.value(context, "growth") * self._warmth(context))


@dataclass(frozen=True)
class SmoothInSpace(_Smooth):
    """A quadratic distortion of the measuring space (scale or refraction of an instrument).

    reach : length by which the coordinates of points are divided [m]
    """

    reach: float = 2.0

    name = "unknown_in_space"
    words = "smooth in the measured space"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return one candidate, scaled by the reach of the arm, at least 0.1 m."""
        return (cls(None, max(arm.reach, 0.1)),)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of each coefficient of the polynomials, orders 1 and 2.

        x_yz is the coefficient of y z / reach^2 in the displacement along x.
        """
        products = [a + b for k, a in enumerate("xyz") for b in "xyz"[k:]]
        return {f"{c}_{p}": (TYPICAL_LENGTH_M, "m") for c in "xyz" for p in ("x", "y", "z", *products)}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """Return the point, (3,) [m], displaced by quadratic polynomials of coordinates / reach.

        point : without the effect, shape (3,) [m]; both are in the measuring frame
        """
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

    def terms(self, context: Context | None) -> Terms:
        """Return (name, relative prior size, value) of each function of load and approach.

        They are the components of gravity in the flange frame, in units of 9.81 m/s^2, tanh(2 load)
        and the direction of approach, -1 or 1, of every joint. A load is the gravity torque divided
        by its peak.
        """
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
