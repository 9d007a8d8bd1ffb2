"""Cameras that measure full poses and fail: named as such on made campaigns, and no cause in the robot claimed.

The campaigns are made by kinematics and a pinhole of this file (scipy's rotations), not by those of the package.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cases import diagnose
from scipy.spatial.transform import Rotation

from casadical.diagnosis.instrument_columns import camera_displacements
from casadical.measurements.measurements import Measurements
from casadical.project.problem import read_campaign_robot

ROOT = Path(__file__).parents[2]
POSES, LATE = 80, 45
NOISE, TURN_NOISE = 1e-4, 2e-4


@cache
def robot():
    return read_campaign_robot(ROOT / "problems" / "ur10e")


def frame(rotvec, xyz) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), xyz
    return T


def flange(q: np.ndarray, wrong: np.ndarray) -> np.ndarray:
    """T_0n of the robot file's rows, theta and d of each joint wrong by so much [rad, m]."""
    T = np.eye(4)
    for j, value, (theta, d) in zip(robot().joints, q, wrong, strict=True):
        T = T @ frame([j.alpha, 0, 0], [j.a, 0, 0])
        T = T @ frame([0, 0, j.theta + value + theta], [0, 0, 0]) @ frame([0, 0, 0], [0, 0, j.d + d])
    return T


def campaign(fault: str, carried: bool, size: float = 1.0) -> Measurements:
    """Full poses by a camera that stands, or is carried, in error by a tenth of a millimetre."""
    rng = np.random.default_rng(3)
    middle = np.deg2rad([20.0, -80.0, 100.0, -60.0, -90.0, 10.0])
    q = middle + rng.uniform(-0.7, 0.7, (POSES, 6))
    wrong = rng.normal(0, [5e-4, 2e-4], (6, 2))
    wrong[3, 0] = 0.0
    stands, hand = frame([1.2, -1.2, 1.0], [0.4, 0.3, 2.4]), frame([0.3, 0.2, -0.4], [0.05, -0.03, 0.12])
    knock, push = frame([1e-3, -5e-4, 8e-4], [4e-4, -3e-4, 3e-4]), frame([-4e-4, 5e-4, 3e-4], [4e-4, 4e-4, -3e-4])
    p, R = np.zeros((POSES, 3)), np.zeros((POSES, 3, 3))
    for k in range(POSES):
        late = k >= LATE
        twisted = q[k].copy()
        if fault == "joint_zero_step":
            twisted[2] += 5e-4 * late
        T = flange(twisted, wrong) @ hand
        T = T @ knock if late and fault == "hand_eye_step" else T
        T = stands @ T
        T = push @ T if late and fault == "stand_step" else T
        if fault == "lens_scale":
            T = seen_wrongly(T, carried, size)
        p[k] = T[:3, 3] + rng.normal(0, NOISE, 3)
        R[k] = T[:3, :3] @ Rotation.from_rotvec(rng.normal(0, TURN_NOISE, 3)).as_matrix()
    return Measurements(q, "pose", position=p, orientation=R)


def seen_wrongly(T: np.ndarray, carried: bool, size: float) -> np.ndarray:
    """What a camera reports whose focal length is 0.1 % too long; the measuring frame is its own, or the board's."""
    seen = np.linalg.inv(T) if carried else T.copy()
    seen[2, 3] *= 1 + 1e-3 * size
    return np.linalg.inv(seen) if carried else seen


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "carried"), [("hand_eye_step", False), ("stand_step", False), ("lens_scale", False), ("lens_scale", True)]
)
def test_what_a_camera_does_wrong_is_named(fault: str, carried: bool) -> None:
    found = diagnose(robot(), campaign(fault, carried))
    assert found.verdict == "explained"
    (cause,) = found.causes
    assert cause.label == fault
    if fault == "lens_scale":
        (effect,) = cause.effects
        assert effect.side == ("carried" if carried else "fixed")
        assert cause.estimates["depth"][0] == pytest.approx(1e-3, rel=0.25)
    else:
        assert cause.effects[0].at == pytest.approx(LATE / POSES, abs=0.06)


@pytest.mark.slow
def test_a_fault_of_the_robot_is_not_the_cameras() -> None:
    found = diagnose(robot(), campaign("joint_zero_step", False))
    assert [c.label for c in found.causes] == ["joint_zero_step@3"]


def test_a_good_camera_has_no_fault() -> None:
    assert diagnose(robot(), campaign("none", False)).verdict == "none"


def test_what_a_fault_adds_is_moved_as_the_pinhole_moves_it() -> None:
    m = campaign("none", False)
    for side in ("fixed", "carried"):
        made = camera_displacements(m.position, m.orientation)
        depth = np.column_stack([made[f"{side}_depth_{c}_m"] for c in "xyz"])
        for k in range(0, POSES, 20):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = m.orientation[k], m.position[k]
            moved = (seen_wrongly(T, side == "carried", 1e-3) - T)[:3, 3] / 1e-6
            np.testing.assert_allclose(depth[k], moved, atol=1e-6)
