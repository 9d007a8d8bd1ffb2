"""Starts of paths with one orientation: random robots on lines, planes and curves, a tool that the file has wrong.

    python docs/studies/placement.py [--campaigns 200] [--first 0] [--seed 0] [--keep FILE.jsonl] [--seconds S]

Synthetic. Each robot is one of three drawings with geometry of its own, measured in a frame that is turned and shifted
at will, with noise of 0.03 mm. Its path keeps the tool's orientation by the controller's model. The robot file has the
tool 20 mm wrong. The same campaign with the true tool in the file, known, is what the result is compared with.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from kept import Row, add_options, rows_of

from casadical.core.basics import ConvergenceError, InputError
from casadical.core.transforms import frame, from_xyz, to_xyz
from casadical.identification.accuracy import errors, predicted
from casadical.identification.identification import identify
from casadical.identification.placement import place_frames
from casadical.measurements.measurements import Measurements, unmeasured
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot

ROOT = Path(__file__).parents[2]
DRAWINGS = ("ur10e", "kr210", "ur5")
PATHS = ("line", "plane", "curve")
NOISE, WRONG, WITHIN, WORSE = 3e-5, 0.020, 0.050, 1.1
LENGTHS, ANGLES = 5e-4, 5e-4


def pose_of(robot: Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return predicted(robot, unmeasured(q))


def follow(robot: Robot, q: np.ndarray, targets: np.ndarray, R: np.ndarray) -> np.ndarray | None:
    """Readings at which the controller's model has the tool at targets, shape (n, 3), as turned as R; or None."""
    found = []
    for target in targets:
        for _ in range(12):
            every = np.concatenate([q[None], q + 1e-6 * np.eye(6)])
            p, turns = pose_of(robot, every)
            off = np.concatenate([target - p[0], to_xyz(R @ turns[0].T)])
            if np.abs(off).max() < 1e-7:
                break
            turned = np.array([to_xyz(t @ turns[0].T) for t in turns[1:]])
            J = np.concatenate([(p[1:] - p[0]).T, turned.T]) / 1e-6
            step = J.T @ np.linalg.solve(J @ J.T + 1e-10 * np.eye(6), off)
            q = q + step * min(1.0, 0.3 / max(np.abs(step).max(), 1e-12))
        else:
            return None
        found.append(q)
    return np.array(found)


def path(kind: str, n: int, rng: np.random.Generator, reach: float) -> np.ndarray:
    """Points of a path about its middle, shape (n, 3) [m], in the order in which they are driven."""
    a, b, c = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    size = 0.15 * reach * rng.uniform(0.7, 1.3)
    s = np.linspace(-1, 1, n)
    if kind == "line":
        return size * s[:, None] * a
    if kind == "plane":  # a raster
        rows = max(2, round(np.sqrt(n) / 2))
        across = np.clip(np.floor((s + 1) / 2 * rows), 0, rows - 1)
        along = 2 * np.abs(2 * ((s + 1) / 2 * rows / 2 % 1) - 1) - 1
        return size * (along[:, None] * a + (2 * across / (rows - 1) - 1)[:, None] * b)
    return size * (s[:, None] * a + 0.5 * np.sin(2.5 * s)[:, None] * b + 0.3 * np.cos(1.7 * s)[:, None] * c)


