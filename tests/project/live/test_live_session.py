"""Readings as they come: judged before the next, kept whatever happens, calibrated as if the table had come whole."""

import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from threading import Timer

import numpy as np
import pytest
from command_line import main
from marks import slow

import casadical
from casadical.core.basics import InputError
from casadical.core.files import csv_text
from casadical.identification.accuracy import predicted
from casadical.identification.pose_selection.candidates import draw, expected, poses_at_places
from casadical.identification.pose_selection.workspace import Workspace
from casadical.measurements.measurements import unmeasured
from casadical.project.live import LiveSession
from casadical.project.live.session import finished
from casadical.project.live.sources import FileSource, FolderSource, Row, SimulatedSource, journal
from casadical.project.live.view import answer
from casadical.project.new.new import SYNTHETIC_NOISE_M, as_built

ROOT = Path(__file__).parents[3]
JOINTS = [f"q{i}_rad" for i in range(1, 7)]


def folder_of(folder: Path, problem: str) -> Path:
    """A problem folder with the robot of one of the committed ones, without measurements."""
    folder.mkdir()
    shutil.copy(ROOT / f"problems/{problem}/robot.toml", folder)
    (folder / "problem.toml").write_text('casadical = 1\ntitle = "t"\nmethods = ["KM"]\nloss = "linear"\n')
    return folder


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    return folder_of(tmp_path / "arm", "ur10")


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return folder_of(tmp_path / "small", "planar")


def series(count: int) -> list[list[str]]:
    """Header and rows of real readings of the UR10: joints and positions."""
    text = (ROOT / "data/ur10_laser_tracker/series_C_random_poses.csv").read_text()
    lines = [line.split(",") for line in text.splitlines()[: count + 1]]
    kept = [lines[0].index(name) for name in (*JOINTS, "x_mm", "y_mm", "z_mm")]
    return [[line[k] for k in kept] for line in lines]


def planar(count: int) -> list[list[str]]:
    """Header and rows of the planar arm's table."""
    return [line.split(",") for line in (ROOT / "data/planar/planar.csv").read_text().splitlines()[: count + 1]]


@contextmanager
def begun(folder: Path) -> Iterator[LiveSession]:
    """A session in a problem folder."""
    with journal(folder) as (course, add):
        yield LiveSession(folder, course, add)


def take(session: LiveSession, *rows: list[str]) -> int | None:
    """Readings one after another, the first row their headings; the number of the last one."""
    for cells in rows[1:]:
        number = session.take(Row(tuple(rows[0]), (), tuple(cells), "test"))
    return number


def followed(folder: Path, rows: list[list[str]]) -> dict:
    """The state of a session that has read a file and looked ahead."""
    (folder / "t.csv").write_text(csv_text(rows))
    with begun(folder) as session:
        session.feed(FileSource(folder / "t.csv"))
        session.look_ahead()
        return session.state()


def doubted(readings: list[dict]) -> list[int]:
    """Numbers of those that are not taken for good."""
    return [r["number"] for r in readings if r["state"] != "good"]


def measured(folder: Path, rows: list[list[str]], wrong: Callable[[int, list[float]], list[float]]) -> list[dict]:
    """The readings of a session in which `wrong` spoils some, judged when the last two have come."""
    spoilt = [list(map(repr, wrong(k, [float(c) for c in cells]))) for k, cells in enumerate(rows[1:], 1)]
    with begun(folder) as session:
        for cells in spoilt[:-2]:
            session.take(Row(tuple(rows[0]), (), tuple(cells), "test"), judge=False)
        take(session, rows[0], *spoilt[-2:])
        return session.state()["readings"]


def swapped(v: list[float]) -> list[float]:
    return [*v[:6], v[7], v[6], v[8]]


def in_metres(v: list[float]) -> list[float]:
    return [*v[:6], *(1e-3 * c for c in v[6:])]


def negative(v: list[float]) -> list[float]:
    return [*v[:2], -v[2], *v[3:]]


def behind(v: list[float]) -> list[float]:
    return [v[0], v[1] + 0.1, *v[2:]]


