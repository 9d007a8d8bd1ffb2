"""Sources of readings, and the journal in which they are stored.

A source is a file that grows, a folder of files, standard input or a simulation; it is read again
as it changes. Any table is read that `casadical new` understands; a line counts once its line end
is written. The journal has every event of a session on disk before anything else is done with it.
"""

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock, Thread
from typing import Any, BinaryIO

import numpy as np

from casadical.core.basics import Array, InputError, shown
from casadical.core.files import appending
from casadical.core.reading import MAX_TEXT_BYTES, json_of, read_bytes
from casadical.identification.pose_selection.candidates import expected
from casadical.measurements.raw_table import read_table
from casadical.project.new.new import SYNTHETIC_NOISE_M, as_built, reading_cells
from casadical.robot.robot import Robot

# Name of the journal of a problem folder: one event in JSON on each line.
JOURNAL_FILE = "measured.jsonl"
# Time between two queries of a source for new readings [s].
POLL_INTERVAL_S = 0.2


# A function that writes an event to the journal: its kind, and its values by name.
Add = Callable[..., dict[str, Any]]


@dataclass
class Reading:
    """One row of the table.

    number : number of the reading, from 1
    cells : cells as they came
    source : file and line, in words
    at : time of arrival, ISO 8601
    struck : reason why it was struck out, empty where it counts
    """

    number: int
    cells: tuple[str, ...]
    source: str
    at: str
    struck: str = ""


class Course:
    """The state that a journal's events lead to: headings, readings, and those struck out."""

    def __init__(self) -> None:
        self.header: tuple[str, ...] = ()
        self.units: tuple[str, ...] = ()
        self.data = "real"
        self.readings: list[Reading] = []

    def follow(self, event: dict[str, Any]) -> None:
        """Apply one event of the journal (begin, read, strike or restore) to the state.

        Events of other kinds are ignored. Raises KeyError, TypeError or ValueError for an invalid
        one.
        """
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
        """Return the reading of this number, from 1. Raises InputError where there is none."""
        if not (isinstance(number, int) and 1 <= number <= len(self.readings)):
            raise InputError(f"there is no reading {number}; the last is {len(self.readings)}")
        return self.readings[number - 1]


@contextmanager
def journal(folder: Path) -> Iterator[tuple[Course, Add]]:
    """Open the journal of a problem folder: yield its state and the function that adds events.

    A last line without its end is cut off. Raises InputError for an invalid line.
    """
    path, course, end = folder / JOURNAL_FILE, Course(), 0
    for k, line in enumerate(read_bytes(path).split(b"\n")[:-1] if path.exists() else (), 1):
        source = f"{shown(path)}: line {k}"
        try:
            course.follow(json_of(line, source))
        except (KeyError, TypeError, ValueError) as error:
            why = error if str(error).startswith(source) else f"{source}: {error}"
            raise InputError(f"{why}; the journal of what was measured: correct the line, nothing is lost") from None
        end += len(line) + 1
    with appending(path, end) as write:

        def add(do: str, **event: Any) -> dict[str, Any]:
            """Write an event to disk, apply it to the state, and return it with its time."""
            whole = {"do": do, "at": datetime.now(UTC).isoformat(timespec="seconds"), **event}
            write(json.dumps(whole) + "\n")
            course.follow(whole)
            return whole

        yield course, add


@dataclass(frozen=True)
class Row:
    """A row of a table as it came.

    header, units : headings, and the cells of a row of units (empty without one)
    cells : texts
    source : file and line, in words
    """

    header: tuple[str, ...]
    units: tuple[str, ...]
    cells: tuple[str, ...]
    source: str


# Answer of a source that is asked for news: rows of the table, new ones and often earlier ones too,
# and sentences on what cannot be read.
News = tuple[list[Row], list[str]]


class FileSource:
    """A file that another program writes, whole or line by line."""

    def __init__(self, path: Path) -> None:
        self.path, self._seen, self._size = path, (0, 0), 0

    @property
    def words(self) -> str:
        """Return the name of the file as it is shown."""
        return shown(self.path)

    def news(self) -> News:
        """Return all rows of the file, earlier ones included, if it has changed; else none."""
        try:
            about = self.path.stat()
        except OSError:
            gone = self._size > 0
            self._size = 0
            return [], [f"{self.words}: is gone; the readings stay, and it is waited for"] if gone else []
        if (about.st_mtime_ns, about.st_size) == self._seen:
            return [], []
        shorter = about.st_size < self._size
        try:
            data = read_bytes(self.path)  # a file that cannot be read now is tried again
            self._seen, self._size = (about.st_mtime_ns, about.st_size), about.st_size
            rows, said = rows_of(self.path, data)
        except InputError as error:
            return [], [str(error)]
        return rows, said + [f"{self.words}: became shorter; the readings of before stay"] * shorter


