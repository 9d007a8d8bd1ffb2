"""Measuring sessions of both physics without noise, and what may be hidden in them that is on no list."""

import os
import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from foreign_effects import FOREIGN, draw_foreign

from casadical.blind_check import mujoco_physics
from casadical.blind_check.mujoco_physics import Plant
from casadical.blind_check.mujoco_physics.plant import random_vector
from casadical.blind_check.mujoco_physics.stops import Stops, only
from casadical.core.basics import Array

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # for the simulator in numpy

import numpy_physics
from numpy_physics import Disturbance, disturbances, draw_disturbance

ROOT = Path(__file__).parents[2]
REPEATABILITY_URAD = 4.0


@dataclass(frozen=True)
class Belt(Disturbance):
    """The joint follows another joint's reading once that is out of a dead band of half a radian."""

    joint: int

    def misread(self, stops: Stops) -> Array:
        q = stops.q[:, self.joint - 2] - np.median(stops.q[:, self.joint - 2])
        return only(self.joint, 1e-4 * np.sign(q) * np.maximum(np.abs(q) - 0.5, 0.0))


@dataclass(frozen=True)
class RememberedFriction(Disturbance):
    """Friction that builds up along the joint's way and forgets over a third of a radian (Dahl 1968)."""

    joint: int

    def misread(self, stops: Stops) -> Array:
        state, found = 0.0, []
        for move in np.diff(stops.q[:, self.joint - 1], prepend=0.0):
            state = np.sign(move) + (state - np.sign(move)) * np.exp(-np.abs(move) / 0.35)
            found.append(-1e-4 * state)
        return only(self.joint, np.array(found))


@dataclass(frozen=True)
class LateSettling(Disturbance):
    """The joint is measured before it has come to rest: it lags by a share of its last way."""

    joint: int

    def misread(self, stops: Stops) -> Array:
        return only(self.joint, -1e-4 * np.diff(stops.q[:, self.joint - 1], prepend=0.0))


@dataclass(frozen=True)
class SlippedFoot(Disturbance):
    """The robot's foot, or the instrument's, shifts and turns at once in the middle of the campaign."""

    seed: int

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:  # noqa: ARG002
        mine = np.random.default_rng(self.seed)
        shift, turn = random_vector(mine, 1e-4), random_vector(mine, 5e-5)
        after = stops.progress > mine.uniform(0.3, 0.7)
        return xyz + after[:, None] * (np.array(shift) + np.cross(turn, xyz))


@dataclass(frozen=True)
class Scatter(Disturbance):
    """One joint repeats worse than the others, by `size` [rad]."""

    joint: int
    seed: int
    size: float = 40e-6

    def misread(self, stops: Stops) -> Array:
        return only(self.joint, self.size * np.random.default_rng(self.seed).standard_normal(len(stops)))


OWN = {"belt": Belt, "remembered_friction": RememberedFriction, "late_settling": LateSettling, "foot": SlippedFoot}
UNLISTED = [
    *(("numpy", word) for word in [*OWN, *disturbances.UNLISTED]),
    *(("mujoco", word) for word in mujoco_physics.UNLISTED),
]


@dataclass(frozen=True, eq=False)
class Session:
    """A measuring session in one of the physics without the instrument's noise."""

    physics: str
    plant: Plant
    poses: int
    seed: int

    def table(self, *acting: Any) -> pd.DataFrame:
        make: Any = mujoco_physics.campaign if self.physics == "mujoco" else numpy_physics.campaign
        hidden = {"disturbances": acting} if self.physics == "numpy" else {"hidden": acting}
        return make(
            self.plant, n=self.poses, seed=self.seed, noise_mm=0.0, repeatability_urad=REPEATABILITY_URAD,
            approach="motion", **hidden,
        )  # fmt: skip

    def drawn(self, word: str, rng: np.random.Generator) -> tuple[str, Any]:
        """An effect by its word, and its label."""
        if self.physics == "mujoco":
            found = mujoco_physics.draw_effect(self.plant, word, rng, poses=self.poses)
            joint = found.joint
        else:
            kind = (OWN | FOREIGN | disturbances.LISTED | disturbances.UNLISTED)[word]
            names = {f.name for f in fields(kind)}
            joint = int(rng.integers(2, 7)) if "joint" in names else None
            seed = int(rng.integers(1 << 30))
            if word in FOREIGN:
                found = draw_foreign(word, seed, self.plant)
            elif word in OWN:
                found = kind(**{k: v for k, v in (("joint", joint), ("seed", seed)) if k in names})
            else:
                found = draw_disturbance(word, seed, joint=joint)
        joint = 2 if word == "gravity_compensator" else joint
        return word if joint is None else f"{word}@{joint}", found
