"""Campaigns of the blind check as other instruments would have measured them, and instruments that fail.

    python docs/studies/any_instrument.py [--campaigns 200] [--faults 40] [--seed 0] > docs/studies/any_instrument.txt

Synthetic. Campaigns of both physics (half each) hide effects of the robot; their measured positions, noise included,
become distances to three places that are known, distances between poses, or half of each campaign stays positions and
half is distances ("mixed"). The campaigns know neither touched points nor orientations, so that contacts and full poses
are not in this figure (see real_diagnoses.txt for those of real robots). `--faults` campaigns have nothing hidden in
the robot: one of three instruments drifts, or the place that it measures to is knocked.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from casadical.blind_check.generation import make
from casadical.blind_check.predictor import session
from casadical.blind_check.protocol import ROBOTS, read_key, read_manifest, read_table
from casadical.core.errors import ConvergenceError, InputError
from casadical.diagnosis.diagnose import Diagnosis, diagnose
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table
from casadical.project.problem import read_campaign_robot
from casadical.robot.robot import Robot

ROOT = Path(__file__).parents[2]
KINDS = ("distances", "pairs", "mixed")
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


def pairs(m: Measurements) -> list[Measurements]:
    """Every pose's distance to the pose a third and two thirds of the campaign later."""
    assert m.position is not None
    found = []
    for k in (1, 2):
        far = np.roll(np.arange(len(m)), k * len(m) // 3)
        apart = np.linalg.norm(m.position - m.position[far], axis=1)
        found.append(Measurements(m.q, "pair_distance", distance=apart, other=m.q[far], conditions=m.conditions))
    return found


def as_kind(kind: str, m: Measurements, robot: Robot, seed: int) -> list[Measurements]:
    if kind == "pairs":
        return pairs(m)
    if kind == "distances":
        return distances(m, places(robot, seed))
    return [m[::2], *distances(m[1::2], places(robot, seed))]


def answered(robot: Robot, sets: Sequence[Measurements]) -> Diagnosis | None:
    try:
        return diagnose(robot, sets)
    except (InputError, ConvergenceError) as error:
        print(f"  failed: {error}")
        return None


def blind(count: int, seed: int) -> None:
    print("kind         physics  campaigns  claims  right  nothing there  alarms  visible (.35)  detected")
    for physics in ("numpy", "mujoco"):
        with tempfile.TemporaryDirectory() as folder:
            public, key = Path(folder) / "public", Path(folder) / "key"
            make(public, key, count // 2, seed, physics=physics, project=ROOT)
            manifest = read_manifest(public)
            secrets = read_key(key, manifest).campaigns
            rows: dict[str, list[tuple[bool, bool, bool, bool, bool]]] = {kind: [] for kind in KINDS}
            for k, (name, secret) in enumerate(sorted(secrets.items())):
                kind = KINDS[k % len(KINDS)]
                model = (public / ROBOTS / f"{secret.robot}.robot.toml").read_text(encoding="utf-8")
                s = session(name, model, read_table(public, name), read_table(public, f"{name}.unseen"))
                found = answered(s.robot, as_kind(kind, s.measured, s.robot, k))
                if found is None:
                    continue
                named = {c.label for c in found.causes if c.effects}
                claimed, nothing = found.verdict == "explained" and bool(named), secret.kind == "none"
                right = named <= set(secret.truth)
                visible = not nothing and secret.visible / secret.noise >= VISIBLE
                rows[kind].append((claimed, right, nothing, found.verdict != "none", visible))
                if claimed and not right:
                    print(f"  {physics} {name} {kind}: {sorted(named)} of {secret.truth}")
        for kind, found_rows in rows.items():
            claimed, right, nothing, detected, visible = np.array(found_rows, dtype=bool).reshape(-1, 5).T
            sums = [np.count_nonzero(a) for a in (claimed, claimed & right, nothing, nothing & detected, visible)]
            text = " ".join(f"{n:{w}d}" for n, w in zip(sums, (7, 6, 14, 7, 14), strict=True))
            print(f"{kind:12s} {physics:8s} {len(found_rows):9d} {text} {np.count_nonzero(visible & detected):9d}")


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
    parser.add_argument("--campaigns", type=int, default=200)
    parser.add_argument("--faults", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(f"{options.campaigns} campaigns, {options.faults} faults, seed {options.seed}\n")
    started = time.process_time()
    if options.campaigns:
        blind(options.campaigns, options.seed)
    if options.faults:
        faults(options.faults, options.seed)
    print(f"\n{time.process_time() - started:.0f} s of CPU")


if __name__ == "__main__":
    main()
