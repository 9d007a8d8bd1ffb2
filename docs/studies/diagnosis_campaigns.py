"""Diagnose campaigns of the independent simulator and score: python docs/studies/diagnosis_campaigns.py

240 campaigns by default (about ten minutes on two cores): three robots, 25 % without any effect, 45 % with one, 15 %
with two, 15 % with one that is on no list. Effects, sizes and joints are drawn by casadical.simulation, whose physics
shares no formula with the candidates; joint repeatability and instrument noise are always there. The same campaign made
without the effect tells how far the gap can shrink. Synthetic data throughout.
"""

import argparse
import json
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from casadical import diagnose, from_table
from casadical.problem import read_campaign_robot
from casadical.simulation import Disturbance, Plant, campaign, draw_disturbance, perturb
from casadical.simulation.disturbances import LISTED, UNLISTED

ROOT = Path(__file__).parents[2]
ROBOTS = ("hh800", "kr210", "ur10e")
SHARES = {"none": 0.25, "one": 0.45, "two": 0.15, "unlisted": 0.15}


@dataclass(frozen=True)
class Trial:
    """What was hidden and what was answered; lengths in mm."""

    kind: str
    truth: tuple[str, ...]
    visible: float  # rms of a coordinate that the base model cannot absorb, over the instrument's noise
    verdict: str
    claims: tuple[str, ...]
    posterior: float  # probability given to the first true cause
    alike: tuple[str, ...]
    predicted_shrink: float
    true_shrink: float


def drawn(effect: str, rng: np.random.Generator) -> Disturbance:
    """An effect by chance, at any joint that can have it."""
    names = {f.name for f in fields((LISTED | UNLISTED)[effect])}
    joint = int(rng.integers(2 if "source" in names else 1, 7)) if "joint" in names else None
    return draw_disturbance(
        effect, int(rng.integers(1 << 30)), joint=joint, scale=float(rng.choice([0.7, 1.0, 1.5, 2.5]))
    )


def label(effect: str, disturbance: object) -> str:
    joint = 2 if effect == "gravity_compensator" else getattr(disturbance, "joint", None)
    return effect if joint is None else f"{effect}@{joint}"


def trial(task: tuple[int, int]) -> Trial:
    number, poses = task
    rng = np.random.default_rng([2026, number])
    name = ROBOTS[number % 3]
    robot = read_campaign_robot(ROOT / "problems" / name)
    nominal = Plant.from_dict(json.loads((ROOT / "data" / "campaigns" / "robots" / f"{name}.json").read_text()))
    plant = perturb(nominal, int(rng.integers(1 << 30)))
    kind = str(rng.choice(list(SHARES), p=list(SHARES.values())))
    words = {"none": 0, "one": 1, "two": 2}.get(kind)
    pool = list(UNLISTED) if words is None else list(LISTED)
    chosen = [str(w) for w in rng.choice(pool, 1 if words is None else words, replace=False)]
    hidden = [drawn(w, rng) for w in chosen]
    circumstances = {
        "noise_mm": float(rng.choice([0.01, 0.02, 0.03])),
        "repeatability_urad": float(rng.uniform(2, 8)),
        "seed": int(rng.integers(1 << 30)),
    }
    tables = [campaign(plant, poses, disturbances=d, **circumstances) for d in (hidden, [])]
    measured, clean = (from_table(t, 6, "position") for t in tables)
    found, floor = diagnose(robot, measured), diagnose(robot, clean, effects=())
    truth = tuple(label(w, d) for w, d in zip(chosen, hidden, strict=True)) if kind in ("one", "two") else ()
    shift = measured.position - clean.position
    first = found.rankings[0].probability
    return Trial(
        kind=kind,
        truth=truth,
        visible=visible(floor.case.whole.J, shift) / (1e-3 * circumstances["noise_mm"]),
        verdict=found.verdict,
        claims=tuple(c.label for c in found.causes),
        posterior=1.0
        if truth and truth[0] == "outliers" and found.outliers
        else first.get(truth[0], 0.0)
        if truth
        else 0.0,
        alike=found.causes[0].indistinguishable if found.causes else (),
        predicted_shrink=1 - found.gap.after / found.gap.before,
        true_shrink=1 - floor.gap.before / found.gap.before,
    )


