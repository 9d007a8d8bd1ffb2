"""Noise floor: standard deviation over repeated poses, and held-out error of noise alone."""

import re
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.diagnosis.cross_validation import held_out_errors, partitions
from casadical.diagnosis.evidence import Evidence
from casadical.measurements.measurements import Measurements, Noise

# Equally probable factors on the noise standard deviation of a pose that is an outlier.
OUTLIER_NOISE_FACTORS = np.geomspace(3.0, 300.0, 9)


@dataclass(frozen=True)
class Replicates:
    """Standard deviation over repeated poses.

    sigma : standard deviation of one coordinate [m], instrument and joint repeatability together;
        0 without repeated poses
    poses : number of measurements at repeated poses; groups : number of distinct repeated poses
    freedom : degrees of freedom of sigma
    """

    sigma: float
    poses: int
    groups: int
    freedom: int

    @property
    def enough(self) -> bool:
        """Return whether sigma has enough degrees of freedom, 12 or more, to rely on it."""
        # With fewer than 12 degrees of freedom sigma is uncertain by more than a fifth.
        return self.freedom >= 12


def replicates(
    m: Measurements, r: Array, inliers: Array, apart: Array | None = None, measured: Array | None = None
) -> Replicates:
    """Return the standard deviation of residuals over repeated inlier poses.

    Poses are repeated if joint variables, rounded to 1e-3 rad or m, and payload, logged approach,
    tool, session and target are equal.
    r : residuals, shape (n, 3) [m]; inliers : mask of the inlier poses, shape (n,)
    apart : index of the target of each pose, shape (n,), if there are several
    measured : mask of the numbers that were measured, shape (n, 3); all by default
    """
    # These logged columns must be equal for two poses to count as repeated.
    circumstances = [
        values
        for name, values in m.conditions.items()
        if re.fullmatch(r"payload_kg|approach\d+|(tool|session)_.*", name)
    ]
    circumstances += [] if apart is None else [apart]
    # Residuals are compared, so that the small modelled difference between poses that are equal
    # after rounding does not count as scatter.
    key = np.column_stack([np.round(m.q / 1e-3), *circumstances])[inliers]
    _, group, counts = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    group = group.ravel()
    means = np.zeros((len(counts), r.shape[1]))
    np.add.at(means, group, r[inliers])
    apart = r[inliers] - (means / counts[:, None])[group]
    several = counts[counts > 1]
    numbers = np.full(len(r), r.shape[1]) if measured is None else np.count_nonzero(measured, axis=1)
    # The mean of a group of k poses takes 1 / k of the degrees of freedom of each pose.
    freedom = round(float((numbers[inliers] * (1 - 1 / counts[group])).sum()))
    sigma = float(np.sqrt((apart**2).sum() / freedom)) if freedom else 0.0
    return Replicates(sigma, int(several.sum()), len(several), freedom)


def noise_floor(e: Evidence, noise: Noise, anchor: float, seed: int) -> float:
    """Return the mean held-out error of simulated pure noise, by a fit of the base model [m].

    e : linear model, at whose poses the noise is simulated; noise : that estimated by the fit
    anchor : standard deviation of a coordinate to which the noise is scaled [m]; 0: unchanged
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
    """Return the probability, 0 to 1, that at least one of the poses is an outlier.

    The prior probability of each pose is 1 %; the noise of an outlier is larger by one of
    `OUTLIER_NOISE_FACTORS`.
    distance : squared Mahalanobis distances of the poses, of three coordinates each, shape (k,)
    """
    wide = (
        -3 * np.log(OUTLIER_NOISE_FACTORS)[:, None]
        - 0.5 * distance / OUTLIER_NOISE_FACTORS[:, None] ** 2
        + 0.5 * distance
    )
    odds = np.log(0.01 / 0.99) + np.logaddexp.reduce(wide, axis=0) - np.log(len(OUTLIER_NOISE_FACTORS))
    return float(-np.expm1(-np.logaddexp(0, odds).sum()))


def scatter_of_coordinate(e: Evidence, noise: Noise) -> float:
    """Return the rms noise of a coordinate over all poses, instrument and joints together [m]."""
    return float(np.sqrt(np.trace(e.covariance(noise), axis1=1, axis2=2).mean() / e.r.shape[1]))
