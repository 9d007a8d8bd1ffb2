"""Laws (expressions of an unlisted effect) as candidate causes: where they act times a function.

A candidate is a place of the model and a function with all its settings: a form of the grammar, or
the smooth function of a state variable, which describes an error without a form. Its evidence is
that of the linear model that judges all causes, averaged over the settings, the size and the noise.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import array_columns
from casadical.core.linear_gaussian.marginals import marginals_of
from casadical.core.linear_gaussian.search import log_factors
from casadical.core.statistics import first_of_best
from casadical.diagnosis.cross_validation import likely_noise
from casadical.diagnosis.evidence import KAPPA_WEIGHTS, Evidence
from casadical.diagnosis.laws.forms import SMOOTH_FORM, Function, StateVariable, rounded, state_variables, varying
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import EffectColumns
from casadical.diagnosis.noise_evidence import WHITE_FORM
from casadical.diagnosis.noise_evidence import Form as NoiseForm
from casadical.diagnosis.posterior import Ranking
from casadical.diagnosis.settings import SETTINGS
from casadical.effects.base import CAUSE_PRIOR_SIGMA
from casadical.effects.formula_effect import COLUMN_NAME, SEAMS, Law, columns_of
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Noise
from casadical.robot.robot import Robot


def places_of(robot: Robot) -> list[Law]:
    """Return a law with a constant formula for every place: joints, links, base, tool and payload."""
    vector = (("a", 1e-5), ("b", 1e-5), ("c", 1e-5))
    laws = [Law(j, "joint", "a") for j in robot.numbers]
    laws += [Law(j, seam, "[a, b, c]", vector) for seam in ("tilt", "shift") for j in robot.numbers]
    # The last link's shift is that of the tool.
    laws = [law for law in laws if (law.seam, law.joint) != ("shift", robot.n)]
    laws += [Law(None, seam, "[a, b, c]", vector) for seam in ("base tilt", "base shift", "tool shift")]
    return [*laws, *([Law(None, "payload", "a", (("a", 0.01),))] if robot.payload else [])]


def prior_weight(place: Law, variable: StateVariable) -> float:
    """Return the prior weight of a state variable at a place; zero where it cannot act.

    A part errs by what happens at itself or its neighbours; angles and loads of other joints act a
    tenth as often. Functions of two joints act in one of the two.
    """
    if place.seam == "payload" and not all(COLUMN_NAME.fullmatch(name) for name in variable.names):
        return 0.0
    if len(variable.joints) == 2:
        return float(place.seam == "joint" and place.joint in variable.joints)
    own = place.joint or (0 if place.seam.startswith("base") else None)
    if not variable.joints or (own is not None and abs(variable.joints[0] - own) <= 1):
        return 1.0
    return 0.1 if variable.family in ("angle", "load") else 0.0


@dataclass(frozen=True, eq=False)
class LawCandidate:
    """The laws of one function at one place, with all its settings.

    place : law with a constant formula there
    unit : columns of its factors in typical sizes, of a function that varies by one, (n, 3, d) [m]
    log_prior : log of its share of the prior of all laws
    """

    place: Law
    unit: Array
    function: Function
    log_prior: float

    @property
    def driven(self) -> tuple[str, StateVariable]:
        """Return the place in words and the state variable."""
        return self.place.place, self.function.variable

    @property
    def label(self) -> str:
        """Return the label in rankings: place, state variable, driver and form."""
        f = self.function
        return f"law: {self.place.place} by {f.variable.words}, {f.driver}, {f.form.name}"

    def columns(self, settings: Array | None = None) -> Array:
        """Return the columns in typical sizes, shape (n, 3, K, w) [m]; settings : None for the grid."""
        f = self.function.on_grid if settings is None else self.function.scaled(settings)[0]
        each = self.unit[:, :, None, None, :] * f.transpose(1, 2, 0)[:, None, :, :, None]
        return np.asarray(each.reshape(*each.shape[:3], -1))

    def law(self, settings: Array) -> Law:
        """Return the law of given settings, shape (settings,), as an effect."""
        _, units = self.function.scaled(settings[None])
        d = SEAMS[self.place.seam].components
        terms, factors = [], []
        for k, part in enumerate(self.function.form.texts(self.function.driver, settings.tolist())):
            # The letters r and t are names of drivers.
            names = "abcdefghijklmnopqsuvwxyz"[k * d : (k + 1) * d]
            terms.append((names if d == 1 else f"[{', '.join(names)}]") + f"*{part}")
            factors += [(name, float(f"{typical_size(self.place) / units[k, 0]:.3g}")) for name in names]
        return replace(self.place, formula=" + ".join(terms), factors=tuple(factors))

    def near(self, settings: Array, step: float) -> Array:
        """Return settings that differ from given ones in one each, shape (2 settings, settings).

        A width w is multiplied by exp(10 step); a frequency f changes by 10 step divided by the range
        of the driver, others by step times the range.
        """
        form, span, moved = self.function.form, float(np.ptp(self.function.x)), []
        for (k, name), sign in itertools.product(enumerate(form.settings), (-1, 1)):
            other = settings.copy()
            if name == "w" and form.name != "on and off":
                other[k] *= np.exp(10 * sign * step)
            else:
                other[k] += sign * step * (10 / span if name == "f" else span)
            moved.append(other)
        return rounded(np.array(moved).reshape(-1, len(settings)))


def typical_size(place: Law) -> float:
    """Return the prior sigma of a factor whose function varies by one [rad, m or kg/kg]."""
    return 0.03 if place.seam == "payload" else 30e-6


@dataclass(frozen=True, eq=False)
class ScoredLaw:
    """A candidate with its most probable settings.

    score : log mean evidence over the settings, plus the log of its prior share [nats]
    evidence : log evidence of these settings over none [nats]
    noise : most probable noise given the law
    errors : standard error of each setting, shape (settings,); NaN before they are computed
    """

    candidate: LawCandidate
    settings: Array
    score: float
    evidence: float
    noise: Noise
    errors: Array

    @property
    def law(self) -> Law:
        """Return the law as an effect."""
        return self.candidate.law(self.settings)

    @property
    def variable(self) -> StateVariable:
        """Return the state variable on which the error depends."""
        return self.candidate.function.variable

    @property
    def form(self) -> str:
        """Return the name of its form, SMOOTH_FORM for a description."""
        return self.candidate.function.form.name


@dataclass(frozen=True, eq=False)
class LawProblem:
    """The linear model of the inlier poses, in which laws are judged as all candidates are.

    evidence : linear model without candidates; the causes in the model are part of its base
    case : case at whose poses laws are given and by whose noise the evidence is prewhitened; None:
        laws are given as the evidence is
    """

    evidence: Evidence
    case: Case | None = None

    @classmethod
    def of_case(cls, case: Case, chosen: Array) -> LawProblem:
        """Return the problem of a case; chosen : indices of the columns in the model."""
        alone = case.judged.with_causes_alone(chosen)
        # Three noise ratios, 0, 0.2 and 0.8, halve the time of thousands of laws.
        alone = replace(alone, near=tuple(k for k in alone.near if k in (0, 2, 4)) or alone.near)
        return cls(alone, case)

    def white(self, columns: Array) -> Array:
        """Return columns of laws (n, 3, ...) prewhitened for autocorrelation as the evidence is."""
        if self.case is None or self.case.form is WHITE_FORM:
            return columns
        return self.case.form.serial(len(columns)).whiten(columns[self.case.order])

    def grids(self, columns: Array) -> tuple[Array, Array]:
        """Return the log evidence over none of K laws, (K,) [nats], and their log likelihoods.

        The likelihoods, weighed by size, have the axes laws, rhos, sigmas and kappas.
        columns : those of each law, shape (n, 3, K, w)
        """
        every = self.white(columns.reshape(*columns.shape[:2], -1))
        prior = np.full(every.shape[2], CAUSE_PRIOR_SIGMA)
        judged = marginals_of(self.evidence).of_other_columns(array_columns(every), prior)
        groups = list(np.arange(every.shape[2]).reshape(columns.shape[2:]))
        return log_factors(judged.log_grids(groups), judged.log_base(), KAPPA_WEIGHTS)

    def judged(self, candidates: Sequence[LawCandidate]) -> list[ScoredLaw]:
        """Return each candidate with the best settings of its grid."""
        laws: list[ScoredLaw] = []
        # Batches have candidates with equal numbers of columns, of about 16 MB of columns each.
        size, batches = dict[int, int](), dict[tuple[int, int], list[LawCandidate]]()
        for c in candidates:
            width = len(c.function.form.parts) * c.unit.shape[2]
            numbers = width * c.unit[..., 0].size * len(c.function.settings)
            size[width] = size.get(width, 0) + 8 * numbers
            batches.setdefault((width, size[width] // 16_000_000), []).append(c)
        for some in batches.values():
            logs, grids = self.grids(np.concatenate([c.columns() for c in some], axis=2))
            edges = np.cumsum([0, *(len(c.function.settings) for c in some)])
            for c, first, end in zip(some, edges[:-1], edges[1:], strict=True):
                own, settings = logs[first:end], c.function.settings
                best = first_of_best(own, logs=True)
                score = float(np.logaddexp.reduce(own) - np.log(len(own))) + c.log_prior
                noise, errors = (
                    likely_noise(grids[first + best], self.evidence.sigmas),
                    np.full(settings.shape[1], np.nan),
                )
                laws.append(ScoredLaw(c, settings[best], score, float(own[best]), noise, errors))
        return laws

    def refined(self, found: ScoredLaw, poses: Array | slice = slice(None)) -> ScoredLaw:
        """Return the law with nearby settings of more evidence; its score rises by the same.

        poses : indices of the problem's poses among those of the law
        """
        settings, evidence, noise = found.settings, found.evidence, found.noise
        # The first step is a fraction of the driver's range (see `LawCandidate.near`).
        step, halved = 0.03, 0
        while halved < 4 and len(settings) and found.form != SMOOTH_FORM:
            near = found.candidate.near(settings, step)
            logs, grids = self.grids(found.candidate.columns(near)[poses])
            best = first_of_best(logs, logs=True)
            if logs[best] > evidence + 0.1:
                settings, evidence = near[best], float(logs[best])
                noise = likely_noise(grids[best], self.evidence.sigmas)
            else:
                step, halved = step / 2, halved + 1
        score = found.score + evidence - found.evidence
        return replace(found, settings=settings, score=score, evidence=evidence, noise=noise)

    def with_errors(self, found: ScoredLaw) -> ScoredLaw:
        """Return the law with standard errors of its settings: steps that cost half a nat."""
        sigmas = np.full(len(found.settings), np.nan)
        for step in (0.1, 0.05, 0.025, 0.012, 0.006, 0.003) if len(sigmas) else ():
            near = found.candidate.near(found.settings, step)
            fallen = found.evidence - self.grids(found.candidate.columns(near))[0].reshape(-1, 2).max(axis=1)
            moved = np.abs(near - found.settings).max(axis=1).reshape(-1, 2).max(axis=1)
            own = moved / np.sqrt(np.maximum(2 * fallen, 1.0))
            sigmas = np.where(np.isnan(sigmas) | (fallen > 0.5), own, sigmas)
        return replace(found, errors=sigmas)


@dataclass(frozen=True, eq=False)
class Round:
    """One ranking of laws and all other candidates, given the causes in the model.

    laws : the laws by score, the best first
    ranking : posterior over the next cause, laws among the candidates by their `label`
    form : form of the noise under which all were evaluated
    alias : labels of listed effects that are equivalent to the best law
    further : probability of "no additional cause" given the best law; NaN where no form is certain
    """

    laws: tuple[ScoredLaw, ...]
    ranking: Ranking
    form: NoiseForm
    alias: tuple[str, ...] = ()
    further: float = np.nan

    @property
    def best(self) -> ScoredLaw:
        """Return the law of the highest score."""
        return self.laws[0]

    @property
    def indistinguishable(self) -> tuple[ScoredLaw, ...]:
        """Return at most six other laws that the data do not distinguish from the best one.

        Their scores are within `Settings.indistinguishable_law_margin` of its score.
        """
        return tuple(s for s in self.laws[1:] if s.score > self.best.score - SETTINGS.indistinguishable_law_margin)[:6]

    @property
    def probability(self) -> float:
        """Return the probability of the forms of the best law's state variable at its place."""
        driven = self.best.candidate.driven
        own = (s for s in self.laws if s.candidate.driven == driven and s.form != SMOOTH_FORM)
        return sum(self.ranking.probability[s.candidate.label] for s in own)

    @property
    def claimed(self) -> bool:
        """Return whether the best law is claimed (see `laws.search`)."""
        certain = self.best.form != SMOOTH_FORM and self.probability >= SETTINGS.min_law_claim
        return certain and not self.alias and self.further >= SETTINGS.min_law_further

    @property
    def rivals(self) -> dict[str, float]:
        """Return the probability of each candidate that is no law, the most probable first."""
        laws = {s.candidate.label for s in self.laws}
        return {k: self.ranking.probability[k] for k in self.ranking.order if k not in laws}

    @cached_property
    def drivers(self) -> dict[StateVariable, float]:
        """Return the probability of each state variable at any place, the most probable first.

        They sum to one: it is given that the error follows one of them.
        """
        total: dict[StateVariable, float] = {}
        for s in self.laws:
            total[s.variable] = total.get(s.variable, 0.0) + float(np.exp(s.score - self.best.score))
        every = sum(total.values())
        return {v: total[v] / every for v in sorted(total, key=lambda v: -total[v])}

    @property
    def description(self) -> ScoredLaw | None:
        """Return the best law of the state variable that describes the error.

        None where no cause at all is detected or no state variable has half of the probability.
        """
        first, p = next(iter(self.drivers.items()))
        there = self.ranking.none <= SETTINGS.max_p_nothing_further and p >= SETTINGS.min_doubtful
        return next(s for s in self.laws if s.variable == first) if there else None


def descriptions(case: Case) -> list[LawCandidate]:
    """Return a smooth function of each state variable that varies, at each place where it can act.

    Their prior shares follow `prior_weight` and sum to one; their columns are at the inlier poses.
    """
    assert isinstance(case.whole.E, EffectColumns)
    variables = state_variables(case.given)
    m, _ = derive(case.m, columns_of({name for v in variables for name in v.names}), case.given.loads)
    linear = replace(case.whole.E.linear, conditions=dict(m.conditions)).at(np.flatnonzero(case.inliers))
    variables, values = varying(linear, variables)
    places = places_of(case.given)
    columns, edges = linear.columns(places), np.cumsum([len(place.sizes()) for place in places])[:-1]
    units = [typical_size(p) * u for p, u in zip(places, np.split(columns, edges, axis=2), strict=True)]
    found = []
    for v in variables:
        function = Function.smooth(v, values)
        each = ((p, unit, prior_weight(p, v)) for p, unit in zip(places, units, strict=True))
        found += [LawCandidate(p, unit, function, float(np.log(w))) for p, unit, w in each if w]
    total = float(np.logaddexp.reduce([c.log_prior for c in found])) if found else 0.0
    return [replace(c, log_prior=c.log_prior - total) for c in found]
