"""Terminal output of all commands: exit codes, lines, tables, JSON files and progress."""

import gc
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich import progress
from rich.console import Console
from rich.text import Text

from casadical.core.basics import MAX_FAULTS_SHOWN, FaultsError, Show, shown, visible
from casadical.core.files import json_text, write_together
from casadical.core.reporting.blocks import Block, Page, Table, next_step
from casadical.core.reporting.result import shortened, terminal

# Width of tables where the output is no terminal [characters].
TABLE_WIDTH_WITHOUT_TERMINAL = 120
# Exit code for unusable input, and for a check that found errors.
EXIT_BAD_INPUT = 2
# Exit code where the solver found no optimum.
EXIT_NO_CONVERGENCE = 3
# Exit code where errors of held-out poses have grown in the calibration by more than chance.
EXIT_WORSE = 4
# Exit code where a robot is no longer valid or has changed, where touches do not decide that, or
# where campaigns differ in a way that is unexplained.
EXIT_NOT_VALID = 5
# Exit code for a bug in casadical.
EXIT_BUG = 70


def refusal(error: object) -> None:
    """Print to standard error why a command ends, as wide as the terminal.

    Several faults of tables are printed as one table.

    error : an exception or a sentence
    """
    # Number of rows of a table that the message about a fault names.
    max_rows_named = 6
    numbering = "rows numbered as in a spreadsheet: line 1 is row 1"
    if isinstance(error, FaultsError) and len(error.faults) > 1:
        rows = []
        for f in error.faults[:MAX_FAULTS_SHOWN]:
            numbers = ", ".join(map(str, f.rows[:max_rows_named]))
            numbers += " ..." * (len(f.rows) > max_rows_named)
            fault = f"allowed: {f.allowed}" if f.allowed else f.wrong
            rows.append((f.source, numbers, f.column, f.value, fault, f.remedy))
        columns = ("file", "rows", "column", "value", "fault", "what to do")
        title = f"casadical: {len(error.faults)} faults of the input; of each the worst value first; {numbering}"
        width = None if sys.stderr.isatty() else TABLE_WIDTH_WITHOUT_TERMINAL
        Console(stderr=True, width=width, markup=False, emoji=False).print(terminal([Table(title, columns, rows)]))
        room = max(0, MAX_FAULTS_SHOWN - len(error.faults))
        more = len(error.faults) + len(error.others) - len(rows) - len(error.others[:room])
        lines = [line for text in error.others[:room] for line in text.splitlines()]
        lines += [f"and {more} more"] if more else []
    else:
        lines = f"casadical: {error}".splitlines()
        lines += [f"({numbering})"] if re.search(r": row \d", str(error)) else []
    if sys.stderr.isatty():
        width = shutil.get_terminal_size().columns
        lines = [part for line in lines for part in textwrap.wrap(line, width, break_long_words=False) or [""]]
    if lines:
        print(visible("\n".join(lines)), file=sys.stderr)  # noqa: T201


class _Console(Console):
    """A console that becomes silent when its pipe is closed, as after `| head`.

    The command goes on, because its files are still to be written.
    """

    def on_broken_pipe(self) -> None:
        """Discard all further output."""
        self.quiet = True
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())


def wrapped(quiet: bool, width: int | None = None) -> Console:
    """Return a console for tables and sentences, as wide as the terminal, without markup."""
    return _Console(quiet=quiet, width=width, markup=False, emoji=False)


def plain(quiet: bool) -> Console:
    """Return a console for lines without colours.

    A terminal breaks them between words; a file has each as one line.
    """
    return _Console(quiet=quiet, soft_wrap=not sys.stdout.isatty(), highlight=False, markup=False, emoji=False)


def with_json(
    texts: Mapping[Path, str | bytes],
    path: Path | None,
    figures: Mapping[str, Any] | Sequence[Mapping[str, Any]],
) -> dict[Path, Any]:
    """Return path -> content of files, with the file of `--json` added if it was asked for.

    texts : the other files; path : of the JSON file, None without one
    figures : its content; a list of one entry is written as this entry
    """
    if path is None:
        return dict(texts)
    return {
        **texts,
        path: json_text(figures[0] if isinstance(figures, Sequence) and len(figures) == 1 else figures),
    }


def save(texts: Mapping[Path, Any], console: Console, about: Mapping[Path, str] | None = None) -> None:
    """Write files, all or none, and print their names.

    texts : path -> content; about : path -> words that are printed after its name
    Raises InputError where one cannot be written.
    """
    write_together(texts)
    for path in texts:
        print_written(path, console, (about or {}).get(path, ""))


def tell(console: Console, *blocks: Block) -> None:
    """Print sentences and tables to a console."""
    console.print(terminal(blocks))


def print_result(console: Console, blocks: Sequence[Block], details: bool) -> None:
    """Print a result: all blocks with --details, else those that fit and the last command."""
    n = len(blocks) - bool(getattr(blocks[-1], "code", ""))
    shown = [*blocks] if details else [*shortened(blocks[:n]), *blocks[n:]]
    tell(console, *shown)
    if len(shown) < len(blocks):
        console.print("all figures and sentences: --details", style="dim")


