"""What may be measured: geometry by sampled lines and by hand."""

from dataclasses import replace

import numpy as np
import pytest
from arms import RIGHT, elbow, planar, readings

from casadical import FourBar, InputError, Joint, Placement, Robot
from casadical.core.transforms import frame
from casadical.identification.pose_selection import Workspace
from casadical.identification.pose_selection.candidates import draw
from casadical.identification.pose_selection.workspace import Box, Tracker, places_about, read_workspace

BOX = Box(np.array([-0.2, -0.1, 0.1]), np.array([0.3, 0.5, 0.4]))


def test_lines_through_a_box_as_points_along_them_say() -> None:
    rng = np.random.default_rng(0)
    station, points = np.array([1.0, -0.7, 0.9]), rng.uniform(-1, 1, (300, 3))
    t = np.linspace(0, 1, 4001)[:, None, None]
    along = station + t * (points - station)
    sampled = BOX.holds(along).any(axis=0)
    hidden = BOX.hides(points, station)
    assert 20 < hidden.sum() < 280
    assert (hidden != sampled).mean() < 0.01  # a corner cut between two samples
    assert not (sampled & ~hidden).any()


def test_lines_along_the_axes() -> None:
    points = np.array([[0.0, 0, 1], [0, 0, -1], [2, 0, 2], [0.0, 0, 0.2]])
    assert BOX.hides(points, np.array([0.0, 0, 2])).tolist() == [False, True, False, True]


def test_a_box_behind_the_target_or_behind_the_tracker_hides_nothing() -> None:
    """All on one line through the box: before it, in front of it, behind it."""
    line = np.array([0.05, 0.2, 0.25]) + np.array([-2.0, -1.5, 1.5, 2.0])[:, None] * np.array([1.0, 0.3, 0.1])
    near, nearer, beyond, far = line
    assert BOX.hides(np.array([beyond, far]), near).all()
    assert not BOX.hides(np.array([nearer]), near).any()  # the box is behind the target
    assert not BOX.hides(np.array([far]), beyond).any()  # and here behind the tracker


def test_a_tracker_sees_a_cone_and_the_open_side() -> None:
    tracker = Tracker(np.zeros(3), np.array([1.0, 0, 0]), np.deg2rad(30), 0.5, 3.0)
    points = np.array([[1, 0, 0], [1, 0.57, 0], [1, 0.59, 0], [0.4, 0, 0], [3.1, 0, 0], [-1, 0, 0]], dtype=float)
    R = np.tile(np.eye(3), (6, 1, 1))
    assert tracker.sees(points, R).tolist() == [True, True, False, False, False, False]
    back = replace(tracker, opening=np.array([-1.0, 0, 0]), acceptance=np.deg2rad(25))
    assert back.sees(points, R)[:2].tolist() == [True, False]  # 29.7 degrees off
    assert not replace(back, opening=np.array([1.0, 0, 0])).sees(points, R).any()


def test_places_are_those_of_the_kinematics() -> None:
    robot = planar()
    q = readings(robot, 5, 0)
    points, _, _ = places_about(robot, q)
    elbow_at = 0.4 * np.column_stack([np.cos(q[:, 0]), np.sin(q[:, 0])])
    tip = elbow_at + 0.3 * np.column_stack([np.cos(q.sum(axis=1)), np.sin(q.sum(axis=1))])
    np.testing.assert_allclose(points[:, 0, :2], elbow_at, atol=1e-12)
    np.testing.assert_allclose(points[:, 1, :2], tip, atol=1e-12)


def test_every_filter_refuses_what_it_names() -> None:
    robot = elbow()
    room = Workspace(
        lower=np.full(6, -2.0), upper=np.full(6, 2.0), floor=0.1, clearance=0.05,
        boxes=(Box(np.array([0.5, -1, 0]), np.array([1.0, 1, 0.5])),),
        tracker=Tracker(np.array([-3.0, 0, 1]), np.array([0.0, 0, 0.5]), np.deg2rad(15)),
    )  # fmt: skip
    q = readings(robot, 400, 1)
    refused = room.refusals(robot, q)
    assert set(refused) == {"joint range", "floor", "box", "line of sight"}
    assert all(mask.any() for mask in refused.values())
    kept = draw(robot, 50, room, np.random.default_rng(0))
    points, _, _ = places_about(robot, kept)
    assert points[:, :, 2].min() >= 0.15
    assert np.abs(kept).max() <= 2.0
    assert not room.boxes[0].holds(points, 0.05).any()
    assert not room.boxes[0].hides(points[:, -1], np.array([-3.0, 0, 1])).any()


