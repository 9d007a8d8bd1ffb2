"""nice python docs/studies/five_touches.py [--lives N] [--seed N] [--kinds KIND ...] > docs/studies/five_touches.txt

What five touches a day say of a calibrated robot (`casadical verify ROBOT DAYS --touches`), in lives of simulated
robots and on real readings.

Lives: a UR10e of `lives.py` as built, with harmonics that no model has, is calibrated with 100 poses (noise 30 um a
coordinate); its robot file is written and read. Five poses are planned and touched on 6 days, 30 um of noise; every
day temperature, tool and frame differ as in `lives.py`. On the fourth day something happens in five lives of six: a
zero (0.1 to 1.5 mrad), a crash (all zeros 0.3 mrad, tool 0.3 mm), the tool or the foot (0.1 to 1.5 mm or mrad), warmth
(50 to 200 um/m, logged in half of these lives). Judged on the third, fourth and sixth day with all days so far. The
truth is the rms error over 3000 poses within the readings of the calibration, as an instrument of this noise reads it.

Counted: "still valid" where the true error is beyond the tolerance (twice what the file states; goal: at most 1 % of
all verdicts); of errors that grew by 0.15 mm or more the share that the corrected robot takes away (goal 70 %); true
errors in the 95 % interval (goal 93 to 97 %). Then real: series B of the UR10 (Landgraf et al. 2021), calibrated with
500 of the poses that are not repeated: five of the repeated poses at a time, first visits as one day, second visits as
the next; the same with joint 3 turned by 0.5 mrad in the second (a planted change). And series C by the order of its
rows, ten parts of which the first four calibrate, five poses of each later part, temperature logged. The rules were
committed before seed 5 was run; seeds 2 to 4 were used to write them. Warmth that is logged is no change of the robot
and is not corrected. Warmth again, by the same rules, in lives of seed 6: --lives 360 --seed 6 --kinds warmth.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from lives import NOISE, ROOT, daily, frame_of, moved, robots, together

from casadical import Measurements, Robot, identify, read_problem, read_robot, write_robot
from casadical.fleet.touches import Touches, plan_touches, touched
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import STANDS, same_readings, unmeasured
from casadical.project.calibration import with_knowledge

KINDS = ("nothing", "zero", "crash", "tool", "foot", "warmth")
WARM = "logged"  # warmth whose temperature is logged
DAYS, EVENT, LEARNT, GREAT = 6, 4, 100, 1.5e-4


def read(truth: Robot, q: np.ndarray, rng: np.random.Generator, noise: float = NOISE) -> Measurements:
    m = unmeasured(q)
    return replace(m, position=predicted(truth, m)[0] + noise * rng.normal(size=(len(q), 3)))


def event(robot: Robot, kind: str, rng: np.random.Generator) -> dict[str, float]:
    def vector(names: tuple[str, ...], least: float, most: float) -> dict[str, float]:
        v = rng.normal(size=len(names))
        return dict(zip(names, v / np.linalg.norm(v) * np.exp(rng.uniform(np.log(least), np.log(most))), strict=True))

    zeros = tuple(f"theta{j}" for j in range(2, 7))
    if kind == "zero":
        return vector((str(rng.choice(zeros[:4])),), 1e-4, 1.5e-3)
    if kind == "crash":
        tool = vector(("tool_x", "tool_y", "tool_z"), 3e-4, 3.001e-4)
        return {n: 3e-4 * rng.normal() for n in zeros} | tool
    if kind == "tool":
        return vector(("tool_x", "tool_y", "tool_z"), 1e-4, 1.5e-3)
    if kind == "foot":
        return vector(frame_of(robot), 1e-4, 1.5e-3)
    return {"lengths": rng.uniform(5e-5, 2e-4)} if kind == "warmth" else {}


def table(m: Measurements, path: Path, temperature: float | None = None) -> Path:
    assert m.position is not None
    n = m.q.shape[1]
    rows = np.hstack([np.rad2deg(m.q), 1e3 * m.position])
    head = [f"q{j + 1}_deg" for j in range(n)] + ["x_mm", "y_mm", "z_mm"]
    if temperature is not None:
        rows, head = np.hstack([rows, np.full((len(rows), 1), temperature)]), [*head, "temperature_degC"]
    np.savetxt(path, rows, delimiter=",", header=",".join(head), comments="", fmt="%.6f")
    return path


def true_error(model: Robot, truth: Robot, q: np.ndarray) -> float:
    m = unmeasured(q)
    return float(np.sqrt(((predicted(model, m)[0] - predicted(truth, m)[0]) ** 2).sum(axis=1).mean() + 3 * NOISE**2))


def one(number: int, seed: int) -> list[dict[str, object]]:
    rng = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    nominal, built = robots("ur10e", 9000 + 10_000 * seed + number)
    learnt = rng.uniform(*built.limits, (LEARNT, built.n))
    what = event(built, kind, rng)
    logged = kind == "warmth" and bool(number // len(KINDS) % 2)
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "r.robot.toml"
        write_robot(with_knowledge(identify(nominal, read(built, learnt, rng), method="SKCM")), file)
        robot = read_robot(file)
        plan = plan_touches(file, 5, seed=number)
        q = np.deg2rad(plan[list(robot.reading_units)].to_numpy(dtype=float))
        task = rng.uniform(learnt.min(axis=0), learnt.max(axis=0), (3000, built.n))
        tables: list[Path] = []
        start = true_error(robot, built, task)
        for day in range(1, DAYS + 1):
            by: Mapping[str, float] = together(what if day >= EVENT else {}, daily(built, rng))
            now = moved(built, by)
            warm = 20 + (what.get("lengths", 0.0) / 12e-6 if day >= EVENT else 0.0)
            tables.append(table(read(now, q, rng), Path(scratch) / f"2026-03-{day:02d}.csv", warm if logged else None))
            if day not in (EVENT - 1, EVENT, DAYS):
                continue
            found = touched(file, tables)
            before = true_error(robot, now, task)
            after = true_error(found.corrected(), now, task) if found.better else before
            low, high = np.quantile(found.errors, [0.025, 0.975])
            rows.append({
                "kind": (WARM if logged else kind) if day >= EVENT else "nothing",
                "verdict": found.verdict, "true": before, "after": after,
                "inside": low <= before <= high, "beyond": before > found.tolerance, "start": start,
                "better": found.better, "low": before < low,
            })  # fmt: skip
    return rows


def removed(rows: list[dict[str, object]]) -> float:
    """Share of the grown mean square that the correction takes away, as a length."""
    grown = [float(r["true"]) ** 2 - float(r["start"]) ** 2 for r in rows]
    left = [max(0.0, float(r["after"]) ** 2 - float(r["start"]) ** 2) for r in rows]
    return float(np.mean([1 - np.sqrt(b / a) for a, b in zip(grown, left, strict=True)]))


def of_lives(count: int, seed: int, kinds: list[str]) -> None:
    lives = [k for k in range(count) if KINDS[k % len(KINDS)] in kinds]
    rows = [r for k in lives for r in one(k, seed)]
    print(f"{len(lives)} lives, seed {seed}; {len(rows)} verdicts; synthetic data")
    print(f"{'':8}   n valid open changed  false valid  inside  corrected  grown .15 mm: n  removed  to half or less")
    for kind in (*KINDS, WARM, "all"):
        if not (own := [r for r in rows if kind in (r["kind"], "all")]):
            continue
        said = [sum(r["verdict"] == v for r in own) for v in ("valid", "open", "changed")]
        false = sum(r["verdict"] == "valid" and bool(r["beyond"]) for r in own)
        great = [r for r in own if float(r["true"]) ** 2 - float(r["start"]) ** 2 > GREAT**2]
        half = sum(removed([r]) >= 0.5 for r in great)
        print(f"{kind:8} {len(own):3d} {said[0]:5d} {said[1]:4d} {said[2]:7d}  {false:11d}  "
              f"{100 * np.mean([bool(r['inside']) for r in own]):5.1f} %  {sum(bool(r['better']) for r in own):9d}  "
              f"{len(great):16d}  " + (f"{100 * removed(great):5.0f} %  {half}" if great else ""))  # fmt: skip
    false = sum(r["verdict"] == "valid" and bool(r["beyond"]) for r in rows)
    print(f"false 'still valid': {100 * false / len(rows):.1f} % of all verdicts (goal 1 %)\n")


def line(words: str, found: Touches) -> str:
    low, high = 1e3 * np.quantile(found.errors, [0.025, 0.975])
    said = f"{words:34} {found.verdict:8} {found.probability:5.3f}  {low:.3f} to {high:.3f} mm  "
    told = found.label or "nothing"
    first = f" {found.moved[0][0]} {found.moved[0][1]:+.4f} +- {found.moved[0][2]:.4f}" if found.moved else ""
    return f"{said}{told} ({found.draws.share(found.label):.2f}){first}"


def real(name: str) -> tuple[Robot, Measurements]:
    problem = read_problem(ROOT / "problems" / name)
    (file,) = (ROOT / "problems" / name / str(t["file"]) for t in problem.tables)
    from casadical.project.problem import read_campaign

    return problem.robot, read_campaign(ROOT / "problems" / name, file, problem.robot, later=True).positions_alone()


def of_ur10() -> None:
    robot, B = real("ur10_joints")
    assert B.position is not None
    reading = same_readings(B.q, STANDS)
    twice = [np.flatnonzero(reading == k) for k in np.flatnonzero(np.bincount(reading) == 2)]
    once = np.flatnonzero(np.isin(reading, np.flatnonzero(np.bincount(reading) == 1)))
    print(f"UR10, series B, real: {len(twice)} poses visited twice, calibrated with {len(once)} others")
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "r.robot.toml"
        write_robot(with_knowledge(identify(robot, B[rng.permutation(once)[:500]], method="SKCM", loss="huber")), file)
        for k, own in enumerate(np.split(rng.permutation(len(twice))[:40], 8)):
            first, second = (B[[twice[i][v] for i in own]] for v in (0, 1))
            days = [table(m, Path(scratch) / f"2026-0{d}-01.csv") for d, m in ((1, first), (2, second))]
            print(line(f"five poses, {k + 1}", touched(file, days)))
            turned = replace(second, q=second.q - 5e-4 * (np.arange(6) == 2))
            days[1] = table(turned, days[1])
            print(line("  joint 3 turned by 0.0286 deg", touched(file, days)))
        robot, C = real("ur10")
        parts = np.array_split(np.arange(len(C)), 10)
        some = rng.permutation(np.concatenate(parts[:4]))[:500]
        write_robot(with_knowledge(identify(robot, C[some], method="SKCM", loss="huber")), file)
        print("\nUR10, series C, real, by the order of its rows; calibrated with 500 poses of parts 1 to 4")
        days = []
        for k, part in enumerate(parts[4:], 5):
            m = C[rng.permutation(part)[:5]]
            degrees = float(m.conditions["temperature_degC"].mean()) if "temperature_degC" in m.conditions else None
            days.append(table(m, Path(scratch) / f"2026-{k:02d}-03.csv", degrees))
            print(line(f"part {k}, {degrees or 0.0:.2f} degC", touched(file, days)))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--lives", type=int, default=180)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    given = parser.parse_args()
    of_lives(given.lives, given.seed, given.kinds)
    if given.kinds == list(KINDS):
        of_ur10()


if __name__ == "__main__":
    main()
