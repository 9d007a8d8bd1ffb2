"""Tables in the forms that people have: every one is read as the poses that were measured."""

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import first_hour
import numpy as np
import pandas as pd
import pytest
from command_line import main
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from casadical import InputError
from casadical.measurements.raw_table import read_table
from casadical.project.check.check import precheck
from casadical.project.check.repair import repaired
from casadical.project.new import new_problem
from casadical.project.new.dh_table import robot_text
from casadical.project.problem import read_campaign, read_campaign_robot

ROWS = 30
# Rows that are enough for the robot to decide, and too few to look for a camera, which takes seconds.
FEW = 11


def poses() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Readings [deg], positions [mm] and orientations (n, 3, 3) of a tool, by plain numpy."""
    q, p = first_hour.measured(ROWS)
    tips = [first_hour.measured(ROWS, tool=first_hour.TOOL + 1000 * e, noise=0.0)[1] for e in np.eye(3)]
    R = np.stack([(tip - first_hour.measured(ROWS, noise=0.0)[1]) / 1000 for tip in tips], axis=2)
    return q, p, R @ Rotation.from_euler("xyz", [70, -40, 130], degrees=True).as_matrix()


Q, P, R = poses()
# Homogeneous matrices (n, 4, 4) [mm], and those of 3x4 numbers.
T = np.zeros((ROWS, 4, 4))
T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = R, P, 1
J = [f"j{k}" for k in range(1, 7)]
NUMBERS = np.random.default_rng(3).permutation(np.arange(100, 100 + ROWS))[:, None]
QUATERNION = Rotation.from_matrix(R).as_quat()


def indices(name: str, rows: int, columns: int, first: int = 0) -> list[str]:
    return [name.format(i, j) for i in range(first, first + rows) for j in range(first, first + columns)]


def grid(names: list[str], values: np.ndarray) -> str:
    return pd.DataFrame(np.hstack([Q, values.reshape(ROWS, -1)]), columns=[*J, *names]).to_csv(index=False)


def bare(*parts: np.ndarray, sep: str = ",") -> str:
    return pd.DataFrame(np.hstack([part.reshape(ROWS, -1) for part in parts])).to_csv(
        sep=sep, index=False, header=False
    )


def motive(*lines: str, still: bool = False, markers: bool = False) -> str:
    """A table of Motive: lines of groups, rigid bodies one beside the other, readings behind them."""
    stand = np.hstack([np.tile([0.1, 0.2, 0.3, 0.927], (ROWS, 1)), np.tile([50.0, 60, 70], (ROWS, 1))])
    bodies = [stand + np.random.default_rng(4).normal(0, 1e-4, stand.shape)] * still + [np.hstack([QUATERNION, P])]
    seen = [np.hstack([b, np.full((ROWS, 1), 0.2)]) for b in bodies] + [P + np.array([30.0, 0, 0])] * markers
    table = np.hstack([np.arange(ROWS)[:, None], *seen, Q])
    names = "X,Y,Z,W,X,Y,Z,," * len(bodies) + "X,Y,Z," * markers
    heads = [*lines, f"Frame,{names}{','.join(f'J{k}' for k in range(1, 7))}"]
    return "\n".join([*heads, pd.DataFrame(table).to_csv(index=False, header=False)])


GROUPS = "Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,"
FORMS: dict[str, Callable[[], str]] = {
    "T03": lambda: grid(indices("T{}{}", 4, 4), T),
    "r14": lambda: grid(indices("r{}{}", 3, 4, 1), T[:, :3]),
    "M_1_4": lambda: grid(indices("M_{}_{}", 4, 4, 1), T),
    "T[0,3]": lambda: grid([f'"{n}"'.strip('"') for n in indices("T[{},{}]", 3, 4)], T[:, :3]),
    "base_T_tip.03": lambda: grid(indices("base_T_tip.{}{}", 4, 4), T),
    "transposed": lambda: grid(indices("H{}{}", 4, 4), T.transpose(0, 2, 1)),
    "4x3": lambda: grid(indices("m{}{}", 4, 3), T.transpose(0, 2, 1)[:, :, :3]),
    "noap": lambda: grid([f"{c}{x}" for c in "noap" for x in "xyz"], T[:, :3].transpose(0, 2, 1)),
    "m0 to m15": lambda: grid([f"m{k}" for k in range(16)], T),
    "pose1 to pose12 by columns": lambda: grid([f"pose{k}" for k in range(1, 13)], T[:, :3].transpose(0, 2, 1)),
    "rotation, then position": lambda: grid([f"pose{k}" for k in range(1, 13)], np.hstack([R.reshape(-1, 9), P])),
    "bare: 4x4": lambda: bare(Q, T),
    "bare: radians, 3x4 in front": lambda: bare(T[:, :3], np.deg2rad(Q)),
    "bare: 4x4 by columns, numbered": lambda: bare(NUMBERS, Q, T.transpose(0, 2, 1), sep="\t"),
    "bare: numbers, readings, positions": lambda: bare(NUMBERS, Q, P),
    "bare: positions in m, readings": lambda: bare(P / 1e3, Q, sep=" "),
    "bare: positions, quaternions, readings": lambda: bare(P, QUATERNION, Q),
    "bare: readings, positions, rotation vectors": lambda: bare(Q, P / 1e3, Rotation.from_matrix(R).as_rotvec()),
    "bare: readings, positions, angles about z, y, x": lambda: bare(
        Q, P, Rotation.from_matrix(R).as_euler("ZYX", degrees=True)
    ),
    "r11 and t1": lambda: grid([*indices("r{}{}", 3, 3, 1), "t1", "t2", "t3"], np.hstack([R.reshape(-1, 9), P])),
    "bare: readings, positions, a deviation": lambda: bare(Q, P, NUMBERS / 7.0),
    "Motive, two lines": lambda: motive("," + GROUPS),
    "Motive, a heading a group": lambda: motive(",Rotation,,,,Position,,,Mean Marker Error,"),
    "Motive, with markers": lambda: motive(
        "," + "Rigid Body," * 8 + "Rigid Body Marker," * 3, "," + GROUPS + "Position,Position,Position,", markers=True
    ),
    "Motive, six lines, two bodies": lambda: motive(
        "Format Version,1.23,Take Name,Take 1,Rotation Type,Quaternion,Length Units,Millimeters",
        "",
        "Type" + ",Rigid Body" * 16,
        "Name" + ",Stand" * 8 + ",Gripper" * 8,
        "ID" + ",A1F0" * 8 + ",B2E7" * 8,
        "," + 2 * GROUPS,
        still=True,
    ),
}


# Two further targets on the flange [mm].
OTHERS = [first_hour.measured(ROWS, tool=first_hour.TOOL + t, noise=0.0)[1] for t in ([80, 0, 0], [0, -50, 40])]
THREE = [P, *OTHERS]


def wide(names: list[str], count: int = 3, line: str = "", factor: float = 1.0) -> str:
    """A table with several targets in each row, of which the last has lost one measurement."""
    values = factor * np.hstack(THREE[:count])
    values[4, -3:] = np.nan
    return f"{line}\n" * bool(line) + pd.DataFrame(np.hstack([Q, values]), columns=[*J, *names]).to_csv(index=False)


def each(form: str, names: str) -> list[str]:
    return [form.format(name, c) for name in names for c in "xyz"]


WIDE: dict[str, str] = {
    "x1": wide(each("{1}{0}", "123")),
    "x first without number": wide(["x", "y", "z", *each("{1}{0}", "23")]),
    "P1_x [mm]": wide(each("P{0}_{1} [mm]", "123")),
    "smr2 X (m)": wide(each("smr{0} {1} (m)", "123"), factor=1e-3),
    "A_x": wide(each("{0}_{1}", "ABC")),
    "Ax": wide(each("{0}{1}", "ABC")),
    "xA": wide(each("{1}{0}", "ABC")),
    "left.x": wide([f"{side}.{c}" for side in ("left", "right") for c in "xyz"], 2),
    "x, y, z again": wide(["X", "Y", "Z"] * 3),
    "groups above": wide(["X", "Y", "Z"] * 3, line=",,,,,,Target A,,,Target B,,,Target C,,"),
    "p12": wide(indices("p{}{}", 3, 3, 1)),
    "no headings": pd.DataFrame(np.hstack([Q, *THREE])).to_csv(index=False, header=False),
    "groups and units": wide(["X", "Y", "Z"] * 3, line=",,,,,,SMR 1,,,SMR 2,,,SMR 3,,").replace(
        "Z\n", "Z\n" + "deg," * 6 + ",".join(["mm"] * 9) + "\n"
    ),
    "target_1_x_mm": wide(each("target_{0}_{1}_mm", "123")),
}


@pytest.mark.parametrize("form", WIDE)
def test_targets_side_by_side_are_as_many_rows(form: str, tmp_path: Path) -> None:
    said: list[object] = []
    problem = new_problem(tmp_path / "arm", **first_hour.given(tmp_path, WIDE[form]), show=said.append)
    count = 2 if form == "left.x" else 3
    assert len({problem.robot.tool_name, *(t.name for t in problem.robot.targets)}) == count
    assert f"{count} targets" in str(said[0])
    m = read_campaign(tmp_path / "arm", tmp_path / "arm" / "poses.csv", problem.robot)
    assert m.position is not None
    seen = np.stack(THREE[:count], axis=1).reshape(-1, 3)
    lost = [] if form == "no headings" else [5 * count - 1]
    np.testing.assert_allclose(1e3 * m.position, np.delete(seen, lost, axis=0), atol=1e-3)
    direct = read_campaign(tmp_path / "arm", tmp_path / "table.csv", problem.robot)
    np.testing.assert_allclose(direct.position, m.position)


def test_coordinates_of_two_frames_and_commanded_ones_are_no_targets(tmp_path: Path) -> None:
    base = P @ Rotation.from_euler("z", 40, degrees=True).as_matrix().T + [900, 20, -300]
    base += np.random.default_rng(1).normal(0, 1.5, base.shape)
    columns = {**dict(zip(J, Q.T, strict=True)), **{f"Tracker {c}": v for c, v in zip("XYZ", P.T, strict=True)}}
    columns |= {f"Robot {c}": v for c, v in zip("XYZ", base.T, strict=True)}
    problem = new_problem(tmp_path / "arm", **first_hour.given(tmp_path, pd.DataFrame(columns)))
    assert len(problem.whole[0]) == ROWS
    np.testing.assert_allclose(1e3 * problem.whole[0].position, P, atol=1e-3)


ORDER = np.random.default_rng(7).permutation(ROWS)
READINGS = pd.DataFrame(Q, columns=J)
SEEN = pd.DataFrame(P, columns=["x", "y", "z"])
TIMES = 1.7e9 + 5.0 * np.arange(ROWS)
FILES: dict[str, tuple[list[pd.DataFrame], str]] = {
    "by number": ([READINGS.assign(ID=ORDER), SEEN.assign(Point=range(ROWS)).iloc[ORDER][::-1]], "columns 'ID' and"),
    "by name": (
        [READINGS.assign(name=[f"P{k:03d}" for k in range(ROWS)]), SEEN.assign(pt=[f"p{k}" for k in range(ROWS)])],
        "columns 'name' and 'pt'",
    ),
    "by order": ([READINGS, SEEN], "by the order of their rows"),
    "without headings": ([READINGS, SEEN.set_axis(range(3), axis=1)], "by the order of their rows"),
    "by time": (
        [
            pd.DataFrame(np.repeat(Q, 10, axis=0), columns=J).assign(
                time=np.repeat(TIMES, 10) + np.tile(0.1 * np.arange(10), ROWS)
            ),
            SEEN.assign(stamp_ms=1e3 * (TIMES + 0.42))[3:20],
        ],
        "by time",
    ),
    "three files": (
        [
            READINGS.assign(ID=range(ROWS)),
            SEEN.assign(ID=range(ROWS)),
            pd.DataFrame({"ID": range(ROWS), "T [°C]": 20.0}),
        ],
        "columns 'ID'",
    ),
    "two days": ([READINGS.join(SEEN)[:12], READINGS.join(SEEN)[12:]], "the rows of both"),
}


@pytest.mark.parametrize("form", FILES)
def test_several_files_are_one_table(form: str, tmp_path: Path) -> None:
    (tmp_path / "dh.csv").write_text(first_hour.DH)
    tables, words = FILES[form]
    paths = [tmp_path / f"table{k}.csv" for k in range(len(tables))]
    for path, frame in zip(paths, tables, strict=True):
        frame.to_csv(path, index=False, header=bool(frame.columns.dtype.kind == "O"))
    said: list[object] = []
    problem = new_problem(tmp_path / "arm", dh=tmp_path / "dh.csv", data=paths, show=said.append)
    assert words in str(said[0])
    m = read_campaign(tmp_path / "arm", tmp_path / "arm" / "poses.csv", problem.robot)
    which = [int(np.argmin(np.abs(Q - q).sum(axis=1))) for q in np.rad2deg(m.q)]
    assert len(m) == (17 if form == "by time" else ROWS)
    seen = P[ORDER[which]] if form == "by number" else P[which]
    assert m.position is not None
    np.testing.assert_allclose(1e3 * m.position, seen, atol=1e-3)


def test_files_without_a_column_in_common_and_of_other_lengths_are_refused(tmp_path: Path) -> None:
    READINGS.to_csv(tmp_path / "q.csv", index=False)
    SEEN[3:].to_csv(tmp_path / "p.csv", index=False)
    (tmp_path / "dh.csv").write_text(first_hour.DH)
    with pytest.raises(InputError, match=r"q\.csv and p\.csv: 30 and 27 rows, and no column in common"):
        new_problem(tmp_path / "arm", dh=tmp_path / "dh.csv", data=[tmp_path / "q.csv", tmp_path / "p.csv"])


def test_headings_may_be_given(tmp_path: Path, monkeypatch) -> None:
    files = first_hour.given(tmp_path, bare(P, Q))
    names = "x_mm,y_mm,z_mm,q6_deg,q2_deg,q3_deg,q4_deg,q5_deg,q1_deg"
    given = ("--dh", files["dh"], "--data", files["data"], "--headings", names, "--yes", "-q")
    assert main(monkeypatch, "new", tmp_path / "arm", *given) == 0
    assert (tmp_path / "arm" / "poses.csv").read_text().startswith(f"{names}\n")
    with pytest.raises(InputError, match="2 headings for 9 columns; the first row has"):
        new_problem(tmp_path / "b", **files, headings="x,y")


def saved_text(path: Path, held: object) -> None:
    path.write_text(json.dumps(held, default=lambda a: a.tolist()))  # JSON is YAML, too


RAD = np.deg2rad(Q)
STATES = pd.DataFrame(
    {
        "stamp": TIMES,
        "name": str([f"joint{k}" for k in range(1, 7)]),
        "position": [str(list(q)) for q in RAD],
        "effort": "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]",
    }
)
HELD: dict[str, tuple[str, Callable[[Path], object]]] = {
    "npy": ("t.npy", lambda path: np.save(path, np.hstack([Q, P]))),
    "npz": ("t.npz", lambda path: np.savez(path, q=RAD[:FEW], T=T[:FEW])),
    "npz, pages behind": ("t.npz", lambda path: np.savez(path, joints=Q[:FEW].T, tcp=np.moveaxis(T[:FEW], 0, -1))),
    "mat": ("t.mat", lambda path: savemat(path, {"q": Q, "p": P, "n": 3.0})),
    "mat, a struct": ("t.mat", lambda path: savemat(path, {"data": {"jointAngles": RAD, "pos_m": P / 1e3}})),
    "mat, transposed": (
        "t.mat",
        lambda path: savemat(path, {"Q": Q[:FEW].T, "xyz": P[:FEW].T, "quat": QUATERNION[:FEW].T}),
    ),
    "json records": (
        "t.json",
        lambda path: saved_text(
            path, [{"joints": q, "tcp": {"x": x, "y": y, "z": z}} for q, (x, y, z) in zip(Q, P, strict=True)]
        ),
    ),
    "json of lists": ("t.json", lambda path: saved_text(path, {"q": RAD, "position_mm": P})),
    "yaml records": (
        "t.yaml",
        lambda path: saved_text(path, {"samples": [{"q": q, "p": p} for q, p in zip(Q, P, strict=True)]}),
    ),
    "a pose in six numbers": (
        "t.npz",
        lambda path: np.savez(path, q=RAD[:FEW], pose=np.hstack([P / 1e3, Rotation.from_matrix(R).as_rotvec()])[:FEW]),
    ),
    "a pose in seven numbers": (
        "t.json",
        lambda path: saved_text(path, {"q": RAD[:FEW], "pose": np.hstack([P / 1e3, QUATERNION])[:FEW]}),
    ),
    "lists in cells": (
        "t.csv",
        lambda path: pd.DataFrame(
            {"q": [str(list(q)) for q in Q[:FEW]], "T": [str(t.tolist()) for t in T[:FEW]]}
        ).to_csv(path, index=False),
    ),
    "arrays in cells": (
        "t.csv",
        lambda path: pd.DataFrame(
            {"joints": [f"array('d', {list(q)})" for q in Q], "xyz": [" ".join(map(str, p)) for p in P]}
        ).to_csv(path, sep=";", index=False),
    ),
    "JointState": ("t.csv", lambda path: STATES.join(SEEN).to_csv(path, index=False)),
}


@pytest.mark.parametrize("form", HELD)
def test_arrays_records_and_lists_are_tables(form: str, tmp_path: Path) -> None:
    (tmp_path / "dh.csv").write_text(first_hour.DH)
    name, write = HELD[form]
    write(tmp_path / name)
    given = {"dh": tmp_path / "dh.csv", "data": tmp_path / name}
    problem = new_problem(tmp_path / "arm", **given, ask=lambda q: pytest.fail(q.text))
    m = read_campaign(tmp_path / "arm", tmp_path / "arm" / "poses.csv", problem.robot)
    assert len(m) in (FEW, ROWS)
    np.testing.assert_allclose(np.rad2deg(m.q), Q[: len(m)], atol=1e-4)
    assert m.position is not None
    np.testing.assert_allclose(1e3 * m.position, P[: len(m)], atol=1e-3)
    assert (m.orientation is not None) == (
        form in ("npz", "npz, pages behind", "mat, transposed", "lists in cells") or "pose" in form
    )


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.json", b'{"robot": "UR5", "ip": "10.0.0.1"}', "holds no table: robot, ip; save the poses as CSV"),
        ("a.yaml", b"just words", "holds no table: str"),
        ("a.yaml", b"a: &a {b: *a}", "holds no table"),  # it holds itself
        ("a.json", b'{"columns": 5, "data": 7}', "holds no table"),
        ("a.mat", b"MATLAB 7.3 MAT-file" + bytes(200), "not a readable .mat file"),
        ("a.npy", b"\x93NUMPY", "not a readable .npy file"),
        ("a.h5", b"\x89HDF\r\n\x1a\n\0\0\xd8\xd8\0", "not a readable CSV table: a .h5 file; save it as CSV"),
    ],
)
def test_files_that_hold_no_table_say_so(name: str, content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=re.escape(words)):
        read_table(tmp_path / name)


def test_dh_rows_in_json_are_those_of_the_csv(tmp_path: Path) -> None:
    (tmp_path / "dh.csv").write_text(first_hour.DH)
    saved_text(tmp_path / "dh.json", {"rows": pd.read_csv(tmp_path / "dh.csv").to_dict("records")})
    csv, js = (tomllib.loads(robot_text(tmp_path / name, "arm", "modified")) for name in ("dh.csv", "dh.json"))
    assert js["joint"] == csv["joint"]
    saved_text(tmp_path / "net.json", {"layers": [{"w": [[1, 2, 3, 4], [5, 6, 7, 8]], "b": [1, 2, 3, 4]}]})
    with pytest.raises(InputError, match=re.escape("'w[0,0]', 'w[0,1]', 'b[0]' are unknown")):
        robot_text(tmp_path / "net.json", "arm", "modified")


def test_joints_by_name_are_counted_from_zero_with_the_one_that_has_no_name(tmp_path: Path) -> None:
    """A URDF's joints are joint1 to joint6, the table's joint_0 to joint_5."""
    pytest.importorskip("yourdfpy", reason="the extra urdf is not installed")
    (tmp_path / "arm.urdf").write_text(first_hour.urdf())
    READINGS.set_axis([f"joint_{k}" for k in range(6)], axis=1).join(SEEN).to_csv(tmp_path / "t.csv", index=False)
    (m,) = new_problem(tmp_path / "arm", urdf=tmp_path / "arm.urdf", data=tmp_path / "t.csv").whole
    np.testing.assert_allclose(np.rad2deg(m.q), Q, atol=1e-4)


@pytest.mark.parametrize(
    ("heading", "cells"),
    [
        ("approach1", ["+", "-"]),
        ("Anfahrrichtung Achse 1", ["+", "-"]),
        ("approach direction J1", ["positive", "negative"]),
        ("Anfahrrichtung A1", ["Plus", "−"]),
        ("Approach_1", [1, -1]),
    ],
)
def test_a_direction_of_approach_may_be_a_sign(heading: str, cells: list[object], tmp_path: Path) -> None:
    table = READINGS.join(SEEN).assign(**{heading: cells * (ROWS // 2)})
    (m,) = new_problem(tmp_path / "arm", **first_hour.given(tmp_path, table)).whole
    np.testing.assert_array_equal(m.conditions["approach1"], [1, -1] * (ROWS // 2))


def columns(*names: str, also: np.ndarray | None = None, joints: list[str] = J) -> pd.DataFrame:
    """A table of readings [deg] and positions [mm], with more columns behind them."""
    seen = P if also is None else np.hstack([P, also])
    return pd.DataFrame(np.hstack([Q, seen])[:FEW], columns=[*joints, *names])


RPY = Rotation.from_matrix(R).as_euler("xyz", degrees=True)
PARTNERS: dict[str, str] = {
    **{form: "\n".join(made().splitlines()[: FEW - ROWS]) for form, made in FORMS.items()},
    "phix1 beside x1": columns("x1", "y1", "z1", "phix1", "phiy1", "phiz1", also=RPY).to_csv(),
    "phix1 beside x1, phix2 beside x2": columns(
        *each("{1}{0}", "1"),
        *each("phi{1}{0}", "1"),
        *each("{1}{0}", "2"),
        *each("phi{1}{0}", "2"),
        also=np.hstack([RPY, OTHERS[0], RPY]),
    )[: FEW // 2].to_csv(index=False),
    "a rounded copy": columns("X_meas", "Y_meas", "Z_meas", "X", "Y", "Z", also=P.round(1)).to_csv(index=False),
    "formulas of a workbook": re.sub(r"(?<=[,\n])([-\d.]+)", r'="\1"', columns(*"xyz").to_csv(index=False)),
    "a printed frame": columns(*"xyz").to_string(),
    "rows with names that have no heading": columns(*"xyz").to_csv(sep=" ").removeprefix('""').lstrip(),
    "tracker_0": columns(*(f"tracker_{k}" for k in range(3)), joints=[f"actual_q_{k}" for k in range(6)]).to_csv(
        index=False
    ),
    "other numbers behind them, without headings": columns(
        *"xyzabc", also=np.random.default_rng(0).uniform(0, 1, (ROWS, 3))
    ).to_csv(index=False, header=False),
    "positions and angles first, without headings": "\n".join(
        bare(P / 1e3, np.deg2rad(RPY), np.deg2rad(Q)).splitlines()[:FEW]
    ),
}


POSITIONS_ALONE = (
    "bare: numbers, readings, positions",
    "bare: positions in m, readings",
    "bare: readings, positions, a deviation",
)


@pytest.mark.parametrize("form", PARTNERS)
def test_a_form_is_recognised_in_few_rows(form: str, tmp_path: Path) -> None:
    first_hour.given(tmp_path, PARTNERS[form])
    (tmp_path / "robot.toml").write_text(robot_text(tmp_path / "dh.csv", "arm", "modified"))
    robot = read_campaign_robot(tmp_path / "robot.toml")
    m = read_campaign(tmp_path / "robot.toml", tmp_path / "table.csv", robot, later=True)
    m = m[::2] if "x2" in form else m
    assert len(m) == (FEW // 2 if "x2" in form else FEW)
    np.testing.assert_allclose(np.rad2deg(m.q), Q[: len(m)], atol=1e-4)
    assert m.position is not None
    np.testing.assert_allclose(1e3 * m.position, P[: len(m)], atol=1e-3)
    turned = "phix1" in form or "angles" in form or (form in FORMS and form not in POSITIONS_ALONE)
    assert (m.orientation is not None) == turned
    if m.orientation is not None:
        np.testing.assert_allclose(m.orientation, R[: len(m)], atol=1e-5)


def test_numbered_columns_of_other_words_are_no_angles_of_the_tool(tmp_path: Path) -> None:
    more = pd.DataFrame(np.random.default_rng(2).uniform(-1, 1, (ROWS, 3)), columns=["phix1", "phix2", "phix3"])
    given = first_hour.given(tmp_path, READINGS.join([SEEN, more]))
    (m,) = new_problem(tmp_path / "arm", **given, ask=lambda q: pytest.fail(str(q))).whole
    assert m.kind == "position"


def test_rounded_coordinates_of_the_robot_give_way_to_a_measured_length(tmp_path: Path) -> None:
    """As a controller shows them: angles to .1 deg and coordinates to .1 mm, beside the wire's length."""
    computed = first_hour.positions(Q, first_hour.ROWS, first_hour.TOOL)
    table = pd.DataFrame(np.hstack([Q.round(1), computed.round(1)]), columns=[*J, "x", "y", "z"])
    table["L"] = np.linalg.norm(P - [3000, 200, 100], axis=1)
    said: list[object] = []
    (m,) = new_problem(tmp_path / "arm", **first_hour.given(tmp_path, table), show=said.append).whole
    assert m.kind == "distance"
    assert "the coordinates are computed" in str(said)


