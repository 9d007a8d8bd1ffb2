"""The base class of all effects, their insertion points in the model, and their inputs.

The insertion points (seams) in the order in which a pose is computed: `energy` (a spring or a mass,
which loads the joints), `joint_angle` (added to the variable), `link` (behind the joint's own
motion), `base`, `tool`, `measurement`. An effect overrides those it needs; the defaults leave the
model unchanged. A file of an effect imports what it needs from here.

Also the counterparts of joint compliances and effects in a simulator, as plain data: springs, play,
dry friction, ratios.
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
    """Inputs of an effect at one pose; all but `arm` are symbolic.

    arm : structure of the robot: DH rows, masses, limits, loops, payload
    torque_scale : shape (n,) [N m or N]: peak gravity torque of each joint (see
        `Robot.torque_scale`)
    q : shape (n,) [rad or m]: joint variables of the robot's rows, from the readings
    conditions : logged and derived columns by name (payload_kg, progress, approach1, ...)
    values : the value of every parameter of the model, by name [SI]
    frames : T_01..T_0n, the rigid links' frames in the robot's base frame, each (4, 4)
    gravity : shape (3,) [m/s^2]: in the robot's base frame
    torque : shape (n,) [N m or N]: gravity torque on the actuated joints; None in `energy`, from
        which it is derived

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
        """Return the gravity torque on a joint (1-based), divided by its peak gravity torque."""
        assert joint is not None
        return self.torque[joint - 1] / self.torque_scale[joint - 1]

    def moment(self, link: int, about: Symbolic = None) -> Symbolic:
        """Return the moment of the weight of a link (1-based) and all after it, shape (3,) [N m].

        The payload is included. Axes are those of the base frame.
        about : reference point in the base frame, shape (3,) [m]; None: origin of the link's frame
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
        """Return the angle of link `joint` (1-based) relative to the one before it [rad].

        It is the joint's variable, without theta, unless a four-bar drives the joint; then it is
        the row's whole angle between the frames.
        """
        if all(loop.driven != joint for loop in self.arm.loops):
            return self.q[joint - 1]
        row = self.frames[joint - 2][:3, 0].T @ self.frames[joint - 1][:3, :2]
        return ca.atan2(-row[1], row[0])

    @property
    def peak_moment(self) -> Symbolic:
        """Return the maximum over the revolute joints of their peak gravity torques [N m].

        If no joint is revolute, it is the maximum over all joints [N].
        """
        return self.greatest(1, self.arm.n)

    def greatest(self, first: int, last: int) -> Symbolic:
        """Return the maximum peak gravity torque of the revolute joints `first` to `last` [N m].

        Joints are 1-based, `last` included. If none of them is revolute, it is the maximum of all
        of them [N]: moments and forces are never compared with each other.
        """
        return reduce(ca.fmax, [self.torque_scale[j - 1] for j in compared(self.arm.revolute, first, last)])


def compared(turning: Collection[int], first: int, last: int) -> Sequence[int]:
    """Return the revolute joints (1-based) in `first` to `last`, or all of this range if none is.

    The peak gravity torques of the returned joints have one unit and can be compared.
    turning : numbers of the arm's revolute joints
    """
    there = range(first, last + 1)
    return [j for j in there if j in turning] or there


# Stiffness by which a simulator represents a rigid joint [N m/rad or N/m]; at it, 10 kN m deflect
# a joint by 1e-8 rad.
RIGID_STIFFNESS = 1e12


@dataclass(frozen=True)
class Drive:
    """The drive train of a joint in a simulator, between its command and its link.

    compliance : compliance of its linear spring [rad/(N m)], 0 for a rigid joint
    k1, k3 : coefficients of a spring of torque k1 d + k3 d^3 at the deflection d, in place of the
        linear one [N m/rad, N m/rad^3]; 0 for none
    give, give_stiffness : largest deflection to each side [rad] and stiffness [N m/rad] of a second
        spring in series, between stops
    ratio : rotation of the joint per commanded rotation
    play : half of the backlash [rad]; play_friction : dry friction within the backlash [N m]
    friction : dry friction of the joint [N m]
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
        """Return the stiffness of the simulated actuator [N m/rad], 1 / compliance.

        It is `RIGID_STIFFNESS` without compliance, and where the spring k1, k3 is a separate part.
        """
        return RIGID_STIFFNESS if self.k1 or not self.compliance else 1 / self.compliance


