"""Slips of made-up tables, one to four at once: how often the right repair comes first; clean tables stay as they are.

    python docs/studies/slips.py [--tables N] [--clean N] [--seed S] [--slips 4 --part 0:25]

Six arms, their poses and their departures from the drawing are plain numpy (`tests/first_hour.py`), noise 0.05 mm;
every other table has orientations, too, with 0.05 deg. A repair is right if it leaves, on 100 other poses with the same
slips, no more than three times what the clean table leaves (or 3 mm), and has no more slips than were made. Slips that
base and tool absorb (zeros of the first and the last joint) are not made. Two of a heavy arm are: "heavy", the third
reading is -J3 - J2 (counted as two), and "wrist", two or three of the last joints count the other way. What couples
readings is done first, for the controller does it; the others are made as its readings are written down.
`--slips` and `--part` run a piece of it: tables of one number of slips (0: the clean ones), some of them.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
import first_hour

from casadical.measurements.reading import from_table
from casadical.project.check.slip_fit import Hypothesis, SlipFit
from casadical.project.check.slips import search_slips
from casadical.robot.robot_file import robot_from

# alpha [deg], a [mm], d [mm], theta [deg] of modified rows; ranges [deg].
ARMS = {
    "first hour": first_hour.ROWS,
    "UR10": [
        (0, 0, 127.3, 0), (90, 0, 0, 0), (0, -612, 0, 0), (0, -572.3, 163.9, 0), (90, 0, 115.7, 0), (-90, 0, 92.2, 0),
    ],
    "PUMA 560": [
        (0, 0, 660, 0), (-90, 0, 149, 0), (0, 431.8, 0, 0), (-90, 20.3, 433, 0), (90, 0, 0, 0), (-90, 0, 56, 0),
    ],
    "KR 210": [
        (180, 0, -675, 0), (90, 350, 0, 0), (0, 1150, 0, -90), (90, -41, -1200, 0), (-90, 0, 0, 0), (90, 0, -215, 180),
    ],
    "Panda": [
        (0, 0, 333, 0), (-90, 0, 0, 0), (90, 0, 316, 0), (90, 82.5, 0, 0), (-90, -82.5, 384, 0), (90, 0, 0, 0),
        (90, 88, 107, 0),
    ],
    "five axes": [(0, 0, 445, 0), (-90, 150, 0, -90), (0, 590, 0, 0), (0, 530, 0, 90), (90, 0, 160, 0)],
}  # fmt: skip
TOOL = np.array([62.0, -35.0, 148.0])
KEYS = ("alpha_deg", "a_mm", "d_mm", "theta_deg")
KINDS = (
    "sign", "quarter", "free", "radians", "unit", "swap", "shift", "hand", "coupled", "length", "convention", "heavy",
    "wrist",
)  # fmt: skip


def slipped(rng: np.random.Generator, rows: np.ndarray, count: int) -> tuple[list[tuple], int]:
    """So many slips of different kinds (signs, zeros and swaps of different joints), each as (kind, numbers).

    And as how many they count.
    """
    n, more = len(rows), 0
    found: list[tuple] = []
    free = list(rng.permutation(np.arange(1, n - 1)))
    kinds = [str(k) for k in rng.permutation([*KINDS, "sign", "quarter"])]
    for kind in kinds:
        if len(found) == count:
            break
        if kind in ("heavy", "wrist"):
            chosen = [2] if kind == "heavy" else [*range(n - 3, n)]
            chosen = [j for j in chosen if j in free or j == n - 1]
            if len(chosen) > (kind == "wrist"):
                found.append((kind, chosen, 0.0))
                free = [j for j in free if j not in chosen]
                more += len(chosen) - 1 + (kind == "heavy")
            continue
        joints = {"swap": 2, "sign": 1, "quarter": 1, "free": 1, "radians": 1, "coupled": 1}.get(kind, 0)
        if joints > len(free):
            continue
        chosen = [int(free.pop()) for _ in range(joints)]
        if kind == "length":
            long = [
                (w, i)
                for w, c in (("a", 1), ("d", 2))
                for i in range(n)
                if abs(rows[i, c]) > 250 and (w, i) != ("d", 0)
            ]
            if not long:
                continue
            w, i = long[rng.integers(len(long))]
            found.append((kind, w, i, float(rng.choice([-1, 1]) * rng.uniform(90, 200))))
        else:
            number = {
                "quarter": float(rng.choice([90, -90, 180])), "free": float(rng.choice([-1, 1]) * rng.uniform(8, 80)),
                "shift": float(rng.choice([-1, 1])), "unit": float(rng.choice([1e-3, 1 / 25.4])),
            }.get(kind, 0.0)  # fmt: skip
            found.append((kind, chosen, number))
    return found, len(found) + more


def table_of(slips: list[tuple], q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The table as it is written down with the slips; q [deg], p [mm]."""
    q, p = q.copy(), p.copy()
    for kind, *rest in sorted(slips, key=lambda slip: slip[0] not in ("coupled", "heavy")):
        chosen, number = rest[0], rest[-1]
        if kind == "sign":
            q[:, chosen[0]] *= -1
        elif kind in ("quarter", "free"):
            q[:, chosen[0]] += number
        elif kind == "radians":
            q[:, chosen[0]] = np.deg2rad(q[:, chosen[0]])
        elif kind == "swap":
            q[:, chosen] = q[:, chosen[::-1]]
        elif kind == "wrist":
            q[:, chosen] *= -1
        elif kind == "heavy":
            q[:, 2] = -q[:, 2] - q[:, 1]
        elif kind == "coupled":
            q[:, chosen[0]] += q[:, chosen[0] - 1]
        elif kind == "unit":
            p *= number
        elif kind == "hand":
            p[:, 1] *= -1
    for kind, *rest in slips:
        if kind == "shift":  # the readings of each pose stand one row later, or one row before
            q, p = (q[:-1], p[1:]) if rest[-1] > 0 else (q[1:], p[:-1])
    return q, p


