"""The expected result of an identification, from one linear step at the nominal robot.

The residuals of the step are of noise and of what the model lacks. Their scatter is propagated
through the identified parameters to poses all over the joint ranges (see `pose_search.forecast`):
this is the accuracy to expect of the parameters. What the model lacks adds to it where the poses
were measured, too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from casadical.core.basics import M_PER_MM, Array
from casadical.core.reporting.blocks import Table
from casadical.core.reporting.plain import WRITTEN, Key, written
from casadical.identification.identifiability import drop_poor
from casadical.identification.least_squares import INITIAL_SIGMA_ANGLE_RAD, INITIAL_SIGMA_M, LeastSquares
from casadical.identification.pose_selection import Workspace
from casadical.identification.pose_selection.candidates import draw, expected, scaled_jacobian
from casadical.identification.reduction import independent_parameters
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Outlook:
    """What one method is expected to determine.

    method : name of the method
    names : parameters that will be identified
    unidentifiable : the reason of each parameter that will not be identified, by name
    numbers : number of observed values
    unknowns : number of independent parameters and coordinates of unknown points
    condition : condition number of the scaled Jacobian
    scatter : rms residual of a linear step, of a coordinate or length [m], NaN without degrees of
        freedom
    noise : noise of a coordinate for the forecasts [m]: the given one, else the scatter
    of_points : whether positions were measured, not distances
    errors : expected standard errors of `names` [SI]
    accuracy : expected rms position error over the joint ranges due to the errors of the
        parameters [m], NaN where none is identified
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("unidentifiable"),
        Key("scatter", lambda view: view.scatter if view.enough else None, "mm"),
        Key("expected_held_out_mean", "held_out", "mm"),
        Key("expected_accuracy", lambda view: view.accuracy if view.enough and view.names else None, "mm"),
        Key("std_error", lambda view: dict(zip(view.names, view.errors, strict=True))),
    )

    method: str
    names: tuple[str, ...] = field(metadata=written("identifiable"))
    unidentifiable: Mapping[str, str]
    numbers: int = field(metadata=WRITTEN)
    unknowns: int
    condition: float = field(metadata=WRITTEN)
    scatter: float
    noise: float
    of_points: bool
    errors: Array
    accuracy: float

    @property
    def reasons(self) -> list[Table]:
        """Return a table of the reasons why parameters are not identified, if there are any."""
        rows = [*self.unidentifiable.items()]
        return [Table("", ("not identifiable", "why"), rows)] if rows else []

    @property
    def held_out(self) -> float | None:
        """Return the expected mean position error on other poses like these [m]; None for lengths.

        It is that of three coordinates with this scatter. None, too, where nothing is identified.
        """
        if not (self.enough and self.of_points and self.names):
            return None
        return float(np.sqrt(8 / np.pi) * self.scatter * np.sqrt(1 + self.unknowns / self.numbers))

    @property
    def enough(self) -> bool:
        """Return whether there are more observed values than unknowns."""
        return self.numbers > self.unknowns


def outlook(
    robot: Robot,
    sets: Sequence[Measurements],
    free: Sequence[str],
    method: str,
    noise: float | None = None,
    seed: int = 0,
) -> Outlook:
    """Return what an identification of these parameters from these sets is expected to determine.

    Rows with large residuals (see `_near`) are excluded.

    robot : nominal robot with base and tool frames fitted to the sets
    free : parameters, as of `identify`
    noise : one sigma of a coordinate [m]; None: as the data show
    seed : seed of the poses over the joint ranges
    Raises InputError.
    """
    sigmas = tuple((noise or m.sigma or INITIAL_SIGMA_M, m.sigma_angle or INITIAL_SIGMA_ANGLE_RAD) for m in sets)
    problem = LeastSquares(robot, tuple(sets), robot.parameters.select(free), "linear", False, sigmas)
    independent = independent_parameters(problem)
    problem, r, J = _weighted(problem.with_names(independent.independent))
    near = _near(problem.sets, r, J)
    if not all(rows.all() for rows in near):  # outliers, which calibrate leaves out, too
        sets = [m[np.flatnonzero(rows)] for m, rows in zip(sets, near, strict=True)]
        return outlook(robot, sets, free, method, noise, seed)
    sigmas, spare = problem.sigmas, problem.residual_count - problem.size
    residual = r - J @ np.linalg.lstsq(J, r, rcond=None)[0]
    scatter = float(np.sqrt(residual @ residual / spare)) if spare > 0 else float("nan")
    if find_kind(sets[0].kind).angles:  # the residuals of angles do not concern positions
        lengths, freedom = _parts(problem.sets[0], r, J)[0]
        scatter = float(np.sqrt(lengths / freedom)) if freedom > 0 else float("nan")
    # The scatter in units of sigma has a floor, as data without noise would divide by zero.
    unit = 1.0 if noise or np.isnan(scatter) else max(scatter, 1e-6)
    _, H = problem.gradient(np.zeros(problem.size))
    columns, poor, C = drop_poor([robot.parameters[n] for n in problem.names], H, unit**2)
    identified = tuple(problem.names[k] for k in columns)
    scale, accuracy = np.array([robot.parameters[n].scale for n in identified]), float("nan")
    if identified:  # rms position error over the joint ranges
        task = expected(robot, draw(robot, 200, Workspace(), np.random.default_rng(seed)), {}, "task")
        J = scaled_jacobian(robot, identified, task)
        accuracy = M_PER_MM * float(np.sqrt(np.einsum("kip,pq,kiq->", J, C, J) / len(J)))
    return Outlook(
        method,
        identified,
        {**independent.unidentifiable, **poor},
        problem.residual_count,
        problem.size,
        independent.condition,
        scatter * sigmas[0][0],
        unit * sigmas[0][0],
        all(find_kind(m.kind).lengths == 3 for m in sets),
        np.sqrt(np.diag(C)) * scale,
        accuracy,
    )


