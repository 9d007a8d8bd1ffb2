"""Log likelihood of the base model with causes, without a further one, where the noise is not what the model assumes.

A form of noise differs in how poses are weighed, in what follows from the pose before, or in how badly a joint repeats.
Sums over the poses are those of plain noise less what some poses or directions have less weight, or are added up again;
where fewer numbers were measured than there are columns, their covariance is used instead.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import SerialColumns
from casadical.core.linear_gaussian.model import axes_of_base, beside_base
from casadical.core.linear_gaussian.noise import Axes, SerialNoise, serial_noise
from casadical.core.linear_gaussian.normal_equations import Joined, joined
from casadical.diagnosis.evidence import REPEATABILITY, RHOS, Evidence, joint_noise, log_known

# A parameter that its prior holds to less than so many sigmas of the noise, all rows together.
HELD = 100.0


@dataclass(frozen=True, eq=False)
class Form:
    """A form of noise; the plain one by default.

    stays : correlation of a pose's noise with that of the pose before
    joint, worse : that repeats so many times worse than the others, 0-based
    times : how many times the usual each pose's noise is, in the order of measuring, shape (n,)
    log_weight : of the form
    """

    stays: float = 0.0
    joint: int | None = None
    worse: float = 1.0
    times: Array | None = None
    log_weight: float = 0.0

    def serial(self, poses: int) -> SerialNoise:
        """As noise of poses in the order of measuring."""
        weight = 1.0 if self.times is None else 1 / self.times
        return serial_noise(self.stays, np.arange(poses) == 0, weight)

    def repeatability(self, Jq: Array) -> Array:
        """Derivative by the joint variables as the joints repeat in the moved numbers, shape (n, 3, joints)."""
        if self.stays:
            both = np.sqrt((1 + self.stays**2) / (1 - self.stays**2))
            return np.asarray(Jq * np.append(1.0, np.full(len(Jq) - 1, both))[:, None, None])
        return Jq if self.joint is None else Jq * np.where(np.arange(Jq.shape[2]) == self.joint, self.worse, 1.0)


# Independent and alike everywhere.
PLAIN = Form()


def as_form_moves(e: Evidence, form: Form, order: Array) -> Evidence:
    """The problem in the order of measuring, with the numbers that a form of noise makes independent.

    Its likelihoods are those of the problem with this noise, less the form's weight. order : of measuring, shape (n,)
    """
    own, noise = e.at(order), form.serial(len(order))
    E = SerialColumns(e.model.columns, order, noise)
    return replace(own, r=noise.white(own.r), J=noise.white(own.J), Jq=form.repeatability(own.Jq), E=E)


class Problem:
    """The problem with causes in its model, at the poses in the order of measuring.

    e : the problem; chosen : columns of the causes, shape (k,); order : of measuring, shape (n,)
    """

    def __init__(self, e: Evidence, chosen: Array, order: Array) -> None:
        self.e, self.chosen, self._order, self._Jq = e, chosen, order, e.Jq[order]
        self._combined, widths = e.model.combined(chosen), e.model.held[chosen]
        self._weights = e.reference / np.concatenate([e.model.prior, self._combined.one_of_each(widths)])
        self._lost = self._combined.left_out(np.log(e.reference / widths))
        self._mean = np.concatenate([e.model.mean, np.zeros(self._combined.width)])
        self._by_rows = e.r.size <= len(self._weights)
        self._kept: dict[int, Array] = {}
        self._known: dict[Form, Array] = {}

    def log_likelihood(self, form: Form) -> Array:
        """Of the problem with this form of noise, its weight included, shape (rhos, sigmas)."""
        if form not in self._known:
            self._known[form] = self.e.averaged(self._judged(form), (p._judged(form) for p in self._at_other_ratios))
        return self._known[form]

    @cached_property
    def _at_other_ratios(self) -> list[Problem]:
        return [Problem(other, self.chosen, self._order) for _, other in self.e.at_other_ratios]

    def _judged(self, form: Form) -> Array:
        e, near = self.e, list(self.e.near)
        out = np.full((len(RHOS), len(e.sigmas)), -np.inf)
        known = log_known(e, form.repeatability(self._Jq))
        for k, (fit, square) in zip(near, self._fits(form, near), strict=True):
            out[k] = e.model.log_over_sigmas(square, fit.log_norm - self._lost) + known[k]
        return out + form.log_weight

    def left(self, form: Form, k: int) -> Array:
        """What the fit leaves at a rho, white, as the form moves it, shape (n, 3); the axes are not the frame's."""
        ((fit, _),) = self._fits(form, [k])
        x = fit.root.T @ fit.z
        if self._by_rows:
            return np.asarray(x[: self.e.r.size].reshape(self.e.r.shape))
        axes, noise = self._axes(form, [k]), form.serial(len(self._order))
        rest = ((noise.white(X[:, :, -1] - X[:, :, :-1] @ x, at), at) for X, at in self._parts())
        return np.concatenate(
            [np.sqrt(axes.precision[0, at]) * axes.turned(r[:, :, None], at)[:, :, 0] for r, at in rest]
        )

    def _fits(self, form: Form, near: Sequence[int]) -> list[tuple[Joined, float]]:
        """At each rho how the parameters fit, and the square of what they leave."""
        return self._by_covariance(form, near) if self._by_rows else self._by_sums(form, near)

    def _by_sums(self, form: Form, near: Sequence[int]) -> list[tuple[Joined, float]]:
        p, total = len(self._weights), self._again(form, near) if form.stays else self._less(form, near)
        known = self._weights**2 * self._mean
        total[:, range(p), range(p)] += self._weights**2
        total[:, p, :p] += known
        total[:, p, p] += known @ self._mean
        logs = (-0.5 * self._axes(form, near).log_det).tolist()
        fits = [joined(s[:p, :p], s[p, :p], float(s[p, p]), log) for s, log in zip(total, logs, strict=True)]
        return [(fit, fit.square) for fit in fits]

    def _again(self, form: Form, near: Sequence[int]) -> Array:
        """Products of columns and what is left as the form moves them, shape (rhos, p + 1, p + 1)."""
        width, axes, noise = len(self._weights) + 1, self._axes(form, near), form.serial(len(self._order))
        total = np.zeros((len(near), width, width))
        for X, at in self._parts():
            Y = axes.turned(noise.white(X, at), at)
            for sums, precision in zip(total, axes.precision, strict=True):
                white = (Y * np.sqrt(precision[at, :, None])).reshape(-1, width)
                sums += white.T @ white
        return total

    def _less(self, form: Form, near: Sequence[int]) -> Array:
        """The same, from those with plain noise and what has less weight than there."""
        total = self.e.marginals.sums.together(self.chosen, near)
        if form.joint is None and form.times is None:
            return total
        axes = self._axes(Form(), near)
        for X, at in self._parts():
            X = X[min(at.start, 1) :]
            for i, (sums, k) in enumerate(zip(total, near, strict=True)):
                if form.times is None:
                    lacking = self._along_joint(form, axes, i, at, float(RHOS[k])) @ X
                else:
                    out = np.flatnonzero(form.times[at] > 1)
                    share = np.sqrt((1 - form.times[at][out, None] ** -2) * axes.precision[i, at][out])
                    lacking = (axes.turn[at][out].transpose(0, 2, 1) @ X[out]) * share[:, :, None]
                lacking = lacking.reshape(-1, X.shape[2])
                sums -= lacking.T @ lacking
        return total

    def _along_joint(self, form: Form, axes: Axes, i: int, at: slice, rho: float) -> Array:
        """Along a joint's motion, the root of what a further variance of it takes from the weight, shape (n, 1, 3).

        (Sherman and Morrison.)
        """
        precise = axes.turn[at] * axes.precision[i, at, None] @ axes.turn[at].transpose(0, 2, 1)
        motion = self._Jq[at, :, form.joint]
        arm = motion[:, None] @ precise
        own = (arm[:, 0] * motion).sum(axis=1)
        more = rho**2 * (form.worse**2 - 1)
        return np.asarray(arm * np.sqrt(more / (1 + more * own))[:, None, None])

    def _by_covariance(self, form: Form, near: Sequence[int]) -> list[tuple[Joined, float]]:
        rows, axes, noise = self.e.r.size, self._axes(form, near), form.serial(len(self._order))
        X, _ = next(self._parts())

        def moved(numbers: Array) -> Array:
            return axes.turned(noise.white(numbers.reshape(*self.e.r.shape, -1))).reshape(rows, -1)

        P, weights = self.e.model.base.shape[2], self._weights
        y, base = moved(X[:, :, -1] - X[:, :, :-1] @ self._mean)[:, 0], moved(X[:, :, :P])
        # What priors hold tightly counts as causes do: of many such parameters the covariance of the rows is smaller.
        top = np.sqrt(axes.precision.reshape(len(near), rows).max(axis=0))
        held = np.linalg.norm(top[:, None] * base, axis=0) < HELD * weights[:P]
        known = base[:, held] / weights[:P][held]
        causes = moved(moved(self._covariance_of_causes).T) + known @ known.T
        log_width = float(np.log(weights[P:]).sum() + np.log(weights[:P][held]).sum())
        base, free = base[:, ~held], weights[:P][~held]
        fits = []
        for precision, log_det in zip(axes.precision.reshape(len(near), rows), axes.log_det, strict=True):
            weight = np.sqrt(precision)
            Q, of_base = axes_of_base(weight[:, None] * base, free)
            left = np.append(weight * y, np.zeros(len(free)))
            normal = beside_base(Q, weight[:, None] * causes * weight)
            fit = joined(normal, left - Q @ (Q.T @ left), 0.0, -0.5 * (float(log_det) + of_base) - log_width)
            fits.append((fit, -fit.square))
        return fits

    @cached_property
    def _covariance_of_causes(self) -> Array:
        """What the priors of the causes' parameters do, in units of the noise, shape (3 n, 3 n)."""
        P = self.e.model.base.shape[2]
        wide = next(self._parts())[0][:, :, P:-1].reshape(self.e.r.size, -1) / self._weights[P:]
        return np.asarray(wide @ wide.T)

    def _axes(self, form: Form, near: Sequence[int]) -> Axes:
        """In which the joints' repeatability is independent, at some rhos."""
        (axes,) = joint_noise(form.repeatability(self._Jq)).axes({REPEATABILITY: RHOS[list(near)]})
        return axes

    def _parts(self) -> Iterator[tuple[Array, slice]]:
        """Columns, then what is left, at some poses and the one before them; and which these are."""
        n, width = len(self._order), len(self._weights)
        step = n if self._by_rows else max(64, self.e.memory.part // (24 * width))
        for start in range(0, n, step):
            X = self._kept.get(start)
            if X is None:
                poses = self._order[max(start - 1, 0) : start + step]
                columns = self.e.model.columns.take(self.chosen, poses, self._combined)
                X = np.concatenate([self.e.model.base[poses], columns, self.e.r[poses, :, None]], axis=2)
                if 24 * n * width <= self.e.memory.kept:
                    self._kept[start] = X
            yield X, slice(start, min(start + step, n))
