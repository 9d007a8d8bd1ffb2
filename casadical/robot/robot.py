"""The robot as an immutable object, and the knowledge about its values.

A robot has modified DH rows (Craig) with Hayati's beta, loops, bodies, frames and compliances. Row
i places frame i in frame i-1: Rot_x(alpha) Trans_x(a) Rot_y(beta) Trans_y(b) Rot_z(theta + q)
Trans_z(d), or with d + q for a prismatic joint. `beta` exists where neighbouring axes are nearly
parallel (Hayati and Mirmirani 1985), `b` only in the first row, where the six numbers together
place the robot in the measuring frame (paper, Table 1). Knowledge means covariances, the range of
the data, and the remaining errors.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby
from typing import Any, ClassVar, Literal

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.parameters import Parameters
from casadical.core.parts import GRAVITY_COLUMNS, Arm, Joint
from casadical.core.reporting.blocks import Table, Words
from casadical.core.reporting.result import Shown, html
from casadical.core.transforms import frame, from_xyz, to_xyz
from casadical.effects import Effect, JointErrorCurve, Session
from casadical.effects.joint_error_curve import TYPICAL_HARMONIC_RAD
from casadical.robot.model import Model, Structure, constants_of
from casadical.robot.parameter_list import PLACEMENT_PARAMETERS, bar_names, parameters_of

# Maximum number of parameters whose covariance is stored as one block; with more, base model and
# each effect have their own block (in an NPZ file if still larger), uncorrelated with others.
MAX_BLOCK_PARAMETERS = 120


@dataclass(frozen=True, eq=False)
class Covariance:
    """Covariance of some parameters, which are uncorrelated with all others.

    names : of the parameters; matrix : shape (k, k) [SI]
    Raises InputError for a matrix of another shape, or that is not finite, symmetric and positive
    semidefinite, and for a name that occurs twice.
    """

    names: tuple[str, ...]
    matrix: Array

    def __post_init__(self) -> None:
        """Refuse a matrix that is no covariance. Raises InputError."""
        k, C = len(self.names), self.matrix
        some = f"covariance of {', '.join(self.names[:3])}{', ...' if k > 3 else ''}"
        if C.shape != (k, k) or not np.isfinite(C).all():
            raise InputError(f"{some}: shape {C.shape} for {k} names; a finite matrix of shape ({k}, {k}) is allowed")
        if len(set(self.names)) < k:
            raise InputError(f"{some}: {next(n for n in self.names if self.names.count(n) > 1)} is named twice")
        for name, variance in zip(self.names, np.diag(C), strict=True):
            if variance < 0:
                raise InputError(f"{some}: the variance of {name} is {variance:.6g}; it must be zero or more")
        scale = np.sqrt(np.diag(C))
        correlation = C / np.outer(*[np.where(scale > 0, scale, 1.0)] * 2)
        # Largest asymmetry of a correlation matrix; times its size, that of an eigenvalue below 0.
        eigenvalue_tolerance = 1e-9
        if not np.allclose(correlation, correlation.T, rtol=0, atol=eigenvalue_tolerance):
            raise InputError(f"{some}: it is not symmetric")
        with suppress(np.linalg.LinAlgError):  # a Cholesky factor exists, and is faster, above the tolerance
            np.linalg.cholesky(correlation + eigenvalue_tolerance * k * np.eye(k))
            return
        least = float(np.linalg.eigvalsh(correlation)[0])
        if least < -eigenvalue_tolerance * k:
            raise InputError(
                f"{some}: the least eigenvalue of its correlations is {least:.3g}; a covariance has none below zero"
            )

    def only(self, names: Iterable[str]) -> Covariance:
        """Return the covariance of those of the named parameters that it has, in its own order."""
        wanted = set(names)
        if wanted.issuperset(self.names):
            return self
        which = [k for k, name in enumerate(self.names) if name in wanted]
        return Covariance(tuple(self.names[k] for k in which), self.matrix[np.ix_(which, which)])


@dataclass(frozen=True, eq=False)
class Knowledge:
    """How accurate a robot's values are, and the ranges of the data that identified them.

    covariance : blocks, which share no parameter
    campaign : names of the measurements' tables; poses : number of poses used
    readings : lowest and highest joint variable of each joint, shape (n, 2) [rad or m]; shape
        (0, 2) where it is unknown
    conditions : logged or derived column -> lowest and highest value [its unit]
    misfit : factor on the variances for a comparison with another campaign (see
        `casadical.identification.misfit`)
    robots : number of robots of one type from which it was learnt: the values are their common
        ones, the covariance is how they differ; 0: from this very robot
    Raises InputError for a parameter in two blocks and for ranges in the wrong order.
    """

    covariance: tuple[Covariance, ...] = ()
    campaign: str = ""
    poses: int = 0
    readings: Array = field(default_factory=lambda: np.zeros((0, 2)))
    conditions: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    misfit: float = 1.0
    robots: int = 0

    def __post_init__(self) -> None:
        """Refuse a parameter in two blocks and ranges in the wrong order. Raises InputError."""
        names = [name for block in self.covariance for name in block.names]
        if len(set(names)) < len(names):
            twice = next(n for n in names if names.count(n) > 1)
            raise InputError(f"covariance: {twice} is in two blocks; one is allowed")
        ranges = {f"q{i}": r for i, r in enumerate(self.readings, 1)} | dict(self.conditions)
        for name, (low, high) in ranges.items():
            if not low <= high:
                raise InputError(f"range of {name}: [{low:.6g}, {high:.6g}]; the lower one must come first")

    @cached_property
    def std_errors(self) -> dict[str, float]:
        """Return standard errors of the parameters with a covariance, name -> value [SI]."""
        return {
            name: float(np.sqrt(variance))
            for block in self.covariance
            for name, variance in zip(block.names, np.diag(block.matrix), strict=True)
        }

    def without(self, names: Iterable[str]) -> Knowledge:
        """Return the knowledge with the named parameters removed from all covariance blocks."""
        gone = set(names)
        blocks = (block.only(set(block.names) - gone) for block in self.covariance)
        return replace(self, covariance=tuple(block for block in blocks if block.names))

    def joined(self, later: Knowledge) -> Knowledge:
        """Return the knowledge with a later campaign's covariance and the ranges of both campaigns.

        Poses are added up; misfit and robots are 1 and 0. Where one of the two has no ranges of
        readings, `later` is returned.
        """
        if not (len(self.readings) and len(later.readings)):
            return later
        both = np.stack([self.readings, later.readings])
        readings = np.column_stack([both[:, :, 0].min(axis=0), both[:, :, 1].max(axis=0)])
        conditions = {**self.conditions, **later.conditions}
        for name in set(self.conditions) & set(later.conditions):
            (low, high), (least, most) = self.conditions[name], later.conditions[name]
            conditions[name] = min(low, least), max(high, most)
        campaign = ", ".join(filter(None, (self.campaign, later.campaign)))
        return Knowledge(later.covariance, campaign, self.poses + later.poses, readings, conditions)


@dataclass(frozen=True, eq=False)
class RemainingErrors:
    """Remaining position errors of a calibrated robot as a random vector: J(q) x at the tool point.

    names : of the k parameters x, among those of `with_joint_harmonics(robot)`
    factor : F, shape (k, r) [SI], with second moment F F' of the parameters' errors x
    rest : root mean square distance that no parameter explains [m]
    poses : number of poses from which they were estimated

    Raises InputError for numbers that are not finite, a rest that is not positive, and a factor
    without a row for each name.
    """

    names: tuple[str, ...]
    factor: Array
    rest: float
    poses: int

    def __post_init__(self) -> None:
        """Refuse numbers and shapes that do not fit. Raises InputError."""
        shape = self.factor.shape
        if len(shape) != 2 or shape[0] != len(self.names) or not np.isfinite(self.factor).all():
            raise InputError(f"remaining: factor of shape {shape}; it must have a row of finite numbers for each name")
        if not (np.isfinite(self.rest) and self.rest > 0):
            raise InputError(f"remaining: rest = {self.rest}; it must be a positive number")


def blocks(names: Sequence[str], owners: Sequence[str], matrix: Array) -> tuple[Covariance, ...]:
    """Return a covariance matrix as one block, or, if it is large, as one block per owner.

    Large is more than `MAX_BLOCK_PARAMETERS`; correlations between blocks are dropped. A parameter
    without a variance (NaN, as at a bound) is omitted.

    names : of the k parameters; owners : label of each one's effect, or "" for the base model
    matrix : shape (k, k) [SI]
    """
    finite = [k for k, variance in enumerate(np.diag(matrix)) if np.isfinite(variance)]
    parts = [finite]
    if len(finite) > MAX_BLOCK_PARAMETERS:
        parts = [list(part) for _, part in groupby(sorted(finite, key=owners.__getitem__), key=owners.__getitem__)]
    symmetric = (matrix + matrix.T) / 2
    return tuple(Covariance(tuple(names[k] for k in p), symmetric[np.ix_(p, p)]) for p in parts if len(p))


# Lower limit of a joint's peak gravity torque, as a share of the largest one of all joints of its
# kind; and of the largest one, as a share of the moved weight (times the reach, if revolute).
MIN_TORQUE_OF_LARGEST = 0.05


@dataclass(frozen=True, eq=False)
class Robot(Shown, Arm):
    """An arm with its model and its parameters.

    name : as reports call it; joints : from the base to the flange; loops : four-bars, each of
        which drives a joint
    base : base frame in the measuring frame; tool : tool frame, whose origin is the measured point,
        in the flange frame
    gravity : acceleration, shape (3,) [m/s^2], in the frame that `gravity_frame` names
    payload : declared load in the flange frame; None: none
    widths : bounds and priors of groups of parameters; body_width : one sigma of declared masses
        and mass centres
    tool_name : name of the measured point, where there are several; targets : further measured
        points on the flange
    masses : "declared", or "estimated" where the links' masses determine no stiffness
    drive : data of the drives; sessions : which parameters each session of a campaign has anew
    effects : error sources added to the base model, see `with_effect`; effect_values : parameter
        name -> value [SI] of those
    notes : sentences that a reader of results must know (assumed masses, sources)
    knowledge : covariance of the values, and the ranges on which they were identified; None:
        unknown
    remaining : position errors that the calibrated model still has; None: unknown
    q of its functions are the rows' joint variables; a controller's readings may differ (see
    `Arm.variables_of`). Raises InputError: parts that do not fit each other, with joint and value.

    Examples
    --------
    >>> arm = casadical.Robot("two links", (casadical.Joint(), casadical.Joint(a=0.4)))
    >>> arm = arm.with_values({"a1": 0.401})
    >>> arm.position([0, 0], arm.parameters.values).full().ravel()
    array([0.401, 0.   , 0.   ])
    >>> from casadical.effects.plugins import find_effect
    >>> loose = arm.with_effect(find_effect("joint_scale")(2))
    >>> loose.effects_in_words
    'joint_scale@2 (k 0 rad/rad)'
    >>> loose.with_only([]).effects
    ()
    >>> values = arm.values_of(arm.with_values({"a1": 0.402}))
    >>> float(values[arm.parameters.index_of("a1")])
    0.402
    """

    line: ClassVar[str] = (
        " {{ it.name | repr }}: {{ it.n }} joints, reach {{ it.reach | f('.2f') }} m, "
        "{{ it.parameters | length }} parameters"
        "{% if it.effects %}, with {{ it.effects | map(attribute='label') | join(', ') }}{% endif %}"
    )

    effects: tuple[Effect, ...] = ()
    effect_values: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    knowledge: Knowledge | None = None
    remaining: RemainingErrors | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for effect in self.effects:
            effect.refuse_joints(self)

    def _repr_html_(self) -> str:
        """Return the DH table with each joint's limits [deg or mm], and the notes, as HTML."""
        rows = []
        for i, (joint, (key, factor)) in enumerate(zip(self.joints, self.reading_units.items(), strict=True), 1):
            numbers = ("" if v is None else f"{v:.3f}" for v in dh_row(joint).values())
            ends = f"{joint.lower / factor:.4g} to {joint.upper / factor:.4g} {key.split('_')[1]}"
            rows.append((str(i), *numbers, ends))
        head = ("joint", "alpha [deg]", "a [mm]", "beta [deg]", "b [mm]", "theta [deg]", "d [mm]", "readings")
        table = Table("Modified DH rows", head, rows, frozenset(range(1, 7)))
        return html([table, *(Words(note, "note") for note in self.notes)], title=repr(self)[1:-1])

    @cached_property
    def conditions(self) -> tuple[str, ...]:
        """Return the names of the logged columns that the model uses, besides the joints' own."""
        tilting = GRAVITY_COLUMNS if self.gravity_frame == "logged" else ()
        own = (*(("payload_kg",) if self.payload else ()), *(t.column for t in self.targets), *tilting)
        return tuple(dict.fromkeys((*own, *(c for e in self.effects for c in e.conditions))))

    @cached_property
    def declared(self) -> Array:
        """Return the values of `conditions` where nothing was logged, shape (k,) [each in its column's unit].

        Payload [kg] and direction of gravity (unit vector) are the declared ones; progress is 1, as
        at the end of the campaign; all else is zero, which for several tools means the first.
        """
        values = {"payload_kg": self.payload.mass if self.payload else 0.0, "progress": 1.0}
        size = max(float(np.linalg.norm(self.gravity)), 1e-9)
        values |= dict(zip(GRAVITY_COLUMNS, self.gravity / size, strict=True))
        return np.array([values.get(c, 0.0) for c in self.conditions])

    @cached_property
    def parameters(self) -> Parameters:
        """Return every parameter of the model, with its nominal value, bounds and prior."""
        return Parameters(parameters_of(self, self.effects, self.effect_values))

    @property
    def shown(self) -> tuple[str, ...]:
        """Return the names of the parameters that tables show.

        Effects with a `summary` in place of their parameters are omitted.
        """
        many = {effect.label for effect in self.effects if effect.summary}
        return tuple(p.name for p in self.parameters if p.group not in many)

    @cached_property
    def torque_scale(self) -> Array:
        """Return the peak gravity torque of each joint, shape (n,) [N m or N].

        It is the 95 % quantile of its magnitude over random poses within the limits, with the
        declared payload and without effects, and at least a twentieth of the largest of joints of
        the same kind, revolute or prismatic: a gear with a vertical axis is made for the forces of
        motion. The largest counts as at least a twentieth of the moved weight (times the reach, if
        revolute): a slightly tilted base loads vertical axes and level strokes.
        """
        lower, upper = self.limits
        q = np.random.default_rng(0).uniform(lower, upper, (512, self.n))
        great = np.nanquantile(np.abs(self._bare_torques(q, {})), 0.95, axis=1)
        turning = np.array([j.kind == "revolute" for j in self.joints])
        for kind, lever in ((turning, self.reach), (~turning, 1.0)):  # N m and N
            if kind.any():
                loads = [*(j.body for j in self.joints[kind.argmax() :]), self.payload]
                weight = float(np.linalg.norm(self.gravity)) * sum(body.mass for body in loads if body)
                most = max(1e-9, MIN_TORQUE_OF_LARGEST * weight * lever, float(np.nanmax(great[kind])))
                great[kind] = np.maximum(great[kind], MIN_TORQUE_OF_LARGEST * most)
        return great

    def loads(self, q: Array, conditions: Mapping[str, Array]) -> Array:
        """Return signed gravity torques at n poses, divided by `torque_scale`, (n, joints).

        Effects are omitted.

        q : joint variables, (n, joints) [rad or m]; conditions : logged columns, else declared ones
        """
        return np.asarray(self._bare_torques(q, conditions).T / self.torque_scale)

    def _bare_torques(self, q: Array, conditions: Mapping[str, Array]) -> Array:
        """Return gravity torques of the model without effects, shape (joints, n) [N m or N]."""
        bare = self.with_only(())
        w = np.tile(bare.declared, (len(q), 1))
        for k, name in enumerate(bare.conditions):
            w[:, k] = conditions.get(name, w[:, k])
        return bare.model.evaluate(("tau",), q, w, bare.parameters.values)[0]

    @cached_property
    def model(self) -> Model:
        """Return the symbolic model and its CasADi functions."""
        return Model(self, self.declared, self.constants, self.structure)

    @cached_property
    def structure(self) -> Structure:
        """Return the parts of which the symbolic model is composed."""
        return Structure(self, self.parameters, self.effects, self.conditions)

    @cached_property
    def constants(self) -> Array:
        """Return constants, shape (24 + n,), see `constants_of`; without effects torque scales are 0."""
        return constants_of(self, self.torque_scale if self.effects else np.zeros(self.n))

    @cached_property
    def position(self) -> ca.Function:
        """Return the CasADi function (q[n], phi)->p[3], the measured point [m] in the measuring frame.

        q are joint variables [rad or m], phi the parameters [SI]; the payload, and every other
        condition, has its declared value.
        """
        return self.model.at_declared("position", ("p",))

    @cached_property
    def pose(self) -> ca.Function:
        """Return the CasADi function (q[n], phi)->(p[3], R[3x3]), the tool frame [m] in the measuring frame.

        Arguments and conditions are as of `position`.
        """
        return self.model.at_declared("pose", ("p", "R"))

    @cached_property
    def torque(self) -> ca.Function:
        """Return the CasADi function (q[n], phi)->tau[n], gravity torques of actuated joints [N m or N].

        Arguments and conditions are as of `position`.
        """
        return self.model.at_declared("torque", ("tau",))

    def with_effect(self, *effects: Effect) -> Robot:
        """Return a robot whose model has these effects too."""
        return replace(self, effects=(*self.effects, *effects))

    @property
    def effects_in_words(self) -> str:
        """Return the labels of all effects, each with up to six values and units; "" for none."""
        texts = []
        for effect in self.effects:
            sizes, values = effect.sizes(), effect.own_values(self.effect_values)
            given = [f"{name} {value:.3g} {sizes[name][1]}".rstrip() for name, value in list(values.items())[:6]]
            texts.append(f"{effect.label} ({', '.join([*given, *(['...'] if len(sizes) > len(given) else [])])})")
        return ", ".join(texts)

    def with_only(self, effects: Iterable[Effect]) -> Robot:
        """Return a robot with only these of its effects in the model.

        Values and covariances of the removed ones are dropped, and all remaining errors with them.
        """
        chosen = tuple(effects)
        gone = {p.name for e in self.effects if e not in chosen for p in e.parameters()}
        values = {name: value for name, value in self.effect_values.items() if name not in gone}
        knowledge = self.knowledge and self.knowledge.without(gone)
        remaining = None if gone else self.remaining
        return replace(self, effects=chosen, effect_values=values, knowledge=knowledge, remaining=remaining)

    @property
    def without_sessions(self) -> Robot:
        """Return the robot without effects of sessions, which stand for a day of a campaign."""
        return self.with_only(e for e in self.effects if not isinstance(e, Session))

    def with_unknown(self, **frames: Literal["none", "position", "pose"]) -> Robot:
        """Return a robot of whose frames, base or tool, another part is to be identified."""
        return replace(self, **{name: replace(getattr(self, name), unknown=what) for name, what in frames.items()})

    @property
    def rigid(self) -> Robot:
        """Return the robot without compliances and `knowledge`; effects and `remaining` stay."""
        joints = tuple(replace(j, compliance=None) for j in self.joints)
        return replace(self, joints=joints, knowledge=None)

    def with_values(self, values: Mapping[str, float]) -> Robot:
        """Return a robot with other nominal values, by parameter name [SI].

        Its `knowledge` and `remaining` are None. Parameters of the base, and rotations of the tool,
        move the nominal frame and are then zero again.

        Raises InputError: no such parameter, or a value that is not finite.
        """
        for name, value in values.items():
            self.parameters.index_of(name)
            if not np.isfinite(value):
                raise InputError(f"{name} is {value}; it must be a finite number")
        v = {p.name: float(values.get(p.name, p.value)) for p in self.parameters}
        effect_names = {p.name for e in self.effects for p in e.parameters()}
        joints, loops, T = [], [], self.tool.T
        for i, joint in enumerate(self.joints, 1):
            row: Any = {name: v.get(f"{name}{i - 1}") for name in ("alpha", "a", "beta", "b")}
            joints.append(replace(joint, **row, theta=v[f"theta{i}"], d=v[f"d{i}"], compliance=v.get(f"c{i}")))
        for k, loop in enumerate(self.loops, 1):
            bars: Any = {bar: v[name] for bar, name in bar_names(k).items()}
            loops.append(replace(loop, **bars))
        moved = np.array([v.get(n, 0.0) for n in PLACEMENT_PARAMETERS["base"]])
        tool = np.array(
            [v.get(n, old) for n, old in zip(PLACEMENT_PARAMETERS["tool"], (*T[:3, 3], 0, 0, 0), strict=True)]
        )
        return replace(
            self,
            joints=tuple(joints),
            loops=tuple(loops),
            base=replace(self.base, T=self.base.T @ frame(from_xyz(moved[3:]), moved[:3])),
            tool=replace(self.tool, T=frame(T[:3, :3] @ from_xyz(tool[3:]), tool[:3])),
            targets=tuple(replace(t, point=np.array([v[name] for name in t.parameters])) for t in self.targets),
            effect_values={n: v[n] for n in effect_names},
            knowledge=None,
            remaining=None,
        )

    def values_of(self, other: Robot) -> Array:
        """Return values of this robot's parameters with which it equals another one, (P,) [SI].

        The other one has the same structure; its nominal base and tool frames may differ.
        """
        values = dict(zip(other.parameters.names, other.parameters.values, strict=True))
        moved, turned = (np.linalg.solve(a.T, b.T) for a, b in ((self.base, other.base), (self.tool, other.tool)))
        nine = (*moved[:3, 3], *to_xyz(moved[:3, :3]), *to_xyz(turned[:3, :3]))
        values |= {
            n: v
            for n, v in zip((*PLACEMENT_PARAMETERS["base"], *PLACEMENT_PARAMETERS["tool"][3:]), nine, strict=True)
            if n in values
        }
        return np.array([values[n] for n in self.parameters.names])


