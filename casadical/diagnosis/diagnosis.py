"""Diagnose what is left after calibration: the verdict, its causes, and how far the gap shrinks without them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pandas as pd

from ..effects import Effect
from ..identification import Identification, identify
from ..measurements import Measurements
from ..robot import Robot
from ..transforms import Array
from .bootstrap import p_value
from .case import Case, make_case
from .gap import Noise, estimates, held_out_errors, random_folds, remainders, shrink_interval
from .library import Candidate, candidates_of
from .next_poses import next_poses
from .refine import refined
from .which import Ranking, rank

Verdict = Literal["none", "explained", "ambiguous", "unknown"]
Show = Callable[[str], None]

# A cause is claimed alone from this probability on.
CLAIM = 0.90
# Something is there if "nothing" is less probable than this, at first and once a cause was found. Noise alone falls below
# the first in 0.1 to 1 % of 2000 bootstrap draws, by robot (practice campaigns without an effect).
DETECT, DETECT_FURTHER = 0.02, 0.05
# With a bootstrap: something is there if noise alone looks as much like it this often at most.
FALSE_ALARMS = 0.01
# Squared Mahalanobis distance of three coordinates beyond which a pose is an outlier, and below which it is none.
OUT, IN = 75.0, 40.0
# A further cause is taken up from this probability on, among those that are there.
LEAST_FURTHER = 0.8
MOST_CAUSES = 4
SET_SHARE, SET_SIZE = 0.97, 3
PARTITIONS = 5
# Less than this share of what could be explained is no explanation.
LEAST_SHARE = 0.5


@dataclass(frozen=True)
class Gap:
    """Mean position error on poses held out from the fit [m]: base model, with the causes, and the noise floor."""

    before: float
    after: float
    floor: float


@dataclass(frozen=True, eq=False)
class Cause:
    """One cause.

    effect, joint : its name and 1-based joint or None; confidence : its posterior probability
    shrink, shrink_interval : share by which the held-out gap falls when it is added, with a 95 % interval
    indistinguishable : labels (name or name@joint) that this data cannot tell from it
    effects : the symbolic effects with their most likely settings
    estimates : parameter -> (value, standard error, unit) [SI]
    """

    effect: str
    joint: int | None
    confidence: float
    shrink: float
    shrink_interval: tuple[float, float]
    indistinguishable: tuple[str, ...]
    effects: tuple[Effect, ...] = ()
    estimates: dict[str, tuple[float, float, str]] | None = None

    @property
    def label(self) -> str:
        return self.effect if self.joint is None else f"{self.effect}@{self.joint}"


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The answer to: why is there still a gap?

    verdict : none, explained, ambiguous, unknown; causes : the largest shrink first
    gap : held-out, before and after the causes; noise : instrument and joint repeatability
    unknown_rest : share of the gap that is there to be explained and that no named cause explains
    rankings : what each step saw; outliers : rows of the table that were left out
    missing : label -> columns that would be needed to speak about it
    p_nothing : how often noise alone would look as much like some cause; None without a bootstrap
    """

    verdict: Verdict
    causes: tuple[Cause, ...]
    gap: Gap
    noise: Noise
    unknown_rest: float
    rankings: tuple[Ranking, ...]
    outliers: tuple[int, ...]
    missing: dict[str, tuple[str, ...]]
    case: Case
    identification: Identification
    p_nothing: float | None = None

    @property
    def in_question(self) -> tuple[str, ...]:
        """Labels that further poses should tell apart: a set that looks alike, or the leading cause and its rival."""
        for cause in self.causes:
            if cause.indistinguishable and cause.label in self.rankings[0].probability:
                return (cause.label, *cause.indistinguishable)
        order = [k for k in self.rankings[-1].order if k in self.rankings[0].probability]
        return tuple(order[:2]) if self.verdict in ("ambiguous", "unknown") else ()

    def next_poses(self, n: int, seed: int = 0) -> pd.DataFrame:
        """The n poses that best tell apart what this data cannot (see `next_poses.next_poses`); empty if nothing is."""
        labels = self.in_question
        return next_poses(self.case, labels, n, seed) if len(labels) > 1 else pd.DataFrame()

    def apply(self, top: int | None = None) -> Robot:
        """The robot that was given, with the first `top` causes' effects in its model (all by default)."""
        effects = [e for c in self.causes[:top] for e in c.effects]
        return self.identification.given.with_effect(*effects)


