"""Levenberg-Marquardt for many small networks at once, with a ridge on the weights.

Problem p minimises  sum_n m[p, n] |outputs - targets|^2 + ridge[p] * sum of squared weights, biases of the output layer
left out. The sample weights m of a problem sum to one, so that a large ridge leaves the mean residual only.
Damping after Nielsen (1999), IMM-REP-1999-05.
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from casadical.compensator.checksummed_json import pack, unpack
from casadical.compensator.network import forward, outputs_and_jacobian
from casadical.compensator.task import Task
from casadical.core.basics import Array

_CHUNK = 4_000_000  # doubles of one Jacobian held at a time


@dataclass(frozen=True, eq=False)
class Batch:
    """P problems in progress: weights (P, count), damping, its growth, cost and whether still active (P,)."""

    weights: Array
    damping: Array
    growth: Array
    cost: Array
    active: Array

    def state(self) -> dict[str, Any]:
        return {name: pack(getattr(self, name)) for name in ("weights", "damping", "growth", "cost", "active")}

    @classmethod
    def restore(cls, state: dict[str, Any]) -> Self:
        return cls(**{name: unpack(value) for name, value in state.items()})


def begin_batch(task: Task, weights: Array, samples: Array, ridge: Array) -> Batch:
    """Start P problems at weights (P, count), with sample weights (P, N) and ridges (P,)."""
    count = len(weights)
    cost = penalised_cost(task, weights, samples, ridge)
    return Batch(weights, np.full(count, -1.0), np.full(count, 2.0), cost, np.ones(count))


def penalised_cost(task: Task, weights: Array, samples: Array, ridge: Array) -> Array:
    """Return the cost of every problem, shape (P,), in squared units of the scaled targets."""
    errors = forward(task.layout, weights, task.inputs) - task.targets
    fit = np.einsum("pon,pon,pn->p", errors, errors, samples)
    return np.asarray(fit + ridge * ((weights * _penalised(task)) ** 2).sum(axis=1), dtype=np.float64)


def advance(task: Task, batch: Batch, samples: Array, ridge: Array, tolerance: float = 1e-7) -> Batch:
    """Do one damped step of every active problem; one ends when a step gains less than ``tolerance`` of its cost."""
    at = np.flatnonzero(batch.active)
    new = {name: getattr(batch, name).copy() for name in ("weights", "damping", "growth", "cost", "active")}
    size = max(1, _CHUNK // (task.layout.count * task.targets.size))
    for part in (at[i : i + size] for i in range(0, len(at), size)):
        _advance_part(task, new, part, samples[part], ridge[part], tolerance)
    return Batch(**new)


def _advance_part(task: Task, new: dict[str, Array], at: Any, samples: Array, ridge: Array, tolerance: float) -> None:
    weights, cost = new["weights"][at], new["cost"][at]
    slope, curvature = _normal_equations(task, weights, samples, ridge)
    diagonal = np.einsum("pii->pi", curvature)
    damping = np.where(new["damping"][at] < 0, 1e-3 * diagonal.max(axis=1), new["damping"][at])
    damping = np.maximum(damping, 1e-14 * diagonal.max(axis=1) + np.finfo(float).tiny)  # never singular
    diagonal += damping[:, None]
    step = -np.linalg.solve(curvature, slope[..., None])[..., 0]
    trial = weights + step
    trial_cost = penalised_cost(task, trial, samples, ridge)
    predicted = np.einsum("pi,pi->p", step, damping[:, None] * step - slope)
    gain = (cost - trial_cost) / np.maximum(predicted, np.finfo(float).tiny)
    better = (trial_cost < cost) & np.isfinite(trial_cost)
    new["weights"][at] = np.where(better[:, None], trial, weights)
    new["cost"][at] = np.where(better, trial_cost, cost)
    shrink = np.maximum(1 / 3, 1 - (2 * np.clip(gain, 0, 1) - 1) ** 3)
    new["damping"][at] = damping * np.where(better, shrink, new["growth"][at])
    new["growth"][at] = np.where(better, 2.0, 2 * new["growth"][at])
    small = better & (cost - trial_cost <= tolerance * cost)
    stuck = ~better & (predicted <= 1e-12 * cost)
    new["active"][at] = ~(small | stuck | (new["growth"][at] > 1e6))


def _normal_equations(task: Task, weights: Array, samples: Array, ridge: Array) -> tuple[Array, Array]:
    """Return half the gradient, shape (P, count), and half the Gauss-Newton Hessian, shape (P, count, count)."""
    outputs, jacobian = outputs_and_jacobian(task.layout, weights, task.inputs)
    count, total = weights.shape
    root = np.sqrt(samples)[:, None]
    errors = ((outputs - task.targets) * root).reshape(count, -1)
    jacobian *= root[:, None]
    flat = jacobian.reshape(count, total, -1)
    curvature = flat @ flat.transpose(0, 2, 1)
    slope = (flat @ errors[..., None])[..., 0]
    penalty = ridge[:, None] * _penalised(task)
    np.einsum("pii->pi", curvature)[...] += penalty
    return slope + penalty * weights, curvature


def _penalised(task: Task) -> Array:
    return np.asarray(~task.layout.output_biases(), dtype=np.float64)
