"""Detection of changed effects: an earlier campaign's prior against that of a new effect.

Both evidences are those of the linear model, integrated over the grid of the noise. An effect in
parts (a curve of each joint) is tested part by part; the prior of a changed part is widened about
zero (see `_parts`), and the others are tested again given this.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.fit import Fit
from casadical.core.linear_gaussian.normal_equations import joined
from casadical.core.linear_gaussian.search import stepwise
from casadical.core.statistics import best_of, robust_std
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.result import Change
from casadical.diagnosis.settings import SETTINGS
from casadical.identification.prior import Prior, probability_of_change
from casadical.measurements.measurements import Noise

# Label of an effect, and the joint of its part, None for an effect without parts.
Part = tuple[str, int | None]


def changes(case: Case, prior: Prior) -> tuple[tuple[Change, ...], Prior]:
    """Return the probability of change of each effect or part, and the prior, widened if changed.

    Parts with a probability of at least `Settings.min_change` count as changed (see `_parts`).
    case : case whose linear model does not contain the prior yet
    prior : prior from an earlier campaign
    """
    parts = _parts(case, prior)
    if not parts:
        return (), prior
    noise = Noise(max(robust_std(case.evidence.r), 1e-9), 0.0)
    # The model is in the parameters themselves, not in combinations, because the prior is on them.
    base = case.base
    e = replace(case.evidence, J=base.J[case.inliers], delta0=base.delta0, prior=base.prior)
    fit = new_fit(e, np.zeros(0, dtype=np.int64), noise)
    factor: dict[Part, float] = {}

    def widened(given: Sequence[Part]) -> Prior:
        """Return the prior, wide for some changed parts."""
        return reduce(Prior.widened, (parts[key] for key in given), prior)

    def next_given(given: Sequence[Part]) -> Part:
        """Return the part that changed most probably in addition to some, if any is left."""
        as_before = _log_evidence(case, fit, noise.sigma, own := widened(given))
        untested = [key for key in parts if key not in given]
        for key in untested:
            factor[key] = _log_evidence(case, fit, noise.sigma, own.widened(parts[key])) - as_before
        return best_of(untested or given, factor.__getitem__, logs=True)

    done, _ = stepwise(
        next_given,
        lambda key, given: key not in given and probability_of_change(factor[key]) >= SETTINGS.min_change,
        len(parts),
    )
    changed = (Change(*key, probability_of_change(value)) for key, value in factor.items())
    return tuple(changed), widened(done)


def _parts(case: Case, prior: Prior) -> dict[Part, dict[str, float]]:
    """Return the prior sigma [SI] of each part's parameters, by name, if the part has changed.

    It is the larger of the typical size and the earlier value's magnitude, about mean zero. Keys
    are (label of the effect, joint or None); effects that the prior does not name are omitted.
    """
    sizes: dict[Part, dict[str, float]] = {}
    for effect in case.given.effects:
        if effect.label not in prior.labels:
            continue
        own = effect.parameters()
        parts: list[tuple[int | None, Array]] = [*effect.parts.items()] or [(effect.joint, np.arange(len(own)))]
        for joint, places in parts:
            names = [own[k] for k in places if own[k].name in prior.means]
            wide = {p.name: max(p.scale, abs(prior.means[p.name][0])) for p in names}
            if wide:
                sizes[effect.label, joint] = wide
    return sizes


def _log_evidence(case: Case, fit: Fit, sigma: float, prior: Prior) -> float:
    """Return the log marginal likelihood of the residual under a prior, up to a constant.

    It is summed over the grid of sigma at the ratio of joint repeatability of the fit. As in
    `Evidence`, prior standard deviations are proportional to the noise.
    fit : fit of the base model; sigma : noise of that fit [m]
    """
    mean, widths, units = case.prior_parts(prior)
    precision = widths**-2.0
    square = fit.sums.square + float(mean**2 @ precision)
    normal = units.T @ fit.sums.H @ units + np.diag(precision)
    right = units.T @ fit.sums.g + precision * mean
    sums = joined(normal, right, square, -float(np.log(widths).sum()))
    grid = case.evidence.sigmas / sigma
    return float(
        np.logaddexp.reduce(sums.log_norm - case.evidence.count * np.log(grid) - 0.5 * sums.square / grid**2, axis=None)
    )
