"""Answer a blind check: diagnose each campaign from its folder alone, and predict positions at its unseen poses."""

from collections.abc import Callable
from concurrent.futures import Executor
from importlib.metadata import version
from pathlib import Path

import pandas as pd

from casadical.blind_check.answers import json_line, read_answers, whole_lines
from casadical.blind_check.predictor import METHODS, answer_campaign
from casadical.blind_check.protocol import MANIFEST, ROBOTS, Manifest, read_manifest, read_table
from casadical.blind_check.worker_pool import completed, workers
from casadical.core.errors import InputError
from casadical.core.files import appending
from casadical.robot.robot_file import read_robot, to_toml


def predict(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    by: str = "diagnosis",
    executor: Executor | None = None,
    show: Callable[[str, int, int], None] = lambda _text, _done, _all: None,
) -> Path:
    """Answer every campaign of a folder that `make` wrote; answers that are in the file already are kept.

    A campaign that cannot be answered has a line that says why; it is tried again by the next call.

    out : file of answers, a line each; by default answers.METHOD.jsonl in the folder
    by : diagnosis, or f-test, a textbook method to compare it with; executor, show : as of `make`
    Raises InputError for no such folder or method, tables that cannot be read, or a file that answers another check.
    """
    folder = Path(folder)
    if by not in METHODS:
        raise InputError(f"--by {by}: not known; allowed: {', '.join(METHODS)}")
    manifest = read_manifest(folder)
    path = Path(out) if out else folder / f"answers.{by}.jsonl"
    done = _begun(path, manifest, by)
    left = [name for name in manifest.campaigns if name not in done]
    robots = {c.robot: folder / ROBOTS / f"{c.robot}.robot.toml" for c in manifest.campaigns.values()}
    models = {robot: to_toml(read_robot(path)) for robot, path in robots.items()}
    tasks = [(by, name, models[manifest.campaigns[name].robot], *_tables(folder, name)) for name in left]
    with workers(executor) as pool, appending(path, whole_lines(path)) as add:
        if not path.stat().st_size:
            versions = {package: version(package) for package in ("casadical", "casadi", "numpy")}
            add(json_line({"key_sha256": manifest.key_sha256, "by": by, "versions": versions}))
        for count, answer in enumerate(completed(pool, answer_campaign, tasks), len(done) + 1):
            add(json_line(answer))
            show(answer["campaign"], count, len(manifest.campaigns))
    return path


def _begun(path: Path, manifest: Manifest, by: str) -> set[str]:
    """Campaigns that are answered already. Raises InputError for answers to another check."""
    if not whole_lines(path):
        return set()
    head, answers = read_answers(path)
    if (head.key_sha256, head.by) != (manifest.key_sha256, by):
        raise InputError(f"{path}: holds answers by {head.by} to another check; name another file by --out")
    return set(answers)


def _tables(folder: Path, name: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    seen, unseen = (read_table(folder, name + end) for end in ("", ".unseen"))
    if {"x_mm", "y_mm", "z_mm"} & set(unseen):
        raise InputError(f"{folder / name}.unseen.csv: holds positions; they belong in the key alone ({MANIFEST})")
    return seen, unseen