@dataclass(frozen=True)
class Balancer:
    """A balancing spring between a link and the one before it.

    joint : number of the joint, 1-based
    anchor : distance of the spring's fixed end from the joint, divided by the distance of its end
        on the arm from the joint
    phase : variable plus theta of the joint where the spring is longest, in line with it [rad]
    swing : amplitude of the sinusoidal part of its torque over the joint angle [N m]
    ahead : phase lead of that part [rad]
    pull : coefficient of the part of its torque by constant tension (`preload` of
        `GravityCompensator`) [N m]
    """

    joint: int
    anchor: float
    phase: float
    swing: float
    ahead: float
    pull: float


@dataclass(frozen=True)
class Omission:
    """An effect, or some of its parameters, without counterpart in a simulator.

    label : label of the effect; why : the reason, in words
    parts : short names of the parameters without counterpart; empty for all
    """

    label: str
    why: str
    parts: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.label}: {self.why}"


@dataclass(frozen=True, eq=False)
class Counterparts:
    """A robot's compliances and effects in the form in which a simulator has them.

    drives : drive train of each joint
    torque_scale : peak gravity torque of each joint, shape (n,) [N m or N]
    mean_load : mean magnitude of each joint's gravity torque, divided by its peak one, shape (n,)
    revolute : numbers of the revolute joints, 1-based
    base : stiffness of the pedestal about the base frame's x and y [N m/rad], infinite where it is
        rigid
    base_below : distance of these axes below the base's origin [m]
    flexures : by link (1-based), stiffness of the whole link as a beam about the x, y and z axes of
        its frame [N m/rad], and whether its weight is distributed along it
    balancers : springs between a link and the one before it
    bodies : identified mass and mass centre of each link, None for a link without mass
    payload : identified payload; payload_factor : its mass divided by the declared one
    written : a sentence on each counterpart; left_out : effects without counterpart
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
        """Return the drive train of a joint (1-based)."""
        assert joint is not None
        return self.drives[joint - 1]

    def peak_torque(self, joint: int | None) -> float:
        """Return the peak gravity torque of a joint (1-based) [N m or N].

        For None it is the maximum over the revolute joints, or over all if none is revolute.
        """
        return self.greatest(joint or 1, joint or len(self.torque_scale))

    def greatest(self, first: int, last: int) -> float:
        """Return the maximum peak gravity torque of the revolute joints `first` to `last` [N m].

        Joints are 1-based, `last` included. If none of them is revolute, all count [N].
        """
        return float(max(self.torque_scale[j - 1] for j in compared(self.revolute, first, last)))

    def with_drive(self, effect: Effect, text: str, **change: object) -> Counterparts:
        """Return the counterparts with changed fields of the drive of an effect's joint.

        text : description of the change, which is appended to `written` behind the effect's label
        change : new values of fields of `Drive`
        """
        drives = list(self.drives)
        drives[(effect.joint or 0) - 1] = replace(self.drive(effect.joint), **change)  # type: ignore[arg-type]
        return self.noted(f"{effect.label}: {text}", drives=tuple(drives))

    def with_springs(self, label: str, sizes: Mapping[str, float], link: int, *, spread: bool = False) -> Counterparts:
        """Return the counterparts with elastic hinges of the pedestal (link 0) or of a link.

        An axis of zero or negative compliance stays rigid; a negative one is added to `left_out`,
        as is the whole effect if the robot has no masses.
        label : label of the effect; link : number of the link, 1-based, 0 for the pedestal
        sizes : rotation [rad] by name of the parameter, about each axis, of the pedestal under the
            maximum peak gravity torque, of a link under that of the joints at its two ends
        spread : whether a link's own weight is distributed along it
        """
        made, peak = self, self.greatest(link, link + 1) if link else self.peak_torque(None)
        # A peak torque this small [N m or N] is that of a robot without masses.
        if peak < 1e-6:
            return made.without(label, "no weight loads it")
        k = tuple(peak / size if size > 0 else np.inf for size in sizes.values())
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
        """Return the counterparts with changed fields, and with `text` appended to `written`."""
        return replace(self, written=(*self.written, text), **change)  # type: ignore[arg-type]

    def without(self, label: str, why: str, parts: tuple[str, ...] = ()) -> Counterparts:
        """Return the counterparts with an `Omission` of these fields appended to `left_out`."""
        return replace(self, left_out=(*self.left_out, Omission(label, why, parts)))

    def without_sign(self, label: str) -> Counterparts:
        """Return the counterparts with an effect appended to `left_out` for its wrong sign."""
        return self.without(label, "no counterpart, for its value or its spring has the wrong sign")


# Prior standard deviation of the parameters of an effect that a robot model includes, divided by
# their typical size. It is wide, because a user had a reason to add the effect, and a robot's own
# value may be many times the typical one.
CAUSE_PRIOR_SIGMA = 8.0


@dataclass(frozen=True)
class Effect:
    """Base of one unmodelled effect: a subclass has a name, parameters and insertion points.

    A subclass overrides the methods of the insertion points (`energy`, `joint_angle`, `link`, ...)
    at which it acts. Additional fields are settings, in which the effect is not linear (see
    `setting`).
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
    # Prior standard deviation of each parameter in a robot model, divided by its typical size.
    prior_sigma: ClassVar[float] = CAUSE_PRIOR_SIGMA
    # List: standard, extended, unknown (no named cause), motion (joint logs); empty: on request.
    on_list: ClassVar[str] = ""
    # Name of the effect of which it is a variant and under whose name it is reported; empty: none.
    answers_as: ClassVar[str] = ""
    # Places of candidates: arm, payload, joints, turning joints (revolute) or rigid joints (without
    # compliance, or of 0); empty: joints if `angle` is overridden, else arm.
    acts_at: ClassVar[str] = ""
    together: ClassVar[bool] = False  # whether the effect in all joints at once is a candidate, too
    # Names of effects that it includes: given it, they are no separate causes.
    covers: ClassVar[frozenset[str]] = frozenset()
    # Typical size (prior standard deviation of a candidate) and its unit, by parameter.
    size: ClassVar[Mapping[str, tuple[float, str]]] = {}
    needs: ClassVar[tuple[str, ...]] = ()  # columns without which it is no candidate
    signature: ClassVar[str] = ""  # how it appears in the data (in brackets: mechanical causes that share it)
    physics: ClassVar[str] = ""  # physical explanation with its source
    confused_with: ClassVar[str] = ""  # causes that are hard to distinguish from it
    of_measurement: ClassVar[bool] = False  # whether instrument or target cause it, not the robot
    from_kind: ClassVar[bool] = False  # whether its columns come from the kind of measurement, not from a log
    simulated_first: ClassVar[bool] = False  # whether its counterpart is made before those of other effects

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return one effect for every place in `arm` (see `acts_at`) and combination of settings.

        The settings are those of the grids that `setting` declares.
        """
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
        """Yield sets of effects, each compared as one cause: first every candidate alone.

        If `together`, the candidates of equal settings at all joints follow as one set.
        """
        by_settings: dict[str, list[Effect]] = {}
        for effect in cls.candidates(arm):
            yield (effect,)
            by_settings.setdefault(str(settings_of(effect)), []).append(effect)
        yield from (tuple(each) for each in by_settings.values() if cls.together and len(each) > 1)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Effect:
        """Return the effect of a table as `to_dict` returns it; settings not given are defaults.

        Raises InputError for an unknown setting or one of the wrong type.
        """
        return cls(data.get("joint"), **checked_settings(cls, data.get("settings", {})))

    def to_dict(self) -> dict[str, Any]:
        """Return a dict of plain data with the keys name, joint and settings.

        joint is missing where it is None, and settings where there are none.
        """
        entries = {"name": self.name, "joint": self.joint, "settings": settings_of(self)}
        return {key: value for key, value in entries.items() if value not in (None, {})}

    def refuse_joints(self, arm: Arm) -> None:
        """Check that the arm has the joints of effect and settings. Raises InputError."""
        for f in fields(self):
            number = getattr(self, f.name)
            if (f.name == "joint" or f.metadata.get("joint")) and number is not None and number not in arm.numbers:
                raise InputError(f"{self.name}: {f.name} = {number}; robot {arm.name!r} has joints 1 to {arm.n}")

    @property
    def label(self) -> str:
        """Return the identifier of the effect: name, or name@joint; #2 follows for a second event."""
        return (self.name if self.joint is None else f"{self.name}@{self.joint}") + self.event_suffix

    @property
    def event_suffix(self) -> str:
        """Return "#2", "#3", ... for a later event of a kind that has a number (`event`), else ""."""
        event = getattr(self, "event", 1)
        return f"#{event}" if event > 1 else ""

    @property
    def conditions(self) -> tuple[str, ...]:
        """Return the names of columns that the model needs, logged or derived from logged ones."""
        return self.needs

    @property
    def only_without(self) -> tuple[str, ...]:
        """Return the names of the columns whose presence makes the effect no candidate.

        Another effect then uses these columns.
        """
        return ()

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size (prior sigma of a candidate) and unit of each parameter, by name.

        The default is `size`. The effect must vanish where all parameters are zero.
        """
        return self.size

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the effect's parameters, named label.name, with nominal value zero.

        Bounds are 1000 typical sizes to each side, prior standard deviations `prior_sigma` typical sizes.
        """
        own = not type(self).__module__.startswith("casadical.")  # of a plug-in or an effect file
        return tuple(
            Parameter(
                f"{self.label}.{name}",
                self.label,
                unit,
                0.0,
                size,
                -1e3 * size,
                1e3 * size,
                self.prior_sigma * size,
                as_declared=own,
            )
            for name, (size, unit) in self.sizes().items()
        )

    def own_values(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the values of the effect's parameters [SI] by short name; 0 for missing ones.

        values : values of a model's parameters by full name, label.name [SI]
        """
        return {name: values.get(f"{self.label}.{name}", 0.0) for name in self.sizes()}

    def for_poses(self, count: int, distinct: Sequence[int] = ()) -> Self:
        """Return the effect in the resolution that `count` poses allow; by default unchanged.

        distinct : number of distinct readings of each joint
        """
        return self

    @property
    def parts(self) -> Mapping[int, Array]:
        """Return groups of parameters whose common prior size is estimated from the data.

        Keys are numbers of joints, values the indices of their parameters in `sizes`, shape (k,).
        The default is no group.
        """
        return {}

    def with_sizes(self, factors: Mapping[int, float]) -> Self:
        """Return the effect with the prior size of each part multiplied by a factor.

        factors : dimensionless, by key of `parts`. The base raises NotImplementedError for any.
        """
        if factors:
            raise NotImplementedError(f"{self.label} has no parts whose size is learnt")
        return self

    @property
    def summary(self) -> tuple[tuple[str, str, str], ...]:
        """Return lines (name, value, unit) that reports show in place of too many parameters.

        By default there are none, and the parameters are shown.
        """
        return ()

    def value(self, context: Context, name: str) -> Symbolic:
        """Return the symbol of a parameter of the effect, by short name [unit of the parameter]."""
        return context.values[f"{self.label}.{name}"]

    def energy(self, context: Context) -> Symbolic:
        """Return the potential energy that the effect adds [J]; by default 0."""
        return 0.0

    def joint_angle(self, context: Context) -> Symbolic:
        """Return what the effect adds to the joint variables, shape (n,) [rad or m].

        The default is `angle` at the effect's own joint and zero at all others.
        """
        moved = ca.SX.zeros(context.arm.n)
        if self.joint is not None:
            moved[self.joint - 1] = self.angle(context, context.q[self.joint - 1])
        return moved

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        """Return what the effect adds to the variable of its own joint, by default 0 [rad or m].

        q : variable of that joint [rad or m]
        """
        return 0.0

    def link(self, number: int, context: Context) -> Symbolic:
        """Return the transform (4, 4) [m] inserted behind link `number`, in that link's frame.

        number : 1-based. The default is the identity.
        """
        return ca.SX.eye(4)

    def base(self, context: Context) -> Symbolic:
        """Return the transform (4, 4) [m] inserted before the first joint, in the base frame.

        The default is the identity.
        """
        return ca.SX.eye(4)

    def tool(self, context: Context) -> Symbolic:
        """Return the transform (4, 4) [m] inserted between flange and tool, in the flange frame.

        The default is the identity.
        """
        return ca.SX.eye(4)

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """Return the point that the instrument reports, shape (3,) [m]; by default `point` itself.

        point : true measured point, shape (3,) [m]; both are in the measuring frame
        """
        return point

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        """Return a simulator's counterparts with that of this effect added.

        v : values of its parameters by short name [SI]. The default adds an `Omission`.
        """
        why = "an effect of the measurement, not of the robot" if self.of_measurement else "no counterpart in MuJoCo"
        return simulator.without(self.label, why)
