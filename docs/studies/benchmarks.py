"""Identification benchmark, made with: python docs/studies/benchmarks.py --python figaroh=VENV/bin/python --python ...

Every contender (a file in benchmarks/contenders) identifies the same arm from the same measurements, each in a
process of its own with a time and a memory limit, and predicts poses whose truth only this script knows. What is
compared and how fair that is: benchmarks.md.
"""

import argparse
import json
import os
import platform
import signal
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent / "benchmarks"
sys.path.insert(0, str(HERE))

from declared import declared  # noqa: E402
from problem import N_IDENTIFIABLE, SIGMA_M, make  # noqa: E402

REFERENCE = "numpy-handmade"
HEADER = (
    "contender            build [s]  solve [s]  x numpy  x with build  import [s]  first [s]  held-out [mm]"
    "  peak [MB]  notes"
)
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--python", action="append", default=[], metavar="NAME=PATH", help="Python for a contender or package"
    )
    parser.add_argument("--poses", type=int, nargs="+", default=[50, 500, 5000])
    parser.add_argument("--only", nargs="+", help="contenders to run besides the reference")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=5, help="runs after the first, at least")
    parser.add_argument("--budget", type=float, default=15.0, help="no further repeat after so many seconds")
    parser.add_argument("--limit", type=float, default=300.0, help="seconds until a contender is stopped")
    parser.add_argument("--memory", type=float, default=4096.0, help="address space a contender may take [MB]")
    return parser.parse_args()


def contenders(only: list[str] | None) -> dict[str, Path]:
    """Variant -> file, the reference first."""
    found = {variant: path for path in sorted(HERE.glob("contenders/*.py")) for variant in declared(path)["VARIANTS"]}
    unknown = set(only or ()) - set(found)
    if unknown:
        sys.exit(f"no contender {', '.join(sorted(unknown))}; there are {', '.join(found)}")
    chosen = [name for name in found if name != REFERENCE and (only is None or name in only)]
    return {REFERENCE: found[REFERENCE], **{name: found[name] for name in chosen}}


def interpreter(variant: str, path: Path, choices: list[str]) -> str:
    """The Python given for this variant or for a package it needs, else the one running this script."""
    given = dict(choice.split("=", 1) for choice in choices)
    return next((given[name] for name in (variant, *declared(path)["NEEDS"].values()) if name in given), sys.executable)


def measure(variant: str, path: Path, python: str, data_file: Path, options: argparse.Namespace) -> dict:
    """Report of one contender on one data set; never raises for what the contender does."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        limits = [str(x) for x in (options.repeats, options.budget, options.memory)]
        command = [python, str(HERE / "worker.py"), str(path), variant, str(data_file), str(result), *limits]
        environment = {**os.environ, **ONE_THREAD, "XDG_CACHE_HOME": folder}  # a cache starts cold
        with (Path(folder) / "log").open("w") as log:
            worker = subprocess.Popen(command, stdout=log, stderr=log, env=environment, start_new_session=True)
            try:
                worker.wait(options.limit)
                ending = f"died with code {worker.returncode}"
            except subprocess.TimeoutExpired:
                ending = f"stopped after {options.limit:.0f} s"
            finally:
                if worker.poll() is None:
                    os.killpg(worker.pid, signal.SIGKILL)
                    worker.wait()
        if result.exists():
            return json.loads(result.read_text())
        last_words = (Path(folder) / "log").read_text(errors="replace").strip().splitlines()
        return {"status": ": ".join([ending, *last_words[-1:]])}


def summarise(report: dict, truth: np.ndarray) -> dict:
    """Figures of a report: CPU seconds, medians over the runs after the first (the first if there is no other)."""
    if report["status"] != "ok":
        return {"status": report["status"]}
    again = report["runs"][1:] or report["runs"]
    wall, cpu = (sum(sum(run[clock].values()) for run in report["runs"]) for clock in ("wall", "cpu"))
    figures = {stage: statistics.median(run["cpu"][stage] for run in again) for stage in ("build", "solve")}
    return {
        "status": "ok",
        **figures,
        "first": sum(report["runs"][0]["cpu"].values()),
        "held_out_mm": 1e3 * float(np.linalg.norm(np.array(report["predicted"]) - truth, axis=1).mean()),
        "peak_mb": max(0.0, report["peak_mb"] - report["baseline_mb"]),
        "import_s": report["import_s"],
        "runs": len(report["runs"]),
        "spread_mm": 1e3 * max(run["spread_m"] for run in report["runs"]),
        "wall_over_cpu": wall / cpu,
        "notes": report["notes"],
        "versions": report["versions"],
    }


def line(variant: str, row: dict, numpy_solve: float, numpy_error: float) -> str:
    """A line of the table; the reference's solve [s] was measured beside this contender, its error is in mm."""
    if row["status"] != "ok":
        return f"{variant:20} {row['status']}"
    notes = [f"{value} {name}" if value.isdigit() else f"{name} {value}" for name, value in row["notes"].items()]
    excess = row["held_out_mm"] / numpy_error
    notes += [f"ERROR {excess:.0f} x numpy's"] if excess > 1.2 else []
    notes += ["one run only"] if row["runs"] == 1 else []
    notes += [f"runs differ by {row['spread_mm']:.1g} mm"] if row["spread_mm"] > 1e-6 else []
    times = f"{row['build']:9.4f} {row['solve']:10.4f}"
    ratios = f"{row['solve'] / numpy_solve:8.1f} {(row['build'] + row['solve']) / numpy_solve:13.1f}"
    result = f"{row['import_s']:11.3f} {row['first']:10.4f} {row['held_out_mm']:14.5f} {row['peak_mb']:10.1f}"
    return f"{variant:20} {times} {ratios} {result}  {', '.join(notes)}"


