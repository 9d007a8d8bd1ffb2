"""Mutated files for every reader, guided by coverage: python docs/studies/fuzz_files.py [--minutes 15] [--seed 0]

A file of each kind that the package reads is mutated by rules that know no schema: tokens, brackets and lines are
moved, repeated, nested and spliced with those of other files; trees of TOML, JSON and XML get values of other types;
bytes flip, encodings change. Words come from a dictionary of all texts in the package's code. A mutant that reaches
lines of the package which none reached before joins the seeds, as in AFL and libFuzzer. What must hold of every one:

- it is read, or ends with an error of the package (CasadicalError)
- it takes less than 20 s of the processor and 1 GB

The readers run in a process of their own, so that one that is stopped by a limit is counted. Inputs that fail are
written to `--found DIR`; those in tests/fuzz/found failed once, and tests/fuzz reads them again.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import xml.etree.ElementTree as ET
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import tomlkit
from fuzz_inputs import NUMBERS
from fuzz_world import ANSWER, DETAILS, DRIVE, EFFECTS, URDF, WITHHELD, world

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
    from casadical.fleet.store import rows
    from casadical.fleet.touches import changes_in_fleet, judge_touches
    from casadical.measurements.logs.reading import is_log, read_log
    from casadical.pose_selection.workspace import read_workspace
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

    def log(path: Path) -> None:
        read_log(path, unit="deg")

    def log_folder(up: int) -> Callable[[Path], object]:
        return lambda p: read_log(p.parents[up] / "data/episode.parquet" if up else p.parent, arm, unit="deg")

    def followed(path: Path) -> None:
        is_log(path)
        found = rows_of(path, path.read_bytes())
        if found.rows:
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
        Kind("my.effect.toml", [EFFECTS.encode()], read_definitions, 3),
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
    from casadical.fleet.store import EMPTY_ROW, add

    with tempfile.TemporaryDirectory() as name:
        add(Path(name), {**EMPTY_ROW, "robot": "a", "fingerprint": "b", "status": "ok"})
        return Path(name, "a.parquet").read_bytes()


# --- mutations ----------------------------------------------------------------------------------------------------


def dictionary() -> list[str]:
    """Every short text in the code of the package."""
    words: set[str] = set()
    for path in Path(PACKAGE).rglob("*.py"):
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        words |= {n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    return sorted(word for word in words if 0 < len(word) <= 30)


_TOKEN = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?|\w+|\"[^\"\n]*\"|\s+|.", re.DOTALL)
_OPEN, _CLOSE = "([{<", ")]}>"
ODD = ("\x00", "\ufeff", "\u2028", "é", "\U0001f916", "\x85", "\r", "\t", "'", '"', "\\", "%s", "${x}", "\x1b[31m", "#")


class Mutator:
    """Mutations of one seeded sequence."""

    def __init__(self, rng: random.Random, words: list[str]) -> None:
        self.rng, self.words = rng, words

    def mutant(self, name: str, content: bytes, other: bytes) -> bytes:
        """Of a file's content; other : of another file of its kind"""
        suffix = Path(name).suffix
        if suffix == ".xlsx" and self.rng.random() < 0.8:
            return self._zipped(content)
        for _ in range(self.rng.choice((1, 1, 1, 2, 3, 6))):
            content = self._once(suffix, content, other)
        if suffix == ".json" and self.rng.random() < 0.7:
            content = _with_checksum(content)
        return content[:2_000_000]

    def _once(self, suffix: str, content: bytes, other: bytes) -> bytes:
        roll = self.rng.random()
        if suffix in (".parquet", ".db3", ".mcap") or roll < 0.05:
            return self._bytes(content)
        if roll < 0.09:
            return self._encoded(content)
        if roll < 0.4 and suffix in _TREES:
            with suppress(Exception):
                return self._tree(suffix, content)
        text, others = content.decode("utf-8", "surrogateescape"), other.decode("utf-8", "surrogateescape")
        return self._tokens(text, others).encode("utf-8", "surrogateescape")

    def _bytes(self, content: bytes) -> bytes:
        data = bytearray(content or b"\x00")
        for _ in range(self.rng.choice((1, 2, 8))):
            k = self.rng.randrange(len(data))
            how = self.rng.randrange(4)
            if how == 0:
                data[k] = self.rng.randrange(256)
            elif how == 1:
                data[k] ^= 1 << self.rng.randrange(8)
            elif how == 2:
                del data[k : k + self.rng.choice((1, 4, 64))]
            else:
                data[k:k] = data[k : k + self.rng.choice((1, 4, 64))]
            data = data or bytearray(b"\x00")
        return bytes(data)

    def _encoded(self, content: bytes) -> bytes:
        text = content.decode("utf-8", "replace")
        codec = self.rng.choice(("utf-16", "utf-32", "utf-8-sig", "latin-1", "cp932", "utf-7", "utf-16-be", "cp1140"))
        return text.replace("utf-8", codec).encode(codec, "replace")

    def value(self) -> str:
        """A number or a word."""
        how = self.rng.randrange(5)
        if how == 0:
            return self.rng.choice(NUMBERS)
        if how == 1:
            return self.rng.choice("123456789") * self.rng.choice((1, 3, 12, 40, 310, 5000))
        if how == 2:
            return (
                f"{self.rng.choice(('', '-'))}{self.rng.random():.3g}e{self.rng.choice((-400, -30, -3, 2, 9, 30, 400))}"
            )
        return self.rng.choice(ODD if how == 3 and self.rng.random() < 0.5 else self.words)

    def _tokens(self, text: str, other: str) -> str:
        tokens, others = _TOKEN.findall(text) or [""], _TOKEN.findall(other) or [""]
        if len(tokens) > 20_000:
            return text[: self.rng.randrange(len(text))]
        a, b = self._span(tokens)
        piece = tokens[a:b]
        how = self.rng.randrange(9)
        if how <= 2:  # most often one value
            k = self._place(tokens)
            tokens[k : k + 1] = [self.value()]
        elif how == 3:
            del tokens[a:b]
        elif how == 4:
            tokens[a:a] = piece * self.rng.choice((1, 1, 2, 10, 300))
        elif how == 5:
            c, d = self._span(others)
            tokens[a:b] = others[c:d]
        elif how == 6:
            c, _ = self._span(tokens)
            tokens[a:b] = []
            tokens[c:c] = piece
        elif how == 7:
            k = self.rng.randrange(len(_OPEN))
            n = self.rng.choice((1, 3, 60, 3000))
            tokens[a:b] = [_OPEN[k] * n, *piece, _CLOSE[k] * self.rng.choice((n, n, 0))]
        else:
            tokens[a:a] = [self.value()]
        return "".join(tokens)

    def _place(self, tokens: list[str]) -> int:
        """Of a token, rather of a number or a word."""
        good = [k for k, token in enumerate(tokens) if token[:1].isalnum() or token[:1] in '-+"']
        return self.rng.choice(good) if good else 0

    def _span(self, tokens: list[str]) -> tuple[int, int]:
        """Of tokens: some, a line, or what stands in brackets."""
        a, how = self.rng.randrange(len(tokens)), self.rng.randrange(3)
        if how == 0:
            return a, min(len(tokens), a + self.rng.choice((1, 1, 2, 5, 20)))
        if how == 1:
            ends = [k for k, token in enumerate(tokens) if "\n" in token]
            before, after = [k for k in ends if k < a], [k for k in ends if k >= a]
            return (before[-1] + 1 if before else 0), (after[0] + 1 if after else len(tokens))
        opened = [k for k, token in enumerate(tokens) if token in _OPEN]
        if not opened:
            return a, a + 1
        a, depth = self.rng.choice(opened), 0
        for b in range(a, len(tokens)):
            depth += (tokens[b] in _OPEN) - (tokens[b] in _CLOSE)
            if depth == 0:
                return a, b + 1
        return a, len(tokens)

    def _tree(self, suffix: str, content: bytes) -> bytes:
        load, dump = _TREES[suffix]
        tree = load(content.decode())
        if suffix in (".urdf", ".xml"):
            self._xml(tree)
        else:
            holders = [h for h in _holders(tree) if len(h)]
            holder = self.rng.choice(holders)
            key = self.rng.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
            how = self.rng.randrange(6)
            if how == 0:
                del holder[key]
            elif how == 1 and isinstance(holder, dict):
                holder[self.rng.choice(self.words)] = holder[key]
            elif how == 2 and isinstance(holder, list):
                holder.extend([holder[key]] * self.rng.choice((1, 2, 50)))
            elif how == 3:
                holder[key] = self.rng.choice([_holder_copy(h) for h in holders[:20]])
            else:
                holder[key] = self._typed(holder[key])
        return dump(tree).encode("utf-8", "surrogateescape")

    def _typed(self, old: Any) -> Any:
        deep: Any = old
        for _ in range(self.rng.choice((1, 2, 60))):
            deep = [deep]
        numbers = (0, -1, 1, 2, 10**9, 10**310, 2**63, 1e308, -1e-308, 0.5, float("inf"), float("nan"))
        return self.rng.choice((True, "", [], {}, deep, {"a": old}, self.rng.choice(self.words), *numbers))

    def _xml(self, root: ET.Element) -> None:
        nodes = list(root.iter())
        node, other = self.rng.choice(nodes), self.rng.choice(nodes)
        how = self.rng.randrange(5)
        if how == 0 and node.attrib:
            node.attrib[self.rng.choice(list(node.attrib))] = self.value()
        elif how == 1 and node.attrib:
            del node.attrib[self.rng.choice(list(node.attrib))]
        elif how == 2 and other not in node.iter():
            other.append(node)
        elif how == 3 and len(node):
            node.remove(node[self.rng.randrange(len(node))])
        else:
            node.tag = self.rng.choice(nodes).tag

    def _zipped(self, content: bytes) -> bytes:
        out = io.BytesIO()
        with suppress(Exception), zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(out, "w", 8) as new:
            chosen = self.rng.choice(old.namelist())
            for name in old.namelist():
                data = old.read(name)
                new.writestr(name, self._once(".xml", data, data) if name == chosen else data)
        return out.getvalue() or self._bytes(content)


