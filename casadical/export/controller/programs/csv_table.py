"""Program language of CSV tables of joint targets: columns of joints change, other cells stay.

A reader of its own knows encodings and separators; the text of the file is not used.
"""

import re
from collections.abc import Sequence
from typing import Any

from casadical.core.basics import M_PER_MM, InputError
from casadical.core.files import csv_text
from casadical.export.controller.programs.language import ProgramLanguage
from casadical.export.controller.programs.target import RAD_PER_DEG, Given, Number, Target
from casadical.measurements.columns import Columns
from casadical.measurements.headings import headings_of, words_of
from casadical.measurements.raw_table import RawTable, read_table
from casadical.measurements.vocabulary import UNITS, WORDS

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

        Raises InputError: the table has columns of more joints, lacks one, or has two for one.
        """
        table = _table(source)
        found: dict[str, str] = {}
        # Other headings are read only where none is ours, and only with their unit, which stays.
        ours = any(re.match(r"q\d+_", name) for name in table.header)
        for h in () if ours else headings_of(table, ()):
            unit, factor = UNITS.get(words_of(h.name)[1], ("", 0.0))
            is_target = h.quantity == "joint" and h.rest <= WORDS["joint"] and factor == 1.0
            if is_target and found.setdefault(name := f"q{h.slot}_{unit}", h.name) != h.name:
                raise InputError(f"{source}: columns {found[name]!r}, {h.name!r} say the same; keep one")
        columns, units = Columns.of_file(table).mapped(found), given.units or ("rad",) * joints
        columns.joints(["revolute" if unit == "rad" else "prismatic" for unit in units])
        # Factor to SI of each unit, and decimals, which are some nanometres at the tool.
        forms = {"deg": (RAD_PER_DEG, 7), "rad": (1.0, 9), "mm": (M_PER_MM, 6), "m": (1.0, 9)}
        places: list[tuple[int, float, int]] = []
        for i, unit in enumerate(units, 1):
            allowed = ("deg", "rad") if unit == "rad" else ("mm", "m")
            name, u = next((name, u) for u in allowed if (name := f"q{i}_{u}") in columns.table)
            places.append((table.header.index(found.get(name, name)), *forms[u]))
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
