"""Forms of noise that the usual model does not have, and the likelihood of a problem under them.

A form differs in how poses are weighed, in what follows from the pose before, or in how badly a joint repeats. The
numbers of a problem are transformed so that their noise is independent; their likelihood is that of the usual model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import SerialColumns
from casadical.core.linear_gaussian.fit import Fit
from casadical.core.linear_gaussian.marginals import NONE
from casadical.core.linear_gaussian.noise import SerialNoise, serial_noise
from casadical.diagnosis.evidence import REPEATABILITY, RHO_GRID, Evidence


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
    E = SerialColumns(e.E, order, noise)
    return replace(own, r=noise.white(own.r), J=noise.white(own.J), Jq=form.repeatability(own.Jq), E=E)


class Problem:
    """The problem with causes in its base, judged under forms of noise.

    e : the problem; chosen : columns of the causes, shape (k,); order : of measuring, shape (n,)
    """

    def __init__(self, e: Evidence, chosen: Array, order: Array) -> None:
        self.e, self.chosen, self._order = e, chosen, order
        self._own = e.with_causes_alone(chosen)
        self._others = [other.with_causes_alone(chosen) for _, other in e.at_other_ratios]
        # What the directions of the causes that move nothing would add to the log likelihood.
        combined, widths = e.combined(chosen), e.widths[chosen]
        self._lost = combined.left_out(np.log(e.reference / widths))
        self._known: dict[Form, Array] = {}

    def log_likelihood(self, form: Form) -> Array:
        """Log likelihood under a form of noise, its weight included, shape (rhos, sigmas)."""
        if form not in self._known:
            own, *others = (as_form_moves(e, form, self._order).log_base() for e in (self._own, *self._others))
            self._known[form] = self.e.averaged(own, others) + form.log_weight - self._lost
        return self._known[form]

    def residual(self, form: Form, rho: int) -> Array:
        """Return the whitened residual of the fit at a ratio of the grid, shape (n, 3), in units of sigma."""
        moved = as_form_moves(self._own, form, self._order)
        fit = Fit(moved, NONE, moved.reference, {REPEATABILITY: float(RHO_GRID[rho])})
        return np.asarray(moved.reference * fit.rest.reshape(moved.r.shape))
