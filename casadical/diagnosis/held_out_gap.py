"""Mean error on held-out poses (gap): by added cause, in the nonlinear refit, with networks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from casadical.core.basics import Array, Show, silent
from casadical.core.linear_gaussian.marginals import NO_COLUMNS
from casadical.diagnosis.cross_validation import (
    held_out_errors,
    noise_mean_square,
    random_folds,
    resampled_means,
    residual_of_fit_without,
)
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.observations import row_slices
from casadical.diagnosis.refit import refit_measurements, row_errors
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.settings import SETTINGS
from casadical.effects import Effect
from casadical.identification.prediction import steps_without
from casadical.measurements.measurements import Noise

if TYPE_CHECKING:
    from casadical.compensator import Trainer

# Names of the columns of the table of `course`.
COURSE_COLUMNS = (
    "model",
    "gap_mm",
    "low_mm",
    "high_mm",
    "loo_mm",
    "blocks_mm",
    "model_mm",
    "model_low_mm",
    "model_high_mm",
)


def course(
    case: Case, stages: Sequence[tuple[str, Array, Noise]], folds: Sequence[Array], noise: Noise, seed: int
) -> pd.DataFrame:
    """Return a table of held-out errors as causes are added, all on the same inlier poses.

    It has a row for each stage and these columns:
    model : "base", or "+ label" of the added cause
    gap_mm : mean held-out position error over partitions into fifths; low_mm, high_mm : its 95 %
        interval by bootstrap over poses
    loo_mm : the same by leave-one-out, of stops where several targets share them
    blocks_mm : the same with contiguous fifths of the campaign held out, which tests the prediction
        of effects of time and temperature
    model_mm : rms held-out error after subtraction of the noise's mean square, as a noiseless
        instrument would read; model_low_mm, model_high_mm : its 95 % interval
    stages : (model, indices of the columns of its causes, shape (k,), noise assumed by its fit)
    folds : partitions into folds, shape (n_inliers,) each; noise : noise that is subtracted
    """
    e = case.evidence
    alone, blocks = np.arange(len(e.r)) if e.stop is None else e.stop, time_blocks(case)
    floor = noise_mean_square(e, noise)
    rows = []
    for added, columns, own in stages:
        runs = np.stack([held_out_errors(e, columns, own, f) for f in folds])
        error, square = runs.mean(axis=0), (runs**2).mean(axis=0) - floor
        loo, block = (held_out_errors(e, columns, own, f).mean() for f in (alone, blocks))
        resampled = resampled_means(np.stack([error, square]), seed, 1000, e.stop)
        of_error, of_square = np.quantile(resampled, [0.025, 0.975], axis=1).T
        rooted = 1e3 * np.sqrt(np.maximum([square.mean(), *of_square], 0.0))
        rows.append((added, *(1e3 * np.array([error.mean(), *of_error, loo, block])).tolist(), *rooted.tolist()))
    return pd.DataFrame(rows, columns=list(COURSE_COLUMNS))


def time_blocks(case: Case) -> Array:
    """Return the index of the fifth of the campaign in time of each inlier, shape (n_inliers,).

    With unknown points they are fifths of each point's poses.
    """
    order, alike = np.argsort(case.order, kind="stable"), case.evidence.alike
    if alike is None:
        return np.asarray(SETTINGS.folds * order // len(order))
    # An unknown point that is measured in one block only could not be predicted; so each point's
    # poses are divided into blocks.
    blocks = np.empty(len(order), dtype=np.int64)
    for point in np.unique(alike):
        own = np.flatnonzero(alike == point)
        blocks[own[np.argsort(order[own])]] = SETTINGS.folds * np.arange(len(own)) // len(own)
    return blocks


def depends_on_time(effects: Sequence[Effect]) -> bool:
    """Return whether any effect depends on time or temperature.

    Leave-one-out errors of such effects are optimistic.
    """
    return any(c == "progress" or c.startswith("warmth") for e in effects for c in e.conditions)


@dataclass(frozen=True)
class Check:
    """Mean held-out errors of two models with the same causes, on fifths of the poses.

    refit : that of the nonlinear refit [m]; linearised : that of the linear model [m]
    """

    refit: float
    linearised: float

    @property
    def agree(self) -> bool:
        """Return whether the two differ by at most a tenth of the linear model's error."""
        return abs(self.refit / self.linearised - 1) <= 0.1


