"""OMP_NUM_THREADS=1 python docs/studies/iwo_speed.py | tee docs/studies/iwo_speed.txt

Invasive weed optimisation of the 6-5-3 network against mealpy's OriginalIWO (pip install mealpy), same task, same loss,
same process, the two in turn so that a noisy machine disturbs both alike; times are CPU times, the result is ratios.
mealpy refuses the paper's step sizes and S_min = 0 (it allows sigma_start >= 0.5 and seed_min >= 1), so it gets the
nearest it allows; ours is run with the paper's settings and with mealpy's step sizes. mealpy makes about three times
the children in an iteration (its S_min is 1 and it rounds up), so the cost of one evaluation is shown beside. The third
settings of the equal-loss part were chosen on data set 0. The residuals are synthetic. With `--costs` nothing of mealpy
runs: what an evaluation costs alone.
"""

import sys
import time

import numpy as np

from casadical.compensator import InvasiveWeeds, Iwo, IwoSettings, JointBox, Layout, make_task, train
from casadical.compensator.network import Task, forward

SEEDS = 10
DATA_SETS = 4
SEEDS_EACH = 5
MEALPY_STEPS = {"sigma_initial": 0.5, "sigma_final": 0.0005}
OUR_SETTINGS = {
    "the paper's settings": {},
    "mealpy's steps": MEALPY_STEPS,
    "S_min 1, steps 0.2 -> 0.0005": {"seeds_min": 1, "sigma_initial": 0.2},
}


def synthetic_task(data_set: int = 0) -> Task:
    """50 poses, a smooth residual of about 0.25 mm with 0.02 mm of noise; output in millimetres as in the paper."""
    truth = np.random.default_rng(99 + data_set)
    mix, rates, phase = truth.normal(size=(3, 4)), truth.normal(0, 0.5, (6, 4)), truth.uniform(0, 6, 4)
    random = np.random.default_rng(data_set)
    q = random.uniform(-2, 2, (50, 6))
    residual = np.sin(q @ rates + phase) @ mix.T
    residual *= 0.25 / np.sqrt((residual**2).sum(axis=1).mean())
    residual += random.normal(0, 0.02, residual.shape)
    return make_task(Layout(), JointBox((-2.0,) * 6, (2.0,) * 6), q, residual)


def plain_objective(task: Task):
    """Return the paper's loss of one weight vector as a user of mealpy would write it: two matrix products."""
    x, y = np.ascontiguousarray(task.inputs[:-1].T), np.ascontiguousarray(task.targets.T)

    def objective(w):
        first, last = w[:35].reshape(5, 7), w[35:].reshape(3, 6)
        z = np.tanh(x @ first[:, :-1].T + first[:, -1])
        squares = np.mean((z @ last[:, :-1].T + last[:, -1] - y) ** 2, axis=1)
        return squares.mean() + 0.7 * squares.max()

    w = np.random.default_rng(1).uniform(-1.7, 1.7, task.layout.count)
    assert abs(objective(w) / task.losses(w[None])[0] - 1) < 1e-12
    return objective


def run_mealpy(task: Task, seed: int, epochs: int) -> tuple[float, float, int]:
    """Return CPU time, loss and evaluations."""
    from mealpy import IWO, FloatVar

    plain, calls = plain_objective(task), [0]

    def objective(w):
        calls[0] += 1
        return plain(w)

    model = IWO.OriginalIWO(
        epoch=epochs, pop_size=50, seed_min=1, seed_max=5, exponent=2, sigma_start=0.5, sigma_end=0.0005
    )
    bounds = FloatVar(lb=(-1.7,) * task.layout.count, ub=(1.7,) * task.layout.count)
    problem = {"obj_func": objective, "bounds": bounds, "minmax": "min", "log_to": None}
    start = time.process_time()
    best = model.solve(problem, seed=seed)
    return time.process_time() - start, best.target.fitness, calls[0]


def run_ours(task: Task, seed: int, settings: IwoSettings, precision: str = "double") -> tuple[float, float, int]:
    """Return CPU time, loss and evaluations of a training."""
    start = time.process_time()
    run = Iwo(settings, precision).begin(task, seed)  # type: ignore[arg-type]
    while not run.reasons():
        run.step()
    loss = float(task.losses(run.best()[None])[0])
    return time.process_time() - start, loss, run.search.evaluations


