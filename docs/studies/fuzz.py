"""Hostile inputs for every command: python docs/studies/fuzz.py [--inputs 3000] [--part K/N] [--seed 0]

An input is a command line of a grammar and files that were changed: numbers at the edge of what can be, words in their
place, lines lost, doubled or cut, control characters and markup, folders and links in place of files. Each runs in a
process of its own on a copy of small valid files. What must hold of every one:

- the exit code is a documented one: 0, 2, 3 or 4; not 70, which is a bug, and no signal
- with 2 and 3 a message begins with `casadical: ` or is the usage; `check` prints its findings; with 0 standard error
  is empty; nowhere is a traceback or a control character
- it takes less than 60 s of the processor, and 2 GB beyond what the harness holds
- no input file is changed; with another code than 0 no output is left; no hidden file of an unfinished output is; JSON
  outputs can be read

`--part 2/4` runs the second of four equal parts of the inputs, with the same inputs as the whole. tests/fuzz draws
inputs of the same grammar by hypothesis.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import pkgutil
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

ROOT = Path(__file__).parents[2]
SECONDS, BYTES = 60, 2 * 2**30
CODES = {0, 2, 3, 4}

T = TypeVar("T")
Choose = Callable[[Sequence[Any]], Any]

NUMBERS = (
    "0", "-0.0", "1", "-1", "0.5", "1e-300", "-1e-320", "1e300", "1e308", "-1e308", "1e400", "nan", "inf", "-inf",
    "9" * 30, "9" * 400, "1_000", "0x10", "2,5", "25 kg", "", "true", '"1"', "[1]", "{}", "1e-12", "179.9", "360",
    "-720",
    "2147483648", "-3", "10000000000",
)  # fmt: skip
WORDS = (
    "", "a", "[/x]", "[bold red]x", "\\u0001", "\x01", "\x1b[31m", "\t", "\n", "'", '"', "\\", "*/ x", "-->",
    "<script>", "é",
    "\u202e", "\U0001f916", "..", "../x", "/", "~", "$HOME", "%s", "{0}", "x" * 300, "x" * 5000, "a\x00b", "KM", "SKCM",
    "GP-NN-SKCM", "linear", "huber", "standard", "extended", "backlash", "backlash@2", "backlash@99", "all", "q1",
    "D", "A",
)  # fmt: skip
PATHS = (
    "in/p", "in/p/robot.toml", "in/p/poses.csv", "in/p/problem.toml", "in/results", "in/results/KM.robot.toml",
    "in/results/result.json", "in/program.csv", "in/dh.csv", "in/arm.urdf", "in/room.toml", "in/net.json", "in/none",
    "in/loop", "in/empty", "in/folder", "in/binary", "", ".", "/dev/null", "/dev/full", "x" * 5000, "a[/x]", "in",
)  # fmt: skip
OUTPUTS = (
    "out/a", "out/b.json", "out/b.csv", "out/deep/er/c.html", "out/c.xml", "out/a", "out/[/x]", "out/é \u202e",
    "in/p/robot.toml",
    "in/foreign.txt", "/dev/full", "/dev/null", "out", "in/loop", "out/" + "x" * 300, "/proc/none/x", "in/empty/x",
)  # fmt: skip

# Commands with arguments that are always given, and options: a value of this kind, or None for a flag.
PROBLEM, ROBOT, TABLE = ("in/p",), ("in/results/KM.robot.toml", "in/p/robot.toml"), ("in/p/poses.csv",)
COMMANDS: dict[tuple[str, ...], tuple[tuple[Sequence[str], ...], dict[str, str | None]]] = {
    ("check",): ((PROBLEM,), {"--noise-mm": "number", "--strict": None, "--json": "out", "-q": None}),
    ("calibrate",): (
        (PROBLEM,),
        {
            "--out": "out", "--json": "out", "--report": "out", "--method": "word", "--loss": "word",
            "--seed": "number",
            "--prior": "path", "--prior-effects": "word", "--frozen": None, "-q": None,
        },
    ),
    ("plan",): (
        (PROBLEM + ROBOT,),
        {
            "-n": "small", "--out": "out", "--for": "word", "--criterion": "word", "--room": "path",
            "--measured": "path",
            "--payloads": "number", "--repeats": "small", "--noise-mm": "number", "--min-distance": "number",
            "--target-mm": "number", "--no-order": None, "--seed": "number", "--json": "out", "-q": None,
        },
    ),
    ("new",): (
        (("out/new", "out/[/x]", "out/é", "in/p", "in/empty"),),
        {"--dh": "dh", "--data": "path", "--urdf": "path", "--convention": "word", "--yes": None, "--json": "out"},
    ),
    ("correct",): (
        ((*ROBOT, "in/results"), ("in/program.csv",)),
        {
            "--out": "out", "--nominal": "path", "--compensator": "path", "--payload": "number", "--steps": "small",
            "--tool": "word", "--trust": None, "--leave-out": None, "--overwrite": None, "--json": "out",
        },
    ),
    ("export", "urdf"): ((ROBOT + PROBLEM,), {
        "--out": "out", "--leave-out": None, "--overwrite": None, "--json": "out"}),
    ("export", "mjcf"): ((ROBOT,), {"--out": "out", "--leave-out": None, "--overwrite": None, "--nominal": "path"}),
    ("diagnose",): ((PROBLEM, TABLE), {
        "--effects": "word", "--seed": "number", "--isolability": None, "--json": "out"}),
    ("withheld", "score"): ((("in", "in/p"), ("in/p",), TABLE), {"--json": "out"}),
    ("withheld", "predict"): ((("in", "in/p"),), {"--out": "out", "--by": "word", "--workers": "small"}),
}  # fmt: skip
# Of each command: `out` is needed by these.
NEEDS_OUT = {("correct",), ("export", "urdf"), ("export", "mjcf")}
# So often is each drawn: those that are quick more often.
WEIGHTS = {("diagnose",): 1, ("plan",): 2, ("calibrate",): 4, ("check",): 4, ("new",): 3, ("correct",): 3}
CHANGED = ("p/robot.toml", "p/problem.toml", "p/poses.csv", "results/KM.robot.toml", "program.csv", "dh.csv",
"arm.urdf",
           "room.toml", "net.json", "results/result.json")  # fmt: skip


@dataclass(frozen=True)
class Hostile:
    """One input: the words of the command line, and changes of files (name, kind, place, what is put there)."""

    command: tuple[str, ...]
    changes: tuple[tuple[str, str, int, str], ...]

    def __str__(self) -> str:
        words = " ".join(ascii(w)[1:-1][:60] for w in self.command)
        return f"{words} | " + "; ".join(f"{n} {k} {p} {ascii(v)[:40]}" for n, k, p, v in self.changes)


def draw(choose: Choose) -> Hostile:
    """An input; choose : takes one of a sequence, `random.Random.choice` or one of hypothesis."""
    names = [name for name in COMMANDS for _ in range(WEIGHTS.get(name, 2))]
    name = choose(names)
    arguments, options = COMMANDS[name]
    words = list(name)
    for valid in arguments:
        words.append(choose(valid) if choose(range(8)) else choose(PATHS))
    given = [option for option in options if not choose(range(4))]
    if name in NEEDS_OUT and "--out" not in given:
        given.append("--out")
    for option in given:
        words += [option, *_value(options[option], choose)]
    changes = []
    for _ in range(choose((0, 1, 1, 1, 2))):
        kind = choose(
            ("number", "number", "number", "word", "word", "drop line", "double line", "cut", "put", "replace")
        )
        value = choose(NUMBERS) if kind == "number" else choose(WORDS)
        changes.append((choose(CHANGED), kind, choose(range(400)), value))
    return Hostile(tuple(w.replace("\x00", "") for w in words), tuple(changes))


def _value(kind: str | None, choose: Choose) -> list[str]:
    if kind is None:
        return []
    if kind == "small":
        return [choose((*NUMBERS, "3", "4", "5", "6"))]
    if kind == "dh":
        return [choose(("in/dh.csv", "in/dh.csv", "in/dh.csv", *PATHS))]
    return [choose({"number": NUMBERS, "word": WORDS, "path": PATHS, "out": OUTPUTS[:4] * 4 + OUTPUTS}[kind])]


def load_all() -> None:
    """Every module of the package, so that no child of this process loads it again."""
    import casadical

    for module in pkgutil.walk_packages(casadical.__path__, "casadical."):
        with suppress(ImportError):  # of an extra that is not installed
            importlib.import_module(module.name)


def world(place: Path) -> None:
    """Small valid files of every kind."""
    import numpy as np

    from casadical import calibrate
    from casadical.compensator import Compensator, save_compensator

    folder = place / "in" / "p"
    folder.mkdir(parents=True)
    (place / "out").mkdir()
    planar = ROOT / "problems" / "planar"
    shutil.copy(planar / "robot.toml", folder)
    text = (planar / "problem.toml").read_text().replace("../../data/planar/planar.csv", "poses.csv")
    (folder / "problem.toml").write_text(text)
    table = (ROOT / "data" / "planar" / "planar.csv").read_text().splitlines()
    (folder / "poses.csv").write_text(
        "\n".join([f"{table[0]},payload_kg", *(f"{row},2.5" for row in table[1:])]) + "\n"
    )
    calibrate(folder).write(place / "in" / "results")
    (place / "in" / "program.csv").write_text("q1_deg,q2_deg,speed\n10,20,fast\n30,-40,slow\n")
    (place / "in" / "dh.csv").write_text("a_mm,alpha_deg,d_mm,theta_deg\n0,0,0,0\n400,0,0,0\n300,90,100,0\n")
    (place / "in" / "room.toml").write_text(
        "casadical = 1\nfloor_mm = -2000\n[[joint]]\nnumber = 1\nlimits_deg = [-90, 90]\n"
    )
    (place / "in" / "arm.urdf").write_text(URDF)
    rng = np.random.default_rng(0)
    q = rng.uniform(-1, 1, (30, 2))
    save_compensator(Compensator.fit(q, np.sin(q @ np.ones((2, 3))), folds=2), place / "in" / "net.json")
    (place / "in" / "foreign.txt").write_text("mine\n")
    (place / "in" / "empty").write_text("")
    (place / "in" / "binary").write_bytes(bytes(range(256)))
    (place / "in" / "folder").mkdir()
    (place / "in" / "loop").symlink_to("loop")


URDF = """<robot name="two"><link name="base"/><link name="one"/><link name="two"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 0.1" rpy="0 0 0"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="j2" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0.4 0 0" rpy="0 0 0"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>
"""


def change(place: Path, name: str, kind: str, at: int, value: str) -> None:
    """Change one file of the world."""
    path = place / "in" / name
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    k = at % max(1, len(lines))
    if kind == "number":
        cells = list(_number_spans(text))
        if cells:
            a, b = cells[at % len(cells)]
            text = text[:a] + value + text[b:]
    elif kind == "word":
        spans = [(i, i + 1) for i, c in enumerate(text) if c in '"=,[']
        if spans:
            a, b = spans[at % len(spans)]
            text = text[:b] + value + text[b:]
    elif kind in ("drop line", "double line"):
        lines[k : k + 1] = [] if kind == "drop line" else lines[k : k + 1] * 2
        text = "\n".join(lines) + "\n"
    elif kind == "cut":
        text = text[: len(text) * (at % 100) // 100]
    elif kind == "put":
        a = len(text) * (at % 100) // 100
        text = text[:a] + value + text[a:]
    else:
        text = value
    path.write_text(text, encoding="utf-8", errors="surrogatepass")


def _number_spans(text: str) -> Any:
    import re

    return (m.span() for m in re.finditer(r"(?<![\w.])-?\d+(\.\d+)?(e-?\d+)?", text))


def run(hostile: Hostile, template: Path, scratch: Path) -> tuple[str, int]:
    """What is wrong with the run of an input, nothing if nothing is, and its exit code."""
    place = scratch / "place"
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(template, place, symlinks=True)
    for one in hostile.changes:
        change(place, *one)
    before = snapshot(place / "in")
    began = time.monotonic()
    process = os.fork()
    if process == 0:
        _child(hostile, place)
    deadline = began + 10 * SECONDS  # for one that waits; a busy machine gives little of its processor
    while True:
        done, status, used = os.wait4(process, os.WNOHANG)
        if done:
            break
        if time.monotonic() > deadline:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
            return f"takes more than {10 * SECONDS} s of waiting", -1
        time.sleep(0.005)
    code = os.waitstatus_to_exitcode(status)
    if code == -signal.SIGXCPU:
        return f"takes more than {SECONDS} s", code
    out, error = ((place / name).read_text("utf-8", "replace") for name in ("stdout", "stderr"))
    held = int((place / "held").read_text())
    return _fault(hostile, place, before, code, out, error, used.ru_maxrss * 1024 - held), code


def _held() -> int:
    """Memory of this process [bytes]. A fork begins with less than its parent holds: pages of files are not copied."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _child(hostile: Hostile, place: Path) -> None:
    """The command in this process, which ends here."""
    try:
        os.chdir(place)
        Path("held").write_text(str(_held()))
        for number, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(os.open(place / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        os.dup2(os.open("/dev/null", os.O_RDONLY), 0)
        sys.stdin, sys.stdout, sys.stderr = open(0, closefd=False), open(1, "w"), open(2, "w")  # noqa: SIM115
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))
        sys.argv = ["casadical", *hostile.command]
        from casadical.cli import main

        main()
        code: Any = 0
    except SystemExit as stopped:
        code = stopped.code
    except BaseException:
        import traceback

        traceback.print_exc()
        code = 71
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 0 if code is None else 1)


