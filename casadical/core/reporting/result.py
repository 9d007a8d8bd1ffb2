"""The common form of results: as report blocks, on a terminal, in a notebook, as JSON and in files.

On a terminal rich shows words and tables; figures are omitted.
"""

from __future__ import annotations

import inspect
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from textwrap import indent as indented
from textwrap import wrap
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from casadical.core.basics import visible
from casadical.core.reporting.blocks import Block, Table, Words
from casadical.core.reporting.figure import Figure
from casadical.core.reporting.plain import Key, plain
from casadical.core.reporting.template import filled, pages, template_blocks

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderableType, RenderResult


def terminal(blocks: Sequence[Block]) -> RenderableType:
    """Return the words and tables among blocks as one object that a console of rich prints.

    A blank line is between a table and the blocks next to it; figures are omitted.
    """
    from rich.console import Group

    shown = [block for block in blocks if not isinstance(block, Figure)]
    lines: list[RenderableType] = [_rendered(block) for block in shown[:1]]
    for above, block in pairwise(shown):
        blank = isinstance(above, Table) or isinstance(block, Table)
        lines += [*([""] if blank else []), _rendered(block)]
    return Group(*lines)


def _rendered(block: Words | Table) -> RenderableType:
    """Return a block of text or a table as an object that a console of the library rich prints."""
    from rich.text import Text  # in which brackets are not markup

    if isinstance(block, Table):
        return _Fitted(block)
    # Style of the library rich in which a terminal shows each kind of words.
    style_by_kind = {"title": "bold underline", "text": "", "note": "dim", "warning": "yellow"}
    style_by_kind |= {"error": "bold red", "verdict": "bold"}
    if block.mark:
        return Text.assemble((block.mark, style_by_kind[block.kind]), f" {visible(block.text)}")
    code = block.code
    if code.startswith("casadical "):  # a command is broken so that it can be copied
        # A command is wrapped at 72 characters.
        code = " \\\n".join(wrap(code, 72, break_long_words=False, break_on_hyphens=False, subsequent_indent="  "))
    text = visible(f"{block.text}\n{indented(code, '    ')}" if code else block.text)
    return Text(text, style=style_by_kind[block.kind])


