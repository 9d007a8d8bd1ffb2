"""Stepwise search for the causes in a joint log: the best one is added until none can be named.

The noise is estimated again given each cause.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from casadical.core.basics import Array
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.motion.problem import NO_COLUMNS, UNIT_NOISE, MotionCase
from casadical.diagnosis.posterior import PRIOR_FIRST, PRIOR_FURTHER, Ranking, rank
from casadical.diagnosis.settings import SETTINGS

# A first cause is detected if the posterior probability of no cause is at most this.
MAX_NOTHING_PROBABILITY = 0.02
# Rms effect of a cause, divided by the rms residual where it acts, from which it counts as visible.
VISIBLE_SHARE = 0.5
# Size, in units of VISIBLE_SHARE, from which a cause of the whole arm can be named (1 for that of a
# joint), as no fault of one joint resembles it.
ARM_VISIBLE_SHARE = 0.5
MAX_CAUSES = 3  # largest number of causes that are searched for
# Coefficients of a usual base are within this many prior standard deviations of their prior means.
BASE_PRIOR_SIGMAS = 2.0
# Smallest log evidence [nats] with which a listed cause enters the model.
MIN_LISTED_EVIDENCE = 30.0
# Smallest log evidence [nats] with which a contact enters the model: over its short time every
# friction model has flaws.
MIN_LOCAL_EVIDENCE = 150.0
# Smallest log evidence [nats] with which an unlisted cause enters the model.
MIN_UNLISTED_EVIDENCE = 100.0
# Factor on the smallest log evidence where no torque was logged: gain and friction of the servo are
# less certain there.
NO_TORQUE_FACTOR = 2.5
MIN_NAMED_EVIDENCE = 150.0  # smallest log evidence [nats] of a cause that is named
MIN_RIVAL_MARGIN = 40.0  # margin [nats] by which a named cause must exceed the best unlisted one
# Log evidence [nats] from which a cause is named without a margin over the best unlisted one, as
# some unlisted ones include every cause as one of their shapes.
CLEAR_EVIDENCE = 500.0
LOCAL_CAUSES = ("contact", "zero_offset_step")  # causes that act in a part of one run only
# Causes of one joint that may be named with evidence in one direction of motion only: they act for
# a short time, or where a load pulls in one direction. All others need it in both directions.
ONE_DIRECTION_CAUSES = (*LOCAL_CAUSES, "saturation")
# Smallest gain of a cause on all held-out runs together, divided by its log evidence.
MIN_HELD_OUT_SHARE = 0.1
MIN_RUN_SHARE = 0.005  # smallest gain on the median held-out run, divided by the log evidence
# The same as MIN_HELD_OUT_SHARE for a local cause, for which interleaved parts are held out: they
# resemble each other.
MIN_HELD_OUT_SHARE_LOCAL = 0.5
MIN_HELD_OUT_GAIN = 30.0  # smallest gain of a cause on all held-out runs together [nats]
MIN_RUN_GAIN = 3.0  # smallest gain of a cause on the median held-out run [nats]
INTERLEAVED_WINDOWS = 10  # number of consecutive windows that are held out together, local causes
# Number of the best candidates that are ranked again with the noise re-estimated.
REJUDGED_CANDIDATES = 12
# Verdict: explained by named causes, several causes fit equally, unlisted cause, or no cause.
Verdict = Literal["explained", "ambiguous", "unknown", "none"]


@dataclass(frozen=True)
class Found:
    """A cause in the model, with the quantities by which it is named or not.

    label, variant : label of the candidate, index of its variant
    probability : its posterior probability given that there is a cause, with those found before in
        the model
    share : rms effect beyond a usual base, divided by the rms residual, in units of VISIBLE_SHARE
    gain : log evidence [nats]; listed : whether it is a listed cause
    held_out : decrease of half the squared whitened residual on each held-out run [nats]
    rival : log evidence of the best unlisted candidate [nats]
    gains_by_direction : gain while its joint moves up and while it moves down [nats], empty for a cause of
        several joints
    before : largest log evidence of a cause in the model that acts on its joint, too [nats]
    """

    label: str
    variant: int
    probability: float
    share: float
    gain: float
    held_out: tuple[float, ...]
    listed: bool
    rival: float
    gains_by_direction: tuple[float, ...] = ()
    before: float = 0.0

    @property
    def confirmed(self) -> bool:
        """Return whether the cause gains enough on held-out runs, in total and in the median."""
        share = MIN_HELD_OUT_SHARE_LOCAL if self.label.startswith(LOCAL_CAUSES) else MIN_HELD_OUT_SHARE
        total, usual = sum(self.held_out), float(np.median(self.held_out))
        if total > 10 * self.gain:
            return False  # the fit cannot support so much: without the cause the base extrapolates
        return total >= max(share * self.gain, MIN_HELD_OUT_GAIN) and usual >= max(
            MIN_RUN_SHARE * self.gain, MIN_RUN_GAIN
        )

    @property
    def named(self) -> bool:
        """Return whether the cause may be named.

        It must be listed, large, certain against rivals, and gain in both directions of motion and
        on held-out runs.
        """
        local = self.label.startswith(LOCAL_CAUSES)
        alone = self.probability >= SETTINGS.min_claim and (
            local or self.gain >= min(self.rival + MIN_RIVAL_MARGIN, CLEAR_EVIDENCE)
        )
        # Given another cause of its joint or of the arm, it must gain a fifth of that one's
        # evidence, as an equation that is only roughly right leaves about as much where it acts.
        clear = self.gain >= max(MIN_NAMED_EVIDENCE, 0.2 * self.before)
        either = self.label.startswith(ONE_DIRECTION_CAUSES) or min(self.gains_by_direction, default=1.0) > 0
        large = self.share >= (1.0 if "@" in self.label else ARM_VISIBLE_SHARE)
        return self.listed and large and clear and either and alone and self.confirmed


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of a search.

    case : the problem, with its noise re-estimated; found : causes in the model
    rankings : posterior over the next cause in each step
    alike : labels of causes that the log does not distinguish, with probabilities
    refused : best additional cause, if it is large but cannot be named
    """

    case: MotionCase
    verdict: Verdict
    found: tuple[Found, ...]
    rankings: tuple[Ranking, ...]
    alike: tuple[tuple[str, float], ...] = ()
    refused: Found | None = None