def compare_500(task: Task) -> None:
    """Print the cost of 500 iterations."""
    rows: dict[str, list[tuple[float, float, int]]] = {}
    wide = IwoSettings(**MEALPY_STEPS)
    for seed in range(SEEDS):
        rows.setdefault("mealpy OriginalIWO", []).append(run_mealpy(task, seed, 500))
        rows.setdefault("ours, paper's settings", []).append(run_ours(task, seed, IwoSettings()))
        rows.setdefault("ours, mealpy's steps", []).append(run_ours(task, seed, wide))
        rows.setdefault("ours, paper's, single precision", []).append(run_ours(task, seed, IwoSettings(), "single"))
    print(f"500 iterations, medians of {SEEDS} seeds; 'faster' is the median of the ratios seed by seed")
    print(f"{'':34}{'CPU [s]':>9}{'loss [mm2]':>12}{'evaluations':>13}{'us each':>9}{'faster':>9}")
    reference = np.array([row[0] for row in rows["mealpy OriginalIWO"]])
    for name, runs in rows.items():
        seconds, losses, evaluations = (np.array(column, dtype=float) for column in zip(*runs, strict=True))
        each, ratio = np.median(seconds / evaluations) * 1e6, np.median(reference / seconds)
        print(
            f"{name:34}{np.median(seconds):9.3f}{np.median(losses):12.4f}{np.median(evaluations):13.0f}"
            f"{each:9.2f}{ratio:8.1f}x"
        )


def compare_equal_loss() -> None:
    """Print the time to mealpy's median loss after 500 iterations, on several data sets.

    A run that ends without that loss is followed by one with another seed, so the expected time is the time of
    all runs over the number of successes; it is compared with mealpy's median time for its 500 iterations.
    """
    tasks = [synthetic_task(data_set) for data_set in range(DATA_SETS)]
    theirs = [[run_mealpy(task, seed, 500) for seed in range(SEEDS_EACH)] for task in tasks]
    targets = [float(np.median([run[1] for run in runs])) for runs in theirs]
    seconds = [float(np.median([run[0] for run in runs])) for runs in theirs]
    print(
        f"\ntime to equal loss, {SEEDS_EACH} seeds on each of {DATA_SETS} data sets; mealpy's median losses after 500"
    )
    print("iterations: " + ", ".join(f"{target:.4f}" for target in targets) + " mm2")
    print(f"{'ours with':44}{'reached':>9}   faster on each data set, and their median")
    for name, steps in OUR_SETTINGS.items():
        for iterations in (1000, 2000):
            ratios, reached = [], 0
            for task, target, reference in zip(tasks, targets, seconds, strict=True):
                settings = IwoSettings(iterations=iterations, target=target, **steps)
                runs = [run_ours(task, seed, settings) for seed in range(SEEDS_EACH)]
                hits = sum(loss <= target for _, loss, _ in runs)
                reached += hits
                ratios.append(reference * hits / sum(run[0] for run in runs))
            text = ", ".join(f"{ratio:.1f}x" if ratio else "never" for ratio in ratios)
            label = f"{name}, {iterations} iterations"
            print(f"{label:44}{reached:6}/{DATA_SETS * SEEDS_EACH}   {text}; median {np.median(ratios):.1f}x")