def _weighted(problem: LeastSquares) -> tuple[LeastSquares, Array, Array]:
    """Return the problem with estimated sigmas, and its residuals (m,) and Jacobian (m, size).

    Sigmas are estimated of the first set, if it has angles without a stated sigma; all is at
    nominal values. With guessed sigmas, positions would hide angles, or angles positions.
    """
    for _ in range(6):  # until their logarithms change by less than 0.03
        residuals, J = problem.evaluate(np.zeros(problem.size))
        r = np.concatenate([part.ravel() for part in residuals])
        m, (sigma, angle) = problem.sets[0], problem.sigmas[0]
        if not find_kind(m.kind).angles or m.sigma_angle or len(r) <= J.shape[1]:
            break
        (square, length_freedom), (turned, freedom) = _parts(m, r, J)
        if min(freedom, length_freedom) <= 0:
            break
        own = m.sigma or sigma * np.sqrt(square / length_freedom)
        sigmas = (float(own), max(float(angle * np.sqrt(turned / freedom)), 1e-6 * INITIAL_SIGMA_ANGLE_RAD))
        change = abs(np.log(sigmas[1] / angle)) + abs(np.log(sigmas[0] / sigma))
        problem = replace(problem, sigmas=(sigmas, *problem.sigmas[1:]))
        if change < 0.03:
            break
    return problem, r, J


def _near(sets: Sequence[Measurements], r: Array, J: Array) -> list[Array]:
    """Return for each set the mask of the rows with small residuals after a linear step, (n,).

    Small is up to five times the median. All rows count as such where there are too few degrees of
    freedom, or too many rows with large residuals.

    r, J : residuals and Jacobian of all sets, shapes (m,) and (m, size)
    """
    residual = r - J @ np.linalg.lstsq(J, r, rcond=None)[0]
    masks = []
    for m in sets:
        kind = find_kind(m.kind)
        size = len(m) * (kind.lengths + kind.angles)
        own, residual = residual[:size].reshape(len(m), -1)[:, : kind.lengths or None], residual[size:]
        e = np.linalg.norm(own, axis=1)
        near = e <= 5.0 * np.median(e)
        masks.append(near if len(r) > 2 * J.shape[1] and near.mean() > 0.9 else np.ones(len(m), dtype=bool))
    return masks


def _parts(m: Measurements, r: Array, J: Array) -> tuple[tuple[float, float], ...]:
    """Return (sum of squares, degrees of freedom) of residuals of lengths, and those of angles.

    They are those of the first set's residuals after a linear step.

    m : the first set; r, J : residuals and Jacobian of all sets, shapes (m,) and (m, size)
    """
    Q = np.linalg.qr(J)[0]
    residual, free = r - Q @ (Q.T @ r), 1 - (Q**2).sum(axis=1)
    kind = find_kind(m.kind)
    of_set = (len(m), kind.lengths + kind.angles)
    residual, free = (values[: of_set[0] * of_set[1]].reshape(of_set) for values in (residual, free))
    cut = [slice(0, kind.lengths), slice(kind.lengths, None)]
    return tuple((float((residual[:, part] ** 2).sum()), float(free[:, part].sum())) for part in cut)
