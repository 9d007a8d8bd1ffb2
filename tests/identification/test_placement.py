"""The start of base and tool where readings determine them badly: held by the robot file."""

import arms
import numpy as np
import pytest

from casadical import InputError, Placement, identify
from casadical.core.transforms import frame, from_xyz
from casadical.identification.placement import FrameEstimate, PlacementProblem, Readings, place_frames, solve_placement
from casadical.measurements.measurements import Measurements

ARM = arms.six_axis()
BASE = frame(from_xyz([0.4, -0.2, 1.1]), [1.5, -0.7, 0.3])
TOOL = np.array([0.05, -0.02, 0.15])


def path(turns: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Flange, its orientation, which departs from one by so much [rad], and measured points of an uncalibrated arm."""
    rng = np.random.default_rng(seed)
    s = np.linspace(-1, 1, 120)
    p = np.array([0.8, 0.1, 0.5]) + 0.3 * s[:, None] * np.array([0.6, 0.8, 0.0]) + 0.1 * np.cos(3 * s)[:, None]
    waves = np.stack([np.sin(2 * s), np.cos(3 * s), s**2], axis=1)
    R = np.array([from_xyz(turns * w) for w in waves])
    # What the nominal model does not know of, smooth along the path.
    wrong = 2e-3 * np.stack([np.sin(1.5 * s), np.cos(2 * s), np.sin(2.5 * s)], axis=1)
    flange = p + wrong + rng.normal(0, 3e-5, p.shape)
    return p, R, (flange + R @ TOOL) @ BASE[:3, :3].T + BASE[:3, 3]


def test_one_orientation_leaves_the_tool_where_the_file_has_it() -> None:
    p, R, y = path(1e-3)
    file = np.add(TOOL, [0.012, -0.012, 0.0105])
    plain = solve_placement(p, R, y, None, np.eye(4), file)[1]
    assert np.linalg.norm(plain - TOOL) > 0.2  # what least squares make of it
    held = PlacementProblem([Readings(p, R, y)], np.eye(4), file, tool_known=False)
    start = FrameEstimate(*(solve_placement(p, R, y, file, np.eye(4), file)[0][:3, c] for c in (slice(3), 3)), file)
    assert not held.determined(start)
    found = held.best([start])
    assert np.linalg.norm(found.t - TOOL) < 0.05
    left = (p + R @ found.t) @ found.R.T + found.p - y
    assert np.linalg.norm(left, axis=1).max() < 0.01


def test_many_orientations_free_the_tool_of_the_file() -> None:
    p, R, y = path(1.0)
    held = PlacementProblem([Readings(p, R, y)], np.eye(4), np.zeros(3), tool_known=False)
    T, t = solve_placement(p, R, y, None, np.eye(4), np.zeros(3))
    assert held.determined(FrameEstimate(T[:3, :3], T[:3, 3], t))
    np.testing.assert_allclose(held.best([FrameEstimate(T[:3, :3], T[:3, 3], t)]).t, TOOL, atol=5e-3)


def test_distances_to_three_known_points_place_the_base() -> None:
    built = arms.planted(ARM, 4)
    q = arms.readings(built, 40, 3)
    measured = arms.positions(built, q, 0, sigma=0.0)
    assert measured.position is not None
    y = measured.position @ BASE[:3, :3].T + BASE[:3, 3]
    anchors = np.array([[3.0, 0.2, 0.1], [0.1, 2.5, 1.0], [-0.5, -2.0, 2.0]])
    sets = [
        Measurements(q, "distance", distance=np.linalg.norm(y - a, axis=1), target=np.tile(a, (len(q), 1)))
        for a in anchors
    ]
    placed = place_frames(ARM, sets)
    stood = BASE @ built.base.T
    np.testing.assert_allclose(placed.base.T[:3, 3], stood[:3, 3], atol=0.02)
    np.testing.assert_allclose(placed.base.T[:3, :3], stood[:3, :3], atol=0.02)


@pytest.mark.parametrize("poses", [2, 3, 4])
def test_few_poses_place_the_base_by_the_files_tool(poses: int) -> None:
    q = arms.readings(ARM, poses, 1)
    m = arms.positions(ARM, q, 0, sigma=0.0)
    placed = place_frames(ARM, m)
    assert np.linalg.norm(placed.tool.T[:3, 3] - ARM.tool.T[:3, 3]) < 0.05


def test_lists_are_taken_as_arrays_and_known_frames_are_named_where_nothing_fits() -> None:
    robot = arms.six_axis(base=Placement(np.eye(4)))
    moved = arms.planted(robot, 5, arms.TRACKER)
    q = arms.readings(robot, 40, 6)
    position = arms.positions(moved, q, 7).position
    with pytest.raises(InputError, match=r'known here: base; unknown = "pose" or "position" has them fitted'):
        identify(robot, Measurements(q.tolist(), "position", position=position.tolist()))
    with pytest.raises(InputError, match=r"are these degrees\? readings of joints that turn are in rad"):
        identify(robot, Measurements(np.degrees(q), "position", position=position))
    with pytest.raises(InputError, match="table: q is no array of numbers"):
        Measurements([["a", "b"]], "position", position=position)
