"""Comparison of campaigns: which parameter or effect changed, when, by how much, how surely.

Base and tool are fitted again in each campaign; how they differ, and the smallest change that would
be detected, are reported too. The evidence of a change is computed in `casadical.fleet.evidence`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.statistics import first_of_best, ranked
from casadical.core.transforms import small_frame, to_xyz
from casadical.fleet import evidence
from casadical.fleet.changes import MIN_ODDS_OF_CHANGE, Amount, Change, Comparison, Rival
from casadical.fleet.estimates import Estimate, with_common_noise
from casadical.fleet.evidence import ANOTHER_ROBOT, Candidate, Course
from casadical.identification.prior import refuse_another
from casadical.robot.axes import row_matrix
from casadical.robot.parameter_list import PLACEMENT_PARAMETERS

# Prior weights of the courses; of each kind of change the weights of its courses are normalised.
COURSE_WEIGHTS: dict[Course, float] = {"jump": 0.6, "drift": 0.4, "season": 0.4, "once": 0.4}
# Days in a year, the unit of time of a drift [d].
DAYS_PER_YEAR = 365.25
# Number of campaigns that count as a year where they have no dates.
CAMPAIGNS_PER_YEAR = 12.0
# Smallest displacement of tool or base that is reported as more than noise [standard errors, rms of
# the coordinates]; noise alone exceeds it in one of a hundred pairs.
MOVED_SIGMAS = 2.0


@dataclass(frozen=True, eq=False)
class _Hypotheses:
    """All changes of one candidate with one course, one for each onset.

    candidate, course : what changes, and how over time
    since : first campaign that shows the change, from 0, shape (onsets,)
    courses : k factors of the change in each campaign, shape (onsets, campaigns, k)
    H, b : information and score of its amplitudes, as of `evidence.marginal_information`
    logs : logarithm of the Bayes factor times the prior weight, for each size on the grid
        `evidence.KAPPAS`, shape (onsets, kappas)
    """

    candidate: Candidate
    course: Course
    since: Array
    courses: Array
    H: Array
    b: Array
    logs: Array


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
    accepted, remaining, swap = changes_in(information, candidates, times, dated=first.day is not None)
    model = _model_given(information, accepted)
    changes = tuple(_change(information, accepted, k, first, swap) for k in range(len(accepted)))

    def model_before(c: Candidate) -> evidence.Model:
        """Return the model given the accepted changes, less those of the last campaign alone in c.

        Changes that only the last campaign shows are excluded if they share a parameter with c.
        """
        others = [a for a in accepted if a.courses[:-1].any() or not {*a.candidate.names} & {*c.names}]
        return _model_given(information, others)

    seen, placements = _detectable_sizes(model_before, candidates, first), _placements(campaigns, names, model)
    noted = tuple(dict.fromkeys(notes))
    return Comparison(tuple(campaigns), names, changes, remaining, tuple(seen), tuple(placements), noted)


def shared_information(
    campaigns: Sequence[Estimate], *, same_tool: bool, same_frame: bool
) -> tuple[tuple[str, ...], evidence.SharedInformation, tuple[Candidate, ...]]:
    """Return the names of the shared parameters, the information on them, and the candidates.

    The information is about the values of the first campaign, with day-to-day differences
    marginalised; the candidates are those for changes in these parameters.

    same_tool, same_frame : as of `compare`
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
    candidates = evidence.candidates_of(first.robot, names)
    information = evidence.SharedInformation(H, b, spread**-2.0).with_jitter(*evidence.daily(candidates))
    return names, information, candidates


@dataclass(frozen=True, eq=False)
class _Accepted:
    """The most probable change of a step of the search.

    candidate : what changes
    courses : k factors of the change in each campaign, shape (n, k)
    kappa : most probable ratio of the change's size to its usual one
    own : all hypotheses of its candidate with its course, one for each onset
    odds : natural logarithm of the odds of any change in this step, given those accepted before
    every : hypotheses of all candidates and courses in this step
    """

    candidate: Candidate
    courses: Array
    kappa: float
    own: _Hypotheses
    odds: float
    every: Sequence[_Hypotheses]


