"""The base of all effects, the seams at which one may enter the model, and what it may look at there.

In the order in which a pose is computed: `energy` (a spring or a mass: it loads the joints), `joint_angle` (added to
the reading), `link` (behind the joint's own motion), `base`, `tool`, `measurement`. An effect overrides the seams it
needs; the defaults leave the model as it is. A file of an effect imports what it needs from here.

What a simulator has in place of joint compliances and effects: springs, play, dry friction, ratios; plain data.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import reduce
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.parameters import Parameter
from casadical.core.parts import Arm, Body
from casadical.core.transforms import Symbolic, apply
from casadical.effects.settings import checked_settings, grid_points, settings_of
from casadical.effects.settings import setting as setting


@dataclass(frozen=True)
class Context:
    """What an effect may look at; every entry but the first is symbolic.

    arm : rows, masses, limits, loops, payload
    torque_scale : shape (n,) [N m or N]: great gravity torques on each joint (see `Robot.torque_scale`)
    q : shape (n,) [rad or m]: joint readings
    conditions : logged columns by name (payload_kg, temperature_degC, progress, approach1, ...)
    values : the value of every parameter of the model, by name [SI]
    frames : T_01..T_0n, the rigid links' frames in the robot's base frame, each (4, 4)
    gravity : shape (3,) [m/s^2]: in the robot's base frame
    torque : shape (n,) [N m or N]: of gravity on the actuated joints; None at the seam `energy`, which makes it

    Examples
    --------
    >>> seen = []
    >>> class Look(casadical.Effect):
    ...     name = "look"
    ...
    ...     def joint_angle(self, context):
    ...         seen.append(context)
    ...         return super().joint_angle(context)
    >>> size = robot.with_effect(Look()).position.n_in()
    >>> context = seen[0]
    >>> context.load(1).shape, context.moment(1).shape, context.greatest(1, 2).shape
    ((1, 1), (3, 1), (1, 1))
    """

    arm: Arm
    torque_scale: Symbolic
    q: Symbolic
    conditions: Mapping[str, Symbolic]
    values: Mapping[str, Symbolic]
    frames: tuple[Symbolic, ...]
    gravity: Symbolic
    torque: Symbolic = None

    def load(self, joint: int | None) -> Symbolic:
        """Gravity torque on a joint (1-based) as a share of its great torques."""
        assert joint is not None
        return self.torque[joint - 1] / self.torque_scale[joint - 1]

    def moment(self, link: int, about: Symbolic = None) -> Symbolic:
        """Moment [N m] of all weight from a link (1-based) on, about its origin; in the base frame, shape (3,).

        about : another point in the base frame, shape (3,) [m]
        """
        origin = self.frames[link - 1][:3, 3] if about is None else about
        joints = self.arm.joints
        loads = [(j.body.mass, apply(T, ca.DM(j.body.com))) for j, T in zip(joints, self.frames, strict=True) if j.body]
        loads = loads[sum(1 for j in joints[: link - 1] if j.body) :]
        if self.arm.payload:
            mass = self.conditions.get("payload_kg", self.arm.payload.mass)
            loads.append((mass, apply(self.frames[-1], ca.DM(self.arm.payload.com))))
        total = ca.SX.zeros(3)
        for mass, centre in loads:
            total = total + ca.cross(centre - origin, mass * self.gravity)
        return total

    def turned(self, joint: int) -> Symbolic:
        """By how much a link turns in its bearing on the one before [rad]: the reading, unless a four-bar drives it."""
        if all(loop.driven != joint for loop in self.arm.loops):
            return self.q[joint - 1]
        row = self.frames[joint - 2][:3, 0].T @ self.frames[joint - 1][:3, :2]
        return ca.atan2(-row[1], row[0])

    @property
    def great_moment(self) -> Symbolic:
        """The greatest of the turning joints' great torques [N m]; of an arm that only slides, of its forces [N]."""
        return self.greatest(1, self.arm.n)

    def greatest(self, first: int, last: int) -> Symbolic:
        """The greatest great torque of the turning joints (1-based) from the first to the last [N m].

        Where none of them turns, of all of them [N]: moments and forces are not compared.
        """
        return reduce(ca.fmax, [self.torque_scale[j - 1] for j in compared(self.arm.revolute, first, last)])


def compared(turning: Collection[int], first: int, last: int) -> Sequence[int]:
    """Joints (1-based) of which one has the greatest torque: those that turn, from the first to the last, if any do."""
    there = range(first, last + 1)
    return [j for j in there if j in turning] or there


# Of a rigid joint [N m/rad or N/m]: 10 kN m turn it by 1e-8 rad.
RIGID = 1e12


