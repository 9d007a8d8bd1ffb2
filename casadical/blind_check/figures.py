"""The figures of a blind check, each with its interval; the one place where they are defined.

Signal is the rms of a coordinate that the hidden effects add and the base model cannot absorb, over the instrument's
noise. Detection, false alarms and FIA are counted as in the DX diagnosis competitions; the others are ours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from casadical.blind_check.intervals import Figure, mean, quantile, share
from casadical.blind_check.trials import Trial

STRONG, SEEN, FAINT = 0.5, 0.35, 0.2


@dataclass(frozen=True)
class Row:
    """A figure by name, and what the project aims at."""

    name: str
    figure: Figure
    target: str = ""


def figures(trials: Sequence[Trial]) -> list[Row]:
    """All figures of a set of trials."""
    none, one, several, off = (of_kind(trials, kind) for kind in ("none", "one", "several", "unlisted"))
    hidden = [t for t in trials if t.kind != "none"]
    return [
        Row("false alarms where there is nothing", false_alarms(none), "at most .01"),
        Row("detection, signal >= .5", detection(hidden, STRONG), ".99"),
        Row("detection, signal .35 to .5", detection(hidden, SEEN, STRONG), ".90"),
        Row("detection, signal .2 to .35", detection(hidden, FAINT, SEEN)),
        Row("one effect: first cause right, signal >= .35", share([t.first_right for t in seen(one)])),
        Row("FIA: probability of the true cause, signal >= .35", isolation(seen(one)), ".92"),
        Row("FIA over all campaigns with one effect", isolation(one)),
        Row("one effect: claims right", claims_right(one), ".98"),
        Row("one effect: claims made, signal >= .35", claims_made(seen(one)), ".65"),
        Row("one effect: sets contain the truth", sets_right(one), ".93 - .97"),
        Row("one effect: size of the set", mean([float(len(t.alike)) for t in one if t.alike])),
        Row("two effects, each >= .35: both named first", share([t.first_right for t in _seen_pairs(several)])),
        Row("several: recall of effects >= .35", recall(several), ".93"),
        Row("several: precision", precision(several), ".90"),
        Row("on no list, claimed as listed", claims_made(off), "at most .02"),
        Row("on no list, any listed cause named", share([bool(t.named) for t in off])),
        *_shrink(trials),
    ]


def of_kind(trials: Sequence[Trial], kind: str) -> list[Trial]:
    return [t for t in trials if t.kind == kind]


def seen(trials: Sequence[Trial]) -> list[Trial]:
    """Those whose signal can be expected to be found."""
    return [t for t in trials if t.signal >= SEEN]


def false_alarms(none: Sequence[Trial]) -> Figure:
    """Answers that say there is something which is not."""
    return share([t.alarmed for t in none])


def detection(hidden: Sequence[Trial], low: float, high: float = float("inf")) -> Figure:
    """Of signals from low to high, those answered by anything but none."""
    return share([t.detected for t in hidden if low <= t.signal < high])


def isolation(trials: Sequence[Trial]) -> Figure:
    """FIA: mean probability given to the truth."""
    return mean([t.probability for t in trials])


def claims_right(one: Sequence[Trial]) -> Figure:
    """Of the answers that say what it is, those that are right."""
    return share([t.first_right for t in one if t.claimed])


def claims_made(trials: Sequence[Trial]) -> Figure:
    return share([t.claimed for t in trials])


def sets_right(one: Sequence[Trial]) -> Figure:
    """Of the sets that are given, those that contain the truth."""
    return share([t.truth[0] in t.alike for t in one if t.alike])


def recall(several: Sequence[Trial], least: float = SEEN) -> Figure:
    """Of the effects whose own signal is as large as this, those that are named."""
    visible = [(t, text) for t in several for text, s in zip(t.truth, t.signals, strict=True) if s >= least]
    return share([text in t.named for t, text in visible])


def precision(several: Sequence[Trial]) -> Figure:
    """Of the causes that are named, those that are there."""
    return share([text in t.truth for t in several for text in t.named])


def _seen_pairs(several: Sequence[Trial]) -> list[Trial]:
    return [t for t in several if len(t.truth) == 2 and min(t.signals) >= SEEN]


def _shrink(trials: Sequence[Trial]) -> list[Row]:
    """How far the gap shrinks at poses that no fit saw, and how well that was predicted; where a cause was named."""
    # The number of outliers among fifty poses is random, and no robot's error; they are counted separately.
    wrong, every = shrink_errors([t for t in trials if "outliers" not in t.named]), shrink_errors(trials)
    return [
        Row("shrink foretold less realised, median", quantile(wrong, 0.5), "at most .04"),
        Row("shrink foretold less realised, 90th percentile", quantile(wrong, 0.9), "at most .12"),
        Row("the same where outliers are named too", quantile(every, 0.9)),
        Row(
            "listed effects, signal >= .35: share of the gap that is left, median",
            quantile([t.left for t in seen(trials) if t.kind in ("one", "several")], 0.5),
        ),
    ]


def shrink_errors(trials: Sequence[Trial]) -> list[float]:
    """By how much the gap shrinks less or more than predicted, where a cause is named."""
    return [abs(t.predicted - t.realised) for t in trials if t.named]


def bands(trials: Sequence[Trial]) -> dict[str, dict[str, list[Trial]]]:
    """Trials in parts: by poses, signal, column that was not logged, robot, and effect."""
    edges = [(0.0, FAINT), (FAINT, SEEN), (SEEN, STRONG), (STRONG, 1.0), (1.0, float("inf"))]
    hidden = [t for t in trials if t.kind != "none"]
    return {
        "poses": _parts(trials, lambda t: f"{t.poses:>3}"),
        "signal": {_band(a, b): [t for t in hidden if a <= t.signal < b] for a, b in edges},
        "not logged": _parts(trials, lambda t: t.missing or "all logged"),
        "robot": _parts(trials, lambda t: t.robot),
        "effect (one hidden)": _parts(of_kind(trials, "one"), lambda t: t.effects[0]),
        "on no list": _parts(of_kind(trials, "unlisted"), lambda t: t.effects[0]),
    }


def _parts(trials: Sequence[Trial], word: Callable[[Trial], str]) -> dict[str, list[Trial]]:
    return {w: [t for t in trials if word(t) == w] for w in sorted({word(t) for t in trials})}


def _band(low: float, high: float) -> str:
    return f">= {low:g}" if high == float("inf") else f"{low:g} .. {high:g}"


def part_figures(part: Sequence[Trial]) -> dict[str, Figure]:
    """The figures that are worth telling of a part."""
    one = of_kind(part, "one")
    return {
        "false alarms": false_alarms(of_kind(part, "none")),
        "detected": share([t.detected for t in part if t.kind != "none"]),
        "first right": share([t.first_right for t in one]),
        "claims right": claims_right(one),
        "FIA": isolation(one),
        "shrink error": quantile(shrink_errors([t for t in part if "outliers" not in t.named]), 0.5),
    }


def confusion(trials: Sequence[Trial]) -> dict[str, dict[str, int]]:
    """What was hidden (rows) against what was answered first, in campaigns with at most one effect."""
    table: dict[str, dict[str, int]] = {}
    for t in trials:
        if t.kind != "several":
            row = table.setdefault(t.effects[0] if t.effects else "none", {})
            row[answered(t)] = row.get(answered(t), 0) + 1
    return table


def answered(t: Trial) -> str:
    """The word of an answer: none, unknown, an effect, or the right effect at another joint."""
    if t.verdict in ("none", "unknown") or not t.named:
        return t.verdict if t.verdict in ("none", "unknown") else "unknown"
    word = t.named[0].partition("@")[0]
    return "at another joint" if t.truth and word == t.effects[0] and t.named[0] != t.truth[0] else word
