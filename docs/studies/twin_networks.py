"""OMP_NUM_THREADS=1 python docs/studies/twin_networks.py | tee docs/studies/twin_networks.txt

Networks on what SKCM leaves of the HH800 twin (synthetic), 50 training poses and the set report as held-out poses:
every trainer over 50 seeds on the experiment of problems/hh800; local minima; the methods over 30 other experiments of
the simulator, each identified again, and how often the refusal let a network through; and the ceiling: how much of the
rest is a function of the joints, by a Gaussian process and by larger networks on up to 2000 poses; and what the
training poses are worth to the identification instead. Writes twin_networks.png.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import trainers
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from casadical import from_table, identify, read_problem
from casadical.compensator import Compensator, Layout, LevenbergMarquardt, Trainer
from casadical.compensator.trainers.known import network_methods
from casadical.identification import residual_mm

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # for the simulator in numpy

from numpy_physics import campaign, hh800_true, hh800_twin
from numpy_physics.twin import UNMODELLED, WARMUP

HH800 = Path(__file__).parents[2] / "problems" / "hh800"
SEEDS, EXPERIMENTS, STARTS = 50, 30, 20
PERIODIC = tuple(range(6))
Arrays = tuple[np.ndarray, np.ndarray]


@cache
def robot():
    return read_problem(HH800).robot


@cache
def residuals(seed: int | None) -> dict[str, Arrays]:
    """Joint angles and SKCM's residual [mm] of every set: of the stored experiment (None), or of a simulated one."""
    table = pd.read_csv(HH800.parents[1] / "data/hh800_twin/hh800_twin.csv") if seed is None else hh800_twin(seed)
    m = from_table(table, 6, "position")
    sets = {name: m[(table["set"] == name).to_numpy()] for name in table["set"].unique()}
    found = identify(robot(), sets["identify"], method="SKCM").robot
    return {name: (part.q, residual_mm(found, part)) for name, part in sets.items()}


def stored(_seed: int) -> tuple[Arrays, Arrays]:
    return residuals(None)["train"], residuals(None)["report"]


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


def other_experiments() -> None:
    """The methods of `casadical calibrate` on experiments simulated again, with the refusal by the set choose."""
    print(
        f"\nB. {EXPERIMENTS} other experiments of the simulator, each identified again; errors on the set report if no"
    )
    print("network were refused [mm], median (quartiles); gain in the mean; and what the set choose decided")
    rows: dict[str, list[tuple[float, ...]]] = {}
    for seed in range(EXPERIMENTS):
        sets = residuals(seed)
        rows.setdefault("no network", []).append((*trainers.lengths(sets["report"][1]), 0.0, 0.0))
        for name, kind in network_methods().items():
            fit = Compensator.fit(
                *sets["train"],
                choose=sets["choose"],
                validate=sets["report"],
                trainer=kind.for_method(),
                output_scale_mm=kind.output_scale_mm,
                seed=seed,
            )
            a = fit.validation.after
            rows.setdefault(name, []).append(
                (a.mean_mm, a.max_mm, a.std_mm, 100 * fit.validation.gain, float(fit.helps))
            )
    print(f"{'':16}{'mean':>22}{'max':>22}{'std':>22}{'gain %':>25}  kept  harmful of these")
    for name, values in rows.items():
        v = np.array(values)
        kept = v[:, 4] > 0
        low, middle, high = np.percentile(v[:, 3], [25, 50, 75])
        print(
            f"{name:16}" + "".join(f"{trainers.quartiles(v[:, i]):>22}" for i in range(3)) +
            f"{f'{middle:+.1f} ({low:+.1f}..{high:+.1f})':>25}  {kept.sum():2}/{len(v)}  {np.sum(v[kept, 3] < 0)}",
            flush=True,
        )  # fmt: skip


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


