"""What a diagnosis says: the statements and rows that the terminal and the page of HTML both show."""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from casadical.core.telling.template import paragraphs, sentence
from casadical.diagnosis.candidates import columns_to_log, gathered, gathered_by_columns
from casadical.diagnosis.cause_table import joints_of, listed, mm, wires_at_fault
from casadical.diagnosis.changes import MIN_CHANGE_PROBABILITY
from casadical.diagnosis.details import Details
from casadical.diagnosis.held_out_gap import of_time
from casadical.diagnosis.isolability import cannot_tell, indistinguishable, invisible
from casadical.diagnosis.localisation import Localisation
from casadical.diagnosis.next_poses import discrimination_probability, kinds_of_poses
from casadical.diagnosis.noise_account import Rule
from casadical.diagnosis.result import Cause, Diagnosis
from casadical.diagnosis.settings import SETTINGS
from casadical.identification.gravity import in_words as gravity_in_words

# Of the probability that a decision stands on: it is said to be just above or below its threshold where the odds
# against it are at most so many times those of the threshold, or the reverse.
NEAR_THRESHOLD_ODDS_RATIO = 1.5
# Poses that raise the probability of a right choice by less tell nothing.
MIN_DECISION_GAIN = 0.1
# Words before what is said about something, where it is a sentence of its own; the most important first.
SUBJECTS = {
    "CHECK": "", "NOISE": "", "SET": "", "MORE": "", "PRIOR": "Prior: ", "CANNOT": "These data cannot ",
    "UNKNOWN": "Left: ", "LAW": "Law: ", "AFTER": "", "OUT": "", "WHERE": "Where: ", "RULED": "Ruled ",
    "NEXT": "Next: ", "MISSING": "", "GRAVITY": "In the model: ", "ASSUMED": "Assumed: ",
}  # fmt: skip


@dataclass(frozen=True)
class Statement:
    """One statement.

    about : VERDICT, PRIOR, GAP, NOISE, ASSUMED, GRAVITY, CHECK, WHERE, WHICH (then come the causes, see `cause_rows`),
        SET, MORE, AFTER, LAYERS (then come these, see `layer_rows`), CANNOT, RULED, UNKNOWN, LAW, OUT, MISSING, NEXT
    doubtful : whether it is a warning
    """

    about: str
    text: str
    doubtful: bool = False

    @property
    def sentence(self) -> str:
        """It without its label, as pages and the short answer have it."""
        text = SUBJECTS.get(self.about, "") + self.text.replace("   ", ", ")
        text = f"{text[0].upper()}{text[1:]}" if text.split()[0].strip(":,").isalpha() else text  # no column's name
        return text if text.endswith((".", ")")) else f"{text}."


def statements(d: Diagnosis, more: Details | None = None) -> list[Statement]:
    """Return all statements in the order in which a reader wants them (statements.j2)."""
    told = paragraphs(_TEMPLATES / "statements.j2", d, more=more or Details(), **_SAYS)
    return [Statement(kind.rstrip("!"), text, kind.endswith("!")) for kind, text in told]


def headline(d: Diagnosis, more: Details | None = None) -> str:
    """Return the verdict in a sentence: causes, and how much of the gap they leave without a cause."""
    return sentence(_TEMPLATES / "headline.j2", d, more=more or Details(), **_SAYS)


def assumptions(d: Diagnosis) -> tuple[str, ...]:
    """Return what a missing column or a declared value was taken for, and what of it is in the comparison."""
    return tuple(text for _, text in paragraphs(_TEMPLATES / "assumptions.j2", d, **_SAYS))


def noise(d: Diagnosis) -> str:
    """What the remainder of a campaign without causes is."""
    known = {
        Rule.REPEATS: ", as large as repeated poses say", Rule.DECLARED: ", as large as declared",
        Rule.SHEET: ", no larger than the data sheet allows",
    }  # fmt: skip
    return (d.account.form or "noise") + known.get(d.account.rules, ", or a form that was not tried")


def hidden(d: Diagnosis) -> bool:
    """Whether more of the remainder is structure that was taken as noise than lies beyond the noise."""
    beyond = 1e-3 * left_over(d)[1] / np.sqrt(3)
    return d.account.excess > 0 or (d.account.is_structure and d.account.structure > beyond)


def members(d: Diagnosis) -> str:
    """The causes; one that these data do not tell from others with all their names, each with its probability."""
    at = {c.label: f" ({joints_of(c)})" for c in d.causes if c.joint is None and len(c.effects) > 1 and joints_of(c)}
    each = [names_of(d, c.label) + at.get(c.label, "") for c in d.causes]
    return "; ".join(each) if d.cause_set and d.cause_set.names else listed(each)


def names_of(d: Diagnosis, label: str) -> str:
    """A cause's label, or all its names."""
    names = d.cause_set.names.get(label, {}) if d.cause_set else {}
    return " or ".join(f"{k} ({p:.2f})" for k, p in names.items()) or label


def floor_of(d: Diagnosis, more: Details | None) -> float:
    """What noise alone would leave beside the best model that is told [m]."""
    return d.gap.floor if more is None or more.floor is None else more.floor


def left_over(d: Diagnosis) -> tuple[float, float, float]:
    """Error of the model without the noise, rms [mm]: of the base model, with all causes, and the share left of it."""
    before, after = float(d.course.iloc[0]["model_mm"]), float(d.course.iloc[-1]["model_mm"])
    return before, after, after / before if before > 0 else 0.0


