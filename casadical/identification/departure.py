"""How far an arm departs from its nominal geometry, and the prior that follows from it.

All geometry departs from nominal by normal errors of one size s, lengths [mm] and angles [mrad] in
proportion (both one unit of `Parameter.scale`). The posterior of s and of the noise, over a grid
and with all parameters integrated out, follows from the linearised fit: a hierarchical model;
Gelman et al., Bayesian Data Analysis (2013), chapter 5, and MacKay (1992), "Bayesian
interpolation". The estimate averaged over s shrinks the free one along each eigenvector of the
information; one prior standard deviation with the same sum of shrinkage factors stands for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.noise import log_gain
from casadical.core.linear_gaussian.normal_equations import marginalised
from casadical.core.reporting.plain import WRITTEN
from casadical.core.reporting.result import Shown
from casadical.identification.identifiability import scaled_inverse
from casadical.identification.least_squares import LeastSquares
from casadical.robot.robot import Robot

# Groups of parameters whose nominal values a drawing of the arm gives.
DRAWN_GROUPS = ("geometry", "loop")
# Grid of sizes s of departures [mm for lengths, mrad for angles]; the first one stands for none.
SIZE_GRID = np.array([1e-3, *np.geomspace(0.01, 20.0, 68)])
# Prior probability that the arm does not depart from its drawing; the other sizes are equally
# probable.
PRIOR_PROBABILITY_OF_NONE = 0.3
# Largest share of a prior in the estimate (0 to 1, mean over the eigenvectors of the information)
# with which the fit without a prior is used.
MAX_PRIOR_SHARE_OF_ESTIMATE = 0.08
# Largest prior standard deviation that is used [mm, mrad]; above it, the fit without a prior is
# used: a prior that wide would constrain nothing.
MAX_PRIOR_SIZE = 3.0


@dataclass(frozen=True)
class Departure(Shown):
    """How far an arm departs from its nominal geometry: root mean square s of all departures.

    size : posterior median of s [mm for lengths, mrad for angles]
    low, high : 95 % interval [mm, mrad]
    prior : prior standard deviation of the fit [mm, mrad]; None: the poses determine the geometry,
        or it would exceed MAX_PRIOR_SIZE, and the fit is free
    """

    line: ClassVar[str] = " {{ it.size | f('.2g') }} mm ({{ it.low | f('.2g') }} to {{ it.high | f('.2g') }})"

    size: float = field(metadata=WRITTEN)
    low: float = field(metadata=WRITTEN)
    high: float = field(metadata=WRITTEN)
    prior: float | None = field(metadata=WRITTEN)

    def priors(self, robot: Robot) -> Mapping[str, tuple[float, float]]:
        """Return priors of the geometry, name -> (mean, one sigma) [SI]; {} if `prior` is None."""
        drawn = (p for p in robot.parameters if p.group in DRAWN_GROUPS)
        return {} if self.prior is None else {p.name: (p.value, self.prior * p.scale) for p in drawn}

    @property
    def visible(self) -> bool:
        """Whether the 95 % interval of the departures excludes a nominal geometry."""
        return bool(self.low > SIZE_GRID[0])

    def in_words(self) -> str:
        """Return a sentence with departure [mm, mrad rms] and prior, or a limit if not visible."""
        if not self.visible:
            return f"The geometry does not visibly depart from nominal (at most {self.high:.2g} mm and mrad rms)."
        interval = f"{self.size:.2g} mm and mrad rms ({self.low:.2g} to {self.high:.2g})"
        prior = "" if self.prior is None else "; what the poses leave open is held that near to nominal"
        return f"The geometry departs from nominal by {interval}{prior}."


def departure_of(problem: LeastSquares, v: Array, variance: float, names: Sequence[str]) -> Departure | None:
    """Return how far the geometry departs from nominal by a fit; None without free geometry.

    None, too, where the variance is zero, or the posterior cannot be computed from this fit.

    problem : as it was solved; v : its optimum
    variance : of a residual in units of sigma squared
    names : of all parameters that the measurements distinguish
    """
    geometry = [problem.robot.parameters[name].group in DRAWN_GROUPS for name in names]
    if not any(geometry) or not variance > 0:
        return None
    whole = problem if tuple(names) == problem.names else problem.with_names(names)
    value_of = dict(zip(problem.names, v, strict=False))
    at = np.concatenate([[value_of.get(name, 0.0) for name in names], v[len(problem.names) :]])
    drawn = np.flatnonzero(geometry)
    rest = np.delete(np.arange(whole.size), drawn)
    H, off = whole.information(at), at - whole.prior_mean
    slope = whole.gradient(at)[0] - whole.prior_matrix @ off
    # The sum of squares of the linearised residuals is square - 2 x'score + x'H x. In x the
    # geometry departs from nominal, all else from the point, where its priors add their part.
    score = H[:, drawn] @ at[drawn] - slope
    square = 2 * whole.cost(at) - whole.prior_square(at) + at[drawn] @ (score - slope)[drawn]
    P = variance * whole.prior_matrix[np.ix_(rest, rest)]
    score[rest] -= P @ off[rest]
    square += off[rest] @ P @ off[rest]
    inverse = scaled_inverse(H[np.ix_(rest, rest)] + P)
    information, product = marginalised(H, score, drawn, inverse)
    square -= score[rest] @ inverse @ score[rest]
    count = whole.residual_count - float(np.sum(inverse * H[np.ix_(rest, rest)]))
    return _posterior(np.linalg.eigh(information), product, max(float(square), 0.0), count, np.sqrt(variance))


def _posterior(
    eigen: tuple[Array, Array], product: Array, square: float, count: float, sigma: float
) -> Departure | None:
    """Return the arm's departure by the normal equations of its geometry, all else marginalised.

    None where the free fit is no point to linearise about: no size is likely there.

    eigen : eigenvalues and eigenvectors of the geometry's information, in units of scale and sigma
    product : J'r with its Jacobian J and the residuals r with nominal geometry, shape (p,)
    square, count : sum of squares and degrees of freedom of r
    sigma : standard deviation of a residual by the fit without a prior, in units of sigma
    """
    value, projected = np.maximum(eigen[0], 0.0), eigen[1].T @ product
    highest = max(4 * sigma, 2 * np.sqrt(square / max(count, 1.0)))
    sigmas = np.geomspace(sigma / 4, highest, max(30, int(10 * np.log(4 * highest / sigma))))
    log_base = -count * np.log(sigmas) - 0.5 * square / sigmas**2
    (log_likelihood,) = log_gain(sigmas, SIZE_GRID, log_base, value[None], projected[None])
    others = (1 - PRIOR_PROBABILITY_OF_NONE) / (len(SIZE_GRID) - 1)
    log_likelihood += np.log([PRIOR_PROBABILITY_OF_NONE, *[others] * (len(SIZE_GRID) - 1)])
    if not np.isfinite(log_likelihood.max()):
        return None
    weight = np.exp(log_likelihood - log_likelihood.max())
    weight /= weight.sum()
    # Shares of the data in the estimate along each eigenvector, at each likely size and sigma.
    likely = weight > 1e-15
    ratio = (sigmas[:, None] / SIZE_GRID)[likely]
    mean = float(weight[likely] @ (value / (value + ratio[:, None] ** 2)).sum(axis=1))
    noise = float(np.exp(weight.sum(axis=1) @ np.log(sigmas)))
    by_size = (value / (value + (noise / SIZE_GRID[:, None]) ** 2)).sum(axis=1)
    prior = float(np.exp(np.interp(mean, by_size, np.log(SIZE_GRID))))
    free = mean > (1 - MAX_PRIOR_SHARE_OF_ESTIMATE) * len(value) or prior > MAX_PRIOR_SIZE
    below = np.cumsum(weight.sum(axis=0))
    low, size, high = (float(SIZE_GRID[np.argmax(below > q)]) for q in (0.025, 0.5, 0.975))
    return Departure(size, low, high, None if free else prior)
