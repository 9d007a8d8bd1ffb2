"""Campaigns of one simulated arm for the tests: as built, changed, measured from elsewhere."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from casadical import Measurements, Robot, read_robot
from casadical.core.transforms import frame, from_rpy
from casadical.identification.accuracy import predicted

ROOT = Path(__file__).parents[2]
NOISE = 3e-5


def as_built(rng: np.random.Generator) -> tuple[Robot, Robot]:
    """The nominal UR10e, and one built with errors of 0.5 mm and mrad, its joints 30 % off in compliance."""
    robot = read_robot(ROOT / "problems/ur10e/robot.toml")
    values = {}
    for p in robot.parameters:
        if p.group == "compliance":
            values[p.name] = p.value * rng.uniform(0.7, 1.3)
        elif p.group in ("geometry", "tool"):
            values[p.name] = p.value + 5e-4 * rng.normal()
    return robot, robot.with_values(values)


def changed(robot: Robot, **by: float) -> Robot:
    """Parameters changed by so much; compliances by such a factor."""
    old = robot.parameters
    return robot.with_values({n: old[n].value * v if n.startswith("c") else old[n].value + v for n, v in by.items()})


def measured(robot: Robot, seed: int, n: int = 40, source: str = "table") -> Measurements:
    """Poses all over the joints' ranges, the instrument somewhere else for each seed."""
    rng = np.random.default_rng(seed)
    T = frame(from_rpy(rng.uniform(-0.3, 0.3, 3)), rng.uniform(-1, 1, 3))
    robot = replace(robot, base=replace(robot.base, T=robot.base.T @ T))
    lower, upper = np.array([(j.lower, j.upper) for j in robot.joints]).T
    q = rng.uniform(lower, upper, (n, robot.n))
    bare = Measurements(q=q, kind="position", position=np.zeros((n, 3)), source=source)
    p, _ = predicted(robot, bare)
    return replace(bare, position=p + NOISE * rng.normal(size=p.shape))


def write_table(m: Measurements, path: Path) -> Path:
    """Readings in degrees and positions in millimetres."""
    assert m.position is not None
    path.parent.mkdir(parents=True, exist_ok=True)
    head = [f"q{j + 1}_deg" for j in range(m.q.shape[1])] + ["x_mm", "y_mm", "z_mm"]
    rows = np.hstack([np.rad2deg(m.q), 1e3 * m.position])
    np.savetxt(path, rows, delimiter=",", header=",".join(head), comments="", fmt="%.9g")
    return path
