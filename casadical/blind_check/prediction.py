"""Answers to a blind check: diagnosis of each campaign from its folder alone, with predictions."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from casadical.blind_check import protocol
from casadical.blind_check.worker_pool import completed, workers
from casadical.core.basics import Array, ConvergenceError, InputError
from casadical.core.files import appending
from casadical.identification.accuracy import predicted
from casadical.identification.identification import calibrate_base_model, prepare
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot, robot_from, to_toml


@dataclass(frozen=True, eq=False)
class Session:
    """A campaign and its unseen poses, whose positions only the key contains.

    name : name of the campaign
    robot : nominal robot
    everything : all poses in the order in which the robot took them, with positions of zero at
        unseen ones
    seen : mask of measured poses, shape (all poses,)
    """

    name: str
    robot: Robot
    everything: Measurements
    seen: Array

    @property
    def measured(self) -> Measurements:
        """The measured poses."""
        return self.everything[self.seen]

    def _with_columns(self, robot: Robot) -> Measurements:
        """Return all poses with the columns of conditions that a robot's effects need.

        Columns of lagged temperatures are relative to their mean over the measured poses.
        """
        m, _ = derive(self.everything, robot.conditions, robot.loads)
        columns = {k: c - c[self.seen].mean() if k.startswith("warmth") else c for k, c in m.conditions.items()}
        return replace(m, conditions=columns)

    def at_unseen(self, robot: Robot) -> Array:
        """Return a robot's predicted positions at the unseen poses, shape (unseen, 3) [m].

        They are in the measuring frame.
        """
        return predicted(robot, self._with_columns(robot)[~self.seen])[0]

    def fitted(self, robot: Robot, leave_out: Array) -> Robot:
        """Return a robot identified, with its effects, from the measured poses without some rows.

        leave_out : row numbers of poses that are not used
        """
        m = self._with_columns(robot)
        m = m[self.seen & ~np.isin(m.row, leave_out)]
        free = ("kinematic", "compliance", *dict.fromkeys(e.label for e in robot.effects))
        return calibrate_base_model(prepare(robot, m), free).robot


@lru_cache(maxsize=16)
def nominal(model: str) -> Robot:
    """Return the robot that the text of a robot file describes.

    It is cached, because compiling its model is costly.
    """
    return robot_from(tomllib.loads(model), "the folder's robot")


def session(name: str, model: str, seen: pd.DataFrame, unseen: pd.DataFrame) -> Session:
    """Return the session of a campaign's two tables. Raises InputError.

    name : name of the campaign; model : text of the nominal robot's file
    seen : table of the measured poses; unseen : table of the other poses, without positions
    """
    robot = nominal(model)
    blank = unseen.assign(x_mm=0.0, y_mm=0.0, z_mm=0.0)
    table = pd.concat([seen.assign(seen=1.0), blank.assign(seen=0.0)]).sort_values("pose", kind="stable")
    joints = [j.kind for j in robot.joints]
    everything = from_table(table.drop(columns="seen"), joints, "position", source=f"{name}.csv")
    # These columns follow from the order of all poses, so they are derived before unseen ones go.
    everything, _ = derive(everything, ["progress", *(f"approach{j}" for j in range(1, robot.n + 1))])
    return Session(name, robot, everything, table["seen"].to_numpy() == 1.0)


def answer_campaign(name: str, model: str, seen: pd.DataFrame, unseen: pd.DataFrame) -> dict[str, Any]:
    """Return the answer to one campaign as plain data; this runs in a worker process.

    It is that of `diagnosis`. If a campaign cannot be answered, it has the entries `campaign` and
    `failed`, the reason.

    name, model, seen, unseen : as of `session`
    """
    try:
        return diagnosis(session(name, model, seen, unseen))
    except (InputError, ConvergenceError) as error:
        return {"campaign": name, "failed": str(error)}


def diagnosis(s: Session) -> dict[str, Any]:
    """Return the answer of the diagnosis to a session as plain data.

    It is what `casadical diagnose --json` writes, with the entries `posterior` (probability by
    label, "none" and "unknown" included) and `unseen` (see `unseen_positions`).
    """
    from casadical.diagnosis.details import Details
    from casadical.diagnosis.json_answer import as_json
    from casadical.diagnosis.localisation import localise
    from casadical.diagnosis.smooth_description import describe_unlisted
    from casadical.project.diagnosis import Campaign, diagnose_campaign

    diagnosed = diagnose_campaign(Campaign(s.robot, (s.measured,))).diagnosis
    answer = as_json(diagnosed, s.name, Details(where=localise(diagnosed), unlisted=describe_unlisted(diagnosed)))
    first = diagnosed.rankings[0]
    posterior = {"none": first.none, "unknown": 0.0}
    for candidate in diagnosed.case.candidates:
        text = candidate.label if candidate.listed else "unknown"
        posterior[text] = posterior.get(text, 0.0) + first.probability.get(candidate.label, 0.0)
    if any(c.effect == "outliers" for c in diagnosed.causes):
        # Outliers are found by a screening, not ranked, so their confidence is used as probability.
        posterior["outliers"] = next(c.confidence for c in diagnosed.causes if c.effect == "outliers")
    out = np.array([o.row for o in diagnosed.outliers], dtype=int)
    return answer | {
        "posterior": {text: round(float(p), 5) for text, p in posterior.items() if p >= 1e-5},
        "unseen": unseen_positions(s, diagnosed.identification.robot, diagnosed.apply(), out),
    }


def unseen_positions(s: Session, base: Robot, with_causes: Robot, leave_out: Array) -> dict[str, Any]:
    """Return predicted positions at the unseen poses [mm], three numbers per pose, by two models.

    The keys are base_mm, of the base model, and with_causes_mm, of the robot with named causes;
    both are in the measuring frame.

    base : base model calibrated on all measured poses
    leave_out : row numbers of outliers, without which the base model is calibrated again
    """
    before = s.at_unseen(s.fitted(s.robot, leave_out) if len(leave_out) else base)
    after = s.at_unseen(with_causes) if with_causes.effects else before
    return {
        name: [[round(float(x), 4) for x in row] for row in 1e3 * positions]
        for name, positions in (("base_mm", before), ("with_causes_mm", after))
    }


def predict(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    executor: Executor | None = None,
    show: Callable[[str, int, int], None] = lambda _text, _done, _all: None,
) -> Path:
    """Answer every campaign of a folder that `make` wrote, and return the file of answers.

    Answers that are in the file already are kept. A campaign that cannot be answered has a line
    that says why; it is tried again by the next call.

    folder : campaigns that `make` wrote
    out : file of answers, a line each; None: answers.diagnosis.jsonl in the folder
    executor, show : as of `make`
    Raises InputError for no such folder, tables that cannot be read, or a file that answers another
    check.
    """
    folder = Path(folder)
    manifest = protocol.read_manifest(folder)
    path = Path(out) if out else folder / "answers.diagnosis.jsonl"
    done: set[str] = set()
    if protocol.whole_lines(path):
        head, answers = protocol.read_answers(path)
        if head.key_sha256 != manifest.key_sha256:
            raise InputError(f"{path}: holds answers to another check; name another file by --out")
        done = set(answers)
    pending = [name for name in manifest.campaigns if name not in done]
    robots = {c.robot: folder / protocol.ROBOTS_FOLDER / f"{c.robot}.robot.toml" for c in manifest.campaigns.values()}
    models = {robot: to_toml(read_robot(path)) for robot, path in robots.items()}
    tasks = []
    for name in pending:
        seen, unseen = (protocol.read_table(folder, name + end) for end in ("", ".unseen"))
        if {"x_mm", "y_mm", "z_mm"} & set(unseen):
            place = folder / name
            raise InputError(
                f"{place}.unseen.csv: holds positions; they belong in the key alone ({protocol.MANIFEST_FILE})"
            )
        tasks.append((name, models[manifest.campaigns[name].robot], seen, unseen))
    with workers(executor) as pool, appending(path, protocol.whole_lines(path)) as add:
        if not path.stat().st_size:
            versions = {package: version(package) for package in ("casadical", "casadi", "numpy")}
            add(protocol.json_line({"key_sha256": manifest.key_sha256, "by": "diagnosis", "versions": versions}))
        for count, answer in enumerate(completed(pool, answer_campaign, tasks), len(done) + 1):
            add(protocol.json_line(answer))
            show(answer["campaign"], count, len(manifest.campaigns))
    return path
