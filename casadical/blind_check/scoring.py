"""Scoring of answers: the key is opened, checked against its published hash, and compared.

Each metric has its 95 % interval. Signal is the rms of a coordinate that the hidden effects add and
the base model cannot absorb, divided by the instrument's noise. Detection, false alarms and FIA
(fault isolation accuracy) are counted as in the DX diagnosis competitions; the other metrics are
casadical's. Intervals of shares are Wilson's score intervals (1927), those of means come from the
bootstrap (Efron 1979), which is implemented here again, because that of the diagnosis is part of
what is judged.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from casadical.blind_check.protocol import Answer, Header, Key, Kind, Secret, read_answers, read_key, read_manifest
from casadical.core.basics import InputError
from casadical.core.reporting.blocks import Block, Table, Words
from casadical.core.reporting.result import Result


@dataclass(frozen=True)
class Outcome:
    """What was hidden in one campaign, and what was answered.

    name, robot : name of the campaign, and of its robot
    kind : none, one, several or unlisted
    poses : number of measured poses
    missing : quantities that were not logged, separated by commas; None: all were
    effects : names of the hidden effects
    truth : labels that a right answer names; empty for unlisted effects and for none
    signal : rms of a coordinate that all effects add and the base model cannot absorb, divided by
        the instrument's noise
    signals : the same for each effect alone
    verdict : verdict of the answer: none, explained, ambiguous or unknown
    named : labels of the causes that the answer names
    alike : first named cause and up to two that the answer cannot distinguish from it
    probability : probability that the answer gives to the truth, the mean over several labels; if
        truth is empty, to "none" or, for unlisted effects, "unknown"
    """

    name: str
    robot: str
    kind: Kind
    poses: int
    missing: str | None
    effects: tuple[str, ...]
    truth: tuple[str, ...]
    signal: float
    signals: tuple[float, ...]
    verdict: str
    named: tuple[str, ...]
    alike: tuple[str, ...]
    probability: float

    @property
    def detected(self) -> bool:
        """Return whether the answer reports anything."""
        return self.verdict != "none"

    @property
    def alarmed(self) -> bool:
        """Return whether the answer names a cause that was not hidden, or is "ambiguous" or "unknown"."""
        return self.verdict in ("ambiguous", "unknown") or any(text not in self.truth for text in self.named)

    @property
    def claimed(self) -> bool:
        """Return whether the answer claims to explain the gap, the error of the base model."""
        return self.verdict == "explained"

    @property
    def wrong_claims(self) -> tuple[str, ...]:
        """Return the labels of claimed causes that were not hidden."""
        return tuple(text for text in self.named if text not in self.truth) if self.claimed else ()

    @property
    def first_right(self) -> bool:
        """Return whether the first causes named are those of `truth`; False if it is empty."""
        return bool(self.truth) and set(self.truth) <= set(self.named[: len(self.truth)])


def outcome(name: str, secret: Secret, answer: Answer) -> Outcome:
    """Return the outcome of a campaign: what it hid (secret) compared with what was answered.

    name : name of the campaign
    """
    named = tuple(dict.fromkeys(c.label for c in answer.causes))
    wanted = secret.truth or ("none" if secret.kind == "none" else "unknown",)
    probability = answer.probabilities
    return Outcome(
        name=name,
        robot=secret.robot,
        kind=secret.kind,
        poses=secret.poses,
        missing=secret.missing,
        effects=tuple(h.effect for h in secret.hidden),
        truth=secret.truth,
        signal=secret.visible / secret.noise,
        signals=tuple(h.visible / secret.noise for h in secret.hidden),
        verdict=answer.verdict,
        named=named,
        alike=(named[0], *answer.causes[0].alike)[:3] if named else (),
        probability=float(np.mean([probability.get(text, 0.0) for text in wanted])),
    )


@dataclass(frozen=True)
class Estimate:
    """An estimate and its 95 % interval; without data value, low and high are None.

    value : fraction or mean
    low, high : ends of its 95 % interval
    n : number of campaigns or claims
    hits : number of positive ones, for a fraction; else None
    """

    value: float | None
    low: float | None
    high: float | None
    n: int
    hits: int | None = None

    def __str__(self) -> str:
        if self.value is None:
            return "-"
        count = f"n = {self.n}" if self.hits is None else f"{self.hits} of {self.n}"
        return f"{self.value:.3f}  ({self.low:.3f} .. {self.high:.3f}; {count})"


def fraction(hits: Sequence[bool]) -> Estimate:
    """Return the fraction of true entries, 0 to 1, with Wilson's 95 % score interval."""
    n, count = len(hits), sum(map(bool, hits))
    if n == 0:
        return Estimate(None, None, None, 0, 0)
    low, high = binomtest(count, n).proportion_ci(method="wilson")
    return Estimate(count / n, float(low), float(high), n, count)


def mean(values: Sequence[float]) -> Estimate:
    """Return the mean with its 95 % bootstrap interval."""
    if not len(values):
        return Estimate(None, None, None, 0)
    data = np.asarray(values, dtype=float)
    draws = data[np.random.default_rng(0).integers(0, len(data), (2000, len(data)))].mean(axis=-1)
    low, high = np.quantile(draws, [0.025, 0.975])
    return Estimate(float(data.mean()), float(low), float(high), len(data))


# Smallest signal (rms over noise, see `Outcome`) of an effect that should be detected.
DETECTABLE_SIGNAL = 0.35


