"""Noise that is not what the model assumes: it follows itself, some poses are far worse, or one joint scatters.

Each form is judged as the base model is, by its marginal likelihood, with the poses weighed as it says. It competes
with the causes. Beside causes, noise of the instrument is one of the ways in which there is no further one, while a
joint that scatters is still something that nobody listed, unless it has a cause: what this leaves looks like scatter.
Where an effect leads whose sizes are learnt once it is in the model, its joints' scatter is no rival before.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.cross_validation import likely_noise
from casadical.diagnosis.evidence import RHOS, Evidence, log_sum
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.posterior import PRIOR_FIRST, PRIOR_FURTHER, Ranking, Rival
from casadical.diagnosis.thresholds import detection
from casadical.measurements.derived_columns import derive

# Of the instrument.
FOLLOWING, TAILED = "noise that follows itself", "noise with heavy tails"
# Correlations of a pose's noise with that of the pose before.
FOLLOWS = (0.4, 0.6, 0.8, 0.9)
# Share of the poses whose noise is so many times the others'; rounds in which they are found.
SHARE, TIMES, FOUND_IN = 0.05, 4.0, 3
# A joint that scatters repeats so many times worse than the others, each at the noise grid's ratios.
SCATTERS = 8.0
# Beside causes, other forms are not asked for where plain noise alone has more probability.
PLAIN = 0.9


def with_noise_forms(ranking: Ranking, case: Case, chosen: Array, joints: Collection[int | None] = ()) -> Ranking:
    """The ranking with other forms of noise in it.

    chosen : columns of causes that are in the model already; joints : that these are at, whose scatter is what their
        equations leave, like noise
    """
    if ranking.none > (PLAIN if len(chosen) else detection(int(case.kept.sum()))):
        return ranking
    prior = PRIOR_FURTHER if len(chosen) else PRIOR_FIRST
    unsized = {
        scatter_of(part) for c in case.candidates if c.label == ranking.order[0] for part in c.variants[0][0].parts
    }
    forms = [f for f in noise_forms(case, chosen) if f.label not in unsized]
    mass = {f.label: float(np.log(prior["unknown"])) + f.log_factor for f in forms}
    plain = none = float(np.log(prior["none"]))
    noise_form = ""
    if len(chosen):
        noise = (FOLLOWING, TAILED, *(scatter_of(j) for j in joints if j))
        own = {label: mass.pop(label) for label in noise if label in mass}
        none = float(log_sum(np.array([plain, *own.values()])))
        best = max(own, key=lambda k: own[k])
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
    return _weighed(ranking, none)


def scatter_of(joint: int) -> str:
    """The label of this form of noise."""
    return f"scatter of joint {joint}"


def _weighed(ranking: Ranking, none: float) -> Ranking:
    """The ranking with probabilities by its masses; none : that of no further cause."""
    logs = np.array([none, *ranking.log_mass.values()])
    share = np.exp(logs - log_sum(logs))
    return replace(
        ranking, none=float(share[0]), probability=dict(zip(ranking.log_mass, share[1:].tolist(), strict=True))
    )


def noise_forms(case: Case, chosen: Array) -> Sequence[Rival]:
    """Each form with its log evidence over plain noise, averaged over its settings; the kinds share the prior."""
    known = case.evidence
    base = known.with_base(chosen)
    base = replace(base, E=np.zeros((len(base.r), 3, 1)), held=None)
    plain = float(log_sum(known.log_base(chosen)))
    progress = derive(case.m, ["progress"])[0].conditions["progress"][case.kept]
    joints = range(base.Jq.shape[2])
    # One problem at a time is made and judged, for each holds as much as the data.
    kinds: list[tuple[str, Iterable[tuple[Evidence, float]], int]]
    kinds = [
        (FOLLOWING, _following(base, np.argsort(progress, kind="stable")), 1),
        (TAILED, filter(None, map(_tails, [base])), 1),
    ]
    kinds += [(scatter_of(j + 1), ((_scattering(base, k), 0.0) for k in (j,)), len(joints)) for j in joints]
    found = []
    for label, ways, alike in kinds:
        grids = [e.log_base() + weight for e, weight in ways]
        if not grids:
            continue
        logs = np.array([float(log_sum(g)) for g in grids])
        factor = float(log_sum(logs)) - np.log(len(grids) * alike * 3) - plain
        found.append(Rival(label, float(factor), likely_noise(grids[int(np.argmax(logs))], base.sigmas)))
    return found


def _following(e: Evidence, order: Array) -> Iterator[tuple[Evidence, float]]:
    """The problem in differences of each pose to the share of the one before that stays, and the log of its weight.

    order : of measuring
    """
    e = e.at(order)
    for stays in FOLLOWS:
        left = np.sqrt(1 - stays**2)
        r, J = ((part[1:] - stays * part[:-1]) / left for part in (e.r, e.J))
        Jq = e.Jq * np.append(1.0, np.full(len(order) - 1, np.sqrt(1 + stays**2) / left))[:, None, None]
        parts = (np.concatenate([whole[:1], part]) for whole, part in ((e.r, r), (e.J, J)))
        yield replace(e, r=next(parts), J=next(parts), Jq=Jq), float(-3 * (len(order) - 1) * np.log(left))


def _tails(e: Evidence) -> tuple[Evidence, float] | None:
    """The problem with the poses that are far out weighed down, and the log of its weight; None without any."""
    times, log_odds = np.ones(len(e.r)), np.log(SHARE / (1 - SHARE)) - 3 * np.log(TIMES)
    weighed = e
    for _ in range(FOUND_IN):
        noise = likely_noise(weighed.log_base(), e.sigmas)
        rho = float(RHOS[int(np.argmin(np.abs(RHOS - noise.repeatability / noise.sigma)))])
        left = weighed.white(rho, e.r[:, :, None]).y[: e.r.size].reshape(-1, 3) * times[:, None]
        square = (left**2).sum(axis=1) / noise.sigma**2
        times = np.where(log_odds + 0.5 * square * (1 - TIMES**-2) > 0, TIMES, 1.0)
        weighed = replace(e, r=e.r / times[:, None], J=e.J / times[:, None, None])
    out = int((times > 1).sum())
    weight = out * np.log(SHARE) + (len(times) - out) * np.log(1 - SHARE) - 3 * out * np.log(TIMES)
    return (weighed, float(weight)) if out else None


def _scattering(e: Evidence, joint: int) -> Evidence:
    """The problem where one joint repeats worse than the others."""
    return replace(e, Jq=e.Jq * np.where(np.arange(e.Jq.shape[2]) == joint, SCATTERS, 1.0))
