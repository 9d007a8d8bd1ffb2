"""Same answers on every processor and of two versions: python docs/studies/same_answers.py [--quick] [--tree FOLDER]

Commands on the shipped problems, practice campaigns and examples run as on this machine and as on others: with
OpenBLAS's kernels for other processors, two threads, without compiled functions, numpy without vector instructions, and
with every reading changed by 1e-12 of itself. With `--tree` they run with the package of another checkout instead.
Every difference is printed, and the exit code is 1 if there is one. These must be equal:

- exit codes, all words that are printed, verdicts, causes, chosen poses
- numbers in JSON and CSV: to 1e-7 of their standard error if it is known, else to 1e-6 of themselves; a hundred times
  that if readings are changed; with `--tree` to 1e-9 of themselves
- robot files and C to the byte, unless readings are changed

`--quick` is for `.ci/run`: three environments, one command of most kinds. With `--folder` the results stay there, and
the next run continues.
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
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
MOVED, BARE, TREE = "readings", "interpreted", "tree"
ENVIRONMENTS: dict[str, dict[str, str]] = {
    **{name: {"OPENBLAS_CORETYPE": name} for name in ("Nehalem", "Prescott", "Haswell", "Zen", "SkylakeX")},
    "two_threads": {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"},
    BARE: {"PATH": "/nowhere"},  # no compiler: nothing is compiled, and an export is not verified
    "plain_numpy": {"NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 X86_V3 X86_V4 AVX512F"},
    MOVED: {},
}
QUICK = ("Nehalem", "Prescott", MOVED)
QUICK_COMMANDS = r"^(calibrate-(planar|kr210)|check-planar|diagnose-kr210-P02|plan-planar|export-kr210)$"
# Of a standard error; of a number without one; of numbers whose size means nothing, in their units (mm, deg, shares).
LIMITS = {TREE: (0.0, 1e-9, 1e-12), MOVED: (1e-5, 1e-4, 1e-7)}
USUAL_LIMITS = (1e-7, 1e-6, 1e-9)
# A number of so few decimals was rounded: the last digit may differ, in this share of a command's numbers at most.
DECIMALS, ROUNDED, ROUNDED_SHARE = 5, "the last digit of a rounded number", 0.02
VOLATILE = re.compile(r"(seconds|duration|elapsed|version|created|_s\b|time|sha256|hash)")
# Headings of joint readings, positions and distances; masses, times and directions are no readings.
READINGS = re.compile(r"^(q|joint|j|theta|axis)_?\d+|^[xyz](_|$)|distance", re.IGNORECASE)
ERRORS = ("std_error", "standard_error", "error", "std")


def commands(only: str) -> dict[str, list[str]]:
    """Return arguments of casadical by name; OUT stands for a command's folder, MADE for that of all."""
    todo = {}
    for file in sorted(path for path in ROOT.glob("problems/*/problem.toml") if "[[measurements]]" in path.read_text()):
        name = file.parent.name
        todo[f"calibrate-{name}"] = f"calibrate problems/{name} --json OUT/a.json --out OUT/files --details"
        todo[f"check-{name}"] = f"check problems/{name}"
    for table in sorted((ROOT / "data/campaigns").glob("practice/*.csv")):
        inputs = f"problems/{table.stem.split('-')[0]} {table.relative_to(ROOT)}"
        todo[f"diagnose-{table.stem}"] = f"diagnose {inputs} --json OUT/a.json --details"
    for log in sorted((ROOT / "data/so101_logs").glob("*.csv.gz")):
        todo[f"log-{log.name.split('.')[0]}"] = f"diagnose problems/so101 {log.relative_to(ROOT)} --json OUT/a.json"
    kr210 = "data/campaigns/practice/kr210-P02.csv"
    hh800 = "diagnose problems/hh800 data/campaigns/practice/hh800-P01.csv"
    robot = "MADE/calibrate-kr210/files/SKCM.robot.toml"
    todo |= {
        "plan-planar": "plan problems/planar -n 8 --out OUT/plan.csv --quiet",
        "export-kr210": f"export c {robot} --nominal problems/kr210 --out OUT/c --json OUT/a.json --leave-out",
        "report-hh800": f"{hh800} --report OUT/a.html --out OUT/files --next OUT/next.csv",
        "laws-kr210": f"diagnose problems/kr210 {kr210} --laws --json OUT/a.json",
        "fleet": "fleet problems/planar problems/kr210 problems/hh800 --store OUT/store.parquet --json OUT/a.json",
        "compare-kr210": f"compare {kr210} {kr210.replace('P02', 'P05')} --robot problems/kr210 --json OUT/a.json",
        "verify-kr210": f"verify {robot} {kr210} --json OUT/a.json",
        "touches-kr210": f"plan {robot} --touches 5 --out OUT/touches.csv",
        "certificate-kr210": "certificate MADE/calibrate-kr210/files --problem problems/kr210 --json OUT/a.json",
        "model-kr210": f"export model {robot} --to mjcf --leave-out --out OUT/a.xml",
        "isolability-kr210": "plan problems/kr210 --isolability --json OUT/a.json",
        "new-example": "new OUT/arm --example",
        "measure-example": "measure MADE/new-example/arm --simulate 12 --no-page",
        "withheld-kr210": "withheld robot problems/kr210 --poses 40 --n 4 --seed 1 --workers 1 --json OUT/a.json",
    }
    wanted = {name for name in todo if re.search(only, name)}
    needed = {match for name in wanted for match in re.findall(r"MADE/([\w-]+)", todo[name])}
    return {name: words.split() for name, words in todo.items() if name in wanted | needed}


