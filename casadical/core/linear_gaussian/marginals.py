"""Marginal likelihoods of groups of columns over the grid, given the base and groups in the model.

The parameters of the base, of the chosen groups and of the group that is judged are integrated in
closed form, from sums over the blocks. A model with more groups is built from one with fewer of
them, and results are cached (MacKay 1992; Kass and Raftery 1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import Combined
from casadical.core.linear_gaussian.model import LinearModel
from casadical.core.linear_gaussian.noise import log_gain
from casadical.core.linear_gaussian.normal_equations import Joined, joined, joined_base
from casadical.core.linear_gaussian.sums import MAX_NARROW_GROUP_COLUMNS, CachedRows, GridSums

# Largest difference of log likelihoods [nats] by which a grid point may be below the maximum of a
# wide group of columns; the search to that side ends at the first that exceeds it.
POINT_LOG_EVIDENCE_WINDOW = 25.0

# The empty set of column indices.
NO_COLUMNS = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Chosen:
    """A model with some groups of columns in it, as is needed to judge additional groups.

    It extends a model with fewer groups (`before`) and stores only what that one does not.

    log_base : log likelihood without an additional group, shape (points, sigmas); minus infinity at
        points that are not in `LinearModel.near`
    columns : indices of the columns of the groups in it
    new : indices of those columns that `before` does not have, shape (new,)
    combined : the new columns, those of complete parts replaced by combinations
    before : model without the new columns; None for the base alone
    at : update of `before` by the new columns, by index of the grid point
    V : coordinates of prepared columns in the orthonormal axes of the new ones, or of the base, by
        index of the grid point, shape (columns, new)
    b : products of prepared columns with the whitened residual of this model, by index of the grid
        point, shape (columns, 1)
    """

    log_base: Array
    columns: Array
    new: Array
    combined: Combined
    before: Chosen | None
    at: dict[int, Joined]
    V: dict[int, CachedRows]
    b: dict[int, CachedRows]

    def axes(self, k: int, columns: Array) -> Array:
        """Return coordinates of columns in the orthonormal axes of all parameters of the model.

        They have the shape (*columns.shape, parameters).

        k : index of the grid point; columns : indices, any shape
        """
        own = self.V[k][columns]
        return own if self.before is None else np.concatenate([self.before.axes(k, columns), own], axis=-1)

    def widened(self, width: int, memo: dict[int, Chosen]) -> Chosen:
        """Return the same model for `width` columns, at least as many, with the same caches.

        memo : models that were widened before, by the `id` of the old ones
        """
        if id(self) not in memo:
            V, b = ({k: rows.widened(width) for k, rows in part.items()} for part in (self.V, self.b))
            before = self.before and self.before.widened(width, memo)
            memo[id(self)] = replace(self, V=V, b=b, before=before)
        return memo[id(self)]


class Marginals:
    """Marginal log likelihoods of groups of a model's columns, over its grid.

    Sums over the blocks, and models with groups in them, are cached.
    """

    def __init__(self, model: LinearModel, same: GridSums | None = None) -> None:
        # The model's cache holds this object: a cycle would wait for the garbage collector.
        self.model = copy(model)
        object.__setattr__(self.model, "cache", {})
        self.sums = GridSums(model, same)
        self._chosen: dict[bytes, Chosen] = {}

    def log_base(self, also: Array = NO_COLUMNS) -> Array:
        """Return the log likelihood of the base and some columns, shape (points, sigmas).

        also : indices of the columns. Points that are not in `near` have minus infinity.
        """
        return self._model_with(also).log_base

    def log_grids(self, groups: Sequence[Array], also: Array = NO_COLUMNS) -> Array:
        """Return the log likelihood with each group as a cause, (groups, points, sigmas, kappas).

        It is minus infinity at points that are not in `near` and what is skipped as negligible.

        groups : indices of the columns of each group, rising
        also : indices of columns that are in the model already and are treated like the base
        """
        model, chosen = self.model, self._model_with(also)
        grid = model.grid
        out = np.full((len(groups), grid.points, len(grid.sigmas), len(grid.kappas)), -np.inf)
        if not groups:
            return out
        self._prepare(chosen, groups)
        gram = self.sums.gram_matrices(groups)
        widths = np.array([len(g) for g in groups])
        for width in np.unique(widths):
            which = np.flatnonzero(widths == width)
            if width > MAX_NARROW_GROUP_COLUMNS:
                narrow = out[widths <= MAX_NARROW_GROUP_COLUMNS].max(axis=(0, 2, 3), initial=-np.inf)
                for g in which:
                    self._judge_wide_group(groups[int(g)], chosen, narrow, out[g])
                continue
            columns = np.stack([groups[int(g)] for g in which])
            own = np.stack([gram[groups[int(g)].tobytes()] for g in which])
            for k in model.near:
                V = chosen.axes(k, columns)
                value, vector = np.linalg.eigh(own[:, k] - V @ V.transpose(0, 2, 1))
                projected = np.einsum("gij,gi->gj", vector, chosen.b[k][columns][:, :, 0])
                most = chosen.at[k].square
                out[which, k] = log_gain(grid.sigmas, grid.kappas, chosen.log_base[k], value, projected, most)
        return out

    def look_ahead(self, chosen: Sequence[Array], groups: Sequence[Array]) -> None:
        """Accumulate, in one pass, the products needed to judge groups given each chosen one.

        chosen, groups : indices of the columns of each group; consecutive in each chosen one
        """
        self.sums.add_cross_products(chosen, self.model.near, np.unique(np.concatenate(groups)))

    def _model_with(self, columns: Array) -> Chosen:
        """Return the model with columns of these indices in it, from the cache if it is there."""
        key = columns.tobytes()
        if key not in self._chosen:
            made = self._join(columns) if len(columns) else self._base()
            # At most three models are cached.
            if len(self._chosen) > 2:
                self._chosen.pop(next(iter(self._chosen)))
            self._chosen[key] = made
        return self._chosen[key]

    def _base(self) -> Chosen:
        """Return the model with the base parameters alone, without columns of causes."""
        model, sums = self.model, self.sums
        weights = model.reference / model.prior
        at = {k: joined_base(sums.base[k], weights, model.delta0, sums.log_det[k]) for k in model.near}
        return self._chosen_model(at, NO_COLUMNS, None, NO_COLUMNS, Combined(()))

    def _join(self, columns: Array) -> Chosen:
        """Return a model with these columns in it, built from the cached one with most of them."""
        model = self.model
        smaller = [key for key, b in self._chosen.items() if np.isin(b.columns, columns).all()]
        key = max(smaller, key=lambda key: len(self._chosen[key].columns), default=None)
        before = self._model_with(NO_COLUMNS) if key is None else self._chosen[key]
        if key is not None:  # moved to the end, for it is likely to be asked for again
            self._chosen[key] = self._chosen.pop(key)
        new = np.setdiff1d(columns, before.columns)
        wide = self.sums.widest_cached_group(new)
        if 0 < len(wide) < len(new):  # built on its own, for it takes long and is likely to be used again
            before = self._model_with(np.union1d(before.columns, wide))
            new = np.setdiff1d(columns, before.columns)
        self._prepare(before, [new])
        weights, every = model.reference / model.cause_prior_sigmas[new], model.combined(new)
        own, at = self.sums.cross_products(new, model.near, new), {}
        precision, lost = np.diag(every.per_combination(weights**2)), every.sum_over_dropped(np.log(weights))
        for k in model.near:
            along = every.combine(before.axes(k, new).T)
            normal = every.combine(own[k].T) + precision - along.T @ along
            right = every.combine(before.b[k][new][:, 0])
            at[k] = joined(normal, right, before.at[k].square, before.at[k].log_norm - lost)
        return self._chosen_model(at, columns, before, new, every)

    def _chosen_model(
        self, at: dict[int, Joined], columns: Array, before: Chosen | None, new: Array, combined: Combined
    ) -> Chosen:
        """Return the model whose updates by new parameters are `at`, by index of the grid point.

        The other arguments are fields of `Chosen`.
        """
        model = self.model
        log_base = np.full((model.grid.points, len(model.grid.sigmas)), -np.inf)
        log_noise = np.broadcast_to(model.log_noise, log_base.shape)
        for k, own in at.items():
            log_base[k] = model.log_over_sigmas(own.square, own.log_norm) + log_noise[k]
        V, b = ({k: CachedRows(model.width, width) for k in at} for width in (len(at[model.near[0]].z), 1))
        return Chosen(log_base, columns, new, combined, before, at, V, b)

    def _prepare(self, chosen: Chosen, groups: Sequence[Array]) -> None:
        """Cache V and b (see `Chosen`) of those columns of the groups that `chosen` has not cached.

        groups : indices of the columns of each group; the grid points are `LinearModel.near`
        """
        near, P, before = self.model.near, self.model.J.shape[2], chosen.before
        # Columns in the model are prepared too: a group may share some with them.
        asked = np.unique(np.concatenate(groups))
        more = asked[chosen.b[near[0]].place[asked] < 0]
        if not more.size:
            return
        cross = {}
        if before is not None:
            self._prepare(before, [more])
            cross = self.sums.cross_products(chosen.new, near, more)
        for k in near:
            if before is None:
                products, residual_products = self.sums.columns[more, k, :P], self.sums.columns[more, k, P]
            else:
                products = cross[k]
                products -= before.axes(k, more) @ chosen.combined.combine(before.axes(k, chosen.new).T)
                residual_products = before.b[k][more][:, 0]
            V = products @ chosen.at[k].root.T
            chosen.V[k].add(more, V)
            chosen.b[k].add(more, (residual_products - V @ chosen.at[k].z)[:, None])

    def _judge_wide_group(self, group: Array, chosen: Chosen, narrow: Array, out: Array) -> None:
        """Write the log likelihood with a group of many columns into `out`.

        Grid points are visited from the likeliest of others to both sides, as long as they are not
        negligible; the others are unchanged.

        group : indices of its columns; out : shape (points, sigmas, kappas)
        narrow : largest log likelihood with a group of few columns, shape (points,)
        """
        near, grid = self.model.near, self.model.grid
        base = chosen.log_base[list(near)].max(axis=1)
        best = int(np.argmax(np.maximum(base, narrow[list(near)])))
        # Ratios of the noise differ by less than a quarter of a nat a number.
        hopeless = max(float(base.max()) - 50.0, float(narrow.max()) - max(50.0, 0.25 * self.model.r.size))
        top = -np.inf
        for step in (1, -1):
            i = best if step > 0 else best - 1
            while 0 <= i < len(near):
                k = near[i]
                value, projected = self._spectrum(group, chosen, k)
                own = value[None], projected[None]
                out[k] = log_gain(grid.sigmas, grid.kappas, chosen.log_base[k], *own, chosen.at[k].square)[0]
                if self.model.r.size < self.model.combined(group).width:
                    out[k] -= loss_of_finer_noise(self.model, chosen.log_base[k])[:, None]
                if out[k].max() < top - POINT_LOG_EVIDENCE_WINDOW:
                    break
                if out[k].max() < hopeless:
                    return
                top = max(top, float(out[k].max()))
                i += step

    def _spectrum(self, group: Array, chosen: Chosen, k: int) -> tuple[Array, Array]:
        """Return the eigenvalues of a group's Gram matrix and products with the residual, (width,).

        The columns are whitened and orthogonal to the chosen model; the products are those of the
        residual with the columns along the eigenvectors. With fewer rows than combinations of them
        the width is the number of rows plus that of the parameters in the model.

        k : index of the grid point
        """
        every = self.model.combined(group)
        # With fewer rows than columns, the smaller matrix of the rows is decomposed.
        if self.model.r.size < every.width:
            projection = self.model.with_base(chosen.columns).projection(self.model.grid.at(k))
            E = projection.columns(self.model.take(group))
            value, vector = np.linalg.eigh(E @ E.T)
            return value, np.sqrt(np.maximum(value, 0.0)) * (vector.T @ projection.y)
        V = every.combine(chosen.axes(k, group).T)
        value, vector = np.linalg.eigh(self.sums.wide_gram_matrix(group, k) - V.T @ V)
        return value, vector.T @ every.combine(chosen.b[k][group][:, 0])


def marginals_of(model: LinearModel) -> Marginals:
    """Return the marginal likelihoods of groups of a model's columns; the model caches them."""
    if "marginals" not in model.cache:
        model.cache["marginals"] = Marginals(model)
    cached: Marginals = model.cache["marginals"]
    return cached


