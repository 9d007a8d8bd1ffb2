"""Foreign tables: form, headings and units; what is unsure is a question, what is written is what was measured."""

from pathlib import Path

import first_hour
import numpy as np
import pytest

from casadical import InputError, read_measurements
from casadical.measurements.columns import Columns, Source
from casadical.measurements.headings import _meaning, words_of
from casadical.measurements.proposals import understand
from casadical.measurements.raw_table import read_table
from casadical.measurements.vocabulary import WORDS

SIX = ["revolute"] * 6


@pytest.mark.parametrize("name", [name for name in first_hour.TABLES if name != "misure.csv"])
def test_a_foreign_table_reads_as_it_was_measured(name: str, tmp_path: Path) -> None:
    q, p = first_hour.measured(40)
    m = read_measurements(first_hour.write(tmp_path, name, q, p), 6)
    assert m.position is not None
    assert np.abs(np.rad2deg(m.q) - q).max() < 1e-4
    assert np.abs(1e3 * m.position - p).max() < 1e-4


def test_numbered_columns_in_unknown_words_leave_a_question(tmp_path: Path) -> None:
    path = first_hour.write(tmp_path, "misure.csv", *first_hour.measured(40))
    found = understand(read_table(path), SIX)
    assert [q.text for q in found.questions] == ["Are these the joint readings?"]
    assert {ours: source.name for ours, source in found.sources.items() if ours.startswith("q")} == {
        f"q{k}_deg": f"Asse {k} [gradi]" for k in range(1, 7)
    }
    with pytest.raises(InputError, match="Are these the joint readings"):
        read_measurements(path, 6)
    path.write_bytes(path.read_bytes().replace(b"Asse 6", b"Asse 8"))
    assert not understand(read_table(path), SIX).questions


