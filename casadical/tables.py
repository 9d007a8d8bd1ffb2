"""Results as tables to read and as JSON to keep."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from .accuracy import Accuracy
from .identification import Identification
from .measurements import Measurements
from .problem import Problem
from .robot import modified_dh

SetAccuracies = Mapping[str, Mapping[str, Accuracy]]

_STATES = {"nominal": "as given", "placed": "base and tool fitted"}


def accuracies(result: Identification, sets: Mapping[str, tuple[Measurements, ...]]) -> dict[str, dict[str, Accuracy]]:
    """Error figures by set, then by state (nominal, placed, calibrated); sets of several kinds get a name for each."""
    found = {}
    for name, parts in sets.items():
        for m in parts:
            found[name if len(parts) == 1 else f"{name}/{m.kind}"] = result.accuracy(m)
    return found


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", title_style="bold", box=None, padding=(0, 2, 0, 0), pad_edge=False)


def error_table(results: Mapping[str, SetAccuracies]) -> Table:
    """Errors in mm before and after, for every method and set."""
    table = _table("Position error [mm]")
    table.add_column("poses, model", no_wrap=True)
    for column in ("n", "mean", "max", "std", "rms", "95 %"):
        table.add_column(column, justify="right", no_wrap=True)
    first = next(iter(results.values()))
    for name in first:
        held_out = not name.startswith("identify")
        table.add_row()
        table.add_row(name + (" (held out)" if held_out else " (used)"), str(first[name]["nominal"].n))
        for state, words in _STATES.items():
            table.add_row(f"  before, {words}", "", *_figures(first[name][state]))
        for method, by_set in results.items():
            figures = _figures(by_set[name]["calibrated"])
            table.add_row(f"  after {method}", "", *figures, style="bold" if held_out else "")
    return table


def _figures(a: Accuracy) -> tuple[str, ...]:
    return tuple(_mm(v) for v in (a.mean, a.max, a.std, a.rms, a.p95))


def _mm(metres: float) -> str:
    value = 1e3 * metres
    return f"{value:.{3 if value < 10 else 2 if value < 100 else 1}f}"


def parameter_table(result: Identification) -> Table:
    """Identified parameters: nominal, value, standard error, 95 % interval."""
    table = _table(f"Parameters identified by {result.method}")
    table.add_column("parameter", no_wrap=True)
    for column in ("nominal", "value", "std error", "95 % low", "high"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("unit")
    for row in _rows(result, "identified", "at bound"):
        sure = not math.isnan(row["std_error"])
        interval = (f"{row['std_error']:.2g}", f"{row['low']:.4f}", f"{row['high']:.4f}") if sure else ("-", "-", "-")
        unit = row["unit"] if row["status"] == "identified" else f"{row['unit']} AT BOUND"
        table.add_row(row["name"], f"{row['nominal']:.4f}", f"{row['value']:.4f}", *interval, unit)
    return table


def _rows(result: Identification, *states: str) -> list[dict[str, Any]]:
    frame = result.parameters
    return [{str(k): v for k, v in row.items()} for row in frame[frame.status.isin(states)].to_dict("records")]


def _stiffness(result: Identification) -> list[Text]:
    """Compliances in the unit that people compare: joint stiffness."""
    rows = [row for row in _rows(result, "identified") if row["group"] == "compliance" and row["value"] > 0]
    text = ", ".join(f"joint {row['name'][1:]} {1e6 / row['value']:.3g}" for row in rows)
    return [Text(f"Joint stiffness [N m/rad]: {text}")] if rows else []


def held_table(result: Identification) -> Table | Text:
    """What could not be identified, and why."""
    rows = _rows(result, "not identifiable")
    if not rows:
        return Text("Every parameter was identified.")
    table = _table("Not identifiable: held at nominal")
    table.add_column("parameter", no_wrap=True)
    table.add_column("why")
    for row in rows:
        table.add_row(row["name"], row["reason"])
    return table


def report(
    problem: Problem, results: Mapping[str, Identification], errors: Mapping[str, SetAccuracies]
) -> RenderableType:
    """Everything that `casadical calibrate` prints about one problem."""
    last = list(results.values())[-1]
    parts: list[RenderableType] = [
        Text(f"{problem.title}", style="bold underline"),
        Text(f"{problem.robot.name}; {problem.data} data"),
        *(Text(f"note: {note}", style="dim") for note in problem.robot.notes),
        Text(),
        *(Text(result.verdict) for result in results.values()),
        Text(_how_sure(last)),
        Text(),
        error_table(errors),
        Text(),
        parameter_table(last),
        *_stiffness(last),
        Text(),
        held_table(last),
    ]
    correlated = last.correlations()
    if len(correlated):
        pairs = [f"{a}/{b} {c:+.3f}" for a, b, c in correlated.head(8).itertuples(index=False)]
        parts.append(Text(f"Correlated above 0.95: {', '.join(pairs)}" + (" ..." if len(correlated) > 8 else "")))
    return Group(*parts)


def _how_sure(result: Identification) -> str:
    noise = ", ".join(f"{1e3 * sigma:.3f} mm a coordinate" for sigma, _ in result.sigmas)
    optimal = "confirmed" if result.is_optimal() else "NOT confirmed"
    return (
        f"Residual scatter {noise}; condition number {result.identifiability.condition:.0f}; "
        f"optimum {optimal} by recomputation; {result.degrees_of_freedom} degrees of freedom."
    )


def as_json(
    problem: Problem, results: Mapping[str, Identification], errors: Mapping[str, SetAccuracies]
) -> dict[str, Any]:
    """The same as plain data: per method and set the error figures, per parameter value, error, unit, status."""
    return {
        "problem": problem.folder.name,
        "title": problem.title,
        "data": problem.data,
        "robot": problem.robot.name,
        "methods": {
            method: {
                "verdict": result.verdict,
                "optimal": result.is_optimal(),
                "condition": result.identifiability.condition,
                "degrees_of_freedom": result.degrees_of_freedom,
                "iterations": len(result.solution.history) - 1,
                "sets": {
                    name: {
                        **_as_mm(states["calibrated"]),
                        "before_nominal": _as_mm(states["nominal"]),
                        "before_placed": _as_mm(states["placed"]),
                    }
                    for name, states in errors[method].items()
                },
                "parameters": [_parameter(row) for row in result.parameters.to_dict("records")],
                "modified_dh": modified_dh(result.robot),
            }
            for method, result in results.items()
        },
    }


def _as_mm(a: Accuracy) -> dict[str, float | int]:
    return {
        "n": a.n,
        "mean_mm": 1e3 * a.mean,
        "max_mm": 1e3 * a.max,
        "std_mm": 1e3 * a.std,
        "rms_mm": 1e3 * a.rms,
        "p95_mm": 1e3 * a.p95,
    }


def _parameter(row: dict[Any, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()}
