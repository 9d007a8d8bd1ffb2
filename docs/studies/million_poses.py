"""Time and memory of many poses: python docs/studies/million_poses.py | tee docs/studies/million_poses.txt (5 minutes)

The arm of benchmarks.py with its 27 parameters (synthetic, .02 mm noise), in tables of a growing number of rows. Each
run is a process of its own with one thread: the table is read at once (`from_table`, Parquet by pandas) or some rows at
a time (`read_measurements`), then identified, compiled if that pays. Memory is what the process holds for itself
(RssAnon, looked at every 5 ms) above what it held after the imports; mapped files, which the system drops where memory
is needed, are not in it. `limited` runs again within an amount of private memory that the system enforces
(RLIMIT_DATA). `calibrate` is what the command does with a folder of the same poses as CSV (micrometres and millionths
of a degree): read, 70 % of the poses identified from, errors on the others, result files with misfit and error bound,
HTML report.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "benchmarks"))
ROWS = (50_000, 200_000, 1_000_000)
GROUP = 65_536
# Label -> how the table is read.
TABLES = {"at once": "at once", "in parts": "in parts", "limited": "in parts", "calibrate": "calibrate"}


def private_mb() -> float:
    """Memory that this process holds for itself [MB]."""
    return int(Path("/proc/self/status").read_text().split("RssAnon:")[1].split()[0]) / 1024


class Peak:
    """The greatest private memory from now on."""

    def __init__(self) -> None:
        self.base = self.mb = private_mb()
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while True:
            self.mb = max(self.mb, private_mb())
            time.sleep(0.005)

    def above(self) -> float:
        return max(self.mb, private_mb()) - self.base


def make_table(rows: int, path: Path) -> None:
    import numpy as np
    import pandas as pd
    import problem

    from casadical.robot.robot_file import to_toml

    data, truth = problem.make(rows, 1)
    values = np.column_stack([np.rad2deg(data.q), 1e3 * data.p])
    names = [*(f"q{k}_deg" for k in range(1, 7)), "x_mm", "y_mm", "z_mm"]
    table = pd.DataFrame(values, columns=names)
    table.to_parquet(path, row_group_size=GROUP)
    table.round(6).to_csv(path.with_suffix(".csv"), index=False)
    (path.parent / "robot.toml").write_text(to_toml(the_robot(), "Made up for a study."))
    (path.parent / "problem.toml").write_text(PROBLEM)
    np.savez(path.with_suffix(".npz"), q=data.q_held_out, p=truth)


def the_robot():
    import numpy as np
    import problem

    import casadical

    joints = tuple(casadical.Joint(*row, lower=-7.0, upper=7.0) for row in problem.NOMINAL_DH)
    unknown = casadical.Placement(np.eye(4), "pose"), casadical.Placement(np.eye(4), "position")
    return casadical.Robot("UR10-like", joints, *unknown)


def run(path: Path, reader: str, limit_mb: float) -> None:
    """One run, in this process; prints its figures."""
    import numpy as np
    import pandas as pd
    import pyarrow.parquet  # noqa: F401 (counts as an import)

    import casadical
    from casadical.identification.accuracy import predicted
    from casadical.measurements.measurements import unmeasured

    robot = the_robot()
    casadical.identify(robot, unmeasured_for_import(), ["placement"])
    if limit_mb:
        status = Path("/proc/self/status").read_text()
        own = int(status.split("VmData:")[1].split()[0]) * 1024
        most = own + int(limit_mb * 2**20)
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    peak, began = Peak(), time.process_time()
    m: object
    if reader == "calibrate":
        m = casadical.read_problem(path.parent)
    elif reader == "at once":
        m = casadical.from_table(pd.read_parquet(path), 6, "position")
    else:
        m = casadical.read_measurements(path, 6, "position")
    read, read_mb = time.process_time(), peak.above()
    if reader == "calibrate":
        calibration = casadical.calibrate(m)
        calibration.files(path.parent / "results")
        casadical.report([calibration])
        found = calibration.identification
    else:
        found = casadical.identify(robot, m, ["kinematic"])
    errors = found.standard_errors
    identified, whole_mb = time.process_time(), peak.above()
    with np.load(path.with_suffix(".npz")) as held_out:
        off = np.linalg.norm(predicted(found.robot, unmeasured(held_out["q"]))[0] - held_out["p"], axis=1)
    figures = {
        "read_s": read - began, "identify_s": identified - read, "read_mb": read_mb, "whole_mb": whole_mb,
        "names": len(found.names), "held_out_um": 1e6 * float(off.mean()), "finite": bool(np.isfinite(errors).all()),
    }  # fmt: skip
    print(json.dumps(figures))


def unmeasured_for_import():
    """Poses that load everything that a run needs."""
    import problem

    import casadical

    data, _ = problem.make(50, 2)
    return casadical.Measurements(q=data.q, kind="position", position=data.p)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, nargs="+", default=ROWS)
    parser.add_argument("--limit", type=float, default=192.0, help="private memory of the limited runs [MB]")
    parser.add_argument("--only", nargs="+", choices=TABLES, default=list(TABLES), help="ways to read the table")
    parser.add_argument("--run", nargs=3, metavar=("TABLE", "READER", "LIMIT_MB"), help="one run, used by the others")
    options = parser.parse_args()
    if options.run:
        run(Path(options.run[0]), options.run[1], float(options.run[2]))
        return
    print("poses      table     read [s]  identify [s]  memory reading [MB]  and identifying [MB]  held-out [um]")
    for rows in options.rows:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "poses.parquet"
            subprocess.run([sys.executable, "-c", _MAKE, str(HERE), str(rows), str(path)], check=True)
            for name in options.only:
                limit = options.limit if name == "limited" else 0.0
                print(f"{rows:9d}  {name:9} {one(path, TABLES[name], limit)}", flush=True)
    if "limited" in options.only:
        print(f"limited: within {options.limit:.0f} MB of private memory above what the imports took.")


PROBLEM = """
casadical = 1
title = "Many poses"
data = "synthetic"
methods = ["KM"]

[[measurements]]
file = "poses.csv"
kind = "position"

[sets]
identify = 0.7
report = 0.3
"""

_MAKE = """
import sys
sys.path[:0] = [sys.argv[1], sys.argv[1] + "/benchmarks"]
import million_poses, pathlib
million_poses.make_table(int(sys.argv[2]), pathlib.Path(sys.argv[3]))
"""


def one(path: Path, reader: str, limit_mb: float) -> str:
    """A line of figures of a run in a process of its own."""
    environment = {**os.environ, **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")}
    command = [sys.executable, str(Path(__file__)), "--run", str(path), reader, str(limit_mb)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        return "failed: " + (done.stderr.strip().splitlines() or ["no message"])[-1][:100]
    f = json.loads(done.stdout)
    text = f"{f['read_s']:9.2f} {f['identify_s']:13.2f} {f['read_mb']:20.0f} {f['whole_mb']:21.0f}"
    return f"{text} {f['held_out_um']:14.3f}"


if __name__ == "__main__":
    main()