def robots(slips: list[tuple], rows: np.ndarray) -> tuple:
    """The nominal robot as its file says it, and as it would be by the other convention."""
    rows = rows.copy()
    convention = "modified"
    for kind, *rest in slips:
        if kind == "length":
            rows[rest[1], 1 if rest[0] == "a" else 2] += rest[2]
        if kind == "convention":
            rows[:, :2] = np.vstack([rows[1:, :2], [0, 0]])
    joints = [
        {
            **dict(zip(("alpha_deg", "a_mm", "d_mm", "theta_deg"), map(float, r), strict=True)),
            "limits_deg": [-720.0, 720.0],
        }
        for r in rows
    ]
    data = {
        "casadical": 1, "name": "arm", "joint": joints,
        "base": {"unknown": "pose"}, "tool": {"unknown": "position"},
    }  # fmt: skip
    return tuple(robot_from({**data, "convention": c}, "arm") for c in (convention, "standard"))


def poses(rng: np.random.Generator, rows: np.ndarray, n: int, built: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Readings [deg] over 200 degrees of each joint, positions [mm] by the arm as built."""
    q = np.round(rng.uniform(-100, 100, (n, len(rows))), 3)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    p = first_hour.positions(q, built, TOOL) @ turn.T + [1800, -700, 400] + rng.normal(0, 0.05, (n, 3))
    return q, p


def orientations(rng: np.random.Generator, q: np.ndarray, built: np.ndarray) -> np.ndarray:
    """Of a tool that is turned in the flange, in the frame of `poses`, shape (n, 3, 3)."""
    turn, tool = (np.linalg.qr(np.random.default_rng(k).normal(size=(3, 3)))[0] for k in (5, 6))
    turn, tool = (R * np.sign(np.linalg.det(R)) for R in (turn, tool))
    ends = [first_hour.positions(q, built, axis) for axis in (np.zeros(3), *np.eye(3))]
    R = np.stack([end - ends[0] for end in ends[1:]], axis=2)
    x, y, z = rng.normal(0, np.deg2rad(0.05), (3, len(q)))
    off = np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]]).transpose(2, 0, 1) + np.eye(3)
    return turn @ R @ tool @ off


def judged(h: Hypothesis, slips: list[tuple], rows: np.ndarray, q: np.ndarray, p: np.ndarray) -> float:
    """What a repair leaves on a table with these slips [mm], of measured millimetres as they are meant."""
    nominal, other = robots(slips, rows)
    wrong_q, wrong_p = table_of(slips, q, p)
    fit = SlipFit(np.deg2rad(wrong_q), 1e-3 * wrong_p, [nominal.joints, other.joints], nominal.reach)
    return 1e3 * fit.placed(h).error


def one(arm: str, seed: int, count: int) -> bool:
    """Whether the first repair is right."""
    rng = np.random.default_rng([seed, count, sorted(ARMS).index(arm)])
    rows = np.array(ARMS[arm], dtype=float)
    built = rows + rng.normal(0, 1, rows.shape) * [0.03, 0.4, 0.4, 0.04]
    slips, made = slipped(rng, rows, count)
    q, p = poses(rng, rows, 70, built)
    wrong_q, wrong_p = table_of(slips, q, p)
    nominal, other = robots(slips, rows)
    names = [*(f"q{k}_rad" for k in range(1, len(rows) + 1)), "x_mm", "y_mm", "z_mm"]
    m = from_table(pd.DataFrame(np.column_stack([np.deg2rad(wrong_q), wrong_p]), columns=names), len(rows), "position")
    if seed % 2:
        turns = orientations(rng, q, built)
        shift = sum(int(numbers[-1]) for kind, *numbers in slips if kind == "shift")
        m = replace(m, orientation=turns[max(shift, 0) : len(turns) + min(shift, 0)])
    found = search_slips(nominal, m, [other])
    assert found is not None
    q, p = poses(rng, rows, 100, built)
    clean = judged(Hypothesis.none(len(rows)), [], rows, q, p)
    best = found.best
    left = judged(best.hypothesis, slips, rows, q, p)
    return left <= max(3 * clean, 3.0) and best.slips <= made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tables", type=int, default=300)
    parser.add_argument("--clean", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--slips", type=int, nargs="*", default=[1, 2, 3, 4, 0])
    parser.add_argument("--part", default=":")
    given = parser.parse_args()
    part = slice(*(int(k) if k else None for k in given.part.split(":")))
    print(f"{given.tables} made-up tables with one to four slips on {len(ARMS)} arms; seed {given.seed}")
    for count in given.slips:
        tables = range(given.tables // 4 if count else given.clean)[part]
        arms = list(ARMS)
        right = sum(one(arms[k % len(arms)], given.seed + k + (0 if count else 5000), count) for k in tables)
        if count:
            share = 100 * right / max(len(tables), 1)
            print(f"{count} slips: the right repair first in {right} of {len(tables)}, {share:.0f} %", flush=True)
        else:
            print(f"clean tables that were repaired: {len(tables) - right} of {len(tables)}", flush=True)


if __name__ == "__main__":
    main()
