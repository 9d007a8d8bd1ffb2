"""Whether arm, camera or both are wrong, and what moved: planted errors of simulated poses of a board."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arms import poses, readings, six_axis
from scipy.spatial.transform import Rotation
from test_camera_noise import MIDDLE, seen_by_hand

from casadical import Measurements, identify
from casadical.core.transforms import frame
from casadical.identification.arm_or_camera import _Model, arm_or_camera
from casadical.identification.identification import prepare
from casadical.robot.robot import Robot


def with_wrong(m: Measurements, focal: float = 0.0, moved: float = 0.0) -> Measurements:
    """Poses as a camera has them whose focal length is wrong by a share, and that moves on the flange after 20."""
    t = -np.einsum("nji,nj->ni", m.orientation, m.position)  # the board's place in the camera
    t[:, 2] += focal * (t + np.einsum("nji,j->ni", m.orientation, MIDDLE))[:, 2]
    T = np.array([frame(R, -R @ each) for R, each in zip(m.orientation, t, strict=True)])
    T[20:] = T[20:] @ frame(Rotation.from_rotvec([0, moved, 0]).as_matrix(), np.array([moved, 0, 0]))
    return replace(m, position=T[:, :3, 3], orientation=T[:, :3, :3])


def wrong_arm(robot: Robot) -> Robot:
    """The nominal robot if its geometry is wrong by a millimetre and milliradian."""
    rng = np.random.default_rng(2)
    off = {p.name: p.value + 1e-3 * rng.normal() for p in robot.parameters if p.group == "geometry"}
    return robot.with_values(off)


@pytest.mark.parametrize(
    ("arm", "focal", "wrong"), [(0, 0, "neither"), (1, 0, "arm"), (0, 0.01, "camera"), (1, 0.02, "both")]
)
def test_the_side_that_is_wrong_is_named_with_its_share(arm: int, focal: float, wrong: str) -> None:
    robot, m, _ = seen_by_hand(40)
    found = arm_or_camera(identify(wrong_arm(robot) if arm else robot, with_wrong(m, focal), ["kinematic"]))
    assert found.wrong == wrong
    assert (found.arm.probability > 0.9) == bool(arm)
    assert (found.camera.probability > 0.9) == (focal > 0)
    by_name = {e.name: e for e in found.errors}
    if focal:
        assert by_name["focal length"].value == pytest.approx(focal, abs=0.003)
        assert "focal length +" in found.in_words()
        assert found.sure.focal == pytest.approx(focal, abs=0.003)
    else:
        assert found.sure is None
    assert found.moved.probability < 0.1
    assert "moved between two rows: no." in found.in_words()
    assert found.total == pytest.approx(np.hypot(np.hypot(found.arm.size, found.camera.size), found.noise), rel=0.4)


def test_errors_of_the_camera_are_taken_off_its_poses() -> None:
    """The hand-eye transform of corrected poses is that of poses without the error."""
    robot, right, _ = seen_by_hand(40)
    wrong = with_wrong(right, 0.01)
    found = arm_or_camera(identify(robot, wrong, ["kinematic"]))
    better = wrong.without_errors(found.sure, np.array(found.ratios.point))
    places = [identify(robot, m, ["placement"]).robot.tool.T[:3, 3] for m in (right, wrong, better)]
    assert np.linalg.norm(places[1] - places[0]) > 1e-3
    assert np.linalg.norm(places[2] - places[0]) < 2e-4
    assert (better.camera, better.inverted) == (wrong.camera, wrong.inverted)


def test_a_camera_that_moved_is_named_with_the_rows_between() -> None:
    robot, m, _ = seen_by_hand(40)
    found = arm_or_camera(identify(robot, with_wrong(m, moved=3e-3), ["kinematic"]))
    moved = found.moved
    assert (moved.what, moved.before, moved.after) == ("the camera on the flange", 19, 20)
    assert (moved.shift, moved.turn) == pytest.approx((3e-3, 3e-3), rel=0.4)
    assert found.wrong == "neither"
    assert found.in_words().startswith("Between rows 19 and 20 the camera on the flange moved by")


def test_positions_and_few_poses_have_no_answer() -> None:
    robot, m, _ = seen_by_hand(12)
    assert arm_or_camera(identify(robot, replace(m, camera=""), ["placement"])) is None
    assert arm_or_camera(identify(robot, m[:11], ["kinematic"])) is None
    assert prepare(robot, m).sets[0].noise is None


def test_poses_that_tell_nothing_leave_the_prior_probability_of_a_step() -> None:
    arm = six_axis()
    m = replace(poses(arm, readings(arm, 14, 0), 1), camera="in hand")
    frames = 1e-9 * np.random.default_rng(0).normal(size=(84, 12))
    blind = SimpleNamespace(m=m, drawn=np.ones(2, dtype=bool), widths=np.ones(2))
    blind.whitened = lambda ratios, sigmas: (np.zeros(84), frames, np.zeros((84, 6)))
    moved, _ = _Model.step(blind, SimpleNamespace(ratios=None, sigmas=None), np.repeat(["tool", "base"], 6))
    assert moved.probability == pytest.approx(0.1)
