"""python docs/studies/laws.py [--keep FILE.jsonl] [--repeats 1] [--part K/N] [--only KIND] [--follows] [--table]

Whether laws that are claimed are right: synthetic campaigns of two robots with an effect that is on no list, without
any effect, with autocorrelated noise, and with one listed effect. All campaigns are drawn from seeds that were
used for nothing before. The effects (foreign_effects.py, 16 kinds) are by an author who has read neither the diagnosis
nor its effects; the grammar does not hold the form of 13 of them. What counts as right (TRUTH) was written down before
any campaign was judged. The print, by the commits that it names, has 27 kinds more, by the author of the grammar, and
its campaigns are those of a simulator in numpy that has left the repository.

--keep : results are added to this file, and campaigns that are in it are not judged again
--part : the K-th of N parts of the campaigns; --table : print the table of what is kept, and judge nothing
--follows : the noise of all campaigns is autocorrelated with this coefficient; other seeds
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from acting import acting
from campaign_robots import machine
from foreign_effects import FOREIGN, draw_foreign
from kept import add_options, rows_of

from casadical.blind_check.generation import base_jacobian, unabsorbed_rms
from casadical.blind_check.mujoco_physics import LISTED, Hidden, campaign, draw_effect, perturb
from casadical.blind_check.mujoco_physics.cause import Cause
from casadical.blind_check.mujoco_physics.plant import Plant
from casadical.core.basics import CasadicalError
from casadical.diagnosis.diagnose import diagnose
from casadical.diagnosis.laws.contest import held_out
from casadical.diagnosis.laws.discovery import Discovery, laws_of_diagnosis
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table

ROBOTS, POSES, NOISE_MM, SIGNALS, SEED = ("kr210", "ur10e"), 100, 0.02, (0.8, 2.5), 101_000
# Coefficient of autocorrelated noise; seeds of campaigns that all have it.
STAYS, SEED_FOLLOWS = 0.8, 102_000
# Kind -> (places, families of drivers, whether the form is in the grammar); a joint's number is that of the effect, {1}
# the one before it.
OWN = ("joint {}", "tilt of link {}")
TRUTH: dict[str, tuple[tuple[str, ...], tuple[str, ...], bool]] = {
    "gear_lag": (OWN, ("load", "memory"), False),
    "short_move_stick": (OWN, ("move", "memory", "approach"), False),
    "wrong_table": (OWN, ("angle", "angles"), False),
    "uneven_planets": (OWN, ("wave by load",), True),
    "warm_balancer": (("joint 2", "tilt of link 2"), ("product",), False),
    "hose_winds": (("joint 5", "tilt of link 5"), ("angle", "angles"), False),
    "bearing_clearance": (("tilt of link {0}", "tilt of link {1}"), ("load", "moment"), False),
    "raceway_dent": (("tilt of link {0}", "tilt of link {1}"), ("angle",), True),
    "creeping_glue": (("tilt of link {}",), ("load", "moment"), False),
    "churned_grease": (("shift of link {0}", "shift of link {1}"), ("move", "memory"), False),
    "loose_anchor": (("base tilt",), ("load", "moment"), False),
    "neighbour_press": (("base tilt", "base shift"), ("time",), False),
    "slipping_part": (("tool shift",), ("move", "memory", "time"), False),
    "sloshing_tank": (("payload", "tilt of link 6"), ("gravity", "payload"), False),
    "cyclic_range": (("beam",), ("range",), True),
    "glass_corner": (("beam", "tool shift"), ("gravity", "range", "place"), False),
}


@dataclass(frozen=True)
class Trial:
    """A campaign to be judged. kind : rare, foreign, clean, follows (autocorrelated noise) or listed"""

    kind: str
    effect: str
    robot: str
    seed: int

    @property
    def name(self) -> str:
        return f"{self.kind}/{self.effect}/{self.robot}/{self.seed}"


def trials(repeats: int, seed: int = SEED) -> list[Trial]:
    """Every kind on every robot so many times; fewer of the others."""
    seeds = iter(range(seed, seed + 100_000))
    found: list[Trial] = []
    for k in range(repeats):
        found += [Trial("clean", "", ROBOTS[i % 2], next(seeds)) for i in range(16)]
        found += [Trial("follows", "", ROBOTS[i % 2], next(seeds)) for i in range(8)]
        listed = [e for e in LISTED if e != "outliers"]
        found += [Trial("listed", e, ROBOTS[(i + k) % 2], next(seeds)) for i, e in enumerate(listed)]
        found += [Trial("foreign", e, ROBOTS[(i + k) % 2], next(seeds)) for i, e in enumerate(FOREIGN)]
    order = np.random.default_rng(seed).permutation(len(found))
    return [found[k] for k in order]


def measured(plant: Plant, seed: int, hidden: Sequence[Hidden | Cause], noise_mm: float = NOISE_MM) -> pd.DataFrame:
    return campaign(plant, hidden, POSES, seed, noise_mm=noise_mm, repeatability_urad=8.0, approach="motion")


def judged(trial: Trial) -> dict[str, Any]:
    """The figures of one trial."""
    follows = trial.kind == "follows" or trial.seed >= SEED_FOLLOWS
    rng = np.random.default_rng([trial.seed, 7])
    robot, nominal = machine(trial.robot)
    plant = perturb(nominal, trial.seed)
    out: dict[str, Any] = {"name": trial.name, "kind": trial.kind, "effect": trial.effect}
    hidden: list[Hidden | Cause] = []
    if trial.kind == "listed":
        hidden = [draw_effect(plant, trial.effect, rng, POSES)]
    if trial.effect in TRUTH:
        clean = measured(plant, trial.seed, ())
        J = base_jacobian(robot, from_table(clean, 6))
        one = draw_foreign(trial.effect, trial.seed, plant)
        wanted = float(rng.uniform(*SIGNALS))
        shift = 1e-3 * (measured(plant, trial.seed, [acting(one, plant)]) - clean)[["x_mm", "y_mm", "z_mm"]].to_numpy()
        scale = wanted * 1e-3 * NOISE_MM / unabsorbed_rms(J, shift)
        hidden = [acting(draw_foreign(trial.effect, trial.seed, plant, scale=scale), plant)]
        out |= {"signal": round(wanted, 3), "joint": getattr(one, "joint", getattr(one, "link", 0)), "scale": scale}
    noise = NOISE_MM * following(rng) if follows else 0.0

    def read(effects: Sequence[Hidden | Cause]) -> Measurements:
        table = measured(plant, trial.seed, effects, 0.005 if follows else NOISE_MM)
        table[["x_mm", "y_mm", "z_mm"]] += noise
        return from_table(table, 6)

    m = read(hidden)
    begun = time.process_time()
    diagnosis = diagnose(robot, m)
    middle = time.process_time()
    found = laws_of_diagnosis(diagnosis)
    out |= {"diagnosis_s": round(middle - begun, 2), "laws_s": round(time.process_time() - middle, 2)}
    out |= _said(found)
    if trial.effect in TRUTH:
        base = diagnose(robot, read(()), ("backlash@1",))
        none = np.zeros(0, dtype=np.int64)
        out["floor"] = float(held_out(base.case, none, (), base.rankings[0].noise[""], 0).mean())
    return out


def following(rng: np.random.Generator) -> np.ndarray:
    """Autocorrelated noise of size one, shape (POSES, 3)."""
    noise = rng.normal(size=(POSES, 3))
    for k in range(1, POSES):
        noise[k] = STAYS * noise[k - 1] + np.sqrt(1 - STAYS**2) * noise[k]
    return noise


def _said(found: Discovery) -> dict[str, Any]:
    first = found.rounds[0]
    s = found.laws[0] if found.laws else first.best
    return {
        "claimed": len(found.laws),
        "lines": found.lines,
        "best": s.law.formula,
        "place": s.law.place,
        "driver": s.tried.driver.text,
        "family": s.tried.driver.family,
        "score": round(first.best.score, 2),
        "listed": [first.listed[0], round(first.listed[1], 2)],
        "smooth": [first.smooth[0], round(first.smooth[1], 2)],
        "alias": list(first.alias),
        "gap": {name: float(v) for name, v in found.gap.items()},
        "kept": found.best_model,
        "verdict": found.diagnosis.verdict,
        "causes": [c.label for c in found.diagnosis.causes],
    }


def _right(out: dict[str, Any]) -> bool:
    """Whether the law's place and driver are those of the effect; an own angle must be the joint's own."""
    places, families, _ = TRUTH[out["effect"]]
    joint = out["joint"]
    if out["place"] not in [p.format(joint, joint - 1) for p in places] or out["family"] not in families:
        return False
    beside = joint + 1 if joint < 6 else joint - 1
    drivers = {"hose_winds": ["q4", "q5"]}
    if out["family"] == "angle":
        return out["driver"] in drivers.get(out["effect"], [f"q{joint}"])
    if out["effect"] in ("wrong_table", "hose_winds"):
        return True
    return out["family"] != "angles" or out["driver"] in (f"q{joint} + q{beside}", f"q{beside} + q{joint}")


def share(row: dict[str, Any], model: str) -> float:
    """How much of the possible shrink a model reaches, held out."""
    gap = row["gap"]
    return float((gap["base"] - gap[model]) / max(gap["base"] - row["floor"], 1e-9))


def report(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """The table of the study."""
    rows = [r | ({"right": _right(r)} if r["effect"] in TRUTH else {}) for r in rows]
    rare = [r for r in rows if r["effect"] in TRUTH]
    groups = {
        "form in the grammar": [r for r in rare if TRUTH[r["effect"]][2]],
        "form outside of it": [r for r in rare if not TRUTH[r["effect"]][2]],
        "all": rare,
    }
    for title, some in groups.items():
        if not some:
            continue
        claimed = [r for r in some if r["claimed"]]
        right = sum(r["right"] for r in claimed)
        yield f"on no list, {title}: {len(some)} campaigns, signal {SIGNALS[0]} to {SIGNALS[1]}"
        yield f"  laws claimed {len(claimed)}, of these right in place and driver {right}"
        yield f"  best law right, claimed or not: {sum(r['right'] for r in some)}"
        named = [r for r in some if r["verdict"] == "explained" and set(r["causes"]) - {"outliers"}]
        beside = sum(not r["claimed"] for r in named)
        yield f"  claimed as a listed cause: {len(named)}, without a law that would take its place {beside}"
        for model in ("kept", "law", "smooth", "causes"):
            models = [(r, r["kept"] if model == "kept" else model) for r in some]
            shares = [share(r, name) for r, name in models if name in r["gap"]]
            if shares:
                yield f"  share of the possible shrink, {model}: median {np.median(shares):.2f} of {len(shares)}"
        lost = sum(1 for r in claimed if "smooth" in r["gap"] and r["gap"]["smooth"] < r["gap"]["law"])
        yield f"  claimed laws that the smooth forms predict better than: {lost}"
    others = {"clean": "nothing", "follows": "autocorrelated noise", "listed": "one listed effect"}
    for kind, words in others.items():
        some = [r for r in rows if r["kind"] == kind]
        yield f"{words}: {sum(bool(r['claimed']) for r in some)} of {len(some)} with a law claimed"
    if rows:
        times = [(r["diagnosis_s"], r["laws_s"]) for r in rows]
        both = np.median(times, axis=0)
        yield f"processor time, {POSES} poses, medians: diagnosis {both[0]:.1f} s, search for laws {both[1]:.1f} s"
    yield ""
    for r in sorted(rows, key=lambda r: r["name"]):
        mark = "right" if r.get("right") and r["claimed"] else "WRONG" if r["claimed"] else "-"
        rivals = f"listed {r['listed'][1]:.1f}, smooth {r['smooth'][1]:.1f}"
        said = "; ".join(r["lines"]) or f"({r['place']} by {r['driver']}, {r['score']:.1f} nats, {rivals})"
        yield f"{mark:6} {r['name']:44} {said}"


def tried(trial: Trial) -> dict[str, Any]:
    """The row of a campaign, or why there is none."""
    try:
        return judged(trial)
    except CasadicalError as error:
        return {"failed": str(error)}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--part", default="1/1")
    parser.add_argument("--only", default="")
    parser.add_argument("--follows", action="store_true")
    add_options(parser, "laws")
    given = parser.parse_args()
    part, parts = map(int, given.part.split("/"))
    every = trials(given.repeats, SEED_FOLLOWS if given.follows else SEED)
    chosen = every[part - 1 :: parts]
    found = rows_of([(t.name, t) for t in chosen if given.only in t.kind], tried, given)
    rows = [row for row in found if "failed" not in row]
    print(f"{len(rows)} of the {len(every)} campaigns, in an order drawn before")
    print("\n".join(report(rows)))


if __name__ == "__main__":
    main()
