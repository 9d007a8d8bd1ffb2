"""The search for causes of a joint log: one by one, noise found again beside each, until no further one is claimed."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from casadical.core.basics import Array
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.motion.problem import NONE, WHITE, MotionCase
from casadical.diagnosis.posterior import PRIOR_FIRST, PRIOR_FURTHER, Ranking, rank
from casadical.diagnosis.settings import SETTINGS

# Something is there if "nothing" is less probable than this.
DETECT = 0.02
# A cause is at least so large over what is left, where it acts; a name of the whole arm, which no flaw of a joint looks
# like, this part of it; most causes that are looked for.
VISIBLE, OF_ARM, MOST = 0.5, 0.5, 3
# A usual base is within so many sigmas of its priors.
USUAL = 2.0
# A cause gains so much log evidence, and one that is short in time so much: there every friction has flaws.
# Where no torque was logged, the servo's gain and friction are known far worse, and it gains so many times more.
CERTAIN, LOCAL, UNLISTED, WITHOUT_TORQUE = 30.0, 150.0, 100.0, 2.5
# It is named from this on, where the best on no list gains less by so much; a great one anyway, for of these some hold
# every cause as one of their shapes.
NAMED, MARGIN, GREAT = 150.0, 40.0, 500.0
LOCAL_CAUSES = ("contact", "zero_offset_step")
# What acts on its joint alone gains while that moves either way: what sticks one way alone is on no list. These are
# short in time, or act where a load pulls one way.
ONE_WAY = (*LOCAL_CAUSES, "saturation")
# Of its evidence, on all runs that were not fitted a cause gains at least this share, and this on half of them each;
# and so much [nats]. Parts of the run in which a cause acts are alike, and tell more of each other.
HELD, EACH, HELD_LOCAL, LEAST_HELD, LEAST_EACH = 0.1, 0.005, 0.5, 30.0, 3.0
# Windows that are left out together of a cause that acts in a part of one run; candidates that are judged again.
INTERLEAVED, NEAREST = 10, 12
Verdict = Literal["explained", "ambiguous", "unknown", "none"]


@dataclass(frozen=True)
class Found:
    """A cause in the model. label, variant : of the candidate; probability : beside the others

    share : what it does beyond a usual base over what is left, in units of what is visible; gain : log evidence
    held_out : gain on each run that was not fitted; rival : log evidence of the best that is on no list
    ways : fitted gain while its joint moves up and down, none of a cause that acts on several
    before : the greatest gain of a cause in the model already that acts on its joint, too
    """

    label: str
    variant: int
    probability: float
    share: float
    gain: float
    held_out: tuple[float, ...]
    listed: bool
    rival: float
    ways: tuple[float, ...] = ()
    before: float = 0.0

    @property
    def true(self) -> bool:
        """Whether it gains on runs that were not fitted: all together its share, half of them each a little."""
        share = HELD_LOCAL if self.label.startswith(LOCAL_CAUSES) else HELD
        total, usual = sum(self.held_out), float(np.median(self.held_out))
        return total >= max(share * self.gain, LEAST_HELD) and usual >= max(EACH * self.gain, LEAST_EACH)

    @property
    def named(self) -> bool:
        """Whether it is large, alone, true of both directions and of runs that were not fitted."""
        local = self.label.startswith(LOCAL_CAUSES)
        alone = self.probability >= SETTINGS.min_claim and (local or self.gain >= min(self.rival + MARGIN, GREAT))
        # Beside another cause of its joint or of the arm it gains this share of that one's
        # evidence: an equation that is roughly right leaves as much, where it acts.
        great = self.gain >= max(NAMED, 0.2 * self.before)
        either = self.label.startswith(ONE_WAY) or min(self.ways, default=1.0) > 0
        large = self.share >= (1.0 if "@" in self.label else OF_ARM)
        return self.listed and large and great and either and alone and self.true


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a search found. rankings : of each step; alike : what the log does not distinguish, with probabilities"""

    case: MotionCase
    verdict: Verdict
    found: tuple[Found, ...]
    rankings: tuple[Ranking, ...]
    alike: tuple[tuple[str, float], ...] = ()
    refused: Found | None = None


