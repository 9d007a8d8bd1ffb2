"""Comparison of campaigns: which parameter or effect changed, when, by how much, how surely.

Base and tool are fitted again in each campaign; how they differ, and the smallest change that would
be detected, are reported too. The evidence of a change is computed in `casadical.fleet.evidence`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.columns import array_columns
from casadical.core.linear_gaussian.fit import Fit
from casadical.core.linear_gaussian.marginals import NO_COLUMNS, marginals_of, take_over_cache
from casadical.core.linear_gaussian.model import LinearModel
from casadical.core.linear_gaussian.search import Posterior, compared_again, log_factors, stepwise
from casadical.core.statistics import best_of, first_of_best, ranked
from casadical.core.transforms import small_frame, to_xyz
from casadical.fleet import evidence
from casadical.fleet.changes import MIN_ODDS_OF_CHANGE, Amount, Change, Comparison, Rival
from casadical.fleet.estimates import Estimate, with_common_noise
from casadical.fleet.evidence import ANOTHER_ROBOT, Candidate, Course
from casadical.identification.prior import refuse_another
from casadical.robot.axes import row_matrix
from casadical.robot.parameter_list import PLACEMENT_PARAMETERS

# Days in a year, the unit of time of a drift [d].
DAYS_PER_YEAR = 365.25
# Number of campaigns that count as a year where they have no dates.
CAMPAIGNS_PER_YEAR = 12.0


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A change of one candidate with one course and one onset.

    candidate, course : what changes, and how over time
    since : first campaign that shows the change, from 0
    weight : prior probability
    group : indices of its columns in the linear model
    """

    candidate: Candidate
    course: Course
    since: int
    weight: float
    group: Array

    @property
    def label(self) -> str:
        """Return candidate, course and first campaign as text, which no other hypothesis has."""
        return f"{self.candidate.label} {self.course} {self.since}"


def compare(
    campaigns: Sequence[Estimate], *, same_tool: bool = False, same_frame: bool = False, notes: Iterable[str] = ()
) -> Comparison:
    """Return what changed in a robot over campaigns: causes, times, sizes, probabilities.

    campaigns : estimates of the campaigns in the order of time
    same_tool : whether the same point of the same tool was measured, so that a tool that moved is a
        change
    same_frame : whether all positions are in one measuring frame, so that a base that moved is a
        change
    notes : sentences on the campaigns for the report
    Raises InputError: fewer than two campaigns, or of robots that cannot be the same one.
    """
    if len(campaigns) < 2:
        raise InputError(f"{len(campaigns)} campaign; a comparison needs two or more")
    first = campaigns[0]
    for other in campaigns[1:]:
        refuse_another(first.robot, other.robot, "campaign")
    campaigns = with_common_noise(campaigns)
    names, information, candidates = shared_information(campaigns, same_tool=same_tool, same_frame=same_frame)
    # Times [years], the first at zero; without days `CAMPAIGNS_PER_YEAR` campaigns count as a year.
    days = np.array([c.day for c in campaigns], dtype=float)
    times = np.arange(len(days)) / CAMPAIGNS_PER_YEAR
    if np.isfinite(days).all():
        times = (days - days[0]) / DAYS_PER_YEAR
    model, hypotheses = evidence_of(*information, candidates, times, dated=first.day is not None)
    accepted, remaining, swap = changes_in(model, hypotheses)
    changes = tuple(_change(model, hypotheses, accepted, k, first, swap) for k in range(len(accepted)))
    seen = _detectable_sizes(model, hypotheses, accepted, first)
    placements = _placements(campaigns, names, *_given(model, accepted))
    noted = tuple(dict.fromkeys(notes))
    return Comparison(tuple(campaigns), names, changes, remaining, tuple(seen), tuple(placements), noted)