def copy_inputs(place: Path, moved: bool) -> None:
    """Copy the problems and the data of the repository; moved : whether every reading is changed."""
    for source in (ROOT / "problems", ROOT / "data"):
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
    """Return the folder of an environment; all names are equally long, so that printed commands break alike."""
    return base / which.ljust(max(map(len, ENVIRONMENTS)), "_")


def run(name: str, words: list[str], place: Path, environment: dict[str, str]) -> None:
    """Run one command; what it writes, prints and returns goes to a folder of its name."""
    out = place / "made" / name
    if (out / "printed.txt").exists():  # of an earlier run
        return
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    words = [w.replace("OUT", str(out)).replace("MADE", str(place / "made")) for w in words]
    program = [sys.executable, "-c", "from casadical.cli import main; main()", *words]
    usual = {"OMP_NUM_THREADS": "1", "COLUMNS": "120", "NO_COLOR": "1", "CASADICAL_CACHE": str(place / "cache")}
    whole = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1", **usual, **environment}
    done = subprocess.run(program, cwd=place, env=whole, capture_output=True, text=True)
    (out / "printed.txt").write_text(f"exit code {done.returncode}\n{done.stdout}{done.stderr}".replace(str(place), ""))


def differences(a: Any, b: Any, place: str, limits: tuple[float, float, float], error: float = 0.0) -> list[str]:
    """Return what differs between two JSON trees; error : standard error that is stated for a number."""
    if isinstance(a, dict) and isinstance(b, dict):
        lost = [f"{place}: keys {sorted(set(a) ^ set(b))}"] if set(a) != set(b) else []
        given = next((float(a[key]) for key in ERRORS if isinstance(a.get(key), int | float)), 0.0)
        both = [key for key in a if key in b and not VOLATILE.search(str(key))]
        return lost + [line for key in both for line in differences(a[key], b[key], f"{place}.{key}", limits, given)]
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            return [f"{place}: {len(a)} entries and {len(b)}"]
        pairs = enumerate(zip(a, b, strict=True))
        return [line for i, (x, y) in pairs for line in differences(x, y, f"{place}[{i}]", limits)]
    if isinstance(a, float) and isinstance(b, int | float):
        of_error, of_itself, whole = limits
        limit = max(of_error * abs(error) if error and of_error else of_itself * abs(a), whole)
        near = abs(a - b) <= limit or (a != a and b != b)
        digits = max(len(repr(x).partition(".")[2]) for x in (a, b))
        rounded = "e" not in repr(a) and digits <= DECIMALS and abs(a - b) < 1.5 * 10.0**-digits
        how = ROUNDED if rounded else f"{abs(a - b) / max(abs(a), abs(b)):.1e} of it"
        return [] if near else [f"{place}: {a!r} and {b!r} ({how})"]
    return [] if a == b else [f"{place}: {a!r} and {b!r}"[:300]]


