"""A file of each kind that the package reads, what reads it, and mutants of it."""

from __future__ import annotations

import io
import json
import random
import re
import shutil
import tempfile
import traceback
from collections.abc import Callable
from itertools import islice
from pathlib import Path

from fuzz_inputs import NUMBERS
from fuzz_world import ANSWER, DETAILS, DRIVE, EFFECTS, URDF, WITHHELD

ROOT = Path(__file__).parents[2]
PACKAGE = str(ROOT / "casadical")
SECONDS, BYTES = 20, 2**30
E6 = "{X 300,Y 0,Z 200,A 0,B 90,C 0,S 2,T 10,E1 0}"
PROGRAMS = {
    "src": f"DEF p( )\n$TOOL={{X 0,Y 0,Z 1,A 0,B 0,C 0}}\n$BASE={{X 0,Y 0,Z 0,A 0,B 0,C 0}}\nPTP {E6}\nLIN {E6} C_DIS\n"
    "PTP {A1 1,A2 2,A3 3,A4 4,A5 5,A6 6}\nDECL E6POS XP1=" + E6 + "\nPTP XP1\nEND\n",
    "mod": "MODULE m\nPERS tooldata t1:=[TRUE,[[0,0,1],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
    "CONST robtarget p1:=[[300,0,200],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"
    "CONST jointtarget j1:=[[1,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"
    "PROC main()\nMoveAbsJ j1,v100,fine,t1;\nMoveL p1,v100\\T:=5,fine,t1;\nENDPROC\nENDMODULE\n",
    "script": "def p():\nset_tcp(p[0,0,0.001,0,0,0])\na_p=p[.3,0,.2,0,3.14,0]\nmovej([0,-1.5,1.5,0,0,0],a=1.4)\n"
    "movel(a_p, a=1.2, v=0.25)\nmovel(p[0.35,0,0.2,0,3.14,0])\nend\n",
    "ls": "/PROG  P\n/ATTR\n/MN\n   1:J P[1] 100% FINE ;\n   2:L P[2] 100mm/sec CNT10 ;\n/POS\nP[1]{\n   GP1:\n"
    "\tUF : 0, UT : 1,\n\tJ1= 1 deg,\tJ2= 2 deg,\tJ3= 3 deg,\n\tJ4= 4 deg,\tJ5= 5 deg,\tJ6= 6 deg\n};\n"
    "P[2]{\n   GP1:\n\tUF : 0, UT : 1,\tCONFIG : 'N U T, 0, 0, 0',\n\tX = 300 mm,\tY = 0 mm,\tZ = 200 mm,\n"
    "\tW = 180 deg,\tP = 0 deg,\tR = 0 deg\n};\n/END\n",
}  # fmt: skip
LAW = """
[[effect]]
name = "law"
joint = 1
settings = {seam = "joint", formula = "a*sin(2*q1) + b*max(0, tau1)/(1 + t**2)", factors = [["a", 3e-5], ["b", 1e-5]]}
[effect.values]
a = {value = 1e-5, unit = "rad", std_error = 2e-6}
b = {value = 1e-5, unit = "rad"}
[[effect]]
name = "backlash"
joint = 2
settings = {friction = 0.1, width = 0.05}
[learnt]
poses = 40
[learnt.readings]
q1_deg = [-90, 90]
q2_deg = [0, 80]
[[covariance]]
names = ["law@1.a", "law@1.b"]
lower = [[4e-12], [1e-12, 9e-12]]
"""


# Files of folders that are logs, and how many folders up the log is named.
SYSTEMS = {
    "sage/state_motor.csv": 0, "sage/control.csv": 0, "sage/joint_list.txt": 0, "bag-db3/metadata.yaml": 0,
    "bag-db3/bag-db3.db3": 0, "bag-mcap/bag-mcap.mcap": 0, "lerobot/meta/info.json": 1,
}  # fmt: skip


class Kind:
    """A kind of file: its name in the world, what reads it there, and how its content is put together."""

    def __init__(self, name: str, seeds: list[bytes], read: Callable[[Path], object], weight: int = 2) -> None:
        self.name, self.seeds, self.read, self.weight = name, seeds, read, weight


