"""Noise models that compete with the causes: autocorrelated, heavy-tailed, or one noisy joint.

Each form is compared by its marginal likelihood. Given causes in the model, another form of
instrument noise counts as "no additional cause", while a joint with large repeatability error
counts as an unlisted cause, unless a cause acts at this joint: the remaining error of that cause
looks like poor repeatability. While the leading candidate is an effect whose sizes are learnt once
it is in the model, noise of its joints is no rival.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.marginals import POINT_LOG_EVIDENCE_WINDOW
from casadical.core.statistics import best_of, first_of_best
from casadical.diagnosis.cross_validation import likely_noise
from casadical.diagnosis.evidence import RHO_GRID
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_evidence import WHITE_FORM, Form, Problem
from casadical.diagnosis.posterior import PRIOR_FIRST, PRIOR_FURTHER, Ranking, Rivals
from casadical.diagnosis.settings import SETTINGS
from casadical.measurements.measurements import Noise

# Label of autocorrelated (AR(1)) noise of the instrument in rankings and reports.
AR_NOISE = "autocorrelated noise"
# Label of heavy-tailed noise of the instrument in rankings and reports.
HEAVY_TAILS = "noise with heavy tails"
# Label of readings that lag behind the joints, by a random share of each pose's last motion.
RANDOM_LAG = "readings that lag behind the last motion"
# Candidate standard deviations of the lag of readings, as shares of each pose's last motion, divided
# by that of the joints' repeatability [1/rad].
LAG_SHARES = (5.0, 20.0, 80.0)
# Beginning of the label of a joint that repeats worse than the others.
NOISY_JOINT = "poor repeatability of joint "
# Labels of noise of the instrument that is larger along some axes than along others: those of its
# frame, any fixed ones, or the line of sight from its own place and the two across it.
UNEQUAL_AXES = (
    "noise that is unequal along x, y and z",
    "noise that is unequal along the instrument's own axes",
    "noise that is unequal along and across the line of sight",
)


def with_noise_forms(ranking: Ranking, case: Case, chosen: Array, joints: Collection[int | None] = ()) -> Ranking:
    """Return the ranking with other forms of noise among its candidates, renormalised.

    Under autocorrelated noise only its `noise_form` is set; given causes, it is returned unchanged
    where "no additional cause" has a probability above 0.9.
    chosen : indices of the columns of causes that are in the model already
    joints : joints (1-based) of these causes, whose poor repeatability counts as "no additional
        cause": it is the remaining error of their equations
    """
    if case.form.ar_coefficient:
        return replace(ranking, noise_form=AR_NOISE)
    # Given causes, other forms are evaluated only where "no additional cause" is not probable yet.
    seen = ranking.none <= (0.9 if len(chosen) else SETTINGS.max_p_nothing)
    if len(chosen) and not seen:
        return ranking
    prior = PRIOR_FURTHER if len(chosen) else PRIOR_FIRST
    first = ranking.order[0]
    unsized = {noisy_joint_label(part) for c in case.candidates if c.label == first for part in c.variants[0][0].parts}
    # Where no cause is detected, a noisy joint may be.
    lead = max(ranking.log_mass.values()) - ranking.log_none if len(chosen) else 0.0
    cache, key = case.evidence.cache.setdefault("noise_forms", {}), (chosen.tobytes(), seen, lead)
    if key not in cache:
        cache[key] = noise_forms(case, chosen, of_instrument=seen, lead=lead)
    forms = {label: form for label, form in cache[key].items() if label not in unsized}
    mass = {label: float(np.log(prior["unknown"])) + log for label, (log, _) in forms.items()}
    none, noise_form = ranking.log_none, ""
    if len(chosen):
        noise = (AR_NOISE, HEAVY_TAILS, *UNEQUAL_AXES, *(noisy_joint_label(j) for j in joints if j))
        own = {"": none, **{label: mass.pop(label) for label in noise if label in mass}}
        none = float(np.logaddexp.reduce(np.array([*own.values()])))
        noise_form = best_of(own, own.__getitem__, logs=True)
    rivals = {label: forms[label] for label in mass}
    noise_of = {**ranking.noise, **{label: noise for label, (_, noise) in forms.items()}}
    more = replace(ranking, noise=noise_of, log_none=none, noise_form=noise_form)
    return more.with_rivals(rivals, prior)


def noisy_joint(case: Case, ranking: Ranking) -> int | None:
    """Return the joint (1-based) whose poor repeatability is a ranking's most probable cause.

    None if another one is, or if "none" exceeds `Settings.max_p_nothing_further`.
    """
    labels = {noisy_joint_label(j): j for j in case.robot.numbers}
    return labels.get(ranking.order[0]) if ranking.none <= SETTINGS.max_p_nothing_further else None


def noisy_joint_label(joint: int) -> str:
    """Return the label of a joint's (1-based) poor repeatability in rankings and reports."""
    return f"{NOISY_JOINT}{joint}"


