"""The errors of the package; each message says what is wrong, the value, what is allowed, and what to do."""

import importlib
from typing import Any


class CasadicalError(Exception):
    """Base class of all errors that casadical raises deliberately.

    Examples
    --------
    >>> issubclass(casadical.InputError, casadical.CasadicalError)
    True
    """


class InputError(CasadicalError, ValueError):
    """A file, table or argument is not usable as it is.

    Examples
    --------
    >>> try:
    ...     casadical.read_robot("nowhere.toml")
    ... except casadical.InputError as error:
    ...     print(error)
    nowhere.toml: no such file
    """


class ConvergenceError(CasadicalError, RuntimeError):
    """The solver stopped without an optimum; nothing was written.

    Examples
    --------
    >>> issubclass(casadical.ConvergenceError, (casadical.CasadicalError, RuntimeError))
    True
    """


def optional(module: str, otherwise: str) -> Any:
    """A module that an extra installs. Raises InputError, with this message, where it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(otherwise) from None


def shown(value: object) -> str:
    """A name or path as a message shows it: control characters escaped, and cut where it is very long."""
    text = "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(value))
    return text if len(text) <= 300 else f"{text[:297]}..."
