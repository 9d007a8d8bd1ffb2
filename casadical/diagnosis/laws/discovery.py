"""Discover laws (expressions of an unlisted effect), and compare models on held-out poses.

An unlisted form (any function of a joint's own angle, smooth in time, ...) names no cause, nor does
a listed effect in addition to it. Together they still describe the error; where the description
predicts held-out poses, it can be corrected.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array, Show, silent
from casadical.core.linear_gaussian.marginals import NO_COLUMNS
from casadical.core.linear_gaussian.search import compared_again, stepwise
from casadical.diagnosis.candidates import EffectChoice
from casadical.diagnosis.conclusion import parameter_values
from casadical.diagnosis.cross_validation import partitioned_errors, shrink_interval
from casadical.diagnosis.diagnose import diagnose
from casadical.diagnosis.laws.answer import Discovery, KeptModel
from casadical.diagnosis.laws.candidates import Round, ScoredLaw
from casadical.diagnosis.laws.search import (
    held_out,
    laws_before_causes,
    ranked_laws,
    ranking_of,
    replaces_causes,
    thinned,
    with_best_noise,
    with_law,
)
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.posterior import Ranking, rank
from casadical.diagnosis.result import Diagnosis, Unlisted
from casadical.diagnosis.search import State, Step
from casadical.diagnosis.settings import SETTINGS
from casadical.effects import Effect
from casadical.identification.result import Identification
from casadical.measurements.measurements import Measurements, Noise
from casadical.robot.robot import Robot


def describe_unlisted(found: Diagnosis) -> Unlisted | None:
    """Return up to four forms that best describe the remaining error, with held-out errors.

    None unless the verdict is unknown, an additional cause is detected and the most probable one is
    unlisted. Forms, which may be listed effects, are added one by one while the next has a
    probability above 0.5; each is then compared again given the others.
    """
    if found.verdict != "unknown":
        return None
    case, seed = found.case, found.seed
    # Effects at single joints of a cause at several joints are in the model, too.
    named = frozenset((*(c.label for c in found.causes), *(e.label for e in found.effects())))
    by_label = {c.label: c for c in case.candidates}
    ranking = found.rankings[-1].restricted_to(by_label)
    if ranking.none > SETTINGS.max_p_nothing_further or by_label[ranking.order[0]].listed:
        return None

    def columns_with(forms: Sequence[Step]) -> Array:
        """Return the indices of the columns of the causes and of some forms, shape (k,)."""
        return np.union1d(found.columns, State(case).columns(forms))

    def ranked(forms: Sequence[Step]) -> Ranking:
        """Return the posterior over an additional form given some."""
        return rank(case, columns_with(forms), named.union(*(form.labels for form in forms)))

    def next_form(given: Sequence[Step]) -> Step:
        """Return the most probable form in addition to some."""
        own = ranked(given) if given else ranking
        label = own.order[0]
        return Step(own, (label,), by_label[label].variants[own.variant[label]])

    def enough(form: Step, _: Sequence[Step]) -> bool:
        """Return whether a form is added to the description."""
        own = form.ranking
        return own.none <= SETTINGS.max_p_nothing_further and own.probability[form.labels[0]] > 0.5

    forms = compared_again(stepwise(next_form, enough, 4)[0], next_form)
    columns = columns_with(forms)
    noise = found.noise if found.effects() else found.rankings[0].noise[""]
    before = partitioned_errors(case.evidence, found.columns, noise, seed)
    last = ranked(forms)
    after = partitioned_errors(case.evidence, columns, last.noise[""], seed)
    means = float(before.mean()), float(after.mean())
    interval = shrink_interval(before, after, seed, case.evidence.stop)
    effects = tuple(e for form in forms for e in form.effects)
    return Unlisted(tuple(form.labels[0] for form in forms), effects, *means, 1 - means[1] / means[0], interval, last)


def discover(
    robot: Robot | Identification,
    m: Measurements | None = None,
    effects: EffectChoice = "standard",
    *,
    seed: int = 0,
    show: Show = silent,
) -> Discovery:
    """Return laws for the errors in a campaign that no listed effect explains, with its diagnosis.

    robot, m, effects, seed, show : as of `diagnose`
    Raises InputError: the measurements cannot carry a diagnosis.

    Examples
    --------
    >>> casadical.discover(found, effects=["backlash"]).best_model  # neither a law nor a cause is missing
    'base'
    """
    found = diagnose(robot, m, effects, seed=seed, show=show)
    return laws_of_diagnosis(found, show)


def laws_of_diagnosis(found: Diagnosis, show: Show = silent, poses: int = SETTINGS.max_law_poses) -> Discovery:
    """Return the law of a diagnosed campaign, or the description of its error by a driver.

    The best law is first compared with all causes together and replaces them or not; then a law is
    searched given the causes. Given a claimed law nothing further is probable, so that none follows.
    poses : largest number of poses on which laws are searched, evenly taken from the campaign
    """
    show("laws alone")
    case, causes, columns = thinned(found.case, poses), found.effects(), found.columns
    searched = (found.law, found.case) if found.law else laws_before_causes(found, poses=poses)
    if searched is None:
        return _concluded(found, [], case, [], causes, columns)
    first, moved = searched
    rounds = [first]
    if replaces_causes(found, first, poses):
        case = with_law(thinned(moved, poses), first.best.law)
        return _concluded(found, rounds, case, [first.best], (), case.group((first.best.law,)))
    if not causes:
        return _concluded(found, rounds, thinned(moved, poses), [], (), NO_COLUMNS)
    show("laws given what was found")
    named = [c.label for c in found.causes if c.effects in ({(e,) for e in causes} | {causes})]
    labels = frozenset((*named, *(e.label for e in causes)))
    judged = ranked_laws(case, columns, ranking_of(case, columns, labels), labels)
    if judged is None:
        return _concluded(found, rounds, case, [], causes, columns)
    last, moved = with_best_noise(case, judged, poses, columns, labels)
    if not last.claimed:
        return _concluded(found, [*rounds, last], case, [], causes, columns)
    case = with_law(moved, last.best.law)
    columns = np.union1d(columns, case.group((last.best.law,)))
    return _concluded(found, [*rounds, last], case, [last.best], causes, columns)


def _concluded(
    found: Diagnosis, rounds: list[Round], case: Case, laws: list[ScoredLaw], causes: tuple[Effect, ...], columns: Array
) -> Discovery:
    """Return the result of the search, with held-out errors of all models.

    columns : indices of the columns of all laws and causes in the model
    """
    description = rounds[-1].description if rounds and not laws else None
    if description:
        case = with_law(case, description.law)
        columns = np.union1d(found.columns, case.group((description.law,)))
    smooth = describe_unlisted(replace(found, verdict="unknown"))
    smooth = smooth if smooth and smooth.effects else None
    modelled = laws or ([description] if description else [])
    noise = modelled[0].noise if modelled else found.noise
    found_values = parameter_values(case, columns, [s.law for s in modelled], noise) if modelled else {}
    values = {f"{law.label}.{name}": value for (law, name), value in found_values.items()}

    def errors_of(effects: Sequence[Effect], noise: Noise, laws: Sequence[ScoredLaw] = ()) -> Array:
        """Return the held-out errors of a model, (n_inliers,) [m]."""
        return held_out(case, np.unique(case.group(effects)), laws, noise, found.seed)

    errors: dict[KeptModel, Array] = {"base": errors_of((), found.rankings[0].noise[""])}
    if found.effects():
        errors["causes"] = errors_of(found.effects(), found.noise)
    if smooth:
        errors["smooth"] = errors_of((*found.effects(), *smooth.effects), found.noise)
    if description:
        errors["described"] = errors_of(found.effects(), noise, [description])
    shrink = None
    if laws:
        errors["law"] = errors_of(causes, noise, laws)
        interval = shrink_interval(errors["base"], errors["law"], found.seed, case.evidence.stop)
        shrink = float(1 - errors["law"].mean() / errors["base"].mean()), interval
    gap = {name: float(e.mean()) for name, e in errors.items()}
    return Discovery(found, tuple(rounds), case, tuple(laws), description, causes, noise, values, gap, shrink, smooth)