def changes_in(
    information: evidence.SharedInformation, candidates: Sequence[Candidate], times: Array, *, dated: bool
) -> tuple[list[_Accepted], float, tuple[str, float]]:
    """Return the accepted changes, the log odds of an additional one, and a rival explanation.

    Several changes are compared with another robot plus what else changed then; the rival
    explanation is the label and probability of the one that was not taken, ("", 0) without one.
    Whether there is any change is decided without another robot: it has so many parameters that a
    change which only it could explain would be a false one.

    times : time of each campaign, shape (n,) [years]; dated : whether they come from dates
    """
    accepted, remaining, score = _stepwise_changes(
        information, [c for c in candidates if c.kind != ANOTHER_ROBOT], times, dated
    )
    if len(accepted) < 2:
        return accepted, remaining, ("", 0.0)
    swapped, more, other = _stepwise_changes(information, candidates, times, dated)
    labels = [a.candidate.label for a in swapped]
    if ANOTHER_ROBOT not in labels:
        return accepted, remaining, ("", 0.0)
    chance = float(1 / (1 + np.exp(np.clip(score - other, -500, 500))))
    if chance < 0.5:
        return accepted, remaining, (ANOTHER_ROBOT, chance)
    swap = [a.candidate.label for a in accepted if a.candidate.label not in labels]
    return swapped, more, (" with ".join(swap), 1 - chance)


def _stepwise_changes(
    information: evidence.SharedInformation, candidates: Sequence[Candidate], times: Array, dated: bool
) -> tuple[list[_Accepted], float, float]:
    """Return at most four changes found one by one, log odds of one more, and log evidence of all.

    The log odds are those of an additional change against none. The log evidence is the sum of the
    changes' logarithms of Bayes factor times prior weight, by which two such lists are compared.

    times, dated : as of `changes_in`
    """
    accepted: list[_Accepted] = []
    score = 0.0
    while True:
        best = _most_probable_change(information, candidates, times, dated, accepted)
        if best.odds < np.log(MIN_ODDS_OF_CHANGE) or len(accepted) == 4:
            break
        accepted.append(best)
        score += float(best.own.logs.max())
    if len(accepted) > 1:  # each is searched again, given the others
        for k in range(len(accepted)):
            others = [a for i, a in enumerate(accepted) if i != k]
            accepted[k] = _most_probable_change(information, candidates, times, dated, others)
        accepted = [a for a in accepted if a.odds >= np.log(MIN_ODDS_OF_CHANGE)]
        accepted = list({a.candidate.label: a for a in accepted}.values())
    return accepted, best.odds, score


def _model_given(information: evidence.SharedInformation, accepted: Sequence[_Accepted]) -> evidence.Model:
    """Return the posterior of theta and of the amplitudes of accepted changes from all campaigns.

    Theta is the deviation of the p shared parameters, in units of their scale; the amplitudes have
    prior standard deviations of `kappa` times the usual sizes of their candidates.
    """
    n, p = information.score.shape
    columns = [np.einsum("nk,pm->npkm", a.courses, a.candidate.columns).reshape(n, p, -1) for a in accepted]
    sizes = [np.tile(a.kappa * a.candidate.sizes, a.courses.shape[1]) for a in accepted]
    whole = np.concatenate([np.zeros((n, p, 0)), *columns], axis=2)
    return evidence.solve(information, whole, np.concatenate([np.zeros(0), *sizes]))


def _most_probable_change(
    information: evidence.SharedInformation,
    candidates: Sequence[Candidate],
    times: Array,
    dated: bool,
    accepted: Sequence[_Accepted],
) -> _Accepted:
    """Return the most probable change in addition to accepted ones.

    times, dated : as of `changes_in`
    """
    model = _model_given(information, accepted)
    if any(a.candidate.kind == ANOTHER_ROBOT for a in accepted):
        candidates = [c for c in candidates if c.kind != ANOTHER_ROBOT]
    hypotheses: list[_Hypotheses] = []
    prior = 0.0
    for candidate, course, weight, since, courses in weighted_hypotheses(
        candidates, evidence.RELATIVE_FREQUENCY, times, dated=dated
    ):
        H, b = evidence.marginal_information(model, candidate.columns, courses)
        logs = evidence.log_evidence(H, b, np.tile(candidate.sizes, courses.shape[2])) + np.log(weight)[:, None]
        prior += float(weight.sum())
        hypotheses.append(_Hypotheses(candidate, course, since, courses, H, b, logs))
    total = float(np.logaddexp.reduce(np.concatenate([evidence.averaged(h.logs) for h in hypotheses])))
    odds = float(np.logaddexp(total, np.log(max(1e-12, 1 - prior))))
    by_label: dict[str, list[float]] = {}
    for h in hypotheses:
        by_label.setdefault(h.candidate.label, []).extend(evidence.averaged(h.logs))
    label = list(by_label)[
        first_of_best([float(np.logaddexp.reduce(np.array(own))) for own in by_label.values()], logs=True)
    ]
    own = [h for h in hypotheses if h.candidate.label == label]
    top = own[first_of_best([float(np.logaddexp.reduce(evidence.averaged(h.logs), axis=None)) for h in own], logs=True)]
    k = first_of_best(evidence.averaged(top.logs), logs=True)
    sizes = np.tile(top.candidate.sizes, top.courses.shape[2])
    _, _, kappa = evidence.amplitude(top.H[k], top.b[k], sizes, top.logs[k])
    return _Accepted(top.candidate, top.courses[k], kappa, top, odds, hypotheses)