def campaign(seed: Sequence[int]) -> tuple[Robot, Robot, Measurements, str]:
    """The robot's file with the tool wrong, the same with the true tool as known, and the measurements."""
    rng = np.random.default_rng(seed)
    kind = PATHS[seed[-1] % 3]
    while True:
        file = read_robot(ROOT / "problems" / rng.choice(DRAWINGS) / "robot.toml")
        tool = frame(file.tool.T[:3, :3], file.tool.T[:3, 3] + [0.0, 0.0, 0.1])
        file = replace(file, targets=(), tool=replace(file.tool, T=tool, unknown="position"))
        joints = tuple(replace(j, lower=-2 * np.pi, upper=2 * np.pi) for j in file.joints)
        file = replace(file, joints=joints, base=replace(file.base, T=np.eye(4), unknown="pose"))
        sd = {"m": LENGTHS, "rad": ANGLES}
        geometry = file.parameters.select(["geometry"])
        real = file.with_values(
            {k: file.parameters[k].value + rng.normal(0, sd[file.parameters[k].unit]) for k in geometry}
        )
        stood = frame(from_xyz(rng.uniform(-np.pi, np.pi, 3) * [1, 0.4, 1]), rng.uniform(-3, 3, 3))
        real = replace(real, base=replace(real.base, T=stood))
        q0 = rng.uniform(-1.2, 1.2, 6) + np.array([0, -0.5, 0.9, 0, 0.9, 0])
        p, R = pose_of(file, q0[None])
        n = int(rng.integers(50, 501))
        q = follow(file, q0, p[0] + path(kind, n, rng, file.reach), R[0])
        if q is None or np.abs(np.diff(q, axis=0)).max() > 0.5 or np.abs(q).max() > 6:
            continue
        off = rng.standard_normal(3)
        off *= WRONG / np.linalg.norm(off)
        wrong = replace(file, tool=replace(file.tool, T=frame(tool[:3, :3], tool[:3, 3] + off)))
        known = replace(file, tool=replace(file.tool, unknown="none"))
        y, _ = pose_of(real, q)
        m = Measurements(q, "position", position=y + rng.normal(0, NOISE, y.shape), source=f"{kind} of {n} poses")
        return wrong, known, m, kind


def judged(seed: tuple[int, int]) -> Row:
    """Where the tool starts, whether identify ends, and the held-out error over that with the tool known."""
    wrong, known, m, kind = campaign(seed)
    order = np.random.default_rng(seed[-1]).permutation(len(m))
    fit, test = m[np.sort(order[: int(0.7 * len(m))])], m[np.sort(order[int(0.7 * len(m)) :])]
    away = float(np.linalg.norm(place_frames(wrong, fit).tool.T[:3, 3] - known.tool.T[:3, 3]))
    ratio, failed = np.inf, ""
    try:
        found = errors(identify(wrong, fit).robot, test).mean()
        ratio = float(found / errors(identify(known, fit).robot, test).mean())
    except (InputError, ConvergenceError) as error:
        failed = str(error)
    return {"kind": kind, "what": m.source, "away": away, "ratio": ratio, "failed": failed}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--campaigns", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    add_options(parser, "placement")
    options = parser.parse_args()
    rows = rows_of(
        [(f"{options.seed} {k}", (options.seed, k)) for k in range(options.first, options.campaigns)], judged, options
    )
    print(f"{len(rows)} of campaigns {options.first} to {options.campaigns - 1}, seed {options.seed}; errors in mm\n")
    print(
        f"{'path':8s}{'campaigns':>10s}{'start ok':>10s}{'worst':>8s}{'ends':>6s}{'within 1.1':>12s}"
        f"{'worst ratio':>13s}"
    )
    for name in (*PATHS, "all"):
        some = [row for row in rows if name in ("all", row["kind"])]
        if some:
            away, ratio = (np.array([row[key] for row in some]) for key in ("away", "ratio"))
            ended = np.mean([not row["failed"] for row in some])
            print(
                f"{name:8s}{len(some):10d}{np.mean(away < WITHIN):10.3f}{1e3 * away.max():8.1f}{ended:6.2f}"
                f"{np.mean(ratio <= WORSE):12.3f}{ratio.max():13.3f}"
            )
    for row in rows:
        if row["failed"] or row["ratio"] > WORSE or row["away"] > WITHIN:
            print(f"  campaign {row['name']}, {row['what']}: start {1e3 * row['away']:.1f} mm off, ratio "
                  f"{row['ratio']:.3f} {row['failed']}")  # fmt: skip


if __name__ == "__main__":
    main()
