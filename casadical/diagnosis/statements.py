"""Statements and tables of a diagnosis, which the terminal's page and the HTML page both show."""

import re
from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from casadical.core.reporting.template import paragraphs, sentence
from casadical.diagnosis.candidates import columns_to_log, gathered, gathered_by_columns
from casadical.diagnosis.details import Details
from casadical.diagnosis.held_out_gap import depends_on_time
from casadical.diagnosis.isolability import cannot_tell, indistinguishable, invisible
from casadical.diagnosis.localisation import Localisation
from casadical.diagnosis.next_poses import discrimination_probability, kinds_of_poses
from casadical.diagnosis.result import Cause, Diagnosis, settings_of
from casadical.diagnosis.settings import SETTINGS
from casadical.effects import TransmissionRipple
from casadical.effects.formula_effect import INSTRUMENT_FLAG_COLUMNS
from casadical.effects.plugins import signature_of
from casadical.identification.gravity import in_words as gravity_in_words

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
        parameters = []
        for name, value in dict.fromkeys(settings):
            row = d.case.m.row[np.where(d.case.progress > value, d.case.progress, 2).argmin()]
            unit = f"of the campaign's time, from row {row}" if name == "at" else ""
            parameters.append((name, f"{value:.3g}", "", unit))
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


# Words before a statement, by its topic, where it is shown as a sentence without the topic; the
# most important topics come first.
SUBJECTS = {
    "CHECK": "",
    "NOISE": "",
    "SET": "",
    "MORE": "",
    "PRIOR": "Prior: ",
    "CANNOT": "These data cannot ",
    "UNKNOWN": "Remaining: ",
    "LAW": "Law: ",
    "AFTER": "",
    "OUT": "",
    "WHERE": "Where: ",
    "RULED": "Ruled ",
    "NEXT": "Next: ",
    "MISSING": "",
    "GRAVITY": "In the model: ",
    "ASSUMED": "Assumed: ",
}


@dataclass(frozen=True)
class Statement:
    """One statement of a diagnosis.

    about : topic: VERDICT, PRIOR, GAP, NOISE, ASSUMED, GRAVITY, CHECK, WHERE, WHICH (followed by
        the causes, see `cause_rows`), SET, MORE, AFTER, LAYERS (followed by the table of
        `layer_rows`), CANNOT, RULED, UNKNOWN, LAW, OUT, MISSING, NEXT
    text : the statement without its topic; doubtful : whether it is a warning
    """

    about: str
    text: str
    doubtful: bool = False

    @property
    def sentence(self) -> str:
        """Return the statement as a sentence without its topic."""
        text = SUBJECTS.get(self.about, "") + self.text.replace("   ", ", ")
        # The name of a column at the start is not capitalised.
        text = f"{text[0].upper()}{text[1:]}" if text.split()[0].strip(":,").isalpha() else text
        return text if text.endswith((".", ")")) else f"{text}."


def statements(d: Diagnosis, more: Details | None = None) -> list[Statement]:
    """Return all statements of a diagnosis in the order of the template statements.j2."""
    topics = paragraphs(_TEMPLATES / "statements.j2", d, more=more or Details(), **_SAYS)
    return [Statement(kind.rstrip("!"), text, kind.endswith("!")) for kind, text in topics]


def headline(d: Diagnosis, more: Details | None = None) -> str:
    """Return a sentence of the verdict, the causes and the part of the gap without a cause."""
    return sentence(_TEMPLATES / "headline.j2", d, more=more or Details(), **_SAYS)


def assumptions(d: Diagnosis) -> tuple[str, ...]:
    """Return a sentence for each assumption about missing columns and declared values."""
    return tuple(text for _, text in paragraphs(_TEMPLATES / "assumptions.j2", d, **_SAYS))


def noise(d: Diagnosis) -> str:
    """Return a phrase on a campaign's noise and the source that confirms it, else the doubt."""
    by_source = {
        "repeats": ", as large as repeated poses say",
        "declared": ", as large as declared",
        "data sheet": ", no larger than the data sheet allows",
    }
    return (d.account.form or "noise") + by_source.get(d.account.rules, ", or a form that was not tried")


