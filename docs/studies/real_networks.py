"""OMP_NUM_THREADS=1 python docs/studies/real_networks.py | tee docs/studies/real_networks.txt

Held-out gain of every network method on the real problems, refusals shown as refusals: one split of each (the
problem's own seed), at most 1500 poses to train on and 500 to choose. UR10 figures stand beside those of others, by
Levenberg-Marquardt with the best of four starts, trained on all that identified the geometry, means over ten splits
(not ours). The last row of a problem takes four sets of which no two share a pose.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from casadical import Identification, identify, read_problem
from casadical.compensator import Compensator, Layout, LevenbergMarquardt, Trainer
from casadical.compensator.trainers.registry import network_methods
from casadical.project.networks import training_material
from casadical.project.problem import Problem

ROOT = Path(__file__).parents[2]
NAMES = ("ur10_grid", "ur10_joints", "ur10", "fr3_camera", "panda_1", "panda_3")
OTHERS = {"ur10_grid": (0.353, 0.265), "ur10_joints": (0.329, 0.288), "ur10": (0.330, 0.251)}  # 6-5-3, 6-20-3

LARGER: dict[str, tuple[Trainer, Layout]] = {
    "6-5-3, 60 starts": (LevenbergMarquardt(restarts=60, ridges=(1e-6,)), Layout()),
    "6-5-3, sin and cos": (LevenbergMarquardt(ridges=(1e-5,)), Layout(periodic=tuple(range(6)))),
    "6-20-3": (LevenbergMarquardt(restarts=4, ridges=(1e-5,)), Layout(hidden=(20,))),
}


def four_sets(problem: Problem) -> Problem:
    """The same report set; what identified before is split into identify, train and choose."""
    (whole,) = problem.sets["identify"]
    parts = whole.split({"identify": 0.4, "train": 0.45, "choose": 0.15}, problem.seed)
    return replace(problem, sets={**{name: (m,) for name, m in parts.items()}, "report": problem.sets["report"]})


def row(
    name: str, material: dict[str, tuple], trainer: Trainer, scale: float | None, layout: Layout | None, note: str = ""
) -> None:
    start = time.process_time()
    q, residual = material["train"]
    fit = Compensator.fit(
        q,
        residual,
        choose=material["choose"],
        validate=material["report"],
        trainer=trainer,
        output_scale_mm=scale,
        layout=layout,
    )
    v = fit.validation
    assert v is not None
    print(
        f"  {name:31} report mean {v.before.mean_mm:.3f} > {v.after.mean_mm:.3f} ({100 * v.gain:+5.1f} %)  max "
        f"{v.before.max_mm:.3f} > {v.after.max_mm:.3f}  std {v.before.std_mm:.3f} > {v.after.std_mm:.3f}  "
        f"{'kept' if fit.helps else 'REFUSED':7} {time.process_time() - start:5.1f} s {note}",
        flush=True,
    )


def study(name: str) -> None:
    problem = read_problem(ROOT / "problems" / name)
    result: Identification = identify(problem.robot, problem.sets["identify"], method="SKCM", loss=problem.loss)
    material, words = training_material(problem, result, problem.seed)
    print(f"{name}: SKCM, {sum(map(len, result.measurements))} poses")
    print(f"  {words}")
    if not material:
        return
    small, large = OTHERS[name]
    notes = {
        "LM-NN-SKCM": f"others {small:.3f}",
        "6-5-3, 60 starts": f"others {small:.3f}",
        "6-20-3": f"others {large:.3f}",
    }
    for method, kind in network_methods().items():
        row(method, material, kind.for_method(), kind.output_scale_mm, None, notes.get(method, ""))
    for label, (trainer, layout) in LARGER.items():
        row(f"LM-NN-SKCM, {label}", material, trainer, None, layout, notes.get(label, ""))
    apart = four_sets(problem)
    again = identify(apart.robot, apart.sets["identify"], method="SKCM", loss=apart.loss)
    strict, _ = training_material(apart, again, apart.seed)
    q, residual = strict["train"]
    drawn = np.random.default_rng(apart.seed).permutation(len(q))[:1500]
    used = {**strict, "train": (q[drawn], residual[drawn])}
    row("LM-NN-SKCM, four sets apart", used, LevenbergMarquardt.for_method(), None, None)


if __name__ == "__main__":
    for chosen in sys.argv[1:] or NAMES:
        study(chosen)