def suggest(console: Console, purpose: str, command: str, *arguments: object) -> None:
    """Print the command to run next; purpose : what it is for (see `next_step`)."""
    tell(console, next_step(purpose, command, *arguments))


def suggest_later(console: Console, robot: Path) -> None:
    """Print the command for a robot file and poses that are measured on a later day.

    It is `verify` if result.json is next to the file, else `calibrate`.
    """
    if (robot.parent / "result.json").exists():
        suggest(console, "when some ten poses were measured again", "verify", robot, "LATER.csv")
    else:
        suggest(console, "when poses were measured", "calibrate", robot, "LATER.csv", "--out", "results")


def print_written(path: Path | None, console: Console, about: str = "") -> None:
    """Print the name of a file that was written, if there is one, and words about it."""
    if path is not None:
        more = f": {about}" if about else ""
        console.print(f"wrote {shown(path)}{more}", soft_wrap=True, markup=False, emoji=False)


def html(pages: Sequence[Page]) -> str:
    """Return the text of one HTML file with pages of results and the command as it was typed."""
    from casadical.core.reporting.page import html_of

    return html_of(pages, ["casadical", *sys.argv[1:]])


# Beginning of a step's words -> share of the work (0 to 1) that is done when the step begins, from
# typical run times.
Steps = Mapping[str, float]
# Beginning of the words of each step of a diagnosis -> share of the work, 0 to 1, when it begins.
DIAGNOSIS: Steps = {
    "calibrating": 0.0,
    "signatures": 0.03,
    "what changed": 0.2,
    "cause 1": 0.25,
    "cause 2": 0.4,
    "cause 3": 0.5,
    "cause": 0.55,
    "sets of causes": 0.55,
    "laws in place": 0.6,
    "where it lies": 0.65,
    "refit": 0.7,
    "network": 0.8,
    "joint error": 0.8,
    "laws alone": 0.72,
    "laws given what": 0.8,
    "poses to measure": 0.85,
    "what these poses": 0.93,
    "the robot with": 0.96,
}
# The same for the steps of a check of a table (beginning of words -> share of the work, 0 to 1).
CHECK: Steps = {"comparing": 0.05, "slips": 0.1, "accuracy": 0.9}
# The same for the steps of a plan of poses (beginning of words -> share of the work, 0 to 1).
PLAN: Steps = {"calibrating": 0.0, "choosing": 0.1, "accuracy": 0.6}


@contextmanager
def importing() -> Iterator[None]:
    """Run a block of imports without garbage collection; its objects then stay exempt from it."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


@contextmanager
def working(quiet: bool, step: str, name: str = "", steps: Steps | None = None) -> Iterator[Show]:
    """Yield a function that shows the progress of one piece of work, on a terminal only.

    Nothing is printed to standard output. The function takes the words of the next step; `k of n`
    in them, and the place of the words among `steps`, show how far the work is.

    step : words of the first step
    name : of the thing that is worked on
    steps : share of the work at which each step begins
    """
    console = Console(stderr=True)
    columns = [progress.SpinnerColumn(), progress.BarColumn(10), progress.TaskProgressColumn()]
    columns += [progress.TimeElapsedColumn(), _ToGo(), progress.TextColumn("{task.description}", markup=False)]
    head = f"{name}: " if name else ""
    silent = quiet or not console.file.isatty()
    with progress.Progress(*columns, console=console, transient=True, disable=silent) as bar:
        task = bar.add_task(head + step, total=None)
        done = 0.0

        def show(text: str) -> None:
            """Show the words of the next step, and how far the work is."""
            nonlocal done
            done = max(done, share(text, steps or {}))
            bar.update(task, description=head + text, total=1.0 if done else None, completed=done)

        yield show


def share(text: str, steps: Steps) -> float:
    """Return the share of the work that is done when a step begins, 0 to 1; 0 if unknown.

    text : words of the step; steps : beginning of such words -> share at which the step begins
    """
    named = next((k for k, words in enumerate(steps) if text.startswith(words)), None)
    ends = [*steps.values(), 1.0]
    first, last = (0.0, 1.0) if named is None else (ends[named], ends[named + 1])
    if counted := re.search(r"(\d+) of (\d+)", text):
        done, count = int(counted[1]), int(counted[2])
        iteration = re.search(r"(?:iteration|step) (\d+)", text)
        # A counted item is complete (a campaign), or has just begun (a solve with iterations).
        # A solve counts as half done after 8 iterations: their number is unknown beforehand.
        begun = int(iteration[1]) / (int(iteration[1]) + 8.0) if iteration else 0.0
        inner = (done - 1 + begun) / count if iteration or named is not None else done / count
        return first + (last - first) * min(inner, 1.0)
    return first if named is not None else 0.0


class _ToGo(progress.TextColumn):
    """The remaining time, extrapolated from the share done and the elapsed time."""

    def __init__(self) -> None:
        super().__init__("")

    def render(self, task: progress.Task) -> Text:
        """Return the remaining time; empty as long as it cannot be estimated."""
        elapsed, done = task.elapsed or 0.0, task.completed if task.total else 0.0
        if not done or elapsed < 1:
            return Text("")
        seconds = round(elapsed * (1 - done) / done)
        return Text(f"about {seconds // 60}:{seconds % 60:02d} to go", style="dim")
