"""Tables of any size, read some rows at a time, are what they are when read at once, and identify the same robot."""

import gzip
import os
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from casadical import InputError, Measurements, identify, read_measurements, read_robot
from casadical.measurements.reading import read_in_portions
from casadical.measurements.table_form import decoded, separator_of
from casadical.measurements.table_parts import USUAL, Portion, read_columns, table_parts

ROOT = Path(__file__).parents[2]
PLANAR = ROOT / "data" / "planar" / "planar.csv"
LINES = PLANAR.read_text(encoding="utf-8").splitlines()
HEAD, ROWS = LINES[0], LINES[1:]
FORMS = {
    "plain": LINES,
    "decimal commas": [line.replace(",", ";").replace(".", ",") for line in LINES],
    "tabs": [line.replace(",", "\t") for line in LINES],
    "title above": ["Measured by a tracker", "", *LINES],
    "a row of units": [
        HEAD.replace("_deg", "").replace("_mm", ""), "deg,deg,mm,mm,mm", *ROWS
    ],
    "comments and blanks": ["# made up", HEAD, *ROWS[:9], "", "# a break", *ROWS[9:25], "", *ROWS[25:]],
    "headings again": [HEAD, *ROWS[:20], HEAD, *ROWS[20:]],
    "quoted": [HEAD, *('"' + row.replace(",", '","') + '"' for row in ROWS)],
}  # fmt: skip


@pytest.fixture(scope="module")
def frame() -> pd.DataFrame:
    return pd.read_csv(PLANAR).assign(weight=np.linspace(0.5, 1.5, 40), temperature_degC=np.linspace(20, 25, 40))


def written(folder: Path, lines: list[str], encoding: str = "utf-8") -> Path:
    path = folder / "poses.csv"
    path.write_text("\n".join(lines) + "\n", encoding=encoding)
    return path


def kept(folder: Path, frame: pd.DataFrame, form: str) -> Path:
    path = folder / f"table.{form}"
    if form == "parquet":
        pytest.importorskip("pyarrow")
        frame.to_parquet(path)
    else:
        frame.to_csv(path, index=False)
    return path


FEW = Portion(300, 7)


def is_mapped(values: np.ndarray) -> bool:
    """Whether an array stands in a file."""
    while values.base is not None and not isinstance(values, np.memmap):
        values = values.base
    return isinstance(values, np.memmap)


def assert_same(found: Measurements, whole: Measurements) -> None:
    for name in ("q", "position", "weight", "row"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))
    for name in ("kind", "sigma", "unused", "copies", "source"):
        assert getattr(found, name) == getattr(whole, name)
    assert found.conditions.keys() == whole.conditions.keys()
    for name, values in whole.conditions.items():
        np.testing.assert_array_equal(found.conditions[name], values)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("size", [150, 700])
def test_parts_are_the_whole(tmp_path: Path, form: str, size: int) -> None:
    path = written(tmp_path, FORMS[form])
    whole = read_measurements(path, 2)
    assert len(whole) == 40
    found = read_in_portions(path, Portion(size, 7), 2)
    assert bool(read_columns(path, Portion(size)).cells) == (form == "quoted")
    assert is_mapped(found.q) == is_mapped(found.position) == (form != "quoted")
    assert_same(found, whole)


@pytest.mark.parametrize("ends", [["\n"] * 20 + ["\r"] * 5 + ["\n"] * 15, ["\r\r\n"] * 40])
def test_rows_are_counted_by_any_end_of_a_line(tmp_path: Path, ends: list[str]) -> None:
    path = tmp_path / "poses.csv"
    path.write_bytes("".join(line + end for line, end in zip(LINES, [*ends, "\n"], strict=True)).encode())
    whole = read_measurements(path, 2)
    assert len(set(whole.row)) == 40
    assert_same(read_in_portions(path, Portion(150, 7), 2), whole)


