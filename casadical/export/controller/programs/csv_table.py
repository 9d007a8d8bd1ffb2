"""Program language of CSV tables of joint targets: columns q1_deg .. change, other cells stay.

A reader of its own knows encodings and separators; the text of the file is not used.
"""

from collections.abc import Sequence
from typing import Any, NoReturn

from casadical.core.basics import M_PER_MM, Array, InputError
from casadical.core.files import csv_text
from casadical.export.controller.programs.language import ProgramLanguage
from casadical.export.controller.programs.target import RAD_PER_DEG, Given, Number, Target
from casadical.measurements.columns import Columns
from casadical.measurements.raw_table import RawTable, read_table

# Name of the column that is added to a corrected table.
STATUS_COLUMN = "correction_status"


class CsvTable(ProgramLanguage):
    """CSV tables of joint targets, with commas and a header.

    A `Number` has its row and column in place of its first and last character.
    """

    name = "CSV"
    suffixes = (".csv",)
    pose = "no pose: a table holds joint targets"
    place = "row"
    report_beside = False

    def decoded(self, source: str, content: bytes) -> str:
        """Return the bytes as text, one character each; tables are read from the file itself."""
        return content.decode("latin-1")

    def targets(self, source: str, text: str, given: Given, joints: int) -> list[Target]:
        """Return the joint targets of a table, one per row, in its order.

        Raises InputError: the table has columns of more joints, or lacks one.
        """
        table = _table(source)
        header = table.header
        if extra := [name for name in header if name.startswith(f"q{joints + 1}_")]:
            raise InputError(f"{source}: column {extra[0]!r}: this robot has only {joints} joints")
        columns, places = Columns.of_file(table), []
        decimals = {"_deg": 7, "_rad": 9, "_mm": 6, "_m": 9}  # some nanometres at the tool
        for i, unit in enumerate(given.units or ("rad",) * joints, 1):
            allowed = {"_deg": RAD_PER_DEG, "_rad": 1.0} if unit == "rad" else {"_mm": M_PER_MM, "_m": 1.0}
            columns.si(f"q{i}", tuple(allowed))
            suffix = next(u for u in allowed if f"q{i}{u}" in header)
            places.append((header.index(f"q{i}{suffix}"), allowed[suffix], decimals[suffix]))
        return [
            Target(line, "", True, tuple(Number(k, at, cells[at], unit, digits) for at, unit, digits in places))
            for k, (line, cells) in enumerate(zip(table.line, table.cells, strict=True))
        ]

    def written(self, source: str, text: str, results: Sequence[Any]) -> bytes:
        """Return the table's bytes with new joint values and a column of statuses.

        source : path of the table, which is read again; results : corrected targets, one per row
        """
        table = _table(source)
        rows = [[*table.header, STATUS_COLUMN]]
        for cells, r in zip(map(list, table.cells), results, strict=True):
            for number, new in zip(r.target.numbers, r.texts, strict=False):
                cells[number.stop] = new
            rows.append([*cells, r.status])
        return csv_text(rows).encode()

    def matrix(self, values: Array) -> NoReturn:
        """Refuse numbers of a pose. Raises InputError, as a table holds none."""
        raise InputError(f"a CSV holds {self.pose}")

    def values(self, T: Array, like: Array) -> NoReturn:
        """Refuse a pose. Raises InputError, as a table holds none."""
        raise InputError(f"a CSV holds {self.pose}")


def _table(path: str) -> RawTable:
    """Return a table of joint targets."""
    table = read_table(path)
    if table.form.separator != "," or table.form.sheet:
        form = "a workbook" if table.form.sheet else f"separated by {table.form.separator!r}"
        raise InputError(f"{path}: is {form}; a program is read and written with commas and decimal points, as CSV")
    if STATUS_COLUMN in map(str.casefold, table.header):
        raise InputError(
            f"{path}: column {STATUS_COLUMN!r} is there already: this program was corrected "
            "before; correct the original"
        )
    for number, cells in zip(table.line, table.cells, strict=True):
        if len(cells) != len(table.header):
            raise InputError(
                f"{path}: row {number} has {len(cells)} cells, the header {len(table.header)}; correct the row"
            )
    return table
