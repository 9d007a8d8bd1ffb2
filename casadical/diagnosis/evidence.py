"""Marginal likelihoods of causes: Gaussian effects of realistic size on the residual, orthogonal to the base model.

The residual is r = J delta + E theta + noise, with noise covariance sigma^2 (I + rho^2 Jq Jq') of instrument and joint
repeatability, delta ~ N(delta0, prior) and theta ~ N(0, (kappa size)^2). delta and theta are integrated in closed
form; sigma, rho and kappa on grids. This projects out base parameters that the data determine well; one that they
determine badly keeps its prior. (MacKay 1992; Kass and Raftery 1995.)

Only sums over poses of products of columns are needed. They are added up some poses at a time, so that memory does not
grow with poses times columns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.linearisation import EVERY, Columns
from casadical.effects.base import CHOSEN

SIGMAS = np.geomspace(3e-6, 300e-6, 33)
# The same steps from 1 um to 11 mm, for instruments that are finer or coarser.
ALL_SIGMAS = SIGMAS[0] * (SIGMAS[-1] / SIGMAS[0]) ** (np.arange(-8, 58) / (len(SIGMAS) - 1))
# Joint repeatability over the instrument's sigma [rad/m].
RHOS = np.array([0.0, 0.1, 0.2, 0.4, 0.8, 1.6])
KAPPAS = np.array([0.35, 0.7, 1.4, 2.8, 5.6])
KAPPA_WEIGHTS = np.array([0.15, 0.25, 0.3, 0.2, 0.1])
# Poses whose columns are in memory at a time.
BLOCK = 256
# Groups of so many columns, and of more than there are rows, are judged on the rows instead.
WIDE = 64
# A wide group is judged at the likely rhos alone: where log evidence is within so much of the best found.
REACH = 25.0
# It is not judged any further where it is so much less likely than nothing.
HOPELESS = 50.0
# Models that are kept ready for judging further groups.
MOST_BESIDE = 2


@dataclass(frozen=True, eq=False)
class Whitened:
    """The problem at one rho: residual and columns made white and orthogonal to the base model.

    y : shape (rows,); E : shape (rows, columns), columns in units of their size
    rows : how many numbers were measured; log_norm : what does not depend on sigma or cause
    """

    y: Array
    E: Array
    rows: int
    log_norm: float


def taken(E: Array | Columns, columns: Array, poses: Array | slice = EVERY) -> Array:
    """Some columns at some poses, shape (poses, 3, len(columns))."""
    return E[poses][:, :, columns] if isinstance(E, np.ndarray) else E.take(columns, poses)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Residuals of a calibrated robot, what the base model and the candidate causes do to them.

    r : measured less modelled position, shape (n, 3) [m]
    J : base model's Jacobian, shape (n, 3, P); Jq : by joint variables, shape (n, 3, joints)
    delta0 : prior mean of the parameters less their present values, shape (P,); prior : one sigma, shape (P,)
    E : columns of all candidates, in m per unit of size: an array, shape (n, 3, columns), or made when asked for
    reference : sigma at which the priors of what is in the model are as given [m]; they grow with the noise
    held : one sigma of each column's parameter once it is in the model, in sizes, shape (columns,); CHOSEN by default
    near : numbers of the rhos that are looked at; all of them until an effect of many parameters is in the model
    repeats : scatter of a coordinate over repeated poses [m], and its degrees of freedom; none without them
    sigmas : of the instrument, on a grid [m]
    """

    r: Array
    J: Array
    Jq: Array
    delta0: Array
    prior: Array
    E: Array | Columns
    reference: float = 20e-6
    held: Array | None = None
    near: tuple[int, ...] = tuple(range(len(RHOS)))
    repeats: tuple[float, int] = (0.0, 0)
    sigmas: Array = field(default_factory=lambda: SIGMAS)

    @property
    def width(self) -> int:
        """Number of columns of all candidates."""
        return int(self.E.shape[2])

    def take(self, columns: Array, poses: Array | slice = EVERY) -> Array:
        """Some of the candidates' columns at some poses, shape (poses, 3, len(columns)) [m per unit of size]."""
        return taken(self.E, columns, poses)

    def only(self, columns: Array) -> Array | Columns:
        """Some of the candidates' columns, all those of an effect or none, made when asked for."""
        return self.E[:, :, columns] if isinstance(self.E, np.ndarray) else self.E.only(columns)

    def width_in_model(self, columns: Array) -> Array:
        """One sigma of these columns' parameters once they are in the model, in sizes, shape (len(columns),)."""
        return np.full(len(columns), CHOSEN) if self.held is None else self.held[columns]

    def at(self, poses: Array) -> Evidence:
        """The problem of some poses."""
        E = self.E[poses] if isinstance(self.E, np.ndarray) else self.E.at(poses)
        return replace(self, r=self.r[poses], J=self.J[poses], Jq=self.Jq[poses], E=E)

    def white(self, rho: float, E: Array) -> Whitened:
        """The problem at one rho, joint repeatability over the instrument's sigma [rad/m].

        E : the columns that are wanted, shape (n, 3, columns)
        """
        C = np.eye(3) + rho**2 * self.Jq @ self.Jq.transpose(0, 2, 1)
        L = np.linalg.cholesky(C)
        W = np.linalg.inv(L)
        flat = [(W @ part).reshape(self.r.size, -1) for part in (self.r[:, :, None], self.J, E)]
        weights = self.reference / self.prior
        A = np.concatenate([flat[1], np.diag(weights)])
        # A parameter whose column is long is scaled first, so that rank is judged fairly.
        Q, R = np.linalg.qr(A / np.linalg.norm(A, axis=0))
        y = np.concatenate([flat[0].ravel(), weights * self.delta0])
        rows = self.r.size
        E = -Q @ (Q[:rows].T @ flat[2])
        E[:rows] += flat[2]
        log_det = 2 * float(np.log(np.diagonal(L, axis1=1, axis2=2)).sum())
        log_det += 2 * float(np.log(np.abs(np.diag(R)) * np.linalg.norm(A, axis=0)).sum())
        return Whitened(y - Q @ (Q.T @ y), E, rows, -0.5 * log_det)

    def with_base(self, columns: Array) -> Evidence:
        """The problem with these columns moved into the base model, as wide as they are held there."""
        if not len(columns):
            return self
        return replace(
            self,
            J=np.concatenate([self.J, self.take(columns)], axis=2),
            delta0=np.concatenate([self.delta0, np.zeros(len(columns))]),
            prior=np.concatenate([self.prior, self.width_in_model(columns)]),
        )

    @cached_property
    def sums(self) -> Sums:
        """Sums over the poses, by which all groups are judged."""
        return Sums(self)

    def log_base(self, also: Array | None = None) -> Array:
        """Log likelihood without a further cause, shape (rhos, sigmas); also : columns that are in the model."""
        return self.sums.beside(also).log_base

    def log_grids(self, groups: Sequence[Array], also: Array | None = None) -> Array:
        """Log likelihood of each group of columns as a cause, shape (groups, rhos, sigmas, kappas).

        also : columns of causes that are in the model already; they are treated like the base model
        """
        return self.sums.log_grids(groups, also)


