"""Readings as they come: judged before the next, kept whatever happens, calibrated as if the table had come whole."""

import json
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from threading import Timer

import numpy as np
import pytest
from command_line import run

import casadical
from casadical.core.basics import InputError
from casadical.core.files import csv_text
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import unmeasured
from casadical.pose_selection.candidates import draw, expected, held_in
from casadical.pose_selection.workspace import Workspace
from casadical.project.live import LiveSession
from casadical.project.live.session import finished
from casadical.project.live.sources import FileSource, FolderSource, Row, SimulatedSource, StreamSource, journal
from casadical.project.live.view import answer, outlook
from casadical.project.new.new import NOISE, as_built

ROOT = Path(__file__).parents[3]
SERIES = ROOT / "data/ur10_laser_tracker/series_C_random_poses.csv"
JOINTS = [f"q{i}_rad" for i in range(1, 7)]


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """A problem folder of the UR10 without measurements."""
    folder = tmp_path / "arm"
    folder.mkdir()
    shutil.copy(ROOT / "problems/ur10/robot.toml", folder)
    (folder / "problem.toml").write_text('casadical = 1\ntitle = "UR10"\nrobot = "robot.toml"\nloss = "linear"\n')
    return folder


def series(count: int, first: int = 0) -> list[list[str]]:
    """Header and rows of real readings: joints and positions."""
    lines = [line.split(",") for line in SERIES.read_text().splitlines()]
    kept = [lines[0].index(name) for name in (*JOINTS, "x_mm", "y_mm", "z_mm")]
    return [[line[k] for k in kept] for line in (lines[0], *lines[1 + first : 1 + first + count])]


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
    """The readings of a session in which `wrong` spoils some."""
    spoilt = [list(map(repr, wrong(k, [float(c) for c in cells]))) for k, cells in enumerate(rows[1:], 1)]
    with begun(folder) as session:
        take(session, rows[0], *spoilt)
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
    readings = measured(arm, series(12), lambda k, v: slip(v) if k == 10 else v)
    assert doubted(readings) == [10]
    assert re.search(words, readings[9]["why"]), readings[9]["why"]


def test_clean_readings_of_a_real_robot_are_not_doubted(arm: Path) -> None:
    assert {r["state"] for r in measured(arm, series(30), lambda _, v: v)} == {"good"}


def camera(folder: Path) -> list[list[str]]:
    """Header and real poses of the FR3's camera; its robot file in the folder."""
    shutil.copy(ROOT / "problems/fr3_camera/robot.toml", folder)
    lines = [line.split(",") for line in (ROOT / "data/fr3_camera/fr3_114.csv").read_text().splitlines()]
    return [line[1:] for line in lines]  # without the running number


