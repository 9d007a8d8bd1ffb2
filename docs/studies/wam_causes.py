"""python docs/studies/wam_causes.py > docs/studies/wam_causes.txt

A cable-driven arm, layer by layer: what compliance, friction and transmissions of the WAM's joints explain.

Real data. Each model is identified from the 216 poses of the grid; judged in five folds of the grid, by which the order
of the layers was chosen, and on the 20 random poses, which chose nothing. Approach directions come from the order of
the poses. The log Bayes factor is that of the linear problem of a diagnosis, in whose base model joints give way: of
friction alone, of the indented layers, each tried by itself, beside friction in all joints. Signs are a check: a joint
gives way along its torque, and stays behind its last motion.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from casadical import identify, read_problem
from casadical.diagnosis.candidates import candidates_of
from casadical.diagnosis.cross_validation import likely_noise, random_folds
from casadical.diagnosis.evidence import KAPPA_WEIGHTS
from casadical.diagnosis.linear_problem import Case, make_case
from casadical.diagnosis.refit import refit
from casadical.effects import AxisWobble, Effect, FrictionWindup, GearEccentricity, JointScale
from casadical.identification.accuracy import errors
from casadical.identification.result import Identification
from casadical.measurements.derived_columns import derive

ROOT = Path(__file__).parents[2]
JOINTS = range(1, 8)
PUBLISHED = 2.918
REPEATABILITY = 2.0


def of_all(kind: type[Effect]) -> tuple[Effect, ...]:
    return tuple(kind(j) for j in JOINTS)


FRICTION = of_all(FrictionWindup)
# What is taken off besides geometry: whether joints give way, and effects.
LAYERS: dict[str, tuple[bool, tuple[Effect, ...]]] = {
    "geometry": (False, ()),
    "+ compliance (cables)": (True, ()),
    "+ friction_windup@1": (True, FRICTION[:1]),
    "+ friction_windup, all joints": (True, FRICTION),
    "  + joint_scale": (True, (*FRICTION, *of_all(JointScale))),
    "  + gear_eccentricity": (True, (*FRICTION, *of_all(GearEccentricity))),
    "  + axis_wobble": (True, (*FRICTION, *of_all(AxisWobble))),
}


def fitted(case: Case, soft: bool, effects: Sequence[Effect], use: np.ndarray | None = None) -> Identification:
    """Base model and effects identified as `Diagnosis.apply` does; use : mask of the poses, all by default."""
    if soft:
        return refit(case, effects, likely_noise(grids(case, effects), case.whole.sigmas), use)
    return identify(case.given, case.m if use is None else case.m[use], "kinematic", priors=True)


def grids(case: Case, effects: Sequence[Effect], beside: Sequence[Effect] = ()) -> np.ndarray:
    """Log likelihood with effects on the grid of noise and sizes, beside others; without any if there are none."""
    columns, also = (np.unique(case.group(some)) if some else np.zeros(0, dtype=np.int64) for some in (effects, beside))
    if not effects:
        return case.evidence.log_base(also)
    return case.evidence.log_grids([columns], also) + np.log(KAPPA_WEIGHTS)


if __name__ == "__main__":
    problem = read_problem(ROOT / "problems" / "wam")
    approaches = [f"approach{j}" for j in JOINTS]
    (grid,), (random,) = ([derive(m, approaches)[0] for m in problem.sets[name]] for name in ("identify", "report"))
    base = identify(problem.robot, grid, ("kinematic", "compliance"), loss="huber", priors=True, screen=False)
    case = make_case(base, candidates_of(problem.robot, "extended")).with_all_sigmas()
    case = case.with_inliers(np.ones(len(grid), dtype=bool))
    folds = random_folds(len(grid), 0)
    print(f"real data; mm; {len(grid)} poses of the grid, {len(random)} random ones")
    print(f"{'model':36} {'five folds':>10}   {'random':>6} {'max':>6}   log Bayes factor")
    for name, (soft, effects) in LAYERS.items():
        held_out = np.empty(len(grid))
        for k in range(5):
            made = fitted(case, soft, effects, folds != k).robot
            held_out[folds == k] = 1e3 * errors(made, grid[folds == k])
        found = fitted(case, soft, effects)
        left = 1e3 * errors(found.robot, random)
        new = [e for e in effects if e not in FRICTION] or list(effects)
        beside = FRICTION if effects[7:] else ()
        factor = float(np.logaddexp.reduce(grids(case, new, beside), axis=None)) - float(
            np.logaddexp.reduce(grids(case, (), beside), axis=None)
        )
        row = f"{name:36} {held_out.mean():10.3f}   {left.mean():6.3f} {left.max():6.3f}"
        print(f"{row}   {factor:10.1f}" if effects else row, flush=True)
        if effects == FRICTION:
            table = found.parameters.set_index("name")
    print(f"{'published, geometry and network':36} {'':10}   {PUBLISHED:6.3f}")
    print(f"{'repeatability that its maker states':36} {'':10}   {REPEATABILITY:6.1f}")
    print("\nwith friction in all joints: deflection by its torque, and angle by which a joint stays behind its motion")
    for j in JOINTS:
        parts = [n for n in (f"c{j}", f"friction_windup@{j}.constant", f"friction_windup@{j}.load") if n in table.index]
        cells = [
            f"{n.rpartition('.')[2]} {table.value[n]:.3g} +- {table.std_error[n]:.2g} {table.unit[n]}"
            for n in parts
            if table.status[n] == "identified"
        ]
        print(f"joint {j}: {', '.join(cells) or 'nothing is determined'}")