def evidence_of(
    H: Array, b: Array, spread: Array, candidates: Sequence[Candidate], times: Array, *, dated: bool
) -> tuple[LinearModel, list[Hypothesis]]:
    """Return the linear model of all campaigns, and the possible changes, whose columns it has.

    times : time of each campaign, shape (n,) [years]; dated : whether they come from dates
    """
    each = list(weighted_hypotheses(candidates, evidence.RELATIVE_FREQUENCY, times, dated=dated))
    changes = [(candidate, factors) for candidate, *_, factors in each]
    model, groups = evidence.model_of_campaigns(H, b, spread, candidates, changes)
    # The models of all steps of the search share these sums.
    marginals_of(model).sums.gram_matrices(groups)
    flat = [
        (c, course, int(k), float(w))
        for c, course, weight, since, _ in each
        for k, w in zip(since, weight, strict=True)
    ]
    return model, [Hypothesis(*own, group) for own, group in zip(flat, groups, strict=True)]


def shared_information(
    campaigns: Sequence[Estimate], *, same_tool: bool, same_frame: bool
) -> tuple[tuple[str, ...], tuple[Array, Array, Array], tuple[Candidate, ...]]:
    """Return the names of the shared parameters, the information on them, and the candidates.

    The information, score and prior standard deviations are about the values of the first campaign
    (see `evidence.model_of_campaigns`); the candidates are those for changes in these parameters.
    """
    first = campaigns[0]
    same_tool = same_tool and len({c.robot.tool_name for c in campaigns}) == 1
    common = set.intersection(*(set(c.names) for c in campaigns))
    names = tuple(n for n in first.names if n in common)
    names = evidence.shared_names(first.robot, names, same_tool=same_tool, same_frame=same_frame)
    at = [first.names.index(n) for n in names]
    values = first.values[at]
    if same_frame:
        # Bases are linearised about that of the first; a large deviation is obvious anyway.
        for k, c in enumerate(campaigns := list(campaigns)):
            own = dict(zip(first.robot.parameters.names, first.robot.values_of(c.robot), strict=True))
            moved = zip(c.names, c.values, strict=True)
            moved_values = [own.get(n, v) if n.startswith("base_") else v for n, v in moved]
            campaigns[k] = replace(c, values=np.array(moved_values))
    H, b = (np.array(parts) for parts in zip(*(c.about(names, values) for c in campaigns), strict=True))
    spread = np.sqrt(np.mean([c.spread[[c.names.index(n) for n in names]] ** 2 for c in campaigns], axis=0))
    # The prior of the harmonics is made 100 times wider than the residuals of one campaign suggest:
    # over a short range of a joint high harmonics look like much greater low ones, and a prior that
    # contradicts the campaigns together would look like a change after the first of them.
    spread[[n.startswith("joint_error_curve") for n in names]] *= 100.0
    return names, (H, b, spread), evidence.candidates_of(first.robot, names)


@dataclass(frozen=True, eq=False)
class Accepted(Hypothesis):
    """The most probable change of a step of the search.

    kappa : most probable ratio of the change's size to its usual one
    posterior : over all hypotheses that were compared, given the changes that were accepted before;
        its log mass of all outcomes is that of the odds of any change in this step
    score : log Bayes factor of this one with its most probable size, plus its log prior probability
    """

    kappa: float
    posterior: Posterior
    score: float


def changes_in(model: LinearModel, hypotheses: Sequence[Hypothesis]) -> tuple[list[Accepted], float, tuple[str, float]]:
    """Return the accepted changes, the log odds of an additional one, and a rival explanation.

    Several changes are compared with another robot plus what else changed then; the rival
    explanation is the label and probability of the one that was not taken, ("", 0) without one.
    Whether there is any change is decided without another robot: it has so many parameters that a
    change which only it could explain would be a false one.
    """

    def sure(change: Accepted, _: Sequence[Accepted] = ()) -> bool:
        """Return whether some change is probable enough to be accepted."""
        return bool(change.posterior.log_total >= np.log(MIN_ODDS_OF_CHANGE))

    def search(swap: bool) -> tuple[list[Accepted], float, float]:
        """Return at most four changes, the log odds of one more, and the log evidence of all.

        The latter is the sum of the changes' log masses, by which two such lists are compared.
        swap : whether another robot is among the candidates
        """
        next_given = partial(_most_probable_change, model, hypotheses, swap=swap)
        found, last = stepwise(next_given, sure, 4)
        again = compared_again(found, next_given)
        accepted = list({a.candidate.label: a for a in again if sure(a)}.values())
        return accepted, last.posterior.log_total, sum(a.score for a in found)

    accepted, remaining, score = search(swap=False)
    if len(accepted) < 2:
        return accepted, remaining, ("", 0.0)
    swapped, more, other = search(swap=True)
    labels = [a.candidate.label for a in swapped]
    if ANOTHER_ROBOT not in labels:
        return accepted, remaining, ("", 0.0)
    chance = float(1 / (1 + np.exp(np.clip(score - other, -500, 500))))
    if chance < 0.5:
        return accepted, remaining, (ANOTHER_ROBOT, chance)
    swap = [a.candidate.label for a in accepted if a.candidate.label not in labels]
    return swapped, more, (" with ".join(swap), 1 - chance)


