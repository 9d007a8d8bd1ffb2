"""Answers to a blind check: diagnosis of each campaign from its folder alone."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from concurrent.futures import Executor
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from casadical.blind_check import protocol
from casadical.blind_check.worker_pool import completed, workers
from casadical.core.basics import ConvergenceError, InputError
from casadical.core.files import appending
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot, robot_from, to_toml


@lru_cache(maxsize=16)
def nominal(model: str) -> Robot:
    """Return the robot that the text of a robot file describes.

    It is cached, because compiling its model is costly.
    """
    return robot_from(tomllib.loads(model), "the folder's robot")


def answer_campaign(name: str, model: str, table: pd.DataFrame) -> dict[str, Any]:
    """Return the answer to one campaign as plain data; this runs in a worker process.

    It is that of `diagnosis`. If a campaign cannot be answered, it has the entries `campaign` and
    `failed`, the reason.

    name : name of the campaign; model : text of the nominal robot's file; table : its table
    """
    try:
        robot = nominal(model)
        measured = from_table(table, [j.kind for j in robot.joints], "position", source=f"{name}.csv")
        return diagnosis(name, robot, measured)
    except (InputError, ConvergenceError) as error:
        return {"campaign": name, "failed": str(error)}


def diagnosis(name: str, robot: Robot, measured: Measurements) -> dict[str, Any]:
    """Return the answer of the diagnosis to a campaign as plain data.

    It is what `casadical diagnose --json` writes, with the entry `posterior` (probability by label,
    "none" and "unknown" included, from 1e-5 on).
    """
    from casadical.diagnosis.details import Details
    from casadical.diagnosis.laws.discovery import describe_unlisted
    from casadical.diagnosis.localisation import localise
    from casadical.diagnosis.text import as_json
    from casadical.project.diagnosis import Campaign, diagnose_campaign

    diagnosed = diagnose_campaign(Campaign(robot, (measured,))).diagnosis
    answer = as_json(diagnosed, name, Details(where=localise(diagnosed), unlisted=describe_unlisted(diagnosed)))
    first = diagnosed.rankings[0]
    posterior = {"none": first.none, "unknown": 0.0}
    for candidate in diagnosed.case.candidates:
        text = candidate.label if candidate.listed else "unknown"
        posterior[text] = posterior.get(text, 0.0) + first.probability.get(candidate.label, 0.0)
    if any(c.effect == "outliers" for c in diagnosed.causes):
        # Outliers are found by a screening, not ranked, so their confidence is used as probability.
        posterior["outliers"] = next(c.confidence for c in diagnosed.causes if c.effect == "outliers")
    return answer | {"posterior": {text: round(float(p), 5) for text, p in posterior.items() if p >= 1e-5}}


def predict(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    executor: Executor | None = None,
    show: Callable[[str, int, int], None] = lambda _text, _done, _all: None,
) -> Path:
    """Answer every campaign of a folder that `make` wrote, and return the file of answers.

    Answers that are in the file already stay there. A campaign that cannot be answered has a line
    that says why; it is tried again by the next call.

    folder : campaigns that `make` wrote
    out : file of answers, a line each; None: answers.diagnosis.jsonl in the folder
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
    robot_of = {name: public["robot"] for name, public in manifest.campaigns.items()}
    place = folder / protocol.ROBOTS_FOLDER
    robots = {name: place / f"{name}.robot.toml" for name in robot_of.values()}
    models = {robot: to_toml(read_robot(path)) for robot, path in robots.items()}
    tasks = [(name, models[robot_of[name]], protocol.read_table(folder, name)) for name in pending]
    with workers(executor) as pool, appending(path, protocol.whole_lines(path)) as add:
        if not path.stat().st_size:
            versions = {package: version(package) for package in ("casadical", "casadi", "numpy")}
            add(protocol.json_line({"key_sha256": manifest.key_sha256, "by": "diagnosis", "versions": versions}))
        for count, answer in enumerate(completed(pool, answer_campaign, tasks), len(done) + 1):
            add(protocol.json_line(answer))
            show(answer["campaign"], count, len(manifest.campaigns))
    return path
