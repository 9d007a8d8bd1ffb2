"""Stepwise search for causes: they are added one by one until no additional one can be claimed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from casadical.core.basics import Array, Show
from casadical.core.linear_gaussian.search import stepwise
from casadical.core.statistics import ranked
from casadical.diagnosis.bootstrap import p_value
from casadical.diagnosis.candidates import Candidate
from casadical.diagnosis.cause_sets import most_probable_set
from casadical.diagnosis.cross_validation import errors_and_distances, likely_noise
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_forms import RANDOM_LAG, better_ar_form, with_noise_forms
from casadical.diagnosis.posterior import Ranking, rank
from casadical.diagnosis.settings import SETTINGS
from casadical.diagnosis.settings_search import log_evidence, refined
from casadical.diagnosis.structure import shown_by
from casadical.effects import Effect, TransmissionRipple

# Why the search ended: no additional cause is detected, candidates cannot be distinguished, an
# unlisted cause is detected, or the last cause was claimed.
End = Literal["none", "ambiguous", "unknown", "claimed"]


@dataclass(frozen=True, eq=False)
class Step:
    """A cause in the model.

    ranking : ranking from which the cause was taken
    labels : its own label, then those of causes that the data cannot distinguish from it
    effects : its effects with refined settings
    """

    ranking: Ranking
    labels: tuple[str, ...]
    effects: tuple[Effect, ...]

    @property
    def log_gain(self) -> float:
        """Return the log Bayes factor of its cause against no additional cause [nats]."""
        return self.ranking.log_factor[self.labels[0]]


@dataclass(frozen=True, eq=False)
class State:
    """State of a search for causes.

    case : case with the present inliers
    steps : causes in the model, in the order in which they were added
    rankings : posterior over the next cause in each round
    doubted : labels of causes in the model, for others to be ranked given them, but not named
    end : why the search ended in this state
    p_nothing : p-value of no cause by a bootstrap, None without one
    """

    case: Case
    steps: tuple[Step, ...] = ()
    rankings: tuple[Ranking, ...] = ()
    doubted: frozenset[str] = frozenset()
    end: End = "none"
    p_nothing: float | None = None

    @cached_property
    def by_label(self) -> Mapping[str, Candidate]:
        """Return the candidates by label."""
        return {c.label: c for c in self.case.candidates}

    def columns(self, steps: Sequence[Step] | None = None) -> Array:
        """Return the indices of the causes' columns of some steps, None: all, rising, shape (k,)."""
        parts = [self.case.group(s.effects) for s in (self.steps if steps is None else steps)]
        return np.unique(np.concatenate(parts)) if parts else np.zeros(0, dtype=np.int64)

    def listed(self, ranking: Ranking) -> list[str]:
        """Return the labels of the listed effects in a ranking, the most probable first."""
        return [k for k in ranking.order if k in self.by_label and self.by_label[k].listed]

    def twins(self, label: str) -> frozenset[str]:
        """Return the labels of all smooth unlisted forms at the joint of a listed cause.

        They describe an error of that joint without the cause's equation; none without a joint.
        """
        joint = self.by_label[label].joint
        same = (c for c in self.case.candidates if joint and c.name == "unknown" and c.variants[0][0].joint == joint)
        return frozenset(c.label for c in same)

    def rank(
        self, given: Sequence[Step], also: Mapping[str, tuple[Effect, ...]] | None = None, keep: str = ""
    ) -> Ranking:
        """Return the posterior over one additional cause given those of some steps.

        Forms of noise are among its rivals unless `also` is given.
        given : steps whose causes are in the model
        also : effects of further causes in the model, by label
        keep : label that stays a candidate: an effect of several joints even if few joints show it,
            a later event even if the first of its kind is not in the model
        """
        also = also or {}
        skip = frozenset((*(s.labels[0] for s in given), *also))
        covers = frozenset[str]().union(*(self.by_label[label].covers for label in skip))
        # A set names an effect at single joints or at several at once, not both.
        alone = {self.by_label[label].name for label in also}
        covered = frozenset(
            c.label for c in self.case.candidates if c.variants[0][0].name in covers or (c.together and c.name in alone)
        )
        # Of the events of one kind only the first that is not in the model yet is a candidate, or `keep`.
        open_events = Counter[tuple[str, int | None]]()
        for c in sorted(self.case.candidates, key=lambda c: c.label != keep):
            if hasattr(c.variants[0][0], "event") and c.label not in skip | covered:
                open_events[c.name, c.joint] += 1
                covered |= {c.label} if open_events[c.name, c.joint] > 1 else frozenset[str]()
        columns = [self.columns(given), *(self.case.group(e) for e in also.values())]
        chosen = np.unique(np.concatenate(columns))
        joints = (
            *(e.joint for s in given for e in s.effects),
            *(j for s in given for e in s.effects for j in e.parts),
        )
        # Rankings are cached: a search needs the same one again when it revisits its causes.
        cache: dict[object, Ranking] = self.case.judged.cache.setdefault("rankings", {})
        key = (chosen.tobytes(), skip, covered, not also, joints, keep)
        if key not in cache:
            ranking = self._without_single(rank(self.case, chosen, skip, covered), chosen, keep)
            cache[key] = ranking if also else with_noise_forms(ranking, self.case, chosen, joints)
        return cache[key]

    def _without_single(self, ranking: Ranking, chosen: Array, keep: str) -> Ranking:
        """Return the ranking without effects of several joints that less than three joints show.

        chosen : indices of the columns in the model; keep : see `rank`
        """
        there = 1 - ranking.none
        likely = [self.by_label[k] for k, p in ranking.probability.items() if p > SETTINGS.min_ambiguous * there]
        # At least three joints must show an effect of several joints at once.
        least = SETTINGS.min_joint_log_evidence
        lost = {
            c.label
            for c in likely
            if c.together
            and c.label != keep
            and sum(g > least for g in self._gains(c.variants[ranking.variant[c.label]], chosen)) < 3
        }
        if not lost:
            return ranking
        mass = {k: m for k, m in ranking.log_mass.items() if k not in lost}
        return replace(ranking, log_mass=mass)

    def _gains(self, effects: Sequence[Effect], chosen: Array) -> list[float]:
        """Return the log evidence of each effect given the other effects and chosen columns [nats].

        chosen : indices of the columns in the model, shape (k,)
        """
        gains, every = [], np.union1d(chosen, self.case.group(effects))
        for effect in effects:
            given = np.setdiff1d(every, self.case.group((effect,)))
            gains.append(float(log_evidence(self.case, [(effect,)], given)[0]))
        return gains

    @property
    def log_gain(self) -> float:
        """Return the log evidence of all causes in the model together over none [nats].

        It is the sum of theirs, each from the ranking that its step has.
        """
        return sum(s.log_gain for s in self.steps)

    def most_probable_set(self) -> tuple[tuple[str, ...], frozenset[str]]:
        """Return the labels of the most probable set of additional listed causes.

        The second item holds those of them that are not certain. A set may explain the data where
        no single cause does (see `cause_sets.most_probable_set`).
        """

        def rank_sets(sets: Sequence[Mapping[str, tuple[Effect, ...]]]) -> list[Ranking]:
            effects = dict.fromkeys(e for also in sets for own in also.values() for e in own)
            chosen = [self.case.group((e,)) for e in effects]
            self.case.judged.look_ahead(chosen, [*self.case.groups.values()])
            return [self.rank(self.steps, also) for also in sets]

        return most_probable_set(
            self.rankings[-1],
            rank_sets,
            {c.label: c.variants for c in self.case.candidates},
            {c.label: self.twins(c.label) for c in self.case.candidates if c.listed},
            len(self.steps),
        )

    def ranked(self) -> State:
        """Return the state with the ranking given all its causes appended to `rankings`."""
        return replace(self, rankings=(*self.rankings, self.rank(self.steps)))

    def refined(self, ranking: Ranking, labels: Sequence[str], given: Sequence[Step]) -> tuple[Case, Step]:
        """Return case and step of the cause of the first label, with refined settings.

        The step has no effects if no joint shows a cause of several joints.
        ranking : ranking from which it is taken; given : steps of the other causes in the model
        """
        label = labels[0]
        variant = self.by_label[label].variants[ranking.variant[label]]
        if self.by_label[label].together:
            gains = self._gains(variant, self.columns(given))
            variant = tuple(e for e, gain in zip(variant, gains, strict=True) if gain > SETTINGS.min_joint_log_evidence)
        case, effects = refined(self.case, label, variant, self.columns(given), ranking.noise[label])
        if effects:
            case = case.with_events_at(getattr(effects[0], "at", None)).with_events(
                1, {label, *(s.labels[0] for s in given)}
            )
        return case, Step(ranking, tuple(labels), effects)

    def with_cause(self, labels: Sequence[str]) -> State:
        """Return the state with the cause of the first label added and the outliers updated.

        labels : the cause's own, then those that the data cannot distinguish from it
        The state is returned unchanged where no joint shows the cause: a set may name a cause that
        its other causes explain completely.
        """
        ranking = self.rankings[-1]
        covers = self.by_label[labels[0]].covers
        steps = tuple(s for s in self.steps if s.effects[0].name not in covers)
        case, step = self.refined(ranking, labels, steps)
        if not step.effects:
            return self
        state = replace(self, case=case, steps=(*steps, step))
        _, distance = errors_and_distances(case.whole, state.columns(), ranking.noise[labels[0]], case.inliers)
        # The limit has a hysteresis, so that the search does not alternate.
        limit = np.where(case.inliers, SETTINGS.outlier_distance, SETTINGS.inlier_distance)
        screened = case.screened(distance < limit)
        if screened is not case:
            case.judged.forget()
        return replace(state, case=screened)

    def with_residual_candidates(self) -> State:
        """Return the state with periodic joint errors and jumps of its residual as candidates."""
        case, columns = self.case, self.columns()
        noise = likely_noise(case.judged.log_base(columns), case.judged.sigmas)
        lines, steps = shown_by(case, columns, noise, case.form)
        for step in steps:
            case = case.with_events_at(step.at)
        ripples = (TransmissionRipple(joint, cycles=cycles) for joint, cycles in sorted(lines))
        new = (r for r in ripples if r.label in self.by_label and r not in case.columns)
        return replace(self, case=case.with_variants({(r,): r.label for r in new}))

    def revisited(self) -> State:
        """Return the state with each cause replaced by the most probable one given the others.

        That is done where the most probable one is listed.
        """
        state = self
        # A single cause is compared again if its rivals are candidates at the time of its event.
        timed = any(hasattr(e, "at") for s in self.steps for e in s.effects)
        for k in range(len(self.steps) if len(self.steps) > 1 or timed else 0):
            others = (*state.steps[:k], *state.steps[k + 1 :])
            ranking = state.rank(others)
            listed = state.listed(ranking)
            if ranking.none <= SETTINGS.max_p_nothing_further and listed[0] == ranking.order[0]:
                case, step = state.refined(ranking, indistinguishable(ranking, listed), others)
                if step.effects:
                    state = replace(state, case=case, steps=(*state.steps[:k], step, *state.steps[k + 1 :]))
        return state


