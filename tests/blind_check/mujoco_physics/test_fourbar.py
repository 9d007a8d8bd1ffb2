"""The loop: closure by a numeric solve, torques by the energy's finite differences, HH800 positions as a serial arm."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import fsolve

from casadical.blind_check.mujoco_physics import Plant, perturb
from casadical.blind_check.mujoco_physics.cause import State, moments, placed
from casadical.blind_check.mujoco_physics.plant import close_loop, crank_distance, unfolded
from casadical.blind_check.mujoco_physics.stops import draw_poses
from casadical.core.basics import InputError

from .machines import HH800, nominal, stops


@pytest.fixture(params=[None, 1, 2, 3])
def plant(request: pytest.FixtureRequest) -> Plant:
    nominal = Plant.from_dict(HH800)
    if request.param is None:
        return nominal
    return perturb(nominal, request.param, length_mm=5.0, angle_mrad=5.0)


def poses(plant: Plant, n: int) -> np.ndarray:
    return draw_poses(plant, n, np.random.default_rng(4), plant.ranges, unfolded(plant))


def test_closure_against_a_numeric_solve(plant: Plant) -> None:
    bar, q = plant.four_bar, poses(plant, 30)
    assert bar is not None
    start = np.linalg.inv(plant.home[1]) @ plant.home[2]
    for crank in q[:, 2] - q[:, 1]:
        end = bar.crank_m * np.array([np.cos(crank + bar.crank_zero_rad), np.sin(crank + bar.crank_zero_rad)])

        def gap(angles: np.ndarray, end: np.ndarray = end) -> np.ndarray:
            rocker = bar.rocker_m * np.array([np.cos(angles[0]), np.sin(angles[0])])
            coupler = bar.coupler_m * np.array([np.cos(angles[1]), np.sin(angles[1])])
            return start[:2, 3] + rocker - coupler - end

        rocker = fsolve(gap, [crank, 0.0], xtol=1e-11)[0]
        assert close_loop(plant, np.array([crank])).passive[0] == pytest.approx(rocker - np.pi / 2, abs=1e-10)


def energy(rest: State) -> np.ndarray:
    mass, centre = rest.weights()
    return np.sum(9.81 * mass * centre[..., 2], 0)


def test_torques_are_the_slope_of_the_energy(plant: Plant) -> None:
    q = poses(plant, 30)
    at, h = stops(q, 300.0), 1e-5
    expected = np.empty_like(q)
    for j in range(6):
        step = h * np.eye(6)[j]
        up, down = (energy(placed(plant, at, q + s)) for s in (step, -step))
        expected[:, j] = (down - up) / (2 * h)
    np.testing.assert_allclose(moments(placed(plant, at, q)), expected, atol=1e-3, rtol=1e-8)


def test_the_arm_stands_as_drawn() -> None:
    """theta2 = 90, theta3 = 180 deg: upper arm upright, crank back, forearm forward."""
    plant = Plant.from_dict(HH800)
    q = np.deg2rad([[0.0, 90, 180, 0, 0, 0]])
    rest = placed(plant, stops(q, 0.0), q)
    elbow, wrist = rest.axis(3)[1][0], rest.axis(5)[1][0]
    np.testing.assert_allclose(elbow, [0.515, 0, 1.6], atol=1e-12)
    np.testing.assert_allclose(wrist - elbow, [1.9, 0, 0.35], atol=1e-12)
    loop = close_loop(plant, q[:, 2] - q[:, 1])
    np.testing.assert_allclose(loop.crank_end, [[0, 0.8]], atol=1e-12)  # in link 2: its x is up, its y is back


def test_limits_are_the_campaigns() -> None:
    assert unfolded(Plant.from_dict(HH800)) == pytest.approx((1.0, 2.2))
    assert unfolded(nominal("kr210")) is None


def test_open_loop_names_the_pose() -> None:
    plant = Plant.from_dict(HH800)
    assert plant.four_bar is not None
    short = replace(plant, four_bar=replace(plant.four_bar, coupler_m=1.0))
    q = np.deg2rad([[0.0, 90, 150, 0, 0, 0], [0, 45, 220, 0, 0, 0]])
    assert crank_distance(short, q)[1] > 1.8
    with pytest.raises(InputError, match="pose 2: the four-bar is open"):
        close_loop(short, q[:, 2] - q[:, 1])


def test_a_serial_arm_has_no_loop() -> None:
    with pytest.raises(InputError, match="no four-bar"):
        crank_distance(nominal("kr210"), np.zeros((1, 6)))
