"""A live calibration: the readings of a problem folder, their judgement, and the next pose.

The journal is the only state on disk; `measured.csv` and the [[measurements]] of problem.toml are
rewritten from it after each reading, so that the folder can be calibrated at any time, also after
the process was killed.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from threading import RLock
from typing import Any

import numpy as np
import tomlkit

from casadical.core.basics import Array, ConvergenceError, InputError, shown
from casadical.core.files import csv_text, write_whole
from casadical.core.reading import read_text
from casadical.core.reporting.result import plain_text
from casadical.identification.identification import lacks_declared_compliance, prepare, with_all_joints_compliant
from casadical.identification.plausibility import check_against
from casadical.identification.pose_selection.candidates import draw, expected
from casadical.identification.pose_selection.workspace import Workspace, read_workspace
from casadical.identification.sessions import with_sessions
from casadical.measurements.columns import Source as ColumnSource
from casadical.measurements.derived_columns import clock_faults
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.measurements.raw_table import read_table
from casadical.project.calibration import calibrate
from casadical.project.check.check import precheck
from casadical.project.check.slip_list import slips_of_reading
from casadical.project.live.estimate import MAX_REFITTED_READINGS, Estimate, robust_estimate
from casadical.project.live.sources import Add, Course, Reading, Row, Source
from casadical.project.live.view import MIN_READINGS_FOR_QUANTILE, with_words
from casadical.project.planning import poses_ahead
from casadical.project.problem import read_campaign, read_problem_robot
from casadical.project.problem_file import DataTable, problem_file
from casadical.project.recognition import understood
from casadical.project.robot_columns import refuse_nameless, with_target_positions

# Name of the table of all readings in the problem folder; it is rewritten from the journal.
TABLE_FILE = "measured.csv"
# Columns of a reading that hold names, not numbers.
NAME_COLUMNS = ("point", "plane", "sphere", "anchor", "dial", "tool", "session")


class LiveSession:
    """Readings of one problem folder, as they come. Methods may be called from several threads.

    folder : problem folder, whose tables are replaced
    course, add : state of its journal, and the function that adds events to it (see `journal`)
    target : wanted accuracy [m], None without one
    room : file of a workspace
    data : "real" or "synthetic", as problem.toml states it
    move : returns the line of a program that moves to controller's readings [deg or mm]; None: no
        program

    Raises InputError: the folder has other measurements that are not synthetic.
    """

    def __init__(
        self,
        folder: Path,
        course: Course,
        add: Add,
        *,
        target: float | None = None,
        room: Path | None = None,
        data: str = "real",
        move: Callable[[Sequence[float]], str] | None = None,
    ) -> None:
        self.folder, self.course, self._add = folder, course, add
        self.target, self._data, self._move = target, data, move
        # Measured tables of an earlier campaign are refused.
        own = problem_file(folder)
        others = [t.file for t in own.measurements if t.file != TABLE_FILE]
        if others and own.data != "synthetic":
            raise InputError(
                f"{shown(folder / 'problem.toml')}: names measured poses ({', '.join(others)}), "
                "and measure would begin again in their place: give a folder of its own, as "
                'casadical new DIR makes it, or, if they are made up, write data = "synthetic"'
            )
        self.robot = read_problem_robot(folder)
        self.room: Workspace | None = read_workspace(room, self.robot) if room else None
        self.lock = RLock()
        self.estimate: Estimate | None = None
        self.plan: Array | None = None  # planned joint variables, shape (n, joints) [rad or m]
        self._of_plan = ""
        self.said: list[str] = []
        self.checked: tuple[int, list[str]] = (0, [])  # number of readings, errors of `check`
        self.m: Measurements | None = None
        self.unread = ""  # why the table cannot be read
        # The expected error is stated for 150 readings drawn over the joints' ranges.
        self._task = draw(self.robot, 150, Workspace(), np.random.default_rng(1))
        self._unreadable: dict[int, str] = {}  # reason by number of the reading
        self._doubtful: dict[int, bool] = {}
        self._words: dict[int, str] = {}  # why a reading is doubtful, by number
        self._off: dict[int, float] = {}  # length of the residual [m] by number
        self._wish: Array | None = None  # joint variables of the pose to repeat
        self._seen = {r.cells for r in course.readings}
        if course.readings:
            self._judge(*(r.number for r in course.readings))

    # Input

    def take(self, row: Row, *, judge: bool = True) -> int | None:
        """Store a row of a table and return its number; None where it is stored already.

        judge : whether the reading is judged at once
        Raises InputError: its headings differ, not only in order, from those of the rows before.
        """
        with self.lock:
            cells = row.cells
            if not self.course.header:
                self._add("begin", header=row.header, units=row.units, data=self._data)
            elif row.header != self.course.header:
                if sorted(row.header) != sorted(self.course.header):
                    raise InputError(
                        f"{row.source}: has the columns {', '.join(row.header)}; the readings "
                        f"before have {', '.join(self.course.header)}: give a folder of its own to "
                        "each"
                    )
                at = dict(zip(row.header, row.cells, strict=True))
                cells = tuple(at[name] for name in self.course.header)
            if cells in self._seen:
                return None
            self._seen.add(cells)
            self._wish = None
            self._add("read", cells=cells, **{"from": row.source})
            number = len(self.course.readings)
            self._doubtful[number] = True  # until it is found plausible
            if judge:
                self._judge(number)
            return number

    def feed(self, source: Source) -> tuple[list[int], list[str]]:
        """Store and judge new rows of a source; return their numbers, and sentences on faults."""
        rows, said = source.news()
        numbers, before = list[int](), set[tuple[str, ...]]()
        for row in rows:
            if row.cells in before:
                said.append(f"{row.source}: is a copy of an earlier row, and counts once")
            before.add(row.cells)
            try:
                number = None if row.cells in self._seen else self.take(row, judge=False)
            except InputError as error:
                said.append(str(error))
                continue
            numbers += [number] if number else []
        if numbers:
            self._judge(*numbers)
        with self.lock:
            said = [text for text in dict.fromkeys(said) if text not in self.said]
            self.said += said
        return numbers, said

    def type_in(self, values: Mapping[str, str]) -> int | None:
        """Store a reading that was typed and return its number; None where it is stored already.

        values : cells by name, as of `fields`
        Raises InputError for a missing or invalid value.
        """
        names, row = self.fields, dict[str, str]()
        for name in names:
            with suppress(ValueError):
                text = values.get(name, "").strip()
                number = text if name in NAME_COLUMNS else f"{float(text):.12g}"
                row |= {name: number} if number and number not in ("inf", "-inf", "nan") else {}
        if lost := [name for name in names if name not in row]:
            raise InputError(f"{', '.join(lost)}: give a value for each of {', '.join(names)}")
        header = tuple(names)
        with self.lock:
            if self.course.header and sorted(header) != sorted(self.course.header):
                header, row = self.course.header, self._as_file(row)
        return self.take(Row(header, (), tuple(row[name] for name in header), "typed"))

    @property
    def fields(self) -> list[str]:
        """Return the names of the columns that are typed for a reading, joints first."""
        kind = find_kind(self.m.kind if self.m is not None else "position")
        further: tuple[str, ...] = ()
        if self.course.header and self.m is not None:
            columns = {
                re.sub("_(m|rad)$", lambda unit: {"_m": "_mm", "_rad": "_deg"}[unit[0]], c) for c in self._sources
            }
            numbers = ("to_x_mm", "to_y_mm", "to_z_mm", "along_x", "along_y", "along_z", "pose", "other_pose")
            further = tuple(c for c in (*numbers, *NAME_COLUMNS) if c in columns and c not in kind.fill)
        return [*self.robot.reading_units, *kind.fill, *further]

    def strike(self, number: int, why: str) -> None:
        """Strike a reading out, so that it no longer counts; it stays in the table.

        why : reason, which is stored with it. Raises InputError without a reason or reading.
        """
        with self.lock:
            self.course.reading(number)
            if not why.strip():
                raise InputError("give the reason why the reading is struck out; it is stored with it")
            self._add("strike", id=number, why=" ".join(why.split()))
            self._judge()

    def restore(self, number: int) -> None:
        """Let a reading that was struck out count again. Raises InputError for no such reading."""
        with self.lock:
            self.course.reading(number)
            self._add("restore", id=number)
            self._judge()

    def repeat(self, number: int) -> None:
        """Make the pose of a reading the next one to measure.

        Raises InputError where there is no such reading, or its joints cannot be read.
        """
        with self.lock:
            self.course.reading(number)
            if number not in (read := self._read()):
                raise InputError(f"reading {number}: its joints cannot be read; type the pose")
            self._wish = read[number]

    def _read(self) -> dict[int, Array]:
        """Return number of each readable reading -> its joint variables, (joints,) [rad or m]."""
        return {} if self.m is None else dict(zip(map(self._number, self.m.row), self.m.q, strict=True))

    def _number(self, row: int) -> int:
        """Return the number of the reading in a row (line, from 1) of `measured.csv`."""
        return int(row) - 1 - bool(self.course.units)

    @property
    def _sources(self) -> dict[str, ColumnSource]:
        """Return casadical's column name, else the heading -> its source in the table."""
        tables = problem_file(self.folder).measurements
        data = next((t for t in tables if t.file == TABLE_FILE), DataTable(file=TABLE_FILE))
        raw = read_table(self.folder / TABLE_FILE)
        sources = {**understood(raw, self.robot, data.sources, data.kind).sources, **data.sources}
        return {name: ColumnSource(name) for name in raw.header if name not in sources} | sources

    def _as_file(self, values: Mapping[str, str]) -> dict[str, str]:
        """Return heading of `measured.csv` -> cell, for typed values; other cells are empty."""
        sources, row = self._sources, dict.fromkeys(self.course.header, "")
        for name, value in values.items():
            stem, _, unit = name.rpartition("_")
            others = {"deg": {f"{stem}_rad": np.pi / 180}, "mm": {f"{stem}_m": 1e-3}}.get(unit, {})
            for ours, factor in ({name: 1.0} | others).items():
                source = sources.get(ours)
                if source is not None and source.name in row and not (source.add or source.rows):
                    same = name in NAME_COLUMNS or (factor, source.plus, source.times) == (1.0, 0.0, 1.0)
                    row[source.name] = value if same else f"{(float(value) * factor - source.plus) / source.times:.12g}"
                    break
            else:
                raise InputError(f"{name}: no column of the file is this alone; append the reading to the file")
        return row

    # Judgement

    def _judge(self, *new: int) -> None:
        """Write and read the table of all readings, and judge each by the others."""
        with self.lock:
            m: Measurements | None = None
            try:
                m = self._table()
            except InputError as error:
                m = self._table_without_unreadable(new, str(error).replace(f"{self.folder}/", ""))
            if m is not None:
                self.unread, self.m = "", m
                self._judge_readings(self.m, new[0] if len(new) == 1 else 0)

    def _table(self) -> Measurements:
        """Return the measurements of all readings that are not excluded; write the table."""
        self._write()
        m = read_campaign(self.folder, self.folder / TABLE_FILE, self.robot, later=True, words=True)
        refuse_nameless(m, self.robot)
        m = with_target_positions(m, self.robot)
        # Raises InputError for a session with too few poses, which then waits for more.
        with_sessions(self.robot, [m])
        return m

    def _table_without_unreadable(self, new: Sequence[int], why: str) -> Measurements | None:
        """Return the measurements without new readings that make the table unreadable, or None.

        Each excluded reading gets its reason in `_unreadable`, and the table file is written again.
        None where the table cannot be read without all new readings either; `unread` then says why.
        Older readings that waited for more may have become readable; they are tried first.
        """
        table: Measurements | None = None
        before, read, whole = self._unreadable, self._read(), ""
        waiting = [r.number for r in self.course.readings if not (r.struck or r.number in (*new, *read))]
        for lost in ((), *((n,) for n in waiting[-10:])) if waiting else ():
            self._unreadable = {n: before.get(n) or why.splitlines()[0] for n in lost}
            try:
                return self._table()
            except InputError as error:
                whole = whole if lost else str(error).replace(f"{self.folder}/", "").splitlines()[0]
        self._unreadable = before
        self._unreadable |= dict.fromkeys(new, "")
        for n in (0, *new):  # all of them excluded, then added one after the other
            self._unreadable.pop(n, None)
            try:
                table = self._table()
            except InputError as error:
                if n == 0:
                    self._unreadable = {k: text for k, text in self._unreadable.items() if k not in new}
                    self.unread = why
                    return None
                own = str(error).replace(f"{self.folder}/", "").splitlines()[0]
                # The same reason as that of the readings before: it waits as they do.
                alike = re.sub("[0-9]+", "", own) == re.sub("[0-9]+", "", whole)
                self._unreadable[n] = whole if alike else own
        self._write()
        return table

    def _judge_readings(self, m: Measurements, new: int) -> None:
        """Judge every reading by the others, and store estimate, doubtful readings and reasons."""
        numbers = [self._number(row) for row in m.row]
        robot = (
            self.robot if not lacks_declared_compliance(self.robot) else with_all_joints_compliant(self.robot, [m])[0]
        )
        robot = prepare(robot, m, tool_turns=True).robot
        was_doubtful = np.array([self._doubtful.get(n, True) for n in numbers])
        lower, upper = self.robot.limits
        outside = ((m.q < lower - 0.002) | (m.q > upper + 0.002)).any(axis=1)
        inside = np.flatnonzero(~outside & (m.weight > 0))
        estimate, out, off = robust_estimate(robot, m[inside], was_doubtful[inside])
        self.estimate = estimate
        was = {n for n, d in self._doubtful.items() if d and n != new}
        self._doubtful = dict.fromkeys(numbers, False)
        self._off = {}
        for i, k in enumerate(inside):
            n = numbers[k]
            self._doubtful[n] = bool(out[i])
            if estimate is not None:
                self._off |= {n: float(np.linalg.norm(off[i]))} if np.isfinite(off[i]).all() else {}
            if not out[i]:
                self._words.pop(n, None)
            elif estimate is not None and (n == new or n not in was or n not in self._words):
                points = [*estimate.points]
                words = slips_of_reading(estimate.robot, m[inside], i, estimate.misses, estimate.limit, points)
                self._words[n] = words
        for k in np.flatnonzero(outside):
            words = "outside of the joints' ranges"
            try:
                check_against(self.robot, m[[int(k)]])
            except InputError as error:
                words = f"{str(error).splitlines()[0]}; another robot's pose, or another unit?"
            self._doubtful[numbers[k]], self._words[numbers[k]] = True, words
        if m.position is not None:
            away = np.linalg.norm(m.position - np.median(m.position, axis=0), axis=1)
            for k in np.flatnonzero(away > 10.0 * self.robot.reach):
                words = (
                    f"{away[k]:.4g} m from the others, and the robot reaches {self.robot.reach:.3g} m: another unit?"
                )
                self._doubtful[numbers[k]], self._words[numbers[k]] = True, words

    def look_ahead(self) -> None:
        """Plan the poses to measure, once; it takes a second or two.

        Raises InputError where the workspace allows no pose.
        """
        if self.plan is None:
            self.plan, self._of_plan = poses_ahead(self.robot, self.folder, self.room, self.target)

    def _remaining_poses(self) -> Array:
        """Return the joint variables of planned poses without a reading, (k, joints) [rad or m].

        Doubtful readings do not count. A pose to repeat comes first.
        """
        assert self.plan is not None
        counting = [q for n, q in self._read().items() if not self._doubtful.get(n)]
        measured = np.array(counting).reshape(-1, 1, self.robot.n)
        remaining = self.plan[(np.abs(self.plan - measured).max(axis=2) > 0.02).all(axis=0)]  # rad or m
        return remaining if self._wish is None else np.vstack([self._wish, remaining])

    def next_pose(self) -> Array:
        """Return the joint variables of the next pose, shape (joints,) [rad or m].

        After the last pose the plan begins again.
        """
        self.look_ahead()
        assert self.plan is not None
        with self.lock:
            remaining = self._remaining_poses()
            return np.asarray(remaining[0] if len(remaining) else self.plan[len(self.course.readings) % len(self.plan)])

    def doubted(self) -> bool:
        """Return whether the whole table is to be checked for slips now (see `check`).

        That is so at certain numbers of readings from 10 on, and at every third one where more than
        a third are doubtful or the noise is large.
        """
        n = len(self.course.readings)
        gross = self.estimate is not None and self.estimate.sigma > 0.003 * self.robot.reach
        many = sum(self._doubtful.values()) > max(2, n / 3)
        # Numbers of readings at which the whole table is checked for slips.
        return (
            n >= 10
            and n > self.checked[0]
            and (n in (10, 15, 25, 40, 60, 100, 200) or ((gross or many) and n % 3 == 0))
        )

    def check(self) -> None:
        """Check the whole table as `casadical check` does, and store the errors in `checked`.

        Too few poses are no such error. A search for slips takes seconds.
        """
        n = len(self.course.readings)
        checked = precheck(self.folder)
        texts = [f"{f.topic}: {f.text}" for f in checked.findings if f.level == "error" and f.topic != "too few poses"]
        with self.lock:
            self.checked = (n, [text.replace(f"{self.folder}/", "") for text in texts])

    # Output

    def _write(self) -> None:
        """Write the table of readings, and problem.toml where it or its excluded rows change."""
        course = self.course
        rows: list[Sequence[str]] = [course.header, *([course.units] if course.units else [])]
        write_whole(self.folder / TABLE_FILE, csv_text([*rows, *(r.cells for r in course.readings)]))
        reasons = self._unreadable | {r.number: r.struck for r in course.readings if r.struck}
        struck = {n + 1 + bool(course.units): why for n, why in reasons.items()}
        path = self.folder / "problem.toml"
        text = read_text(path)
        document = tomlkit.parse(text)
        tables = [t for t in document.get("measurements", []) if t.get("file") == TABLE_FILE]
        if not tables:
            document["data"] = course.data
            document["data"].comment(f"{TABLE_FILE}, by casadical measure")
            document["title"] = f"{self.robot.name}, {'measured' if course.data == 'real' else 'SYNTHETIC poses'}"
            document["measurements"] = tomlkit.aot()
            document["measurements"].append(table := tomlkit.table())
            table["file"] = TABLE_FILE
            table.add(tomlkit.nl())
            tables = [table]
        if "data" not in document:
            document["data"] = course.data
        if sorted(struck) != sorted(tables[0].get("leave_out", [])):
            listed = tomlkit.array()
            listed.extend(sorted(struck))
            tables[0]["leave_out"] = listed
            if struck:
                why = "; ".join(f"{row}: {shown(reason)}" for row, reason in sorted(struck.items()))
                tables[0]["leave_out"].comment(why)
        if (made := tomlkit.dumps(document)) != text:
            write_whole(path, made)

    def state(self) -> dict[str, Any]:
        """Return all that the page shows, for JSON; angles [deg], lengths [mm].

        The keys are robot, folder, data, fields, readings, said, table, known (of the estimate;
        None before), next (planned poses) and the sentences of `with_words`.
        """
        with self.lock:
            read, estimate = self._read(), self.estimate
            readings = [self._reading_json(r, read.get(r.number)) for r in self.course.readings]
            figures: dict[str, Any] | None = None
            if estimate is not None:
                errors_mm = 1e3 * np.linalg.norm(estimate.left_out, axis=1)
                errors_mm, task = errors_mm[np.isfinite(errors_mm)], expected(estimate.robot, self._task, {}, "task")
                highest = None
                if len(errors_mm) >= MIN_READINGS_FOR_QUANTILE:
                    highest = float(np.quantile(errors_mm, 0.95, method="higher"))
                figures = {
                    "readings": len(estimate),
                    "noise_mm": 1e3 * estimate.sigma,
                    "expected_mm": 1e3 * estimate.expected(task),
                    "left_out_mean_mm": float(errors_mm.mean()) if len(errors_mm) >= MAX_REFITTED_READINGS else None,
                    "promise_mm": highest,
                }
            # Poses that touch something are not planned.
            touches = self.m is not None and find_kind(self.m.kind).touches
            return with_words(
                {
                    "robot": self.robot.name,
                    "folder": self.folder.resolve().name,
                    "data": self.course.data if readings else self._data,
                    "fields": self.fields,
                    "readings": readings,
                    "said": [*([self.unread] if self.unread else []), *self.said[-5:], *self._of_table],
                    "table": self._of_table,
                    "known": figures,
                    "next": None if self.plan is None or touches else self._next_json(),
                }
            )

    @property
    def _of_table(self) -> list[str]:
        """Return sentences on the faults of the whole table at its last check, and of its clock."""
        return [*self.checked[1], *(clock_faults(self.m) if self.m is not None else ())]

    def _reading_json(self, r: Reading, at: Array | None) -> dict[str, Any]:
        """Return a reading for the page: number, at, from, state, why, off_mm and joints.

        The state is good, doubtful, unread or struck; off_mm is the length of its residual.

        at : its joint variables, shape (joints,) [rad or m]; None where they cannot be read
        """
        state = "struck" if r.struck else "doubtful" if self._doubtful.get(r.number) else "good"
        if at is None and not r.struck:
            state = "unread"
        lost = (self.unread or "a cell is empty or no number") if state == "unread" else ""
        return {
            "number": r.number,
            "at": r.at,
            "from": r.source,
            "state": state,
            "why": r.struck or self._unreadable.get(r.number) or self._words.get(r.number, lost),
            "off_mm": round(1e3 * self._off[r.number], 4) if r.number in self._off else None,
            "joints": None if at is None else self._joints(at),
        }

    def _joints(self, q: Array) -> list[float]:
        """Return the controller's readings at q [rad or m], rounded, in the units of their columns."""
        readings = self.robot.readings_of(np.asarray(q)[None])[0]
        return [round(float(v), 4) for v in readings / list(self.robot.reading_units.values())]

    def _next_json(self) -> dict[str, Any]:
        """Return the planned poses for the page: poses, program, to_go and words.

        Poses [deg or mm] begin with the next one, whose move command is `program`.
        """
        poses = [self._joints(q) for q in (self.next_pose(), *self._remaining_poses()[1:])]
        remaining = len(self._remaining_poses())
        words = f"{remaining} planned poses remain" if remaining else "all planned poses are measured"
        program = self._move(poses[0]) if self._move else ""
        return {"poses": poses, "program": program, "to_go": remaining, "words": f"{words}; {self._of_plan}"}


def finished(session: LiveSession) -> str:
    """Calibrate the session's folder into its folder `results`, and return the report.

    Raises InputError, also where held-out poses are worse than before, and ConvergenceError; then
        nothing is written.
    """
    folder = session.folder
    try:
        calibrated = calibrate(folder)
    except (InputError, ConvergenceError) as error:
        doubted = [str(r["number"]) for r in session.state()["readings"] if r["state"] == "doubtful"]
        listed = f"; doubtful: reading {', '.join(doubted)}: strike out what was a slip" if doubted else ""
        raise InputError(f"{error}{listed}") from None
    if calibrated.worse:
        raise InputError(f"nothing was written: {calibrated.worse}")
    calibrated.write(folder / "results")
    return f"{plain_text(calibrated.brief())}\nwrote {folder / 'results'}"
