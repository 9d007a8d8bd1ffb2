"""What all commands share on a terminal: the same options in the same words, progress only where someone looks."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]


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
