"""Build wheel and sdist, and try each in a clean environment, away from the checkout.

    python docs/studies/release.py python3.11 python3.12 python3.13 | tee docs/studies/release.txt

For each Python: the wheel with its base dependencies, then an example arm from `new` to the calibrated robot; of the
first one also the sdist, and the installed packages as .ci/constraints.txt. Needs a package index and hatchling.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
STEPS = (("new", "arm", "--example"), ("check", "arm"), ("calibrate", "arm", "--out", "results"))


def run(*command: str | Path, cwd: Path) -> str:
    """What a command prints; its failure ends the study."""
    done = subprocess.run([*map(str, command)], cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}: {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def megabytes(*paths: Path) -> float:
    return sum(f.stat().st_size for p in paths for f in (p.rglob("*") if p.is_dir() else [p]) if f.is_file()) / 1e6


def tried(python: str, file: Path, folder: Path) -> Path:
    """A new environment with one of the files, in which the example runs; prints a line."""
    folder.mkdir(parents=True)
    run(python, "-m", "venv", "venv", cwd=folder)
    site = next((folder / "venv/lib").glob("python*")) / "site-packages"
    pip, begin = megabytes(site), time.perf_counter()
    run("venv/bin/python", "-m", "pip", "install", "--quiet", file, cwd=folder)
    seconds = time.perf_counter() - begin
    for step in STEPS:
        said = run("venv/bin/casadical", *step, cwd=folder)
    version = run("venv/bin/python", "--version", cwd=folder).split()[1]
    after = next(line.strip() for line in said.splitlines() if line.strip().startswith("after SKCM"))
    own, casadi, every = megabytes(site / "casadical"), megabytes(site / "casadi"), megabytes(site) - pip
    print(
        f"{version:<8} {file.suffix:<5} installed in {seconds:3.0f} s: {every:4.0f} MB, of these casadi {casadi:.0f}, "
        f"casadical {own:.1f} (with byte code); example: {' '.join(after.split()[:3])} mm",
        flush=True,
    )
    return folder


def main(pythons: list[str]) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        dist = Path(scratch) / "dist"
        run(sys.executable, "-m", "hatchling", "build", "-d", dist, cwd=ROOT)
        files = sorted(dist.iterdir(), reverse=True)
        for file in files:
            print(f"{file.name}: {megabytes(file):.2f} MB", flush=True)
        wheel = next(f for f in files if f.suffix == ".whl")
        for k, python in enumerate(pythons):
            folder = tried(python, wheel, Path(scratch) / f"wheel{k}")
            if k == 0:
                frozen = run("venv/bin/python", "-m", "pip", "freeze", "--exclude", "casadical", cwd=folder)
                print("packages:", ", ".join(frozen.split()), flush=True)
        tried(pythons[0], next(f for f in files if f.suffix != ".whl"), Path(scratch) / "sdist")


if __name__ == "__main__":
    main(sys.argv[1:] or [sys.executable])
