"""OMP_NUM_THREADS=1 python docs/studies/pose_selection.py [PART...] > docs/studies/pose_selection.txt

Parts: errors, formula, campaigns (all of them), and robots: hh800, kr210, ur10e (all of them).

Chosen poses against random ones, for three robots and 30, 50, 100 poses: the held-out error over simulated campaigns,
the standard errors predicted and realised, and what no choice of poses could better. Campaigns come from the
independent simulator: robots that depart from the drawing in every link, 0.02 mm of noise a coordinate, 8 urad a
joint; held-out errors are against the truth.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from campaign_robots import plant_of
from scipy.stats import chi2

from casadical import identify, read_robot
from casadical.blind_check.mujoco_physics import campaign, perturb
from casadical.core.linear_gaussian.noise import whitening_of
from casadical.measurements.reading import from_table
from casadical.pose_selection import Noise, Workspace
from casadical.pose_selection.candidates import draw, expected, noise_covariance, scaled_jacobian
from casadical.pose_selection.experimental_design import inverse
from casadical.pose_selection.pose_search import select_poses

HERE = Path(__file__).parent
PROBLEMS = HERE.parents[1] / "problems"
ROBOTS = {"hh800": "campaign.robot.toml", "kr210": "robot.toml", "ur10e": "robot.toml"}
SIZES = (30, 50, 100)
HELD_OUT, CAMPAIGNS, REPETITIONS = 200, 100, 100
ROUNDS, STEPS = (0.3, 0.1, 0.05, 0.03, 0.02), 300
SIGMA, REPEATABILITY = 2e-5, 8e-6
NOISE = Noise(SIGMA, REPEATABILITY)
XYZ, TRUE = ["x_mm", "y_mm", "z_mm"], ["x_true_mm", "y_true_mm", "z_true_mm"]


ERRORS_HEAD = f"""
Predicted and realised standard errors, 50 poses, {REPETITIONS} campaigns of one real robot.
The range of realised/predicted over parameters is to be within what chance alone leaves (95 %).

robot   parameters: number, rms, range, by chance, within;  task error [mm] predicted, realised, ratio"""
FORMULA_HEAD = """
Expected rms error [mm] over the task, by formula: mean of 50 random sets of poses, V, and what no choice of so many
poses could better; 'less': what V gains on random poses; 'at most': what any choice could gain.

robot     n  random  V        less   bound   at most"""
CAMPAIGNS_HEAD = f"""
Held-out rms error [mm], {CAMPAIGNS} real robots, each measured once at random and at chosen poses.
'less': what V gains, with its standard error; 'mean': the same of the mean error; 'wins': campaigns in
which V is better.

