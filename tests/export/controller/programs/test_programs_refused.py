"""What a program does not say is left and listed; a program that cannot be corrected is refused by its line."""

import csv
import json

import numpy as np
import pytest
from command_line import main as run
from controller_arms import nominal_path, planted
from program_texts import OTHER_UNITS, REDEFINED, TOOLS, Point, held, loosened, matrix, with_line, write

from casadical.core.basics import InputError
from casadical.export.controller.commands import Sources
from casadical.export.controller.programs.correction import Cell
from casadical.export.controller.programs.program import (
    assumptions,
    corrected_program,
    language_named,
    language_of,
    read_target_program,
    report_of,
)
from casadical.export.controller.programs.target import Given
from casadical.robot.robot_file import read_robot, write_robot

ROBTARGET = "[[1500,0,1200],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
E6POS = "{X 1500,Y 10,Z 1200,A 10,B 90,C 0,S 2,T 2,E1 0.0}"
LS = "P[1]{{\n   GP1:\n\tUF : 0, UT : 1,\t\tCONFIG : {config},\n\tX = 1500.000 {unit},\tY = 1.000 mm,\tZ = 1200.000 mm,\n\tW = 180.000 deg,\tP = 0.000 deg,\tR = 0.000 deg\n}};\n"  # noqa: E501
TOOL = {"": matrix((0, 0, 100, 0, 0, 0))}


@pytest.fixture(scope="module")
def cell():
    return Cell(Sources(planted("kr210"), read_robot(nominal_path("kr210"))), leave_unreached=True)


def program(tmp_path, name, text, given=None):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_target_program(path, given or Given(), 6)


def statuses(tmp_path, cell, name, text, given=None):
    read = program(tmp_path, name, text, given)
    result = corrected_program(read, cell)
    if not any(r.fine for r in result.results):
        assert result.content() == (text if isinstance(text, bytes) else text.encode())
    return {r.target.name: (r.status, r.why) for r in result.results}


@pytest.mark.parametrize(
    ("name", "text", "where"),
    [
        (
            "p.dat",
            f"$TOOL={{X 0,Y 0,Z 1,A 0,B 0,C 0}}\nPTP {E6POS}\n$TOOL={{X 0,Y 0,Z 2,A 0,B 0,C 0}}\n",
            "line 3.*split",
        ),
        ("p.dat", f"PTP {E6POS}\nBAS(#TOOL,1)\nBAS (#TOOL,2)\n", "line 3.*split"),
        ("p.dat", "PTP {A1 1,A2 2,A3 3,A4 4,A5 5,A6 6,A7 7}\n", "line 1.*A7.*only 6 joints"),
        ("p.dat", "DEFDAT P\nENDDAT\n", "no target"),
        ("p.mod", f"MoveL {ROBTARGET},v1,fine,t1;\nPDispOn p1,p2,t1;\n", "line 2.*displaces"),
        (
            "p.mod",
            f"CONST robtarget p1:={ROBTARGET};\nMoveL p1,v1,fine,t1\\WObj:=w1;\nMoveL p1,v1,fine,t2;\n",
            "line 3.*tool t2 and work object wobj0, in line 2 with t1 and w1",
        ),
        (
            "p.mod",
            "PERS tooldata t1:=[TRUE,[[0,0,1],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
            f"MoveL {ROBTARGET},v1,fine,t1;\nt1.tframe.trans.z:=5;\n",
            "line 3: t1 is changed",
        ),
        ("p.script", "set_tcp(p[40,20,120,0,0,0])\nmovej([0,0,0,0,0,0])\n", "line 1: the tool is 120 m.*millimetres"),
        (
            "p.mod",
            "PERS tooldata t1:=[TRUE,[[0,0,1],[0,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
            f"MoveL {ROBTARGET},v1,fine,t1;\n",
            "p.mod: line 1: .*its length is 0; it must be 1",
        ),
        (
            "p.ls",
            "/MN\n 1: UTOOL[1]=PR[3] ;\n/POS\n" + LS.format(config="'N U T, 0, 0, 0'", unit="mm"),
            "line 2.*UTOOL",
        ),
        ("p.tp", "x", "cannot be read.*KUKA KRL"),
    ],
)
def test_a_program_that_cannot_be_corrected_is_refused_by_its_line(name, text, where, tmp_path):
    with pytest.raises(InputError, match=rf"(?s){where}"):
        program(tmp_path, name, text)