def in_file_units(part: object, **units: str) -> dict[str, float | None]:
    """Return fields of a part of a robot, key "field_mm" or "field_deg" -> value in this unit.

    A value is None where the field is None.

    part : a dataclass with values in m and rad; units : name of each field -> "mm" or "deg"
    """
    factors = {"mm": 1e3, "deg": 180 / np.pi}
    given = ((f"{name}_{unit}", getattr(part, name), factors[unit]) for name, unit in units.items())
    return {key: None if value is None else float(factor * value) for key, value, factor in given}


def dh_row(joint: Joint) -> dict[str, float | None]:
    """Return a modified DH row by the keys alpha_deg, a_mm, beta_deg, b_mm, theta_deg, d_mm.

    The value is None for a beta or b that the row has not.
    """
    return in_file_units(joint, alpha="deg", a="mm", beta="deg", b="mm", theta="deg", d="mm")


def modified_dh(robot: Robot) -> list[dict[str, float | None]]:
    """Return the modified DH table, a dict per row with joint (from 1) and the keys of `dh_row`."""
    return [{"joint": i, **dh_row(joint)} for i, joint in enumerate(robot.joints, 1)]


def with_joint_harmonics(robot: Robot, orders: int = 1) -> Robot:
    """Return the robot with one added effect: harmonics of each revolute joint's error, all zero.

    Joint error curves that it had, and its remaining errors with them, are removed.

    orders : highest harmonic; their prior standard deviation is TYPICAL_HARMONIC_RAD [rad]
    """
    spread = tuple(TYPICAL_HARMONIC_RAD * (j in robot.revolute) for j in robot.numbers)
    bare = robot.with_only(e for e in robot.effects if not isinstance(e, JointErrorCurve))
    return bare.with_effect(JointErrorCurve(None, spread, orders=orders))
