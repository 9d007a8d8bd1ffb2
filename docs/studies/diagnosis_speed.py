"""Time and memory of a diagnosis: python docs/studies/diagnosis_speed.py [PART...] > docs/studies/diagnosis_speed.txt

Parts, all by default: command (a minute), series-b (half a minute), command-b, command-c, command-2500 (two minutes),
full-poses, series-a (two minutes), simulated-1000, simulated-10000 (half a minute), simulated-100000 (ten minutes).
Each row is a process of its own with one thread: seconds of CPU, seconds of wall time, peak of its memory. On a busy
machine both times are longer. The print has the parts that were run so far, and what else ran on the machine.

command: `casadical diagnose` of 100 poses. First: nothing is in the cache. Again: formulas are. Next: each further
campaign of the same command. series-b and series-a: all poses of two series of the real UR10, by `diagnose` of
Python; command-b: by the command, which also refits and judges the poses; command-c: series C, with --details;
command-2500: as many poses of series A, with --details. full-poses: 100 poses of series C with orientations, the
causes of series B as a prior. simulated: poses of a UR10e with backlash.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pandas as pd
from campaign_robots import machine

from casadical import diagnose
from casadical.blind_check.mujoco_physics import Hidden, campaign, perturb
from casadical.project.problem import read_campaign, read_campaign_robot

ROOT = Path(__file__).parents[2]
DATA = ROOT / "data" / "ur10_laser_tracker"
SERIES = {
    "a": ("series_A_grid.csv", "ur10_grid"),
    "b": ("series_B_joint_configurations.csv", "ur10_joints"),
    "c": ("series_C_random_poses.csv", "ur10"),
}
SIZES = (1000, 10_000, 100_000)
FURTHER = 3
COMMAND = "from casadical.cli import main; main()"


def process(arguments: Sequence[object], cache: Path) -> tuple[float, float, float]:
    """Seconds of CPU and of wall time and peak memory [MB] of Python with these arguments."""
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    environment = {**kept, "OMP_NUM_THREADS": "1", "CASADICAL_CACHE": str(cache)}
    began = time.perf_counter()
    run = subprocess.Popen([sys.executable, *map(str, arguments)], env=environment, stdout=subprocess.PIPE, cwd=ROOT)
    assert run.stdout
    said = run.stdout.read()
    _, status, used = os.wait4(run.pid, 0)
    wall = time.perf_counter() - began
    if status:
        raise RuntimeError(f"{arguments} ended with {status}: {said[-500:]!r}")
    return used.ru_utime + used.ru_stime, wall, used.ru_maxrss / 1e3


def row(what: str, used: tuple[float, float, float], more: str = "") -> None:
    cpu, wall, peak = used
    print(f"{what:<52} {cpu:>7.1f} {wall:>7.1f} {peak:>7.0f}  {more}".rstrip(), flush=True)


def command(folder: Path) -> None:
    """100 poses: one effect in simulated campaigns of a KR 210, and a real series of the UR10."""
    simulated = []
    for seed in range(1 + FURTHER):
        table = simulated_campaign("kr210", 100, seed)
        simulated.append(folder / f"kr210-{seed}.csv")
        table.to_csv(simulated[-1], index=False)
    series = pd.read_csv(DATA / "series_C_random_poses.csv", comment="#")
    real = []
    for first in range(1 + FURTHER):
        real.append(folder / f"ur10-{first}.csv")
        series.iloc[first :: len(series) // 100][:100].to_csv(real[-1], index=False)
    for name, problem, files in (("simulated", "kr210", simulated), ("real UR10", "ur10", real)):
        cache = folder / f"cache-{problem}"
        start = ["-c", COMMAND, "diagnose", ROOT / "problems" / problem]
        row(f"command, 100 poses, {name}, first", process([*start, files[0]], cache))
        again = process([*start, files[0]], cache)
        row(f"command, 100 poses, {name}, again", again)
        several = process([*start, *files], cache)
        cpu, wall = ((several[k] - again[k]) / FURTHER for k in (0, 1))
        row(f"command, 100 poses, {name}, next", (cpu, wall, several[2]))


def simulated_campaign(name: str, poses: int, seed: int) -> pd.DataFrame:
    """A campaign of a robot of the blind check with backlash in one joint."""
    hidden = (Hidden("backlash", 2, {"size": 60e-6, "friction": 0.02}),)
    plant = perturb(machine(name)[1], seed)
    return campaign(plant, hidden, poses, noise_mm=0.02, repeatability_urad=4.0, seed=seed)


def series(folder: Path, letter: str) -> None:
    """All poses of a real series."""
    file, problem = SERIES[letter]
    used = process([__file__, "--one", ROOT / "problems" / problem, DATA / file, folder / "said.txt"], folder)
    row(f"diagnose, series {letter.upper()}", used, (folder / "said.txt").read_text())


def command_of_series(folder: Path, letter: str, *options: str) -> None:
    """All poses of a real series by the command."""
    file, problem = SERIES[letter]
    used = process(["-c", COMMAND, "diagnose", ROOT / "problems" / problem, DATA / file, *options], folder)
    row(" ".join([f"command, series {letter.upper()}", *options]), used)


def command_of_some(folder: Path, poses: int) -> None:
    """So many poses of series A, spread over it, by the command with its details."""
    file, problem = SERIES["a"]
    table = pd.read_csv(DATA / file, comment="#")
    (some := folder / "some.csv").write_text(table.iloc[:: len(table) // poses][:poses].to_csv(index=False))
    used = process(["-c", COMMAND, "diagnose", ROOT / "problems" / problem, some, "--details"], folder)
    row(f"command, {poses} poses of series A --details", used)


def full_poses(folder: Path) -> None:
    """100 poses with their orientations, beside the causes of another series."""
    file, problem = SERIES["b"]
    process(["-c", COMMAND, "diagnose", ROOT / "problems" / problem, DATA / file, "--out", folder / "b"], folder)
    (prior,) = (folder / "b").rglob("diagnosed.robot.toml")
    file, problem = SERIES["c"]
    table = pd.read_csv(DATA / file, comment="#")
    table.iloc[:: len(table) // 100][:100].to_csv(folder / "poses.csv", index=False)
    (folder / "robot.toml").write_text((ROOT / "problems" / problem / "robot.toml").read_text())
    (folder / "problem.toml").write_text(
        'casadical = 1\ntitle = "Full poses"\n[[measurements]]\nfile = "poses.csv"\nkind = "pose"\n'
    )
    row(
        "command, 100 full poses, B's causes as a prior",
        process(["-c", COMMAND, "diagnose", folder, "--prior", prior], folder),
    )


def simulated(folder: Path, size: int) -> None:
    """Time by the number of poses."""
    path = folder / f"simulated-{size}.csv"
    simulated_campaign("ur10e", size, 0).to_csv(path, index=False)
    used = process([__file__, "--one", ROOT / "problems" / "ur10e", path, folder / "said.txt"], folder)
    row(f"diagnose, {size} simulated poses", used, (folder / "said.txt").read_text())


def one(problem: Path, file: Path, answer: Path) -> None:
    """Diagnose a campaign and say what came out."""
    robot = read_campaign_robot(problem)
    found = diagnose(robot, read_campaign(problem, file, robot))
    causes = ", ".join(c.label for c in found.causes)
    answer.write_text(
        f"{found.verdict}: {causes}; {1e3 * found.gap.before:.3f} -> {1e3 * found.gap.after:.3f} mm, "
        f"{int(found.case.kept.sum())} poses kept"
    )


PARTS = {
    "command": command,
    "series-b": partial(series, letter="b"),
    "command-b": lambda folder: command_of_series(folder, "b"),
    "command-c": lambda folder: command_of_series(folder, "c", "--details"),
    "command-2500": partial(command_of_some, poses=2500),
    "full-poses": full_poses,
    "series-a": partial(series, letter="a"),
    **{f"simulated-{size}": partial(simulated, size=size) for size in SIZES},
}


def main() -> None:
    load = f"{os.getloadavg()[0]:.0f} processes on {os.cpu_count()} cores as it begins"
    print(f"{load:<52} {'CPU s':>7} {'wall s':>7} {'MB':>7}", flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        for part in sys.argv[1:] or PARTS:
            PARTS[part](Path(scratch))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        one(*map(Path, sys.argv[2:]))
    else:
        main()
