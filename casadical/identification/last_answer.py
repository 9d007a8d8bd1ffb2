"""What a least squares problem computed last: at one point it is asked for cost, gradient and statistics in turn."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from casadical.core.arrays import Array


@dataclass(frozen=True, eq=False)
class Sums:
    """Of all poses at one point: cost and gradient with the priors, J'WJ without, residuals of every set."""

    cost: float
    gradient: Array
    information: Array
    residuals: list[Array]


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
        if not self.holds(v):
            self.point, self.answer = v.copy(), compute(v)
        return self.answer
