"""Marginal likelihoods of causes: Gaussian effects of realistic size on the residual, orthogonal to the base model.

The residual is r = J delta + E theta + noise, with noise covariance sigma^2 (I + rho^2 Jq Jq') of instrument and joint
repeatability, delta ~ N(delta0, prior) and theta ~ N(0, (kappa size)^2). delta and theta are integrated in closed
form; sigma, rho and kappa on grids. This projects out base parameters that the data determine well; one that they
determine badly keeps its prior. (MacKay 1992; Kass and Raftery 1995.)

Only sums over poses of products of columns are needed. They are added up some poses at a time, so that memory does not
grow with poses times columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.added import Added, added
from casadical.diagnosis.combinations import Combined
from casadical.diagnosis.gains import log_gain
from casadical.diagnosis.linearisation import EVERY, Columns
from casadical.diagnosis.sums import WIDE, Kept, Sums, combined_of, taken
from casadical.effects.base import CHOSEN

SIGMAS = np.geomspace(3e-6, 300e-6, 33)
# The same steps from 1 um to 11 mm, for instruments that are finer or coarser.
ALL_SIGMAS = SIGMAS[0] * (SIGMAS[-1] / SIGMAS[0]) ** (np.arange(-8, 58) / (len(SIGMAS) - 1))
# Joint repeatability over the instrument's sigma [rad/m].
RHOS = np.array([0.0, 0.1, 0.2, 0.4, 0.8, 1.6])
KAPPAS = np.array([0.35, 0.7, 1.4, 2.8, 5.6])
KAPPA_WEIGHTS = np.array([0.15, 0.25, 0.3, 0.2, 0.1])
# Sums of other poses are made from those of known ones if at most this share of the poses differs.
FEW = 0.2
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
    measured : which of a pose's numbers were measured, shape (n, 3), all by default; of other kinds of measurement than
        positions there are others than three, in units in which their noise is alike
    size : of each number in the error that reports tell [m], shape (n, 3), one by default
    alike : number of the unknown point that each pose shares with others, shape (n,), where there are such
    absorbed : numbers that the base model's parameters take, which tell nothing of the noise; with one number at a
        pose they are a large share, and a cause that follows noise would gain by them (compare REML: Harville 1977)
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
    measured: Array | None = None
    size: Array | None = None
    alike: Array | None = None
    absorbed: float = 0.0

    @property
    def count(self) -> int:
        """How many numbers were measured."""
        return int(self.r.size if self.measured is None else np.count_nonzero(self.measured))

    @property
    def width(self) -> int:
        """Number of columns of all candidates."""
        return int(self.E.shape[2])

    def combined(self, columns: Array) -> Combined:
        """Some of the candidates' columns, in rising order, those of parts of effects as combinations."""
        return combined_of(self.E, columns)

    def take(self, columns: Array, poses: Array | slice = EVERY) -> Array:
        """Some of the candidates' columns at some poses, shape (poses, 3, len(columns)) [m per unit of size]."""
        return taken(self.E, columns, poses)

    def width_in_model(self, columns: Array) -> Array:
        """One sigma of these columns' parameters once they are in the model, in sizes, shape (len(columns),)."""
        return np.full(len(columns), CHOSEN) if self.held is None else self.held[columns]

    def at(self, poses: Array) -> Evidence:
        """The problem of some poses."""
        E = self.E[poses] if isinstance(self.E, np.ndarray) else self.E.at(poses)
        kept = {name: of[poses] for name in ("measured", "size", "alike") if (of := getattr(self, name)) is not None}
        return replace(self, r=self.r[poses], J=self.J[poses], Jq=self.Jq[poses], E=E, **kept)

    def white(self, rho: float, E: Array) -> Whitened:
        """The problem at one rho, joint repeatability over the instrument's sigma [rad/m].

        E : the columns that are wanted, shape (n, 3, columns)
        """
        C = np.eye(self.r.shape[1]) + rho**2 * self.Jq @ self.Jq.transpose(0, 2, 1)
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
        return Whitened(y - Q @ (Q.T @ y), E, self.count, -0.5 * log_det)

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
    def judge(self) -> Judge:
        """Judges all groups by sums over the poses."""
        return Judge(self)

    def extending(self, known: Evidence) -> Evidence:
        """The problem, which takes over what is known of one with the same poses and the first of the columns."""
        if "judge" in known.__dict__:
            self.judge.extend(known.judge)
        return self

    def moving(self, known: Evidence, lost: Evidence, gained: Evidence) -> Evidence:
        """The problem, which takes over what is known of one with some more (lost) and some fewer poses (gained)."""
        few = FEW * len(known.r)
        if "judge" in known.__dict__ and len(lost.r) + len(gained.r) <= few:
            self.judge.sums.move(known.judge.sums, lost.judge.sums, gained.judge.sums)
        return self

    def log_base(self, also: Array | None = None) -> Array:
        """Log likelihood without a further cause, shape (rhos, sigmas); also : columns that are in the model."""
        return self.judge.beside(also).log_base

    def log_grids(self, groups: Sequence[Array], also: Array | None = None) -> Array:
        """Log likelihood of each group of columns as a cause, shape (groups, rhos, sigmas, kappas).

        also : columns of causes that are in the model already; they are treated like the base model
        """
        return self.judge.log_grids(groups, also)


