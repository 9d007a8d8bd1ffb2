"""The same answer on every processor: python docs/studies/processors.py [--quick] [--only REGEX] [--jobs 1]

Every command on every shipped problem, practice campaign and example is run as this machine runs it, and as others do:
with OpenBLAS's kernels for other processors, two threads, without compiled functions, numpy without its vector
instructions, and with every reading moved by 1e-12 of itself. What must be equal:

- exit codes, all words that are printed, verdicts, causes, chosen poses
- numbers in JSON, to 1e-7 of their standard error where one stands beside them, else to 1e-6 of themselves; with moved
  readings, which are 1e-7 of a standard error themselves, to 1e-5 of either
- robot files and the C made from them, to the byte (not where readings moved)

`--quick` runs two other kernels and moved readings on one command of most kinds, for `.ci/run`; `compare` is left to
the whole study, since its numbers are known to 5e-7 of their standard errors alone. With `--folder` what ran stays
there, and the next run continues with what is left; `--minutes` ends it after a command.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from same_answers import ROOT, commands

# Of a standard error; of a number without one; of numbers whose size says nothing, in their units (mm, deg, shares).
OF_ERROR, OF_ITSELF, WHOLE = 1e-7, 1e-6, 1e-9
# A number of so few decimals was rounded: one that stands between two may be either. Such are listed, and not counted
# unless they are more than this share of a command's: numbers that are known to the limits above are so near as rarely.
FEW, ROUNDED, BETWEEN = 5, "the last digit of a rounded number", 0.02
KERNELS = ("Haswell", "Zen", "Nehalem", "Prescott", "Sandybridge", "SkylakeX")
MOVED, BARE = "readings", "interpreted"
ENVIRONMENTS: dict[str, dict[str, str]] = {
    **{name: {"OPENBLAS_CORETYPE": name} for name in KERNELS},
    "two threads": {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"},
    BARE: {"PATH": "/nowhere"},  # no compiler: nothing is compiled, and an export not verified
    "plain numpy": {"NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 X86_V3 X86_V4 AVX512F"},
    MOVED: {},
}
QUICK = ("Nehalem", "Prescott", MOVED)
QUICK_COMMANDS = r"^(calibrate-(planar|kr210)|check-planar|diagnose-kr210-P02|plan-planar|export-kr210)$"
VOLATILE = re.compile(r"(seconds|duration|elapsed|version|created|_s\b|time|sha256|hash)")
# Headings of joints' readings, positions and distances; masses, times and directions are no readings.
READINGS = re.compile(r"^(q|joint|j|theta|axis)_?\d+|^[xyz](_|$)|distance", re.IGNORECASE)
ERRORS = ("std_error", "standard_error", "error", "std")


def todo(scratch: Path, only: str) -> dict[str, list[str]]:
    """Commands by name; OUT and MADE as of `same_answers`."""
    found = commands(scratch)
    found["plan-planar"] = ["plan", "problems/planar", "-n", "8", "--out", "OUT/plan.csv", "--quiet"]
    wanted = {name: words for name, words in found.items() if re.search(only, name)}
    needed = {match for words in wanted.values() for match in re.findall(r"MADE/([\w-]+)", " ".join(words))}
    return {name: words for name, words in found.items() if name in wanted or name in needed}


def inputs(place: Path, moved: bool) -> None:
    """Problems, data of the repository and tables made from them, with every reading moved where that is asked for."""
    for source in (ROOT / "problems", ROOT / "data", place.parents[1] / "inputs"):
        shutil.copytree(source, place / source.name, ignore=shutil.ignore_patterns("*.xz", "answers*"))
    rng = random.Random(0)
    for path in place.rglob("*.csv") if moved else ():
        head, *rows = path.read_text("utf-8").splitlines()
        own = [k for k, name in enumerate(head.split(",")) if READINGS.search(name.strip())]
        cells = [row.split(",") for row in rows]
        for row in cells:
            for k in own:
                if k < len(row) and re.fullmatch(r"-?\d+(\.\d+)?(e-?\d+)?", row[k].strip()):
                    row[k] = repr(float(row[k]) * (1 + 1e-12 * rng.uniform(-1, 1)))
        path.write_text("\n".join([head, *(",".join(row) for row in cells)]) + "\n", "utf-8")


def place_of(base: Path, which: str) -> Path:
    """Folder of an environment; all names are as long and have no space: commands that are printed break alike."""
    return base / "as" / which.replace(" ", "_").ljust(max(map(len, ENVIRONMENTS)), "_")


def run(name: str, words: list[str], place: Path, environment: dict[str, str]) -> None:
    """One command; what it writes, prints and returns goes to a folder of its name."""
    out = place / "made" / name
    if (out / "printed.txt").exists():  # of a run before
        return
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    own = {"OUT": out, "MADE": place / "made", str(place.parents[1] / "inputs"): place / "inputs"}
    for word, stands_for in own.items():
        words = [w.replace(word, str(stands_for)) for w in words]
    program = [sys.executable, "-c", "from casadical.cli import main; main()", *words]
    usual = {"OMP_NUM_THREADS": "1", "COLUMNS": "120", "NO_COLOR": "1", "CASADICAL_CACHE": str(place / "cache")}
    whole = {**os.environ, "PYTHONPATH": str(ROOT), **usual, **environment}
    done = subprocess.run(program, cwd=place, env=whole, capture_output=True, text=True)
    (out / "printed.txt").write_text(f"exit code {done.returncode}\n{done.stdout}{done.stderr}".replace(str(place), ""))


def differences(a: Any, b: Any, place: str, times: float, error: float = 0.0) -> list[str]:
    """Of two JSON trees; times : of the limits; error : the standard error that stands beside a number"""
    if isinstance(a, dict) and isinstance(b, dict):
        lost = [f"{place}: keys {sorted(set(a) ^ set(b))}"] if set(a) != set(b) else []
        beside = next((float(a[key]) for key in ERRORS if isinstance(a.get(key), int | float)), 0.0)
        both = [key for key in a if key in b and not VOLATILE.search(str(key))]
        return lost + [line for key in both for line in differences(a[key], b[key], f"{place}.{key}", times, beside)]
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            return [f"{place}: {len(a)} entries and {len(b)}"]
        return [d for i, (x, y) in enumerate(zip(a, b, strict=True)) for d in differences(x, y, f"{place}[{i}]", times)]
    if isinstance(a, float) and isinstance(b, int | float):
        limit = max(times * OF_ERROR * abs(error) if error else times * OF_ITSELF * abs(a), times * WHOLE)
        near = abs(a - b) <= limit or (a != a and b != b)
        digits = max(len(repr(x).partition(".")[2]) for x in (a, b))
        rounded = "e" not in repr(a) and digits <= FEW and abs(a - b) < 1.5 * 10.0**-digits
        how = ROUNDED if rounded else f"{abs(a - b) / max(abs(a), abs(b)):.1e} of it"
        return [] if near else [f"{place}: {a!r} and {b!r} ({how})"]
    return [] if a == b else [f"{place}: {a!r} and {b!r}"[:300]]


def compared(one: Path, other: Path, which: str) -> list[str]:
    """What differs between the folders of one command; which : environment of the other."""
    moved = which == MOVED
    times = 100.0 if moved else 1.0
    names = {p.relative_to(one) for p in one.rglob("*") if p.is_file()}
    names ^= {p.relative_to(other) for p in other.rglob("*") if p.is_file()}
    found = [f"{name}: is in one only" for name in sorted(names) if ".parquet" not in str(name)]
    for path in sorted(p for p in one.rglob("*") if p.is_file()):
        name = path.relative_to(one)
        exported = moved and "c" in name.parts[:-1]  # C of other numbers is another C
        untold = which == BARE and (one / "c").is_dir() and path.suffix not in (".c", ".h", ".st")
        if exported or untold or not (other / name).is_file() or path.suffix in (".html", ".parquet"):
            continue
        a, b = (
            (f / name).read_text("utf-8", "replace").replace(str(f), "").replace(str(f.parents[1]), "")
            for f in (one, other)
        )
        if path.suffix == ".txt":  # a command that is printed breaks where the length of the study's folder makes it
            a, b = (re.sub(r"\s*\\\n\s*", " ", text).replace("'", "") for text in (a, b))
        if moved:  # of robot files with other numbers
            a, b = (re.sub(r"[0-9a-f]{40,64}", "", text) for text in (a, b))
        if a == b:
            continue
        if path.suffix == ".json":
            found += [f"{name}{line}" for line in differences(json.loads(a), json.loads(b), "", times)]
        elif path.suffix == ".csv" or (moved and path.suffix != ".txt"):
            found += [f"{name} {line}" for line in differences(_cells(a), _cells(b), "", times)]
        else:
            lines = [pair for pair in zip(a.splitlines(), b.splitlines(), strict=False) if pair[0] != pair[1]]
            found += [f"{name}: {x.strip()[:100]!r} and {y.strip()[:100]!r}" for x, y in lines or [("", "its end")]]
    return found


def _cells(text: str) -> list[list[Any]]:
    """Words and numbers of every line."""
    number = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")
    cells = [re.split(r"[\s,;(){}\[\]=]+", line) for line in text.splitlines()]
    return [[float(c) if number.fullmatch(c) else c for c in row] for row in cells]


def told(base: Path, name: str, which: str) -> bool:
    """Prints what differs of one command as another machine; whether anything does."""
    one = place_of(base, "here") / "made" / name
    found = compared(one, place_of(base, which) / "made" / name, which)
    few = sum(len(re.findall(rf"\.\d{{1,{FEW}}}(?![\de])", p.read_text("utf-8"))) for p in one.rglob("*.json"))
    rounded = [line for line in found if ROUNDED in line]
    others = [line for line in found if line not in rounded or len(rounded) > max(1.0, BETWEEN * few)]
    for line in found[:6]:
        print(f"{'DIFFERS' if line in others else 'ROUNDED'} {which}: {name}: {line}", flush=True)
    if len(found) > 6:
        print(f"{'DIFFERS' if others else 'ROUNDED'} {which}: {name}: and {len(found) - 6} more", flush=True)
    return bool(others)


def study(base: Path, given: argparse.Namespace) -> int:
    """Runs the commands one after the other, each as all machines, and lists what differs."""
    chosen = given.environments.split(",") if given.environments else QUICK if given.quick else tuple(ENVIRONMENTS)
    (base / "inputs").mkdir(exist_ok=True, parents=True)
    wanted = todo(base / "inputs", given.only or (QUICK_COMMANDS if given.quick else ""))
    for which in ("here", *chosen):
        if not place_of(base, which).exists():
            inputs(place_of(base, which), which == MOVED)
    end, ran, count = time.monotonic() + 60 * given.minutes, 0, 0
    for name in wanted:
        if time.monotonic() > end:
            break
        with ThreadPoolExecutor(given.jobs) as pool:
            places = ((which, place_of(base, which), ENVIRONMENTS.get(which, {})) for which in ("here", *chosen))
            list(pool.map(lambda p: run(name, wanted[name], *p[1:]), places))  # noqa: B023
        differs = [which for which in chosen if told(base, name, which)]
        ran, count = ran + 1, count + len(differs)
        print(f"{name}: {len(differs)} of {len(chosen)} differ", flush=True)
    print(f"{ran} of {len(wanted)} commands as {', '.join(chosen)}: {count} of {ran * len(chosen)} differ")
    return 1 if count else 0


def main() -> int:
    """Run as this machine does, and as others, and list what differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", default="")
    parser.add_argument("--environments", default="", help="names, by commas")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="keeps what ran, so that a run can be continued")
    parser.add_argument("--minutes", type=float, default=float("inf"))
    given = parser.parse_args()
    if given.folder:
        return study(given.folder.resolve(), given)
    with tempfile.TemporaryDirectory() as folder:
        return study(Path(folder), given)


if __name__ == "__main__":
    sys.exit(main())