def weighted_hypotheses(
    candidates: Sequence[Candidate], often: Mapping[str, float], times: Array, *, dated: bool
) -> Iterator[tuple[Candidate, Course, Array, Array, Array]]:
    """Yield each candidate with each of its courses: candidate, course, weights, onsets, factors.

    The last three are as of `courses_of`; the weights are multiplied by the candidate's prior
    probability.

    often : relative frequency of each kind of change, which is divided equally among its candidates
    times, dated : as of `changes_in`
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

    times, dated : as of `changes_in`; there is a season only with dates
    """
    n = len(times)
    onset, since = _onsets(n), np.arange(1, n)
    kinds: list[Course] = ["jump"]
    if kind in evidence.GRADUAL_KINDS:
        kinds.append("drift")
    if kind in evidence.SEASONAL_KINDS and dated:
        kinds.append("season")
    if kind == ANOTHER_ROBOT and n > 2:
        kinds.append("once")
    whole = sum(COURSE_WEIGHTS[c] for c in kinds)
    for course in kinds:
        share = COURSE_WEIGHTS[course] / whole
        if course == "season":
            yield course, np.array([share]), np.array([1]), evidence.season(times)
        elif course == "once":  # in the last campaign alone it is a jump
            yield course, share * onset[:-1], since[:-1], np.eye(n)[1:-1, :, None]
        else:
            yield course, share * onset, since, evidence.jumps(n) if course == "jump" else evidence.drifts(times)


def _onsets(n: int) -> Array:
    """Return the prior probability of an onset at each of n campaigns but the first, (n - 1,).

    It does not depend on n, so that all sum to less than one: half of it is 1 / (k (k + 1)) at
    campaign k from 1, half is geometric.
    """
    k = np.arange(1, n)
    # Probability that a change begins at a campaign, given that it did not begin before, in the
    # geometric half of the prior of `_onsets`.
    onset_hazard = 0.03
    return np.asarray(0.5 / (k * (k + 1)) + 0.5 * onset_hazard * (1 - onset_hazard) ** (k - 1))


def _change(
    information: evidence.SharedInformation,
    accepted: Sequence[_Accepted],
    k: int,
    first: Estimate,
    swap: tuple[str, float],
) -> Change:
    """Return the accepted change k as a result, with its possible causes, amounts and course.

    first : estimate of the first campaign
    swap : rival explanation of all changes together: label and probability, as of `changes_in`
    """
    change = accepted[k]
    candidate, top = change.candidate, change.own
    total = float(np.logaddexp.reduce(np.concatenate([evidence.averaged(h.logs) for h in change.every])))
    share = [(h, np.exp(evidence.averaged(h.logs) - total)) for h in change.every]
    own = [(h, s) for h, s in share if h.candidate.label == candidate.label]
    probability = float(sum(s.sum() for _, s in own))
    at = first_of_best(evidence.averaged(top.logs), logs=True)
    begun = np.exp(evidence.averaged(top.logs) - np.logaddexp.reduce(evidence.averaged(top.logs), axis=None))
    likely = top.since[np.sort(ranked(begun)[: int(np.searchsorted(np.cumsum(np.sort(begun)[::-1]), 0.95)) + 1])]
    rivals: dict[str, Rival] = {}
    for h, s in share:
        label, best = h.candidate.label, first_of_best(s)
        old = rivals.get(label)
        more = (old.probability if old else 0.0) + float(s.sum())
        if old and old.probability > s.sum():
            rivals[label] = replace(old, probability=more)
        else:
            rivals[label] = Rival(label, h.course, int(h.since[best]), more)
    other, chance = swap if ANOTHER_ROBOT in (candidate.kind, swap[0]) else ("", 0.0)
    rivals = {label: replace(r, probability=(1 - chance) * r.probability) for label, r in rivals.items()}
    if other:
        rivals[other] = Rival(other, "jump", int(top.since[at]), chance)
    m = top.courses.shape[2]
    a, C, _ = evidence.amplitude(top.H[at], top.b[at], np.tile(candidate.sizes, m), top.logs[at])
    others = [other for i, other in enumerate(accepted) if i != k]
    # Size in each campaign along the change's own direction, relative to the whole change.
    direction = (candidate.columns @ a[: len(candidate.sizes)])[:, None]
    n = len(information.score)
    H, score = evidence.marginal_information(_model_given(information, others), direction, np.eye(n)[:, 1:][None])
    course = np.linalg.inv(H[0] + np.diag(np.full(n - 1, 1e-4)))
    return Change(
        candidate,
        top.course,
        int(top.since[at]),
        (int(likely.min()), int(likely.max())),
        (1 - chance) * probability,
        float(sum(s.sum() for h, s in own if h.course == top.course)) / probability,
        change.odds,
        tuple(sorted(rivals.values(), key=lambda r: -r.probability)),
        tuple(_amounts(candidate, first, a, C, m)),
        np.vstack([[0.0, 0.0], np.column_stack([course @ score[0], np.sqrt(np.diag(course))])]),
    )


