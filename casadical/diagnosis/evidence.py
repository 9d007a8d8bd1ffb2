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
from casadical.diagnosis.linearisation import EVERY, Columns
from casadical.diagnosis.sums import WIDE, Kept, Sums, taken
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
    """The base model with some causes in it, at every rho: what is needed to judge further groups of columns.

    log_base : log likelihood without a further cause, shape (rhos, sigmas)
    chosen : columns of the causes in it; root : of the inverse of its normal matrix, at each rho, shape (base, base)
    z : fit of the base model in the axes of the root, at each rho, shape (base,)
    V : columns in these axes, at each rho, (columns, base); b : their products with what is left, (columns, 1)
    """

    log_base: Array
    chosen: Array
    root: dict[int, Array]
    z: dict[int, Array]
    V: dict[int, Kept]
    b: dict[int, Kept]

    def of(self, width: int) -> Beside:
        """The same of at least as many columns."""
        V, b = ({k: kept.of(width) for k, kept in part.items()} for part in (self.V, self.b))
        return replace(self, V=V, b=b)


class Judge:
    """Judges groups of columns of one problem by its sums over the poses; what is asked for again is kept."""

    def __init__(self, e: Evidence) -> None:
        # A copy, which does not hold the judge in turn: large arrays would be kept too long.
        self.e, self.sums = replace(e), Sums(e.r, e.J, e.Jq, e.E, RHOS)
        self._beside: dict[bytes, Beside] = {}

    def extend(self, known: Judge) -> None:
        """Take over what is known of the same poses and the first of the columns."""
        self.sums.extend(known.sums)
        if self.e.width > known.e.width:
            self._beside = {key: beside.of(self.e.width) for key, beside in known._beside.items()}

    def beside(self, also: Array | None = None) -> Beside:
        """The base model with these columns in it too."""
        chosen = np.zeros(0, dtype=np.int64) if also is None else also
        key = chosen.tobytes()
        if key not in self._beside:
            if len(self._beside) > MOST_BESIDE:
                self._beside.pop(next(iter(self._beside)))
            self._beside[key] = self._fitted(chosen)
        return self._beside[key]

    def _fitted(self, chosen: Array) -> Beside:
        """The base model with these columns in it, fitted at every rho."""
        e, P, sums = self.e, self.e.J.shape[2], self.sums
        prior = np.concatenate([e.prior, e.width_in_model(chosen)])
        mean = np.concatenate([e.delta0, np.zeros(len(chosen))])
        weights = e.reference / prior
        log_base = np.full((len(RHOS), len(e.sigmas)), -np.inf)
        root, fitted = {}, {}
        cross = sums.crossed(chosen, e.near, chosen) if len(chosen) else {}
        for k in e.near:
            normal = np.diag(weights**2)
            normal[:P, :P] += sums.base[k, :P, :P]
            if len(chosen):
                normal[:P, P:] += sums.columns[chosen, k, :P].T
                normal[P:, :P] += sums.columns[chosen, k, :P]
                normal[P:, P:] += cross[k]
            right = np.concatenate([sums.base[k, :P, P], sums.columns[chosen, k, P]]) + weights**2 * mean
            # A parameter whose column is long is scaled first, so that rank is judged fairly.
            scale = 1 / np.sqrt(np.diag(normal))
            L = np.linalg.cholesky(normal * np.outer(scale, scale))
            root[k] = np.linalg.inv(L) * scale
            fitted[k] = root[k] @ right
            square = float(sums.base[k, P, P] + (weights * mean) @ (weights * mean) - fitted[k] @ fitted[k])
            log_norm = -0.5 * sums.log_det[k] - float((np.log(np.diag(L)) - np.log(scale)).sum())
            log_base[k] = log_norm - e.r.size * np.log(e.sigmas) - 0.5 * square / e.sigmas**2 + self._log_repeats(k)
        V, b = ({k: Kept(e.width, width) for k in e.near} for width in (len(prior), 1))
        return Beside(log_base, chosen, root, fitted, V, b)

    def _log_repeats(self, k: int) -> Array:
        """Log likelihood of the scatter of repeated poses at a rho, shape (sigmas,)."""
        scatter, freedom = self.e.repeats
        # Mean over coordinates of the noise's variance in units of sigma^2.
        total = float(1 + RHOS[k] ** 2 * (self.e.Jq**2).sum(axis=2).mean()) * self.e.sigmas**2
        return np.asarray(-0.5 * freedom * (np.log(total / self.e.sigmas[-1] ** 2) + scatter**2 / total))

    def _look_at(self, beside: Beside, groups: Sequence[Array]) -> None:
        """Make known what is needed to judge these groups."""
        asked = np.zeros(self.e.width, dtype=bool)
        asked[np.concatenate(groups)] = True
        asked[beside.chosen] = False
        P, near = self.e.J.shape[2], self.e.near
        new = np.flatnonzero(asked & (beside.b[near[0]].place < 0))
        if not new.size:
            return
        cross = self.sums.crossed(beside.chosen, near, new) if len(beside.chosen) else {}
        for k in near:
            EJ = self.sums.columns[new, k, :P]
            if cross:
                EJ = np.concatenate([EJ, cross[k]], axis=1)
            V = EJ @ beside.root[k].T
            beside.V[k].add(new, V)
            beside.b[k].add(new, (self.sums.columns[new, k, P] - V @ beside.z[k])[:, None])

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
                V = beside.V[k][columns]
                value, vector = np.linalg.eigh(own[:, k] - V @ V.transpose(0, 2, 1))
                turned = np.einsum("gij,gi->gj", vector, beside.b[k][columns][:, :, 0])
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
        if self.sums.rows < len(group):  # fewer rows than columns: on the rows
            chosen = np.zeros(0, dtype=np.int64) if also is None else also
            w = self.e.with_base(chosen).white(float(RHOS[k]), self.e.take(group))
            value, vector = np.linalg.eigh(w.E @ w.E.T)
            return value, np.sqrt(np.maximum(value, 0.0)) * (vector.T @ w.y)
        V = beside.V[k][group]
        value, vector = np.linalg.eigh(self.sums.wide(group, k) - V @ V.T)
        return value, vector.T @ beside.b[k][group][:, 0]


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