@dataclass(frozen=True)
class Drive:
    """What stands between a joint's command and its link.

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
class Balancer:
    """A spring between a link and the one before it.

    joint : 1-based; anchor : in levers; phase : reading at which all lie in line [rad]
    swing : torque of the spring [N m] at its greatest; ahead : by how much its phase is ahead [rad]
    pull : torque of the constant pull [N m], as the effect's preload
    """

    joint: int
    anchor: float
    phase: float
    swing: float
    ahead: float
    pull: float


@dataclass(frozen=True)
class Omission:
    """An effect that has no counterpart, and why; parts : short names of the parameters that have none, empty: all."""

    label: str
    why: str
    parts: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.label}: {self.why}"


@dataclass(frozen=True, eq=False)
class Counterparts:
    """A robot's compliances and effects as a simulator knows them.

    drives : of each joint; torque_scale, mean_load : great torque of each joint [N m or N], mean one as a share of it
    revolute : the joints that turn
    base : stiffness about the base frame's x and y [N m/rad], infinite where it is rigid
    base_below : how far below the base's origin these axes are [m]
    flexures : of a link (1-based), stiffness [N m/rad] about its axes of the whole link as a beam, and whether its
        weight is spread along it
    balancers : springs between a link and the one before it
    bodies : of the links, the true ones; payload : the true one
    payload_factor : its mass as a multiple of the declared one
    written : what became of each effect, in words; left_out : why others have none
    """

    drives: tuple[Drive, ...]
    torque_scale: Array
    mean_load: Array
    revolute: Collection[int]
    bodies: tuple[Body | None, ...] = ()
    payload: Body | None = None
    payload_factor: float = 1.0
    base: tuple[float, float] = (np.inf, np.inf)
    base_below: float = 0.0
    flexures: Mapping[int, tuple[tuple[float, float, float], bool]] = field(default_factory=dict)
    balancers: tuple[Balancer, ...] = ()
    written: tuple[str, ...] = ()
    left_out: tuple[Omission, ...] = ()

    def drive(self, joint: int | None) -> Drive:
        """Of a joint (1-based)."""
        assert joint is not None
        return self.drives[joint - 1]

    def great(self, joint: int | None) -> float:
        """The great torque on a joint (1-based) [N m or N]; of None the greatest moment."""
        return self.greatest(joint or 1, joint or len(self.torque_scale))

    def greatest(self, first: int, last: int) -> float:
        """As `Context.greatest`."""
        return float(max(self.torque_scale[j - 1] for j in compared(self.revolute, first, last)))

    def with_drive(self, effect: Effect, text: str, **change: object) -> Counterparts:
        """With the drive of an effect's joint changed, and a line on it."""
        drives = list(self.drives)
        drives[(effect.joint or 0) - 1] = replace(self.drive(effect.joint), **change)  # type: ignore[arg-type]
        return self.noted(f"{effect.label}: {text}", drives=tuple(drives))

    def with_springs(self, label: str, sizes: Mapping[str, float], link: int, *, spread: bool = False) -> Counterparts:
        """With hinges of the foot (link 0) or of a link; an axis that came out negative stays rigid.

        sizes : turn about each axis under the greatest torque, of a link of the joints at its ends [rad]
        spread : whether a link's own weight is spread along it
        """
        made, great = self, self.greatest(link, link + 1) if link else self.great(None)
        # A great torque that is none: of a robot without masses [N m or N].
        if great < 1e-6:
            return made.without(label, "no weight loads it")
        k = tuple(great / size if size > 0 else np.inf for size in sizes.values())
        wrong = tuple(name for name, size in sizes.items() if size < 0)
        if wrong:
            made = made.without(label, f"{', '.join(wrong)} came out negative: rigid there", wrong)
        if all(np.isinf(k)):
            return made
        stiff = ", ".join(f"{s:.4g}" for s in k)
        if not link:
            return made.noted(f"{label}: hinges of the foot, {stiff} N m/rad", base=k)
        pieces = f"{label}: link {link} in three pieces between hinges, {stiff} N m/rad in all"
        return made.noted(pieces, flexures={**made.flexures, link: (k, spread)})

    def noted(self, text: str, **change: object) -> Counterparts:
        """With what an effect became, and a line on it."""
        return replace(self, written=(*self.written, text), **change)  # type: ignore[arg-type]

    def without(self, label: str, why: str, parts: tuple[str, ...] = ()) -> Counterparts:
        """With an effect that has no counterpart (see `Omission`)."""
        return replace(self, left_out=(*self.left_out, Omission(label, why, parts)))

    def without_sign(self, label: str) -> Counterparts:
        """With the line on an effect whose counterpart would need a negative stiffness."""
        return self.without(label, "no counterpart, for its value or its spring has the wrong sign")


