"""Textbook methods to compare with: forward choice by F-test, or by a Bayesian information criterion.

They have the candidates of the diagnosis and the residual that the base model leaves, and assume white noise: ordinary
least squares, no priors, no unknown cause, every choice a claim. The shrink of the gap is that of the fit's residuals.
(Montgomery, Peck and Vining 2012, chapter 10; Schwarz 1978; Chen and Chen 2008, whose extended criterion is for more
candidates than the data can distinguish.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casadical.blind_check.predictor import Session, rounded, unseen_positions
from casadical.blind_check.signal_size import RANK, column_space
from casadical.core.arrays import Array
from casadical.core.errors import ConvergenceError, optional
from casadical.diagnosis.candidates import Candidate, standard_candidates
from casadical.diagnosis.linear_problem import Case, make_case
from casadical.effects import Effect
from casadical.identification.identification import base_calibrated
from casadical.identification.prepared import prepare
from casadical.robot.robot import Robot

SIGNIFICANT = 0.01
MOST = 4


@dataclass(frozen=True, eq=False)
class Regression:
    """What the base model leaves: y, shape (rows,), and candidates' columns E, shape (rows, columns), orthogonal to it.

    freedom : rows less the rank of what is in the model
    """

    y: Array
    E: Array
    freedom: int

    def gains(self, groups: Sequence[Array]) -> Array:
        """By how much each group of columns lowers the sum of squares, shape (groups,)."""
        b, found = self.E.T @ self.y, np.zeros(len(groups))
        widths = np.array([len(g) for g in groups])
        for width in np.unique(widths):
            which = np.flatnonzero(widths == width)
            columns = np.stack([groups[int(k)] for k in which])
            G = np.einsum("rgi,rgj->gij", self.E[:, columns], self.E[:, columns])
            value, vector = np.linalg.eigh(G)
            turned = np.einsum("gij,gi->gj", vector, b[columns])
            kept = value > RANK * value.max(axis=1, keepdims=True)
            found[which] = np.sum(np.where(kept, turned**2 / np.where(kept, value, 1.0), 0.0), axis=1)
        return found

    def without(self, columns: Array) -> Regression:
        """The same once these columns are in the model."""
        y, E, rank = _left(self.E[:, columns], self.y, self.E)
        return Regression(y, E, self.freedom - rank)


def regression(case: Case) -> Regression:
    e = case.evidence
    rows = e.r.size
    y, E, rank = _left(e.J.reshape(rows, -1), e.r.ravel(), e.take(np.arange(e.width)).reshape(rows, -1))
    return Regression(y, E, rows - rank)


def _left(A: Array, y: Array, E: Array) -> tuple[Array, Array, int]:
    """What columns A leave of y and E, and their rank."""
    Q = column_space(A)
    return y - Q @ (Q.T @ y), E - Q @ (Q.T @ E), Q.shape[1]


@dataclass(frozen=True, eq=False)
class _Choice:
    """A step: probability of each label (none among them), and the variant to take, or None to stop."""

    probability: dict[str, float]
    take: tuple[Candidate, int] | None


# What is left, the candidates, and how many were taken already.
Step = Callable[[Regression, Case, int], _Choice]


def f_test(s: Session) -> dict[str, Any]:
    """Forward choice by F-test, the level shared among all candidates and settings (Bonferroni)."""
    return _forward(s, _by_f)


def bic(s: Session) -> dict[str, Any]:
    """Forward choice by the Bayesian information criterion."""
    return _forward(s, lambda left, case, _taken: _by_bic(left, case, 0.0))


def extended_bic(s: Session) -> dict[str, Any]:
    """The same by the extended criterion (gamma = 1): all models with as many causes are together as likely as those
    with one fewer."""
    return _forward(s, lambda left, case, n: _by_bic(left, case, 2 * np.log((len(case.variants) - n) / (n + 1))))


def _by_f(left: Regression, case: Case, _taken: int) -> _Choice:
    f = optional("scipy.stats", "--by f-test needs scipy: pip install 'casadical[withheld]'").f
    total, widths = float(left.y @ left.y), np.array([len(g) for g in case.groups])
    gain = np.minimum(left.gains(case.groups), total * (1 - 1e-12))
    freedom = left.freedom - widths
    ratio = gain / widths / ((total - gain) / freedom)
    p = np.minimum(1.0, f.sf(ratio, widths, freedom) * len(widths))
    # Beyond what a float can hold, the greater ratio decides.
    best = int(np.lexsort((-ratio, p))[0])
    candidate = case.candidates[case.variants[best][0]]
    sure = bool(p[best] < SIGNIFICANT)
    return _Choice({candidate.label if sure else "none": 1.0}, (candidate, case.variants[best][1]) if sure else None)


def _by_bic(left: Regression, case: Case, extra: float) -> _Choice:
    """The setting that lowers the criterion most; extra : penalty of any of them beyond its parameters."""
    total, widths, rows = float(left.y @ left.y), np.array([len(g) for g in case.groups]), len(left.y)
    gain = np.minimum(left.gains(case.groups), total * (1 - 1e-12))
    # Less the criterion of the model as it is.
    score = rows * np.log1p(-gain / total) + widths * np.log(rows) + extra
    best = int(np.argmin(score))
    low: dict[str, float] = {"none": 0.0}
    for (c, _), value in zip(case.variants, score, strict=True):
        text = case.candidates[c].label
        low[text] = min(low.get(text, np.inf), float(value))
    least = min(low.values())
    weight = {text: float(np.exp(-0.5 * (value - least))) for text, value in low.items()}
    whole = sum(weight.values())
    taken = (case.candidates[case.variants[best][0]], case.variants[best][1]) if score[best] < 0 else None
    return _Choice({text: w / whole for text, w in weight.items()}, taken)


@dataclass(frozen=True, eq=False)
class _Taken:
    """A cause that was taken into the model: its probability then, and the mean residual that it leaves [m]."""

    candidate: Candidate
    effects: tuple[Effect, ...]
    probability: float
    left: float


def _forward(s: Session, step: Step) -> dict[str, Any]:
    found = base_calibrated(prepare(s.robot, s.measured))
    case = make_case(found, [c for c in standard_candidates(s.robot) if c.listed])
    left = regression(case)
    before = _mean_length(left.y)
    taken: list[_Taken] = []
    choice = first = step(left, case, 0)
    while choice.take is not None and len(taken) < MOST:
        candidate, variant = choice.take
        effects = candidate.variants[variant]
        left = left.without(case.group(effects))
        taken.append(_Taken(candidate, effects, choice.probability[candidate.label], _mean_length(left.y)))
        # A label is taken once; its columns stay where they are.
        case = replace(case, candidates=tuple(c for c in case.candidates if c.label != candidate.label))
        choice = step(left, case, len(taken))
    together = dict.fromkeys(e for t in taken for e in t.effects)
    out = case.m.row[~case.kept]
    return {
        "campaign": s.name,
        "verdict": "explained" if taken else "none",
        "gap_mm": {"before": round(1e3 * before, 5), "after": round(1e3 * _mean_length(left.y), 5)},
        "causes": [_cause(t, before) for t in taken],
        "posterior": rounded(first.probability),
        "unseen": unseen_positions(s, found.robot, _with_causes(s, tuple(together), out), out),
    }


def _with_causes(s: Session, effects: tuple[Effect, ...], leave_out: Array) -> Robot:
    """The robot fitted with these effects; the nominal one, without effects, where the fit finds no optimum."""
    try:
        return s.fitted(s.robot.with_effect(*effects), leave_out) if effects else s.robot
    except ConvergenceError:
        return s.robot


def _cause(t: _Taken, before: float) -> dict[str, Any]:
    """A cause in the campaigns' format; shrink: of all up to this one."""
    return {
        "effect": t.candidate.name,
        "joint": t.candidate.joint,
        "confidence": round(t.probability, 4),
        "shrink": round(1 - t.left / before, 4),
        "indistinguishable": [],
    }


def _mean_length(y: Array) -> float:
    return float(np.linalg.norm(y.reshape(-1, 3), axis=1).mean())
