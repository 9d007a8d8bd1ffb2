"""Simulated measuring sessions of planned campaigns, with hidden effects."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from casadical.blind_check.mujoco_physics import Hidden, Plant, campaign, draw_effect, perturb
from casadical.blind_check.mujoco_physics.campaigns import readings_of
from casadical.blind_check.mujoco_physics.hidden import SECONDS_A_POSE
from casadical.blind_check.mujoco_physics.plant import Building
from casadical.blind_check.mujoco_physics.stops import Warmup
from casadical.blind_check.protocol import Kind

# Default numbers of measured poses that a campaign may have.
POSE_COUNTS = (40, 100, 200)
# Prefix of the names of the columns of each quantity that may not be logged in a campaign.
COLUMN_PREFIXES = {"temperature": "temperature_degC", "payload": "payload_kg", "approach": "approach", "time": "time_s"}

Thing = TypeVar("Thing")


@dataclass(frozen=True)
class Plan:
    """One campaign before it is measured.

    name : name of the campaign
    robot : name of the robot
    kind : number of hidden effects (none, one, several), or "unlisted"
    effects : names of the hidden effects
    poses : number of measured poses
    missing : quantities that are not logged, separated by commas; None: all are logged
    noise : standard deviation of a measured coordinate [m]
    repeatability : standard deviation of a joint about its reading [rad]
    seed : seed of everything else that is drawn
    """

    name: str
    robot: str
    kind: Kind
    effects: tuple[str, ...]
    poses: int
    missing: str | None
    noise: float
    repeatability: float
    seed: int

    @property
    def not_logged(self) -> tuple[str, ...]:
        """Return the quantities that are not logged, such as "temperature"; see `COLUMN_PREFIXES`."""
        return tuple(self.missing.split(",")) if self.missing else ()


def draw_plans(
    n: int,
    seed: int,
    words: tuple[Sequence[str], Sequence[str]],
    poses: Sequence[int] = POSE_COUNTS,
    *,
    robots: Sequence[str] = ("hh800", "kr210", "ur10e"),
    noise_levels: Sequence[float] = (10e-6, 20e-6, 30e-6),
    struck: float = 1 / 3,
) -> list[Plan]:
    """Return the plans of n campaigns in random order, with fixed proportions of their kinds.

    Robots, numbers of poses, effects and missing columns take turns; "several" are two or three.

    seed : seed of everything drawn
    words : names of the effects that are on the diagnosis' list, and of those on none
    poses : possible numbers of measured poses of a campaign
    robots : names of possible robots
    noise_levels : possible standard deviations of a measured coordinate [m]
    struck : fraction of campaigns in which a quantity is not logged, 0 to 1
    """
    rng = np.random.default_rng([seed, 1])
    shares: dict[Kind, float] = {"none": 0.25, "one": 0.45, "several": 0.15, "unlisted": 0.15}
    kinds = shuffled(rng, in_shares(n, shares))
    lacking = shuffled(rng, in_shares(n, {True: struck, False: 1 - struck}))
    names, sizes, columns = turns(rng, robots), turns(rng, poses), turns(rng, tuple(COLUMN_PREFIXES))
    listed, foreign = (turns(rng, pool) for pool in words)
    plans = []
    for k, kind in enumerate(kinds):
        count = {"none": 0, "one": 1, "unlisted": 1}.get(kind) if kind != "several" else int(rng.integers(2, 4))
        pool, names_of = (foreign, words[1]) if kind == "unlisted" else (listed, words[0])
        robot, effects = next(names), dict[str, None]()
        while len(effects) < min(count or 0, len(set(names_of))):
            effects[next(pool)] = None
        size, missing = next(sizes), next(columns) if lacking[k] else None
        noise, repeatability = float(rng.choice(noise_levels)), float(rng.uniform(2e-6, 8e-6))
        name, own_seed = f"{robot}-{k + 1:03d}", int(rng.integers(1 << 62))
        plans.append(Plan(name, robot, kind, tuple(effects), size, missing, noise, repeatability, own_seed))
    return plans


def in_shares(n: int, shares: dict[Thing, float]) -> list[Thing]:
    """Return n items in given proportions, rounded by the largest remainder method.

    shares : fraction of each item, 0 to 1; they add up to one
    """
    exact = {thing: n * share for thing, share in shares.items()}
    counts = {thing: int(count) for thing, count in exact.items()}
    for thing in sorted(exact, key=lambda t: counts[t] - exact[t])[: n - sum(counts.values())]:
        counts[thing] += 1
    return [thing for thing, count in counts.items() for _ in range(count)]


def shuffled(rng: np.random.Generator, things: Sequence[Thing]) -> list[Thing]:
    """Return the items in random order."""
    return [things[int(k)] for k in rng.permutation(len(things))]


def turns(rng: np.random.Generator, things: Sequence[Thing]) -> Iterator[Thing]:
    """Yield all items in random order, then again in another random order, endlessly."""
    while True:
        yield from shuffled(rng, things)


@dataclass(frozen=True, eq=False)
class Subject:
    """A robot whose diagnosis is checked.

    nominal : nominal robot, for the physics
    model : text of the robot file that the diagnosis is given
    building : which building errors the simulated robot has
    level : whether gravity is given in the measuring frame, not in the base frame
    poses : poses to measure, in their order, as columns of a campaign: readings, and those of
        time_s, temperature_degC, payload_kg, approach1 .. that are not to be simulated; None: poses
        are drawn within the joint ranges
    """

    nominal: Plant
    model: str
    building: Building = Building()  # noqa: RUF009  (frozen)
    level: bool = True
    poses: pd.DataFrame | None = None

    def built(self, seed: int) -> Plant:
        """Return the robot as built, with building errors drawn from a seed.

        Unless `level` is set, gravity stays the same in the base frame while the base tilts.
        """
        plant = perturb(self.nominal, seed, building=self.building)
        if self.level:
            return plant
        before, now = self.nominal.base[:3, :3], plant.base[:3, :3]
        return replace(plant, gravity=now @ before.T @ plant.gravity)


@dataclass(frozen=True, eq=False)
class Record:
    """A measuring session, and the same session with fewer effects.

    hidden : hidden effects of the session
    session : table with all effects; its columns are those of a campaign
    clean : table without any effect, with the same seed, poses and noise
    alone : table with each effect by itself, if there are several; else empty
    """

    hidden: tuple[Hidden, ...]
    session: pd.DataFrame
    clean: pd.DataFrame
    alone: tuple[pd.DataFrame, ...]


def record(subject: Subject, plan: Plan) -> Record:
    """Return the simulated session of a plan, with, without and with single ones of its effects."""
    rng = np.random.default_rng(plan.seed)
    plant = subject.built(int(rng.integers(1 << 30)))
    options: dict[str, Any] = {"approach": "motion"}
    options |= {"noise_mm": 1e3 * plan.noise, "repeatability_urad": 1e6 * plan.repeatability}
    lasting, poses = plan.poses, subject.poses
    if poses is not None:
        options |= {"q_deg": poses[readings_of(plant)].to_numpy(), "given": poses}
        if "temperature_degC" in poses:
            options["warmup"] = Warmup(start_degC=float(poses["temperature_degC"].iloc[0]))
        if "time_s" in poses:
            lasting = max(1, round(float(poses["time_s"].iloc[-1]) / SECONDS_A_POSE))
    # A payload that is not logged is constant.
    if "payload" in plan.not_logged:
        options["payload_states"] = [plant.payload_kg]
        if poses is not None:
            options["given"] = poses.drop(columns="payload_kg", errors="ignore")
    hidden = tuple(draw_effect(plant, effect, rng, lasting) for effect in plan.effects)
    seed = int(rng.integers(1 << 30))

    def session(*acting: Hidden) -> pd.DataFrame:
        """Return the table of the session with these effects alone."""
        return campaign(plant, acting, plan.poses, seed, **options)

    return Record(
        hidden=hidden,
        session=session(*hidden),
        clean=session(),
        alone=tuple(session(each) for each in hidden) if len(hidden) > 1 else (),
    )