SUFFIXES = {"krl": "p.dat", "rapid": "p.mod", "urscript": "p.script", "fanuc": "p.ls"}
SPOILT = [
    (language, extra)
    for language in SUFFIXES
    for extra in (*REDEFINED[language], *OTHER_UNITS.get(language, ()), "\x00\x01\x02")
]


def random_program(language, rng, targets=6):
    q = np.array([0, -1.2, 1.3, 0, 0.8, 0]) + rng.uniform(-0.5, 0.5, (targets, 6))
    points = [Point(row, bool(k % 2), 0 if language == "urscript" else k % 2, 1) for k, row in enumerate(q)]
    return loosened(language, write(language, points, [np.eye(4)] * targets, rng, "\n"), rng)


@pytest.mark.parametrize(("language", "extra"), SPOILT)
def test_a_random_program_with_one_bad_line_is_refused_by_that_line(language, extra, tmp_path):
    """A tool or base that is changed on the way, other units, bytes of an encrypted or compiled program."""
    given = Given({str(k): np.eye(4) for k in (1, 2)}, {str(k): np.eye(4) for k in (1, 2)})
    given = given if language == "fanuc" else Given()
    rng = np.random.default_rng(0)
    whole = random_program(language, rng)
    assert len(program(tmp_path, SUFFIXES[language], whole, given).targets) == 6
    spoilt, line = with_line(language, whole, extra, rng)
    with pytest.raises(InputError, match=rf"line {line}:"):
        program(tmp_path, SUFFIXES[language], spoilt, given)


@pytest.mark.parametrize("language", SUFFIXES)
def test_a_target_that_would_leave_the_limits_keeps_its_numbers(language, cell, tmp_path):
    lower, upper = np.array([(j.lower, j.upper) for j in read_robot(nominal_path("kr210")).joints]).T
    rows = [np.where(np.arange(6) == i, side, (lower + upper) / 2) for side in (lower, upper) for i in range(6)]
    points = [Point(row, True, 0, 1) for row in rows]
    content = write(language, points, [np.eye(4)] * len(rows), np.random.default_rng(0), "\n")
    given = Given({str(k): np.eye(4) for k in (1, 2)}, {str(k): np.eye(4) for k in (1, 2)})
    read = program(tmp_path, SUFFIXES[language], content, given if language == "fanuc" else Given())
    result = corrected_program(read, cell)
    left = [r for r in result.results if not r.fine]
    assert [r.status for r in left].count("LEAVES_BOX") >= 2
    assert {r.status for r in left} <= {"LEAVES_BOX", "CLAMPED"}  # the last by rounding
    assert any(r.fine for r in result.results)
    new = result.content()
    lines, new_lines = content.splitlines(), new.splitlines()
    for r in left:
        assert lines[r.target.line - 1] == new_lines[r.target.line - 1]
    assert new != content


@pytest.mark.parametrize("language", SUFFIXES)
def test_a_corrected_program_is_not_corrected_twice(language, cell, tmp_path):
    points = [Point(np.deg2rad([10, -80, 90, 20, 40, -30.0]), True, 0, 0)] * 2
    content = write(language, points, [np.eye(4)] * 2, np.random.default_rng(0), "\n")
    given = Given({"1": np.eye(4)}, {"1": np.eye(4)}) if language == "fanuc" else Given()
    result = corrected_program(program(tmp_path, SUFFIXES[language], content, given), cell)
    assert [r.status for r in result.results] == ["OK", "OK"]
    assert assumptions(result, cell)[0].startswith("the controller's own absolute-accuracy option is off")
    out = tmp_path / f"new_{SUFFIXES[language]}"
    report_of(out).write_text(result.to_csv())
    with pytest.raises(InputError, match=r"line \d+: .* was corrected before"):
        program(tmp_path, out.name, result.content(), given)
    report_of(out).unlink()
    assert len(program(tmp_path, out.name, result.content(), given).targets) == 2


