"""Marginal likelihood under other noise than white: autocorrelated, heavy-tailed, a noisy joint.

The rows of the linear model are prewhitened so that their noise is independent; the likelihood
of the white model then applies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import serial_columns
from casadical.core.linear_gaussian.marginals import marginals_of
from casadical.core.linear_gaussian.noise import SerialNoise, serial_noise
from casadical.diagnosis.evidence import REPEATABILITY, RHO_GRID, Evidence


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
        shape (n, 3, 3), in models without candidates; None for x, y and z
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


def prewhitened(e: Evidence, form: Form, order: Array | None = None) -> Evidence:
    """Return the model in the order of measuring, its rows prewhitened for a form of noise.

    Its log likelihoods are those under this noise minus the form's log_weight.
    order : indices of the poses in the order of measuring, shape (n,); None for a model without
        candidates whose poses are in this order
    """
    own, noise = e if order is None else e.at(order), form.serial(len(e.r))
    if form.axes is not None:
        r = (form.axes @ own.r[:, :, None])[:, :, 0]
        own = replace(own, r=r, J=form.axes @ own.J, Jq=form.axes @ own.Jq)
    E = e.E if order is None else serial_columns(e.E, order, noise)
    return replace(own, r=noise.whiten(own.r), J=noise.whiten(own.J), Jq=form.repeatability(own.Jq), E=E)


class Problem:
    """A linear model with causes in its base, evaluated under several forms of noise.

    e : the model; chosen : columns of the causes, shape (k,)
    order : indices of the poses in the order of measuring, shape (n,)
    """

    def __init__(self, e: Evidence, chosen: Array, order: Array) -> None:
        self.e, self.chosen = e, chosen
        models = (e, *(other for _, other in e.at_other_ratios))
        self._own, *self._others = (own.with_causes_alone(chosen).at(order) for own in models)
        # Contribution to the log likelihood of the directions of the causes that no pose shows.
        combined, widths = e.combined(chosen), e.cause_prior_sigmas[chosen]
        self._lost = combined.sum_over_dropped(np.log(e.reference / widths))
        self._cache: dict[Form, tuple[Array, dict[int, Array]]] = {}

    def log_likelihood(self, form: Form) -> Array:
        """Return the log likelihood under a form of noise, shape (rhos, sigmas).

        The form's log_weight and the prior of the noise are included; results are cached by form.
        """
        if form not in self._cache:
            own = marginals_of(prewhitened(self._own, form))
            others = (prewhitened(e, form).log_base() for e in self._others)
            log = self.e.averaged(own.log_base(), others)
            self._cache[form] = log + form.log_weight - self._lost, own.estimates_of_base()
        return self._cache[form][0]

    def residual(self, form: Form, rho: int) -> Array:
        """Return the whitened residual of the fit, in the order of measuring, shape (n, 3) [m].

        rho : index of the repeatability ratio in `RHO_GRID`
        """
        self.log_likelihood(form)
        moved = prewhitened(self._own, form)
        W, _ = moved.noise.whitening({REPEATABILITY: float(RHO_GRID[rho])})
        r = moved.r - moved.J @ self._cache[form][1][rho]
        return np.asarray((W @ r[:, :, None])[:, :, 0])
