"""The noise of measured positions: the instrument's, and the repeatability of the joints."""

from dataclasses import dataclass

from casadical.core.basics import InputError


@dataclass(frozen=True)
class Noise:
    """Noise of a campaign.

    sigma : of a measured coordinate, one sigma [m]
    repeatability : of how a joint repeats its reading, one sigma [rad or m]
    Raises InputError: a sigma that is not positive, or a negative repeatability.

    Examples
    --------
    >>> casadical.pose_selection.Noise(sigma=2e-5, repeatability=8e-6).sigma
    2e-05
    """

    sigma: float = 2e-5
    repeatability: float = 0.0

    def __post_init__(self) -> None:
        if not (self.sigma > 0 and self.repeatability >= 0):
            raise InputError(
                f"noise of {self.sigma} m and {self.repeatability} rad; allowed: above zero, and zero or more"
            )
