"""Several sessions of one robot: base and tool of its own for each, joint zeros shared or not."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from arms import TRACKER, planted, positions, readings, six_axis

from casadical import Identification, InputError, Measurements, from_table, identify, read_robot, write_robot
from casadical.core.parts import Sessions
from casadical.core.transforms import frame, from_rpy
from casadical.identification.accuracy import errors
from casadical.identification.sessions import not_shared, sessions_in

# Where the instrument stands in the second session: elsewhere, and turned.
ELSEWHERE = frame(from_rpy(np.array([0.4, 0.2, -2.0])), np.array([-1.0, 2.0, 0.3]))
SHIFT = np.array([0.004, -0.02, 0.01])
ZERO = 2e-4


def labelled(m: Measurements, name: str) -> Measurements:
    return replace(m, conditions={f"session_{name}": np.ones(len(m))}, source=f"{name}.csv")


@cache
def made() -> tuple[Measurements, Measurements, Measurements, Measurements]:
    """Two sessions to identify from, and held-out poses of each; in the second, joint 3 has another zero."""
    built = planted(six_axis(), 3, TRACKER)
    T = built.tool.T.copy()
    T[:3, 3] += SHIFT
    theta3 = built.parameters["theta3"].value + ZERO
    later = replace(built.with_values({"theta3": theta3}), base=replace(built.base, T=ELSEWHERE))
    later = replace(later, tool=replace(later.tool, T=T))
    first, second = (
        labelled(positions(robot, readings(built, 90, k), k + 10), name)
        for k, (robot, name) in enumerate(((built, "May"), (later, "June")))
    )
    return first[:60], second[:60], first[60:], second[60:]


OWN = replace(six_axis(), sessions=Sessions(zeros="own"))


@cache
def apart() -> Identification:
    """Both sessions, each a set of its own, with zeros of its own."""
    return identify(OWN, made()[:2], method="KM")


@pytest.mark.slow
def test_base_and_tool_are_found_anew_and_the_robot_is_shared() -> None:
    first, second, held, held_later = made()
    found = apart()
    alone = identify(six_axis(), first, method="KM")
    assert errors(found.robot, held).mean() < 1.02 * errors(alone.robot, held).mean()
    assert errors(found.robot, held_later).mean() < 5e-5
    shift = [found.robot.effect_values[f"session_June.tool_{c}"] for c in "xyz"]
    np.testing.assert_allclose(shift, SHIFT, atol=2e-4)
    zero = found.parameters.set_index("name").loc["session_June.zero3"]
    assert zero["value"] == pytest.approx(np.rad2deg(ZERO), abs=3 * zero["std_error"])
    # With the zeros shared, the change of joint 3 stays in the errors.
    shared = identify(six_axis(), (first, second), method="KM")
    assert errors(shared.robot, held_later).mean() > 1.3 * errors(found.robot, held_later).mean()


def test_a_column_names_the_sessions_of_one_table(tmp_path: Path) -> None:
    first, second, held, _ = made()
    both = Measurements(
        q=np.concatenate([first.q, second.q]),
        kind="position",
        position=np.concatenate([first.position, second.position]),
        conditions={"session_May": np.repeat([1.0, 0.0], 60), "session_June": np.repeat([0.0, 1.0], 60)},
    )
    found = identify(OWN, both, method="KM")
    assert errors(found.robot, held).mean() == pytest.approx(errors(apart().robot, held).mean(), rel=0.05)
    # The file holds the robot, and base and tool of the first session.
    write_robot(found.robot, tmp_path / "robot.toml")
    again = read_robot(tmp_path / "robot.toml")
    assert again.effects == ()
    assert errors(again, held) == pytest.approx(errors(found.robot, held), abs=1e-9)
    assert sessions_in((both,)) == ("May", "June")


def test_what_cannot_be_had_is_said() -> None:
    first, second, _, _ = made()
    with pytest.raises(InputError, match=r"session 'June' has 4 poses; .* measure 2 more in it"):
        identify(six_axis(), (first, second[:4]), method="KM")
    with pytest.raises(InputError, match="table: says no session, and others do"):
        identify(six_axis(), (first, replace(second, conditions={}, source="table")), method="KM")
    assert "session 'June' shares no pose with 'May'" in not_shared((first, second))
    again = labelled(first[:3], "June")
    assert not_shared((first, again)) == ""
    assert not_shared((first,)) == ""


def test_the_column_is_words_and_complete() -> None:
    import pandas as pd

    q = np.round(np.random.default_rng(1).uniform(-1, 1, (4, 2)), 3)
    table = pd.DataFrame({"q1_rad": q[:, 0], "q2_rad": q[:, 1], "x_mm": 1.0, "y_mm": 2.0, "z_mm": [3.0, 4, 5, 6]})
    m = from_table(table.assign(session=["a", "a", "b", 7]), 2)
    assert sessions_in((m,)) == ("a", "b", "7")
    with pytest.raises(InputError, match="column 'session': is empty"):
        from_table(table.assign(session=["a", "a", None, "b"]), 2)