@dataclass(frozen=True, eq=False)
class Beside:
    """A model with some causes in it, at every rho: what is needed to judge further groups of columns.

    It is made from one with fewer causes; what this one knows is not kept again.
    log_base : log likelihood without a further cause, shape (rhos, sigmas)
    chosen : columns of the causes in it; new : of those that the one before has not, shape (new,); combined : these
    at : how they join what was there before, at each rho
    V : columns in these axes, at each rho, (columns, new); b : their products with what is left, (columns, 1)
    """

    log_base: Array
    chosen: Array
    new: Array
    combined: Combined
    before: Beside | None
    at: dict[int, Added]
    V: dict[int, Kept]
    b: dict[int, Kept]

    def axes(self, k: int, columns: Array) -> Array:
        """Columns in the axes of all that is in the model, shape (*columns.shape, base)."""
        own = self.V[k][columns]
        return own if self.before is None else np.concatenate([self.before.axes(k, columns), own], axis=-1)

    def of(self, width: int, known: dict[int, Beside]) -> Beside:
        """The same of at least as many columns; known : those that were made, by the identity of the old one."""
        if id(self) not in known:
            V, b = ({k: kept.of(width) for k, kept in part.items()} for part in (self.V, self.b))
            known[id(self)] = replace(self, V=V, b=b, before=self.before and self.before.of(width, known))
        return known[id(self)]