def _given(model: LinearModel, accepted: Sequence[Accepted]) -> tuple[LinearModel, Array]:
    """Return the model with accepted changes' sizes as priors, and the indices of their columns.

    The prior standard deviations of their amplitudes are `kappa` times the usual sizes.
    """
    prior = np.ones(model.width)
    for a in accepted:
        prior[a.group] = a.kappa
    given = replace(model, cause_prior=prior)
    take_over_cache(given, model)
    return given, np.unique(np.concatenate([NO_COLUMNS, *(a.group for a in accepted)]))


def _most_probable_change(
    model: LinearModel, hypotheses: Sequence[Hypothesis], accepted: Sequence[Accepted], *, swap: bool
) -> Accepted:
    """Return the most probable change in addition to accepted ones.

    It is of the most probable candidate, its most probable course, and the onset of that.

    swap : whether another robot is among the candidates, unless it is accepted already
    """
    swap = swap and all(a.candidate.kind != ANOTHER_ROBOT for a in accepted)
    some = {h.label: h for h in hypotheses if swap or h.candidate.kind != ANOTHER_ROBOT}
    weight = np.array([h.weight for h in some.values()])
    if not swap:  # of all frequencies those of the other kinds sum to less than one
        kinds = {h.candidate.kind for h in hypotheses}
        often = evidence.RELATIVE_FREQUENCY
        weight *= sum(often[k] for k in kinds) / sum(often[k] for k in kinds - {ANOTHER_ROBOT})
    given, chosen = _given(model, accepted)
    sizes = np.full(len(evidence.KAPPAS), 1 / len(evidence.KAPPAS))
    base, groups = marginals_of(given).log_base(chosen), [h.group for h in some.values()]
    factors, grids = log_factors(marginals_of(given).log_grids(groups, chosen), base, sizes)
    logs = {(label, 0): log for label, log in zip(some, factors.tolist(), strict=True)}
    weights = dict(zip(some, weight.tolist(), strict=True))
    posterior = Posterior.of_variants(logs, weights, max(1e-12, 1 - float(weight.sum())))
    mass = posterior.log_mass

    def best(own: Iterable[str], key: Callable[[Hypothesis], object]) -> list[str]:
        """Return those hypotheses among some that share the most probable value of a key."""
        sets: dict[object, list[str]] = {}
        for k in own:
            sets.setdefault(key(some[k]), []).append(k)
        return best_of(sets.values(), lambda one: float(np.logaddexp.reduce([mass[k] for k in one])), logs=True)

    own = best(best(some, lambda h: h.candidate.label), lambda h: h.course)
    top = best_of(own, mass.__getitem__, logs=True)
    by_label = dict(zip(some, grids[:, 0, 0] - base[0, 0] + np.log(weight)[:, None] - np.log(sizes), strict=True))
    kappa = float(evidence.KAPPAS[first_of_best(by_label[top], logs=True)])
    score = max(float(by_label[k].max()) for k in own)
    return Accepted(**vars(some[top]), kappa=kappa, posterior=posterior, score=score)


def weighted_hypotheses(
    candidates: Sequence[Candidate], often: Mapping[str, float], times: Array, *, dated: bool
) -> Iterator[tuple[Candidate, Course, Array, Array, Array]]:
    """Yield each candidate with each of its courses: candidate, course, weights, onsets, factors.

    The last three are as of `courses_of`; the weights are multiplied by the candidate's prior
    probability.

    often : relative frequency of each kind of change, which is divided equally among its candidates
    """
    kinds = [c.kind for c in candidates]
    whole = sum(often[kind] for kind in set(kinds))
    for c in candidates:
        share = often[c.kind] / whole / kinds.count(c.kind)
        for course, weight, since, courses in courses_of(c.kind, times, dated):
            yield c, course, share * weight, since, courses


