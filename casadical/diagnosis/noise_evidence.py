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
from casadical.core.linear_gaussian.noise import Axes, SerialNoise, axes_of, covariance_of, serial_noise, whitening_of
from casadical.core.linear_gaussian.normal_equations import Joined, joined_base
from casadical.core.statistics import first_of_best
from casadical.diagnosis.evidence import RHO_GRID, Evidence, log_noise_prior

# Number of columns from which a gain is estimated first: the evidence of fewer takes no longer.
MIN_ESTIMATED_COLUMNS = 100
# Largest part of an estimated gain by which it is too low: 0.35 in diagnoses of the real UR10 with
# more than 400 columns; between these and `MIN_ESTIMATED_COLUMNS` it was not measured.
MAX_ESTIMATE_ERROR = 0.4


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
        self._cache: dict[Form, Array] = {}
        # Estimates of each form by point of the grid, and the fits under white noise.
        self._estimates: dict[Form, dict[int, Array]] = {}
        self._white: dict[int, Joined] = {}
        self._noise_of: dict[Form, tuple[Array, Axes, Array]] = {}

    def log_likelihood(self, form: Form) -> Array:
        """Return the log likelihood under a form of noise, shape (rhos, sigmas).

        The form's log_weight and the prior of the noise are included; results are cached by form.
        Points are visited from the likeliest of white noise to both sides until they are
        negligible; the others have minus infinity.
        """
        if form not in self._cache:
            e, (_, axes, prior) = self.e, self._noise(form)
            own, estimates = np.full(prior.shape, -np.inf), self._estimates.setdefault(form, {})
            for run in (e.near[self._first :], e.near[: self._first][::-1]):
                for k in run:
                    fit = joined_base(self._gram(form, axes, k), *self._prior, axes.log_det[k])
                    estimates[k] = fit.estimate
                    if form is WHITE_FORM:
                        self._white[k] = fit
                    own[k] = e.log_over_sigmas(fit.square, fit.log_norm) + prior[k]
                    if own[k].max() < own.max() - POINT_LOG_EVIDENCE_WINDOW:
                        break
            others = (other.log_likelihood(form) for other in self._others)
            self._cache[form] = e.averaged(own + form.log_weight - self._lost, others)
        return self._cache[form]

    def may_gain(self, form: Form, least: float) -> bool:
        """Return whether the log evidence of a form over white noise may be above a number of nats.

        That of a few columns is not estimated: it is evaluated in no more time.
        """
        if len(self._prior[0]) < MIN_ESTIMATED_COLUMNS:
            return True
        gain = self.estimated_gain(form)
        return gain + MAX_ESTIMATE_ERROR * abs(gain) > least

    def estimated_gain(self, form: Form) -> float:
        """Return an estimate of the log evidence of a form over white noise [nats].

        It is that of one Newton step from the fits under white noise, whose normal matrices are
        scaled by the mean precision, in a fifth of the time of `log_likelihood`. Near zero it is
        right to some nats; it may be too low by `MAX_ESTIMATE_ERROR` of its size.
        """
        from scipy.linalg import solve_triangular

        self.log_likelihood(WHITE_FORM)
        e, serial = self.e, form.serial(len(self._rows))
        (_, white, white_prior), (_, axes, prior) = self._noise(WHITE_FORM), self._noise(form)
        logs = np.full((2, *prior.shape), -np.inf)

        def whitened(own: Axes, k: int, numbers: Array) -> Array:
            """Return P numbers, P the inverse covariance of each pose at a grid point, (n, 3)."""
            turned = own.precision[k] * np.einsum("nji,nj->ni", own.rotation, numbers)
            return np.asarray(np.einsum("nij,nj->ni", own.rotation, turned))

        for k, fit in self._white.items():
            r = self._unexplained(fit.estimate)
            before, own = whitened(white, k, r), r if form.axes is None else np.einsum("nij,nj->ni", form.axes, r)
            after = serial.whiten_transposed(whitened(axes, k, serial.whiten(own)))
            after = after if form.axes is None else np.einsum("nji,nj->ni", form.axes, after)
            change = after - before
            scores = [
                values @ (self._levers[:, :, i] * change).sum(axis=1) for i, (_, values) in enumerate(self._factors)
            ]
            score = np.concatenate([*scores, np.tensordot(self._rows[:, :, :-1], change, ((0, 1), (0, 1)))])
            step = solve_triangular(fit.L, fit.scale * score, lower=True)
            precision = float(axes.precision[k].mean() * (serial.weight**2).mean() / white.precision[k].mean())
            square = fit.square + float((r * change).sum()) - float(step @ step) / precision
            log_det = axes.log_det[k] - white.log_det[k] + len(score) * min(np.log(precision), 0.0)
            logs[0, k] = e.log_over_sigmas(fit.square, fit.log_norm) + white_prior[k]
            logs[1, k] = e.log_over_sigmas(square, fit.log_norm - 0.5 * log_det) + prior[k]
        before, after = np.logaddexp.reduce(logs.reshape(2, -1), axis=1)
        return float(after - before + form.log_weight)

    def _noise(self, form: Form) -> tuple[Array, Axes, Array]:
        """Return a form's Jacobian by the joints, axes and log prior on the grid, (rhos, sigmas)."""
        if form not in self._noise_of:
            Jq = self.e.Jq[self._order]
            Jq = form.repeatability(Jq if form.axes is None else form.axes @ Jq)
            self._noise_of[form] = Jq, axes_of(Jq, self.e.ratios), log_noise_prior(self.e, Jq)
        return self._noise_of[form]

    def _unexplained(self, x: Array) -> Array:
        """Return the residual at estimates of all columns, in the order of measuring, (n, 3) [m]."""
        first = 1 - self._rows.shape[2]
        r = self._rows @ np.append(-x[first:], 1.0)
        for i, (own, values) in enumerate(self._factors):
            r -= self._levers[:, :, i] * (x[own] @ values)[:, None]
        return np.asarray(r)

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
        W, _ = whitening_of(covariance_of(self._noise(form)[0], float(RHO_GRID[rho])))
        r = self._unexplained(self._estimates[form][rho])
        r = r if form.axes is None else (form.axes @ r[:, :, None])[:, :, 0]
        return np.asarray((W @ form.serial(len(r)).whiten(r)[:, :, None])[:, :, 0])
