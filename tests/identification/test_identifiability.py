"""Which parameters come out as identifiable, and the words for those that do not."""

import re
from dataclasses import replace
from pathlib import Path

import arms
import numpy as np
import pytest

from casadical import InputError, identify, read_problem
from casadical.identification import least_squares
from casadical.identification.identifiability import analyse

ARM = arms.six_axis()


def held(result):
    return result.identifiability.unidentifiable


def partners(reason):
    """Names of the parameters that move the measured points as the one of this reason does."""
    return set(re.findall(r"(?: as|,) (\w+)(?=,| do)", reason))


def test_hh800_as_in_the_paper():
    """Table 3: 29 kinematic parameters and the compliances of joints 2 to 5; d2, d6, theta6, L3 crossed out."""
    robot = arms.hh800()
    built = arms.planted(robot, 1)
    result = identify(robot, arms.positions(built, arms.readings(robot, 60, 2), 3))
    assert result.is_optimal()
    kinematic = [n for n in result.names if robot.parameters[n].group != "compliance"]
    assert len(kinematic) == 29
    assert [n for n in result.names if n not in kinematic] == ["c2", "c3", "c4", "c5"]
    why = held(result)
    assert set(why) == {"d2", "d6", "theta6", "L3", "c1"}
    assert "axes 2 and 3 are nearly parallel: d2 moves the tool as d3 does" in why["d2"]
    assert partners(why["d6"]) == {"tool_z"}
    assert partners(why["theta6"]) == {"tool_x", "tool_y"}
    assert "L5 - L3" in why["L3"]
    table = result.parameters.set_index("name")
    assert table.loc["d6", "status"] == "not identifiable"
    assert table.loc["d6", "reason"] == "it moves the measured points exactly as tool_z does"


def test_no_gravity_torque_about_a_vertical_axis():
    robot = arms.hh800()
    result = identify(robot, arms.positions(robot, arms.readings(robot, 40, 2), 3))
    assert held(result)["c1"] == "it has no effect on what was measured"
    with pytest.raises(InputError, match=r"determine none of the parameters.*c1: it has no effect"):
        identify(robot, arms.positions(robot, arms.readings(robot, 40, 2), 3), ["c1"])


def test_gravity_turns_the_first_joint_where_the_base_is_found_to_be_tilted():
    """The drawing has an upright first axis; the robot leans by 6 degrees, so that its first joint is loaded."""
    robot = replace(arms.hh800(), gravity_frame="measuring")
    softer = 1.6 * robot.parameters["c1"].value
    built = robot.with_values({"alpha0": 0.1, "beta0": -0.05, "a2": 1.6005, "c1": softer})
    result = identify(robot, arms.positions(built, arms.readings(robot, 60, 2), 3))
    assert "c1" in result.names
    assert result.names == tuple(n for n in robot.parameters.names if n not in held(result))
    error = result.parameters.set_index("name").loc["c1", "std_error"]
    found = result.robot.parameters["c1"]
    assert abs(found.readable(found.value) - found.readable(softer)) < 4 * error
    assert error < 0.2 * found.readable(softer)


def test_a_joint_that_never_moved():
    """Rows about a fixed joint melt into one; what is named stands in for what is not."""
    built = arms.planted(ARM, 4, arms.TRACKER)
    q = arms.readings(built, 80, 5)
    q[:, 3] = 0.3
    stiff = identify(ARM, arms.positions(built, q, 6), ["kinematic"])
    free = identify(ARM, arms.positions(built, arms.readings(built, 80, 5), 6), ["kinematic"])
    assert len(stiff.names) == len(free.names) - 4  # a turning axis is four numbers
    new = set(held(stiff)) - set(held(free))
    assert len(new) == 4
    for name in new:
        assert "exactly as" in held(stiff)[name]
        assert partners(held(stiff)[name]) <= set(stiff.names)
    # Predictions are as good as ever where that joint stays.
    probe = arms.readings(built, 100, 7)
    probe[:, 3] = 0.3
    assert np.linalg.norm(stiff.predict(probe)[0] - arms.points(built, probe), axis=1).mean() < arms.NOISE


def test_poorly_told_is_told_in_words_with_partners():
    """Readings within a hundredth of a radian: much is seen, little is told."""
    built = arms.planted(ARM, 4, arms.TRACKER)
    near = 0.02 * arms.readings(built, 60, 5) + np.array([0.1, 0.4, -0.6, 0.3, 0.8, 0.2])
    result = identify(ARM, arms.positions(built, near, 6), ["kinematic"], priors=False)
    poor = [why for why in held(result).values() if "worse than its prior" in why]
    assert any(partners(why) for why in poor)
    widths = np.array([result.start.parameters[n].prior for n in result.names])
    assert (result.standard_errors <= 1.05 * widths).all()
    wanted = 2.0 * arms.NOISE
    assert np.linalg.norm(result.predict(near)[0] - arms.points(built, near), axis=1).mean() < wanted


def test_nearly_parallel_axes_take_beta_and_a_d_is_held():
    tilted = list(ARM.joints)
    tilted[2] = replace(tilted[2], alpha=np.deg2rad(1.5), beta=None)
    robot = arms.six_axis(joints=tuple(tilted))
    built = arms.planted(robot, 8, arms.TRACKER)
    result = identify(robot, arms.positions(built, arms.readings(built, 60, 9), 10), ["kinematic"])
    assert "beta2" in result.names
    assert "d2" not in result.names
    assert len(result.names) == 27


def test_analyse_names_exact_combinations():
    """A plain matrix: c = a + b, z = 0, e = 2 d; d is a wish to hold."""
    rng = np.random.default_rng(0)
    a, b, d, f = rng.normal(size=(4, 30))
    found = analyse(np.column_stack([a, b, a + b, 0 * a, d, 2 * d, f]), list("abczdef"), 0, {"d": "because"})
    assert found.independent == ("a", "b", "e", "f")
    assert partners(found.unidentifiable["c"]) == {"a", "b"}
    assert found.unidentifiable["z"] == "it has no effect on what was measured"
    assert found.unidentifiable["d"] == "because; e carries it"
    assert found.condition == pytest.approx(
        np.linalg.cond(np.column_stack([v / np.linalg.norm(v) for v in (a, b, d, f)])), rel=1e-9
    )


def test_analyse_lets_points_come_first():
    rng = np.random.default_rng(0)
    point, a = rng.normal(size=(2, 10))
    found = analyse(np.column_stack([point, 3 * point, a]), ["shift", "a"], 1, {})
    assert found.independent == ("a",)
    assert found.unidentifiable == {"shift": "the unknown points absorb it"}


def test_no_search_goes_on_along_what_will_be_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four angles and compliances of this campaign are determined so badly that Ipopt takes 90 evaluations."""
    monkeypatch.setattr(least_squares, "minimise", None)
    problem = read_problem(Path(__file__).parents[2] / "problems" / "ur10")
    result = identify(problem.robot, problem.sets["identify"], method="SKCM", loss="linear", priors=False)
    assert sum("worse than its prior" in why for why in held(result).values()) == 4
