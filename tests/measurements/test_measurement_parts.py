"""How a table is told to be written, what noise may be, and which unit a distance is taken for."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from casadical import Measurements, read_measurements
from casadical.core.basics import InputError
from casadical.measurements.columns import Columns, Source
from casadical.measurements.kinds.distance import distance_fault
from casadical.measurements.measurements import Noise
from casadical.measurements.raw_table import read_table
from casadical.measurements.reading import refuse_shared_rows
from casadical.measurements.table_form import Form, decoded


def test_a_separation_is_kept_only_with_both_its_points() -> None:
    m = Measurements(q=np.zeros((4, 2)), kind="contact", label=np.array(list("ABBC"), dtype=object))
    m = m.with_separations([("A", "B", 0.1), ("C", "B", 0.2)])
    assert m.residuals == 3 * 4 + 2
    assert m[1:].separations == (("C", "B", 0.2),)
    assert m[:3].separations == (("A", "B", 0.1),)
    assert m[[0, 3]].separations == ()


@pytest.mark.parametrize(("sigma", "repeatability"), [(0.0, 0.0), (-1e-5, 0.0), (1e-5, -1e-6), (0.0, 1e-5)])
def test_noise_that_cannot_be_is_refused(sigma: float, repeatability: float) -> None:
    with pytest.raises(InputError, match="allowed: above zero, and zero or more"):
        Noise(sigma, repeatability)
    assert Noise(1e-5, 0.0).sigma == 1e-5


@pytest.mark.parametrize(("times", "word"), [(100.0, ""), (101.0, "distance_mm"), (0.0101, ""), (0.0099, "distance_m")])
def test_a_distance_of_another_unit_is_told_by_a_factor_beyond_a_hundred(times: float, word: str) -> None:
    p = np.zeros((5, 3))
    far = np.tile([0.0, 0.0, 1.0], (5, 1))
    told = distance_fault({"distance": np.full(5, times)}, p, far, 1.5)
    assert told.endswith(f"should the column be named {word}?") if word else told == ""


def test_the_form_of_a_table_in_words() -> None:
    text = Form("cp1252", ";", ",", 3, ("deg", "mm"), ((1, "title"), (2, "")))
    assert text.words == (
        "cp1252, semicolons, decimal commas, headings in line 3, a row of units, 2 other lines skipped"
    )
    assert Form(header_line=0).words == "utf-8, commas, decimal points, no headings"
    assert (
        Form(sheet="Messung", skipped=((1, "x"),)).words == "sheet 'Messung', headings in line 1, 1 other line skipped"
    )


@pytest.mark.parametrize("order", ["le", "be"])
@pytest.mark.parametrize("text", ["q1_deg,x_mm\n1,2\n", "\u4e00" * 40 + "a" * 80, "x" * 400 + "\u4e00" * 300])
def test_utf_16_without_its_mark_is_told_by_where_the_zeros_are(order: str, text: str) -> None:
    # Letters have a zero as their high byte; a few signs, as the Chinese one, have one as their low byte.
    assert decoded(text.encode(f"utf-16-{order}")) == (text, f"utf-16-{order}")


@pytest.mark.parametrize(("name", "least", "most"), [("temperature_degC", -273.15, 200.0), ("payload_kg", 0.0, 1e5)])
def test_what_cannot_be_logged_is_refused(tmp_path: Path, name: str, least: float, most: float) -> None:
    """Colder than all, and heavier than any arm lifts."""
    table = pd.DataFrame({"q1_deg": [1.0, 2.0], "x_mm": [0.0, 1.0], "y_mm": [0.0, 1.0], "z_mm": [0.0, 1.0]})
    table.assign(**{name: [least, most]}).to_csv(tmp_path / "a.csv", index=False)
    assert len(read_measurements(tmp_path / "a.csv", 1)) == 2
    for far in (least - 0.01, 1.001 * most):
        table.assign(**{name: [20.0, far]}).to_csv(tmp_path / "a.csv", index=False)
        with pytest.raises(InputError, match=f"row 3, column '{name}'"):
            read_measurements(tmp_path / "a.csv", 1)


def test_a_column_may_be_added_to_itself():
    table = pd.DataFrame({"q1_deg": [10.0, -20.0], "q2_deg": [1.0, 2.0]})
    source = Source("q1_deg", times=2.0, add={"q1_deg": -0.5, "q2_deg": 1.0})
    columns = Columns.of_frame(table, "made up").mapped({"q1_deg": source})
    assert columns.column("q1_deg").tolist() == [16.0, -28.0]


@pytest.mark.parametrize("kind", ["position", "contact"])
def test_tables_that_share_half_of_their_poses_are_refused(kind):
    q = np.arange(24.0).reshape(8, 3) / 10
    seen = {"position": q + 1} if kind == "position" else {"label": np.array(["a", "b"] * 4)}

    def part(rows):
        return Measurements(q[rows], kind, source=f"{rows[0]}.csv", **{name: v[rows] for name, v in seen.items()})

    refuse_shared_rows([part([0, 1, 2, 3]), part([4, 5, 6]), part([7, 0])][:2])
    for other in ([0, 1, 2, 3], [7, 0], [5, 6, 2, 3, 7]):
        with pytest.raises(InputError, match=r"poses are in 0\.csv, too; a pose counts once: take one"):
            refuse_shared_rows([part([0, 1, 2, 3]), part(other)])
    if kind == "contact":  # another point at the same readings is another pose
        refuse_shared_rows([part([0, 1]), Measurements(q[:2], kind, label=np.array(["b", "a"]))])


def test_a_control_character_in_a_heading_is_refused(tmp_path):
    (tmp_path / "poses.csv").write_text("q1_deg,x\x1b[31m_mm\n1,2\n")
    with pytest.raises(InputError, match=r"poses\.csv: the heading of column 2 holds the control character '\\x1b'"):
        read_measurements(tmp_path / "poses.csv", 1)


def test_an_infinite_cell_is_named_as_it_stands(tmp_path):
    (tmp_path / "poses.csv").write_text("q1_deg,x_mm,y_mm,z_mm\n1,2,3,4\n2,inf,3,4\n3,2,3,4\n")
    with pytest.raises(InputError, match=r"row 3, column 'x_mm': inf is not a finite number"):
        read_measurements(tmp_path / "poses.csv", 1)


def test_a_column_without_a_cell_is_there_but_empty(tmp_path):
    (tmp_path / "poses.csv").write_text("q1_deg,q2_deg,x_mm,y_mm,z_mm\n,1,2,3,4\nnan,5,2,3,5\n")
    with pytest.raises(InputError, match=r"^poses\.csv: column q1_deg is empty; each of its rows needs a number$"):
        read_measurements(tmp_path / "poses.csv", 2)
    with pytest.raises(InputError, match="column q1_deg is empty"):
        Columns.of_file(read_table(tmp_path / "poses.csv")).si("q1", ["_deg", "_rad"])
