"""Laws (expressions of errors) compared with listed causes, smooth effects and noise.

A law is claimed if its score (see `search`) is 12 nats or more and exceeds by 3 that of the best
listed effect, of the best smooth effect, and of other forms of noise; the settings of rivals are
refined as the law's are. A law whose columns are those of a listed effect is that effect under
another name. Laws that score nearly as high are reported with it. A law replaces causes only if it
also predicts held-out poses better.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import array_columns
from casadical.core.linear_gaussian.marginals import NO_COLUMNS
from casadical.core.statistics import best_of, first_of_best, ranked
from casadical.diagnosis.candidates import Candidate
from casadical.diagnosis.cross_validation import lengths, new_fit, random_folds
from casadical.diagnosis.evidence import KAPPA_WEIGHTS, RHO_GRID, Evidence
from casadical.diagnosis.laws.problem import (
    Problem,
    Round,
    ScoredLaw,
    scaled,
)
from casadical.diagnosis.laws.search import refined_settings, search_laws
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_forms import (
    ar_form,
    best_ar_form,
    best_form_given_ar,
    better_ar_form,
    noise_forms,
)
from casadical.diagnosis.posterior import PRIOR_FIRST, Ranking, rank
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.settings import SETTINGS
from casadical.diagnosis.settings_search import refined
from casadical.effects.base import CAUSE_PRIOR_SIGMA
from casadical.effects.formula_effect import Law
from casadical.measurements.measurements import Noise


def replaces_causes(found: Diagnosis, first: Round, poses: int = SETTINGS.max_law_poses) -> bool:
    """Return whether the best law replaces all causes of a diagnosis together.

    It does if it is claimed, has enough evidence against several causes, and predicts held-out
    poses better.
    first : comparison of laws without a cause in the model
    poses : largest number of poses on which the two are compared
    """
    if not first.claimed:
        return False
    case, listed = thinned(found.case, poses), _set_mass(found)
    if np.isfinite(listed):
        # Both are relative to no cause, each under its own form of noise.
        over = (
            _log_none(case.with_form(first.form)) - _log_none(case)
            if first.form.ar_coefficient != case.form.ar_coefficient
            else 0.0
        )
        if first.best.score + over + np.log(PRIOR_FIRST["unknown"]) < listed + SETTINGS.min_law_margin:
            return False
    if not found.columns.size:
        return True
    by_law = held_out(case, NO_COLUMNS, [first.best], first.best.noise, found.seed)
    by_causes = held_out(case, found.columns, (), found.noise, found.seed)
    return bool(by_law.mean() < by_causes.mean())


def laws_before_causes(found: Diagnosis, poses: int = SETTINGS.max_law_poses) -> Round:
    """Return the comparison of laws with their rivals without a cause in the model.

    It is under white noise or, if no law is claimed then, under AR(1) noise where that is better.
    poses : largest number of poses on which laws are searched
    """
    for full_case, case, ranking in _before_causes(found, poses):
        alone = round_of(case, NO_COLUMNS, ranking)
        assert alone is not None  # without causes some law lowers the error
        first, _ = with_best_noise(full_case, alone, poses)
        if first.claimed:
            break
    return first


def claimed_before_causes(found: Diagnosis) -> tuple[Round, Case] | None:
    """Return the comparison with a claimed law and the case under its noise; None without one.

    No cause is in the model. Laws that certainly have lower scores than rivals are not evaluated
    exactly.
    """
    for full_case, case, ranking in _before_causes(found, SETTINGS.max_law_poses):
        # Refining their settings only raises the scores of rivals.
        threshold = max(SETTINGS.min_law_score, max(ranking.log_factor.values()) + SETTINGS.min_law_margin)
        laws = search_laws(case, NO_COLUMNS, least=threshold - SETTINGS.indistinguishable_law_margin)
        if laws and laws[0].score >= threshold:
            first, moved = with_best_noise(full_case, _judged(laws, case, NO_COLUMNS, ranking), SETTINGS.max_law_poses)
            if first.claimed:
                return first, moved
    return None


def with_best_noise(
    case: Case, first: Round, poses: int, chosen: Array = NO_COLUMNS, causes: frozenset[str] = frozenset()
) -> tuple[Round, Case]:
    """Return a comparison, and its case with all poses, under the best noise given a claimed law.

    While the noise given the law has another AR coefficient, all are compared again under it.
    case : case with all poses; first : comparison of its laws
    poses : largest number of poses on which laws are searched
    chosen, causes : indices of the columns and labels of the effects in the model
    """
    for _ in range(SETTINGS.max_form_searches if case.observations.plain else 0):
        own = with_law(case, first.best.law) if first.claimed else None
        other = own and better_ar_form(own, np.union1d(chosen, own.group((first.best.law,))))
        if not other:
            break
        case = case.with_form(other[0])
        fewer = thinned(case, poses)
        first = round_of(fewer, chosen, rank(fewer, chosen, causes), causes) or first
    return first, case


def with_law(case: Case, law: Law) -> Case:
    """Return the case with a law as an additional unlisted candidate."""
    named = Candidate(law.label, law.name, law.joint, (), listed=False)
    return replace(case, candidates=(*case.candidates, named)).with_variants(law.label, [(law,)])


def _before_causes(found: Diagnosis, poses: int) -> Iterator[tuple[Case, Case, Ranking]]:
    """Yield (case, case thinned to `poses`, ranking in it without a cause), for one or two noises.

    Where there is no cause and the noise is autocorrelated, the first is under white noise, since a
    law may be what is autocorrelated, and the second under AR(1) noise, which may hide a law.
    """
    case, ranking = thinned(found.case, poses), found.rankings[0]
    yield found.case, case, ranking if case is found.case else rank(case, NO_COLUMNS)
    follows = None if found.effects() else with_ar_noise(found.case, ranking)
    if follows:
        case = thinned(follows, poses)
        yield follows, case, rank(case, NO_COLUMNS)


def with_ar_noise(case: Case, ranking: Ranking) -> Case | None:
    """Return the case under the best AR(1) noise; None if white noise is better or it has AR noise.

    The noise is fitted without a cause and given each of the most probable candidates of a ranking;
    the pair with the most evidence counts.
    """
    if case.form.ar_coefficient or not case.observations.plain:
        return None
    variants = {c.label: c.variants for c in case.candidates}
    groups = [(0.0, NO_COLUMNS)]
    # AR noise is fitted given each of the three most probable candidates.
    for label in [label for label in ranking.order if label in variants][:3]:
        groups.append((ranking.log_factor[label], case.group(variants[label][ranking.variant[label]])))
    judged = [(log, best_ar_form(case, group)) for log, group in groups]
    _, (form, _, gain) = best_of(judged, lambda j: j[0] + j[1][2], logs=True)
    return case.with_form(form) if gain >= SETTINGS.min_ar_log_gain else None


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


def _log_none(case: Case) -> float:
    """Return the log likelihood without a cause, under the case's form of noise [nats]."""
    return float(np.logaddexp.reduce(case.judged.log_base(NO_COLUMNS), axis=None)) + case.form.log_weight