def cause_columns(case: MotionCase, found: tuple[Found, ...]) -> Array:
    """Return the indices of the columns of causes that were found, in rising order."""
    parts = [case.group(f.label, f.variant) for f in found]
    return np.sort(np.concatenate(parts)) if parts else NO_COLUMNS


def share_of(case: MotionCase, columns: Array, own: Array) -> float:
    """Return the size of a cause beyond a usual base, divided by the residual, in its largest row.

    Both are rms values over the windows in which the cause acts. A delay that a base may have, or
    friction of another day, is no cause however well the data determine it.
    columns, own : indices of the columns of all causes in the model, and of this one
    """
    x, theta = case.fitted(columns)
    part = case.E.take(own) @ theta[np.isin(columns, own)]
    usual = np.clip(replace(case.only(NO_COLUMNS), r=part).fitted(NO_COLUMNS)[0], -BASE_PRIOR_SIGMAS, BASE_PRIOR_SIGMAS)
    beyond, residual = ((a**2)[case.of_log] for a in (part - case.base @ usual, case.residual(columns, x, theta)))
    # A cause acts where its effect exceeds a tenth of its largest one.
    acts = np.abs(part[case.of_log]) > 0.1 * np.abs(part[case.of_log]).max(axis=0)
    over = (beyond * acts).sum(axis=0) / ((residual + case.floor**2) * acts).sum(axis=0).clip(1e-300)
    return float(np.sqrt(over.max()))


