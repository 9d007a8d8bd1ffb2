"""The tables that the docs show of each kind are read as that kind; what is wrong with others is said."""

import io
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from casadical import InputError
from casadical.measurements.columns import Columns
from casadical.measurements.kinds.registry import kinds
from casadical.measurements.reading import from_columns, from_table, read_measurements

PAGE = (Path(__file__).parents[2] / "docs" / "measurements.md").read_text(encoding="utf-8")
SHOWN = dict(re.findall(r"<!-- (\w+) -->\n```text\n(.*?)```", PAGE, flags=re.DOTALL))
READINGS = {"q1_deg": [10.0, 30, -40, 15, 20], "q2_deg": [20.0, -15, 25, 5, 0]}


def test_every_kind_has_a_table() -> None:
    assert set(SHOWN) | {"position", "corners"} == set(
        kinds()
    )  # those of corners: tests/identification/test_corners.py


@pytest.mark.parametrize("kind", SHOWN)
def test_a_table_of_the_docs_is_read_as_its_kind(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "table.csv"
    file.write_text(SHOWN[kind])
    m = read_measurements(file, 2)
    assert m.kind == kind
    assert len(m) == len(SHOWN[kind].splitlines()) - 1
    assert set(m.conditions) <= {"pose", "other_pose"}
    assert m.residuals > 0


def test_the_far_ends_of_a_table_are_named() -> None:
    m = from_table(pd.read_csv(io.StringIO(SHOWN["distance"])), 2)
    assert kinds()["distance"].point_names(m.arrays) == ["left", "right", "left", "right"]


def test_the_first_row_of_motions_is_no_measurement() -> None:
    m = from_table(pd.read_csv(io.StringIO(SHOWN["relative_pose"])), 2)
    assert m.weight.tolist() == [0.0, 1.0, 1.0]
    assert m.residuals == 2 * 6
    assert m.other is not None
    np.testing.assert_array_equal(m.other[1:], m.q[:-1])


@pytest.mark.parametrize(("row", "weights"), [(2, [0.0, 1.0, 1.0]), (3, [0.0, 0.0, 1.0])])
def test_a_motion_from_a_row_that_is_left_out_does_not_count(row: int, weights: list[float]) -> None:
    """Its other end would be that of the row before: a wrong measurement that nobody sees."""
    lines = SHOWN["relative_pose"].splitlines()
    columns = Columns.of_frame(pd.read_csv(io.StringIO("\n".join([*lines, lines[-1]]))), "made up")
    m = from_columns(columns.without([row], "leave_out"), 2)
    assert m.weight.tolist() == weights


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"plane": ["a", "a", "a", "b", "b"]}, "'a' is touched 3 times; three touches only say where the plane is"),
        ({"plane": ["a", "a", None, "a", "a"]}, "row 4, column 'plane' is empty"),
        ({"sphere": ["a"] * 5}, "column 'radius_mm' is missing; a ball tells nothing of the robot unless"),
        ({"sphere": ["a"] * 5, "radius_mm": [25.4] * 4 + [-1]}, "row 6, column 'radius': -1 mm; a radius must be"),
        ({"sphere": ["a"] * 4 + ["b"], "radius_mm": [25.4] * 5}, "'a' is touched 4 times; touch it at 5 poses"),
        ({"reading_mm": [1.0] * 5, "along_x": [0.0] * 5, "along_y": [0.0] * 5, "along_z": [2.0] * 5}, "length 2;"),
        ({"reading_mm": [1.0] * 5, "dial": ["a", "a", "b", "b", "b"]}, "2 readings of one gauge; its axis and zero"),
        ({"distance_mm": [900.0] * 5, "anchor": ["a", None, "b", "b", "b"]}, "row 3, column 'anchor' is empty"),
        (
            {c: [1.0] * 5 for c in ("dx_mm", "dy_mm", "dz_mm")} | {f"r{c}_deg": [0.0] * 5 for c in "xyz"},
            "row 2: has no row before that it could be relative to",
        ),
    ],
)
def test_what_is_wrong_with_a_table_is_said(columns: dict[str, list[object]], said: str) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        from_table(pd.DataFrame(READINGS).assign(**columns), 2)


@pytest.mark.parametrize("wrong", [(), (4,), (7,)], ids=str)
def test_a_wrong_distance_does_not_move_the_unknown_anchor(wrong: tuple[int, ...]) -> None:
    rng = np.random.default_rng(5)
    p, anchor = rng.uniform(-0.6, 0.6, (10, 3)), np.array([1.5, -0.8, 1.1])
    distance = np.linalg.norm(p - anchor, axis=1) + rng.normal(0, 3e-5, len(p))
    distance[[*wrong]] += 0.3
    errors = kinds()["distance"].errors({"distance": distance}, p, lambda q: q)
    assert [*np.flatnonzero(errors > 1e-3)] == [*wrong]
    assert np.delete(errors, wrong).max() < 1e-4


def test_the_axis_of_a_gauge_is_that_of_its_readings() -> None:
    p, axis = np.random.default_rng(5).uniform(-0.6, 0.6, (10, 3)), np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(kinds()["dial"].start({"reading": p @ axis - 0.7}, p), 10.7 * axis, atol=1e-9)