def noise_hides_structure(d: Diagnosis) -> bool:
    """Return whether the estimated noise exceeds an independent figure or hides a large structure.

    The structure is large if it exceeds the error beyond the noise (rms of a coordinate).
    """
    beyond = 1e-3 * noiseless_errors(d)[1] / np.sqrt(3)
    return d.account.excess > 0 or (d.account.is_structure and d.account.structure > beyond)


def members(d: Diagnosis) -> str:
    """Return the labels of all causes as text, each with the labels indistinguishable from it."""
    at = {c.label: f" ({joints_of(c)})" for c in d.causes if c.joint is None and len(c.effects) > 1 and joints_of(c)}
    each = [names_of(d, c.label) + at.get(c.label, "") for c in d.causes]
    return "; ".join(each) if d.cause_set and d.cause_set.names else listed(each)


def names_of(d: Diagnosis, label: str) -> str:
    """Return a cause's label as text, or all its indistinguishable labels with probabilities."""
    names = d.cause_set.names.get(label, {}) if d.cause_set else {}
    return " or ".join(f"{k} ({p:.2f})" for k, p in names.items()) or label


def floor_of(d: Diagnosis, more: Details | None) -> float:
    """Return the mean held-out error by noise alone [m], of the report's best model if known."""
    return d.gap.floor if more is None or more.floor is None else more.floor


def noiseless_errors(d: Diagnosis) -> tuple[float, float, float]:
    """Return the rms held-out errors without noise of base model and with all causes [mm].

    The third item is the ratio of the latter to the former, 0 if the former is 0.
    """
    before, after = float(d.course.iloc[0]["model_mm"]), float(d.course.iloc[-1]["model_mm"])
    return before, after, after / before if before > 0 else 0.0


def readings_of(d: Diagnosis) -> str:
    """Return a phrase on the number of readings in the error of a pose; empty for a single one."""
    most = d.case.observations.stops.most
    return f", of each the norm over up to {most} readings" if most > 1 else ""


def unlogged(d: Diagnosis) -> list[int]:
    """Return the joints (1-based) whose direction of approach the first set did not log."""
    logged = d.identification.measurements[0].conditions
    return [j for j in d.identification.given.numbers if f"approach{j}" not in logged]


def wires_of(d: Diagnosis, faults: Sequence[Cause]) -> str:
    """Return as text the names of the distance sensors (wires) at fault by some causes, or "".

    faults : the causes; those at no distance sensor add no name
    """
    return listed(dict.fromkeys(w for c in faults for w in wires_at_fault(d, c)))


def largest_parts(where: Localisation) -> list[dict[Hashable, Any]]:
    """Return at most five parts of the robot with the largest fractions of the gap, from 5 % on.

    Each is a row of `Localisation.joints` or `Localisation.links` as a dict.
    """
    parts = pd.concat([where.joints, where.links])
    great = parts[(parts["share"] >= 0.05) & (parts["part"] != "elsewhere")].sort_values("share", ascending=False)
    return great.head(5).to_dict("records")


def claims_near(d: Diagnosis) -> Iterator[tuple[str, str, float]]:
    """Yield (label, "above" or "below", probability) of causes near the threshold of a claim."""
    known = 1 - SETTINGS.look_alike  # no probability of a cause is above
    members, claimed = d.cause_set.members if d.cause_set else {}, d.verdict in ("explained", "ambiguous")
    judged = {c.label: members.get(c.label, c.confidence) for c in d.causes if claimed}
    ranking, listed = d.rankings[-1], {c.label for c in d.case.candidates if c.listed}
    dropped = {k: known * ranking.probability[k] for k in ranking.order[:1] if k in listed and k not in judged}
    for label, p in {**judged, **dropped}.items():
        side = _side_of_threshold(p / known, SETTINGS.min_claim / known)
        if side and (label in judged or side == "below"):
            yield label, side, p


def detections_near(d: Diagnosis) -> Iterator[tuple[str, str, str, float, float]]:
    """Yield the detections whose probability is close to their threshold.

    Each item is the name of what is detected, that of its absence, "above" or "below", the
    probability of absence and the threshold of that.
    """
    detected = (
        (d.p_nothing is None, "an effect", "nothing", d.rankings[0].none, SETTINGS.max_p_nothing),
        (bool(d.effects()), "a further effect", "no further one", d.rankings[-1].none, SETTINGS.max_p_nothing_further),
    )
    for asked, what, name, none, least in detected:
        if asked and (side := _side_of_threshold(1 - none, 1 - least)):
            yield what, name, side, none, least


