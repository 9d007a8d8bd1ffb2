"""Laws against listed causes, smooth forms and noise: which is claimed, and whether in place of what was found.

A law is claimed if its score (see `search`) is 12 or more and 3 above that of the best listed effect, of the best form
on no list, and of noise that is not the model's; rivals have their settings refined as the law's are. Where its columns
are those of a listed effect, it is that effect under another name. Laws that score nearly as much are named with it. It
takes the place of causes only where it predicts poses held out better, too.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import ArrayColumns
from casadical.core.linear_gaussian.marginals import NO_COLUMNS
from casadical.core.statistics import best_of, first_of_best, ranked
from casadical.diagnosis.candidates import Candidate
from casadical.diagnosis.cross_validation import lengths, new_fit, random_folds
from casadical.diagnosis.evidence import KAPPA_WEIGHTS, RHO_GRID, Evidence
from casadical.diagnosis.laws.problem import ABOVE, ALIKE, CLAIMED, Problem, Round, Scored, scaled
from casadical.diagnosis.laws.search import refined_settings, search_laws
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_forms import (
    MIN_AR_LOG_GAIN,
    ar_form,
    best_ar_form,
    best_form_given_ar,
    better_ar_form,
    noise_forms,
)
from casadical.diagnosis.posterior import PRIOR_FIRST, Ranking, rank
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.search import MAX_FORM_SEARCHES
from casadical.diagnosis.settings_search import refined
from casadical.effects.base import CAUSE_PRIOR_SIGMA
from casadical.effects.formula_effect import Law
from casadical.measurements.measurements import Noise

# Laws are searched on so many poses at most, spread over the campaign: its time grows with the poses.
MOST_POSES = 600
# A law is a listed effect by another name if their columns correlate by more.
CORRELATION = 0.95


def replaces_causes(found: Diagnosis, first: Round, poses: int = MOST_POSES) -> bool:
    """Whether the best law beside nothing is claimed in place of all causes of a diagnosis together."""
    if not first.claimed:
        return False
    case, listed = thinned(found.case, poses), _set_mass(found)
    if np.isfinite(listed):
        # Both are over no cause, each under a noise of its own.
        over = _log_none(case.with_form(first.form)) - _log_none(case) if first.form.stays != case.form.stays else 0.0
        if first.best.score + over + np.log(PRIOR_FIRST["unknown"]) < listed + ABOVE:
            return False
    if not found.columns.size:
        return True
    by_law = held_out(case, NO_COLUMNS, [first.best], first.best.noise, found.seed)
    by_causes = held_out(case, found.columns, (), found.noise, found.seed)
    return bool(by_law.mean() < by_causes.mean())


def laws_before_causes(found: Diagnosis, poses: int = MOST_POSES) -> Round:
    """Laws compared with all else before any cause is in the model, on so many poses at most.

    Of the noise's forms that may be there, by the first under which one is claimed, else by the last.
    """
    for whole, case, ranking in _before_causes(found, poses):
        first, _ = beside_its_noise(whole, round_of(case, NO_COLUMNS, ranking), poses)
        if first.claimed:
            break
    return first


def claimed_before_causes(found: Diagnosis) -> tuple[Round, Case] | None:
    """The same where a law is claimed, and the case as its noise moves it, else None.

    Laws that rivals outdo for certain are not looked at closely.
    """
    for whole, case, ranking in _before_causes(found, MOST_POSES):
        # With their settings refined rivals have still more.
        least = max(CLAIMED, max(ranking.log_factor.values()) + ABOVE)
        laws = search_laws(case, NO_COLUMNS, least=least - ALIKE)
        if laws and laws[0].score >= least:
            first, moved = beside_its_noise(whole, _judged(laws, case, NO_COLUMNS, ranking), MOST_POSES)
            if first.claimed:
                return first, moved
    return None


def beside_its_noise(
    case: Case, first: Round, poses: int, chosen: Array = NO_COLUMNS, causes: frozenset[str] = frozenset()
) -> tuple[Round, Case]:
    """A comparison and the case of all poses that it is of; where it claims a law, by the noise that is best beside it.

    All are compared again where the noise beside the law follows itself by another share, until it does not.
    chosen, causes : columns and labels of what is in the model already
    """
    for _ in range(MAX_FORM_SEARCHES if case.observations.plain else 0):
        own = with_law(case, first.best.law) if first.claimed else None
        other = own and better_ar_form(own, np.union1d(chosen, own.group((first.best.law,))))
        if not other:
            break
        case = case.with_form(other[0])
        fewer = thinned(case, poses)
        first = round_of(fewer, chosen, rank(fewer, chosen, causes), causes)
    return first, case


def with_law(case: Case, law: Law) -> Case:
    """The case with a law among its candidates."""
    named = Candidate(law.label, law.name, law.joint, (), listed=False)
    return replace(case, candidates=(*case.candidates, named)).with_variants(law.label, [(law,)])


def _before_causes(found: Diagnosis, poses: int) -> Iterator[tuple[Case, Case, Ranking]]:
    """The case, the same of some of its poses, and their ranking before any cause is in the model.

    Where there is no cause and noise follows itself, first as if it did not: a law may be what follows. Then as it
    does: a law may be hidden in it.
    """
    case, ranking = thinned(found.case, poses), found.rankings[0]
    yield found.case, case, ranking if case is found.case else rank(case, NO_COLUMNS)
    follows = None if found.effects() else as_noise_follows(found.case, ranking)
    if follows:
        case = thinned(follows, poses)
        yield follows, case, rank(case, NO_COLUMNS)


def as_noise_follows(case: Case, ranking: Ranking) -> Case | None:
    """The case under the noise that follows itself best; None where none does, or the case has such a noise already.

    The noise is fitted beside no cause and beside each of the most probable candidates of a ranking; the pair with most
    evidence counts.
    """
    if case.form.stays or not case.observations.plain:
        return None
    variants = {c.label: c.variants for c in case.candidates}
    groups = [(0.0, NO_COLUMNS)]
    # Candidates beside which the form of noise that follows itself is looked for.
    for label in [label for label in ranking.order if label in variants][:3]:
        groups.append((ranking.log_factor[label], case.group(variants[label][ranking.variant[label]])))
    judged = [(log, best_ar_form(case, group)) for log, group in groups]
    _, (form, _, gain) = best_of(judged, lambda j: j[0] + j[1][2], logs=True)
    return case.with_form(form) if gain >= MIN_AR_LOG_GAIN else None


def thinned(case: Case, poses: int) -> Case:
    """The case with at most so many of its poses, spread over the campaign: of noise that follows itself less stays."""
    at = np.flatnonzero(case.kept)[case.order]
    some = np.zeros_like(case.kept)
    some[at[np.linspace(0, len(at) - 1, min(len(at), poses)).round().astype(int)]] = True
    fewer = case.with_kept(some)
    if fewer is case or not case.form.stays:
        return fewer
    e, stays = fewer.evidence, case.form.stays ** (len(at) / poses)
    return fewer.with_form(ar_form(stays, len(e.r), e.count / len(e.r)))


def _log_none(case: Case) -> float:
    """Log likelihood without a cause, by the case's form of noise."""
    return float(np.logaddexp.reduce(case.judged.log_base(NO_COLUMNS), axis=None)) + case.form.log_weight


