"""What each effect does to the measured position: its columns of the Jacobian, at zero effect.

The chain rule at the seams: a column is the position's derivative by the seam's variables (joint variables, a twist
behind each link, at the base and in the tool, the measured point) times those variables' derivative by the effect's
parameter. The first factor is the same for all effects and is computed once per pose. The second is a short formula,
composed once for all settings of an effect and evaluated for all poses and settings together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.casadi_arrays import ArrayFunction
from casadical.core.casadi_buffers import call
from casadical.core.transforms import Symbolic, small_frame
from casadical.effects import Context, Effect
from casadical.measurements.measurements import Measurements
from casadical.robot.model import Structure, constants_of, expressions, rigid_context
from casadical.robot.robot import Robot
from casadical.robot.statics import deflections, gravity_torques

_TWIST = ("x", "y", "z", "rx", "ry", "rz")
# Poses whose seams are evaluated in one call.
BLOCK = 512
# All poses.
EVERY = slice(None)


class _Probe(Effect):
    """An effect with every variable of every seam as a parameter."""

    name: ClassVar[str] = "probe"

    def __init__(self, robot: Robot) -> None:
        object.__setattr__(self, "joint", None)
        names = [f"q{i}" for i in range(1, robot.n + 1)]
        for seam in (*(f"link{i}" for i in range(1, robot.n + 1)), "base", "tool"):
            names += [f"{seam}_{c}" for c in _TWIST]
        object.__setattr__(self, "names", (*names, "point_x", "point_y", "point_z"))

    def sizes(self) -> dict[str, tuple[float, str]]:
        return dict.fromkeys(self.names, (1.0, ""))  # type: ignore[attr-defined]

    def joint_angle(self, context: Context) -> Symbolic:
        return ca.vertcat(*(self.value(context, f"q{i}") for i in range(1, context.arm.n + 1)))

    def _frame(self, context: Context, seam: str) -> Symbolic:
        return small_frame(*(self.value(context, f"{seam}_{c}") for c in _TWIST))

    def link(self, number: int, context: Context) -> Symbolic:
        return self._frame(context, f"link{number}")

    def base(self, context: Context) -> Symbolic:
        return self._frame(context, "base")

    def tool(self, context: Context) -> Symbolic:
        return self._frame(context, "tool")

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        return point + ca.vertcat(*(self.value(context, f"point_{c}") for c in "xyz"))


@dataclass(frozen=True, eq=False)
class _Seams:
    """Robots of one structure at their seams, nothing under judgement in them.

    function : (q, w, phi, constants)->(J[3, P], S[3, seams], seen), the last what effects look at, one number each
    exact : a context of the model's own expressions; free : the same with `seen` as symbols
    inputs : q, w, phi and the constants; point : the measured one, as a symbol
    """

    function: ca.Function
    exact: Context
    free: Context
    inputs: tuple[ca.SX, ca.SX, ca.SX, ca.SX]
    seen: ca.SX
    point: ca.SX

    @lru_cache(maxsize=64)  # noqa: B019 - seams live in a cache themselves
    def mapped(self, n: int) -> ca.Function:
        """The function over n poses, parameters and constants shared."""
        return self.function.map("poses", "serial", n, [2, 3], [])


def seams_of(robot: Robot) -> _Seams:
    """The seams of a robot, composed once for all robots of its structure."""
    return _seams(robot.with_effect(_Probe(robot)).structure, len(robot.parameters))


@lru_cache(maxsize=16)
def _seams(structure: Structure, count: int) -> _Seams:
    """Derivatives of the position by the first `count` parameters and by every seam's variables, at zero of these."""
    model, arm = expressions(structure), structure.arm
    phi, seams = model.phi[:count], model.phi[count:]
    zero = ca.SX.zeros(seams.numel())
    parts = ca.substitute([model.p, ca.jacobian(model.p, phi), ca.jacobian(model.p, seams)], [seams], [zero])
    # At its own parameters the loads are those of the robot as it is.
    point, J, S = ca.substitute(parts, [model.loaded], [ca.vertcat(phi, zero)])
    conditions = dict(zip(structure.conditions, ca.vertsplit(model.w) if structure.conditions else [], strict=True))
    values = dict(zip(structure.parameters.names[:count], ca.vertsplit(phi), strict=True))
    base = ca.vertcat(ca.reshape(model.constants[:12], 3, 4), ca.DM([[0, 0, 0, 1]]))
    exact = rigid_context(arm, model.constants[24:], model.q, conditions, values, base)
    others = [e.energy(exact) for e in structure.effects]
    exact = replace(exact, torque=gravity_torques(exact, sum(others)))
    frames = [ca.reshape(T[:3, :], 12, 1) for T in exact.frames]
    looked_at = ca.vertcat(point, ca.SX(exact.torque), ca.SX(exact.gravity), *map(ca.SX, frames))
    seen = ca.SX.sym("seen", looked_at.numel())
    torque, gravity = seen[3 : 3 + arm.n], seen[3 + arm.n : 6 + arm.n]
    parts = ca.vertsplit(seen[6 + arm.n :], 12)
    rigid = tuple(ca.vertcat(ca.reshape(part, 3, 4), ca.DM([[0, 0, 0, 1]])) for part in parts)
    free = replace(exact, torque=torque, gravity=gravity, frames=rigid)
    inputs = (model.q, model.w, phi, model.constants)
    outputs = [ca.densify(part) for part in (J, S, looked_at)]
    function = ca.Function("seams", [*inputs], outputs, ["q", "w", "phi", "constants"], ["J", "S", "seen"])
    return _Seams(function, exact, free, inputs, seen, seen[:3])


