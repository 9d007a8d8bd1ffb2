"""How long a diagnosis takes: python docs/studies/diagnosis_time.py [--commands] > docs/studies/diagnosis_time.txt

Wall time on one core of `diagnose`, calibration included, of synthetic campaigns of 100 poses with one effect each. The
first of a robot builds its signatures, which later ones of the same process share. A minute.

--commands : processor time and most memory of `casadical diagnose` in a process of its own, of the largest tables of
    the problem folders (real, except the hh800's), too; ten minutes
"""

import os
import subprocess
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from diagnosis_campaigns import ROBOTS, hidden, machine

from casadical.blind_check.mujoco_physics import perturb
from casadical.diagnosis.diagnose import diagnose
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table
from casadical.robot.robot import Robot

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # for the simulator in numpy

from numpy_physics import campaign

CAMPAIGNS, DRAWS = 36, 2000
DATA = Path(__file__).parents[2] / "data"
# Problem folder and the table of it that is diagnosed; None: its own.
TABLES = {
    "ur10_grid": None, "ur10_joints": None, "ur10": None, "ur5": "ur5_laser_tracker/measured_grid.csv",
    "wam": "wam_laser_tracker/measured_grid.csv", "fr3_camera": None, "panda_1": None, "hh800": None,
}  # fmt: skip


def measured(number: int) -> tuple[Robot, Measurements]:
    rng = np.random.default_rng([5, number])
    robot, nominal = machine(ROBOTS[number % 3])
    plant = perturb(nominal, number)
    secret = tuple(hidden("one", rng).values())
    table = campaign(plant, 100, disturbances=secret, noise_mm=0.02, repeatability_urad=4.0, seed=number)
    return robot, from_table(table, 6, "position")


def seconds(robot: Robot, m: Measurements, draws: int = 0) -> float:
    began = time.perf_counter()
    diagnose(robot, m, bootstrap=draws)
    return time.perf_counter() - began


def spent(problem: str, table: str | None) -> tuple[float, float]:
    """Processor time [s] and most memory [MB] of the command."""
    words = ["diagnose", str(DATA.parent / "problems" / problem), *([str(DATA / table)] if table else [])]
    began = subprocess.Popen([str(Path(sys.executable).parent / "casadical"), *words], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(began.pid, 0)
    if status:
        sys.exit(f"{problem}: the command ended with {os.waitstatus_to_exitcode(status)}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1000


if __name__ == "__main__":
    every = [measured(k) for k in range(CAMPAIGNS)]
    first = [seconds(*every[k]) for k in range(3)]
    later = [seconds(*one) for one in every[3:]]
    drawn = [seconds(*every[k], DRAWS) for k in range(3)]
    print("first of a robot [s]: " + ", ".join(f"{r} {s:.1f}" for r, s in zip(ROBOTS, first, strict=True)))
    nine = np.quantile(later, 0.9)
    print(f"later ones [s]: median {np.median(later):.2f}, nine in ten under {nine:.2f} (of {len(later)})")
    print(f"with {DRAWS} bootstrap draws [s]: " + ", ".join(f"{r} {s:.1f}" for r, s in zip(ROBOTS, drawn, strict=True)))
    for problem, table in TABLES.items() if "--commands" in sys.argv[1:] else ():
        print(
            f"casadical diagnose problems/{problem}: {{:.0f}} s, {{:.0f}} MB".format(*spent(problem, table)), flush=True
        )
