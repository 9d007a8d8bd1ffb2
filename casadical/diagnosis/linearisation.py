"""What each effect does to the measured position: its columns of the Jacobian, at zero effect.

The chain rule at the seams: a column is the position's derivative by the seam's variables (joint variables, a twist
behind each link, at the base and in the tool, the measured point) times those variables' derivative by the effect's
parameter. The first factor is the same for all effects and is computed once per pose. The second is a short formula,
composed once for all settings of an effect and evaluated for all poses and settings together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadical.core.arrays import Array
from casadical.core.casadi_buffers import call
from casadical.diagnosis.formulas import Part, plan
from casadical.diagnosis.seams import seams_of
from casadical.effects import Effect
from casadical.measurements.measurements import Measurements
from casadical.robot.model import constants_of
from casadical.robot.robot import Robot

# Poses whose seams are evaluated in one call.
BLOCK = 512
# All poses.
EVERY = slice(None)


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
        parts = plan(s, tuple(effects))
        out = np.zeros((len(self.q), 3, sum(len(part.starts) * part.width for part in parts)))
        for part in parts:
            self._fill(out, part)
        return out

    def _fill(self, out: Array, part: Part) -> None:
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