NOMINAL = first_hour.positions(Q, first_hour.ROWS, first_hour.TOOL)
CONTROLLERS = NOMINAL + np.random.default_rng(0).normal(0, 0.3, P.shape)


@pytest.mark.parametrize(
    ("names", "beside"),
    [
        (["x", "y", "z", "xm", "ym", "zm"], NOMINAL),
        (["TCP X", "TCP Y", "TCP Z", "Leica X", "Leica Y", "Leica Z"], CONTROLLERS),
        (["x_nom", "y_nom", "z_nom", "x_act", "y_act", "z_act"], NOMINAL),
    ],
)
def test_measured_coordinates_go_before_those_of_the_controller(
    names: list[str], beside: np.ndarray, tmp_path: Path
) -> None:
    table = pd.DataFrame(np.hstack([Q, beside, P]), columns=[*J, *names])
    (m,) = new_problem(tmp_path / "arm", **first_hour.given(tmp_path, table)).whole
    assert m.position is not None
    np.testing.assert_allclose(1e3 * m.position, P, atol=1e-3)


@pytest.mark.parametrize("headings", [True, False])
def test_the_order_of_numbers_is_seen_though_a_joint_counts_the_other_way(headings: bool, tmp_path: Path) -> None:
    turned = Q * [1, -1, 1, 1, 1, 1]
    names = [*J, "x", "y", "z", *(f"quat{k}" for k in range(4))]
    seen = Rotation.from_matrix(R).as_quat(scalar_first=True)
    text = pd.DataFrame(np.hstack([turned, P, seen]), columns=names).to_csv(index=False, header=headings)
    (m,) = new_problem(tmp_path / "arm", **first_hour.given(tmp_path, text)).whole
    assert m.orientation is not None
    np.testing.assert_allclose(m.orientation, R, atol=1e-5)
    np.testing.assert_allclose(np.rad2deg(m.q), turned, atol=1e-4)
    repaired(precheck(tmp_path / "arm"))
    found = precheck(tmp_path / "arm")
    assert found.ok, found.findings


def test_a_table_of_one_number_in_each_row_is_read_below_its_title(tmp_path: Path) -> None:
    length = np.linalg.norm(P - [3000, 200, 100], axis=1)
    rows = [f"P{k};links;{str(value).replace('.', ',')}" for k, value in enumerate(length)]
    (tmp_path / "wires.csv").write_text("\n".join(["Protokoll", "Punkt;Seil;Abstand [mm]", *rows]))
    (tmp_path / "lists.csv").write_text(
        "\n".join(["Protokoll", "Punkt;joint_states", *(f"P{k};{list(q)}" for k, q in enumerate(Q))])
    )
    (tmp_path / "dh.csv").write_text(first_hour.DH)
    tables = [tmp_path / "lists.csv", tmp_path / "wires.csv"]
    (m,) = new_problem(tmp_path / "arm", dh=tmp_path / "dh.csv", data=tables).whole
    assert m.distance is not None
    np.testing.assert_allclose(1e3 * m.distance, length, atol=1e-6)
    np.testing.assert_allclose(np.rad2deg(m.q), Q, atol=1e-6)
