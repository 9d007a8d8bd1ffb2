"""Calibrate a problem folder with its methods, and write what came out."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import cast

from .errors import InputError
from .identification import METHODS, Identification, Method, identify
from .problem import Problem, read_problem
from .residuals import LOSSES
from .robot_file import to_toml
from .tables import SetAccuracies, accuracies, as_json

Run = tuple[Problem, dict[str, Identification], dict[str, SetAccuracies]]


def calibrate_problem(
    folder: Path,
    *,
    method: str | None = None,
    loss: str | None = None,
    seed: int | None = None,
    show: Callable[[str], None] = lambda _text: None,
) -> Run:
    """The problem, an identification for each method, and the errors of each on every set.

    show : called with a line of progress. Raises InputError, ConvergenceError.
    """
    if method is not None and method not in METHODS:
        raise InputError(f"--method {method}: not known; allowed: {', '.join(METHODS)}")
    if loss is not None and loss not in LOSSES:
        raise InputError(f"--loss {loss}: not known; allowed: {', '.join(LOSSES)}")
    problem = read_problem(folder, seed)
    if loss is not None:
        problem = replace(problem, loss=loss)
    results: dict[str, Identification] = {}
    errors: dict[str, SetAccuracies] = {}
    for name in (method,) if method else problem.methods:

        def progress(iteration: int, cost: float, name: str = name) -> None:
            show(f"{name} iteration {iteration}, cost {cost:.6g}")

        results[name] = identify(
            problem.robot,
            problem.sets["identify"],
            method=cast(Method, name),
            loss=problem.loss,
            progress=progress,
        )
        errors[name] = accuracies(results[name], problem.sets)
    return problem, results, errors


def result_files(
    folder: Path, problem: Problem, results: dict[str, Identification], errors: dict[str, SetAccuracies]
) -> dict[Path, str]:
    """What is kept of a run: the calibrated robot of each method, its parameters and all figures, by file."""
    texts = {folder / "result.json": json.dumps(as_json(problem, results, errors), indent=1, allow_nan=False) + "\n"}
    for name, result in results.items():
        comment = (
            f"Calibrated by casadical, method {name}, from {problem.title} ({problem.data} data).\n{result.verdict}"
        )
        texts[folder / f"{name}.robot.toml"] = to_toml(result.robot, comment)
        if problem.urdf:
            texts[folder / f"{name}.robot.urdf"] = _urdf(problem, result)
        texts[folder / f"{name}.parameters.csv"] = result.parameters.to_csv(index=False)
    return texts


def _urdf(problem: Problem, result: Identification) -> str:
    """The problem's URDF with the calibrated geometry, the measured point as a link of its own."""
    from .urdf_export import calibrated_urdf_text

    assert problem.urdf is not None
    path, base_link, tip_link = problem.urdf
    return calibrated_urdf_text(
        problem.robot, result.robot, path, base_link, tip_link, measured_link="casadical_measured_point"
    )
