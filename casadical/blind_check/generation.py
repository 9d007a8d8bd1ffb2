"""Generation of a blind check: public campaigns, and in another folder the key.

Planned campaigns are measured in simulated sessions, with and without their hidden effects.
The hash of the key is published with the campaigns.
"""

import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from casadical.blind_check import protocol
from casadical.blind_check.mujoco_physics import LISTED, UNLISTED, Hidden, Plant, campaign, draw_effect, perturb
from casadical.blind_check.mujoco_physics.campaigns import MEASURED_COLUMNS, readings_of
from casadical.blind_check.mujoco_physics.hidden import SECONDS_A_POSE
from casadical.blind_check.mujoco_physics.stops import Warmup
from casadical.blind_check.prediction import nominal
from casadical.blind_check.protocol import Kind
from casadical.blind_check.worker_pool import completed, workers
from casadical.core.basics import ConvergenceError, InputError
from casadical.core.files import claimed, write_together
from casadical.core.reading import load_json
from casadical.diagnosis.linearisation import base_jacobian, unabsorbed_rms
from casadical.measurements.reading import from_table
from casadical.project.problem import read_campaign_robot
from casadical.robot.robot_file import to_toml

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
    base_shift, base_turn, mass_spread : building errors of the simulated robot, as of `perturb`
    reflector : whether its reflector is displaced
    level : whether gravity is given in the measuring frame, not in the base frame
    poses : poses to measure, in their order, as columns of a campaign: readings, and those of
        time_s, temperature_degC, payload_kg, approach1 .. that are not to be simulated; None: poses
        are drawn within the joint ranges
    """

    nominal: Plant
    model: str
    base_shift: bool = True
    base_turn: bool = True
    reflector: bool = True
    mass_spread: float = 0.0
    level: bool = True
    poses: pd.DataFrame | None = None

    def built(self, seed: int) -> Plant:
        """Return the robot as built, with building errors drawn from a seed.

        Unless `level` is set, gravity stays the same in the base frame while the base tilts.
        """
        plant = perturb(
            self.nominal,
            seed,
            tool_mm=1.0 if self.reflector else 0.0,
            base_shift=self.base_shift,
            base_turn=self.base_turn,
            mass_spread=self.mass_spread,
        )
        if self.level:
            return plant
        before, now = self.nominal.base[:3, :3], plant.base[:3, :3]
        return replace(plant, gravity=now @ before.T @ plant.gravity)


# Hidden effects of a session, its table, that without effects, and those of single effects.
Record = tuple[tuple[Hidden, ...], pd.DataFrame, pd.DataFrame, list[pd.DataFrame]]


def record(subject: Subject, plan: Plan) -> Record:
    """Return a plan's hidden effects and its simulated sessions, of the same seed, poses and noise.

    The sessions are tables with the columns of a campaign; those of single effects are left out
    where there are not several.
    """
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

    single = [session(each) for each in hidden] if len(hidden) > 1 else []
    return hidden, session(*hidden), session(), single


# Smallest number of measured poses of a campaign; with fewer a robot is hardly identified.
MIN_POSES = 20


def make(
    folder: str | Path,
    key: str | Path,
    n: int,
    seed: int | None = None,
    *,
    poses: Sequence[int] = POSE_COUNTS,
    project: str | Path = ".",
    executor: Executor | None = None,
    show: Callable[[str, int, int], None] = lambda _text, _done, _all: None,
    also: Callable[[protocol.Manifest], Mapping[Path, str]] = lambda _: {},
) -> protocol.Manifest:
    """Write n campaigns to a folder and their key to another, and return the manifest.

    The manifest contains the hash of the key.

    folder, key : new folders of the campaigns and of the key; n : number of campaigns, at least 4
    seed : seed of everything drawn, which the key contains; None: a random one, which a real test
        needs
    poses : possible numbers of poses of a campaign, each at least `MIN_POSES`
    project : folder with problems/ and data/
    executor : executor of `concurrent.futures`; None: a process for each core
    show : called with a campaign's name, the number of campaigns done, and that of all
    also : function that returns texts of additional files by path, which are written together with
        the campaigns
    Raises InputError for too few campaigns or poses, a check that is there already, a key within
    the campaigns' folder, or a missing robot.
    """
    folder, key_folder = Path(folder), Path(key)
    if n < 4:
        raise InputError(f"n is {n}; a blind check needs at least 4 campaigns, one of each kind")
    if not poses or min(poses) < MIN_POSES:
        raise InputError(f"poses of {list(poses)}; a campaign needs at least {MIN_POSES}, or no robot is identified")
    if key_folder.resolve() == folder.resolve() or folder.resolve() in key_folder.resolve().parents:
        raise InputError(f"{key}: the key must lie apart from the campaigns in {folder}; name another folder")
    for path in (folder / protocol.MANIFEST_FILE, key_folder / protocol.KEY_FILE):
        if path.exists():
            raise InputError(f"{path}: is there already; name a new folder, or delete that check first")
    seed = secrets.randbits(62) if seed is None else seed
    versions = {"casadical": version("casadical"), **engine_versions()}
    todo = draw_plans(n, seed, (tuple(LISTED), tuple(UNLISTED)), poses)
    subjects: dict[str, Subject] = {}
    for name in sorted({p.robot for p in todo}):
        path = Path(project) / "data" / "campaigns" / "robots" / f"{name}.json"
        if not path.is_file():
            raise InputError(
                f"{path}: no such robot; name the project's folder (with problems/ and data/) by --project"
            )
        model = to_toml(read_campaign_robot(Path(project) / "problems" / name))
        subjects[name] = Subject(Plant.from_dict(load_json(path)), model)
    made: dict[str, tuple[str, protocol.Secret]] = {}
    with workers(executor) as pool:
        tasks = [(subjects[p.robot], p) for p in todo]
        for done, (name, table, secret) in enumerate(completed(pool, campaign_of, tasks), 1):
            made[name] = table, secret
            show(name, done, len(todo))
    inside = protocol.Key(
        salt=protocol.sha256(f"casadical withheld {seed}".encode()),
        seed=seed,
        reality="mujoco",
        versions=versions,
        campaigns={p.name: made[p.name][1] for p in todo},
    )
    manifest = protocol.Manifest(
        key_sha256=protocol.sha256(inside.text().encode()),
        campaigns={p.name: {"robot": p.robot} for p in todo},
    )
    # The key is written first, because campaigns without a key would be useless.
    texts = {key_folder / protocol.KEY_FILE: inside.text()}
    texts |= {
        folder / protocol.ROBOTS_FOLDER / f"{name}.robot.toml": subject.model for name, subject in subjects.items()
    }
    texts |= {folder / f"{name}.csv": table for name, (table, _) in made.items()}
    texts |= {folder / protocol.MANIFEST_FILE: manifest.model_dump_json(indent=1) + "\n"}
    with claimed([folder, key_folder]):
        write_together({**texts, **also(manifest)})
    return manifest


def engine_versions() -> dict[str, str]:
    """Return the versions of mujoco and numpy, on which campaigns depend, by name.

    Raises InputError if one is not installed.
    """
    try:
        return {name: version(name) for name in ("mujoco", "numpy")}
    except PackageNotFoundError as error:
        raise InputError(f"the engine {error.name} is not installed: pip install 'casadical[withheld]'") from None


def campaign_of(subject: Subject, plan: Plan) -> tuple[str, str, protocol.Secret]:
    """Return a plan's simulated campaign: its name, its table as CSV text, and what it hides.

    Columns that are not logged are omitted. This runs in a worker process.

    Raises ConvergenceError: no equilibrium in six attempts with different draws.
    """
    # If a session finds no equilibrium, everything but the plan is drawn again, up to five times.
    for retry in range(6):
        plan = replace(plan, seed=plan.seed + min(retry, 1))
        try:
            hidden, recorded, clean, single = record(subject, plan)
            break
        except ConvergenceError:
            if retry == 5:
                raise
    prefixes = tuple(COLUMN_PREFIXES[word] for word in plan.not_logged)
    struck = [c for c in recorded if str(c).startswith(prefixes)]
    text = recorded.drop(columns=struck).to_csv(index=False)
    robot = nominal(subject.model)
    J = base_jacobian(robot, from_table(clean, [j.kind for j in robot.joints], "position"))

    def seen(table: pd.DataFrame) -> float:
        """Return the visible size [m] of the effects in a table; see `unabsorbed_rms`."""
        shift = table[MEASURED_COLUMNS].to_numpy(float) - clean[MEASURED_COLUMNS].to_numpy(float)
        return round(unabsorbed_rms(J, 1e-3 * shift), 9)

    together = seen(recorded)
    alone = [seen(t) for t in single] or [together] * len(hidden)
    secret = protocol.Secret(
        robot=plan.robot,
        kind=plan.kind,
        hidden=tuple(
            protocol.HiddenEffect(effect=a.effect, joint=a.joint, about=a.about, visible=v)
            for a, v in zip(hidden, alone, strict=True)
        ),
        poses=plan.poses,
        missing=plan.missing,
        noise=plan.noise,
        repeatability=plan.repeatability,
        visible=together,
    )
    return plan.name, text, secret
