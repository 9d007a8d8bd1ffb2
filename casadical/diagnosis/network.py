"""The same gap when the compensator's network is used instead of the causes, and on what the causes leave."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from casadical.compensator import Compensator, Trainer
from casadical.core.transforms import Array
from casadical.diagnosis.cross_validation import FOLDS, Noise, fitted_without, random_folds
from casadical.diagnosis.linear_problem import Case


@dataclass(frozen=True)
class NetworkGap:
    """Mean held-out error [m] of a model, and of the model with a network trained on what it leaves of the same poses.

    before : the model alone, on the same fifths; used : with the network where the training poses said that it helps
    forced : with the network in any case, as cross-validation in the training poses judged it; refused : in how many
    of the five trainings it was refused
    """

    before: float
    used: float
    forced: float
    refused: int


def network_gap(
    case: Case,
    columns: Array,
    noise: Noise,
    seed: int,
    trainer: Trainer | str = "lm",
    show: Callable[[str], None] = lambda _text: None,
) -> NetworkGap:
    """Train the paper's 6-5-3 network on four fifths of the poses and try it on the last, five times.

    columns : of the causes in the model, refitted to each four fifths; the network sees joint readings alone
    """
    e, q = case.evidence, case.m.q[case.kept]
    folds = random_folds(len(e.r), seed)
    before, used = np.empty(len(e.r)), np.empty(len(e.r))
    ratios, refused = [], 0
    for fold in range(FOLDS):
        show(f"network {fold + 1} of {FOLDS}")
        test = folds == fold
        left = 1e3 * fitted_without(e, columns, noise, test)
        net = Compensator.fit(q[~test], left[~test], trainer=trainer, folds=FOLDS, seed=seed)
        before[test] = np.linalg.norm(left[test], axis=1)
        used[test] = np.linalg.norm(left[test] - net.correction_mm(q[test]), axis=1)
        ratios.append(net.choice.after.mean_mm / net.choice.before.mean_mm)
        refused += not net.helps
    base = 1e-3 * float(before.mean())
    return NetworkGap(base, 1e-3 * float(used.mean()), base * float(np.mean(ratios)), refused)
