"""Whether arm, camera or both are wrong, and what moved: planted errors of simulated poses of a board."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arms import poses, readings, six_axis
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation
from test_camera_noise import MIDDLE, seen_by_hand

from casadical import Measurements, identify
from casadical.core.transforms import frame
from casadical.identification.arm_or_camera import _Model, _settings, arm_or_camera
from casadical.identification.identification import prepare
from casadical.measurements.camera_noise import CameraNoise
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


def test_a_cause_has_the_posterior_probability_of_dense_normal_densities() -> None:
    """Of noise half as large again as estimated, which the average over its sigmas has to allow for."""
    arm, rng = six_axis(), np.random.default_rng(6)
    m = replace(poses(arm, readings(arm, 14, 0), 1), camera="in hand")
    y, frames, rest = 1.5 * rng.normal(size=84), rng.normal(size=(84, 12)), rng.normal(size=(84, 5))
    rest *= [0.1, 300, 300, 300, 300]
    y += 0.002 * rest[:, 1]
    model = SimpleNamespace(m=m, drawn=np.zeros(1, dtype=bool), widths=np.ones(1), names=np.array(["a1"]))
    model.whitened = lambda noise, sigmas: (y, frames, rest)
    found = _Model.answer(model, CameraNoise(distance=1.0), (1e-5, 1e-4))
    sd, log_prior, present = _settings(model.drawn, model.widths)
    # In an orthonormal basis of what the frames leave, and of its part that the errors move.
    free = null_space(frames.T)
    Q, A = np.linalg.qr(free.T @ rest)
    e = Q.T @ free.T @ y
    log = []
    for f in np.geomspace(0.75, 1.5, 6):
        C = f**2 * np.eye(5) + (A * sd[:, None] ** 2) @ A.T
        other = 67 * np.log(f) + 0.5 * (np.sum((free.T @ y) ** 2) - e @ e) / f**2
        log.append(log_prior - 0.5 * np.linalg.slogdet(C)[1] - 0.5 * np.linalg.inv(C) @ e @ e - other)
    weight = np.exp(log - np.max(log)).sum(axis=0)
    expected = weight @ present / weight.sum()
    assert 0.5 < expected[0] < 0.7
    assert [error.probability for error in found.errors] == pytest.approx(expected, abs=0.05)