def kinds(place: Path) -> dict[str, Kind]:
    """All kinds; place : a folder made by `fuzz.world`"""

    import casadical
    from casadical.blind_check.protocol import read_answers
    from casadical.blind_check.protocol import read_manifest as read_withheld
    from casadical.compensator import load_compensator
    from casadical.core.drive import read_drive
    from casadical.effects.definition import read_definitions
    from casadical.export.c.kernel import Manifest
    from casadical.export.controller.programs.program import read_target_program
    from casadical.export.controller.programs.target import Given
    from casadical.fleet.run import rows
    from casadical.fleet.touches import changes_in_fleet, judge_touches
    from casadical.identification.pose_selection.workspace import read_workspace
    from casadical.measurements.logs.reading import is_log, read_log
    from casadical.project.acceptance.certificate import certificate
    from casadical.project.acceptance.iso9283 import evaluated_table
    from casadical.project.acceptance.verification import promised_rms
    from casadical.project.live import LiveSession
    from casadical.project.live.sources import FileSource, journal, rows_of
    from casadical.project.new.new import new_problem
    from casadical.project.problem import read_problem
    from casadical.project.problem_file import result_in, tables_of

    arm = casadical.read_robot(place / "in/p/robot.toml")
    planar = (place / "in/p/robot.toml").read_bytes()
    own = planar.replace(b"casadical = 1", b"casadical = 2") + LAW.encode()
    robots = [(ROOT / "problems" / name / "robot.toml").read_bytes() for name in ("kr210", "wam", "ur5")]
    table = b"\n".join((place / "in/p/poses.csv").read_bytes().splitlines()[:12])
    problems = [(ROOT / "problems" / name / "problem.toml").read_bytes() for name in ("planar", "ur10", "fr3_camera")]

    def posed(path: Path) -> None:
        robot = casadical.read_robot(path)
        robot.position([0.1] * robot.n, robot.parameters.values)

    def folder(path: Path) -> None:
        read_problem(path.parent)

    def made(path: Path) -> None:
        new_problem(path.parent / "made", dh=path)

    def results(path: Path) -> None:
        robot = result_in(path.parent)
        tables_of(robot)
        promised_rms(robot)

    def program(path: Path) -> None:
        read_target_program(path, Given(), 6)

    def effects(path: Path) -> None:
        for kind in read_definitions(path).values():  # what is accepted has a place in the model
            robot = arm.with_effect(*islice(kind.candidates(arm), 1))
            robot.position([0.1] * robot.n, robot.parameters.values)

    def log(path: Path) -> None:
        read_log(path, unit="deg")

    def log_folder(up: int) -> Callable[[Path], object]:
        return lambda p: read_log(p.parents[up] / "data/episode.parquet" if up else p.parent, arm, unit="deg")

    def followed(path: Path) -> None:
        is_log(path)
        found = rows_of(path, path.read_bytes())
        if found[0]:
            (path.parent / "other").mkdir(exist_ok=True)
            for name in ("problem.toml", "robot.toml"):
                shutil.copy(place / "in/live" / name, path.parent / "other")
            with journal(path.parent / "other") as (course, add):
                LiveSession(path.parent / "other", course, add).feed(FileSource(path))

    def journalled(path: Path) -> None:
        kept = path.read_bytes()
        with journal(path.parent) as (course, add):
            LiveSession(path.parent, course, add).state()
        path.write_bytes(kept)

    def touches(path: Path) -> None:
        judge_touches(place / "in/results", [path], noise_mm=0.05, tolerance_mm=1)

    def iso(path: Path) -> None:
        evaluated_table(path, arm).table()

    def certified(path: Path) -> None:
        certificate(place / "in/results", path, problem=place / "in/p").blocks()

    def stated(path: Path) -> None:
        results(path)
        certificate(path.parent, problem=place / "in/p").to_json()

    here = place / "in"
    listed = [
        Kind("robot.toml", [planar, own, *robots], posed, 6),
        Kind("p/problem.toml", [(place / "in/p/problem.toml").read_bytes(), *problems], folder, 4),
        Kind("poses.csv", [table, table.replace(b",", b";")], lambda p: casadical.read_measurements(p, 2), 4),
        Kind("book.xlsx", [_book(table)], lambda p: casadical.read_measurements(p, 2), 2),
        Kind("poses.parquet", [_columns(table)], lambda p: casadical.read_measurements(p, 2), 2),
        Kind("dh.csv", [(place / "in/dh.csv").read_bytes()], made, 3),
        Kind("arm.urdf", [URDF.encode()], casadical.read_urdf, 3),
        Kind("room.toml", [(place / "in/room.toml").read_bytes()], lambda p: read_workspace(p, arm), 2),
        Kind("my.effect.toml", [EFFECTS.encode()], effects, 3),
        Kind("program.csv", [(place / "in/program.csv").read_bytes()], lambda p: read_target_program(p, Given(), 2), 2),
        Kind("net.json", [(place / "in/net.json").read_bytes()], load_compensator, 3),
        Kind("results/result.json", [(place / "in/results/result.json").read_bytes()], stated, 2),
        Kind(
            "c/manifest.json", [b'{"kernel": {"joints": 2}, "files": {"a.c": "0"}}'], lambda p: Manifest.read(p.parent)
        ),
        Kind("w/withheld.json", [json.dumps(WITHHELD).encode()], lambda p: read_withheld(p.parent)),
        Kind("answers.jsonl", [ANSWER.encode() * 3], read_answers),
        Kind("store/a.parquet", [_parquet()], lambda p: rows(p.parent), 1),
        *(Kind(name, [(here / name).read_bytes()], log, 3) for name in ("log.csv", "rtde.csv", "log.parquet")),
        *(Kind(name, [(here / name).read_bytes()], log_folder(up), 2) for name, up in SYSTEMS.items()),
        Kind("drive.toml", [DRIVE.encode()], lambda p: read_drive(p, 2), 2),
        Kind("certificate.toml", [DETAILS.encode()], certified, 2),
        Kind("fleet.json", [(here / "fleet.json").read_bytes()], changes_in_fleet, 1),
        Kind("2026-03-01.csv", [(here / "2026-03-01.csv").read_bytes()], touches, 2),
        Kind("iso.csv", [(here / "iso.csv").read_bytes()], iso, 2),
        Kind("stdin.csv", [(here / "stdin.csv").read_bytes()], followed, 3),
        Kind("live/measured.jsonl", [(here / "live/measured.jsonl").read_bytes()], journalled, 3),
        *(Kind(f"p.{end}", [text.encode()], program, 2) for end, text in PROGRAMS.items()),
    ]
    return {kind.name: kind for kind in listed}


