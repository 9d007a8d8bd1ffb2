"""Noise that the campaigns of a robot have in common: of one campaign it is known too badly.

A campaign of 40 poses has little left after a fit of all parameters and harmonics. Where its residuals are small by
chance, it would be believed too much, and a change explained that. How well joints repeat and how large their harmonics
are belongs to the robot, the noise of a coordinate to the instrument: all campaigns tell of these together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadical.core.statistics import exceeded_by_chance
from casadical.fleet.estimates import Estimate
from casadical.identification.misfit import RHOS, WideFit

# Instruments are others where what they leave differs more than so many times.
OTHER = 3.0
# So often it may look like that where it is one instrument.
CHANCE = 0.01
# A joint repeats otherwise than the rest where that makes the campaigns more probable by so much, as a logarithm.
GAIN = 2.0


def with_common_noise(campaigns: Sequence[Estimate]) -> list[Estimate]:
    """Campaigns with the noise and harmonics that those by a like instrument show together; robot files as given."""
    estimates = list(campaigns)
    left = [k for k, c in enumerate(campaigns) if c.fit is not None]
    while left:
        group = [k for k in left if _alike(campaigns[left[0]], campaigns[k])]
        left = [k for k in left if k not in group]
        for k, own in zip(group, _together([campaigns[k] for k in group]), strict=True):
            estimates[k] = own
    return estimates


def _alike(a: Estimate, b: Estimate) -> bool:
    """Whether one instrument may have measured both: of few poses the scatter is known badly."""
    (s, f), (t, g) = ((c.sigma or 1e-12, c.freedom or 1.0) for c in (a, b))
    chances = exceeded_by_chance((s / t / OTHER) ** 2, f, g), exceeded_by_chance((t / s / OTHER) ** 2, g, f)
    return min(chances) > CHANCE and _own(a).keys() == _own(b).keys()


def _own(c: Estimate) -> dict[str, int]:
    """Places of the robot's parameters in an estimate: those of the tools, which may be others, are not among them."""
    return {
        n: k
        for k, n in enumerate(c.names)
        if n.startswith("joint_error_curve") or c.robot.parameters[n].group != "tool"
    }


def _together(group: Sequence[Estimate]) -> list[Estimate]:
    wide = [c.fit for c in group if c.fit is not None]
    rhos = repeatability(wide)
    fits = [w.at(rhos) for w in wide]
    weights = [len(w.poses) for w in wide]
    s2 = np.average([f.s2 for f in fits], weights=weights)
    names = list(_own(group[0]))
    at = [[_own(c)[n] for n in names] for c in group]
    mean = np.average([f.variance[k] for f, k in zip(fits, at, strict=True)], axis=0, weights=weights)
    estimates = []
    for c, f, k in zip(group, fits, at, strict=True):
        variance, unit = f.variance.copy(), s2 * c.misfit
        variance[k] = mean
        estimates.append(replace(c, information=f.sums.H / unit, score=-f.sums.g / unit, spread=np.sqrt(variance)))
    return estimates


def repeatability(fits: Sequence[WideFit]) -> tuple[float, ...]:
    """Of each turning joint over the noise of a coordinate, the most probable of RHOS by all campaigns [rad/m]."""

    def log_likelihood(rhos: tuple[float, ...]) -> float:
        return sum(fit.log_likelihood(rhos) for fit in fits)

    best = max(((rho,) * fits[0].joints for rho in RHOS), key=log_likelihood)
    better = True
    while better:
        better = False
        for j, own in enumerate(best):
            at = RHOS.index(own)
            for rho in RHOS[max(0, at - 1) : at] + RHOS[at + 1 : at + 2]:
                other = (*best[:j], rho, *best[j + 1 :])
                if log_likelihood(other) > log_likelihood(best) + GAIN:
                    best, better = other, True
    return best
