"""Metrics of a blind check, each with its 95 % interval, from hidden effects and answers.

Signal is the rms of a coordinate that the hidden effects add and the base model cannot absorb,
divided by the instrument's noise. Detection, false alarms and FIA (fault isolation accuracy) are
counted as in the DX diagnosis competitions; the other metrics are casadical's. Intervals of shares
are Wilson's score intervals (1927), those of means and quantiles come from the bootstrap (Efron
1979). The bootstrap is implemented here again, because that of the diagnosis is part of what is
judged.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from casadical.blind_check.protocol import Answer, Kind, Secret
from casadical.core.basics import Array


@dataclass(frozen=True)
class Outcome:
    """What was hidden in one campaign, and what was answered.

    name, robot : name of the campaign, and of its robot
    kind : none, one, several or unlisted
    poses : number of measured poses
    missing : quantities that were not logged; None: all were
    effects : names of the hidden effects
    truth : labels that a right answer names; empty for unlisted effects
    signal : rms of a coordinate that all effects add and the base model cannot absorb, divided by
        the instrument's noise
    signals : the same for each effect alone
    verdict : verdict of the answer: none, explained, ambiguous or unknown
    named : labels of the causes that the answer names
    alike : first named cause and up to two that the answer cannot distinguish from it
    probability : probability that the answer gives to the truth, the mean over several labels
    predicted, realised : relative reduction of the mean error by the named causes, as predicted by
        the answer and at the unseen poses
    before, after : mean error at the unseen poses [m], of the base model and with the named causes
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
    predicted: float
    realised: float
    before: float
    after: float

    @property
    def detected(self) -> bool:
        """Whether the answer reports anything."""
        return self.verdict != "none"

    @property
    def alarmed(self) -> bool:
        """Whether the answer names a cause that was not hidden, or is "ambiguous" or "unknown"."""
        return self.verdict in ("ambiguous", "unknown") or any(text not in self.truth for text in self.named)

    @property
    def claimed(self) -> bool:
        """Whether the answer claims to explain the gap, the error of the base model."""
        return self.verdict == "explained"

    @property
    def wrong_claims(self) -> tuple[str, ...]:
        """The labels of claimed causes that were not hidden."""
        return tuple(text for text in self.named if text not in self.truth) if self.claimed else ()

    @property
    def first_right(self) -> bool:
        """Whether the causes named first are the hidden ones, with their joints, in any order."""
        return bool(self.truth) and set(self.truth) <= set(self.named[: len(self.truth)])


def outcome(name: str, secret: Secret, answer: Answer) -> Outcome:
    """Return the outcome of a campaign: what it hid (secret) compared with what was answered.

    name : name of the campaign
    """
    named = tuple(dict.fromkeys(c.label for c in answer.causes))
    before, after = unseen_errors(secret, answer, "outliers" in named)
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
        predicted=1 - answer.gap_mm.after / answer.gap_mm.before,
        realised=1 - after / before,
        before=before,
        after=after,
    )


def unseen_errors(secret: Secret, answer: Answer, outliers_named: bool) -> tuple[float, float]:
    """Return the mean errors at the unseen poses [m], of the base model and with the named causes.

    If the answer names outliers, those of the instrument are excluded from the second, because they
    are no error of the robot.

    outliers_named : whether the answer names outliers
    """
    measured, true = np.array(secret.measured_mm), np.array(secret.true_mm)
    base, better = np.array(answer.unseen.base_mm), np.array(answer.unseen.with_causes_mm)
    before, after = np.linalg.norm(measured - base, axis=1), np.linalg.norm(measured - better, axis=1)
    if outliers_named:
        noise = np.abs(measured - true)
        # A coordinate beyond eight robust standard deviations is an outlier of the instrument.
        after = after[noise.max(axis=1) <= 8.0 * 1.4826 * float(np.median(noise))]
    return 1e-3 * float(before.mean()), 1e-3 * float(after.mean())


