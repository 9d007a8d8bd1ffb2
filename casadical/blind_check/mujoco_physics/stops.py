"""Circumstances of measured poses (readings, time, temperature, payload, approach)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from casadical.blind_check.mujoco_physics.fourbar import crank_distance
from casadical.blind_check.mujoco_physics.plant import Array, Plant
from casadical.core.basics import InputError


@dataclass(frozen=True)
class Stops:
    """The circumstances of n poses at which the robot has stopped.

    q : readings, shape (n, joints) [rad or m]
    time_s : since the start, shape (n,) [s]
    warmth_K : temperature of the arm's surface above that at time 0, shape (n,) [K]
    payload_kg : declared, shape (n,) [kg]
    approach : -1 or 1, each joint's last motion before it stopped, shape (n, joints)
    """

    q: Array
    time_s: Array
    warmth_K: Array
    payload_kg: Array
    approach: Array

    def __len__(self) -> int:
        return len(self.q)

    def warmth_after(self, lag_minutes: float) -> Array:
        """Return the temperature rise of a part that lags behind the surface, shape (n,) [K]."""
        steps = np.diff(self.time_s, prepend=0.0)
        share = -np.expm1(-steps / (60.0 * lag_minutes))
        part, followed = 0.0, np.empty(len(self))
        for k in range(len(self)):
            part += (self.warmth_K[k] - part) * share[k]
            followed[k] = part
        return followed

    @property
    def progress(self) -> Array:
        """The share of the campaign that is over, shape (n,), from 0 to 1."""
        return np.arange(len(self)) / max(len(self) - 1, 1)


@dataclass(frozen=True)
class Warmup:
    """Warm-up of the arm.

    start_degC : temperature at the start [degC]
    rise_K : temperature rise in the end [K]
    minutes : time constant [min]
    sensor_K : standard deviation of the temperature sensor [K]
    """

    start_degC: float = 20.0
    rise_K: float = 7.0
    minutes: float = 35.0
    sensor_K: float = 0.05

    def course(self, time_s: Array) -> Array:
        """Return the temperature rise, shape (n,) [K], at times (n,) [s] since the start."""
        return np.asarray(-self.rise_K * np.expm1(-np.asarray(time_s, float) / (60.0 * self.minutes)))


def draw_poses(
    plant: Plant, n: int, rng: np.random.Generator, ranges: Array, crank_distance_m: tuple[float, float] | None
) -> Array:
    """Return random readings, shape (n, joints) [rad or m], uniform in ``ranges`` (joints, 2).

    crank_distance_m : limits within which the four-bar stays [m]
    Raises InputError when hardly any pose in the ranges keeps the limits.
    """
    kept = np.empty((0, plant.n))
    for _ in range(200):
        q = rng.uniform(ranges[:, 0], ranges[:, 1], (max(2 * n, 64), plant.n))
        if plant.four_bar is not None and crank_distance_m is not None:
            distance = crank_distance(plant, q)
            q = q[(distance >= crank_distance_m[0]) & (distance <= crank_distance_m[1])]
        kept = np.vstack([kept, q])[:n]
        if len(kept) == n:
            return kept
    raise InputError(
        f"only {len(kept)} of {n} poses keep the four-bar within {crank_distance_m} m; widen it or the joint ranges"
    )


def draw_stops(
    q: Array,
    seeds: Sequence[np.random.SeedSequence],
    payload_states: Sequence[float],
    warmup: Warmup,
    approach: Literal["chance", "motion"] = "chance",
) -> Stops:
    """Return random circumstances of the readings ``q`` (n, joints) [rad or m].

    A pose takes 20 to 40 s; payloads come in blocks; approaches are random, or follow from the
    order of poses.
    """
    n = len(q)
    time = np.cumsum(np.round(np.random.default_rng(seeds[0]).uniform(20.0, 40.0, n), 1))
    came = np.random.default_rng(seeds[1]).choice([-1.0, 1.0], q.shape)
    if approach == "motion":
        came[1:] = np.where(np.diff(q, axis=0) < 0, -1.0, 1.0)
    blocks = 1 if len(payload_states) == 1 else 2 * len(payload_states)
    turn = (np.arange(n) * blocks // n) % len(payload_states)
    return Stops(q, time, warmup.course(time), np.asarray(payload_states, float)[turn], came)


def in_column(joint: int, values: Array, joints: int = 6) -> Array:
    """Return zeros, shape (n, joints), with ``values`` (n,) in the column of a joint.

    joint : 1-based
    """
    columns = np.zeros((len(values), joints))
    columns[:, joint - 1] = values
    return columns
