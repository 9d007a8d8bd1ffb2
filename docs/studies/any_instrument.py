"""Campaigns of the engine as other instruments measure them, and instruments that fail.

    python docs/studies/any_instrument.py --campaigns 200 --seed 2604 --keep FILE --seconds 500

(again until all are done; with --table it prints what is there), and `--faults 40`.

Synthetic. Campaigns (instrument_campaigns.py), of MuJoCo, hide nothing, one effect, or one that is on no
list; they are distances to three places, touches of sockets, planes or balls, full poses, or positions and distances at
the same stops. The limit is the power of a test that knows the hidden signature (to three parameters) and the noise, at
a false alarm in a hundred campaigns for all causes together (69 labels of a six-axis robot). Seeds 2601 and 2602 are
for practice now; 2603 judged 2084f925, and 2604 what came of it, with rules that were committed before it was run; by
the commits that the print names, half of the campaigns came from a simulator in numpy. A table of fewer campaigns is
of those done.

`--faults` campaigns have nothing hidden in the robot: one of three instruments drifts, or the place that it measures to
is knocked.
"""

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from instrument_campaigns import campaign
from kept import Row, add_options, rows_of

from casadical.core.basics import ConvergenceError, InputError
from casadical.diagnosis.diagnose import Diagnosis, diagnose
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table
from casadical.project.problem import read_campaign_robot
from casadical.robot.robot import Robot

ROOT = Path(__file__).parents[2]
GROUPS = {
    "distances": ("distances",), "contacts": ("sockets", "planes", "balls"), "poses": ("poses",), "mixed": ("mixed",),
    "  sockets": ("sockets",), "  planes": ("planes",), "  balls": ("balls",),
}  # fmt: skip
NAMES = ("ur10e", "kr210", "hh800")
INSTRUMENT = {"wire_drift", "station_step"}
# What is hidden is visible from this ratio of its rms to the noise on (over all numbers that were measured).
VISIBLE = 0.35


