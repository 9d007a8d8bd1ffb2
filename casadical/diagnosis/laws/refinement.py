"""Settings of a law that raise its evidence, found by steps of shrinking size, and how sure they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.cross_validation import likely_noise
from casadical.diagnosis.laws.forms import rounded
from casadical.diagnosis.laws.problem import Problem, Scored, Tried

# Steps of a refinement, first as shares of the driver's range (of a width: factors), halved when none helps.
FIRST_STEP, HALVINGS, ROUNDS, GAIN = 0.03, 3, 10, 0.1


def refined(problem: Problem, found: Scored) -> Scored:
    """The law with its settings refined, which raises the score as much as the evidence."""
    if not len(found.settings):
        return found
    settings, better = refined_settings(problem, found.tried, found.seam, found.settings)
    law, columns = found.tried.column(found.seam, settings)
    return replace(
        found,
        law=law,
        settings=settings,
        score=found.score + better - found.evidence,
        evidence=better,
        columns=columns,
        noise=likely_noise(problem.grids([columns])[0], problem.evidence.sigmas),
        errors=_sigmas(problem, found.tried, found.seam, settings, better),
    )


def _moved(tried: Tried, seam: int, settings: Array, k: int, step: float) -> Array:
    """One setting moved: a width by a factor, a frequency by its share of the range, a position by a share of it."""
    moved, span = settings.copy(), float(np.ptp(tried.x[seam]))
    name = tried.form.settings[k]
    if name == "w" and tried.form.name not in ("on and off", "levels"):
        moved[k] *= np.exp(10 * step)
    elif name == "p":
        moved[k] += 20 * step
    elif name == "f":
        moved[k] += 10 * step / span
    else:
        moved[k] += step * span
    return rounded(moved)


def refined_settings(
    problem: Problem, tried: Tried, seam: int, settings: Array, poses: Array | slice = slice(None)
) -> tuple[Array, float]:
    """The best settings near these, and their log evidence. poses : of those tried, the problem's."""

    def evidences(trial: Sequence[Array]) -> Array:
        return problem.evidences([tried.column(seam, s)[1][poses] for s in trial])

    if not len(settings):
        return settings, float(evidences([settings])[0])
    evidence = float(evidences([settings])[0])
    step, halved = FIRST_STEP, 0
    for _ in range(ROUNDS):
        near = [_moved(tried, seam, settings, k, s) for k in range(len(settings)) for s in (-step, step)]
        logs = evidences(near)
        best = int(np.argmax(logs))
        if logs[best] > evidence + GAIN:
            settings, evidence = near[best], float(logs[best])
            continue
        step, halved = step / 2, halved + 1
        if halved > HALVINGS:
            break
    return settings, evidence


def _sigmas(problem: Problem, tried: Tried, seam: int, settings: Array, evidence: float) -> Array:
    """One sigma of each setting alone: where the log evidence has fallen by a half, from steps of growing size."""
    found = np.empty(len(settings))
    for k in range(len(settings)):
        steps = np.array([0.003, 0.006, 0.012, 0.025, 0.05, 0.1])
        moved = [_moved(tried, seam, settings, k, s) for s in (*steps, *-steps)]
        logs = problem.evidences([tried.column(seam, n)[1] for n in moved])
        fallen = evidence - np.maximum(logs[: len(steps)], logs[len(steps) :])
        beyond = np.flatnonzero(fallen > 0.5)
        at = int(beyond[0]) if len(beyond) else len(steps) - 1
        found[k] = abs(moved[at][k] - settings[k]) / np.sqrt(max(2 * float(fallen[at]), 1.0))
    return found
