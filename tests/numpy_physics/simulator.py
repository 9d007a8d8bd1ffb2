"""The simulator in numpy in place of the engine, for campaigns of the blind check."""

from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from casadical.blind_check.mujoco_physics import Plant
from casadical.blind_check.mujoco_physics.hidden import sizes_in_words
from casadical.blind_check.recording import Simulator
from numpy_physics import disturbances
from numpy_physics.campaigns import campaign
from numpy_physics.disturbance import Disturbance
from numpy_physics.draw import draw_disturbance

SCALES = (0.7, 1.0, 1.5, 2.5)
WORDS = (tuple(disturbances.LISTED), tuple(disturbances.UNLISTED))


class Acting(NamedTuple):
    """An effect as the simulator draws it."""

    effect: str
    joint: int | None
    about: str
    itself: Disturbance


def _drawn(_plant: Plant, effect: str, rng: np.random.Generator, _poses: int) -> Acting:
    names = {f.name for f in fields((disturbances.LISTED | disturbances.UNLISTED)[effect])}
    joint = int(rng.integers(2 if "source" in names else 1, 7)) if "joint" in names else None
    found = draw_disturbance(effect, int(rng.integers(1 << 30)), joint=joint, scale=float(rng.choice(SCALES)))
    sizes = {f.name: getattr(found, f.name) for f in fields(found) if f.name != "joint"}
    return Acting(effect, joint, f"{type(found).__name__}: {sizes_in_words(sizes)}", found)


def _campaign(plant: Plant, acting: list[Any], n: int, seed: int, **options: Any) -> pd.DataFrame:
    return campaign(plant, n, seed, disturbances=[a.itself for a in acting], **options)


NUMPY = Simulator(_drawn, _campaign)
