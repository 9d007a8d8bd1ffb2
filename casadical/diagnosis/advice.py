"""The value of further poses: the probability to distinguish the causes, and what kind of poses they are."""

from __future__ import annotations

from math import erf, log, sqrt

import numpy as np
import pandas as pd

from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.result import Diagnosis
from casadical.measurements.measurements import unmeasured

# Torque of this share of a great one counts as none.
IDLE = 0.15


def told_apart(d: Diagnosis, poses: pd.DataFrame) -> tuple[float, float]:
    """Probability that the more probable of the two most similar causes is true: now, and after these poses.

    After them the log odds are normal about their expected gain D with variance 2 D, whichever cause is true.
    """
    first, second = d.in_question[:2]
    ranking = max(d.rankings, key=lambda r: r.probability.get(first, 0) + r.probability.get(second, 0))
    a, b = (max(ranking.probability.get(k, 0.0), 1e-12) for k in (first, second))
    return after_gain(a / (a + b), 0.0), after_gain(a / (a + b), float(poses["separation"].iloc[-1]))


def after_gain(share: float, gain: float) -> float:
    """Probability of a right choice between two causes, of which one has this share, after an expected log factor."""
    if gain <= 0:
        return max(share, 1 - share)
    odds, width = log(share / (1 - share)), sqrt(2 * gain)
    return share * _normal((gain + odds) / width) + (1 - share) * _normal((gain - odds) / width)


def _normal(x: float) -> float:
    return 0.5 * (1 + erf(x / sqrt(2)))


def kinds(case: Case, poses: pd.DataFrame) -> str:
    """What kind of poses they are, in words."""
    found = []
    if repeats := int((poses["repeats"] != "").sum()):
        found.append(f"{repeats} repeat earlier ones in other circumstances")
    masses, counts = np.unique(poses.get("payload_kg", []), return_counts=True)
    if len(masses) > 1:
        found.append(", ".join(f"{n} with {mass:g} kg" for mass, n in zip(masses, counts, strict=True)))
    for name in (c for c in map(str, poses) if c.startswith("approach")):
        rising = int((poses[name] > 0).sum())
        found.append(f"joint {name[8:]} approached rising in {rising}, falling in {len(poses) - rising}")
    if "state" in poses:
        found.append(f"{int((poses['state'] == 'warm').sum())} warm, {int((poses['state'] == 'cold').sum())} cold")
    if wider := int(poses["new"].str.contains("range of").sum()):
        found.append(f"{wider} beyond the ranges so far")
    return "; ".join([*found, *_idle(case, poses)])


def _idle(case: Case, poses: pd.DataFrame) -> list[str]:
    """Joints whose gravity torque is near zero in more of the poses than of the campaign's."""
    robot = case.given
    units = [("deg", np.pi / 180) if j.kind == "revolute" else ("mm", 1e-3) for j in robot.joints]
    q = np.stack([poses[f"q{k}_{u}"].to_numpy() * f for k, (u, f) in enumerate(units, 1)], axis=1)
    conditions = {"payload_kg": poses["payload_kg"].to_numpy()} if "payload_kg" in poses else {}
    new = unmeasured(q, conditions)
    idle = []
    for m in (new, case.m):
        w = m.condition_matrix(robot.conditions, robot.declared)
        tau = robot.model.function("torque", ("tau",)).map(len(m))(m.q.T, w.T, case.values).full()
        idle.append((np.abs(tau) < IDLE * robot.torque_scale[:, None]).mean(axis=1))
    more = np.flatnonzero(idle[0] > np.minimum(2 * idle[1], idle[1] + 0.3))
    return [f"{round(idle[0][j] * len(q))} with joint {j + 1} near zero torque" for j in more[:2]]
