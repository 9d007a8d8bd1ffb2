"""A calibration beside the instrument, `casadical measure`: its answers, the slips that it says, what a kill loses.

    python docs/studies/live.py [times] [slips] [kills] > docs/studies/live.txt

The rules by which readings are judged were committed before this study was run. "Real" is the UR10's tracker series C;
everything else is made up by the package's own model: a robot that departs from its file (lengths .3 mm, angles .5
mrad, compliance), noise of .02 mm per coordinate.
"""

import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from casadical import read_problem
from casadical.core.basics import Array
from casadical.identification.accuracy import predicted
from casadical.identification.pose_selection.candidates import draw, expected, one_turn
from casadical.identification.pose_selection.workspace import Workspace
from casadical.project.live import LiveSession
from casadical.project.live.sources import FileSource, Row, journal, rows_of
from casadical.project.new.new import SYNTHETIC_NOISE_M, as_built
from casadical.robot.robot import Robot

ROOT = Path(__file__).parents[2]
ROBOTS = ("ur10", "kr210", "hh800")
KINDS = ("axes", "sign", "unit", "target", "joint", "joint sign", "unmoved")
SESSIONS, FRESH = 43, 100  # of each kind, and the number of the first
SEEN = 1e-3  # a slip that moves the point by less [m] is none
CLEAN, READINGS = 12, 60
KILLS = 200


