"""How far the gap shrinks: on poses left out of the fit, one by one, in fifths, and in blocks of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from casadical.core.transforms import Array
from casadical.diagnosis.cross_validation import FOLDS, Noise, covariance, held_out_errors
from casadical.diagnosis.evidence import Evidence
from casadical.diagnosis.linear_problem import Case
from casadical.effects import Effect
from casadical.measurements.derived_columns import derive

DRAWS = 1000
COLUMNS = ("model", "gap_mm", "low_mm", "high_mm", "loo_mm", "blocks_mm", "model_mm", "model_low_mm", "model_high_mm")


@dataclass(frozen=True, eq=False)
class Stage:
    """The model at one stage: what was added last, columns of all causes in it, the noise that it leaves."""

    added: str
    columns: Array
    noise: Noise


def course(case: Case, stages: Sequence[Stage], folds: Sequence[Array], noise: Noise, seed: int) -> pd.DataFrame:
    """A row for each stage, all on the same poses, the outliers left out.

    model : "base", or "+ label"; gap_mm : mean held-out position error over partitions into fifths, low_mm and high_mm
    its 95 % interval by bootstrap over poses; loo_mm : the same with each pose left out alone
    blocks_mm : with contiguous fifths of the campaign left out, which effects of time and temperature must foresee
    model_mm : rms held-out error with the noise's own mean square taken off, with a 95 % interval: what a noiseless
    instrument would read
    """
    e = case.evidence
    alone, blocks = np.arange(len(e.r)), time_blocks(case)
    floor = np.trace(covariance(e, noise), axis1=1, axis2=2)
    pick = np.random.default_rng(seed).integers(0, len(e.r), (DRAWS, len(e.r)))
    rows = []
    for stage in stages:
        runs = np.stack([held_out_errors(e, stage.columns, stage.noise, f) for f in folds])
        error, square = runs.mean(axis=0), (runs**2).mean(axis=0) - floor
        loo, block = (held_out_errors(e, stage.columns, stage.noise, f).mean() for f in (alone, blocks))
        rows.append((stage.added, *_with_interval(error, pick), 1e3 * loo, 1e3 * block, *_rooted(square, pick)))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def time_blocks(case: Case) -> Array:
    """Number of the contiguous fifth of the campaign in which each kept pose was measured, shape (kept,)."""
    m, _ = derive(case.m, ["progress"])
    order = np.argsort(np.argsort(m.conditions["progress"][case.kept], kind="stable"), kind="stable")
    return np.asarray(FOLDS * order // len(order))


def of_time(effects: Sequence[Effect]) -> bool:
    """Whether any of the effects follows time or temperature, so that leaving out single poses flatters it."""
    return any(c == "progress" or c.startswith("warmth") for e in effects for c in e.conditions)


def scatter(e: Evidence, noise: Noise) -> float:
    """Of one measured coordinate about the truth, instrument and joint repeatability together [m]."""
    return float(np.sqrt(np.trace(covariance(e, noise), axis1=1, axis2=2).mean() / 3))


def _with_interval(error: Array, pick: Array) -> tuple[float, float, float]:
    low, high = np.quantile(error[pick].mean(axis=1), [0.025, 0.975])
    return 1e3 * float(error.mean()), 1e3 * float(low), 1e3 * float(high)


def _rooted(square: Array, pick: Array) -> tuple[float, float, float]:
    low, high = np.quantile(square[pick].mean(axis=1), [0.025, 0.975])
    mean, low, high = (1e3 * float(np.sqrt(max(0.0, float(v)))) for v in (square.mean(), low, high))
    return mean, low, high
