"""Evidence that something changed between campaigns: Gaussian changes of realistic size, all else integrated.

Campaign i tells of its parameters theta_i = theta + sum of s_ji E_j a_j: what the robot is, and changes of size a_j
along columns E_j with a course s_ji over the campaigns (a jump, a drift, a season). With information H_i and score b_i
of each campaign, all is linear and Gaussian. Integrating theta projects it out, where the data determine it, and the
amplitudes a ~ N(0, (kappa size)^2) have closed form; kappa is on a grid.

The evidence of a change, averaged over candidates, courses and times by weights that were fixed before the data, is a
martingale as campaigns come in while nothing changes: it ever reaches 1 / p with probability p at most (Ville 1939).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.grid import gain, log_sum
from casadical.core.linear_gaussian.normal_equations import inverse_of, root_of_inverse
from casadical.core.statistics import first_of_best

# Sizes of a change in units of its usual one.
KAPPAS = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
# A change is not searched where its direction is seen less than this, in squared units of its size.
UNSEEN = 1e-6


@dataclass(frozen=True, eq=False)
class SharedInformation:
    """Campaigns about common values, in units of the scale: what they tell of p parameters that they share.

    information : shape (n, p, p); score : shape (n, p); precision : of theta before the data, shape (p,)
    """

    information: Array
    score: Array
    precision: Array

    def with_jitter(self, columns: Array, sizes: Array) -> SharedInformation:
        """With what comes and goes in each campaign alone; columns : shape (p, m); sizes : one sigma of each."""
        HD = self.information @ columns
        inner = np.array([inverse_of(own) for own in columns.T @ HD + np.diag(sizes**-2.0)])
        lost = HD @ inner
        b = self.score - (lost @ (self.score @ columns)[:, :, None])[:, :, 0]
        return SharedInformation(self.information - lost @ HD.transpose(0, 2, 1), b, self.precision)

    def first(self, n: int) -> SharedInformation:
        """Of the first campaigns alone."""
        return SharedInformation(self.information[:n], self.score[:n], self.precision)


@dataclass(frozen=True, eq=False)
class Known:
    """Changes that are in the model already: columns over all campaigns, shape (n, p, m), and sizes, shape (m,)."""

    columns: Array
    sizes: Array


@dataclass(frozen=True, eq=False)
class Model:
    """Theta and known changes, solved for: what is left for a further change.

    root : R of the covariance R'R of u = (theta, known amplitudes); turned : R times the score of u
    """

    told: SharedInformation
    known: Known
    root: Array = field(repr=False)
    turned: Array = field(repr=False)

    @property
    def inverse(self) -> Array:
        return self.root.T @ self.root

    @property
    def mean(self) -> Array:
        """Of u."""
        return self.root.T @ self.turned

    @property
    def p(self) -> int:
        return int(self.told.score.shape[1])


def solve(told: SharedInformation, known: Known | None = None) -> Model:
    """Theta and the known changes, given all campaigns."""
    n, p = told.score.shape
    known = known or Known(np.zeros((n, p, 0)), np.zeros(0))
    X = np.concatenate([np.broadcast_to(np.eye(p), (n, p, p)), known.columns], axis=2)
    HX = told.information @ X
    Lambda = np.tensordot(X, HX, axes=([0, 1], [0, 1]))
    Lambda += np.diag(np.concatenate([told.precision, known.sizes**-2.0]))
    root = root_of_inverse(Lambda)
    return Model(told, known, root, root @ np.einsum("npi,np->i", X, told.score))


def visible(model: Model, E: Array, courses: Array) -> tuple[Array, Array]:
    """Information and score of a change along columns E with each of several courses.

    E : shape (p, m); courses : shape (c, n, k), of each campaign k factors. Returns shapes (c, km, km) and (c, km).
    """
    information = model.told
    (c, n, k), m = courses.shape, E.shape[1]
    HE = information.information @ E
    flat = courses.transpose(0, 2, 1).reshape(c * k, n)
    squares = (courses[:, :, :, None] * courses[:, :, None, :]).transpose(0, 2, 3, 1).reshape(c * k * k, n)
    H = (squares @ (E.T @ HE).reshape(n, m * m)).reshape(c, k, k, m, m).transpose(0, 1, 3, 2, 4)
    H = H.reshape(c, k * m, k * m)
    HEu = HE
    if model.known.sizes.size:
        HEu = np.concatenate([HE, model.known.columns.transpose(0, 2, 1) @ HE], axis=1)
    C = (flat @ HEu.reshape(n, -1)).reshape(c, k, -1, m).transpose(0, 2, 1, 3).reshape(c, -1, k * m)
    b = (flat @ (information.score @ E)).reshape(c, k * m)
    # A change along known ones is the small difference of large numbers: squares of the root keep twice the digits that
    # products with the inverse do.
    C = model.root @ C
    return H - C.transpose(0, 2, 1) @ C, b - model.turned @ C


def log_evidence(H: Array, b: Array, sizes: Array) -> Array:
    """Log of how many times more probable the data are with changes than without, shape (c, kappas).

    H, b : as of `visible`; sizes : usual one of each column, shape (m,)
    """
    values, V = np.linalg.eigh(sizes[:, None] * H * sizes)
    values = np.maximum(values, 0.0)
    turned = (V.transpose(0, 2, 1) @ (sizes * b)[:, :, None])[:, :, 0] ** 2
    return gain(KAPPAS**-2.0, 1.0, values, turned)


def averaged(logs: Array) -> Array:
    """Mean evidence over the sizes, as a logarithm; logs : shape (..., kappas)."""
    return np.asarray(log_sum(logs, axis=-1) - np.log(len(KAPPAS)))


def amplitude(H: Array, b: Array, sizes: Array, logs: Array) -> tuple[Array, Array, float]:
    """Mean, shape (m,), and covariance of one change's amplitudes, at its most probable size, which is returned too."""
    kappa = float(KAPPAS[first_of_best(logs, logs=True)])
    C = inverse_of(H + np.diag((kappa * sizes) ** -2.0))
    return C @ b, C, kappa


def jumps(n: int) -> Array:
    """Courses of a change at each campaign but the first, shape (n - 1, n, 1)."""
    return (np.arange(n) >= np.arange(1, n)[:, None]).astype(float)[:, :, None]


def drifts(times: Sequence[float] | Array) -> Array:
    """Courses of a drift that begins after each campaign but the last, shape (n - 1, n, 1), a unit of time one."""
    t = np.asarray(times, dtype=float)
    return np.asarray(np.maximum(0.0, t - t[:-1, None])[:, :, None])


def season(times: Sequence[float] | Array) -> Array:
    """Course of what comes again every unit of time, shape (1, n, 2)."""
    turn = 2 * np.pi * np.asarray(times, dtype=float)
    return np.stack([np.sin(turn), np.cos(turn)], axis=-1)[None]
