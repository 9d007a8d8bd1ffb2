"""Effects beside their counterparts in the engine of the blind check: one robot in both worlds, and a pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from acting import Disturbance, acting
from campaign_robots import machine

from casadical import Placement, Robot
from casadical.blind_check.mujoco_physics import Hidden, Plant
from casadical.blind_check.mujoco_physics.campaigns import positions
from casadical.blind_check.mujoco_physics.cause import rated_torque
from casadical.blind_check.mujoco_physics.hidden import causes
from casadical.blind_check.mujoco_physics.plant import unfolded
from casadical.blind_check.mujoco_physics.stops import Stops, Warmup, draw_poses, draw_stops
from casadical.core.basics import Array
from casadical.core.transforms import frame
from casadical.effects import (
    Effect,
)
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import unmeasured

ROBOTS = ("hh800", "kr210", "ur10e")
Values = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Bench:
    """One robot in both worlds, and poses. plant : its drawing; robot : its model of the same numbers."""

    name: str
    plant: Plant
    robot: Robot
    stops: Stops

    @cached_property
    def rated(self) -> Array:
        """Rated torque of each joint as the engine's effects mean it, shape (6,) [N m]."""
        return rated_torque(self.plant)

    @cached_property
    def great(self) -> Array:
        """Great torque of each joint as the effects mean it, shape (6,) [N m]."""
        return self.robot.torque_scale

    @cached_property
    def clean(self) -> Array:
        """Where the engine has the reflector without any effect, shape (n, 3) [m]."""
        return positions(self.plant, (), self.stops)

    def along(self, link: int) -> Array:
        """Share of a link's own three axes along it (1) and across it (0), shape (3,)."""
        T = self.plant.home[link - 1]
        way = T[:3, :3].T @ (self.plant.stations[link + 1] - self.plant.stations[link])
        return np.asarray((np.abs(way) > 0.99 * np.linalg.norm(way)).astype(float))

    def length(self, link: int) -> float:
        return float(np.linalg.norm(self.plant.stations[link + 1] - self.plant.stations[link]))

    def changed(self, plant: Mapping[str, Any], robot: Robot) -> Bench:
        return replace(self, plant=replace(self.plant, **plant), robot=robot)


@dataclass(frozen=True, eq=False)
class Pair:
    """An effect and its counterpart with the same parameters.

    effects, values : in the model; columns : what was logged besides the payload
    hidden : counterparts in the engine; other : fields of the drawing that are otherwise in the engine
    bench : with which they are compared
    """

    bench: Bench
    effects: Sequence[Effect]
    values: Values
    columns: Mapping[str, Array] = field(default_factory=dict)
    hidden: Sequence[Hidden | Disturbance] = ()
    other: Mapping[str, Any] = field(default_factory=dict)

    def moved(self) -> Array:
        """How far the effects move the tool of the model, shape (n, 3) [m]."""
        b = self.bench
        with_them = b.robot.with_effect(*self.effects).with_values(self.values)
        m = unmeasured(b.stops.q, {"payload_kg": b.stops.payload_kg, **self.columns})
        return np.asarray(predicted(with_them, m)[0] - predicted(b.robot, m)[0])

    @cached_property
    def there(self) -> Array:
        """How far the counterpart moves it in the engine, shape (n, 3) [m]."""
        b = self.bench
        hidden = [h if isinstance(h, Hidden) else acting(h, b.plant) for h in self.hidden]
        seen = positions(replace(b.plant, **self.other), hidden, b.stops)
        for cause in causes(hidden, b.plant.n):
            seen = cause.measured(seen, b.stops, np.random.default_rng(0))
        return np.asarray(seen - b.clean)

    def apart(self, there: Array | None = None) -> tuple[float, float]:
        """Relative distance of the two, and the greatest motion of the counterpart [m]; there : known already."""
        there = self.there if there is None else there
        here = self.moved()
        return float(np.linalg.norm(here - there) / np.linalg.norm(there)), float(np.linalg.norm(there, axis=1).max())


def bench(name: str, poses: int, seed: int = 1) -> Bench:
    robot, plant = machine(name)
    q = draw_poses(plant, poses, np.random.default_rng(seed), plant.ranges, unfolded(plant))
    seeds = np.random.SeedSequence(seed).spawn(2)
    stops = draw_stops(q, seeds, [plant.payload_kg, plant.payload_kg / 2], Warmup(), approach="chance")
    return Bench(name, plant, robot, stops)


def approach(b: Bench, joint: int) -> dict[str, Array]:
    return {f"approach{joint}": b.stops.approach[:, joint - 1]}


def without_mass(b: Bench, link: int) -> Bench:
    """The same robot, one link of which weighs nothing: its own weight is another load case of a beam or flange."""
    mass = b.plant.mass.copy()
    mass[link - 1] = 1e-6
    joints = list(b.robot.joints)
    body = joints[link - 1].body
    assert body is not None
    joints[link - 1] = replace(joints[link - 1], body=replace(body, mass=1e-6))
    return b.changed({"mass": mass}, replace(b.robot, joints=tuple(joints)))


def without_tool(b: Bench) -> Bench:
    robot = replace(b.robot, tool=Placement(frame(b.robot.tool.T[:3, :3], np.zeros(3)), b.robot.tool.unknown))
    return b.changed({"reflector": np.zeros(3)}, robot)


def named(label: str, values: Values) -> dict[str, float]:
    return {f"{label}.{name}": float(value) for name, value in values.items()}


def progress(b: Bench) -> dict[str, Array]:
    return {"progress": b.stops.progress}
