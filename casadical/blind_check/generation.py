"""Generation of a blind check: public campaigns, and in another folder the key.

The hash of the key is published with the campaigns.
"""

import secrets
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.linalg import orth

from casadical.blind_check import protocol
from casadical.blind_check.mujoco_physics import LISTED, UNLISTED, Plant
from casadical.blind_check.mujoco_physics.campaigns import MEASURED_COLUMNS
from casadical.blind_check.prediction import nominal
from casadical.blind_check.recording import COLUMN_PREFIXES, POSE_COUNTS, Plan, Record, Subject, draw_plans, record
from casadical.blind_check.worker_pool import completed, workers
from casadical.core.basics import Array, ConvergenceError, InputError
from casadical.core.files import claimed, write_together
from casadical.core.reading import load_json
from casadical.diagnosis.linearisation import signatures
from casadical.identification.identification import calibrate_base_model, prepare
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table
from casadical.project.problem import read_campaign_robot
from casadical.robot.robot import Robot
from casadical.robot.robot_file import to_toml


def base_jacobian(robot: Robot, clean: Measurements) -> Array:
    """Return the base model's Jacobian at the poses of a campaign, shape (n, 3, P) [m per SI unit].

    It is taken at the values of a calibration of the base model on the campaign.

    robot : nominal robot; clean : campaign without effects
    """
    fit = calibrate_base_model(prepare(robot, clean))
    m, _ = derive(clean, robot.conditions, robot.loads)
    return signatures(robot, (), m, robot.values_of(fit.robot))[1]


def unabsorbed_rms(J: Array, shift: Array) -> float:
    """Return the rms over all coordinates of the part of a shift that the base model cannot absorb.

    J : Jacobian of the base model, shape (n, 3, P), on whose columns the shift is projected
    shift : displacement of each measured point, shape (n, 3) [m]; the result is in its unit
    """
    A = J.reshape(shift.size, -1)
    # Some columns of the base model are linearly dependent; without a rank threshold they would add
    # arbitrary directions.
    Q = orth(A / np.maximum(np.linalg.norm(A, axis=0), 1e-300), rcond=1e-9)
    remaining = shift.ravel() - Q @ (Q.T @ shift.ravel())
    return float(np.sqrt(np.mean(remaining**2)))


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
        campaigns={p.name: protocol.CampaignEntry(robot=p.robot) for p in todo},
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
            recorded = record(subject, plan)
            break
        except ConvergenceError:
            if retry == 5:
                raise
    struck = [c for word in plan.not_logged for c in recorded.session if str(c).startswith(COLUMN_PREFIXES[word])]
    table = recorded.session.drop(columns=struck).to_csv(index=False)
    return plan.name, table, _secret(plan, recorded, subject.model)


def _secret(plan: Plan, recorded: Record, model: str) -> protocol.Secret:
    """Return what a campaign hides, with the visible size of each effect.

    model : text of the nominal robot's file
    """
    robot = nominal(model)
    clean = from_table(recorded.clean, [j.kind for j in robot.joints], "position")
    J = base_jacobian(robot, clean)

    def seen(table: pd.DataFrame) -> float:
        """Return the visible size [m] of the effects in a table; see `unabsorbed_rms`."""
        shift = table[MEASURED_COLUMNS].to_numpy(float) - recorded.clean[MEASURED_COLUMNS].to_numpy(float)
        return round(unabsorbed_rms(J, 1e-3 * shift), 9)

    together = seen(recorded.session)
    alone = [seen(t) for t in recorded.alone] or [together] * len(recorded.hidden)
    return protocol.Secret(
        robot=plan.robot,
        kind=plan.kind,
        hidden=tuple(
            protocol.HiddenEffect(effect=a.effect, joint=a.joint, about=a.about, visible=v)
            for a, v in zip(recorded.hidden, alone, strict=True)
        ),
        poses=plan.poses,
        missing=plan.missing,
        noise=plan.noise,
        repeatability=plan.repeatability,
        visible=together,
    )
