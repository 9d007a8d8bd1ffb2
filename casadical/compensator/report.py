"""Accuracy figures of a compensator: mean, max and standard deviation of the position error, before and after."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from casadical.core.basics import Array


@dataclass(frozen=True)
class Errors:
    """Error lengths of a set of poses: how many; mean, maximum and standard deviation of the sample (n - 1) [mm]."""

    poses: int
    mean_mm: float
    max_mm: float
    std_mm: float

    @classmethod
    def summarise(cls, errors_mm: Array) -> Self:
        """Summarise error vectors, shape (n, outputs) [mm]."""
        length = np.linalg.norm(errors_mm, axis=1)
        spread = float(length.std(ddof=1)) if len(length) > 1 else 0.0
        return cls(len(length), float(length.mean()), float(length.max()), spread)


@dataclass(frozen=True)
class BeforeAfter:
    """Errors of poses without and with the network; gain : 1 - mean after / mean before, and its standard error."""

    before: Errors
    after: Errors
    gain: float
    gain_error: float

    @classmethod
    def compare(cls, before_mm: Array, after_mm: Array) -> Self:
        """Compare error vectors of the same poses before and after, shape (n, outputs) [mm] each."""
        was, now = np.linalg.norm(before_mm, axis=1), np.linalg.norm(after_mm, axis=1)
        mean = float(was.mean())
        if mean == 0.0:
            return cls(Errors.summarise(before_mm), Errors.summarise(after_mm), 0.0, 0.0)
        ratio = float(now.mean()) / mean
        # delta method: the ratio of two means of paired values
        spread = float(np.std(now - ratio * was, ddof=1)) if len(was) > 1 else 0.0
        return cls(Errors.summarise(before_mm), Errors.summarise(after_mm), 1 - ratio, spread / mean / len(was) ** 0.5)


def table(rows: dict[str, BeforeAfter]) -> str:
    """Return the figures of several sets as a plain text table."""
    lines = [f"{'[mm]':24}{'poses':>6}  {'mean':>15}  {'max':>15}  {'std':>15}"]
    for name, row in rows.items():
        b, a = row.before, row.after
        pairs = ((b.mean_mm, a.mean_mm), (b.max_mm, a.max_mm), (b.std_mm, a.std_mm))
        lines.append(f"{name:24}{b.poses:6}  " + "  ".join(f"{was:6.4f} > {now:6.4f}" for was, now in pairs))
    return "\n".join(lines)
