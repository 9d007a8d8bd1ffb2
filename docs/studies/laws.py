"""python docs/studies/laws.py [--keep FILE.jsonl] [--repeats 2] [--seed 103000] [--part K/N] [--table]

Whether forms that are claimed are right, and drivers that are described: synthetic campaigns of two robots with an
effect that is on no list, without any effect, with autocorrelated noise, and with one listed effect. The effects
(foreign_effects.py, 16 kinds) are by an author who has read neither the diagnosis nor its effects; the grammar holds
the form of two of them. What counts as right (TRUTH) and the rule of a claim were committed before the campaigns that
are printed were judged.

--keep : results are added to this file, and campaigns that are in it are not judged again
--repeats : campaigns of each kind; --seed : first seed, fresh by default
--part : the K-th of N parts of the campaigns; --table : print the table of what is kept, and judge nothing
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from acting import acting
from campaign_robots import machine
from foreign_effects import FOREIGN, draw_foreign
from kept import add_options, rows_of

from casadical.blind_check.mujoco_physics import LISTED, Hidden, campaign, draw_effect, perturb
from casadical.blind_check.mujoco_physics.cause import Cause
from casadical.core.basics import CasadicalError
from casadical.diagnosis.diagnose import diagnose
from casadical.diagnosis.laws.discovery import Discovery, laws_of_diagnosis
from casadical.diagnosis.linearisation import base_jacobian, unabsorbed_rms
from casadical.measurements.reading import from_table

ROBOTS, POSES, NOISE_MM, SIGNALS = ("kr210", "ur10e"), 100, 0.02, (0.8, 2.5)
# Coefficient of autocorrelated noise of the campaigns that have it.
AR_COEFFICIENT = 0.8
# Kind -> (places, families of state variables, joints of these, whether the grammar holds the form). N is the effect's
# joint or link; {0} is N, {1} the one before it, joints are differences from N, or numbers for an effect without N.
OWN, MOVED = ("joint {0}", "tilt of link {0}"), ("last motion", "motion history")
TILT = ("tilt of link {0}", "tilt of link {1}")
TRUTH: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[int, ...], bool]] = {
    "gear_lag": (OWN, ("load", "load history", "motion history"), (0,), False),
    "short_move_stick": (OWN, MOVED, (0,), False),
    "wrong_table": (OWN, ("angle", "angles"), (0,), False),
    "uneven_planets": (OWN, ("angle and load",), (0,), True),
    "warm_balancer": (("joint 2", "tilt of link 2"), ("angle, in time and temperature,",), (2,), False),
    "hose_winds": (("joint 5", "tilt of link 5"), ("angle", "angles"), (4, 5), False),
    "bearing_clearance": (TILT, ("load", "moment"), (-1, 0, 1), False),
    "raceway_dent": (TILT, ("angle",), (0,), True),
    "creeping_glue": (TILT, ("load", "moment"), (0, 1), False),
    "churned_grease": (("shift of link {0}", "shift of link {1}"), MOVED, (0,), False),
    "loose_anchor": (("base tilt", "tilt of link 1"), ("load", "moment"), (0, 1, 2), False),
    "neighbour_press": (("base tilt", "base shift"), ("time",), (), False),
    "slipping_part": (("tool shift",), (*MOVED, "time"), (0,), False),
    "sloshing_tank": (("payload", "tilt of link 6"), ("gravity in the tool", "payload"), (), False),
    "cyclic_range": ((), ("place of the flange",), (), False),
    "glass_corner": (("tool shift",), ("gravity in the tool", "place of the flange"), (), False),
}
FIXED = ("warm_balancer", "hose_winds", "loose_anchor")  # effects without N


@dataclass(frozen=True)
class Trial:
    """A campaign to be judged. kind : foreign, clean, follows (autocorrelated noise) or listed"""

    kind: str
    effect: str
    robot: str
    seed: int

    @property
    def name(self) -> str:
        return f"{self.kind}/{self.effect}/{self.robot}/{self.seed}"


def trials(repeats: int, seed: int) -> list[Trial]:
    """Every kind so many times, the robots in turn."""
    kinds = [("clean", "")] * 4 + [("follows", "")] * 2 + [("listed", e) for e in [*LISTED][seed % 2 :: 2]]
    kinds += [("foreign", e) for e in FOREIGN]
    found = [
        Trial(kind, effect, ROBOTS[(i + k) % 2], seed + k * len(kinds) + i)
        for k in range(repeats)
        for i, (kind, effect) in enumerate(kinds)
    ]
    order = np.random.default_rng(seed).permutation(len(found))
    return [found[k] for k in order]


def judged(trial: Trial) -> dict[str, Any]:
    """The figures of one trial."""
    rng = np.random.default_rng([trial.seed, 7])
    robot, nominal = machine(trial.robot)
    plant = perturb(nominal, trial.seed)
    follows = trial.kind == "follows"

    def measured(hidden: Sequence[Hidden | Cause]) -> pd.DataFrame:
        noise_mm = 0.005 if follows else NOISE_MM
        table = campaign(plant, hidden, POSES, trial.seed, noise_mm=noise_mm, repeatability_urad=8.0, approach="motion")
        table[["x_mm", "y_mm", "z_mm"]] += NOISE_MM * following(rng) if follows else 0.0
        return table

    out: dict[str, Any] = {"name": trial.name, "kind": trial.kind, "effect": trial.effect}
    hidden: list[Hidden | Cause] = [draw_effect(plant, trial.effect, rng, POSES)] if trial.kind == "listed" else []
    if trial.effect in TRUTH:
        clean = measured(())
        J, one = base_jacobian(robot, from_table(clean, 6)), draw_foreign(trial.effect, trial.seed, plant)
        wanted = float(rng.uniform(*SIGNALS))
        shift = 1e-3 * (measured([acting(one, plant)]) - clean)[["x_mm", "y_mm", "z_mm"]].to_numpy()
        scale = wanted * 1e-3 * NOISE_MM / unabsorbed_rms(J, shift)
        hidden = [acting(draw_foreign(trial.effect, trial.seed, plant, scale=scale), plant)]
        out |= {"signal": round(wanted, 3), "joint": getattr(one, "joint", getattr(one, "link", 0))}
    table = measured(hidden)
    found = laws_of_diagnosis(diagnose(robot, from_table(table, 6)))
    return out | _said(found)


def following(rng: np.random.Generator) -> np.ndarray:
    """Autocorrelated noise of size one, shape (POSES, 3)."""
    noise = rng.normal(size=(POSES, 3))
    for k in range(1, POSES):
        noise[k] = AR_COEFFICIENT * noise[k - 1] + np.sqrt(1 - AR_COEFFICIENT**2) * noise[k]
    return noise


def _said(found: Discovery) -> dict[str, Any]:
    last = found.rounds[-1]
    s = found.laws[0] if found.laws else found.description or last.best
    return {
        "claimed": found.lines,
        "described": found.described,
        "place": s.law.place,
        "family": s.variable.family,
        "joints": s.variable.joints,
        "probability": round(last.drivers.get(s.variable, 0.0), 3),
    }


def right_driver(out: dict[str, Any]) -> bool:
    """Whether the law's state variable is that of the effect, at the right joint."""
    _, families, joints, _ = TRUTH[out["effect"]]
    first = 0 if out["effect"] in FIXED else out["joint"]
    ours = set(out["joints"]) & {j + first for j in joints}
    return out["family"] in families and (not joints or not out["joints"] or bool(ours))


