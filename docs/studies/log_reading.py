"""Time and memory of reading joint logs: seven joints at 500 Hz, up to ten minutes, by form of the file.

    python docs/studies/log_reading.py > docs/studies/log_reading.txt

Synthetic. Each file is read in a process of its own, with what the log says of itself; the memory is the most of the
whole process (`nothing`: an interpreter that reads none). To be reached: ten minutes within 1 GB, linear in the rows.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

RATE, JOINTS = 500, 7
MINUTES = (2.5, 5.0, 10.0)
READ = """
import json, resource, sys, time
from casadical.measurements.logs.reading import read_log
rows = 0
start = time.process_time()
if sys.argv[1] != "nothing":
    log = read_log(sys.argv[1])
    rows = len(log)
used = resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps([rows, time.process_time() - start, used.ru_maxrss / 1024]))
"""


def table(minutes: float) -> pd.DataFrame:
    """Commands, readings, speeds, torques and temperatures of smooth motions, as a controller writes them."""
    rng = np.random.default_rng(0)
    t = np.arange(int(60 * minutes * RATE)) / RATE
    columns = {"time_s": np.round(t + rng.normal(0, 1e-4, len(t)), 6)}
    for i in range(1, JOINTS + 1):
        rate, start = rng.uniform(0.3, 2.0), rng.uniform(0, 6)
        q = np.sin(rate * t + start) + 0.2 * np.sin(3.1 * rate * t)
        columns[f"command{i}_rad"] = np.round(q, 6)
        columns[f"q{i}_rad"] = np.round(q - 0.002 + rng.normal(0, 1e-4, len(t)), 5)
        columns[f"v{i}_rad_s"] = np.round(np.gradient(q, t), 5)
        columns[f"torque{i}_Nm"] = np.round(20 * np.cos(q) + np.sign(np.gradient(q)) + rng.normal(0, 0.1, len(t)), 4)
        columns[f"temperature{i}_degC"] = np.round(30 + 0.01 * t, 1)
    return pd.DataFrame(columns)


def measured(path: str) -> tuple[int, float, float]:
    """Rows, seconds of processor time, and MB of the process that reads a file."""
    done = subprocess.run([sys.executable, "-c", READ, path], capture_output=True, text=True, check=True)
    rows, seconds, megabytes = json.loads(done.stdout)
    return rows, seconds, megabytes


def main() -> None:
    print(f"{JOINTS} joints at {RATE} Hz, synthetic: {5 * JOINTS + 1} columns\n")
    print(f"{'file':<22}{'rows':>9}{'MB on disk':>12}{'CPU s':>8}{'us a row':>10}{'MB':>7}")
    print(f"{'nothing':<22}{0:>9}{'':>12}{'':>8}{'':>10}{measured('nothing')[2]:>7.0f}")
    with tempfile.TemporaryDirectory() as folder:
        for end in ("csv", "csv.gz", "parquet"):
            for minutes in MINUTES if end == "csv" else MINUTES[-1:]:
                path = Path(folder) / f"log.{end}"
                frame = table(minutes)
                if end == "parquet":
                    frame.to_parquet(path)
                else:
                    frame.to_csv(path, index=False)
                del frame
                rows, seconds, megabytes = measured(str(path))
                size, name = path.stat().st_size / 1e6, f"{minutes:g} minutes, {end}"
                print(f"{name:<22}{rows:>9}{size:>12.1f}{seconds:>8.2f}{1e6 * seconds / rows:>10.1f}{megabytes:>7.0f}")
                path.unlink()


if __name__ == "__main__":
    main()
