"""Inverse kinematics by damped Newton steps for many poses at once, for any model.

The step is J^T (J J^T + lambda I)^-1 r (Levenberg and Marquardt; Nakamura and Hanafusa 1986), by
singular values. With more joints than residuals it has the least norm: the elbow stays near.
"""

from collections.abc import Callable

import numpy as np

from casadical.core.basics import Array

# (joints q, shape (k, n), indices of the poses, shape (k,)) -> residuals, target minus reached,
# shape (k, m), and Jacobians of what is reached, shape (k, m, n).
Evaluate = Callable[[Array, Array], tuple[Array, Array]]


def solve_joints(
    evaluate: Evaluate,
    start: Array,
    steps: int,
    largest: float,
    *,
    limits: tuple[Array, Array] | None = None,
    coupled: Callable[[Array], Array] | None = None,
    least: float = 0.0,
    damping: float = 0.0,
    of_error: float = 0.0,
    done: float = 0.0,
) -> Array:
    """Return the joints after damped Newton steps towards k poses, shape (k, n) [rad or m].

    They need not reach the poses; where residual or Jacobian are not finite, no more step is taken.

    evaluate : residuals and Jacobians of some poses at given joints
    start : first joints, shape (k, n) [rad or m]; steps : maximum number of steps
    largest : largest change of a joint in one step [rad or m]
    limits : lower and upper limits of the joints, shape (n,) each [rad or m]; None: none
    coupled : function that completes joints that follow others, shape (k, n) to (k, n)
    least : share of the largest singular value of J below which a direction is omitted
    damping, of_error : lambda is damping + of_error |r|^2
    done : length of the residual up to which a pose takes no more steps
    """
    q, active = np.array(start, float), np.arange(len(start))
    for _ in range(steps):
        r, J = evaluate(q[active], active)
        size = np.linalg.norm(np.nan_to_num(r, nan=np.inf), axis=1)
        go = (size > done) & np.isfinite(size) & np.isfinite(J).all(axis=(1, 2))
        active, r, J = active[go], r[go], J[go]
        if not len(active):
            break
        U, s, Vt = np.linalg.svd(J, full_matrices=False)
        ridge = damping + of_error * np.sum(r**2, axis=1)[:, None]
        inverse = np.where(s > least * s[:, :1], s / np.maximum(s**2 + ridge, 1e-24), 0.0)
        step = np.einsum("nki,nk,njk,nj->ni", Vt, inverse, U, r)
        moved = q[active] + np.clip(step, -largest, largest)
        moved = moved if limits is None else np.clip(moved, *limits)
        q[active] = moved if coupled is None else coupled(moved)
    return q