def compared(one: Path, other: Path, which: str) -> list[str]:
    """Return what differs between the folders of one command; which : environment of the other."""
    moved, limits = which == MOVED, LIMITS.get(which, USUAL_LIMITS)
    names = {p.relative_to(one) for p in one.rglob("*") if p.is_file()}
    names ^= {p.relative_to(other) for p in other.rglob("*") if p.is_file()}
    found = [f"{name}: is in one only" for name in sorted(names) if ".parquet" not in str(name)]
    for path in sorted(p for p in one.rglob("*") if p.is_file()):
        name = path.relative_to(one)
        exported = moved and "c" in name.parts[:-1]  # C of other numbers is other C
        unverified = which == BARE and (one / "c").is_dir() and path.suffix not in (".c", ".h", ".st")
        if exported or unverified or not (other / name).is_file() or path.suffix in (".html", ".parquet"):
            continue
        places = ((one, path), (other, other / name))
        a, b = (p.read_text("utf-8", "replace").replace(str(f), "").replace(str(f.parents[1]), "") for f, p in places)
        if path.suffix == ".txt":  # where a printed command breaks depends on the length of the folder's name
            a, b = (re.sub(r"\s*\\\n\s*", " ", text).replace("'", "") for text in (a, b))
        if moved:  # hashes of robot files with other numbers
            a, b = (re.sub(r"[0-9a-f]{40,64}", "", text) for text in (a, b))
        if a == b:
            continue
        if path.suffix == ".json":
            found += [f"{name}{line}" for line in differences(json.loads(a), json.loads(b), "", limits)]
        elif path.suffix == ".csv" or (moved and path.suffix != ".txt"):
            found += [f"{name} {line}" for line in differences(_cells(a), _cells(b), "", limits)]
        else:
            lines = [pair for pair in zip(a.splitlines(), b.splitlines(), strict=False) if pair[0] != pair[1]]
            found += [f"{name}: {x.strip()[:100]!r} and {y.strip()[:100]!r}" for x, y in lines or [("", "its end")]]
    return found


def _cells(text: str) -> list[list[Any]]:
    """Return the words and numbers of every line."""
    number = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")
    cells = [re.split(r"[\s,;(){}\[\]=]+", line) for line in text.splitlines()]
    return [[float(c) if number.fullmatch(c) else c for c in row] for row in cells]


def differs(base: Path, name: str, which: str) -> bool:
    """Print what differs for one command in another environment; return whether anything does but rounding."""
    one = place_of(base, "here") / "made" / name
    found = compared(one, place_of(base, which) / "made" / name, which)
    numbers = sum(len(re.findall(rf"\.\d{{1,{DECIMALS}}}(?![\de])", p.read_text())) for p in one.rglob("*.json"))
    rounded = [line for line in found if ROUNDED in line]
    others = [line for line in found if line not in rounded or len(rounded) > max(1.0, ROUNDED_SHARE * numbers)]
    for line in found[:6] + [f"and {len(found) - 6} more"] * (len(found) > 6):
        print(f"{'DIFFERS' if others else 'ROUNDED'} {which}: {name}: {line}", flush=True)
    return bool(others)


def study(base: Path, given: argparse.Namespace) -> int:
    """Run the commands one after the other in all environments, and print what differs; return the exit code."""
    environments = {which: ENVIRONMENTS[which] for which in (QUICK if given.quick else ENVIRONMENTS)}
    if given.tree:
        environments = {TREE: {"PYTHONPATH": str(given.tree.resolve())}}
    todo = commands(given.only or (QUICK_COMMANDS if given.quick else ""))
    environments = {"here": {}, **environments}
    for which in environments:
        if not place_of(base, which).exists():
            copy_inputs(place_of(base, which), which == MOVED)
    count = 0
    for name, words in todo.items():
        for which, environment in environments.items():
            run(name, words, place_of(base, which), environment)
        wrong = [which for which in environments if which != "here" and differs(base, name, which)]
        count += len(wrong)
        print(f"{name}: {len(wrong)} of {len(environments) - 1} differ", flush=True)
    print(f"{len(todo)} commands in {', '.join(environments)}: {count} of {len(todo) * (len(environments) - 1)} differ")
    return 1 if count else 0


def main() -> int:
    """Run the study in a folder that stays or in a temporary one, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", default="", help="regular expression of names of commands")
    parser.add_argument("--tree", type=Path, help="checkout whose package is compared with this one")
    parser.add_argument("--folder", type=Path, help="where the results stay")
    given = parser.parse_args()
    if given.folder:
        return study(given.folder.resolve(), given)
    with tempfile.TemporaryDirectory() as folder:
        return study(Path(folder), given)


if __name__ == "__main__":
    sys.exit(main())