def test_rows_count_as_in_the_file(tmp_path: Path) -> None:
    """Titles, units and comments included."""
    q, p = first_hour.measured(12)
    raw = read_table(first_hour.write(tmp_path, "messung.csv", q, p))
    assert raw.form.header_line == 4
    assert raw.line == tuple(range(5, 17))
    assert raw.form.words == "cp1252, semicolons, decimal commas, headings in line 4, 2 other lines skipped"
    for name, first, words in (
        ("einheiten.csv", 3, "utf-16, semicolons, decimal commas, headings in line 1, a row of units"),
        ("poses.xlsx", 4, "sheet 'Poses', headings in line 3, 1 other line skipped"),
        ("no_headings.csv", 1, "utf-8, commas, decimal points, no headings"),
    ):
        raw = read_table(first_hour.write(tmp_path, name, q, p))
        assert (raw.line[0], raw.form.words) == (first, words)


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("a;b\n1.234,5;2\n3,25;4\n", (1234.5, 3.25)),  # points set off thousands
        ('a,b\n"1,234.5",2\n3.25,4\n', (1234.5, 3.25)),  # commas do
        ("a\tb\n１２，５\t2\n−3,25\t4\n", (12.5, -3.25)),  # digits of full width, the sign of typography
        ("a|b\n1.5|2\n3.25|4\n\n", (1.5, 3.25)),
        ("a;b;\n1,5;2;\n3,25;4;\n", (1.5, 3.25)),  # a separator at the end of each line
    ],
)
def test_decimal_signs_and_separators(text: str, numbers: tuple[float, float], tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(text, encoding="utf-8")
    assert tuple(read_table(path).frame["a"]) == numbers


@pytest.mark.parametrize(
    ("heading", "words", "unit"),
    [
        ("Achse 1 [°]", ["achse", "1"], "°"),
        ("JointAngle3 (rad)", ["joint", "angle", "3"], "rad"),
        ("第2軸(度)", ["第", "2", "軸"], "度"),
        ("x_inch", ["x"], "inch"),
        ("Position Y in mm", ["position", "y"], "mm"),
        ("m", ["m"], ""),
    ],
)
def test_words_and_unit_of_a_heading(heading: str, words: list[str], unit: str) -> None:
    assert words_of(heading) == (words, unit)


def few(tmp_path: Path, positions: str = "1,2,3") -> Path:
    """Three poses whose numbers tell no unit."""
    path = tmp_path / "few.csv"
    rows = [f"{k / 10},{k / 5},{positions.replace('1', str(k))}" for k in (1, 2, 4)]
    path.write_text("\n".join(["A1,A2,X,Y,Z", *rows]) + "\n")
    return path


def test_what_the_numbers_do_not_tell_is_a_question(tmp_path: Path) -> None:
    found = understand(read_table(few(tmp_path)), ["revolute"] * 2)
    assert [q.text for q in found.questions] == ["In which unit are A1, A2?", "In which unit are X, Y, Z?"]
    assert [list(q.choices) for q in found.questions] == [["rad", "deg"], ["m", "mm"]]
    assert list(found.sources) == ["q1_rad", "q2_rad", "x_m", "y_m", "z_m"]
    answered = found.answered(found.questions[0], "deg")
    assert list(answered.sources) == ["q1_deg", "q2_deg", "x_m", "y_m", "z_m"]
    with pytest.raises(InputError, match=r"few\.csv: In which unit are A1, A2\? Allowed: rad; deg\. Say it in"):
        read_measurements(few(tmp_path), 2)
    said = {"q1_deg": "A1", "q2_deg": "A2", "x_mm": "X", "y_mm": "Y", "z_mm": "Z"}
    assert read_measurements(few(tmp_path), 2, columns=said).q[0, 0] == pytest.approx(np.deg2rad(0.1))


def test_two_groups_of_joints_are_a_question_and_deviations_none(tmp_path: Path) -> None:
    q, p = first_hour.measured(20)
    names = [f"{w}{k} [deg]" for w in "AJ" for k in range(1, 7)] + ["X mm", "Y mm", "Z mm", "dX mm", "Abw. X mm"]
    path = tmp_path / "two.csv"
    path.write_text(first_hour.table(names, np.column_stack([q, q]), np.column_stack([p, p[:, :2]])))
    (question,) = understand(read_table(path), SIX).questions
    assert question.text == "Which columns are the joint readings?"
    assert len(question.choices) == 2
    assert {c.source.name for way in question.choices.values() for c in way} == set(names[:12])


def test_a_condition_with_its_unit_is_taken_beside_our_own_names(tmp_path: Path) -> None:
    """A word without a unit is not: what `temperature` holds there nobody said."""
    names = [*(f"q{k}_deg" for k in range(1, 7)), "x_mm", "y_mm", "z_mm", "Traglast [kg]", "temperature"]
    path = tmp_path / "t.csv"
    path.write_text("\n".join([",".join(names), *(",".join([str(k)] * 10 + ["20"]) for k in range(5))]))
    m = read_measurements(path, 6)
    assert m.conditions["payload_kg"].tolist() == [0, 1, 2, 3, 4]
    assert "temperature_degC" not in m.conditions
    path.write_text(path.read_text().replace("x_mm,y_mm,z_mm", "X [mm],Y [mm],Z [mm]"))  # names are foreign here
    assert read_measurements(path, 6).conditions["temperature_degC"].tolist() == [20] * 5


def test_a_column_is_made_as_its_source_says(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("A1,A2,X,Y,Z\n10,1,5,6,7\n20,2,8,9,10\n30,3,11,12,13\n")
    mapped = Columns.of_file(read_table(path)).mapped(
        {
            "q1_deg": Source("A1", times=-1.0, plus=90.0),
            "q2_deg": Source("A2", add={"A1": 0.5}),
            "x_mm": Source("X", times=25.4, rows=1),
        }
    )
    # x of the row after: the last row has none and is left out.
    assert mapped.row.tolist() == [2, 3]
    assert mapped.column("q1_deg").tolist() == [80.0, 70.0]
    assert mapped.column("q2_deg").tolist() == [6.0, 12.0]
    assert mapped.column("x_mm").tolist() == pytest.approx([8 * 25.4, 11 * 25.4])


def test_a_wrong_unit_in_a_heading_of_ours_is_renamed(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("q1_deg,x_mm,y_mm,z_mm\n0.5,5,6,7\n0.7,8,9,10\n")
    assert read_measurements(path, 1, columns={"q1_rad": "q1_deg"}).q.ravel().tolist() == [0.5, 0.7]
    path.write_text(path.read_text().replace("z_mm", "z_cm"))  # which is read as it says
    np.testing.assert_allclose(read_measurements(path, 1).position, [[0.005, 0.006, 0.07], [0.008, 0.009, 0.1]])


def test_files_that_are_no_tables_are_refused(tmp_path: Path) -> None:
    (tmp_path / "old.xls").write_bytes(bytes.fromhex("d0cf11e0a1b11ae1") + bytes(600))
    (tmp_path / "broken.xlsx").write_bytes(b"PK\x03\x04" + bytes(600))
    with pytest.raises(InputError, match=r"old\.xls: a workbook of the old format; save it as \.xlsx or as CSV"):
        read_table(tmp_path / "old.xls")
    with pytest.raises(InputError, match=r"broken\.xlsx: not a readable workbook"):
        read_table(tmp_path / "broken.xlsx")


def test_a_heading_with_a_joints_name_leaves_the_words_that_mean_nothing() -> None:
    for filler in sorted(WORDS["filler"] | WORDS["joint"]):
        words = ["shoulder", "wibble", filler]
        assert _meaning(words, {*words}, [(["shoulder"], "2")]) == ("joint", "2", {"by name", "wibble"})


ANGLES = "J1 [deg],X [mm],Y [mm],Z [mm],Roll [deg],Pitch [deg],Yaw [deg]"


@pytest.mark.parametrize(("kind", "turned"), [(None, True), ("pose", True), ("position", False)])
def test_angles_are_read_unless_positions_alone_are_declared(kind: str | None, turned: bool, tmp_path: Path) -> None:
    rows = np.random.default_rng(0).uniform(-40, 40, (8, 7)) + np.array([0, 500, 0, 300, 0, 0, 0])
    (tmp_path / "a.csv").write_text("\n".join([ANGLES, *(",".join(f"{v:.3f}" for v in row) for row in rows)]))
    found = understand(read_table(tmp_path / "a.csv"), ["revolute"], kind=kind)
    ways = [found.columns, *(way for question in found.questions for way in question.choices.values())]
    assert any(c.source.name == "Roll [deg]" for way in ways for c in way) is turned


def test_a_length_of_a_wire_is_what_was_measured(tmp_path: Path) -> None:
    rows = "\n".join(f"{10 * k},{500 + 7 * k}" for k in range(8))
    (tmp_path / "a.csv").write_text(f"J1 [deg],Distance [mm]\n{rows}\n")
    found = understand(read_table(tmp_path / "a.csv"), ["revolute"])
    ways = [found.columns, *(way for question in found.questions for way in question.choices.values())]
    assert any(c.source.name == "Distance [mm]" for way in ways for c in way)