@pytest.mark.parametrize(
    ("slip", "words"),
    [
        (lambda p, R: (-R.T @ p, R.T), "it is the inverse pose"),
        (lambda p, R: (p, R.T), "its orientation is the inverse"),
        (lambda p, R: (p, R @ np.diag([-1.0, -1.0, 1.0])), "its position is plausible, its orientation is not"),
        (lambda p, R: (p[[1, 0, 2]], R), "its axes are swapped: x holds y, y holds x"),
    ],
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
        q, which = held_in(truth, places, 42, Workspace(), rng)
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
        ("point", "point", lambda _: "A", "it is of C, not of A"),
        ("point", "q3_rad", lambda cell: repr(float(cell) + 0.05), "joint 3 stood at"),
        ("plane", "plane", lambda _: "A", "it is of C, not of A"),
        ("dial", "reading_mm", lambda cell: repr(-float(cell)), "the sign of its reading is wrong"),
        ("anchor", "distance_mm", lambda cell: repr(1e-3 * float(cell)), "its distance is in m"),
        ("pose", "distance_mm", lambda cell: repr(1e-3 * float(cell)), "its distance is in m"),
        ("dx", "dx_mm", lambda cell: repr(-float(cell)), "the sign of x is wrong"),
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
    with begun(arm) as session:
        for count, cells in enumerate([[*row, "a"] for row in rows[1:12]] + turned, 1):
            number = take(session, [*rows[0], "session"], cells)
            if count == 13:
                assert "session 'b' has 2 poses" in answer(session.state(), number)
        session.look_ahead()
        assert {r["state"] for r in session.state()["readings"]} == {"good"}


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


def test_the_only_reading_may_be_struck_out(arm: Path) -> None:
    rows = series(2)
    with begun(arm) as session:
        take(session, *rows[:2])
        session.strike(1, "the target was loose")
        assert session.state()["readings"][0]["state"] == "struck"
        take(session, rows[0], rows[2])
        assert [r["state"] for r in session.state()["readings"]] == ["struck", "good"]


def test_it_goes_on_where_it_was_and_ends_as_if_the_table_had_come_whole(arm: Path, tmp_path: Path) -> None:
    rows = series(60)
    whole = tmp_path / "whole"
    shutil.copytree(arm, whole)
    (whole / "measured.csv").write_text(csv_text(rows))
    (whole / "problem.toml").write_text(
        (arm / "problem.toml").read_text() + '\n[[measurements]]\nfile = "measured.csv"\n'
    )
    table = arm / "tracker.csv"
    for count in (25, 60):  # a process that ends between the two
        table.write_text(csv_text(rows[: 1 + count]))
        with journal(arm) as (course, add):
            session = LiveSession(arm, course, add)
            assert len(course.readings) == (0 if count == 25 else 25)
            session.feed(FileSource(table))
    with (arm / "measured.jsonl").open("a") as file:
        file.write('{"do": "read", "at"')  # killed while it wrote
    with journal(arm) as (course, add):
        assert len(course.readings) == 60
    assert (arm / "measured.csv").read_text() == csv_text(rows)
    ours, given = casadical.calibrate(arm, method="KM"), casadical.calibrate(whole, method="KM")
    name = Path("results/KM.parameters.csv")
    assert ours.files("results")[name] == given.files("results")[name]


def test_a_reading_is_struck_out_with_its_reason_and_restored(arm: Path) -> None:
    rows = series(8)
    with begun(arm) as session:
        take(session, *rows)
        with pytest.raises(InputError, match="reason"):
            session.strike(3, " ")
        session.strike(3, "the target <b>was</b> loose")
        assert "leave_out = [4] # 4: the target" in (arm / "problem.toml").read_text()
        assert session.state()["known"]["readings"] == 7
        session.restore(3)
        assert session.state()["known"]["readings"] == 8
        session.repeat(2)
        session.look_ahead()
        assert session.state()["next"]["poses"][0] == session.state()["readings"][1]["joints"]
    assert sum(len(parts[0]) for parts in casadical.read_problem(arm).sets.values()) == 8


def test_typed_readings_count_beside_those_of_a_file_in_other_units(arm: Path) -> None:
    rows = series(6)
    with begun(arm) as session:
        take(session, *rows[:6])
        last = [float(c) for c in rows[6]]
        values = dict(zip(session.fields, map(repr, map(float, [*np.rad2deg(last[:6]), *last[6:]])), strict=True))
        with pytest.raises(InputError, match="q2_deg: give a value"):
            session.type_in({**values, "q2_deg": "nan"})
        assert session.type_in(values) == 6
        assert session.state()["readings"][5]["state"] == "good"
        assert session.type_in(values) is None  # the same again


def test_a_refused_end_names_the_readings_that_were_doubted(arm: Path) -> None:
    rows = series(20)
    rows[15] = [*rows[15][:6], rows[15][7], rows[15][6], rows[15][8]]
    with begun(arm) as session:
        (arm / "t.csv").write_text(csv_text(rows))
        session.feed(FileSource(arm / "t.csv"))
        with pytest.raises(InputError, match=r"does not fit.*doubtful: reading 15: strike out what was a slip"):
            finished(session)


def test_files_as_others_write_them(arm: Path, tmp_path: Path) -> None:
    rows = series(9)
    table, folder = tmp_path / "t.csv", tmp_path / "many"
    with journal(arm) as (course, add):
        session, source = LiveSession(arm, course, add), FileSource(table)
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
        assert any("line 7" in s and "left aside" in s for s in said)
        table.unlink()
        assert "is gone" in session.feed(source)[1][0]
        folder.mkdir()
        (folder / "8.csv").write_text(csv_text([rows[0], rows[8]]))
        (folder / "note.md").write_text("x")
        (folder / "9.csv").write_text(csv_text([rows[0][:3], rows[8][:3]]))
        found, said = session.feed(FolderSource(folder))
        assert len(found) == 1
        assert "has the columns" in said[0]
        assert len(course.readings) == 7


def test_one_process_measures_into_a_folder_and_never_over_measurements(arm: Path) -> None:
    with journal(arm), pytest.raises(InputError, match="another casadical"), journal(arm):
        pass
    (arm / "problem.toml").write_text('casadical = 1\ntitle = "t"\ndata = "real"\n[[measurements]]\nfile = "old.csv"\n')
    with journal(arm) as (course, add), pytest.raises(InputError, match=r"old\.csv"):
        LiveSession(arm, course, add)


def test_a_pose_beyond_the_limits_is_doubted_and_a_lost_cell_is_said(arm: Path) -> None:
    rows = series(8)
    rows[6][1] = "44.0"
    rows[7][6] = ""
    with begun(arm) as session:
        take(session, *rows)
        told = session.state()["readings"]
    assert told[5]["state"] != "good"
    assert "44" in told[5]["why"] or "degrees" in told[5]["why"]
    assert (told[6]["state"], told[6]["why"]) == ("unread", "a cell is empty or no number")
    assert [told[k]["why"] for k in (0, 1, 2, 3, 4, 7)] == [""] * 6
    assert {told[k]["state"] for k in (0, 1, 2, 3, 4, 7)} == {"good"}


def test_positions_that_no_robot_reaches_are_doubted(arm: Path) -> None:
    told = measured(arm, series(7), lambda k, v: [*v[:6], *(1e3 * x for x in v[6:])])
    assert sum(r["state"] == "doubtful" for r in told) >= 5
    assert any("from the others, and the robot reaches" in r["why"] for r in told if r["state"] == "doubtful")


def test_what_the_command_writes_is_not_followed(arm: Path) -> None:
    done = run("measure", arm, "--no-page", "--follow", arm / "measured.csv")
    assert done.returncode == 2
    assert "measured.csv: is what this command writes itself; name what the instrument writes" in done.stderr


def test_a_folder_that_is_not_there_is_not_made(tmp_path: Path) -> None:
    done = run("measure", "none", "--no-page", "--simulate", "1", folder=tmp_path)
    assert (done.returncode, [*tmp_path.iterdir()]) == (2, [])
    assert "none/problem.toml: no such file" in done.stderr


def test_a_clock_that_goes_back_and_another_robots_table_are_said_in_the_terminal_too(arm: Path) -> None:
    rows = series(5)
    with begun(arm) as session:
        for k, cells in enumerate(rows[1:]):
            take(session, [*rows[0], "time_s"], [*cells, str(10 * k - 100 * (k == 4))])
        assert "time_s goes back from 30 to -60 s" in "\n".join(outlook(session.state()))
        assert any("goes back" in text for text in session.state()["said"])
    (arm / "measured.jsonl").unlink()
    with begun(arm) as session:
        take(session, [*rows[0], "q7_rad"], [*rows[1], "0.1"])
        said = answer(session.state(), 1)
        assert said.startswith("1: unread: measured.csv: column 'q7_rad': this robot has only 6 joints")


def test_the_journal_is_lines_of_json(arm: Path) -> None:
    with (arm / "problem.toml").open("a") as file:  # how the table is to be understood, said beforehand
        file.write('[[measurements]]\nfile = "measured.csv"\nkind = "position"\n')
    measured(arm, series(2), lambda _, v: v)
    events = [json.loads(line) for line in (arm / "measured.jsonl").read_text().splitlines()]
    assert [e["do"] for e in events] == ["begin", "read", "read"]
    assert casadical.read_problem(arm).data == "real"
    (arm / "measured.jsonl").write_text('{"do": "strike", "at": "", "id": 5, "why": "x"}\n')
    with pytest.raises(InputError, match="line 1: no reading 5"), journal(arm):
        pass


def test_a_four_bar_that_cannot_close_on_the_way_to_an_explanation_stops_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "hh800"
    folder.mkdir()
    shutil.copy(ROOT / "problems/hh800/robot.toml", folder)
    (folder / "problem.toml").write_text('casadical = 1\ntitle = "t"\n')
    m = casadical.read_problem(ROOT / "problems/hh800").sets["identify"][0]
    with begun(folder) as session:
        units = session.robot.reading_units
        for k in range(11):
            q = m.q[k] * np.where((k == 10) & (np.arange(session.robot.n) == 0), -1, 1)
            cells = [*(q / list(units.values())), *(1e3 * m.position[k])]
            take(session, [*units, "x_mm", "y_mm", "z_mm"], [f"{v:.6f}" for v in cells])
        told = session.state()["readings"]
    assert doubted(told) == [11]
    assert "joint 1 counts the other way" in told[10]["why"]


def test_poses_stay_above_the_plane_that_the_robot_stands_on(arm: Path) -> None:
    """Also where an axis lies in that plane, as the KR 210's and the planar arm's do."""
    for name in ("ur10", "kr210", "planar"):
        shutil.copy(ROOT / f"problems/{name}/robot.toml", arm)
        with begun(arm) as session:
            session.look_ahead()
            told, robot = session.state()["next"], session.robot
        tool = expected(robot, session.plan, {}, "plan").position - robot.base.T[:3, 3]
        assert (tool @ robot.base.T[:3, :3])[:, 2].min() >= -1e-6, name
        assert "not checked" not in told["words"]


def test_the_command_prints_answers_and_keeps_its_figures(arm: Path) -> None:
    table, kept = arm / "t.csv", arm / "state.json"
    table.write_text(csv_text(series(3)))
    assert run("measure", arm, "--no-page").returncode == 2
    both = run("measure", arm, "--no-page", "--follow", table, "--simulate", 3)
    assert "give one of them" in both.stderr
    for given, words in (
        (("--follow", table, "--every", 5), "--every: is for --simulate, not for readings that are measured"),
        (("--simulate", 1, "--port", 8000), "--port: is for the page, not for --no-page"),
    ):
        refused = run("measure", arm, "--no-page", *given)
        assert (refused.returncode, words in refused.stderr) == (2, True), refused.stderr
    for _ in range(2):
        ended = run("measure", arm, "--no-page", "--simulate", 1, "--program", "krl", "--json", kept)
        assert (ended.returncode, ended.stderr) == (0, "")
        assert "PTP {A1" in ended.stdout
    assert [r["state"] for r in json.loads(kept.read_text())["readings"]] == ["good", "good"]
    assert "goes on after 1 readings" in ended.stdout


def test_a_pipe_is_followed_until_its_writer_closes_it(arm: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, into = os.pipe()
    os.write(into, csv_text(series(2)).encode())
    Timer(1.0, os.close, [into]).start()
    with os.fdopen(out) as stream:
        monkeypatch.setattr("sys.stdin", stream)
        done = run("measure", arm, "--no-page", "--follow", "-")
    assert (done.returncode, done.stderr) == (0, "")
    assert len((arm / "measured.csv").read_text().splitlines()) == 3


def test_a_stream_that_cannot_be_read_ends_and_says_so(tmp_path: Path) -> None:
    class Folder:
        def fileno(self) -> int:
            return os.open(tmp_path, os.O_RDONLY)

    source = StreamSource(Folder())
    for _ in range(100):
        if source.ended:
            break
        time.sleep(0.01)
    assert source.ended
    assert "standard input: is read no further" in source.news().said[0]


def test_a_simulated_reading_is_of_a_robot_as_built() -> None:
    arm, q = casadical.read_robot(ROOT / "problems/ur10/robot.toml"), np.linspace(0.3, -1.2, 6)
    (row,) = SimulatedSource(arm, lambda: q, 1).news().rows
    told = np.array([float(cell) for cell in row.cells])
    np.testing.assert_allclose(np.deg2rad(told[:6]), q, atol=1e-7)
    place = predicted(as_built(arm, np.random.default_rng(0)), unmeasured(q[None]))[0][0]
    np.testing.assert_allclose(told[6:], 1e3 * place, atol=5e3 * NOISE)
