"""python docs/studies/mutants.py [--room ROOM] [--seconds S] [--most N]; then --print > docs/studies/mutants.txt

Which wrong formulas would the tests notice? Each mutant is one semantic change of the package: a sign, an index, a
constant, a unit, a dropped term, a swapped function or comparison. Those of LISTED were written by hand; the others are
drawn with a fixed seed from all that the rules below find, so many in each room. A mutant runs tests until one fails:
those of its room (the folder of tests with its name) that call the mutant's function, the quickest first, the others of
their files, and then 60 tests of other rooms that call it. It is killed by a failure, an error or a test that hangs. It
lives if all pass, or if none has failed within the limit (--seconds of processor time, 25); the print says which, and
how many were killed by their own room. Tests that killed one are run without a mutant at the end; a kill by one that
fails then does not count. Mutants that change nothing a caller can see are argued in EQUIVALENT. Which tests call what
is in build/mutants_map.jsonl, which the first run makes by running the tests once; delete it after a change of tests.

A run works in a copy of the repository, appends a line to the log for each mutant, and continues where the log ends:
`--room effects --most 20` runs the next twenty of one room. `--list` prints all mutants.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pytest
from mutants_tests import Bench, chosen, read_map, run_tests

ROOT = Path(__file__).parents[2]
SEED, LIMIT = 16, 25
# Mutants of each room that are drawn.
DRAWN = {
    "core": 16, "effects": 28, "robot": 26, "measurements": 18, "identification": 30, "pose_selection": 20,
    "compensator": 18, "diagnosis": 26, "project": 12, "blind_check": 24, "export": 24, "report": 8, "cli": 6,
}  # fmt: skip
MAP = ROOT / "build" / "mutants_map.jsonl"
LOG = ROOT / "docs" / "studies" / "mutants.jsonl"

# File, what stands there (once), what is put in its place, and what that means.
LISTED = (
    ("identification/least_squares.py", 'if self.loss != "linear":\n            squared',
     "if False:\n            squared", "plain inverse as the covariance of a robust loss"),
    ("identification/residuals.py", "3: 7.81", "3: 12.59", "knee of three degrees of freedom is that of six"),
    ("identification/residuals.py", "6: 12.59", "6: 7.81", "knee of six degrees of freedom is that of three"),
    ("identification/least_squares.py", "near = 1e-5 *", "near = 1e-2 *", "tolerance at a bound"),
    ("identification/screening.py", "LEAST_REDUNDANCY = 0.1", "LEAST_REDUNDANCY = 1.0", "least redundancy"),
    ("identification/identifiability.py", "share = np.abs(covariance[k] / (errors[k] * errors))",
     "share = np.abs(covariance[k])", "correlation is not normalised"),
    ("robot/kinematics.py", "key=lambda k: arm.loops[k - 1].driven)", "key=lambda k: -arm.loops[k - 1].driven)",
     "order of nested loops"),
    ("robot/model.py", "factors = [effect.base(context) for effect in effects]", "factors = []", "seam base dropped"),
    ("robot/model.py", "for effect in effects:\n        moved = moved + effect.joint_angle(context)",
     "for effect in effects[:1]:\n        moved = moved + effect.joint_angle(context)", "angles of the first effect"),
    ("robot/model.py", "*(effect.tool(context) for effect in effects), ", "", "seam tool dropped"),
    ("robot/model.py", "factors += [*row, *(effect.link(i, context) for effect in effects)]", "factors += [*row]",
     "seam link dropped"),
    ("effects/link_flexure.py", "k * (root + end) / 2, k * (2 * root + end) / 6",
     "k * (root + end) / 2, k * (root + 2 * end) / 6", "beam coefficients swapped"),
    ("effects/frame_drift.py", "ca.cross(turn, point)", "ca.cross(point, turn)", "turn of the drifting frame"),
    ("effects/hose_drag.py", "elbow[:3, 2] * self.side", "elbow[:3, 1] * self.side", "offset of the hose's clip"),
    ("effects/bearing_play.py", "context.greatest(max(self.joint - 1, 1), self.joint)",
     "context.greatest(1, self.joint)", "range of the bearing's great torques"),
    ("effects/axis_wobble.py", "ca.cos(q) * x + ca.sin(q) * y, ca.cos(q) * y - ca.sin(q) * x",
     "ca.cos(q) * x - ca.sin(q) * y, ca.cos(q) * y + ca.sin(q) * x", "turn of the wobble"),
    ("effects/gravity_compensator.py", '+ context.values[f"theta{self.joint}"] - self.phase',
     '- context.values[f"theta{self.joint}"] - self.phase', "phase of the balancer"),
    ("effects/base.py", "loads = loads[sum(1 for j in joints[: link - 1] if j.body) :]",
     "loads = loads[sum(1 for j in joints[: link] if j.body) :]", "moment without its first load"),
    ("pose_selection/workspace.py", "(leave > 0) & (enter < 1)", "(leave > 0)", "a box behind the tracker's target"),
    ("pose_selection/workspace.py", "(enter < leave) & (leave > 0)", "(enter < leave)", "a box behind the tracker"),
    ("export/c/intervals.py", "if b[0] <= 0.0 <= b[1]:", "if b[0] < 0.0 < b[1]:", "division by an interval from zero"),
    ("export/c/intervals.py", '{"float": 2.0**-21, "double": 2.0**-50}', '{"float": 0.0, "double": 0.0}',
     "intervals are not widened"),
    ("identification/prediction.py", "A @ S @ A.T, -A @ S", "A @ S @ A.T, A @ S", "held and identified parameters"),
    ("effects/backlash.py", "- self.friction *", "+ self.friction *", "play lies ahead of the last motion"),
    ("effects/friction_windup.py", "against = -context", "against = context", "friction winds ahead"),
    ("effects/payload_error.py", "return -kg *", "return kg *", "sign of the payload's energy"),
    ("effects/base_compliance.py", 'self.value(context, "ry") * moment[1]', 'self.value(context, "ry") * moment[0]',
     "axis of the base's tilt"),
    ("effects/thermal_growth.py", "here[:3, :3].T @", "", "growth in the base's axes"),
    ("effects/refraction.py", "(x**2 + y**2)", "(x**2 - y**2)", "square of the way of the beam"),
    ("effects/gear_eccentricity.py", "ca.sin(2 * q)", "ca.sin(q)", "second harmonic"),
    ("core/transforms.py", "translate(x, y, z) @ rot_x(rx) @ rot_y(ry) @ rot_z(rz)",
     "translate(x, y, z) @ rot_z(rz) @ rot_y(ry) @ rot_x(rx)", "convention of a small frame"),
    ("robot/statics.py", "energy - mass", "energy + mass", "sign of gravity's energy"),
)  # fmt: skip

# Mutants that do not differ from the original, and why: "file:line what".
EQUIVALENT: dict[str, str] = {
    "pose_selection/experimental_design.py:21 1e4 -> 13000.0": "when a determinant is computed again and not updated; "
    "updates lose about log10 of it in digits, 4 or 4.1 of 16",
}


@dataclass(frozen=True)
class Mutant:
    """path : below casadical; line; start, end : which characters of the file; old, new : what they become."""

    room: str
    path: str
    line: int
    start: int
    end: int
    new: str
    what: str

    @property
    def name(self) -> str:
        return f"{self.path}:{self.line} {self.what}"


def listed() -> list[Mutant]:
    """The mutants of LISTED. Stops with SystemExit where the package has changed so that one is not found."""
    found = []
    for path, old, new, what in LISTED:
        text = (ROOT / "casadical" / path).read_text(encoding="utf-8")
        at = text.find(old)
        if at < 0:
            raise SystemExit(f"mutants: {path}: {old!r} is not there any more; correct LISTED")
        found.append(Mutant(path.split("/")[0], path, text.count("\n", 0, at) + 1, at, at + len(old), new, what))
    return found


SWAPPED = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"), ast.MatMult: ("@", "*"),
    ast.Lt: ("<", "<="), ast.LtE: ("<=", "<"), ast.Gt: (">", ">="), ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="), ast.And: ("and", "or"), ast.Or: ("or", "and"),
}  # fmt: skip
NAMES = {
    "sin": "cos", "cos": "sin", "min": "max", "max": "min", "fmin": "fmax", "fmax": "fmin", "argmin": "argmax",
    "argmax": "argmin", "mean": "median", "median": "mean", "deg2rad": "rad2deg", "rad2deg": "deg2rad", "any": "all",
    "all": "any", "sqrt": "abs", "rot_x": "rot_y", "rot_y": "rot_z", "rot_z": "rot_x", "lower": "upper",
    "upper": "lower", "floor": "ceil", "ceil": "floor",
}  # fmt: skip


class _Finder(ast.NodeVisitor):
    """All changes that the rules find in one file."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.starts = [0]
        for line in text.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.found: list[tuple[int, int, int, str, str]] = []

    def place(self, line: int, column: int) -> int:
        """Of a place that ast counts in bytes, in characters."""
        whole = self.text[self.starts[line - 1] : self.starts[line]].encode()
        return self.starts[line - 1] + len(whole[:column].decode())

    def span(self, node: ast.expr) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self.place(node.lineno, node.col_offset), self.place(node.end_lineno, node.end_col_offset)

    def add(self, node: ast.expr, start: int, end: int, new: str) -> None:
        what = f"{self.text[start:end].strip()} -> {new.strip() or 'nothing'}"
        self.found.append((node.lineno, start, end, new, " ".join(what.split())))

    def between(self, left: ast.expr, right: ast.expr, op: ast.AST) -> None:
        """Another operator between two operands, or the right operand of a sum dropped."""
        if type(op) not in SWAPPED:
            return
        old, new = SWAPPED[type(op)]
        start, end = self.span(left)[1], self.span(right)[0]
        at = self.text.find(old, start, end)
        if at >= 0:
            self.add(left, at, at + len(old), new)
        if isinstance(op, ast.Add | ast.Sub) and self.text[start:end].strip() in "+-":
            self.add(left, start, self.span(right)[1], "")

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if not any(isinstance(n, ast.JoinedStr) or (isinstance(n, ast.Constant) and isinstance(n.value, str))
                   for n in (node.left, node.right)):  # fmt: skip
            self.between(node.left, node.right, node.op)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        self.between(node.values[0], node.values[1], node.op)
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        self.between(node.left, node.comparators[0], node.ops[0])
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        start, (operand, _) = self.span(node)[0], self.span(node.operand)
        if isinstance(node.op, ast.USub | ast.Not):
            self.add(node, start, operand, "")
        if not (isinstance(node.op, ast.USub) and isinstance(node.operand, ast.Constant)):
            self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        start, end = self.span(node)
        if isinstance(node.value, bool):
            self.add(node, start, end, str(not node.value))
        elif isinstance(node.value, int):
            self.add(node, start, end, str(node.value + 1))
        elif isinstance(node.value, float):
            unit = node.value in (1e3, 1e-3, 1e6, 1e-6)
            self.add(node, start, end, repr(1 / node.value if unit else 1.3 * node.value + (node.value == 0)))

    def visit_Attribute(self, node: ast.Attribute) -> None:
        self.generic_visit(node)
        _, end = self.span(node)
        if node.attr == "T":
            self.add(node, end - 2, end, "")
        elif node.attr in NAMES:
            self.add(node, end - len(node.attr), end, NAMES[node.attr])

    def visit_Name(self, node: ast.Name) -> None:
        if node.id in NAMES:
            self.add(node, *self.span(node), NAMES[node.id])

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        for part in (*node.body, *node.args.defaults):
            self.visit(part)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        for part in node.body:
            self.visit(part)

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg not in ("strict", "frozen", "eq"):
            self.visit(node.value)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Raise(self, node: ast.Raise) -> None:
        """Messages are no formulas."""

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Nor is text."""

    def visit_Import(self, node: ast.Import) -> None: ...

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None: ...


def drawn(room: str) -> list[Mutant]:
    """Mutants of a room by the rules, as even over its files as their number of changes allows."""
    by_file: list[list[Mutant]] = []
    rng = random.Random(f"{SEED} {room}")
    for path in sorted((ROOT / "casadical" / room).rglob("*.py")):
        text, name = path.read_text(encoding="utf-8"), str(path.relative_to(ROOT / "casadical"))
        finder = _Finder(text)
        finder.visit(ast.parse(text))
        own = [Mutant(room, name, line, start, end, new, what) for line, start, end, new, what in finder.found]
        rng.shuffle(own)
        if own:
            by_file.append(own)
    rng.shuffle(by_file)
    turns = (own.pop() for _ in range(1000) for own in by_file if own)
    return [m for m, _ in zip(turns, range(DRAWN[room]), strict=False)]


def mutants(room: str = "") -> Iterator[Mutant]:
    """All, or those of one room; what was written by hand comes first."""
    yield from (m for m in listed() if room in ("", m.room))
    for name in DRAWN:
        if room in ("", name):
            yield from drawn(name)


def outcome(mutant: Mutant, bench: Bench, stamp: int) -> tuple[str, str]:
    """killed, lived, or late (no test had failed within the limit), and the test that failed."""
    file = bench.root / "casadical" / mutant.path
    original = file.read_text(encoding="utf-8")
    file.write_text(original[: mutant.start] + mutant.new + original[mutant.end :], encoding="utf-8")
    os.utime(file, (stamp, stamp))  # so that no compiled file of another mutant is taken for this one
    try:
        status = run_tests(chosen(bench.known, mutant.room, mutant.path, mutant.line), bench)
    finally:
        file.write_text(original, encoding="utf-8")
        os.utime(file, (stamp + 1, stamp + 1))
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGALRM):
        return "late", ""
    if os.waitstatus_to_exitcode(status) in (0, pytest.ExitCode.NO_TESTS_COLLECTED):
        return "lived", ""
    return "killed", bench.failed.read_text(encoding="utf-8")


def make_map(path: Path, rooms: list[str]) -> None:
    """Run the tests of these rooms once, and note what each calls."""
    path.parent.mkdir(parents=True, exist_ok=True)
    found = [str(Path(__file__).parent), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "MUTANTS_MAP": str(path.resolve()), "PYTHONPATH": os.pathsep.join(found)}
    for room in rooms:
        command = [sys.executable, "-m", "pytest", "-p", "mutants_tests", "-q", f"tests/{room}"]
        subprocess.run(command, cwd=ROOT, env=environment, check=True)


def copied(folder: Path) -> Path:
    """A copy of the repository in which files may be changed; what the tests only read is linked."""
    for path in ROOT.iterdir():
        if path.name in ("casadical", "tests", "docs"):
            shutil.copytree(path, folder / path.name, ignore=shutil.ignore_patterns("__pycache__", "gallery"))
        elif path.name != ".git":
            (folder / path.name).symlink_to(path)
    return folder


def unplaced(name: str) -> str:
    """A mutant's name without its line, which moves."""
    return re.sub(r":\d+ ", " ", name, count=1)