def readings_of(d: Diagnosis) -> str:
    """Of how many readings the error of a pose is the norm, where several tables have readings of one pose."""
    most = d.case.observations.stops.most
    return f", of each the norm over up to {most} readings" if most > 1 else ""


def unlogged(d: Diagnosis) -> list[int]:
    """Return the joints of which no table says from where they came to a pose."""
    logged = d.identification.measurements[0].conditions
    return [j for j in d.identification.given.numbers if f"approach{j}" not in logged]


def wires_of(d: Diagnosis, faults: Sequence[Cause]) -> str:
    """Return the wires that faults of the instrument are of; "" where these are of no wire."""
    return listed(dict.fromkeys(w for c in faults for w in wires_at_fault(d, c)))


def great_parts(where: Localisation) -> list[dict[Hashable, Any]]:
    """Return the five parts of the robot with the greatest shares of the gap, from 5 % on."""
    parts = pd.concat([where.joints, where.links])
    great = parts[(parts["share"] >= 0.05) & (parts["part"] != "elsewhere")].sort_values("share", ascending=False)
    return great.head(5).to_dict("records")


def claims_near(d: Diagnosis) -> Iterator[tuple[str, str, float]]:
    """Yield causes whose probability is hardly above or below that of a claim: label, side, probability."""
    members, claimed = d.cause_set.members if d.cause_set else {}, d.verdict in ("explained", "ambiguous")
    judged = {c.label: members.get(c.label, c.confidence) for c in d.causes if claimed}
    ranking, listed = d.rankings[-1], {c.label for c in d.case.candidates if c.listed}
    dropped = {k: ranking.probability[k] for k in ranking.order[:1] if k in listed and k not in judged}
    for label, p in {**judged, **dropped}.items():
        if (side := _beside(p, SETTINGS.min_claim)) and (label in judged or side == "below"):
            yield label, side, p


def detections_near(d: Diagnosis) -> Iterator[tuple[str, str, str, float, float]]:
    """Yield detections that are hardly above or below their threshold.

    Each with what is there, the name of nothing, the side, the probability of nothing and its threshold.
    """
    detected = (
        (d.p_nothing is None, "anything", "nothing", d.rankings[0].none, SETTINGS.max_p_nothing),
        (bool(d.effects()), "something further", "no further one", d.rankings[-1].none, SETTINGS.max_p_nothing_further),
    )
    for asked, what, name, none, least in detected:
        if asked and (side := _beside(1 - none, 1 - least)):
            yield what, name, side, none, least


def _beside(probability: float, threshold: float) -> str:
    """Whether a probability is just above or below a threshold; empty where it is far from it."""
    times = (1 - threshold) * probability / max(threshold * (1 - probability), 1e-300)
    return (
        "above"
        if 1 <= times < NEAR_THRESHOLD_ODDS_RATIO
        else "below"
        if 1 / NEAR_THRESHOLD_ODDS_RATIO < times < 1
        else ""
    )


def change(ratio: float) -> str:
    """An error beside another one on the same poses."""
    return f"{abs(100 * (ratio - 1)):.0f} % {'more' if ratio > 1 else 'less'}"


def resembles(d: Diagnosis) -> str:
    """Return the form on no list that the rest looks most like; "" where a listed cause comes first."""
    ranking, on_list = d.rankings[-1], {c.label for c in d.case.candidates if c.listed}
    best = ranking.order[0] if ranking.order else ""
    return "" if best in on_list or (best and ranking.probability[best] < 0.5) else best


def not_logged(d: Diagnosis) -> dict[str, str]:
    """Columns as a user writes them -> what could be judged if they were logged."""
    said = gathered_by_columns(missing_columns(d))
    logged = d.case.m.conditions
    if "temperature_degC" in logged and "time_s" not in logged:
        said["time_s"] = "how far the links lag behind temperature_degC (now taken as not at all)"
    return said


def missing_columns(d: Diagnosis) -> dict[str, tuple[str, ...]]:
    """Effect that cannot be judged -> columns to log for it, as a table names them."""
    return columns_to_log(d.missing, d.case.m.conditions)


def gain_of(d: Diagnosis, poses: pd.DataFrame) -> float:
    """How much more probable the right answer becomes by poses of `next_poses`."""
    before, after = discrimination_probability(d, poses)
    return after - before


_TEMPLATES = Path(__file__).parent
# What the templates ask for beside the diagnosis.
_SAYS: dict[str, Any] = {
    "NEW": MIN_CHANGE_PROBABILITY,
    "DETECT": SETTINGS.max_p_nothing,
    "CLAIM": SETTINGS.min_claim,
    "SET_CLAIM": SETTINGS.min_set,
    "LITTLE": MIN_DECISION_GAIN,
    "timed": lambda causes: any(of_time(c.effects) for c in causes),
    "rare": lambda d, label: any(c.label == label and c.name != "unknown" for c in d.case.candidates),
    "undeclared": lambda d: any(m.sigma is None for m in d.case.observations.sets),
    **{
        function.__name__: function
        for function in (
            mm, listed, gathered, cannot_tell, indistinguishable, invisible, discrimination_probability, kinds_of_poses,
            noise, hidden, members, names_of, floor_of, left_over, readings_of, unlogged, wires_of, great_parts,
            claims_near, detections_near, change, resembles, not_logged,
        )
    },
    "gravity_in_words": gravity_in_words,
}  # fmt: skip
