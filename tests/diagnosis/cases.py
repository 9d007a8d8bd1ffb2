"""Robots, campaigns and cases that the tests of this folder share."""

import json
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from bench import robot
from planted import campaign

import casadical
from casadical.blind_check.mujoco_physics import Hidden, perturb
from casadical.blind_check.mujoco_physics.cause import Cause
from casadical.diagnosis.candidates import candidates_of
from casadical.diagnosis.evidence import Evidence
from casadical.diagnosis.linear_problem import Case, make_case
from casadical.diagnosis.posterior import Ranking
from casadical.diagnosis.result import Diagnosis
from casadical.identification.identification import identify
from casadical.identification.result import Identification
from casadical.measurements.measurements import Measurements, Noise
from casadical.measurements.reading import from_table, read_measurements
from casadical.project.problem import read_problem

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "studies"))

from campaign_robots import plant_of as plant  # noqa: E402

PRACTICE = ROOT / "data" / "campaigns" / "practice"
ANSWERS = json.loads((PRACTICE / "answers.json").read_text())


@cache
def practice(name: str) -> Measurements:
    return read_measurements(PRACTICE / f"{name}.csv", 6)


def diagnose(*what: Any, **more: Any) -> Diagnosis:
    """A diagnosis without laws, unless they are asked for: most tests are of causes."""
    return casadical.diagnose(*what, **({"laws": False} | more))


@cache
def diagnosed(name: str) -> Diagnosis:
    return diagnose(robot(name.split("-")[0]), practice(name), laws=True)


def made_up(shares: dict[str, float], none: float = 1e-6) -> Ranking:
    """A ranking with these probabilities, up to a factor, and that of no further cause."""
    mass = {label: float(np.log(share)) for label, share in shares.items()}
    noise = dict.fromkeys(("", *shares), Noise(2e-5, 0.0))
    return Ranking(float(np.log(max(none, 1e-300))), {}, mass, dict.fromkeys(shares, 0), noise)


def with_none(ranking: Ranking, none: float) -> Ranking:
    """The ranking with another probability of no further cause."""
    others = float(np.logaddexp.reduce([*ranking.log_mass.values()]))
    return replace(ranking, log_none=others + float(np.log(none / (1 - none))))


@cache
def planar() -> Diagnosis:
    """The planar arm of two joints, in a tenth of a second: nothing is wrong with it."""
    problem = read_problem(ROOT / "problems" / "planar")
    return diagnose(problem.robot, [*problem.sets["identify"]], ["backlash"])


@cache
def identified(name: str) -> Identification:
    return identify(robot(name.split("-")[0]), practice(name), loss="huber", priors=True)


@cache
def case(name: str, *effects: str) -> Case:
    found = identified(name)
    return make_case(found, candidates_of(found.given, effects or ("standard",)))


def simulated(
    name: str, seed: int, *hidden: Hidden | Cause, n: int = 100, drop: tuple[str, ...] = (), noise_mm: float = 0.015
):
    """A campaign of a serial robot from the engine, as measurements; drop : columns that were not logged."""
    table = campaign(perturb(plant(robot(name)), seed), n, seed, hidden, noise_mm=noise_mm)
    return from_table(table.drop(columns=[c for c in table if c.startswith(drop)] if drop else []), 6)


def following_noise(shape: tuple[int, ...], stays: float, sigma: float, seed: int) -> np.ndarray:
    """Noise of which a share stays from each pose to the next."""
    noise = sigma * np.random.default_rng(seed).standard_normal(shape)
    for k in range(1, len(noise)):
        noise[k] = stays * noise[k - 1] + np.sqrt(1 - stays**2) * noise[k]
    return noise


def small_problem(seed: int = 0, n: int = 9) -> Evidence:
    """A few poses, five base parameters, four columns."""
    rng = np.random.default_rng(seed)
    J, Jq, E = rng.normal(size=(n, 3, 5)), rng.normal(size=(n, 3, 2)), 4e-5 * rng.normal(size=(n, 3, 4))
    delta0, prior = 1e-5 * rng.normal(size=5), np.array([1e-3, 3e-5, 1e-4, 1e-2, 2e-5])
    r = J @ (delta0 + 1e-5 * rng.normal(size=5)) + E @ [1.0, 0, -0.5, 0] + 2e-5 * rng.normal(size=(n, 3))
    return Evidence(r, J, delta0, prior, E, Jq=Jq)
