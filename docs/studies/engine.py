"""How exactly and how fast the engine finds rest: python docs/studies/engine.py > docs/studies/engine.txt

Needs MuJoCo and Pinocchio (``pip install '.[dev]'``). Synthetic robots throughout.
"""

import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import mujoco
import numpy as np
from campaign_robots import machine as drawn

from casadical.blind_check import mujoco_physics as engine
from casadical.blind_check.mujoco_physics import Plant, perturb
from casadical.blind_check.mujoco_physics.cause import reflector, settle
from casadical.blind_check.mujoco_physics.equilibrium import Engine, Stop
from casadical.blind_check.mujoco_physics.mechanism import start
from casadical.blind_check.mujoco_physics.plant import unfolded
from casadical.blind_check.mujoco_physics.stops import Stops, draw_poses

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "blind_check"))

from mujoco_physics.oracle import rest as by_pinocchio

ROBOTS = ("hh800", "kr210", "ur10e")
FOLDER = Path(__file__).parents[2] / "data" / "campaigns" / "robots"


def stops(machine: Plant, n: int, seed: int) -> Stops:
    rng = np.random.default_rng(seed)
    q = draw_poses(machine, n, rng, machine.ranges, unfolded(machine))
    payload = np.where(np.arange(n) % 2, machine.payload_kg, 0.0)
    return Stops(q, 30.0 * np.arange(1, n + 1), np.zeros(n), payload, rng.choice([-1.0, 1.0], (n, 6)))


def gap(machine: Plant, at: Stops) -> float:
    """How far the loop's ends come apart at most [m]."""
    moving, worst = Engine(engine.mechanism(machine)), 0.0
    for q, payload in zip(at.q, at.payload_kg, strict=True):
        moving.rest(Stop(q, np.ones(6), start(machine, q), payload))
        ends = [moving.data.site(name).xpos for name in ("coupler_end", "rocker_end")]
        worst = max(worst, float(np.linalg.norm(ends[0] - ends[1])))
    return worst


def main() -> None:
    print(f"MuJoCo {mujoco.__version__}, one thread; 5 robots as built, 100 poses each, with and without payload\n")
    print("positions [um], largest difference (mean) of the engine's without effects")
    for name in ROBOTS:
        nominal = drawn(name)[1]
        theirs: dict[str, list[np.ndarray]] = {"fixed point": [], "pinocchio": []}
        gaps = []
        for seed in range(5):
            machine = perturb(nominal, seed)
            at = stops(machine, 100, seed)
            ours = engine.positions(machine, (), at)
            theirs["fixed point"].append(ours - reflector(settle(machine, at)))
            balanced = [by_pinocchio(machine, p, q) for p, q in zip(at.payload_kg, at.q, strict=True)]
            theirs["pinocchio"].append(ours - np.array(balanced))
            if machine.four_bar is not None:
                gaps.append(gap(machine, at))
        for who, differences in theirs.items():
            far = 1e6 * np.linalg.norm(np.concatenate(differences), axis=1)
            print(f"  {name:6} against {who:11} {far.max():9.5f} ({far.mean():.5f})")
        if gaps:
            print(f"  {name:6} loop closed within     {1e6 * max(gaps):9.5f}")
    print("\nprocessor time [ms] a pose (100 poses, building the model included)")
    for name in ROBOTS:
        machine = perturb(drawn(name)[1], 0)
        at = stops(machine, 100, 0)
        for label, effect, joint in (
            ("no effect", None, None),
            ("link flexure", "link_flexure", None),
            ("friction, with the move to the pose", "friction_windup", 2),
            ("backlash, with the move to the pose", "backlash", 2),
        ):
            rng = np.random.default_rng(0)
            hidden = () if effect is None else (engine.draw_effect(machine, effect, rng),)
            if joint:
                hidden = (engine.Hidden(effect, joint, hidden[0].size),)
            begun = time.process_time()
            engine.positions(machine, hidden, at)
            print(f"  {name:6} {label:37} {10 * (time.process_time() - begun):6.2f}")


if __name__ == "__main__":
    main()
