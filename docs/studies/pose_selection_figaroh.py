"""python3.11 -m venv FIGAROH && FIGAROH/bin/pip install figaroh==1.0.2 picos==2.6.2 cvxopt==1.3.3
export OMP_NUM_THREADS=1
python docs/studies/pose_selection_figaroh.py FIGAROH/bin/python > docs/studies/pose_selection_figaroh.txt

Our D-optimal choices beside figaroh's, for three robots and 30, 50, 100 poses out of the same 300 candidates: the
index O1, the processor's seconds, and what no choice from these candidates could better.
"""

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from casadical import read_robot
from casadical.pose_selection import Noise, Workspace
from casadical.pose_selection.candidates import draw, expected
from casadical.pose_selection.information import MM, independent, observability, scaled_jacobian
from casadical.pose_selection.pose_search import select_poses

HERE = Path(__file__).parent
PROBLEMS = HERE.parents[1] / "problems"
ROBOTS = {"hh800": "campaign.robot.toml", "kr210": "robot.toml", "ur10e": "robot.toml"}
SIZES = (30, 50, 100)
POOL, STEPS = 300, 2000
NOISE = Noise(2e-5)


def o1(J, chosen):
    return observability(J[chosen].reshape(-1, J.shape[2]), len(chosen))["O1"]


def no_more(J, n, *, twice):
    """An O1 that no n of these poses can exceed: the best weights there could be, each at most 1 unless `twice`.

    The logarithm of the determinant is concave in the weights, so its tangent at any weights bounds it everywhere
    (Boyd and Vandenberghe 2004, sections 3.1.3 and 7.5). Multiplicative steps, or Frank and Wolfe's.
    """
    N, _, p = J.shape
    w, least = np.full(N, n / N), np.inf
    for k in range(STEPS):
        M = np.einsum("k,kip,kiq->pq", w, J, J, optimize=True)
        slope = np.einsum("kip,pq,kiq->k", J, np.linalg.inv(M), J, optimize=True)
        heaviest = np.sort(slope)[-n:].sum() if not twice else n * slope.max()
        least = min(least, np.linalg.slogdet(M)[1] + heaviest - slope @ w)
        if twice:
            w = w * slope * n / p
        else:
            corner = np.zeros(N)
            corner[np.argsort(slope)[-n:]] = 1
            w += 2 / (k + 3) * (corner - w)
    return np.exp(least / (2 * p)) / np.sqrt(n)


def theirs(J, python):
    """What figaroh chooses, by number of poses."""
    with tempfile.TemporaryDirectory() as folder:
        rows, out = Path(folder) / "rows.npy", Path(folder) / "out.json"
        np.save(rows, J)
        subprocess.run([python, HERE / "figaroh_designs.py", rows, out, *map(str, SIZES)], check=True)
        return json.loads(out.read_text(encoding="utf-8"))


def ours(robot, among, n, min_distance=0.0):
    """A selection and its seconds, of a fresh robot, so that building its functions counts."""
    start = time.process_time()
    found = select_poses(replace(robot), among, n, "O1", noise=NOISE, min_distance=min_distance)
    return found, time.process_time() - start


def compare(name, robot, python):
    q = draw(robot, POOL, Workspace(), np.random.default_rng(1))
    m = expected(robot, q, {}, "pool")

    def information(kept):
        rows = scaled_jacobian(robot, kept, m).reshape(-1, len(kept))
        return rows.T @ rows * (MM / NOISE.sigma) ** 2 * 50 / len(m)

    names, _ = independent(robot, robot.parameters.select(["kinematic", "compliance"]), [m], information)
    J = scaled_jacobian(robot, names, m)
    for found in theirs(J, python):
        n = found["n"]
        chance = np.random.default_rng(2)
        random = np.mean([o1(J, chance.choice(POOL, n, replace=False)) for _ in range(50)])
        socp = "  -   " if found["socp"] is None else f"{o1(J, found['socp']):.4f}"
        once, seconds = ours(robot, q, n)
        again, longer = ours(robot, q, n, None)
        free, freely = ours(robot, None, n)
        assert once.names == again.names == free.names == names
        print(
            f"{name:5s} {n:4d}  {random:.4f}  {socp} {found['socp_s']:5.1f}  "
            f"{o1(J, found['detmax']):.4f} {found['detmax_s']:5.1f} {n - len(set(found['detmax'])):3d}  "
            f"{once.observability['O1']:.4f} {seconds:5.2f} <{no_more(J, n, twice=False):.4f}  "
            f"{again.observability['O1']:.4f} {longer:5.2f} {n - len(np.unique(again.q, axis=0)):3d} "
            f"<{no_more(J, n, twice=True):.4f}  {free.observability['O1']:.4f} {freely:5.2f}",
            flush=True,
        )


def main() -> None:
    print(f"O1 [mm] and CPU seconds [s] of three robots, {POOL} candidates for all. 'SOCP': its n heaviest weights.")
    print("figaroh's 'Detmax' may take a pose twice: 'two' counts such takings. 'once': ours, each pose at most once;")
    print("'again': ours where poses may be taken twice; '<': what no choice under the same rule could better. Ours")
    print("includes Jacobians and the choice of parameters; figaroh gets finished Jacobians. 'free': ours with")
    print("candidates of its own, refined.\n")
    print("robot    n  random  SOCP     [s]  Detmax  [s] two  once    [s]  <       again   [s] two  <       free   [s]")
    for name, file in ROBOTS.items():
        compare(name, read_robot(PROBLEMS / name / file), sys.argv[1])


if __name__ == "__main__":
    main()
