"""Nothing changes when readings move by 1e-12: python docs/studies/moved_readings.py [--more FOLDER] [--keep FILE].

Again until all are done (`--seconds S` ends it after so much processor time); with --table it prints what is there.
Every practice and sealed campaign (`--more`: of further folders) is diagnosed as it is, and with joints and what was
measured moved by normal numbers of 1e-12 rad and m. Then positions are made into distances from a known place, and
into full poses by the calibrated robot's orientations with a noise of .1 mrad; of practice campaigns at once, of sealed
ones after all positions. Compared are the verdict, the causes in their order, the names that are told with them, how
far each makes the gap shrink, and all shares of WHERE. A share or a shrink counts as another from 5e-5 on, half of the
last digit of the answer in JSON.
"""

import argparse
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from campaign_robots import campaigns, read
from kept import Row, add_options, rows_of

from casadical import InputError, diagnose
from casadical.core.basics import Array
from casadical.diagnosis.localisation import localise
from casadical.identification.accuracy import predicted
from casadical.identification.identification import base_calibrated, prepare
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

KINDS = ("position", "distance", "pose")
MOVED, ANGLE, DIGIT = 1e-12, 1e-4, 5e-5


def turned(R: Array, angle: Array) -> Array:
    """Orientations, shape (n, 3, 3), turned by small angles about their axes, shape (n, 3) [rad]."""
    return np.asarray(R + np.cross(R, angle[:, None, :]))


def as_kind(robot: Robot, m: Measurements, kind: str) -> Measurements:
    """Positions as another instrument would have measured them."""
    assert m.position is not None
    if kind == "distance":
        place = 1.6 * robot.reach * np.array([0.8, 0.6, 0.3])
        d = np.linalg.norm(m.position - place, axis=1)
        target = np.tile(place, (len(m), 1))
        return Measurements(m.q, kind, distance=d, target=target, conditions=m.conditions, source=m.source)
    if kind == "pose":
        R = predicted(base_calibrated(prepare(robot, m)).robot, m)[1]
        R = turned(R, ANGLE * np.random.default_rng(0).standard_normal((len(m), 3)))
        return Measurements(m.q, kind, position=m.position, orientation=R, conditions=m.conditions, source=m.source)
    return m


def moved(m: Measurements, seed: int) -> Measurements:
    rng = np.random.default_rng(seed)
    of = {
        name: values + MOVED * rng.standard_normal(values.shape)
        for name in ("q", "position", "distance")
        if (values := getattr(m, name)) is not None
    }
    if m.orientation is not None:
        of["orientation"] = turned(m.orientation, MOVED * rng.standard_normal((len(m), 3)))
    return replace(m, **of)


def answer(robot: Robot, m: Measurements) -> tuple[Any, dict[str, float]]:
    """What is said in words, and numbers."""
    try:
        found = diagnose(robot, m)
    except InputError as error:
        return ["refused", str(error)], {}
    words = [found.verdict, *([c.label, *c.indistinguishable] for c in found.causes)]
    where = localise(found)
    numbers = {f"shrink of {c.label}": c.shrink for c in found.causes}
    for name, table in where.tables():
        rows = table["frame"] + " " + table["part"] if "frame" in table else table.get("by", name) + " " + table["part"]
        numbers |= {f"{name}: {row}": float(v) for row, v in zip(rows, table["share"], strict=True)}
    return words, numbers


def judged(entry: tuple[Path, str]) -> Row:
    path, kind = entry
    robot, m = read(path)
    m = as_kind(robot, m, kind)
    (words, numbers), (again, others) = answer(robot, m), answer(robot, moved(m, 1))
    off = {name: abs(others.get(name, np.inf) - value) for name, value in numbers.items()}
    worst = max(off, key=lambda name: off[name], default="")
    return {
        "kind": kind,
        "folder": path.parent.name,
        "words": [words] if words == again else [words, again],
        "numbers": sum(v >= DIGIT for v in off.values()),
        "worst": [worst, float(off.get(worst, 0.0))],
    }


def told(rows: Sequence[Row]) -> None:
    print(f"{'':24}{'campaigns':>10}{'other words':>13}{'other shares':>14}{'greatest difference':>21}")
    for folder in dict.fromkeys(r["folder"] for r in rows):
        for kind in KINDS:
            some = [r for r in rows if r["folder"] == folder and r["kind"] == kind]
            if some:
                words, shares = sum(len(r["words"]) > 1 for r in some), sum(r["numbers"] > 0 for r in some)
                most = max(r["worst"][1] for r in some)
                print(f"{f'{folder}, {kind}s':24}{len(some):10}{words:13}{shares:14}{most:21.1e}")
    for r in rows:
        if len(r["words"]) > 1:
            print(f"{r['name']}: {r['words'][0]} and {r['words'][1]}")
        elif r["numbers"]:
            print(f"{r['name']}: {r['numbers']} numbers, {r['worst'][0]} by {r['worst'][1]:.1e}")
    refused = [r["name"] for r in rows if r["words"][0][0] == "refused"]
    print(f"refused, alike: {', '.join(refused) or 'none'}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--more", type=Path, action="append", default=[], help="folder of further campaigns")
    parser.add_argument("--only", default="", help="campaigns whose names begin so")
    add_options(parser, "moved_readings")
    given = parser.parse_args()
    paths = [path for path in campaigns(given.more) if path.stem.startswith(given.only)]
    every = [(path, kind) for path in paths for kind in KINDS]
    # What an end of the run leaves undone are other kinds of sealed campaigns.
    every.sort(key=lambda entry: entry[0].parent.name != "practice" and entry[1] != KINDS[0])
    todo = [(f"{path.stem} {kind}s", (path, kind)) for path, kind in every]
    rows = rows_of(todo, judged, given)
    print(f"{len(rows)} of {len(todo)} done")
    told(rows)


if __name__ == "__main__":
    main()
