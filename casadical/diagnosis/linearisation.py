"""What each effect does to the measured position: its columns of the Jacobian, at zero effect.

The chain rule at the seams: a column is the position's derivative by the seam's variables (joint variables, a twist
behind each link, at the base and in the tool, the measured point) times those variables' derivative by the effect's
parameter. The first factor is the same for all effects and is computed once per pose. The second is a short formula,
composed once for all settings of an effect and evaluated for all poses and settings together.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadical.core.arrays import Array
from casadical.core.casadi_buffers import call
from casadical.diagnosis.combinations import Combined, Directions, directions_of
from casadical.diagnosis.formulas import Part, plan
from casadical.diagnosis.seams import Seams, seams_of
from casadical.effects import Effect
from casadical.measurements.measurements import Measurements
from casadical.robot.model import constants_of
from casadical.robot.robot import Robot

# Poses whose seams are evaluated in one call.
BLOCK = 512
# All poses.
EVERY = slice(None)
# Variables of the measured point, the last of the seams.
POINT = 3
# Behind a condition's name, before the number of the reading at a pose.
TURN = "#"


def of_turn(condition: str, turn: int) -> str:
    """The name of a condition of a further reading at a pose; of the first, 0, its own."""
    return f"{condition}{TURN}{turn}" if turn else condition


@dataclass(frozen=True, eq=False)
class Factors:
    """Columns as sums over seams: the position's derivative by a seam's variable times a factor at each pose.

    blocks : a seam, the columns that act there, at most once each, and their factors, shape (columns, n)
    width : number of columns
    """

    blocks: tuple[tuple[int, Array, Array], ...]
    width: int

    def columns_at(self, S: Array) -> Array:
        """The columns, shape (n, 3, columns); S : derivative by all seam variables, shape (n, 3, seams)."""
        out = np.zeros((*S.shape[:2], self.width))
        for seam, columns, values in self.blocks:
            out[:, :, as_slice(columns)] += S[:, :, seam, None] * values.T[:, None]
        return out

    def scaled(self, sizes: Array) -> Factors:
        """In units of sizes, shape (columns,)."""
        return replace(self, blocks=tuple((s, c, values * sizes[c, None]) for s, c, values in self.blocks))

    def at(self, poses: Array | slice) -> Factors:
        """At some of the poses."""
        return replace(self, blocks=tuple((s, c, values[:, poses]) for s, c, values in self.blocks))

    def only(self, columns: Array) -> Factors:
        """Of some of the columns, renumbered in this order."""
        place = np.full(self.width, -1)
        place[columns] = np.arange(len(columns))
        found = []
        for seam, own, values in self.blocks:
            kept = np.flatnonzero(place[own] >= 0)
            if len(kept):
                found.append((seam, place[own[kept]], values[kept] if len(kept) < len(own) else values))
        return Factors(tuple(found), len(columns))

    def combined(self, every: Combined) -> Factors:
        """Of combinations of the columns, of which those of a part act at the same seams."""
        if every.plain:
            return self
        starts, found = np.array([a for a, _, _ in every.blocks]), []
        for seam, own, values in self.blocks:
            which = np.searchsorted(starts, own, side="right") - 1
            parts = [(k, own[which == k], values[which == k]) for k in np.unique(which).tolist()]
            more = [every.factors(k, columns, part) for k, columns, part in parts]
            places, factors = (np.concatenate(a) for a in zip(*more, strict=True))
            if len(places):  # a joint that moves no pose has no combinations
                found.append((seam, places, factors))
        return Factors(tuple(found), every.width)

    def products(self, S: Array) -> Array:
        """Products of the columns, added up over the poses, shape (columns, columns)."""
        total = np.zeros((self.width, self.width))
        for s, own, values in self.blocks:
            for t, others, more in self.blocks:
                total[np.ix_(own, others)] += (values * (S[:, :, s] * S[:, :, t]).sum(axis=1)) @ more.T
        return total

    def before(self, others: Factors) -> Factors:
        """With the columns of others behind."""
        shifted = tuple((s, self.width + c, values) for s, c, values in others.blocks)
        return Factors((*self.blocks, *shifted), self.width + others.width)


def as_slice(columns: Array) -> Array | slice:
    """Columns one after the other as a slice, which is faster."""
    return slice(columns[0], columns[-1] + 1) if (np.diff(columns) == 1).all() else columns


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A robot at its seams at measured poses; columns of effects are made from it, some poses at a time.

    robot : nothing of what is judged is in it; phi : its parameters, shape (P,) [SI]
    q, conditions : of the poses, shapes (n, joints) and (n,) each
    J : by the base model's parameters, shape (n, 3, P); S : by all seam variables, shape (n, 3, seams)
    seen : what effects look at, shape (n, numbers); constants : of the model with effects in it
    model : the robot at its seams, of any pose
    far : readings and what effects look at where the other ends of measurements are, whose seams follow those of the
        poses in S; None for measurements with one end
    further : readings that a pose has at most beside the first; each has variables of the measured point of its own,
        behind all other seams, and conditions of its own where there are such (see `of_turn`)
    Of other kinds of measurement than positions, J and S are of what is measured (see `observations`), not of three
    coordinates.
    """

    robot: Robot
    model: Seams
    phi: Array
    q: Array
    conditions: dict[str, Array]
    J: Array
    S: Array
    seen: Array
    constants: Array
    far: tuple[Array, Array] | None = None
    further: int = 0

    @property
    def Jq(self) -> Array:
        """By the joint variables, shape (n, 3, joints)."""
        return self.S[:, :, : self.robot.n]

    def at(self, poses: Array | slice) -> Linearisation:
        """Some of the poses."""
        conditions = {name: values[poses] for name, values in self.conditions.items()}
        far = self.far and (self.far[0][poses], self.far[1][poses])
        return replace(
            self,
            q=self.q[poses],
            conditions=conditions,
            J=self.J[poses],
            S=self.S[poses],
            seen=self.seen[poses],
            far=far,
        )

    def columns(self, effects: Sequence[Effect]) -> Array:
        """Columns of all parameters of the effects, shape (n, 3, parameters) [m per unit of parameter].

        Raises KeyError for a condition that is not there (see `derived_columns.derive`).
        """
        return self.factors(plan(self.model, tuple(effects))).columns_at(self.S)

    def factors(self, parts: Sequence[Part]) -> Factors:
        """The same columns as factors of the seams at which they act; parts : of `plan`."""
        n, found = len(self.q), dict[int, list[tuple[Array, Array]]]()
        for numbers, first, least, turn in self._places():
            q, seen = ([c[None] for c in of.T] for of in numbers)
            for part in parts:
                f = part.formula
                if f.rows.max(initial=-1) < least:
                    continue
                logged = [self._condition(c, turn)[None] for c in f.conditions]
                settings = [setting[:, None] for setting in part.settings]
                (factors,) = f.function.on_arrays(q, logged, list(self.phi), list(self.constants), seen, settings)
                for seam, column, factor in zip(f.rows.tolist(), f.columns, factors, strict=True):
                    if seam >= least:
                        own = np.broadcast_to(factor, (len(part.starts), n))
                        found.setdefault(first + seam, []).append((part.starts + column, own))
        blocks = tuple(
            (seam, np.concatenate([c for c, _ in own]), np.concatenate([f for _, f in own]))
            for seam, own in sorted(found.items())
        )
        return Factors(blocks, sum(len(part.starts) * part.width for part in parts))

    def _places(self) -> Iterator[tuple[tuple[Array, Array], int, int, int]]:
        """Where effects act: readings and what effects look at, number of the first seam, the least that is used, turn.

        Of further readings at a pose it is the measured point alone.
        """
        ends = [(self.q, self.seen)] if self.far is None else [(self.q, self.seen), self.far]
        seams = (self.S.shape[2] - POINT * self.further) // len(ends)
        for k, end in enumerate(ends):
            yield end, k * seams, 0, 0
        for turn in range(1, self.further + 1):
            yield ends[0], len(ends) * seams + POINT * turn - seams, seams - POINT, turn

    def _condition(self, name: str, turn: int) -> Array:
        for own in (of_turn(name, turn), name):
            if own in self.conditions:
                return self.conditions[own]
        known = dict(zip(self.robot.conditions, self.robot.declared, strict=True))
        return np.full(len(self.q), known[name])


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
    return Linearisation(robot, s, phi, m.q, dict(m.conditions), J, S, seen[:, :, 0], constants)


