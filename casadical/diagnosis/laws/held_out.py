"""Held-out errors of laws whose settings are chosen again from the poses of each fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.cross_validation import lengths, new_fit, random_folds
from casadical.diagnosis.evidence import Evidence
from casadical.diagnosis.laws.problem import Problem, Scored, scaled
from casadical.diagnosis.laws.refinement import refined_settings
from casadical.diagnosis.linear_problem import Case
from casadical.effects.base import CHOSEN
from casadical.measurements.noise import Noise


def held_out(case: Case, columns: Array, laws: Sequence[Scored], noise: Noise, seed: int) -> Array:
    """Position error of each kept pose, shape (n,) [m], by a fit to the poses of the other folds.

    columns : of the effects in the model, whose settings stay; laws : whose settings are chosen again in each fold
    """
    base = case.evidence.with_base(columns)
    folds = random_folds(len(base.r), seed, alike=base.alike)
    errors = np.empty(len(base.r))
    for fold in np.unique(folds):
        test = folds == fold
        parts = _columns(base, laws, np.flatnonzero(~test))
        whole = replace(base, E=np.concatenate([np.zeros((*base.r.shape, 0)), *parts], axis=2), held=None)
        fit = new_fit(whole, np.arange(whole.width), noise)
        errors[test] = lengths(base, fit.without(np.flatnonzero(test)), test)
    return errors


def _columns(base: Evidence, laws: Sequence[Scored], train: Array) -> list[Array]:
    """Columns at all poses of the laws with the settings that are best for some of them, shape (n, 3, w) each."""
    found: list[Array] = []
    for law in laws:
        known = np.concatenate([np.zeros((*base.r.shape, 0)), *found], axis=2)
        e = replace(base.with_known(known, np.full(known.shape[2], CHOSEN)), E=np.zeros((*base.r.shape, 1)), held=None)
        found.append(_best(Problem(e.at(train)), law, train))
    return found


def _best(problem: Problem, law: Scored, train: Array) -> Array:
    tried = law.tried
    if not law.tried.form.settings and len(tried.seams) == 1:
        return law.columns
    logs = []
    for seam, x, settings in zip(tried.seams, tried.x, tried.settings, strict=True):
        functions = scaled(tried.form.values(x, settings))
        logs.append(problem.gains(replace(seam, columns=seam.columns[train]), functions[:, train]))
    place = int(np.argmax([g.max() for g in logs]))
    start = tried.settings[place][int(np.argmax(logs[place]))]
    best, _ = refined_settings(problem, tried, place, start, train)
    return tried.column(place, best)[1]
