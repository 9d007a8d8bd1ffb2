"""MuJoCo as a reality: robots as built in a physics engine that is not ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
import pandas as pd

from casadical.blind_check.drawing import Plan
from casadical.blind_check.mujoco_physics import LISTED, UNLISTED, Hidden, campaign, draw_effect
from casadical.blind_check.numpy_physics import Plant, perturb
from casadical.blind_check.physics import Act, Record
from casadical.core.errors import InputError


def words() -> tuple[tuple[str, ...], tuple[str, ...]]:
    return tuple(LISTED), tuple(UNLISTED)


def versions() -> dict[str, str]:
    try:
        return {"mujoco": version("mujoco"), "numpy": np.__version__}
    except PackageNotFoundError:
        raise InputError(
            "the engine mujoco is not installed: pip install 'casadical[withheld]', or take --reality numpy"
        ) from None


def record(table: Mapping[str, Any], plan: Plan, poses: int) -> Record:
    rng = np.random.default_rng(plan.seed)
    plant = perturb(Plant.from_dict(table), int(rng.integers(1 << 30)))
    hidden = [draw_effect(plant, word, rng, poses=poses) for word in plan.effects]
    seed = int(rng.integers(1 << 30))

    def session(acting: Sequence[Hidden]) -> pd.DataFrame:
        return campaign(
            plant,
            acting,
            poses,
            seed,
            noise_mm=1e3 * plan.noise,
            repeatability_urad=1e6 * plan.repeatability,
            # Nobody notes a payload that never changes.
            payload_states=[plant.payload_kg] if plan.missing == "payload" else None,
            approach="motion",
            truth=True,
        )

    return Record(
        hidden=tuple(Act(h.effect, h.joint, _about(h)) for h in hidden),
        session=session(hidden),
        clean=session([]),
        alone=tuple(session([h]) for h in hidden) if len(hidden) > 1 else (),
    )


def _about(hidden: Hidden) -> str:
    numbers = {name: np.round(value, 9).tolist() for name, value in hidden.size.items()}
    return ", ".join(f"{name} {value}" for name, value in numbers.items())