def signatures(robot: Robot, effects: Sequence[Effect], m: Measurements, values: Array) -> tuple[Array, Array, Array]:
    """Columns of the effects, of the base model's parameters and of the joint variables at the measured poses.

    Shapes (n, 3, all effects' parameters), (n, 3, P), (n, 3, joints), at the parameter values given, shape (P,) [SI].
    m : with every condition that the effects need (see `casadical.measurements.derived_columns.derive`)
    """
    found = linearise(robot, m, values)
    return found.columns(effects), found.J, found.Jq


# Factors of up to so many bytes are kept once they were made.
KEPT = 100_000_000


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of effects at poses in units of their parameters' sizes, made when they are asked for.

    linear : the poses; effects : one after the other; sizes : of every parameter, shape (columns,)
    growth : of the sizes, for a robot that leaves more than others do
    first : the columns of the first of the effects, which were made before
    directions : of the parts of effects that have parts (see `combinations`); none until they are asked for
    """

    linear: Linearisation
    effects: tuple[Effect, ...]
    growth: float = 1.0
    first: Columns | None = None
    directions: Directions = ()

    @cached_property
    def sizes(self) -> Array:
        """Realistic size of every parameter, shape (columns,)."""
        known = np.zeros(0) if self.first is None else self.first.sizes
        return np.concatenate([known, [self.growth * size for e in self._own for size, _ in e.sizes().values()]])

    @cached_property
    def held(self) -> Array:
        """One sigma of every parameter once it is in a model, in sizes, shape (columns,)."""
        known = np.zeros(0) if self.first is None else self.first.held
        return np.concatenate([known, [e.held for e in self._own for _ in e.sizes()]])

    @property
    def _own(self) -> tuple[Effect, ...]:
        return self.effects if self.first is None else self.effects[len(self.first.effects) :]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Poses, coordinates, columns."""
        return *self.linear.S.shape[:2], len(self.sizes)

    @cached_property
    def _edges(self) -> Array:
        known = np.zeros(1, dtype=np.int64) if self.first is None else self.first._edges
        return np.concatenate([known, known[-1] + np.cumsum([len(e.sizes()) for e in self._own], dtype=np.int64)])

    @cached_property
    def _parts(self) -> tuple[Part, ...]:
        return plan(self.linear.model, self.effects)

    @cached_property
    def _all(self) -> Factors:
        if self.first is None:
            return self._made(self.linear)
        return self.first._all.before(Columns(self.linear, self._own, self.growth)._all)

    def _made(self, linear: Linearisation) -> Factors:
        return linear.factors(self._parts).scaled(self.sizes)

    @property
    def _few(self) -> bool:
        return 8 * self.shape[0] * self.shape[2] <= KEPT

    def factors(self, poses: Array | slice = EVERY) -> Factors:
        """All columns at some poses as factors of the seams (see `Linearisation.S`)."""
        return self._all.at(poses) if self._few else self._made(self.linear.at(poses))

    def take(self, columns: Array, poses: Array | slice = EVERY, every: Combined | None = None) -> Array:
        """Some of the columns at some poses, shape (poses, 3, len(columns)) [m per unit of size], or combinations."""
        factors = self._factors_of(columns, poses)
        return (factors.combined(every) if every else factors).columns_at(self.linear.S[poses])

    def _factors_of(self, columns: Array, poses: Array | slice) -> Factors:
        if self._few:
            return self._all.only(columns).at(poses)
        some, places = self._owning(columns)
        return some.factors(poses).only(places)

    def _owning(self, columns: Array) -> tuple[Columns, Array]:
        """The columns of those effects that have some columns, and the places of these among them."""
        owners = np.searchsorted(self._edges, columns, side="right") - 1
        used = np.unique(owners)
        some = Columns(self.linear, tuple(self.effects[k] for k in used), self.growth)
        starts = self._edges[used] - some._edges[:-1]
        return some, columns - starts[np.searchsorted(used, owners)]

    def only(self, columns: Array) -> Columns:
        """Some of the columns, in rising order, all those of an effect or none."""
        used = np.unique(np.searchsorted(self._edges, columns, side="right") - 1)
        some = Columns(self.linear, tuple(self.effects[k] for k in used), self.growth)
        some.__dict__["sizes"] = self.sizes[columns]
        if self._few:
            some.__dict__["_all"] = self._all.only(columns)
        return some

    def at(self, poses: Array) -> Columns:
        """The same columns at some of the poses."""
        some = Columns(self.linear.at(poses), self.effects, self.growth, directions=self.directions)
        if self._few:
            some.__dict__["_all"] = self._all.at(poses)
        return some

    def with_directions(self) -> Columns:
        """The same with the directions of all parts; they serve for some of these poses, too."""
        found = []
        for effect, first in zip(self.effects, self._edges.tolist(), strict=False):
            for part in effect.parts.values():
                normal = np.zeros((len(part), len(part)))
                for start in range(0, self.shape[0], BLOCK):
                    poses = slice(start, start + BLOCK)
                    normal += self._factors_of(first + part, poses).products(self.linear.S[poses])
                found.append((first + part, directions_of(normal)))
        more = replace(self, directions=tuple(found))
        if self._few:
            more.__dict__["_all"] = self._all
        return more

    def after(self, column: int) -> Columns:
        """The columns from this one on, with which an effect's columns begin."""
        return Columns(self.linear, self.effects[int(np.searchsorted(self._edges, column)) :], self.growth)

    def plus(self, effects: tuple[Effect, ...], conditions: Mapping[str, Array]) -> Columns:
        """With further effects behind the others; conditions : all logged and derived columns of these poses."""
        linear = replace(self.linear, conditions=dict(conditions))
        return Columns(linear, (*self.effects, *effects), self.growth, self, self.directions)
