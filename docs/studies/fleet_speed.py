"""python docs/studies/fleet_speed.py [--robots N] [--workers N ...] [--diagnose] > docs/studies/fleet_speed.txt

Throughput of `casadical fleet`: N simulated UR10e of 40 poses each, every one a problem folder, on Dask's local cluster
with one worker and with two; robots a second after the first 10 (workers load the package), peak memory of a worker and
of the command. What the command itself does for a row (take it, keep it, write it) is measured apart; its inverse is
the rate that no number of workers exceeds, and so the number of workers that one command feeds. A whole run of 10 000
robots: `--robots 10000`. The machine's other work is in the figures: see the load, printed first.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
from fewer_poses import built, measured

from casadical.fleet.one_robot import NOTHING, one_robot
from casadical.fleet.run import run_fleet
from casadical.fleet.store import add, rows
from casadical.project.problem import read_campaign_robot

ROOT = Path(__file__).parents[2]
FIRST = 10


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


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--robots", type=int, default=60)
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--diagnose", action="store_true")
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before; {options.robots} robots x 40 poses")
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        folders(place / "plant", options.robots)
        for workers in options.workers:
            seen: list[float] = []
            store = place / f"{workers}.parquet"
            run_fleet(
                [place / "plant"], store, workers=workers, with_diagnosis=options.diagnose,
                show=lambda _text, seen=seen: seen.append(time.perf_counter()),
            )  # fmt: skip
            rate = (len(seen) - 1 - FIRST) / (seen[-1] - seen[FIRST])
            child = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
            print(
                f"{workers} worker{'s' * (workers > 1)}: {rate:.2f} robots/s, {len(rows(store))} rows, "
                f"greatest worker so far {child:.0f} MB, load {os.getloadavg()[0]:.1f}",
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
        print(f"on paper: at {1 / each:.0f} rows/s one command feeds {1 / each / rate * workers:.0f} such workers")


if __name__ == "__main__":
    main()