class Judge:
    """Judges groups of columns of one problem by its sums over the poses; what is asked for again is kept."""

    def __init__(self, e: Evidence) -> None:
        # A copy, which does not hold the judge in turn: large arrays would be kept too long.
        self.e, self.sums = replace(e), Sums(e.r, e.J, e.Jq, e.E, RHOS, e.near)
        self._beside: dict[bytes, Beside] = {}

    def extend(self, known: Judge) -> None:
        """Take over what is known of the same poses and the first of the columns."""
        self.sums.extend(known.sums)
        if self.e.width > known.e.width:
            made: dict[int, Beside] = {}
            self._beside = {key: beside.of(self.e.width, made) for key, beside in known._beside.items()}

    def beside(self, also: Array | None = None) -> Beside:
        """The base model with these columns in it too."""
        chosen = np.zeros(0, dtype=np.int64) if also is None else also
        key = chosen.tobytes()
        if key not in self._beside:
            made = self._with(chosen) if len(chosen) else self._base()
            if len(self._beside) > MOST_BESIDE:
                self._beside.pop(next(iter(self._beside)))
            self._beside[key] = made
        return self._beside[key]

    def _base(self) -> Beside:
        """The base model alone."""
        e, P, sums = self.e, self.e.J.shape[2], self.sums
        weights, found = e.reference / e.prior, {}
        for k in e.near:
            normal = np.diag(weights**2) + sums.base[k, :P, :P]
            right = sums.base[k, :P, P] + weights**2 * e.delta0
            square = float(sums.base[k, P, P] + (weights * e.delta0) @ (weights * e.delta0))
            found[k] = added(normal, right, square, -0.5 * float(sums.log_det[k]))
        none = np.zeros(0, dtype=np.int64)
        return self._made(found, none, None, none, Combined(()))

    def _with(self, chosen: Array) -> Beside:
        """A model with these causes, from the one with most of them."""
        smaller = [key for key, b in self._beside.items() if np.isin(b.chosen, chosen).all()]
        key = max(smaller, key=lambda key: len(self._beside[key].chosen), default=None)
        before = self.beside() if key is None else self._beside[key]
        if key is not None:  # it is likely to be asked for again
            self._beside[key] = self._beside.pop(key)
        new = np.setdiff1d(chosen, before.chosen)
        wide = self.sums.widest(new)
        if 0 < len(wide) < len(new):  # what takes long is made alone, for it is likely to stay
            before = self.beside(np.union1d(before.chosen, wide))
            new = np.setdiff1d(chosen, before.chosen)
        self._look_at(before, [new])
        weights, every = self.e.reference / self.e.width_in_model(new), self.e.combined(new)
        own, found = self.sums.crossed(new, self.e.near, new), {}
        precision, lost = np.diag(every.one_of_each(weights**2)), every.left_out(np.log(weights))
        for k in self.e.near:
            along = every.of(before.axes(k, new).T)
            normal = every.of(own[k].T) + precision - along.T @ along
            right = every.of(before.b[k][new][:, 0])
            found[k] = added(normal, right, before.at[k].square, before.at[k].log_norm - lost)
        return self._made(found, chosen, before, new, every)

    def _made(self, found: dict[int, Added], chosen: Array, before: Beside | None, new: Array, of: Combined) -> Beside:
        """A model from what `added` gave at each rho."""
        e = self.e
        log_base = np.full((len(RHOS), len(e.sigmas)), -np.inf)
        for k, at in found.items():
            log_base[k] = log_over_sigmas(e, at.square, at.log_norm) + log_repeats(e, e.Jq, k)
        V, b = ({k: Kept(e.width, width) for k in found} for width in (len(found[e.near[0]].z), 1))
        return Beside(log_base, chosen, new, of, before, found, V, b)

    def _look_at(self, beside: Beside, groups: Sequence[Array]) -> None:
        """Make known what is needed to judge these groups."""
        near, P, before = self.e.near, self.e.J.shape[2], beside.before
        asked = np.setdiff1d(np.concatenate(groups), beside.chosen)
        more = asked[beside.b[near[0]].place[asked] < 0]
        if not more.size:
            return
        cross = {}
        if before is not None:
            self._look_at(before, [more])
            cross = self.sums.crossed(beside.new, near, more)
        for k in near:
            if before is None:
                products, left = self.sums.columns[more, k, :P], self.sums.columns[more, k, P]
            else:
                products = cross[k]
                products -= before.axes(k, more) @ beside.combined.of(before.axes(k, beside.new).T)
                left = before.b[k][more][:, 0]
            V = products @ beside.at[k].root.T
            beside.V[k].add(more, V)
            beside.b[k].add(more, (left - V @ beside.at[k].z)[:, None])

    def log_grids(self, groups: Sequence[Array], also: Array | None = None) -> Array:
        """See `Evidence.log_grids`."""
        beside = self.beside(also)
        out = np.full((len(groups), len(RHOS), len(self.e.sigmas), len(KAPPAS)), -np.inf)
        if not groups:
            return out
        self._look_at(beside, groups)
        self.sums.add_own(groups)
        widths = np.array([len(g) for g in groups])
        for width in np.unique(widths):
            which = np.flatnonzero(widths == width)
            if width > WIDE:
                for g in which:
                    self._wide(groups[int(g)], beside, also, out[g])
                continue
            columns = np.stack([groups[int(g)] for g in which])
            own = self.sums.own([groups[int(g)] for g in which])
            for k in self.e.near:
                V = beside.axes(k, columns)
                value, vector = np.linalg.eigh(own[:, k] - V @ V.transpose(0, 2, 1))
                turned = np.einsum("gij,gi->gj", vector, beside.b[k][columns][:, :, 0])
                out[which, k] = log_gain(self.e.sigmas, KAPPAS, beside.log_base[k], value, turned)
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
                out[k] = log_gain(self.e.sigmas, KAPPAS, beside.log_base[k], value[None], turned[None])[0]
                if self.sums.rows < self.e.combined(group).width:
                    out[k] -= finer_than_base(self.e, beside.log_base[k])[:, None]
                if out[k].max() < top - REACH:
                    break
                if out[k].max() < float(beside.log_base.max()) - HOPELESS:
                    return
                top = max(top, float(out[k].max()))
                i += step

    def _spectrum(self, group: Array, beside: Beside, also: Array | None, k: int) -> tuple[Array, Array]:
        """Eigenvalues of a group's visible products and the products with what is left, in their directions."""
        every = self.e.combined(group)
        if self.sums.rows < every.width:  # fewer rows than columns: on the rows
            chosen = np.zeros(0, dtype=np.int64) if also is None else also
            w = self.e.with_base(chosen).white(float(RHOS[k]), self.e.take(group))
            value, vector = np.linalg.eigh(w.E @ w.E.T)
            return value, np.sqrt(np.maximum(value, 0.0)) * (vector.T @ w.y)
        V = every.of(beside.axes(k, group).T)
        value, vector = np.linalg.eigh(self.sums.wide(group, k) - V.T @ V)
        return value, vector.T @ every.of(beside.b[k][group][:, 0])


