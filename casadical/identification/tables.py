"""The result of an identification, as tables and sentences."""

import math
from typing import Any

from casadical.core.telling.blocks import Table, Words
from casadical.identification.gravity import in_words
from casadical.identification.identifiability import CONFOUNDED
from casadical.identification.result import Identification

NEARLY_CONFOUNDED = (
    f" A condition number above {CONFOUNDED} means that some parameters are nearly confounded: trust the robot as a "
    "whole, by its held-out errors, more than each value. Standard errors and correlations tell which; poses spread "
    "wider (casadical plan) would separate them."
)
PLACED = Words(
    "nominal of base and tool: as first placed on the data (base_* are what is added to that), not as in the robot "
    "file",
    "note",
)


def how_sure(result: Identification) -> Words:
    """Scatter of the residuals, condition and optimality in a sentence."""
    noise = ", ".join(f"{1e3 * sigma:.3f} mm a coordinate" for sigma, _ in result.sigmas)
    optimal = "confirmed" if result.is_optimal() else "NOT confirmed"
    condition = result.identifiability.condition
    if result.noise_is_assumed:
        noise += " (an upper end: so few poses do not tell it beside the prior; say sigma_mm in problem.toml)"
    return Words(
        f"Residual scatter {noise}; condition number {condition:.0f}; optimum {optimal} by recomputation; "
        f"{result.degrees_of_freedom} degrees of freedom." + (NEARLY_CONFOUNDED if condition > CONFOUNDED else "")
    )


def parameter_tables(result: Identification, whole: bool = False) -> list[Table | Words]:
    """Nominal, value, standard error and 95 % interval; bold at a bound.

    whole : with the parameters that were held, grey, and folded; else those that were identified alone
    """
    strong: set[int] = set()
    faint: set[int] = set()
    rows: list[tuple[str, ...]] = []
    for r in _parameters(result):
        status = "" if r["status"] == "identified" else "AT BOUND" if r["status"] == "at bound" else r["status"]
        known = status in ("", "AT BOUND")
        if not (known or whole):
            continue
        if status:
            (strong if known else faint).add(len(rows))
        sure = not math.isnan(r["std_error"])
        interval = (f"{r['std_error']:.2g}", f"{r['low']:.4f}", f"{r['high']:.4f}") if sure else ("-", "-", "-")
        rows.append((r["name"], f"{r['nominal']:.4f}", f"{r['value']:.4f}", *interval, f"{r['unit']} {status}".strip()))
    columns = ("parameter", "nominal", "value", "std error", "95 % low", "high", "unit")
    title = f"{'All parameters of' if whole else 'Parameters identified by'} {result.method}"
    table = Table(title, columns, rows, frozenset(range(1, 6)), frozenset(strong), frozenset(faint), folded=whole)
    return [table, *([PLACED] if was_placed(result) else []), *_stiffness(result), *_summaries(result)]


def was_placed(result: Identification) -> bool:
    """Whether the nominal values of base and tool come from a first placement (see `placement.place_frames`)."""
    return result.given.base.unknown == "pose" and any(m.position is not None for m in result.measurements)


def _parameters(result: Identification) -> list[dict[Any, Any]]:
    return result.shown.to_dict("records")


def _stiffness(result: Identification) -> list[Words]:
    """Compliances in the unit that people compare: joint stiffness; where masses are not known, the deflection."""
    if result.robot.masses == "estimated":
        gives = any(result.start.parameters[name].group == "compliance" for name in result.names)
        return [Words(in_words(result).capitalize())] if gives else []
    told = [r for r in _parameters(result) if r["status"] == "identified" and r["group"] == "compliance"]
    text = ", ".join(f"joint {r['name'][1:]} {stiffness(r['value'], r['std_error'])}" for r in told if r["value"] > 0)
    return [Words(f"Joint stiffness [N m/rad]: {text}")] if text else []


def _summaries(result: Identification) -> list[Words]:
    """Effects whose parameters are too many to be shown."""
    effects = [effect for effect in result.start.effects if effect.summary]
    texts = [", ".join(f"{name} {value} {unit}".rstrip() for name, value, unit in e.summary) for e in effects]
    return [
        Words(f"{e.label}: {text}; coefficients in the robot file", "note")
        for e, text in zip(effects, texts, strict=True)
    ]


def stiffness(compliance: float, error: float) -> str:
    """Stiffness [N m/rad] of a compliance [urad/(N m)], or the least it can be where zero compliance is possible."""
    if compliance <= 1.96 * error:
        return f"above {1e6 / (compliance + 1.96 * error):.2g} (rigid is possible)"
    return f"{1e6 / compliance:.3g}"


def held_table(result: Identification) -> Table | Words:
    """What could not be identified, and why."""
    rows = [(r["name"], r["reason"]) for r in _parameters(result) if r["status"] == "not identifiable"]
    if not rows:
        return Words("Every parameter was identified.")
    return Table("Not identifiable: held at nominal", ("parameter", "why"), rows)


def correlated(result: Identification, most: int = 8) -> list[Words]:
    """The strongest of the pairs of estimates that are correlated above 0.95, if there are any."""
    pairs = result.correlations()
    pairs = pairs[pairs[["parameter", "with"]].isin(result.start.shown).all(axis=1)]
    text = ", ".join(f"{a}/{b} {c:+.3f}" for a, b, c in pairs.head(most).itertuples(index=False))
    return [Words(f"Correlated above 0.95: {text}" + (" ..." if len(pairs) > most else ""))] if text else []