@dataclass(frozen=True)
class Estimate:
    """An estimate and its 95 % interval; without data these are None.

    value : fraction, mean or quantile
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
    p, z = count / n, NormalDist().inv_cdf(0.975)
    centre, half = p + z**2 / (2 * n), z * float(np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2)))
    low, high = ((centre + sign * half) / (1 + z**2 / n) for sign in (-1, 1))
    return Estimate(p, max(0.0, low), min(1.0, high), n, count)


def bootstrap(values: Sequence[float], statistic: Callable[[Array], Array]) -> Estimate:
    """Return a statistic of values with its bootstrap interval.

    statistic : function of arrays that reduces their last axis, along which the values are
    """
    if not len(values):
        return Estimate(None, None, None, 0)
    data = np.asarray(values, dtype=float)
    draws = statistic(data[np.random.default_rng(0).integers(0, len(data), (2000, len(data)))])
    low, high = np.quantile(draws, [0.025, 0.975])
    return Estimate(float(statistic(data)), float(low), float(high), len(data))


def mean(values: Sequence[float]) -> Estimate:
    """Return the mean with its bootstrap interval."""
    return bootstrap(values, lambda x: np.asarray(x.mean(axis=-1)))


def quantile(values: Sequence[float], q: float) -> Estimate:
    """Return the quantile of values at a probability q, 0 to 1, with its bootstrap interval."""
    return bootstrap(values, lambda x: np.asarray(np.quantile(x, q, axis=-1)))


# Smallest signal (rms over noise, see `Outcome`) of a strong effect.
STRONG_SIGNAL = 0.5
# Smallest signal of an effect that should be detected.
DETECTABLE_SIGNAL = 0.35
# Smallest signal of a faint effect; effects with a smaller one are invisible.
FAINT_SIGNAL = 0.2


def metrics(outcomes: Sequence[Outcome]) -> dict[str, tuple[Estimate, str]]:
    """Return the metrics by name, each with the project's target as text; "" for none."""
    none, one, several, off = (of_kind(outcomes, kind) for kind in ("none", "one", "several", "unlisted"))
    hidden = [t for t in outcomes if t.kind != "none"]
    pairs = [t for t in several if len(t.truth) == 2 and min(t.signals) >= DETECTABLE_SIGNAL]
    visible = [(t, text) for t in several for text, s in zip(t.truth, t.signals, strict=True) if s >= DETECTABLE_SIGNAL]
    # Answers with outliers are counted separately: their number among fifty poses is random, and
    # they are no error of the robot.
    wrong, every = shrink_errors([t for t in outcomes if "outliers" not in t.named]), shrink_errors(outcomes)
    gap_ratios = [t.after / t.before for t in detectable(outcomes) if t.kind in ("one", "several")]
    return {
        "false alarms where there is nothing": (false_alarms(none), "at most .01"),
        "detection, signal >= .5": (detection(hidden, STRONG_SIGNAL), ".99"),
        "detection, signal .35 to .5": (detection(hidden, DETECTABLE_SIGNAL, STRONG_SIGNAL), ".90"),
        "detection, signal .2 to .35": (detection(hidden, FAINT_SIGNAL, DETECTABLE_SIGNAL), ""),
        "one effect: first cause right, signal >= .35": (fraction([t.first_right for t in detectable(one)]), ""),
        "FIA: probability of the true cause, signal >= .35": (isolation(detectable(one)), ".92"),
        "FIA over all campaigns with one effect": (isolation(one), ""),
        "one effect: claims right": (claims_right(one), ".98"),
        "one effect: claims made, signal >= .35": (claims_made(detectable(one)), ".65"),
        "one effect: sets contain the truth": (
            fraction([t.truth[0] in t.alike for t in one if t.alike]),
            ".93 - .97",
        ),
        "one effect: size of the set": (mean([float(len(t.alike)) for t in one if t.alike]), ""),
        "two effects, each >= .35: both named first": (fraction([t.first_right for t in pairs]), ""),
        "several: recall of effects >= .35": (fraction([text in t.named for t, text in visible]), ".93"),
        "several: precision": (fraction([text in t.truth for t in several for text in t.named]), ".90"),
        "on no list, claimed as listed": (claims_made(off), "at most .02"),
        "on no list, any listed cause named": (fraction([bool(t.named) for t in off]), ""),
        "shrink foretold less realised, median": (quantile(wrong, 0.5), "at most .04"),
        "shrink foretold less realised, 90th percentile": (quantile(wrong, 0.9), "at most .12"),
        "the same where outliers are named too": (quantile(every, 0.9), ""),
        "listed effects, signal >= .35: share of the gap that is left, median": (quantile(gap_ratios, 0.5), ""),
    }