def noise_forms(case: Case, chosen: Array, *, of_instrument: bool = True, lead: float = 0.0) -> Rivals:
    """Return each form of noise by label: its log evidence over white noise, and its noise.

    The evidence is averaged over a form's settings; each of five kinds has a fifth of the prior.
    Forms that cannot come within `POINT_LOG_EVIDENCE_WINDOW` of white noise, or of a more probable
    cause, are left out.
    chosen : indices of the columns of causes in the model
    lead : log mass of the most probable cause over that of no additional cause [nats]
    of_instrument : whether autocorrelated and heavy-tailed noise of the instrument is included;
        unequal axes, a random lag and noisy joints are included in any case, where they apply
    """
    e = case.evidence
    problem, least = Problem(e, chosen, case.order), max(lead, 0.0) - POINT_LOG_EVIDENCE_WINDOW
    plain, joints = float(np.logaddexp.reduce(e.log_base(chosen), axis=None)), range(case.robot.n)
    kinds: list[tuple[str, Sequence[Form], int]] = []
    if of_instrument and e.stop is None:  # poses of one stop share how the joints repeat there
        numbers = e.count / len(e.r)
        kinds += [(AR_NOISE, [ar_form(share, len(e.r), numbers) for share in SETTINGS.ar_coefficients], 1)]
    if of_instrument:
        kinds += [(HEAVY_TAILS, [tails], 1) for tails in (heavy_tailed_form(problem, least),) if tails]
    if case.vectors is not None:
        unequal = unequal_forms(problem, case.positions[case.inliers][case.order], least)
        named = zip(UNEQUAL_AXES, unequal, strict=True)
        kinds += [(label, [form], len(unequal)) for label, form in named if form]
    if case.lags is not None:
        kinds.append((RANDOM_LAG, lag_forms(case), 1))
    kinds += [
        (noisy_joint_label(j + 1), [Form(joint=j, repeatability_factor=SETTINGS.noisy_joint_factor)], len(joints))
        for j in joints
    ]
    rivals: Rivals = {}
    for label, forms, alike in kinds:
        grids: list[Array] = []
        logs = np.zeros(0)
        for form in forms:
            if form.scale is None and not problem.may_gain(form, least):
                continue
            grids.append(problem.log_likelihood(form))
            logs = np.append(logs, float(np.logaddexp.reduce(grids[-1], axis=None)))
            # Likelihood falls with the coefficient from here on.
            if logs[-1] < max(plain, logs.max()) - POINT_LOG_EVIDENCE_WINDOW:
                break
        if not grids:
            continue
        gain = (float(np.logaddexp.reduce(logs, axis=None)) - plain) / e.poses_per_stop
        factor = gain - float(np.log(len(forms) * alike * 5))
        best = first_of_best(logs, logs=True)
        noise, times = likely_noise(grids[best], e.sigmas), forms[best].scale
        if times is not None and times.ndim == 2:  # the mean over the axes
            noise = replace(noise, sigma=noise.sigma * float(np.sqrt((times**2).mean())))
        rivals[label] = float(factor), noise
    return rivals


def lag_forms(case: Case) -> list[Form]:
    """Return the forms of a random lag along the last motion, by `LAG_SHARES`; [] without motions."""
    lags = None if case.lags is None else case.lags[case.inliers][case.order]
    return [] if lags is None else [Form(lags=share * lags) for share in LAG_SHARES]


def likely_lag(case: Case, ranking: Ranking, chosen: Array) -> float | None:
    """Return the most likely of `LAG_SHARES`, if a random lag is a ranking's most probable cause.

    None if another one is, or if "none" exceeds `Settings.max_p_nothing_further`.
    chosen : indices of the columns of causes in the model
    """
    if ranking.order[0] != RANDOM_LAG or ranking.none > SETTINGS.max_p_nothing_further:
        return None
    problem = Problem(case.evidence, chosen, case.order)
    logs = [float(np.logaddexp.reduce(problem.log_likelihood(form), axis=None)) for form in lag_forms(case)]
    return LAG_SHARES[first_of_best(logs, logs=True)]


def ar_form(ar_coefficient: float, poses: int, numbers: float = 3.0) -> Form:
    """Return the form of autocorrelated (AR(1)) noise over a number of poses.

    ar_coefficient : correlation of a pose's noise with that of the previous pose
    numbers : mean count of measured numbers of a pose
    """
    return Form(
        ar_coefficient=ar_coefficient, log_weight=-0.5 * numbers * (poses - 1) * float(np.log(1 - ar_coefficient**2))
    )


