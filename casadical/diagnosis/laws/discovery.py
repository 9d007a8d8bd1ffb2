"""Discover laws of residual errors, given listed causes, and compare models on held-out poses."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array, Show, silent
from casadical.core.linear_gaussian.marginals import NO_COLUMNS
from casadical.diagnosis.conclusion import parameter_values
from casadical.diagnosis.cross_validation import shrink_interval
from casadical.diagnosis.diagnose import diagnose
from casadical.diagnosis.laws.answer import Discovery, KeptModel
from casadical.diagnosis.laws.candidates import ScoredLaw
from casadical.diagnosis.laws.search import (
    Round,
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
from casadical.diagnosis.noise_forms import better_ar_form
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.settings import SETTINGS
from casadical.diagnosis.settings_search import refined
from casadical.diagnosis.smooth_description import describe_unlisted
from casadical.effects import Effect
from casadical.identification.result import Identification
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot


def discover(
    robot: Robot | Identification,
    m: Measurements | None = None,
    effects: str | Sequence[str | Effect | type[Effect]] = "standard",
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
    """Return the laws of a diagnosed campaign.

    The best law is first compared with all causes together and replaces them or not; then further
    laws are searched given the causes or the law.
    poses : largest number of poses on which laws are searched, evenly taken from the campaign
    """
    show("laws alone")
    case = thinned(found.case, poses)
    searched = (found.law, found.case) if found.law else laws_before_causes(found, poses=poses)
    if searched is None:
        return _concluded(found, [], case, [], found.effects(), found.columns)
    first, _ = searched
    rounds, laws, causes, columns = [first], list[ScoredLaw](), found.effects(), found.columns
    if replaces_causes(found, first, poses):
        laws, causes = [first.best], ()
        case = with_law(case if first.form == case.form else case.with_form(first.form), first.best.law)
        columns = case.group((first.best.law,))
    elif not causes:
        return _concluded(found, rounds, case, laws, (), NO_COLUMNS)
    # Each of at most four rounds adds a law or a cause to the model.
    for _ in range(4):
        show("laws given what was found")
        other = better_ar_form(case, columns) if case.observations.plain else None
        case = case.with_form(other[0]) if other else case
        known = [c.label for c in found.causes if c.effects in ({(e,) for e in causes} | {causes})]
        labels = frozenset((*(s.law.label for s in laws), *known, *(e.label for e in causes)))
        ranking = ranking_of(case, columns, labels)
        listed = {c.label: c for c in case.candidates if c.listed}
        top = ranking.order[0]
        there = ranking.none <= SETTINGS.max_p_nothing_further
        if laws and top in listed and there and ranking.probability[top] >= SETTINGS.min_claim:
            variant = listed[top].variants[ranking.variant[top]]
            case, added = refined(case, top, variant, columns, ranking.noise[top])
            causes, columns = (*causes, *added), np.unique(np.concatenate([columns, case.group(added)]))
            continue
        judged = ranked_laws(case, columns, ranking, labels)
        if judged is None:
            break
        comparison, moved = with_best_noise(case, judged, poses, columns, labels)
        rounds.append(comparison)
        # At most two laws are claimed.
        if not comparison.claimed or len(laws) == 2:
            break
        laws.append(comparison.best)
        case = with_law(moved, comparison.best.law)
        columns = np.unique(np.concatenate([columns, case.group((comparison.best.law,))]))
    return _concluded(found, rounds, case, laws, causes, columns)


def _concluded(
    found: Diagnosis, rounds: list[Round], case: Case, laws: list[ScoredLaw], causes: tuple[Effect, ...], columns: Array
) -> Discovery:
    """Return the result of the search, with held-out errors of all models.

    Where no form is claimed, the most probable law of the first round describes the error.
    columns : indices of the columns of all laws and causes in the model
    """
    description = rounds[-1].description if rounds and not laws else None
    if description:
        case = with_law(case, description.law)
        columns = np.union1d(found.columns, case.group((description.law,)))
    smooth = describe_unlisted(replace(found, verdict="unknown"))
    smooth = smooth if smooth and smooth.effects else None
    modelled = laws or ([description] if description else [])
    noise = modelled[-1].noise if modelled else found.noise
    found_values = parameter_values(case, columns, [s.law for s in modelled], noise) if modelled else {}
    values = {f"{law.label}.{name}": value for (law, name), value in found_values.items()}
    before = held_out(case, NO_COLUMNS, (), found.rankings[0].noise[""], found.seed)
    errors: dict[KeptModel, Array] = {"base": before}
    if found.effects():
        errors["causes"] = held_out(case, found.columns, (), found.noise, found.seed)
    if smooth:
        forms = np.unique(np.concatenate([found.columns, case.group(smooth.effects)]))
        errors["smooth"] = held_out(case, forms, (), found.noise, found.seed)
    if description:
        errors["described"] = held_out(case, found.columns, [description], noise, found.seed)
    shrink = None
    if laws:
        errors["law"] = held_out(case, case.group(causes), laws, noise, found.seed)
        interval = shrink_interval(before, errors["law"], found.seed, found.case.evidence.stop)
        shrink = float(1 - errors["law"].mean() / before.mean()), interval
    gap = {name: float(e.mean()) for name, e in errors.items()}
    return Discovery(found, tuple(rounds), case, tuple(laws), description, causes, noise, values, gap, shrink, smooth)