def _book(table: bytes) -> bytes:
    import openpyxl

    book, out = openpyxl.Workbook(), io.BytesIO()
    for line in table.decode().splitlines():
        book.active.append([float(c) if re.fullmatch(r"[-+.\deE]+", c) else c for c in line.split(",")])
    book.save(out)
    return out.getvalue()


def _columns(table: bytes) -> bytes:
    import pandas as pd

    return pd.read_csv(io.BytesIO(table)).assign(note="a").to_parquet()


def _parquet() -> bytes:
    from casadical.fleet.run import EMPTY_ROW, add

    with tempfile.TemporaryDirectory() as name:
        add(Path(name), {**EMPTY_ROW, "robot": "a", "fingerprint": "b", "status": "ok"})
        return Path(name, "a.parquet").read_bytes()


def fault_of(kind: Kind, place: Path, content: bytes) -> str:
    """What is wrong with a reader of a content; nothing if nothing is."""
    from casadical import CasadicalError

    path = place / kind.name
    shutil.rmtree(path.parent / "made", ignore_errors=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    try:
        kind.read(path)
    except CasadicalError:
        return ""
    except MemoryError:
        return "takes more than 1 GB"
    except Exception as error:
        own = [f for f in traceback.extract_tb(error.__traceback__) if f.filename.startswith(PACKAGE)]
        at = f"{Path(own[-1].filename).relative_to(PACKAGE)}:{own[-1].name}" if own else "outside"
        return f"{type(error).__name__} at {at}: {str(error)[:100]!r}"
    finally:
        path.write_bytes(kind.seeds[0])  # which others are read with
    return ""


def mutated(kind: Kind, rng: random.Random) -> bytes:
    """Return a seed of a kind with tokens dropped, repeated, moved or replaced by others and by numbers at the edge."""
    tokens = re.findall(rb"\w+|\W", rng.choice(kind.seeds))
    for _ in range(rng.randint(1, 4)):
        a, b = sorted(rng.randrange(len(tokens) + 1) for _ in range(2))
        b = min(b, a + rng.choice((1, 3, 30)))
        part = rng.choice(
            ([], tokens[a:b] * rng.randint(2, 50), tokens[::-1][a:b], [rng.choice(NUMBERS).encode()], [b"\xff\x00"])
        )
        tokens[a:b] = part
    return b"".join(tokens)


NAMES = ("q1", "q{joint}", "q{joint}", "tau{joint}", "approach{joint}", "t", "warmth_600s", "payload_kg", "width")
ODD_NAMES = ("tau9", "q0", "joint", "temperature_degC", "__class__", "x")


def formula(rng: random.Random, odd: float, depth: int = 3) -> str:
    """Return a formula of an effect, with operators and calls up to `depth` in one another.

    odd : share of names, calls and numbers that do not exist or are at the edge
    """
    if depth == 0 or rng.random() < 0.2:
        return rng.choice(ODD_NAMES + NUMBERS) if rng.random() < odd else rng.choice((*NAMES, "0.5", "2"))
    a, b = formula(rng, odd, depth - 1), formula(rng, odd, depth - 1)
    sign = rng.choice(("%", "<", "", "/")) if rng.random() < odd else rng.choice("+-**")
    one, two = rng.choice(("sin", "cos", "tanh", "abs", "step", "sign")), rng.choice(("min", "max"))
    if rng.random() < odd:
        one, two = rng.choice(("exp", "sqrt", "eval", "q1", "")), rng.choice(("sin", "pow"))
    return rng.choice((f"{a} {sign} {b}", f"({a}) {sign} ({b})", f"{one}({a})", f"{two}({a}, {b})"))


def effect_file(rng: random.Random) -> bytes:
    """Return an effect file by its grammar: keys that exist, and values of which few or none are odd."""
    odd = rng.choice((0.0, 0.0, 0.05, 0.3))

    def value(*usual: str) -> str:
        number = rng.choice(NUMBERS) or "0"
        strange = ("0.1", number, f"[{number}, 0.2]", f"{{first = {number}, last = 2, count = 3}}", '"near"', "true")
        return rng.choice(strange if rng.random() < odd else usual)

    lines = ["casadical = 2"]
    for k in range(rng.randint(1, 3)):
        seam, own = rng.choice(("joint", "joint", "growth", "tool shift")), f"half * ({formula(rng, odd)})"
        own = f"[{own}, 0, {formula(rng, odd, 1)}]" if seam == "tool shift" else own
        size, unit, grid = value("40e-6", "1"), value('"rad"', '"m"'), value("[0.1, 0.2]", "[0.1]")
        keys = {
            "name": value(f'"own_{k}"'),
            "signature": value('"a step"'),
            "sizes": f"{{half = [{size}, {unit}]}}",
            f"formulas.{value(json.dumps(seam))}": json.dumps(own),
            "settings.width": f"{{default = {value('0.1')}, grid = {grid}}}",
            "needs": value('["payload_kg"]', '["approach{joint}"]'),
            "acts_at": value('"joints"', '"arm"', '"turning joints"'),
            "together": value("true", "false"),
        }
        left = rng.sample(list(keys)[4:], rng.randint(0, 4))
        lines += ["[[definition]]", *(f"{key} = {text}" for key, text in keys.items() if key not in left)]
    return "\n".join(lines).encode()


def log_file(rng: random.Random) -> bytes:
    """Return a joint log by its grammar: a heading of columns, units and rows in time, some cells at the edge."""
    units = ("", "_rad", "_deg", "_A", "_Nm", "_rad_s")
    heads = [
        f"{what}{k}{unit}" for k in (1, 2, 3) for what in ("q", "command", "current", "qd", "tau") for unit in units
    ]
    usual = ["command1_rad", "command2_rad", "q1_rad", "q2_rad"] if rng.random() < 0.7 else []
    columns = ["time_s", *usual, *rng.sample(heads, rng.randint(0, 2) if usual else rng.randint(1, 9))]
    comma, decimal = rng.choice(((",", "."), (";", ","), ("\t", "."), (" ", "."), (",", ",")))
    end, odd = rng.choice(("\n", "\r\n")), rng.choice((0.0, 0.0, 0.01))
    step = float(rng.choice(("0.004", "0.004", "0.002", "0.01", "-0.004", "1e9")))
    lines = [comma.join(columns)]
    for i in range(rng.choice((1, 2, 2, 3, 30, 300))):
        cells = [f"{step * i:.6g}", *(f"{rng.gauss(0, 1):.6g}" for _ in columns[1:])]
        cells = [rng.choice(NUMBERS) if rng.random() < odd else cell for cell in cells]
        lines.append(comma.join(cell.replace(".", decimal) for cell in cells))
    return (rng.choice(("", "", "\ufeff", "# log" + end)) + end.join(lines)).encode()