def compare(n: int, options: argparse.Namespace, folder: Path) -> dict[str, dict]:
    """Measures and prints all contenders at n poses, the reference before and after each of the others."""
    data, truth = make(n, options.seed)
    data_file = folder / f"{n}.npz"
    np.savez(data_file, **vars(data))
    files = contenders(options.only)

    def measured(variant: str) -> dict:
        python = interpreter(variant, files[variant], options.python)
        row = summarise(measure(variant, files[variant], python, data_file, options), truth)
        if variant == REFERENCE and row["status"] != "ok":
            sys.exit(f"{REFERENCE}: {row['status']}")
        return row

    floor = 1e3 * SIGMA_M * np.sqrt(N_IDENTIFIABLE / n)
    print(f"\n{n} poses; noise floor about {floor:.5f} mm (RMS at the measured poses)")
    print(HEADER)
    rows = {REFERENCE: measured(REFERENCE)}
    error, solves = rows[REFERENCE]["held_out_mm"], [rows[REFERENCE]["solve"]]
    print(line(REFERENCE, rows[REFERENCE], solves[0], error), flush=True)
    for variant in files:
        if variant == REFERENCE:
            continue
        rows[variant] = measured(variant)
        solves.append(measured(REFERENCE)["solve"])
        rows[variant]["numpy_solve"] = statistics.mean(solves[-2:])
        print(line(variant, rows[variant], rows[variant]["numpy_solve"], error), flush=True)
    print(f"{REFERENCE} took between {min(solves):.4f} and {max(solves):.4f} s in {len(solves)} processes")
    return rows


def main() -> None:
    options = arguments()
    print(f"{platform.machine()}, {os.cpu_count()} cores, one thread each, Python {platform.python_version()}")
    print("Seconds are CPU seconds: median of the runs after the first; 'first' is build + solve of the first run.")
    print(f"'x numpy' is solve over that of {REFERENCE} just before and after; 'peak' is above what the imports took.")
    with tempfile.TemporaryDirectory() as folder:
        results = {n: compare(n, options, Path(folder)) for n in options.poses}
    good = {name: row for rows in results.values() for name, row in rows.items() if row["status"] == "ok"}
    versions = {f"{package} {version}" for row in good.values() for package, version in row["versions"].items()}
    print("\nVersions: " + ", ".join(sorted(versions)))
    busy = statistics.median(
        row["wall_over_cpu"] for rows in results.values() for row in rows.values() if row["status"] == "ok"
    )
    print(f"Wall over CPU time, median: {busy:.2f} (1 on an idle machine).")


if __name__ == "__main__":
    main()