def snapshot(folder: Path) -> dict[str, str]:
    """Every entry of a folder, with the hash of its content."""
    found = {}
    for path in sorted(folder.rglob("*")):
        plain = path.is_file() and not path.is_symlink() if path.name != "loop" else False
        found[str(path.relative_to(folder))] = hashlib.sha256(path.read_bytes()).hexdigest() if plain else ""
    return found


def _fault(hostile: Hostile, place: Path, before: dict[str, str], code: int, out: str, error: str, used: int) -> str:
    """The first thing that is wrong with what a run left."""
    if "Traceback (most recent call last)" in out + error:
        return "traceback: " + error.strip().splitlines()[-2 if len(error.strip().splitlines()) > 1 else -1][:150]
    if code not in CODES:
        return f"exit code {code}: {error[-150:]!r}"
    if code in (2, 3) and not error.startswith("casadical: ") and "Usage: " not in error and not out.strip():
        return f"no message with exit code {code}: {error[:150]!r}"
    if code == 0 and error:
        return f"standard error with exit code 0: {error[:150]!r}"
    bad = next((c for c in out + error if ord(c) < 32 and c not in "\n\t"), None)
    if bad:
        return f"prints the control character {bad!r}"
    if used > BYTES:
        return f"takes {used / 2**30:.2f} GB"
    after = snapshot(place / "in")
    if after != before:
        names = [n for n in {*before, *after} if before.get(n) != after.get(n)]
        # What --overwrite was asked to replace may be replaced, unless the command reads it.
        asked = hostile.command if "--overwrite" in hostile.command else ()
        names = [n for n in names if f"in/{n}" not in asked]
        # A folder that `new` was told to write gets new files.
        into = hostile.command[1] if hostile.command[0] == "new" and code == 0 else ""
        if any(n in before or not into or Path("in", n).parent != Path(into) for n in names):
            return f"changes inputs: {sorted(names)[:5]}"
    return _outputs_fault(hostile, place, code)


