"""Progress of one piece of work where a person watches: its step, its share, and the time to go."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, Task, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

from casadical.core.progress import Show

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

    step : what is done first; name : of what. The function that it gives takes the next step's name; `k of n` in it,
    and the place of its words among `steps`, say how far the work is.
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
        # What is counted is either done, as campaigns are, or begun, as solves and refits are.
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
