"""Large tables, read some lines at a time, give what they give when read at once."""

from pathlib import Path

import numpy as np
import pytest

from casadical import InputError, read_measurements
from casadical.measurements import table_parts

ROOT = Path(__file__).parents[2]
LINES = (ROOT / "data" / "planar" / "planar.csv").read_text(encoding="utf-8").splitlines()
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


def written(folder: Path, lines: list[str]) -> Path:
    path = folder / "poses.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("size", [150, 700])
def test_parts_are_the_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str, size: int) -> None:
    path = written(tmp_path, FORMS[form])
    whole = read_measurements(path, 2)
    assert len(whole) == 40
    monkeypatch.setattr(table_parts, "SIZE", size)
    found = read_measurements(path, 2)
    assert bool(table_parts.read_columns(path).rest) == (form != "quoted")
    for name in ("q", "position", "row"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))
    assert (found.kind, found.unused, found.source) == (whole.kind, whole.unused, whole.source)


def test_a_word_in_a_later_part_is_named_with_its_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_parts, "SIZE", 300)
    path = written(tmp_path, [HEAD, *ROWS[:30], "lost" + ROWS[30][ROWS[30].index(",") :], *ROWS[31:]])
    with pytest.raises(InputError, match=r"row 32, column 'q1_deg': .*lost.* is not a finite number"):
        read_measurements(path, 2)


def test_a_copy_of_a_row_of_an_earlier_part_counts_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_parts, "SIZE", 300)
    assert read_measurements(written(tmp_path, [*LINES, ROWS[0]]), 2).copies == (42,)


def test_a_row_with_more_cells_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_parts, "SIZE", 300)
    with pytest.raises(InputError, match="row 37 has 6 cells, the header 5"):
        read_measurements(written(tmp_path, [*LINES[:36], LINES[36] + ",1", *LINES[37:]]), 2)
