"""The nonlinear refit of what was chosen: base model and causes identified together by Ipopt, and its held-out gap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.transforms import Array
from casadical.diagnosis.cross_validation import FOLDS, Noise, random_folds
from casadical.diagnosis.linear_problem import Case
from casadical.effects import Effect
from casadical.identification.accuracy import errors
from casadical.identification.identification import Identification, identify
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements


def refit(case: Case, effects: Sequence[Effect], noise: Noise, use: Array | None = None) -> Identification:
    """Base model and effects identified together: the evidence's model without its linearisation.

    The data, their noise and the priors are the evidence's: positions of the poses that are no outliers, the sigma
    that the diagnosis found, base parameters that depart from the robot that was given. It starts from the calibrated
    base model, for what loads a joint shows nothing while the joint's compliance is zero.
    effects : with their settings (knee, lag, cycles), which stay; their parameters are free
    use : mask over the kept poses of those to identify from, all by default
    """
    m = measurements_of(case, effects, noise)
    m = m if use is None else m[use]
    base = case.robot if use is None else identify(case.given, m, priors=True).robot
    free = ("kinematic", "compliance", *dict.fromkeys(e.label for e in effects))
    return identify(base.with_effect(*effects), m, free, priors=_priors(case))


def _priors(case: Case) -> dict[str, tuple[float, float]]:
    """Mean and one sigma of the evidence's prior of each base parameter; the base frame stays where it was placed."""
    values = zip(case.given.parameters.values.tolist(), case.whole.prior.tolist(), strict=True)
    priors = zip(case.given.parameters.names, values, strict=True)
    return {name: prior for name, prior in priors if not name.startswith("base_")}


def measurements_of(case: Case, effects: Sequence[Effect], noise: Noise) -> Measurements:
    """Kept poses as positions, with every column that the effects need, and the noise that was found."""
    m, _ = derive(case.m, [c for e in effects for c in e.conditions])
    return replace(m.positions_alone(), sigma=noise.sigma)[case.kept]


@dataclass(frozen=True, eq=False)
class Check:
    """Held-out gap of the refit, each fifth of the poses predicted by a refit to the others, and the linearised one
    on the same fifths, mean [m]."""

    refit: float
    linearised: float

    @property
    def agree(self) -> bool:
        """Whether the two differ by no more than a tenth."""
        return abs(self.refit / self.linearised - 1) <= 0.1


def held_out_refit(
    case: Case, effects: Sequence[Effect], noise: Noise, seed: int, show: Callable[[str], None] = lambda _text: None
) -> Array:
    """Position error of each kept pose, shape (kept,) [m], by a refit to the other fifths."""
    folds = random_folds(int(case.kept.sum()), seed)
    m = measurements_of(case, effects, noise)
    found = np.empty(len(m))
    for fold in range(FOLDS):
        show(f"refit {fold + 1} of {FOLDS}")
        test = folds == fold
        found[test] = errors(refit(case, effects, noise, ~test).robot, m[test])
    return found
