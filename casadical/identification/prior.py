"""Results of one campaign as the prior of the next one.

Base and tool frames are fitted again: they belong to the campaign. Values learnt earlier become
prior means; their covariance is widened, as the robot may have changed. Frozen, the values are
fixed. A covariance of the robots of one type is taken unchanged: it already contains how they
differ.

Without an earlier campaign, the prior follows from how far the arm departs from its nominal
geometry: by normal errors of one size s, lengths [mm] and angles [mrad] in proportion (both one
unit of `Parameter.scale`). The posterior of s and of the noise, over a grid and with all parameters
integrated out, follows from the linearised fit: a hierarchical model; Gelman et al., Bayesian Data
Analysis (2013), chapter 5, and MacKay (1992), "Bayesian interpolation". The estimate averaged over
s shrinks the free one along each eigenvector of the information; one prior standard deviation with
the same sum of shrinkage factors stands for it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.noise import log_gain
from casadical.core.linear_gaussian.normal_equations import marginalised, scaled_inverse
from casadical.core.reporting.plain import WRITTEN, Key, plain
from casadical.core.reporting.result import Shown
from casadical.effects import Effect
from casadical.identification.least_squares import FRAME_GROUPS, LeastSquares
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Knowledge, Robot

# Factor on the variances of a prior from another campaign: they come from the scatter within that
# campaign, which does not contain the differences between campaigns.
PRIOR_VARIANCE_FACTOR = 1.5
# Standard deviation of a parameter's change between campaigns, as a share of its scale (of
# geometry: 1 mm or 1 mrad).
CHANGE_SIGMA_OF_SCALE = 0.1


def probability_of_change(log_likelihood_ratio: float) -> float:
    """Return the posterior probability that something changed between two campaigns.

    Its prior probability is 0.1.

    log_likelihood_ratio : natural logarithm of the likelihood ratio of a change against none
    """
    odds_against = (1 - 0.1) / 0.1
    return float(1 / (1 + odds_against * np.exp(-np.clip(log_likelihood_ratio, -500, 500))))


@dataclass(frozen=True, eq=False)
class Prior(Shown):
    """The prior of parameters from another campaign of the robot, or from robots of its type.

    free : names of all its parameters, which are to be identified
    means : name -> (mean, one sigma) [SI]
    covariances : names and covariance [SI] of each group of correlated parameters
    labels : of the effects that were taken over
    knowledge : covariance and ranges of validity of the robot file that they come from
    frozen : whether the parameters are fixed at their values (then free, means and covariances are empty)
    """

    line: ClassVar[str] = (
        " of {{ it.labels | join(', ') or 'geometry and compliance' }}: "
        "{% if it.frozen %}frozen{% else %}{{ it.free | length }} parameters{% endif %}"
    )

    derived: ClassVar[tuple[Key, ...]] = (
        Key("campaign", "knowledge.campaign"),
        Key("effects", "labels"),
        Key("parameters", lambda prior: len(prior.free)),
        Key("frozen"),
    )

    free: tuple[str, ...] = ()
    means: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    covariances: tuple[tuple[tuple[str, ...], Array], ...] = ()
    labels: tuple[str, ...] = ()
    knowledge: Knowledge = field(default_factory=Knowledge)
    frozen: bool = False

    def widened(self, wide: Mapping[str, float]) -> Prior:
        """Return the prior with mean zero and no correlation for some parameters.

        wide : names of these parameters -> new standard deviation [SI]
        """
        rest = ([k for k, name in enumerate(names) if name not in wide] for names, _ in self.covariances)
        covariances = (
            (tuple(names[k] for k in at), matrix[np.ix_(at, at)])
            for at, (names, matrix) in zip(rest, self.covariances, strict=True)
        )
        means = {**self.means, **{name: (0.0, sigma) for name, sigma in wide.items()}}
        return replace(self, means=means, covariances=tuple(block for block in covariances if block[0]))

    def uncovered(self, sets: Sequence[Measurements]) -> dict[str, float]:
        """Return the share of poses (0 to 1) outside of each range on which the prior was learnt.

        The keys are joints ("q1", ...) and logged columns that the sets have.
        """
        of = {f"q{j}": (ends, [m.q[:, j - 1] for m in sets]) for j, ends in enumerate(self.knowledge.readings, 1)}
        for name, ends in self.knowledge.conditions.items():
            of[name] = ends, [m.conditions[name] for m in sets if name in m.conditions]
        columns = {name: (ends, np.concatenate(logged)) for name, (ends, logged) in of.items() if logged}
        return {name: float(np.mean((x < low) | (x > high))) for name, ((low, high), x) in columns.items()}

    def refuse_uncovered(self, sets: Sequence[Measurements]) -> None:
        """Refuse frozen values where joints or logged columns are outside of the prior's ranges.

        Raises InputError, also for a prior without ranges of joint variables.
        """
        if not len(self.knowledge.readings):
            raise InputError(
                "frozen: the prior's file does not say on which readings it was learnt ([learnt.readings]); use it as "
                "a prior instead"
            )
        if beyond := _shares_in_words(self.uncovered(sets)):
            raise InputError(
                f"frozen: poses outside of the ranges that {self.knowledge.campaign or 'the prior'} covers: {beyond}; "
                "frozen values are allowed inside these ranges only: use them as a prior instead"
            )

    def learnt_from(self, sets: Sequence[Measurements]) -> bool:
        """Return whether the prior seems to have been learnt from these measurements.

        They have a source in common and contain its extreme joint variables.
        """
        theirs = self.knowledge.readings
        if not len(theirs) or not {m.source for m in sets} & set(self.knowledge.campaign.split(", ")):
            return False
        q = np.concatenate([m.q for m in sets])
        # Readings that differ by less [rad or m] are equal.
        return all(np.abs(q[:, j] - end).min() < 1e-9 for j, ends in enumerate(theirs) for end in ends)

    def in_words(self, sets: Sequence[Measurements]) -> str:
        """Return sentences on what was taken over, how, and whether the poses are in its ranges."""
        what = ", ".join(self.labels) or "geometry and compliance"
        source = f"Prior from {self.knowledge.campaign or 'another campaign'}: {what}"
        if self.learnt_from(sets):
            source = (
                "The prior seems to have been learnt from these very measurements: they count twice, and all standard "
                f"errors are too small; use it with a later campaign. {source}"
            )
        if self.frozen:
            return f"{source} held at the values found there."
        text = f"{source}; {len(self.free)} parameters are free about the values found there, "
        text += (
            f"as far as {self.knowledge.robots} robots of the type differ."
            if self.knowledge.robots
            else f"variances widened {PRIOR_VARIANCE_FACTOR:g} times and by {100 * CHANGE_SIGMA_OF_SCALE:g} % of the "
            "usual size of each."
        )
        if beyond := _shares_in_words(self.uncovered(sets)):
            return f"{text} Poses outside of the ranges that it covers: {beyond}."
        covered = " These poses lie in the ranges that it covers: --frozen would take the values as they are."
        return text + (covered if len(self.knowledge.readings) else "")

    def to_json(self, sets: Sequence[Measurements]) -> dict[str, Any]:
        """Return the prior for JSON, with the shares of poses outside of its ranges.

        Keys: campaign, effects (labels), parameters (number of free ones), frozen (whether all are
        fixed), same_data (see `learnt_from`) and uncovered (joint or column -> share, 0 to 1).
        """
        uncovered = {name: round(share, 4) for name, share in self.uncovered(sets).items()}
        return {**plain(self), "same_data": self.learnt_from(sets), "uncovered": uncovered}


def _shares_in_words(uncovered: Mapping[str, float]) -> str:
    """Return the positive shares of uncovered poses as text in %; empty if all are zero.

    uncovered : joint or logged column -> share, 0 to 1
    """
    return ", ".join(f"{name} {100 * share:.3g} %" for name, share in uncovered.items() if share > 0)


def carry_over(
    robot: Robot, other: Robot, parts: Collection[str] = ("effects",), *, frozen: bool = False
) -> tuple[Robot, Prior]:
    """Return the robot with another campaign's effects and values, and these values as a prior.

    other : the same robot as it was identified then, with effects or covariances
    parts : "effects" (those that do not depend on time or warm-up), names or labels of single
        effects, and "all" for geometry and compliance too
    frozen : whether the values are fixed; the prior then has none to identify
    Raises InputError for another robot, names that are not there, values that are not finite, and,
    unless frozen, a result without a covariance or with a variance of zero.
    """
    refuse_another(robot, other, "prior")
    effects = _chosen_effects(other, parts)
    labels = tuple(e.label for e in effects)
    whole = "all" in parts
    knowledge = other.knowledge or Knowledge()
    model = robot.with_only(e for e in robot.effects if e.label not in labels).with_effect(*effects)
    theirs = {p.name: p for p in other.parameters}
    taken = [p for p in model.parameters if p.group in labels or (whole and p.group not in FRAME_GROUPS)]
    taken = [p for p in taken if p.name in theirs]
    model = model.with_values({p.name: theirs[p.name].value for p in taken})
    if frozen:
        remaining = knowledge.without(set(knowledge.std_errors) - {p.name for p in taken})
        return replace(model, knowledge=remaining), Prior(labels=labels, knowledge=knowledge, frozen=True)
    lost = [label for label in labels if not any(name.startswith(f"{label}.") for name in knowledge.std_errors)]
    if lost or not knowledge.std_errors:
        raise InputError(
            f"prior {other.name!r}: covariance: nothing says how well {lost[0] if lost else 'anything'} is known; "
            "identify it with casadical, which writes [[covariance]] or std_error, or take it frozen"
        )
    sizes = {p.name: p.scale for p in taken}
    # The robot may have changed since an earlier campaign: the covariance is widened.
    factor, change_share = (1.0, 0.0) if knowledge.robots else (PRIOR_VARIANCE_FACTOR, CHANGE_SIGMA_OF_SCALE)
    covariances: tuple[tuple[tuple[str, ...], Array], ...] = ()
    for block in (block.only(sizes) for block in knowledge.covariance):
        variances = np.diag(block.matrix)
        if not (variances > 0).all():
            zero = block.names[int(np.argmin(variances))]
            raise InputError(
                f"prior: covariance: the variance of {zero} is zero; it must be positive, or take it frozen"
            )
        change = change_share * np.array([sizes[name] for name in block.names])
        covariances += ((block.names, factor * block.matrix + np.diag(change**2)),) if block.names else ()
    errors = {name: float(s) for names, C in covariances for name, s in zip(names, np.sqrt(np.diag(C)), strict=True)}
    means = {p.name: (theirs[p.name].value, errors.get(p.name, p.prior)) for p in taken}
    return model, Prior(tuple(means), means, covariances, labels, knowledge)


def _chosen_effects(other: Robot, parts: Collection[str]) -> tuple[Effect, ...]:
    """Return the effects of the other robot that `parts` names, in its order."""
    lasting = [e for e in other.effects if not any(c.startswith(("progress", "warmth")) for c in e.conditions)]
    effects = lasting if {"effects", "all"} & set(parts) else []
    for word in parts:
        hit = [e for e in other.effects if word in (e.name, e.label)]
        if not hit and word not in ("effects", "all"):
            raise InputError(
                f"prior {other.name!r}: no effect {word!r}; allowed: effects, all, "
                f"{', '.join(e.label for e in other.effects) or 'and it has no effects'}"
            )
        effects = [*effects, *(e for e in hit if e not in effects)]
    if not effects and "all" not in parts:
        raise InputError(
            f"prior {other.name!r}: it has no effects that last beyond their campaign; write 'all' for its geometry, "
            "or name the effect"
        )
    return tuple(effects)


def refuse_another(robot: Robot, other: Robot, what: str) -> None:
    """Refuse another robot that cannot be the same one in the same convention and units.

    what : word for the other one in messages
    Raises InputError unless number and kinds of joints are equal, and the geometry agrees within
    the parameters' bounds.
    """
    if other.n != robot.n:
        raise InputError(
            f"{what} {other.name!r} has {other.n} joints, robot {robot.name!r} has {robot.n}; it must be the same robot"
        )
    for i, (ours, kind) in enumerate(zip(robot.joints, (j.kind for j in other.joints), strict=True), 1):
        if ours.kind != kind:
            raise InputError(f"{what} {other.name!r}: joint {i} is {kind}, of robot {robot.name!r} {ours.kind}")
    same = [p for p in robot.parameters if p.group in ("geometry", "loop")]
    values = {p.name: p.value for p in other.parameters}
    lengths = [p.value / values[p.name] for p in same if p.unit == "m" and values.get(p.name) and p.value]
    ratio = float(np.median(lengths)) if lengths else 1.0
    for p in same:
        apart = values.get(p.name, np.inf) - p.value
        if p.unit == "rad" and np.isfinite(apart):  # angles are equal modulo a turn
            apart = (apart + np.pi) % (2 * np.pi) - np.pi
        if abs(apart) > p.upper - p.value:
            theirs = f"{p.readable(values[p.name]):.6g}" if p.name in values else "missing"
            why = "it is another robot, or in another convention (modified, standard) or with other zeros of the joints"
            if max(ratio, 1 / ratio) > 900:
                why = f"its lengths differ by a factor of {max(ratio, 1 / ratio):.3g}: its units are wrong"
            allowed = p.readable(p.upper - p.value)
            raise InputError(
                f"{what} {other.name!r}: {p.name} is {theirs} {p.readable_unit}, of robot {robot.name!r} "
                f"{p.readable(p.value):.6g}; they may differ by {allowed:.6g}: {why}"
            )


# Groups of parameters whose nominal values a drawing of the arm gives.
DRAWN_GROUPS = ("geometry", "loop")
# Grid of sizes s of departures [mm for lengths, mrad for angles]; the first one stands for none.
SIZE_GRID = np.array([1e-3, *np.geomspace(0.01, 20.0, 68)])
# Prior probability that the arm does not depart from its drawing; the other sizes are equally
# probable.
PRIOR_PROBABILITY_OF_NONE = 0.3


@dataclass(frozen=True)
class Departure(Shown):
    """How far an arm departs from its nominal geometry: root mean square s of all departures.

    size : posterior median of s [mm for lengths, mrad for angles]
    low, high : 95 % interval [mm, mrad]
    prior : prior standard deviation of the fit [mm, mrad]; None: the poses determine the geometry,
        or it would exceed 3 mm or mrad, and the fit is free
    """

    line: ClassVar[str] = " {{ it.size | f('.2g') }} mm ({{ it.low | f('.2g') }} to {{ it.high | f('.2g') }})"

    size: float = field(metadata=WRITTEN)
    low: float = field(metadata=WRITTEN)
    high: float = field(metadata=WRITTEN)
    prior: float | None = field(metadata=WRITTEN)

    def priors(self, robot: Robot) -> Mapping[str, tuple[float, float]]:
        """Return priors of the geometry, name -> (mean, one sigma) [SI]; {} if `prior` is None."""
        drawn = (p for p in robot.parameters if p.group in DRAWN_GROUPS)
        return {} if self.prior is None else {p.name: (p.value, self.prior * p.scale) for p in drawn}

    @property
    def visible(self) -> bool:
        """Whether the 95 % interval of the departures excludes a nominal geometry."""
        return bool(self.low > SIZE_GRID[0])

    def in_words(self) -> str:
        """Return a sentence with departure [mm, mrad rms] and prior, or a limit if not visible."""
        if not self.visible:
            return f"The geometry does not visibly depart from nominal (at most {self.high:.2g} mm and mrad rms)."
        interval = f"{self.size:.2g} mm and mrad rms ({self.low:.2g} to {self.high:.2g})"
        prior = "" if self.prior is None else "; what the poses leave open is held that near to nominal"
        return f"The geometry departs from nominal by {interval}{prior}."


def departure_of(problem: LeastSquares, v: Array, variance: float, names: Sequence[str]) -> Departure | None:
    """Return how far the geometry departs from nominal by a fit; None without free geometry.

    None, too, where the variance is zero, or the posterior cannot be computed from this fit.

    problem : as it was solved; v : its optimum
    variance : of a residual in units of sigma squared
    names : of all parameters that the measurements distinguish
    """
    geometry = [problem.robot.parameters[name].group in DRAWN_GROUPS for name in names]
    if not any(geometry) or not variance > 0:
        return None
    whole = problem if tuple(names) == problem.names else problem.with_names(names)
    value_of = dict(zip(problem.names, v, strict=False))
    at = np.concatenate([[value_of.get(name, 0.0) for name in names], v[len(problem.names) :]])
    drawn = np.flatnonzero(geometry)
    rest = np.delete(np.arange(whole.size), drawn)
    H, off = whole.information(at), at - whole.prior_mean
    slope = whole.gradient(at)[0] - whole.prior_matrix @ off
    # The sum of squares of the linearised residuals is square - 2 x'score + x'H x. In x the
    # geometry departs from nominal, all else from the point, where its priors add their part.
    score = H[:, drawn] @ at[drawn] - slope
    square = 2 * whole.cost(at) - whole.prior_square(at) + at[drawn] @ (score - slope)[drawn]
    P = variance * whole.prior_matrix[np.ix_(rest, rest)]
    score[rest] -= P @ off[rest]
    square += off[rest] @ P @ off[rest]
    inverse = scaled_inverse(H[np.ix_(rest, rest)] + P)
    information, product = marginalised(H, score, drawn, inverse)
    square -= score[rest] @ inverse @ score[rest]
    count = whole.residual_count - float(np.sum(inverse * H[np.ix_(rest, rest)]))
    return _posterior(np.linalg.eigh(information), product, max(float(square), 0.0), count, np.sqrt(variance))


def _posterior(
    eigen: tuple[Array, Array], product: Array, square: float, count: float, sigma: float
) -> Departure | None:
    """Return the arm's departure by the normal equations of its geometry, all else marginalised.

    None where the free fit is no point to linearise about: no size is likely there.

    eigen : eigenvalues and eigenvectors of the geometry's information, in units of scale and sigma
    product : J'r with its Jacobian J and the residuals r with nominal geometry, shape (p,)
    sigma : standard deviation of a residual by the fit without a prior, in units of sigma
    """
    value, projected = np.maximum(eigen[0], 0.0), eigen[1].T @ product
    highest = max(4 * sigma, 2 * np.sqrt(square / max(count, 1.0)))
    sigmas = np.geomspace(sigma / 4, highest, max(30, int(10 * np.log(4 * highest / sigma))))
    log_base = -count * np.log(sigmas) - 0.5 * square / sigmas**2
    (log_likelihood,) = log_gain(sigmas, SIZE_GRID, log_base, value[None], projected[None])
    others = (1 - PRIOR_PROBABILITY_OF_NONE) / (len(SIZE_GRID) - 1)
    log_likelihood += np.log([PRIOR_PROBABILITY_OF_NONE, *[others] * (len(SIZE_GRID) - 1)])
    if not np.isfinite(log_likelihood.max()):
        return None
    weight = np.exp(log_likelihood - log_likelihood.max())
    weight /= weight.sum()
    # Shares of the data in the estimate along each eigenvector, at each likely size and sigma.
    likely = weight > 1e-15
    ratio = (sigmas[:, None] / SIZE_GRID)[likely]
    mean = float(weight[likely] @ (value / (value + ratio[:, None] ** 2)).sum(axis=1))
    noise = float(np.exp(weight.sum(axis=1) @ np.log(sigmas)))
    by_size = (value / (value + (noise / SIZE_GRID[:, None]) ** 2)).sum(axis=1)
    prior = float(np.exp(np.interp(mean, by_size, np.log(SIZE_GRID))))
    # The fit without a prior is used where the prior's share in the estimate, the mean over the
    # eigenvectors of the information, is below 8 %, or where it is too wide to constrain anything.
    free = mean > (1 - 0.08) * len(value) or prior > 3.0
    below = np.cumsum(weight.sum(axis=0))
    low, size, high = (float(SIZE_GRID[np.argmax(below > q)]) for q in (0.025, 0.5, 0.975))
    return Departure(size, low, high, None if free else prior)