def _amounts(candidate: Candidate, first: Estimate, a: Array, C: Array, waves: int) -> Iterable[Amount]:
    """Yield the change of each parameter in readable units, or that of all lengths [um/m].

    first : estimate of the first campaign
    a, C : posterior mean, (k m,), and covariance, (k m, k m), of the m amplitudes for each factor
    waves : number k of factors of the course, 2 for a season, else 1
    """
    width = len(candidate.sizes)
    if candidate.kind == "lengths":
        for w in range(waves):
            name = "lengths" if waves == 1 else f"lengths, {('sine', 'cosine')[w]}"
            yield Amount(name, 1e6 * a[w], 1e6 * float(np.sqrt(C[w, w])), "um/m")
        return
    for k, name in enumerate(candidate.names[:width]):
        p = first.robot.parameters[name]
        yield Amount(name, p.readable(a[k] * p.scale), p.readable(float(np.sqrt(C[k, k])) * p.scale), p.readable_unit)


# Function from names of r parameters to the last campaign's values less those of the one before,
# shape (r,), and their covariance, shape (r, r), both in units of scale.
Between = Callable[[Sequence[str]], tuple[Array, Array]]


def _detectable_sizes(
    model_before: Callable[[Candidate], evidence.Model], candidates: Sequence[Candidate], first: Estimate
) -> Iterator[tuple[str, float, str]]:
    """Yield (cause, size, unit): the smallest change in the last campaign that would be detected.

    Only joint zeros and joint stiffnesses are listed; the size is in readable units, and infinite
    if it would have to be 30 times the usual one.

    model_before : function from a candidate to the model without its change in the last campaign
    first : estimate of the first campaign
    """
    for c in candidates:
        if c.columns.shape[1] == 1 and c.kind in ("joint_zero", "joint_stiffness"):
            model = model_before(c)
            H, _ = evidence.marginal_information(model, c.columns, evidence.jumps(len(model.shared.score))[-1:])
            p = first.robot.parameters[c.names[0]]
            # A change is detected from roughly five standard errors on, because it competes with
            # about a hundred candidates.
            size = 5.0 / np.sqrt(max(float(H[0, 0, 0]), 1e-30))
            # A change that would have to be 30 times its usual size counts as not detectable.
            seen = size < 30.0 * float(c.sizes[0])
            yield c.label, p.readable(float(size) * p.scale) if seen else float("inf"), p.readable_unit


def _placements(
    campaigns: Sequence[Estimate], names: Sequence[str], model: evidence.Model
) -> Iterator[tuple[str, str]]:
    """Yield ("tool", text) and ("base", text): how they moved before the last campaign.

    They are compared with those of the campaign before, where they were fitted again in each.

    names : shared parameters; model : posterior of these and of the accepted changes
    """
    first, (before, after) = campaigns[0], campaigns[-2:]

    def between(own: Sequence[str]) -> tuple[Array, Array]:
        """Return the last campaign's values of `own` less those of the one before, with covariance.

        own : names of k parameters that were fitted again in each campaign
        Returns the difference, shape (k,), and its covariance, shape (k, k); see `Between`
        """
        # X, Y: a campaign's shared parameters from the solved ones, theta and the changes so far.
        X, Y = (np.hstack([np.eye(model.p), model.columns[k]]) for k in (-2, -1))
        a, A, V = _refitted(before, own, names, first, X, model.mean)
        b, B, W = _refitted(after, own, names, first, Y, model.mean)
        return b - a, V + W + (B - A) @ model.inverse @ (B - A).T

    yield from _tool(before, after, names, between)
    yield from _base(before, after, names, between)


