"""The tables of a robot file, in millimetres and degrees."""

from typing import Any

import numpy as np

from casadical.core.parts import WIDTHS, Body, BodyWidth, FourBar, Joint, Placement
from casadical.core.transforms import to_rpy
from casadical.robot.robot import Robot


def mm(value: float) -> float:
    """Millimetres of metres."""
    return float(value * 1e3)


def deg(value: float) -> float:
    """Degrees of radians."""
    return float(np.rad2deg(value))


def frame_table(placement: Placement) -> dict[str, Any]:
    """A frame as a file has it."""
    return {
        "xyz_mm": [mm(v) for v in placement.T[:3, 3]],
        "rpy_deg": [deg(v) for v in to_rpy(placement.T[:3, :3])],
        "unknown": placement.unknown,
    }


def tool_tables(robot: Robot) -> list[dict[str, Any]]:
    """Of several tools a table for each, the first one first."""
    further = [
        {"name": t.name, "xyz_mm": [mm(v) for v in t.point], "unknown": robot.tool.unknown} for t in robot.targets
    ]
    return [{"name": robot.tool_name, **frame_table(robot.tool)}, *further]


def body_table(body: Body) -> dict[str, Any]:
    """A mass and its centre."""
    return {"mass_kg": float(body.mass), "com_mm": [mm(v) for v in body.com]}


def joint_table(joint: Joint) -> dict[str, Any]:
    """A row."""
    table: dict[str, Any] = {"alpha_deg": deg(joint.alpha), "a_mm": mm(joint.a)}
    if joint.beta is not None:
        table["beta_deg"] = deg(joint.beta)
    if joint.b is not None:
        table["b_mm"] = mm(joint.b)
    table |= {"theta_deg": deg(joint.theta), "d_mm": mm(joint.d)}
    if joint.kind == "prismatic":
        table |= {"type": "prismatic", "limits_mm": [mm(joint.lower), mm(joint.upper)]}
    else:
        table["limits_deg"] = [deg(joint.lower), deg(joint.upper)]
    if joint.coupling is not None:
        turning = joint.kind == "revolute"
        table["follows"] = [[j, float(k)] for j, k in joint.coupling.follows]
        table["at_deg" if turning else "at_mm"] = (deg if turning else mm)(joint.coupling.at)
    if joint.compliance is not None:
        table["compliant"] = True
        if joint.compliance > 0:
            unit = "Nm_per_rad" if joint.kind == "revolute" else "N_per_m"
            table[f"stiffness_{unit}"] = float(1 / joint.compliance)
    if joint.body:
        table["body"] = body_table(joint.body)
    return table


def loop_table(loop: FourBar) -> dict[str, Any]:
    """A four-bar."""
    return {
        "driven": loop.driven,
        "carrier": loop.carrier,
        "crank_mm": mm(loop.crank),
        "coupler_mm": mm(loop.coupler),
        "rocker_mm": mm(loop.rocker),
        "offset_deg": deg(loop.offset),
    }


def width_tables(robot: Robot) -> dict[str, Any]:
    """Widths that are not the usual ones, by group."""
    of_bodies = {"mass_share": robot.body_width.share, "com_mm": mm(robot.body_width.centre)}
    groups = {
        group: {
            "length_bound_mm": mm(w.length_bound),
            "angle_bound_deg": deg(w.angle_bound),
            "length_prior_mm": mm(w.length_prior),
            "angle_prior_deg": deg(w.angle_prior),
        }
        for group, w in robot.widths.items()
        if w != WIDTHS[group]
    }
    return groups | ({} if robot.body_width == BodyWidth() else {"body": of_bodies})
