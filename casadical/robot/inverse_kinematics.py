"""Inverse kinematics by damped Newton steps, many poses at once; plain numbers, the model is the caller's.

The step is J^T (J J^T + lambda I)^-1 r (Levenberg and Marquardt; Nakamura and Hanafusa 1986), by singular values. With
more joints than numbers it is the one of least norm: the elbow stays where it was started.
"""

from collections.abc import Callable

import numpy as np

from casadical.core.basics import Array

# Residuals, shape (k, m), wanted less reached, and Jacobians, shape (k, m, n), of joints q, shape (k, n), at poses of
# these indices, shape (k,).
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
    """Return the joints after the steps, shape (k, n) [rad or m]; they need not reach the poses.

    start : shape (k, n); largest : change of a joint in one step [rad or m]; limits : of the joints, shape (n,) each
    coupled : completes joints that follow others, shape (k, n) to (k, n)
    least : share of the greatest singular value of J below which a direction is left aside
    damping, of_error : lambda is damping + of_error |r|^2; done : pose whose residual is no longer take no more steps
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
