"""What a public function or a command gives, in one form: told by blocks, as plain data, kept in files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from casadical.core.files import json_text
from casadical.core.telling.blocks import Block, Words
from casadical.core.telling.figure import Figure
from casadical.core.telling.notebook import Shown, html
from casadical.core.telling.terminal import plain_text


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
