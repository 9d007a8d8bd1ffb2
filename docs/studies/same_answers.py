"""What two versions of the package say to the same inputs: python docs/studies/same_answers.py make|compare FOLDER ...

`make FOLDER --tree CHECKOUT` runs the commands listed here with the package of a checkout (some 15 minutes on one core)
and keeps what they write: JSON, text, robot files, generated C. `compare BEFORE AFTER` lists every difference: numbers
beyond 1e-9 of their size, words, verdicts, and other files that are not equal byte for byte. Inputs are the shipped
problems, practice and sealed campaigns, and series of the real UR10 at 300 poses. Nothing is judged here: a difference
is listed, its reason is for a user who changed the code.
"""

import argparse
import json
import math
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
CAMPAIGNS = ROOT / "data" / "campaigns"
SERIES = {"A": ("ur10_grid", "A_grid"), "B": ("ur10_joints", "B_joint_configurations"), "C": ("ur10", "C_random_poses")}
TOLERANCE = 1e-9  # of a number's size
WHOLE = 1e-12  # of numbers in the units of the JSON: below, a number is rounding
VOLATILE = re.compile(r"(seconds|duration|elapsed|version|created|_s\b|time)")


def commands(scratch: Path) -> dict[str, list[str]]:
    """Arguments of casadical, by the name of what they write; OUT stands for its folder, MADE for that of all."""
    todo: dict[str, str] = {}
    files = [path for path in ROOT.glob("problems/*/problem.toml") if "[[measurements]]" in path.read_text()]
    for folder in sorted(path.parent.name for path in files):
        todo[f"calibrate-{folder}"] = f"calibrate problems/{folder} --json OUT/a.json --out OUT/files --details"
        todo[f"check-{folder}"] = f"check problems/{folder}"
    sealed = sorted(CAMPAIGNS.glob("sealed/*.csv"))[::2][:24] + sorted(CAMPAIGNS.glob("sealed_B/*.csv"))[::10][:16]
    for table in [*sorted(CAMPAIGNS.glob("practice/*.csv")), *sealed]:
        name = table.stem.split("-")[0]
        own = CAMPAIGNS / "robots_B" / f"{name}.robot.toml"
        place = own if own.is_file() else ROOT / "problems" / name
        inputs = f"{place.relative_to(ROOT)} {table.relative_to(ROOT)}"
        todo[f"diagnose-{table.stem}"] = f"diagnose {inputs} --json OUT/a.json --details"
    for series, (folder, table) in SERIES.items():
        lines = (ROOT / f"data/ur10_laser_tracker/series_{table}.csv").read_text().splitlines()
        step, some = (len(lines) - 1) // 300, scratch / f"{series}.csv"
        some.write_text("\n".join([lines[0], *lines[1::step][:300]]) + "\n")
        todo[f"diagnose-ur10-{series}"] = f"diagnose problems/{folder} {some} --json OUT/a.json --details"
    hh800, kr210 = (min(CAMPAIGNS.glob(f"practice/{name}*.csv")).relative_to(ROOT) for name in ("hh800", "kr210"))
    todo["report-hh800"] = f"diagnose problems/hh800 {hh800} --report OUT/a.html --out OUT/files --next OUT/next.csv"
    todo["fleet-three"] = (
        "fleet problems/planar problems/kr210 problems/hh800 --store OUT/store.parquet --json OUT/a.json"
    )
    todo["plan-kr210"] = "plan problems/kr210 -n 20 --out OUT/plan.csv --quiet"
    todo["compare-kr210"] = f"compare {kr210} {kr210.with_stem('kr210-P05')} --robot problems/kr210 --json OUT/a.json"
    todo["report-planar"] = "calibrate problems/planar --report OUT/a.html"
    todo["discover-kr210"] = f"diagnose problems/kr210 {kr210} --laws --json OUT/a.json"
    for name in ("kr210", "ur10"):
        robots = f"MADE/calibrate-{name}/files/SKCM.robot.toml --nominal problems/{name}/robot.toml"
        todo[f"export-{name}"] = f"export c {robots} --out OUT/c --json OUT/a.json --leave-out"
    todo["verify-ur10"] = f"verify MADE/calibrate-ur10/files/SKCM.robot.toml {scratch / 'C.csv'} --json OUT/a.json"
    todo["touches-ur10"] = "plan MADE/calibrate-ur10/files/SKCM.robot.toml --touches 5 --out OUT/touches.csv"
    todo["certificate-ur10"] = "certificate MADE/calibrate-ur10/files --problem problems/ur10 --json OUT/a.json"
    todo["certificate-planar"] = "certificate MADE/calibrate-planar/files --problem problems/planar --json OUT/a.json"
    todo["model-kr210"] = "export model MADE/calibrate-kr210/files/KM.robot.toml --to mjcf --leave-out --out OUT/a.xml"
    todo["fleet-two"] = "fleet problems/planar problems/ur5 --store OUT/store.parquet --json OUT/a.json --no-diagnose"
    for log in sorted((ROOT / "data/so101_logs").glob("*.csv.gz")):
        todo[f"log-{log.name.split('.')[0]}"] = f"diagnose problems/so101 {log.relative_to(ROOT)} --json OUT/a.json"
    table = scratch / "program.csv"
    rows = [line.split(",") for line in (ROOT / kr210).read_text().splitlines()[:11]]
    targets = [k for k, heading in enumerate(rows[0]) if heading.startswith("q")]
    table.write_text("\n".join(",".join(row[k] for k in targets) for row in rows) + "\n")
    model = "MADE/calibrate-kr210/files/SKCM.robot.toml --nominal problems/kr210/robot.toml"
    todo["correct-kr210"] = f"correct {model} {table} --leave-out --out OUT/corrected.csv --json OUT/a.json"
    todo["isolability-kr210"] = "plan problems/kr210 --isolability --json OUT/a.json"
    todo["new-example"] = "new OUT/arm --example"
    todo["calibrate-example"] = "calibrate MADE/new-example/arm --json OUT/a.json --out OUT/files"
    todo["measure-example"] = "measure MADE/new-example/arm --simulate 12 --no-page"
    todo["withheld-kr210"] = "withheld robot problems/kr210 --poses 40 --n 4 --seed 1 --workers 1 --json OUT/a.json"
    table = "data/ur10_laser_tracker/series_B_joint_configurations.csv"
    todo["calibrate-csv"] = f"calibrate problems/ur10_joints {table} --method KM --json OUT/a.json"
    return {name: words.split() for name, words in todo.items()}


