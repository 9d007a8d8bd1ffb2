"""Marginal likelihoods of groups of columns over the grid, beside the base and groups that are in the model already.

Base, chosen groups and the group that is judged are integrated in closed form, by sums over the blocks. A model with
groups in it is made from one with fewer of them; what is asked for again is kept. (MacKay 1992; Kass and Raftery 1995.)
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import Columns, Combined
from casadical.core.linear_gaussian.grid import log_gain
from casadical.core.linear_gaussian.normal_equations import Joined, joined
from casadical.core.linear_gaussian.sums import WIDE, GridSums, KnownRows

if TYPE_CHECKING:
    from casadical.core.linear_gaussian.model import LinearModel

# A wide group is judged at the likely points alone: where log evidence is within so much of the best known.
REACH = 25.0
# Sums of other blocks are made from those of known ones where at most this share of the blocks differs.
FEW = 0.2

NONE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Chosen:
    """A model with some groups in it, at every point: what is needed to judge further groups of columns.

    It is made from one with fewer groups; what this one knows is not kept again.
    log_base : log likelihood without a further group, shape (points, sigmas)
    columns : of the groups in it; new : of those that the one before has not, shape (new,); combined : these
    at : how they join what was there before, at each point
    V : columns in these axes, at each point, (columns, new); b : their products with what is left, (columns, 1)
    """

    log_base: Array
    columns: Array
    new: Array
    combined: Combined
    before: Chosen | None
    at: dict[int, Joined]
    V: dict[int, KnownRows]
    b: dict[int, KnownRows]

    def axes(self, k: int, columns: Array) -> Array:
        """Columns in the axes of all that is in the model, shape (*columns.shape, base)."""
        own = self.V[k][columns]
        return own if self.before is None else np.concatenate([self.before.axes(k, columns), own], axis=-1)

    def emptied(self, width: int) -> Chosen:
        """The same of other columns, of which nothing is known yet."""
        V, b = ({k: KnownRows(width, rows.numbers) for k, rows in part.items()} for part in (self.V, self.b))
        return replace(self, V=V, b=b)

    def widened(self, width: int, known: dict[int, Chosen]) -> Chosen:
        """The same of at least as many columns; known : those that were made, by the identity of the old one."""
        if id(self) not in known:
            V, b = ({k: rows.widened(width) for k, rows in part.items()} for part in (self.V, self.b))
            before = self.before and self.before.widened(width, known)
            known[id(self)] = replace(self, V=V, b=b, before=before)
        return known[id(self)]


class Marginals:
    """Log likelihoods of groups of columns of one model; what is asked for again is kept."""

    def __init__(self, model: LinearModel) -> None:
        self.model = model
        self.sums = GridSums(model)
        self._chosen: dict[bytes, Chosen] = {}

    def extended(self, model: LinearModel) -> Marginals:
        """Those of a model with the same blocks and these columns first, which take over what is known."""
        more = Marginals(model)
        more.sums.extend(self.sums)
        if model.width > self.model.width:
            made: dict[int, Chosen] = {}
            more._chosen = {key: chosen.widened(model.width, made) for key, chosen in self._chosen.items()}
        return more

    def of_others(self, columns: Columns, held: float) -> Marginals:
        """Those of the model with other columns, which take over what is known of its base."""
        more = copy(self)
        more.model = replace(self.model, E=columns, held=np.full(columns.shape[2], held))
        more.sums = self.sums.of_others(columns)
        more._chosen = {NONE.tobytes(): self._with(NONE).emptied(columns.shape[2])}
        return more

    def moved(self, model: LinearModel, lost: LinearModel, gained: LinearModel) -> Marginals:
        """Those of a model without some blocks (lost) and with others (gained), which are FEW."""
        more = Marginals(model)
        more.sums.move(self.sums, Marginals(lost).sums, Marginals(gained).sums)
        return more

    def log_base(self, also: Array = NONE) -> Array:
        """Log likelihood without a further group, shape (points, sigmas); also : columns that are in the model."""
        return self._with(also).log_base

    def log_grids(self, groups: Sequence[Array], also: Array = NONE) -> Array:
        """Log likelihood of each group of columns as a cause, shape (groups, points, sigmas, kappas).

        also : columns of causes that are in the model already; they are treated like the base
        """
        model, chosen = self.model, self._with(also)
        grid = model.grid
        out = np.full((len(groups), grid.points, len(grid.sigmas), len(grid.kappas)), -np.inf)
        if not groups:
            return out
        self._look_at(chosen, groups)
        self.sums.add_own(groups)
        widths = np.array([len(g) for g in groups])
        for width in np.unique(widths):
            which = np.flatnonzero(widths == width)
            if width > WIDE:
                for g in which:
                    self._wide(groups[int(g)], chosen, out[g])
                continue
            columns = np.stack([groups[int(g)] for g in which])
            own = self.sums.own([groups[int(g)] for g in which])
            for k in model.near:
                V = chosen.axes(k, columns)
                value, vector = np.linalg.eigh(own[:, k] - V @ V.transpose(0, 2, 1))
                turned = np.einsum("gij,gi->gj", vector, chosen.b[k][columns][:, :, 0])
                out[which, k] = log_gain(grid.sigmas, grid.kappas, chosen.log_base[k], value, turned)
        return out

    def look_ahead(self, chosen: Sequence[Array], groups: Sequence[Array]) -> None:
        """Add up in one go over the blocks what the groups need when they are judged beside each of the chosen ones."""
        self.sums.cross(chosen, self.model.near, np.unique(np.concatenate(groups)))

    def _with(self, columns: Array) -> Chosen:
        """The base with these columns in it too."""
        key = columns.tobytes()
        if key not in self._chosen:
            made = self._join(columns) if len(columns) else self._base()
            # Models that are kept ready for judging further groups.
            if len(self._chosen) > 2:
                self._chosen.pop(next(iter(self._chosen)))
            self._chosen[key] = made
        return self._chosen[key]

    def _base(self) -> Chosen:
        model, P, sums = self.model, self.model.J.shape[2], self.sums
        weights, at = model.reference / model.prior, {}
        for k in model.near:
            normal = np.diag(weights**2) + sums.base[k, :P, :P]
            right = sums.base[k, :P, P] + weights**2 * model.delta0
            square = float(sums.base[k, P, P] + (weights * model.delta0) @ (weights * model.delta0))
            at[k] = joined(normal, right, square, -0.5 * float(sums.log_det[k]))
        return self._made(at, NONE, None, NONE, Combined(()))

    def _join(self, columns: Array) -> Chosen:
        """A model with these columns, from the one with most of them."""
        model = self.model
        smaller = [key for key, b in self._chosen.items() if np.isin(b.columns, columns).all()]
        key = max(smaller, key=lambda key: len(self._chosen[key].columns), default=None)
        before = self._with(NONE) if key is None else self._chosen[key]
        if key is not None:  # it is likely to be asked for again
            self._chosen[key] = self._chosen.pop(key)
        new = np.setdiff1d(columns, before.columns)
        wide = self.sums.widest(new)
        if 0 < len(wide) < len(new):  # what takes long is made alone, for it is likely to stay
            before = self._with(np.union1d(before.columns, wide))
            new = np.setdiff1d(columns, before.columns)
        self._look_at(before, [new])
        weights, every = model.reference / model.widths[new], model.combined(new)
        own, at = self.sums.crossed(new, model.near, new), {}
        precision, lost = np.diag(every.one_of_each(weights**2)), every.left_out(np.log(weights))
        for k in model.near:
            along = every.combine(before.axes(k, new).T)
            normal = every.combine(own[k].T) + precision - along.T @ along
            right = every.combine(before.b[k][new][:, 0])
            at[k] = joined(normal, right, before.at[k].square, before.at[k].log_norm - lost)
        return self._made(at, columns, before, new, every)

    def _made(
        self, at: dict[int, Joined], columns: Array, before: Chosen | None, new: Array, combined: Combined
    ) -> Chosen:
        """A model from how parameters join it at each point."""
        model = self.model
        log_base = np.full((model.grid.points, len(model.grid.sigmas)), -np.inf)
        known = np.broadcast_to(model.log_noise, log_base.shape)
        for k, own in at.items():
            log_base[k] = model.log_over_sigmas(own.square, own.log_norm) + known[k]
        V, b = ({k: KnownRows(model.width, width) for k in at} for width in (len(at[model.near[0]].z), 1))
        return Chosen(log_base, columns, new, combined, before, at, V, b)

    def _look_at(self, chosen: Chosen, groups: Sequence[Array]) -> None:
        """Make known what is needed to judge these groups."""
        near, P, before = self.model.near, self.model.J.shape[2], chosen.before
        # Of those in the model already, too: a group may share some with them.
        asked = np.unique(np.concatenate(groups))
        more = asked[chosen.b[near[0]].place[asked] < 0]
        if not more.size:
            return
        cross = {}
        if before is not None:
            self._look_at(before, [more])
            cross = self.sums.crossed(chosen.new, near, more)
        for k in near:
            if before is None:
                products, left = self.sums.columns[more, k, :P], self.sums.columns[more, k, P]
            else:
                products = cross[k]
                products -= before.axes(k, more) @ chosen.combined.combine(before.axes(k, chosen.new).T)
                left = before.b[k][more][:, 0]
            V = products @ chosen.at[k].root.T
            chosen.V[k].add(more, V)
            chosen.b[k].add(more, (left - V @ chosen.at[k].z)[:, None])

    def _wide(self, group: Array, chosen: Chosen, out: Array) -> None:
        """A group of many columns, from the most probable point so far to both sides while it is within reach."""
        near, grid = self.model.near, self.model.grid
        best = int(np.argmax(chosen.log_base[list(near)].max(axis=1)))
        top = -np.inf
        for step in (1, -1):
            i = best if step > 0 else best - 1
            while 0 <= i < len(near):
                k = near[i]
                value, turned = self._spectrum(group, chosen, k)
                out[k] = log_gain(grid.sigmas, grid.kappas, chosen.log_base[k], value[None], turned[None])[0]
                if self.sums.rows < self.model.combined(group).width:
                    out[k] -= loss_of_finer_noise(self.model, chosen.log_base[k])[:, None]
                if out[k].max() < top - REACH:
                    break
                # It is not judged any further where it is so much less likely than nothing.
                if out[k].max() < float(chosen.log_base.max()) - 50.0:
                    return
                top = max(top, float(out[k].max()))
                i += step

    def _spectrum(self, group: Array, chosen: Chosen, k: int) -> tuple[Array, Array]:
        """Eigenvalues of a group's visible products and the products with what is left, in their directions."""
        every = self.model.combined(group)
        if self.sums.rows < every.width:  # fewer rows than columns: on the rows
            projection = self.model.with_base(chosen.columns).projection(self.model.grid.at(k))
            E = projection.columns(self.model.take(group))
            value, vector = np.linalg.eigh(E @ E.T)
            return value, np.sqrt(np.maximum(value, 0.0)) * (vector.T @ projection.y)
        V = every.combine(chosen.axes(k, group).T)
        value, vector = np.linalg.eigh(self.sums.wide(group, k) - V.T @ V)
        return value, vector.T @ every.combine(chosen.b[k][group][:, 0])


def loss_of_finer_noise(model: LinearModel, log_base: Array) -> Array:
    """What a cause with more parameters than rows loses where the noise is finer than without it.

    It can take up all that is left, so that only the base's priors, which grow with the noise, would say how large the
    noise is. The numbers that the base takes up do not count for a finer one (REML: Harville 1977).
    log_base : log likelihood without the cause, shape (sigmas, ...); the same shape is returned
    """
    sigmas = model.grid.sigmas.reshape(-1, *[1] * (log_base.ndim - 1))
    finer = np.log(model.grid.sigmas[np.argmax(log_base, axis=0)] / sigmas)
    return np.asarray((model.absorbed_by_base - model.absorbed) * np.maximum(finer, 0.0))
