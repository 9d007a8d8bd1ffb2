"""The three robots of the campaigns as built, poses, and what an effect does to them."""

import json
from pathlib import Path

import numpy as np

from casadical.blind_check import mujoco_physics as engine
from casadical.blind_check.mujoco_physics import Plant, perturb
from casadical.blind_check.mujoco_physics.cause import reflector, settle
from casadical.blind_check.mujoco_physics.plant import unfolded
from casadical.blind_check.mujoco_physics.stops import Stops, draw_poses

ROBOTS = ("hh800", "kr210", "ur10e")
FOLDER = Path(__file__).parents[3] / "data" / "campaigns" / "robots"
HH800, KR210 = (json.loads((FOLDER / f"{name}.json").read_text()) for name in ("hh800", "kr210"))


def nominal(name: str) -> Plant:
    return Plant.from_dict(json.loads((FOLDER / f"{name}.json").read_text()))


def built(name: str, seed: int = 5) -> Plant:
    return perturb(nominal(name), seed)


def stops(q, payload_kg, *, approach=1.0, time_s=None, warmth_K=0.0) -> Stops:
    """Readings ``q`` (n, 6) [rad] and their circumstances; scalars hold for all poses (and all joints)."""
    n = len(q)
    time_s = 30.0 * np.arange(1, n + 1) if time_s is None else np.asarray(time_s, float)
    warmth, payload = np.full(n, warmth_K, float), np.full(n, payload_kg, float)
    return Stops(np.asarray(q, float), time_s, warmth, payload, np.broadcast_to(np.asarray(approach, float), (n, 6)))


def drawn(machine: Plant, n: int, seed: int = 0):
    """Readings (n, 6) [rad] in the robot's ranges."""
    return draw_poses(machine, n, np.random.default_rng(seed), machine.ranges, unfolded(machine))


def shift(machine: Plant, hidden: engine.Hidden, at: Stops):
    """How far a hidden effect moves the reflector, (n, 3) [m]."""
    return engine.positions(machine, (hidden,), at) - engine.positions(machine, (), at)


def axis(machine: Plant, at: Stops, joint: int):
    """Direction (n, 3) of a joint's axis and a point (n, 3) on it, at rest on the joints' springs."""
    return settle(machine, at).axis(joint)


def angle_about(machine: Plant, at: Stops, joint: int, moved):
    """Turns (n,) [rad] about a joint's axis that move the reflector by ``moved`` (n, 3), and what they leave (n,)."""
    direction, centre = axis(machine, at, joint)
    speed = np.cross(direction, reflector(settle(machine, at)) - centre)
    angle = np.sum(speed * moved, 1) / np.sum(speed * speed, 1)
    return angle, np.linalg.norm(moved - angle[:, None] * speed, axis=1)
