"""Columns of a table under casadical's names, converted to SI.

Missing columns, cells that are no numbers and values in a wrong unit raise an InputError that
names file, row and column.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from casadical.core.basics import Array, Fault, FaultsError, InputError, shown
from casadical.core.reading import LARGEST_NUMBER
from casadical.measurements.corners import CORNER_NUMBERS, MIN_CORNERS
from casadical.measurements.raw_table import RawTable, refuse_repeated_names
from casadical.measurements.vocabulary import UNITS


@dataclass(frozen=True)
class Source:
    """How a column of ours is computed: times * (a column of the file) + sum(add * others) + plus.

    name : column of the file
    times : factor of that column
    plus : offset in the unit of our column's name
    add : further columns of the file with their factors
    rows : shift of the column in rows, where a logger was ahead or behind: the value is taken from
        this number of rows later (earlier if negative)
    """

    name: str
    times: float = 1.0
    plus: float = 0.0
    add: Mapping[str, float] = field(default_factory=dict)
    rows: int = 0

    @classmethod
    def read(cls, given: str | Mapping[str, Any]) -> Source:
        """Return the source that a TOML value describes: a column's name or a table with `from`."""
        table: Mapping[str, Any] = {"from": given} if isinstance(given, str) else given
        return cls(table["from"], **{key: value for key, value in table.items() if key != "from"})

    @property
    def table(self) -> str | dict[str, Any]:
        """The TOML value that describes this source, a name or a table; `Source.read` reads it."""
        usual = Source(self.name)
        more = {k: getattr(self, k) for k in ("times", "plus", "rows", "add") if getattr(self, k) != getattr(usual, k)}
        return {"from": self.name, **more} if more else self.name

    @property
    def plain(self) -> bool:
        """Whether the column of the file is used unchanged."""
        return self == Source(self.name)

    @property
    def words(self) -> str:
        """The computation of the column as text, such as "0.5 x 'A' - 'B' +90, 1 row below"."""
        terms = [(self.times, self.name), *((factor, name) for name, factor in self.add.items())]
        texts = [
            f"{'-' if factor < 0 else '+'} {'' if abs(factor) == 1 else f'{abs(factor):.6g} x '}'{shown(name)}'"
            for factor, name in terms
        ]
        first = f"-{texts[0][2:]}" if self.times < 0 else texts[0][2:]
        plus = f" {self.plus:+g}" if self.plus else ""
        rows = f", {abs(self.rows)} row{'s' * (abs(self.rows) > 1)} {'below' if self.rows > 0 else 'above'}"
        return " ".join([first, *texts[1:]]) + plus + (rows if self.rows else "")


def columns_used(sources: Mapping[str, Source]) -> Iterator[tuple[str, str]]:
    """Yield every column of the file that the sources use, and for messages who names it.

    That is a phrase such as "named for 'q1_deg'".

    sources : casadical's column name -> its source
    """
    return ((name, f"named for {ours!r}") for ours, s in sources.items() for name in (s.name, *s.add))


def _column_of_source(table: pd.DataFrame, source: Source) -> pd.Series:
    """Return the column that a source computes from a table's columns.

    Cells that are words stay, so that messages can quote them; cells beyond the ends of the table
    are missing.
    """
    if source.plain:
        return table[source.name]
    terms = {source.name: source.times + source.add.get(source.name, 0.0)}
    terms |= {n: source.add[n] for n in source.add if n != source.name}
    number = {name: pd.Series(numbers_of(table[name]), table.index) for name in terms}
    total = sum((factor * number[name] for name, factor in terms.items()), start=pd.Series(source.plus, table.index))
    words = table[source.name].where(number[source.name].isna())
    return total.where(words.isna(), words).shift(-source.rows)


def _stem(name: str) -> str:
    """Return a column's name without its unit."""
    return name.rpartition("_")[0]


