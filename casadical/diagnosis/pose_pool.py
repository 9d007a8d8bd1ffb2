"""What could be measured next: poses within given limits under every payload, approach and thermal state."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.linear_problem import Case
from casadical.effects import Effect
from casadical.measurements.measurements import Measurements, unmeasured
from casadical.pose_selection.workspace import Workspace

# An arm is warmed up by at least so much [K] where a cause follows the temperature.
RISE_K = 5.0
# Readings beyond the campaign's own range by less than this [rad or m] are no news.
_BEYOND = 0.02


@dataclass(frozen=True, eq=False)
class Pool:
    """Poses to choose from.

    m : readings, and every column that the causes need
    repeated : row of the campaign that a pose repeats, -1 for none, shape (K,)
    warm : whether the arm is to be warm, shape (K,); None where no cause follows the temperature
    """

    m: Measurements
    repeated: Array
    warm: Array | None


def draw_pool(
    case: Case,
    effects: Sequence[Effect],
    size: int,
    seed: int,
    workspace: Workspace | None = None,
    payloads: Sequence[float] = (),
) -> Pool:
    """Random poses, half of them within the campaign's ranges, and the campaign's own, under every circumstance.

    workspace : where poses may lie, by default the robot's ranges; loops stay as open as they were
    payloads : states [kg] that can be mounted; by default none, the declared one and the campaign's
    """
    rng = np.random.default_rng(seed)
    room = workspace or Workspace()
    own = case.m.q[case.kept]
    narrow = own.min(axis=0), own.max(axis=0)
    lower, upper = room.ranges(case.robot)
    near = _within(case, room, np.maximum(narrow[0], lower), np.minimum(narrow[1], upper), size // 2, rng)
    wide = _within(case, room, lower, upper, size - len(near), rng)
    q = np.concatenate([near, wide, own])
    repeated = np.concatenate([np.full(len(near) + len(wide), -1), np.flatnonzero(case.kept)])
    names = dict.fromkeys((*case.robot.conditions, *(c for e in effects for c in e.conditions)))
    states = np.array(sorted(payloads)) if payloads else campaign_payloads(case, with_usual=True)
    warm = rng.random(len(q)) < 0.5
    columns = {name: _circumstance(case, name, len(q), warm, states, rng) for name in names}
    timed = any(name.startswith("warmth_") for name in columns)
    return Pool(unmeasured(q, columns), repeated, warm if timed else None)


def campaign_payloads(case: Case, *, with_usual: bool = False) -> Array:
    """Payloads [kg] of the campaign; with_usual : and none, and the declared one."""
    payload = case.robot.payload
    declared = payload.mass if payload else 0.0
    states = case.m.conditions.get("payload_kg", np.array([declared]))
    return np.unique(np.concatenate([states, [0.0, declared]]) if with_usual else states)


def _within(case: Case, room: Workspace, lower: Array, upper: Array, count: int, rng: np.random.Generator) -> Array:
    """Up to count readings that the workspace allows, with loops as open as in the campaign."""
    if (upper <= lower).any():
        return np.empty((0, len(lower)))
    q = rng.uniform(lower, upper, (4 * count, len(lower)))
    q = q[room.allows(case.robot, q)]
    if case.robot.loops and len(q):
        margin = case.robot.model.at_declared("loop", ("margin",))
        values = case.robot.parameters.values
        least = margin.map(len(case.m))(case.m.q.T, values).full().min(axis=1)
        q = q[(margin.map(len(q))(q.T, values).full() >= least[:, None]).all(axis=0)]
    return np.asarray(q[:count])


def _circumstance(case: Case, name: str, count: int, warm: Array, states: Array, rng: np.random.Generator) -> Array:
    """A condition at the new poses: what can be chosen is drawn, what cannot is that of a later day."""
    if name == "progress":
        return np.ones(count)
    if name.startswith("approach"):
        return rng.choice([-1.0, 1.0], count)
    if name == "payload_kg":
        return rng.choice(states, count)
    logged = case.m.conditions.get(name)
    if logged is None:
        return np.zeros(count)
    if name.startswith("warmth_"):
        return np.asarray(np.where(warm, max(logged.max(), logged.min() + RISE_K), logged.min()))
    return rng.choice(np.unique(logged), count)


def news(case: Case, pool: Pool, picked: Sequence[int]) -> list[str]:
    """For each pose, what of it the campaign had not: a wider range, another payload, approach or thermal state."""
    own = case.m.conditions
    lower, upper = case.m.q.min(axis=0) - _BEYOND, case.m.q.max(axis=0) + _BEYOND
    payloads = campaign_payloads(case)
    found = []
    for k in picked:
        said = [f"q{j + 1}" for j in np.flatnonzero((pool.m.q[k] < lower) | (pool.m.q[k] > upper))]
        parts = [f"range of {' '.join(said)}"] if said else []
        for name, column in pool.m.conditions.items():
            value = float(column[k])
            if name == "payload_kg" and np.abs(payloads - value).min() > 1e-9:
                parts.append(f"payload {value:g} kg")
            if name.startswith("approach") and name in own and value not in own[name]:
                parts.append(f"{name} {value:+.0f}")
            if name.startswith("warmth_") and value > own[name].max() + 0.5:
                parts.append(f"arm warmed up by {value - own[name].min():.0f} K")
        found.append("; ".join(dict.fromkeys(parts)))
    return found