@pytest.mark.parametrize(
    ("slip", "words"),
    [
        (swapped, "axes are swapped: x holds y, y holds x"),
        (in_metres, "its position is in m"),
        (negative, "joint 3 counts the other way"),
        (behind, r"joint 2 stood at .* did not arrive"),
    ],
)
def test_a_slip_is_named_when_it_comes_and_the_others_are_plausible(arm: Path, slip, words: str) -> None:
    readings = measured(arm, series(10), lambda k, v: slip(v) if k == 10 else v)
    assert doubted(readings) == [10]
    assert re.search(words, readings[9]["why"]), readings[9]["why"]


def test_clean_readings_of_a_real_robot_are_not_doubted(arm: Path) -> None:
    assert {r["state"] for r in measured(arm, series(15), lambda _, v: v)} == {"good"}


def camera(folder: Path) -> list[list[str]]:
    """Header and real poses of the FR3's camera; its robot file in the folder."""
    shutil.copy(ROOT / "problems/fr3_camera/robot.toml", folder)
    lines = [line.split(",") for line in (ROOT / "data/fr3_camera/fr3_114.csv").read_text().splitlines()]
    return [line[1:] for line in lines]  # without the running number


@pytest.mark.parametrize(
    ("slip", "words"),
    slow(
        (lambda p, R: (-R.T @ p, R.T), "it is the inverse pose"),
        (lambda p, R: (p, R.T), "its orientation is the inverse"),
        (lambda p, R: (p, R @ np.diag([-1.0, -1.0, 1.0])), "its position is plausible, its orientation is not"),
    ),
)
def test_full_poses_are_judged_by_their_orientation_too(arm: Path, slip, words: str) -> None:
    rows = camera(arm)[:23]
    values = np.array([float(c) for c in rows[15][7:]])
    p, R = slip(values[:3], values[3:].reshape(3, 3))
    rows[15][7:] = map(repr, [*map(float, p), *map(float, R.ravel())])
    told = followed(arm, rows)
    assert doubted(told["readings"]) == [15]
    assert words in told["readings"][14]["why"]
    assert told["fields"][7:] == ["x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"]
    assert (casadical.calibrate(arm).problem.sets["identify"][0].kind) == "pose"


@cache
def made_up(kind: str) -> list[list[str]]:
    """Header and some forty readings of a UR10 that departs from its file, of one kind."""
    rng = np.random.default_rng(2)
    truth = as_built(casadical.read_robot(ROOT / "problems/ur10/robot.toml"), rng)
    corner = np.array([[0.5, 0.3, 0.3], [-0.4, 0.5, 0.4], [0.3, -0.6, 0.5]])
    spots = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [-0.1, 0.05, 0]])
    name = np.arange(42) % 3
    if kind in ("point", "plane", "dial"):  # in one point, on faces of a box, under three gauges that look down
        places = (
            corner if kind == "point" else np.array([c + np.roll(at, k) for k, c in enumerate(corner) for at in spots])
        )
        if kind == "dial":
            places = np.array([c + 0.3 * np.roll(at, k) for c in corner for k, at in enumerate(spots)])
        places = places @ truth.base.T[:3, :3].T + truth.base.T[:3, 3]
        q, which = poses_at_places(truth, places, 42, Workspace(), rng)
        name = which.astype(int) // (len(places) // 3)
    else:
        q = draw(truth, 42, Workspace(), rng)
    p, R = predicted(truth, unmeasured(q))
    p, number = p + 1e-5 * rng.normal(size=p.shape), np.arange(len(q))
    if kind in ("point", "plane"):
        head, cells = [kind], [["ABC"[k]] for k in name]
    elif kind == "dial":
        head, cells = ["dial", "reading_mm"], [["ABC"[k], 1e3 * p[n, 2]] for n, k in enumerate(name)]
    elif kind == "anchor":
        far = 1e3 * np.linalg.norm(p - 4 * corner[name], axis=1)
        head, cells = [kind, "distance_mm"], [["ABC"[k], far[n]] for n, k in enumerate(name)]
    elif kind == "pose":  # two by two, the first of which waits for the second
        far = 1e3 * np.linalg.norm(p - p[number ^ 1], axis=1)
        head, cells = ["pose", "other_pose", "distance_mm"], np.stack([number, number ^ 1, far], axis=1).tolist()
    else:
        before, head = np.maximum(number - 1, 0), ["dx_mm", "dy_mm", "dz_mm"]
        shift = 1e3 * np.einsum("nji,nj->ni", R[before], p - p[before])
        turn = (R[before].transpose(0, 2, 1) @ R).reshape(-1, 9).round(9)
        head, cells = [*head, *(f"R{i}{j}" for i in range(3) for j in range(3))], np.hstack([shift, turn]).tolist()
    return [[*JOINTS, *head], *([*map(repr, map(float, a)), *map(str, c)] for a, c in zip(q, cells, strict=True))]