# One sigma, in realistic sizes, of an effect once it is in a model: wide, because a user had a reason to put it there,
# and a robot's own may be many times the usual.
CHOSEN = 8.0


@dataclass(frozen=True)
class Effect:
    """One unmodelled effect. Subclass it, name it, give its parameters, and override the seams it acts at.

    Further fields are settings, in which the effect is not linear (see `setting`).

    joint : number of the joint, 1-based, of effects that belong to a joint

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Slack(casadical.Effect):
    ...     name = "slack"
    ...     physics = "A hose pulls its joint back."
    ...
    ...     def sizes(self):
    ...         return {"spring": (10.0, "N m/rad")}
    ...
    ...     def energy(self, context):
    ...         return 0.5 * self.value(context, "spring") * context.q[self.joint - 1] ** 2
    ...
    ...     def joint_angle(self, context):
    ...         return super().joint_angle(context)  # what `angle` adds to its own joint
    >>> slack = Slack(2)
    >>> slack.label, slack.to_dict(), Slack.from_dict(slack.to_dict()) == slack
    ('slack@2', {'name': 'slack', 'joint': 2}, True)
    >>> [p.name for p in slack.parameters()], slack.own_values({"slack@2.spring": 3.0})
    (['slack@2.spring'], {'spring': 3.0})
    >>> [effect.label for effect in Slack.candidates(robot)], len(list(Slack.variants(robot)))
    (['slack'], 1)
    >>> slack.refuse_joints(robot)  # the arm has a joint 2
    >>> slack.for_poses(100) is slack, slack.with_sizes({}) is slack
    (True, True)
    >>> hosed = robot.with_effect(slack).with_values({"slack@2.spring": 3.0})
    >>> hosed.position([0.1, 0.2], hosed.parameters.values).shape
    (3, 1)
    >>> slack.angle(None, 0.1), slack.link(1, None).is_eye(), slack.base(None).is_eye(), slack.tool(None).is_eye()
    (0.0, True, True, True)
    >>> slack.measurement("as it is", None)
    'as it is'
    >>> from casadical.effects.base import Counterparts
    >>> slack.counterpart(Counterparts((), np.zeros(2), np.zeros(2), 0.0), {"spring": 3.0}).left_out
    (Omission(label='slack@2', why='no counterpart in MuJoCo', parts=()),)
    """

    joint: int | None = None

    name: ClassVar[str] = "none"
    held: ClassVar[float] = CHOSEN  # one sigma of each parameter once the effect is in a model, in sizes
    on_list: ClassVar[str] = ""  # standard, extended, unknown (names no cause), or only where it is asked for by name
    answers_as: ClassVar[str] = ""  # the effect under whose name it is a candidate and an answer, as one more law
    acts_at: ClassVar[str] = ""  # arm, payload, [turning or rigid] joints; by default joints where it adds an `angle`
    together: ClassVar[bool] = False  # all joints at once are a candidate, too, where a drive's make is the cause
    covers: ClassVar[frozenset[str]] = frozenset()  # effects that it holds: beside it they are no causes of their own
    size: ClassVar[Mapping[str, tuple[float, str]]] = {}  # its parameters, where all settings have the same
    needs: ClassVar[tuple[str, ...]] = ()  # columns that must have been logged
    signature: ClassVar[str] = ""  # what the data show of it (in brackets: mechanical causes that share it)
    physics: ClassVar[str] = ""  # with its source
    confused_with: ClassVar[str] = ""  # what looks alike
    of_measurement: ClassVar[bool] = False  # it acts on what the instrument reports, and leaves the robot as it is
    from_kind: ClassVar[bool] = False  # its columns come from the kind of measurement: nobody can log them
    simulated_first: ClassVar[bool] = False  # its counterpart comes before those of others, which bend around it

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """The effect with its settings on a grid, by default all combinations, wherever it may act (`acts_at`)."""
        place = cls.acts_at or ("arm" if cls.angle is Effect.angle else "joints")
        rigid = [j for j in arm.numbers if not arm.joints[j - 1].compliance]
        every: Mapping[str, Sequence[int | None]] = {
            "arm": (None,),
            "payload": (None,) if arm.payload else (),
            "joints": arm.numbers,
            "turning joints": arm.revolute,
            "rigid joints": rigid,
        }
        return (
            cls(joint, **point)
            for joint in every[place]
            for point in grid_points(cls, arm.near(joint) if joint else ())
        )

    @classmethod
    def variants(cls, arm: Arm) -> Iterable[tuple[Effect, ...]]:
        """The candidates, those together that act together; by default each alone, and all joints' if `together`."""
        alike: dict[str, list[Effect]] = {}
        for effect in cls.candidates(arm):
            yield (effect,)
            alike.setdefault(str(settings_of(effect)), []).append(effect)
        yield from (tuple(each) for each in alike.values() if cls.together and len(each) > 1)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Effect:
        """The effect that `to_dict` wrote, defaults for what is not given. Raises InputError for a faulty setting."""
        return cls(data.get("joint"), **checked_settings(cls, data.get("settings", {})))

    def to_dict(self) -> dict[str, Any]:
        """Name, joint where it has one, and settings where there are any, as plain data."""
        whole = {"name": self.name, "joint": self.joint, "settings": settings_of(self)}
        return {key: value for key, value in whole.items() if value not in (None, {})}

    def refuse_joints(self, arm: Arm) -> None:
        """Raises InputError where the arm does not have its joint, or one that is a setting."""
        for f in fields(self):
            number = getattr(self, f.name)
            if (f.name == "joint" or f.metadata.get("joint")) and number is not None and number not in arm.numbers:
                raise InputError(f"{self.name}: {f.name} = {number}; robot {arm.name!r} has joints 1 to {arm.n}")

    @property
    def label(self) -> str:
        """name, or name@joint."""
        return self.name if self.joint is None else f"{self.name}@{self.joint}"

    @property
    def conditions(self) -> tuple[str, ...]:
        """Columns that the model needs, logged or derived from logged ones (see `derived_columns`)."""
        return self.needs

    @property
    def only_without(self) -> tuple[str, ...]:
        """Columns with which, once they were logged, it is no candidate: what it stands for is known better then."""
        return ()

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Its parameters: name -> (realistic size, one sigma; unit), by default `size`. Zero must mean: no effect."""
        return self.size

    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters, named label.name, without bounds that matter and with a prior that hardly holds them back."""
        return tuple(
            Parameter(f"{self.label}.{name}", self.label, unit, 0.0, size, -1e3 * size, 1e3 * size, self.held * size)
            for name, (size, unit) in self.sizes().items()
        )

    def own_values(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values of its parameters [SI] by their short names, out of those of a model; zero where there is none."""
        return {name: values.get(f"{self.label}.{name}", 0.0) for name in self.sizes()}

    def for_poses(self, count: int) -> Self:
        """The effect as it is judged in a campaign of so many poses."""
        return self

    @property
    def parts(self) -> Mapping[int, Array]:
        """Indices, shape (k,), of the parameters of each part whose prior size is estimated, by part; {} by default."""
        return {}

    def with_sizes(self, factors: Mapping[int, float]) -> Self:
        """The effect with the prior size of each part times a factor; factors : by part."""
        if factors:
            raise NotImplementedError(f"{self.label} has no parts whose size is learnt")
        return self

    @property
    def summary(self) -> tuple[tuple[str, str, str], ...]:
        """What is shown in place of its parameters where these are too many: (name, value, unit); none by default."""
        return ()

    def value(self, context: Context, name: str) -> Symbolic:
        """The symbol of one of its parameters [unit of the parameter]."""
        return context.values[f"{self.label}.{name}"]

    def energy(self, context: Context) -> Symbolic:
        """Potential energy that it adds [J]."""
        return 0.0

    def joint_angle(self, context: Context) -> Symbolic:
        """What it adds to the joint variables, shape (n,) [rad or m]; by default `angle`, at its own joint."""
        moved = ca.SX.zeros(context.arm.n)
        if self.joint is not None:
            moved[self.joint - 1] = self.angle(context, context.q[self.joint - 1])
        return moved

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        """What it adds to its own joint, whose reading is q [rad or m]."""
        return 0.0

    def link(self, number: int, context: Context) -> Symbolic:
        """Transform (4, 4) [m] behind link `number` (1-based), in that link's frame; the identity by default."""
        return ca.SX.eye(4)

    def base(self, context: Context) -> Symbolic:
        """Transform (4, 4) [m] of the robot's foot, in the base frame; the identity by default."""
        return ca.SX.eye(4)

    def tool(self, context: Context) -> Symbolic:
        """Transform (4, 4) [m] in front of the tool, in the flange frame; the identity by default."""
        return ca.SX.eye(4)

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """The measured point, shape (3,) [m], as the instrument reports it."""
        return point

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        """What a simulator has in its place, besides what it has for others; v : its `own_values` [SI]"""
        why = "an effect of the measurement, not of the robot" if self.of_measurement else "no counterpart in MuJoCo"
        return simulator.without(self.label, why)
