"""An offline program as a CSV table: joint targets are read in SI, every other column is kept unchanged."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.core.files import csv_text
from casadical.measurements.columns import Columns
from casadical.measurements.raw_table import read_table

STATUS, BOUND = "correction_status", "correction_bound_mm"

_TO_SI = {"rad": {"_deg": np.pi / 180, "_rad": 1.0}, "m": {"_mm": 1e-3, "_m": 1.0}}
_FACTOR = {unit: factor for units in _TO_SI.values() for unit, factor in units.items()}
_DIGITS = {"_deg": 7, "_rad": 9, "_mm": 6, "_m": 9}  # decimals: some nanometres at the tool


@dataclass(frozen=True, eq=False)
class Program:
    r"""Joint targets and the table that contains them.

    source : name of the file
    q : Array, shape (rows, joints) [rad or m]: joint targets
    header : headers of the columns
    rows : cells as text
    line : of each row in the file
    columns : indices of the joints' columns
    units : "_deg" or "_rad" of each, "_mm" or "_m" of a linear joint
    """

    source: str
    q: Array
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    line: tuple[int, ...]
    columns: tuple[int, ...]
    units: tuple[str, ...]

    def text(self, q: Array, moved: Array, status: Sequence[str], bound_mm: Array | None = None) -> str:
        """The table as CSV with new targets in some rows, and a column with each row's status.

        q : Array, shape (rows, joints) [rad or m]: joint targets
        moved : Array, shape (rows,): which rows take them, boolean
        bound_mm : Array | None, shape (rows,): of the error that remains, a further column; empty where a row was not
            moved
        """
        table = [[*self.header, STATUS, *([] if bound_mm is None else [BOUND])]]
        for k, row in enumerate(self.rows):
            cells = list(row)
            for i, (column, unit) in enumerate(zip(self.columns, self.units, strict=True)):
                if moved[k]:
                    cells[column] = f"{q[k, i] / _FACTOR[unit]:.{_DIGITS[unit]}f}"
            bound = [] if bound_mm is None else [f"{bound_mm[k]:.4f}" if moved[k] else ""]
            table.append([*cells, status[k], *bound])
        return csv_text(table)


def read_program(path: str | Path, joints: int, units: Sequence[str] = ()) -> Program:
    r"""Joint targets q1_deg .. (or q1_rad ..) from a CSV file with commas and a header.

    joints : number of joints
    units : "rad" or "m" of each joint's reading: of a linear joint the column is q1_mm or q1_m; default: all rad
    Raises InputError: a cell or column that cannot be used; it names file, row and column.
    """
    table = read_table(path)
    header, rows, line = table.header, table.cells, table.line
    if table.form.separator != "," or table.form.sheet:
        form = "a workbook" if table.form.sheet else f"separated by {table.form.separator!r}"
        raise InputError(f"{path}: is {form}; a program is read and written with commas and decimal points, as CSV")
    if STATUS in header:
        raise InputError(
            f"{path}: column {STATUS!r} is there already: this program was corrected before; correct the original"
        )
    for number, row in zip(line, rows, strict=True):
        if len(row) != len(header):
            raise InputError(f"{path}: row {number} has {len(row)} cells, the header {len(header)}; correct the row")
    if extra := [name for name in header if name.startswith(f"q{joints + 1}_")]:
        raise InputError(f"{path}: column {extra[0]!r}: this robot has only {joints} joints")
    columns, names = Columns.of_file(table), [f"q{i}" for i in range(1, joints + 1)]
    allowed = [tuple(_TO_SI[unit]) for unit in units or ("rad",) * joints]
    q = np.stack([columns.si(name, fit) for name, fit in zip(names, allowed, strict=True)], axis=1)
    used = tuple(next(u for u in fit if f"{name}{u}" in header) for name, fit in zip(names, allowed, strict=True))
    places = tuple(header.index(f"{name}{u}") for name, u in zip(names, used, strict=True))
    return Program(str(path), q, header, rows, tuple(line), places, used)
