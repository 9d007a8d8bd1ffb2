"""A blind run once more, by today's rules: python docs/studies/blind_check_again.py third (15 minutes), or fourth (30)

Makes the campaigns with the seed of that run, answers and scores them by the three commands of docs/blind-check.md. The
keys of these runs are known: it tells whether anything became worse, and is no blind figure.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

# Campaigns and seed.
RUNS = {"third": ("320", "20261125"), "fourth": ("640", "20261127")}
ROOT = Path(__file__).parents[2]
COMMAND = [sys.executable, "-c", "from casadical.cli import main; main()", "withheld"]


def main() -> None:
    count, seed = RUNS[sys.argv[1]]
    with tempfile.TemporaryDirectory() as scratch:
        run, key = Path(scratch) / "run", Path(scratch) / "key"
        steps = (
            ("make", "--n", count, "--seed", seed, "--out", run, "--key", key),
            ("predict", run, "--workers", "1"),
            ("score", run, key, run / "answers.diagnosis.jsonl"),
        )
        for k, step in enumerate(steps, 1):
            said = subprocess.run([*COMMAND, *map(str, step)], cwd=ROOT, check=True, capture_output=True, text=True)
            if k == len(steps):
                print(said.stdout)


if __name__ == "__main__":
    main()
