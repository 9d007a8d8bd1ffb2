"""Every fault of a robot or problem file is answered with file, key, value and what is allowed."""

from pathlib import Path

import pytest

from casadical import InputError
from casadical.project.problem import read_problem
from casadical.robot.robot_file import read_robot

GOOD = """
casadical = 1
name = "two joints"

[tool]
xyz_mm = [10, 0, 0]

[[joint]]
d_mm = 100
limits_deg = [-170, 170]

[[joint]]
a_mm = 300
"""


def row2(keys: str) -> tuple[str, str]:
    """Other keys in row 2."""
    return "a_mm = 300", keys


def before_tool(text: str) -> tuple[str, str]:
    return "[tool]", f"{text}\n[tool]"


def loop(driven: int, carrier: int, crank: float) -> tuple[str, str]:
    bars = f"crank_mm = {crank}\ncoupler_mm = 300\nrocker_mm = 100"
    return "", f"\n[[four_bar]]\ndriven = {driven}\ncarrier = {carrier}\n{bars}\n"


# What is changed or added, and what the message must then hold besides the file's name.
FAULTS = {
    "text for a number": (row2('a_mm = "300"'), ["joint[2].a_mm = '300'", "must be a valid number"]),
    "larger than any number": (row2("a_mm = 1e300"), ["joint[2].a_mm = 1e+300", "finite numbers up to 1e+100"]),
    "longer than any arm": (row2("a_mm = 1e12"), ["joint[2].a_mm = 1000000000000", "allowed: at most 1e+07"]),
    "twists in radians under a name of degrees": (
        ("d_mm = 100", "alpha_deg = -1.5708\n[[joint]]\nalpha_deg = 3.142\n[[joint]]\nalpha_deg = 0"),
        ["joint[1].alpha_deg = -1.5708", "looks like radians", "alpha_rad"],
    ),
    "no unit": (row2("a = 0.3"), ["joint[2].a = 0.3", "a_mm or a_m"]),
    "an angle's unit on a length": (row2("a_deg = 3"), ["joint[2].a_deg = 3", "unknown key", "a_mm"]),
    "two units": (row2("a_mm = 300\na_m = 0.3"), ["joint[2].a_m = 0.3", "given twice"]),
    "a slip of the pen": (row2("alhpa_deg = 9"), ["joint[2].alhpa_deg = 9", "is alpha_deg meant?", "theta_deg"]),
    "a version that is true": (("casadical = 1", "casadical = true"), ["casadical = true", "must be 1 or 2"]),
    "a date for a number": (row2("a_mm = 2026-01-01"), ["joint[2].a_mm = 2026-01-01: must be a valid"]),
    "a list for a table": (before_tool("base = [3]"), ["base = [3]: must be a table"]),
    "gravity in millimetres": (
        before_tool("[gravity]\nvector_m_per_s2 = [0, 0, -9810]"),
        ["gravity.vector_m_per_s2 = [0, 0, -9810]", "at most 30 m/s2"],
    ),
    "a stiffness of what is not compliant": (
        row2("a_mm = 300\nstiffness_Nm_per_rad = 2e5\ncompliant = false"),
        ["joint[2].compliant = false", "leave one of the two out"],
    ),
    "a gain that drives away, a clock that none has": (
        before_tool("[drive]\nkp_Nm_per_rad = [1, -5]\nlog_rate_Hz = 1e99"),
        ["drive.kp_Nm_per_rad[2] = -5: must be greater than or equal to 0", "log_rate_Hz = 1e+99: must be less than"],
    ),
    "a gain for one joint too many": (
        before_tool("[drive]\nkp_Nm_per_rad = [1, 2, 3]"),
        ["drive.kp_Nm_per_rad = [1, 2, 3]: has 3 numbers; allowed: one, or one for each of 2"],
    ),
    "a gain without a unit": (before_tool("[drive]\nkp = 3"), ["drive.kp = 3: write its unit too: kp_Nm_per_rad or"]),
    "a drive's unknown key and word": (
        before_tool('[drive]\ngear = 100\nencoder_side = "both"\ndelay_s = -1'),
        ["drive.gear = 100: unknown key", "encoder_side = 'both': must be 'motor' or 'joint'", "drive.delay_s"],
    ),
    "one name for two joints": (
        ("[[joint]]\n", '[[joint]]\nname = "a"\n[[joint]]\nname = "a"\n'),
        ["joint[1].name = 'a'", "each needs one of its own"],
    ),
    "a mass centre in the wrong unit": (
        row2("a_mm = 300\nbody = { mass_kg = 5, com_m = [60, 0, 0] }"),
        ["joint[2].body.com: 60 m", "reaches 0.41 m", "Is it in the unit"],
    ),
    "a loop that does not close": (
        loop(2, 1, 2000),
        ["four_bar[1] cannot be assembled", "limits_deg of joints 1 and 2"],
    ),
    "a version to come": (("casadical = 1", "casadical = 3"), ["casadical = 3", "up to version 2"]),
    "range in millimetres of a revolute joint": (
        ("limits_deg = [-170, 170]", "limits_mm = [0, 5]"),
        ["joint[1].limits_mm = [0, 5]", "revolute", "limits_deg"],
    ),
    "range the wrong way round": (("[-170, 170]", "[170, -170]"), ["joint[1].limits_deg = [170, -170]", "lower one"]),
    "beta in standard rows": (
        ("casadical = 1\n", 'casadical = 1\nconvention = "standard"\n'),
        ["joint[2].beta_deg = 0", "modified rows"],
    ),
    "b without beta": (("d_mm = 100", "b_mm = 3"), ["joint[1].b_mm = 3", "row 1 beside beta"]),
    "b in a later row": (row2("beta_deg = 0\nb_mm = 3"), ["joint[2].b_mm = 3", "row 1 only"]),
    "a loop on a joint that is not there": (loop(3, 2, 100), ["four_bar[1]: carrier = 2, driven = 3", "(1..2)"]),
    "two loops on one joint": (("", 2 * loop(2, 1, 100)[1]), ["driven by two loops"]),
    "not TOML": (row2("a_mm = "), ["not valid TOML", "line 13"]),
}