# Kind of joint -> suffixes of the units in which its readings may be given.
_UNITS = {"revolute": ("_deg", "_rad"), "prismatic": ("_mm", "_m")}
# Column that the model or effects use -> its lowest and highest allowed value [its own unit].
POSSIBLE_RANGES = {
    "payload_kg": (0.0, 1e5),
    "temperature_degC": (-273.15, 200.0),  # room temperatures in kelvin are refused
    "time_s": (-1e12, 1e12),
    "pose": (-1e12, 1e12),
    "weight": (-LARGEST_NUMBER, LARGEST_NUMBER),
}
# Largest reading of a revolute joint that is accepted, to either side [turns].
MAX_TURNS = 4
# One turn, rounded up [rad]: numbers below may be radians, whatever unit their heading names.
FULL_TURN_RAD = 6.3
# Pattern of logged columns (warm-up, direction of approach) that must be numbers or signs.
_NUMERIC_CONDITIONS = re.compile(r"warmth_\w+|approach\d+")
# Pattern of the columns that describe an orientation.
ORIENTATION = "(r[xyz]|rotvec_[xyz]|roll|pitch|yaw)_(deg|rad)|R[012]{2}|q[wxyz]"
# Pattern of the columns of measured positions, distances and orientations.
_OBSERVATION_NAME = re.compile(f"[xyz]_mm?|distance_mm?|{ORIENTATION}")
# Pattern of the columns of joint readings, with number of the joint and unit.
_READING_NAME = re.compile(r"q(\d+)_(deg|rad|mm|m)")
# Pattern of the columns of the base's inclination, by tilt angles or the direction of gravity.
_TILT_NAME = "tilt_[xy]_(deg|rad)|gravity_[xyz]"
# Pattern of columns with a meaning of their own (readings, weight, set, target, session), which are
# no conditions.
_NO_CONDITION_NAME = r"q\d+_(deg|rad|mm|m)|weight|set|tool|session"


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of one table, converted to SI on reading; an InputError names source, row and column.

    table : cells under their headings, which have no blanks around them
    source : file name or description
    row : line of the file at which each row stands, shape (n,)
    empty : headings of columns without any cell, which are dropped
    taken : headings of columns from which others were computed
    left_out : lines of the file that the user excluded
    corners : corners in the image of each row's station, shape (n, N, 6) (see `corners.Images`); None: without images

    Examples
    --------
    >>> columns = casadical.measurements.Columns.of_frame(table, "made up")
    >>> columns.joints(["revolute", "revolute"]).shape, columns.vector("").shape, columns.si("x", ["_mm", "_m"]).shape
    ((60, 2), (60, 3), (60,))
    >>> columns.column("q1_deg").shape, columns.at(0), columns.tools(), columns.sessions()
    ((60,), 'made up: row 2', {}, {})
    >>> columns.with_tools({"A": [2, 3], "B": [4]}).table.tool[:3].tolist()
    ['A', 'A', 'B']
    >>> columns.without([2, 3], "leave_out").at(0)
    'made up: row 4'
    >>> columns.conditions(["[xyz]_mm"]), columns.unused([], ["[xyz]_mm"])
    ({}, ())
    >>> columns.mapped({"payload_kg": "z_mm"}).names.split(", ")[-1]
    'payload_kg'
    >>> from casadical.measurements.raw_table import read_table
    >>> casadical.measurements.Columns.of_file(read_table("data/planar/planar.csv")).names
    'q1_deg, q2_deg, x_mm, y_mm, z_mm'
    """

    table: pd.DataFrame
    source: str
    row: Array
    empty: tuple[str, ...] = ()
    taken: tuple[str, ...] = ()
    left_out: tuple[int, ...] = ()
    corners: Array | None = None

    def __post_init__(self) -> None:
        if not len(self.table):
            why = f": {len(self.left_out)} are left out" if self.left_out else ""
            raise InputError(f"{self.source}: a header but no rows that count{why}; at least one row is needed")

    @staticmethod
    def of_file(raw: RawTable) -> Columns:
        """Return the columns of a file's table. Raises InputError: a heading occurs twice."""
        return Columns.of_frame(raw.frame, raw.path.name, np.array(raw.line))

    @staticmethod
    def of_frame(table: pd.DataFrame, source: str, row: Array | None = None) -> Columns:
        """Return the columns of a pandas table [units of its headings].

        Raises InputError: a heading occurs twice.

        source : what messages call it
        row : line of a file, from 1, of each row, shape (n,); by default as below a line of
            headings, from 2
        """
        table = table.rename(columns=lambda name: str(name).strip())
        refuse_repeated_names(table.columns, source)
        filled = table.dropna(axis="columns", how="all")
        empty = tuple(str(name) for name in table if name not in filled and not str(name).startswith("Unnamed: "))
        return Columns(filled, source, np.arange(len(table)) + 2 if row is None else row, empty)

    def mapped(self, columns: Mapping[str, str | Source], point_from: Sequence[str] = ()) -> Columns:
        """Return the columns under casadical's names, where the table's headings differ from them.

        Rows for which a shift of rows gives no value are omitted; rows of corners become stations.

        columns : casadical's name -> name in the table, or how it is computed from its columns
        point_from : columns whose words, joined by "/", name the touched point
        Raises InputError: a named column is missing, or shifted by all rows; corners are unusable.
        """
        sources = {ours: Source(given) if isinstance(given, str) else given for ours, given in columns.items()}
        used = [*columns_used(sources), *((name, "named in point_from") for name in point_from)]
        for theirs, where in used:
            if theirs not in self.table:
                raise InputError(f"{self.source}: column {theirs!r}, {where}, is missing; there are {self.names}")
        # A header that keeps its own name elsewhere in the map is copied, not moved.
        ours = {name: _column_of_source(self.table, source) for name, source in sources.items()}
        if point_from:
            ours["point"] = self.table[list(point_from)].astype(str).agg("/".join, axis=1)
        moved = {name for name, s in sources.items() if name in self.table and s.name != name}
        # A mapping q3_rad = "q3_deg" means that the unit in the heading is wrong.
        moved |= {s.name for name, s in sources.items() if s.name not in sources and _stem(name) == _stem(s.name)}
        shifts = [s.rows for s in sources.values()]
        if far := next((o for o, s in sources.items() if abs(s.rows) >= len(self.table)), None):
            rows_of = f"columns.{far}.rows = {sources[far].rows}"
            raise InputError(f"{self.source}: {rows_of}: allowed: less than its {len(self.table)} rows")
        rows = slice(max(0, -min(shifts, default=0)), len(self.table) - max(0, *shifts, 0))
        table = self.table.drop(columns=sorted(moved)).assign(**ours).iloc[rows].reset_index(drop=True)
        made = replace(self, table=table, row=self.row[rows], taken=(*self.taken, *(name for name, _ in used)))
        return made._as_stations() if {"u_px", "v_px"} <= {*table} else made

    def _as_stations(self) -> Columns:
        """Return the columns with a row for each station, where each row was a corner in an image.

        Rows one after the other with equal joint readings are of one station, which has the row of
        its first corner; the column `corners` has their number.
        """
        flat = not {"board_z_mm", "board_z_m"} & {*self.table}
        of_board = [self.si(f"board_{c}", ("_mm", "_m")) for c in ("xy" if flat else "xyz")]
        one = np.ones(len(self.row))
        each = np.column_stack([self.column("u_px"), self.column("v_px"), *of_board, *([0 * one] * flat), one])
        readings = self.table[[name for name in map(str, self.table) if _READING_NAME.fullmatch(name)]]
        first = np.flatnonzero((readings != readings.shift()).any(axis=1)) if len(readings.columns) else np.array([0])
        counts = np.diff([*first, len(each)])
        if counts.min() < MIN_CORNERS:
            k = int(np.argmin(counts))
            raise InputError(
                f"{self.source}: row {self.row[first[k]]}: the station that begins there has {counts[k]} corners (rows "
                f"with equal joint readings); allowed: {MIN_CORNERS} or more; delete its rows"
            )
        corners = np.zeros((len(first), counts.max(), CORNER_NUMBERS))
        for images, begin, count in zip(corners, first, counts, strict=True):
            images[:count] = each[begin : begin + count]
        if np.ptp(corners[corners[:, :, 5] > 0][:, 4]) > 0:
            raise InputError(
                f"{self.source}: column board_z_mm: the corners lie in several planes; allowed: one, z = 0"
            )
        gone = [name for name in map(str, self.table) if re.fullmatch(r"[uv]_px|board_[xyz]_mm?", name)]
        table = self.table.iloc[first].drop(columns=gone).reset_index(drop=True).assign(corners=counts)
        return replace(self, table=table, row=self.row[first], corners=corners)

    def without(self, rows: Collection[int], why: str) -> Columns:
        """Return the columns without some rows of the file.

        rows : lines of the file, from 1; why : where the user names them, for the message
        Raises InputError: a line that is no row of the table.
        """
        missing = sorted(set(rows) - set(self.row.tolist()))
        if missing:
            raise InputError(f"{self.source}: row {missing[0]}, named in {why}, is no row of the table")
        remaining = ~np.isin(self.row, list(rows))
        left_out = (*self.left_out, *self.row[~remaining].tolist())
        return replace(
            self,
            table=self.table[remaining].reset_index(drop=True),
            row=self.row[remaining],
            left_out=left_out,
            corners=None if self.corners is None else self.corners[remaining],
        )

    def with_tools(self, rows: Mapping[str, Sequence[int]]) -> Columns:
        """Return the columns with a column `tool` that names each row's target.

        rows : name of a target -> lines of the file, from 1, at which it was measured; others get
            none
        Raises InputError: a row is listed under two names.
        """
        names: dict[int, str] = {}
        for name, listed in rows.items():
            for row in listed:
                if names.setdefault(row, name) != name:
                    raise InputError(f"{self.source}: row {row} is in tools twice, of {names[row]} and of {name}")
        tool = pd.Series([names.get(int(row)) for row in self.row], dtype=object)
        return replace(self, table=self.table.assign(tool=tool))

    @property
    def lost_rows(self) -> tuple[int, ...]:
        """Lines of the file in which a reading or an observation is no finite number.

        Empty if these are more than half of the rows: then the columns are wrong, not single rows.
        """
        return self._rows_of(self._needed.apply(pd.to_numeric, errors="coerce").abs() < np.inf)

    @property
    def empty_rows(self) -> tuple[int, ...]:
        """Lines of the file with an empty cell among readings and observations: lost measurements.

        Words in such cells may be typing errors and do not count. Empty if these are more than half
        of the rows.
        """
        return self._rows_of(self._needed.notna())

    @property
    def _needed(self) -> pd.DataFrame:
        """The cells of the columns of joint readings and of observations."""
        names = (str(name) for name in self.table)
        return self.table[
            [name for name in names if _OBSERVATION_NAME.fullmatch(name) or _READING_NAME.fullmatch(name)]
        ]

    def _rows_of(self, good: pd.DataFrame) -> tuple[int, ...]:
        """Return the lines of the rows that are not all True; () if these are more than half."""
        bad = ~good.all(axis=1).to_numpy(dtype=bool)
        return tuple(int(k) for k in self.row[bad]) if 2 * bad.sum() <= len(bad) else ()

    @property
    def names(self) -> str:
        """All headings, separated by commas, for messages."""
        return ", ".join(map(str, self.table))

    def at(self, k: int) -> str:
        """Return source and line of the table's k-th row, for messages."""
        return f"{self.source}: row {self.row[k]}"

    def column(self, name: str) -> Array:
        """Return a column of numbers, shape (n,) [its own unit]; dates and signs become numbers.

        Raises InputError: it is missing, or holds cells that are no finite numbers or impossible.
        """
        if name not in self.table:
            raise InputError(f"{self.source}: column {name!r} is missing; there are {self.names}")
        if faults := self._faults(name):
            raise FaultsError(faults)
        return self._values(name)

    def _values(self, name: str) -> Array:
        """Return a column's cells as numbers, shape (n,) [its own unit], NaN if they are none."""
        read = in_seconds if name == "time_s" else signs_of if name.startswith("approach") else numbers_of
        return read(self.table[name])

    def _faults(self, name: str) -> list[Fault]:
        """Return the fault of a column's cells that are no finite numbers or out of range, or [].

        Values out of range are reported only where all cells are finite numbers.
        """
        values = self._values(name)
        faults: list[Fault] = []
        least, most = POSSIBLE_RANGES.get(name, (-LARGEST_NUMBER, LARGEST_NUMBER))
        with np.errstate(invalid="ignore"):
            far = (values < least) | (values > most)
            if towards := name.startswith("approach"):
                far = ~np.isin(values, (-1, 0, 1))
        for wrong, mask in (("is not a finite number", ~np.isfinite(values)), ("is not possible", far)):
            if (bad := np.flatnonzero(mask)).size and not faults:
                rows, finite = tuple(map(int, self.row[bad])), np.isfinite(values[bad[0]])
                value = f"{values[bad[0]]:g}" if finite else _cell(self.table[name].iloc[int(bad[0])])
                allowed = ("-1 or 1" if towards else f"{least:g} to {most:g}") if finite else ""
                faults.append(Fault(self.source, rows, name, value, wrong, allowed, "correct or delete the row"))
        return faults

    def refuse_faults(self, kinds: Sequence[str], observations: str) -> None:
        """Refuse missing readings, and impossible numbers in all columns that are used, at once.

        kinds : revolute or prismatic, of each joint
        observations : pattern of the columns that the kinds of measurement read
        Raises FaultsError: with every fault.
        """
        named = [[f"q{i}{unit}" for unit in _UNITS[kind]] for i, kind in enumerate(kinds, 1)]
        blank = [name for names in named if not {*names} & {*self.table} for name in names if name in self.empty]
        lost = [" or ".join(names) for names in named if not {*names} & {*self.table, *blank}]
        remedy = f"name it so, or map it by `columns` in problem.toml; there are {self.names}"
        what = "are missing" if len(lost) > 1 else "is missing"
        faults = [Fault(self.source, (), ", ".join(lost), "", what, "", remedy)] if lost else []
        faults += map(self._empty, blank)
        for name in map(str, self.table):
            asked = name in POSSIBLE_RANGES or re.fullmatch(
                f"{_NUMERIC_CONDITIONS.pattern}|{_READING_NAME.pattern}|{_TILT_NAME}", name
            )
            mostly = pd.to_numeric(self.table[name], errors="coerce").notna().mean() >= 0.5
            measured = _OBSERVATION_NAME.fullmatch(name) or not re.fullmatch(
                f"{_NO_CONDITION_NAME}|{observations}", name
            )
            if asked or (mostly and measured and name not in self.taken):
                faults += self._faults(name)
        if faults:
            raise FaultsError(faults)

    def _empty(self, name: str) -> Fault:
        """Return the fault of a column without any cell."""
        return Fault(self.source, (), name, "", "is empty", "", "each of its rows needs a number")

    def si(self, stem: str, units: Sequence[str]) -> Array:
        """Return the column STEM_mm, STEM_m, STEM_deg or STEM_rad in SI, shape (n,) [m or rad].

        stem : name without unit; units : suffixes that are allowed
        Raises InputError: it is missing, given in two units, or a cell is no finite number.
        """
        present = [u for u in units if f"{stem}{u}" in self.table]
        if len(present) > 1:
            both = " and ".join(f"{stem}{u}" for u in present)
            raise InputError(f"{self.source}: columns {both} say the same; keep one")
        if not present:
            wanted = " or ".join(f"{stem}{u}" for u in units)
            if blank := [name for name in self.empty if name in {f"{stem}{u}" for u in units}]:
                raise FaultsError([self._empty(blank[0])])
            raise InputError(f"{self.source}: column {wanted} is missing; there are {self.names}; name it so")
        to_si = {"_mm": 1e-3, "_m": 1.0, "_deg": np.pi / 180, "_rad": 1.0}
        return self.column(stem + present[0]) * to_si[present[0]]

    def joints(self, kinds: Sequence[str]) -> Array:
        """Return the joint readings q1_deg (_rad, _mm, _m) and so on, shape (n, joints) [rad or m].

        kinds : revolute or prismatic, of each joint
        Raises InputError: a column is missing, or there are columns of more joints.
        """
        columns = [self.si(f"q{i}", _UNITS[kind]) for i, kind in enumerate(kinds, 1)]
        for name in map(str, self.table):
            match = _READING_NAME.fullmatch(name)
            if match and not 1 <= int(match[1]) <= len(kinds):
                raise InputError(f"{self.source}: column {name!r}: this robot has only {len(kinds)} joints")
        return np.stack(columns, axis=1)

    def vector(self, prefix: str, units: Sequence[str] = ("_mm", "_m")) -> Array:
        """Return columns PREFIXx_mm, PREFIXy_mm and PREFIXz_mm, shape (n, 3) [m or rad].

        Raises InputError as `si` does.
        """
        return np.stack([self.si(f"{prefix}{c}", units) for c in "xyz"], axis=1)

    def conditions(self, observations: Iterable[str]) -> dict[str, Array]:
        """Return the numeric columns that are no readings or observations, (n,) [their own units].

        Columns of words (remarks, operators) are not among them.

        observations : patterns of the columns that the kinds of measurement read
        Raises InputError: words among numbers.
        """
        others = re.compile("|".join([_NO_CONDITION_NAME, *observations]))
        conditions = {}
        for name in map(str, self.table):
            if others.fullmatch(name) or (name in self.taken and name not in POSSIBLE_RANGES):
                continue  # a heading that one of our columns was made from is no condition
            numeric = pd.to_numeric(self.table[name], errors="coerce").notna()
            # A column with few words among numbers contains mistakes, for which `column` raises an
            # error. Columns that the model uses must be numbers.
            if numeric.mean() >= 0.5 or name in POSSIBLE_RANGES or _NUMERIC_CONDITIONS.fullmatch(name):
                conditions[name] = self.column(name)
        return conditions

    def tools(self) -> dict[str, Array]:
        """Return an indicator per name in the column `tool`: "tool_NAME" -> shape (n,), 0 or 1 [-].

        Empty without that column. Raises InputError: an empty cell.
        """
        return self._named("tool", "name the measured point, there or in `tools` of problem.toml")

    def sessions(self) -> dict[str, Array]:
        """Return an indicator per name in the column `session`: "session_NAME" -> shape (n,), 0 or 1 [-].

        The dict is empty without that column. Raises InputError: an empty cell.
        """
        return self._named("session", "name the session in every row")

    def _named(self, column: str, remedy: str) -> dict[str, Array]:
        """Return an indicator per name in a column: "COLUMN_NAME" -> shape (n,), 0 or 1.

        remedy : end of the message on an empty cell
        """
        if column not in self.table:
            return {}
        names = self.table[column].map(lambda cell: "" if pd.isna(cell) else _name(str(cell)))
        if (names == "").any():
            raise InputError(f"{self.at(int(np.argmax(names == '')))}, column {column!r}: is empty; {remedy}")
        return {f"{column}_{name}": (names == name).to_numpy(dtype=float) for name in dict.fromkeys(names)}

    def unused(self, conditions: Collection[str], observations: Iterable[str]) -> tuple[str, ...]:
        """Return the names of columns that nothing reads: those of words, and those without a cell.

        conditions : names of the columns that are used as conditions
        observations : patterns of the columns that the kinds of measurement read
        """
        used = re.compile("|".join([_NO_CONDITION_NAME, *observations]))
        unread = (n for n in map(str, self.table) if n not in (*conditions, *self.taken) and not used.fullmatch(n))
        return (*unread, *self.empty)


