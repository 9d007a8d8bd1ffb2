"""python docs/studies/fleet_speed.py [--robots N] [--workers N ...] [--diagnose] > docs/studies/fleet_speed.txt

Throughput of `casadical fleet`: N simulated UR10e of 40 poses each, every one a problem folder, on Dask's local cluster
with one worker and with two: robots a second after the first 20 (workers load the package), processor time of a robot
in the workers, which other work on the machine changes less, and the memory of each worker early and late. In the
last run a worker is killed when a third of the robots is done, and the rows are counted.

What the command itself does for a row (take it, keep it, write it) and how many tasks a second the scheduler hands out
are measured apart: the slower one is the rate that no number of workers exceeds. A whole run of 10 000 robots:
`--robots 10000`. The machine's other work is in the figures: see the load, printed first.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from fewer_poses import built, measured

from casadical.fleet import cluster
from casadical.fleet.run import run_fleet
from casadical.fleet.store import NOTHING, add, one_robot, rows
from casadical.project.problem import read_campaign_robot

ROOT = Path(__file__).parents[2]
FIRST = 20
TRIVIAL = 2000


def folders(place: Path, count: int) -> None:
    """A problem folder for each robot."""
    nominal = read_campaign_robot(ROOT / "problems/ur10e")
    for k in range(count):
        rng = np.random.default_rng([3, k])
        m = measured(built(nominal, 3e-4, rng), 40, rng)
        folder = place / f"robot{k:05d}"
        folder.mkdir(parents=True)
        shutil.copy(ROOT / "problems/ur10e/robot.toml", folder)
        (folder / "problem.toml").write_text(
            'casadical = 1\ntitle = "simulated"\ndata = "synthetic"\n[[measurements]]\nfile = "poses.csv"\n'
            "[sets]\nseed = 0\nidentify = 0.8\nreport = 0.2\n"
        )
        assert m.position is not None
        head = ",".join([f"q{j}_deg" for j in range(1, 7)] + ["x_mm", "y_mm", "z_mm"])
        table = np.hstack([np.rad2deg(m.q), 1e3 * m.position])
        np.savetxt(folder / "poses.csv", table, delimiter=",", header=head, comments="", fmt="%.7g")


def workers_of(pid: int) -> dict[int, float]:
    """Memory [MB] of the processes that compute, below one process: those that loaded the package."""
    found, waiting = {}, [pid]
    parents: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents.setdefault(int(stat.read_text().rsplit(")", 1)[1].split()[1]), []).append(int(stat.parent.name))
        except OSError:
            continue
    while waiting:
        for child in parents.get(waiting.pop(), []):
            waiting.append(child)
            found[child] = int((Path("/proc") / str(child) / "statm").read_text().split()[1]) * 4096 / 2**20
    return {child: size for child, size in found.items() if size > 100}


class Run:
    """Times of the rows, and the memory of workers; kills one worker on the way if asked to."""

    def __init__(self, total: int, *, kill: bool) -> None:
        self.seen: list[float] = []
        self.memory: list[float] = []
        self.kill_at = total // 3 if kill else -1
        self.killed = 0

    def __call__(self, _text: str) -> None:
        self.seen.append(time.perf_counter())
        if len(self.seen) % 20 == 0:
            self.memory.append(max(workers_of(os.getpid()).values(), default=0.0))
        if len(self.seen) == self.kill_at:
            self.killed = max(workers_of(os.getpid()))
            os.kill(self.killed, signal.SIGKILL)


def same(number: int) -> dict[str, object]:
    """The least task."""
    return {"robot": str(number)}


def spent() -> float:
    """Processor time of ended children [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--robots", type=int, default=400)
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--diagnose", action="store_true")
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before; {options.robots} robots x 40 poses")
    rate = 0.0
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        folders(place / "plant", options.robots)
        for workers in options.workers:
            run = Run(options.robots, kill=workers == options.workers[-1])
            store, before = place / f"{workers}.parquet", spent()
            run_fleet([place / "plant"], store, workers=workers, with_diagnosis=options.diagnose, show=run)
            took = f"{run.seen[-1] - run.seen[0]:.0f} s"
            rate = (len(run.seen) - 1 - FIRST) / (run.seen[-1] - run.seen[FIRST])
            good = int((rows(store, ["robot", "status"])["status"] == "ok").sum())
            print(
                f"{workers} worker{'s' * (workers > 1)}: {rate:.2f} robots/s, {took} in all; "
                f"{1e3 * (spent() - before) / options.robots:.0f} ms of processor time a robot; greatest worker "
                f"{run.memory[1]:.0f} MB after 40 robots, {run.memory[-1]:.0f} MB at the end; {good} good rows"
                f"{', one worker killed on the way' if run.killed else ''}; load {os.getloadavg()[0]:.1f}",
                flush=True,
            )
        own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        row = {**NOTHING, **one_robot(str(place / "plant" / "robot00000"), False)}
        paper = place / "paper.parquet"
        paper.mkdir()
        start = time.process_time()
        for k in range(20):
            add(paper, [{**row, "robot": f"{k}-{i}"} for i in range(50)])
        each = (time.process_time() - start) / 1000
        size = sum(p.stat().st_size for p in paper.iterdir()) / 1000 / 1024
        print(f"the command: {own:.0f} MB; {1e3 * each:.2f} ms of processor time a row, {size:.1f} kB in the store")
        with cluster.client_of(None, 1) as client:
            client.run(_can_import, str(Path(__file__).parent))
            cluster.AHEAD *= 100  # as many tasks are on their way as with a hundred workers
            start = time.perf_counter()
            count = sum(1 for _ in cluster.results(client, same, [(k,) for k in range(TRIVIAL)]))
            handed = count / (time.perf_counter() - start)
        most, own_rate = min(1 / each, handed), rate / options.workers[-1]
        print(
            f"the scheduler hands out {handed:.0f} tasks/s; on paper {most:.0f} robots/s at most, what "
            f"{most / own_rate:.0f} such workers do: 10 000 robots in {10000 / most:.0f} s\n"
            f"a thousand such workers: {1000 * own_rate:.0f} robots/s, if a task were "
            f"{np.ceil(1000 * own_rate / handed):.0f} robots; the command takes {1 / each:.0f} rows/s"
        )


def _can_import(folder: str) -> None:
    sys.path.insert(0, folder)


if __name__ == "__main__":
    main()