def _holders(tree: Any) -> Iterator[Any]:
    if isinstance(tree, dict | list):
        yield tree
        for value in tree.values() if isinstance(tree, dict) else tree:
            yield from _holders(value)


def _holder_copy(holder: Any) -> Any:
    return json.loads(json.dumps(holder, default=str))


def _with_checksum(content: bytes) -> bytes:
    from casadical.compensator.checksummed_json import digest
    from casadical.core.files import json_text

    with suppress(Exception):
        document = json.loads(content)
        if isinstance(document, dict) and "sha256" in document:
            body = {key: value for key, value in document.items() if key != "sha256"}
            return json_text(body | {"sha256": digest(body)}).encode()
    return content


_TREES: dict[str, tuple[Callable[[str], Any], Callable[[Any], str]]] = {
    ".toml": (lambda text: tomlkit.parse(text).unwrap(), tomlkit.dumps),
    ".json": (json.loads, json.dumps),
    ".jsonl": (lambda text: [json.loads(t) for t in text.splitlines()], lambda t: "\n".join(map(json.dumps, t)) + "\n"),
    ".urdf": (ET.fromstring, lambda tree: ET.tostring(tree, encoding="unicode")),
    ".xml": (ET.fromstring, lambda tree: ET.tostring(tree, encoding="unicode")),
}


