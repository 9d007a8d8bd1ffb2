"""The errors of the package; each message says what is wrong, the value, what is allowed, and what to do."""

import importlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

# Faults of one file that a message tells.
MOST_FAULTS = 50


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


@dataclass(frozen=True)
class Fault:
    """What is wrong with a column of a table.

    source : file; rows : its lines, none where a column is missing; value : the first one, or the worst
    wrong : what it is; allowed : in its place
    """

    source: str
    rows: tuple[int, ...]
    column: str
    value: str
    wrong: str
    allowed: str
    remedy: str

    def __str__(self) -> str:
        if not self.rows:
            return f"{self.source}: column {self.column} {self.wrong}; {self.remedy}"
        such = f" ({len(self.rows)} such in this column)" if len(self.rows) > 1 else ""
        what = f"{self.value} {self.wrong}{f'; allowed: {self.allowed}' if self.allowed else ''}{such}"
        return f"{self.source}: row {self.rows[0]}, column {self.column!r}: {what}; {self.remedy}"


class FaultsError(InputError):
    """All faults of tables that were found at once."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        more = [f"and {len(faults) - MOST_FAULTS} more"] if len(faults) > MOST_FAULTS else []
        super().__init__("\n".join([*map(str, faults[:MOST_FAULTS]), *more]))
        self.faults = tuple(faults)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.faults,)


def all_faults(steps: Iterable[Callable[[], object]]) -> None:
    """Takes several steps; their faults are raised together (FaultsError), any other error at once."""
    faults: list[Fault] = []
    for step in steps:
        try:
            step()
        except FaultsError as error:
            faults += error.faults
    if faults:
        raise FaultsError(list(dict.fromkeys(faults)))


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
