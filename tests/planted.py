"""What tests hide in the engine's campaigns: effects of its list with usual sizes, and errors of one joint."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
import pytest

from casadical.blind_check import mujoco_physics
from casadical.blind_check.mujoco_physics import Hidden, Plant
from casadical.blind_check.mujoco_physics.cause import Cause, Kind
from casadical.blind_check.mujoco_physics.stops import Stops

# What a test need not say of an effect.
USUAL: dict[str, dict[str, Any]] = {
    "gear_eccentricity": {"size": 40e-6, "towards": 0.6, "oval": 30e-6, "oval_towards": 1.1},
    "transmission_ripple": {"cycles": 4, "phase": 0.3},
    "frame_drift": {
        "shift_m": (115e-6, -123e-6, 93e-6), "turn_rad": (30e-6, 38e-6, 42e-6), "settling_minutes": 15.0,
    },
    "joint_zero_step": {"at_s": 1500.0},  # half of a campaign of 100 poses
    "thermal_growth": {"lag_minutes": 6.0},
    "friction_windup": {"load_share": 0.8},
    "backlash": {"friction": 0.02},
}  # fmt: skip


def planted(effect: str, joint: int | None = None, **sizes: Any) -> Hidden:
    """Return an effect of the engine's list; sizes that are not given are usual ones."""
    return Hidden(effect, joint, USUAL.get(effect, {}) | sizes)


def misread(joint: int, error: Callable[[Stops], np.ndarray]) -> Cause:
    """Return a joint that stops off its reading by ``error``, shape (n,) [rad], a function of the stops."""

    def of_reading(_plant: Plant, stops: Stops, *, joint: int) -> np.ndarray:
        return error(stops)

    return Cause(Kind("motors", of_reading), {"joint": joint})


def campaign(plant: Plant, n: int, seed: int, hidden: Sequence[Hidden | Cause] = (), **options: Any) -> pd.DataFrame:
    """Return the table of ``n`` poses of a robot as built; its joints repeat to 8 urad."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra mujoco)")
    return mujoco_physics.campaign(plant, hidden, n, seed, **({"repeatability_urad": 8.0} | options))
