"""Settings of invasive weed optimisation, and the step size that shrinks with the generations (paper, eq. 13)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from casadical.core.errors import InputError


@dataclass(frozen=True)
class IwoSettings:
    """Settings of the search; the defaults are the paper's (section 4).

    initial : members at the start
    maximum : members at most
    seeds_min : children of the worst member
    seeds_max : children of the best member
    exponent : of eq. 13
    sigma_initial : of eq. 13, at the start [as of the bounds]
    sigma_final : of eq. 13, at the end [as of the bounds]
    lower, upper : bound of every coordinate, or one a coordinate
    dispersal : "normal" for steps N(0, sigma), "literal" for the printed sigma * K with K uniform in [0, 1]
    iterations : generations at most
    target : loss at which it stops; None: none
    patience : generations in a row without a better loss after which it stops; None: none

    Examples
    --------
    >>> settings = casadical.compensator.IwoSettings(iterations=100)
    >>> settings.sigma(0) > settings.sigma(100)
    True
    """

    initial: int = 10
    maximum: int = 50
    seeds_min: int = 0
    seeds_max: int = 5
    exponent: float = 2.0
    sigma_initial: float = 0.05
    sigma_final: float = 0.0005
    lower: float | tuple[float, ...] = -1.7
    upper: float | tuple[float, ...] = 1.7
    dispersal: Literal["normal", "literal"] = "normal"
    iterations: int = 500
    target: float | None = None
    patience: int | None = None

    def __post_init__(self) -> None:
        if min(self.initial, self.maximum) < 1:
            raise InputError(f"a colony needs at least one member; got {self.initial} and {self.maximum}")
        if not 0 <= self.seeds_min <= self.seeds_max or self.seeds_max < 1:
            raise InputError(f"needs 0 <= seeds_min <= seeds_max and seeds_max >= 1; got {self}")
        if not (self.sigma_initial >= 0 and self.sigma_final >= 0 and self.exponent > 0):
            raise InputError(f"needs sigmas >= 0 and an exponent > 0; got {self}")
        if not np.all(np.asarray(self.lower) <= np.asarray(self.upper)):
            raise InputError(f"lower bounds must not exceed upper ones; got {self.lower} and {self.upper}")
        if self.dispersal not in ("normal", "literal"):
            raise InputError(f"dispersal is 'normal' or 'literal'; got {self.dispersal!r}")
        if self.iterations < 1 or (self.patience is not None and self.patience < 1):
            raise InputError(f"iterations and patience must be at least 1; got {self.iterations}, {self.patience}")

    def sigma(self, iteration: int) -> float:
        """Return the standard deviation of generation ``iteration`` = 0 .. iterations [as of the bounds] (eq. 13)."""
        left = (self.iterations - iteration) / self.iterations
        return float(left**self.exponent * (self.sigma_initial - self.sigma_final) + self.sigma_final)