def _outputs_fault(hostile: Hostile, place: Path, code: int) -> str:
    left = sorted((place / "out").rglob("*"))
    if any(p.name.startswith(".casadical-") for p in left):
        return f"leaves a hidden file: {[p.name for p in left]}"
    files = [p for p in left if p.is_file()]
    if code not in (0, 4) and files and hostile.command[0] != "check":
        return f"leaves outputs with exit code {code}: {[p.name for p in files]}"
    for path in files:
        if path.stat().st_size == 0:
            return f"leaves an empty file {path.name!r}"
        if f"--json {path.relative_to(place)}" in " ".join(hostile.command):
            try:
                json.loads(path.read_text())
            except ValueError as error:
                return f"writes {path.name!r}, which is no JSON: {error}"
    return ""


def main() -> int:
    """Draw, run and count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--part", default="1/1")
    given = parser.parse_args()
    part, parts = map(int, given.part.split("/"))
    rng = random.Random(given.seed)
    chosen = [draw(rng.choice) for _ in range(given.inputs)][part - 1 :: parts]
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    codes: Counter[tuple[str, int]] = Counter()
    faults: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        template = Path(name) / "template"
        load_all()
        world(template)
        for one in chosen:
            fault, code = run(one, template, Path(name))
            codes[" ".join(one.command[: 2 if one.command[0] in ("export", "withheld") else 1]), code] += 1
            if fault:
                faults[fault] += 1
                print(f"FAULT {fault}\n   {one}", flush=True)
    print(
        f"part {given.part} of {given.inputs} inputs, seed {given.seed}: {len(chosen)} run, "
        f"{sum(faults.values())} faults"
    )
    for command in sorted({c for c, _ in codes}):
        row = {code: count for (c, code), count in sorted(codes.items()) if c == command}
        print(f"  {command:18}" + "  ".join(f"exit {code}: {count}" for code, count in row.items()))
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
