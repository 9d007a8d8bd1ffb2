"""Noise of a camera's poses in its own axes: whitening, estimation from residuals, and what it gains.

Errors are planted by scipy's rotations in the camera's frame, about the middle of a board whose origin is a corner.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from casadical import Measurements, identify
from casadical.core.parts import Joint, Placement
from casadical.core.transforms import frame, from_rpy
from casadical.identification.accuracy import predicted
from casadical.identification.pose_errors import image_plane
from casadical.measurements.camera_noise import CameraNoise, View, lines_of_sight, moved_by_errors, refined, whitening
from casadical.robot.robot import Robot

MIDDLE = np.array([0.12, 0.08, 0.0])
PLANTED = CameraNoise((0.5, 1.5, 1.2, 0.3), (1.0, 2.0, 1.0, 1.0), 0.5, (0.12, 0.08, 0.0))


def target_poses(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Places and orientations of a target in a camera, 0.3 to 0.8 m away."""
    z = rng.uniform(0.3, 0.8, n)
    t = np.column_stack([*(z * rng.uniform(-0.3, 0.3, n) for _ in range(2)), z])
    R = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (n, 3))) * Rotation.from_rotvec([np.pi, 0, 0])
    return t - R.apply(MIDDLE), R.as_matrix()


def with_errors(t: np.ndarray, R: np.ndarray, camera: str, e: np.ndarray) -> Measurements:
    """Measured poses, as casadical has them, of a target whose middle is off by e along the line of sight's axes."""
    m = Measurements(np.zeros((len(t), 1)), "pose", position=t, orientation=R, camera=camera)
    m = m.inverse() if camera == "in hand" else m
    axes, _ = lines_of_sight(m.view, PLANTED)
    shift, turn = (np.einsum("nji,nj->ni", axes, part) for part in (e[:, :3], e[:, 3:]))
    seen = Rotation.from_rotvec(turn).as_matrix() @ R
    p = t + np.einsum("nij,j->ni", R, MIDDLE) + shift - np.einsum("nij,j->ni", seen, MIDDLE)
    m = Measurements(m.q, "pose", position=p, orientation=seen, camera=camera)
    return m.inverse() if camera == "in hand" else m


@pytest.mark.parametrize("camera", ["in hand", "to base"])
def test_whitened_residuals_are_the_errors_in_the_cameras_axes(camera: str) -> None:
    rng = np.random.default_rng(0)
    t, R = target_poses(40, rng)
    e = 1e-4 * rng.normal(size=(40, 6))
    m, true = (with_errors(t, R, camera, part) for part in (e, 0 * e))
    turn = Rotation.from_matrix(m.orientation.transpose(0, 2, 1) @ true.orientation).as_rotvec()
    plain = np.column_stack([true.position - m.position, turn])
    _, away = lines_of_sight(m.view, PLANTED)
    white = np.einsum("nij,nj->ni", whitening(m.view, PLANTED), plain) * PLANTED.relative(away)
    np.testing.assert_allclose(white, -e, atol=4e-7)


@pytest.mark.parametrize("camera", ["in hand", "to base"])
def test_planted_components_growth_and_point_are_found(camera: str) -> None:
    rng = np.random.default_rng(1)
    t, R = target_poses(400, rng)
    _, away = lines_of_sight((m := with_errors(t, R, camera, np.zeros((400, 6)))).view, PLANTED)
    e = PLANTED.relative(away) * rng.normal(size=(400, 6)) * np.repeat([2e-4, 1e-3], 3)
    m, true = with_errors(t, R, camera, e), m
    turn = Rotation.from_matrix(m.orientation.transpose(0, 2, 1) @ true.orientation).as_rotvec()
    plain, noise, sigmas = np.column_stack([true.position - m.position, turn]), CameraNoise(), (1e-4, 1e-4)
    for _ in range(4):
        r = np.einsum("nij,nj->ni", whitening(m.view, noise), plain) / np.repeat(sigmas, 3)
        noise, sigmas = refined(m.view, noise, r, np.ones_like(r), sigmas)
    at_half = np.array(noise.ratios) * (0.5 / noise.distance) ** np.array(noise.growth) * np.repeat(sigmas, 2)
    np.testing.assert_allclose(at_half, np.array(PLANTED.ratios) * np.repeat([2e-4, 1e-3], 2), rtol=0.1)
    np.testing.assert_allclose(noise.point, MIDDLE, atol=0.02)
    np.testing.assert_allclose(noise.growth, PLANTED.growth, atol=0.5)