def _set_mass(found: Diagnosis) -> float:
    """Return log evidence plus log prior of all causes together [nats]; -inf for less than two."""
    labels = {c.label for c in found.causes}
    total, count = 0.0, 0
    for ranking in found.rankings:
        common = labels & ranking.log_mass.keys()
        if common:
            best = best_of(sorted(common), ranking.log_mass.__getitem__, logs=True)
            total, count = total + ranking.log_mass[best], count + 1
            labels.remove(best)
    return total if count > 1 else -np.inf


def round_of(case: Case, chosen: Array, ranking: Ranking, without: frozenset[str] = frozenset()) -> Round | None:
    """Return the comparison of the laws found by a search with the candidates of a ranking.

    None where no law is better than none, as given curves of all joints.
    chosen : indices of the columns in the model; without : labels of laws in it
    """
    laws = search_laws(case, chosen, without)
    return _judged(laws, case, chosen, ranking) if laws else None


def _judged(laws: Sequence[ScoredLaw], case: Case, chosen: Array, ranking: Ranking) -> Round:
    """Return the comparison of laws with the candidates of a ranking and with forms of noise.

    laws : the best first; chosen : indices of the columns in the model
    """
    score = itemgetter(1)
    by_label = {c.label: c for c in case.candidates}
    labels = list(ranking.log_factor)
    order = [labels[k] for k in ranked(list(ranking.log_factor.values()), logs=True)]
    listed = [k for k in order if k in by_label and by_label[k].listed]
    smooth = [k for k in order if k in by_label and not by_label[k].listed]
    rivals = [_refined_rival(case, by_label[k], ranking, chosen) for k in listed[:2]]
    best = best_of(rivals, score, logs=True) if rivals else ("", -np.inf)
    other = best_of((_refined_rival(case, by_label[k], ranking, chosen) for k in smooth[:2]), score, logs=True)
    if case.form.ar_coefficient:
        noise = best_form_given_ar(case, chosen)
    else:
        noise = best_of(((f.label, f.log_factor) for f in noise_forms(case, chosen)), score, logs=True)
    return Round(tuple(laws), best, other, noise, aliases(case, chosen, laws[0], ranking.variant), case.form)


