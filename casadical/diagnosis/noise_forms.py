"""Noise that is not what the model assumes: it follows itself, some poses are far worse, or one joint scatters.

Each form is judged as the base model is, by its marginal likelihood, with the poses weighed as it says. It competes
with the causes. Beside causes, noise of the instrument is one of the ways in which there is no further one, while a
joint that scatters is still something that nobody listed, unless it has a cause: what this leaves looks like scatter.
Where an effect leads whose sizes are learnt once it is in the model, its joints' scatter is no rival before.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.marginals import REACH
from casadical.core.statistics import best_of, first_of_best
from casadical.diagnosis.cross_validation import likely_noise
from casadical.diagnosis.evidence import RHO_GRID
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_evidence import Form, Problem
from casadical.diagnosis.posterior import PRIOR_FIRST, PRIOR_FURTHER, Ranking, Rival
from casadical.diagnosis.settings import SETTINGS
from casadical.measurements.measurements import Noise

# Of the instrument.
FOLLOWING, TAILED = "noise that follows itself", "noise with heavy tails"
# Correlations of a pose's noise with that of the pose before.
FOLLOWS = (0.4, 0.6, 0.8, 0.9)
# The best of them is moved by this to both sides where causes are searched under it.
BETWEEN = 0.07
# Share of the poses whose noise is so many times the others'; rounds in which they are found.
SHARE, TIMES, FOUND_IN = 0.05, 4.0, 3
# A joint that scatters repeats so many times worse than the others, each at the noise grid's ratios.
SCATTERS = 8.0
# Log evidence over plain noise from which causes and laws are judged again by noise that follows itself.
FORM_GAIN = 10.0


def with_noise_forms(ranking: Ranking, case: Case, chosen: Array, joints: Collection[int | None] = ()) -> Ranking:
    """The ranking with other forms of noise in it.

    chosen : columns of causes that are in the model already; joints : that these are at, whose scatter is what their
        equations leave, like noise
    """
    if case.form.stays:
        return replace(ranking, noise_form=FOLLOWING)
    # Beside causes, other forms are not asked for where plain noise alone has more probability.
    seen = ranking.none <= (0.9 if len(chosen) else SETTINGS.max_p_nothing)
    if len(chosen) and not seen:
        return ranking
    prior = PRIOR_FURTHER if len(chosen) else PRIOR_FIRST
    unsized = {
        scatter_of(part) for c in case.candidates if c.label == ranking.order[0] for part in c.variants[0][0].parts
    }
    # Where nothing else is seen, a joint that scatters may be.
    forms = [f for f in noise_forms(case, chosen, of_instrument=seen) if f.label not in unsized]
    mass = {f.label: float(np.log(prior["unknown"])) + f.log_factor for f in forms}
    plain = none = float(np.log(prior["none"]))
    noise_form = ""
    if len(chosen):
        noise = (FOLLOWING, TAILED, *(scatter_of(j) for j in joints if j))
        own = {label: mass.pop(label) for label in noise if label in mass}
        none = float(np.logaddexp.reduce(np.array([plain, *own.values()])))
        best = best_of(own, own.__getitem__, logs=True)
        noise_form = best if own[best] > plain else ""
    rivals = [f for f in forms if f.label in mass]
    ranking = replace(
        ranking,
        log_factor={**ranking.log_factor, **{f.label: f.log_factor for f in rivals}},
        log_mass={**ranking.log_mass, **mass},
        noise={**ranking.noise, **{f.label: f.noise for f in rivals}},
        log_noise=none - plain,
        noise_form=noise_form,
    )
    return ranking.weighed(none)


def scattering(case: Case, ranking: Ranking) -> int | None:
    """The joint (1-based) whose scatter is the most probable in a ranking, if one's is."""
    labels = {scatter_of(j): j for j in case.robot.numbers}
    return labels.get(ranking.order[0]) if ranking.none <= SETTINGS.max_p_nothing_further else None


def scatter_of(joint: int) -> str:
    """The label of this form of noise."""
    return f"scatter of joint {joint}"


