"""The common interface of acceptance tests: their figures, sentences and acceptance."""

from casadical.core.reporting.result import Result


class Acceptance(Result):
    """The result of a test of a calibrated robot: verification, ISO 9283 or certificate."""

    @property
    def accepted(self) -> bool | None:
        """Return whether the error is within its limit; None where open or without a limit."""
        raise NotImplementedError