def make(folder: Path, tree: Path, jobs: int, only: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    scratch = folder.resolve().parent / "inputs"
    scratch.mkdir(exist_ok=True)
    todo = {name: words for name, words in commands(scratch).items() if re.search(only, name)}
    environment = {
        **os.environ,
        "PYTHONPATH": str(tree.resolve()),
        "PYTHONSAFEPATH": "1",  # else the package of the folder that it runs in comes first
        "OMP_NUM_THREADS": "1",
        "COLUMNS": "120",
        "NO_COLOR": "1",
    }

    def run(name: str) -> None:
        out = folder.resolve() / name
        out.mkdir(exist_ok=True)
        words = [w.replace("OUT", str(out)).replace("MADE", str(folder.resolve())) for w in todo[name]]
        program = [sys.executable, "-c", "from casadical.cli import main; main()", *words]
        done = subprocess.run(program, cwd=ROOT, env=environment, capture_output=True, text=True)
        (out / "stdout.txt").write_text(done.stdout.replace(str(folder.resolve()), "FOLDER"))
        (out / "exit.txt").write_text(f"{done.returncode}\n{done.stderr[-2000:] if done.returncode else ''}")
        print(f"{name}: exit {done.returncode}", flush=True)

    later = [name for name in todo if "MADE" in " ".join(todo[name])]
    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(run, [name for name in todo if name not in later]))
        list(pool.map(run, later))


def differences(a: Any, b: Any, place: str = "") -> list[str]:
    if isinstance(a, dict) and isinstance(b, dict):
        lost = [f"{place}: keys {sorted(set(a) ^ set(b))}"] if set(a) != set(b) else []
        both = [key for key in a if key in b and not VOLATILE.search(str(key))]
        return lost + [line for key in both for line in differences(a[key], b[key], f"{place}.{key}")]
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            return [f"{place}: {len(a)} entries, {len(b)} now"]
        return [line for i, (x, y) in enumerate(zip(a, b, strict=True)) for line in differences(x, y, f"{place}[{i}]")]
    if isinstance(a, int | float) and isinstance(b, int | float) and not isinstance(a, bool):
        near = math.isclose(a, b, rel_tol=TOLERANCE, abs_tol=WHOLE) or (math.isnan(a) and math.isnan(b))
        return [] if near else [f"{place}: {a!r}, now {b!r} ({abs(a - b) / max(abs(a), abs(b)):.1e})"]
    return [] if a == b else [f"{place}: {a!r}, now {b!r}"]


def text_differences(a: str, b: str) -> list[str]:
    before, after = a.splitlines(), b.splitlines()
    if len(before) != len(after):
        return [f"{len(before)} lines, {len(after)} now"]
    return [
        f"line {i}: {x.strip()[:110]!r}, now {y.strip()[:110]!r}"
        for i, (x, y) in enumerate(zip(before, after, strict=True), 1)
        if x != y
    ]


def compare(before: Path, after: Path, only: str, most: int) -> None:
    equal = differing = 0
    for path in sorted(p for p in before.rglob("*") if p.is_file() and ".parquet" not in str(p)):
        name = str(path.relative_to(before))
        if not re.search(only, name) or (not (after / name).parents[len(Path(name).parts) - 2].is_dir()):
            continue
        if not (after / name).is_file():
            lines = ["is not written now"]
        elif path.suffix == ".json" and "compensator" not in name:
            lines = differences(json.loads(path.read_text()), json.loads((after / name).read_text()))
        else:
            lines = text_differences(path.read_text(errors="replace"), (after / name).read_text(errors="replace"))
        equal, differing = equal + (not lines), differing + bool(lines)
        for line in lines[:most]:
            print(f"{name}{line if line[0] in '.[' else ': ' + line}")
        if len(lines) > most:
            print(f"{name}: and {len(lines) - most} more")
    print(f"{equal} files are equal, {differing} differ")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("action", choices=("make", "compare"))
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--tree", type=Path, default=ROOT, help="checkout whose package answers")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="", help="regular expression of names")
    parser.add_argument("--most", type=int, default=6, help="differences printed for a file")
    given = parser.parse_args()
    if given.action == "make":
        make(given.folders[0], given.tree, given.jobs, given.only)
    else:
        compare(given.folders[0], given.folders[1], given.only, given.most)


if __name__ == "__main__":
    main()