@pytest.mark.parametrize(
    ("kind", "column", "wrong", "words"),
    [
        ("plane", "plane", lambda _: "A", "it is of C, not of A"),
        ("dx", "dx_mm", lambda cell: repr(-float(cell)), "the sign of x is wrong"),
        *slow(
            ("point", "q3_rad", lambda cell: repr(float(cell) + 0.05), "joint 3 stood at"),
            ("dial", "reading_mm", lambda cell: repr(-float(cell)), "the sign of its reading is wrong"),
            ("anchor", "distance_mm", lambda cell: repr(1e-3 * float(cell)), "its distance is in m"),
            ("pose", "distance_mm", lambda cell: repr(1e-3 * float(cell)), "its distance is in m"),
        ),
    ],
)
def test_every_kind_is_followed_and_its_slips_are_named(arm: Path, kind: str, column: str, wrong, words: str) -> None:
    rows = [list(row) for row in made_up(kind)]
    k, bad = rows[0].index(column), len(rows) - 3
    rows[bad][k] = wrong(rows[bad][k])
    told = followed(arm, rows)
    assert doubted(told["readings"]) == [bad]
    assert words in told["readings"][bad - 1]["why"]
    assert told["known"]["noise_mm"] < 0.1
    assert (told["next"] is None) == (kind in ("point", "plane", "dial"))


@pytest.mark.slow
def test_rows_wait_for_those_without_which_they_tell_nothing(arm: Path) -> None:
    """A touch for the others of its plane, a session for the poses of its base; a faulty row holds nobody up."""
    rows = made_up("plane")
    with begun(arm) as session:
        for count, cells in enumerate([*rows[1:4], [*rows[4][:6], ""], rows[4]], 1):
            take(session, rows[0], cells)
            states = [r["state"] for r in session.state()["readings"]]
            assert states == (["unread"] * count if count < 5 else ["good"] * 3 + ["unread", "good"])
        assert session.type_in({**dict.fromkeys(session.fields, "1.5"), "plane": "A"}) == 6
        with pytest.raises(InputError, match="plane: give a value"):
            session.type_in({**dict.fromkeys(session.fields, "1.5"), "plane": " "})
    (arm / "measured.jsonl").unlink()
    rows = series(21)
    turned = [[*row[:6], row[7], repr(-float(row[6])), row[8], "b"] for row in rows[12:]]
    every = [*([*row, "a"] for row in rows[1:12]), *turned]
    with begun(arm) as session:
        for cells in every[:12]:
            session.take(Row((*rows[0], "session"), (), tuple(cells), "test"), judge=False)
        number = take(session, [*rows[0], "session"], every[12])
        assert "session 'b' has 2 poses" in answer(session.state(), number)
        for cells in every[13:-1]:
            session.take(Row((*rows[0], "session"), (), tuple(cells), "test"), judge=False)
        take(session, [*rows[0], "session"], every[-1])
        assert {r["state"] for r in session.state()["readings"]} == {"good"}


