"""What noise alone leaves: the scatter of repeated poses, and the held-out error that noise of a size gives."""

import re
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.diagnosis.cross_validation import held_out_errors, partitions
from casadical.diagnosis.evidence import Evidence
from casadical.measurements.measurements import Measurements, Noise

# Usual share of poses that the instrument gets wrong, and how many times their noise is the usual one.
OUTLIERS, TIMES = 0.01, np.geomspace(3.0, 300.0, 9)
_CIRCUMSTANCE = re.compile(r"payload_kg|approach\d+|(tool|session)_.*")


@dataclass(frozen=True)
class Replicates:
    """Scatter of repeated poses.

    sigma : of one coordinate [m], instrument and joint repeatability together; poses, groups : how many poses repeat,
    and of how many different ones; freedom : degrees of freedom
    """

    sigma: float
    poses: int
    groups: int
    freedom: int

    @property
    def enough(self) -> bool:
        """Whether they are enough to go by."""
        # Fewer degrees of freedom than this leave the noise uncertain by more than a fifth.
        return self.freedom >= 12


def replicates(
    m: Measurements, r: Array, kept: Array, apart: Array | None = None, measured: Array | None = None
) -> Replicates:
    """Scatter of the residuals r, shape (n, 3) [m], of kept poses at the same readings, payload and logged approach.

    apart : number of what each pose was measured to, where there are several, shape (n,); measured : as of `Evidence`
    """
    circumstances = [values for name, values in m.conditions.items() if _CIRCUMSTANCE.fullmatch(name)]
    circumstances += [] if apart is None else [apart]
    # Readings that differ by less than this [rad or m] are one pose; the model's own small
    # difference is taken off.
    key = np.column_stack([np.round(m.q / 1e-3), *circumstances])[kept]
    _, group, counts = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    group = group.ravel()
    means = np.zeros((len(counts), r.shape[1]))
    np.add.at(means, group, r[kept])
    apart = r[kept] - (means / counts[:, None])[group]
    several = counts[counts > 1]
    numbers = np.full(len(r), r.shape[1]) if measured is None else np.count_nonzero(measured, axis=1)
    # Each pose of a group of k has the share 1 - 1 / k of its numbers.
    freedom = round(float((numbers[kept] * (1 - 1 / counts[group])).sum()))
    sigma = float(np.sqrt((apart**2).sum() / freedom)) if freedom else 0.0
    return Replicates(sigma, int(several.sum()), len(several), freedom)


def noise_floor(e: Evidence, noise: Noise, anchor: float, seed: int) -> float:
    """Mean held-out error [m] if only noise were left: simulated through the same fit.

    noise : as the fit leaves it; anchor : its size of a coordinate, where something else says it [m], else zero
    """
    if anchor:
        scale = anchor / scatter_of_coordinate(e, noise)
        noise = Noise(scale * noise.sigma, scale * noise.repeatability)
    rng = np.random.default_rng(seed)
    draws = []
    for folds in partitions(e, seed):
        white = noise.sigma * rng.standard_normal(e.r.shape)
        joints = noise.repeatability * rng.standard_normal((len(e.r), e.Jq.shape[2], 1))
        fake = replace(e, r=white + (e.Jq @ joints)[:, :, 0], delta0=np.zeros_like(e.delta0))
        draws.append(held_out_errors(fake, np.zeros(0, dtype=np.int64), noise, folds).mean())
    return float(np.mean(draws))


def outlier_probability(distance: Array) -> float:
    """Probability that any of some poses is an outlier, by their squared Mahalanobis distances, shape (k,).

    A pose's noise is the usual, or with a share of `OUTLIERS` so many times as large as one of `TIMES`, alike likely.
    """
    wide = -3 * np.log(TIMES)[:, None] - 0.5 * distance / TIMES[:, None] ** 2 + 0.5 * distance
    odds = np.log(OUTLIERS / (1 - OUTLIERS)) + np.logaddexp.reduce(wide, axis=0) - np.log(len(TIMES))
    return float(-np.expm1(-np.logaddexp(0, odds).sum()))


def scatter_of_coordinate(e: Evidence, noise: Noise) -> float:
    """Of one measured coordinate about the truth, instrument and joint repeatability together [m]."""
    return float(np.sqrt(np.trace(e.covariance(noise), axis1=1, axis2=2).mean() / e.r.shape[1]))
