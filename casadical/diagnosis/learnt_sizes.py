"""The prior size of an effect's parts, learnt from the data: marginal likelihood, by MacKay's fixed point.

A part's variance is set to the mean square of its parameters over the share of them that the data determine; the noise
variance too. A part that the data do not determine keeps its size. (MacKay 1992, Bayesian interpolation, sec. 4.)
"""

from collections.abc import Mapping

import numpy as np

from casadical.core.arrays import Array
from casadical.core.linear_gaussian.normal_equations import root_of_inverse
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.evidence import Evidence
from casadical.measurements.noise import Noise

ROUNDS, SETTLED = 8, 0.05
# A part of which the data determine less than this many parameters is left as it is.
LEAST = 1.0
LEAST_FACTOR, MOST_FACTOR = 0.05, 8.0


def learnt_sizes(
    e: Evidence, group: Array, parts: Mapping[int, Array], beside: Array, noise: Noise
) -> tuple[dict[int, float], Noise]:
    """Factor on the size of each part, and the noise that is left.

    e : the problem; group : columns of the effect, shape (k,); parts : places in the group, by part
    beside : columns of other causes in the model; noise : as far as known
    """
    columns = np.union1d(beside, group)
    fit = new_fit(e, columns, noise)
    sums = fit.sums
    first, own = len(fit.prior) - fit.combined.width, np.searchsorted(columns, group)
    places_of = {part: first + fit.combined.places(own[places]) for part, places in parts.items()}
    prior, mean = fit.prior.copy(), fit.mean
    factors, scale, rows = dict.fromkeys(parts, 1.0), 1.0, len(fit.y)
    square = float(fit.y @ fit.y)
    for _ in range(ROUNDS):
        normal = sums.H / scale + np.diag(prior**-2)
        root = root_of_inverse(normal)
        x = root.T @ (root @ (sums.g / scale + mean / prior**2))
        determined = 1 - (root**2).sum(axis=0) / prior**2
        left = square - 2 * sums.g @ x + x @ sums.H @ x
        before = (scale, *factors.values())
        # With more parameters than rows the noise would shrink to nothing.
        scale = max(float(left / (rows - determined.sum())), LEAST_FACTOR**2)
        for part, at in places_of.items():
            count = float(determined[at].sum())
            if count > LEAST:
                unit = prior[at] / factors[part]
                factor = float(np.sqrt(((x[at] / unit) ** 2).sum() / count))
                factors[part] = float(np.clip(factor, LEAST_FACTOR, MOST_FACTOR))
                prior[at] = unit * factors[part]
        if np.abs(np.log(np.array((scale, *factors.values())) / np.array(before))).max() < SETTLED:
            break
    return factors, Noise(noise.sigma * float(np.sqrt(scale)), noise.repeatability * float(np.sqrt(scale)))
