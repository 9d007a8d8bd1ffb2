"""Results as tables to read and as JSON to keep."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from casadical.identification.accuracy import Accuracy
from casadical.identification.identifiability import CONFOUNDED
from casadical.identification.identification import Identification
from casadical.measurements.measurements import Measurements
from casadical.project.networks import NetworkResult, Networks
from casadical.project.problem import Problem
from casadical.robot.robot import modified_dh

SetAccuracies = Mapping[str, Mapping[str, Accuracy]]

NEARLY_CONFOUNDED = (
    f" A condition number above {CONFOUNDED} means that some parameters are nearly confounded: trust the robot as a "
    "whole, by its held-out errors, more than each value. Standard errors and correlations tell which; poses spread "
    "wider (casadical plan) would part them."
)
PLACED = (
    "nominal of base and tool: as first placed on the data (base_* are what is added to that), not as in the robot file"
)
_NETWORK_USE = {"train": "networks learn", "choose": "networks are judged", "report": "held out"}
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


def error_table(results: Mapping[str, SetAccuracies], networks: Networks | None = None) -> Table:
    """Errors in mm before and after, for every method and set."""
    trained = [r for r in networks.results.values() if r.compensator] if networks else []
    table = _table("Position error [mm]")
    table.add_column("poses, model", no_wrap=True)
    for column in ("n", "mean", "max", "std", "rms", "95 %"):
        table.add_column(column, justify="right", no_wrap=True)
    first = next(iter(results.values()))
    for name in first:
        held_out = not name.startswith("identify")
        use = _NETWORK_USE.get(name.split("/")[0]) if trained else None
        table.add_row()
        table.add_row(f"{name} ({use or ('held out' if held_out else 'used')})", str(first[name]["nominal"].n))
        for state, words in _STATES.items():
            table.add_row(f"  before, {words}", "", *_figures(first[name][state]))
        for method, by_set in results.items():
            figures = _figures(by_set[name]["calibrated"])
            table.add_row(f"  after {method}", "", *figures, style="bold" if held_out else "")
        for result in trained:
            words = "" if result.helps else ": refused"
            style = "bold" if held_out and result.helps else ""
            table.add_row(f"  after {result.method}{words}", "", *_figures(result.errors[name]), style=style)
    return table


def network_table(networks: Networks) -> Table | Text:
    """What each trained network does to the mean error, also where it was refused, and why it was."""
    table = _table("Mean error without > with each network as trained, mm, and what became of it")
    for column in ("", "trained on", "judged on", "gain there", "report", ""):
        table.add_column(column, no_wrap=True)
    for name, result in networks.results.items():
        c = result.compensator
        if c is None:
            return Text(result.why)
        pairs = [_pair(x.before.mean_mm, x.after.mean_mm) if x else "-" for x in (c.training, c.choice, c.validation)]
        gain = f"{100 * c.choice.gain:+.0f} +/- {100 * c.choice.gain_error:.0f} %"
        table.add_row(name, *pairs[:2], gain, pairs[2], "kept" if c.helps else "refused")
    return table


def _pair(was: float, now: float) -> str:
    return f"{was:.2f}>{now:.2f}"


def paper_tables(
    problem: Problem, errors: Mapping[str, SetAccuracies], networks: Networks | None = None
) -> list[RenderableType]:
    """Mean, max and std [mm] beside the published ones: calibration (the poses that each was made from) and report."""
    if problem.paper is None:
        return []
    parts: list[RenderableType] = []
    for name, published in (("calibration", problem.paper.calibration), ("validation", problem.paper.validation)):
        table = _table(f"Beside the paper: {name} [mm]")
        for column in ("", "set", "mean", "max", "std", "paper: mean", "max", "std"):
            table.add_column(column, justify="right" if column not in ("", "set") else "left", no_wrap=True)
        for method, set_name, figures in _beside(name, errors, networks):
            theirs = published.get(method)
            cells = [f"{v:.4f}" for v in theirs] if theirs else ["-"] * 3
            refused = networks and method in networks.results and not networks.results[method].helps
            table.add_row(method + ("*" if refused else ""), set_name, *(f"{v:.4f}" for v in figures), *cells)
        parts += [table, Text()]
    star = " * refused: it makes held-out poses worse or no better; SKCM stays in use." if networks else ""
    return [*parts, Text(f"Paper: {problem.paper.source}.{star}")]


def _beside(
    name: str, errors: Mapping[str, SetAccuracies], networks: Networks | None
) -> Iterator[tuple[str, str, tuple[float, float, float]]]:
    """Method, set and our (mean, max, std) [mm]; networks as they were trained, for the paper refuses none."""
    base = "identify" if name == "calibration" else "report"
    rows = list(errors.items())
    for method, states in [("before", rows[-1][1]), *rows]:
        a = states.get(base, {}).get("placed" if method == "before" else "calibrated")
        if a:
            yield method, base, (1e3 * a.mean, 1e3 * a.max, 1e3 * a.std)
    for result in networks.results.values() if networks else ():
        c = result.compensator
        found = c and (c.training if name == "calibration" else c.validation)
        if found:
            e = found.after
            yield result.method, "train" if name == "calibration" else base, (e.mean_mm, e.max_mm, e.std_mm)


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
    rows = _rows(result, "identified", "at bound")
    if was_placed(result):
        table.caption, table.caption_justify = PLACED, "left"
    for row in rows:
        sure = not math.isnan(row["std_error"])
        interval = (f"{row['std_error']:.2g}", f"{row['low']:.4f}", f"{row['high']:.4f}") if sure else ("-", "-", "-")
        unit = row["unit"] if row["status"] == "identified" else f"{row['unit']} AT BOUND"
        table.add_row(row["name"], f"{row['nominal']:.4f}", f"{row['value']:.4f}", *interval, unit)
    return table


def was_placed(result: Identification) -> bool:
    """Whether the nominal values of base and tool come from a first placement on the data (see `placement.place`)."""
    return result.given.base.unknown == "pose" and any(m.position is not None for m in result.measurements)


def _rows(result: Identification, *states: str) -> list[dict[str, Any]]:
    frame = result.parameters
    return [{str(k): v for k, v in row.items()} for row in frame[frame.status.isin(states)].to_dict("records")]


def _stiff(compliance: float, error: float) -> str:
    """Stiffness [N m/rad] of a compliance [urad/(N m)], or the least it can be where zero compliance is possible."""
    if compliance <= 1.96 * error:
        return f"above {1e6 / (compliance + 1.96 * error):.2g} (not told from rigid)"
    return f"{1e6 / compliance:.3g}"


def _stiffness(result: Identification) -> list[Text]:
    """Compliances in the unit that people compare: joint stiffness."""
    rows = [row for row in _rows(result, "identified") if row["group"] == "compliance" and row["value"] > 0]
    text = ", ".join(f"joint {row['name'][1:]} {_stiff(row['value'], row['std_error'])}" for row in rows)
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
    problem: Problem,
    results: Mapping[str, Identification],
    errors: Mapping[str, SetAccuracies],
    networks: Networks | None = None,
) -> RenderableType:
    """Everything that `casadical calibrate` prints about one problem."""
    last = list(results.values())[-1]
    parts: list[RenderableType] = [
        Text(f"{problem.title}", style="bold underline"),
        Text(f"{problem.robot.name}; {problem.origin}"),
        *(Text(f"note: {note}", style="dim") for note in problem.robot.notes),
        Text(),
        *(Text(result.verdict) for result in results.values()),
        Text(_how_sure(last)),
        Text(),
        error_table(errors, networks),
        Text(),
        *([network_table(networks), Text(networks.trained_on), Text()] if networks else []),
        *(paper := paper_tables(problem, errors, networks)),
        *([Text()] if paper else []),
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
    condition = result.identifiability.condition
    return (
        f"Residual scatter {noise}; condition number {condition:.0f}; "
        f"optimum {optimal} by recomputation; {result.degrees_of_freedom} degrees of freedom."
    ) + (NEARLY_CONFOUNDED if condition > CONFOUNDED else "")


def as_json(
    problem: Problem,
    results: Mapping[str, Identification],
    errors: Mapping[str, SetAccuracies],
    networks: Networks | None = None,
) -> dict[str, Any]:
    """The same as plain data: per method and set the error figures, per parameter value, error, unit, status."""
    found: dict[str, Any] = {
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
    if networks:
        found["trained_on"] = networks.trained_on
        found["networks"] = {name: _network(result) for name, result in networks.results.items()}
    if problem.paper:
        paper = {"calibration": problem.paper.calibration, "validation": problem.paper.validation}
        found["paper"] = {"source": problem.paper.source} | {
            name: {m: dict(zip(("mean_mm", "max_mm", "std_mm"), f, strict=True)) for m, f in table.items()}
            for name, table in paper.items()
        }
    return found


def _network(result: NetworkResult) -> dict[str, Any]:
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