def of_kind(outcomes: Sequence[Outcome], kind: str) -> list[Outcome]:
    """Return the outcomes of campaigns of one kind."""
    return [t for t in outcomes if t.kind == kind]


def detectable(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Return the outcomes with a signal of at least `DETECTABLE_SIGNAL`."""
    return [t for t in outcomes if t.signal >= DETECTABLE_SIGNAL]


def false_alarms(none: Sequence[Outcome]) -> Estimate:
    """Return the fraction of false alarms, 0 to 1, among answers to campaigns that hide nothing."""
    return fraction([t.alarmed for t in none])


def detection(hidden: Sequence[Outcome], low: float, high: float = float("inf")) -> Estimate:
    """Return the fraction of detected campaigns, 0 to 1, among those with low <= signal < high.

    The signal is `Outcome.signal`.
    """
    return fraction([t.detected for t in hidden if low <= t.signal < high])


def isolation(outcomes: Sequence[Outcome]) -> Estimate:
    """Return the mean probability that answers give to the truth (fault isolation accuracy)."""
    return mean([t.probability for t in outcomes])


def claims_right(one: Sequence[Outcome]) -> Estimate:
    """Return the fraction of right claims, 0 to 1, on campaigns with one hidden effect."""
    return fraction([t.first_right for t in one if t.claimed])


def claims_made(outcomes: Sequence[Outcome]) -> Estimate:
    """Return the fraction of answers, 0 to 1, that claim an explanation."""
    return fraction([t.claimed for t in outcomes])


def shrink_errors(outcomes: Sequence[Outcome]) -> list[float]:
    """Return |predicted - realised| reduction of the error, of each answer that names a cause."""
    return [abs(t.predicted - t.realised) for t in outcomes if t.named]


def breakdown(outcomes: Sequence[Outcome]) -> dict[str, dict[str, list[Outcome]]]:
    """Return the outcomes in parts, by criterion and value.

    The criteria are poses, signal, "not logged", robot, "effect (one hidden)" and "on no list".
    """
    bands = [
        (0.0, FAINT_SIGNAL),
        (FAINT_SIGNAL, DETECTABLE_SIGNAL),
        (DETECTABLE_SIGNAL, STRONG_SIGNAL),
        (STRONG_SIGNAL, 1.0),
        (1.0, float("inf")),
    ]
    words = [*(f"{low:g} .. {high:g}" for low, high in bands[:-1]), ">= 1"]
    hidden = [t for t in outcomes if t.kind != "none"]
    return {
        "poses": _parts(outcomes, lambda t: f"{t.poses:>3}"),
        "signal": {w: [t for t in hidden if a <= t.signal < b] for w, (a, b) in zip(words, bands, strict=True)},
        "not logged": _parts(outcomes, lambda t: t.missing or "all logged"),
        "robot": _parts(outcomes, lambda t: t.robot),
        "effect (one hidden)": _parts(of_kind(outcomes, "one"), lambda t: t.effects[0]),
        "on no list": _parts(of_kind(outcomes, "unlisted"), lambda t: t.effects[0]),
    }


def _parts(outcomes: Sequence[Outcome], word: Callable[[Outcome], str]) -> dict[str, list[Outcome]]:
    """Return the outcomes grouped by the text that a function gives for each, sorted by it."""
    return {w: [t for t in outcomes if word(t) == w] for w in sorted({word(t) for t in outcomes})}


def part_metrics(part: Sequence[Outcome]) -> dict[str, Estimate]:
    """Return the metrics that are computed for each part of `breakdown`, by name."""
    one = of_kind(part, "one")
    return {
        "false alarms": false_alarms(of_kind(part, "none")),
        "detected": fraction([t.detected for t in part if t.kind != "none"]),
        "first right": fraction([t.first_right for t in one]),
        "claims right": claims_right(one),
        "FIA": isolation(one),
        "shrink error": quantile(shrink_errors([t for t in part if "outliers" not in t.named]), 0.5),
    }
