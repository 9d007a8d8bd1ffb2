"""Tables read some rows at a time are what they are when read at once, and identify the same robot."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from casadical import InputError, identify, read_large, read_measurements, read_robot
from casadical.identification import least_squares, residuals
from casadical.measurements import large_tables

ROOT = Path(__file__).parents[2]
PLANAR = ROOT / "data" / "planar" / "planar.csv"


def kept(folder: Path, frame: pd.DataFrame, form: str) -> Path:
    path = folder / f"table.{form}"
    if form == "parquet":
        pytest.importorskip("pyarrow")
        frame.to_parquet(path)
    else:
        frame.to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def frame() -> pd.DataFrame:
    return pd.read_csv(PLANAR).assign(weight=np.linspace(0.5, 1.5, 40), temperature_c=np.linspace(20, 25, 40))


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize("rows", [7, 40, 1000])
def test_the_numbers_are_those_of_the_whole_table(tmp_path: Path, frame: pd.DataFrame, form: str, rows: int) -> None:
    path = kept(tmp_path, frame, form)
    found = read_large(path, 2, rows=rows, sigma_mm=0.03)
    whole = read_measurements(kept(tmp_path, frame, "csv"), 2, sigma_mm=0.03)
    for name in ("q", "position", "weight", "row"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))
    assert (found.kind, found.sigma, found.unused) == (whole.kind, whole.sigma, whole.unused)
    assert found.conditions.keys() == whole.conditions.keys()
    np.testing.assert_array_equal(found.conditions["temperature_c"], whole.conditions["temperature_c"])
    assert found[3:5].source == str(path)


def test_a_robot_is_identified_without_keeping_data_jacobian_or_residuals(
    tmp_path: Path, frame: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, path = read_robot(ROOT / "problems" / "planar" / "robot.toml"), kept(tmp_path, frame, "csv")
    usual = identify(robot, read_measurements(path, 2), method="KM")
    monkeypatch.setattr(residuals, "HELD", 10)
    monkeypatch.setattr(residuals, "CHUNK", 16)
    monkeypatch.setattr(least_squares, "KEPT", 0)
    found = identify(robot, read_large(path, 2, rows=16), method="KM")
    assert found.names == usual.names
    assert found.problem._last_sums.answer.residuals is None
    np.testing.assert_allclose(found.solution.v, usual.solution.v, atol=1e-6)
    np.testing.assert_allclose(found.standard_errors, usual.standard_errors, rtol=1e-6)
    assert found.variance == pytest.approx(usual.variance, rel=1e-9)
    again = found.problem.residuals(found.solution.v)
    np.testing.assert_allclose(again[0], usual.problem.residuals(usual.solution.v)[0], atol=1e-4)


def test_a_wrong_row_is_named_as_in_the_file(tmp_path: Path, frame: pd.DataFrame) -> None:
    frame = frame.copy()
    frame.loc[33, "x_mm"] = np.inf
    with pytest.raises(InputError, match=r"table\.csv: row 35.*x_mm"):
        read_large(kept(tmp_path, frame, "csv"), 2, rows=10)


def test_copies_are_counted_once_within_the_rows_read_at_a_time(tmp_path: Path, frame: pd.DataFrame) -> None:
    doubled = pd.concat([frame.iloc[:10], frame.iloc[9:]])
    found = read_large(kept(tmp_path, doubled, "csv"), 2, rows=20)
    assert (len(found), found.copies) == (40, (12,))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not a readable table"),
        ("q1_deg,q2_deg,x_mm,y_mm,z_mm\n", "no rows; at least one is needed"),
        ("q1_deg,q2_deg,x_mm,y_mm,z_mm\n1,2,3,4,5\n1,2,3,4,5,6,7\n", "not a readable table"),
        ("q1_deg,q2_deg,point\n1,2,A\n3,4,A\n", "points are compared with others; use read_measurements"),
        ("q1_deg,q2_deg,x_mm,y_mm,z_mm,payload_kg\n1,2,3,4,5,6\n1,3,3,4,5,\n", "payload_kg"),
    ],
)
def test_what_is_no_such_table_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_large(path, 2, rows=1 if "payload" in text else large_tables.ROWS)


def test_no_file_and_no_parquet(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    with pytest.raises(InputError, match="No such file"):
        read_large(tmp_path / "none.csv", 2)
    broken = tmp_path / "broken.parquet"
    broken.write_text("q1_deg")
    with pytest.raises(InputError, match=r"broken\.parquet: not a readable table: Parquet"):
        read_large(broken, 2)
