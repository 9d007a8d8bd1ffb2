"""Held-out errors of the UR5 and the WAM: `python docs/studies/real_arms.py > docs/studies/real_arms.txt` (minutes).

Two splits of each: the published one (identified on the grid, judged on 20 random poses), and ten seeded ones of the
grid, judged on the rest of the grid and on the random poses; means over the ten of each one's mean and maximum.
Published figures are means over the same 20 random poses, for geometric calibration with a graph network (Jacobi 2025).

Then both signs of the published errors, of which docs/studies/real_tables.py shows the right one: a check by physics. A
model that is linear in its parameters leaves mirrored errors equally small, so that only two things speak of the sign:
terms of second order, and that a joint gives way along its torque, never against it. The log-likelihood gains suppose
independent noise, which these residuals are not, and so are too large.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from real_tables import SETS, SIGN, measured, published

from casadical import Robot, from_table, identify, read_problem
from casadical.core.parts import Width
from casadical.identification.accuracy import errors
from casadical.measurements.measurements import Measurements
from casadical.project.problem import Problem

ROOT = Path(__file__).parents[2]
GRID = {"ur5": 300, "wam": 150}  # poses of the grid that identify, in the second split
SEEDS = range(10)
PUBLISHED = {"ur5": (2.5664, 0.1549), "wam": (17.7661, 2.9178)}  # mm: as given, and with both of their models
# As soft as a joint may be that a cable drives and a controller without much integral holds.
SOFT = Width(length_bound=0.1, angle_bound=np.deg2rad(20), length_prior=0.01, angle_prior=np.deg2rad(1))

Tests = Mapping[str, Measurements]
MODELS: dict[str, Callable[[Robot, Measurements], Robot]] = {
    "as given": lambda robot, _: robot,
    "base and tool": lambda robot, m: identify(robot, m, ("base", "tool")).robot,
    "geometry": lambda robot, m: identify(robot, m, method="KM").robot,
    "and compliance": lambda robot, m: identify(robot, m, method="SKCM").robot,
}


def splits(problem: Problem, poses: int) -> Iterator[tuple[str, list[tuple[Measurements, Tests]]]]:
    """Each split's name, and its pairs of poses that identify and sets of poses to be judged on."""
    (grid,), (random,) = problem.sets["identify"], problem.sets["report"]
    yield "published", [(grid, {"random": random})]
    cut = [grid.split({"identify": poses, "report": len(grid) - poses}, seed) for seed in SEEDS]
    yield f"{poses} of grid", [(c["identify"], {"random": random, "rest": c["report"]}) for c in cut]


def held_out(robot: Robot, pairs: list[tuple[Measurements, Tests]], model: str) -> dict[str, np.ndarray]:
    """Mean and maximum error [mm] by set judged on, each averaged over the pairs of a split."""
    found: dict[str, list[tuple[float, float]]] = {}
    for given, tests in pairs:
        made = MODELS[model](robot, given)
        for name, m in tests.items():
            e = 1e3 * errors(made, m)
            found.setdefault(name, []).append((e.mean(), e.max()))
    return {name: np.mean(rows, axis=0) for name, rows in found.items()}


def figures(name: str) -> None:
    problem = read_problem(ROOT / "problems" / name)
    for split, pairs in splits(problem, GRID[name]):
        for model in MODELS:
            shown = held_out(problem.robot, pairs, model)
            text = "   ".join(f"{mean:8.4f} {most:8.4f}" for mean, most in shown.values())
            print(f"{name:5} {split:12} {model:15} {text}", flush=True)
    print(f"{name:5} published: {PUBLISHED[name][0]:.4f} as given, {PUBLISHED[name][1]:.4f} with geometry and network")


def signs(name: str) -> None:
    """Both signs of the errors: what the grid, fitted, and the random poses, held out, are left with."""
    robot = read_problem(ROOT / "problems" / name).robot
    soft = replace(robot, widths={**robot.widths, "compliance": SOFT})
    cost: dict[str, float] = {}
    for sign in (-SIGN, SIGN):
        grid, random = (
            from_table(measured(published(name, table), use, sign), robot.n, "position") for table, use in SETS.items()
        )
        for model, start, method in (("geometry", robot, "KM"), ("soft joints", soft, "SKCM")):
            found = identify(start, grid, method=method)
            e, left = errors(found.robot, grid), 1e3 * errors(found.robot, random)
            half = -1.5 * len(grid) * np.log(np.mean(e**2))
            gain = half - cost.setdefault(model, half)
            c = found.parameters.set_index("name").filter(regex=r"^c\d", axis=0)
            c = c[c.status != "not identifiable"]
            text = ", ".join(
                f"{n} {v:.0f}" + (f" +- {s:.0f}" if np.isfinite(s) else " (bound)")
                for n, v, s in zip(c.index, c.value, c.std_error, strict=True)
            )
            what = f"target {'-' if sign < 0 else '+'} error"
            print(
                f"{name:5} {what:15} {model:12} {1e3 * e.mean():7.4f}   {left.mean():7.4f}   {gain:8.1f}"
                f"   {text if method == 'SKCM' else ''}".rstrip(),
                flush=True,
            )


if __name__ == "__main__":
    print(f"{'held out, mm':31} {'random: mean':>12} {'max':>8}   {'rest: mean':>10} {'max':>6}")
    for arm in GRID:
        figures(arm)
    print(f"\n{'the sign of the errors':36} {'grid':>5}   {'random':>7}   {'log gain':>8}   compliances, urad/(N m)")
    for arm in GRID:
        signs(arm)
