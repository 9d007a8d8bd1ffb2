"""What changed since an earlier campaign: known parameters as their prior says, against those of a new effect.

The evidence of both in the linear problem, the size of the noise integrated on its grid. Of an effect in parts (a curve
of each joint), each part alone; what changed is then no longer known, and the others are judged again beside it.
"""

from dataclasses import replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.fit import Fit
from casadical.core.linear_gaussian.normal_equations import joined
from casadical.core.statistics import best_of, robust_std
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.result import Change
from casadical.identification.prior import Prior, probability_of_change
from casadical.measurements.measurements import Noise

# From this probability on, nothing of the earlier campaign is taken for known of a part.
MIN_CHANGE_PROBABILITY = 0.5


def changes(case: Case, prior: Prior) -> tuple[tuple[Change, ...], Prior]:
    """Every part of the known effects with the probability that it changed, and the prior without what did.

    case : whose evidence does not hold the prior yet
    """
    parts = _parts(case, prior)
    noise = Noise(max(robust_std(case.evidence.r), 1e-9), 0.0)
    # The parameters as they are, of which some are known.
    base = case.base
    e = replace(case.evidence, J=base.J[case.kept], delta0=base.delta0, prior=base.prior)
    fit = new_fit(e, np.zeros(0, dtype=np.int64), noise)
    factor: dict[tuple[str, int | None], float] = {}
    done: set[tuple[str, int | None]] = set()
    while True:
        as_known = _log_evidence(case, fit, noise.sigma, prior)
        for key, wide in parts.items():
            if key not in done:
                factor[key] = _log_evidence(case, fit, noise.sigma, prior.with_nothing_known(wide)) - as_known
        left = [key for key in parts if key not in done]
        first = best_of(left, factor.__getitem__, logs=True) if left else None
        if first is None or probability_of_change(factor[first]) < MIN_CHANGE_PROBABILITY:
            return tuple(Change(*key, probability_of_change(value)) for key, value in factor.items()), prior
        done.add(first)
        prior = prior.with_nothing_known(parts[first])


def _parts(case: Case, prior: Prior) -> dict[tuple[str, int | None], dict[str, float]]:
    """Names of each part's parameters with the size of a new one: the usual, or what it was where that is more."""
    sizes: dict[tuple[str, int | None], dict[str, float]] = {}
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
    """Log marginal likelihood of the residual; as in `Evidence`, what the prior leaves open grows with the noise.

    fit : of the base model at noise of this sigma [m]
    """
    mean, widths, known = case.prior_parts(prior)
    precision = np.diag(widths**-2.0)
    log_det = -2 * float(np.log(np.delete(widths, np.concatenate([*(at for at, _ in known), []]).astype(int))).sum())
    for at, C in known:
        unit = np.sqrt(np.diag(C))
        scaled = C / np.outer(unit, unit)
        precision[np.ix_(at, at)] = np.linalg.inv(scaled) / np.outer(unit, unit)
        log_det -= float(np.linalg.slogdet(scaled)[1]) + 2 * float(np.log(unit).sum())
    square = float(fit.y @ fit.y + mean @ precision @ mean)
    left = joined(fit.sums.H + precision, fit.sums.g + precision @ mean, square, 0.5 * log_det)
    grid = case.evidence.sigmas / sigma
    return float(
        np.logaddexp.reduce(left.log_norm - case.evidence.count * np.log(grid) - 0.5 * left.square / grid**2, axis=None)
    )
