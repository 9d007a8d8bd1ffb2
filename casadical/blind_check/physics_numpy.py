"""The project's own simulator as a reality: rigid motions in numpy, physics unlike the candidates' equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import pandas as pd

from casadical.blind_check.drawing import Plan
from casadical.blind_check.numpy_physics import Disturbance, Plant, campaign, draw_disturbance, perturb
from casadical.blind_check.numpy_physics.disturbances import LISTED, UNLISTED
from casadical.blind_check.physics import Act, Record

SCALES = (0.7, 1.0, 1.5, 2.5)


def words() -> tuple[tuple[str, ...], tuple[str, ...]]:
    return tuple(LISTED), tuple(UNLISTED)


def versions() -> dict[str, str]:
    return {"numpy": np.__version__}


def record(table: Mapping[str, Any], plan: Plan, poses: int) -> Record:
    rng = np.random.default_rng(plan.seed)
    plant = perturb(Plant.from_dict(table), int(rng.integers(1 << 30)))
    hidden = [_drawn(word, rng) for word in plan.effects]
    seed = int(rng.integers(1 << 30))

    def session(disturbances: Sequence[Disturbance]) -> pd.DataFrame:
        return campaign(
            plant,
            poses,
            seed,
            noise_mm=1e3 * plan.noise,
            repeatability_urad=1e6 * plan.repeatability,
            disturbances=disturbances,
            # Nobody notes a payload that never changes.
            payload_states=[plant.payload_kg] if plan.missing == "payload" else None,
            approach="motion",
            truth=True,
        )

    return Record(
        hidden=tuple(Act(w, getattr(d, "joint", None), _about(d)) for w, d in zip(plan.effects, hidden, strict=True)),
        session=session(hidden),
        clean=session([]),
        alone=tuple(session([d]) for d in hidden) if len(hidden) > 1 else (),
    )


def _drawn(effect: str, rng: np.random.Generator) -> Disturbance:
    """An effect by chance, at any joint that can have it."""
    names = {f.name for f in fields((LISTED | UNLISTED)[effect])}
    joint = int(rng.integers(2 if "source" in names else 1, 7)) if "joint" in names else None
    return draw_disturbance(effect, int(rng.integers(1 << 30)), joint=joint, scale=float(rng.choice(SCALES)))


def _about(d: Disturbance) -> str:
    numbers = {f.name: np.round(getattr(d, f.name), 9).tolist() for f in fields(d) if f.name != "joint"}
    return f"{type(d).__name__}: " + ", ".join(f"{name} {value}" for name, value in numbers.items())
