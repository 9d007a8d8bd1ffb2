"""Criteria for sets of poses: observability indices O1-O5, D-, A- and V-optimality.

All are functions of the scaled Jacobian's singular values s_1 >= ... >= s_p, or of the information matrix J'J. Sun and
Hollerbach (2008), "Observability index selection for robot calibration", eqs. 9-17; Atkinson, Donev and Tobias (2007),
"Optimum Experimental Designs", chapters 10 and 17.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError

Criterion = Literal["O1", "O2", "O3", "O4", "O5", "D", "A", "V"]
CRITERIA: tuple[Criterion, ...] = ("O1", "O2", "O3", "O4", "O5", "D", "A", "V")

# Logarithm of the index, without the number of poses, of ascending eigenvalues of J'J, shape (..., p); and its
# derivative by each of them.
_Spectral = tuple[Callable[[Array], Array], Callable[[Array], Array]]


def observability(J: Array, n: int) -> dict[str, float]:
    """Indices of observability of J, shape (rows, p) [sigma per scaled unit], a scaled Jacobian of n poses.

    O1: root of the product of the singular values over the root of n; O2: smallest over greatest; O3: smallest; O4:
    square of the smallest over the greatest; O5: inverse of the sum of inverses.
    """
    s = np.linalg.svd(J, compute_uv=False)
    if len(J) < J.shape[1] or s[-1] <= 1e-14 * s[0]:
        return dict.fromkeys(("O1", "O2", "O3", "O4", "O5"), 0.0)
    return {
        "O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(n)),
        "O2": float(s[-1] / s[0]),
        "O3": float(s[-1]),
        "O4": float(s[-1] ** 2 / s[0]),
        "O5": float(1 / np.sum(1 / s)),
    }


def _ends(low: float, high: float) -> Callable[[Array], Array]:
    """Derivative of low log(w_min) - high log(w_max)."""

    def slope(w: Array) -> Array:
        d = np.zeros_like(w)
        d[0] = low / w[0]
        d[-1] -= high / w[-1]
        return d

    return slope


SPECTRAL: dict[str, _Spectral] = {
    "O2": (lambda w: 0.5 * np.log(w[..., 0] / w[..., -1]), _ends(0.5, 0.5)),
    "O3": (lambda w: 0.5 * np.log(w[..., 0]), _ends(0.5, 0.0)),
    "O4": (lambda w: np.log(w[..., 0]) - 0.5 * np.log(w[..., -1]), _ends(1.0, 0.5)),
    "O5": (lambda w: -np.log(np.sum(w**-0.5, axis=-1)), lambda w: 0.5 * w**-1.5 / np.sum(w**-0.5)),
}


def checked(criterion: str) -> Criterion:
    """The criterion of this name. Raises InputError that lists those there are."""
    if criterion not in CRITERIA:
        raise InputError(f"criterion {criterion!r} is not known; allowed: {', '.join(CRITERIA)}")
    return criterion
