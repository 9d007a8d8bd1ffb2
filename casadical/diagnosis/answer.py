"""A diagnosis as a table to read and as plain data to keep."""

from __future__ import annotations

from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from .diagnosis import Cause, Diagnosis
from .where import where

# Mechanical causes that leave the same signature in joint space.
SIGNATURES = {
    "gear_eccentricity": "once-per-turn error (gear, encoder disc, coupling; balancer on joint 2)",
    "transmission_ripple": "periodic error at a fixed number of cycles a turn (mesh, wave generator)",
    "joint_scale": "error that grows with the reading (ratio; eccentricity over part of a turn)",
    "joint_coupling": "error that follows another joint's reading (wrist gears, hoses)",
    "joint_zero_step": "a jump of one joint's zero",
    "thermal_growth": "links that lengthen with temperature",
    "thermal_zero_drift": "a joint's zero that follows the temperature",
    "target_shift": "a jump of the reflector in its nest",
    "payload_error": "torque errors where the payload is mounted",
    "axis_wobble": "an axis that tilts and shifts as it turns (bearing, eccentric flange)",
    "gravity_compensator": "a smooth torque on joint 2 (spring, gas balancer)",
    "nonlinear_stiffness": "deflection that saturates with torque (gear bedding in)",
    "cubic_stiffness": "deflection that grows less than the torque (hardening)",
    "backlash": "two positions, by the sign of gravity's torque",
    "friction_windup": "a lag behind the last motion",
    "link_flexure": "a link that bends under the weight beyond it",
    "base_compliance": "a foot that tilts under the overturning moment",
    "frame_drift": "a measuring frame that creeps with time",
    "outliers": "single points that are wrong",
    "bearing_play": "a bearing or flange that rocks under the weight beyond it",
    "load_hysteresis": "a lag behind the last motion that grows with the load",
    "gear_mesh": "periodic error once and twice a turn of the motor or wave generator",
    "cross_coupling": "a joint that gives way to another one's torque (parallelogram, link bending)",
    "missing_compliance": "deflection of a joint that the model takes as rigid",
    "hose_drag": "a pull at the wrist that grows as hose or cable is drawn out",
    "tracker_scale": "all lengths wrong by one factor",
    "refraction": "a beam bent by warm air",
    "smr_offset": "an offset that stays fixed against the beam",
}


def as_json(d: Diagnosis, campaign: str) -> dict[str, Any]:
    """The answer in the campaigns' format; lengths in mm, readable by any tool."""
    return {
        "campaign": campaign,
        "verdict": d.verdict,
        "gap_mm": {"before": _mm(d.gap.before), "after": _mm(d.gap.after), "floor": _mm(d.gap.floor)},
        "causes": [_cause(c) for c in d.causes],
        "unknown_rest": round(d.unknown_rest, 4),
        "where": where(d.case),
        "noise": {"sigma_mm": _mm(d.noise.sigma), "repeatability_urad": round(1e6 * d.noise.repeatability, 2)},
        "outlier_rows": list(d.outliers),
        "next_measurements": _next(d),
    }


def _next(d: Diagnosis, n: int = 10) -> list[dict[str, Any]]:
    """Poses that would tell apart what this data cannot."""
    rows = d.next_poses(n).to_dict("records")
    return [{str(k): v for k, v in row.items() if v == v and v is not None} for row in rows]


def _mm(value: float) -> float:
    return round(1e3 * value, 5)


def _cause(c: Cause) -> dict[str, Any]:
    return {
        "effect": c.effect,
        "joint": c.joint,
        "confidence": round(c.confidence, 4),
        "shrink": round(c.shrink, 4),
        "shrink_interval": [round(v, 4) for v in c.shrink_interval],
        "indistinguishable": list(c.indistinguishable),
        "parameters": {
            name: {"value": value, "std_error": error, "unit": unit}
            for name, (value, error, unit) in (c.estimates or {}).items()
        },
    }


def report(d: Diagnosis, title: str) -> RenderableType:
    """The layout that a person reads: gap, where, which, cannot tell, unknown."""
    parts: list[RenderableType] = [
        Text(title, style="bold underline"),
        Text(_gap_line(d)),
        Text(_where_line(d)),
        Text(_verdict_line(d), style="bold"),
    ]
    if d.causes:
        parts += [Text(), _cause_table(d)]
    parts += [Text(line) for line in _doubts(d)]
    return Group(*parts)


def _gap_line(d: Diagnosis) -> str:
    there = "nothing detected" if d.verdict == "none" else "detected"
    return (
        f"GAP    {1e3 * d.gap.before:.4f} mm mean, held out (noise floor {1e3 * d.gap.floor:.4f}; "
        f"{int(d.case.kept.sum())} poses); {there}, P(nothing) = {d.rankings[0].none:.2g}{_chance(d.p_nothing)}"
    )


def _chance(p: float | None) -> str:
    """A bootstrap's p-value."""
    if p is None:
        return ""
    return f", p < {p:.1g}" if p < 1e-3 else f", p = {p:.2g}"


def _where_line(d: Diagnosis) -> str:
    shares = where(d.case)
    joints = ", ".join(f"{k} {100 * v:.0f} %" for k, v in shares["joints"].items() if v >= 0.1)
    directions = ", ".join(f"{k} {100 * v:.0f} %" for k, v in shares["directions"].items())
    return f"WHERE  as joint errors: {joints or 'spread over all'}; direction: {directions}"


def _verdict_line(d: Diagnosis) -> str:
    sentence = {
        "none": "NONE: what is left is noise; no cause can be claimed.",
        "explained": "EXPLAINED",
        "ambiguous": "CANNOT TELL: something is there, but these causes look alike in this data.",
        "unknown": "UNKNOWN: something is there that no listed cause explains.",
    }[d.verdict]
    return f"WHICH  {sentence}"


def _cause_table(d: Diagnosis) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    for column, side in (("cause", "left"), ("posterior", "right"), ("gap shrinks by", "right"), ("95 %", "right")):
        table.add_column(column, justify=side, no_wrap=True)  # type: ignore[arg-type]
    table.add_column("signature")
    for c in d.causes:
        low, high = (100 * v for v in c.shrink_interval)
        table.add_row(
            c.label,
            f"{c.confidence:.3f}",
            f"{100 * c.shrink:.0f} %",
            f"{low:.0f} .. {high:.0f} %",
            SIGNATURES.get(c.effect) or (c.effects[0].physics if c.effects else ""),
        )
    return table


def _doubts(d: Diagnosis) -> list[str]:
    lines = [f"CANNOT TELL  {c.label} from {', '.join(c.indistinguishable)}" for c in d.causes if c.indistinguishable]
    if d.unknown_rest > 0.05:
        lines.append(f"UNKNOWN REST  {100 * d.unknown_rest:.0f} % of the gap is above the noise floor and unexplained")
    if d.outliers:
        shown = ", ".join(map(str, d.outliers[:10])) + (" ..." if len(d.outliers) > 10 else "")
        lines.append(f"OUTLIERS  {len(d.outliers)} poses left out: rows {shown}")
    if d.missing:
        columns = sorted({c for lacking in d.missing.values() for c in lacking})
        lines.append(f"NOT LOGGED  {', '.join(columns)}: nothing can be said about {', '.join(sorted(d.missing))}")
    return lines