@dataclass(frozen=True, eq=False)
class Beside:
    """The base model with some causes in it, at every rho: what is needed to judge further groups of columns.

    log_base : log likelihood without a further cause, shape (rhos, sigmas)
    chosen : columns of the causes in it; root : of the inverse of its normal matrix, at each rho, shape (base, base)
    z : fit of the base model in the axes of the root, at each rho, shape (base,)
    V : all columns in these axes, at each rho, shape (base, columns)
    b : products of all columns with what is left, at each rho, shape (columns,)
    """

    log_base: Array
    chosen: Array
    root: dict[int, Array]
    z: dict[int, Array]
    V: dict[int, Array]
    b: dict[int, Array]


class Sums:
    """Sums over poses of products of whitened columns, at every rho.

    In the axes of a pose's joint repeatability its whitening at any rho is a weight for each of three rows, so that
    columns are turned once and weighted for each rho.
    """

    def __init__(self, e: Evidence, known: Sums | None = None) -> None:
        """Of a fit; known : sums of the same poses and the first of the columns."""
        self.e = e
        self._cross: dict[tuple[int, int], Array] = {}
        self._beside: dict[bytes, Beside] = {}
        self._own: dict[bytes, Array] = dict(known._own) if known else {}
        if known:
            self._take_over(known)
            return
        square, self._turn = np.linalg.eigh(e.Jq @ e.Jq.transpose(0, 2, 1))
        square = np.maximum(square, 0.0).reshape(-1)
        self._weight = 1 / (1 + np.outer(RHOS**2, square))
        self.log_det = np.log1p(np.outer(RHOS**2, square)).sum(axis=1)
        r, J = (self._turned(part, slice(None)) for part in (e.r[:, :, None], e.J))
        self._base = np.concatenate([J, r], axis=1)
        self.base = self._base.T @ (self._weight[:, :, None] * self._base)
        self.columns = self._by_base(e.E)

    def _by_base(self, E: Array | Columns) -> Array:
        """Products of columns with the base model's and the residual, shape (columns, rhos, P + 1)."""
        weighted = np.concatenate([*(self._weight[:, :, None] * self._base)], axis=1)
        return self._products(E, weighted).reshape(E.shape[2], len(RHOS), -1)

    def _take_over(self, known: Sums) -> None:
        """Take over what is known and add up what is new."""
        self._turn, self._weight, self.log_det = known._turn, known._weight, known.log_det
        self._base, self.base = known._base, known.base
        self.columns = known.columns
        if self.e.width == known.e.width:
            return
        new = self.e.E.after(known.e.width) if isinstance(self.e.E, Columns) else self.e.E[:, :, known.e.width :]
        self.columns = np.concatenate([known.columns, self._by_base(new)])
        for (first, last), cross in known._cross.items():
            more = self._crossed(new, np.arange(first, last + 1))
            self._cross[first, last] = np.concatenate([cross, more])
        for key, beside in known._beside.items():
            self._beside[key] = self._judging(beside, known.e.width)

    def _turned(self, part: Array, poses: slice) -> Array:
        """Columns in the axes of each pose's repeatability, shape (rows, columns)."""
        turned = self._turn[poses].transpose(0, 2, 1) @ part
        return np.asarray(turned.reshape(-1, part.shape[2]))

    def _blocks(self, E: Array | Columns) -> Iterator[tuple[Array, slice]]:
        """All columns of some poses, turned, and the rows where they stand."""
        for first in range(0, len(self.e.r), BLOCK):
            poses = slice(first, min(first + BLOCK, len(self.e.r)))
            some = E[poses] if isinstance(E, np.ndarray) else E.block(poses)
            yield self._turned(some, poses), slice(3 * poses.start, 3 * poses.stop)

    def _products(self, E: Array | Columns, right: Array) -> Array:
        """Products of columns with others, shape (columns, others); right : shape (rows, others)."""
        total = np.zeros((E.shape[2], right.shape[1]))
        for some, rows in self._blocks(E):
            total += some.T @ right[rows]
        return total

    def _crossed(self, E: Array | Columns, run: Array) -> Array:
        """Products of columns with some of all the columns, shape (columns, rhos that are looked at, run)."""
        other = self._turned(self.e.take(run), slice(None))
        return np.stack([self._products(E, self._weight[k][:, None] * other) for k in self.e.near], axis=1)

    def _with(self, columns: Array) -> Array:
        """Products of all columns with these, shape (columns, rhos that are looked at, these); kept by runs."""
        runs = np.split(columns, np.flatnonzero(np.diff(columns) != 1) + 1)
        for run in runs:
            key = int(run[0]), int(run[-1])
            if key not in self._cross:
                self._cross[key] = self._crossed(self.e.E, run)
        return np.concatenate([self._cross[int(run[0]), int(run[-1])] for run in runs], axis=2)

    def own(self, groups: Sequence[Array]) -> None:
        """Add up the products of each group's columns among themselves, shape (rhos, width, width), all in one go."""
        new = {g.tobytes(): g for g in groups if g.tobytes() not in self._own}
        by_width: dict[int, list[Array]] = {}
        for g in new.values():
            if len(g) <= WIDE:
                by_width.setdefault(len(g), []).append(g)
        stacks = {w: np.stack(gs) for w, gs in by_width.items()}
        totals = {w: np.zeros((len(RHOS), len(s), w, w)) for w, s in stacks.items()}
        if not stacks:
            return
        used = np.unique(np.concatenate([which.ravel() for which in stacks.values()]))
        for E, rows in self._blocks(self.e.only(used)):
            by_column = np.ascontiguousarray(E.T)
            for w, which in stacks.items():
                part = by_column[np.searchsorted(used, which)]
                for k, weight in enumerate(self._weight[:, rows]):
                    scaled = part * np.sqrt(weight)
                    totals[w][k] += scaled @ scaled.transpose(0, 2, 1)
        for w, which in stacks.items():
            for i, g in enumerate(which):
                self._own[g.tobytes()] = totals[w][:, i]

    def _wide_own(self, group: Array, k: int) -> Array:
        """Products of a wide group's columns among themselves at one rho, shape (width, width)."""
        key = group.tobytes() + bytes([k])
        if key not in self._own:
            total = np.zeros((len(group), len(group)))
            for E, rows in self._blocks(self.e.only(group)):
                scaled = E * np.sqrt(self._weight[k, rows])[:, None]
                total += scaled.T @ scaled
            self._own[key] = total
        return self._own[key]

    def _on_rows(self, width: int) -> bool:
        """Whether a group is judged on the rows, of which there are fewer than columns."""
        return width > WIDE and self._base.shape[0] < width

    def beside(self, also: Array | None = None) -> Beside:
        """The base model with these columns in it too."""
        chosen = np.zeros(0, dtype=np.int64) if also is None else also
        key = chosen.tobytes()
        if key not in self._beside:
            if len(self._beside) > MOST_BESIDE:
                self._beside.pop(next(iter(self._beside)))
            self._beside[key] = self._judging(self._fitted(chosen))
        return self._beside[key]

    def _fitted(self, chosen: Array) -> Beside:
        """The base model with these columns in it, fitted at every rho."""
        e, P = self.e, self.e.J.shape[2]
        prior = np.concatenate([e.prior, e.width_in_model(chosen)])
        mean = np.concatenate([e.delta0, np.zeros(len(chosen))])
        weights = e.reference / prior
        log_base = np.full((len(RHOS), len(e.sigmas)), -np.inf)
        root, fitted = {}, {}
        for i, k in enumerate(e.near):
            normal = np.diag(weights**2)
            normal[:P, :P] += self.base[k, :P, :P]
            if len(chosen):
                normal[:P, P:] += self.columns[chosen, k, :P].T
                normal[P:, :P] += self.columns[chosen, k, :P]
                normal[P:, P:] += self._with(chosen)[chosen, i]
            right = np.concatenate([self.base[k, :P, P], self.columns[chosen, k, P]]) + weights**2 * mean
            # A parameter whose column is long is scaled first, so that rank is judged fairly.
            scale = 1 / np.sqrt(np.diag(normal))
            L = np.linalg.cholesky(normal * np.outer(scale, scale))
            root[k] = np.linalg.inv(L) * scale
            fitted[k] = root[k] @ right
            square = float(self.base[k, P, P] + (weights * mean) @ (weights * mean) - fitted[k] @ fitted[k])
            log_norm = -0.5 * self.log_det[k] - float((np.log(np.diag(L)) - np.log(scale)).sum())
            log_base[k] = log_norm - e.r.size * np.log(e.sigmas) - 0.5 * square / e.sigmas**2 + self._log_repeats(k)
        return Beside(log_base, chosen, root, fitted, {}, {})

    def _log_repeats(self, k: int) -> Array:
        """Log likelihood of the scatter of repeated poses at a rho, shape (sigmas,)."""
        scatter, freedom = self.e.repeats
        # Mean over coordinates of the noise's variance in units of sigma^2.
        total = float(1 + RHOS[k] ** 2 * (self.e.Jq**2).sum(axis=2).mean()) * self.e.sigmas**2
        return np.asarray(-0.5 * freedom * (np.log(total / self.e.sigmas[-1] ** 2) + scatter**2 / total))

    def _judging(self, beside: Beside, known: int = 0) -> Beside:
        """The same with what is needed to judge all columns, the first of which may be known."""
        P, V, b = self.e.J.shape[2], {}, {}
        cross = self._with(beside.chosen) if len(beside.chosen) else None
        judged = np.setdiff1d(np.arange(known, self.e.width), beside.chosen)
        for i, k in enumerate(self.e.near):
            EJ = self.columns[judged, k, :P]
            if cross is not None:
                EJ = np.concatenate([EJ, cross[judged, i]], axis=1)
            V[k] = np.zeros((len(beside.root[k]), self.e.width - known))
            V[k][:, judged - known] = beside.root[k] @ EJ.T
            b[k] = self.columns[known:, k, P] - beside.z[k] @ V[k]
            if known:
                V[k] = np.concatenate([beside.V[k], V[k]], axis=1)
                b[k] = np.concatenate([beside.b[k], b[k]])
        return replace(beside, V=V, b=b)

    def log_grids(self, groups: Sequence[Array], also: Array | None = None) -> Array:
        """See `Evidence.log_grids`."""
        beside = self.beside(also)
        out = np.full((len(groups), len(RHOS), len(self.e.sigmas), len(KAPPAS)), -np.inf)
        self.own(groups)
        widths = np.array([len(g) for g in groups])
        for width in np.unique(widths):
            which = np.flatnonzero(widths == width)
            if width > WIDE:
                for g in which:
                    self._wide(groups[int(g)], beside, also, out[g])
                continue
            columns = np.stack([groups[int(g)] for g in which])
            own = np.stack([self._own[groups[int(g)].tobytes()] for g in which])
            for k in self.e.near:
                V = beside.V[k].T[columns]
                value, vector = np.linalg.eigh(own[:, k] - V @ V.transpose(0, 2, 1))
                turned = np.einsum("gij,gi->gj", vector, beside.b[k][columns])
                out[which, k] = _log_gain(self.e.sigmas, beside.log_base[k], value, turned)
        return out

    def _wide(self, group: Array, beside: Beside, also: Array | None, out: Array) -> None:
        """A group of many columns, from the most probable rho so far to both sides while it is within reach."""
        near = self.e.near
        best = int(np.argmax(beside.log_base[list(near)].max(axis=1)))
        top = -np.inf
        for step in (1, -1):
            i = best if step > 0 else best - 1
            while 0 <= i < len(near):
                k = near[i]
                value, turned = self._spectrum(group, beside, also, k)
                out[k] = _log_gain(self.e.sigmas, beside.log_base[k], value[None], turned[None])[0]
                if out[k].max() < top - REACH:
                    break
                if out[k].max() < float(beside.log_base.max()) - HOPELESS:
                    return
                top = max(top, float(out[k].max()))
                i += step

    def _spectrum(self, group: Array, beside: Beside, also: Array | None, k: int) -> tuple[Array, Array]:
        """Eigenvalues of a group's visible products and the products with what is left, in their directions."""
        if self._on_rows(len(group)):
            chosen = np.zeros(0, dtype=np.int64) if also is None else also
            w = self.e.with_base(chosen).white(float(RHOS[k]), self.e.take(group))
            value, vector = np.linalg.eigh(w.E @ w.E.T)
            return value, np.sqrt(np.maximum(value, 0.0)) * (vector.T @ w.y)
        V = beside.V[k][:, group]
        value, vector = np.linalg.eigh(self._wide_own(group, k) - V.T @ V)
        return value, vector.T @ beside.b[k][group]


def _log_gain(sigmas: Array, log_base: Array, value: Array, turned: Array) -> Array:
    """Log likelihood with groups of columns, shape (groups, sigmas, kappas), from that without, shape (sigmas,).

    value, turned : eigenvalues of their visible products, and products with what is left, shapes (groups, width)
    """
    signal = (KAPPAS[None, :] / sigmas[:, None]) ** 2
    gain = 1 + signal[None, :, :, None] * np.maximum(value, 0)[:, None, None, :]
    quad = (signal[None, :, :, None] * turned[:, None, None, :] ** 2 / gain).sum(axis=3) / sigmas[None, :, None] ** 2
    return np.asarray(log_base[None, :, None] - 0.5 * np.log(gain).sum(axis=3) + 0.5 * quad)


def log_sum(a: Array, axis: int | tuple[int, ...] | None = None) -> Array:
    """log(sum(exp(a))) without overflow."""
    top = np.max(a, axis=axis, keepdims=True)
    total = np.log(np.exp(a - top).sum(axis=axis, keepdims=True)) + top
    return np.asarray(np.squeeze(total, axis=axis) if axis is not None else total.item())
