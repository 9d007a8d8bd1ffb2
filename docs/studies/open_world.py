"""Where the diagnosis meets what it was not built on: python docs/studies/open_world.py --seeds judge > open_world.txt

Synthetic campaigns of the blind check's engine MuJoCo, which shares no formula with the candidates (half of those of
the print, by the commit that it names, came from a simulator in numpy); robots, joints, sizes and poses by chance. Each
effect is scaled to a signal: rms of a coordinate that the base model cannot absorb, over the instrument's noise.
Declared masses are wrong in the robot that is given; noise is made here. Rules were developed on seeds "develop" and
"develop 2", and judged on "judge" and, after the changes that followed, on "judge 2" to "judge 18", which nobody had
seen before the commit that froze them. The part "foreign" has effects (foreign_effects.py) written by an author who
has read neither the diagnosis nor its effects; "one beside a foreign one" has one of these beside a listed one. A
single is claimed where it, or the two or three causes that the poses do not tell apart, is named from .9 on;
"explained" says besides that it is all, which noise of another form forbids. The weight of what was not tried was
learnt with the foreign ones on seeds "develop 2".

--share 4 makes four times as many campaigns; --keep FILE keeps finished ones, to go on after a break.
"""

import argparse
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from acting import acting
from campaign_robots import machine
from foreign_effects import FOREIGN
from kept import add_options, rows_of
from scipy import signal
from sessions import UNLISTED, Scatter, Session

from casadical.blind_check.mujoco_physics import LISTED, perturb
from casadical.blind_check.mujoco_physics.campaigns import MEASURED_COLUMNS
from casadical.blind_check.scoring import Estimate, fraction
from casadical.core.basics import Array, InputError
from casadical.diagnosis.diagnose import diagnose
from casadical.diagnosis.linearisation import base_jacobian, unabsorbed_rms
from casadical.diagnosis.settings import SETTINGS
from casadical.measurements.reading import from_table
from casadical.robot.robot import Robot

ROBOTS = ("hh800", "kr210", "ur10e")
NAMES = ("develop", "judge", "develop 2", *(f"judge {k}" for k in range(2, 19)))
SEEDS = dict(zip(NAMES, range(1501, 1521), strict=True))
NOISE_MM = 0.02
# Campaigns of each part.
PARTS = {
    "clean": 12,
    "masses 3-10 %": 12,
    "masses 10-30 %": 15,
    "autocorrelated noise": 9,
    "one scattering joint": 12,
    "heavy tails": 9,
    "copied rows": 6,
    "missing column": 12,
    "one": 24,
    "one, imperfect": 18,
    "one, masses wrong": 15,
    "two": 12,
    "three": 12,
    "four": 8,
    "clutter": 8,
    "unlisted": 36,
    "noise of another size": 9,
    "foreign": 32,
    "one beside a foreign one": 20,
    "one beside an unlisted one": 20,
}
# Those that hide nothing, and those that hide what is on no list.
CLEAN = (*tuple(PARTS)[:8], "noise of another size")
OFF, BESIDE = ("unlisted", "foreign"), ("one beside a foreign one", "one beside an unlisted one")
IMPERFECT = ("autocorrelated noise", "one scattering joint", "heavy tails", "copied rows", "missing column")
COLUMNS = {"approach": "approach", "temperature": "temperature", "payload": "payload", "time": "time_s"}


def noise(kind: str, poses: int, rng: np.random.Generator) -> Array:
    """Of the instrument, shape (poses, 3) [mm]."""
    white = rng.standard_normal((poses, 3))
    if kind == "autocorrelated noise":
        phi = rng.uniform(0.5, 0.9)
        white = signal.lfilter([np.sqrt(1 - phi**2)], [1, -phi], rng.standard_normal((poses + 50, 3)), axis=0)[50:]
    if kind == "heavy tails":
        white[rng.random(poses) < 0.05] *= 4
    if kind == "noise of another size":
        white *= rng.choice([1 / 3, 3])
    return NOISE_MM * white


def wrong_masses(robot: Robot, low: float, high: float, centre: float, rng: np.random.Generator) -> Robot:
    """The robot as declared by a user who guesses: masses off by shares, mass centres by lengths [m]."""
    joints = []
    for j in robot.joints:
        body = j.body
        if body:
            mass = body.mass * (1 + rng.choice([-1, 1]) * rng.uniform(low, high))
            body = replace(body, mass=mass, com=body.com + rng.uniform(-centre, centre, 3))
        joints.append(replace(j, body=body))
    return replace(robot, joints=tuple(joints))