def test_what_a_krl_program_does_not_say_is_left(tmp_path, cell):
    text = (
        f"DECL E6POS XP1={E6POS}\nDECL FDAT FP1={{TOOL_NO 3,BASE_NO 0,IPO_FRAME #BASE}}\n"
        "DECL POS X2={X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T 2}\nX2.Z=5\n"
        f"DECL E6POS XP3={E6POS.replace('E1 0.0', 'E1 5.0')}\nDECL FDAT FP3={{TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE}}\n"
        f"DECL E6POS XP4={E6POS}\nDECL FDAT FP4={{TOOL_NO 1,BASE_NO 0,IPO_FRAME #TCP}}\n"
        f"DECL E6POS XP5={E6POS.replace('S 2', 'S 5')}\nDECL FDAT FP5={{TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE}}\n"
        "LIN_REL {X 10}\nLIN {X 1500,Y 0,Z 1200,A 0,B 90,C 0}\nTOOL_DATA[1]={X 0,Y 0,Z 100,A 0,B 0,C 0}\n"
        "DECL E6POS XP6={X 9000,Y 2,Z 3,A 0,B 0,C 0,S 2,T 2}\nDECL FDAT FP6={TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE}\n"
        "BAS(#TOOL,1)\n$BASE=$NULLFRAME\n"
    )
    found = statuses(tmp_path, cell, "p.dat", text)
    assert found["XP1"][0] == "NO_TOOL"
    assert found["X2"] == ("LEFT", "line 4 gives it another value")
    assert found["XP3"][0] == "EXTERNAL_AXIS"
    assert "stands still" in found["XP4"][1]
    assert found["XP5"][0] == "UNREACHABLE"
    assert found["XP6"][0] == "UNREACHABLE"
    assert found["in the motion"][0] == "NO_CONFIGURATION"


def test_what_the_others_do_not_say_is_left(tmp_path, cell):
    mod = (
        f"CONST robtarget p1:={ROBTARGET};\nCONST robtarget p2:={ROBTARGET};\nVAR robtarget p3:=CRobT();\n"
        "p2.trans.z:=100;\nMoveL p1,v1,fine,t9;\nMoveL p2,v1,fine,t9;\n"
    )
    found = statuses(tmp_path, cell, "p.mod", mod)
    assert found["p1"][0] == "NO_TOOL"
    assert found["p2"] == ("LEFT", "line 4 gives it another value")
    assert found["p3"] == ("LEFT", "its value is an expression")
    assert statuses(tmp_path, cell, "p.mod", mod, Given(TOOL))["p1"][0] != "NO_TOOL"
    script = (
        "movel(p[1.5,0,1.2,0,1.57,0])\na=p[1.5,0,1.2,0,1.57,0]\nmovel(a)\nb=pose_add(a, a)\nmovel(pose_trans(a, a))\n"
    )
    found = statuses(tmp_path, cell, "p.script", script, Given(TOOL))
    assert found["in the motion"][0] == "NO_CONFIGURATION"
    assert found["a"] == ("LEFT", "it is also part of an expression")
    assert found["movel"][0] == "LEFT"
    listing = "/POS\n" + LS.format(config="'N L U T, 0, 0, 0'", unit="mm")
    assert "CONFIG" in statuses(tmp_path, cell, "p.ls", listing, Given(TOOL))["P[1]"][1]
    for off in (5, -5):
        aside = LS.format(config="'N U T, 0, 0, 0'", unit="mm").replace("\n};", f",\n\tE1 = {off}.000 mm\n}};")
        assert statuses(tmp_path, cell, "p.ls", f"/POS\n{aside}", Given(TOOL))["P[1]"][0] == "EXTERNAL_AXIS"