def check_refit(found: Diagnosis, show: Show = silent) -> Check:
    """Return the mean held-out errors of the nonlinear refit and of the linear model.

    Ipopt refits all poses once; each fifth is then removed by a Gauss-Newton step from that
    optimum, which moves the parameters by a few standard errors at most: the model is linear there.

    Raises ConvergenceError: Ipopt finds no optimum.
    """
    case, effects = found.case, found.effects()
    folds = random_folds(int(case.inliers.sum()), found.seed, case.evidence.alike, case.evidence.stop)
    sets = refit_measurements(case, effects, found.noise)
    # For positions the estimated noise is the weight in the fit only.
    if case.observations.plain:
        sets = tuple(m.positions_alone() for m in sets)
    show("refit of all poses")
    whole = found.refit()
    problem, remaining = whole.problem, np.empty(len(folds))
    show("refits without a fifth each")
    steps = steps_without(problem, whole.solution.v, [folds[case.rows][at] for at in row_slices(problem.sets)])
    for fold, step in enumerate(steps):
        test, v = folds == fold, whole.solution.v + step
        fitted = replace(whole, robot=whole.start.with_values(problem.values(v)), solution=replace(whole.solution, v=v))
        error = row_errors(fitted, sets, test[case.rows])
        square = np.bincount(case.rows[test[case.rows]], error**2, minlength=len(folds))
        remaining[test] = np.sqrt(square[test])
    linear = held_out_errors(case.evidence, found.columns, found.noise, folds)
    return Check(float(remaining.mean()), float(linear.mean()))


@dataclass(frozen=True)
class NetworkGap:
    """Mean held-out error [m] of a model alone and with a network trained on its residuals.

    before : that of the model alone, on the same fifths
    used : that with the network in those fifths for which the training poses indicate that it helps
    forced : estimate with the network in all fifths, `before` times the mean ratio of the errors
        with and without it that cross-validation on the training poses predicts
    refused : number of the five trainings in which the network was not used
    """

    before: float
    used: float
    forced: float
    refused: int


def network_gaps(found: Diagnosis, show: Show = silent) -> tuple[NetworkGap, NetworkGap]:
    """Return the held-out errors with a network (the paper's) instead of causes, and after them."""
    alone = network_gap(found.case, NO_COLUMNS, found.rankings[0].noise[""], found.seed, show=show)
    return alone, network_gap(found.case, found.columns, found.noise, found.seed, show=show)


def network_gap(
    case: Case, columns: Array, noise: Noise, seed: int, trainer: Trainer | str = "lm", show: Show = silent
) -> NetworkGap:
    """Return the mean held-out errors without and with the paper's 6-5-3 network, in fifths.

    Networks are trained on four fifths of the inliers each; their inputs are joint variables only.
    columns : indices of the causes' columns, shape (k,); they are refitted to each four fifths
    noise : noise of these fits; seed : seed of the fifths and of the training
    trainer : name of one of `trainers_by_name`, or a trainer with its settings
    """
    # Imported on demand, because it takes a tenth of the time of all imports.
    from casadical.compensator import Compensator

    e, q = case.evidence, case.m.q[case.inliers]
    folds = random_folds(len(e.r), seed, stop=e.stop)
    before, used = np.empty(len(e.r)), np.empty(len(e.r))
    ratios, refused = [], 0
    for fold in range(SETTINGS.folds):
        show(f"network {fold + 1} of {SETTINGS.folds}")
        test = folds == fold
        remaining = 1e3 * residual_of_fit_without(e, columns, noise, test)
        net = Compensator.fit(q[~test], remaining[~test], trainer=trainer, folds=SETTINGS.folds, seed=seed)
        before[test] = np.linalg.norm(remaining[test], axis=1)
        used[test] = np.linalg.norm(remaining[test] - net.correction_mm(q[test]), axis=1)
        ratios.append(net.choice.after.mean_mm / net.choice.before.mean_mm)
        refused += not net.helps
    base = 1e-3 * float(before.mean())
    return NetworkGap(base, 1e-3 * float(used.mean()), base * float(np.mean(ratios)), refused)
