"""A table of another robot among the campaigns is said to be one; several changes of one robot are not."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from lives import as_built, changed, measured, write_table

from casadical import InputError, Robot
from casadical.core.reporting.result import plain_text
from casadical.fleet.campaigns import compare_files
from casadical.fleet.changes import Comparison
from casadical.fleet.comparison import compare
from casadical.fleet.estimates import Estimate, estimate


@pytest.fixture(scope="module")
def arms() -> tuple[Robot, Robot, Robot]:
    """The nominal robot, and two of its type as built."""
    robot, built = as_built(np.random.default_rng(301))
    return robot, built, as_built(np.random.default_rng(302))[1]


@pytest.fixture(scope="module")
def months(arms: tuple[Robot, Robot, Robot]) -> list[Estimate]:
    return [estimate((arms[0], measured(arms[1], seed)), f"2026-0{seed}") for seed in (1, 2, 3)]


def found(comparison: Comparison) -> list[tuple[str, bool, str, int]]:
    return [(c.cause.label, c.named, c.course, c.since) for c in comparison.changes]


@pytest.mark.parametrize(("at", "course", "since"), [(1, "once", 1), (3, "jump", 3), (0, "jump", 1)])
def test_another_robot_is_one_change_and_not_many(arms, months, at, course, since):
    """One table in the middle, the last one, or the first one, which all others differ from."""
    robot, _, other = arms
    told = [*months[:at], estimate((robot, measured(other, 4)), "other"), *months[at:]]
    comparison = compare(told)
    assert found(comparison) == [("another_robot", True, course, since)]
    text = plain_text(comparison.blocks())
    assert "This looks like another robot than before" in text
    assert "parameters differ by more than 3 standard errors" in " ".join(text.split())


def test_another_robot_stands_elsewhere_with_another_tool(arms, months):
    """With the frame and the tool declared as the same ones, these are no changes of their own."""
    told = [months[0], estimate((arms[0], measured(arms[2], 1)), "other")]
    assert found(compare(told, same_tool=True, same_frame=True)) == [("another_robot", True, "jump", 1)]


def test_what_changes_after_another_robot_came_is_named_beside_it(arms, months):
    robot, _, other = arms
    others = [estimate((robot, measured(other, seed)), f"2026-0{seed}") for seed in (4, 5)]
    hit = [estimate((robot, measured(changed(other, theta3=1e-3), seed)), f"2026-0{seed}") for seed in (6, 7)]
    told = found(compare([*months, *others, *hit]))
    assert sorted(told) == [("another_robot", True, "jump", 3), ("joint_zero@3", True, "jump", 5)]


def test_several_changes_at_once_are_no_other_robot(arms: tuple[Robot, Robot, Robot], months: list[Estimate]) -> None:
    """A crash that turned two joints and bent a link."""
    robot, built, _ = arms
    crashed = estimate((robot, measured(changed(built, theta2=5e-4, theta4=-5e-4, a2=5e-4), 9)), "crashed")
    comparison = compare([*months, crashed])
    assert {"joint_zero@2", "link@3"} <= {label for label, *_ in found(comparison)}
    assert "another_robot" not in {label for label, *_ in found(comparison)}


def test_a_table_of_another_robot_in_the_folder_of_one(arms: tuple[Robot, Robot, Robot], tmp_path: Path) -> None:
    """One problem folder is enough: later tables lie in its folder campaigns; a copy of the first one is none."""
    own = tmp_path / "R-1207"
    first = write_table(measured(arms[1], 11), own / "first.csv")
    (own / "problem.toml").write_text('casadical = 1\ntitle = "arm"\n[[measurements]]\nfile = "first.csv"\n')
    shutil.copy(Path(__file__).parents[2] / "problems/ur10e/robot.toml", own)
    with pytest.raises(InputError, match=r"two are needed\. Give more, or a problem folder"):
        compare_files([own])
    write_table(measured(arms[1], 12), own / "campaigns" / "2026-02-01.csv")
    write_table(measured(arms[2], 20), own / "campaigns" / "2026-03-01.csv")
    shutil.copy(first, own / "campaigns" / "2026-01-01.csv")
    found = compare_files([own])
    assert [c.label for c in found.campaigns] == ["R-1207", "2026-02-01", "2026-03-01"]
    assert found.name == "R-1207"
    (change,) = found.to_json()["changes"]
    assert (change["cause"], change["since"]) == ("another_robot", "2026-03-01")