def seen_by_hand(poses: int, seed: int = 5) -> tuple[Robot, Measurements, np.ndarray]:
    """An arm with a camera in its hand, noisy poses, and its hand-eye transform."""
    rng, right = np.random.default_rng(seed), np.pi / 2
    rows = [(0, 0, 0.1625), (right, 0, 0), (0, -0.425, 0), (0, -0.3922, 0.1333), (right, 0, 0.0997), (-right, 0, 0.1)]
    joints = tuple(Joint(alpha=alpha, a=a, d=d, lower=-2.9, upper=2.9) for alpha, a, d in rows)
    robot = Robot("arm", joints, base=Placement(np.eye(4), "pose"), tool=Placement(np.eye(4), "pose"))
    X = frame(from_rpy(np.array([0.1, -0.2, 1.0])), np.array([0.05, -0.04, 0.07]))
    q = np.array([0.3, -1.2, 1.6, -1.8, -1.5, 0]) + rng.uniform(-0.6, 0.6, (20_000, 6))
    built = replace(robot, tool=replace(robot.tool, T=X))
    p, R = predicted(built, Measurements(q, "position", position=np.zeros((len(q), 3))))
    board = p[0] + R[0] @ [0, 0, 0.5]
    c = np.einsum("nji,nj->ni", R, board - p)
    near = np.flatnonzero((c[:, 2] > 0.3) & (np.hypot(c[:, 0], c[:, 1]) < 0.4 * c[:, 2]))[:poses]
    B = R[0] @ np.diag([1.0, -1, -1])
    t, turned = c[near] - np.einsum("nji,j->ni", R[near], B @ MIDDLE), R[near].transpose(0, 2, 1) @ B
    exact = with_errors(t, turned, "in hand", np.zeros((poses, 6)))
    _, away = lines_of_sight(exact.view, PLANTED)
    e = PLANTED.relative(away) * rng.normal(size=(poses, 6)) * np.repeat([1e-4, 2e-3], 3)
    return robot, replace(with_errors(t, turned, "in hand", e), q=q[near]), X


def test_the_hand_eye_transform_is_several_times_better_with_the_cameras_noise() -> None:
    robot, m, X = seen_by_hand(25)
    off = {}
    for camera in ("in hand", ""):
        found = identify(robot, replace(m, camera=camera), ["placement"])
        off[camera] = np.linalg.norm(found.robot.tool.T[:3, 3] - X[:3, 3])
    assert 3 * off["in hand"] < off[""]
    assert off["in hand"] < 3e-4
    assert found.problem.sets[0].noise is None


def test_arrows_in_the_image_are_the_errors_across_the_view() -> None:
    robot, m, _X = seen_by_hand(25)
    found = identify(robot, m, ["placement"]).robot
    p, R = predicted(found, m)
    t = -np.einsum("nji,nj->ni", R, p) + [2e-3, -1e-3, 0]  # the board's first corner in the camera, and 2 mm aside
    moved = replace(m, position=-np.einsum("nij,nj->ni", R, t), orientation=R)
    line, ends = image_plane(moved, {"KM": found}).series
    factor = float(line.name.split()[2])
    at = t[:, :2] / t[:, 2:]
    np.testing.assert_allclose(np.column_stack([line.x, line.y])[::3], at, atol=1e-6)
    arrows = np.array([2e-3, -1e-3]) / t[:, 2:]
    np.testing.assert_allclose(np.column_stack([ends.x, ends.y]), at + factor * arrows, atol=1e-5)


def test_a_wrong_tilt_turns_a_board_by_its_obliqueness_about_the_axis_that_shows_it() -> None:
    t, R = target_poses(20, np.random.default_rng(0))
    turn = moved_by_errors(View(t, R, "in hand", None), MIDDLE)[:, 3:, 1]
    middle = t + R @ MIDDLE
    line, normal = middle / np.linalg.norm(middle, axis=1)[:, None], R[:, :, 2]
    cosine = np.einsum("ni,ni->n", line, normal)
    np.testing.assert_allclose(np.linalg.norm(turn, axis=1), np.sqrt(1 / cosine**2 - 1), rtol=1e-9)
    np.testing.assert_allclose(np.einsum("nk,nki->ni", turn, np.stack([line, normal], axis=2)), 0.0, atol=1e-12)
