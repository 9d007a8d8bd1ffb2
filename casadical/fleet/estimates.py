"""What one campaign tells of a robot, as information on all its parameters: enough to compare it with other campaigns.

The log likelihood is a parabola about the campaign's own values, with information J'J / s^2 and a score. Parameters
that the campaign did not identify have a place in it too, so that campaigns which identified different ones can be
compared; so have the first harmonics of each turning joint's error, which are in no base model and bend the estimates
of two campaigns differently where their poses differ: the lowest may change, the others are fitted in each campaign.

A campaign of 40 poses has little left after such a fit. Where its residuals are small by chance, it would be believed
too much, and a change explained that. How well joints repeat and how large their harmonics are belongs to the robot,
the noise of a coordinate to the instrument: all campaigns tell of these together.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from scipy.special import fdtrc

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.normal_equations import marginalised
from casadical.core.statistics import best_of
from casadical.core.telling.plain import WRITTEN, written
from casadical.core.telling.result import Shown
from casadical.identification.identifiability import scaled_inverse
from casadical.identification.identification import identify
from casadical.identification.misfit import MAX_FITTED_HARMONIC, REPEATABILITY_RATIOS, WideFit, wide_fit
from casadical.identification.remaining_errors import residuals_and_jacobian, uncertain_parameters_of
from casadical.identification.result import Identification
from casadical.measurements.derived_columns import clock_faults
from casadical.measurements.measurements import Measurements, unmeasured
from casadical.robot.remaining_errors import doubted
from casadical.robot.robot import Robot

# Poses that stand for those of a robot file, which does not say which they were.
DRAWN = 200


@dataclass(frozen=True, eq=False)
class Estimate(Shown):
    """What one campaign tells of a robot's parameters.

    robot : as the campaign found it, with harmonics of zero size
    names : parameters that are not known exactly, base and tool among them, k of them
    values : Array, shape (k,) [SI]: about which it is a parabola
    information : Array, shape (k, k): in units of each parameter's scale
    score : Array, shape (k,): slope of the log likelihood at the values
    spread : Array, shape (k,): one sigma before the data, in units of the scale; of the harmonics as the residuals show
        it
    day : when it was measured [d]
    poses : how many were used
    sigma : of a coordinate that nothing explains [m]; None of a robot file
    misfit : how many times wider than independent noise says
    notes : what was assumed
    readings : Array, shape (n, 2): range of each joint in which nine of ten poses lie; of a robot file, in which all do
        [rad or m]
    fit : by which other campaigns may tell of its noise; None of a robot file, and of more than 1000 poses
    freedom : degrees of freedom of sigma
    """

    line: ClassVar[str] = (
        " {{ it.label | repr }}: {{ it.names | length }} parameters from {{ it.poses }} poses"
        "{% if it.sigma is not none %}, {{ (1e3 * it.sigma) | f('.3g') }} mm a coordinate left{% endif %}"
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

    @property
    def date(self) -> str:
        return date_text(self.day)

    @property
    def scale(self) -> Array:
        return np.array([self.robot.parameters[n].scale for n in self.names])

    def about(self, names: tuple[str, ...], values: Array) -> tuple[Array, Array]:
        """Information, (p, p), and score, (p,), at other values [SI], units of scale; all others are fitted again."""
        kept, _, inverse = self.fitted_beside(names)
        own, score = marginalised(self.information, self.score, kept, inverse)
        return own, score + own @ ((self.values[kept] - values) / self.scale[kept])

    def fitted_beside(self, names: Sequence[str]) -> tuple[Array, Array, Array]:
        """Places of these parameters, of all others, and the covariance of the others given these, units of scale."""
        kept = np.array([self.names.index(n) for n in names], dtype=int)
        rest = np.setdiff1d(np.arange(len(self.names)), kept)
        H = self.information[np.ix_(rest, rest)]
        return kept, rest, scaled_inverse(H + np.diag(self.spread[rest] ** -2.0))


def date_text(day: float | None) -> str:
    if day is None or not np.isfinite(day):
        return ""
    return str(np.datetime64("1970-01-01") + np.timedelta64(int(day), "D"))


def estimate(
    campaign: Identification | tuple[Robot, Measurements | Sequence[Measurements]],
    label: str = "",
    day: float | None = None,
) -> Estimate:
    """What measurements of any kind tell of all parameters; day : when they were measured [d].

    campaign : an identification, or a nominal robot and measurements, by which it is identified first
    label : of the campaign; empty: the source of its measurements
    Raises InputError: known distances between touched points, which cannot be compared; ConvergenceError: Ipopt finds
        no optimum.
    """
    identified = campaign if isinstance(campaign, Identification) else identify(*campaign, loss="huber")
    fit = wide_fit(identified)
    unit = fit.best.s2 * fit.misfit
    noted: list[str] = []
    for m in identified.measurements:
        if m.lost:
            rows = ", ".join(map(str, m.lost))
            noted.append(f"{m.source}: row{'s' * (len(m.lost) > 1)} {rows} not used, a reading or a position is empty")
        noted += [*([m.copies_in_words] if m.copies else []), *clock_faults(m)]
    # A campaign of more poses tells its own noise.
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
        fit.left,
        fit.misfit,
        (*_outliers(identified), *noted),
        np.quantile(np.concatenate([m.q for m in identified.used]), [0.05, 0.95], axis=0).T,
        fit if len(fit.poses) <= 1000 else None,
        fit.freedom,
    )


def _outliers(found: Identification) -> Iterator[str]:
    out = found.left_out
    if not out:
        return
    said = f"{len(out)} pose{'s' * (len(out) > 1)} left out as outliers"
    rows = sorted(o.row for o in out)
    (kept, *more) = found.used
    between = kept.row[(kept.row > rows[0]) & (kept.row < rows[-1])]
    # So many outliers one after another are no slips.
    if len(rows) >= 5 and not more and not len(between):
        said += f", rows {rows[0]} to {rows[-1]} one after another: units, tool or set-up changed there"
    yield said


def estimate_of_file(robot: Robot, label: str = "", day: float | None = None) -> Estimate:
    """What a robot file with a covariance of its geometry, as `calibrate --out` writes it, tells of all parameters.

    The file does not say which poses were measured. How parameters that were not identified bend those that were is
    therefore computed at poses drawn from the readings on which it was learnt.

    label : of the campaign; empty: that of the file; day : when it was measured [d]
    Raises InputError: a robot without a covariance of its geometry.
    """
    known = robot.knowledge
    if robot.tool.unknown == "pose":  # the poses drawn below are positions, which do not tell how the tool is turned
        robot = replace(robot, tool=replace(robot.tool, unknown="position"))
    geometry = {p.name for p in robot.parameters if p.group in ("geometry", "loop")}
    if known is None or geometry.isdisjoint(known.std_errors):
        raise InputError(
            f"robot {robot.name!r}: its file has no covariance of the geometry; write it with `casadical calibrate "
            "--out`, or give the folder of the problem"
        )
    drawn = "the learnt range of each joint" if len(known.readings) else "the limits of each joint"
    wide = doubted(robot, MAX_FITTED_HARMONIC)
    solved = [n for n in robot.parameters.names if n in known.std_errors]
    doubts = uncertain_parameters_of(wide, [n for n in solved if n in wide.parameters.names])
    turns = np.arange(DRAWN) % (1 + len(wide.targets))  # of several targets each pose tells one
    measured = {t.column: (turns == k).astype(float) for k, t in enumerate(wide.targets, 1)}
    J = residuals_and_jacobian(wide, [unmeasured(readings_of(robot, DRAWN), measured)], doubts.names)[1]
    J = J[np.isfinite(J).all(axis=(1, 2))].reshape(-1, J.shape[2])  # poses that the robot can take
    at, rest = doubts.solved, np.setdiff1d(np.arange(len(doubts.names)), doubts.solved)
    A = scaled_inverse(J[:, at].T @ J[:, at]) @ (J[:, at].T @ J[:, rest])
    B = np.zeros((len(at), len(doubts.names)))
    B[:, at], B[:, rest] = np.eye(len(at)), A
    names = [doubts.names[k] for k in at]
    scale = np.array([wide.parameters[n].scale for n in names])
    C = np.zeros((len(names), len(names)))
    for block in known.covariance:
        own = block.only(names)
        places = [names.index(n) for n in own.names]
        C[np.ix_(places, places)] = own.matrix
    H = B.T @ scaled_inverse(known.misfit * C / np.outer(scale, scale)) @ B
    note = f"poses are not known: drawn from {drawn}"
    return Estimate(
        wide,
        doubts.names,
        np.array([wide.parameters[n].value for n in doubts.names]),
        (H + H.T) / 2,
        np.zeros(len(H)),
        doubts.sigma,
        label or known.campaign,
        day,
        known.poses,
        misfit=known.misfit,
        notes=(note,),
        readings=known.readings if len(known.readings) else None,
    )


def readings_of(robot: Robot, n: int) -> Array:
    """Readings over the ranges on which a robot was learnt, or its limits, shape (n, joints) [rad or m]."""
    known = robot.knowledge
    low, high = known.readings.T if known and len(known.readings) else robot.limits
    return np.random.default_rng(0).uniform(low, high, (n, robot.n))


# Instruments are others where what they leave differs more than so many times.
OTHER = 3.0


def with_common_noise(campaigns: Sequence[Estimate]) -> list[Estimate]:
    """Campaigns with the noise and harmonics that those by a like instrument show together; robot files as given."""
    estimates = list(campaigns)
    left = [k for k, c in enumerate(campaigns) if c.fit is not None]
    while left:
        group = [k for k in left if _alike(campaigns[left[0]], campaigns[k])]
        left = [k for k in left if k not in group]
        for k, own in zip(group, _together([campaigns[k] for k in group]), strict=True):
            estimates[k] = own
    return estimates


def _alike(a: Estimate, b: Estimate) -> bool:
    """Whether one instrument may have measured both: of few poses the scatter is known badly."""
    (s, f), (t, g) = ((c.sigma or 1e-12, c.freedom or 1.0) for c in (a, b))
    chances = fdtrc(f, g, (s / t / OTHER) ** 2), fdtrc(g, f, (t / s / OTHER) ** 2)
    # So often it may look like that where it is one instrument.
    return min(chances) > 0.01 and _own(a).keys() == _own(b).keys()


def _own(c: Estimate) -> dict[str, int]:
    """Places of the robot's parameters in an estimate: those of the tools, which may be others, are not among them."""
    return {
        n: k
        for k, n in enumerate(c.names)
        if n.startswith("joint_error_curve") or c.robot.parameters[n].group != "tool"
    }


