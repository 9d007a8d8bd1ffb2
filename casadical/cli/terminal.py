"""What all commands share on a terminal: exit codes, lines and JSON."""

import os
import shutil
import sys
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from casadical.core.errors import FaultsError, InputError, shown
from casadical.core.files import json_text, write_together

if TYPE_CHECKING:
    from casadical.core.telling.blocks import Page

# Rows that are named of a fault, and the width of a table that no terminal shows.
NAMED, WIDE = 6, 120
BAD_INPUT, NO_CONVERGENCE, WORSE, NOT_VALID, OUR_BUG = 2, 3, 4, 5, 70


def refusal(error: object) -> None:
    """Print why a command ends, to standard error: as wide as the terminal, several faults of tables as one table."""
    if isinstance(error, FaultsError) and len(error.faults) > 1:
        from casadical.core.telling.blocks import Table
        from casadical.core.telling.terminal import terminal

        rows = [
            (f.source, f"{', '.join(map(str, f.rows[:NAMED]))}{' ...' * (len(f.rows) > NAMED)}", f.column, f.value,
             f.allowed or f.wrong, f.remedy)
            for f in error.faults
        ]  # fmt: skip
        columns = ("file", "rows", "column", "value", "allowed", "what to do")
        title = f"casadical: {len(error.faults)} faults of the input; of each the worst value and its row first"
        width = None if sys.stderr.isatty() else WIDE
        Console(stderr=True, width=width, markup=False, emoji=False).print(terminal([Table(title, columns, rows)]))
        return
    lines = f"casadical: {error}".splitlines()
    if sys.stderr.isatty():
        width = shutil.get_terminal_size().columns
        lines = [part for line in lines for part in textwrap.wrap(line, width, break_long_words=False) or [""]]
    print("\n".join(lines), file=sys.stderr)  # noqa: T201


def as_text(figures: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> str:
    """Figures as JSON; a list of one is written as its only entry."""
    whole = figures[0] if isinstance(figures, Sequence) and len(figures) == 1 else figures
    return json_text(whole)


class _Console(Console):
    """One that goes on silently where nobody reads any more, as after `| head`: files are still to be written."""

    def on_broken_pipe(self) -> None:
        """What was to be printed goes nowhere from here on."""
        self.quiet = True
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())


def wrapped(quiet: bool, width: int | None = None) -> Console:
    """A console for tables and sentences, as wide as the terminal; brackets in names are no markup."""
    return _Console(quiet=quiet, width=width, markup=False, emoji=False)


def plain(quiet: bool) -> Console:
    """A console for lines that are neither wrapped nor coloured."""
    return _Console(quiet=quiet, soft_wrap=True, highlight=False, markup=False, emoji=False)


def keep_json(path: Path | None, figures: Mapping[str, Any] | Sequence[Mapping[str, Any]], console: Console) -> None:
    """Write figures to the file of `--json`, if there is one, and print its name. Raises InputError."""
    if path is not None:
        keep({path: as_text(figures)}, console)


def with_json(
    texts: Mapping[Path, str | bytes], path: Path | None, figures: Mapping[str, Any] | Sequence[Mapping[str, Any]]
) -> dict[Path, Any]:
    """Files, and among them the one of `--json`, if there is one."""
    return {**texts, **({} if path is None else {path: as_text(figures)})}


def keep(texts: Mapping[Path, Any], console: Console, about: Mapping[Path, str] | None = None) -> None:
    """Write files, all or none, and print their names, of some with words about them. Raises InputError."""
    write_together(texts)
    for path in texts:
        print_written(path, console, (about or {}).get(path, ""))


def print_written(path: Path | None, console: Console, about: str = "") -> None:
    """Print the name of a file that was written, if there is one."""
    if path is not None:
        more = f": {about}" if about else ""
        console.print(f"wrote {shown(path)}{more}", soft_wrap=True, markup=False, emoji=False)


def refuse_taken(out: Path, overwrite: bool) -> None:
    if out.exists() and not overwrite:
        raise InputError(f"{out} is there already; give another file, or --overwrite")


def as_typed() -> list[str]:
    return ["casadical", *sys.argv[1:]]


def html(pages: "Sequence[Page]") -> str:
    """Pages of results as one HTML file, with the command as it was typed."""
    from casadical.core.telling.page import html_of

    return html_of(pages, as_typed())