def signals(part: str, rng: np.random.Generator) -> list[float]:
    """Of the effects that a part hides."""
    counts = {"one": 1, "two": 2, "three": 3, "four": 4}
    if part in OFF:
        return [float(rng.uniform(0.8, 2.5))]
    if part in BESIDE:
        return [float(rng.uniform(0.8, 2.5)), float(rng.uniform(0.6, 2.0))]
    if part == "one":
        return [float(np.exp(rng.uniform(np.log(0.35), np.log(2.5))))]
    if part == "clutter":
        return [3.0, *rng.uniform(0.35, 0.7, 5)]
    return list(rng.uniform(0.8, 2.5, counts.get(part.split(",")[0], 0)))


def trial(part: str, number: int, seeds: str) -> dict[str, Any]:
    """One campaign, hidden, measured and diagnosed."""
    rng = np.random.default_rng([SEEDS[seeds], list(PARTS).index(part), number])
    robot, nominal = machine(ROBOTS[number % 3])
    words = [str(w) for w in rng.permutation([w for w in LISTED if w != "outliers"])]
    if part == "unlisted":
        words = [UNLISTED[int(np.random.default_rng(SEEDS[seeds]).permutation(len(UNLISTED))[number % len(UNLISTED)])]]
    if part == "foreign":
        words = [list(FOREIGN)[number % len(FOREIGN)]]
    if part in BESIDE:
        foreign = list(FOREIGN) if part == BESIDE[0] else UNLISTED
        words = [words[0], foreign[number % len(foreign)]]
    kind = str(rng.choice(IMPERFECT)) if part == "one, imperfect" else part
    plant = perturb(nominal, int(rng.integers(1 << 30)))
    session = Session(plant, int(rng.choice([60, 100])), number + 7)
    also = [acting(Scatter(int(rng.integers(1, 7)), number), plant)] if kind == "one scattering joint" else []
    clean = session.table(*also)
    m0 = from_table(session.table(), 6, "position")
    sizes = signals(part, rng)
    J = base_jacobian(robot, m0) if sizes else None
    position, truth, visible = clean[MEASURED_COLUMNS].to_numpy(float), [], []
    for word, size in zip(words, sizes, strict=False):
        label, hidden = session.drawn(word, rng)
        shift = session.table(hidden)[MEASURED_COLUMNS].to_numpy(float) - 1e3 * m0.position
        seen = unabsorbed_rms(J, shift) / NOISE_MM
        # What the base model absorbs altogether stays small.
        factor = min(size / seen, 8.0)
        position, truth, visible = position + factor * shift, [*truth, label], [*visible, factor * seen]
    table = clean.assign(**dict(zip(MEASURED_COLUMNS, (position + noise(kind, len(clean), rng)).T, strict=True)))
    missing = ""
    if kind == "missing column":
        missing = list(COLUMNS)[number % 4]
        table = table.drop(columns=[c for c in table if c.startswith(COLUMNS[missing])])
    if kind == "copied rows":
        table = pd.concat([table, table.iloc[rng.choice(len(table), 8, replace=False)]])
    if "masses" in part:
        limits = (0.03, 0.1, 0.02) if "3-10" in part else (0.1, 0.3, 0.03)
        robot = wrong_masses(robot, *limits, rng)
    answer = {"part": part, "kind": kind, "robot": robot.name, "missing": missing}
    answer |= {"truth": truth, "signals": visible, "poses": len(table)}
    try:
        found = diagnose(robot, from_table(table, 6, "position"))
    except InputError as error:
        return answer | {"verdict": "refused", "named": [], "why": str(error)}
    return answer | {
        "verdict": found.verdict,
        "named": [c.label for c in found.causes],
        "confidence": [c.confidence for c in found.causes],
        "names": {label: dict(each) for label, each in found.cause_set.names.items()} if found.cause_set else {},
        "set": found.cause_set and found.cause_set.probability,
    }


def right(t: dict[str, Any]) -> set[str]:
    """Labels that a right answer may name: what is hidden; wrong masses; poses that the instrument got wrong."""
    found = set() if t["part"] in OFF else set(t["truth"])
    if "masses" in t["part"]:
        found.add("link_masses")
    return found | {"outliers"}


def wrong(t: dict[str, Any]) -> bool:
    """Whether any cause is named that is not there."""
    return bool(set(t["named"]) - right(t))


def flawed(t: dict[str, Any]) -> bool:
    """Whether a cause is named that is not there, or one that can be seen is not named."""
    return wrong(t) or any(k not in t["named"] for k, s in zip(t["truth"], t["signals"], strict=True) if s >= 0.35)