def diagnose(
    robot: Robot,
    m: Measurements,
    effects: Sequence[str | Effect] | Literal["standard", "extended"] = "standard",
    *,
    seed: int = 0,
    bootstrap: int = 0,
    show: Show = lambda _text: None,
) -> Diagnosis:
    """Calibrate the base model on a campaign and diagnose what is left.

    robot : nominal model, with the compliances that it should have; m : one set of measured positions
    effects : "standard" or "extended", or names (backlash), labels (backlash@5) and own effects
    seed : of the partitions into folds and of the bootstrap; show : called with a line of progress
    bootstrap : draws of noise alone that calibrate whether something is there (2000 take some seconds); 0 for none

    Raises InputError where the measurements cannot carry a diagnosis.
    """
    show("calibrating the base model")
    identification = identify(robot, m, ("kinematic", "compliance"), loss="huber", priors=True, screen=False)
    return diagnose_identification(identification, effects, seed=seed, bootstrap=bootstrap, show=show)


def diagnose_identification(
    identification: Identification,
    effects: Sequence[str | Effect] | Literal["standard", "extended"] = "standard",
    *,
    seed: int = 0,
    bootstrap: int = 0,
    show: Show = lambda _text: None,
) -> Diagnosis:
    """Diagnose what an identification left on its own measurements; arguments as of `diagnose`."""
    robot = identification.given
    show("signatures of the candidates")
    case = make_case(identification, candidates_of(robot, effects))
    return _Investigation(identification, case, seed, bootstrap, show).conclude()


@dataclass
class _Step:
    """A cause that was accepted, or the set at which the search stopped."""

    ranking: Ranking
    labels: tuple[str, ...]
    effects: tuple[Effect, ...]


