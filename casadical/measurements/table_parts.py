"""A large table of text, read some lines at a time: as text it takes twenty times the memory of its numbers."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from casadical.core.errors import InputError
from casadical.measurements.raw_table import RawTable, read_table, table_of
from casadical.measurements.table_form import decoded, records_of, separator_of

# Characters that are read at a time; a text of fewer is read at once.
SIZE = 4_000_000
# Characters from which separator and decimal sign are told.
SAMPLE = 100_000


def read_columns(path: str | Path) -> RawTable:
    """As `read_table`, for those who want the columns: of a large table only the first rows are kept as text.

    The rows behind these stand in `rest`. A table with quoted cells or in a workbook is read at once.
    Raises InputError as `read_table` does.
    """
    path = Path(path)
    if not path.is_file() or path.stat().st_size <= SIZE:
        return read_table(path)
    data = path.read_bytes()
    try:
        text, encoding = decoded(data)
    except UnicodeDecodeError:
        return read_table(path)
    del data
    if '"' in text or "\0" in text[:SAMPLE] or text.startswith("PK\x03\x04"):
        return read_table(path)
    separator = separator_of(text[:SAMPLE])
    parts = _parts(text)
    _, start = next(parts)
    first = table_of(path, records_of(start, separator), encoding, separator)
    return replace(first, rest=tuple((t.frame(), np.array(t.line)) for t in _others(first, parts)))


def _others(first: RawTable, parts: Iterator[tuple[int, str]]) -> Iterator[RawTable]:
    """The tables of further lines, under the headings of the first ones."""
    form = first.form
    head = [(form.header_line, list(first.header))] if form.header_line else []
    for before, text in parts:
        records = [(before + line, cells) for line, cells in records_of(text, form.separator)]
        if records:
            found = table_of(first.path, [*head, *records], form.encoding, form.separator, form.decimal)
            if found.header != first.header:
                raise InputError(
                    f"{first.path}: other columns from row {before + 1} on: {', '.join(found.header)}; "
                    f"before: {', '.join(first.header)}; give one file to each"
                )
            yield found


def _parts(text: str) -> Iterator[tuple[int, str]]:
    """Some lines at a time, and how many are before them."""
    start = lines = 0
    while start < len(text):
        end = text.find("\n", min(start + SIZE, len(text) - 1)) + 1 or len(text)
        yield lines, text[start:end]
        lines, start = lines + text.count("\n", start, end), end