def best_ar_form(case: Case, chosen: Array) -> tuple[Form, Noise, float]:
    """Return the most probable AR(1) form, its noise and its log evidence over white noise.

    chosen : columns of the causes in the model, shape (k,)
    """
    e, problem = case.evidence, Problem(case.evidence, chosen, case.order)

    def judged(shares: Sequence[float]) -> list[tuple[float, Form, Array]]:
        """Return (log evidence, form, log likelihoods) of each AR(1) coefficient in `shares`."""
        forms = [ar_form(ar_coefficient, len(e.r), e.count / len(e.r)) for ar_coefficient in shares]
        grids = [problem.log_likelihood(form) for form in forms]
        return [
            (float(np.logaddexp.reduce(grid, axis=None)), form, grid) for form, grid in zip(forms, grids, strict=True)
        ]

    tried = judged(SETTINGS.ar_coefficients)
    best = best_of(tried, lambda k: k[0], logs=True)[1].ar_coefficient
    step = SETTINGS.ar_coefficient_step
    log, form, grid = best_of((*tried, *judged([best - step, best + step])), lambda k: k[0], logs=True)
    return form, likely_noise(grid, e.sigmas), log - float(np.logaddexp.reduce(e.log_base(chosen), axis=None))


def better_ar_form(case: Case, chosen: Array) -> tuple[Form, Noise, float] | None:
    """Return the result of `best_ar_form`, or None if the case's own form of noise remains.

    It remains if the coefficient is the same within half a refinement step, or the log evidence
    over white noise is below `Settings.min_ar_log_gain`.
    """
    form, noise, gain = best_ar_form(case, chosen)
    moved = abs(form.ar_coefficient - case.form.ar_coefficient) > SETTINGS.ar_coefficient_step / 2
    return (form, noise, gain) if moved and gain >= SETTINGS.min_ar_log_gain else None


def unequal_forms(problem: Problem, places: Array, least: float = -np.inf) -> list[Form | None]:
    """Return a form of noise that is unequal along each of `UNEQUAL_AXES`, None where none can win.

    Its sizes are those of the residual. The logarithm of the pose count is paid for two of its
    numbers each: the ratios of the sizes, and the rotation of axes that nothing determines.
    places : point of each pose in the instrument's frame [m], in the order of measuring, (n, 3)
    least : log evidence over white noise that a form needs [nats]
    """
    n = len(problem.e.r)
    if problem.e.r.shape[1] != 3:
        return [None] * len(UNEQUAL_AXES)
    residual = _likely_residual(problem, WHITE_FORM)
    own = np.linalg.eigh(residual.T @ residual)[1].T
    sight = places / np.maximum(np.linalg.norm(places, axis=1, keepdims=True), 1e-9)
    level = np.cross([0.0, 0.0, 1.0], sight)
    level /= np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-9)
    along = np.stack([sight, level, np.cross(sight, level)], axis=1)
    forms: list[Form | None] = []
    for axes, numbers in ((None, 2), (np.tile(own, (n, 1, 1)), 5), (along, 2)):
        turned = residual if axes is None else np.einsum("nij,nj->ni", axes, residual)
        square, cost = (turned**2).mean(axis=0), 0.5 * numbers * np.log(n)
        gain = 0.5 * n * (3 * np.log(square.mean()) - np.log(square).sum())
        form, times = Form(axes=axes), np.ones(3)
        for turn in range(3 if gain > cost else 0):
            if turn:
                square = (_likely_residual(problem, form) ** 2).mean(axis=0)
            times = times * np.sqrt(square)
            times /= np.exp(np.log(times).mean())
            form = replace(form, scale=np.tile(times, (n, 1)), log_weight=-float(cost))
            if not turn and not problem.may_gain(form, least):
                gain = 0.0
                break
        forms.append(form if gain > cost else None)
    return forms


def _likely_residual(problem: Problem, form: Form) -> Array:
    """Return the whitened residual under the likeliest noise of a form, shape (n, 3) [m]."""
    noise = likely_noise(problem.log_likelihood(form), problem.e.sigmas)
    rho = int(np.argmin(np.abs(RHO_GRID - noise.repeatability / noise.sigma)))
    return problem.residual(form, rho)


def heavy_tailed_form(problem: Problem, least: float = -np.inf) -> Form | None:
    """Return a form of noise that is larger at poses with large residuals; None without such poses.

    The noise there is larger by `Settings.tail_noise_factor`, and white elsewhere.
    least : log evidence over white noise that the form needs [nats]
    """
    n, numbers = len(problem.e.r), problem.e.count / len(problem.e.r)
    share, factor = SETTINGS.tail_share, SETTINGS.tail_noise_factor
    log_odds = np.log(share / (1 - share)) - numbers * np.log(factor)
    times, form = np.ones(n), WHITE_FORM
    for _ in range(3):
        noise = likely_noise(problem.log_likelihood(form), problem.e.sigmas)
        unscaled = _likely_residual(problem, form) * times[:, None]
        square = (unscaled**2).sum(axis=1) / noise.sigma**2
        before, times = times, np.where(log_odds + 0.5 * square * (1 - factor**-2) > 0, factor, 1.0)
        if np.array_equal(before, times):
            break
        out = int((times > 1).sum())
        weight = out * np.log(share) + (n - out) * np.log(1 - share) - numbers * out * np.log(factor)
        form = Form(scale=times, log_weight=float(weight))
        if not problem.may_gain(form, least):
            return None
    return form if (times > 1).any() else None
