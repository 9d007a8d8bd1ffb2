"""Stations of a camera: all of them see the board, and so many as were measured have the error that is forecast."""

from dataclasses import replace

import numpy as np
import pytest
from test_camera_noise import MIDDLE, seen_by_hand

from casadical import InputError, Measurements, identify
from casadical.core.parts import Coupling
from casadical.identification.accuracy import predicted
from casadical.identification.pose_selection.camera_stations import camera_stations, read_view, simulated_stations


def test_stations_see_the_board_and_more_of_them_promise_less_error() -> None:
    robot, m, _ = seen_by_hand(15)
    found = identify(robot, m, ["kinematic"])
    planned = camera_stations(found, 20)
    assert planned.table.shape == (20, 6)
    assert list(planned.forecast["stations"]) == [15, 10, 15, 20, 25, 40]
    assert (planned.forecast["hand_eye_mm"].diff()[2:] < 0).all()
    p, R = predicted(found.robot, Measurements(planned.q, "position", position=np.zeros((20, 3))))
    x, y, z = np.einsum("nji,nj->in", R, MIDDLE - p)  # the middle of the board in the camera
    near, far, off, _ = planned.visible
    tolerance = 0.02  # the middle is estimated
    assert (np.sqrt(x**2 + y**2 + z**2) > near - tolerance).all()
    assert (np.sqrt(x**2 + y**2 + z**2) < far + tolerance).all()
    assert (np.arctan2(np.hypot(x, y), z) < off + tolerance).all()
    assert "visible from" in planned.blocks()[0].text


def test_the_forecast_of_measured_stations_is_the_error_that_they_have() -> None:
    off, promised = [], []
    for seed in range(8):
        robot, m, X = seen_by_hand(15, seed)
        found = identify(robot, m, ["kinematic"])
        off.append(1e3 * np.linalg.norm(found.robot.tool.T[:3, 3] - X[:3, 3]))
        if seed < 2:
            promised.append(camera_stations(found, 10).forecast["hand_eye_mm"][0])
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(np.mean(promised), rel=0.5)


def test_of_a_nominal_arm_stations_are_planned_from_a_view() -> None:
    """More noise promises more error, in proportion where the arm is nominal; the board is in the given view."""
    robot, _, _ = seen_by_hand(12)
    view = read_view("0.35,0.7,20,45")
    planned = [camera_stations(simulated_stations(robot, view, sigma), 12, view=view) for sigma in (3e-4, 3e-3)]
    assert planned[0].table.shape == (12, 6)
    assert planned[0].visible == view
    assert list(planned[0].forecast["stations"]) == [15, 10, 12, 15, 25, 40]
    assert 2 * planned[0].forecast["place_mm"].iloc[-1] < planned[1].forecast["place_mm"].iloc[-1]
    assert "simulated stations" in planned[0].blocks()[0].text
    coupled = replace(robot, joints=(*robot.joints[:5], replace(robot.joints[5], coupling=Coupling(((4, 0.5),), 0.1))))
    found = simulated_stations(coupled, view)
    m = found.problem.sets[0]
    turned = np.linalg.norm(m.orientation - np.diag([1.0, -1.0, -1.0]), axis=(1, 2))
    assert turned.min() < 0.02  # the camera stands straight before the board at one station
    for q in (found.problem.sets[0].q, camera_stations(found, 12, view=view).q):
        np.testing.assert_allclose(q[:, 5], 0.1 + 0.5 * q[:, 3])
    for wrong in ("0.5,0.3,20,45", "0.3,0.9,20", "a,b,c,d"):
        with pytest.raises(InputError, match="two rising distances"):
            read_view(wrong)


def test_without_poses_of_a_camera_there_is_no_plan() -> None:
    robot, m, _ = seen_by_hand(12)
    with pytest.raises(InputError, match="no full poses of a camera"):
        camera_stations(identify(robot, replace(m, camera=""), ["placement"]))