def courses_of(kind: str, times: Array, dated: bool) -> Iterable[tuple[Course, Array, Array, Array]]:
    """Yield the courses that a kind of change may have: name, prior weights, onsets, factors.

    The weights, (c,), are for each onset; the onsets, (c,), are the first campaigns that show the
    change, from 0; the k factors of the change in each of n campaigns have the shape (c, n, k).
    """
    n = len(times)
    since = np.arange(1, n)
    # Prior probability of each onset. It does not depend on n, so that all sum to less than one: half
    # of it is 1 / (k (k + 1)) at campaign k from 1; half is geometric, a change begins with a
    # probability of 0.03 where it did not begin before.
    onset = 0.5 / (since * (since + 1)) + 0.5 * 0.03 * (1 - 0.03) ** (since - 1)
    kinds: list[Course] = ["jump"]
    # All kinds of change may jump; these may drift.
    if kind in ("joint_zero", "joint_stiffness", "joint_curve", "lengths", "foot"):
        kinds.append("drift")
    if kind == "lengths" and dated:
        kinds.append("season")
    if kind == ANOTHER_ROBOT and n > 2:
        kinds.append("once")
    weights = [0.6, 0.4, 0.4, 0.4][: len(kinds)]  # a jump is the most probable one
    for course, weight in zip(kinds, weights, strict=True):
        share = weight / sum(weights)
        if course == "season":
            yield course, np.array([share]), np.array([1]), evidence.season(times)
        elif course == "once":  # in the last campaign alone it is a jump
            yield course, share * onset[:-1], since[:-1], np.eye(n)[1:-1, :, None]
        else:
            yield course, share * onset, since, evidence.jumps(n) if course == "jump" else evidence.drifts(times)


def _change(
    model: LinearModel,
    hypotheses: Sequence[Hypothesis],
    accepted: Sequence[Accepted],
    k: int,
    first: Estimate,
    swap: tuple[str, float],
) -> Change:
    """Return the accepted change k as a result, with its possible causes, amounts and course."""
    change = accepted[k]
    masses = np.array([change.posterior.log_mass.get(h.label, -np.inf) for h in hypotheses])
    share = np.exp(masses - np.logaddexp.reduce(masses))
    at: dict[tuple[str, Course], list[int]] = {}
    for i, h in enumerate(hypotheses):
        at.setdefault((h.candidate.label, h.course), []).append(i)
    label, same = change.candidate.label, at[change.candidate.label, change.course]
    probability = sum(float(share[own].sum()) for (name, _), own in at.items() if name == label)
    begun = share[same] / share[same].sum()
    enough = int(np.searchsorted(np.cumsum(np.sort(begun)[::-1]), 0.95)) + 1
    likely = [hypotheses[same[i]].since for i in ranked(begun)[:enough]]
    rivals: dict[str, Rival] = {}
    for (name, course), own in at.items():
        if not np.isfinite(masses[own]).any():  # not compared
            continue
        old, mass = rivals.get(name), float(share[own].sum())
        more = (old.probability if old else 0.0) + mass
        if old and old.probability > mass:
            rivals[name] = replace(old, probability=more)
        else:
            rivals[name] = Rival(name, course, hypotheses[own[first_of_best(share[own])]].since, more)
    other, chance = swap if ANOTHER_ROBOT in (change.candidate.kind, swap[0]) else ("", 0.0)
    rivals = {name: replace(r, probability=(1 - chance) * r.probability) for name, r in rivals.items()}
    if other:
        rivals[other] = Rival(other, "jump", change.since, chance)
    given, columns = _given(model, accepted)
    values, errors = Fit(given, columns, 1.0, 1.0).causes
    places = np.searchsorted(columns, change.group)
    values, errors = (x[places] * np.resize(change.candidate.sizes, len(places)) for x in (values, errors))
    if change.candidate.kind == "lengths":
        waves = ["lengths"] if len(values) == 1 else ["lengths, sine", "lengths, cosine"]
        amounts = [Amount(*own, "um/m") for own in zip(waves, 1e6 * values, 1e6 * errors, strict=True)]
    else:  # those of the first factor of the course
        amounts = []
        for name, *own in zip(change.candidate.names, values, errors, strict=False):
            p = first.robot.parameters[name]
            value, error = (p.readable(float(x) * p.scale) for x in own)
            amounts.append(Amount(name, value, error, p.readable_unit))
    # Size in each campaign along the change's own direction, relative to the whole change.
    direction = change.candidate.columns @ values[: len(change.candidate.sizes)]
    n = len(model.J)
    alone = np.zeros((n, model.J.shape[1], n - 1))
    alone[np.arange(1, n), :, np.arange(n - 1)] = (model.J @ direction)[1:]
    given, columns = _given(model, [a for i, a in enumerate(accepted) if i != k])
    given = given.with_base(columns)
    given = replace(given, E=array_columns(alone), cause_prior=np.full(n - 1, 100.0))
    by_campaign = Fit(given, np.arange(n - 1), 1.0, 1.0).causes
    return Change(
        change.candidate,
        change.course,
        change.since,
        (min(likely), max(likely)),
        (1 - chance) * probability,
        float(share[same].sum()) / probability,
        change.posterior.log_total,
        tuple(sorted(rivals.values(), key=lambda r: -r.probability)),
        tuple(amounts),
        np.vstack([[0.0, 0.0], np.column_stack(by_campaign)]),
    )


