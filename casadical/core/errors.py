"""The errors of the package; each message says what is wrong, the value, what is allowed, and what to do."""


class CasadicalError(Exception):
    """Base class of all errors that casadical raises deliberately."""


class InputError(CasadicalError, ValueError):
    """A file, table or argument is not usable as it is."""


class ConvergenceError(CasadicalError, RuntimeError):
    """The solver stopped without an optimum; nothing was written."""
