"""The steps of one diagnosis: causes are added one by one until no further one can be claimed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from casadical.core.arrays import Array
from casadical.diagnosis.bootstrap import p_value
from casadical.diagnosis.candidates import Candidate
from casadical.diagnosis.cross_validation import (
    estimates,
    held_out_errors,
    partitioned_errors,
    partitions,
    remainders,
    shrink_interval,
)
from casadical.diagnosis.held_out_gap import Stage, course, scatter
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.pair_search import two_causes
from casadical.diagnosis.posterior import Ranking, rank
from casadical.diagnosis.replicates import Replicates, replicates
from casadical.diagnosis.result import Cause, Diagnosis, Gap, Outlier, Verdict
from casadical.diagnosis.settings_search import refined
from casadical.diagnosis.thresholds import (
    CLAIM,
    DETECT_FURTHER,
    FALSE_ALARMS,
    IN,
    LEAST_FURTHER,
    LEAST_SHARE,
    MISMATCH,
    MOST_CAUSES,
    MUCH,
    OUT,
    SET_SHARE,
    SET_SIZE,
    WORSE,
    detection,
)
from casadical.effects import Effect
from casadical.identification.identification import Identification
from casadical.measurements.noise import Noise

Show = Callable[[str], None]


@dataclass
class _Step:
    """A cause that was accepted, or the set at which the search stopped."""

    ranking: Ranking
    labels: tuple[str, ...]
    effects: tuple[Effect, ...]


class Investigation:
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
        self.case, effects = refined(
            self.case, label, self.variant(ranking, label), self.columns(beside), ranking.noise[label]
        )
        return _Step(ranking, tuple(labels), effects)

    def _screen(self, noise: Noise) -> None:
        """Decide again which poses are outliers, now that the model has more causes."""
        case = self.case
        _, distance = remainders(case.whole, self.columns(self.steps), noise, case.kept)
        self.case = case.with_kept(np.where(case.kept, distance < OUT, distance < IN))

    @property
    def folds(self) -> list[Array]:
        return partitions(int(self.case.kept.sum()), self.seed)

    def errors(self, columns: Array, noise: Noise) -> Array:
        """Held-out error of each pose, averaged over partitions."""
        return partitioned_errors(self.case.evidence, columns, noise, self.seed)

    def ranking(self, beside: Sequence[_Step]) -> Ranking:
        return rank(self.case, self.columns(beside), frozenset(s.labels[0] for s in beside))

    def conclude(self) -> Diagnosis:
        end = "none"
        while len(self.steps) < MOST_CAUSES:
            self.show(f"cause {len(self.steps) + 1}: evidence of {len(self.by_label)} candidates")
            self.rankings.append(self.ranking(self.steps))
            end, labels = self._next(self.rankings[-1])
            if end == "unknown" and not self.steps and (two := two_causes(self.case, self.rankings[0])):
                self._accept(two[:1])
                self.rankings.append(self.ranking(self.steps))
                labels = two[1:]
            if not labels:
                break
            self._accept(labels)
            self._revisit()
        return self._result(end)

    def _accept(self, labels: tuple[str, ...]) -> None:
        """Take up a cause of the last ranking."""
        self.steps.append(self.accepted(self.rankings[-1], labels, self.steps))
        self._screen(self.rankings[-1].noise[labels[0]])

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
        if self.steps:
            return ranking.none <= DETECT_FURTHER
        if not self.bootstrap:
            return ranking.none <= detection(int(self.case.kept.sum()))
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
        """Compare each cause again, with the others in the model; a more probable one replaces it."""
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
        course = self._course(noise)
        gap = Gap(float(before_all.mean()), float(after.mean()), floor)
        verdict, rest = self._verdict(end, gap, bool(causes), course)
        return Diagnosis(
            verdict=verdict,
            causes=tuple(causes),
            gap=gap,
            noise=noise,
            unknown_rest=rest,
            course=course,
            replicates=self.replicates,
            rankings=tuple(self.rankings),
            outliers=self._outliers(noise),
            missing=self.case.missing,
            case=self.case,
            identification=self.identification,
            seed=self.seed,
            p_nothing=self.p_nothing,
        )

    def _final_noise(self, end: str) -> Noise:
        """The noise that the best model in sight leaves, the unknown included."""
        last = self.rankings[-1]
        if end == "none":
            return last.noise[""]
        return last.noise[last.order[0]]

    @property
    def replicates(self) -> Replicates:
        return replicates(self.case.m, self.case.whole.r, self.case.kept)

    def _course(self, noise: Noise) -> pd.DataFrame:
        """The model grows cause by cause; each stage with the noise that it leaves."""
        names = ["base", *(f"+ {step.labels[0]}" for step in self.steps)]
        noises = [*(r.noise[""] for r in self.rankings[: len(self.steps)]), noise]
        stages = [Stage(names[k], self.columns(self.steps[:k]), noises[k]) for k in range(len(names))]
        return course(self.case, stages, self.folds, noise, self.seed)

    def _outliers(self, noise: Noise) -> tuple[Outlier, ...]:
        """Poses left out, the farthest first."""
        case = self.case
        length, square = remainders(case.whole, self.columns(self.steps), noise, case.kept)
        out = sorted(np.flatnonzero(~case.kept), key=lambda i: -length[i])
        return tuple(Outlier(int(case.m.row[i]), float(length[i]), float(np.sqrt(square[i]))) for i in out)

    def _floor(self, noise: Noise) -> float:
        """Mean held-out error if only noise were left: simulated through the same fit.

        The noise is that of repeated poses where there are enough of them.
        """
        case = self.case
        if self.replicates.enough:
            scale = self.replicates.sigma / scatter(case.evidence, noise)
            noise = Noise(scale * noise.sigma, scale * noise.repeatability)
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
            sizes = self.case.sizes(self.case.columns[effect])
            for place, size, (name, (_, unit)) in zip(places, sizes, effect.sizes().items(), strict=True):
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

    def _remainder(self) -> float:
        """Evidence of the remainder, as a share of that of the causes."""
        claimed = sum(s.ranking.log_factor[s.labels[0]] for s in self.steps)
        last = self.rankings[-1]
        return last.log_factor[last.order[0]] / claimed if claimed > 0 else 0.0

    def _verdict(self, end: str, gap: Gap, found: bool, course: pd.DataFrame) -> tuple[Verdict, float]:
        """The verdict, and the share of the gap that no named cause explains."""
        rest = max(0.0, (gap.after - gap.floor) / gap.before)
        if not found or (end == "unknown" and not self.steps):
            return ("unknown" if end in ("unknown", "ambiguous") else "none"), rest
        share = (gap.before - gap.after) / max(gap.before - gap.floor, 1e-9)
        if share < LEAST_SHARE and (end == "unknown" or rest > MUCH):
            return "unknown", rest
        if end == "unknown" and self._remainder() > MISMATCH:
            return "unknown", rest
        if self.steps and len(self.steps[0].labels) > 1:
            return "ambiguous", rest
        blocks = course["blocks_mm"].to_numpy()
        if blocks[-1] > WORSE * blocks[0]:  # what does not hold over time explains nothing
            return "unknown", rest
        return "explained", rest
