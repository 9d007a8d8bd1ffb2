"""A textbook method to compare with: forward choice of causes by F-test (Montgomery, Peck and Vining 2012, chapter 10).

It has the candidates of the diagnosis and the residual that the base model leaves, and assumes white noise: ordinary
least squares, no priors, no unknown cause, every choice a claim. The shrink of the gap is that of the fit's residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casadical.blind_check.prediction import Session, unseen_positions
from casadical.core.basics import Array, ConvergenceError, optional
from casadical.core.statistics import RANK, column_space
from casadical.diagnosis.candidates import standard_candidates
from casadical.diagnosis.linear_problem import make_case
from casadical.effects import Effect
from casadical.identification.identification import base_calibrated, prepare

SIGNIFICANT = 0.01
MOST = 4


@dataclass(frozen=True, eq=False)
class Regression:
    """Measurements y, shape (rows,), columns E of candidates, shape (rows, columns), and the degrees of freedom left.

    Both are orthogonal to what is in the model; freedom : rows less the rank of what is in the model
    """

    y: Array
    E: Array
    freedom: int

    def with_columns(self, A: Array) -> Regression:
        """The same once columns A, shape (rows, any), are in the model."""
        Q = column_space(A)
        return Regression(self.y - Q @ (Q.T @ self.y), self.E - Q @ (Q.T @ self.E), self.freedom - Q.shape[1])

    def gains(self, groups: Sequence[Array]) -> Array:
        """By how much each group of columns lowers the sum of squares, shape (groups,)."""
        b, gained = self.E.T @ self.y, np.zeros(len(groups))
        widths = np.array([len(g) for g in groups])
        for width in np.unique(widths):
            which = np.flatnonzero(widths == width)
            columns = np.stack([groups[int(k)] for k in which])
            G = np.einsum("rgi,rgj->gij", self.E[:, columns], self.E[:, columns])
            value, vector = np.linalg.eigh(G)
            turned = np.einsum("gij,gi->gj", vector, b[columns])
            kept = value > RANK * value.max(axis=1, keepdims=True)
            gained[which] = np.sum(np.where(kept, turned**2 / np.where(kept, value, 1.0), 0.0), axis=1)
        return gained

    def best(self, groups: Sequence[Array]) -> tuple[int, float]:
        """The group that an F-test prefers, and its p-value; the level is shared among all groups (Bonferroni).

        The p-value is 1 where so many columns leave no degree of freedom.
        """
        f = optional("scipy.stats", "--by f-test needs scipy: pip install 'casadical[withheld]'").f
        total, widths = float(self.y @ self.y), np.array([len(g) for g in groups])
        gain = np.minimum(self.gains(groups), total * (1 - 1e-12))
        freedom = self.freedom - widths
        ratio = np.where(freedom > 0, gain / widths / (total - gain) * freedom, 0.0)
        p = np.where(freedom > 0, np.minimum(1.0, f.sf(ratio, widths, np.maximum(freedom, 1)) * len(widths)), 1.0)
        # Beyond what a float can hold, the greater ratio decides.
        best = int(np.lexsort((-ratio, p))[0])
        return best, float(p[best])

    @property
    def mean_length(self) -> float:
        """Of the vectors of three rows that are left [m]."""
        return float(np.linalg.norm(self.y.reshape(-1, 3), axis=1).mean())


def f_test(s: Session) -> dict[str, Any]:
    """The answer to a campaign: a cause after the other, as long as the F-test is significant."""
    base = base_calibrated(prepare(s.robot, s.measured))
    case = make_case(base, [c for c in standard_candidates(s.robot) if c.listed])
    e = case.evidence
    rows = e.r.size
    left = Regression(e.r.ravel(), e.take(np.arange(e.width)).reshape(rows, -1), rows)
    left = left.with_columns(e.J.reshape(rows, -1))
    before = left.mean_length
    causes: list[dict[str, Any]] = []
    labels: list[str] = []
    together: dict[Effect, None] = {}
    while len(causes) < MOST:
        best, p = left.best(case.groups)
        if p >= SIGNIFICANT:
            break
        number, variant = case.variants[best]
        candidate = case.candidates[number]
        effects = candidate.variants[variant]
        left = left.with_columns(left.E[:, case.group(effects)])
        causes.append(
            {
                "effect": candidate.name,
                "joint": candidate.joint,
                "confidence": 1.0,
                "shrink": round(1 - left.mean_length / before, 4),
                "indistinguishable": [],
            }
        )
        labels.append(candidate.label)
        together |= dict.fromkeys(effects)
        # A label is taken once; its columns stay where they are.
        case = replace(case, candidates=tuple(c for c in case.candidates if c.label != candidate.label))
    out, with_causes = case.m.row[~case.kept], s.robot
    with suppress(ConvergenceError):  # then the nominal robot stays, without effects
        with_causes = s.fitted(s.robot.with_effect(*together), out) if together else s.robot
    return {
        "campaign": s.name,
        "verdict": "explained" if causes else "none",
        "gap_mm": {"before": round(1e3 * before, 5), "after": round(1e3 * left.mean_length, 5)},
        "causes": causes,
        "posterior": {labels[0] if labels else "none": 1.0},
        "unseen": unseen_positions(s, base.robot, with_causes, out),
    }