def _set_mass(found: Diagnosis) -> float:
    """Log evidence of all listed causes of a diagnosis together, with the log of their prior; of one alone -inf."""
    left = {c.label for c in found.causes}
    total, count = 0.0, 0
    for ranking in found.rankings:
        known = left & ranking.log_mass.keys()
        if known:
            best = best_of(sorted(known), ranking.log_mass.__getitem__, logs=True)
            total, count = total + ranking.log_mass[best], count + 1
            left.remove(best)
    return total if count > 1 else -np.inf


def round_of(case: Case, chosen: Array, ranking: Ranking, without: frozenset[str] = frozenset()) -> Round:
    """Laws compared with what else a ranking has. chosen : columns in the model; without : labels of laws in it"""
    return _judged(search_laws(case, chosen, without), case, chosen, ranking)


def _judged(laws: Sequence[Scored], case: Case, chosen: Array, ranking: Ranking) -> Round:
    score = itemgetter(1)
    by_label = {c.label: c for c in case.candidates}
    labels = list(ranking.log_factor)
    order = [labels[k] for k in ranked(list(ranking.log_factor.values()), logs=True)]
    listed = [k for k in order if k in by_label and by_label[k].listed]
    smooth = [k for k in order if k in by_label and not by_label[k].listed]
    rivals = [_refined_rival(case, by_label[k], ranking, chosen) for k in listed[:2]]
    best = best_of(rivals, score, logs=True) if rivals else ("", -np.inf)
    other = best_of((_refined_rival(case, by_label[k], ranking, chosen) for k in smooth[:2]), score, logs=True)
    if case.form.stays:
        noise = best_form_given_ar(case, chosen)
    else:
        noise = best_of(((f.label, f.log_factor) for f in noise_forms(case, chosen)), score, logs=True)
    return Round(tuple(laws), best, other, noise, aliases(case, chosen, laws[0], ranking.variant), case.form)


def _refined_rival(case: Case, candidate: Candidate, ranking: Ranking, chosen: Array) -> tuple[str, float]:
    """A rival's log evidence, mean over its settings, and what refining these adds."""
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


def aliases(case: Case, chosen: Array, law: Scored, variant: Mapping[str, int]) -> tuple[str, ...]:
    """Labels of the listed effects that can do what a law does: its fit correlates with what they make of it.

    chosen : columns of what is in the model beside it; variant : settings of each candidate, by label
    """
    problem = Problem.beside(case, chosen)
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
        if np.linalg.norm(same) > CORRELATION * np.linalg.norm(fit):
            found.append(candidate.label)
    return tuple(found)


def held_out(case: Case, columns: Array, laws: Sequence[Scored], noise: Noise, seed: int) -> Array:
    """Position error of each kept pose, shape (n,) [m], by a fit to the poses of the other folds.

    columns : of the effects in the model, whose settings stay; laws : whose settings are chosen again in each fold
    """
    base = case.evidence.with_base(columns)
    folds = random_folds(len(base.r), seed, alike=base.alike)
    errors = np.empty(len(base.r))
    for fold in np.unique(folds):
        test = folds == fold
        parts = _columns(base, laws, np.flatnonzero(~test))
        whole = replace(
            base, E=ArrayColumns(np.concatenate([np.zeros((*base.r.shape, 0)), *parts], axis=2)), cause_prior=None
        )
        fit = new_fit(whole, np.arange(whole.width), noise)
        errors[test] = lengths(base, fit.residual_without(np.flatnonzero(test)), test)
    return errors


def _columns(base: Evidence, laws: Sequence[Scored], train: Array) -> list[Array]:
    """Columns at all poses of the laws with the settings that are best for some of them, shape (n, 3, w) each."""
    columns: list[Array] = []
    for law in laws:
        known = np.concatenate([np.zeros((*base.r.shape, 0)), *columns], axis=2)
        e = base.with_base_columns(known, np.full(known.shape[2], CAUSE_PRIOR_SIGMA))
        e = replace(e, E=ArrayColumns(np.zeros((*base.r.shape, 1))), cause_prior=None)
        columns.append(_best(Problem(e.at(train)), law, train))
    return columns


def _best(problem: Problem, law: Scored, train: Array) -> Array:
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
