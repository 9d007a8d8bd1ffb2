"""What nearly every module needs: the array type, the errors, and the progress callback.

An error message says what is wrong, the value, what is allowed, and what to do.
"""

import importlib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:  # numpy is not loaded for an annotation
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[Any]
else:
    Array = Any

# Metres in a millimetre, the unit of lengths in least-squares problems.
M_PER_MM = 1e-3
# Progress callback of long computations: it is called with a line of text.
Show = Callable[[str], None]


def silent(_text: str) -> None:
    """Ignore a line of progress."""


# Largest number of faults that one error message lists; the others are counted.
MAX_FAULTS_SHOWN = 50


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
    """A fault in a column of a table.

    source : name of the file
    rows : numbers of its faulty rows in the file, from 1; empty where the column is missing
    column : name of the column
    value : the first faulty value, or the worst, as text
    wrong : what is wrong with it
    allowed : what would be right; empty: nothing is said
    remedy : what the user can do
    """

    source: str
    rows: tuple[int, ...]
    column: str
    value: str
    wrong: str
    allowed: str
    remedy: str

    def within(self, other: "Fault") -> bool:
        """Return whether `other` is this fault in these rows and more, of any value and remedy."""
        same = replace(self, rows=other.rows, value=other.value, remedy=other.remedy) == other
        return same and {*self.rows} < {*other.rows}

    def __str__(self) -> str:
        if not self.rows:
            return f"{self.source}: column {self.column} {self.wrong}; {self.remedy}"
        such = f" ({len(self.rows)} such in this column)" if len(self.rows) > 1 else ""
        what = f"{self.value} {self.wrong}{f'; allowed: {self.allowed}' if self.allowed else ''}{such}"
        return f"{self.source}: row {self.rows[0]}, column {self.column!r}: {what}; {self.remedy}"


class FaultsError(InputError):
    """Several faults of files, raised together.

    faults : faults of tables
    others : other faults, as text
    """

    def __init__(self, faults: Sequence[Fault], others: Sequence[str] = ()) -> None:
        texts = [*map(str, faults), *others]
        more = [f"and {len(texts) - MAX_FAULTS_SHOWN} more"] if len(texts) > MAX_FAULTS_SHOWN else []
        super().__init__("\n".join([*texts[:MAX_FAULTS_SHOWN], *more]))
        self.faults, self.others = tuple(faults), tuple(others)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.faults, self.others)

    @staticmethod
    def joined(errors: Iterable[InputError]) -> InputError:
        """Return one error with the faults of all, without duplicates.

        Faults are grouped by file; one is dropped if another is the same in more rows. A single
        error is returned unchanged.
        """
        all_errors = list(errors)
        faults = list(dict.fromkeys(f for e in all_errors if isinstance(e, FaultsError) for f in e.faults))
        files = list(dict.fromkeys(f.source for f in faults))
        distinct = sorted((f for f in faults if not any(map(f.within, faults))), key=lambda f: files.index(f.source))
        others = [t for e in all_errors for t in (e.others if isinstance(e, FaultsError) else [str(e)])]
        combined = FaultsError(distinct, list(dict.fromkeys(others)))
        return all_errors[0] if len(all_errors) == 1 or str(combined) == str(all_errors[0]) else combined


def all_faults(steps: Iterable[Callable[[], object]]) -> None:
    """Call all functions and raise the InputErrors of those that fail as one error.

    Raises InputError; an error of another type is raised at once.
    """
    errors: list[InputError] = []
    for step in steps:
        try:
            step()
        except InputError as error:
            errors.append(error)
    if errors:
        raise FaultsError.joined(errors)


@contextmanager
def errors_of(place: str) -> Iterator[None]:
    """Prefix the message of an InputError of the block with a place, such as "FILE: " or "KEY.".

    Raises InputError, also in place of a FaultsError, whose faults are then in the message only.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}{error}") from None


class ConvergenceError(CasadicalError, RuntimeError):
    """A solver stopped without an optimum, or a simulator without an equilibrium.

    Examples
    --------
    >>> issubclass(casadical.ConvergenceError, (casadical.CasadicalError, RuntimeError))
    True
    """


def optional(module: str, otherwise: str) -> Any:
    """Return a module that belongs to an optional dependency, by its name.

    Raises InputError, with the message `otherwise`, where it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(otherwise) from None


def visible(text: str) -> str:
    """Return text that is safe for a terminal, with control characters escaped.

    Line feeds and tabs are unchanged.
    """
    return re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", lambda found: repr(found[0])[1:-1], text)


def shown(value: object) -> str:
    """Return a name or path as at most 300 characters for a message, unprintable ones escaped."""
    text = "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(value))
    return text if len(text) <= 300 else f"{text[:297]}..."
