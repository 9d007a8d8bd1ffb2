"""OMP_NUM_THREADS=1 python docs/studies/real_networks.py | tee docs/studies/real_networks.txt

Held-out gain of every network method on the real problems, refusals shown as refusals: one split of each (the
problem's own seed), at most 1500 poses to train on and 500 to choose. UR10 figures stand beside those of others, by
Levenberg-Marquardt with the best of four starts, trained on all that identified the geometry, means over ten splits
(not ours).
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from casadical import Identification, identify, read_problem
from casadical.compensator import Compensator, Trainer
from casadical.compensator.trainers.registry import network_methods
from casadical.project.networks import training_material

ROOT = Path(__file__).parents[2]
NAMES = ("ur10_grid", "ur10_joints", "ur10", "fr3_camera", "panda_1", "panda_3")
OTHERS = {"ur10_grid": 0.353, "ur10_joints": 0.329, "ur10": 0.330}


def row(name: str, material: dict[str, tuple], trainer: Trainer, scale: float | None, note: str) -> None:
    start = time.process_time()
    q, residual = material["train"]
    fit = Compensator.fit(
        q,
        residual,
        choose=material["choose"],
        validate=material["report"],
        trainer=trainer,
        output_scale_mm=scale,
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
    for method, kind in network_methods().items():
        note = f"others {OTHERS[name]:.3f}" if method == "LM-NN-SKCM" else ""
        row(method, material, kind.for_method(), kind.output_scale_mm, note)


if __name__ == "__main__":
    for chosen in sys.argv[1:] or NAMES:
        study(chosen)
