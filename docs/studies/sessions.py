"""Measuring sessions in the engine without noise, and what may be hidden in them that is on no list."""

import os
from dataclasses import dataclass, fields
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from acting import Disturbance, acting
from foreign_effects import FOREIGN, draw_foreign

from casadical.blind_check import mujoco_physics
from casadical.blind_check.mujoco_physics import Plant
from casadical.blind_check.mujoco_physics.plant import random_vector
from casadical.blind_check.mujoco_physics.stops import Stops, in_column
from casadical.core.basics import Array

REPEATABILITY_URAD = 4.0


@dataclass(frozen=True)
class Belt(Disturbance):
    """The joint follows another joint's reading once that is out of a dead band of half a radian."""

    joint: int

    def misread(self, stops: Stops) -> Array:
        q = stops.q[:, self.joint - 2] - np.median(stops.q[:, self.joint - 2])
        return in_column(self.joint, 1e-4 * np.sign(q) * np.maximum(np.abs(q) - 0.5, 0.0))


@dataclass(frozen=True)
class RememberedFriction(Disturbance):
    """Friction that builds up along the joint's way and forgets over a third of a radian (Dahl 1968)."""

    joint: int

    def misread(self, stops: Stops) -> Array:
        state, found = 0.0, []
        for move in np.diff(stops.q[:, self.joint - 1], prepend=0.0):
            state = np.sign(move) + (state - np.sign(move)) * np.exp(-np.abs(move) / 0.35)
            found.append(-1e-4 * state)
        return in_column(self.joint, np.array(found))


@dataclass(frozen=True)
class LateSettling(Disturbance):
    """The joint is measured before it has come to rest: it lags by a share of its last way."""

    joint: int

    def misread(self, stops: Stops) -> Array:
        return in_column(self.joint, -1e-4 * np.diff(stops.q[:, self.joint - 1], prepend=0.0))


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
        return in_column(self.joint, self.size * np.random.default_rng(self.seed).standard_normal(len(stops)))


OWN = {"belt": Belt, "remembered_friction": RememberedFriction, "late_settling": LateSettling, "foot": SlippedFoot}
UNLISTED = [*OWN, *mujoco_physics.UNLISTED]


@dataclass(frozen=True, eq=False)
class Session:
    """A measuring session in the engine without the instrument's noise."""

    plant: Plant
    poses: int
    seed: int

    def table(self, *hidden: Any) -> pd.DataFrame:
        return mujoco_physics.campaign(
            self.plant, hidden, self.poses, self.seed, noise_mm=0.0, repeatability_urad=REPEATABILITY_URAD,
            approach="motion",
        )  # fmt: skip

    def drawn(self, word: str, rng: np.random.Generator) -> tuple[str, Any]:
        """An effect by its word, and its label."""
        if word in FOREIGN:
            effect = draw_foreign(word, int(rng.integers(1 << 30)), self.plant)
            found, joint = acting(effect, self.plant), getattr(effect, "joint", None)
        elif word in OWN:
            given = {"joint": int(rng.integers(2, 7)), "seed": int(rng.integers(1 << 30))}
            effect = OWN[word](**{f.name: given[f.name] for f in fields(OWN[word])})
            found, joint = acting(effect, self.plant), getattr(effect, "joint", None)
        else:
            found = mujoco_physics.draw_effect(self.plant, word, rng, poses=self.poses)
            joint = 2 if word == "gravity_compensator" else found.joint
        return word if joint is None else f"{word}@{joint}", found
