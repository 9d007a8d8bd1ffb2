"""Noise that the campaigns of a robot have in common: of one campaign it is known too badly.

A campaign of 40 poses has little left after a fit of all parameters and harmonics. Where its residuals are small by
chance, it would be believed too much, and a change explained that. How well joints repeat and how large their harmonics
are belongs to the robot, the noise of a coordinate to the instrument: all campaigns tell of these together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadical.fleet.estimates import Estimate

# Instruments are others where what they leave differs more than so many times.
OTHER = 3.0


def with_common_noise(campaigns: Sequence[Estimate]) -> list[Estimate]:
    """Campaigns with the noise and harmonics that those by a like instrument show together; robot files as given."""
    return [_with_noise_of([c for c in campaigns if _alike(c, own)], own) for own in campaigns]


def _alike(a: Estimate, b: Estimate) -> bool:
    if a.sigma is None or b.sigma is None or not a.fits or not b.fits or a.names != b.names:
        return False
    return bool(a.sigma < OTHER * b.sigma and b.sigma < OTHER * a.sigma)


def _with_noise_of(alike: Sequence[Estimate], own: Estimate) -> Estimate:
    if not alike:
        return own
    best = int(np.argmax(np.sum([[fit.log_likelihood for fit in c.fits] for c in alike], axis=0)))
    weights = [c.poses for c in alike]
    s2 = np.average([c.fits[best].s2 for c in alike], weights=weights)
    variance = np.average([c.fits[best].variance for c in alike], axis=0, weights=weights)
    sums, unit = own.fits[best].sums, s2 * own.misfit
    return replace(own, information=sums.H / unit, score=-sums.g / unit, spread=np.sqrt(variance))
