"""Corners of a board in images: poses and weights by their reprojection errors, and errors of the camera itself.

The oracle is a projection that is written here, by OpenCV's model of a lens, and scipy's bundle adjustment with it.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from test_camera_noise import seen_by_hand

import casadical
from casadical import InputError, Measurements, from_table, identify
from casadical.core.transforms import frame
from casadical.identification.accuracy import predicted
from casadical.measurements.camera_noise import to_camera_axes, whitening
from casadical.measurements.corners import INTRINSICS, CameraErrors
from casadical.project.new import new_problem
from casadical.project.robot_columns import as_poses
from casadical.robot.robot_file import robot_files
from casadical.robot.urdf.writing import new_urdf

# Eight by six corners of squares of 30 mm, whose origin is the first.
BOARD = np.array([[0.03 * i, 0.03 * j, 0.0] for i in range(8) for j in range(6)])
LENS = {"fx": 900.0, "fy": 905.0, "cx": 640.0, "cy": 360.0, "distortion": [-0.12, 0.03, 1e-3, -5e-4, 0.01]}
PIXEL = 0.3


def pixels(T: np.ndarray, lens: dict = LENS, board: np.ndarray = BOARD) -> np.ndarray:
    """Images of the board at poses (n, 4, 4) in the camera, shape (n, corners, 2) [px]."""
    k1, k2, p1, p2, k3 = lens["distortion"]
    c = (T @ np.column_stack([board, np.ones(len(board))]).T)[:, :3]
    x, y = c[:, 0] / c[:, 2], c[:, 1] / c[:, 2]
    r = np.hypot(x, y)
    radial = 1 + k1 * r**2 + k2 * r**4 + k3 * r**6
    u = lens["fx"] * (x * radial + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2)) + lens["cx"]
    v = lens["fy"] * (y * radial + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y) + lens["cy"]
    return np.stack([u, v], axis=-1)


def stations(n: int, seed: int = 5) -> tuple[casadical.Robot, np.ndarray, np.ndarray, np.ndarray]:
    """An arm, its readings, exact poses of the board in the camera on its flange, and the hand-eye transform."""
    robot, m, X = seen_by_hand(n, seed)
    p, R = predicted(replace(robot, tool=replace(robot.tool, T=X)), m)
    T = np.array([np.linalg.inv(frame(*each)) for each in zip(R, p, strict=True)])
    # The board is where the first camera sees it, 0.5 m away.
    stands = np.linalg.inv(T[0]) @ frame(np.diag([1.0, -1, -1]), np.array([-0.1, 0.08, 0.5]))
    return robot, m.q, T @ stands, X


def table(q: np.ndarray, seen: np.ndarray, lens: dict | None = LENS) -> pd.DataFrame:
    """A row for each corner that was seen; seen : (n, corners, 2) [px]."""
    n = len(BOARD)
    columns = {f"q{k + 1}_rad": np.repeat(q[:, k], n) for k in range(q.shape[1])}
    columns |= {"u_px": seen[..., 0].ravel(), "v_px": seen[..., 1].ravel()}
    columns |= {f"board_{c}_mm": np.tile(1e3 * BOARD[:, k], len(q)) for k, c in enumerate("xy")}
    if lens:
        values = (lens["fx"], lens["fy"], lens["cx"], lens["cy"], *lens["distortion"])
        columns |= dict(zip(INTRINSICS, values, strict=True))
    return pd.DataFrame(columns)


def moved(T: np.ndarray, e: np.ndarray) -> np.ndarray:
    """Poses shifted and rotated in the axes of the camera by e, (n, 6) or (6,)."""
    e = np.broadcast_to(e, (len(T), 6)).copy()
    turned = Rotation.from_rotvec(e[:, 3:]).as_matrix() @ T[:, :3, :3]
    return np.array([frame(R, p) for R, p in zip(turned, T[:, :3, 3] + e[:, :3], strict=True)])


def test_poses_are_those_of_least_reprojection_error() -> None:
    _, q, T, _ = stations(6)
    exact = from_table(table(q, pixels(T)), 6)
    np.testing.assert_allclose(exact.view.T, T, atol=1e-8)
    started = np.array([exact.view.images._start(k) for k in range(6)])  # by the homography alone
    np.testing.assert_allclose(started, T, atol=1e-7)
    assert (exact.kind, len(exact), exact.row.tolist()) == ("pose", 6, [2 + 48 * k for k in range(6)])
    seen = pixels(T) + np.random.default_rng(0).normal(0, PIXEL, (6, 48, 2))
    found = from_table(table(q, seen), 6).view.T
    for k in range(6):
        best = least_squares(lambda e, k=k: (pixels(moved(T[k : k + 1], e)) - seen[k]).ravel(), np.zeros(6)).x
        np.testing.assert_allclose(found[k], moved(T[k : k + 1], best)[0], atol=2e-6)


@pytest.mark.parametrize("camera", ["in hand", "to base"])
def test_squares_of_whitened_residuals_are_those_of_the_pixels(camera: str) -> None:
    rng, (_, q, T, _) = np.random.default_rng(1), stations(5)
    seen = pixels(T) + rng.normal(0, PIXEL, (5, 48, 2))
    m = replace(from_table(table(q, seen), 6), camera="to base")
    m = replace(m.inverse() if camera == "in hand" else m, camera=camera).in_camera_axes()
    e = rng.normal(size=(5, 6)) * np.repeat([2e-4, 1e-3], 3)
    grown = ((pixels(moved(m.view.T, e)) - seen) ** 2).sum(axis=(1, 2)) - ((pixels(m.view.T) - seen) ** 2).sum(
        axis=(1, 2)
    )
    plain = np.linalg.solve(to_camera_axes(m.view), e[..., None])
    white = (whitening(m.view, m.noise) @ plain)[..., 0] / np.repeat(m.noise.pixel, 3)
    np.testing.assert_allclose((white**2).sum(axis=1), grown, rtol=0.03)


def test_the_hand_eye_transform_is_that_of_a_bundle_adjustment() -> None:
    """With the nominal arm: scipy fits hand-eye and board to all pixels of all images."""
    robot, q, T, X = stations(20)
    seen = pixels(T) + np.random.default_rng(2).normal(0, PIXEL, (20, 48, 2))
    # Half of the board is hidden in every second image: such stations weigh less.
    rows = table(q, seen)
    m = as_poses(from_table(rows[(np.arange(len(rows)) // 48 % 2 == 0) | (np.arange(len(rows)) % 48 < 24)], 6), robot)
    assert (m.camera, m.inverted) == ("in hand", True)
    found = identify(robot, m, ["placement"])
    p, R = predicted(robot, Measurements(q, "position", position=np.zeros((20, 3))))
    arm = np.array([frame(*each) for each in zip(R, p, strict=True)])
    stand = arm[0] @ X @ T[0]
    used = (np.arange(20) % 2 == 0)[:, None] | (np.arange(48) < 24)

    def residual(v: np.ndarray) -> np.ndarray:
        hand, board = moved(X[None], v[:6])[0], moved(stand[None], v[6:])[0]
        return (pixels(np.linalg.inv(arm @ hand) @ board) - seen)[used].ravel()

    best = least_squares(residual, np.zeros(12), x_scale=1e-3)
    std = PIXEL * np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
    off = found.robot.tool.T[:3, 3] - moved(X[None], best.x[:6])[0, :3, 3]
    assert np.abs(off).max() < 0.05 * std[:3].min()
    noise = found.problem.sets[0].noise if found.problem.sets[0].noise else m.in_camera_axes().noise
    assert found.problem.sigmas[0][0] / noise.pixel[0] == pytest.approx(PIXEL, rel=0.15)


def test_errors_of_the_camera_are_taken_off_images() -> None:
    """Of given intrinsics and a board that are wrong the poses follow as of right ones."""
    _, q, T, _ = stations(5)
    wrong = LENS | {"fx": 900 * 1.01, "fy": 905 * 1.01, "distortion": [-0.15, 0.03, 1e-3, -5e-4, 0.01]}
    rows = table(q, pixels(T), wrong).assign(
        board_x_mm=lambda t: t.board_x_mm * 1.005, board_y_mm=lambda t: t.board_y_mm * 1.005
    )
    m = replace(from_table(rows, 6), camera="to base")
    assert np.abs(m.view.T - T)[:, :3, 3].max() > 2e-3
    right = m.without_errors(CameraErrors(focal=0.01, board=0.005, distortion=0.03), np.zeros(3))
    np.testing.assert_allclose(right.view.T, T, atol=1e-8)


def problem(folder: Path, focal: float = 0.0) -> tuple[Path, np.ndarray]:
    """A problem of 24 stations whose focal length is given wrong by a share, and its hand-eye transform."""
    robot, q, T, X = stations(24)
    seen = pixels(T) + np.random.default_rng(3).normal(0, PIXEL, (24, 48, 2))
    table(q, seen, None).to_csv(folder / "corners.csv", index=False)
    for path, text in robot_files(folder / "robot.toml", robot, "an arm", reproducible=True).items():
        path.write_text(text)
    lens = f"fx = {900 * (1 + focal)}, fy = {905 * (1 + focal)}, cx = 640.0, cy = 360.0"
    (folder / "problem.toml").write_text(
        'casadical = 1\ntitle = "corners"\ndata = "synthetic"\nmethods = ["KM"]\n[[measurements]]\n'
        f'file = "corners.csv"\nintrinsics = {{ {lens}, distortion = {LENS["distortion"]} }}\n'
    )
    return folder, X


def test_a_wrong_focal_length_is_found_and_taken_off(tmp_path: Path) -> None:
    folder, X = problem(tmp_path, 0.006)
    result = casadical.calibrate(folder)
    answer = result.arm_or_camera
    assert answer.wrong == "camera"
    assert answer.sure.focal == pytest.approx(0.006, abs=5e-4)
    assert np.abs(result.hand_eye_nominal.T[:3, 3] - X[:3, 3]).max() < 2e-4
    assert "errors of the camera are taken off" in " ".join(str(result).split())
    (told,) = result.to_json()["tables"]
    assert told["camera_errors"]["focal"] == answer.sure.focal
    # Read with what was found, the poses are the same, and nothing is left to correct.
    text = (folder / "problem.toml").read_text()
    (folder / "problem.toml").write_text(f"{text}camera_errors = {{ focal = {answer.sure.focal} }}\n")
    again = casadical.read_problem(folder)
    np.testing.assert_allclose(
        again.sets["identify"][0].position, result.problem.sets["identify"][0].position, atol=1e-9
    )


def test_new_keeps_the_intrinsics(tmp_path: Path) -> None:
    robot, q, T, _ = stations(12)
    (tmp_path / "arm.urdf").write_text(new_urdf(robot))
    table(q, pixels(T), None).to_csv(tmp_path / "corners.csv", index=False)
    given = {"urdf": tmp_path / "arm.urdf", "data": tmp_path / "corners.csv"}
    made = new_problem(tmp_path / "arm", **given, intrinsics="900,905,640,360,-0.12,0.03,1e-3,-5e-4,0.01")
    parts = [m for _, m in made.parts()]
    assert sum(map(len, parts)) == 12
    assert {(m.camera, m.inverted) for m in parts} == {("in hand", True)}
    k = [int(np.abs(q - each).sum(axis=1).argmin()) for each in parts[0].q]
    np.testing.assert_allclose(parts[0].view.T, T[k], atol=1e-7)
    for wrong in ("900,905", "900,x,640,360", "-900,905,640,360", "900,905,640,nan"):
        with pytest.raises(InputError, match="allowed: FX,FY,CX,CY in pixels"):
            new_problem(tmp_path / "other", **given, intrinsics=wrong)


def test_tables_of_corners_that_cannot_be_used_are_refused() -> None:
    _, q, T, _ = stations(4)
    rows = table(q, pixels(T))
    with pytest.raises(InputError, match="row 50: the station that begins there has 5 corners"):
        from_table(rows.drop(index=rows.index[53:96]), 6)
    with pytest.raises(InputError, match="fx_px, fy_px, cx_px, cy_px missing; say in"):
        from_table(rows.drop(columns=list(INTRINSICS)), 6)
    with pytest.raises(InputError, match=r"row 7.*u_px"):
        from_table(rows.assign(u_px=rows.u_px.where(rows.index != 5)), 6)
    with pytest.raises(InputError, match="the corners lie in several planes"):
        from_table(rows.assign(board_z_mm=rows.board_x_mm), 6)