def _tool(before: Estimate, after: Estimate, names: Sequence[str], between: Between) -> Iterator[tuple[str, str]]:
    """Yield ("tool", text): by how many mm the measured point moved on the flange, and its meaning.

    Nothing is yielded if it was not fitted in each campaign, or the tool has another name.

    names : shared parameters; between : difference of the two campaigns, see `Between`
    """
    own = [n for n in PLACEMENT_PARAMETERS["tool"][:3] if n in before.names and n in after.names and n not in names]
    if len(own) < 3 or before.robot.tool_name != after.robot.tool_name:
        return
    apart, cov = between(own)
    scale = np.array([after.robot.parameters[n].scale for n in own])
    size = float(np.linalg.norm(apart * scale))
    error = float(np.sqrt(np.trace(cov * np.outer(scale, scale)) / 3))
    distance = float(np.sqrt(apart @ np.linalg.solve(cov, apart) / 3))
    # Only a displacement of the tool's point of more than four standard errors (rms of the
    # coordinates) is reported as another tool, or as the same one mounted again.
    if distance > 4.0:
        words = "another tool, or mounted again"
    elif distance > MOVED_SIGMAS:
        words = "more than noise alone, too little for another tool"
    else:
        words = "the same point, as far as these poses show"
    yield "tool", f"{1e3 * size:.3g} mm from where it was, +/- {1e3 * error:.2g} mm per coordinate: {words}"


def _refitted(
    c: Estimate, own: Sequence[str], names: Sequence[str], first: Estimate, X: Array, u: Array
) -> tuple[Array, Array, Array]:
    """Return the parameters `own` of a campaign as refitted given the p shared ones.

    They are the mean, (r,), its derivative by u, (r, len(u)), and the covariance given u, (r, r),
    in units of scale.

    own : names of the r parameters; names : names of the p shared ones
    first : estimate of the first campaign
    X : matrix, shape (p, len(u)); X u are the campaign's shared parameters less those of the first
    u : posterior mean of the solved variables, see `evidence.Model`
    """
    shared, rest, V = c.refitted_given(names)
    G = -V @ c.information[np.ix_(rest, shared)]
    from_first = np.array([first.values[first.names.index(n)] for n in names])
    departure = (from_first - c.values[shared]) / c.scale[shared] + X @ u
    mean = c.values[rest] / c.scale[rest] + V @ c.score[rest] + G @ departure
    at = [list(rest).index(c.names.index(n)) for n in own]
    return mean[at], (G @ X)[at], V[np.ix_(at, at)]


def _base(before: Estimate, after: Estimate, names: Sequence[str], between: Between) -> Iterator[tuple[str, str]]:
    """Yield ("base", text): by how many mm and deg the base moved in the measuring frame.

    Nothing is yielded if it was not fitted again in the last campaign, or did not move at all.

    names : shared parameters; between : difference of the two campaigns, see `Between`
    """
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
        if apart @ np.linalg.solve(cov, apart) < len(apart) * MOVED_SIGMAS**2:
            words = "the same place, as far as these poses show"
    far = f"{1e3 * np.linalg.norm(T[:3, 3]):.3g} mm and {turn:.3g} deg"
    yield "base", f"{far} from where it stood in the instrument's frame: {words}"


def _base_pose(c: Estimate) -> Array:
    """Return the pose of a campaign's base in the measuring frame, shape (4, 4) [m].

    Where no base is fitted, the pose of the first DH row's frame is returned.
    """
    if c.robot.base.unknown == "none":  # the first row of the table places the robot
        return np.asarray(c.robot.base.T @ row_matrix(c.robot.joints[0]))
    values = [c.values[c.names.index(n)] if n in c.names else 0.0 for n in PLACEMENT_PARAMETERS["base"]]
    return np.asarray(c.robot.base.T @ np.array(small_frame(*values)))