def test_it_goes_on_where_it_was_and_ends_as_if_the_table_had_come_whole(small: Path, tmp_path: Path) -> None:
    rows, whole, table = planar(40), tmp_path / "whole", small / "tracker.csv"
    shutil.copytree(small, whole)
    (whole / "measured.csv").write_text(csv_text(rows))
    with (whole / "problem.toml").open("a") as file:
        file.write('\n[[measurements]]\nfile = "measured.csv"\n')
    for count in (15, 40):  # a process that ends between the two
        table.write_text(csv_text(rows[: 1 + count]))
        with begun(small) as session:
            assert len(session.course.readings) == (0 if count == 15 else 15)
            session.feed(FileSource(table))
    with (small / "measured.jsonl").open("a") as file:
        file.write('{"do": "read", "at"')  # killed while it wrote
    with journal(small) as (course, _):
        assert len(course.readings) == 40
    assert (small / "measured.csv").read_text() == csv_text(rows)
    ours, given = casadical.calibrate(small), casadical.calibrate(whole)
    name = Path("results/KM.parameters.csv")
    assert ours.files("results")[name] == given.files("results")[name]


def test_a_reading_is_struck_out_with_its_reason_and_restored(small: Path) -> None:
    rows = planar(8)
    with begun(small) as session:
        take(session, *rows[:2])
        session.strike(1, "the target was loose")
        assert session.state()["readings"][0]["state"] == "struck"
        session.restore(1)
        take(session, rows[0], *rows[2:])
        with pytest.raises(InputError, match="reason"):
            session.strike(3, " ")
        session.strike(3, "the target <b>was</b> loose")
        assert "leave_out = [4] # 4: the target" in (small / "problem.toml").read_text()
        assert session.state()["known"]["readings"] == 7
        session.restore(3)
        assert session.state()["known"]["readings"] == 8
    assert sum(len(parts[0]) for parts in casadical.read_problem(small).sets.values()) == 8


def test_the_plan_goes_on_where_a_reading_counts_and_a_pose_may_be_repeated(small: Path) -> None:
    with begun(small) as session:
        source = SimulatedSource(session.robot, session.next_pose, 8)
        for _ in range(6):
            session.feed(source)
        count = len(session.plan)
        told = session.state()["next"]
        assert (told["to_go"], len(told["poses"])) == (count - 6, count - 6)
        assert told["words"].startswith(f"{count - 6} planned poses remain; {count} are planned, of which 0.0")
        pose = session.next_pose()
        cells = [*(pose / list(session.robot.reading_units.values())), 1.0, 2.0, 3.0]  # no place of this robot
        take(session, [*session.robot.reading_units, "x_mm", "y_mm", "z_mm"], [repr(float(v)) for v in cells])
        assert session.state()["readings"][-1]["state"] == "doubtful"
        np.testing.assert_array_equal(session.next_pose(), pose)
        session.repeat(2)
        assert session.state()["next"]["poses"][0] == session.state()["readings"][1]["joints"]
        session.feed(source)
        assert session.state()["next"]["to_go"] == count - 6  # the pose that was repeated is no further one
        session.plan = session.plan[:2]
        assert session.state()["next"]["words"].startswith("all planned poses are measured")


def test_typed_readings_count_beside_those_of_a_file_in_other_units(arm: Path) -> None:
    rows = series(3)
    with begun(arm) as session:
        take(session, *rows[:3])
        last = [float(c) for c in rows[3]]
        values = dict(zip(session.fields, map(repr, map(float, [*np.rad2deg(last[:6]), *last[6:]])), strict=True))
        with pytest.raises(InputError, match="q2_deg: give a value"):
            session.type_in({**values, "q2_deg": "nan"})
        assert session.type_in(values) == 3
        assert session.state()["readings"][2]["state"] == "good"
        assert session.type_in(values) is None  # the same again


def test_a_refused_end_names_the_readings_that_were_doubted(arm: Path) -> None:
    rows = series(20)
    rows[15] = [*rows[15][:6], rows[15][7], rows[15][6], rows[15][8]]
    with begun(arm) as session:
        (arm / "t.csv").write_text(csv_text(rows))
        session.feed(FileSource(arm / "t.csv"))
        with pytest.raises(InputError, match=r"does not fit.*doubtful: reading 15: strike out what was a slip"):
            finished(session)


