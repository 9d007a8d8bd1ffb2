"""The one form of what a test of a calibrated robot says: an error, what it is held against, and what follows."""

from typing import ClassVar

from casadical.core.telling.result import Result


class Acceptance(Result):
    """A test of a calibrated robot.

    report : its sentences, as of every result
    """

    report: ClassVar[str]

    @property
    def error(self) -> float:
        """Return the rms position error that was found [m]."""
        raise NotImplementedError

    @property
    def accepted(self) -> bool | None:
        """Return whether the error is within what it is held against; None where that is open or nothing is."""
        raise NotImplementedError
