"""What a least squares problem computed last: at one point it is asked for cost, gradient and statistics in turn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from casadical.core.arrays import Array

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Sums:
    """Of all poses at one point, without priors: cost, gradient, J'WJ, and the residuals of every set.

    square : sum of the squared residuals, without the loss; residuals : None of so many poses that they are not kept
    triangle : triangular factor of J, without the loss, where it was asked for
    """

    cost: float
    gradient: Array
    information: Array
    square: float
    residuals: list[Array] | None
    triangle: Array | None = None

    def for_variables(self, columns: Sequence[int]) -> Sums:
        """The same poses for some of the variables alone."""
        at = np.array(columns, dtype=int)
        return Sums(self.cost, self.gradient[at], self.information[np.ix_(at, at)], self.square, self.residuals)


class Last:
    """The last answer of a function of a point, shape (size,), and that point."""

    point: Array | None = None
    answer: Any = None

    def holds(self, v: Array) -> bool:
        """Whether v is that point, to the bit."""
        return self.point is not None and self.point.tobytes() == v.tobytes()

    @property
    def at_zero(self) -> Any:
        """The answer, if it is that at zero; else None."""
        return None if self.point is None or self.point.any() else self.answer

    def __call__(self, v: Array, compute: Callable[[Array], Any]) -> Any:
        """Its answer at v, computed where v is another point."""
        return self.answer if self.holds(v) else self.keep(v, compute(v))

    def keep(self, v: Array, answer: Any) -> Any:
        """An answer at v that was computed elsewhere."""
        self.point, self.answer = v.copy(), answer
        return answer


class Kept:
    """What a problem has computed: once and for all, by name, and last at one point."""

    def __init__(self) -> None:
        self.made: dict[str, Any] = {}
        self.sums, self.parts, self.gradient, self.cost = Last(), Last(), Last(), Last()

    def once(self, name: str, compute: Callable[[], T]) -> T:
        """What was computed under this name, or now."""
        if name not in self.made:
            self.made[name] = compute()
        answer: T = self.made[name]
        return answer