def _refined_rival(case: Case, candidate: Candidate, ranking: Ranking, chosen: Array) -> tuple[str, float]:
    """Return label and score of a rival: its log Bayes factor with refined settings [nats]."""
    label = candidate.label
    score, variant = ranking.log_factor[label], candidate.variants[ranking.variant[label]]
    if len(variant) != 1 or variant[0].parts:
        return label, score
    more, better = refined(case, label, variant, chosen, ranking.noise[label])
    if better == variant:
        return label, score
    grids = more.judged.log_grids([more.group(variant), more.group(better)], chosen) + np.log(KAPPA_WEIGHTS)
    before, after = np.logaddexp.reduce(grids.reshape(2, -1), axis=1)
    return label, score + float(after - before)


def aliases(case: Case, chosen: Array, law: ScoredLaw, variant: Mapping[str, int]) -> tuple[str, ...]:
    """Return labels of the listed effects that are equivalent to a law: they can reproduce its fit.

    chosen : indices of the columns in the model
    variant : index of the settings of each candidate, by label
    """
    problem = Problem.of_case(case, chosen)
    rho = float(RHO_GRID[int(np.argmin(np.abs(RHO_GRID - law.noise.repeatability / law.noise.sigma)))])
    listed = [c for c in case.candidates if c.listed and c.label in variant and not c.variants[0][0].parts]
    groups = [case.group(c.variants[variant[c.label]]) for c in listed]
    if not groups:
        return ()
    projection, listed_columns = problem.evidence.projected(rho), case.judged.take(np.concatenate(groups))
    E = projection.columns(np.concatenate([problem.white(law.columns), listed_columns], axis=2))
    w = law.columns.shape[2]
    own = E[:, :w]
    fit = own @ np.linalg.lstsq(own, projection.y, rcond=None)[0]
    found, at = [], w
    for candidate, group in zip(listed, groups, strict=True):
        other = E[:, at : at + len(group)]
        at += len(group)
        same = other @ np.linalg.lstsq(other, fit, rcond=None)[0]
        if np.linalg.norm(same) > SETTINGS.min_alias_correlation * np.linalg.norm(fit):
            found.append(candidate.label)
    return tuple(found)


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
        parts = _columns(base, laws, np.flatnonzero(~test))
        model = replace(
            base, E=array_columns(np.concatenate([np.zeros((*base.r.shape, 0)), *parts], axis=2)), cause_prior=None
        )
        fit = new_fit(model, np.arange(model.width), noise)
        errors[test] = lengths(base, fit.residual_without(np.flatnonzero(test)), test)
    return errors


def _columns(base: Evidence, laws: Sequence[ScoredLaw], train: Array) -> list[Array]:
    """Return the columns of laws whose settings are refined on some poses, (n, 3, w) each.

    The columns are at all poses; each law is refined given those before it.
    base : linear model of all poses; train : indices of the poses used
    """
    columns: list[Array] = []
    for law in laws:
        earlier = np.concatenate([np.zeros((*base.r.shape, 0)), *columns], axis=2)
        e = base.with_base_columns(earlier, np.full(earlier.shape[2], CAUSE_PRIOR_SIGMA))
        e = replace(e, E=array_columns(np.zeros((*base.r.shape, 1))), cause_prior=None)
        columns.append(_best(Problem(e.at(train)), law, train))
    return columns


def _best(problem: Problem, law: ScoredLaw, train: Array) -> Array:
    """Return the columns at all poses, (n, 3, w), of a law with its best settings on some poses.

    problem : problem of these poses; train : their indices
    """
    if not law.tried.form.settings and len(law.tried.seams) == 1:
        return law.columns
    tried, logs = law.tried.by(problem, train), []
    for seam, x, settings in zip(tried.seams, tried.x, tried.settings, strict=True):
        functions = scaled(tried.form.values(x, settings))
        logs.append(problem.gains(replace(seam, columns=seam.columns[train]), functions[:, train]))
    place = first_of_best([g.max() for g in logs], logs=True)
    start = tried.settings[place][first_of_best(logs[place], logs=True)]
    (tried, place, best), _ = refined_settings(problem, tried, place, start, train)
    return tried.column(place, best)[1]