def test_files_as_others_write_them(small: Path, tmp_path: Path) -> None:
    rows = planar(9)
    table, folder = tmp_path / "t.csv", tmp_path / "many"
    with begun(small) as session:
        source = FileSource(table)
        assert session.feed(source) == ([], [])  # not there yet
        text = csv_text(rows[:4])
        table.write_text(text[:-9])  # the last line half written
        assert len(session.feed(source)[0]) == 2
        table.write_text(text)
        assert len(session.feed(source)[0]) == 1
        table.write_text(csv_text([rows[0], rows[4], *rows[1:4], rows[2]]))  # late, twice
        found, said = session.feed(source)
        assert len(found) == 1
        assert ["copy" in s for s in said] == [True]
        table.write_text(csv_text([*rows[:6], rows[6] + rows[7], rows[7]]))  # two writers of one file
        found, said = session.feed(source)
        assert len(found) == 2
        assert any("line 7" in s and "is ignored" in s for s in said)
        table.unlink()
        assert "is gone" in session.feed(source)[1][0]
        folder.mkdir()
        (folder / "8.csv").write_text(csv_text([rows[0], rows[8]]))
        (folder / "note.md").write_text("x")
        (folder / "9.csv").write_text(csv_text([rows[0][:3], rows[8][:3]]))
        found, said = session.feed(FolderSource(folder))
        assert len(found) == 1
        assert "has the columns" in said[0]
        assert "waited for" in session.feed(FolderSource(tmp_path / "removed"))[1][0]
        assert len(session.course.readings) == 7


def test_one_process_measures_into_a_folder_and_never_over_measurements(small: Path) -> None:
    with journal(small), pytest.raises(InputError, match="another casadical"), journal(small):
        pass
    table = '[[measurements]]\nfile = "old.csv"\n'
    (small / "problem.toml").write_text(f'casadical = 1\ntitle = "t"\ndata = "real"\n{table}')
    with pytest.raises(InputError, match=r"old\.csv"), begun(small):
        pass


def test_a_pose_beyond_the_limits_is_doubted_and_a_lost_cell_is_said(small: Path) -> None:
    rows = planar(8)
    rows[6][1] = "2400.0"
    rows[7][2] = ""
    with begun(small) as session:
        take(session, *rows)
        told = session.state()["readings"]
    assert told[5]["state"] != "good"
    assert "2400" in told[5]["why"]
    assert (told[6]["state"], told[6]["why"]) == ("unread", "a cell is empty or no number")
    assert [told[k]["why"] for k in (0, 1, 2, 3, 4, 7)] == [""] * 6
    assert {told[k]["state"] for k in (0, 1, 2, 3, 4, 7)} == {"good"}


def test_the_journal_is_lines_of_json(small: Path) -> None:
    with (small / "problem.toml").open("a") as file:  # how the table is to be understood, said beforehand
        file.write('[[measurements]]\nfile = "measured.csv"\nkind = "position"\n')
    measured(small, planar(2), lambda _, v: v)
    events = [json.loads(line) for line in (small / "measured.jsonl").read_text().splitlines()]
    assert [e["do"] for e in events] == ["begin", "read", "read"]
    assert casadical.read_problem(small).data == "real"
    (small / "measured.jsonl").write_text('{"do": "strike", "at": "", "id": 5, "why": "x"}\n')
    with pytest.raises(InputError, match="line 1: there is no reading 5"), journal(small):
        pass


@pytest.mark.parametrize("name", ["planar", *slow("ur10", "kr210")])
def test_poses_stay_above_the_plane_that_the_robot_stands_on(tmp_path: Path, name: str) -> None:
    """Also where an axis lies in that plane, as the KR 210's and the planar arm's do."""
    with begun(folder_of(tmp_path / "a", name)) as session:
        session.look_ahead()
        told, robot = session.state()["next"], session.robot
    tool = expected(robot, session.plan, {}, "plan").position - robot.base.T[:3, 3]
    assert (tool @ robot.base.T[:3, :3])[:, 2].min() >= -1e-6
    assert "not checked" not in told["words"]


