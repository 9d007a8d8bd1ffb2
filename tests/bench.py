"""Shipped robots and campaigns, and effects with their columns."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from casadical.diagnosis.candidates import candidates_of
from casadical.effects import Effect
from casadical.effects.formula_effect import CAMERA_SIDES, image_columns
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import read_measurements
from casadical.project.problem import read_campaign_robot
from casadical.robot.robot import Robot

ROOT = Path(__file__).parents[1]
FIRST = {"hh800": "hh800-P01", "kr210": "kr210-P02", "ur10e": "ur10e-P03"}


@cache
def robot(name: str) -> Robot:
    return read_campaign_robot(ROOT / "problems" / name)


@cache
def campaign(name: str) -> Measurements:
    return read_measurements(ROOT / "data" / "campaigns" / "practice" / f"{FIRST[name]}.csv", 6)


def batches(name: str, listed: bool = True) -> list[list[Effect]]:
    """Every effect of the extended list, in batches without two of the same label: first, middle and last setting."""
    found: list[list[Effect]] = [[], [], []]
    by_label: dict[str, dict[Effect, None]] = {}
    for c in candidates_of(robot(name), "extended"):
        if c.listed is listed:
            for effect in (e for v in c.variants for e in v):
                by_label.setdefault(effect.label, {})[effect] = None
    for effects in map(list, by_label.values()):
        for k, e in enumerate(dict.fromkeys((effects[0], effects[len(effects) // 2], effects[-1]))):
            found[k].append(e)
    return [b for b in found if b]


def moved_by(name: str, effects: list[Effect], values: np.ndarray, poses: Measurements) -> np.ndarray:
    """Positions of the robot with the effects in its model, shape (variations, n, 3); values : (variations, P)."""
    whole = robot(name).with_effect(*effects)
    w = poses.condition_matrix(whole.conditions, whole.declared)
    n, K = len(poses), len(values)
    f = whole.model.function("position", ("p",)).map(n * K)
    p = f(np.tile(poses.q, (K, 1)).T, np.tile(w, (K, 1)).T, np.repeat(values, n, axis=0).T)
    return p.full().T.reshape(K, n, 3)


def with_columns(m: Measurements, effects: Sequence[Effect]) -> Measurements:
    # Of an instrument that reads distances, the first of some.
    far = {f"far_{c}_m": np.full(len(m), v) for c, v in zip("xyz", (2.0, -1.0, 0.5), strict=True)}
    wires = {f"wire{k}": np.full(len(m), float(k == 1)) for k in range(1, 5)}
    names = [c for side in CAMERA_SIDES for what in ("depth", "radial") for c in image_columns(side, what)]
    images = dict(zip(names, np.random.default_rng(0).normal(size=(len(names), len(m))), strict=True))
    m = replace(m, conditions={**m.conditions, **far, **wires, **images})
    found, missing = derive(m, [c for e in effects for c in e.conditions], lambda q, _: np.sin(q))  # loads of no robot
    assert missing == ()
    return found
