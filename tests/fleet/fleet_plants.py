"""Simulated planar arms of one drawing, each a problem folder, with later campaigns where they are asked for."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd

from casadical import Robot, read_robot

ROOT = Path(__file__).parents[2]
A1 = 0.4004  # as built; drawn 0.4


def planar(folder: Path, seed: int, campaigns: int = 0, a1: float = A1) -> Path:
    """A problem of a planar arm, a1 longer than drawn by 0.4 mm and 0.1 mm from arm to arm; later it turns longer."""
    rng = np.random.default_rng(seed)
    nominal = read_robot(ROOT / "problems/planar/robot.toml")
    built = a1 + 1e-4 * rng.normal()
    folder.mkdir(parents=True)
    shutil.copy(ROOT / "problems/planar/robot.toml", folder)
    (folder / "problem.toml").write_text(
        'casadical = 1\ntitle = "arm"\ndata = "synthetic"\nmethods = ["KM"]\n[[measurements]]\nfile = "poses.csv"\n'
        "[sets]\nseed = 0\nidentify = 0.7\nreport = 0.3\n"
    )
    write(nominal, built, folder / "poses.csv", rng)
    for k in range(campaigns):
        (folder / "campaigns").mkdir(exist_ok=True)
        write(nominal, built * (1 + 5e-4 * (k > 0)), folder / "campaigns" / f"2026-{k + 1:02d}-01.csv", rng)
    return folder


def write(nominal: Robot, a1: float, path: Path, rng: np.random.Generator) -> None:
    robot = nominal.with_values({"a1": a1, "tool_x": nominal.parameters["tool_x"].value * a1 / A1})
    q = rng.uniform(-2.5, 2.5, (40, 2))
    p = robot.model.evaluate(("p",), q, np.tile(robot.declared, (40, 1)), robot.parameters.values)[0].T
    table = pd.DataFrame(np.hstack([np.degrees(q), 1e3 * (p + 2e-5 * rng.normal(size=p.shape))]))
    table.to_csv(path, index=False, header=["q1_deg", "q2_deg", "x_mm", "y_mm", "z_mm"])