def _name(cell: str) -> str:
    """Return a name in one spelling: "1.0" becomes "1", and letters are composed (NFC).

    pandas reads whole numbers as floats where a cell of the column is empty.
    """
    return unicodedata.normalize("NFC", cell).strip().removesuffix(".0")


def is_ours(name: str, pattern: str) -> bool:
    """Return whether a column is read under this name, so that it needs no mapping.

    pattern : of the columns that the kind of measurement reads
    """
    return name in POSSIBLE_RANGES or bool(
        re.fullmatch(f"{_NO_CONDITION_NAME}|{_NUMERIC_CONDITIONS.pattern}|{_TILT_NAME}|{pattern}", name)
    )


def numbers_of(cells: pd.Series) -> Array:
    """Return cells as numbers, shape (n,), NaN for those that are none, such as truth values."""
    if cells.dtype in (bool, object):
        cells = cells.map(lambda cell: str(cell) if isinstance(cell, bool | np.bool_) else cell)
    return pd.to_numeric(cells, errors="coerce").to_numpy(dtype=float)


def signs_of(cells: pd.Series) -> Array:
    """Return directions as -1 and 1, shape (n,): signs and words; numbers as they are, else NaN."""
    words = {"+": 1.0, "-": -1.0, "−": -1.0, "–": -1.0, "pos": 1.0, "neg": -1.0, "plus": 1.0, "minus": -1.0}
    texts = cells.astype(str).str.strip().str.casefold().str.replace(r"iti(v|ve|f)$|ati(v|ve|f)$", "", regex=True)
    return np.where(texts.isin(words), texts.map(words), numbers_of(cells)).astype(float)


