"""Poses simulated with the robot's own model, for a first run before anything is measured; marked as synthetic."""

from dataclasses import replace

import numpy as np

from casadical.core.arrays import Array
from casadical.core.transforms import frame, from_rpy
from casadical.measurements.measurements import Measurements
from casadical.pose_selection import Workspace
from casadical.pose_selection.candidates import draw, expected
from casadical.robot.robot import Robot

POSES = 60
NOISE = 2e-5
# One sigma by which the robot "as built" departs from the drawing: lengths [m], angles [rad].
DEPARTURE = {"m": 3e-4, "rad": 5e-4}
# Where it stands in the measuring frame, if that is to be found.
STAND = frame(from_rpy(np.deg2rad([0.5, -0.3, 30.0])), np.array([0.8, -0.4, 0.2]))


def synthetic_poses(robot: Robot, seed: int = 0) -> str:
    """A CSV table of readings and noisy positions, of a robot that departs a little from its drawing."""
    rng = np.random.default_rng(seed)
    built = as_built(robot, rng)
    q = draw(one_turn(robot), POSES, Workspace(), rng)
    m = expected(built, q, {}, "synthetic")
    assert m.position is not None
    return _table(robot, m, m.position + rng.normal(0.0, NOISE, m.position.shape))


def one_turn(robot: Robot) -> Robot:
    """Joints that turn more than once are driven within half a turn to either side."""
    joints = (
        replace(j, lower=max(j.lower, -np.pi), upper=min(j.upper, np.pi)) if j.upper - j.lower > 2 * np.pi else j
        for j in robot.joints
    )
    return replace(robot, joints=tuple(joints))


def as_built(robot: Robot, rng: np.random.Generator) -> Robot:
    """A robot that departs a little from its drawing, somewhere in the measuring frame."""
    values = {}
    for p in robot.parameters:
        if p.group in ("geometry", "loop"):
            values[p.name] = p.value + rng.normal(0.0, DEPARTURE[p.unit])
        elif p.group == "tool":
            values[p.name] = p.value + 5 * rng.normal(0.0, DEPARTURE[p.unit])
        elif p.group == "compliance":
            values[p.name] = p.value + rng.uniform(0.2, 0.5) * p.prior
    built = robot.with_values(values)
    if robot.base.unknown == "none":
        return built
    return replace(built, base=replace(built.base, T=built.base.T @ STAND))


def _table(robot: Robot, m: Measurements, position: Array) -> str:
    units = robot.reading_units
    lines = [",".join([*units, "x_mm", "y_mm", "z_mm"])]
    for q, p in zip(m.q / list(units.values()), 1e3 * position, strict=True):
        lines.append(",".join([*(f"{v:.6f}" for v in q), *(f"{v:.4f}" for v in p)]))
    return "\n".join(lines) + "\n"
