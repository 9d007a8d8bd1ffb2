"""Bad rows in a table: what the default loss `auto` costs on clean data, and what it saves; all data are made up.

    python docs/studies/bad_rows.py [TABLES]

An arm of `tests/first_hour.py` (plain numpy, not this package's model), 90 poses, noise 0.03 mm; each table is
calibrated by `casadical.calibrate`, KM. Bad rows: a position that is wrong by 5 to 200 mm, as after a lost beam or a
swapped point; of them, those that fall into the fitted poses are counted.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
import first_hour

from casadical import calibrate
from casadical.identification import errors
from casadical.measurements.reading import read_measurements
from casadical.project.new import new_problem


def one(seed: int, bad: int) -> dict[str, object]:
    """Means [mm] over clean poses that no fit saw, by loss; the rows that auto left out, and its bad ones."""
    rng = np.random.default_rng([seed, bad])
    q, p = first_hour.measured(150, seed)
    rows = rng.choice(90, bad, replace=False)
    moved = p[:90].copy()
    turn = rng.normal(size=(bad, 3))
    moved[rows] += turn / np.linalg.norm(turn, axis=1)[:, None] * np.exp(rng.uniform(np.log(5), np.log(200), (bad, 1)))
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        path = first_hour.write(place, "messung.csv", q[:90], moved)
        problem = new_problem(place / "arm", dh=place / "dh.csv", data=path)
        unseen = read_measurements(first_hour.write(place, "einheiten.csv", q[90:], p[90:]), 6)
        found: dict[str, object] = {}
        for loss in ("linear", "auto"):
            c = calibrate(problem, loss=loss)
            found[loss] = 1e3 * float(errors(c.robot, unseen).mean())
        fitted = {int(r) for m in problem.sets["identify"] for r in m.row}
        found["bad"] = {int(r) + 5 for r in rows} & fitted  # headings in line 4
        found["left out"] = {out.row for out in c.identification.left_out}
    return found


def main() -> None:
    tables = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    print(f"{tables} made-up tables each; mean error on 60 clean poses that no fit saw, median over the tables [mm]")
    print(f"{'bad rows':>9} {'linear':>8} {'auto':>8} {'the same':>9} {'bad left out':>13} {'good left out':>14}")
    for bad in (0, 1, 4, 9):
        found = [one(seed, bad) for seed in range(tables)]
        same = sum(f["linear"] == f["auto"] for f in found)
        caught = sum(len(f["bad"] & f["left out"]) for f in found)
        wrong = sum(len(f["left out"] - f["bad"]) for f in found)
        there = sum(len(f["bad"]) for f in found)
        medians = [float(np.median([f[loss] for f in found])) for loss in ("linear", "auto")]
        print(f"{bad:>9} {medians[0]:>8.4f} {medians[1]:>8.4f} {same:>9} {f'{caught} of {there}':>13} {wrong:>14}")


if __name__ == "__main__":
    main()
