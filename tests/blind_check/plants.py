"""Robots and circumstances for the tests of the simulator."""

from typing import Any

import numpy as np

from casadical.blind_check.mujoco_physics.plant import Plant
from casadical.blind_check.mujoco_physics.stops import Stops

ARM: dict[str, Any] = {
    "name": "arm",
    "modified_dh": [
        {"alpha_deg": 0, "a_m": 0, "d_m": 0.7, "theta0_deg": 0},
        {"alpha_deg": -90, "a_m": 0.35, "d_m": 0, "theta0_deg": 0},
        {"alpha_deg": 0, "a_m": 1.2, "d_m": 0, "theta0_deg": -90},
        {"alpha_deg": -90, "a_m": 0.05, "d_m": 1.1, "theta0_deg": 0},
        {"alpha_deg": 90, "a_m": 0, "d_m": 0, "theta0_deg": 0},
        {"alpha_deg": -90, "a_m": 0, "d_m": 0.2, "theta0_deg": 0},
    ],
    "tool_m": [0.12, 0.05, 0.3],
    "mass_kg": [400, 250, 200, 70, 40, 20],
    "com_m": [[0.1, 0, -0.2], [0.5, 0, -0.1], [0.1, 0.1, 0], [0, 0, -0.4], [0, -0.03, 0], [0, 0, -0.05]],
    "payload": {"mass_kg": 100.0, "com_m": [0.05, 0.02, 0.2]},
    "stiffness_Nm_per_rad": [3e6, 2.6e6, 2.2e6, 6e5, 5e5, 3.5e5],
    "joint_range_deg": [[-140, 140], [-110, -20], [-30, 110], [-170, 170], [-110, 110], [-170, 170]],
}


def arm() -> Plant:
    return Plant.from_dict(ARM)


def stops_at(q: np.ndarray, payload_kg: float) -> Stops:
    """The readings ``q`` (n, 6) on a cold arm, every joint stopped upwards."""
    n = len(q)
    return Stops(q, 30.0 * np.arange(1, n + 1), np.zeros(n), np.full(n, payload_kg), np.ones((n, 6)))
