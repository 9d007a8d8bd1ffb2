"""Tables of a diagnosis: its causes and their signatures, and its error layer by layer."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadical.diagnosis.result import Cause, Diagnosis, settings_of
from casadical.effects.formula_effect import INSTRUMENT_FLAG_COLUMNS
from casadical.effects.plugins import signature_of

# Factor and unit in which values of an SI unit are shown, by SI unit.
READABLE_UNITS = {"rad": (1e6, "urad"), "m": (1e6, "um"), "m/m": (1e6, "um/m"), "rad/rad": (1e6, "urad/rad")}
READABLE_UNITS |= {"rad/K": (1e6, "urad/K"), "1/K": (1e6, "1e-6/K"), "1/m": (1e6, "um/m^2"), "kg/kg": (1e2, "%")}


@dataclass(frozen=True)
class CauseRow:
    """One cause as text for a table.

    shown : signature, how it appears in the data; named : label and possible mechanical reasons
    gap : held-out error without it and with it alone [mm], "0.127 -> 0.071"; for outliers the mean
        error with them, because removing rows is no remedy
    shrinks : 95 % interval of the percentage by which the gap shrinks
    parameters : (name, value, standard error, unit); the standard error is empty for settings
    """

    cause: Cause
    shown: str
    named: str
    gap: str
    shrinks: str
    parameters: tuple[tuple[str, str, str, str], ...]


def cause_rows(d: Diagnosis) -> list[CauseRow]:
    """Return a row of texts for each cause of a diagnosis, the largest shrink first."""
    rows, alone = [], sum(bool(c.effects) for c in d.causes) == 1
    for c in d.causes:
        words = "single points that are wrong" if c.effect == "outliers" else signature_of(c.effect)
        if c.effects:
            words = words or c.effects[0].signature or c.effects[0].physics
        shown, _, mechanical = words.partition(" (")
        shown = ", ".join(filter(None, [shown, joints_of(c)]))
        if f"gravity_compensator@{c.joint}" not in {k.label for k in d.case.candidates}:
            mechanical = mechanical.replace("; balancer on the shoulder", "")
        mechanical = mechanical.rstrip(")")
        after = d.gap.after if alone else d.gap.without_outliers * (1 - c.shrink)
        low, high = (100 * v for v in c.shrink_interval)
        settings = [setting for e in c.effects for setting in settings_of(e).items()]
        parameters = [(name, f"{value:.3g}", "", "") for name, value in dict.fromkeys(settings)]
        parameters += [(name, value, "", unit) for e in c.effects for name, value, unit in e.summary]
        parameters += [_estimate(name, *given) for name, given in (c.estimates or {}).items()]
        if c.effect == "outliers":
            few = ", ".join(str(o.row) for o in d.outliers[:10])
            parameters = [("rows", few + (" ..." if len(d.outliers) > 10 else ""), "", "")]
        rows.append(
            CauseRow(
                c,
                "; ".join([shown, *(f"{which}: {sizes}" for which, sizes in wires_at_fault(d, c).items())]),
                f"{c.label}; may be {mechanical}" if mechanical else c.label,
                f"{mm(d.gap.without_outliers)} -> {mm(after)}" if c.effects else f"{mm(d.gap.before)} with them",
                f"{low:.0f} to {high:.0f} %" if c.effects else "excluded",
                tuple(parameters),
            )
        )
    return rows


def wires_at_fault(d: Diagnosis, c: Cause) -> dict[str, str]:
    """Return an instrument cause's parameters as text, by distance instrument (table and anchor).

    Instruments without a parameter more than three standard errors from zero are omitted; {} is
    returned for causes of the robot.
    """
    if not c.of_instrument:
        return {}
    words: dict[str, list[str]] = {}
    clear: dict[str, float] = {}
    for name, (value, error, unit) in (c.estimates or {}).items():
        if part := re.fullmatch(r"(\D+)(\d)", name):
            for m in d.case.observations.sets:
                here = m.conditions.get(INSTRUMENT_FLAG_COLUMNS[int(part[2]) - 1], np.zeros(len(m))) > 0
                if here.any():
                    anchors = [*np.unique(m.label[here])] if m.label is not None else []
                    which = " ".join([m.source or f"wire {part[2]}", *map(str, anchors)])
                    words.setdefault(which, []).append("{} {} +- {} {}".format(*_estimate(part[1], value, error, unit)))
                    clear[which] = max(clear.get(which, 0.0), abs(value) / error)
    # An instrument is named if one of its parameters is more than three standard errors from zero.
    return {which: ", ".join(own) for which, own in words.items() if clear[which] > 3.0}


def joints_of(c: Cause) -> str:
    """Return the joints at which a cause acts as text, "joints 2 and 3"; empty if at none."""
    joints = dict.fromkeys(str(e.joint) for e in c.effects if e.joint) if c.joint is None else [str(c.joint)]
    return f"joint{'s' * (len(joints) > 1)} {listed(joints)}" if joints else ""


def listed(words: Iterable[str]) -> str:
    """Return words separated by commas, with "and" before the last; "" for none."""
    *first, last = [*words] or [""]
    return f"{', '.join(first)} and {last}" if first else last


def _estimate(name: str, value: float, error: float, unit: str) -> tuple[str, str, str, str]:
    """Return name, value, standard error and unit as text; lengths from 1 mm on are in mm."""
    size = max(abs(value), error)
    factor, word = (1e3, "mm") if unit == "m" and size >= 1e-3 else READABLE_UNITS.get(unit, (1.0, unit))
    return name, f"{factor * value:.3g}", f"{factor * error:.2g}", word


def mm(metres: float) -> str:
    """Return a length [m] as text in millimetres, to three decimals from 10 um on, else four."""
    return f"{1e3 * metres:.3f}" if metres >= 1e-5 else f"{1e3 * metres:.4f}"


# Titles of the columns of `layer_rows`.
LAYER_COLUMNS = ("layer", "mean", "95 %", "time excluded", "without noise")


def layers(d: Diagnosis, floor: float | None = None) -> list[dict[str, Any]]:
    """Return the held-out error after each added cause as dicts; [] if no cause has effects.

    name : the base model, the added cause, or the noise, in words
    mean_mm, low_mm, high_mm : mean error on held-out poses with a 95 % interval over poses
    blocks_mm : the same with fifths of the time excluded; model_mm : rms without noise
    The last dict is the error of noise alone.
    floor : that error [m]; None: that of the diagnosis
    """
    if not d.effects():
        return []
    whole, r = any(c.effect == "outliers" for c in d.causes), d.replicates
    taken: list[dict[str, Any]] = [{"name": "as calibrated, outliers in", "mean_mm": 1e3 * d.gap.before}] * whole
    for k, row in enumerate(d.course.to_dict("records")):
        name = str(row["model"]) if k else "outliers excluded" if whole else "as calibrated"
        figures = {key: float(row[key]) for key in ("low_mm", "high_mm", "blocks_mm", "model_mm")}
        taken.append({"name": name, "mean_mm": float(row["gap_mm"]), **figures})
    noise = f"noise of {r.poses} repeated poses" if r.enough else "noise as the fit has it"
    taken.append({"name": noise, "mean_mm": 1e3 * (d.gap.floor if floor is None else floor)})
    return [{k: round(v, 5) if isinstance(v, float) else v for k, v in layer.items()} for layer in taken]


def layer_rows(d: Diagnosis, floor: float | None = None) -> list[tuple[str, ...]]:
    """Return the dicts of `layers` as rows of text under `LAYER_COLUMNS`; floor : see `layers`."""
    forms = ("{name}", "{mean_mm:.3f}", "{low_mm:.3f} to {high_mm:.3f}", "{blocks_mm:.3f}", "{model_mm:.3f}")
    every = layers(d, floor)
    return [tuple(f.format(**a) if k < 2 or "low_mm" in a else "" for k, f in enumerate(forms)) for a in every]
