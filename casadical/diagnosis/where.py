"""Where the gap lies: as errors of which joint, in which direction, under which payload, in which part of the data."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..transforms import Array
from .case import Case


def where(case: Case) -> dict[str, Any]:
    """Shares of the residual.

    joints : share of the residual's squares that an error of one joint alone, pose by pose, would reproduce, above
        what a random direction gives; they overlap and do not sum to one
    directions : radial, tangential and vertical in the base frame, summing to one
    payload, warmth, time : mean residual [mm] in the halves of the data, where the column was logged
    """
    e = case.evidence
    return {
        "joints": _joints(e.r, e.Jq),
        "directions": _directions(case),
        **{name: halves for name, halves in _halves(case).items() if halves},
    }


def _joints(r: Array, Jq: Array) -> dict[str, float]:
    found = {}
    total = float((r**2).sum())
    for j in range(Jq.shape[2]):
        lever = np.linalg.norm(Jq[:, :, j], axis=1)
        use = lever > 0.05 * max(float(lever.max()), 1e-9)
        along = (r[use] * Jq[use, :, j]).sum(axis=1) / lever[use]
        # A third of an isotropic residual lies along any direction.
        excess = float((along**2).sum() - (r[use] ** 2).sum() / 3)
        found[f"joint {j + 1}"] = max(0.0, round(1.5 * excess / total, 4))
    return found


def _directions(case: Case) -> dict[str, float]:
    assert case.m.position is not None
    T = case.robot.base.T
    p = (case.m.position[case.kept] - T[:3, 3]) @ T[:3, :3]
    r = case.evidence.r @ T[:3, :3]
    out = p[:, :2] / np.maximum(np.linalg.norm(p[:, :2], axis=1, keepdims=True), 1e-9)
    radial = (r[:, :2] * out).sum(axis=1)
    tangential = r[:, 1] * out[:, 0] - r[:, 0] * out[:, 1]
    squares = np.array([(radial**2).sum(), (tangential**2).sum(), (r[:, 2] ** 2).sum()])
    shares = squares / squares.sum()
    return {n: round(float(s), 4) for n, s in zip(("radial", "tangential", "vertical"), shares, strict=True)}


def _halves(case: Case) -> dict[str, dict[str, float]]:
    size = 1e3 * np.linalg.norm(case.evidence.r, axis=1)
    found = {}
    for name, column in (("payload", "payload_kg"), ("warmth", "temperature_degC"), ("time", "time_s")):
        logged = case.m.conditions.get(column)
        if logged is None or np.ptp(logged[case.kept]) == 0:
            continue
        values = logged[case.kept]
        high = values > np.median(values) if name != "payload" else values > 0.5 * values.max()
        if 0 < high.sum() < len(high):
            found[name] = {"low": round(float(size[~high].mean()), 5), "high": round(float(size[high].mean()), 5)}
    return found