class _Investigation:
    """The steps of one diagnosis."""

    def __init__(self, identification: Identification, case: Case, seed: int, bootstrap: int, show: Show) -> None:
        self.identification, self.case, self.seed, self.show = identification, case, seed, show
        self.bootstrap = bootstrap
        self.p_nothing: float | None = None
        self.steps: list[_Step] = []
        self.rankings: list[Ranking] = []

    @property
    def by_label(self) -> dict[str, Candidate]:
        return {c.label: c for c in self.case.candidates}

    def columns(self, steps: Sequence[_Step]) -> Array:
        parts = [self.case.group(s.effects) for s in steps]
        return np.unique(np.concatenate(parts)) if parts else np.zeros(0, dtype=np.int64)

    def variant(self, ranking: Ranking, label: str) -> tuple[Effect, ...]:
        return self.by_label[label].variants[ranking.variant[label]]

    def accepted(self, ranking: Ranking, labels: Sequence[str], beside: Sequence[_Step]) -> _Step:
        """A cause (the first of the labels) with its settings refined beside others."""
        label = labels[0]
        self.case, effects = refined(self.case, label, self.variant(ranking, label), self.columns(beside))
        return _Step(ranking, tuple(labels), effects)

    def _screen(self, noise: Noise) -> None:
        """Decide anew which poses are outliers, now that the model holds more."""
        case = self.case
        _, distance = remainders(case.whole, self.columns(self.steps), noise, case.kept)
        self.case = replace(case, kept=np.where(case.kept, distance < OUT, distance < IN))

    @property
    def folds(self) -> list[Array]:
        return [random_folds(int(self.case.kept.sum()), self.seed + k) for k in range(PARTITIONS)]

    def errors(self, columns: Array, noise: Noise) -> Array:
        """Held-out error of each pose, averaged over partitions."""
        runs = [held_out_errors(self.case.evidence, columns, noise, folds) for folds in self.folds]
        return np.asarray(np.mean(runs, axis=0))

    def ranking(self, beside: Sequence[_Step]) -> Ranking:
        return rank(self.case, self.columns(beside), frozenset(s.labels[0] for s in beside))

    def conclude(self) -> Diagnosis:
        end = "none"
        while len(self.steps) < MOST_CAUSES:
            self.show(f"cause {len(self.steps) + 1}: evidence of {len(self.by_label)} candidates")
            self.rankings.append(self.ranking(self.steps))
            end, labels = self._next(self.rankings[-1])
            if not labels:
                break
            self.steps.append(self.accepted(self.rankings[-1], labels, self.steps))
            self._screen(self.rankings[-1].noise[labels[0]])
            self._revisit()
        return self._result(end)

    def _next(self, ranking: Ranking) -> tuple[str, tuple[str, ...]]:
        """The next cause and what looks like it; or no label and why not: none, ambiguous, unknown."""
        if not self._detected(ranking):
            return "none", ()
        listed = [label for label in ranking.order if self.by_label[label].listed]
        there = 1 - ranking.none
        unknown = sum(p for label, p in ranking.probability.items() if not self.by_label[label].listed)
        if not listed or unknown > 0.5:
            return "unknown", ()
        if self.steps and ranking.probability[listed[0]] < LEAST_FURTHER * there:
            return "ambiguous", ()
        return "claimed", self._alike(ranking, listed)

    def _detected(self, ranking: Ranking) -> bool:
        """Whether there is a (further) cause, listed or not."""
        if self.steps or not self.bootstrap:
            return ranking.none <= (DETECT_FURTHER if self.steps else DETECT)
        self.p_nothing = p_value(self.case, ranking, self.bootstrap, self.seed, self.show)
        return self.p_nothing <= FALSE_ALARMS

    def _alike(self, ranking: Ranking, listed: Sequence[str]) -> tuple[str, ...]:
        """The most probable cause alone if it is certain, else with those that share the probability."""
        there = 1 - ranking.none
        if ranking.probability[listed[0]] >= CLAIM * there:
            return (listed[0],)
        total = np.cumsum([ranking.probability[label] for label in listed[:SET_SIZE]])
        return tuple(listed[: int(np.searchsorted(total, SET_SHARE * there)) + 1])

    def _revisit(self) -> None:
        """Judge each cause anew beside the others, which it was found without; a rival that is likelier replaces it."""
        for k in range(len(self.steps) if len(self.steps) > 1 else 0):
            others = self.steps[:k] + self.steps[k + 1 :]
            ranking = self.ranking(others)
            listed = [label for label in ranking.order if self.by_label[label].listed]
            if ranking.none <= DETECT_FURTHER and listed[0] == ranking.order[0]:
                self.steps[k] = self.accepted(ranking, self._alike(ranking, listed), others)

    def _result(self, end: str) -> Diagnosis:
        first = self.rankings[0]
        before = self.errors(np.zeros(0, dtype=np.int64), first.noise[""])
        noise = self._final_noise(end)
        after = self.errors(self.columns(self.steps), noise) if self.steps else before
        floor = self._floor(noise)
        causes = [self._cause(step, before) for step in self.steps]
        before_all, causes = self._with_outliers(before, noise, causes)
        causes.sort(key=lambda c: -c.shrink)
        gap = Gap(float(before_all.mean()), float(after.mean()), floor)
        verdict, rest = self._verdict(end, gap, bool(causes))
        return Diagnosis(
            verdict=verdict,
            causes=tuple(causes),
            gap=gap,
            noise=noise,
            unknown_rest=rest,
            rankings=tuple(self.rankings),
            outliers=tuple(int(self.case.m.row[i]) for i in np.flatnonzero(~self.case.kept)),
            missing=self.case.missing,
            case=self.case,
            identification=self.identification,
            p_nothing=self.p_nothing,
        )

    def _final_noise(self, end: str) -> Noise:
        """The noise that the best model in sight leaves, the unknown included."""
        last = self.rankings[-1]
        if end == "none":
            return last.noise[""]
        return last.noise[last.order[0]]

    def _floor(self, noise: Noise) -> float:
        """Mean held-out error if only noise were left: simulated through the same fit."""
        case = self.case
        rng = np.random.default_rng(self.seed)
        e = case.evidence
        draws = []
        for folds in self.folds:
            white = noise.sigma * rng.standard_normal(e.r.shape)
            joints = noise.repeatability * rng.standard_normal((len(e.r), e.Jq.shape[2], 1))
            fake = replace(e, r=white + (e.Jq @ joints)[:, :, 0], delta0=np.zeros_like(e.delta0))
            draws.append(held_out_errors(fake, np.zeros(0, dtype=np.int64), noise, folds).mean())
        return float(np.mean(draws))

    def _cause(self, step: _Step, before: Array) -> Cause:
        label = step.labels[0]
        candidate = self.by_label[label]
        columns = self.case.group(step.effects)
        alone = self.errors(columns, step.ranking.noise[label])
        rivals = [k for k in step.ranking.order if k != label and self.by_label[k].listed]
        alike = tuple(k for k in rivals if step.ranking.probability[k] > 0.02)[: SET_SIZE - 1]
        return Cause(
            effect=candidate.name,
            joint=candidate.joint,
            confidence=step.ranking.probability[label],
            shrink=float(1 - alone.mean() / before.mean()),
            shrink_interval=shrink_interval(before, alone, self.seed),
            indistinguishable=step.labels[1:] or alike,
            effects=step.effects,
            estimates=self._estimates(step),
        )

    def _estimates(self, step: _Step) -> dict[str, tuple[float, float, str]]:
        """Parameters of a cause, all causes fitted together."""
        everything = self.columns(self.steps)
        value, error = estimates(self.case.evidence, everything, step.ranking.noise[step.labels[0]])
        found = {}
        for effect in step.effects:
            places = np.searchsorted(everything, self.case.columns[effect])
            for place, (name, (size, unit)) in zip(places, effect.sizes().items(), strict=True):
                found[name] = (float(value[place] * size), float(error[place] * size), unit)
        return found

    def _with_outliers(self, before: Array, noise: Noise, causes: list[Cause]) -> tuple[Array, list[Cause]]:
        """Poses that were left out are themselves a cause; one alone only if it is far out."""
        case = self.case
        wrong, distance = remainders(case.whole, self.columns(self.steps), noise, case.kept)
        out = ~case.kept
        count = int(out.sum())
        if count == 0 or (count == 1 and distance[out][0] < 2 * OUT):
            return before, causes
        whole = np.concatenate([before, wrong[out]])
        shrink = float(1 - before.mean() / whole.mean())
        interval = shrink_interval(whole, np.concatenate([before, np.full(count, before.mean())]), self.seed)
        return whole, [*causes, Cause("outliers", None, 0.99, shrink, interval, ())]

    def _verdict(self, end: str, gap: Gap, found: bool) -> tuple[Verdict, float]:
        """The verdict, and the share of the gap that no named cause explains."""
        rest = max(0.0, (gap.after - gap.floor) / gap.before)
        if not found:
            return ("unknown" if end in ("unknown", "ambiguous") else "none"), rest
        share = (gap.before - gap.after) / max(gap.before - gap.floor, 1e-9)
        if end == "unknown" and share < LEAST_SHARE:
            return "unknown", rest
        if self.steps and len(self.steps[0].labels) > 1:
            return "ambiguous", rest
        return "explained", rest