def _together(group: Sequence[Estimate]) -> list[Estimate]:
    wide = [c.fit for c in group if c.fit is not None]
    rhos = repeatability(wide)
    fits = [w.at(rhos) for w in wide]
    weights = [len(w.poses) for w in wide]
    s2 = np.average([f.s2 for f in fits], weights=weights)
    names = list(_own(group[0]))
    at = [[_own(c)[n] for n in names] for c in group]
    mean = np.average([f.variance[k] for f, k in zip(fits, at, strict=True)], axis=0, weights=weights)
    estimates = []
    for c, f, k in zip(group, fits, at, strict=True):
        variance, unit = f.variance.copy(), s2 * c.misfit
        variance[k] = mean
        estimates.append(replace(c, information=f.sums.H / unit, score=-f.sums.g / unit, spread=np.sqrt(variance)))
    return estimates


def repeatability(fits: Sequence[WideFit]) -> tuple[float, ...]:
    """Return the most probable repeatability ratio of each revolute joint by all campaigns [rad/m].

    It is one of REPEATABILITY_RATIOS, a joint's repeatability over the noise of a coordinate.
    """

    def log_likelihood(rhos: tuple[float, ...]) -> float:
        return sum(fit.log_likelihood(rhos) for fit in fits)

    best = best_of(((rho,) * fits[0].joints for rho in REPEATABILITY_RATIOS), log_likelihood, logs=True)
    better = True
    while better:
        better = False
        for j, own in enumerate(best):
            at = REPEATABILITY_RATIOS.index(own)
            for rho in REPEATABILITY_RATIOS[max(0, at - 1) : at] + REPEATABILITY_RATIOS[at + 1 : at + 2]:
                other = (*best[:j], rho, *best[j + 1 :])
                # A joint repeats otherwise than the rest where that makes the campaigns more
                # probable by so much, as a logarithm.
                if log_likelihood(other) > log_likelihood(best) + 2.0:
                    best, better = other, True
    return best
