"""The linear-Gaussian model: residual, base, columns, priors, noise and grid, and projections."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import WHOLE_AXIS, Columns, Combined, MemoryLimits, array_columns, combined
from casadical.core.linear_gaussian.noise import covariance_of, whitening_of


@dataclass(frozen=True, eq=False)
class LinearModel:
    """A linear-Gaussian model with a few base parameters and many columns of candidates.

    r = J delta + E theta + noise, delta ~ N(delta0, (sigma / reference * prior)^2),
    theta ~ N(0, kappa^2).

    r : residual, shape (n, m) for n blocks of m rows
    J : columns of the base, shape (n, m, P)
    delta0, prior : prior mean and standard deviation of delta, shape (P,)
    E : columns of the candidates, per typical size of their parameters theta; an array, shape (n,
        m, columns), becomes `Columns`
    Jq : derivative of the rows by sources of noise that the rows of a block share, shape (n, m,
        sources)
    sigmas : grid of the standard deviation of the white noise, rising, in the unit of the residual
    ratios : grid of the sources' standard deviation divided by sigma, shape (points,)
    kappas : grid of the prior standard deviation of a cause's parameters in typical sizes, rising
    reference : sigma at which the priors of delta are as given; they scale with sigma
    cause_prior : prior standard deviation of each theta once it is in the model, in typical sizes,
        shape (columns,); None: eight for all
    measured : mask of the numbers that were measured, shape (n, m); None: all
    absorbed : degrees of freedom that the base takes from the estimate of the noise (REML: Harville
        1977)
    near : indices of the grid points at which likelihoods are computed
    log_noise : log likelihood of other information on the noise, shape (points, sigmas) or a number
    memory : limits on memory
    cache : results computed for the model: its marginal likelihoods, and others of its users
    """

    r: Array
    J: Array
    delta0: Array
    prior: Array
    E: Columns
    Jq: Array
    sigmas: Array
    ratios: Array
    kappas: Array
    reference: float
    cause_prior: Array | None = None
    measured: Array | None = None
    absorbed: float = 0.0
    near: tuple[int, ...] = (0,)
    log_noise: Array | float = 0.0
    memory: MemoryLimits = field(default_factory=MemoryLimits)
    cache: dict[object, Any] = field(init=False, repr=False, default_factory=dict)

    # Names of the fields, other than E, that have one entry for each block.
    BY_BLOCK: ClassVar[tuple[str, ...]] = ("r", "J", "Jq", "measured")

    def __post_init__(self) -> None:
        columns: Any = self.E
        if isinstance(columns, np.ndarray):
            object.__setattr__(self, "E", array_columns(columns))

    @property
    def width(self) -> int:
        """Return the number of columns of all candidates."""
        return int(self.E.shape[2])

    @property
    def cause_prior_sigmas(self) -> Array:
        """Return the prior sigma of each cause parameter, in typical sizes, shape (columns,)."""
        # By default the prior is wide: the data determine a cause that is in the model.
        return np.full(self.width, 8.0) if self.cause_prior is None else self.cause_prior

    @property
    def count(self) -> int:
        """Return the number of measured rows of all blocks."""
        return int(self.r.size if self.measured is None else np.count_nonzero(self.measured))

    def at(self, blocks: Array) -> Self:
        """Return the model of some of the blocks, given by their indices or a mask."""
        given = ((name, getattr(self, name)) for name in self.BY_BLOCK)
        some: dict[str, Any] = {k: v[blocks] for k, v in given if v is not None}
        return replace(self, E=self.E.at(blocks), **some)

    def combined(self, columns: Array) -> Combined:
        """Return the combinations of columns of these indices, rising; see `columns.combined`."""
        return combined(columns, self.E.directions)

    def take(self, columns: Array, blocks: Array | slice = WHOLE_AXIS) -> Array:
        """Return the columns of some indices at some blocks, shape (blocks, m, len(columns))."""
        return self.E.take(columns, blocks)

    def with_base(self, columns: Array) -> Self:
        """Return the model with columns of these indices, rising, copied to the base.

        They stay among the candidates, so that indices keep their meaning. Their prior
        at sigma = `reference` is `cause_prior_sigmas`. Directions that change no row are dropped,
        which changes the log likelihoods by a constant.
        """
        if not len(columns):
            return self
        every = self.combined(columns)
        return self.with_base_columns(
            self.E.take(columns, WHOLE_AXIS, every), every.per_combination(self.cause_prior_sigmas[columns])
        )

    def with_base_columns(self, columns: Array, prior: Array) -> Self:
        """Return the model with k additional columns in the base.

        columns : shape (n, m, k)
        prior : prior standard deviations of their parameters at sigma = `reference`, shape (k,);
            the prior means are zero
        """
        J, delta0 = np.concatenate([self.J, columns], axis=2), np.pad(self.delta0, (0, len(prior)))
        return replace(self, J=J, delta0=delta0, prior=np.append(self.prior, prior))

    @cached_property
    def absorbed_by_base(self) -> float:
        """Return the effective number of base parameters, the trace of the base's hat matrix.

        The noise of the rows is taken as white, of standard deviation `reference`.
        """
        A = self.J.reshape(self.r.size, -1) * (self.prior / self.reference)
        # Not from A'A: the eigenvalues of narrow priors would be lost to round-off next to those of
        # wide ones.
        square = np.linalg.svd(np.linalg.qr(A, mode="r"), compute_uv=False) ** 2
        return float((square / (1 + square)).sum())

    def log_over_sigmas(self, square: float, log_norm: float) -> Array:
        """Return the log likelihood, up to a constant, for every sigma of the grid, (sigmas,).

        square : squared norm of the residual, whitened for sigma = 1
        log_norm : term of the log likelihood that does not depend on sigma
        """
        freedom = self.count - self.absorbed
        return np.asarray(log_norm - freedom * np.log(self.sigmas) - 0.5 * square / self.sigmas**2)

    def projection(self, ratio: float) -> Projection:
        """Return the projection that whitens rows and makes them orthogonal to the base.

        ratio : standard deviation of the sources of noise divided by sigma
        """
        W, log_det = whitening_of(covariance_of(self.Jq, ratio))
        weights = self.reference / self.prior
        Q, log_det_of_base = axes_of_base((W @ self.J).reshape(self.r.size, -1), weights)
        y = np.concatenate([(W @ self.r[:, :, None]).ravel(), weights * self.delta0])
        return Projection(W, Q, y - Q @ (Q.T @ y), -0.5 * (log_det + log_det_of_base))


def axes_of_base(A: Array, weights: Array) -> tuple[Array, float]:
    """Return an orthonormal basis of the whitened base with its prior rows, and a log determinant.

    The basis has the shape (rows + P, P); the determinant is that of the base's normal matrix,
    priors included.

    A : whitened columns of the base, shape (rows, P)
    weights : inverse prior standard deviations, shape (P,)
    """
    A = np.concatenate([A, np.diag(weights)])
    # Scaled to unit columns, so that rank does not depend on the units of the parameters.
    scale = np.linalg.norm(A, axis=0)
    A /= scale
    Q, R = np.linalg.qr(A)
    return Q, 2 * float(np.log(np.abs(np.diag(R)) * scale).sum())


@dataclass(frozen=True, eq=False)
class Projection:
    """Projection of rows at one level of noise: whitened, and orthogonal to the base.

    W : whitening matrix of each block for sigma = 1, shape (n, m, m)
    Q : orthonormal basis of the base, shape (n m + P, P); the rows of the P priors are last
    y : projected residual, shape (n m + P,)
    log_norm : term of the log likelihood that depends neither on sigma nor on additional columns
    """

    W: Array
    Q: Array
    y: Array
    log_norm: float

    def columns(self, E: Array) -> Array:
        """Return columns whitened and projected orthogonally to the base, shape (n m + P, k).

        The last P rows are those of the prior of the base parameters.

        E : columns before, shape (n, m, k)
        """
        flat = (self.W @ E).reshape(-1, E.shape[2])
        out = -self.Q @ (self.Q[: len(flat)].T @ flat)
        out[: len(flat)] += flat
        return np.asarray(out)