def ceiling() -> None:
    """Held-out error against the number of training poses; the same 1000 poses of the twin held out throughout."""
    plant = hh800_true()
    table = campaign(plant, 3000, 7, noise_mm=0.02, repeatability_urad=8.0, disturbances=UNMODELLED, warmup=WARMUP,
                     payload_states=[plant.payload_kg])  # fmt: skip
    m = from_table(table, 6, "position")
    train = read_problem(HH800).sets["identify"]
    q, y = m.q, residual_mm(identify(robot(), train, method="SKCM").robot, m)
    other_q, other = q[2000:], y[2000:]
    mean, worst, _ = trainers.lengths(other)
    print(
        f"\nceiling: 3000 more poses of the same arm, 1000 of them held out: SKCM leaves {mean:.3f} mean, "
        f"{worst:.2f} max"
    )
    print(
        "held-out mean (gain), max [mm] with so many poses to train on; ridge and lengths by the training poses alone"
    )
    few = LevenbergMarquardt(restarts=4, fold_starts=2)
    larger = LevenbergMarquardt(restarts=2, iterations=100, folds=3, fold_starts=1, ridges=(0.01, 1e-3, 1e-4))
    many = LevenbergMarquardt(restarts=2, iterations=100, ridges=(3e-5,))  # a choice takes too long; a weak one is safe
    wide = Layout(hidden=(20,), periodic=PERIODIC)

    def by_network(q: np.ndarray, y: np.ndarray, trainer: Trainer, layout: Layout) -> np.ndarray:
        network = Compensator.fit(q, y, choose=(q, y), trainer=trainer, layout=layout, margin=0.0)
        return network.correction_mm(other_q)

    ways: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
        "lm 6-5-3": lambda q, y: by_network(q, y, few if len(q) <= 500 else many, Layout()),
        "lm 6-20-3, sin and cos": lambda q, y: by_network(q, y, larger if len(q) <= 500 else many, wide),
        "Gaussian process": lambda q, y: gaussian_process(q, y, other_q),
    }
    for name, way in ways.items():
        cells = []
        for n in (50, 100, 200, 500, 2000):
            after = trainers.lengths(other - way(q[:n], y[:n]))
            cells.append(f"{n}: {after[0]:.3f} ({100 * (1 - after[0] / mean):+.0f} %), {after[1]:.2f}")
        print(f"  {name:24}" + "; ".join(cells), flush=True)


def process_on_fifty_poses() -> None:
    """The Gaussian process in the place of the network: 50 poses of the set train, errors on the set report."""
    rows = []
    for seed in (None, *range(EXPERIMENTS)):
        (q, y), (other_q, other) = residuals(seed)["train"], residuals(seed)["report"]
        rows.append((*trainers.lengths(other)[:2], *trainers.lengths(other - gaussian_process(q, y, other_q))[:2]))
    v = np.array(rows)
    gain = 100 * (1 - v[:, 2:] / v[:, :2])
    print("\nGaussian process on the 50 poses of the set train, errors on the set report:")
    print(f"  stored experiment: mean {v[0, 0]:.3f} > {v[0, 2]:.3f}, max {v[0, 1]:.3f} > {v[0, 3]:.3f}")
    for i, name in enumerate(("mean", "max")):
        low, middle, high = np.percentile(gain[1:, i], [25, 50, 75])
        print(
            f"  {EXPERIMENTS} experiments: {name} {trainers.quartiles(v[1:, i])} > {trainers.quartiles(v[1:, 2 + i])}, "
            f"gain {middle:+.1f} % ({low:+.1f}..{high:+.1f}), better in {np.sum(gain[1:, i] > 0)}/{EXPERIMENTS}",
            flush=True,
        )


def spent_on_identification() -> None:
    """What the 50 poses of the set train are worth to SKCM itself, without any network."""
    rows = []
    for seed in range(EXPERIMENTS):
        table = hh800_twin(seed)
        m = from_table(table, 6, "position")
        report = m[(table["set"] == "report").to_numpy()]
        both = m[table["set"].isin(["identify", "train"]).to_numpy()]
        after = trainers.lengths(residual_mm(identify(robot(), both, method="SKCM").robot, report))
        rows.append((*trainers.lengths(residuals(seed)["report"][1])[:2], *after[:2]))
    v = np.array(rows)
    gain = 100 * (1 - v[:, 2:] / v[:, :2])
    print(f"\nC. the same {EXPERIMENTS} experiments, SKCM from identify and train (90 poses), no network; report:")
    for i, name in enumerate(("mean", "max")):
        low, middle, high = np.percentile(gain[:, i], [25, 50, 75])
        print(
            f"  {name} {trainers.quartiles(v[:, i])} > {trainers.quartiles(v[:, 2 + i])}, gain {middle:+.1f} % "
            f"({low:+.1f}..{high:+.1f}), better in {np.sum(gain[:, i] > 0)}/{len(v)}",
            flush=True,
        )


def main() -> None:
    found = same_experiment()
    title = "HH800 twin (synthetic): errors on the set report, 50 seeds of each trainer"
    trainers.plot(found, Path(__file__).with_suffix(".png"), title)
    trainers.local_minima(stored, STARTS)
    other_experiments()
    ceiling()
    process_on_fifty_poses()
    spent_on_identification()


if __name__ == "__main__":
    main()
