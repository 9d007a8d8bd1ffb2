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
from casadical.diagnosis.laws.contest import (
    held_out,
    laws_before_causes,
    replaces_causes,
    round_of,
    thinned,
    with_best_noise,
    with_law,
)
from casadical.diagnosis.laws.problem import Round, ScoredLaw
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_forms import better_ar_form
from casadical.diagnosis.posterior import rank
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
    cached = found.law if found.law and len(found.law.best.columns) == case.inliers.sum() else None
    first = cached or laws_before_causes(found, poses)
    rounds, laws, causes = [first], [], found.effects()
    columns = found.columns
    if replaces_causes(found, first, poses):
        laws, causes = [first.best], ()
        case = with_law(
            case if first.form.ar_coefficient == case.form.ar_coefficient else case.with_form(first.form),
            first.best.law,
        )
        columns = case.group((first.best.law,))
    elif not causes:
        return _concluded(found, rounds, case, [], (), NO_COLUMNS)
    # Each of at most four rounds adds a law or a cause to the model.
    for _ in range(4):
        show("laws given what was found")
        other = better_ar_form(case, columns) if case.observations.plain else None
        if other:
            case = case.with_form(other[0])
        labels = frozenset(
            [
                *(s.law.label for s in laws),
                *(c.label for c in found.causes if c.effects in ({(e,) for e in causes} | {causes})),
                *(e.label for e in causes),
            ]
        )
        ranking = rank(case, columns, labels)
        listed = {c.label: c for c in case.candidates if c.listed}
        top = ranking.order[0]
        there = ranking.none <= SETTINGS.max_p_nothing_further
        if laws and top in listed and there and ranking.probability[top] >= SETTINGS.min_claim:
            variant = listed[top].variants[ranking.variant[top]]
            case, added = refined(case, top, variant, columns, ranking.noise[top])
            causes, columns = (*causes, *added), np.unique(np.concatenate([columns, case.group(added)]))
            continue
        judged = round_of(case, columns, ranking, labels)
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

    columns : indices of the columns of all laws and causes in the model
    """
    smooth = describe_unlisted(replace(found, verdict="unknown"))
    smooth = smooth if smooth and smooth.effects else None
    noise = laws[-1].noise if laws else found.noise
    found_values = parameter_values(case, columns, [s.law for s in laws], noise) if laws else {}
    values = {f"{law.label}.{name}": value for (law, name), value in found_values.items()}
    named = found.columns
    before = held_out(case, NO_COLUMNS, (), found.rankings[0].noise[""], found.seed)
    errors: dict[KeptModel, Array] = {"base": before}
    if found.effects():
        errors["causes"] = held_out(case, named, (), found.noise, found.seed)
    if smooth:
        forms = np.unique(np.concatenate([named, case.group(smooth.effects)]))
        errors["smooth"] = held_out(case, forms, (), found.noise, found.seed)
    shrink = None
    if laws:
        given = np.unique(np.concatenate([NO_COLUMNS, *(case.columns[e] for e in causes)])).astype(np.int64)
        errors["law"] = held_out(case, given, laws, noise, found.seed)
        interval = shrink_interval(before, errors["law"], found.seed, found.case.evidence.stop)
        shrink = float(1 - errors["law"].mean() / before.mean()), interval
    gap = {name: float(e.mean()) for name, e in errors.items()}
    return Discovery(found, tuple(rounds), case, tuple(laws), causes, noise, values, gap, shrink, smooth)
