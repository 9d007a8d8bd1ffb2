"""The errors a user can meet; each message says what was wrong, the value, what is allowed, and what to do."""


class CasadicalError(Exception):
    """Base of every error that casadical raises on purpose."""


class InputError(CasadicalError, ValueError):
    """A file, table or argument is not usable as it is."""


class ConvergenceError(CasadicalError, RuntimeError):
    """The solver stopped without an optimum; nothing was written."""
