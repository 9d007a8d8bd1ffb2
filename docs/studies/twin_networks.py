"""OMP_NUM_THREADS=1 python docs/studies/twin_networks.py | tee docs/studies/twin_networks.txt

Networks on what SKCM leaves of the HH800 twin (synthetic): every trainer of the compensator over 50 seeds on the 50
training poses of problems/hh800, the set report as held-out poses; and how often trainings end in local minima. Answers
the paper's two claims: does invasive weed optimisation avoid local minima that single runs of back-propagation fall
into, and does it beat Levenberg-Marquardt with ridge?
"""

from __future__ import annotations

import dataclasses
import time
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from casadical import from_table, identify, read_problem
from casadical.compensator import (
    Backprop,
    Iwo,
    IwoSettings,
    IwoThenLm,
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
    "iwo, scaled, 5000 it.": (Iwo(IwoSettings(iterations=5000)), None),
    "backprop, one run": (Backprop(), None),
    "lm, one run, no ridge": (PLAIN_LM, None),
    "lm, ridge by CV": (LevenbergMarquardt(), None),
    "iwo then lm, ridge by CV": (IwoThenLm(), None),
    "taught by a process": (Taught(), None),
}
# Pairs of which the print says how often the first has the smaller held-out error.
RIVALS = (
    ("iwo, as in the paper", "backprop, one run"),
    ("iwo, scaled, 5000 it.", "backprop, one run"),
    ("iwo, as in the paper", "lm, ridge by CV"),
    ("iwo, as in the paper", "no network"),
    ("lm, ridge by CV", "no network"),
    ("taught by a process", "no network"),
)


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


def lengths(errors_mm: np.ndarray) -> tuple[float, float, float]:
    """Return mean, max and std of the error lengths [mm]."""
    length = np.linalg.norm(errors_mm, axis=1)
    return float(length.mean()), float(length.max()), float(length.std(ddof=1))


def quartiles(values: np.ndarray) -> str:
    """Return 'median (lower quartile .. upper quartile)'."""
    low, middle, high = np.percentile(values, [25, 50, 75])
    return f"{middle:.3f} ({low:.3f}..{high:.3f})"


def distributions() -> dict[str, np.ndarray]:
    """Return held-out mean, max, std, training mean, loss and CPU time of each trainer, shape (seeds, 6)."""
    found: dict[str, list[tuple[float, ...]]] = {"no network": []}
    for seed in range(SEEDS):
        training, held_out = tasks(None)
        nothing = np.zeros(training.layout.count)
        before = (lengths(training.errors_mm(nothing))[0], float(training.losses(nothing[None])[0]), 0.0)
        found["no network"].append((*lengths(held_out.errors_mm(nothing)), *before))
        for name, (trainer, scale) in TRAINERS.items():
            training, held_out = tasks(scale)
            start = time.process_time()
            result = train(training, trainer, seed=seed)
            seconds = time.process_time() - start
            after = (lengths(training.errors_mm(result.weights))[0], result.loss_mm2, seconds)
            found.setdefault(name, []).append((*lengths(held_out.errors_mm(result.weights)), *after))
    return {name: np.array(rows) for name, rows in found.items()}


def print_distributions(found: dict[str, np.ndarray]) -> None:
    """Print the table of `distributions`, and which of two trainers wins how often."""
    print(f"held-out error over {SEEDS} seeds [mm]: median (quartiles); the paper's loss on training poses [mm2]")
    print(f"{'':26}{'mean':>24}{'max':>24}{'std':>24}{'training mean':>15}{'loss':>9}{'CPU [s]':>9}{'worse':>7}")
    before = found["no network"][:, 0]
    for name, rows in found.items():
        text = "".join(f"{quartiles(rows[:, i]):>24}" for i in range(3))
        training, loss, seconds = (float(np.median(rows[:, i])) for i in (3, 4, 5))
        print(f"{name:26}{text}{training:15.3f}{loss:9.4f}{seconds:9.2f}{int(np.sum(rows[:, 0] > before)):4}/{SEEDS}")
    print("how often the first has the smaller held-out error (median gain):")
    for one, other in RIVALS:
        a, b = found[one][:, :3], found[other][:, :3]
        each = zip(("mean", "max", "std"), np.sum(a < b, axis=0), np.median(1 - a / b, axis=0), strict=True)
        figures = ", ".join(f"{name}: {wins}/{SEEDS} ({100 * gain:+.0f} %)" for name, wins, gain in each)
        print(f"  '{one}' against '{other}': {figures}", flush=True)


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