@dataclass(frozen=True)
class _Formula:
    """The seam variables' derivative by one effect's parameters, its settings left open.

    conditions : of the formula's input w, in order; rows, columns : seam and parameter of each nonzero
    """

    function: ArrayFunction
    conditions: tuple[str, ...]
    rows: Array
    columns: Array


@lru_cache(maxsize=4096)
def _formula(s: _Seams, template: Effect, settings: tuple[str, ...]) -> _Formula | None:
    """The formula of an effect whose settings of these names are inputs; None where it must know their values."""
    symbols: dict[str, Any] = {name: ca.SX.sym(name) for name in settings}
    conditions = tuple(dict.fromkeys((*s.exact.conditions, *template.conditions)))
    q, own, phi, constants = s.inputs
    w = ca.vertcat(own, ca.SX.sym("w", len(conditions) - own.numel()))
    logged = dict(zip(conditions, ca.vertsplit(w) if conditions else [], strict=True))
    try:
        effect = replace(template, **symbols) if symbols else template
        derivative = ca.sparsify(_seam_derivative(effect, s, logged))
    except Exception:
        if symbols:
            return None
        raise
    inputs = [q, w, phi, constants, s.seen, ca.vertcat(*symbols.values())]
    function = ca.Function("formula", [ca.SX(i) for i in inputs], [derivative])
    rows, columns = (np.array(k, dtype=np.int64) for k in derivative.sparsity().get_triplet())
    return _Formula(ArrayFunction(function), conditions, rows, columns)


def _seam_derivative(effect: Effect, s: _Seams, logged: dict[str, ca.SX]) -> ca.SX:
    """Derivative of all seam variables by the effect's parameters at zero, shape (seams, parameters)."""
    parameters = effect.parameters()
    theta = ca.SX.sym("theta", len(parameters))
    own = dict(zip((p.name for p in parameters), ca.vertsplit(theta), strict=True))
    exact, context = (replace(c, values={**c.values, **own}, conditions=logged) for c in (s.exact, s.free))
    angle = ca.SX(effect.joint_angle(context))
    energy = ca.SX(effect.energy(replace(exact, torque=None)))
    if ca.depends_on(energy, theta):
        angle += deflections(context.arm, gravity_torques(exact, energy), context.values)
    seams, n = [angle], context.arm.n
    seams += [_twist(effect.link(i, context)) for i in range(1, n + 1)] if _acts(effect, "link") else [ca.SX(6 * n, 1)]
    seams += [_twist(effect.base(context)) if _acts(effect, "base") else ca.SX(6, 1)]
    seams += [_twist(effect.tool(context)) if _acts(effect, "tool") else ca.SX(6, 1)]
    seams += [effect.measurement(s.point, context) - s.point if _acts(effect, "measurement") else ca.SX(3, 1)]
    derivative = ca.jacobian(ca.vertcat(*seams), theta)
    return ca.substitute(derivative, theta, ca.SX.zeros(theta.numel()))


def _acts(effect: Effect, seam: str) -> bool:
    """Whether the effect overrides a seam."""
    return getattr(type(effect), seam) is not getattr(Effect, seam)