def right_place(out: dict[str, Any]) -> bool:
    """Whether the law's place is that of the effect."""
    return out["place"] in [p.format(out["joint"], out["joint"] - 1) for p in TRUTH[out["effect"]][0]]


def report(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """The table of the study."""
    foreign = [r for r in rows if r["kind"] == "foreign"]
    groups = {
        "form in the grammar": [r for r in foreign if TRUTH[r["effect"]][3]],
        "form outside of it": [r for r in foreign if not TRUTH[r["effect"]][3]],
    }
    for title, some in groups.items():
        claimed, said = [r for r in some if r["claimed"]], [r for r in some if r["described"]]
        right = sum(right_driver(r) and right_place(r) for r in claimed)
        yield f"on no list, {title}: {len(some)} campaigns, signal {SIGNALS[0]} to {SIGNALS[1]}"
        yield f"  forms claimed {len(claimed)}, of these right in place and driver {right}"
        yield f"  described by a driver {len(said)}: right {sum(map(right_driver, said))}"
    for kind, words in {"clean": "nothing", "follows": "autocorrelated noise", "listed": "one listed effect"}.items():
        some = [r for r in rows if r["kind"] == kind]
        claimed, said = sum(bool(r["claimed"]) for r in some), sum(bool(r["described"]) for r in some)
        yield f"{words}: {claimed} of {len(some)} with a form claimed, {said} described"
    yield ""
    for r in sorted(rows, key=lambda r: r["name"]):
        there = r["kind"] == "foreign"
        good = there and right_driver(r) and (right_place(r) or not r["claimed"])
        mark = ("right" if good else "WRONG") if r["claimed"] or (there and r["described"]) else "-"
        unsaid = f"({r['place']} by {r['family']} {r['joints']}, {r['probability']})"
        yield f"{mark:6} {r['name']:40} {'; '.join(r['claimed']) or r['described'] or unsaid}"


def tried(trial: Trial) -> dict[str, Any]:
    """The row of a campaign, or why there is none."""
    try:
        return judged(trial)
    except CasadicalError as error:
        return {"failed": str(error)}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--seed", type=int, default=103_000)
    parser.add_argument("--part", default="1/1")
    add_options(parser, "laws")
    given = parser.parse_args()
    part, parts = map(int, given.part.split("/"))
    every = trials(given.repeats, given.seed)
    chosen = every[part - 1 :: parts]
    found = rows_of([(t.name, t) for t in chosen], tried, given)
    rows = [row for row in found if "failed" not in row]
    print(f"{len(rows)} of the {len(every)} campaigns, in an order drawn before")
    print("\n".join(report(rows)))


if __name__ == "__main__":
    main()