def test_texts_of_parquet_are_looked_at_with_their_rows(tmp_path: Path) -> None:
    frame = pd.read_csv(PLANAR).assign(remark=[f"pose {k}" for k in range(40)])
    assert len(read_in_portions(kept(tmp_path, frame, "parquet"), Portion(rows=7), 2)) == 40


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp932"])
def test_parts_of_other_encodings_are_the_whole(tmp_path: Path, encoding: str) -> None:
    path = written(tmp_path, ["# 温度", *LINES], encoding)
    found = read_in_portions(path, FEW, 2)
    assert is_mapped(found.q) == (encoding != "cp932")
    assert_same(found, read_measurements(path, 2))


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize("rows", [7, 40])
def test_weights_and_columns_are_those_of_the_whole_table(tmp_path, frame, form, rows):
    whole = read_measurements(kept(tmp_path, frame, "csv"), 2, sigma_mm=0.03)
    path = kept(tmp_path, frame, form)
    found = read_in_portions(path, Portion(100 * rows, rows), 2, sigma_mm=0.03)
    assert is_mapped(found.conditions["temperature_degC"]) == (rows < 40)
    assert found[3:5].source == path.name
    np.testing.assert_array_equal(found.weight, whole.weight)
    np.testing.assert_allclose(found.conditions["temperature_degC"], whole.conditions["temperature_degC"], rtol=1e-15)
    np.testing.assert_allclose(found.position, whole.position, rtol=1e-15)
    np.testing.assert_array_equal(found.row, whole.row)


def test_a_robot_is_identified_without_keeping_data_jacobian_or_residuals(tmp_path, frame):
    robot, path = read_robot(ROOT / "problems" / "planar" / "robot.toml"), kept(tmp_path, frame, "csv")
    usual = identify(robot, read_measurements(path, 2), method="KM")
    found = identify(robot, read_in_portions(path, Portion(700, 7), 2), method="KM")
    (poses,) = found.measurements
    assert is_mapped(poses.q)
    problem = replace(found.problem, most_kept=0)
    assert problem.names == usual.names
    v = problem.solve().v
    assert problem.kept.sums.answer.residuals is None
    np.testing.assert_allclose(v, usual.solution.v, atol=1e-6)
    assert problem.variance(v, trimmed=True) == pytest.approx(usual.variance, rel=1e-9)
    np.testing.assert_allclose(problem.covariance(v, usual.variance), usual.covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(problem.residuals(v)[0], usual.problem.residuals(usual.solution.v)[0], atol=1e-4)


def test_a_word_in_a_later_part_is_named_with_its_row(tmp_path: Path) -> None:
    path = written(tmp_path, [HEAD, *ROWS[:30], "lost" + ROWS[30][ROWS[30].index(",") :], *ROWS[31:]])
    with pytest.raises(InputError, match=r"row 32, column 'q1_deg': .*lost.* is not a finite number"):
        read_in_portions(path, FEW, 2)


def test_a_wrong_number_of_parquet_is_named_with_its_row(tmp_path, frame):
    frame = frame.copy()
    frame.loc[33, "x_mm"] = np.inf
    with pytest.raises(InputError, match=r"table\.parquet: row 35.*x_mm"):
        read_in_portions(kept(tmp_path, frame, "parquet"), Portion(rows=10), 2)


def test_a_copy_of_a_row_of_an_earlier_part_counts_once(tmp_path: Path) -> None:
    path = written(tmp_path, [*LINES, ROWS[0], ROWS[7]])
    found = read_in_portions(path, FEW, 2)
    assert (len(found), found.copies) == (40, (42, 43))
    assert is_mapped(found.q)
    assert_same(found, read_measurements(path, 2))


def test_a_row_with_more_cells_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="row 37 has 6 cells, the header 5"):
        read_in_portions(written(tmp_path, [*LINES[:36], LINES[36] + ",1", *LINES[37:]]), FEW, 2)


