"""Result of an identification: parameters, standard errors, accuracy, predictions."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from casadical.core.basics import M_PER_MM, Array, InputError
from casadical.core.reporting.blocks import Table, Words, mm
from casadical.core.reporting.plain import IN_MM, WRITTEN, Key
from casadical.core.reporting.result import Result
from casadical.identification.accuracy import (
    Accuracy,
    accuracy_of,
    errors,
    predicted,
    residual_mm,
    summarise,
    turn_errors,
)
from casadical.identification.identifiability import Identifiability
from casadical.identification.least_squares import SETTLED_COST_GAIN, LeastSquares, initial_sigmas
from casadical.identification.prediction import covariance, covariance_of_all, redundancies
from casadical.identification.prior import Departure
from casadical.identification.reduction import (
    MAX_OUTLIER_ROUNDS,
    MAX_RESIDUAL_OF_REACH,
    MIN_NOISE_FREEDOM,
    OUTLIER_PROBABILITY,
    solve_without_outliers,
)
from casadical.identification.residuals import Loss, make_block
from casadical.identification.solver import Solution
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements, unmeasured, without_poses
from casadical.robot.robot import Knowledge, Robot, blocks, modified_dh
from casadical.robot.robot_file import to_toml

# The remark on an identified parameter whose standard error is that of its prior, so that the poses
# gave no information on it.
PRIOR_ONLY_REASON = "as the prior has it; these poses tell no more of it"


@dataclass(frozen=True)
class LeftOut:
    """A pose that was excluded as an outlier.

    source : its table; row : its row there; error : of the calibrated model at it, see
        `accuracy.errors` [m]
    column : the one coordinate or reading whose change explains it ("z", "q3"), else ""
    """

    source: str = field(metadata=WRITTEN)
    row: int = field(metadata=WRITTEN)
    error: float = field(metadata=IN_MM)
    column: str = field(default="", metadata=WRITTEN)


def rows_in_words(rows: Sequence[LeftOut], most: int = 8, of: Iterable[str] = ()) -> str:
    """Return row numbers of outliers with errors [mm] as text, with file names if several.

    most : maximum number of rows that are listed; of the others the number is given
    of : names of all files from which they could be
    """
    several = len({*(out.source for out in rows), *of}) > 1
    words = [
        f"{f'{out.source} ' if several else ''}row {out.row} ({mm(out.error)} mm{out.column and f' in {out.column}'})"
        for out in rows[:most]
    ]
    return ", ".join(words) + (f" and {len(rows) - most} more" if len(rows) > most else "")


@dataclass(frozen=True)
class Tried:
    """Result of the test for compliance that the robot file does not declare.

    rigid, compliant : residual standard deviation of a coordinate by each model, same poses [m]
    kept : whether the data support compliance
    outliers : (set, pose) indices of the outliers of the compliant model; None where it did not use
        all poses
    """

    rigid: float = field(metadata=IN_MM)
    compliant: float = field(metadata=IN_MM)
    kept: bool = field(metadata=WRITTEN)
    outliers: tuple[tuple[int, int], ...] | None = ()

    def in_words(self, method: str) -> str:
        """Return a clause with both residuals [mm per coordinate] and the conclusion.

        method : by which the result was identified, "KM" or "SKCM"
        """
        end = "too little for compliance in the model"
        if self.kept:
            end = "compliance is in the model"
        if self.kept and method == "KM":
            end = "the standard errors of KM are too small; SKCM has it"
        return f"rigid joints leave {mm(self.rigid)} mm per coordinate, compliant ones {mm(self.compliant)}: {end}"


@dataclass(frozen=True, eq=False)
class Identification(Result):
    """Result of an identification: what was identified, from what, and how certain it is.

    given : the nominal robot as handed in, with added effects
    start : the same with initial base and tool frames fitted
    robot : the calibrated robot
    measurements : all sets, outliers included
    method : "KM", "SKCM", or "identify" for a user's own choice of parameters
    loss : loss of the residuals
    identifiability : which parameters are independent, which are not and why
    problem : the least squares problem that was solved, without outliers
    solution : point at which the solver stopped
    variance : of a residual, in units of the problem's sigmas squared
    degrees_of_freedom : number of residuals and informative priors minus the number of variables
    outliers : (set, pose) indices of poses that a robust loss excluded
    tried : whether the data support a compliance that the robot file does not declare
    departure : how far the geometry departs from nominal, where the fit chose its own prior

    Examples
    --------
    >>> found.parameters[["name", "value", "std_error", "unit"]].head(2).round(4)
         name     value  std_error unit
    0  tool_x  299.3005     0.0033   mm
    1  tool_y   -2.0832     0.0045   mm
    >>> position, covariance = found.predict(poses.q[:2])
    >>> position.round(3)
    array([[ 0.622,  0.223,  0.   ],
           [-0.394,  0.246,  0.   ]])
    >>> {state: round(1e3 * a.mean, 3) for state, a in found.accuracy(poses).items()}  # mm
    {'nominal': 1.735, 'placed': 1.694, 'calibrated': 0.029}
    >>> found.correlations(above=0.9).shape[1], found.is_optimal()
    (3, True)
    >>> found.to_toml().splitlines()[0]
    '# Calibrated by casadical.'
    """

    line: ClassVar[str] = (
        " {{ it.method }} of {{ it.given.name | repr }}: {{ it.names | length }} parameters from "
        "{{ it.used | map('length') | sum }} poses, {{ it.identifiability.unidentifiable | length }} not identifiable, "
        "{{ (1e3 * it.sigmas | map('first') | max) | f('.3g') }} mm per coordinate remaining"
    )

    derived: ClassVar[tuple[Key, ...]] = (
        Key("verdict"),
        Key("optimal", lambda found: found.is_optimal()),
        Key("condition", "identifiability.condition"),
        Key("degrees_of_freedom"),
        Key("iterations", lambda found: len(found.solution.history) - 1),
        Key("loss"),
        Key("left_out"),
        Key("departure", omit_none=True),
        Key("unknown_places"),
        Key("parameters", "shown"),
        Key("modified_dh", lambda found: modified_dh(found.robot)),
    )

    given: Robot
    start: Robot
    robot: Robot
    measurements: tuple[Measurements, ...]
    method: str
    loss: Loss
    identifiability: Identifiability
    problem: LeastSquares
    solution: Solution
    variance: float
    degrees_of_freedom: int
    outliers: tuple[tuple[int, int], ...] = ()
    tried: Tried | None = None
    departure: Departure | None = None

    def blocks(self) -> list[Words | Table]:
        """Return the verdict and a table of all parameters."""
        rows = [
            (
                str(r["name"]),
                f"{r['nominal']:.4f}",
                f"{r['value']:.4f}",
                f"{r['std_error']:.2g}",
                str(r["unit"]),
                str(r["reason"] or r["status"]),
            )
            for r in self.shown.to_dict("records")
        ]
        head = ("parameter", "nominal", "value", "std error", "unit", "status")
        return [Words(self.verdict), Table("All parameters", head, rows, frozenset({1, 2, 3}), folded=True)]

    @property
    def unknown_places(self) -> list[dict[str, Any]]:
        """Identified places to which distances were measured, such as anchors of wires, for JSON.

        Each has source (the table), name and xyz_mm, its position in the measuring frame.
        """
        places = []
        for label, xyz in self.unknown_points.items():
            k, name = label.split("/", 1)
            m = self.measurements[int(k)]
            if find_kind(m.kind).places:
                places.append({"source": m.source, "name": name, "xyz_mm": [1e3 * float(v) for v in xyz]})
        return places

    def bars(self) -> list[tuple[str, float]]:
        """Return (label, error [m]) of bars: mean and 95th percentile of each set's inliers."""
        each = [(m.kind, summarise(errors(self.robot, m))) for m in self.used]
        return [bar for kind, a in each for bar in ((f"{kind}, mean", a.mean), (f"{kind}, 95 % below", a.p95))]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the identified parameters, errors of estimated masses included."""
        return self.problem.names

    @property
    def identified(self) -> tuple[str, ...]:
        """Names of the identified parameters, without errors of masses that were only estimated."""
        given = self.start.parameters
        return tuple(n for n in self.names if not given[n].guess or given[n].group == "compliance")

    @cached_property
    def estimate(self) -> Array:
        """Estimates of the parameters `names`, shape (p,) [SI]."""
        return np.array(list(self.problem.values(self.solution.v).values()))

    @cached_property
    def covariance(self) -> Array:
        """Covariance of `estimate`, shape (p, p) [SI]; NaN for parameters at a bound."""
        return covariance(self.problem, self.solution.v, self.variance)

    @cached_property
    def standard_errors(self) -> Array:
        """Standard errors of `estimate`, shape (p,) [SI]; NaN for parameters at a bound."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @cached_property
    def knowledge(self) -> Knowledge:
        """Covariance of the calibrated values, and the ranges on which they were learnt."""
        return learnt_from(self, self.given.knowledge or Knowledge())

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """Names of the identified parameters at a bound, except compliances of zero (rigid)."""
        return tuple(n for n in self._stopped if n not in self._rigid)

    @property
    def _stopped(self) -> tuple[str, ...]:
        """Names of the identified parameters at a bound, compliances of zero included."""
        mask = self.problem.at_bounds(self.solution.v)[: len(self.names)]
        return tuple(n for n, stopped in zip(self.names, mask, strict=True) if stopped)

    @property
    def _rigid(self) -> tuple[str, ...]:
        """Names of the identified compliances at their lower bound of zero."""
        own = self.start.parameters
        nearer = {n: 2 * v < own[n].upper for n, v in zip(self.names, self.estimate, strict=True)}
        return tuple(n for n in self._stopped if own[n].group == "compliance" and nearer[n])

    @property
    def used(self) -> tuple[Measurements, ...]:
        """The measurements without outliers, one set per original set."""
        return without_poses(self.measurements, self.outliers)

    @cached_property
    def left_out(self) -> tuple[LeftOut, ...]:
        """The outliers with table, row and error [m], the one with the largest error first."""
        by_set = [[i for place, i in self.outliers if place == k] for k in range(len(self.measurements))]
        out = [row for m, poses in zip(self.measurements, by_set, strict=True) for row in self._outlier_rows(m, poses)]
        return tuple(sorted(out, key=lambda out: -out.error))

    def _outlier_rows(self, m: Measurements, poses: Sequence[int]) -> list[LeftOut]:
        """Return the rows of these outliers among the poses of m, with error and faulty column.

        A column is named if it is the only one of which a change alone leaves no more than noise.
        It is searched for measured positions only, and for the first 20 outliers.
        """
        if not len(poses):
            return []
        e, sigma = errors(self.robot, m), self._noise_of(m)[0]
        columns = dict.fromkeys(poses, "")
        from scipy.special import chdtri

        for i in poses[:20] if m.position is not None else ():  # of more rows no list is read
            one = m[[i]]
            square = residual_mm(self.robot, one)[0] ** 2
            remaining = dict(zip("xyz", square.sum() - square, strict=True))
            for j in range(one.q.shape[1]):
                moved = one
                for _ in range(8):  # Gauss-Newton steps in one reading
                    step = np.eye(one.q.shape[1])[[j]] * 1e-6
                    r = residual_mm(self.robot, moved)[0]
                    slope = (residual_mm(self.robot, replace(moved, q=moved.q + step))[0] - r) / 1e-6
                    moved = replace(moved, q=moved.q - 1e6 * step * (slope @ r) / max(slope @ slope, 1e-12))
                remaining[f"q{j + 1}"] = float((residual_mm(self.robot, moved)[0] ** 2).sum())
            # Two coordinates remain, which noise alone makes larger once in a thousand.
            enough = [name for name, rest in remaining.items() if rest < chdtri(2, 1e-3) * (1e3 * sigma) ** 2]
            columns[i] = enough[0] if len(enough) == 1 else ""
        return [LeftOut(m.source, int(m.row[i]), float(e[i]), columns[i]) for i in poses]

    def _noise_of(self, m: Measurements) -> tuple[float, float]:
        """Return noise of coordinate [m] and angle [rad] of m's table; largest if not fitted."""
        own = (s for s, fitted in zip(self.sigmas, self.measurements, strict=True) if fitted.source == m.source)
        return next(own, max(self.sigmas))

    def without_outliers(self, m: Measurements) -> tuple[Measurements, list[LeftOut]]:
        """Return poses that were not fitted without those that this model calls outliers, and these.

        The bound is that of fitted poses (`outlier_masks`): noise alone exceeds it with
        OUTLIER_PROBABILITY. Noise is that of the fit or of these poses, whichever is larger; the
        uncertainty of a predicted position widens it. Where more than a fifth, and more than one,
        would be outliers, none is: then the model errs, not the rows.
        """
        from scipy.special import chdtri

        out = np.zeros(len(m), dtype=bool)
        numbers = find_kind(m.kind).lengths
        turns = turn_errors(self.robot, m)
        judged = [(errors(self.robot, m), numbers, 0), *([(turns, 3, 1)] if turns is not None else [])]
        for e, freedom, k in judged:
            z = (e / max(self._noise_of(m)[k], 1e-8)) ** 2  # data without noise have that of rounding
            bound = chdtri(freedom, OUTLIER_PROBABILITY) * max(1.0, float(np.median(z) / chdtri(freedom, 0.5)))
            far = np.flatnonzero(z > bound)
            if k == 0 and m.position is not None and len(far):
                some = m[far]
                C = self.predict(some.q, some.conditions)[1]
                far = far[z[far] > bound * (1 + np.trace(C, axis1=1, axis2=2) / 3 / self._noise_of(m)[0] ** 2)]
            out[far] = True
        if out.sum() > max(1, 0.2 * len(m)):
            out[:] = False
        return m[np.flatnonzero(~out)], self._outlier_rows(m, [int(i) for i in np.flatnonzero(out)])

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the tables of measurements."""
        return tuple(m.source for m in self.measurements)

    @property
    def unknown_points(self) -> dict[str, Array]:
        """Identified unknown points, label -> position in the measuring frame, shape (3,) [m].

        A label is "set index/point name", such as "0/A".
        """
        _, u = self.problem.separate(self.solution.v)
        return dict(zip(self.problem.labels, self.problem.points + M_PER_MM * u, strict=True))

    @property
    def sigmas(self) -> tuple[tuple[float, float], ...]:
        """Noise standard deviations (coordinate [m], angle [rad]) of each set by the residuals."""
        scale = float(np.sqrt(self.variance))
        return tuple((s * scale, a * scale) for s, a in self.problem.sigmas)

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """A row per parameter, with its estimate, 95 % interval and status.

        The columns are name, group, nominal, value, std_error, low, high (95 %), unit, status
        (identified, at bound, not identifiable, held), reason; values are in `unit` (mm, deg, ...),
        errors and interval NaN unless identified. Where an identified one has the standard error of
        its prior, the reason says so.
        """
        from scipy.special import stdtrit

        quantile = stdtrit(max(1, self.degrees_of_freedom), 0.975)
        reasons = self.identifiability.unidentifiable
        place_of = {name: k for k, name in enumerate(self.names)}
        before = {p.name: p.prior for p in self.start.parameters if p.guess}
        before |= {name: sigma for name, (_, sigma) in self.problem.given.items()}
        blocks = self.problem.correlated
        before |= {n: np.sqrt(v) for names, C in blocks for n, v in zip(names, np.diag(C), strict=True)}
        rows = []
        for p in self.start.parameters:
            nominal = p.readable(p.value)
            value, error, status, reason = nominal, np.nan, "held", "not asked for"
            if p.name in place_of:
                k = place_of[p.name]
                value, error = p.readable(self.estimate[k]), p.readable(self.standard_errors[k])
                status, reason = ("at bound", "its bound stops it") if p.name in self._stopped else ("identified", "")
                if p.name in self._rigid:
                    reason = "zero, the least: no compliance shows"
                # At this share of the prior's standard error, the data added no information.
                if self.standard_errors[k] >= 0.98 * before.get(p.name, np.inf):
                    reason = PRIOR_ONLY_REASON
            elif p.name in reasons:
                status, reason = "not identifiable", reasons[p.name]
            low, high = value - quantile * error, value + quantile * error
            rows.append((p.name, p.group, nominal, value, error, low, high, p.readable_unit, status, reason))
        columns = ["name", "group", "nominal", "value", "std_error", "low", "high", "unit", "status", "reason"]
        return pd.DataFrame(rows, columns=columns)

    @property
    def shown(self) -> pd.DataFrame:
        """`parameters` without the rows of effects that are summarised, as joint_error_curve is."""
        return self.parameters[self.parameters["name"].isin(self.start.shown)].reset_index(drop=True)

    def correlations(self, above: float = 0.95) -> pd.DataFrame:
        """Return the pairs of strongly correlated estimates, the strongest first.

        above : absolute correlation above which a pair is listed
        Returns one row per pair, with the columns parameter, with (both names) and correlation.
        """
        C = self.covariance / np.outer(self.standard_errors, self.standard_errors)
        i, j = np.nonzero(np.tril(np.abs(C) > above, -1))
        pairs = pd.DataFrame(
            {"parameter": np.array(self.names)[i], "with": np.array(self.names)[j], "correlation": C[i, j]}
        )
        return pairs.sort_values("correlation", key=np.abs, ascending=False, ignore_index=True)

    @cached_property
    def noise_is_assumed(self) -> bool:
        """Whether the noise is neither declared for all sets nor determined by the residuals.

        With a correlated prior, few poses leave too few degrees of freedom to estimate it. Without
        such a prior it is False.
        """
        problem = self.problem
        if not problem.correlated or all(m.sigma for m in problem.sets):
            return False
        return float(redundancies(problem, self.solution.v).sum()) < MIN_NOISE_FREEDOM

    def predict(self, q: Array, conditions: Mapping[str, Array] | None = None) -> tuple[Array, Array]:
        """Return positions of the calibrated robot and their covariances, in the measuring frame.

        Shapes (n, 3) [m] and (n, 3, 3) [m^2]. The covariance is that of the model's position; a new
        measurement adds its own noise. It includes the parameters that were not identified, by
        their covariance in the robot's file or else by their priors, times a factor that follows
        from the departures that the poses do determine (see `prediction`).

        q : joint variables, shape (n, joints) [rad or m]
        conditions : logged columns by name, each of shape (n,); others are as declared
        """
        q = np.atleast_2d(q)
        m = unmeasured(q, conditions)
        p, _ = predicted(self.robot, m)
        problem, x, C = self._everything
        block = make_block(self.start, m, problem.names, 1.0, 1.0, np.zeros((0, 3)), np.zeros(len(q), int))
        J = block.evaluate(x, np.zeros((0, 3)))[1] / problem.scale
        return p, J @ C @ J.transpose(0, 2, 1)

    @cached_property
    def _everything(self) -> tuple[LeastSquares, Array, Array]:
        """Problem, departures [units of scale] and covariance [SI] of all uncertain parameters."""
        return covariance_of_all(self.problem, self.solution.v, self.variance, self.given)

    def accuracy(self, *m: Measurements | Sequence[Measurements]) -> dict[str, Accuracy]:
        """Return error statistics of the "nominal", "placed" and "calibrated" robot, by this name.

        They are those of any measurements. Placed is the nominal robot with base and tool fitted.

        *m : those of the identification or others; of several sets, as a problem has them, the
            figures are over all
        """
        sets = [part for given in m for part in ((given,) if isinstance(given, Measurements) else given)]
        robots = {"nominal": self.given, "placed": self.placed, "calibrated": self.robot}
        return {state: accuracy_of(r, sets) for state, r in robots.items()}

    @cached_property
    def placed(self) -> Robot:
        """The given robot with only its base and tool frames fitted to the used poses.

        It is the robot "before calibration" with which the calibrated one is compared; `start`
        where these poses do not determine the frames.
        """
        return self.placed_fit[0]

    @cached_property
    def placed_fit(self) -> tuple[Robot, tuple[str, ...], Array]:
        """Robot `placed`, names of its fitted parameters, and their covariance, (p, p) [SI]."""
        nothing = self.start, (), np.zeros((0, 0))
        groups = [g for g in ("base", "tool") if g in self.given.parameters.groups]
        if not groups:
            return nothing
        names = self.start.parameters.select(groups)
        used = tuple(replace(m, noise=own.noise) for m, own in zip(self.used, self.problem.sets, strict=True))
        free = LeastSquares(self.start, used, names, self.loss, False, initial_sigmas(used))
        try:
            (problem, solution, _), _ = solve_without_outliers(free, MAX_OUTLIER_ROUNDS, None)
        except InputError:  # relative measurements do not determine the frames
            return nothing
        C = covariance(problem, solution.v, problem.variance(solution.v, trimmed=True))
        return self.start.with_values(problem.values(solution.v)), problem.names, C

    def is_optimal(self) -> bool:
        """Return whether no step within the bounds lowers the cost, recomputed from the data.

        A Gauss-Newton step does not count if it reduces the cost (half of chi-squared) by less than
        1e-4 per variance, which is about 1 % of a standard error; with guesses by 0.01.
        """
        tolerance = 2 * SETTLED_COST_GAIN if self.problem.guesses.any() else 1e-4
        round_off = 1e-12 * self.problem.cost(np.zeros(self.problem.size))
        return self.problem.decrement(self.solution.v) < tolerance * self.variance + round_off

    def to_toml(self) -> str:
        """Return the calibrated robot as the text of a robot file that `read_robot` reads."""
        return to_toml(self.robot, f"Calibrated by casadical.\n{self.verdict}", reproducible=True)

    @property
    def dh_table(self) -> pd.DataFrame:
        """The corrected modified DH table, a row per joint, in millimetres and degrees."""
        return pd.DataFrame(modified_dh(self.robot))

    @property
    def verdict(self) -> str:
        """Sentence with method and numbers of identified and other parameters and of used poses.

        Warnings follow where they apply (parameters at bounds, outliers, a model that does not
        fit), then the solver's message as a sentence.
        """
        used = sum(len(m) for m in self.measurements) - len(self.outliers)
        masses = len(self.names) - len(self.identified)
        text = (
            f"{self.method}: {len(self.identified)} parameters identified from {used} poses, "
            f"{len(self.identifiability.unidentifiable)} not identifiable"
        )
        if masses:
            text += f", {masses} of the estimated masses as far as their priors leave open"
        if self.tried:
            text += f"; {self.tried.in_words(self.method)}"
        if self.at_bounds:
            text += f"; AT BOUNDS: {', '.join(self.at_bounds)} - widen the bounds or doubt the model"
        if self.outliers:
            text += f"; left out as outliers: {rows_in_words(self.left_out, of=self.sources)}"
        largest_sigma = max(sigma for sigma, _ in self.sigmas)
        if largest_sigma > MAX_RESIDUAL_OF_REACH * self.robot.reach:
            text += (
                f"; THE MODEL DOES NOT FIT: {1e3 * largest_sigma:.3g} mm remain - check joint signs, zeros and units"
            )
        return f"{text}. {self.solution.message}"


def learnt_from(found: Identification, before: Knowledge) -> Knowledge:
    """Return covariance and ranges of validity of the calibrated values of an identification.

    Parameters that were not identified have their earlier knowledge. Ranges (of joint variables and
    logged columns) and campaign are those of these measurements without outliers, but those of
    `before` if the robot has effects of which no parameter was identified.

    before : knowledge of the robot that was given
    """
    labels = {e.label for e in found.robot.effects}
    groups = [found.robot.parameters[name].group for name in found.names]
    owners = [group if group in labels else "" for group in groups]
    remaining = before.without(found.names)
    own = blocks(found.names, owners, found.covariance)
    if labels and not any(owners):
        return replace(remaining, covariance=(*own, *remaining.covariance))
    sets = found.problem.sets
    q = np.concatenate([m.q for m in sets])
    columns = (*found.robot.conditions, *(c for e in found.robot.effects for c in e.needs))
    logged = {c: [m.conditions[c] for m in sets if c in m.conditions] for c in columns}
    ranges = {c: (float(min(map(min, v))), float(max(map(max, v)))) for c, v in logged.items() if v}
    readings = np.column_stack([q.min(axis=0), q.max(axis=0)])
    return Knowledge((*own, *remaining.covariance), ", ".join(m.source for m in sets), len(q), readings, ranges)