def _detectable_sizes(
    model: LinearModel, hypotheses: Sequence[Hypothesis], accepted: Sequence[Accepted], first: Estimate
) -> Iterator[tuple[str, float, str]]:
    """Yield (cause, size, unit): the smallest change in the last campaign that would be detected.

    Only joint zeros and joint stiffnesses are listed; the size is in readable units, and infinite
    if it would have to be 30 times the usual one. Accepted changes that only the last campaign
    shows do not count if they share a parameter with it.
    """
    last = len(model.r) - 1
    for h in hypotheses:
        c = h.candidate
        if h.since == last and h.course == "jump" and c.kind in ("joint_zero", "joint_stiffness"):
            alone = [a for a in accepted if a.since == last and a.course != "season"]
            others = [a for a in accepted if a not in alone or {*a.candidate.names}.isdisjoint(c.names)]
            given, columns = _given(model, others)
            given = replace(given.with_base(columns), cause_prior=np.full(model.width, 1e3))
            _, (error,) = Fit(given, h.group, 1.0, 1.0).causes
            # A change is detected from roughly five standard errors on, because it competes with
            # about a hundred candidates. One of 30 times its usual size counts as not detectable.
            size, p = 5.0 / np.sqrt(max(error**-2.0 - 1e-6, 1e-30)), first.robot.parameters[c.names[0]]
            readable = p.readable(float(size * c.sizes[0]) * p.scale) if size < 30.0 else float("inf")
            yield c.label, readable, p.readable_unit