WORDS = [f"{row},{'A' if k % 2 else 'B'}" for k, row in enumerate(ROWS)]


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("tool", WORDS),
        ("session", WORDS),
        ("remark", [f"{row},{'' if k < 30 else 'warm'}" for k, row in enumerate(ROWS)]),
    ],
)
def test_what_only_the_whole_table_tells_is_read_at_once(tmp_path, name, rows):
    path = written(tmp_path, [f"{HEAD},{name}", *rows])
    assert_same(read_in_portions(path, FEW, 2), read_measurements(path, 2))


def test_a_column_that_is_empty_in_later_parts_is_refused_as_at_once(tmp_path):
    path = written(tmp_path, [f"{HEAD},load_n", *(f"{row},{k if k < 30 else ''}" for k, row in enumerate(ROWS))])
    refused = r"row 32, column 'load_n': an empty cell is not a finite number \(10 such"
    with pytest.raises(InputError, match=refused):
        read_measurements(path, 2)
    with pytest.raises(InputError, match="row 3[2-9], column 'load_n'|" + refused):
        read_in_portions(path, Portion(150), 2)


def test_points_touched_in_several_parts_are_the_same_points(tmp_path: Path) -> None:
    rows = [",".join(row.split(",")[:2]) + f",{'ABCDEFGHIJ'[k % 10]}" for k, row in enumerate(ROWS)]
    path = written(tmp_path, ["q1_deg,q2_deg,point", *rows])
    assert read_in_portions(path, FEW, 2).label.tolist() == read_measurements(path, 2).label.tolist()


@pytest.mark.parametrize("slow", [0, 20])
def test_angles_in_another_unit_are_told_by_all_rows(tmp_path, slow):
    """A part in which the robot hardly moves is no fault."""
    cells = [row.split(",") for row in ROWS]
    still = [",".join([f"{10 + 0.01 * k:.4f}", f"{20 - 0.01 * k:.4f}", *c[2:]]) for k, c in enumerate(cells)]
    path = written(tmp_path, [HEAD, *still[:20], *(ROWS[20:] if slow else still[20:])])
    if slow:
        assert len(read_in_portions(path, Portion(600), 2)) == 40
    else:
        with pytest.raises(InputError, match=r"no joint moves by more than 0\.39 deg over 40 poses"):
            read_in_portions(path, Portion(600), 2)


def test_no_file_and_no_parquet(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    with pytest.raises(InputError, match="no such file"):
        read_measurements(tmp_path / "none.parquet", 2)
    os.mkfifo(tmp_path / "pipe.parquet")  # nobody writes to it
    with pytest.raises(InputError, match=r"pipe\.parquet: is a pipe or a socket; name a file"):
        read_measurements(tmp_path / "pipe.parquet", 2)
    broken = tmp_path / "broken.parquet"
    broken.write_text("q1_deg")
    with pytest.raises(InputError, match=r"broken\.parquet: not a readable table: Parquet.*; write it again"):
        read_measurements(broken, 2)


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (["\n" * 50], "it is empty"),
        (["1" * 200_000, *ROWS], "field larger than field limit"),
        ([HEAD], "a header but no rows"),
    ],
)
def test_what_is_no_table_is_refused_in_parts_as_at_once(tmp_path, lines, told) -> None:
    path = written(tmp_path, lines)
    for portion in (USUAL, Portion(20)):
        with pytest.raises(InputError, match=told):
            read_columns(path, portion)


def test_notes_for_pandas_in_a_parquet_file_are_not_needed(tmp_path: Path) -> None:
    arrow, parquet = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
    table = arrow.table({"q1_deg": [1.0, 2.0], "x_mm": [3.0, 4.0]})
    cut = '{"columns": [{"name": "q1_deg"}], "index_columns": ["x_mm"]}'
    parquet.write_table(table.replace_schema_metadata({"pandas": cut}), tmp_path / "cut.parquet")
    (part,) = table_parts(tmp_path / "cut.parquet")
    assert part.frame.to_dict("list") == {"q1_deg": [1.0, 2.0], "x_mm": [3.0, 4.0]}