@pytest.mark.parametrize("name", ["krl", "rapid", "urscript", "fanuc"])
def test_a_damaged_program_is_read_or_refused(name):
    """Whatever is deleted, replaced or repeated: targets whose numbers stand where they say, or a refusal."""
    points = [Point(np.array([0.1, -1.2, 1.3, 0.2, 0.5, 0.1]), k == 0, 0, 1) for k in range(2)]
    whole = write(name, points, [np.eye(4)] * 2, np.random.default_rng(0), "\n").decode("latin-1")
    rng, read = np.random.default_rng(1), 0
    for _ in range(40):
        text = whole
        for at in rng.integers(len(whole) - 50, size=rng.integers(1, 6)):
            middle = ("", rng.choice(list("{}[](),;:=\"'-.09eA \n")), 2 * text[at : at + 20])[rng.integers(3)]
            text = text[:at] + middle + text[at + rng.integers(1, 12) :]
        try:
            targets = language_named(name).targets("p", text, Given(), 6)
        except InputError:
            continue
        read += len(targets)
        for number in (n for t in targets for n in (*t.numbers, *t.turn_text)):
            assert text[number.start : number.stop] == number.text
    assert read > 20


def test_a_target_that_another_file_changes_is_left(tmp_path, cell):
    given = Given({"": matrix((0, 0, 100, 0, 0, 0))}, {}, {"p.src": "XP1.Z=5\nPTP XP1\n"})
    text = f"DECL E6POS XP1={E6POS}\nDECL FDAT FP1={{TOOL_NO 0,BASE_NO 0,IPO_FRAME #BASE}}\n"
    assert statuses(tmp_path, cell, "p.dat", text, given)["XP1"] == ("LEFT", "p.src gives it another value")


def test_the_command_writes_program_and_report_and_corrects_once(tmp_path, monkeypatch, capfd):
    robot, nominal = tmp_path / "real.toml", nominal_path("kr210")
    write_robot(planted("kr210"), robot)
    points = [Point(np.deg2rad([10, -80, 90, 20, 40, -30.0]), True, 0, 0)] * 2
    content = write("krl", points, [np.eye(4)] * 2, np.random.default_rng(0), "\r\n")
    (tmp_path / "p.dat").write_bytes(content)
    arguments = ("correct", robot, tmp_path / "p.dat", "--nominal", nominal, "--out", tmp_path / "new.dat")
    assert run(monkeypatch, *arguments, "--json", tmp_path / "s.json") == 0
    printed = capfd.readouterr().out
    assert "2 of 2 targets corrected" in printed
    assert "ASSUMED" in printed
    rows = list(csv.DictReader((tmp_path / "new.dat.correction.csv").read_text().splitlines()))
    assert [row["status"] for row in rows] == ["OK", "OK"]
    assert float(rows[0]["off_mm_before"]) > 0.1 > 0.02 > float(rows[0]["off_mm_after"])
    assert json.loads((tmp_path / "s.json").read_text())["corrected"] == 2
    new = (tmp_path / "new.dat").read_bytes()
    assert new != content
    assert f"XP1={{{','.join(f'A{i} {v}' for i, v in enumerate(rows[0]['is'].split(), 1))}".encode() in new
    again = ("correct", robot, tmp_path / "new.dat", "--nominal", nominal, "--out", tmp_path / "twice.dat")
    assert run(monkeypatch, *again) == 2
    assert "was corrected before" in capfd.readouterr().err
    assert not (tmp_path / "twice.dat").exists()


def test_targets_taught_with_absolute_accuracy_are_asked_for(tmp_path, monkeypatch, capfd):
    write_robot(planted("kr210"), tmp_path / "real.toml")
    (tmp_path / "p.dat").write_text(f"DECL E6POS XP1={E6POS.replace('S 2', 'S 10')}\n")
    arguments = ("correct", tmp_path / "real.toml", tmp_path / "p.dat", "--nominal", nominal_path("kr210"))
    assert run(monkeypatch, *arguments, "--out", tmp_path / "new.dat") == 2
    assert "--accuracy-off" in capfd.readouterr().err
    assert not list(tmp_path.glob("new*"))
    given = ("--accuracy-off", "--tcp", "0,0,100,0,0,0", "--base", "0,0,0,0,0,0", "--leave-unreached")
    assert run(monkeypatch, *arguments, "--out", tmp_path / "new.dat", *given) == 0