def search_with_forms(case: Case, seed: int, bootstrap: int, show: Show) -> State:
    """Return the result of `search` under the form of noise that is most probable given its causes.

    Autocorrelated noise is fitted given the causes of each search, and causes are searched again
    under it, until neither changes or `Settings.max_form_searches` times. Fitted before any cause,
    it would absorb the causes. For other measurements than one set of positions, a row a stop,
    noise is white. The arguments are those of `search`.
    """
    state = first = search(case, seed, bootstrap, show)
    if not case.observations.plain or case.evidence.stop is not None:
        return state

    lone = False  # whether sets of causes are still to be searched

    def under_ar_noise(given: State, least: float = 0.0, *, first: bool = False) -> State | None:
        """Return the result of a search under the best AR(1) noise given the causes of a state.

        Returns None if the noise is not autocorrelated or no cause is found under it.
        least : log evidence that noise and causes need together over white noise without causes
        first : whether the causes will be searched once more, so that sets of them can wait
        """
        follows = better_ar_form(given.case, given.columns())
        if not follows:
            return None
        form, _, gain = follows
        show(f"causes under autocorrelated noise, coefficient {form.ar_coefficient:g}")
        given.case.judged.forget()
        other = search(case.with_form(form), seed, 0, show, sets=not first)
        detected = other.steps and other.rankings[0].none <= SETTINGS.max_p_nothing_under_form
        return other if detected and gain + other.log_gain > least else None

    # Effects with many parameters fit autocorrelated noise; so this noise is tried first without
    # them.
    if any(e.parts for s in state.steps for e in s.effects):
        state = under_ar_noise(State(case), state.log_gain, first=True) or state
        lone = state is not first
    for _ in range(SETTINGS.max_form_searches):
        found = under_ar_noise(state)
        if not found:
            break
        state, lone = found, False
    if lone:
        state = search(case.with_form(state.case.form), seed, 0, show)
    return replace(state, p_nothing=first.p_nothing)


