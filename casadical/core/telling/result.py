"""What a public function or a command gives, in one form: told by blocks, as plain data, kept in files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, ClassVar

from casadical.core.telling.blocks import Block, Table, Words, mm
from casadical.core.telling.figure import Figure
from casadical.core.telling.terminal import plain_text

_CELL = "padding:2px 12px 2px 0;text-align:{};white-space:nowrap"
_BAR, _ROW, _LABEL = 260, 20, 190


# Characters of a result's line.
LINE = 160


class Shown:
    """A result that Python shows as one line: its class, and `_line`, by default the first of its blocks."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.__repr__ = Shown.__repr__  # type: ignore[method-assign]  # a dataclass keeps what is there

    @property
    def _line(self) -> str:
        words = [block for block in self.blocks() if isinstance(block, Words)]  # type: ignore[attr-defined]
        words.sort(key=lambda block: block.kind != "verdict")
        return f": {words[0].text}" if words else ""

    def __repr__(self) -> str:
        line = f"{type(self).__name__}{self._line}"
        return f"<{line if len(line) <= LINE else line[: LINE - 3] + '...'}>"


def html(blocks: Sequence[Words | Table], bars: Sequence[tuple[str, float]] = (), title: str = "") -> str:
    """Blocks, beneath them a bar for each (words, length [m]); a table that is folded on a page is folded here, too."""
    parts = [f"<b>{escape(title)}</b>"] if title else []
    parts += [_table(b) if isinstance(b, Table) else _words(b) for b in blocks]
    return f"<div>{''.join(parts)}{_bars(bars) if bars else ''}</div>"


def _words(block: Words) -> str:
    weight = "bold" if block.kind in ("title", "verdict") else "normal"
    faint = ";opacity:.7" if block.kind == "note" else ""
    mark = f"<b>{escape(block.mark)}</b> " if block.mark else ""
    return f'<p style="font-weight:{weight};margin:4px 0;max-width:80ch{faint}">{mark}{escape(block.text)}</p>'


def _table(block: Table) -> str:
    sides = ["right" if k in block.numbers else "left" for k in range(len(block.columns))]
    head = "".join(f'<th style="{_CELL.format(s)}">{escape(c)}</th>' for c, s in zip(block.columns, sides, strict=True))
    rows = []
    for k, row in enumerate(block.rows):
        weight = "bold" if k in block.strong else "normal"
        cells = (f'<td style="{_CELL.format(s)}">{escape(c)}</td>' for c, s in zip(row, sides, strict=True))
        rows.append(f'<tr style="font-weight:{weight}">{"".join(cells)}</tr>')
    table = (
        f'<table style="border-collapse:collapse"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'
    )
    if block.folded:
        return f"<details><summary>{escape(block.title)}</summary>{table}</details>"
    return f'<p style="font-weight:bold;margin:6px 0 2px">{escape(block.title)}</p>{table}'


def _bars(bars: Sequence[tuple[str, float]]) -> str:
    longest = max(length for _, length in bars) or 1.0
    rows = []
    for k, (words, length) in enumerate(bars):
        y, width = k * _ROW, max(1.0, _BAR * length / longest)
        rows.append(
            f'<text x="{_LABEL - 8}" y="{y + 14}" text-anchor="end">{escape(words)}</text>'
            f'<rect x="{_LABEL}" y="{y + 3}" width="{width:.1f}" height="{_ROW - 6}" fill="#3d95c9"/>'
            f'<text x="{_LABEL + width + 6:.1f}" y="{y + 14}">{mm(length)} mm</text>'
        )
    size = f'width="{_LABEL + _BAR + 90}" height="{_ROW * len(bars)}"'
    return f'<svg {size} font-size="12" fill="currentColor" role="img">{"".join(rows)}</svg>'


class Result(Shown):
    """A result; terminal, notebook, report and JSON are made of what it has, and showing it computes nothing.

    ``blocks`` and ``to_json`` are its own. ``kept_as`` : name of its files, without the ending
    """

    kept_as: ClassVar[str] = "result"

    def blocks(self) -> Sequence[Block]:
        """In words, tables and figures."""
        raise NotImplementedError

    def to_json(self) -> dict[str, Any]:
        raise NotImplementedError

    @property
    def next(self) -> tuple[Words, ...]:
        """The one command to go on with, where the result suggests one (see `next_step`); the last of its blocks."""
        return ()

    def files(self, folder: str | Path) -> Mapping[Path, str]:
        """What is kept of it, by file, in a folder: plain data and words."""
        from casadical.core.files import json_text  # late: physics shows results too, and writes none

        place = Path(folder) / self.kept_as
        words = plain_text(self.blocks(), 100)
        return {place.with_suffix(".json"): json_text(self.to_json()), place.with_suffix(".txt"): words}

    def bars(self) -> Sequence[tuple[str, float]]:
        """Lengths [m] that a notebook shows as bars, each with its words."""
        return ()

    def _repr_html_(self) -> str:
        """For a notebook."""
        shown = [block for block in self.blocks() if not isinstance(block, Figure)]
        return html(shown, self.bars(), repr(self)[1:-1])