@pytest.mark.parametrize("language", ["krl", pytest.param("rapid", marks=pytest.mark.slow)])
def test_nothing_is_corrected_while_poses_are_not_reached_and_frames_are_asked_for(
    language, tmp_path, monkeypatch, capfd
):
    """A controller whose flange is turned by 180 degrees about x, as where the file's last row ends otherwise."""
    robot, nominal = tmp_path / "real.toml", read_robot(nominal_path("kr210"))
    write_robot(planted("kr210"), robot)
    flange = matrix((0, 0, 0, 180, 0, 0))
    drawn = np.array([0.3, -1.2, 1.3, 0.4, 0.8, 0.5]) + np.random.default_rng(1).uniform(-0.2, 0.2, (4, 6))
    points = [Point(q, k == 0, 0, 1) for k, q in enumerate(drawn)]
    in_base = [np.linalg.inv(nominal.base.T) @ held(nominal, q, flange @ matrix(TOOLS[0])) for q in drawn]
    path = tmp_path / SUFFIXES[language]
    path.write_bytes(write(language, points, in_base, np.random.default_rng(0), "\n"))
    given = ("correct", robot, path, "--nominal", nominal_path("kr210"), "--out", tmp_path / f"new_{path.name}")
    assert run(monkeypatch, *given) == 2
    said = " ".join(capfd.readouterr().err.split())
    assert "nothing is corrected: the nominal robot does not reach" in said
    assert "of 3 poses" in said
    assert "give --root" in said
    right = {"krl": "0,0,0,0,0,180", "rapid": "0,0,0,0,1,0,0"}[language]
    assert f"--flange {right}" in said
    assert not list(tmp_path.glob("new*"))
    assert run(monkeypatch, *given, "--flange", right) == 0
    assert "4 of 4 targets corrected" in capfd.readouterr().out
    assert run(monkeypatch, *given, "--flange", right) == 2
    assert "--overwrite" in capfd.readouterr().err
    assert run(monkeypatch, *given, "--flange", right, "--overwrite") == 0


LONG = {
    "digits of S": ("p.dat", f"DECL E6POS XP1={E6POS.replace('S 2', 'S ' + '9' * 500)}\n"),
    "cfx": ("p.mod", f"CONST robtarget p1:={ROBTARGET.replace('[0,0,0,0]', '[0,0,0,1e400]')};\nMoveL p1,v1,fine,t1;\n"),
    "a turn of CONFIG": ("p.ls", "/POS\n" + LS.format(config=f"'N U T, {'9' * 5000}, 0, 0'", unit="mm")),
    "lists": ("p.mod", f"CONST robtarget p1:={'[' * 4000}1{']' * 4000};\n"),
    "calls": ("p.script", f"movej({'f(' * 4000}1{')' * 4000})\n"),
}


@pytest.mark.parametrize("case", LONG)
def test_numbers_without_a_value_and_deep_brackets_are_refused_or_left(case, tmp_path):
    name, text = LONG[case]
    if case == "lists":
        with pytest.raises(InputError, match=r"no target|too deeply"):
            program(tmp_path, name, text)
    else:
        assert all(t.skip_reason or t.posture is None for t in program(tmp_path, name, text).targets)


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("p.src", "PTP {A1 10,A1 20,A2 -80,A3 40,A4 0,A5 30,A6 0}\n", "has A1 twice"),
        ("p.ls", "/POS\n" + 2 * LS.format(config="'N U T, 0, 0, 0'", unit="mm"), "is there 2 times"),
        (
            "p.ls",
            "/POS\n" + LS.format(config="'N U T, 0, 0, 0'", unit="mm").replace("Y =", "X = 1.0 mm, Y ="),
            "has X twice",
        ),
    ],
)
def test_what_is_given_twice_is_left(name, text, why, cell, tmp_path):
    assert {found for _, found in statuses(tmp_path, cell, name, text).values()} == {why}


def test_a_language_is_found_by_the_suffix_of_the_file(tmp_path):
    assert language_of(tmp_path / "X.SRC").name == "KUKA KRL"
