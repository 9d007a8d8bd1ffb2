"""OMP_NUM_THREADS=1 python docs/studies/twin_networks.py | tee docs/studies/twin_networks.txt

Networks on what SKCM leaves of the HH800 twin (synthetic), 50 training poses and the set report as held-out poses:
every trainer over 50 seeds on the experiment of problems/hh800; local minima; and a Gaussian process in the place of
the network. Writes twin_networks.png.
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import trainers
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from casadical import from_table, identify, read_problem
from casadical.identification import residual_mm

HH800 = Path(__file__).parents[2] / "problems" / "hh800"
SEEDS, STARTS = 50, 20
Arrays = tuple[np.ndarray, np.ndarray]


@cache
def robot():
    return read_problem(HH800).robot


@cache
def residuals() -> dict[str, Arrays]:
    """Joint angles and SKCM's residual [mm] of every set of the stored experiment."""
    table = pd.read_csv(HH800.parents[1] / "data/hh800_twin/hh800_twin.csv")
    m = from_table(table, 6, "position")
    sets = {name: m[(table["set"] == name).to_numpy()] for name in table["set"].unique()}
    found = identify(robot(), sets["identify"], method="SKCM").robot
    return {name: (part.q, residual_mm(found, part)) for name, part in sets.items()}


def stored(_seed: int) -> tuple[Arrays, Arrays]:
    return residuals()["train"], residuals()["report"]


def same_experiment() -> dict[str, np.ndarray]:
    """Only the trainers' seed differs."""
    print(f"A. the stored experiment, problems/hh800; {SEEDS} seeds of the trainers\n")
    for name in ("iwo, scaled output", "lm, best of 20, no ridge"):  # as in trainers.txt; left out for time
        del trainers.TRAINERS[name]
    found = trainers.distributions(stored, SEEDS)
    trainers.print_distributions(found)
    print("how often the first has the smaller held-out error (median gain):")
    for one, other in (
        ("iwo, as in the paper", "backprop, one run"),
        ("iwo, scaled, 5000 it.", "backprop, one run"),
        ("iwo, as in the paper", "lm, ridge by CV"),
        ("iwo, as in the paper", "no network"),
        ("lm, ridge by CV", "no network"),
        ("taught by a process", "no network"),
    ):
        trainers.compare(found, one, other)
    sys.stdout.flush()
    return found


def gaussian_process(q: np.ndarray, y: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Mean of a Gaussian process with a length for each joint and noise, by maximum likelihood; shape (m, outputs)."""

    def kernel(a: np.ndarray, b: np.ndarray, logs: np.ndarray) -> np.ndarray:
        a, b = a / np.exp(logs[:6]), b / np.exp(logs[:6])
        square = (a**2).sum(1)[:, None] + (b**2).sum(1) - 2 * a @ b.T
        return np.exp(2 * logs[6] - 0.5 * np.maximum(square, 0))

    def cost(logs: np.ndarray, q: np.ndarray, y: np.ndarray) -> float:
        K = kernel(q, q, logs) + np.exp(2 * logs[7]) * np.eye(len(q))
        factor = cho_factor(K, lower=True)
        half = np.log(np.diag(factor[0])).sum()
        return float(0.5 * np.sum(y * cho_solve(factor, y)) + y.shape[1] * half)

    few = slice(0, 300)  # lengths from a part of them, then all poses
    spread = np.log(np.std(y) + 1e-9)
    starts = [np.r_[np.full(6, np.log(s)), spread, spread - 1] for s in (1.0, 3.0)]
    bounds = [(np.log(0.1), np.log(100.0))] * 6 + [(spread - 5, spread + 3)] * 2
    ends = [minimize(cost, s, (q[few], y[few]), "L-BFGS-B", bounds=bounds, options={"maxiter": 60}) for s in starts]
    best = min(ends, key=lambda end: end.fun).x
    K = kernel(q, q, best) + np.exp(2 * best[7]) * np.eye(len(q))
    return kernel(at, q, best) @ cho_solve(cho_factor(K, lower=True), y)


def process_on_fifty_poses() -> None:
    """The Gaussian process in the place of the network: 50 poses of the set train, errors on the set report."""
    (q, y), (other_q, other) = residuals()["train"], residuals()["report"]
    before, after = trainers.lengths(other), trainers.lengths(other - gaussian_process(q, y, other_q))
    print("\nGaussian process on the 50 poses of the set train, errors on the set report:")
    print(f"  mean {before[0]:.3f} > {after[0]:.3f}, max {before[1]:.3f} > {after[1]:.3f}")


def main() -> None:
    found = same_experiment()
    title = "HH800 twin (synthetic): errors on the set report, 50 seeds of each trainer"
    trainers.plot(found, Path(__file__).with_suffix(".png"), title)
    trainers.local_minima(stored, STARTS)
    process_on_fifty_poses()


if __name__ == "__main__":
    main()