# --- running ------------------------------------------------------------------------------------------------------


class Coverage:
    """Lines of the package that ran; code whose lines were long all seen is not looked at any more."""

    def __init__(self) -> None:
        self.lines: set[tuple[CodeType, int]] = set()
        self.idle: Counter[CodeType] = Counter()
        self.new = False

    def __call__(self, frame: FrameType, _event: str, _arg: Any) -> Any:
        code = frame.f_code
        if not code.co_filename.startswith(PACKAGE) or self.idle[code] > 200:
            return None
        self.idle[code] += 1
        return self._line

    def _line(self, frame: FrameType, _event: str, _arg: Any) -> Any:
        at = frame.f_code, frame.f_lineno
        if at not in self.lines:
            self.lines.add(at)
            self.idle[frame.f_code] = 0
            self.new = True
        return self._line


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


def limited(seconds: float) -> None:
    """Limits of this process from now on: so many seconds of the processor, 1 GB beyond what it holds."""
    used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
    resource.setrlimit(resource.RLIMIT_CPU, (int(used + seconds) + 1, resource.RLIM_INFINITY))


def worker(listed: dict[str, Kind], place: Path, given: argparse.Namespace, round_: int) -> None:
    """Mutate and read until the time is over; what happens goes to `log`, the input before it is read to `input`."""
    rng = random.Random(f"{given.seed} {round_}")
    mutator, coverage = Mutator(rng, dictionary()), Coverage()
    pools = {name: list(kind.seeds) for name, kind in listed.items()}
    for path in sorted(place.glob("kept/*/*")):
        pools[path.parent.name.replace("+", "/")].append(path.read_bytes())
    names = [name for name, kind in listed.items() for _ in range(kind.weight)]
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + BYTES, held + BYTES))
    log = (place / "log").open("a", buffering=1)
    sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    left = given.inputs
    while left > 0 and sum(resource.getrusage(resource.RUSAGE_SELF)[:2]) < given.minutes * 60 - given.used:
        left -= 1
        name = rng.choice(names)
        pool = pools[name]
        content = mutator.mutant(name, rng.choice(pool), rng.choice(pool))
        (place / "input").write_bytes(name.encode() + b"\n" + content)
        limited(SECONDS)
        coverage.new = False
        sys.settrace(coverage)
        fault = fault_of(listed[name], place / "work", content)
        sys.settrace(None)
        log.write(json.dumps([name, fault, len(coverage.lines)]) + "\n")
        if fault:
            shutil.copy(place / "input", place / "faults" / f"{abs(hash(fault)) % 10**12}")
        elif coverage.new and len(content) < 100_000:
            pool.append(content)
            kept = place / "kept" / name.replace("/", "+")
            kept.mkdir(exist_ok=True, parents=True)
            (kept / f"{round_}-{len(pool)}").write_bytes(content)


