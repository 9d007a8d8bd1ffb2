"""Blocks of a report as plain data: words, tables and figures, and the page that they make."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from casadical.core.reporting.figure import Figure

# Role of a paragraph of a report, which sets its style.
Kind: TypeAlias = Literal["title", "text", "note", "warning", "error", "verdict"]


@dataclass(frozen=True)
class Words:
    """A paragraph.

    text : the paragraph
    kind : its role, which sets its style
    code : command or code beneath it, but in a PDF and, with a mark, on a terminal; empty: none
    mark : word before it; if given, only the mark has the style of the kind
    """

    text: str
    kind: Kind = "text"
    code: str = ""
    mark: str = ""


def next_step(purpose: str, command: str, *arguments: object) -> Words:
    """Return the paragraph with the command that a result suggests next.

    purpose : words such as "to learn what changed", which follow "Next,"
    command, arguments : name of the casadical command, and its arguments
    """
    return Words(f"Next, {purpose}:", code=shlex.join(["casadical", command, *map(str, arguments)]))


@dataclass(frozen=True)
class Table:
    """A table of text cells.

    title : title; empty: none
    columns : headings of the columns; all empty: no headings
    rows : cells of each row
    numbers : indices of the columns that are right-aligned
    strong, faint : indices of the rows in bold and in faint type
    folded : whether a page shows it only when the reader asks for it; a terminal shows it always
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers: frozenset[int] = frozenset()
    strong: frozenset[int] = frozenset()
    faint: frozenset[int] = frozenset()
    folded: bool = False


# Type of a block of a report.
Block = Words | Table | Figure


@dataclass(frozen=True, eq=False)
class Section:
    """A section of a page with a title; HTML omits sections without blocks."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Tile:
    """A key number, shown large at the top of a page.

    label, value, unit : its name, its number as text, and the unit
    note : words beneath it
    """

    label: str
    value: str
    unit: str = ""
    note: str = ""


@dataclass(frozen=True, eq=False)
class Page:
    """The report of one result.

    kind : kind of the result, such as "Calibration"
    title, subtitle : headings of the page
    sections : sections of the page in their order
    tiles : key numbers at the top
    badges : warnings that must not be overlooked, such as "synthetic data"
    files : files from which the result was computed
    """

    kind: str
    title: str
    subtitle: str
    sections: Sequence[Section]
    tiles: Sequence[Tile] = ()
    badges: Sequence[str] = ()
    files: Sequence[Path] = ()


def figures_named(figures: Mapping[str, Figure], start: str) -> list[Figure]:
    """Return the figures whose name is `start` or begins with `start` and a slash."""
    return [figure for name, figure in figures.items() if name == start or name.startswith(f"{start}/")]


def cut(text: str, letters: int = 240) -> str:
    """Return the last line of a text, cut and with " ..." appended if it has more letters.

    It is cut after a clause, if there are several, else after a word.
    """
    line = (text.strip().splitlines() or [""])[-1]
    if len(line) <= letters:
        return line
    whole, part, _ = line[:letters].rpartition("; ")
    return f"{whole if part else line[:letters].rpartition(' ')[0]} ..."


def mm(metres: float) -> str:
    """Return a length [m] as the text of a number of mm, with four to one decimal places."""
    value = 1e3 * metres
    return f"{value:.{4 if abs(value) < 0.1 else 3 if abs(value) < 10 else 2 if abs(value) < 100 else 1}f}"
