"""An offline program as a CSV table: joint targets are read in SI, every other column is kept unchanged."""

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.measurements.raw_table import read_table

STATUS = "correction_status"

_TARGET = re.compile(r"q(\d+)_(\w+)")
_TO_RAD = {"deg": np.pi / 180, "rad": 1.0}
_DIGITS = {"deg": 7, "rad": 9}  # decimals: some nanometres at the tool


@dataclass(frozen=True, eq=False)
class Program:
    """Joint targets and the table that contains them.

    q : shape (rows, joints) [rad]; header, rows : the table's cells as text; line : of each row in the file
    columns : indices of the joints' columns; units : "deg" or "rad" of each
    """

    source: str
    q: Array
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    line: tuple[int, ...]
    columns: tuple[int, ...]
    units: tuple[str, ...]

    def text(self, q: Array, moved: Array, status: Sequence[str]) -> str:
        """The table as CSV with new targets in some rows, and a column with each row's status.

        q : joint targets, shape (rows, joints) [rad or m]; moved : which rows take them, boolean, shape (rows,)
        """
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([*self.header, STATUS])
        for k, row in enumerate(self.rows):
            cells = list(row)
            for i, (column, unit) in enumerate(zip(self.columns, self.units, strict=True)):
                if moved[k]:
                    cells[column] = f"{q[k, i] / _TO_RAD[unit]:.{_DIGITS[unit]}f}"
            writer.writerow([*cells, status[k]])
        return out.getvalue()


def read_program(path: str | Path, joints: int) -> Program:
    """Joint targets q1_deg .. (or q1_rad ..) from a CSV file with commas and a header.

    Raises InputError that names file, row and column.
    """
    table = read_table(path)
    header, rows, line = table.header, table.cells, table.line
    columns, units = _columns(table.path, header, joints)
    for number, row in zip(line, rows, strict=True):
        if len(row) != len(header):
            raise InputError(f"{path}: row {number} has {len(row)} cells, the header {len(header)}; correct the row")
    q = np.empty((len(rows), joints))
    for i, (column, unit) in enumerate(zip(columns, units, strict=True)):
        for k, row in enumerate(rows):
            q[k, i] = _number(row[column], f"{path}: row {line[k]}, column {header[column]!r}") * _TO_RAD[unit]
    return Program(str(path), q, header, rows, line, columns, units)


def _columns(path: Path, header: tuple[str, ...], joints: int) -> tuple[tuple[int, ...], tuple[str, ...]]:
    if STATUS in header:
        raise InputError(
            f"{path}: column {STATUS!r} is there already: this program was corrected before; correct the original"
        )
    found: dict[int, tuple[int, str]] = {}
    for column, name in enumerate(header):
        target = _TARGET.fullmatch(name)
        if target is None:
            continue
        i, unit = int(target[1]), target[2]
        if unit not in _TO_RAD:
            raise InputError(f"{path}: column {name!r}: unit {unit!r} is not known; allowed: q{i}_deg, q{i}_rad")
        if i in found:
            raise InputError(f"{path}: columns {header[found[i][0]]!r} and {name!r} are of the same joint; keep one")
        if not 1 <= i <= joints:
            raise InputError(f"{path}: column {name!r}: this robot has only {joints} joints")
        found[i] = (column, unit)
    for i in range(1, joints + 1):
        if i not in found:
            raise InputError(f"{path}: column q{i}_deg or q{i}_rad is missing; there are {', '.join(header)}")
    return tuple(found[i][0] for i in range(1, joints + 1)), tuple(found[i][1] for i in range(1, joints + 1))


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{where}: {text!r} is not a finite number; correct or delete the row")
    return value