def test_a_folded_loop_is_refused() -> None:
    """Joint 3 is driven by a parallelogram."""
    limits = (-2, 2), (0.5, 2.5), (1.0, 4.0)
    rows = ((0.0, 0.0, 0.5), (RIGHT, 0.3, 0.0), (0.0, 0.8, 0.0))
    joints = (
        Joint(alpha, a, d=d, lower=low, upper=high) for (alpha, a, d), (low, high) in zip(rows, limits, strict=True)
    )
    loop = FourBar(driven=3, carrier=2, crank=0.4, coupler=0.8, rocker=0.4, offset=-RIGHT)
    robot = Robot("loop", tuple(joints), tool=Placement(frame(np.eye(3), np.array([0.6, 0, 0]))), loops=(loop,))
    q = np.random.default_rng(0).uniform(*np.transpose(limits), (300, 3))
    folded = Workspace(margin=0.3).refusals(robot, q)["four-bar margin"]
    # Area of the triangle driven joint - crank's end - rocker's end: as of the other half of the parallelogram.
    crank, ground, turn = 0.4, 0.8, q[:, 2] - q[:, 1]
    diagonal = np.sqrt(crank**2 + ground**2 - 2 * crank * ground * np.cos(turn))
    sine = ground * np.sin(turn) / diagonal
    assert 20 < folded.sum() < 280
    np.testing.assert_array_equal(folded, sine**2 < 0.3)


def test_a_room_without_a_way_says_what_refuses() -> None:
    with pytest.raises(InputError, match=r"of the last 20 were refused: joint range 0, floor 20"):
        draw(elbow(), 20, Workspace(floor=5.0), np.random.default_rng(0))
    with pytest.raises(InputError, match="widen"):
        draw(elbow(), 20, Workspace(floor=5.0), np.random.default_rng(0), to_ends=True)
    with pytest.raises(InputError, match="needs 6 readings"):
        Workspace(lower=np.zeros(5)).ranges(elbow())
    with pytest.raises(InputError, match="the first below the second"):
        Box(np.zeros(3), np.array([1.0, -1, 1]))


ROOM = """
casadical = 1
floor_mm = 100
clearance_mm = 50
[[joint]]
number = 2
limits_deg = [-30, 200]
[[box]]
low_mm = [500, -1000, 0]
high_m = [1, 1, 0.5]
[tracker]
station_mm = [-3000, 0, 1000]
towards_m = [0, 0, 0.5]
half_angle_deg = 15
"""


SEEN = "casadical = 1\n[tracker]\nstation_m = [3, 0, 0]\n"


def test_a_room_file(tmp_path) -> None:
    (tmp_path / "room.toml").write_text(ROOM, encoding="utf-8")
    room = read_workspace(tmp_path / "room.toml", elbow())
    assert room.floor == pytest.approx(0.1)
    assert room.clearance == pytest.approx(0.05)
    assert room.lower[1] == pytest.approx(np.deg2rad(-30))
    assert room.upper[1] == 2.6  # the robot's own limit
    np.testing.assert_allclose(room.boxes[0].low, [0.5, -1, 0])
    np.testing.assert_allclose(room.tracker.station, [-3, 0, 1])
    assert room.tracker.half_angle == pytest.approx(np.deg2rad(15))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("casadical = 1\nflor_mm = 3\n", "is floor_mm meant"),
        ("casadical = 1\n[[joint]]\nnumber = 9\nlimits_deg = [0, 1]\n", "elbow has 6 joints"),
        ("casadical = 1\n[[joint]]\nnumber = 1\nlimits_deg = [170, 180]\n", "nothing of its range is left"),
        ("casadical = 1\n[tracker]\nstation = [0, 0, 0]\n", "write its unit too"),
        ("casadical = 1\nclearance_mm = -5\n", "clearance_mm = -5: must be greater than or equal to 0"),
        ("casadical = 1\n[[box]]\nlow_m = [1, 1, 1]\nhigh_m = [2, 0, 2]\n", r"box\[1\].high_m = .* greater than that"),
        (SEEN + "half_angle_deg = 5\n", "half_angle_deg = 5: has no effect without towards"),
        (SEEN + "acceptance_deg = 5\n", "acceptance_deg = 5: has no effect without opening"),
        (SEEN + "towards_m = [3, 0, 0]\n", "towards_m = .*: is the station itself"),
        (SEEN + "towards_m = [0, 0, 0]\nhalf_angle_deg = 400\n", "half_angle_deg = 400: allowed: at most 180"),
        (SEEN + "opening = [0, 0, 0]\n", "opening = .*: has no direction"),
        (SEEN + "farthest_m = 0.1\n", "farthest_m = 0.1: must be greater than nearest, 0.3 m"),
    ],
)
def test_faults_of_a_room_file(tmp_path, text, message) -> None:
    (tmp_path / "room.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_workspace(tmp_path / "room.toml", elbow())
