"""Parameters that join a model, by their normal matrix beside what is in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from casadical.core.arrays import Array
from casadical.core.normal_matrices import inverse_of_triangle, reduced


@dataclass(frozen=True, eq=False)
class Added:
    """Parameters that joined a model at one rho.

    L, scale : Cholesky factor of their scaled normal matrix beside those before, and what scales it
    z : what they take up in the axes of `root`, shape (new,)
    square, log_norm : what is left, and what does not depend on sigma
    """

    L: Array
    scale: Array
    z: Array
    square: float
    log_norm: float

    @cached_property
    def root(self) -> Array:
        """Of the inverse of their normal matrix, shape (new, new)."""
        return np.asarray(inverse_of_triangle(self.L) * self.scale)


def added(normal: Array, right: Array, square: float, log_norm: float) -> Added:
    """How parameters join a model.

    normal : beside what is in the model, shape (new, new); right : products with what was left, shape (new,)
    square, log_norm : of the model before
    """
    # A parameter whose column is long is scaled first, so that rank is judged fairly.
    scale = 1 / np.sqrt(np.diag(normal))
    L, z = reduced(normal * np.outer(scale, scale), scale * right)
    return Added(L, scale, z, square - float(z @ z), log_norm - float((np.log(np.diag(L)) - np.log(scale)).sum()))