def search(case: Case, seed: int, bootstrap: int, show: Show, *, sets: bool = True) -> State:
    """Return the final state of a search, which adds causes until no additional one is claimed.

    bootstrap : number of draws of noise alone; 0 for no bootstrap, whose p-value is then None
    show : called with a line of progress
    sets : whether sets of causes that explain the data only together are searched
    """

    def next_state(before: Sequence[State]) -> State:
        """Return the state with the next cause or set of causes, if there is one."""
        given = before[-1] if before else State(case)
        show(f"cause {len(given.steps) + 1}: evidence of {len(given.by_label)} candidates")
        state = given.with_residual_candidates().ranked()
        ranking = state.rankings[-1]
        if bootstrap and not state.steps:
            state = replace(state, p_nothing=p_value(case, ranking, bootstrap, seed, show))
        end, labels = next_cause(state, ranking, state.p_nothing)
        # Several simultaneous causes can hide each other; sets wait for the noise of a lag.
        hidden = sets and ranking.order[0] != RANDOM_LAG
        if hidden and (end in ("unknown", "ambiguous") or len(labels) > 1):
            show("sets of causes")
            # A set may have two events of one kind.
            state = replace(state, case=state.case.with_events(2, {s.labels[0] for s in state.steps}))
            several, doubted = state.most_probable_set()
            state = replace(state, doubted=state.doubted | doubted)
            for label in several[:-1]:
                state = state.with_cause((label,)).ranked()
            labels = several[-1:] or labels
        if labels:
            state = state.with_cause(labels)
            if state.steps == given.steps:
                end = "unknown" if _detected(state, state.rankings[-1], state.p_nothing) else "none"
            else:
                state = state.revisited()
        return replace(state, end=end)

    most = SETTINGS.max_causes
    # A cause that covers others takes their places, so that there may be more rounds than causes.
    return stepwise(
        next_state,
        lambda state, before: state.steps != (before[-1].steps if before else ()) and len(state.steps) < most,
        2 * most,
    )[1]


