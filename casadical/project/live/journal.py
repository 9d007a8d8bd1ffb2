"""What happened while measuring, in lines that are on disk before anything else is done with them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

from casadical.core.basics import InputError, shown
from casadical.core.files import appending
from casadical.core.reading import json_of, read_bytes

NAME = "measured.jsonl"
# What a line tells, and what it has besides.
EVENTS = {"begin": ("header", "units", "data"), "read": ("cells", "from"), "strike": ("id", "why"), "restore": ("id",)}


class Add(Protocol):
    """Writes an event to the journal."""

    def __call__(self, do: str, **event: Any) -> dict[str, Any]: ...


@dataclass
class Reading:
    """One row of the table.

    number : from 1; cells : as they came; source : where from, in words; at : time of arrival
    struck : the reason why it was struck out, empty where it counts
    """

    number: int
    cells: tuple[str, ...]
    source: str
    at: str
    struck: str = ""


class Course:
    """What the journal of a folder tells: the headings, the readings in order, which of them are struck out."""

    def __init__(self) -> None:
        self.header: tuple[str, ...] = ()
        self.units: tuple[str, ...] = ()
        self.data = "real"
        self.readings: list[Reading] = []

    def follow(self, event: dict[str, Any]) -> None:
        """Take one event. Raises KeyError, TypeError or ValueError for one that is none."""
        do = event["do"]
        if do == "begin":
            self.header, self.units, self.data = tuple(event["header"]), tuple(event["units"]), str(event["data"])
        elif do == "read":
            number, cells = len(self.readings) + 1, tuple(map(str, event["cells"]))
            self.readings.append(Reading(number, cells, str(event["from"]), str(event["at"])))
        elif do == "strike":
            self.reading(event["id"]).struck = str(event["why"])
        elif do == "restore":
            self.reading(event["id"]).struck = ""

    def reading(self, number: object) -> Reading:
        """The reading of this number. Raises ValueError."""
        if not (isinstance(number, int) and 1 <= number <= len(self.readings)):
            raise ValueError(f"no reading {number}")
        return self.readings[number - 1]


@contextmanager
def journal(folder: Path) -> Iterator[tuple[Course, Add]]:
    """What happened in a problem folder until now, and what adds to it; a line that was half written is cut off.

    Raises InputError: another process measures into this folder, or a line that is no event.
    """
    path, course, end = folder / NAME, Course(), 0
    for k, line in enumerate(read_bytes(path).split(b"\n")[:-1] if path.exists() else (), 1):
        source = f"{shown(path)}: line {k}"
        try:
            course.follow(json_of(line, source))
        except (KeyError, TypeError, ValueError) as error:
            why = error if isinstance(error, InputError) else f"{source}: {error}"
            raise InputError(f"{why}; the journal of what was measured: correct the line, nothing is lost") from None
        end += len(line) + 1
    with appending(path, end) as write:

        def add(do: str, **event: Any) -> dict[str, Any]:
            whole = {"do": do, "at": datetime.now(UTC).isoformat(timespec="seconds"), **event}
            assert set(event) == set(EVENTS[do])
            write(json.dumps(whole) + "\n")
            course.follow(whole)
            return whole

        yield course, add