def noise_forms(case: Case, chosen: Array, *, of_instrument: bool = True) -> Sequence[Rival]:
    """Each form with its log evidence over plain noise, averaged over its settings; the kinds share the prior.

    of_instrument : whether those of the instrument are among them, beside those of the joints
    """
    e = case.evidence
    problem = Problem(e, chosen, case.order)
    plain, joints = float(np.logaddexp.reduce(e.log_base(chosen), axis=None)), range(e.Jq.shape[2])
    kinds: list[tuple[str, Sequence[Form], int]] = []
    if of_instrument:
        kinds += [(FOLLOWING, [following(stays, len(e.r), e.count / len(e.r)) for stays in FOLLOWS], 1)]
        kinds += [(TAILED, [tails], 1) for tails in (tailed(problem),) if tails]
    kinds += [(scatter_of(j + 1), [Form(joint=j, worse=SCATTERS)], len(joints)) for j in joints]
    rivals = []
    for label, forms, alike in kinds:
        grids: list[Array] = []
        logs = np.zeros(0)
        for form in forms:
            grids.append(problem.log_likelihood(form))
            logs = np.append(logs, float(np.logaddexp.reduce(grids[-1], axis=None)))
            if logs[-1] < max(plain, logs.max()) - REACH:  # what follows itself still more is less likely yet
                break
        factor = float(np.logaddexp.reduce(logs, axis=None)) - np.log(len(forms) * alike * 3) - plain
        rivals.append(Rival(label, float(factor), likely_noise(grids[first_of_best(logs, logs=True)], e.sigmas)))
    return rivals


def following(stays: float, poses: int, numbers: float = 3.0) -> Form:
    """Noise of which so much stays from each pose to the next; numbers : measured at each."""
    return Form(stays=stays, log_weight=-0.5 * numbers * (poses - 1) * float(np.log(1 - stays**2)))


def best_following(case: Case, chosen: Array) -> tuple[Form, Noise, float]:
    """The most probable noise that follows itself, beside causes: its form, its size, its log evidence over plain."""
    e, problem = case.evidence, Problem(case.evidence, chosen, case.order)

    def judged(shares: Sequence[float]) -> list[tuple[float, Form, Array]]:
        forms = [following(stays, len(e.r), e.count / len(e.r)) for stays in shares]
        grids = [problem.log_likelihood(form) for form in forms]
        return [
            (float(np.logaddexp.reduce(grid, axis=None)), form, grid) for form, grid in zip(forms, grids, strict=True)
        ]

    known = judged(FOLLOWS)
    best = best_of(known, lambda k: k[0], logs=True)[1].stays
    log, form, grid = best_of((*known, *judged([best - BETWEEN, best + BETWEEN])), lambda k: k[0], logs=True)
    return form, likely_noise(grid, e.sigmas), log - float(np.logaddexp.reduce(e.log_base(chosen), axis=None))


def other_following(case: Case, chosen: Array) -> tuple[Form, Noise, float] | None:
    """The same where causes and laws are to be judged again by it; None where the case keeps its own noise."""
    form, noise, gain = best_following(case, chosen)
    moved = abs(form.stays - case.form.stays) > BETWEEN / 2
    return (form, noise, gain) if moved and gain >= FORM_GAIN else None


def best_beside_following(case: Case, chosen: Array) -> tuple[str, float]:
    """The most probable other form of noise where noise follows itself, beside causes, and its log evidence over this.

    Another share, heavy tails beside the same share, or any form without one.
    """
    e, problem = case.evidence, Problem(case.evidence, chosen, case.order)
    own = following(case.form.stays, len(e.r), e.count / len(e.r))  # poses may have been left out since it was found
    plain, log = (
        float(np.logaddexp.reduce(e.log_base(chosen), axis=None)),
        float(np.logaddexp.reduce(problem.log_likelihood(own), axis=None)),
    )
    rivals = [(FOLLOWING, best_following(case, chosen)[2])]
    rivals += [(f.label, f.log_factor) for f in noise_forms(case, chosen)]
    if tails := tailed(problem, own):
        rivals.append((TAILED, float(np.logaddexp.reduce(problem.log_likelihood(tails), axis=None)) - plain))
    label, gain = best_of(rivals, itemgetter(1), logs=True)
    return label, gain + plain - log


def tailed(problem: Problem, usual: Form | None = None) -> Form | None:
    """A form, by default the plain one, with the poses that are far out weighed down; None without any."""
    usual = usual or Form()
    n, numbers = len(problem.e.r), problem.e.count / len(problem.e.r)
    log_odds = np.log(SHARE / (1 - SHARE)) - numbers * np.log(TIMES)
    times, form = np.ones(n), usual
    grid = problem.log_likelihood(usual) if usual.stays else problem.e.log_base(problem.chosen)
    for _ in range(FOUND_IN):
        noise = likely_noise(grid, problem.e.sigmas)
        rho = int(np.argmin(np.abs(RHO_GRID - noise.repeatability / noise.sigma)))
        square = ((problem.residual(form, rho) * times[:, None]) ** 2).sum(axis=1) / noise.sigma**2
        before, times = times, np.where(log_odds + 0.5 * square * (1 - TIMES**-2) > 0, TIMES, 1.0)
        if np.array_equal(before, times):
            break
        out = int((times > 1).sum())
        weight = out * np.log(SHARE) + (n - out) * np.log(1 - SHARE) - numbers * out * np.log(TIMES)
        form = replace(usual, times=times, log_weight=usual.log_weight + float(weight))
        grid = problem.log_likelihood(form)
    return form if (times > 1).any() else None
