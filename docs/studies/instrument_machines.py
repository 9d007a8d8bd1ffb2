"""A robot as built in the engine, its nominal model, and what an instrument could see of a difference."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.linalg import orth

from casadical.blind_check import mujoco_physics
from casadical.blind_check.mujoco_physics import Plant
from casadical.blind_check.mujoco_physics.table import MEASURED_COLUMNS
from casadical.core.basics import Array
from casadical.diagnosis.linearisation import signatures
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table
from casadical.robot.robot import Robot

# Points of the flange that tell its orientation [m].
POINTS = np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0], [0.0, 0.15, 0.0]])


@dataclass(frozen=True, eq=False)
class Machine:
    """A robot as built in the engine, at any readings; a hidden effect acts by a factor on what it shifts."""

    plant: Plant
    seed: int
    hidden: Any = None
    factor: float = 0.0

    def table(self, q: Array | None, n: int, hidden: Any, point: Array, repeatability: float) -> pd.DataFrame:
        readings = None if q is None else np.rad2deg(q)
        plant = replace(self.plant, reflector=self.plant.reflector + point)
        acting = () if hidden is None else (hidden,)
        return mujoco_physics.campaign(
            plant, acting, n, self.seed, noise_mm=0.0, repeatability_urad=repeatability, q_deg=readings
        )

    def positions(self, q: Array, point: Array = POINTS[0], repeatability: float = 0.0) -> tuple[Array, Array]:
        """Where a point of the flange is [m], and by how much a hidden effect alone shifts it, shapes (n, 3)."""
        still = self.table(q, len(q), None, point, repeatability)[MEASURED_COLUMNS].to_numpy(float) * 1e-3
        if self.hidden is None:
            return still, np.zeros_like(still)
        moved = self.table(q, len(q), self.hidden, point, repeatability)[MEASURED_COLUMNS].to_numpy(float) * 1e-3
        return still, moved - still

    def at(self, q: Array) -> Array:
        """Where the first point is with the hidden effect, shape (n, 3) [m]."""
        still, shift = self.positions(q)
        return still + self.factor * shift


@dataclass(frozen=True, eq=False)
class Model:
    """The nominal robot at poses: position, its derivatives by parameters and joints."""

    p: Array
    J: Array
    Jq: Array

    @staticmethod
    def of(robot: Robot, m: Measurements) -> Model:
        _, J, Jq = signatures(robot, (), m, robot.parameters.values)
        return Model(predicted(robot, m)[0], J, Jq)


def blank(robot: Robot, table: pd.DataFrame) -> Measurements:
    return from_table(table, [j.kind for j in robot.joints], "position")


def visible(rows: Array, base: Array, joints: Array, sigma: Array, repeatability: float) -> float:
    """Noncentrality of a signature; rows : shape (n, k), base : (n, k, P), joints : (n, k, joints), sigma : (k,)."""
    C = np.eye(rows.shape[1]) * sigma**2 + repeatability**2 * joints @ joints.transpose(0, 2, 1)
    W = np.linalg.inv(np.linalg.cholesky(C))
    white, A = (W @ rows[:, :, None]).ravel(), (W @ base).reshape(rows.size, -1)
    moving = A[:, np.linalg.norm(A, axis=0) > 0]
    Q = orth(moving / np.linalg.norm(moving, axis=0), rcond=1e-9)
    return float(np.sum((white - Q @ (Q.T @ white)) ** 2))


def scaled(noncentrality: float, numbers: int, signal: float) -> float:
    """By what a signature is multiplied for a signal; what the base model absorbs altogether stays small."""
    return float(min(signal / max(np.sqrt(noncentrality / numbers), 1e-12), 8.0))
