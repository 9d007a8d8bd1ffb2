"""OMP_NUM_THREADS=1 python docs/studies/twin_networks.py | tee docs/studies/twin_networks.txt

Networks on what SKCM leaves of the HH800 twin (synthetic): every trainer of the compensator over 50 seeds on the 50
training poses of problems/hh800, the set report as held-out poses; and how often trainings end in local minima. Answers
the paper's two claims: does invasive weed optimisation avoid local minima that single runs of back-propagation fall
into, and does it beat Levenberg-Marquardt with ridge?
"""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from casadical import from_table, identify, read_problem
from casadical.compensator import (
    Backprop,
    Iwo,
    IwoSettings,
    JointBox,
    Layout,
    LevenbergMarquardt,
    Taught,
    Trainer,
    make_task,
    train,
)
from casadical.compensator.network import Loss
from casadical.identification import residual_mm

HH800 = Path(__file__).parents[2] / "problems" / "hh800"
SEEDS, STARTS = 50, 20
PLAIN_LM = LevenbergMarquardt(restarts=1, iterations=400, ridges=(0.0,))
# Trainer, and millimetres of one output unit (None: root mean square of the training residual), by name.
TRAINERS: dict[str, tuple[Trainer, float | None]] = {
    "iwo, as in the paper": (Iwo(), 1.0),
    "backprop, one run": (Backprop(), None),
    "lm, ridge by CV": (LevenbergMarquardt(), None),
    "taught by a process": (Taught(), None),
}


@cache
def residuals() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return joint angles and SKCM's residuals [mm] of every set of the stored experiment."""
    table = pd.read_csv(HH800.parents[1] / "data/hh800_twin/hh800_twin.csv")
    m = from_table(table, 6, "position")
    sets = {name: m[(table["set"] == name).to_numpy()] for name in table["set"].unique()}
    found = identify(read_problem(HH800).robot, sets["identify"], method="SKCM").robot
    return {name: (part.q, residual_mm(found, part)) for name, part in sets.items()}


def tasks(scale: float | None):
    """Return the training and the held-out task; scale : millimetres of one output unit."""
    (q, residual), (other_q, other) = residuals()["train"], residuals()["report"]
    layout, box = Layout(joints=q.shape[1]), JointBox(tuple(q.min(axis=0)), tuple(q.max(axis=0)))
    unit = scale if scale is not None else float(np.sqrt(np.mean(residual**2)))
    return make_task(layout, box, q, residual, scale_mm=unit), make_task(layout, box, other_q, other, scale_mm=unit)


def quartiles(values: np.ndarray) -> str:
    """Return 'median (lower quartile .. upper quartile)'."""
    low, middle, high = np.percentile(values, [25, 50, 75])
    return f"{middle:.3f} ({low:.3f}..{high:.3f})"


def distributions() -> dict[str, np.ndarray]:
    """Return mean and maximum of the held-out error lengths [mm] of each trainer, shape (seeds, 2)."""
    found: dict[str, list[tuple[float, float]]] = {}
    for seed in range(SEEDS):
        for name, (trainer, scale) in {"no network": (None, None), **TRAINERS}.items():
            training, held_out = tasks(scale)
            weights = train(training, trainer, seed=seed).weights if trainer else np.zeros(training.layout.count)
            length = np.linalg.norm(held_out.errors_mm(weights), axis=1)
            found.setdefault(name, []).append((float(length.mean()), float(length.max())))
    return {name: np.array(rows) for name, rows in found.items()}


def print_distributions(found: dict[str, np.ndarray]) -> None:
    """Print the table of `distributions`, and in how many seeds a network is worse than none."""
    print(f"held-out error over {SEEDS} seeds [mm]: median (quartiles)")
    print(f"{'':26}{'mean':>24}{'max':>24}{'worse':>7}")
    before = found["no network"][:, 0]
    for name, rows in found.items():
        text = "".join(f"{quartiles(rows[:, i]):>24}" for i in range(2))
        print(f"{name:26}{text}{int(np.sum(rows[:, 0] > before)):4}/{SEEDS}", flush=True)


def print_local_minima() -> None:
    """Print where trainings end, and in which basins: each end polished without ridge."""
    training, _ = tasks(None)
    square = dataclasses.replace(training, loss=Loss(1.0, 0.0))
    starts = {
        "random start": lambda _: None,
        "backprop, mean square": lambda seed: train(square, Backprop(steps=3000), seed=seed).weights,
        "backprop, paper's loss": lambda seed: train(training, Backprop(steps=3000), seed=seed).weights,
        "iwo, 500 iterations": lambda seed: train(training, Iwo(), seed=seed).weights,
        "iwo, 5000 iterations": lambda seed: train(training, Iwo(IwoSettings(iterations=5000)), seed=seed).weights,
    }
    runs = range(STARTS)
    ends = {name: np.array([_end(square, start(seed), seed) for seed in runs]) for name, start in starts.items()}
    best = min(values[:, 1].min() for values in ends.values())
    print(f"\nlocal minima: {STARTS} runs; root mean square training error a coordinate [mm] at the end, and after")
    print("polishing that end by Levenberg-Marquardt without ridge to the bottom of its basin")
    print(f"{'':26}{'end':>24}{'bottom of its basin':>24}{'within 10 % of the best basin':>32}")
    for name, values in ends.items():
        near = int(np.sum(values[:, 1] < 1.1 * best))
        print(f"{name:26}{quartiles(values[:, 0]):>24}{quartiles(values[:, 1]):>24}{near:>28}/{STARTS}")


def _end(task, weights: np.ndarray | None, seed: int) -> tuple[float, float]:
    """Return root mean square errors [mm] of weights (or of a random start) and of the optimum below them."""
    first, *_, last = PLAIN_LM.states(task, seed, starts=None if weights is None else weights[None])
    return tuple(float(np.sqrt(task.losses(s.weights[None])[0])) for s in (first, last))  # type: ignore[return-value]


if __name__ == "__main__":
    print_distributions(distributions())
    print_local_minima()
