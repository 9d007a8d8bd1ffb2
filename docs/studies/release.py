"""Build wheel and sdist, and try each in a clean environment, away from the checkout.

    python docs/studies/release.py python3.11 python3.12 python3.13 | tee docs/studies/release.txt

For each Python: the wheel with its base dependencies, an example arm from `new` to the calibrated robot, and each
extra of users alone, with a command that needs it; of the first one also the sdist, and the installed packages as
.ci/constraints.txt. Needs a package index, hatchling and uv (`pip install uv`), which installs from one cache.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
ARM = (("new", "arm", "--example"), ("check", "arm"), ("calibrate", "arm", "--out", "results"))
WORKBOOK = """
import casadical, pandas
pandas.read_csv("arm/poses.csv").to_excel("poses.xlsx", index=False)
print(len(casadical.read_measurements("poses.xlsx", 6)))
"""
PICTURE = """
from pathlib import Path
from types import SimpleNamespace
from casadical.blind_check.scoring import draw_confusion
draw_confusion(SimpleNamespace(confusion={"backlash": {"backlash": 3}, "none": {"none": 2}}), Path("confusion.png"))
"""
PAGE = """
from casadical.project.live.server import LivePage, bound
import starlette, sse_starlette, uvicorn
print(LivePage, bound("127.0.0.1", 0).getsockname()[0])
"""
LOG = """
import numpy, pandas
from casadical.measurements.logs.reading import read_log
import rosbags
t = numpy.arange(0, 2, 0.01)
motion = {f"{name}{i}_rad": 0.3 * numpy.sin(t + i) for name in ("q", "command") for i in range(1, 4)}
table = pandas.DataFrame({"time_s": t, **motion})
table.to_parquet("log.parquet")
print(read_log("log.parquet"))
"""
# What needs the extra: commands, or a program.
NEEDED: dict[str, tuple[tuple[str, ...], ...] | str] = {
    "urdf": (
        ("export", "model", "arm", "--to", "urdf", "--out", "arm.urdf"),
        ("new", "second", "--urdf", "arm.urdf", "--data", "arm/poses.csv"),
        ("calibrate", "second"),
    ),
    "xlsx": WORKBOOK,
    "plots": PICTURE,
    "report": (("calibrate", "arm", "--report", "arm.html"),),
    "fleet": (("fleet", ".", "--store", "store.parquet", "--no-diagnose"),),
    "live": PAGE,
    "logs": LOG,
    "certificate": (
        ("calibrate", "arm", "--out", "results"),
        ("certificate", "results", "--out", "cert.pdf"),
    ),
    "plan": (("plan", "arm", "--order", "--out", "plan.csv"),),
    "withheld": (("withheld", "arm", "--poses", "40", "--n", "4"),),
    "mujoco": (("verify", "arm", "arm/poses.csv", "--mujoco"),),
}


def run(*command: str | Path, cwd: Path) -> str:
    """What a command prints, with what is installed alone; its failure ends the study."""
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([*map(str, command)], cwd=cwd, env=alone, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}: {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def megabytes(*paths: Path) -> float:
    return sum(f.stat().st_size for p in paths for f in (p.rglob("*") if p.is_dir() else [p]) if f.is_file()) / 1e6


def installed(python: str, file: str, folder: Path) -> Path:
    """A new environment with one of the files, or with one of its extras."""
    folder.mkdir(parents=True)
    uv = (sys.executable, "-m", "uv", "--quiet")
    run(*uv, "venv", "--python", python, "venv", cwd=folder)
    run(*uv, "pip", "install", "--python", "venv/bin/python", file, cwd=folder)
    return folder


def tried(python: str, file: Path, folder: Path) -> Path:
    """The example arm with the base install; prints a line."""
    installed(python, str(file), folder)
    site = next((folder / "venv/lib").glob("python*")) / "site-packages"
    run("venv/bin/python", "-m", "compileall", "-q", site.parent, cwd=folder)
    begin = time.perf_counter()
    for step in ARM:
        said = run("venv/bin/casadical", *step, cwd=folder)
    seconds = time.perf_counter() - begin
    version = run("venv/bin/python", "--version", cwd=folder).split()[1]
    after = next(line.strip() for line in said.splitlines() if line.strip().startswith("after SKCM"))
    own, casadi, every = megabytes(site / "casadical"), megabytes(site / "casadi"), megabytes(site)
    print(
        f"{version:<8} {file.suffix:<5} {every:4.0f} MB, of these casadi {casadi:.0f}, casadical {own:.1f} "
        f"(with byte code); example in {seconds:.0f} s: {' '.join(after.split()[:3])} mm",
        flush=True,
    )
    return folder


def tried_extra(python: str, wheel: Path, extra: str, folder: Path) -> None:
    """What needs the extra, with this extra alone; prints a line."""
    installed(python, f"{wheel}[{extra}]", folder)
    run("venv/bin/casadical", "new", "arm", "--example", cwd=folder)
    work = NEEDED[extra]
    for step in work if isinstance(work, tuple) else ():
        run("venv/bin/casadical", *step, cwd=folder)
    if isinstance(work, str):
        run("venv/bin/python", "-c", work, cwd=folder)
    shown = "; ".join(" ".join(step[:2]) for step in work) if isinstance(work, tuple) else "from Python"
    print(f"         [{extra}] {megabytes(folder / 'venv'):.0f} MB without byte code: {shown}: good", flush=True)


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
                frozen = run(
                    sys.executable, "-m", "uv", "pip", "freeze", "--python", folder / "venv/bin/python", cwd=folder
                )
                names = (line for line in frozen.split("\n") if line and not line.startswith("casadical"))
                print("packages:", ", ".join(names), flush=True)
            for extra in NEEDED:
                tried_extra(python, wheel, extra, Path(scratch) / f"wheel{k}{extra}")
        tried(pythons[0], next(f for f in files if f.suffix != ".whl"), Path(scratch) / "sdist")


if __name__ == "__main__":
    main(sys.argv[1:] or [sys.executable])