def take_over_cache(model: LinearModel, other: LinearModel, changed: Sequence[LinearModel] = ()) -> None:
    """Give a model the cached marginal likelihoods of another one, if any, brought up to date.

    other : model with the same blocks and the first of these columns, or with other blocks
    changed : model of the blocks that `other` has and `model` has not, and model of the blocks that
        `model` has and `other` has not; empty: the blocks are the same
    """
    if "marginals" not in other.cache:
        return
    own = marginals_of(other)
    same = not changed and {*model.near} <= {*own.model.near}
    model.cache["marginals"] = more = Marginals(model, own.sums if same else None)
    if changed:
        more.sums.move(own.sums, *map(GridSums, changed))
    else:
        more.sums.extend(own.sums)
    if model.width > own.model.width:
        made: dict[int, Chosen] = {}
        more._chosen = {key: chosen.widened(model.width, made) for key, chosen in own._chosen.items()}


def loss_of_finer_noise(model: LinearModel, log_base: Array) -> Array:
    """Return the log-likelihood penalty on finer noise for a cause with more columns than rows.

    A cause with more parameters than rows can explain the whole residual, so that only the base's
    priors, which scale with the noise, would determine sigma. The degrees of freedom that the base
    takes do not count for a smaller sigma (REML: Harville 1977). The penalty is zero for sigmas of
    at least that of the largest `log_base`.

    log_base : log likelihood without the cause, shape (sigmas, ...), which is also the shape
        returned
    """
    sigmas = model.grid.sigmas.reshape(-1, *[1] * (log_base.ndim - 1))
    finer = np.log(model.grid.sigmas[np.argmax(log_base, axis=0)] / sigmas)
    return np.asarray((model.absorbed_by_base - model.absorbed) * np.maximum(finer, 0.0))