@dataclass(frozen=True)
class _Fitted:
    """A table fitted to a console: text wraps, numbers only where they do not fit in one line."""

    block: Table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the table with numbers on one line if nothing is cut, else with wrapped cells."""
        whole = self._rich(one_line=True)
        drawn = sum(_visible_characters(part.text) for line in console.render_lines(whole, options) for part in line)
        block = self.block
        cells = [block.title, *block.columns, *(cell for row in block.rows for cell in row)]
        yield (
            whole if drawn == sum(_visible_characters(visible(cell)) for cell in cells) else self._rich(one_line=False)
        )

    def _rich(self, *, one_line: bool) -> RenderableType:
        """Return the table for the library rich; one_line : whether numbers must not wrap."""
        from rich import table as rich
        from rich.text import Text

        block = self.block
        title = Text(block.title, style="bold") if block.title else None
        shown = rich.Table(
            title=title,
            title_justify="left",
            box=None,
            padding=(0, 2, 0, 0),
            pad_edge=False,
            show_header=any(block.columns),
        )
        for k, name in enumerate(block.columns):
            number = k in block.numbers
            min_width = max((len(row[k]) for row in block.rows), default=0) if number and one_line else None
            justify: Literal["left", "right"] = "right" if number else "left"
            shown.add_column(Text(visible(name)), justify=justify, overflow="fold", min_width=min_width)
        for k, row in enumerate(block.rows):
            shown.add_row(
                *map(Text, map(visible, row)), style="bold" if k in block.strong else "dim" if k in block.faint else ""
            )
        return shown


def _visible_characters(text: str) -> int:
    """Return the number of characters that are not white space."""
    return len("".join(text.split()))


def plain_text(blocks: Sequence[Block], width: int = 80) -> str:
    """Return blocks as the text that a terminal of `width` characters shows, without colours."""
    from rich.console import Console

    console = Console(width=width, file=io.StringIO(), record=True)
    console.print(terminal(blocks))
    return console.export_text()


def shortened(blocks: Sequence[Block], lines: int = 16) -> list[Block]:
    """Return the blocks, at least one, that fit into so many lines of 80 columns, in their order.

    Verdicts, titles, errors, warnings and words in capitals (LEFT OUT) are chosen first, then
    sentences, tables and figures, then notes.
    """

    def weight(block: Block) -> int:
        """Return 0 for the most important blocks, 2 for the least important ones."""
        if not isinstance(block, Words):
            return 1
        loud = block.kind in ("verdict", "title", "error", "warning") or (block.mark or block.text)[:3].isupper()
        return 0 if loud else 2 if block.kind == "note" else 1

    order = sorted(range(len(blocks)), key=lambda k: weight(blocks[k]))
    chosen: list[int] = []
    for k in order:
        tried = sorted([*chosen, k])
        if not chosen or plain_text([blocks[i] for i in tried]).count("\n") <= lines:
            chosen = tried
    return [blocks[k] for k in chosen]


class Shown:
    """Base of results with a one-line `repr`: the class name and a summary.

    line : jinja2 template of the summary, with the result as `it`; empty: the summary is the
        verdict or the first paragraph of `blocks`
    """

    line: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.__repr__ = Shown.__repr__  # type: ignore[method-assign]  # a dataclass keeps what is there

    @property
    def _line(self) -> str:
        """Return the summary that follows the class name in `repr`."""
        if self.line:
            return filled(self.line, self)
        words = [block for block in self.blocks() if isinstance(block, Words)]  # type: ignore[attr-defined]
        words.sort(key=lambda block: block.kind != "verdict")
        return f": {words[0].text}" if words else ""

    def __repr__(self) -> str:
        line = f"{type(self).__name__}{self._line}"
        return f"<{line if len(line) <= 160 else line[:157] + '...'}>"


def html(blocks: Sequence[Block], bars: Sequence[tuple[str, float]] = (), title: str = "") -> str:
    """Return blocks, without figures, as HTML for a notebook.

    bars : label and length [m] of each bar beneath them; title : title of the HTML
    """
    template = pages(Path(__file__).parent / "templates").get_template("notebook.html")
    return template.render(blocks=blocks, bars=bars, title=title)


class Result(Shown):
    """Base of results that are shown on terminals, in notebooks, reports and JSON.

    Showing a result computes nothing.

    report : file name of the template of its sentences, in the folder of the class's module
    file_stem : name of the files in which it is saved, without the suffix
    derived : keys of its JSON that are not marked fields, see `plain`
    """

    report: ClassVar[str]
    file_stem: ClassVar[str] = "result"
    derived: ClassVar[tuple[Key, ...]] = ()

    def blocks(self) -> Sequence[Block]:
        """Return the report as words, tables and figures."""
        return self._report_blocks(brief=False)

    def _report_blocks(self, **more: Any) -> list[Block]:
        """Return the blocks of the template `report`; more : values that it needs, by name."""
        return template_blocks(Path(inspect.getfile(type(self))).parent / self.report, self, **more)

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain data, in the units that its keys name (see `plain`)."""
        data: dict[str, Any] = plain(self)
        return data

    @property
    def next(self) -> tuple[Words, ...]:
        """Return the suggested next commands, see `next_step`; empty: none."""
        return ()

    @property
    def commands(self) -> list[str]:
        """Return the commands of `next` as they are typed, for the JSON file."""
        return [step.code for step in self.next]

    def files(self, folder: str | Path) -> Mapping[Path, str | bytes]:
        """Return the texts of the files that save the result in a folder, by their paths.

        They are the JSON file and the report as plain text; nothing is written.
        """
        from casadical.core.files import json_text  # late: the simulators' physics show results but write none

        place = Path(folder) / self.file_stem
        words = plain_text(self.blocks(), 100)
        return {place.with_suffix(".json"): json_text(self.to_json()), place.with_suffix(".txt"): words}

    def bars(self) -> Sequence[tuple[str, float]]:
        """Return lengths [m] with their labels, which a notebook shows as bars."""
        return ()

    def _repr_html_(self) -> str:
        """Return the result as HTML for a notebook."""
        return html(self.blocks(), self.bars(), repr(self)[1:-1])
