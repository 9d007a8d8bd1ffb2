"""Calibrate a problem folder with its methods, and write what came out."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from casadical.compensator import compensator_text
from casadical.core.errors import InputError
from casadical.identification.identification import Identification, identify
from casadical.identification.residuals import LOSSES
from casadical.project.networks import Networks, train_networks
from casadical.project.problem import ALL_METHODS, NETWORK_METHODS, Problem, base_methods, read_problem
from casadical.report.calibration_text import SetAccuracies, accuracies, as_json
from casadical.robot.robot_file import to_toml

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

    A network method needs SKCM, which is identified here; the network itself is trained by `problem_networks`.
    show : called with a line of progress. Raises InputError, ConvergenceError.
    """
    if method is not None and method not in ALL_METHODS:
        raise InputError(f"--method {method}: not known; allowed: {', '.join(ALL_METHODS)}")
    if loss is not None and loss not in LOSSES:
        raise InputError(f"--loss {loss}: not known; allowed: {', '.join(LOSSES)}")
    problem = read_problem(folder, seed)
    if loss is not None:
        problem = replace(problem, loss=loss)
    results: dict[str, Identification] = {}
    errors: dict[str, SetAccuracies] = {}
    if method is not None:
        chosen = tuple(m for m in NETWORK_METHODS if m == method)
        problem = replace(problem, methods=base_methods([method]), networks=chosen)
    for name in problem.methods:

        def progress(iteration: int, cost: float, name: str = name) -> None:
            show(f"{name} iteration {iteration}, cost {cost:.6g}")

        results[name] = identify(
            problem.robot,
            problem.sets["identify"],
            method=name,
            loss=problem.loss,
            progress=progress,
        )
        errors[name] = accuracies(results[name], problem.sets)
    return problem, results, errors


def problem_networks(
    problem: Problem, results: dict[str, Identification], show: Callable[[str], None] = lambda _text: None
) -> Networks | None:
    """The problem's network methods, trained on what its SKCM left; None where it lists none. Raises InputError."""
    if not problem.networks:
        return None
    return train_networks(problem, results["SKCM"], problem.networks, seed=problem.seed, show=show)


def result_files(
    folder: Path,
    problem: Problem,
    results: dict[str, Identification],
    errors: dict[str, SetAccuracies],
    networks: Networks | None = None,
) -> dict[Path, str]:
    """What is kept of a run, by file: all figures, of each method the robot and its parameters or the compensator."""
    figures = as_json(problem, results, errors, networks)
    texts = {folder / "result.json": json.dumps(figures, indent=1, allow_nan=False) + "\n"}
    for name, trained in (networks.results if networks else {}).items():
        if trained.compensator is not None:
            texts[folder / f"{name}.compensator.json"] = compensator_text(trained.compensator)
    for name, result in results.items():
        comment = f"Calibrated by casadical, method {name}, from {problem.title} ({problem.origin}).\n{result.verdict}"
        texts[folder / f"{name}.robot.toml"] = to_toml(result.robot, comment)
        if problem.urdf:
            texts[folder / f"{name}.robot.urdf"] = _urdf(problem, result)
        texts[folder / f"{name}.parameters.csv"] = result.parameters.to_csv(index=False)
    return texts


def _urdf(problem: Problem, result: Identification) -> str:
    """The problem's URDF with the calibrated geometry, the measured point as a link of its own."""
    from casadical.robot.urdf_export import calibrated_urdf_text

    assert problem.urdf is not None
    path, base_link, tip_link = problem.urdf
    return calibrated_urdf_text(
        problem.robot, result.robot, path, base_link, tip_link, measured_link="casadical_measured_point"
    )
