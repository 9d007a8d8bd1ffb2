"""Search for a law (expression of an unlisted effect), or for the driver that the error follows.

Smooth functions of all state variables at all places are candidates, as are the listed effects, the
smooth effects, forms of noise and "nothing"; the grammar's forms are, where those have the most
evidence. A form is claimed if the forms of one state variable at one place are certain, no listed
effect is equivalent, and nothing further is probable given it: a form outside the grammar leaves a
part of the error that its state variable or another one still describes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import array_columns
from casadical.core.linear_gaussian.marginals import NO_COLUMNS
from casadical.core.statistics import best_of, first_of_best, ranked
from casadical.diagnosis.candidates import Candidate
from casadical.diagnosis.cross_validation import lengths, new_fit, random_folds
from casadical.diagnosis.evidence import RHO_GRID
from casadical.diagnosis.laws.candidates import LawProblem, Round, ScoredLaw, descriptions
from casadical.diagnosis.laws.forms import SMOOTH_FORM
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_forms import ar_form, better_ar_form, with_noise_forms
from casadical.diagnosis.posterior import PRIOR_FIRST, PRIOR_FURTHER, Ranking, rank
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.settings import SETTINGS
from casadical.effects.base import CAUSE_PRIOR_SIGMA
from casadical.effects.formula_effect import Law
from casadical.measurements.measurements import Noise


def ranking_of(case: Case, chosen: Array, skip: frozenset[str] = frozenset()) -> Ranking:
    """Return the ranking of causes and forms of noise without laws.

    chosen : indices of the columns in the model; skip : labels of their effects
    """
    return with_noise_forms(rank(case, chosen, skip), case, chosen)


def ranked_laws(
    case: Case, chosen: Array, ranking: Ranking, skip: frozenset[str] = frozenset(), needed: float = -np.inf
) -> Round | None:
    """Return the ranking with laws; None where none can reach the log mass `needed` [nats].

    None, too, where no state variable varies over the poses. With `needed` neither errors of a
    law that is an alias nor what is given it are computed.
    chosen : indices of the columns in the model; skip : labels of their effects
    ranking : that of the other candidates
    """
    problem, every = LawProblem.of_case(case, chosen), descriptions(case)
    smooth = _by_score(problem.judged(every))
    # A form has a few nats more than the smooth function that follows it, 30 at most.
    if not smooth or smooth[0].score + np.log(PRIOR_FIRST["unknown"]) < needed - 30.0:
        return None
    near = [s for s in smooth if s.score > smooth[0].score - 12.0][:12]
    # The forms of a state variable share half of its prior.
    others = {function: function.others() for function in {s.candidate.function: None for s in near}}
    shared = [
        replace(c, function=f, log_prior=c.log_prior - float(np.log(2 * len(others[c.function]))))
        for c in (s.candidate for s in near)
        for f in others[c.function]
    ]
    forms = _by_score(problem.judged(shared))
    forms = [problem.refined(s) for s in forms[:6]] + forms[6:]
    split = {f.candidate.driven for f in forms}
    halved = [replace(s, score=s.score - float(np.log(2))) if s.candidate.driven in split else s for s in smooth]
    laws = _by_score([*forms, *halved])
    found = Round(tuple(laws), _with_laws(ranking, laws, chosen), case.form)
    if found.best.form == SMOOTH_FORM or found.probability < SETTINGS.min_law_claim:
        return found
    alias = aliases(case, chosen, found.best, ranking.variant)
    if alias and needed > -np.inf:
        return replace(found, alias=alias)
    best = problem.with_errors(found.best)
    more = with_law(case, best.law)
    columns = np.union1d(chosen, more.group((best.law,)))
    given = ranking_of(more, columns, skip | {best.law.label})
    given = _with_laws(given, LawProblem.of_case(more, columns).judged(every), columns)
    return replace(found, laws=(best, *laws[1:]), alias=alias, further=given.none)


def _by_score(laws: Sequence[ScoredLaw]) -> list[ScoredLaw]:
    """Return laws by score, the best first."""
    return [laws[k] for k in ranked([s.score for s in laws], logs=True)]


def _with_laws(ranking: Ranking, laws: Sequence[ScoredLaw], chosen: Array) -> Ranking:
    """Return the ranking with laws among its candidates; chosen : columns in the model."""
    prior = PRIOR_FURTHER if len(chosen) else PRIOR_FIRST
    return ranking.with_rivals({s.candidate.label: (s.score, s.noise) for s in laws}, prior)


def with_law(case: Case, law: Law) -> Case:
    """Return the case with a law as an additional unlisted candidate."""
    named = Candidate(law.label, law.name, law.joint, (), listed=False)
    return replace(case, candidates=(*case.candidates, named)).with_variants({(law,): law.label})


def aliases(case: Case, chosen: Array, s: ScoredLaw, variant: Mapping[str, int]) -> tuple[str, ...]:
    """Return labels of the listed effects that are equivalent to a law: they can reproduce its fit.

    chosen : indices of the columns in the model
    variant : index of the settings of each candidate, by label
    """
    problem = LawProblem.of_case(case, chosen)
    rho = float(RHO_GRID[int(np.argmin(np.abs(RHO_GRID - s.noise.repeatability / s.noise.sigma)))])
    listed = [c for c in case.candidates if c.listed and c.label in variant and not c.variants[0][0].parts]
    projection = problem.evidence.projection(rho)
    own = projection.columns(problem.white(s.candidate.columns(s.settings[None])[:, :, 0]))
    fit = own @ np.linalg.lstsq(own, projection.y, rcond=None)[0]
    found = []
    for candidate in listed:
        other = projection.columns(case.judged.take(case.group(candidate.variants[variant[candidate.label]])))
        same = other @ np.linalg.lstsq(other, fit, rcond=None)[0]
        if np.linalg.norm(same) > SETTINGS.min_alias_correlation * np.linalg.norm(fit):
            found.append(candidate.label)
    return tuple(found)


def laws_before_causes(
    found: Diagnosis, needed: float = -np.inf, poses: int = SETTINGS.max_law_poses
) -> tuple[Round, Case] | None:
    """Return the ranking of laws without a cause in the model, and the case with all poses.

    The case has the form of noise of the ranking. None where `ranked_laws` returns None.
    needed : log mass that a law needs to be of interest [nats], see `ranked_laws`
    poses : largest number of poses on which laws are searched
    """
    case = thinned(found.case, poses)
    ranking = found.rankings[0] if case is found.case else ranking_of(case, NO_COLUMNS)
    first = ranked_laws(case, NO_COLUMNS, ranking, needed=needed)
    return with_best_noise(found.case, first, poses, sure=bool(found.effects())) if first else None


def with_best_noise(
    case: Case,
    first: Round,
    poses: int,
    chosen: Array = NO_COLUMNS,
    causes: frozenset[str] = frozenset(),
    *,
    sure: bool = True,
) -> tuple[Round, Case]:
    """Return a ranking, and its case with all poses, under the best noise given its best law.

    While the noise given the law has another AR coefficient, all are compared again under it: a law
    may be what is autocorrelated, and AR(1) noise may hide a law.
    case : case with all poses; first : ranking of its laws
    poses : largest number of poses on which laws are searched
    chosen, causes : indices of the columns and labels of the effects in the model
    sure : whether only a claimed law counts
    """
    for _ in range(SETTINGS.max_form_searches if case.observations.plain else 0):
        own = with_law(case, first.best.law) if first.claimed or not sure else None
        other = own and better_ar_form(own, np.union1d(chosen, own.group((first.best.law,))))
        if not other:
            break
        case = case.with_form(other[0])
        fewer = thinned(case, poses)
        first = ranked_laws(fewer, chosen, ranking_of(fewer, chosen, causes), causes) or first
    return first, case


def thinned(case: Case, poses: int) -> Case:
    """Return the case with at most `poses` inliers, evenly taken from the campaign in time.

    The AR(1) coefficient of its noise is adapted to the larger steps between them.
    """
    at = np.flatnonzero(case.inliers)[case.order]
    mask = np.zeros_like(case.inliers)
    mask[at[np.linspace(0, len(at) - 1, min(len(at), poses)).round().astype(int)]] = True
    fewer = case.with_inliers(mask)
    if fewer is case or not case.form.ar_coefficient:
        return fewer
    e, coefficient = fewer.evidence, case.form.ar_coefficient ** (len(at) / poses)
    return fewer.with_form(ar_form(coefficient, len(e.r), e.count / len(e.r)))


def log_mass_of_causes(found: Diagnosis) -> float:
    """Return log evidence plus log prior of all causes together [nats]; -inf for none."""
    labels = {c.label for c in found.causes}
    total, count = 0.0, 0
    for ranking in found.rankings:
        common = labels & ranking.log_mass.keys()
        if common:
            best = best_of(sorted(common), ranking.log_mass.__getitem__, logs=True)
            total, count = total + ranking.log_mass[best], count + 1
            labels.remove(best)
    return total if count else -np.inf


def replaces_causes(found: Diagnosis, first: Round, poses: int = SETTINGS.max_law_poses) -> bool:
    """Return whether the best law replaces all causes of a diagnosis together.

    It does if it is claimed, is more probable than several causes by `Settings.min_law_margin`, and
    predicts held-out poses better.
    first : ranking of laws without a cause in the model
    poses : largest number of poses on which the two are compared
    """
    if not first.claimed:
        return False
    case = thinned(found.case, poses)
    if len(found.causes) > 1:
        # Both are relative to no cause, each under its own form of noise.
        over = _log_none(case.with_form(first.form)) - _log_none(case) if first.form != case.form else 0.0
        mass = first.best.score + over + float(np.log(PRIOR_FIRST["unknown"]))
        if mass < log_mass_of_causes(found) + SETTINGS.min_law_margin:
            return False
    if not found.columns.size:
        return True
    by_law = held_out(case, NO_COLUMNS, [first.best], first.best.noise, found.seed)
    by_causes = held_out(case, found.columns, (), found.noise, found.seed)
    return bool(by_law.mean() < by_causes.mean())


def _log_none(case: Case) -> float:
    """Return the log likelihood without a cause, under the case's form of noise [nats]."""
    return float(np.logaddexp.reduce(case.judged.log_base(NO_COLUMNS), axis=None)) + case.form.log_weight