def main() -> int:
    """Run workers one after the other until the processor's time is over, and count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--inputs", type=int, default=10**9, help="most of one worker")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="")
    parser.add_argument("--found", type=Path)
    given = parser.parse_args()
    faults: Counter[tuple[str, str]] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        world(place)
        listed = {name: kind for name, kind in kinds(place).items() if re.search(given.only, name)}
        shutil.copytree(place / "in", place / "work", symlinks=True)
        (place / "faults").mkdir()
        given.used, round_ = 0.0, 0
        began = resource.getrusage(resource.RUSAGE_CHILDREN)
        while given.used < given.minutes * 60 - 1:
            round_ += 1
            process = os.fork()
            if process == 0:
                signal.signal(signal.SIGXCPU, signal.SIG_DFL)
                try:
                    worker(listed, place, given, round_)
                    os._exit(0)
                finally:
                    os._exit(99)
            _, status = os.waitpid(process, 0)
            now = resource.getrusage(resource.RUSAGE_CHILDREN)
            given.used = sum(now[:2]) - sum(began[:2])
            if not status:
                break
            name = (place / "input").read_bytes().partition(b"\n")[0].decode()
            code = os.waitstatus_to_exitcode(status)
            why = f"takes more than {SECONDS} s" if code == -signal.SIGXCPU else f"ends with {code}"
            faults[name, why] += 1
            shutil.copy(place / "input", place / "faults" / f"end-{round_}")
        rows = [json.loads(line) for line in (place / "log").read_text().splitlines()]
        runs = Counter(name for name, _, _ in rows)
        runs.update(name for name, _ in faults.elements())
        faults.update((name, fault) for name, fault, _ in rows if fault)
        lines = max(row[2] for row in rows)
        kept = {name: len(list((place / "kept" / name.replace("/", "+")).glob("*"))) for name in listed}
        if given.found:
            shutil.copytree(place / "faults", given.found, dirs_exist_ok=True)
    print(
        f"{sum(runs.values())} inputs, {given.used / 60:.1f} min of the processor, seed {given.seed}, {round_} workers"
    )
    print(f"{sum(faults.values())} faults of {len(faults)} sorts; {lines} lines of the package reached")
    for name in listed:
        print(f"  {name:22} {runs[name]:6} inputs, {kept[name]:4} reached new lines")
    for (name, fault), count in faults.most_common():
        print(f"FAULT {name}: {fault}  ({count} times)")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