def columns_of(case: MotionCase, found: tuple[Found, ...]) -> Array:
    """Of some causes, in rising order."""
    parts = [case.group(f.label, f.variant) for f in found]
    return np.sort(np.concatenate(parts)) if parts else NONE


def share_of(case: MotionCase, columns: Array, own: Array) -> float:
    """What a cause does beyond what a usual base could, over what is left; in the row of most, where it acts.

    A delay that a base may have, or friction of another day, is no cause however well the data determine it.
    """
    x, theta = case.fitted(columns)
    part = case.E.take(own) @ theta[np.isin(columns, own)]
    usual = np.clip(replace(case.only(NONE), r=part).fitted(NONE)[0], -USUAL, USUAL)
    beyond, left = ((a**2)[case.of_log] for a in (part - case.base @ usual, case.left(columns, x, theta)))
    # A cause acts where it does more than this share of the most that it does.
    acts = np.abs(part[case.of_log]) > 0.1 * np.abs(part[case.of_log]).max(axis=0)
    over = (beyond * acts).sum(axis=0) / ((left + case.floor**2) * acts).sum(axis=0).clip(1e-300)
    return float(np.sqrt(over.max()))


def folds_of(case: MotionCase, *, local: bool = False) -> Array:
    """Number of the part in which a block is left out, shape (blocks,): runs, or parts of one; see `held_out`."""
    run = np.where(case.of_log, np.cumsum(case.first), 0)
    within = np.arange(len(run))
    if local:
        return np.where(case.of_log, 1 + (within // INTERLEAVED) % 2, 0)
    if len(np.unique(run[case.of_log])) < 2:
        return np.where(case.of_log, 1 + (3 * (within - within[case.of_log][0])) // max(int(case.of_log.sum()), 1), 0)
    return run


def unfitted(case: MotionCase, columns: Array) -> Array:
    """What base and some columns leave of the log, each run by a fit to all others, as it is, shape (blocks, rows)."""
    few, every, P = case.only(columns), np.arange(len(columns)), case.base.shape[2]
    fit, folds, out = new_fit(few.white, every, WHITE, combined=False), folds_of(case), np.array(case.r)
    for k in np.unique(folds[case.of_log]):
        x = fit.estimate_from(np.flatnonzero(folds != k))
        out[folds == k] = few.left(every, x[:P], x[P:])[folds == k]
    return out


def held_out(case: MotionCase, chosen: Array, own: Array, *, local: bool) -> tuple[tuple[float, ...], Array]:
    """What a cause gains on each run that was not fitted, in nats; and fitted, at each of the log's blocks, (blocks,).

    Of a local cause, which acts in a part of one run, and where there is one run, parts of a run are left out in turn.
    The reference is always fitted. A base that takes the cause's place by numbers far from their priors, such as a
    delay of 30 ms that is known to one, pays for these, each run its share.
    """
    folds, P = folds_of(case, local=local), case.base.shape[2]
    parts = np.unique(folds[case.of_log])
    errors, whole = [], []
    for columns in (chosen, np.union1d(chosen, own)):
        few = case.only(columns)
        fit = new_fit(few.white, np.arange(len(columns)), WHITE, combined=False)
        others = [fit.estimate_from(np.flatnonzero(folds != k)) for k in parts]
        errors.append([
            float((fit.residual(x)[folds == k] ** 2).sum() / 2 + (x[:P] ** 2).sum() / 2 / len(parts))
            for k, x in zip(parts, others, strict=True)
        ])  # fmt: skip
        whole.append((fit.residual(fit.x)[case.of_log] ** 2).sum(axis=1) / 2)
    return tuple(a - b for a, b in zip(*errors, strict=True)), whole[0] - whole[1]


def search(case: MotionCase) -> Outcome:
    """Causes until no further one can be named; those too small to be named stay in the model."""
    found: tuple[Found, ...] = ()
    rankings: tuple[Ranking, ...] = ()
    while True:
        named = [f for f in found if f.named]
        last: Verdict = "explained" if named else "none"
        skip, chosen = frozenset(f.label for f in found), columns_of(case, found)
        ranking = rank(case, chosen, skip)
        rankings = (*rankings, ranking)
        if ranking.none > (SETTINGS.max_p_nothing_further if found else DETECT) or len(found) == MOST:
            return Outcome(case, last, found, rankings)
        ranking, case = _sharper(case, found, ranking)
        rankings = (*rankings[:-1], ranking)
        one = judged(case, found, ranking)
        least = CERTAIN if one.listed else UNLISTED
        least = LOCAL if case.by_label[one.label].name == "contact" else least
        if one.gain < max(least * (1.0 if case.unit else WITHOUT_TORQUE), SETTINGS.max_flaw * one.before):
            return Outcome(case, last, found, rankings)
        if one.share >= 1 and not one.named:
            there = 1 - ranking.none
            alike = [
                (k, ranking.probability[k] / there) for k in ranking.order
                if case.by_label[k].listed and ranking.probability[k] > SETTINGS.min_ambiguous * there
            ]  # fmt: skip
            whole = sum(p for _, p in alike[: SETTINGS.max_ambiguous])
            verdict: Verdict = "ambiguous" if whole > SETTINGS.ambiguous_share and one.listed else "unknown"
            return Outcome(case, last if named else verdict, found, rankings, tuple(alike), one)
        found = (*found, one)


def judged(case: MotionCase, found: tuple[Found, ...], ranking: Ranking) -> Found:
    """The most probable next cause, with all that decides whether it is named."""
    top, chosen = ranking.order[0], columns_of(case, found)
    own = case.group(top, ranking.variant[top])
    there = 1 - ranking.none
    p = sum(ranking.probability[k] for k in ranking.order if twins(case, k, top)) / there
    candidate = case.by_label[top]
    share = share_of(case, np.union1d(chosen, own), own) / VISIBLE
    gains, by_block = held_out(case, chosen, own, local=candidate.name in LOCAL_CAUSES)
    ways: tuple[float, ...] = ()
    if len(acts := {row % case.joints for row in case.rows_of(own)}) == 1 and candidate.joint:
        speed = case.over[1][:, acts.pop()]
        ways = float(by_block[speed > 0].sum()), float(by_block[speed < 0].sum())
    rival = max((g for k, g in ranking.log_factor.items() if not case.by_label[k].listed), default=0.0)
    joints = {f: case.by_label[f.label].joint for f in found if f.label != top}
    near = (f for f, joint in joints.items() if joint is None or candidate.joint in (None, joint))
    before, gain = max((f.gain for f in near), default=0.0), ranking.log_factor[top]
    return Found(top, ranking.variant[top], p, share, gain, gains, candidate.listed, rival, ways, before)


def _sharper(case: MotionCase, found: tuple[Found, ...], ranking: Ranking) -> tuple[Ranking, MotionCase]:
    """The ranking and the case with noise as it is beside the most probable cause, of those that come near it."""
    top = ranking.order[0]
    case = case.renewed(np.union1d(columns_of(case, found), case.group(top, ranking.variant[top])))
    near = set(ranking.order[:NEAREST]) | {f.label for f in found}
    few = case.among(near)
    again = rank(few, columns_of(few, found), frozenset(f.label for f in found))
    mass = {k: ranking.log_mass[k] + again.log_factor.get(k, f) - f for k, f in ranking.log_factor.items()}
    factor, variant = {**ranking.log_factor, **again.log_factor}, {**ranking.variant, **again.variant}
    none = float(np.log((PRIOR_FURTHER if found else PRIOR_FIRST)["none"]))
    return replace(ranking, log_factor=factor, log_mass=mass, variant=variant).weighed(none), case


def twins(case: MotionCase, one: str, other: str) -> bool:
    """Whether two labels are one cause, or two names of what is the same in the data at usual sizes."""
    a, b = case.by_label[one], case.by_label[other]
    names = {a.name, b.name}
    if one == other or (names == {"lag", "transport_delay"} and a.joint == b.joint):
        return True
    last = case.by_label.get(f"link_mass@{case.joints}")
    return names == {"payload", "link_mass"} and last is not None and last.label in (one, other)
