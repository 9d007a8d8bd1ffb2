"""Robots of synthetic campaigns: the model that a user has, and the drawing of which a simulator builds one.

And the campaigns of positions that the repository ships, with the robot of each.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from casadical.blind_check.mujoco_physics import Plant
from casadical.measurements.measurements import Measurements
from casadical.project.problem import read_campaign, read_campaign_robot
from casadical.robot.robot import Robot

ROOT = Path(__file__).parents[2]
CAMPAIGNS = ROOT / "data" / "campaigns"


@cache
def machine(name: str) -> tuple[Robot, Plant]:
    """A robot of data/campaigns: its model and its drawing."""
    drawing = json.loads((CAMPAIGNS / "robots" / f"{name}.json").read_text(encoding="utf-8"))
    return read_campaign_robot(ROOT / "problems" / name), Plant.from_dict(drawing)


def campaigns(more: Sequence[Path] = ()) -> list[Path]:
    """Tables of all practice and sealed campaigns, and of further folders, whose robot is known by its name."""
    folders = [CAMPAIGNS / name for name in ("practice", "sealed", "sealed_B")]
    return [path for folder in (*folders, *more) for path in sorted(folder.glob("*-*.csv")) if place_of(path).exists()]


def place_of(path: Path) -> Path:
    """Where the robot of a campaign is, which its file's name begins with: a robot file, or a problem folder."""
    name = path.stem.split("-")[0]
    own = CAMPAIGNS / "robots_B" / f"{name}.robot.toml"
    return own if own.is_file() else ROOT / "problems" / name


def read(path: Path) -> tuple[Robot, Measurements]:
    """A campaign and its robot, as the diagnosis takes them."""
    robot = read_campaign_robot(place_of(path))
    return robot, read_campaign(place_of(path), path, robot)


def plant_of(robot: Robot) -> Plant:
    """The drawing of a robot with six joints, written out as a simulator takes it."""
    joints = robot.joints
    table = {
        "name": robot.name,
        "modified_dh": [
            {"alpha_deg": np.rad2deg(j.alpha), "a_m": j.a, "d_m": j.d, "theta0_deg": np.rad2deg(j.theta)}
            for j in joints
        ],
        "tool_m": robot.tool.T[:3, 3],
        "mass_kg": [j.body.mass for j in joints],
        "com_m": [j.body.com for j in joints],
        "payload": {"mass_kg": robot.payload.mass, "com_m": robot.payload.com},
        "stiffness_Nm_per_rad": [1 / j.compliance for j in joints],
        "joint_range_deg": [[np.rad2deg(j.lower), np.rad2deg(j.upper)] for j in joints],
    }
    if robot.loops:
        bar = robot.loops[0]
        table["four_bar"] = {
            "crank_L5_m": bar.crank, "coupler_L4_m": bar.coupler, "rocker_L3_m": bar.rocker,
            "passive_offset_deg": np.rad2deg(bar.offset),
        }  # fmt: skip
    return Plant.from_dict(table)