def report(log: Path) -> None:
    """Score by room, and what lived."""
    lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()] if log.exists() else []
    done = {unplaced(line["name"]): line for line in lines}
    known = {unplaced(m.name): m for m in mutants()}
    same_as = {unplaced(name): why for name, why in EQUIVALENT.items()}
    done = {name: line for name, line in done.items() if name in known}
    print(f"{len(done)} of {len(known)} mutants ran; * no failure within the limit")
    print()
    print(f"{'room':16s}   ran  killed  by its own tests  lived  equivalent  score   of")
    for room in (*DRAWN, "all"):
        rows = [line for line in done.values() if room in (line["room"], "all")]
        killed = sum(line["outcome"] == "killed" for line in rows)
        own = sum(f"tests/{line['room']}/" in line.get("by", "") for line in rows)
        same = sum(unplaced(line["name"]) in same_as for line in rows)
        lived = len(rows) - killed - same
        score = f"{killed / (len(rows) - same):6.3f}" if len(rows) > same else "     -"
        total = sum(room in (m.room, "all") for m in known.values())
        print(f"{room:16s} {len(rows):5d} {killed:7d} {own:17d} {lived:6d} {same:11d} {score} {total:4d}")
    print()
    print("lived:")
    for name, line in done.items():
        if line["outcome"] != "killed" and name not in same_as:
            print(f"  {line['name']}{' *' if line['outcome'] == 'late' else ''}")
    print("\n".join(["", "equivalent:", *(f"  {name}: {why}" for name, why in EQUIVALENT.items())] * bool(EQUIVALENT)))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--room", default="")
    parser.add_argument("--seconds", type=int, default=LIMIT)
    parser.add_argument("--most", type=int, default=1000)
    parser.add_argument("--log", type=Path, default=LOG)
    parser.add_argument("--map", type=Path, default=MAP, help="which tests call what; made where it is not there")
    parser.add_argument("--print", action="store_true", dest="shown")
    parser.add_argument("--list", action="store_true", dest="names")
    parser.add_argument("--again", default="", help="run those again whose name contains this")
    given = parser.parse_args()
    if given.names:
        print("\n".join(m.name for m in mutants(given.room)))
        return
    if given.shown:
        report(given.log)
        return
    if not given.map.exists():
        make_map(given.map, list(DRAWN))
    for module in ("casadi", "numpy", "pandas", "scipy.stats", "pydantic", "typer", "rich.console", "hypothesis"):
        importlib.import_module(module)  # once for all children
    lines = given.log.read_text(encoding="utf-8").splitlines() if given.log.exists() else []
    known = {unplaced(json.loads(line)["name"]) for line in lines}
    todo = [m for m in mutants(given.room) if given.again in m.name and (given.again or unplaced(m.name) not in known)]
    todo = todo[: given.most]
    with tempfile.TemporaryDirectory() as scratch:
        bench = Bench(copied(Path(scratch)), read_map(given.map), given.seconds)
        done = []
        for k, mutant in enumerate(todo):
            began = time.monotonic()
            result, by = outcome(mutant, bench, 10**9 + 2 * k)
            done.append({"name": mutant.name, "outcome": result, "by": by, **asdict(mutant)})
            print(f"{result:7s} {time.monotonic() - began:5.0f} s  {mutant.name}  {by}", flush=True)
        unsure = failing_anyway(done, bench)
    with given.log.open("a", encoding="utf-8") as log:
        for line in done:
            log.write(json.dumps(line | ({"outcome": "lived"} if line["by"] in unsure else {})) + "\n")


def failing_anyway(done: list[dict[str, Any]], bench: Bench) -> set[str]:
    """Tests that killed a mutant and fail without one, too: these kills do not count."""
    killers = sorted({str(line["by"]) for line in done if "::" in str(line["by"])})
    wrong: set[str] = set()
    while killers and os.waitstatus_to_exitcode(run_tests(killers, bench)):
        test = bench.failed.read_text(encoding="utf-8")
        print(f"fails without a mutant: {test}", flush=True)
        if test not in killers:
            return set(killers)
        wrong.add(test)
        killers.remove(test)
    return wrong


if __name__ == "__main__":
    main()
