"""What all commands share on a terminal: exit codes, lines and JSON, and progress where a person watches."""

import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.text import Text

from casadical.core.basics import MAX_FAULTS_SHOWN, FaultsError, Show, shown, visible
from casadical.core.files import json_text, write_together
from casadical.core.telling.blocks import Block, Page, Table, next_step
from casadical.core.telling.result import terminal

# Rows that are named of a fault, and the width of a table that no terminal shows.
NAMED, WIDE = 6, 120
BAD_INPUT, NO_CONVERGENCE, WORSE, NOT_VALID, OUR_BUG = 2, 3, 4, 5, 70


def refusal(error: object) -> None:
    """Print why a command ends, to standard error: as wide as the terminal, several faults of tables as one table."""
    if isinstance(error, FaultsError) and len(error.faults) > 1:
        rows = [
            (f.source, f"{', '.join(map(str, f.rows[:NAMED]))}{' ...' * (len(f.rows) > NAMED)}", f.column, f.value,
             f.allowed or f.wrong, f.remedy)
            for f in error.faults[:MAX_FAULTS_SHOWN]
        ]  # fmt: skip
        columns = ("file", "rows", "column", "value", "allowed", "what to do")
        title = f"casadical: {len(error.faults)} faults of the input; of each the worst value and its row first"
        width = None if sys.stderr.isatty() else WIDE
        Console(stderr=True, width=width, markup=False, emoji=False).print(terminal([Table(title, columns, rows)]))
        left = max(0, MAX_FAULTS_SHOWN - len(error.faults))
        more = len(error.faults) + len(error.others) - len(rows) - len(error.others[:left])
        lines = [line for text in error.others[:left] for line in text.splitlines()]
        lines += [f"and {more} more"] if more else []
    else:
        lines = f"casadical: {error}".splitlines()
    if sys.stderr.isatty():
        width = shutil.get_terminal_size().columns
        lines = [part for line in lines for part in textwrap.wrap(line, width, break_long_words=False) or [""]]
    if lines:
        print(visible("\n".join(lines)), file=sys.stderr)  # noqa: T201


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
    """A console for lines without colours; a terminal breaks them between words, a file has each whole."""
    return _Console(quiet=quiet, soft_wrap=not sys.stdout.isatty(), highlight=False, markup=False, emoji=False)


def with_json(
    texts: Mapping[Path, str | bytes],
    path: Path | None,
    figures: Mapping[str, Any] | Sequence[Mapping[str, Any]],
) -> dict[Path, Any]:
    """Files, and among them the one of `--json`, if there is one; a list of one is written as its only entry."""
    if path is None:
        return dict(texts)
    return {
        **texts,
        path: json_text(figures[0] if isinstance(figures, Sequence) and len(figures) == 1 else figures),
    }


def keep(texts: Mapping[Path, Any], console: Console, about: Mapping[Path, str] | None = None) -> None:
    """Write files, all or none, and print their names, of some with words about them.

    Raises InputError.
    """
    write_together(texts)
    for path in texts:
        print_written(path, console, (about or {}).get(path, ""))


def tell(console: Console, *blocks: Block) -> None:
    """Print words and tables."""
    console.print(terminal(blocks))


def suggest(console: Console, purpose: str, command: str, *arguments: object) -> None:
    """Print the one command to go on with; see `next_step`."""
    tell(console, next_step(purpose, command, *arguments))


def suggest_later(console: Console, robot: Path) -> None:
    """Print what a robot file is for on a later day: to be verified, where its results say what was promised."""
    if (robot.parent / "result.json").exists():
        suggest(console, "when some ten poses were measured again", "verify", robot, "LATER.csv")
    else:
        suggest(console, "when poses were measured", "calibrate", robot, "LATER.csv", "--out", "results")