def test_the_command_prints_answers_and_keeps_its_figures(small: Path, monkeypatch, capfd) -> None:
    kept = small / "state.json"
    for _ in range(2):
        words = ("--simulate", 1, "--program", "krl", "--json", kept)
        assert main(monkeypatch, "measure", small, "--no-page", *words) == 0
        told = capfd.readouterr()
        assert "PTP {A1" in told.out
    assert [r["state"] for r in json.loads(kept.read_text())["readings"]] == ["good", "good"]
    assert "goes on after 1 readings" in told.out


def test_a_pipe_is_followed_until_its_writer_closes_it(small: Path, monkeypatch) -> None:
    out, into = os.pipe()
    os.write(into, csv_text(planar(2)).encode())
    Timer(0.3, os.close, [into]).start()
    with os.fdopen(out) as stream:
        monkeypatch.setattr("sys.stdin", stream)
        assert main(monkeypatch, "measure", small, "--no-page", "--follow", "-") == 0
    assert len((small / "measured.csv").read_text().splitlines()) == 3


def test_a_simulated_reading_is_of_a_robot_as_built() -> None:
    arm, q = casadical.read_robot(ROOT / "problems/ur10/robot.toml"), np.linspace(0.3, -1.2, 6)
    (row,), _ = SimulatedSource(arm, lambda: q, 1).news()
    told = np.array([float(cell) for cell in row.cells])
    np.testing.assert_allclose(np.deg2rad(told[:6]), q, atol=1e-7)
    place = predicted(as_built(arm, np.random.default_rng(0)), unmeasured(q[None]))[0][0]
    np.testing.assert_allclose(told[6:], 1e3 * place, atol=5e3 * SYNTHETIC_NOISE_M)


@pytest.mark.slow
def test_distances_to_known_places_are_followed(arm: Path) -> None:
    rows = series(40)
    ends = np.array([[2000.0, 0.0, 0.0], [0.0, 2000.0, 300.0], [-1500.0, -1500.0, 1000.0]])
    made = []
    for k, row in enumerate(rows[1:]):
        end = ends[k % 3]
        far = float(np.linalg.norm(np.array([float(c) for c in row[6:]]) - end))
        made.append([*row[:6], f"{far:.4f}", *map(str, ends[(k + (k == 35)) % 3])])
    head = [*JOINTS, "distance_mm", "to_x_mm", "to_y_mm", "to_z_mm"]
    told = followed(arm, [head, *made])
    assert doubted(told["readings"]) == [36]
    assert "its distance is to -1500, -1500, 1000 mm" in told["readings"][35]["why"]


@pytest.mark.slow
def test_several_targets_are_followed_and_a_wrong_one_is_named(arm: Path) -> None:
    text = (arm / "robot.toml").read_text().replace("[tool]", '[[tool]]\nname = "P"', 1)
    second = '[[tool]]\nname = "Q"\nxyz_mm = [60, 0, 150]\nunknown = "position"\n\n[gravity]'
    (arm / "robot.toml").write_text(text.replace("[gravity]", second, 1))
    robot = casadical.read_robot(arm / "robot.toml")
    q = draw(robot, 30, Workspace(), np.random.default_rng(1))
    second = np.arange(30) % 2
    flags = {"tool_P": 1.0 - second, "tool_Q": 1.0 * second}
    p = 1e3 * predicted(robot, unmeasured(q, flags))[0] + 0.02 * np.random.default_rng(2).normal(size=(30, 3))
    rows = [[*JOINTS, "x_mm", "y_mm", "z_mm", "tool"]]
    rows += [[*map(repr, map(float, (*a, *b))), "PQ"[k]] for a, b, k in zip(q, p, second, strict=True)]
    rows[28][-1] = "P"
    told = followed(arm, rows)
    assert doubted(told["readings"]) == [28]
    assert "it is of the target Q" in told["readings"][27]["why"]
    assert told["fields"][-1] == "tool"