def finer_than_base(e: Evidence, log_base: Array) -> Array:
    """What a cause with more parameters than numbers were measured loses where the noise is finer than beside nothing.

    It can take up all that is left, so that only the base model's priors, which grow with the noise, would say how
    large the noise is. The numbers that the base model takes up do not count for a finer one (REML: Harville 1977).
    log_base : log likelihood without the cause, shape (sigmas, ...); the same shape is returned
    """
    finer = np.log(e.sigmas[np.argmax(log_base, axis=0)] / e.sigmas.reshape(-1, *[1] * (log_base.ndim - 1)))
    return np.asarray((absorbed_by_base(e) - e.absorbed) * np.maximum(finer, 0.0))


def absorbed_by_base(e: Evidence) -> float:
    """How many numbers the base model's parameters take: the trace of what projects on them, priors included."""
    A = e.J.reshape(e.r.size, -1) * (e.prior / e.reference)
    square = np.linalg.svd(A, compute_uv=False) ** 2
    return float((square / (1 + square)).sum())


def log_over_sigmas(e: Evidence, square: float, log_norm: float) -> Array:
    """Log likelihood of the residuals, shape (sigmas,), from the two numbers of `Added`."""
    return np.asarray(log_norm - (e.count - e.absorbed) * np.log(e.sigmas) - 0.5 * square / e.sigmas**2)


def log_repeats(e: Evidence, Jq: Array, k: int) -> Array:
    """Log likelihood of the scatter of repeated poses at a rho, shape (sigmas,), of joints that repeat as in Jq."""
    scatter, freedom = e.repeats
    # Mean over coordinates of the noise's variance in units of sigma^2.
    total = float(1 + RHOS[k] ** 2 * (Jq**2).sum(axis=2).sum() / e.count) * e.sigmas**2
    return np.asarray(-0.5 * freedom * (np.log(total / e.sigmas[-1] ** 2) + scatter**2 / total))


def log_sum(a: Array, axis: int | tuple[int, ...] | None = None) -> Array:
    """log(sum(exp(a))) without overflow."""
    top = np.max(a, axis=axis, keepdims=True)
    total = np.log(np.exp(a - top).sum(axis=axis, keepdims=True)) + top
    return np.asarray(np.squeeze(total, axis=axis) if axis is not None else total.item())
