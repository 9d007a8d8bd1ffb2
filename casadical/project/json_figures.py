"""Figures of a calibration as plain data, as `casadical calibrate --json` writes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from casadical.identification.accuracy import Accuracy
from casadical.identification.result import Identification
from casadical.measurements.kinds.registry import find_kind
from casadical.project.networks import NetworkResult
from casadical.project.problem_file import Paper
from casadical.robot.robot import modified_dh


def method_figures(
    result: Identification, sets: Mapping[str, Mapping[str, Accuracy]], usual: Mapping[str, Accuracy]
) -> dict[str, Any]:
    """One method: its verdict, errors and parameters.

    sets : by set and state; usual : of sets in which poses are far off, without these
    """
    return {
        "verdict": result.verdict,
        "optimal": result.is_optimal(),
        "condition": result.identifiability.condition,
        "degrees_of_freedom": result.degrees_of_freedom,
        "iterations": len(result.solution.history) - 1,
        "loss": result.loss,
        "left_out": [{"source": out.source, "row": out.row, "error_mm": 1e3 * out.error} for out in result.left_out],
        "unknown_places": _places(result),
        "sets": {
            name: {
                **_as_mm(states["calibrated"]),
                "before_nominal": _as_mm(states["nominal"]),
                "before_placed": _as_mm(states["placed"]),
                **({"without_far_off": _as_mm(usual[name])} if name in usual else {}),
            }
            for name, states in sets.items()
        },
        "parameters": [_parameter(row) for row in result.shown.to_dict("records")],
        "modified_dh": modified_dh(result.robot),
    }


def network_figures(result: NetworkResult) -> dict[str, Any]:
    """One network method: its verdict, the errors by set as it is used, and as trained even where it was refused."""
    found: dict[str, Any] = {"verdict": result.verdict, "helps": result.helps}
    c = result.compensator
    if c is None:
        return found
    parts = {"train": c.training, "choose": c.choice, "report": c.validation}
    return found | {
        "trainer": c.trainer,
        "settings": c.settings,
        "seed": c.seed,
        "chosen_by": c.chosen_by,
        "sets": {name: _as_mm(a) for name, a in result.errors.items()},
        "as_trained": {name: asdict(part) for name, part in parts.items() if part},
    }


def paper_figures(paper: Paper) -> dict[str, Any]:
    """What a paper reports, by table and method."""
    tables = {"calibration": paper.calibration, "validation": paper.validation}
    return {"source": paper.source} | {
        name: {m: dict(zip(("mean_mm", "max_mm", "std_mm"), f, strict=True)) for m, f in table.items()}
        for name, table in tables.items()
    }


def _places(result: Identification) -> list[dict[str, Any]]:
    """Places that were identified too, such as far ends of wires, in the frame of the measurements."""
    found = []
    for label, xyz in result.unknown_points.items():
        k, name = label.split("/", 1)
        m = result.measurements[int(k)]
        if find_kind(m.kind).places:
            found.append({"source": m.source, "name": name, "xyz_mm": [1e3 * float(v) for v in xyz]})
    return found


def _as_mm(a: Accuracy) -> dict[str, float | int]:
    return {name if name == "n" else f"{name}_mm": v if name == "n" else 1e3 * v for name, v in asdict(a).items()}


def _parameter(row: dict[Any, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()}
