"""The linear-Gaussian model: residual, base, columns, priors, noise and the grid, and what follows from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import EVERY, ArrayColumns, Columns, Combined, Memory, combined
from casadical.core.linear_gaussian.grid import Grid
from casadical.core.linear_gaussian.marginals import Marginals
from casadical.core.linear_gaussian.noise import NoiseModel, Ratio, Whitening

# Prior standard deviation of a column's parameter once it is in the model, in sizes, where none is given.
HELD = 8.0


@dataclass(frozen=True, eq=False)
class LinearModel:
    """r = J delta + E theta + noise, delta ~ N(delta0, (sigma / reference * prior)^2), theta ~ N(0, kappa^2).

    r : residual, shape (n, m); J : base, shape (n, m, P); delta0, prior : of delta, shapes (P,)
    E : columns in units of the usual sizes of theta; an array, shape (n, m, columns), becomes `ArrayColumns`
    noise : its components; grid : where it is judged
    reference : sigma at which priors of what is in the model are as given; they grow with the noise
    held : one sigma of each theta once it is in the model, in sizes, shape (columns,); `HELD` by default
    measured : which numbers were measured, shape (n, m); all by default
    absorbed : numbers that the base takes, which tell nothing of the noise (REML: Harville 1977)
    near : points of the grid that are looked at; log_noise : what else is known of the noise, as a logarithm, shape
        (points, sigmas)
    memory : how much is held at a time
    cache : what was computed of the model: its marginal likelihoods, and whatever else its users keep
    """

    r: Array
    J: Array
    delta0: Array
    prior: Array
    E: Columns
    noise: NoiseModel
    grid: Grid
    reference: float
    held: Array | None = None
    measured: Array | None = None
    absorbed: float = 0.0
    near: tuple[int, ...] = (0,)
    log_noise: Array | float = 0.0
    memory: Memory = field(default_factory=Memory)
    cache: dict[object, Any] = field(init=False, repr=False, default_factory=dict)

    # Fields with one entry for each block.
    BY_BLOCK: ClassVar[tuple[str, ...]] = ("r", "J", "noise", "measured")

    def __post_init__(self) -> None:
        columns: Any = self.E
        if isinstance(columns, np.ndarray):
            object.__setattr__(self, "E", ArrayColumns(columns))

    @property
    def width(self) -> int:
        """Number of columns of all candidates."""
        return int(self.E.shape[2])

    @property
    def widths(self) -> Array:
        """One sigma of each column's parameter once it is in the model, in sizes, shape (columns,)."""
        return np.full(self.width, HELD) if self.held is None else self.held

    @property
    def count(self) -> int:
        """How many numbers were measured."""
        return int(self.r.size if self.measured is None else np.count_nonzero(self.measured))

    def at(self, blocks: Array) -> Self:
        """The model of some blocks."""
        given = ((name, getattr(self, name)) for name in self.BY_BLOCK)
        some: dict[str, Any] = {
            k: v.at(blocks) if isinstance(v, NoiseModel) else v[blocks] for k, v in given if v is not None
        }
        return replace(self, E=self.E.at(blocks), **some)

    def combined(self, columns: Array) -> Combined:
        """Some of the columns, in rising order, those of parts as combinations."""
        return combined(columns, self.E.directions)

    def take(self, columns: Array, blocks: Array | slice = EVERY) -> Array:
        """Some of the columns at some blocks, shape (blocks, m, len(columns))."""
        return self.E.take(columns, blocks)

    def with_base(self, columns: Array) -> Self:
        """The model with these columns, in rising order, moved into the base, as wide as they are held there.

        Log likelihoods are less by what the directions left out would add, alike everywhere.
        """
        if not len(columns):
            return self
        every = self.combined(columns)
        return self.with_known(self.E.take(columns, EVERY, every), every.one_of_each(self.widths[columns]))

    def with_known(self, columns: Array, prior: Array) -> Self:
        """The model with further columns in the base, shape (n, m, k), of zero mean; prior : shape (k,)."""
        J, delta0 = np.concatenate([self.J, columns], axis=2), np.pad(self.delta0, (0, len(prior)))
        return replace(self, J=J, delta0=delta0, prior=np.append(self.prior, prior))

    @property
    def marginals(self) -> Marginals:
        """Marginal likelihoods of all groups of columns."""
        if "marginals" not in self.cache:
            self.cache["marginals"] = Marginals(self)
        known: Marginals = self.cache["marginals"]
        return known

    def extending(self, known: LinearModel) -> Self:
        """The model, which takes over what is known of one with the same blocks and the first of the columns."""
        if "marginals" in known.cache:
            self.cache["marginals"] = known.marginals.extended(self)
        return self

    def moving(self, known: LinearModel, lost: LinearModel, gained: LinearModel) -> Self:
        """The model, which takes over what is known of one with some more (lost) and some fewer blocks (gained)."""
        if "marginals" in known.cache:
            self.cache["marginals"] = known.marginals.moved(self, lost, gained)
        return self

    @cached_property
    def absorbed_by_base(self) -> float:
        """How many numbers the base takes: the trace of what projects on it, priors included."""
        A = self.J.reshape(self.r.size, -1) * (self.prior / self.reference)
        # Not of A' A: beside a wide prior's direction its eigenvalues lose those of narrow ones.
        square = np.linalg.svd(np.linalg.qr(A, mode="r"), compute_uv=False) ** 2
        return float((square / (1 + square)).sum())

    def log_over_sigmas(self, square: float, log_norm: float) -> Array:
        """Log likelihood, shape (sigmas,); square : of what is left; log_norm : what does not depend on sigma."""
        sigmas = self.grid.sigmas
        return np.asarray(log_norm - (self.count - self.absorbed) * np.log(sigmas) - 0.5 * square / sigmas**2)

    def projection(self, ratios: Mapping[str, Ratio]) -> Projection:
        """What makes rows white and orthogonal to the base at one noise."""
        whitening = self.noise.whitening(ratios)
        weights = self.reference / self.prior
        Q, log_det = axes_of_base((whitening @ self.J).reshape(self.r.size, -1), weights)
        y = np.concatenate([(whitening @ self.r[:, :, None]).ravel(), weights * self.delta0])
        return Projection(whitening, Q, y - Q @ (Q.T @ y), -0.5 * (whitening.log_det + log_det))


def axes_of_base(A: Array, weights: Array) -> tuple[Array, float]:
    """Orthogonal axes of the base's white columns with the rows of its priors behind, and their log determinant.

    A : shape (rows, P); weights : one over the widths of the priors, shape (P,). The axes have the shape (rows + P, P).
    """
    A = np.concatenate([A, np.diag(weights)])
    # A parameter whose column is long is scaled first, so that rank is judged fairly.
    scale = np.linalg.norm(A, axis=0)
    Q, R = np.linalg.qr(A / scale)
    return Q, 2 * float(np.log(np.abs(np.diag(R)) * scale).sum())


@dataclass(frozen=True, eq=False)
class Projection:
    """A model at one noise, white and orthogonal to its base; the rows of the priors stand behind those of the blocks.

    y : what is left of the residual, shape (rows,); Q : axes of the base, shape (rows, P)
    log_norm : of the log likelihood, what depends neither on sigma nor on further columns
    """

    whitening: Whitening
    Q: Array
    y: Array
    log_norm: float

    def columns(self, E: Array) -> Array:
        """Columns, shape (n, m, k), as rows: shape (rows, k)."""
        flat = (self.whitening @ E).reshape(-1, E.shape[2])
        out = -self.Q @ (self.Q[: len(flat)].T @ flat)
        out[: len(flat)] += flat
        return np.asarray(out)