robot     n  random  V       less             mean   wins"""


def measured(plant, q, seed, payload):
    """A campaign at readings q, shape (n, 6) [rad], and the true points [m]."""
    table = campaign(
        plant, (), len(q), seed, q_deg=np.rad2deg(q), payload_states=[payload], noise_mm=1e3 * SIGMA,
        repeatability_urad=1e6 * REPEATABILITY, truth=True,
    )  # fmt: skip
    return from_table(table.drop(columns=TRUE), 6, sigma_mm=None), 1e-3 * table[TRUE].to_numpy()


def identified(robot, m):
    """The HH800's file places its base by parameters, upright at first: what gravity does to joint 1 of a base that
    leans can only be identified in a second step, from the result of the first. The other robots are placed anyway."""
    result = identify(robot, m)
    return result if robot.base.unknown == "pose" else identify(result.robot, m)


def held_out(robot, plant, q, seed):
    """Root mean square and mean error [m] of a calibration from readings q, at readings that nobody has measured."""
    result = identified(robot, measured(plant, q, seed, robot.payload.mass)[0])
    test = draw(robot, HELD_OUT, Workspace(), np.random.default_rng((7, seed)))
    _, truth = measured(plant, test, seed + 1000, robot.payload.mass)
    p, _ = result.predict(test)
    error = np.linalg.norm(p - truth, axis=1)
    return np.sqrt(np.mean(error**2)), error.mean()


def rows(robot, names, q):
    """Jacobians in units of sigma, shape (n, 3, p)."""
    m = expected(robot, q, {}, "pool")
    return whitening_of(noise_covariance(robot, m, NOISE)) @ scaled_jacobian(robot, names, m)


def least_variance(robot, names, task):
    """Lower bound [mm^2] on n times the expected square error of any n poses: the best weights that poses could have.

    Multiplicative algorithm for trace(W C), which is convex in the weights, so that its tangent bounds it from below
    (Atkinson, Donev and Tobias 2007, chapters 9 and 10); in rounds, with new poses near those of weight and all over.
    It holds for least squares with and without weights (Gauss and Markov), as far as the last round's poses are dense.
    """
    rng = np.random.default_rng(5)
    lower, upper = Workspace().ranges(robot)
    T = scaled_jacobian(robot, names, task)
    W = np.einsum("kip,kiq->pq", T, T) / len(T)

    def allowed(q):
        q = np.clip(q, lower, upper)
        return q[Workspace().allows(robot, q)]

    q = allowed(rng.uniform(lower, upper, (4000, robot.n)))
    A, w = rows(robot, names, q), np.full(len(q), 1 / len(q))
    for size in ROUNDS:
        for _ in range(STEPS):
            C = inverse(np.einsum("k,kip,kiq->pq", w, A, A, optimize=True))
            slope = np.einsum("kip,pq,kiq->k", A, C @ W @ C, A, optimize=True)
            w *= np.sqrt(slope)
            w /= w.sum()
        value, kept = np.sum(W * C), w > 1e-6
        some = rng.random((4000, robot.n)) < 0.5
        near = q[rng.choice(len(q), 4000, p=w)] + size * (upper - lower) * rng.normal(size=some.shape) * some
        new = np.concatenate([allowed(near), allowed(rng.uniform(lower, upper, (4000, robot.n)))])
        B = rows(robot, names, new)
        further = np.einsum("kip,pq,kiq->k", B, C @ W @ C, B, optimize=True)
        bound = 2 * value - max(slope.max(), further.max())
        best = np.argsort(further)[-1500:]
        q, A = np.concatenate([q[kept], new[best]]), np.concatenate([A[kept], B[best]])
        w = np.concatenate([0.9 * w[kept], np.full(len(best), 0.1 / len(best))])
        w /= w.sum()
    return bound


def by_formula(name, robot, _plant):
    bound = None
    for n in SIZES:
        chosen = select_poses(robot, None, n, noise=NOISE)
        bound = bound or least_variance(robot, chosen.names, chosen.task)
        least = 1e-3 * np.sqrt(bound / n)
        rng = np.random.default_rng(4)
        random = np.mean([accuracy_of(chosen, draw(robot, n, Workspace(), rng)) for _ in range(50)])
        print(
            f"{name:6s} {n:4d}  {1e3 * random:.4f}  {1e3 * chosen.accuracy:.4f} {1 - chosen.accuracy / random:6.1%}  "
            f"{1e3 * least:.4f}   {1 - least / random:6.1%}",
            flush=True,
        )


def campaigns(name, robot, plant):
    for n in SIZES:
        chosen = select_poses(robot, None, n, noise=NOISE)
        errors, wins = compare(robot, plant, chosen.q, Workspace())
        print(f"{name:6s} {n:4d}  {said(errors)}  {wins:4.0%}", flush=True)


def said(errors):
    """Errors [mm], what is gained, rms and mean, and the former's standard error, by a bootstrap over campaigns."""
    random, V = (1e3 * np.array(errors[c]) for c in ("random", "V"))
    picks = np.random.default_rng(8).integers(len(V), size=(2000, len(V)))
    spread = np.std(1 - V[picks, 0].mean(axis=1) / random[picks, 0].mean(axis=1))
    less = 1 - V.mean(axis=0) / random.mean(axis=0)
    return f"{random[:, 0].mean():.4f}  {V[:, 0].mean():.4f} {less[0]:6.1%} +- {spread:4.1%}  {less[1]:6.1%}"