def next_cause(state: State, ranking: Ranking, p_nothing: float | None = None) -> tuple[End, tuple[str, ...]]:
    """Return "claimed" and the labels of the next cause, or another `End` and no label.

    The labels are its own, then those of causes that the data cannot distinguish from it.
    p_nothing : bootstrap p-value of no cause, None without a bootstrap
    """
    if not _detected(state, ranking, p_nothing):
        return "none", ()
    listed = state.listed(ranking)
    there = 1 - ranking.none
    alike = indistinguishable(ranking, listed) if listed else ()
    together = sum(ranking.probability[label] for label in alike)
    if not listed:
        return "unknown", ()
    if there - sum(ranking.probability[k] for k in listed) > 0.5:
        # The cause is unlisted, unless it is one of a few labels, a listed one among them.
        probable = ranking.probability[listed[0]] > SETTINGS.min_ambiguous * there
        few = together >= SETTINGS.ambiguous_share * there
        if not probable or not few or any(state.by_label[k].name == "unknown" for k in alike):
            return "unknown", ()
        alike = tuple(alike[k] for k in ranked([ranking.probability[k] for k in alike]))
    doubtful = ranking.probability[listed[0]] < SETTINGS.min_further * there
    if state.steps and doubtful and together < SETTINGS.ambiguous_share * there:
        return "ambiguous", ()
    return "claimed", alike


def _detected(state: State, ranking: Ranking, p_nothing: float | None) -> bool:
    """Return whether a cause that is not in the model yet is detected, listed or not."""
    if state.steps:
        return ranking.none <= SETTINGS.max_p_nothing_further
    if p_nothing is not None:
        return p_nothing <= SETTINGS.max_bootstrap_p
    return ranking.none <= SETTINGS.max_p_nothing


def indistinguishable(ranking: Ranking, listed: Sequence[str]) -> tuple[str, ...]:
    """Return the most probable listed cause and those that the data cannot distinguish from it.

    listed : labels of the listed causes, the most probable first; they precede the unlisted ones

    A certain cause is returned alone.
    """
    there = 1 - ranking.none
    if (1 - SETTINGS.look_alike) * ranking.probability[listed[0]] >= SETTINGS.min_claim * there:
        return (listed[0],)
    alike = [k for k in (*listed, *(k for k in ranking.order if k not in listed)) if k in ranking.variant]
    alike = [k for k in alike[1:] if ranking.probability[k] > SETTINGS.min_ambiguous * there] or alike[1:2]
    total = np.cumsum([ranking.probability[k] for k in (listed[0], *alike)])
    enough = 2 + int(np.searchsorted(total[1:], SETTINGS.ambiguous_share * there))
    return (listed[0], *alike)[: min(SETTINGS.max_ambiguous, enough)]