@pytest.mark.parametrize("name", FAULTS)
def test_fault_is_named(name: str, tmp_path: Path) -> None:
    (old, new), expected = FAULTS[name]
    text = GOOD.replace(old, new, 1) if old else GOOD + new
    if name == "beta in standard rows":
        text = text.replace(*row2("a_mm = 300\nbeta_deg = 0"))
    assert text != GOOD
    (tmp_path / "arm.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        read_robot(tmp_path / "arm.toml")
    message = str(caught.value)
    for part in ["arm.toml", *expected]:
        assert part in message


def test_the_good_file_is_good(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(f"{GOOD}limits_deg = [60, 120]\n{loop(2, 1, 100)[1]}")
    assert read_robot(tmp_path / "arm.toml").n == 2


def test_all_faults_are_listed_at_once(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(GOOD.replace("300", '"300"').replace("100", "nan"))
    with pytest.raises(InputError, match=r"2 faults") as caught:
        read_robot(tmp_path / "arm.toml")
    assert "joint[1].d_mm" in str(caught.value)
    assert "joint[2].a_mm" in str(caught.value)


PROBLEM = """
casadical = 1
title = "test"
data = "synthetic"

[[measurements]]
file = "table.csv"

[sets]
identify = 0.5
report = 0.5
"""

TABLE = "q1_deg,q2_deg,x_mm,y_mm,z_mm,set,tag\n" + "".join(
    f"{10 * k},{7 * k * k % 90},{400 - 3 * k},{20 * k},{k % 3},identify,{k % 2}\n" for k in range(12)
)


def of_table(keys: str) -> tuple[str, str]:
    """Further keys of the table of measurements."""
    return "\n\n[sets]", f"\n{keys}\n\n[sets]"


def sets(keys: str) -> tuple[str, str]:
    """Other keys of the sets."""
    return "identify = 0.5\nreport = 0.5", keys


PROBLEM_FAULTS = {
    "no such method": (("[[", 'methods = ["BP"]\n[['), ["methods[1] = 'BP'", "allowed: KM, SKCM, NN-SKCM"]),
    "no such table": (('"table.csv"', '"tables.csv"'), ["tables.csv", "no such file", "named in", "problem.toml"]),
    "two statements of one noise": (
        of_table("sigma_mm = 0.02\ndatasheet_mm = 0.05"),
        ["measurements[1].datasheet_mm = 0.05", "sigma_mm says more of the same", "leave one of them out"],
    ),
    "a slip of the pen": (("[sets]", "[sets]\nidentfy = 3"), ["sets.identfy", "is identify meant?"]),
    "a set of nothing": (("identify = 0.5", "identify = 0"), ["sets.identify = 0"]),
    "a figure of no method": (
        ("[sets]", '[paper]\nsource = "x"\ncalibration = { BP = [1.0, 2.0, 3.0] }\n[sets]'),
        ["allowed: before, KM"],
    ),
    "a set that is not whole": (("identify = 0.5", "identify = 7.5"), ["sets.identify = 7.5", "whole number"]),
    "more poses than there are": (("identify = 0.5", "identify = 9"), ["table.csv", "cannot be taken from 12"]),
    "sizes beside a column": (("[sets]", '[sets]\ncolumn = "set"'), ["sets.column = 'set'", "leave out identify"]),
    "no such column of sets": (sets('column = "part"'), ["'part'", "is missing", "q1_deg"]),
    "sets of other names": (sets('column = "tag"'), ["'tag'", "holds '0'", "identify, train, choose, report"]),
    "nothing to identify from": (("identify = 0.5", ""), ["no poses are named 'identify'", "report"]),
    "no such column": (of_table('columns = { x_mm = "X" }'), ["column 'X'", "named for 'x_mm'", "is missing"]),
    "a table of a URDF for none": (
        ("[sets]", '[urdf]\nbase_link = "x"\n[sets]'),
        ["urdf: has no effect", "robot.toml"],
    ),
    "sessions of none": (("[sets]", '[sessions]\nzeros = "own"\n[sets]'), ["sessions: has no effect", "`session`"]),
    "a point where none is touched": (
        of_table('point_from = ["tag"]'),
        ["table.csv: point_from: has no effect on kind 'position'"],
    ),
    "a column of nothing": (
        of_table('columns = { q1_deg = { from = "q1_deg", times = 0 } }'),
        ["columns.q1_deg.times = 0: leaves nothing of column 'q1_deg'"],
    ),
    "a column less itself": (
        of_table('columns = { q1_deg = { from = "q1_deg", add = { q1_deg = -1 } } }'),
        ["columns.q1_deg.add", "leaves nothing of column 'q1_deg'"],
    ),
    "a shift beyond the table": (
        of_table('columns = { q1_deg = { from = "q1_deg", rows = 1000 } }'),
        ["table.csv: columns.q1_deg.rows = 1000: allowed: less than its 12 rows"],
    ),
    "all rows left out": (
        of_table(f"leave_out = {[*range(2, 14)]}"),
        ["table.csv: a header but no rows that count: 12 are left out"],
    ),
    "sets beyond the table": (("identify = 0.5", "identify = 0.9"), ["sets of identify 0.9, report 0.5 cannot"]),
    "a set without poses": (("report = 0.5", "report = 1e-9"), ["table.csv: no poses are left for the set 'report'"]),
    "tables without end": (
        ("[sets]", 1000 * '[[measurements]]\nfile = "table.csv"\n' + "[sets]"),
        ["at most 1000 entries"],
    ),
    "one table twice": (
        of_table('[[measurements]]\nfile = "./table.csv"'),
        ["table.csv: 12 of its 12 poses are in table.csv, too", "take one of the two tables out"],
    ),
}


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (PROBLEM.encode("utf-8-sig"), "save it as UTF-8 without one"),
        (PROBLEM.encode("utf-16"), "save it as UTF-8 without one"),
        (
            PROBLEM.replace("synthetic", "\u00fc").encode("latin-1"),
            r"row 4 holds the byte 0xfc, which is not UTF-8; save it as UTF-8",
        ),
        (f"casadical = {'1' * 5000}".encode(), "4300 digits.*digits$"),
    ],
)
def test_a_text_that_is_no_toml_says_what_to_do(content: bytes, why: str, tmp_path: Path) -> None:
    folder = problem_folder(tmp_path, PROBLEM)
    (folder / "problem.toml").write_bytes(content)
    with pytest.raises(InputError, match=rf"problem\.toml: not valid TOML: .*{why}"):
        read_problem(folder)


def problem_folder(folder: Path, text: str) -> Path:
    (folder / "robot.toml").write_text(GOOD)
    (folder / "problem.toml").write_text(text)
    (folder / "table.csv").write_text(TABLE)
    return folder


@pytest.mark.parametrize("name", PROBLEM_FAULTS)
def test_fault_of_a_problem_is_named(name: str, tmp_path: Path) -> None:
    (old, new), expected = PROBLEM_FAULTS[name]
    assert old in PROBLEM
    with pytest.raises(InputError) as caught:
        read_problem(problem_folder(tmp_path, PROBLEM.replace(old, new, 1)))
    for part in expected:
        assert part in str(caught.value)


def test_a_copied_row_shifts_no_set(tmp_path: Path) -> None:
    folder = problem_folder(tmp_path, PROBLEM.replace(*sets('column = "set"')))
    head, *rows = TABLE.splitlines()
    rows = [row if k < 8 else row.replace("identify", "report") for k, row in enumerate(rows)]
    (folder / "table.csv").write_text("\n".join([head, *rows[:3], rows[0], *rows[3:]]) + "\n")
    found = read_problem(folder).sets
    assert [found["identify"][0].row[-1], *found["report"][0].row] == [10, 11, 12, 13, 14]


def test_the_good_problem_is_good(tmp_path: Path) -> None:
    found = read_problem(problem_folder(tmp_path, PROBLEM)).sets
    assert {name: len(parts[0]) for name, parts in found.items()} == {"identify": 6, "report": 6}
