"""Robots of the problem folders with planted errors: the 'calibrated' file of each test."""

from pathlib import Path

import numpy as np

from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot

ROOT = Path(__file__).parents[3]
NAMES = ("ur10", "hh800")
SIZES = {"base": 1.0, "geometry": 0.2, "loop": 0.2, "tool": 0.05}  # of a prior width
FRAME = {"alpha0", "a0", "beta0", "b0", "theta1", "d1"}  # of hh800: where the instrument stood


def nominal_path(name: str) -> Path:
    return ROOT / "problems" / name / "robot.toml"


def planted(name: str, *, only_base: bool = False, seed: int = 1) -> Robot:
    """The problem's robot with random errors; with only_base nothing but the instrument elsewhere."""
    robot = read_robot(nominal_path(name))
    rng = np.random.default_rng(seed)
    first_row_is_base = robot.joints[0].b is not None
    values = {}
    for p in robot.parameters:
        size = SIZES.get(p.group, 0.0) * p.prior * rng.normal()
        if p.name in FRAME and p.group != "base":
            size = 50 * size if first_row_is_base else 0.0
        of_base = p.group == "base" or (first_row_is_base and p.name in FRAME)
        if p.group == "compliance":
            size = 0.0 if only_base else 0.5 * p.prior
        elif only_base and not of_base:
            size = 0.0
        values[p.name] = p.value + size
    return robot.with_values(values)


def poses(robot: Robot, count: int, seed: int = 0) -> np.ndarray:
    """Random joints in the inner part of the ranges, shape (count, n) [rad]."""
    lower, upper = np.array([(j.lower, j.upper) for j in robot.joints]).T
    middle, half = (lower + upper) / 2, (upper - lower) / 2
    return np.random.default_rng(seed).uniform(middle - 0.8 * half, middle + 0.8 * half, (count, robot.n))


def positions(robot: Robot, q: np.ndarray, payload_kg: float | None = None) -> np.ndarray:
    """Tool positions in the measuring frame by the package's own model, shape (k, 3) [m]."""
    w = np.tile(robot.declared, (len(q), 1))
    if payload_kg is not None:
        w[:, robot.conditions.index("payload_kg")] = payload_kg
    return robot.model.evaluate(("p",), q, w, robot.parameters.values)[0].T


def rigid_motion(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """R, t that take the points a nearest to b (Kabsch), and the distances that remain [m]."""
    ca, cb = a.mean(0), b.mean(0)
    U, _, Vt = np.linalg.svd((a - ca).T @ (b - cb))
    R = (U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt).T
    t = cb - R @ ca
    return R, t, np.linalg.norm(a @ R.T + t - b, axis=1)
