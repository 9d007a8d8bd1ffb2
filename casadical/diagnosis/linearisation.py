"""Jacobian columns of the effects: derivative of the measured position by each effect's parameters.

Columns are computed at zero effect by the chain rule at the seams, the insertion points of effects
in the model: a column is the position's derivative by the seam's variables (joint variables, a
twist behind each link, at the base and in the tool, the measured point) times those variables'
derivative by the effect's parameter. The first factor is the same for all effects and is computed
once per pose. The second is a short formula, composed once for all settings of an effect and
evaluated for all poses and settings together.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import WHOLE_AXIS, Columns, Directions, Factors, directions_of
from casadical.diagnosis.formula_cache import Part, plan
from casadical.diagnosis.seams import POSES_PER_CALL, Seams, over_poses, seams_of
from casadical.effects import Effect
from casadical.identification.identification import calibrate_base_model, prepare
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.robot.model import constants_of
from casadical.robot.robot import Robot

# Number of variables, x, y and z, by which effects displace a measured point: the last of a pose.
POINT_VARIABLES = 3
# Character between a condition's name and the index of an additional reading at the same pose.
READING_MARK = "#"


def condition_of_reading(condition: str, turn: int) -> str:
    """Return the name under which a condition is stored for one of several readings at a pose.

    turn : index of the reading, 0 for the first, whose name is unchanged
    """
    return f"{condition}{READING_MARK}{turn}" if turn else condition


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A robot linearised at its seams at the measured poses, from which effects' columns are made.

    robot : calibrated base model, without the candidate effects
    model : derivative functions of the robot's structure, for any pose
    phi : parameters of the robot, shape (P,) [SI]
    q : joint variables of the poses, shape (n, joints) [rad or m]
    conditions : logged and derived columns by name, shape (n,) each
    J : Jacobian of the measured position by the base model's parameters, shape (n, 3, P)
    S : Jacobian of the measured position by all seam variables, shape (n, 3, seams)
    seen : quantities for effects (point, gravity torques, gravity, frames), shape (n, quantities)
    constants : constants of the model (see `constants_of`)
    far : q and seen at the other ends of measurements between two poses, whose seam variables
        follow those of the first ends in S; None for measurements with one end
    further : largest number of additional readings at a pose; each has its own variables of the
        measured point, after all other seam variables, and may have its own conditions (see
        `condition_of_reading`)

    For other kinds of measurement than positions, J and S are derivatives of the measured numbers
    (see `observations`) instead of three coordinates.
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
        """Return the Jacobian of the measured position by the joint variables, (n, 3, joints)."""
        return self.S[:, :, : self.robot.n]

    def at(self, poses: Array | slice) -> Linearisation:
        """Return the linearisation of the poses with these indices."""
        conditions = {name: values[poses] for name, values in self.conditions.items()}
        far = self.far and (self.far[0][poses], self.far[1][poses])
        each = {name: getattr(self, name)[poses] for name in ("q", "J", "S", "seen")}
        return replace(self, conditions=conditions, far=far, **each)

    def columns(self, effects: Sequence[Effect]) -> Array:
        """Return the Jacobian by all effects' parameters, shape (n, 3, parameters) [m per SI unit].

        Raises KeyError for a missing condition (see `derived_columns.derive`).
        """
        return self.factors(plan(self.model, tuple(effects))).columns_at(self.S)

    def factors(self, parts: Sequence[Part], sizes: Array | None = None) -> Factors:
        """Return the derivatives of the seam variables, where effects enter, by their parameters.

        parts : formulas and effects as `plan` returns them
        sizes : units of the parameters, shape (columns,) [SI]; None: SI units
        """
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
        """Yield ((q, seen), first, least, turn) for each end (pose) and each additional reading.

        Seam variable k of it has the index first + k in S; only those with k >= least exist, for an
        additional reading those of the measured point. turn is the index of the reading.
        """
        ends = [(self.q, self.seen)] if self.far is None else [(self.q, self.seen), self.far]
        seams = (self.S.shape[2] - POINT_VARIABLES * self.further) // len(ends)
        for k, end in enumerate(ends):
            yield end, k * seams, 0, 0
        for turn in range(1, self.further + 1):
            yield ends[0], len(ends) * seams + POINT_VARIABLES * turn - seams, seams - POINT_VARIABLES, turn

    def _condition(self, name: str, turn: int) -> Array:
        """Return a condition at reading number `turn` of each stop (from 0), shape (n,).

        It is that of the reading, else that of the pose, else the robot's declared value.
        """
        for own in (condition_of_reading(name, turn), name):
            if own in self.conditions:
                return self.conditions[own]
        values = dict(zip(self.robot.conditions, self.robot.declared, strict=True))
        return np.full(len(self.q), values[name])


def linearise(robot: Robot, m: Measurements, phi: Array) -> Linearisation:
    """Return the robot linearised at the insertion points of effects (seams) at measured poses.

    m : measurements with every condition that the candidate effects need
    phi : the robot's parameters, shape (P,) [SI]
    """
    s, constants = seams_of(robot), constants_of(robot, robot.torque_scale)
    w = m.condition_matrix(robot.conditions, robot.declared)
    J, S, seen = over_poses(s.function, m.q, w, (phi, constants))
    return Linearisation(robot, s, phi, m.q, dict(m.conditions), J, S, seen[:, :, 0], constants)


def signatures(robot: Robot, effects: Sequence[Effect], m: Measurements, values: Array) -> tuple[Array, Array, Array]:
    """Return Jacobians of the measured position by effects, base parameters and joint variables.

    Shapes are (n, 3, all effects' parameters), (n, 3, P) and (n, 3, joints) [m per SI unit], in the
    measuring frame.
    m : measurements with every condition that the effects need (see
        `casadical.measurements.derived_columns.derive`)
    values : the robot's parameters at which they are evaluated, shape (P,) [SI]
    """
    linear = linearise(robot, m, values)
    return linear.columns(effects), linear.J, linear.Jq


def base_jacobian(robot: Robot, clean: Measurements) -> Array:
    """Return the base model's Jacobian at the poses of a campaign, shape (n, 3, P) [m per SI unit].

    It is taken at the values of a calibration of the base model on the campaign.

    robot : nominal robot; clean : campaign without effects
    """
    fit = calibrate_base_model(prepare(robot, clean))
    m, _ = derive(clean, robot.conditions, robot.loads)
    return signatures(robot, (), m, robot.values_of(fit.robot))[1]


def unabsorbed_rms(J: Array, shift: Array) -> float:
    """Return the rms over all coordinates of the part of a shift that the base model cannot absorb.

    J : Jacobian of the base model, shape (n, 3, P), on whose columns the shift is projected
    shift : displacement of each measured point, shape (n, 3) [m]; the result is in its unit
    """
    from scipy.linalg import orth

    A = J.reshape(shift.size, -1)
    # Some columns of the base model are linearly dependent; without a rank threshold they would add
    # arbitrary directions.
    Q = orth(A / np.maximum(np.linalg.norm(A, axis=0), 1e-300), rcond=1e-9)
    remaining = shift.ravel() - Q @ (Q.T @ shift.ravel())
    return float(np.sqrt(np.mean(remaining**2)))


@dataclass(frozen=True, eq=False)
class EffectColumns(Columns):
    """Jacobian columns of effects in units of their parameters' typical sizes, made on demand.

    linear : linearisation at all poses; effects : effects whose columns follow one another
    growth : factor on all sizes, for a robot with larger residuals than the noise grid covers
    first : columns of the first effects, computed before; None without
    directions : observable directions of the effects' parts (see `core.linear_gaussian.columns`);
        empty until `with_directions`
    poses : indices of the linearisation's poses at which the columns are, shape (n,); None for all
    cached : what was computed before: `sizes` and the factors of all columns at all poses
    """

    linear: Linearisation
    effects: tuple[Effect, ...]
    growth: float = 1.0
    first: EffectColumns | None = None
    directions: Directions = ()
    poses: Array | None = None
    cached: dict[str, Any] = field(repr=False, default_factory=dict)

    @property
    def sizes(self) -> Array:
        """Return the typical size of every parameter times `growth`, shape (columns,) [SI]."""
        if "sizes" not in self.cached:
            earlier = np.zeros(0) if self.first is None else self.first.sizes
            own = [self.growth * size for e in self._own for size, _ in e.sizes().values()]
            self.cached["sizes"] = np.concatenate([earlier, own])
        sizes: Array = self.cached["sizes"]
        return sizes

    @cached_property
    def prior_sigma(self) -> Array:
        """Return the prior sigma of each parameter of a cause, in typical sizes, (columns,)."""
        earlier = np.zeros(0) if self.first is None else self.first.prior_sigma
        return np.concatenate([earlier, [e.prior_sigma for e in self._own for _ in e.sizes()]])

    @property
    def _own(self) -> tuple[Effect, ...]:
        """Return the effects after those of `first`."""
        return self.effects if self.first is None else self.effects[len(self.first.effects) :]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Return the number of poses, of measured numbers of a pose, and of columns."""
        n, numbers, _ = self.linear.S.shape
        return n if self.poses is None else len(self.poses), numbers, len(self.sizes)

    def _among_all(self, blocks: Array | slice) -> Array | slice:
        """Return the indices of some of these poses among those of the linearisation."""
        return blocks if self.poses is None else self.poses[blocks]

    @cached_property
    def _edges(self) -> Array:
        """Return the first column of each effect, then the number of columns, (effects + 1,)."""
        earlier = np.zeros(1, dtype=np.int64) if self.first is None else self.first._edges
        return np.concatenate([earlier, earlier[-1] + np.cumsum([len(e.sizes()) for e in self._own], dtype=np.int64)])

    @cached_property
    def _parts(self) -> tuple[Part, ...]:
        """Return the formulas of all effects as groups (see `plan`)."""
        return plan(self.linear.model, self.effects)

    @property
    def _all(self) -> Factors:
        """Return all columns at all poses of the linearisation as cached seam derivatives."""
        if "factors" not in self.cached:
            if self.first is None:
                self.cached["factors"] = self._factors_at(self.linear)
            else:
                own = EffectColumns(self.linear, self._own, self.growth)
                self.cached["factors"] = self.first._all.before(own._all)
        factors: Factors = self.cached["factors"]
        return factors

    def _factors_at(self, linear: Linearisation) -> Factors:
        """Return all columns' seam derivatives at the poses of a linearisation."""
        return linear.factors(self._parts, self.sizes)

    @property
    def _cacheable(self) -> bool:
        """Return whether the seam derivatives at all poses are small enough to cache (100 MB)."""
        return 8 * len(self.linear.q) * self.shape[2] <= 100_000_000

    def factors(self, blocks: Array | slice = WHOLE_AXIS, columns: Array | None = None) -> Factors:
        """Return derivatives of the seam variables by the parameters, in units of their sizes.

        blocks : indices of poses; columns : indices of parameters, None for all
        """
        poses = self._among_all(blocks)
        if not self._cacheable:
            if columns is None:
                return self._factors_at(self.linear.at(poses))
            some, places = self._owning(columns)
            return some._factors_at(some.linear.at(poses)).only(places)
        if columns is None:
            return self._all.at(poses)
        # A slice of poses is a view; what is selected of it is copied.
        sliced = isinstance(poses, slice)
        return self._all.at(poses).only(columns) if sliced else self._all.only(columns).at(poses)

    def levers(self, blocks: Array | slice = WHOLE_AXIS) -> Array:
        """Return the Jacobian of the measured numbers by the seam variables, (poses, 3, seams).

        blocks : indices of poses
        """
        return self.linear.S[self._among_all(blocks)]

    def _owning(self, columns: Array) -> tuple[EffectColumns, Array]:
        """Return all columns of the effects to which some columns belong, and the latter's indices.

        columns : indices of columns, in rising order
        """
        owners = np.searchsorted(self._edges, columns, side="right") - 1
        used = np.unique(owners)
        some = EffectColumns(self.linear, tuple(self.effects[k] for k in used), self.growth, poses=self.poses)
        starts = self._edges[used] - some._edges[:-1]
        return some, columns - starts[np.searchsorted(used, owners)]

    def only(self, columns: Array) -> EffectColumns:
        """Return some of the columns, either all or none of each effect.

        columns : their indices, in rising order
        """
        some, _ = self._owning(columns)
        some.cached["sizes"] = self.sizes[columns]
        if self._cacheable:
            some.cached["factors"] = self._all.only(columns)
        return some

    def at(self, blocks: Array) -> EffectColumns:
        """Return the same columns at the poses with these indices."""
        poses = blocks if self.poses is None else self.poses[blocks]
        if self._cacheable or 2 * len(poses) > len(self.linear.q):
            return replace(self, poses=poses)
        return EffectColumns(self.linear.at(poses), self.effects, self.growth, directions=self.directions)

    def with_directions(self) -> EffectColumns:
        """Return the columns with the observable directions of all parts computed."""
        directions = []
        for effect, first in zip(self.effects, self._edges.tolist(), strict=False):
            for part in effect.parts.values():
                normal = np.zeros((len(part), len(part)))
                for start in range(0, self.shape[0], POSES_PER_CALL):
                    poses = slice(start, start + POSES_PER_CALL)
                    normal += self.factors(poses, first + part).products(self.levers(poses))
                # A direction of a part is unobservable if one size of it moves all poses together
                # by less than this [m].
                directions.append((first + part, directions_of(normal, 3e-9)))
        return replace(self, directions=tuple(directions))

    def plus(self, effects: tuple[Effect, ...], conditions: Mapping[str, Array]) -> EffectColumns:
        """Return the columns with those of additional effects appended.

        conditions : logged and derived columns of all poses by name, shape (n,) each
        """
        linear = replace(self.linear, conditions=dict(conditions))
        return EffectColumns(linear, (*self.effects, *effects), self.growth, self, self.directions, self.poses)