def _placements(
    campaigns: Sequence[Estimate], names: Sequence[str], model: LinearModel, columns: Array
) -> Iterator[tuple[str, str]]:
    """Yield ("tool", text) and ("base", text): how they moved before the last campaign.

    They are compared with those of the campaign before, where they were fitted again in each: the
    measured point on the flange of a tool of the same name, and the base, unless it did not move.
    """
    first, (before, after) = campaigns[0], campaigns[-2:]
    fit = Fit(model, columns, 1.0, 1.0)
    # A campaign's shared parameters from the solved ones, theta and the changes so far.
    moved = model.E.factors(columns=columns).columns_at(np.broadcast_to(np.eye(len(names)), model.J.shape))

    def between(own: Sequence[str]) -> tuple[Array, Array]:
        """Return the last campaign's values of `own` less those of the one before, with covariance.

        Returns the difference, shape (k,), and its covariance, shape (k, k), both in units of scale
        """
        X, Y = (np.hstack([np.eye(len(names)), moved[k]]) for k in (-2, -1))
        a, A, V = _refitted(before, own, names, first, X, fit.x)
        b, B, W = _refitted(after, own, names, first, Y, fit.x)
        return b - a, V + W + (B - A) @ fit.covariance @ (B - A).T

    own = [n for n in PLACEMENT_PARAMETERS["tool"][:3] if n in before.names and n in after.names and n not in names]
    # Smallest displacement of tool or base that is reported as more than noise [standard errors,
    # rms of the coordinates]; noise alone exceeds it in one of a hundred pairs.
    least = 2.0
    if len(own) == 3 and before.robot.tool_name == after.robot.tool_name:
        apart, cov = between(own)
        scale = np.array([after.robot.parameters[n].scale for n in own])
        size = float(np.linalg.norm(apart * scale))
        error = float(np.sqrt(np.trace(cov * np.outer(scale, scale)) / 3))
        distance = float(np.sqrt(apart @ np.linalg.solve(cov, apart) / 3))
        # Only a displacement of the tool's point of more than four standard errors (rms of the
        # coordinates) is reported as another tool, or as the same one mounted again.
        if distance > 4.0:
            words = "another tool, or mounted again"
        elif distance > least:
            words = "more than noise alone, too little for another tool"
        else:
            words = "the same point, as far as these poses show"
        yield "tool", f"{1e3 * size:.3g} mm from where it was, +/- {1e3 * error:.2g} mm per coordinate: {words}"
    placing = {p.name for p in after.robot.parameters if p.group == "base"}
    if not placing & set(after.names) or placing & set(names):
        return
    T = np.linalg.solve(_base_pose(before), _base_pose(after))
    # Readings that do not determine the base leave it exactly as in the robot file [m, rad].
    if np.allclose(T, np.eye(4), rtol=0, atol=1e-12):
        return
    turn = float(np.rad2deg(np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1))))
    words = "the instrument stands elsewhere, or the robot's foot moved"
    if set(PLACEMENT_PARAMETERS["base"]) <= {*before.names} & {*after.names}:
        _, cov = between(PLACEMENT_PARAMETERS["base"])
        apart = np.concatenate([T[:3, 3], to_xyz(T[:3, :3])])
        apart = apart / [after.robot.parameters[n].scale for n in PLACEMENT_PARAMETERS["base"]]
        if apart @ np.linalg.solve(cov, apart) < len(apart) * least**2:
            words = "the same place, as far as these poses show"
    far = f"{1e3 * np.linalg.norm(T[:3, 3]):.3g} mm and {turn:.3g} deg"
    yield "base", f"{far} from where it stood in the instrument's frame: {words}"


def _refitted(
    c: Estimate, own: Sequence[str], names: Sequence[str], first: Estimate, X: Array, u: Array
) -> tuple[Array, Array, Array]:
    """Return the parameters `own` of a campaign as refitted given the p shared ones.

    They are the mean, (r,), its derivative by u, (r, len(u)), and the covariance given u, (r, r),
    in units of scale.

    X : matrix, shape (p, len(u)); X u are the campaign's shared parameters less those of the first
    """
    shared, rest, V = c.refitted_given(names)
    G = -V @ c.information[np.ix_(rest, shared)]
    from_first = np.array([first.values[first.names.index(n)] for n in names])
    departure = (from_first - c.values[shared]) / c.scale[shared] + X @ u
    mean = c.values[rest] / c.scale[rest] + V @ c.score[rest] + G @ departure
    at = [list(rest).index(c.names.index(n)) for n in own]
    return mean[at], (G @ X)[at], V[np.ix_(at, at)]


def _base_pose(c: Estimate) -> Array:
    """Return the pose of a campaign's base in the measuring frame, shape (4, 4) [m].

    Where no base is fitted, the pose of the first DH row's frame is returned.
    """
    if c.robot.base.unknown == "none":  # the first row of the table places the robot
        return np.asarray(c.robot.base.T @ row_matrix(c.robot.joints[0]))
    values = [c.values[c.names.index(n)] if n in c.names else 0.0 for n in PLACEMENT_PARAMETERS["base"]]
    return np.asarray(c.robot.base.T @ np.array(small_frame(*values)))
