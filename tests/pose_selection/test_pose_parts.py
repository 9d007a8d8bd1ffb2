"""Parts of a search for poses: depth of the exchange, size of the pool, order, digits of the table."""

from pathlib import Path

import numpy as np
import pytest
from arms import planar

from casadical.core.basics import InputError
from casadical.effects.instrument import Session
from casadical.pose_selection.candidates import Candidates, Circumstances, candidates_at, expected, later_poses
from casadical.pose_selection.pose_search import select_poses
from casadical.pose_selection.selection import TIME_PARTS, in_measuring_order
from casadical.pose_selection.workspace import read_workspace

ROBOT = planar()


@pytest.mark.parametrize(("n", "candidates"), [(5, 100), (50, 150)])
def test_the_pool_is_three_times_what_is_chosen_at_least(n: int, candidates: int) -> None:
    with pytest.raises(InputError, match=f"the {candidates} candidates lie too near"):
        select_poses(ROBOT, None, n, pool=100, min_distance=100.0)


def test_poses_stay_in_their_part_of_the_campaign() -> None:
    rng = np.random.default_rng(0)
    progress = np.array([1.0, 0.0, 0.3, 0.9, 0.05, 0.6])
    q = rng.uniform(-1, 1, (6, ROBOT.n))
    m = in_measuring_order(ROBOT, Candidates(q, {"progress": progress[:, None]}), Circumstances(), travel=False)
    order = [int(np.flatnonzero((q == row).all(axis=1))[0]) for row in m.q]
    parts = np.minimum((TIME_PARTS * progress).astype(int), TIME_PARTS - 1)
    assert order == sorted(range(6), key=lambda k: (parts[k], k))


def test_limits_that_leave_one_reading_leave_nothing(tmp_path: Path) -> None:
    low, high = (float(np.rad2deg(v)) for v in (ROBOT.joints[0].lower, ROBOT.joints[0].upper))
    middle = 0.5 * (low + high)
    path = tmp_path / "room.toml"
    path.write_text(f"casadical = 1\n[[joint]]\nnumber = 1\nlimits_deg = [{middle}, {middle}]\n")
    with pytest.raises(InputError, match=r"joint 1: nothing of its range is left"):
        read_workspace(path, ROBOT)
    path.write_text(f"casadical = 1\n[[joint]]\nnumber = 1\nlimits_deg = [{middle}, {middle + 1}]\n")
    assert read_workspace(path, ROBOT).upper[0] == pytest.approx(np.deg2rad(middle + 1))


def test_the_table_for_the_robot_tells_micrometres() -> None:
    found = select_poses(ROBOT, None, 3, pool=12, restarts=1)
    assert found.m.position is not None
    shown = found.table[["nominal_x_mm", "nominal_y_mm", "nominal_z_mm"]].to_numpy()
    assert (np.round(shown, 3) == shown).all()
    np.testing.assert_allclose(shown, 1e3 * found.m.position, rtol=0, atol=5.001e-4)
    assert list(found.table.columns[:3]) == ["pose", "q1_deg", "q2_deg"]


def test_half_of_the_later_poses_lie_within_the_campaigns_ranges() -> None:
    own = expected(ROBOT, np.random.default_rng(0).uniform(0.2, 0.6, (5, ROBOT.n)), {}, "campaign")
    drawn = later_poses(ROBOT, own, np.ones(5, dtype=bool), (), 400, 0)
    new = drawn.m.q[drawn.repeated < 0]
    within = ((new >= own.q.min(axis=0)) & (new <= own.q.max(axis=0))).all(axis=1)
    assert 200 <= within.sum() < 220


def test_poses_are_planned_for_the_last_session() -> None:
    arm = ROBOT.with_effect(*(Session(None, which=name) for name in "bcd"))
    columns = candidates_at(arm, np.zeros((4, ROBOT.n)), Circumstances(), 4, np.random.default_rng(0)).conditions
    assert {name: set(v.ravel()) for name, v in columns.items()} == {
        "session_b": {0.0}, "session_c": {0.0}, "session_d": {1.0}
    }  # fmt: skip


def test_a_reading_is_measured_in_every_pass_from_both_sides() -> None:
    assert Circumstances(both_approaches=True, repeats=3).size(planar()) == 6