def visible(J: np.ndarray, shift: np.ndarray) -> float:
    """Root mean square of a shift, shape (n, 3), orthogonal to the base model's columns, shape (n, 3, P)."""
    A = J.reshape(shift.size, -1)
    Q, _ = np.linalg.qr(A / np.maximum(np.linalg.norm(A, axis=0), 1e-12))
    left = shift.ravel() - Q @ (Q.T @ shift.ravel())
    return float(np.sqrt(np.mean(left**2)))


def share(hits: list[bool]) -> str:
    """A share with its 95 % Wilson interval."""
    n = len(hits)
    if n == 0:
        return "-"
    p, z = float(np.mean(hits)), 1.96
    centre, half = (p + z * z / (2 * n)), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    low, high = ((centre + s * half) / (1 + z * z / n) for s in (-1, 1))
    return f"{p:.3f}  ({low:.3f} .. {high:.3f}; {sum(hits)} of {n})"


def score(trials: list[Trial]) -> list[tuple[str, str, str]]:
    """Rows of figure, value, target."""
    none = [t for t in trials if t.kind == "none"]
    one = [t for t in trials if t.kind == "one"]
    off = [t for t in trials if t.kind == "unlisted"]
    two = [t for t in trials if t.kind == "two"]
    claimed = [t for t in one if t.verdict == "explained"]
    spoken = [t for t in one if t.claims]
    strong, weak = ([t for t in one if low <= t.visible < high] for low, high in ((0.5, np.inf), (0.35, 0.5)))
    seen = [t for t in one if t.visible >= 0.35]
    errors = np.abs([t.predicted_shrink - t.true_shrink for t in one + two if t.claims])
    named = [c for t in two for c in t.claims]
    right = [c for t in two for c in t.claims if c in t.truth]
    hidden = [c for t in two if t.visible >= 0.35 for c in t.truth]
    caught = [c for t in two if t.visible >= 0.35 for c in t.truth if c in t.claims]
    return [
        ("false alarms where there is nothing", share([t.verdict != "none" for t in none]), "at most .01"),
        ("detection, visible rms/noise >= .5", share([t.verdict != "none" for t in strong]), ".99"),
        ("detection, visible rms/noise .35 to .5", share([t.verdict != "none" for t in weak]), ".90"),
        (
            "FIA: mean probability of the true cause, visible >= .35",
            f"{np.mean([t.posterior for t in seen]):.3f}",
            ".92",
        ),
        ("single causes: claims right", share([t.claims[0] == t.truth[0] for t in claimed]), ".98"),
        ("single causes: claims made, visible >= .35", share([t.verdict == "explained" for t in seen]), ".65"),
        ("sets contain the truth", share([t.truth[0] in (t.claims[0], *t.alike) for t in spoken]), ".93 - .97"),
        ("on no list, claimed as listed", share([t.verdict == "explained" for t in off]), "at most .02"),
        (
            "|predicted - true shrink|, median / 90th percentile",
            f"{np.median(errors):.3f} / {np.quantile(errors, 0.9):.3f}",
            ".04 / .12",
        ),
        ("two at once: recall, visible >= .35 together", share([c in caught for c in hidden]), ".93"),
        ("two at once: precision", share([c in right for c in named]), ".90"),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=240)
    parser.add_argument("--poses", type=int, default=100)
    options = parser.parse_args()
    with ProcessPoolExecutor(2) as pool:
        trials = list(pool.map(trial, [(k, options.poses) for k in range(options.campaigns)]))
    print(f"{len(trials)} synthetic campaigns of {options.poses} poses: value (95 % interval), target\n")
    for figure, value, target in score(trials):
        print(f"{figure:<56} {value:<40} {target}")
    print("\nWrong claims, and what was hidden:")
    for t in trials:
        wrong = [c for c in t.claims if c not in t.truth]
        if t.verdict == "explained" and wrong:
            print(
                f"  {t.kind:<9} {', '.join(t.truth) or '-':<42} claimed {', '.join(wrong)}  (visible {t.visible:.2f})"
            )


if __name__ == "__main__":
    main()