def folds_of(case: MotionCase, *, local: bool = False) -> Array:
    """Return the index of the fold in which each block is held out, shape (blocks,).

    Folds are runs, or thirds of a single run; the reference is fold 0, which is never held out.
    local : whether folds are interleaved parts of the log, for causes in a part of one run
    """
    run = np.where(case.of_log, np.cumsum(case.first), 0)
    within = np.arange(len(run))
    if local:
        return np.where(case.of_log, 1 + (within // INTERLEAVED_WINDOWS) % 2, 0)
    if len(np.unique(run[case.of_log])) < 2:
        return np.where(case.of_log, 1 + (3 * (within - within[case.of_log][0])) // max(int(case.of_log.sum()), 1), 0)
    return run


def held_out_residual(case: MotionCase, columns: Array) -> Array:
    """Return the residual of base and some columns, in each run by a fit to the others.

    It has shape (blocks, rows) and is not whitened. columns : indices of columns
    """
    few, every, P = case.only(columns), np.arange(len(columns)), case.base.shape[2]
    fit, folds, out = new_fit(few.white, every, UNIT_NOISE, combined=False), folds_of(case), np.array(case.r)
    for k in np.unique(folds[case.of_log]):
        x = fit.estimate_from(np.flatnonzero(folds != k))
        out[folds == k] = few.residual(every, x[:P], x[P:])[folds == k]
    return out


def held_out(case: MotionCase, chosen: Array, own: Array, *, local: bool) -> tuple[tuple[float, ...], Array]:
    """Return a cause's gain on each held-out run [nats], and its gain in each block of the fit.

    Gains are decreases of half the squared whitened residual; the second has one entry for each
    block of the log. For a local cause, which acts in a part of one run, and where there is one
    run, parts of a run are held out in turn. The reference is always fitted. A base that replaces
    the cause by coefficients far from their priors, such as a delay of 30 ms that is declared to
    one, pays for these in equal parts in all runs.
    chosen, own : indices of the columns of the causes found before, and of the cause
    local : whether the cause acts in a part of one run
    """
    folds, P = folds_of(case, local=local), case.base.shape[2]
    parts = np.unique(folds[case.of_log])
    errors, fitted_costs = [], []
    for columns in (chosen, np.union1d(chosen, own)):
        few = case.only(columns)
        fit = new_fit(few.white, np.arange(len(columns)), UNIT_NOISE, combined=False)
        others = [fit.estimate_from(np.flatnonzero(folds != k)) for k in parts]
        errors.append(
            [
                float((fit.residual(x)[folds == k] ** 2).sum() / 2 + (x[:P] ** 2).sum() / 2 / len(parts))
                for k, x in zip(parts, others, strict=True)
            ]
        )
        fitted_costs.append((fit.residual(fit.x)[case.of_log] ** 2).sum(axis=1) / 2)
    return tuple(a - b for a, b in zip(*errors, strict=True)), fitted_costs[0] - fitted_costs[1]


def search(case: MotionCase) -> Outcome:
    """Return the causes of a log, found one by one until no additional one can be named.

    Causes that are too small to be named remain in the model.
    """
    found: tuple[Found, ...] = ()
    rankings: tuple[Ranking, ...] = ()
    while True:
        named = [f for f in found if f.named]
        last: Verdict = "explained" if named else "none"
        skip, chosen = frozenset(f.label for f in found), cause_columns(case, found)
        ranking = rank(case, chosen, skip)
        rankings = (*rankings, ranking)
        if (
            ranking.none > (SETTINGS.max_p_nothing_further if found else MAX_NOTHING_PROBABILITY)
            or len(found) == MAX_CAUSES
        ):
            return Outcome(case, last, found, rankings)
        ranking, case = _with_renewed_noise(case, found, ranking)
        rankings = (*rankings[:-1], ranking)
        one = next_cause(case, found, ranking)
        threshold = MIN_LISTED_EVIDENCE if one.listed else MIN_UNLISTED_EVIDENCE
        threshold = MIN_LOCAL_EVIDENCE if case.by_label[one.label].name == "contact" else threshold
        if one.gain < max(threshold * (1.0 if case.unit else NO_TORQUE_FACTOR), SETTINGS.max_flaw * one.before):
            return Outcome(case, last, found, rankings)
        if one.share >= 1 and not one.named:
            there = 1 - ranking.none
            alike = [
                (k, ranking.probability[k] / there)
                for k in ranking.order
                if case.by_label[k].listed and ranking.probability[k] > SETTINGS.min_ambiguous * there
            ]
            whole = sum(p for _, p in alike[: SETTINGS.max_ambiguous])
            verdict: Verdict = "ambiguous" if whole > SETTINGS.ambiguous_share and one.listed else "unknown"
            return Outcome(case, last if named else verdict, found, rankings, tuple(alike), one)
        found = (*found, one)


def next_cause(case: MotionCase, found: tuple[Found, ...], ranking: Ranking) -> Found:
    """Return the most probable next cause, with the quantities by which it is named or not."""
    top, chosen = ranking.order[0], cause_columns(case, found)
    own = case.group(top, ranking.variant[top])
    there = 1 - ranking.none
    p = sum(ranking.probability[k] for k in ranking.order if indistinguishable(case, k, top)) / there
    candidate = case.by_label[top]
    share = share_of(case, np.union1d(chosen, own), own) / VISIBLE_SHARE
    gains, by_block = held_out(case, chosen, own, local=candidate.name in LOCAL_CAUSES)
    by_direction: tuple[float, ...] = ()
    if len(acts := {row % case.joints for row in case.rows_of(own)}) == 1 and candidate.joint:
        speed = case.region_values[1][:, acts.pop()]
        by_direction = float(by_block[speed > 0].sum()), float(by_block[speed < 0].sum())
    rival = max((g for k, g in ranking.log_factor.items() if not case.by_label[k].listed), default=0.0)
    joints = {f: case.by_label[f.label].joint for f in found if f.label != top}
    near = (f for f, joint in joints.items() if joint is None or candidate.joint in (None, joint))
    before, gain = max((f.gain for f in near), default=0.0), ranking.log_factor[top]
    return Found(top, ranking.variant[top], p, share, gain, gains, candidate.listed, rival, by_direction, before)


def _with_renewed_noise(case: MotionCase, found: tuple[Found, ...], ranking: Ranking) -> tuple[Ranking, MotionCase]:
    """Return ranking and case with the noise re-estimated given the most probable cause.

    The best `REJUDGED_CANDIDATES` are ranked again under it; the others keep their evidence.
    """
    top = ranking.order[0]
    case = case.renewed(np.union1d(cause_columns(case, found), case.group(top, ranking.variant[top])))
    near = set(ranking.order[:REJUDGED_CANDIDATES]) | {f.label for f in found}
    few = case.among(near)
    again = rank(few, cause_columns(few, found), frozenset(f.label for f in found))
    mass = {k: ranking.log_mass[k] + again.log_factor.get(k, f) - f for k, f in ranking.log_factor.items()}
    factor, variant = {**ranking.log_factor, **again.log_factor}, {**ranking.variant, **again.variant}
    none = float(np.log((PRIOR_FURTHER if found else PRIOR_FIRST)["none"]))
    return replace(ranking, log_factor=factor, log_mass=mass, variant=variant).normalised(none), case


def indistinguishable(case: MotionCase, one: str, other: str) -> bool:
    """Return whether two labels are the same, or of causes with nearly equal effects on a log.

    These are lag and transport delay of a joint, and payload and mass of the last link.
    """
    a, b = case.by_label[one], case.by_label[other]
    names = {a.name, b.name}
    if one == other or (names == {"lag", "transport_delay"} and a.joint == b.joint):
        return True
    last = case.by_label.get(f"link_mass@{case.joints}")
    return names == {"payload", "link_mass"} and last is not None and last.label in (one, other)
