"""Robots of synthetic campaigns: the model that a user has, and the drawing of which a simulator builds one."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np

from casadical.blind_check.mujoco_physics import Plant
from casadical.project.problem import read_campaign_robot
from casadical.robot.robot import Robot

ROOT = Path(__file__).parents[2]


@cache
def machine(name: str) -> tuple[Robot, Plant]:
    """A robot of data/campaigns: its model and its drawing."""
    drawing = json.loads((ROOT / "data" / "campaigns" / "robots" / f"{name}.json").read_text(encoding="utf-8"))
    return read_campaign_robot(ROOT / "problems" / name), Plant.from_dict(drawing)


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