def _side_of_threshold(probability: float, threshold: float) -> str:
    """Return "above" or "below" for a probability close to a threshold, else an empty string.

    It is close if the odds differ by less than `Settings.near_threshold_odds_ratio`.
    """
    times = (1 - threshold) * probability / max(threshold * (1 - probability), 1e-300)
    near = SETTINGS.near_threshold_odds_ratio
    return "above" if 1 <= times < near else "below" if 1 / near < times < 1 else ""


def change(ratio: float) -> str:
    """Return a phrase, "12 % more" or "12 % less", for the ratio of an error to another one."""
    return f"{abs(100 * (ratio - 1)):.0f} % {'more' if ratio > 1 else 'less'}"


def ambiguous_cycles(d: Diagnosis) -> Iterator[tuple[str, float, float, float]]:
    """Yield the transmission ripples whose cycles per turn are uncertain by more than one.

    The angles of their joint span too little. Each item is a cause's label, its cycles, the
    difference of cycles that look alike, and the span of the angles [deg].
    """
    for c in d.causes:
        for e in (e for e in c.effects if isinstance(e, TransmissionRipple)):
            span = float(np.ptp(d.case.m.q[d.case.inliers, (e.joint or 1) - 1]))
            # Two sines are distinguished where their phases part by half a turn over the span.
            if span < np.pi:
                yield c.label, e.cycles, np.pi / span, float(np.rad2deg(span))


def resembles(d: Diagnosis) -> str:
    """Return the label of the unlisted form or noise that the remaining error resembles most.

    It is "" if a listed cause is the most probable, or the form's probability is below 0.5.
    """
    ranking, on_list = d.rankings[-1], {c.label for c in d.case.candidates if c.listed}
    best = ranking.order[0] if ranking.order else ""
    return "" if best in on_list or (best and ranking.probability[best] < 0.5) else best


def is_rare(d: Diagnosis, label: str) -> bool:
    """Return whether a label is that of an effect of the extended list."""
    return any(c.label == label and c.name != "unknown" for c in d.case.candidates)


def not_logged(d: Diagnosis) -> dict[str, str]:
    """Return the effects that could be judged, as text, by the columns that were not logged.

    Columns are named as a user writes them.
    """
    said = gathered_by_columns(missing_columns(d))
    logged = d.case.m.conditions
    if "temperature_degC" in logged and "time_s" not in logged:
        said["time_s"] = "how far the links lag behind temperature_degC (now taken as not at all)"
    return said


def missing_columns(d: Diagnosis) -> dict[str, tuple[str, ...]]:
    """Return the columns to log, as a table names them, by label of the effect that needs them."""
    return columns_to_log(d.missing, d.case.m.conditions)


# Folder of the Jinja templates of statements.
_TEMPLATES = Path(__file__).parent
# Values and functions, by the names under which the templates use them with the diagnosis.
_SAYS: dict[str, Any] = {
    "NEW": SETTINGS.min_change,
    "DETECT": SETTINGS.max_p_nothing,
    "CLAIM": SETTINGS.min_claim,
    "SET_CLAIM": SETTINGS.min_set,
    "MIN_GAIN": SETTINGS.min_decision_gain,
    "timed": lambda causes: any(depends_on_time(c.effects) for c in causes),
    "undeclared": lambda d: any(m.sigma is None for m in d.case.observations.sets),
    **{
        function.__name__: function
        for function in (
            mm,
            listed,
            gathered,
            cannot_tell,
            indistinguishable,
            invisible,
            discrimination_probability,
            kinds_of_poses,
            noise,
            noise_hides_structure,
            members,
            names_of,
            floor_of,
            noiseless_errors,
            readings_of,
            unlogged,
            wires_of,
            largest_parts,
            claims_near,
            detections_near,
            change,
            ambiguous_cycles,
            resembles,
            is_rare,
            not_logged,
        )
    },
    "gravity_in_words": gravity_in_words,
}