def metrics(outcomes: Sequence[Outcome]) -> dict[str, tuple[Estimate, str]]:
    """Return the metrics by description, each with the project's target as text; "" for none."""
    none, one, several, off = (
        [t for t in outcomes if t.kind == kind] for kind in ("none", "one", "several", "unlisted")
    )
    clear = [t for t in one if t.signal >= DETECTABLE_SIGNAL]
    pairs = [t for t in several if len(t.truth) == 2 and min(t.signals) >= DETECTABLE_SIGNAL]
    visible = [(t, text) for t in several for text, s in zip(t.truth, t.signals, strict=True) if s >= DETECTABLE_SIGNAL]

    def detected(low: float, high: float) -> Estimate:
        """Return the fraction of detected campaigns among those with low <= signal < high."""
        return fraction([t.detected for t in outcomes if t.kind != "none" and low <= t.signal < high])

    return {
        "false alarms where there is nothing": (fraction([t.alarmed for t in none]), "at most .01"),
        "detection, signal >= .5": (detected(0.5, float("inf")), ".99"),
        "detection, signal .35 to .5": (detected(DETECTABLE_SIGNAL, 0.5), ".90"),
        "detection, signal .2 to .35": (detected(0.2, DETECTABLE_SIGNAL), ""),
        "one effect: first cause right, signal >= .35": (fraction([t.first_right for t in clear]), ""),
        "FIA: probability of the true cause, signal >= .35": (mean([t.probability for t in clear]), ".92"),
        "FIA over all campaigns with one effect": (mean([t.probability for t in one]), ""),
        "one effect: claims right": (fraction([t.first_right for t in one if t.claimed]), ".98"),
        "one effect: claims made, signal >= .35": (fraction([t.claimed for t in clear]), ".65"),
        "one effect: sets contain the truth": (
            fraction([t.truth[0] in t.alike for t in one if t.alike]),
            ".93 - .97",
        ),
        "one effect: size of the set": (mean([float(len(t.alike)) for t in one if t.alike]), ""),
        "two effects, each >= .35: both named first": (fraction([t.first_right for t in pairs]), ""),
        "several: recall of effects >= .35": (fraction([text in t.named for t, text in visible]), ".93"),
        "several: precision": (fraction([text in t.truth for t in several for text in t.named]), ".90"),
        "on no list, claimed as listed": (fraction([t.claimed for t in off]), "at most .02"),
        "on no list, any listed cause named": (fraction([bool(t.named) for t in off]), ""),
    }


@dataclass(frozen=True, eq=False)
class Score(Result):
    """A file of answers compared with the key.

    head : header of the file of answers: the method that answered, and its versions
    key : what was hidden, and how the campaigns were made
    outcomes : comparisons of the campaigns that were answered
    """

    head: Header
    key: Key
    outcomes: tuple[Outcome, ...]

    @property
    def unanswered(self) -> list[str]:
        """Return the names of campaigns without an answer, sorted; they do not count."""
        return sorted(set(self.key.campaigns) - {t.name for t in self.outcomes})

    @property
    def metrics(self) -> dict[str, tuple[Estimate, str]]:
        """Return the metrics over all outcomes by name, each with its target as text; "" for none."""
        return metrics(self.outcomes)

    def blocks(self) -> list[Block]:
        """Return the report: metrics with targets, and every wrong claim."""
        made = ", ".join(f"{name} {number}" for name, number in self.key.versions.items())
        missing = f"; {len(self.unanswered)} more have no answer and do not count" if self.unanswered else ""
        wrong = ["Wrong claims, and what was hidden:"]
        for t in (t for t in self.outcomes if t.wrong_claims):
            hidden = ", ".join(t.truth or t.effects) or "nothing"
            wrong.append(f"  {t.name}  {t.kind:<8}  {hidden}: claimed {', '.join(t.named)}  (signal {t.signal:.2f})")
        return [
            Words(
                f"{len(self.outcomes)} campaigns whose effect was withheld (engine: {self.key.reality}, "
                f"seed {self.key.seed}; {made}){missing}\nkey as published: sha256 {self.head.key_sha256}"
            ),
            Table("", ["", self.head.by, "target"], [[n, str(e), aim] for n, (e, aim) in self.metrics.items()]),
            *map(Words, wrong if len(wrong) > 1 else ["No wrong claims."]),
        ]

    def to_json(self) -> dict[str, Any]:
        """Return the score as plain data for the JSON file."""
        return {
            "by": self.head.by,
            "versions": self.head.versions,
            "made": {"seed": self.key.seed, "reality": self.key.reality, "versions": self.key.versions},
            "campaigns": len(self.outcomes),
            "unanswered": self.unanswered,
            "figures": {name: {**_short(e.__dict__), "target": aim} for name, (e, aim) in self.metrics.items()},
            "trials": [_short(t.__dict__) for t in self.outcomes],
        }


def score(folder: str | Path, key: str | Path, answers: str | Path) -> Score:
    """Return the score of answers to the campaigns in a folder, by their key.

    folder : campaigns that `make` wrote
    answers : file of answers that `predict` wrote
    Raises InputError if the key is not the published one, or the answers are to another check.
    """
    folder, path = Path(folder), Path(answers)
    manifest = read_manifest(folder)
    head, answered = read_answers(path)
    if head.key_sha256 != manifest.key_sha256:
        raise InputError(f"{path}: answers another check than the one in {folder}; predict that one first")
    opened = read_key(Path(key), manifest)
    outcomes = tuple(outcome(name, s, answered[name]) for name, s in opened.campaigns.items() if name in answered)
    if not outcomes:
        raise InputError(f"{path}: answers no campaign of {folder}")
    return Score(head, opened, outcomes)


def _short(value: Any) -> Any:
    """Return plain data with floats rounded to six significant digits."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: _short(entry) for key, entry in value.items()}
    return [_short(v) for v in value] if isinstance(value, Sequence) and not isinstance(value, str) else value
