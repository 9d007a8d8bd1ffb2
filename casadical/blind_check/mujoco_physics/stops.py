"""Circumstances of measured poses (readings, time, temperature, payload, approach)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from casadical.blind_check.mujoco_physics.plant import Array, Plant, crank_distance
from casadical.core.basics import InputError


@dataclass(frozen=True)
class Stops:
    """The circumstances of n poses at which the robot has stopped.

    q : readings, shape (n, joints) [rad or m]
    time_s : time since the start of the campaign, shape (n,) [s]
    warmth_K : temperature of the arm's surface above that at time 0, shape (n,) [K]
    payload_kg : declared mass of the payload, shape (n,) [kg]
    approach : direction of each joint's last motion before it stopped, -1 or 1, shape (n, joints)
    """

    q: Array
    time_s: Array
    warmth_K: Array
    payload_kg: Array
    approach: Array

    def __len__(self) -> int:
        return len(self.q)

    def warmth_after(self, lag_minutes: float) -> Array:
        """Return the temperature rise of a part that lags behind the surface, shape (n,) [K].

        lag_minutes : time constant of the lag [min]
        """
        steps = np.diff(self.time_s, prepend=0.0)
        share = -np.expm1(-steps / (60.0 * lag_minutes))
        part, followed = 0.0, np.empty(len(self))
        for k in range(len(self)):
            part += (self.warmth_K[k] - part) * share[k]
            followed[k] = part
        return followed

    @property
    def progress(self) -> Array:
        """Return the index of each stop divided by that of the last one, 0 to 1, shape (n,)."""
        return np.arange(len(self)) / max(len(self) - 1, 1)


@dataclass(frozen=True)
class Warmup:
    """Exponential warm-up of the arm.

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
    """Return n random readings, uniform within joint ranges, shape (n, joints) [rad or m].

    ranges : lower and upper readings, shape (joints, 2) [rad or m]
    crank_distance_m : limits of the four-bar's `crank_distance` [m]; None: none
    Raises InputError when hardly any pose in the ranges keeps the limits.
    """
    allowed = np.empty((0, plant.n))
    for _ in range(200):
        q = rng.uniform(ranges[:, 0], ranges[:, 1], (max(2 * n, 64), plant.n))
        if plant.four_bar is not None and crank_distance_m is not None:
            distance = crank_distance(plant, q)
            q = q[(distance >= crank_distance_m[0]) & (distance <= crank_distance_m[1])]
        allowed = np.vstack([allowed, q])[:n]
        if len(allowed) == n:
            return allowed
    raise InputError(
        f"only {len(allowed)} of {n} poses keep the four-bar within {crank_distance_m} m; widen it or the joint ranges"
    )


def draw_stops(
    q: Array,
    seeds: Sequence[np.random.SeedSequence],
    payload_states: Sequence[float],
    warmup: Warmup,
    approach: Literal["chance", "motion"] = "chance",
) -> Stops:
    """Return the stops at given readings, with random circumstances.

    A pose takes 20 to 40 s; payloads come in blocks.

    q : readings, shape (n, joints) [rad or m]
    seeds : seeds of the times and of the approaches
    payload_states : declared masses of the payload that alternate [kg]
    approach : "chance" for random directions of approach, "motion" for those of the joints' motions
        from pose to pose, but for the first pose
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
    """Return zeros, shape (n, joints), with `values`, shape (n,), in the column of one joint.

    joint : number of the joint, from 1; joints : number of all joints
    """
    columns = np.zeros((len(values), joints))
    columns[:, joint - 1] = values
    return columns
