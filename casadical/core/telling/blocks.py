"""The blocks that a result is told in, as plain data: words, tables and figures, and the page that they make."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from casadical.core.telling.figure import Figure

Kind: TypeAlias = Literal["title", "text", "note", "warning", "error", "verdict"]


@dataclass(frozen=True)
class Words:
    """A paragraph; code : a command to show beneath it; mark : a word before it, which alone looks as its kind does."""

    text: str
    kind: Kind = "text"
    code: str = ""
    mark: str = ""


def next_step(purpose: str, command: str, *arguments: object) -> Words:
    """The one command that a result suggests; purpose : "to learn what changed", or "when ..." """
    return Words(f"Next, {purpose}:", code=shlex.join(["casadical", command, *map(str, arguments)]))


@dataclass(frozen=True)
class Table:
    """Rows of cells as text; numbers : columns set flush right; strong, faint : rows to stress or to hold back.

    folded : shown on a page when the reader asks for it; a terminal shows it all
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers: frozenset[int] = frozenset()
    strong: frozenset[int] = frozenset()
    faint: frozenset[int] = frozenset()
    folded: bool = False


Block = Words | Table | Figure


@dataclass(frozen=True, eq=False)
class Section:
    """One question of the reader and what answers it; an empty one is left out."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Tile:
    """A main figure, shown large at the top of a page."""

    label: str
    value: str
    unit: str = ""
    note: str = ""


@dataclass(frozen=True, eq=False)
class Page:
    """All that is told of one result.

    kind : of the result, as "Calibration"; badges : what must not be overlooked, as "synthetic data"
    files : from which it was made
    """

    kind: str
    title: str
    subtitle: str
    sections: Sequence[Section]
    tiles: Sequence[Tile] = ()
    badges: Sequence[str] = ()
    files: Sequence[Path] = ()


def shown(figures: Mapping[str, Figure], start: str) -> list[Figure]:
    """The figures of a name, or of names that begin with it and a slash."""
    return [figure for name, figure in figures.items() if name == start or name.startswith(f"{start}/")]


def mm(metres: float) -> str:
    """A length in mm, with three digits or more."""
    value = 1e3 * metres
    return f"{value:.{4 if abs(value) < 0.1 else 3 if abs(value) < 10 else 2 if abs(value) < 100 else 1}f}"
