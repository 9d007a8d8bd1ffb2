"""OMP_NUM_THREADS=1 python docs/studies/pose_selection.py > docs/studies/pose_selection.txt

Chosen poses against random ones, for three robots and 30, 50, 100 poses: the held-out error over simulated campaigns,
the standard errors predicted and realised, and what no choice of poses could better. Campaigns come from the
independent simulator: robots that depart from the drawing in every link, 0.02 mm of noise a coordinate, 8 urad a
joint; held-out errors are against the truth.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from casadical import identify, read_robot
from casadical.measurements import from_table
from casadical.pose_selection import Box, Noise, Tracker, Workspace, forecast, select_poses
from casadical.pose_selection.candidates import draw_uniform, expected
from casadical.pose_selection.designs import inverse
from casadical.pose_selection.information import scaled_jacobian
from casadical.simulation import campaign, perturb
from casadical.simulation.plant import Plant

HERE = Path(__file__).parent
PROBLEMS = HERE.parents[1] / "problems"
ROBOTS = {"hh800": "campaign.robot.toml", "kr210": "robot.toml", "ur10e": "robot.toml"}
SIZES = (30, 50, 100)
HELD_OUT, CAMPAIGNS, REPETITIONS = 200, 50, 100
SIGMA, REPEATABILITY = 2e-5, 8e-6
NOISE = Noise(SIGMA, REPEATABILITY)
XYZ, TRUE = ["x_mm", "y_mm", "z_mm"], ["x_true_mm", "y_true_mm", "z_true_mm"]


def plant_of(robot):
    """The same nominal robot in the simulator."""
    joints = robot.joints
    table = {
        "name": robot.name,
        "modified_dh": [
            {"alpha_deg": np.rad2deg(j.alpha), "a_m": j.a, "d_m": j.d, "theta0_deg": np.rad2deg(j.theta)}
            for j in joints
        ],
        "tool_m": robot.tool.T[:3, 3],
        "mass_kg": [j.body.mass for j in joints],
        "com_m": [j.body.com for j in joints],
        "payload": {"mass_kg": robot.payload.mass, "com_m": robot.payload.com},
        "stiffness_Nm_per_rad": [1 / j.compliance for j in joints],
        "joint_range_deg": [[np.rad2deg(j.lower), np.rad2deg(j.upper)] for j in joints],
    }
    if robot.loops:
        bar = robot.loops[0]
        table["four_bar"] = {
            "crank_L5_m": bar.crank, "coupler_L4_m": bar.coupler, "rocker_L3_m": bar.rocker,
            "passive_offset_deg": np.rad2deg(bar.offset),
        }  # fmt: skip
    return Plant.from_dict(table)


def measured(plant, q, seed, payload):
    """A campaign at readings q, shape (n, 6) [rad], and the true points [m]."""
    table = campaign(
        plant, len(q), seed, q_deg=np.rad2deg(q), payload_states=[payload], noise_mm=1e3 * SIGMA,
        repeatability_urad=1e6 * REPEATABILITY, truth=True,
    )  # fmt: skip
    return from_table(table.drop(columns=TRUE), 6, sigma_mm=None), 1e-3 * table[TRUE].to_numpy()


def held_out(robot, plant, q, seed):
    """Mean error [m] of a calibration from readings q, at readings that nobody has measured."""
    result = identify(robot, measured(plant, q, seed, robot.payload.mass)[0])
    test = draw_uniform(robot, HELD_OUT, Workspace(), np.random.default_rng((7, seed)))
    _, truth = measured(plant, test, seed + 1000, robot.payload.mass)
    p, _ = result.predict(test)
    return float(np.linalg.norm(p - truth, axis=1).mean())


def least_error(robot, names, n, task):
    """Lower bound [m] on the expected error of any n poses out of 6000: the best weights that poses could have.

    Multiplicative algorithm for trace(W C); convexity gives the bound (Atkinson, Donev and Tobias 2007, ch. 9 and 10).
    """
    rng = np.random.default_rng(5)
    lower, upper = Workspace().ranges(robot)
    share = 0.5 - 0.5 * np.cos(np.pi * rng.uniform(size=(9000, robot.n)))
    q = lower + (upper - lower) * share
    J = scaled_jacobian(robot, names, expected(robot, q[Workspace().allows(robot, q)][:6000], {}, "pool"))
    T = scaled_jacobian(robot, names, task)
    W = np.einsum("kip,kiq->pq", T, T) / len(T)
    w = np.full(len(J), 1 / len(J))
    for _ in range(600):
        C = inverse(np.einsum("k,kip,kiq->pq", w, J, J, optimize=True))
        d = np.einsum("kip,pq,kiq->k", J, C @ W @ C, J, optimize=True)
        value = float(np.sum(W * C))
        w *= np.sqrt(d)
        w /= w.sum()
    return SIGMA * np.sqrt((2 * value - d.max()) / n)


def campaigns(name, robot, plant):
    for n in SIZES:
        chosen = select_poses(robot, None, n, "V", noise=NOISE)
        mean, wins = compare(robot, plant, chosen.q, Workspace())
        plain = select_poses(robot, None, n, "V", noise=Noise(SIGMA))
        rng = np.random.default_rng(4)
        chance = [draw_uniform(robot, n, Workspace(), rng) for _ in range(50)]
        by_formula = np.mean([accuracy_of(chosen, q) for q in chance])
        alike = np.mean([accuracy_of(plain, q) for q in chance])
        least = least_error(robot, plain.names, n, plain.task)
        print(
            f"{name:6s} {n:4d}  {mean['random']:.4f}  {mean['V']:.4f} {1 - mean['V'] / mean['random']:6.1%}  "
            f"{wins:4.0%}   {1 - chosen.accuracy / by_formula:6.1%}   {1 - plain.accuracy / alike:6.1%}  "
            f"{1 - least / alike:6.1%}",
            flush=True,
        )


def compare(robot, plant, q, room):
    """Mean held-out errors [mm] of random readings in the room and of q, and how often q is better."""
    errors = {"random": [], "V": []}
    for k in range(CAMPAIGNS):
        real = perturb(plant, 100 + k)
        by_chance = draw_uniform(robot, len(q), room, np.random.default_rng((3, len(q), k)))
        errors["random"].append(held_out(robot, real, by_chance, k))
        errors["V"].append(held_out(robot, real, q, k))
    wins = np.mean(np.less(errors["V"], errors["random"]))
    return {c: 1e3 * np.mean(v) for c, v in errors.items()}, wins


def accuracy_of(selection, q):
    """Expected error [m] of other readings than the chosen ones."""
    return replace(selection, m=expected(selection.robot, q, {}, "random")).accuracy


def in_a_room(name, robot, plant):
    """Half the joint-1 range is all that the tracker sees; the robot is to be accurate everywhere."""
    reach = robot.reach
    room = Workspace(
        floor=-0.1 * reach, boxes=(Box(np.array([-2.0, -2.0, -0.2]) * reach, np.array([-0.3, 2.0, 1.0]) * reach),),
        tracker=Tracker(np.array([2.5, 0.0, 0.4]) * reach, np.array([0.0, 0.0, 0.3]) * reach, np.deg2rad(20)),
    )  # fmt: skip
    everywhere = draw_uniform(robot, 300, Workspace(), np.random.default_rng(6))
    for n in SIZES[:2]:
        chosen = select_poses(robot, room, n, "V", task=everywhere, noise=NOISE)
        mean, wins = compare(robot, plant, chosen.q, room)
        less = 1 - mean["V"] / mean["random"]
        print(f"{name:6s} {n:4d}  {mean['random']:.4f}  {mean['V']:.4f} {less:6.1%}  {wins:4.0%}", flush=True)


def standard_errors(name, robot, plant):
    """One real robot, measured REPETITIONS times at the same 50 poses."""
    real = perturb(plant, 99)
    chosen = select_poses(robot, None, 50, "V", noise=NOISE)
    results = [identify(robot, measured(real, chosen.q, k, robot.payload.mass)[0]) for k in range(REPETITIONS)]
    # A base that leans a little lets gravity load joint 1, which the drawing does not know.
    assert all(set(r.names) ^ set(chosen.names) <= {"c1"} for r in results)
    # The base frame is placed anew each time; its parameters count from there.
    kept = [k for k, n in enumerate(chosen.names) if not n.startswith("base_")]
    values = np.array([[r.robot.parameters[chosen.names[k]].value for k in kept] for r in results])
    ratio = values.std(axis=0, ddof=1) / chosen.standard_errors[kept]
    test = draw_uniform(robot, 300, Workspace(), np.random.default_rng(9))
    points = np.array([r.predict(test)[0] for r in results])
    realised = np.sqrt(points.var(axis=0, ddof=1).sum(axis=1).mean())
    m = expected(robot, test, {}, "test")
    predicted = np.sqrt(np.mean(chosen.expected_error(m) ** 2))
    print(
        f"{name:6s}  {np.sqrt(np.mean(ratio**2)):.3f}  {ratio.min():.3f}-{ratio.max():.3f}  "
        f"{1e3 * predicted:.4f} {1e3 * realised:.4f} {realised / predicted:.3f}",
        flush=True,
    )


def main() -> None:
    robots = {name: read_robot(PROBLEMS / name / file) for name, file in ROBOTS.items()}
    plants = {name: plant_of(robot) for name, robot in robots.items()}
    print(f"\nPredicted and realised standard errors, 50 poses, {REPETITIONS} campaigns of one real robot:\n")
    print("robot   parameters: rms, range of realised/predicted; task error [mm] predicted, realised, ratio")
    for name, robot in robots.items():
        standard_errors(name, robot, plants[name])
    print(f"\nHeld-out mean error [mm], {CAMPAIGNS} real robots, each measured once at random and at chosen poses.")
    print("'wins': campaigns in which V is better. 'by formula': what V gains on random poses in expectation, with")
    print("this noise; 'alike': with noise alike in all poses; 'at most': what no poses could better (a bound).\n")
    print("robot     n  random  V        less  wins   by formula   alike at most")
    for name, robot in robots.items():
        campaigns(name, robot, plants[name])
    print("\nThe same in a room that lets only a part be measured (tracker, floor, wall), accurate everywhere:\n")
    print("robot     n  random  V        less  wins")
    for name, robot in robots.items():
        in_a_room(name, robot, plants[name])
    print("\nForecast: expected error [mm] against poses, the best ones next")
    for name, robot in robots.items():
        seen = forecast(robot, 100, noise=NOISE)
        at = [f"{n}: {1e3 * np.interp(n, seen.poses, seen.error):.4f}" for n in (20, 30, 40, 60, 100)]
        print(f"{name:6s}  {', '.join(at)}; ten more gain under 10 % from {seen.stop()} poses on")


if __name__ == "__main__":
    main()
