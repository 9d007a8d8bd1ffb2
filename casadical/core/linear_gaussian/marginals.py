"""Marginal likelihoods of groups of columns over the grid, given the base and groups in the model.

The parameters of the base, of the chosen groups and of the group that is judged are integrated in
closed form, from sums over the blocks. A model with more groups is built from one with fewer of
them, and results are cached (MacKay 1992; Kass and Raftery 1995).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import Columns, Combined
from casadical.core.linear_gaussian.model import LinearModel
from casadical.core.linear_gaussian.noise import log_gain
from casadical.core.linear_gaussian.normal_equations import Joined, joined, joined_base
from casadical.core.linear_gaussian.sums import MAX_NARROW_GROUP_COLUMNS, GridSums

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
    runs : those that `before` does not have, by runs of consecutive ones
    combined : these new columns, those of complete parts replaced by combinations
    before : model without the new columns; None for the base alone
    at : update of `before` by the new columns, by index of the grid point
    along : coefficients that project the new columns on those of each level before, of the base
        first, by index of the grid point, shape (parameters of the level, new) each
    """

    log_base: Array
    columns: Array
    runs: Sequence[Array]
    combined: Combined
    before: Chosen | None
    at: dict[int, Joined]
    along: dict[int, list[Array]]

    @property
    def levels(self) -> list[Chosen]:
        """Return the models on which this one is built, the base first, and itself."""
        return [self] if self.before is None else [*self.before.levels, self]


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
        # Results for groups, by the bytes of the chosen columns (see `_spectra`, `_spectrum`).
        self._narrow: dict[bytes, dict[bytes, tuple[Array, ...]]] = {}
        self._wide: dict[tuple[bytes, bytes, int], tuple[Array, Array]] = {}

    def of_other_columns(self, E: Columns, cause_prior: Array) -> Marginals:
        """Return the marginal likelihoods of the same model with other columns of candidates.

        cause_prior : their prior standard deviations, see `LinearModel`
        """
        other = Marginals(replace(self.model, E=E, cause_prior=cause_prior), self.sums)
        other._chosen[NO_COLUMNS.tobytes()] = self._model_with(NO_COLUMNS)
        return other

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
        out = np.full((len(groups), *map(len, (model.ratios, model.sigmas, model.kappas))), -np.inf)
        if not groups:
            return out
        spectra, widths = self._spectra(groups, chosen), np.array([len(g) for g in groups])
        for width in np.unique(widths):
            which = np.flatnonzero(widths == width)
            if width > MAX_NARROW_GROUP_COLUMNS:
                narrow = out[widths <= MAX_NARROW_GROUP_COLUMNS].max(axis=(0, 2, 3), initial=-np.inf)
                for g in which:
                    self._judge_wide_group(groups[int(g)], chosen, narrow, out[g])
                continue
            some = [spectra[groups[int(g)].tobytes()] for g in which]
            value, projected = (np.stack([own[i] for own in some]) for i in (2, 3))
            for i, k in enumerate(model.near):
                own, most = (value[:, i], projected[:, i]), chosen.at[k].square
                out[which, k] = log_gain(model.sigmas, model.kappas, chosen.log_base[k], *own, most)
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
            # The spectra are cached as long as the models, and the models on which these are built.
            used = [*self._chosen.values()]
            for model in used:
                used += [model.before] if model.before else []
            keys = {model.columns.tobytes() for model in used}
            self._narrow = {k: spectra for k, spectra in self._narrow.items() if k in keys}
        return self._chosen[key]

    def _base(self) -> Chosen:
        """Return the model with the base parameters alone, without columns of causes."""
        model, sums = self.model, self.sums
        weights = model.reference / model.prior
        grams = zip(model.near, sums.base, sums.log_det, strict=True)
        at = {k: joined_base(gram, weights, model.delta0, log_det) for k, gram, log_det in grams}
        return Chosen(self._log_base_of(at), NO_COLUMNS, (), Combined(()), None, at, {})

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
        self._prepare(before, new)
        self.sums.add_cross_products(runs := self.sums.runs(new), model.near, new)
        weights, every = model.reference / model.cause_prior_sigmas[new], model.combined(new)
        precision, lost = np.diag(every.per_combination(weights**2)), every.sum_over_dropped(np.log(weights))
        at, along = dict[int, Joined](), dict[int, list[Array]]()
        for k in model.near:
            axes, right = self._axes_and_right(before, k, new)
            parts, last = [every.combine(V.T) for V in axes], before.at[k]
            along[k] = [level.at[k].root.T @ V for level, V in zip(before.levels, parts, strict=True)]
            normal = every.combine(self.sums.cross_products(runs, k, new).T) + precision
            normal -= sum(V.T @ V for V in parts)
            at[k] = joined(normal, every.combine(right), last.square, last.log_norm - lost)
        return Chosen(self._log_base_of(at), columns, runs, every, before, at, along)

    def _log_base_of(self, at: dict[int, Joined]) -> Array:
        """Return `Chosen.log_base` of a model; at : as of `Chosen`."""
        model = self.model
        log_base = np.full((len(model.ratios), len(model.sigmas)), -np.inf)
        log_noise = np.broadcast_to(model.log_noise, log_base.shape)
        for k, own in at.items():
            log_base[k] = model.log_over_sigmas(own.square, own.log_norm) + log_noise[k]
        return log_base

    def _prepare(self, chosen: Chosen, columns: Array) -> None:
        """Accumulate the products of columns, of these indices, with those that `chosen` has."""
        if chosen.before is not None:
            self._prepare(chosen.before, columns)
            self.sums.add_cross_products(chosen.runs, self.model.near, columns)

    def _products(self, chosen: Chosen, k: int, columns: Array) -> list[Array]:
        """Return products of columns with the new ones of each level, orthogonal to those before.

        They have the shape (len(columns), new) each, of the base first. Those of all columns with
        many new ones would take more memory than all else, and are computed when they are needed.

        k : index of the grid point; columns : indices of prepared columns
        """
        products = [self.sums.columns[self.model.near.index(k)][columns][:, :-1]]
        for level in chosen.levels[1:]:
            own = self.sums.cross_products(level.runs, k, columns)
            for before, coefficients in zip(products, level.along[k], strict=True):
                own -= before @ coefficients
            products.append(own)
        return products

    def _axes_and_right(self, chosen: Chosen, k: int, columns: Array) -> tuple[list[Array], Array]:
        """Return coordinates of columns in the axes of each level, and products with the residual.

        The shapes are (len(columns), new), of the base first, and (len(columns),); the residual is
        the whitened one of the model.

        k : index of the grid point; columns : indices of prepared columns
        """
        right, axes = self.sums.columns[self.model.near.index(k)][columns][:, -1], []
        for level, products in zip(chosen.levels, self._products(chosen, k, columns), strict=True):
            axes.append(products @ level.at[k].root.T)
            right = right - axes[-1] @ level.at[k].z
        return axes, right

    def _spectra(self, groups: Iterable[Array], chosen: Chosen) -> dict[bytes, tuple[Array, ...]]:
        """Return results for narrow groups given a model, by the bytes of their indices.

        They are the Gram matrix of the columns, whitened and orthogonal to the model, shape
        (points, width, width); their products with the residual; the eigenvalues; and the products
        with the columns along the eigenvectors, shape (points, width) each. All that are cached
        are returned.

        groups : indices of the columns of each group; wider groups are ignored
        """
        known = self._narrow.setdefault(chosen.columns.tobytes(), {})
        narrow = {g.tobytes(): g for g in groups if len(g) <= MAX_NARROW_GROUP_COLUMNS}
        new = {key: g for key, g in narrow.items() if key not in known}
        if not new:
            return known
        self._prepare(chosen, np.unique(np.concatenate([*new.values()])))
        gram = {} if chosen.before else self.sums.gram_matrices(new.values())
        earlier = self._spectra(new.values(), chosen.before) if chosen.before else {}
        by_width: dict[int, list[bytes]] = {}
        for key, g in new.items():
            by_width.setdefault(len(g), []).append(key)
        # The coordinates of 512 columns are computed at a time.
        starts = [(w, i) for w, keys in by_width.items() for i in range(0, len(keys), 512 // w)]
        for w, first in starts:
            keys = by_width[w][first : first + 512 // w]
            columns = np.stack([new[key] for key in keys])
            own = np.stack([gram[key] if gram else earlier[key][0] for key in keys])
            if earlier:
                right = np.stack([earlier[key][1] for key in keys])
            else:
                right = np.stack([rows[columns][:, :, -1] for rows in self.sums.columns], axis=1)
            for i, k in enumerate(self.model.near):
                V = self._products(chosen, k, columns.ravel())[-1] @ chosen.at[k].root.T
                V = V.reshape(*columns.shape, -1)
                own[:, i] -= V @ V.transpose(0, 2, 1)
                right[:, i] -= V @ chosen.at[k].z
            value, vector = np.linalg.eigh(own)
            projected = (right[:, :, None] @ vector)[:, :, 0]
            known.update(zip(keys, zip(own, right, value, projected, strict=True), strict=True))
        return known

    def _judge_wide_group(self, group: Array, chosen: Chosen, narrow: Array, out: Array) -> None:
        """Write the log likelihood with a group of many columns into `out`.

        Grid points are visited from the likeliest of others to both sides, as long as they are not
        negligible; the others are unchanged.

        group : indices of its columns; out : shape (points, sigmas, kappas)
        narrow : largest log likelihood with a group of few columns, shape (points,)
        """
        near, model = self.model.near, self.model
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
                out[k] = log_gain(model.sigmas, model.kappas, chosen.log_base[k], *own, chosen.at[k].square)[0]
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
        key, every = (chosen.columns.tobytes(), group.tobytes(), k), self.model.combined(group)
        if key in self._wide:
            return self._wide[key]
        # With fewer rows than columns, the smaller matrix of the rows is decomposed.
        if self.model.r.size < every.width:
            projection = self.model.with_base(chosen.columns).projection(float(self.model.ratios[k]))
            E = projection.columns(self.model.take(group))
            value, vector = np.linalg.eigh(E @ E.T)
            self._wide[key] = value, np.sqrt(np.maximum(value, 0.0)) * (vector.T @ projection.y)
        else:
            self._prepare(chosen, group)
            axes, right = self._axes_and_right(chosen, k, group)
            V = every.combine(np.hstack(axes).T)
            value, vector = np.linalg.eigh(self.sums.wide_gram_matrix(group, k) - V.T @ V)
            self._wide[key] = value, vector.T @ every.combine(right)
        return self._wide[key]


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
    if not {*model.near} <= {*own.model.near} or (changed and model.near != own.model.near):
        return
    model.cache["marginals"] = more = Marginals(model, None if changed else own.sums)
    if changed:
        more.sums.move(own.sums, *map(GridSums, changed))
    else:
        more.sums.extend(own.sums)
    if model.width > own.model.width and model.near == own.model.near:
        more._chosen, more._wide = dict(own._chosen), dict(own._wide)
        more._narrow = {key: dict(spectra) for key, spectra in own._narrow.items()}


def loss_of_finer_noise(model: LinearModel, log_base: Array) -> Array:
    """Return the log-likelihood penalty on finer noise for a cause with more columns than rows.

    A cause with more parameters than rows can explain the whole residual, so that only the base's
    priors, which scale with the noise, would determine sigma. The degrees of freedom that the base
    takes do not count for a smaller sigma (REML: Harville 1977). The penalty is zero for sigmas of
    at least that of the largest `log_base`.

    log_base : log likelihood without the cause, shape (sigmas, ...), which is also the shape
        returned
    """
    sigmas = model.sigmas.reshape(-1, *[1] * (log_base.ndim - 1))
    finer = np.log(model.sigmas[np.argmax(log_base, axis=0)] / sigmas)
    return np.asarray((model.absorbed_by_base - model.absorbed) * np.maximum(finer, 0.0))
