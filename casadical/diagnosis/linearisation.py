"""What each effect does to the measured position: its columns of the Jacobian, at zero effect.

The chain rule at the seams: a column is the position's derivative by the seam's variables (joint variables, a twist
behind each link, at the base and in the tool, the measured point) times those variables' derivative by the effect's
parameter. The first factor is the same for all effects and is computed once per pose. The second is a short formula,
composed once for all settings of an effect and evaluated for all poses and settings together.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import EVERY, Combined, Directions, Factors, directions_of
from casadical.diagnosis.formula_cache import Part, plan
from casadical.diagnosis.seams import BLOCK, Seams, over_poses, seams_of
from casadical.effects import Effect
from casadical.measurements.measurements import Measurements
from casadical.robot.model import constants_of
from casadical.robot.robot import Robot

# Variables of the measured point, the last of the seams.
POINT = 3
# Behind a condition's name, before the number of the reading at a pose.
TURN = "#"


def of_turn(condition: str, turn: int) -> str:
    """The name of a condition of a further reading at a pose; of the first, 0, its own."""
    return f"{condition}{TURN}{turn}" if turn else condition


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
        each = {name: getattr(self, name)[poses] for name in ("q", "J", "S", "seen")}
        return replace(self, conditions=conditions, far=far, **each)

    def columns(self, effects: Sequence[Effect]) -> Array:
        """Columns of all parameters of the effects, shape (n, 3, parameters) [m per unit of parameter].

        Raises KeyError for a condition that is not there (see `derived_columns.derive`).
        """
        return self.factors(plan(self.model, tuple(effects))).columns_at(self.S)

    def factors(self, parts: Sequence[Part], sizes: Array | None = None) -> Factors:
        """The same columns as factors of the seams at which they act; parts : of `plan`; sizes : units, (columns,)."""
        n, by_seam = len(self.q), dict[int, list[tuple[Array, Array | float]]]()
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
                        by_seam.setdefault(first + seam, []).append((part.starts + column, factor))
        blocks = []
        for seam, own in sorted(by_seam.items()):
            edges = np.cumsum([0, *(len(columns) for columns, _ in own)]).tolist()
            values = np.empty((edges[-1], n))
            for start, end, (_, factor) in zip(edges[:-1], edges[1:], own, strict=True):
                values[start:end] = factor
            columns = np.concatenate([columns for columns, _ in own])
            if sizes is not None:
                values *= sizes[columns, None]
            blocks.append((seam, columns, values))
        return Factors(tuple(blocks), sum(len(part.starts) * part.width for part in parts))

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
    J, S, seen = over_poses(s.function, m.q, w, (phi, constants))
    return Linearisation(robot, s, phi, m.q, dict(m.conditions), J, S, seen[:, :, 0], constants)


def signatures(robot: Robot, effects: Sequence[Effect], m: Measurements, values: Array) -> tuple[Array, Array, Array]:
    """Columns of the effects, of the base model's parameters and of the joint variables at the measured poses.

    Shapes (n, 3, all effects' parameters), (n, 3, P), (n, 3, joints), at the parameter values given, shape (P,) [SI].
    m : with every condition that the effects need (see `casadical.measurements.derived_columns.derive`)
    """
    linear = linearise(robot, m, values)
    return linear.columns(effects), linear.J, linear.Jq


@dataclass(eq=False)
class Made:
    """What was made of columns: their factors at all poses of the linearisation, and the sizes of their parameters."""

    factors: Factors | None = None
    sizes: Array | None = None


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """Columns of effects at poses in units of their parameters' sizes, made when they are asked for.

    linear : all poses; effects : one after the other; sizes : of every parameter, shape (columns,)
    poses : which of the linearisation's these columns are of, shape (n,); None for all
    growth : of the sizes, for a robot that leaves more than others do
    first : the columns of the first of the effects, which were made before
    directions : of the parts of effects that have parts (see `core.linear_gaussian.columns`); none until they are asked
        for
    """

    linear: Linearisation
    effects: tuple[Effect, ...]
    growth: float = 1.0
    first: EffectColumns | None = None
    directions: Directions = ()
    poses: Array | None = None
    made: Made = field(repr=False, default_factory=Made)

    @property
    def sizes(self) -> Array:
        """Realistic size of every parameter, shape (columns,)."""
        if self.made.sizes is None:
            known = np.zeros(0) if self.first is None else self.first.sizes
            own = [self.growth * size for e in self._own for size, _ in e.sizes().values()]
            self.made.sizes = np.concatenate([known, own])
        return self.made.sizes

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
        n, numbers, _ = self.linear.S.shape
        return n if self.poses is None else len(self.poses), numbers, len(self.sizes)

    def _among_all(self, blocks: Array | slice) -> Array | slice:
        """The numbers of some poses among those of the linearisation."""
        return blocks if self.poses is None else self.poses[blocks]

    @cached_property
    def _edges(self) -> Array:
        known = np.zeros(1, dtype=np.int64) if self.first is None else self.first._edges
        return np.concatenate([known, known[-1] + np.cumsum([len(e.sizes()) for e in self._own], dtype=np.int64)])

    @cached_property
    def _parts(self) -> tuple[Part, ...]:
        return plan(self.linear.model, self.effects)

    @property
    def _all(self) -> Factors:
        if self.made.factors is None:
            if self.first is None:
                self.made.factors = self._factors_at(self.linear)
            else:
                own = EffectColumns(self.linear, self._own, self.growth)
                self.made.factors = self.first._all.before(own._all)
        return self.made.factors

    def _factors_at(self, linear: Linearisation) -> Factors:
        return linear.factors(self._parts, self.sizes)

    @property
    def _few(self) -> bool:
        # Factors of up to so many bytes are kept once they were made.
        return 8 * len(self.linear.q) * self.shape[2] <= 100_000_000

    def factors(self, blocks: Array | slice = EVERY) -> Factors:
        """All columns at some poses as factors of the seams (see `Linearisation.S`)."""
        poses = self._among_all(blocks)
        return self._all.at(poses) if self._few else self._factors_at(self.linear.at(poses))

    def levers(self, blocks: Array | slice = EVERY) -> Array:
        """Derivative by the seams' variables at some poses, shape (poses, 3, seams)."""
        return self.linear.S[self._among_all(blocks)]

    def take(self, columns: Array, blocks: Array | slice = EVERY, every: Combined | None = None) -> Array:
        """Some of the columns at some poses, shape (poses, 3, len(columns)) [m per unit of size], or combinations."""
        factors = self._factors_of(columns, blocks)
        return (factors.combined(every) if every else factors).columns_at(self.levers(blocks))

    def _factors_of(self, columns: Array, blocks: Array | slice) -> Factors:
        poses = self._among_all(blocks)
        if self._few:
            return self._all.only(columns).at(poses)
        some, places = self._owning(columns)
        return some._factors_at(some.linear.at(poses)).only(places)

    def _owning(self, columns: Array) -> tuple[EffectColumns, Array]:
        """The columns of those effects that have some columns, and the places of these among them."""
        owners = np.searchsorted(self._edges, columns, side="right") - 1
        used = np.unique(owners)
        some = EffectColumns(self.linear, tuple(self.effects[k] for k in used), self.growth, poses=self.poses)
        starts = self._edges[used] - some._edges[:-1]
        return some, columns - starts[np.searchsorted(used, owners)]

    def only(self, columns: Array) -> EffectColumns:
        """Some of the columns, in rising order, all those of an effect or none."""
        some, _ = self._owning(columns)
        some.made.sizes = self.sizes[columns]
        some.made.factors = self._all.only(columns) if self._few else None
        return some

    def at(self, blocks: Array) -> EffectColumns:
        """The same columns at some of the poses."""
        poses = blocks if self.poses is None else self.poses[blocks]
        if self._few or 2 * len(poses) > len(self.linear.q):
            return replace(self, poses=poses)
        return EffectColumns(self.linear.at(poses), self.effects, self.growth, directions=self.directions)

    def with_directions(self) -> EffectColumns:
        """The same with the directions of all parts; they serve for some of these poses, too."""
        directions = []
        for effect, first in zip(self.effects, self._edges.tolist(), strict=False):
            for part in effect.parts.values():
                normal = np.zeros((len(part), len(part)))
                for start in range(0, self.shape[0], BLOCK):
                    poses = slice(start, start + BLOCK)
                    normal += self._factors_of(first + part, poses).products(self.levers(poses))
                # A direction of a part is left out if one size of it moves all poses together by
                # less than this [m].
                directions.append((first + part, directions_of(normal, 3e-9)))
        return replace(self, directions=tuple(directions))

    def after(self, column: int) -> EffectColumns:
        """The columns from this one on, with which an effect's columns begin."""
        some = self.effects[int(np.searchsorted(self._edges, column)) :]
        return EffectColumns(self.linear, some, self.growth, poses=self.poses)

    def plus(self, effects: tuple[Effect, ...], conditions: Mapping[str, Array]) -> EffectColumns:
        """With further effects behind the others; conditions : all logged and derived columns of all poses."""
        linear = replace(self.linear, conditions=dict(conditions))
        return EffectColumns(linear, (*self.effects, *effects), self.growth, self, self.directions, self.poses)
