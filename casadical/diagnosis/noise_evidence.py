"""Marginal likelihood under other noise than white: autocorrelated, heavy-tailed, a noisy joint.

The rows of the linear model are prewhitened so that their noise is independent; the likelihood
of the white model then applies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import WHOLE_AXIS, as_slice, serial_columns
from casadical.core.linear_gaussian.marginals import POINT_LOG_EVIDENCE_WINDOW
from casadical.core.linear_gaussian.noise import Axes, NoiseModel, SerialNoise, serial_noise
from casadical.core.linear_gaussian.normal_equations import Joined, joined_base
from casadical.core.statistics import first_of_best
from casadical.diagnosis.evidence import REPEATABILITY, RHO_GRID, Evidence, joint_noise, log_noise_prior


@dataclass(frozen=True, eq=False)
class Form:
    """A form of noise; by default independent and identically distributed (white).

    ar_coefficient : AR(1) coefficient: correlation of a pose's noise with that of the previous pose
    joint : index (0-based) of a joint with larger repeatability error, or None
    repeatability_factor : its repeatability error divided by that of the other joints
    lags : displacement of each pose per unit of the joints' repeatability along its last motion, in
        the order of measuring, shape (n, numbers); None for none
    scale : factor on the noise of each pose, in the order of measuring, shape (n,), or on the
        instrument's noise of each number, shape (n, 3); None for ones
    axes : rotation of each pose's numbers into the axes of `scale`, in the order of measuring,
        shape (n, 3, 3); None for x, y and z
    log_weight : term added to log likelihoods: log prior and log determinant of the prewhitening
    """

    ar_coefficient: float = 0.0
    joint: int | None = None
    repeatability_factor: float = 1.0
    lags: Array | None = None
    scale: Array | None = None
    axes: Array | None = None
    log_weight: float = 0.0

    def serial(self, poses: int) -> SerialNoise:
        """Return the prewhitening of this form of noise for a number of poses in time order."""
        weight = np.ones(poses) if self.scale is None else 1 / self.scale
        first = np.arange(poses) == 0
        return serial_noise(self.ar_coefficient, first if weight.ndim == 1 else first[:, None], weight)

    def repeatability(self, Jq: Array) -> Array:
        """Return the Jacobian by the joints' repeatability errors in prewhitened rows.

        Jq : that in the measured numbers, in the order of measuring, shape (n, 3, joints), as the
            result, which has one column more for `lags`
        """
        if self.ar_coefficient:
            both = np.sqrt((1 + self.ar_coefficient**2) / (1 - self.ar_coefficient**2))
            return np.asarray(Jq * np.append(1.0, np.full(len(Jq) - 1, both))[:, None, None])
        if self.lags is not None:
            return np.concatenate([Jq, self.lags[:, :, None]], axis=2)
        if self.scale is not None and self.scale.ndim == 2:
            return np.asarray(Jq / self.scale[:, :, None])
        return (
            Jq
            if self.joint is None
            else Jq * np.where(np.arange(Jq.shape[2]) == self.joint, self.repeatability_factor, 1.0)
        )


# Form of independent, identically distributed noise.
WHITE_FORM = Form()


def prewhitened(e: Evidence, form: Form, order: Array) -> Evidence:
    """Return the model in the order of measuring, its rows prewhitened for a form of noise.

    Its log likelihoods are those under this noise minus the form's log_weight.
    order : indices of the poses in the order of measuring, shape (n,)
    """
    own, noise = e.at(order), form.serial(len(e.r))
    r, J, E = noise.whiten(own.r), noise.whiten(own.J), serial_columns(e.E, order, noise)
    return replace(own, r=r, J=J, Jq=form.repeatability(own.Jq), E=E)


class Problem:
    """A linear model with causes in its base, evaluated under several forms of noise.

    The columns of a part of an effect move a pose through few variables, one joint for example:
    their Gram matrix is a sum over pairs of these with fewer products than that of whitened rows.
    e : the model; chosen : columns of the causes, rising, shape (k,)
    order : indices of the poses in the order of measuring, shape (n,)
    """

    def __init__(self, e: Evidence, chosen: Array, order: Array) -> None:
        self.e, self.chosen, self._order = e, chosen, order
        self._others = [Problem(other, chosen, order) for _, other in e.at_other_ratios]
        runs = [(end - first, V is not None) for first, end, V in e.combined(chosen).blocks]
        in_parts = np.repeat([inside for _, inside in runs], [k for k, _ in runs]).astype(bool)
        parts, others = chosen[in_parts], chosen[~in_parts]
        every, widths = e.combined(parts), e.cause_prior_sigmas
        factors = e.E.factors(WHOLE_AXIS, parts).combined(every).at(order)
        self._factors = [(as_slice(own), values) for _, own, values in factors.blocks]
        self._levers = e.E.levers(order)[:, :, [variable for variable, _, _ in factors.blocks]]
        # The other columns, and the residual as the last one.
        self._rows = np.concatenate([e.J, e.take(others), e.r[:, :, None]], axis=2)[order]
        prior = np.concatenate([every.per_combination(widths[parts]), e.prior, widths[others]])
        self._prior = e.reference / prior, np.pad(e.delta0, (every.width, len(others)))
        # Contribution to the log likelihood of the directions of the causes that no pose shows.
        self._lost = every.sum_over_dropped(np.log(e.reference / widths[parts]))
        white = e.log_base(chosen)[list(e.near)].max(axis=1)
        self._first = first_of_best(white, logs=True)  # place in `near` of the likeliest point of white noise
        self._cache: dict[Form, tuple[Array, dict[int, Joined], NoiseModel]] = {}

    def log_likelihood(self, form: Form) -> Array:
        """Return the log likelihood under a form of noise, shape (rhos, sigmas).

        The form's log_weight and the prior of the noise are included; results are cached by form.
        Points are visited from the likeliest of white noise to both sides until they are
        negligible; the others have minus infinity.
        """
        if form not in self._cache:
            e, Jq = self.e, self.e.Jq[self._order]
            noise = joint_noise(form.repeatability(Jq if form.axes is None else form.axes @ Jq))
            prior = log_noise_prior(e, noise.components[REPEATABILITY])
            (axes,), at = noise.axes(e.grid.ratios), {}
            own = np.full(prior.shape, -np.inf)
            for run in (e.near[self._first :], e.near[: self._first][::-1]):
                for k in run:
                    at[k] = joined_base(self._gram(form, axes, k), *self._prior, axes.log_det[k])
                    own[k] = e.log_over_sigmas(at[k].square, at[k].log_norm) + prior[k]
                    if own[k].max() < own.max() - POINT_LOG_EVIDENCE_WINDOW:
                        break
            others = (other.log_likelihood(form) for other in self._others)
            self._cache[form] = e.averaged(own + form.log_weight - self._lost, others), at, noise
        return self._cache[form][0]

    def _gram(self, form: Form, axes: Axes, k: int) -> Array:
        """Return the Gram matrix of all whitened columns and, last, the residual at a grid point.

        axes : of the form's noise; k : index of the point
        """
        serial, width = form.serial(len(self._rows)), len(self._prior[0]) + 1
        W = np.sqrt(axes.precision[k])[:, :, None] * axes.rotation.transpose(0, 2, 1)
        W = W * serial.weight.reshape(len(W), 1, -1)
        W = W if form.axes is None else W @ form.axes
        rows, through = W @ self._rows, [(W @ self._levers, self._factors)]
        if serial.is_autocorrelated:
            before = np.maximum(np.arange(len(W)) - 1, 0)
            share = -serial.ar_coefficient[:, None, None] * W
            rows += share @ self._rows[before]
            through += [(share @ self._levers[before], [(k, v[:, before]) for k, v in self._factors])]
        variables = [(U[:, :, i], *one) for U, every in through for i, one in enumerate(every)]
        # Products of a variable with itself count half.
        half, first = np.zeros((width, width)), width - rows.shape[2]
        half[first:, first:] = np.tensordot(rows, rows, ((0, 1), (0, 1))) / 2
        for i, (lever, own, values) in enumerate(variables):
            half[own, first:] += values @ np.einsum("ni,nid->nd", lever, rows)
            scaled = values * np.sqrt((lever**2).sum(axis=1) / 2)
            half[own, own] += scaled @ scaled.T
            for other, columns, more in variables[i + 1 :]:
                half[own, columns] += (values * (lever * other).sum(axis=1)) @ more.T
        return half + half.T

    def residual(self, form: Form, rho: int) -> Array:
        """Return the whitened residual of the fit, in the order of measuring, shape (n, 3) [m].

        rho : index of the repeatability ratio in `RHO_GRID`
        """
        self.log_likelihood(form)
        _, at, noise = self._cache[form]
        W, _ = noise.whitening({REPEATABILITY: float(RHO_GRID[rho])})
        x, first = at[rho].estimate, 1 - self._rows.shape[2]
        r = self._rows @ np.append(-x[first:], 1.0)
        for i, (own, values) in enumerate(self._factors):
            r -= self._levers[:, :, i] * (x[own] @ values)[:, None]
        r = r if form.axes is None else (form.axes @ r[:, :, None])[:, :, 0]
        return np.asarray((W @ form.serial(len(r)).whiten(r)[:, :, None])[:, :, 0])