@contextmanager
def session(robot: str) -> Iterator[LiveSession]:
    """A session of a robot of the problems, in a folder of its own."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "arm"
        folder.mkdir()
        shutil.copy(ROOT / "problems" / robot / "robot.toml", folder)
        text = 'casadical = 1\ntitle = "t"\n[[measurements]]\nfile = "measured.csv"\nkind = "position"\n'
        (folder / "problem.toml").write_text(text)
        with journal(folder) as (course, add):
            yield LiveSession(folder, course, add)


def row(robot: Robot, q: Array, position: Array) -> Row:
    """A reading as a file has it."""
    units = robot.reading_units
    cells = [f"{v:.7g}" for v in q / list(units.values())] + [f"{1e3 * v:.4f}" for v in position]
    return Row((*units, "x_mm", "y_mm", "z_mm"), (), tuple(cells), "study")


def real_or_simulated(robot: str) -> tuple[Array, Array]:
    """Readings and positions of a problem, in the order of its file."""
    parts = [m for _, m in read_problem(ROOT / "problems" / robot).parts()]
    order = np.argsort(np.concatenate([m.row for m in parts]))
    return np.concatenate([m.q for m in parts])[order], np.concatenate([m.position for m in parts])[order]


def times() -> None:
    """Time from a reading to its answer."""
    print("Time from a reading to its answer (kept, judged, what the page shows) [s]")
    print("robot    poses   median    95 %         max")
    for robot in ("ur10", "kr210"):
        problem = read_problem(ROOT / "problems" / robot)
        table = problem.folder / problem.tables[0]["file"]
        rows = rows_of(table, table.read_bytes()).rows
        answers = []
        with session(robot) as live:
            for k in range(100):
                start = time.perf_counter()
                live.take(rows[k])
                live.state()
                answers.append(time.perf_counter() - start)
                live.look_ahead()
        figures = " ".join(f"{v:8.3f}" for v in (np.median(answers), np.quantile(answers, 0.95), max(answers)))
        print(f"{robot:8} {len(answers):5} {figures}", flush=True)


def made_up(robot: Robot, count: int, rng: np.random.Generator) -> tuple[Robot, Array, Array]:
    """A robot as it was built, readings and positions."""
    built = as_built(robot, rng)
    q = draw(one_turn(robot), count, Workspace(), rng)
    return built, q, _measured(built, q) + rng.normal(0.0, SYNTHETIC_NOISE_M, (count, 3))


def _measured(built: Robot, q: Array) -> Array:
    return np.asarray(expected(built, q, {}, "made up").position)


def spoilt(kind: str, built: Robot, q: Array, y: Array, k: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """The k-th reading with a slip."""
    said, place, i = q[k].copy(), y[k].copy(), int(rng.integers(built.n))
    if kind == "axes":
        place = place[list(((1, 0, 2), (0, 2, 1), (2, 1, 0), (1, 2, 0))[rng.integers(4)])]
    elif kind == "sign":
        place[rng.integers(3)] *= -1
    elif kind == "unit":
        place *= (1e-3, 1 / 25.4)[rng.integers(2)]
    elif kind == "target":
        away = rng.normal(size=3)
        m = expected(built, q[[k]], {}, "made up")
        place = place + predicted(built, m)[1][0] @ (away / np.linalg.norm(away) * rng.uniform(0.01, 0.06))
    elif kind == "joint":
        stood = q[k].copy()
        stood[i] = q[k - 1, i] + rng.uniform(0.0, 0.95) * (q[k, i] - q[k - 1, i])
        place = _measured(built, stood[None])[0] + rng.normal(0.0, SYNTHETIC_NOISE_M, 3)
    elif kind == "joint sign":
        said[i] *= -1
    else:
        place = y[k - 1] + rng.normal(0.0, SYNTHETIC_NOISE_M, 3)
    return said, place


def slips() -> None:
    """Slips put in while measuring, and warnings in sessions without any."""
    print(f"\nSlips put in while measuring: {SESSIONS * len(KINDS)} made-up sessions, {', '.join(ROBOTS)}, one each")
    print("kind         sessions   said at once")
    total = 0
    for number, kind in enumerate(KINDS):
        draws = (np.random.default_rng([number, FRESH + k]) for k in range(SESSIONS))
        found = sum(_said_at_once(kind, ROBOTS[k % len(ROBOTS)], rng) for k, rng in enumerate(draws))
        total += found
        print(f"{kind:12} {SESSIONS:8} {found:14}", flush=True)
    count = SESSIONS * len(KINDS)
    print(f"{'all':12} {count:8} {total / count:14.1%}")
    warned = 0
    for k in range(CLEAN):
        rng = np.random.default_rng([99, FRESH + k])
        with session(ROBOTS[k % len(ROBOTS)]) as live:
            _, q, y = made_up(live.robot, READINGS, rng)
            warned += _warnings(live, q, y)
    print(f"False warnings, made up: {warned} in {CLEAN} sessions of {READINGS}, {warned / CLEAN:.2f} a session")
    q, y = real_or_simulated("ur10")
    warned = 0
    for k in range(CLEAN):
        with session("ur10") as live:
            some = np.random.default_rng([98, FRESH + k]).permutation(len(q))[:READINGS]
            warned += _warnings(live, q[some], y[some])
    print(f"False warnings, real UR10: {warned} in {CLEAN} sessions of {READINGS}, {warned / CLEAN:.2f} a session")


def _warnings(live: LiveSession, q: Array, y: Array) -> int:
    """How many readings were ever doubted."""
    ever: set[int] = set()
    for k in range(len(q)):
        live.take(row(live.robot, q[k], y[k]))
        ever |= {r["number"] for r in live.state()["readings"] if r["state"] != "good"}
    return len(ever)


def _said_at_once(kind: str, robot: str, rng: np.random.Generator) -> bool:
    """Whether the slip of one session is said at once."""
    with session(robot) as live:
        while True:
            at = int(rng.integers(7, 40))
            built, q, y = made_up(live.robot, at + 2, rng)
            said, place = spoilt(kind, built, q, y, at, rng)
            if np.linalg.norm(_measured(built, said[None])[0] - place) > SEEN and _within(live.robot, said):
                break
        for k in range(at):
            live.take(row(live.robot, q[k], y[k]), judge=k == at - 1)
        live.take(row(live.robot, said, place))
        return bool(live.state()["readings"][at]["state"] == "doubtful")


def _within(robot: Robot, q: Array) -> bool:
    lower, upper = robot.limits
    return bool(((q > lower) & (q < upper)).all())


def kills() -> None:
    """A process that is killed at random moments while it keeps readings of a growing file."""
    rng, nominal = np.random.default_rng(96), read_problem(ROOT / "problems/planar").robot
    with tempfile.TemporaryDirectory() as scratch:
        folder, table = Path(scratch) / "arm", Path(scratch) / "tracker.csv"
        folder.mkdir()
        shutil.copy(ROOT / "problems/planar/robot.toml", folder)
        (folder / "problem.toml").write_text('casadical = 1\ntitle = "t"\n')
        _, q, y = made_up(nominal, KILLS, rng)
        rows = [row(nominal, *reading) for reading in zip(q, y, strict=True)]
        table.write_text(",".join(rows[0].header) + "\n")
        with session("planar") as warm:  # what is compiled once, each child of this process has
            for first in rows[:8]:
                warm.take(first)
        answered, lost = 0, 0
        for k in range(KILLS):
            with table.open("a") as file:
                file.write(",".join(rows[k].cells) + "\n")
            reader, writer = os.pipe()
            child = os.fork()
            if child == 0:
                _child(folder, table, writer)
            os.close(writer)
            time.sleep(float(rng.uniform(0.0, 0.8)))
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            with os.fdopen(reader, "rb") as told:
                answered = max([answered, *map(int, told.read().split())])
            path = folder / "measured.jsonl"
            kept = path.read_bytes().count(b'"do": "read"') if path.exists() else 0
            lost += max(0, answered - kept)
    print(f"\nKilled {KILLS} times; {answered} readings were answered before a kill, of which were lost: {lost}")


def _child(folder: Path, table: Path, writer: int) -> None:
    try:
        with journal(folder) as (course, add):
            live = LiveSession(folder, course, add)
            os.write(writer, f"{len(course.readings)} ".encode())
            while True:
                numbers, _ = live.feed(FileSource(table))
                if numbers:
                    os.write(writer, f"{numbers[-1]} ".encode())
                time.sleep(0.01)
    finally:
        os._exit(1)


if __name__ == "__main__":
    every = {f.__name__: f for f in (times, slips, kills)}
    for name in sys.argv[1:] or every:
        every[name]()