def places(robot: Robot, seed: int) -> np.ndarray:
    """Three known places about the robot, shape (3, 3) [m]."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0, 2 * np.pi) + np.array([0, 2, 4]) * np.pi / 3
    out = 1.6 * robot.reach
    height = robot.reach * rng.permutation([0.0, 0.4, 0.9])
    return robot.base.T[:3, 3] + np.column_stack([out * np.cos(turn), out * np.sin(turn), height])


def distances(m: Measurements, to: np.ndarray) -> list[Measurements]:
    assert m.position is not None
    return [
        Measurements(
            m.q,
            "distance",
            distance=np.linalg.norm(m.position - place, axis=1),
            target=np.tile(place, (len(m), 1)),
            conditions=m.conditions,
            source=f"distances {k}",
        )
        for k, place in enumerate(to, 1)
    ]


def answered(robot: Robot, sets: Sequence[Measurements]) -> Diagnosis | None:
    try:
        return diagnose(robot, sets)
    except (InputError, ConvergenceError) as error:
        print(f"  failed: {error}")
        return None


def judged(number: int, seed: int) -> Row:
    """One campaign and its answer."""
    c = campaign(number, seed)
    row = {
        "kind": c.kind, "robot": c.robot.name, "hidden": c.hidden, "truth": c.truth,
        "visible": c.visible, "limit": c.limit(0.01, 69),
    }  # fmt: skip
    began = time.process_time()
    try:
        found = diagnose(c.robot, c.sets)
    except (InputError, ConvergenceError) as error:
        return row | {"verdict": "refused", "why": str(error), "named": []}
    named = sorted({cause.label for cause in found.causes if cause.effects})
    none = found.rankings[0].none
    return row | {"verdict": found.verdict, "named": named, "none": none, "seconds": time.process_time() - began}


def table(rows: Sequence[Row]) -> str:
    """A line for each group of instruments, and what was claimed wrongly."""
    groups = {kind: [r for r in rows if r["kind"] in kinds] for kind, kinds in GROUPS.items()}
    lines = [
        "              of   refused  claims  right     nothing  alarms  on no list  claimed    one: detected  limit    "
        "visible >= .35: detected  limit  claimed"
    ]
    for name, own in {**groups, "all": list(rows)}.items():
        claims = [r for r in own if r["verdict"] == "explained" and r["named"]]
        right = [r for r in claims if set(r["named"]) <= set(r["truth"])]
        none, off, one = ([r for r in own if r["hidden"] == what] for what in ("none", "unlisted", "one"))
        seen = [r for r in one if r["visible"] >= VISIBLE]
        alarms = sum(r["verdict"] not in ("none", "refused") for r in none)
        numbers = [
            f"{len(own):4d} {sum(r['verdict'] == 'refused' for r in own):9d} {len(claims):7d} {len(right):6d}",
            f"{len(none):7d} {alarms:7d} {len(off):11d} {sum(r in claims for r in off):8d}",
            f"{_detected(one)} {np.mean([r['limit'] for r in one] or [0]):6.2f}",
            f"{_detected(seen)} {np.mean([r['limit'] for r in seen] or [0]):6.2f} {sum(r in claims for r in seen):8d}",
        ]
        lines.append(f"{name:12s} " + "    ".join(numbers))
    lines.append("")
    for r in rows:
        wrong, which = set(r["named"]) - set(r["truth"]), f"{r['name']} {r['kind']}"
        if r["verdict"] == "refused" or (r["hidden"] == "none" and r["verdict"] != "none"):
            lines.append(f"{which}, hidden {r['hidden']}: {r['verdict']} {r.get('why', '')}")
        elif r["verdict"] == "explained" and wrong:
            lines.append(f"{which}: {', '.join(wrong)} claimed of {r['truth'] or r['hidden']}")
    return "\n".join(lines)


def _detected(rows: Sequence[Row]) -> str:
    return f"{sum(r['verdict'] not in ('none', 'refused') for r in rows):8d} of {len(rows):3d}"


def faults(count: int, seed: int) -> None:
    print("\nfault          campaigns  visible  named  a cause in the robot claimed (of all)")
    rows: dict[str, list[tuple[bool, bool, bool]]] = {"wire_drift": [], "station_step": []}
    for k in range(count):
        rng = np.random.default_rng([seed, 77, k])
        name, fault = NAMES[k % 3], [*rows][k % 2]
        robot = read_campaign_robot(ROOT / "problems" / name)
        poses, noise = int(rng.choice([60, 100, 150])), float(rng.choice([0.02, 0.05, 0.1, 0.2])) * 1e-3
        lower, upper = np.array([[j.lower, j.upper] for j in robot.joints]).T
        q = lower + (upper - lower) * rng.uniform(0.2, 0.8, (poses, robot.n))
        real = robot.with_values(
            {n: robot.parameters[n].value + rng.normal(0, 2e-4) for n in robot.parameters.select(["geometry"])}
        )
        blank = from_table(_frame(q), [j.kind for j in robot.joints], "position")
        m = replace(blank, position=predicted(real, blank)[0])
        sets = distances(m, places(robot, k))
        which, size = int(rng.integers(3)), noise * float(rng.choice([0.5, 1.0, 2.0, 4.0]))
        late = np.linspace(0, 1, poses)
        if fault == "wire_drift":
            moved = size * np.sqrt(12) * (late - 0.5)
        else:
            shift = rng.standard_normal(3) * size * 2
            assert m.position is not None
            after = (late > rng.uniform(0.2, 0.8))[:, None]
            moved = np.linalg.norm(m.position - sets[which].target - after * shift, axis=1) - sets[which].distance
        sets[which] = replace(sets[which], distance=sets[which].distance + moved)
        sets = [replace(s, distance=s.distance + rng.normal(0, noise, poses)) for s in sets]
        found = answered(robot, sets)
        if found is None:
            continue
        named = {c.label for c in found.causes if c.effects}
        visible = float(np.sqrt(np.mean((moved - moved.mean()) ** 2) / 3)) / noise >= VISIBLE
        rows[fault].append((visible, named == {fault}, found.verdict == "explained" and bool(named - INSTRUMENT)))
        if named != {fault} or not visible:
            print(
                f"  {fault} {k}: {poses} poses, rms {1e3 * moved.std():.3f} mm, noise {1e3 * noise:.2f}: "
                f"{found.verdict} {sorted(named)}"
            )
    for fault, found_rows in rows.items():
        visible, right, robots = np.array(found_rows, dtype=bool).reshape(-1, 3).T
        print(f"{fault:14s} {len(visible):9d} {visible.sum():8d} {(visible & right).sum():6d} {robots.sum():8d}")


def _frame(q: np.ndarray) -> pd.DataFrame:
    table = pd.DataFrame(np.rad2deg(q), columns=[f"q{j}_deg" for j in range(1, q.shape[1] + 1)])
    return table.assign(x_mm=0.0, y_mm=0.0, z_mm=0.0)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--campaigns", type=int, default=0)
    parser.add_argument("--faults", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    add_options(parser, "any_instrument")
    options = parser.parse_args()
    print(f"{options.campaigns} campaigns, {options.faults} faults, seed {options.seed}\n")
    started = time.process_time()
    if options.campaigns:
        todo = [(f"{options.seed}-{k}", k) for k in range(options.campaigns)]
        rows = rows_of(todo, lambda k: judged(k, options.seed), options)
        print(f"{len(rows)} of them\n\n{table(rows)}")
    if options.faults:
        faults(options.faults, options.seed)
    print(f"\n{time.process_time() - started:.0f} s of CPU")


if __name__ == "__main__":
    main()
