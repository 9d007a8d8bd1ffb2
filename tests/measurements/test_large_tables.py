"""Large tables are read by pandas at once, and Parquet by Arrow: what they hold is what the text reader finds."""

import gzip
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from casadical import InputError, read_measurements
from casadical.measurements.raw_table import read_table

PLANAR = Path(__file__).parents[2] / "data" / "planar" / "planar.csv"
LINES = PLANAR.read_text(encoding="utf-8").splitlines()
HEAD, ROWS = LINES[0], LINES[1:]
# Whether the form is read as plain numbers under one line of headings.
FORMS = {
    "plain": (LINES, True),
    "an empty cell": ([*LINES, ROWS[0].rpartition(",")[0] + ","], True),
    "blanks": ([line.replace(",", ", ") for line in LINES], True),
    "decimal commas": ([line.replace(",", ";").replace(".", ",") for line in LINES], False),
    "a title above": (["Measured by a tracker", "", *LINES], False),
    "a blank line": ([*LINES[:9], "", *LINES[9:]], False),
    "a comment": ([*LINES[:9], "# a break", *LINES[9:]], False),
    "headings again": ([*LINES[:9], HEAD, *LINES[9:]], False),
    "numbers alone": ([row.replace("0", "1e1", 1) for row in ROWS], False),
    "headings in a comment": (["# " + HEAD, *ROWS], False),
    "a column without a heading": ([HEAD + ",", *(row + ",1" for row in ROWS)], False),
    "a row of units": ([HEAD.replace("_deg", "").replace("_mm", ""), "deg,deg,mm,mm,mm", *ROWS], False),
    "quoted": ([HEAD, *('"' + row.replace(",", '","') + '"' for row in ROWS)], True),
    "a separator at each end": ([HEAD, *(f"{row}," for row in ROWS)], False),
}


def written(folder: Path, lines: list[str]) -> Path:
    path = folder / "poses.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("form", FORMS)
def test_plain_numbers_read_at_once_are_those_of_the_text(tmp_path: Path, form: str) -> None:
    lines, plain = FORMS[form]
    path = written(tmp_path, lines)
    text, found = read_table(path), read_table(path, keep_text=False)
    assert bool(text.cells)
    assert bool(found.cells) != plain
    assert found.header == text.header
    np.testing.assert_array_equal(found.line, text.line)
    pd.testing.assert_frame_equal(found.frame, text.frame, check_dtype=False)


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (["1" * 200_000, *ROWS], "field larger than field limit"),
        ([*LINES[:36], LINES[36] + ",1", *LINES[37:]], "row 37 has 6 cells, the header 5"),
        ([",".join(f"c{k}" for k in range(2001)), ",".join(["1"] * 2001)], "2001 columns; at most 2000 are read"),
    ],
)
def test_what_is_no_table_is_refused_however_large_it_is(tmp_path: Path, lines: list[str], told: str) -> None:
    for kept in (False, True):
        with pytest.raises(InputError, match=told):
            read_table(written(tmp_path, lines), keep_text=kept)


@pytest.fixture
def frame() -> pd.DataFrame:
    pytest.importorskip("pyarrow")
    return pd.read_csv(PLANAR).assign(weight=np.linspace(0.5, 1.5, 40), temperature_degC=np.linspace(20, 25, 40))


def test_parquet_holds_the_same_poses(tmp_path: Path, frame: pd.DataFrame) -> None:
    frame = pd.concat([frame, frame[3:4]], ignore_index=True).assign(remark="warm")
    frame.to_csv(tmp_path / "a.csv", index=False)
    frame.to_parquet(tmp_path / "a.parquet")
    text, found = (read_measurements(tmp_path / f"a.{form}", 2, sigma_mm=0.03) for form in ("csv", "parquet"))
    for name in ("q", "position", "weight"):
        np.testing.assert_allclose(getattr(found, name), getattr(text, name), rtol=1e-15)
    for name in ("kind", "sigma", "unused", "copies"):
        assert getattr(found, name) == getattr(text, name)
    assert found.copies == (42,)
    np.testing.assert_array_equal(found.row, text.row)
    np.testing.assert_allclose(found.conditions["temperature_degC"], text.conditions["temperature_degC"], rtol=1e-15)


def test_a_wrong_number_of_parquet_is_named_with_its_row(tmp_path: Path, frame: pd.DataFrame) -> None:
    frame.loc[33, "x_mm"] = np.inf
    frame.to_parquet(tmp_path / "table.parquet")
    with pytest.raises(InputError, match=r"table\.parquet: row 35.*x_mm"):
        read_measurements(tmp_path / "table.parquet", 2)


def test_what_is_no_parquet_is_said(tmp_path: Path) -> None:
    arrow, parquet = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
    with pytest.raises(InputError, match="no such file"):
        read_measurements(tmp_path / "none.parquet", 2)
    path, numbers = tmp_path / "poses.parquet", arrow.array([1.0, 2.0])
    path.write_text("q1_deg")
    with pytest.raises(InputError, match=r"poses\.parquet: not a readable table: Parquet.*; write it again"):
        read_measurements(path, 2)
    no_text = arrow.array([b"\xff", b"a"]).view(arrow.string())
    parquet.write_table(arrow.table({"q1_deg": numbers, "note": no_text}), path)
    with pytest.raises(InputError, match=r"poses\.parquet: not a readable table: .*UTF8.*; write it again"):
        read_table(path)
    parquet.write_table(arrow.table([numbers, numbers], ["q1_deg", " q1_deg"]), path)
    with pytest.raises(InputError, match="column 'q1_deg' is there twice; keep one"):
        read_table(path)
    parquet.write_table(arrow.table([numbers[:0]], ["q1_deg"]), path)
    with pytest.raises(InputError, match="no rows; at least one is needed"):
        read_table(path)


def test_notes_for_pandas_and_blanks_in_headings_of_parquet_are_not_needed(tmp_path: Path) -> None:
    arrow, parquet = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
    table = arrow.table([[1.0, 2.0], [3.0, 4.0]], [" q1_deg", "x_mm"])
    cut = '{"columns": [{"name": " q1_deg"}], "index_columns": ["x_mm"]}'
    parquet.write_table(table.replace_schema_metadata({"pandas": cut}), tmp_path / "cut.parquet")
    assert read_table(tmp_path / "cut.parquet").frame.to_dict("list") == {"q1_deg": [1.0, 2.0], "x_mm": [3.0, 4.0]}


@pytest.mark.parametrize("form", ["gzipped", "decimal commas", "carriage returns"])
def test_too_many_numbers_are_refused_before_a_text_is_split(tmp_path: Path, form: str) -> None:
    """Else the quote that is never closed, or the row of one cell, would be found."""
    lines = FORMS[form][0] if form in FORMS else LINES
    quote = "10" if "returns" in form else '"10'
    lines = [*lines, *lines[1:] * 6, quote, *lines[1:] * 50_000]
    text = ("\r" if "returns" in form else "\n").join(lines).encode()
    path = tmp_path / "poses.csv"
    path.write_bytes(gzip.compress(text, 1) if form == "gzipped" else text)
    with pytest.raises(InputError, match=r"poses\.csv: has more than 10000000 numbers; split it, or leave"):
        read_table(path)
