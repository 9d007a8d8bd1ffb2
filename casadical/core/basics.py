"""What nearly every module needs: the one name for arrays, the errors, and how long work says where it stands.

Each message of an error says what is wrong, the value, what is allowed, and what to do.
"""

import importlib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:  # numpy is not loaded for a name in annotations
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[Any]
else:
    Array = Any

# How long work says where it stands: a function that is called with a line.
Show = Callable[[str], None]


def silent(_text: str) -> None:
    """Shows nothing."""


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

    def within(self, other: "Fault") -> bool:
        """Whether another one says the same of more rows."""
        same = replace(self, rows=other.rows, value=other.value, remedy=other.remedy) == other
        return same and {*self.rows} < {*other.rows}

    def __str__(self) -> str:
        if not self.rows:
            return f"{self.source}: column {self.column} {self.wrong}; {self.remedy}"
        such = f" ({len(self.rows)} such in this column)" if len(self.rows) > 1 else ""
        what = f"{self.value} {self.wrong}{f'; allowed: {self.allowed}' if self.allowed else ''}{such}"
        return f"{self.source}: row {self.rows[0]}, column {self.column!r}: {what}; {self.remedy}"


class FaultsError(InputError):
    """All faults of files that were found at once.

    faults : of tables; others : in words, what else is wrong, each of one file
    """

    def __init__(self, faults: Sequence[Fault], others: Sequence[str] = ()) -> None:
        texts = [*map(str, faults), *others]
        more = [f"and {len(texts) - MOST_FAULTS} more"] if len(texts) > MOST_FAULTS else []
        super().__init__("\n".join([*texts[:MOST_FAULTS], *more]))
        self.faults, self.others = tuple(faults), tuple(others)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.faults, self.others)

    @staticmethod
    def joined(errors: Iterable[InputError]) -> InputError:
        """Several errors as one, each fault once; of the same in fewer rows of the same column, that of most rows."""
        every = list(errors)
        faults = list(dict.fromkeys(f for e in every if isinstance(e, FaultsError) for f in e.faults))
        files = list(dict.fromkeys(f.source for f in faults))
        kept = sorted((f for f in faults if not any(map(f.within, faults))), key=lambda f: files.index(f.source))
        others = [t for e in every for t in (e.others if isinstance(e, FaultsError) else [str(e)])]
        whole = FaultsError(kept, list(dict.fromkeys(others)))
        return every[0] if len(every) == 1 or str(whole) == str(every[0]) else whole


def all_faults(steps: Iterable[Callable[[], object]]) -> None:
    """Takes several steps; their errors are raised together. Raises InputError."""
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
    """Raises InputError with a place, "file: " or "key.", in front of what the block raises as such."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}{error}") from None


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


def visible(text: str) -> str:
    """Lines as a terminal may get them: control characters of what was read escaped."""
    return re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", lambda found: repr(found[0])[1:-1], text)


def shown(value: object) -> str:
    """A name or path as a message shows it: control characters escaped, and cut where it is very long."""
    text = "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(value))
    return text if len(text) <= 300 else f"{text[:297]}..."