@pytest.mark.parametrize("form", ["coded", "plain"])
def test_a_small_file_of_large_texts_is_refused_before_they_are_made(tmp_path, form):
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path, texts = tmp_path / "poses.parquet", pyarrow.array(["x" * 500_000] * 100 + [None])
    texts = texts.dictionary_encode() if form == "coded" else texts

    def write(times: int) -> None:
        columns = {"q1_deg": pyarrow.array([1.0] * 101), "remark": texts}
        table = pyarrow.table({name: pyarrow.chunked_array([cells] * times) for name, cells in columns.items()})
        parquet.write_table(table, path, compression="zstd")

    write(11)
    assert path.stat().st_size < 30_000
    with pytest.raises(InputError, match=r"poses\.parquet: its texts have more than 500000000 bytes; leave columns"):
        read_columns(path)
    write(1)
    assert read_columns(path).frame.shape == (101, 2)


def test_parts_of_comments_alone_are_no_rows(tmp_path: Path) -> None:
    comments = ["# made up"] * 50
    path = written(tmp_path, [*comments, *LINES[:20], *comments, *LINES[20:], *comments])
    assert_same(read_in_portions(path, FEW, 2), read_measurements(path, 2))
    with pytest.raises(InputError, match="at least one row is needed"):
        read_in_portions(written(tmp_path, [*comments, *comments]), FEW, 2)


def test_too_many_columns_are_refused_before_they_are_parsed(tmp_path, monkeypatch):
    monkeypatch.setattr(pd, "read_csv", None)
    path = written(tmp_path, [",".join(f"c{k}" for k in range(2001)), ",".join(["1"] * 2001)])
    with pytest.raises(InputError, match="has 2001 columns; at most 2000 are read"):
        read_measurements(path, 2)


def test_texts_and_headings_of_parquet_that_pandas_reads_otherwise(tmp_path: Path) -> None:
    arrow, parquet = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
    path, numbers = tmp_path / "poses.parquet", arrow.array([1.0, 2.0])
    no_text = arrow.array([b"\xff", b"a"]).view(arrow.string())
    parquet.write_table(arrow.table({"q1_deg": numbers, "note": no_text}), path)
    with pytest.raises(InputError, match=r"poses\.parquet: not a readable table: .*UTF8.*; write it again"):
        read_columns(path)
    parquet.write_table(arrow.table([numbers, numbers], ["q1_deg", " q1_deg"]), path)
    with pytest.raises(InputError, match="column 'q1_deg' is there twice; keep one"):
        read_columns(path)
    parquet.write_table(arrow.table([numbers], [" q1_deg"]), path)
    raw = read_columns(path)
    assert raw.header == tuple(raw.frame) == ("q1_deg",)


@pytest.mark.parametrize("form", ["gzipped", "decimal commas", "carriage returns"])
def test_too_many_numbers_are_refused_before_a_text_is_split(tmp_path, form):
    """Else the quote that is never closed, or the row of one cell, would be found."""
    path, lines = tmp_path / "poses.csv", FORMS.get(form, LINES)
    quote = "10" if "returns" in form else '"10'
    lines = [*lines, *lines[1:] * 6, quote, *lines[1:] * 50_000]
    text = ("\r" if "returns" in form else "\n").join(lines).encode()
    path.write_bytes(gzip.compress(text, 1) if form == "gzipped" else text)
    with pytest.raises(InputError, match=r"poses\.csv: has more than 10000000 numbers; split it.*; of a CSV in UTF-8"):
        read_columns(path)


def test_a_separator_is_told_from_the_head_of_a_long_text() -> None:
    text = "10,20,500\n" * 500_000
    tracemalloc.start()
    assert separator_of(text) == ","
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6


def test_an_encoding_of_one_country_is_told_without_a_copy_for_each() -> None:
    data = ("x,y\n" + "\u00a5\u00b1,1\n" * 100_000).encode("cp1252")
    tracemalloc.start()
    assert decoded(data)[1] == "cp1252"
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * len(data)