def in_seconds(cells: pd.Series) -> Array:
    """Return cells of times as numbers, shape (n,): dates as seconds since 1970, numbers unchanged.

    Numbers that write a date in digits, such as 20261121143005, count as dates. Other words, and
    dates among numbers, are NaN; so is all where one date is not readable.
    """
    numbers = numbers_of(cells)
    form, first = "mixed", False
    if np.isfinite(numbers).any():
        if not (np.isfinite(numbers) & (numbers > 1.9e13) & (numbers < 2.1e13)).all():
            return np.asarray(numbers)
        texts, form = pd.Series([f"{number:.0f}" for number in numbers]), "%Y%m%d%H%M%S"
    elif (texts := cells.astype(str).str.strip()).str.fullmatch(r"\d{1,2}\.\d{1,2}\.\d{2,4}\b.*").any():
        first = True
    dates = pd.to_datetime(texts, errors="coerce", format=form, dayfirst=first, utc=True)
    if dates.isna().any():
        return np.asarray(numbers)
    return np.asarray((dates - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1), dtype=float)


def seconds_of_one(times: Array, unit: str) -> float:
    """Return the unit of times in seconds: by its word, else by the size of stamps since 1970."""
    size = float(np.median(np.abs(times)))
    stamps = ((1e11, 1.0), (1e14, 1e-3), (1e17, 1e-6))
    return UNITS[unit][1] if unit else next((f for most, f in stamps if size < most), 1e-9)


def _cell(text: object) -> str:
    """Return a cell as text for messages; "an empty cell or n/a" where it is missing."""
    if isinstance(text, float) and np.isnan(text):
        return "an empty cell or n/a"
    return repr(text.item() if isinstance(text, np.generic) else text)
