"""Estimate of a robot from one campaign: a Gaussian log likelihood of all its parameters.

The log likelihood is a parabola about the campaign's own values, with the information matrix J'J /
s^2 and a score. It includes parameters that the campaign did not identify, so that campaigns which
identified different ones can be compared. It also includes harmonics of each revolute joint's
error, which bend the estimates of two campaigns differently where their poses differ: the lowest
orders may change, the others are fitted in each campaign.

After such a fit a campaign of 40 poses has few degrees of freedom. If its residuals are small by
chance, it would be trusted too much, and a change would be found that explains it. Joint
repeatability and the size of the harmonics are therefore estimated from all campaigns of a robot
together, and so is the noise of a coordinate from all campaigns of one instrument.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from scipy.special import fdtrc

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.normal_equations import marginalised, scaled_inverse
from casadical.core.reporting.plain import WRITTEN, written
from casadical.core.reporting.result import Shown
from casadical.core.statistics import best_of
from casadical.identification.identification import identify
from casadical.identification.misfit import MAX_FITTED_HARMONIC, REPEATABILITY_RATIOS, WideFit, wide_fit
from casadical.identification.remaining_errors import residuals_and_jacobian, uncertain_parameters_of
from casadical.identification.result import Identification
from casadical.measurements.derived_columns import clock_faults
from casadical.measurements.measurements import Measurements, unmeasured
from casadical.robot.robot import Robot, with_joint_harmonics


@dataclass(frozen=True, eq=False)
class Estimate(Shown):
    """Information of one campaign on a robot's parameters.

    robot : robot as the campaign identified it, with harmonics of its joints added at zero
    names : names of the k parameters that are not fixed, base and tool among them
    values : values about which the log likelihood is expanded, shape (k,) [SI]
    information : information matrix of the parameters, shape (k, k), in units of their scale
    score : gradient of the log likelihood at the values, shape (k,), in units of scale
    spread : prior standard deviations of the parameters, shape (k,), in units of scale; those of
        the harmonics are estimated from the residuals
    label : name of the campaign
    day : day of the measurement, since 1970 [d]; None: unknown
    poses : number of poses that were used
    sigma : residual standard deviation of a coordinate [m]; None for a robot file
    misfit : factor on the noise variance, at least 1, for residuals that are correlated between
        similar poses
    notes : sentences on assumptions and excluded rows
    readings : lower and upper end of the range of each joint that holds nine of ten poses, for a
        robot file of all poses, shape (joints, 2) [rad or m]; None: unknown
    fit : fit by which noise is pooled over campaigns; None for a robot file, and for more than
        1000 poses
    freedom : degrees of freedom of sigma; None for a robot file
    held_out : of a robot file, the standard deviation of a coordinate of the held-out poses [m] and
        their number; None where it is unknown, and for measurements
    """

    line: ClassVar[str] = (
        " {{ it.label | repr }}: {{ it.names | length }} parameters from {{ it.poses }} poses"
        "{% if it.sigma is not none %}, {{ (1e3 * it.sigma) | f('.3g') }} mm per coordinate of residual{% endif %}"
    )

    robot: Robot
    names: tuple[str, ...]
    values: Array
    information: Array
    score: Array
    spread: Array
    label: str = field(default="", metadata=WRITTEN)
    day: float | None = field(default=None, metadata=WRITTEN)
    poses: int = field(default=0, metadata=WRITTEN)
    sigma: float | None = field(default=None, metadata=written("left", "mm"))
    misfit: float = field(default=1.0, metadata=written(digits=4))
    notes: tuple[str, ...] = field(default=(), metadata=WRITTEN)
    readings: Array | None = None
    fit: WideFit | None = None
    freedom: float | None = None
    held_out: tuple[float, int] | None = None

    @property
    def date(self) -> str:
        """Return the day as an ISO date; empty if it is unknown."""
        return date_text(self.day)

    @property
    def scale(self) -> Array:
        """Return the scale of each parameter: the SI value of its unit in the solver, shape (k,)."""
        return np.array([self.robot.parameters[n].scale for n in self.names])

    def about(self, names: tuple[str, ...], values: Array) -> tuple[Array, Array]:
        """Return information, (p, p), and score, (p,), of p parameters, all others marginalised.

        Both are in units of scale.

        names : the p parameters
        values : values of these parameters at which the score is taken, shape (p,) [SI]
        """
        chosen, _, inverse = self.refitted_given(names)
        own, score = marginalised(self.information, self.score, chosen, inverse)
        return own, score + own @ ((self.values[chosen] - values) / self.scale[chosen])

    def refitted_given(self, names: Sequence[str]) -> tuple[Array, Array, Array]:
        """Return the indices of p parameters, (p,), of the r others, and the others' covariance.

        The covariance, (r, r), is conditional on the p parameters and in units of scale.
        """
        chosen = np.array([self.names.index(n) for n in names], dtype=int)
        rest = np.setdiff1d(np.arange(len(self.names)), chosen)
        H = self.information[np.ix_(rest, rest)]
        return chosen, rest, scaled_inverse(H + np.diag(self.spread[rest] ** -2.0))


def date_text(day: float | None) -> str:
    """Return a day, counted from 1970-01-01 [d], as an ISO date; empty for None and NaN."""
    if day is None or not np.isfinite(day):
        return ""
    return str(np.datetime64("1970-01-01") + np.timedelta64(int(day), "D"))


def estimate(
    campaign: Identification | tuple[Robot, Measurements | Sequence[Measurements]],
    label: str = "",
    day: float | None = None,
) -> Estimate:
    """Return the estimate of all parameters of a robot from measurements of any kind.

    campaign : an identification, or a nominal robot and measurements, by which it is identified
        first
    label : name of the campaign; empty: the source of its measurements
    day : day of the measurement, since 1970 [d]
    Raises InputError: given distances between touched points, which cannot be compared.
    Raises ConvergenceError: Ipopt finds no optimum.
    """
    identified = campaign if isinstance(campaign, Identification) else identify(*campaign, loss="huber")
    fit = wide_fit(identified)
    unit = fit.best.s2 * fit.misfit
    noted: list[str] = []
    if out := identified.left_out:
        noted.append(f"{len(out)} pose{'s' * (len(out) > 1)} left out as outliers")
        rows = sorted(o.row for o in out)
        used, *more = identified.used
        between = used.row[(used.row > rows[0]) & (used.row < rows[-1])]
        # Five or more consecutive outliers show a change of the set-up, not single mistakes.
        if len(rows) >= 5 and not more and not len(between):
            noted[0] += f", rows {rows[0]} to {rows[-1]} one after another: units, tool or set-up changed there"
    for m in identified.measurements:
        if m.lost:
            lost = ", ".join(map(str, m.lost))
            noted.append(f"{m.source}: row{'s' * (len(m.lost) > 1)} {lost} not used, a reading or a position is empty")
        noted += [*([m.copies_in_words] if m.copies else []), *clock_faults(m)]
    # A campaign of more than 1000 poses determines its own noise, so its fit is not stored
    # for pooling.
    return Estimate(
        fit.robot,
        fit.doubts.names,
        np.array([fit.robot.parameters[n].value for n in fit.doubts.names]),
        fit.best.sums.H / unit,
        -fit.best.sums.g / unit,
        np.sqrt(fit.best.variance),
        label or identified.measurements[0].source,
        day,
        len(fit.poses),
        fit.coordinate_sigma,
        fit.misfit,
        tuple(noted),
        np.quantile(np.concatenate([m.q for m in identified.used]), [0.05, 0.95], axis=0).T,
        fit if len(fit.poses) <= 1000 else None,
        fit.freedom,
    )


def estimate_of_file(robot: Robot, label: str = "", day: float | None = None) -> Estimate:
    """Return the estimate of all parameters from a robot file with a covariance of its geometry.

    `calibrate --out` writes such files. They do not contain the measured poses. How unidentified
    parameters bias the identified ones is therefore computed at poses drawn from the joint ranges
    on which the robot was learnt.

    label : name of the campaign; empty: that in the file
    day : day of the measurement, since 1970 [d]
    Raises InputError: a robot without a covariance of its geometry.
    """
    knowledge = robot.knowledge
    if robot.tool.unknown == "pose":  # positions, as below, do not determine the tool's orientation
        robot = robot.with_unknown(tool="position")
    geometry = {p.name for p in robot.parameters if p.group in ("geometry", "loop")}
    if knowledge is None or geometry.isdisjoint(knowledge.std_errors):
        raise InputError(
            f"robot {robot.name!r}: its file has no covariance of the geometry; write it with "
            "`casadical calibrate --out`, or give the folder of the problem"
        )
    drawn = "the learnt range of each joint" if len(knowledge.readings) else "the limits of each joint"
    wide = with_joint_harmonics(robot, MAX_FITTED_HARMONIC)
    solved = [n for n in robot.parameters.names if n in knowledge.std_errors]
    doubts = uncertain_parameters_of(wide, [n for n in solved if n in wide.parameters.names])
    # Number of random poses in place of the measured ones, which a robot file does not store.
    drawn_poses = 200
    turns = np.arange(drawn_poses) % (1 + len(wide.targets))  # each pose measures one of the targets
    measured = {t.column: (turns == k).astype(float) for k, t in enumerate(wide.targets, 1)}
    J = residuals_and_jacobian(wide, [unmeasured(readings_of(robot, drawn_poses), measured)], doubts.names)[1]
    J = J[np.isfinite(J).all(axis=(1, 2))].reshape(-1, J.shape[2])  # poses that the robot can take
    at, rest = doubts.solved, np.setdiff1d(np.arange(len(doubts.names)), doubts.solved)
    names = [doubts.names[k] for k in at]
    scale = np.array([wide.parameters[n].scale for n in names])
    C = np.zeros((len(names), len(names)))
    for block in knowledge.covariance:
        own = block.only(names)
        places = [names.index(n) for n in own.names]
        C[np.ix_(places, places)] = own.matrix
    C = knowledge.misfit * C / np.outer(scale, scale)
    # Priors alone determine some parameters, such as estimated masses. The noise variance
    # [mm^2] is that with which poses like the drawn ones give the file's covariance: with the prior
    # precision P, C (J'J / variance + P) is the identity, whose trace is the number of parameters.
    normal, precision = J[:, at].T @ J[:, at], doubts.sigma[at] ** -2.0
    by_poses = max(len(at) - float(np.diag(C) @ precision), 1.0)
    variance = float((C * normal).sum()) / by_poses
    A = scaled_inverse(normal + variance * np.diag(precision)) @ (J[:, at].T @ J[:, rest])
    B = np.zeros((len(at), len(doubts.names)))
    B[:, at], B[:, rest] = np.eye(len(at)), A
    H = B.T @ scaled_inverse(C) @ B
    note = f"poses are unknown: drawn from {drawn}"
    return Estimate(
        wide,
        doubts.names,
        np.array([wide.parameters[n].value for n in doubts.names]),
        (H + H.T) / 2,
        np.zeros(len(H)),
        doubts.sigma,
        label or knowledge.campaign,
        day,
        knowledge.poses,
        misfit=knowledge.misfit,
        notes=(note,),
        readings=knowledge.readings if len(knowledge.readings) else None,
    )


def readings_of(robot: Robot, n: int) -> Array:
    """Return n random joint variables in a robot's learnt ranges, shape (n, joints) [rad or m].

    A robot without known ranges has its joint limits instead. The seed is fixed.
    """
    knowledge = robot.knowledge
    low, high = knowledge.readings.T if knowledge and len(knowledge.readings) else robot.limits
    return np.random.default_rng(0).uniform(low, high, (n, robot.n))


def exceeds_by_chance(own: tuple[float, float], other: tuple[float, float], ratio: float) -> float:
    """Return the probability that noise alone makes a residual sigma exceed another as it does.

    It is that of an F test: the true sigma is at most `ratio` times the other one.

    own, other : residual sigma of a coordinate, and its degrees of freedom
    """
    return float(fdtrc(own[1], other[1], (own[0] / (ratio * other[0])) ** 2))


# Largest ratio of the residual sigmas of two campaigns that may have been measured by one
# instrument. Between two campaigns an F test decides whether it is exceeded; a campaign and the
# held-out poses of a robot file are compared by the ratio itself.
MAX_SIGMA_RATIO = 3.0
# Smallest number of degrees of freedom with which a campaign determines its own noise.
MIN_FREEDOM = 6


def with_common_noise(campaigns: Sequence[Estimate]) -> list[Estimate]:
    """Return the campaigns with noise and prior spreads pooled over those of one instrument.

    Campaigns of one instrument are recognised by their residuals. Estimates without a fit, as of
    robot files, are returned unchanged. A single campaign that is too small to determine its own
    noise has it from the held-out poses of a robot file, too.
    """
    estimates = list(campaigns)
    ungrouped = [k for k, c in enumerate(campaigns) if c.fit is not None]
    if len(ungrouped) == 1:
        held_out = next((c.held_out for c in campaigns if c.held_out), None)
        estimates[ungrouped[0]] = _with_noise_of_file(campaigns[ungrouped[0]], held_out)
        return estimates
    while ungrouped:
        first, group = campaigns[ungrouped[0]], []
        for k in ungrouped:
            a, b = ((c.sigma or 1e-12, c.freedom or 1.0) for c in (first, campaigns[k]))
            # At a level of 1 %: may their sigmas be those of one instrument?
            chances = (exceeds_by_chance(*pair, MAX_SIGMA_RATIO) for pair in ((a, b), (b, a)))
            if min(chances) > 0.01 and _places_of_robot(first).keys() == _places_of_robot(campaigns[k]).keys():
                group.append(k)
        ungrouped = [k for k in ungrouped if k not in group]
        for k, own in zip(group, _with_pooled_noise([campaigns[k] for k in group]), strict=True):
            estimates[k] = own
    return estimates


def _with_noise_of_file(c: Estimate, held_out: tuple[float, int] | None) -> Estimate:
    """Return a campaign whose noise is pooled with that of a robot file.

    It is unchanged if it has `MIN_FREEDOM` degrees of freedom or more, or much more noise than the
    file, or if the file's is unknown (None).

    held_out : standard deviation of a coordinate of the file's held-out poses [m], and their number
    """
    sigma, freedom = c.sigma or 0.0, c.freedom or 0.0
    # A campaign of six degrees of freedom or more determines its own noise; a much larger noise is
    # that of another instrument, or of an error that the robot file lacks.
    if held_out is None or freedom >= MIN_FREEDOM or sigma > MAX_SIGMA_RATIO * held_out[0]:
        return c
    more = 3.0 * held_out[1]
    pooled = np.average(np.array([sigma, held_out[0]]) ** 2, weights=[freedom, more])
    ratio = sigma**2 / float(pooled)
    note = f"too few poses for its own noise: that of the calibration, {1e3 * held_out[0]:.2g} mm per coordinate"
    return replace(
        c,
        information=ratio * c.information,
        score=ratio * c.score,
        freedom=freedom + more,
        notes=(*c.notes, note),
    )


def _places_of_robot(c: Estimate) -> dict[str, int]:
    """Return the index in `c.names` of each parameter by name, without those of the tool."""
    return {
        n: k
        for k, n in enumerate(c.names)
        if n.startswith("joint_error_curve") or c.robot.parameters[n].group != "tool"
    }


def _with_pooled_noise(group: Sequence[Estimate]) -> list[Estimate]:
    """Return campaigns of one instrument with noise and prior spreads estimated from all of them.

    Information and score are computed anew with the common noise of a coordinate and the common
    joint repeatability. The spreads are root mean squares, weighted by the numbers of poses.
    """
    wide = [c.fit for c in group if c.fit is not None]
    rhos = pooled_repeatability(wide)
    fits = [w.at(rhos) for w in wide]
    weights = [len(w.poses) for w in wide]
    s2 = np.average([f.s2 for f in fits], weights=weights)
    names = list(_places_of_robot(group[0]))
    at = [[_places_of_robot(c)[n] for n in names] for c in group]
    mean = np.average([f.variance[k] for f, k in zip(fits, at, strict=True)], axis=0, weights=weights)
    estimates = []
    for c, f, k in zip(group, fits, at, strict=True):
        variance, unit = f.variance.copy(), s2 * c.misfit
        variance[k] = mean
        estimates.append(replace(c, information=f.sums.H / unit, score=-f.sums.g / unit, spread=np.sqrt(variance)))
    return estimates


def pooled_repeatability(fits: Sequence[WideFit]) -> tuple[float, ...]:
    """Return the ratio of each revolute joint's repeatability to a coordinate's noise [rad/m].

    The ratios are the most probable combination of `REPEATABILITY_RATIOS` for all fits together,
    found by a coordinate search from equal ratios.
    """

    def log_likelihood(rhos: tuple[float, ...]) -> float:
        """Return the log likelihood of all fits together for one ratio per joint."""
        return sum(fit.log_likelihood(rhos) for fit in fits)

    best = best_of(((rho,) * fits[0].joints for rho in REPEATABILITY_RATIOS), log_likelihood, logs=True)
    better = True
    while better:
        better = False
        for j, own in enumerate(best):
            at = REPEATABILITY_RATIOS.index(own)
            for rho in REPEATABILITY_RATIOS[max(0, at - 1) : at] + REPEATABILITY_RATIOS[at + 1 : at + 2]:
                other = (*best[:j], rho, *best[j + 1 :])
                # A joint gets another value than the rest only if this raises the log likelihood by
                # 2.
                if log_likelihood(other) > log_likelihood(best) + 2.0:
                    best, better = other, True
    return best