def best_of(call, repeats: int = 40, inner: int = 20) -> float:
    """Return the least CPU time of a call [s]."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        for _ in range(inner):
            call()
        times.append((time.process_time() - start) / inner)
    return min(times)


def compare_products(task: Task, colony: int = 125) -> None:
    """Print the cost of an evaluation against its bare matrix products; 125 is a usual number of children."""
    weights = np.random.default_rng(2).uniform(-1.7, 1.7, (colony, task.layout.count))
    first, last = (np.ascontiguousarray(layer) for layer in task.layout.layers(weights))
    stacked = first.reshape(-1, 7)
    sums, z = np.empty((len(stacked), 50)), np.ones((colony, 6, 50))
    out, x = np.empty((colony, 3, 50)), np.ascontiguousarray(task.inputs[:-1].T)
    pairs = [(np.ascontiguousarray(f[:, :-1].T), np.ascontiguousarray(w[:, :-1].T)) for f, w in zip(first, last)]  # noqa: B905
    hidden, objective = np.tanh(x @ pairs[0][0]), plain_objective(task)

    def whole_colony():
        np.matmul(stacked, task.inputs, out=sums)
        np.matmul(last, z, out=out)

    def one_by_one():
        for a, b in pairs:
            x @ a
            hidden @ b

    stacked_single, inputs_single = stacked.astype(np.float32), task.inputs.astype(np.float32)
    sums_single, z_single = sums.astype(np.float32), z.astype(np.float32)
    last_single, out_single = last.astype(np.float32), out.astype(np.float32)

    def whole_colony_single():
        np.matmul(stacked_single, inputs_single, out=sums_single)
        np.matmul(last_single, z_single, out=out_single)

    tanh_of = np.random.default_rng(3).normal(0, 1.5, sums.shape)  # sums of these weights and inputs spread so
    tanh_of_single, tanhs, tanhs_single = tanh_of.astype(np.float32), sums.copy(), sums_single.copy()
    single = Iwo(precision="single").begin(task, 0)._task
    weights_single = weights.astype(np.float32)
    search = InvasiveWeeds(task.layout.count)
    while search.iteration < 20:
        search.tell(task.losses(search.ask()))

    def generation():
        search._asked = None
        search.ask()

    rows = {
        "bare products, one network at a time": one_by_one,
        "bare products, whole colony at once": whole_colony,
        "  the tansig alone": lambda: np.tanh(tanh_of, out=tanhs),
        "  products and tansig": lambda: (whole_colony(), np.tanh(tanh_of, out=tanhs)),
        "  exp of that size alone": lambda: np.exp(tanh_of, out=tanhs),
        "  products and exp": lambda: (whole_colony(), np.exp(tanh_of, out=tanhs)),
        "the same products, single": whole_colony_single,
        "  products and tansig, single": lambda: (
            whole_colony_single(),
            np.tanh(tanh_of_single, out=tanhs_single),
        ),
        "forward pass": lambda: forward(task.layout, weights, task.inputs),
        "forward pass and loss": lambda: task.losses(weights),
        "forward pass and loss, single": lambda: single.losses(weights_single),
        "plain objective (what mealpy calls)": lambda: [objective(w) for w in weights],
    }
    costs = {name: best_of(call) / colony * 1e6 for name, call in rows.items()}
    alone, batched = costs["bare products, one network at a time"], costs["bare products, whole colony at once"]
    print(f"\ncost of an evaluation, {colony} networks on 50 poses [us], and as a multiple of the bare products")
    print(f"{'':38}{'us':>7}{'of one at a time':>19}{'of whole colony':>18}")
    for name, cost in costs.items():
        print(f"{name:38}{cost:7.2f}{cost / alone:19.2f}{cost / batched:18.2f}")
    floor = costs["  products and tansig"]
    print(
        f"products and tansig alone, which no loss can do without: {floor / batched:.2f} of the products; "
        f"the whole loss is {costs['forward pass and loss'] / floor:.2f} of them"
    )
    of_exp = costs["  products and exp"] / batched
    print(f"products and one exp a neuron: {of_exp:.2f} of the products; what is left of a goal of 2: {2 - of_exp:.2f}")
    draws = best_of(generation) / len(search.ask()) * 1e6
    normal = best_of(lambda: np.random.default_rng(0).standard_normal(weights.shape)) / colony * 1e6
    for label, cost in (("making a child (random numbers, clip)", draws), ("  its normal numbers alone", normal)):
        print(f"{label:38}{cost:7.2f}{cost / alone:19.2f}{cost / batched:18.2f}")
    run = min((run_ours(task, seed, IwoSettings()) for seed in range(SEEDS)), key=lambda one: one[0] / one[2])
    whole = 1e6 * run[0] / run[2]
    least = floor + normal
    print(
        f"products, tansig and normal numbers: {least:.2f} us; a search takes {whole:.2f}, {whole / least:.2f} of them"
    )


def show_literal(task: Task) -> None:
    """Print what the printed eq. 17, K in [0, 1], does."""
    runs = [train(task, Iwo(IwoSettings(dispersal="literal")), seed=seed) for seed in range(SEEDS)]
    at_bound = np.mean([np.mean(run.weights >= 1.69) for run in runs])
    print(
        f"\ndispersal='literal' (K in [0, 1] as printed): median loss {np.median([r.loss_mm2 for r in runs]):.2f} mm2, "
        f"{100 * at_bound:.0f} % of the weights at the upper bound"
    )


if __name__ == "__main__":
    the_task = synthetic_task()
    no_network = float(the_task.losses(np.zeros((1, 53)))[0])
    print(f"synthetic residual, 50 poses, 6-5-3 network, loss without a network {no_network:.4f} mm2")
    if "--costs" not in sys.argv:
        run_mealpy(the_task, 0, 20)  # warm up
        compare_500(the_task)
        compare_equal_loss()
    compare_products(the_task)
    show_literal(the_task)