def compare(robot, plant, q, room):
    """Held-out errors [m] of random readings in the room and of q, and how often q is better."""
    errors = {"random": [], "V": []}
    for k in range(CAMPAIGNS):
        real = perturb(plant, 100 + k)
        by_chance = draw(robot, len(q), room, np.random.default_rng((3, len(q), k)))
        errors["random"].append(held_out(robot, real, by_chance, k))
        errors["V"].append(held_out(robot, real, q, k))
    wins = np.mean(np.less(errors["V"], errors["random"])[:, 0])
    return errors, wins


def accuracy_of(selection, q):
    """Expected error [m] of other readings than the chosen ones."""
    return replace(selection, m=expected(selection.robot, q, {}, "random")).accuracy


def by_chance_alone(count):
    """Range of realised over true standard errors that REPETITIONS campaigns give by chance: in 95 of 100 studies all
    of so many parameters are within (a realised variance is a chi-square; Bonferroni, which asks no independence)."""
    tail = 0.025 / count
    return np.sqrt(chi2.ppf([tail, 1 - tail], REPETITIONS - 1) / (REPETITIONS - 1))


def standard_errors(name, robot, plant):
    """One real robot, measured REPETITIONS times at the same 50 poses."""
    real = perturb(plant, 99)
    chosen = select_poses(robot, None, 50, noise=NOISE)
    results = [identify(robot, measured(real, chosen.q, k, robot.payload.mass)[0]) for k in range(REPETITIONS)]
    # A base that leans a little lets gravity load joint 1, which the drawing does not know.
    assert all(set(r.names) ^ set(chosen.names) <= {"c1"} for r in results)
    # The base frame is placed again each time; its parameters count from there.
    kept = [k for k, n in enumerate(chosen.names) if not n.startswith("base_")]
    values = np.array([[r.robot.parameters[chosen.names[k]].value for k in kept] for r in results])
    ratio = values.std(axis=0, ddof=1) / chosen.standard_errors[kept]
    test = draw(robot, 300, Workspace(), np.random.default_rng(9))
    points = np.array([r.predict(test)[0] for r in results])
    realised = np.sqrt(points.var(axis=0, ddof=1).sum(axis=1).mean())
    m = expected(robot, test, {}, "test")
    predicted = np.sqrt(np.mean(chosen.expected_error(m) ** 2))
    low, high = by_chance_alone(len(kept))
    within = "yes" if low < ratio.min() and ratio.max() < high else "NO"
    print(
        f"{name:6s}  {len(kept)}  {np.sqrt(np.mean(ratio**2)):.3f}  {ratio.min():.3f}-{ratio.max():.3f}  "
        f"{low:.3f}-{high:.3f} {within:3s}  "
        f"{1e3 * predicted:.4f} {1e3 * realised:.4f} {realised / predicted:.3f}",
        flush=True,
    )


def main() -> None:
    asked = sys.argv[1:]
    robots = {name: read_robot(PROBLEMS / name / file) for name, file in ROBOTS.items()}
    robots = {name: robots[name] for name in [n for n in ROBOTS if n in asked] or ROBOTS}
    parts = [part for part in PARTS if part in asked] or list(PARTS)
    for part in parts:
        head, measure = PARTS[part]
        print(head)
        for name, robot in robots.items():
            measure(name, robot, plant_of(robot))


PARTS = {
    "errors": (ERRORS_HEAD, standard_errors),
    "formula": (FORMULA_HEAD, by_formula),
    "campaigns": (CAMPAIGNS_HEAD, campaigns),
}

if __name__ == "__main__":
    main()
