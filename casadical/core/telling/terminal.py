"""Blocks on a terminal: words and tables, by rich; figures are left out."""

from __future__ import annotations

import io
from collections.abc import Sequence
from itertools import pairwise, zip_longest
from textwrap import indent as indented
from textwrap import wrap
from typing import TYPE_CHECKING

from casadical.core.telling.blocks import Block, Table, Words
from casadical.core.telling.figure import Figure

if TYPE_CHECKING:
    from rich.console import RenderableType

# How a terminal shows each kind of words.
_STYLES = {
    "title": "bold underline", "text": "", "note": "dim", "warning": "yellow", "error": "bold red", "verdict": "bold",
}  # fmt: skip
# Characters of a line of a command.
_WIDE = 72


def terminal(blocks: Sequence[Block]) -> RenderableType:
    """Blocks one below the other, for a console of rich, with a blank line before and after every table."""
    from rich.console import Group

    shown = [block for block in blocks if not isinstance(block, Figure)]
    lines: list[RenderableType] = [_rendered(block) for block in shown[:1]]
    for above, block in pairwise(shown):
        blank = isinstance(above, Table) or isinstance(block, Table)
        lines += [*([""] if blank else []), _rendered(block)]
    return Group(*lines)


def _rendered(block: Words | Table) -> RenderableType:
    from rich.text import Text  # takes brackets as they are

    if isinstance(block, Table):
        return _table(block)
    if block.mark:
        return Text.assemble((block.mark, _STYLES[block.kind]), f" {block.text}")
    code = block.code
    if code.startswith("casadical "):  # a command is broken so that it can be copied
        code = " \\\n".join(wrap(code, _WIDE, break_long_words=False, break_on_hyphens=False, subsequent_indent="  "))
    return Text(f"{block.text}\n{indented(code, '    ')}" if code else block.text, style=_STYLES[block.kind])


def _table(block: Table) -> RenderableType:
    """Numbers stay on one line; where the terminal is narrow all else is broken, nothing is cut."""
    from rich import table as rich
    from rich.text import Text

    title = Text(block.title, style="bold") if block.title else None
    shown = rich.Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0), pad_edge=False)
    for k, name in enumerate(block.columns):
        number = k in block.numbers
        longest = max((len(row[k]) for row in block.rows), default=0)
        least = longest if number else None
        shown.add_column(Text(name), justify="right" if number else "left", overflow="fold", min_width=least)
    for k, row in enumerate(block.rows):
        shown.add_row(*map(Text, row), style="bold" if k in block.strong else "dim" if k in block.faint else "")
    return shown


def table_lines(
    table: Table, widths: Sequence[int] = (), *, gap: int = 2, indent: int = 0, most: int = 0
) -> list[list[str]]:
    """A table as lines of plain text: those of its head, then those of each row, for pages of a fixed width.

    widths : of its columns, by default of the longest cell of each; gap : between them; indent : before the first
    most : characters of a line, so that the last column is broken; cells may hold several lines, too
    """
    rows = [row for row in (table.columns, *table.rows) if row]
    wide = widths or [max(len(line) for row in rows for line in row[k].split("\n")) for k in range(len(rows[0]))]
    room = most - indent - sum(wide[:-1]) - gap * (len(wide) - 1)
    texts = []
    for row in rows:
        cells = [cell.split("\n") for cell in row]
        if most:
            cells[-1] = wrap(row[-1], room, break_on_hyphens=False)
        lines = []
        for parts in zip_longest(*cells, fillvalue=""):
            sides = (
                part.rjust(width) if k in table.numbers else part.ljust(width)
                for k, (part, width) in enumerate(zip(parts, wide, strict=True))
            )
            lines.append((" " * indent + (" " * gap).join(sides)).rstrip())
        texts.append(lines)
    return texts


def plain_text(blocks: Sequence[Block], width: int = 80) -> str:
    """Blocks as a terminal of so many columns shows them, without colours."""
    from rich.console import Console

    console = Console(width=width, file=io.StringIO(), record=True)
    console.print(terminal(blocks))
    return console.export_text()