class FolderSource:
    """A folder into which another program puts files, each with one row or more."""

    def __init__(self, path: Path) -> None:
        self.path, self._files = path, dict[Path, FileSource]()
        self.words = shown(path)

    def news(self) -> News:
        """Return all rows of those files that are new or have changed, in the order of names."""
        rows: list[Row] = []
        said: list[str] = []
        tables = {".csv", ".txt", ".tsv", ".dat", ".asc", ".xlsx", ".parquet"}
        try:
            paths = sorted(p for p in self.path.iterdir() if p.suffix.lower() in tables and p.is_file())
        except OSError as error:
            return [], [f"{self.words}: {error.strerror}; the readings stay, and it is waited for"]
        for path in paths:
            new, odd = self._files.setdefault(path, FileSource(path)).news()
            rows += new
            said += odd
        return rows, said


class StreamSource:
    """Lines of a pipe, which a thread reads.

    stream : the pipe
    ended : whether the writer has closed it
    """

    def __init__(self, stream: BinaryIO, name: str = "standard input") -> None:
        self.words, self.ended = name, False
        self._stream, self._data, self._read, self._lock = stream, b"", -1, Lock()
        self._said: list[str] = []
        Thread(target=self._follow, daemon=True).start()

    def _follow(self) -> None:
        """Read the pipe until it is closed, or more has come than is allowed."""
        try:
            while some := os.read(self._stream.fileno(), 65536):
                with self._lock:
                    self._data += some
                    if len(self._data) > MAX_TEXT_BYTES:
                        raise InputError(f"more than {MAX_TEXT_BYTES} bytes came; give a file, or start again")
        except (OSError, InputError) as error:
            self._said.append(f"{self.words}: is read no further: {error}")
        finally:
            with self._lock:
                self._data += b"" if self._data.endswith(b"\n") or not self._data else b"\n"
                self.ended = True

    def news(self) -> News:
        """Return all rows that have come so far, if there is a new one; else none."""
        with self._lock:
            data, said, self._said = self._data, self._said, []
        if len(data) == self._read or not data:
            return [], said
        self._read = len(data)
        try:
            rows, odd = rows_of(Path(self.words), data)
        except InputError as error:
            return [], [str(error), *said]
        return rows, [*odd, *said]


class SimulatedSource:
    """A simulated instrument, which measures a robot that departs a little from nominal.

    pose : returns the joint variables of the next reading, shape (joints,) [rad or m]
    count : number of readings, after which it ends
    """

    words = "simulated"

    def __init__(self, robot: Robot, pose: Callable[[], Array], count: int, seed: int = 0) -> None:
        self._pose, self._remaining, self._rng = pose, count, np.random.default_rng(seed)
        self._robot = as_built(robot, self._rng)

    @property
    def ended(self) -> bool:
        """Return whether all readings were given."""
        return self._remaining == 0

    def news(self) -> News:
        """Return the next simulated reading as a row; none after the last."""
        if self.ended:
            return [], []
        self._remaining -= 1
        q = self._pose()
        place = expected(self._robot, q[None], {}, self.words).position
        assert place is not None
        cells = reading_cells(self._robot, q, place[0] + self._rng.normal(0.0, SYNTHETIC_NOISE_M, 3))
        header = (*self._robot.reading_units, "x_mm", "y_mm", "z_mm")
        return [Row(header, (), tuple(cells), self.words)], []


# Any source of readings.
Source = FileSource | FolderSource | StreamSource | SimulatedSource


def source_of(path: str, stdin: BinaryIO) -> Source:
    """Return the source of readings at a path: a file, a folder, or, for "-", standard input.

    stdin : stream of standard input
    Raises InputError where the folder of the path is not there.
    """
    if path == "-":
        return StreamSource(stdin)
    place = Path(path)
    if place.is_dir():
        return FolderSource(place)
    if not place.parent.is_dir():
        raise InputError(f"{shown(place)}: its folder is not there; name a file, which need not be there yet, or -")
    return FileSource(place)


def rows_of(path: Path, data: bytes) -> News:
    """Return the rows of a table as read so far, without a last line that has no line end.

    path : name of the table, for messages; data : its content. Raises InputError.
    """
    text = not data.startswith((b"PK\x03\x04", b"PAR1", b"\x1f\x8b"))
    whole = data[: data.rfind(b"\n") + 1] if text else data
    said: list[str] = []
    if whole.count(b"\n") < 2 and text:  # headings alone
        return [], []
    try:
        raw = read_table(path, whole)
    except InputError:
        if not text:
            raise
        # Two writers of one file leave unreadable lines, which count as blank.
        lines = whole.splitlines(keepends=True)
        good = 2
        read_table(path, b"".join(lines[:good]))
        readable = lines[:good]
        for number, line in enumerate(lines[good:], good + 1):
            try:
                read_table(path, b"".join([*lines[:good], line]))
                readable.append(line)
            except InputError as error:
                readable.append(b"\n")
                why = str(error).removeprefix(f"{path}: ")
                said.append(f"{shown(path)}, line {number}: is ignored ({why}); correct it there, or type the reading")
        raw = read_table(path, b"".join(readable))
    rows = []
    for line, cells in zip(raw.line, raw.cells, strict=True):
        wide = tuple(cells) + ("",) * (len(raw.header) - len(cells))
        rows.append(Row(raw.header, raw.form.units, wide, f"{raw.path.name}, line {line}"))
    return rows, said
