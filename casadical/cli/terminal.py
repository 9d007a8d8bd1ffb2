"""What all commands share on a terminal: the same options in the same words, progress only where someone looks."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from casadical.core.files import json_text, write_whole

BAD_INPUT, NO_CONVERGENCE, OUR_BUG = 2, 3, 70

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Json = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Keep all figures as JSON; of several inputs, of each.")
]
Report = Annotated[
    Path | None,
    typer.Option("--report", metavar="FILE.html", help="Write an HTML report in one file (needs plotly and jinja2)."),
]
Problems = Annotated[list[Path], typer.Argument(metavar="PROBLEM_DIR...", help="One or more problem folders.")]


def as_text(figures: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> str:
    """Figures as JSON; of one that was listed alone, itself."""
    whole = figures[0] if isinstance(figures, Sequence) and len(figures) == 1 else figures
    return json_text(whole)


def plain(quiet: bool) -> Console:
    """Where a command prints lines that are neither wrapped nor coloured."""
    return Console(quiet=quiet, soft_wrap=True, highlight=False, markup=False, emoji=False)


def keep_json(path: Path | None, figures: Mapping[str, Any] | Sequence[Mapping[str, Any]], console: Console) -> None:
    """Write figures where `--json` says, if it does, and say so. Raises InputError."""
    if path is None:
        return
    write_whole(path, as_text(figures))
    console.print(f"wrote {path}", soft_wrap=True)


def as_typed() -> list[str]:
    """The command line, for provenance."""
    return ["casadical", *sys.argv[1:]]


def progress(quiet: bool) -> Progress:
    """Live progress on a terminal's standard error; silent elsewhere."""
    console = Console(stderr=True)
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=quiet or not console.is_terminal,
    )
