"""OMP_NUM_THREADS=1 python docs/studies/trainers.py | tee docs/studies/trainers.txt

Every trainer of the compensator on 50 training poses over 50 seeds: held-out mean, max and std of the position error,
median and quartiles, and a box plot (trainers.png, needs matplotlib). Answers the paper's two claims with numbers: does
invasive weed optimisation avoid local minima that single back-propagation runs fall into, and does it beat
Levenberg-Marquardt with ridge? With --data FILE.csv (columns q1_rad ... and dx_mm, dy_mm, dz_mm: residual = measured
minus computed) it takes a data set of yours and draws its training poses again for every seed; without it, a synthetic
smooth residual, declared as such in its output.
"""

import argparse
import dataclasses
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from casadical.compensator import (
    Backprop,
    Compensator,
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

TRAINING_POSES, HELD_OUT_POSES = 50, 1000
PLAIN_LM = LevenbergMarquardt(restarts=1, iterations=400, ridges=(0.0,))

# name: trainer, and millimetres of one output unit (None: root mean square of the training residual)
TRAINERS: dict[str, tuple[Trainer, float | None]] = {
    "iwo, as in the paper": (Iwo(), 1.0),
    "iwo, scaled output": (Iwo(), None),
    "iwo, scaled, 5000 it.": (Iwo(IwoSettings(iterations=5000)), None),
    "backprop, one run": (Backprop(), None),
    "lm, one run, no ridge": (PLAIN_LM, None),
    "lm, best of 20, no ridge": (LevenbergMarquardt(restarts=20, ridges=(0.0,)), None),
    "lm, ridge by CV": (LevenbergMarquardt(), None),
    "iwo then lm, ridge by CV": (IwoThenLm(), None),
    "taught by a process": (Taught(), None),
}

Arrays = tuple[np.ndarray, np.ndarray]
Source = Callable[[int], tuple[Arrays, Arrays]]


def synthetic(seed: int) -> tuple[Arrays, Arrays]:
    """Return training and held-out (q, residual): another smooth residual for each seed, 0.25 mm rms, 0.02 mm noise."""
    random = np.random.default_rng(seed)
    mix, rates, phase = random.normal(size=(3, 6)), random.normal(0, 0.5, (6, 6)), random.uniform(0, 2 * np.pi, 6)
    q = random.uniform(-2, 2, (TRAINING_POSES + HELD_OUT_POSES, 6))
    smooth = np.sin(q @ rates + phase) @ mix.T
    smooth *= 0.25 / np.sqrt(np.mean(np.sum(smooth**2, axis=1)))
    residual = smooth + random.normal(0, 0.02, smooth.shape)
    return (q[:TRAINING_POSES], residual[:TRAINING_POSES]), (q[TRAINING_POSES:], residual[TRAINING_POSES:])


def from_file(path: str) -> Source:
    """Return a source that draws training poses from a file; the rest is held out."""
    table = pd.read_csv(path)
    q = table[[name for name in table.columns if name.startswith("q") and name.endswith("_rad")]].to_numpy(float)
    residual = table[["dx_mm", "dy_mm", "dz_mm"]].to_numpy(float)

    def draw(seed: int) -> tuple[Arrays, Arrays]:
        order = np.random.default_rng(seed).permutation(len(q))
        a, b = order[:TRAINING_POSES], order[TRAINING_POSES:][:HELD_OUT_POSES]
        return (q[a], residual[a]), (q[b], residual[b])

    return draw


def tasks_of(source: Source, seed: int, scale: float | None):
    """Return training and held-out task of a seed."""
    (q, residual), (other_q, other) = source(seed)
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


def distributions(source: Source, seeds: int) -> dict[str, np.ndarray]:
    """Train all; return per trainer rows of held-out mean, max, std, training mean, loss, CPU time; (seeds, 6)."""
    found: dict[str, list[tuple[float, ...]]] = {"no network": []}
    for seed in range(seeds):
        training, held_out = tasks_of(source, seed, None)
        nothing = np.zeros(training.layout.count)
        before = (lengths(training.errors_mm(nothing))[0], float(training.losses(nothing[None])[0]), 0.0)
        found["no network"].append((*lengths(held_out.errors_mm(nothing)), *before))
        for name, (trainer, scale) in TRAINERS.items():
            training, held_out = tasks_of(source, seed, scale)
            start = time.process_time()
            result = train(training, trainer, seed=seed)
            seconds = time.process_time() - start
            after = (lengths(training.errors_mm(result.weights))[0], result.loss_mm2, seconds)
            found.setdefault(name, []).append((*lengths(held_out.errors_mm(result.weights)), *after))
    return {name: np.array(rows) for name, rows in found.items()}


def print_distributions(found: dict[str, np.ndarray]) -> None:
    """Print the table of `distributions`."""
    seeds = len(found["no network"])
    print(f"held-out error over {seeds} seeds [mm]: median (quartiles); the paper's loss on training poses [mm2]")
    print(f"{'':26}{'mean':>24}{'max':>24}{'std':>24}{'training mean':>15}{'loss':>9}{'CPU [s]':>9}{'worse':>7}")
    before = found["no network"][:, 0]
    for name, rows in found.items():
        text = "".join(f"{quartiles(rows[:, i]):>24}" for i in range(3))
        worse = int(np.sum(rows[:, 0] > before))
        training, loss, seconds = (float(np.median(rows[:, i])) for i in (3, 4, 5))
        print(f"{name:26}{text}{training:15.3f}{loss:9.4f}{seconds:9.2f}{worse:4}/{seeds}")


def compare(found: dict[str, np.ndarray], one: str, other: str) -> None:
    """Print how often one trainer beats another, seed by seed, on the held-out poses."""
    a, b = found[one], found[other]
    wins = [int(np.sum(a[:, i] < b[:, i])) for i in range(3)]
    gain = [100 * float(np.median(1 - a[:, i] / b[:, i])) for i in range(3)]
    figures = ", ".join(
        f"{w}: {n}/{len(a)} ({g:+.0f} %)" for w, n, g in zip(("mean", "max", "std"), wins, gain, strict=True)
    )
    print(f"  '{one}' against '{other}': {figures}")


def local_minima(source: Source, seeds: int) -> None:
    """Print where trainings end on one and the same task, and in which basins: each end polished without ridge."""
    training, _ = tasks_of(source, 0, None)
    square = dataclasses.replace(training, loss=Loss(1.0, 0.0))
    starts = {
        "random start": lambda _: None,
        "backprop, mean square": lambda seed: train(square, Backprop(steps=3000), seed=seed).weights,
        "backprop, paper's loss": lambda seed: train(training, Backprop(steps=3000), seed=seed).weights,
        "iwo, 500 iterations": lambda seed: train(training, Iwo(), seed=seed).weights,
        "iwo, 5000 iterations": lambda seed: train(training, Iwo(IwoSettings(iterations=5000)), seed=seed).weights,
    }
    ends = {
        name: np.array([_end(square, start(seed), seed) for seed in range(seeds)]) for name, start in starts.items()
    }
    best = min(values[:, 1].min() for values in ends.values())
    print(
        f"\nlocal minima: one task (seed 0's), {seeds} runs; root mean square training error a coordinate [mm] at the"
    )
    print("end, and after polishing that end by Levenberg-Marquardt without ridge to the bottom of its basin")
    print(f"{'':26}{'end':>24}{'bottom of its basin':>24}{'within 10 % of the best basin':>32}")
    for name, values in ends.items():
        near = int(np.sum(values[:, 1] < 1.1 * best))
        print(f"{name:26}{quartiles(values[:, 0]):>24}{quartiles(values[:, 1]):>24}{near:>28}/{seeds}")


def _end(task, weights: np.ndarray | None, seed: int) -> tuple[float, float]:
    """Return root mean square errors [mm] of weights (or of a random start) and of the optimum below them."""
    run = PLAIN_LM.begin(task, seed, starts=None if weights is None else weights[None])
    first = run.best()
    while not run.reasons():
        run.step()
    return tuple(float(np.sqrt(task.losses(w[None])[0])) for w in (first, run.best()))  # type: ignore[return-value]


def refusals(seeds: int) -> None:
    """Print how often pure noise, and a smooth residual, pass the test of the cross-validated gain."""
    trainer = LevenbergMarquardt(restarts=3)
    print(
        f"\nrefusal: {seeds} data sets of {TRAINING_POSES} poses each, lm with ridge; networks kept at a margin of so\n"
        "many standard errors of the cross-validated gain, and the change of the held-out mean error by those kept"
    )
    for name in ("pure noise", "smooth residual"):
        rows = []
        for seed in range(seeds):
            (q, residual), held_out = synthetic(seed)
            if name == "pure noise":
                random = np.random.default_rng(1000 + seed)
                residual, noise = (random.normal(0, 0.1, (n, 3)) for n in (TRAINING_POSES, HELD_OUT_POSES))
                held_out = (held_out[0], noise)
            fit = Compensator.fit(q, residual, validate=held_out, trainer=trainer, seed=seed)
            assert fit.validation is not None
            rows.append((fit.choice.gain, fit.choice.gain / max(fit.choice.gain_error, 1e-300), fit.validation.gain))
        gain, sure, true = np.array(rows).T
        for margin in (0, 1, 2):
            kept = (gain > 0) & (sure > margin)
            change = (
                f"{-100 * np.median(true[kept]):+.1f} % median, {-100 * true[kept].min():+.1f} % at worst"
                if kept.any()
                else "-"
            )
            harmed = int(np.sum(true[kept] < 0))
            print(f"  {name:16} margin {margin}: kept {kept.sum():2}/{seeds}, of these harmful {harmed:2}; {change}")


def plot(found: dict[str, np.ndarray], path: Path, title: str) -> None:
    """Draw the held-out mean, max and std of every trainer as box plots."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12, 4), sharey=True)
    for i, (axis, name) in enumerate(zip(axes, ("mean", "max", "std"), strict=True)):
        axis.boxplot([rows[:, i] for rows in found.values()], orientation="horizontal", showfliers=False)
        axis.set_yticks(range(1, len(found) + 1), list(found))
        axis.set_xlabel(f"held-out {name} [mm]")
        axis.grid(axis="x", alpha=0.3)
    axes[0].invert_yaxis()
    figure.suptitle(title, fontsize=10)
    figure.tight_layout()
    figure.savefig(path, dpi=90, metadata={"Software": None})


def main() -> None:
    """Run the study."""
    options = argparse.ArgumentParser(description="Every trainer of the compensator over many seeds.")
    options.add_argument("--data", help="CSV with q1_rad ... and dx_mm, dy_mm, dz_mm; default: synthetic")
    options.add_argument("--seeds", type=int, default=50)
    options.add_argument("--plot", default=str(Path(__file__).with_suffix(".png")))
    choice = options.parse_args()
    source = from_file(choice.data) if choice.data else synthetic
    kind = f"data set {Path(choice.data).name}" if choice.data else "SYNTHETIC smooth residuals, another one each seed"
    print(f"{kind}; {TRAINING_POSES} training poses, 6-5-3 network\n")
    found = distributions(source, choice.seeds)
    print_distributions(found)
    print("seed by seed, how often the first has the smaller held-out error (median gain):")
    for one, other in (
        ("iwo, as in the paper", "backprop, one run"),
        ("iwo, scaled output", "backprop, one run"),
        ("iwo, scaled, 5000 it.", "backprop, one run"),
        ("iwo, scaled, 5000 it.", "lm, one run, no ridge"),
        ("iwo, scaled, 5000 it.", "lm, ridge by CV"),
        ("iwo then lm, ridge by CV", "lm, ridge by CV"),
    ):
        compare(found, one, other)
    local_minima(source, choice.seeds)
    if not choice.data:
        refusals(choice.seeds)
    plot(found, Path(choice.plot), kind)


if __name__ == "__main__":
    main()
