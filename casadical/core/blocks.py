"""The blocks of a report as plain data: words and tables, for the terminal and for HTML."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from textwrap import indent
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from rich.console import RenderableType

# How a terminal shows each kind of words.
_STYLES = {"title": "bold underline", "text": "", "note": "dim", "warning": "yellow", "verdict": "bold"}


@dataclass(frozen=True)
class Words:
    """A paragraph; code : a command to show beneath it."""

    text: str
    kind: Literal["title", "text", "note", "warning", "verdict"] = "text"
    code: str = ""

    def __rich__(self) -> RenderableType:
        from rich.text import Text

        return Text(f"{self.text}\n{indent(self.code, '    ')}" if self.code else self.text, style=_STYLES[self.kind])


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

    def __rich__(self) -> RenderableType:
        """First column and numbers stay on one line; other columns are broken where the terminal is narrow."""
        from rich import table as rich
        from rich.text import Text  # takes brackets as they are

        title = Text(self.title, style="bold") if self.title else None
        shown = rich.Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0), pad_edge=False)
        for k, name in enumerate(self.columns):
            number = k in self.numbers
            shown.add_column(Text(name), justify="right" if number else "left", no_wrap=number or k == 0)
        for k, row in enumerate(self.rows):
            shown.add_row(*map(Text, row), style="bold" if k in self.strong else "dim" if k in self.faint else "")
        return shown


def terminal(blocks: Sequence[Words | Table]) -> RenderableType:
    """Blocks one below the other, for a console of rich, with a blank line before and after every table."""
    from rich.console import Group

    spaced: list[RenderableType] = list(blocks[:1])
    for above, block in pairwise(blocks):
        spaced += [*([""] if isinstance(above, Table) or isinstance(block, Table) else []), block]
    return Group(*spaced)


def plain_text(blocks: Sequence[Words | Table], width: int = 80) -> str:
    """Blocks as a terminal of so many columns shows them, without colours."""
    from rich.console import Console

    console = Console(width=width, file=io.StringIO(), record=True)
    console.print(terminal(blocks))
    return console.export_text()


def mm(metres: float) -> str:
    """A length in mm, with three digits or more."""
    value = 1e3 * metres
    return f"{value:.{4 if abs(value) < 0.1 else 3 if abs(value) < 10 else 2 if abs(value) < 100 else 1}f}"
