"""The one form of what a test of a calibrated robot says: figures, sentences, and whether it is accepted."""

from casadical.core.telling.result import Result


class Acceptance(Result):
    """A test of a calibrated robot: verification, ISO 9283 or certificate."""

    @property
    def accepted(self) -> bool | None:
        """Return whether the error is within what it is held against; None where that is open or nothing is."""
        raise NotImplementedError
