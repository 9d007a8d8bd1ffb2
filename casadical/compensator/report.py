"""Accuracy of a compensator: mean, maximum and standard deviation of the position error."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from casadical.core.basics import Array


@dataclass(frozen=True)
class Errors:
    """Statistics of the position errors of a set of poses.

    poses : number n of poses
    mean_mm, max_mm, std_mm : mean, maximum and sample standard deviation (divisor n - 1) of the
        errors' norms [mm]; the last is 0 for one pose
    """

    poses: int
    mean_mm: float
    max_mm: float
    std_mm: float

    @classmethod
    def summarise(cls, errors_mm: Array) -> Self:
        """Return the statistics of the norms of error vectors, shape (n, outputs) [mm]."""
        length = np.linalg.norm(errors_mm, axis=1)
        spread = float(length.std(ddof=1)) if len(length) > 1 else 0.0
        return cls(len(length), float(length.mean()), float(length.max()), spread)


@dataclass(frozen=True)
class BeforeAfter:
    """Errors of the same poses without and with the network.

    before, after : statistics without and with the network
    gain : relative reduction of the mean error, 1 - mean after / mean before; 0.3 is 30 %; 0 if
        the mean before is zero
    gain_error : standard error of the gain; 0 for one pose, or if the mean before is zero
    """

    before: Errors
    after: Errors
    gain: float
    gain_error: float

    @classmethod
    def compare(cls, before_mm: Array, after_mm: Array) -> Self:
        """Return the comparison of n poses' error vectors without and with the network.

        before_mm, after_mm : shape (n, outputs) [mm]
        """
        was, now = np.linalg.norm(before_mm, axis=1), np.linalg.norm(after_mm, axis=1)
        mean = float(was.mean())
        if mean == 0.0:
            return cls(Errors.summarise(before_mm), Errors.summarise(after_mm), 0.0, 0.0)
        ratio = float(now.mean()) / mean
        # Standard error of the ratio of two means of paired values, by the delta method.
        spread = float(np.std(now - ratio * was, ddof=1)) if len(was) > 1 else 0.0
        return cls(Errors.summarise(before_mm), Errors.summarise(after_mm), 1 - ratio, spread / mean / len(was) ** 0.5)


def table(rows: dict[str, BeforeAfter]) -> str:
    """Return statistics of sets of poses, by name, as text, without > with the network [mm]."""
    lines = [f"{'[mm]':24}{'poses':>6}  {'mean':>15}  {'max':>15}  {'std':>15}"]
    for name, row in rows.items():
        b, a = row.before, row.after
        pairs = ((b.mean_mm, a.mean_mm), (b.max_mm, a.max_mm), (b.std_mm, a.std_mm))
        lines.append(f"{name:24}{b.poses:6}  " + "  ".join(f"{was:6.4f} > {now:6.4f}" for was, now in pairs))
    return "\n".join(lines)