def held_out(case: Case, columns: Array, laws: Sequence[ScoredLaw], noise: Noise, seed: int) -> Array:
    """Return the reported error of each inlier by a fit to the other folds, (n_inliers,) [m].

    columns : indices of the columns of effects in the model, whose settings are fixed
    laws : laws in the model, whose settings are chosen again in each fold
    noise : noise of the fits; seed : seed of the folds
    """
    base = case.evidence.with_base(columns)
    folds = random_folds(len(base.r), seed, alike=base.alike, stop=base.stop)
    errors = np.empty(len(base.r))
    for fold in np.unique(folds):
        test = folds == fold
        train, made = np.flatnonzero(~test), np.zeros((*base.r.shape, 0))
        for s in laws:
            e = base.with_base_columns(made, np.full(made.shape[2], CAUSE_PRIOR_SIGMA))
            e = replace(e, E=array_columns(np.zeros((*base.r.shape, 1))), cause_prior=None)
            problem, settings = LawProblem(e.at(train)), s.candidate.function.settings
            logs, _ = problem.grids(s.candidate.columns()[train])
            best = first_of_best(logs, logs=True)
            own = problem.refined(replace(s, settings=settings[best], evidence=float(logs[best])), train)
            made = np.concatenate([made, s.candidate.columns(own.settings[None])[:, :, 0]], axis=2)
        model = replace(base, E=array_columns(made), cause_prior=None)
        fit = new_fit(model, np.arange(model.width), noise)
        errors[test] = lengths(base, fit.residual_without(np.flatnonzero(test)), test)
    return errors