def print_written(path: Path | None, console: Console, about: str = "") -> None:
    """Print the name of a file that was written, if there is one."""
    if path is not None:
        more = f": {about}" if about else ""
        console.print(f"wrote {shown(path)}{more}", soft_wrap=True, markup=False, emoji=False)


def html(pages: Sequence[Page]) -> str:
    """Pages of results as one HTML file, with the command as it was typed."""
    from casadical.core.telling.page import html_of

    return html_of(pages, ["casadical", *sys.argv[1:]])


# How a step's words begin -> the share of the whole work that is done when it begins, as a usual run takes its time.
Steps = Mapping[str, float]
DIAGNOSIS: Steps = {
    "calibrating": 0.0, "signatures": 0.03, "what changed": 0.2, "cause 1": 0.25, "cause 2": 0.4, "cause 3": 0.5,
    "cause": 0.55, "sets of causes": 0.55,
    "laws in place": 0.6, "where it lies": 0.65, "refit": 0.7, "network": 0.8, "joint error": 0.8,
    "laws beside nothing": 0.72, "laws beside what": 0.8, "poses to measure": 0.85, "what these poses": 0.93,
    "the robot with": 0.96,
}  # fmt: skip
CHECK: Steps = {"comparing": 0.05, "slips": 0.1, "accuracy": 0.9}
PLAN: Steps = {"calibrating": 0.0, "choosing": 0.1, "accuracy": 0.6}
# After so many iterations half of a solve is taken as done: how many it needs is not known beforehand.
ITERATIONS = 8.0
_COUNT = re.compile(r"(\d+) of (\d+)")
_ITERATION = re.compile(r"(?:iteration|step) (\d+)")


@contextmanager
def working(quiet: bool, step: str, name: str = "", steps: Steps | None = None) -> Iterator[Show]:
    """Live progress of one piece of work; silent but on a terminal, and never on standard output.

    step : what is done first; name : of what. The function that it gives takes the next step's
        name; `k of n` in it, and the place of its words among `steps`, say how far the work is.
    """
    console = Console(stderr=True)
    columns = (
        SpinnerColumn(), BarColumn(10), TaskProgressColumn(), TimeElapsedColumn(), _ToGo(),
        TextColumn("{task.description}", markup=False),
    )  # fmt: skip
    head = f"{name}: " if name else ""
    with Progress(*columns, console=console, transient=True, disable=quiet or not console.file.isatty()) as bar:
        task = bar.add_task(head + step, total=None)
        done = 0.0

        def show(text: str) -> None:
            nonlocal done
            done = max(done, share(text, steps or {}))
            bar.update(task, description=head + text, total=1.0 if done else None, completed=done)

        yield show


def share(text: str, steps: Steps) -> float:
    """How much of the work is done when a step of these words begins, from 0 to 1; 0 where nothing says."""
    named = next((k for k, words in enumerate(steps) if text.startswith(words)), None)
    ends = [*steps.values(), 1.0]
    first, last = (0.0, 1.0) if named is None else (ends[named], ends[named + 1])
    if counted := _COUNT.search(text):
        done, count = int(counted[1]), int(counted[2])
        iteration = _ITERATION.search(text)
        # What is counted is either done, as campaigns are, or begun, as solves are.
        begun = int(iteration[1]) / (int(iteration[1]) + ITERATIONS) if iteration else 0.0
        inner = (done - 1 + begun) / count if iteration or named is not None else done / count
        return first + (last - first) * min(inner, 1.0)
    return first if named is not None else 0.0


class _ToGo(TextColumn):
    """The time to go, as far as the share done and the time until now tell it."""

    def __init__(self) -> None:
        super().__init__("")

    def render(self, task: Task) -> Text:
        """Nothing while too little is known."""
        elapsed, done = task.elapsed or 0.0, task.completed if task.total else 0.0
        if not done or elapsed < 1:
            return Text("")
        seconds = round(elapsed * (1 - done) / done)
        return Text(f"about {seconds // 60}:{seconds % 60:02d} to go", style="dim")
