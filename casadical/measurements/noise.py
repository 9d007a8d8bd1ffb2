"""The noise of measured positions: the instrument's, and the repeatability of the joints."""

from dataclasses import dataclass

from casadical.core.errors import InputError


@dataclass(frozen=True)
class Noise:
    """One sigma each: of a measured coordinate [m], and of how a joint repeats its reading [rad or m].

    Raises InputError for a sigma that is not positive and for a negative repeatability.
    """

    sigma: float = 2e-5
    repeatability: float = 0.0

    def __post_init__(self) -> None:
        if not (self.sigma > 0 and self.repeatability >= 0):
            raise InputError(
                f"noise of {self.sigma} m and {self.repeatability} rad; allowed: above zero, and zero or more"
            )