def causes(t: dict[str, Any]) -> list[str]:
    """What is named, masses and outliers aside."""
    return [k for k in t["named"] if k not in ("link_masses", "outliers")]


def claim(t: dict[str, Any]) -> set[str]:
    """Labels of the one cause that is claimed, whatever the verdict says of the rest; none with a form of no list."""
    if len(causes(t)) != 1:
        return set()
    (label,) = causes(t)
    names = t["names"].get(label) or {label: t["confidence"][t["named"].index(label)]}
    listed = {k for k in names if " " not in k}
    return listed if sum(names[k] for k in listed) >= SETTINGS.min_claim else set()


def table(trials: Sequence[dict[str, Any]]) -> str:
    """The figures of all parts with Wilson's intervals."""
    of = {part: [t for t in trials if t["part"] == part] for part in PARTS}
    rows: list[tuple[str, Estimate]] = []
    for part in CLEAN:
        rows.append((f"{part}: a wrong cause named", fraction([wrong(t) for t in of[part]])))
    rows.append(("all of these: a wrong cause named", fraction([wrong(t) for part in CLEAN for t in of[part]])))
    singles = [t for part in ("one", "one, imperfect", "one, masses wrong") for t in of[part]]
    for name, part in [*((p, of[p]) for p in ("one", "one, imperfect", "one, masses wrong")), ("all single", singles)]:
        claims = [t for t in part if t["verdict"] == "explained" and causes(t)]
        rows.append((f"{name}: claims made", fraction([t in claims for t in part])))
        rows.append((f"{name}: claims right", fraction([causes(t)[:1] == t["truth"][:1] for t in claims])))
        rows.append((f"{name}: a wrong cause named", fraction([wrong(t) for t in part])))
    seen = [t for t in singles if t["signals"][0] >= 0.35]
    rows.append(("all single, signal >= .35: called explained", fraction([t["verdict"] == "explained" for t in seen])))
    rows.append(("all single, signal >= .35: claimed", fraction([bool(claim(t)) for t in seen])))
    rows.append(("all single, signal >= .35: right", fraction([t["truth"][0] in claim(t) for t in seen if claim(t)])))
    for part in ("two", "three", "four", "clutter"):
        hits = [k in t["named"] for t in of[part] for k, s in zip(t["truth"], t["signals"], strict=True) if s >= 0.35]
        rows.append((f"{part}: recall", fraction(hits)))
        rows.append((f"{part}: precision", fraction([k in right(t) for t in of[part] for k in t["named"]])))
    for name in BESIDE:
        beside = of[name]
        rows.append((f"{name}: named", fraction([t["truth"][0] in t["named"] for t in beside])))
        rows.append((f"{name}: a wrong cause named", fraction([wrong(t) for t in beside])))
        sure = [{k for k, p in zip(t["named"], t["confidence"], strict=True) if p >= 0.9} - right(t) for t in beside]
        rows.append((f"{name}: a wrong cause at 0.9 or more", fraction([bool(labels) for labels in sure])))
        rows.append((f"{name}: called explained", fraction([t["verdict"] == "explained" for t in beside])))
    for low, high in ((0.0, 0.5), (0.5, 0.9), (0.9, 1.01)):
        sets = [t for t in trials if t.get("set") and low <= t["set"] < high]
        rows.append(
            (f"sets of probability {low:g} to {min(high, 1.0):g}: right", fraction([not flawed(t) for t in sets]))
        )
    for name, off in {"on no list": of["unlisted"], "foreign": of["foreign"]}.items():
        rows.append(
            (f"{name}, claimed as listed", fraction([t["verdict"] == "explained" and bool(causes(t)) for t in off]))
        )
        rows.append((f"{name}, any listed cause named", fraction([bool(causes(t)) for t in off])))
    return "\n".join(f"{name:<58} {estimate}" for name, estimate in rows if estimate.n)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", choices=SEEDS, default="develop")
    parser.add_argument("--share", type=float, default=1.0, help="of the campaigns of every part")
    parser.add_argument("--parts", default=";".join(PARTS), help="by semicolons")
    add_options(parser, "open_world")
    options = parser.parse_args()
    counts = {part: round(options.share * PARTS[part]) for part in options.parts.split(";")}
    tasks = sorted((k / count, part, k) for part, count in counts.items() for k in range(count))
    todo = [(f"{part}-{k}", (part, k)) for _, part, k in tasks]
    trials = rows_of(todo, lambda task: trial(*task, options.seeds), options)
    print(f"{len(trials)} of {len(tasks)} campaigns, seeds {options.seeds}\n")
    print(table(trials))


if __name__ == "__main__":
    main()
