"""The physics in numpy: the HH800 twin; kinematics, gravity torques and equilibrium against Pinocchio."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy_physics import HH800, campaign, hh800_true, hh800_twin
from numpy_physics.state import moments
from numpy_physics.statics import placed, settle, tool_point
from numpy_physics.twin import UNMODELLED, WARMUP
from pinocchio_arm import PinocchioArm
from plants import ARM, random_arm, stops_at
from scipy.optimize import fsolve, least_squares
from scipy.spatial.transform import Rotation

from casadical.blind_check.mujoco_physics import Plant
from casadical.blind_check.mujoco_physics.plant import rotation

Q, XYZ = [f"q{j}_deg" for j in range(1, 7)], ["x_mm", "y_mm", "z_mm"]


@pytest.fixture(scope="module")
def twin() -> pd.DataFrame:
    return hh800_twin(truth=True)


def test_sets(twin: pd.DataFrame) -> None:
    assert twin["set"].value_counts().to_dict() == {"identify": 40, "train": 50, "choose": 50, "report": 50}
    assert not twin.duplicated(Q).any()
    assert (twin["payload_kg"] == 300.0).all()


def test_deterministic(twin: pd.DataFrame) -> None:
    pd.testing.assert_frame_equal(twin, hh800_twin(truth=True))
    assert not hh800_twin(seed=1)[Q].equals(twin[Q])


def test_before_calibration_is_near_table_4_and_5(twin: pd.DataFrame) -> None:
    """Only base frame and reflector are fitted, by rigid registration: the paper has 4.6 and 4.4."""
    nominal, q = Plant.from_dict(HH800), np.deg2rad(twin[Q].to_numpy())
    flange = placed(nominal, stops_at(q, 300.0), q).bodies[6] @ nominal.home[5]
    measured = twin[XYZ].to_numpy() / 1e3

    def error(x: np.ndarray) -> np.ndarray:
        tool = flange[:, :3, :3] @ (nominal.reflector + x[6:]) + flange[:, :3, 3]
        return 1e3 * (tool @ rotation(x[:3]).T + x[3:6] - measured)

    first = (twin["set"] == "identify").to_numpy()
    fitted = least_squares(lambda x: error(x)[first].ravel(), np.zeros(9), x_scale=1e-3).x
    length = pd.Series(np.linalg.norm(error(fitted), axis=1)).groupby(twin["set"]).mean()
    assert length["identify"] == pytest.approx(4.597, rel=0.15)
    assert length["choose"] == pytest.approx(4.427, rel=0.15)


def test_what_does_not_repeat_is_a_small_part() -> None:
    """The same poses anew, other approaches and noise: 0.20 mm rms of the 0.49 mm that the model leaves."""
    q_deg = hh800_twin()[Q].to_numpy()[:60]
    again = [
        campaign(hh800_true(), 60, seed, q_deg=q_deg, payload_states=[300.0], warmup=WARMUP, disturbances=UNMODELLED)[
            XYZ
        ]
        for seed in range(8)
    ]
    rms = np.sqrt(np.var(np.array(again), axis=0, ddof=1).sum(1).mean())
    assert 0.15 < rms < 0.25


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
