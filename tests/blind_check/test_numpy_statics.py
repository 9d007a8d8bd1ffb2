"""Forward kinematics, gravity torques and static equilibrium of serial arms against Pinocchio."""

from dataclasses import replace

import numpy as np
import pytest
from numpy_physics.state import moments
from numpy_physics.statics import placed, settle, tool_point
from pinocchio_arm import PinocchioArm
from plants import ARM, random_arm, stops_at
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from casadical.blind_check.mujoco_physics.plant import Plant

ROBOTS = [ARM, *(random_arm(seed) for seed in range(5))]


@pytest.fixture(params=range(len(ROBOTS)))
def pair(request: pytest.FixtureRequest) -> tuple[Plant, PinocchioArm]:
    robot = ROBOTS[request.param]
    base = np.eye(4)
    base[:3, :3] = Rotation.from_rotvec([0.03, -0.02, 0.4]).as_matrix()
    base[:3, 3] = 0.02, -0.01, 0.03
    return replace(Plant.from_dict(robot), base=base), PinocchioArm(robot, base)


def test_positions_and_torques(pair: tuple[Plant, PinocchioArm]) -> None:
    plant, oracle = pair
    q = np.random.default_rng(1).uniform(-3, 3, (40, 6))
    rest = placed(plant, stops_at(q, plant.payload_kg), q)
    np.testing.assert_allclose(tool_point(rest), [oracle.position(x) for x in q], atol=1e-12)
    np.testing.assert_allclose(moments(rest), [oracle.weight_torque(x) for x in q], atol=1e-9)


def test_rest_is_where_springs_and_weights_agree(pair: tuple[Plant, PinocchioArm]) -> None:
    plant, oracle = pair
    plant = replace(plant, stiffness=np.array([2e5, 1e5, 2e5, 1e5, 5e4, 4e4]))
    q = np.random.default_rng(2).uniform(-3, 3, (10, 6))
    found = tool_point(settle(plant, stops_at(q, plant.payload_kg)))
    for reading, point in zip(q, found, strict=True):
        true = fsolve(lambda x, r=reading: x - r - oracle.weight_torque(x) / plant.stiffness, reading, xtol=1e-11)
        np.testing.assert_allclose(point, oracle.position(true), atol=1e-9)
        assert np.linalg.norm(point - oracle.position(reading)) > 1e-3