def _twist(T: ca.SX) -> ca.SX:
    """The six numbers of a transform near identity, to first order."""
    T = ca.SX(T)
    turn = 0.5 * ca.vertcat(T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1])
    return ca.vertcat(T[:3, 3], turn)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A robot at its seams at measured poses; columns of effects are made from it, some poses at a time.

    robot : nothing of what is judged is in it; phi : its parameters, shape (P,) [SI]
    q, conditions : of the poses, shapes (n, joints) and (n,) each
    J : by the base model's parameters, shape (n, 3, P); S : by all seam variables, shape (n, 3, seams)
    seen : what effects look at, shape (n, numbers); constants : of the model with effects in it
    """

    robot: Robot
    phi: Array
    q: Array
    conditions: dict[str, Array]
    J: Array
    S: Array
    seen: Array
    constants: Array

    @property
    def Jq(self) -> Array:
        """By the joint variables, shape (n, 3, joints)."""
        return self.S[:, :, : self.robot.n]

    def at(self, poses: Array | slice) -> Linearisation:
        """Some of the poses."""
        conditions = {name: values[poses] for name, values in self.conditions.items()}
        return replace(
            self, q=self.q[poses], conditions=conditions, J=self.J[poses], S=self.S[poses], seen=self.seen[poses]
        )

    def columns(self, effects: Sequence[Effect]) -> Array:
        """Columns of all parameters of the effects, shape (n, 3, parameters) [m per unit of parameter].

        Raises KeyError for a condition that is not there (see `derived_columns.derive`).
        """
        s = seams_of(self.robot)
        plan = _plan(s, tuple(effects))
        out = np.zeros((len(self.q), 3, sum(len(part.starts) * part.width for part in plan)))
        for part in plan:
            self._fill(out, part)
        return out

    def _fill(self, out: Array, part: _Part) -> None:
        """Columns of effects that share a formula."""
        n, formula = len(self.q), part.formula
        logged = [self._condition(c)[:, None] for c in formula.conditions]
        q, seen = ([c[:, None] for c in values.T] for values in (self.q, self.seen))
        (found,) = formula.function(q, logged, list(self.phi), list(self.constants), seen, part.settings)
        for seam in np.unique(formula.rows):
            own = np.flatnonzero(formula.rows == seam)
            factor = np.empty((n, len(part.starts), len(own)))
            for i, k in enumerate(own):
                factor[:, :, i] = found[k]
            columns = (part.starts[:, None] + formula.columns[own]).ravel()
            out[:, :, _as_slice(columns)] += self.S[:, :, seam, None] * factor.reshape(n, 1, -1)

    def _condition(self, name: str) -> Array:
        if name in self.conditions:
            return self.conditions[name]
        known = dict(zip(self.robot.conditions, self.robot.declared, strict=True))
        return np.full(len(self.q), known[name])


def _as_slice(columns: Array) -> Array | slice:
    """Columns one after the other as a slice, which is faster."""
    return slice(columns[0], columns[-1] + 1) if (np.diff(columns) == 1).all() else columns


@dataclass(frozen=True, eq=False)
class _Part:
    """Effects that share a formula.

    settings : values of each setting that is an input, one for each effect
    starts : of each effect's columns; width : how many an effect has
    """

    formula: _Formula
    settings: list[Array]
    starts: Array
    width: int


@lru_cache(maxsize=32)
def _plan(s: _Seams, effects: tuple[Effect, ...]) -> tuple[_Part, ...]:
    """How the columns of effects, one after the other, are made."""
    starts = np.cumsum([0, *(len(e.sizes()) for e in effects)])
    parts = []
    for (template, names), which in _templates(effects).items():
        width = len(template.sizes())
        if formula := _formula(s, template, names):
            settings = [np.array([getattr(effects[k], name) for k in which]) for name in names]
            parts.append(_Part(formula, settings, starts[which], width))
            continue
        for k in which:
            known = _formula(s, effects[k], ())
            assert known
            parts.append(_Part(known, [], starts[[k]], width))
    return tuple(parts)


def _templates(effects: Sequence[Effect]) -> dict[tuple[Effect, tuple[str, ...]], list[int]]:
    """Effects that differ only in settings which their conditions do not depend on, under their first one."""
    first: dict[Any, tuple[Effect, tuple[str, ...]]] = {}
    found: dict[tuple[Effect, tuple[str, ...]], list[int]] = {}
    for k, effect in enumerate(effects):
        values = {f.name: getattr(effect, f.name) for f in fields(effect)}
        names = tuple(n for n, v in values.items() if isinstance(v, float))
        rest = tuple((n, v) for n, v in values.items() if n not in names)
        key = (type(effect), rest, effect.conditions, tuple(effect.sizes()))
        ones: dict[str, Any] = dict.fromkeys(names, 1.0)
        template = first.setdefault(key, (replace(effect, **ones), names))
        found.setdefault(template, []).append(k)
    return found


def linearise(robot: Robot, m: Measurements, phi: Array) -> Linearisation:
    """A robot at its seams at measured poses.

    m : with every condition that the effects to be judged need; phi : the robot's parameters, shape (P,) [SI]
    """
    s, constants = seams_of(robot), constants_of(robot, robot.torque_scale)
    w = m.condition_matrix(robot.conditions, robot.declared)
    parts: list[list[Array]] = [[], [], []]
    for first in range(0, len(m), BLOCK):
        some = slice(first, first + BLOCK)
        n = len(m.q[some])
        found = call(s.mapped(n), m.q[some].T, w[some].T, phi, constants)
        for part, value in zip(parts, found, strict=True):
            part.append(value.reshape(value.shape[0], n, -1).transpose(1, 0, 2))
    J, S, seen = (np.concatenate(part) for part in parts)
    return Linearisation(robot, phi, m.q, dict(m.conditions), J, S, seen[:, :, 0], constants)


def signatures(robot: Robot, effects: Sequence[Effect], m: Measurements, values: Array) -> tuple[Array, Array, Array]:
    """Columns of the effects, of the base model's parameters and of the joint variables at the measured poses.

    Shapes (n, 3, all effects' parameters), (n, 3, P), (n, 3, joints), at the parameter values given, shape (P,) [SI].
    m : with every condition that the effects need (see `casadical.measurements.derived_columns.derive`)
    """
    found = linearise(robot, m, values)
    return found.columns(effects), found.J, found.Jq


# Columns of up to so many bytes are kept once they were made.
KEPT = 60_000_000


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of effects at poses in units of their parameters' sizes, made when they are asked for.

    linear : the poses; effects : one after the other; sizes : of every parameter, shape (columns,)
    growth : of the sizes, for a robot that leaves more than others do
    """

    linear: Linearisation
    effects: tuple[Effect, ...]
    growth: float = 1.0

    @cached_property
    def sizes(self) -> Array:
        """Realistic size of every parameter, shape (columns,)."""
        return self.growth * np.array([size for e in self.effects for size, _ in e.sizes().values()])

    @cached_property
    def held(self) -> Array:
        """One sigma of every parameter once it is in a model, in sizes, shape (columns,)."""
        return np.array([e.held for e in self.effects for _ in e.sizes()])

    @property
    def shape(self) -> tuple[int, int, int]:
        """Poses, coordinates, columns."""
        return len(self.linear.q), 3, len(self.sizes)

    @cached_property
    def _edges(self) -> Array:
        return np.cumsum([0, *(len(e.sizes()) for e in self.effects)])

    @cached_property
    def _all(self) -> Array:
        return self.linear.columns(self.effects) * self.sizes

    @property
    def _few(self) -> bool:
        return 8 * int(np.prod(self.shape)) <= KEPT

    def take(self, columns: Array, poses: Array | slice = EVERY) -> Array:
        """Some of the columns at some poses, shape (poses, 3, len(columns)) [m per unit of size]."""
        if self._few:
            return np.asarray(self._all[poses][:, :, columns])
        owners = np.unique(np.searchsorted(self._edges, columns, side="right") - 1)
        some = replace(self, effects=tuple(self.effects[k] for k in owners))
        starts = self._edges[owners] - some._edges[:-1]
        place = np.searchsorted(owners, np.searchsorted(self._edges, columns, side="right") - 1)
        found = self.linear.at(poses).columns(some.effects)
        found *= some.sizes
        places = columns - starts[place]
        return found if np.array_equal(places, np.arange(found.shape[2])) else np.asarray(found[:, :, places])

    def only(self, columns: Array) -> Columns:
        """Some of the columns, in rising order, all those of an effect or none."""
        owners = np.unique(np.searchsorted(self._edges, columns, side="right") - 1)
        some = replace(self, effects=tuple(self.effects[k] for k in owners))
        assert some.shape[2] == len(columns)
        if self._few:
            some.__dict__["_all"] = self._all[:, :, columns]
        return some

    def block(self, poses: slice) -> Array:
        """All columns at some poses, shape (poses, 3, columns) [m per unit of size]."""
        return np.asarray(self._all[poses] if self._few else self.linear.at(poses).columns(self.effects) * self.sizes)

    def at(self, poses: Array) -> Columns:
        """The same columns at some of the poses."""
        some = replace(self, linear=self.linear.at(poses))
        if self._few:
            some.__dict__["_all"] = self._all[poses]
        return some

    def after(self, column: int) -> Columns:
        """The columns from this one on, with which an effect's columns begin."""
        return replace(self, effects=self.effects[int(np.searchsorted(self._edges, column)) :])

    def plus(self, effects: tuple[Effect, ...], conditions: Mapping[str, Array]) -> Columns:
        """With further effects behind the others; conditions : all logged and derived columns of these poses."""
        linear = replace(self.linear, conditions=dict(conditions))
        more = replace(self, linear=linear, effects=(*self.effects, *effects))
        if more._few:
            more.__dict__["_all"] = np.concatenate([self._all, Columns(linear, effects, self.growth)._all], axis=2)
        return more
