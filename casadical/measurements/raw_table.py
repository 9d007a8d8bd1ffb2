"""Reader of table files: the content as text and numbers.

Only the form is checked here (size, headings, cells per row), not the meaning of the columns.
"""

import csv
import io
import re
import zipfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from casadical.core import reading
from casadical.core.basics import Array, InputError, optional
from casadical.measurements import table_form
from casadical.measurements.array_files import ARRAY_FILES, table_of_arrays

# Maximum number of columns; more show that the file is no table of measurements.
MAX_COLUMNS = 2000


@dataclass(frozen=True, eq=False)
class RawTable:
    """A table as it stands in a file.

    path : of the file
    header : names of the columns, without blanks around them
    cells : text of each row's cells, numbers with decimal points; empty if it was not asked for
    frame : the rows, numbers where a column holds nothing else
    line : line of the file at which each row begins
    form : how the file writes its table
    comments : lines that are comments, unchanged
    said : sentences on how the table was rearranged; empty if it is as in the file
    """

    path: Path
    header: tuple[str, ...]
    cells: Sequence[Sequence[str]]
    frame: pd.DataFrame
    line: Sequence[int] | Array
    form: table_form.Form = field(default_factory=table_form.Form)
    comments: tuple[str, ...] = ()
    said: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _refuse_header(self.header, self.path)


def _refuse_header(header: Sequence[str], path: Path) -> None:
    """Check the headings. Raises InputError: too many, too long, or control characters in one."""
    if len(header) > MAX_COLUMNS:
        raise InputError(f"{path}: has {len(header)} columns; at most {MAX_COLUMNS} are read")
    # Maximum length of a heading [characters]; a longer one shows that the file is no table.
    max_heading_characters = 1000
    for k, name in enumerate(header, 1):
        if len(name) > max_heading_characters:
            raise InputError(
                f"{path}: the heading of column {k} has {len(name)} characters, {name[:30]!r}...; "
                f"allowed: up to {max_heading_characters}; is it a table?"
            )
        if fault := reading.text_fault(name):
            raise InputError(f"{path}: the heading of column {k} {fault}")


def read_table(path: str | Path, data: bytes | None = None, *, keep_text: bool = True) -> RawTable:
    """Return the table in a file: text in any usual form, .xlsx, .parquet, or one of ARRAY_FILES.

    Reading .xlsx needs openpyxl, reading .parquet pyarrow. The file may be gzipped. Comments,
    titles above the headings, a row of units, repeated headings and blank lines are no rows.

    data : content of the file, if it was read already
    keep_text : whether the text of the cells is needed; without it, plain numbers under one line of
        headings are read in a tenth of the time
    Raises InputError that names the file, and the row where one is wrong: no such file, neither
    text nor a workbook, a name twice in the header, no rows, too many numbers, or a row with more
    cells than the header.
    """
    path = Path(path)
    packed = reading.read_bytes(path) if data is None else data
    if path.suffix.lower() == ".parquet":
        raw = _parquet(path, packed)
        return replace(raw, cells=_texts(raw.frame)) if keep_text else raw
    data = reading.unpacked(packed, str(path))
    if path.suffix.lower() in ARRAY_FILES:
        table, said = table_of_arrays(path, data)
        refuse_many(path, table.size)
        named = not all(str(name).startswith("column ") for name in table)
        form = table_form.Form(path.suffix.lower()[1:], header_line=int(named))
        cells, lines = _texts(table) if keep_text else (), np.arange(len(table)) + 1
        return RawTable(path, tuple(map(str, table)), cells, table, lines, form, said=(said,))
    if not keep_text and (plain := _plain(path, data)) is not None:
        return plain
    sheet = ""
    try:
        if data.startswith(b"PK\x03\x04"):
            text, encoding, sheet = _sheet(path, data)
        elif data.startswith(b"\xd0\xcf\x11\xe0"):
            raise InputError(f"{path}: a workbook of the old format; save it as .xlsx or as CSV")
        else:
            text, encoding = table_form.decoded(data)
        separator = "," if sheet else table_form.separator_of(text)
        if not sheet:  # a text that is split takes 200 bytes for each number
            numbers = text.count(separator) + max(text.count("\n"), text.count("\r"))
            refuse_many(path, numbers, 10_000_000, "; of plain numbers under one line of headings more are read")
        records = table_form.records_of(text, separator)
    except UnicodeDecodeError as error:
        if b"\0" in data[:1000] and error.encoding.startswith("utf-16"):
            what = f"a {path.suffix} file" if path.suffix.lower() not in ("", ".csv", ".txt") else "a binary file"
            raise InputError(
                f"{path}: not a readable CSV table: {what}; save it as CSV, .xlsx, .mat, .npy or Parquet"
            ) from None
        row = error.object.count(b"\n", 0, error.start) + 1
        why = f"row {row} is no text in {error.encoding}; save it as UTF-8"
        raise InputError(f"{path}: not a readable CSV table: {why}") from None
    except csv.Error as error:
        raise InputError(f"{path}: not a readable CSV table: {error}") from None
    return _table_of(path, records, encoding, separator, sheet)


def _texts(frame: pd.DataFrame) -> list[list[str]]:
    """Return the text of each row's cells of a table without text; "" where a value is missing."""
    cells: list[list[str]] = frame.astype(object).where(frame.notna(), "").astype(str).to_numpy().tolist()
    return cells


def refuse_many(path: str | Path, numbers: int, most: int = reading.MAX_TABLE_NUMBERS, remedy: str = "") -> None:
    """Refuse a table that is too large for memory.

    numbers : of the table, rows times columns; remedy : end of the message
    Raises InputError: more numbers than `most`.
    """
    if numbers > most:
        raise InputError(f"{path}: has more than {most} numbers; split it, or leave columns and rows out{remedy}")


def plain_headings(line: bytes) -> tuple[str, ...]:
    """Return the headings in a line of ASCII text with commas and without quotes; else ()."""
    named = re.sub(rb"[^A-Za-z]*", b"", line, count=1)
    usual = line.isascii() and b"," in named.strip() and not re.search(rb"[\n\"]", line.strip())
    return tuple(word.strip() for word in line.decode().split(",")) if usual else ()


def _plain(path: Path, data: bytes) -> RawTable | None:
    """Return a table of plain numbers under one line of headings; None for any other text."""
    header = plain_headings(data[: data.find(b"\n") + 1])
    blank = b"\n\n" in data or b"\n\r" in data or b"\r\r" in data  # rows are counted by their lines
    if not (all(header) and 0 < len(header) == len({*header}) <= MAX_COLUMNS) or blank:
        return None
    if table_form.commented(header) or any(map(table_form.is_number, header)):
        return None
    refuse_many(path, data.count(b",") + data.count(b"\n"))
    try:
        frame = pd.read_csv(io.BytesIO(data), skipinitialspace=True, low_memory=False)
    except ValueError:
        return None
    numeric = len(frame) and all(map(pd.api.types.is_numeric_dtype, frame.dtypes))
    if not numeric or frame.shape[1] != len(header) or not isinstance(frame.index, pd.RangeIndex):
        return None
    return RawTable(path, header, (), frame.set_axis(header, axis=1), np.arange(len(frame)) + 2)


def _parquet(path: Path, data: bytes) -> RawTable:
    """Return the table of a Parquet file, its rows numbered as in a text file, from 2 on."""
    parquet = optional("pyarrow.parquet", f"{path}: reading Parquet needs pyarrow: pip install 'casadical[logs]'")
    with (
        reading.foreign(f"{path}: not a readable table", "write it again"),
        parquet.ParquetFile(io.BytesIO(data)) as file,
    ):
        refuse_many(path, file.metadata.num_rows * len(file.schema_arrow.names))
        table = file.read()
        refuse_many(path, table.nbytes // 8)  # lists and texts, too
        table.validate(full=True)  # else pandas finds texts that are none where they are looked at
        header = tuple(str(name).strip() for name in table.column_names)
        refuse_repeated_names(header, str(path))
        frame = table.to_pandas(ignore_metadata=True).set_axis(header, axis=1)
    if not len(frame):
        raise InputError(f"{path}: no rows; at least one is needed")
    return RawTable(path, header, (), frame, np.arange(len(frame)) + 2, table_form.Form("parquet"))


def _sheet(path: Path, data: bytes) -> tuple[str, str, str]:
    """Return a workbook's sheet with the most numbers: its CSV text, "workbook", and its name.

    The lines of the CSV are the rows of the sheet.
    """
    needed = f"{path}: reading .xlsx needs openpyxl: pip install 'casadical[xlsx]', or save it as CSV"
    openpyxl = optional("openpyxl", needed)
    content, best, cells = reading.archive_of(data, str(path)), ("", "", -1), 0
    with reading.foreign(f"{path}: not a readable workbook"):
        with zipfile.ZipFile(content) as archive:  # openpyxl reads a sheet to its end before it gives the first row
            for name in archive.namelist():
                if name.endswith(".xml"):
                    _refuse_cells(path, len(re.findall(rb"<(?:\w+:)?(?:row|c)[\s/>]", archive.read(name))))
        for sheet in openpyxl.load_workbook(content, read_only=True, data_only=True).worksheets:
            sheet.reset_dimensions()  # the size that a sheet declares may be wrong
            out, numbers = io.StringIO(newline=""), 0
            rows = csv.writer(out)
            for row in sheet.iter_rows(values_only=True):
                cells += 1 + len(row)
                _refuse_cells(path, cells)
                numbers += sum(isinstance(value, int | float) for value in row)
                rows.writerow(map(_cell, row))
            best = max(best, (out.getvalue(), str(sheet.title), numbers), key=lambda sheet: sheet[2])
    return best[0], "workbook", best[1]


def _refuse_cells(path: Path, cells: int) -> None:
    """Check the number of cells of a workbook. Raises InputError: too many."""
    if cells > reading.MAX_WORKBOOK_CELLS:
        raise InputError(f"{path}: has more than {reading.MAX_WORKBOOK_CELLS} cells; save what was measured as CSV")


def _cell(value: Any) -> str:
    """Return the value of a workbook's cell as text; that of a formula that failed is empty."""
    if value is None or value in ("#NULL!", "#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#NUM!", "#N/A"):
        return ""
    return " ".join(str(int(value) if isinstance(value, float) and value.is_integer() else value).split())


def _table_of(path: Path, records: list[table_form.Record], encoding: str, separator: str, sheet: str) -> RawTable:
    """Return the table in the records (lines as cells) of a text."""
    if not records:
        raise InputError(f"{path}: not a readable CSV table: it is empty; a header and at least one row are needed")
    comments = [(line, cells) for line, cells in records if table_form.commented(cells)]
    rest = [record for record in records if not table_form.commented(record[1])]
    decimal = table_form.decimal_of(rest)
    if not rest:
        rest, comments = comments, []
    place, header, units = _headings(rest, comments)
    body = rest[place:]
    head_line = 0 if header is None else header[0]
    width = max(len(cells) for _, cells in body) if body else 0
    given = [f"column {k}" for k in range(1, width + 1)] if header is None else header[1]
    names = tuple(name.replace("\ufeff", "").strip() for name in given)  # pandas drops a mark of the byte order, too
    names = _made_unique(names)
    _refuse_header(names, path)
    refuse_repeated_names(names, str(path))
    skipped = [r for r in [*comments, *rest[:place]] if r is not header and not (units and r[1] is units[1])]
    rows = []
    last = next((k for k in reversed(range(len(body))) if table_form.is_data(body[k][1])), len(body) - 1)
    for k, (line, cells) in enumerate(body):
        few = k > last and sum(bool(cell.strip()) for cell in cells) < 2 and len(names) > 1
        if few or (cells[0].strip() == names[0] and tuple(c.strip() for c in cells) == names):
            skipped.append((line, cells))
        else:
            rows.append((line, cells))
    spare = {len(cells) - len(names) for _, cells in rows}
    if len(rows) > 1 and len(spare) == 1 and not any("".join(cells[len(names) :]).strip() for _, cells in rows):
        rows = [(line, cells[: len(names)]) for line, cells in rows]
    firsts = [cells[0] for _, cells in rows if not re.search(r"\d[.,]\d", cells[0])]
    if spare == {1} and len({*firsts}) == len(rows) > 1:  # numbers of the rows, without a heading
        names = ("", *names)
    for line, cells in rows:
        if len(cells) > len(names):
            sizes = f"row {line} has {len(cells)} cells, the header {len(names)}"
            raise InputError(f"{path}: not a readable CSV table: {sizes}; correct the row")
    if not rows:
        raise InputError(f"{path}: a header but no rows; at least one row is needed")
    form = table_form.Form(
        encoding,
        separator,
        decimal,
        header_line=head_line,
        sheet=sheet,
        units=tuple(map(table_form.unit_word, units[1])) if units else (),
        skipped=tuple((line, " ".join(" ".join(cells).split())[:80]) for line, cells in sorted(skipped)),
    )
    text = io.StringIO(newline="")
    plain = [[table_form.as_plain_number(cell, decimal) if cell else cell for cell in cells] for _, cells in rows]
    csv.writer(text).writerows([names, *plain])
    text.seek(0)
    lines, said = tuple(line for line, _ in rows), tuple(" ".join(cells) for _, cells in comments)
    return RawTable(path, names, plain, pd.read_csv(text, low_memory=False), lines, form, said)


def _headings(
    rest: list[table_form.Record], comments: list[table_form.Record]
) -> tuple[int, table_form.Record | None, table_form.Record | None]:
    """Return the index in `rest` of the table's first row, and the records of headings and units.

    A record is None where there are no headings or no row of units.
    """
    first = next((k for k, (_, cells) in enumerate(rest) if table_form.is_data(cells)), None)
    if first is None:  # rows of words, lists and single numbers
        some = (k for k, (_, row) in enumerate(rest) if any(re.match(r"[-+]?\d|[\[(].*\d.*,", c.strip()) for c in row))
        first = next(some, 0)
        if not first:
            return 1, rest[0], None
    if first == 0:
        # SpatialAnalyzer and numpy write the headings into the last comment above the rows.
        width, line = len(rest[0][1]), rest[0][0]
        above = []
        for k, cells in comments:
            bare = re.sub(r"^(#|//|%|!)+", "", cells[0].lstrip())
            if k < line:
                above.append((k, [bare, *cells[1:]] if bare.strip() else cells[1:]))
        named = [record for record in above if len(record[1]) == width > 1]
        if not named:
            return 0, None, None
        if len(named) > 1 and table_form.is_units(named[-1][1]):
            return 0, named[-2], named[-1]
        return 0, named[-1], None
    above = rest[:first]
    # Cells of each line that are words, not numbers; none in a row of units.
    words = [
        0 if table_form.is_units(cells) else sum(bool(c.strip()) and not table_form.is_number(c) for c in cells)
        for _, cells in above
    ]
    place = max(range(first), key=lambda k: (words[k], -k))
    header, units = above[place], None
    after = place + 1
    if after < first and table_form.is_units(above[after][1]):
        units, after = above[after], after + 1
    if place and len(set(header[1])) < len([c for c in header[1] if c.strip()]):
        lines = [cells for _, cells in above[:place] if sum(bool(c.strip()) for c in cells) > 1]
        header = (header[0], _grouped(lines, header[1]))
    return after, header, units


def _grouped(lines: Sequence[Sequence[str]], names: Sequence[str]) -> list[str]:
    """Return headings that occur twice, and others of their groups, preceded by the groups'."""
    groups = [""] * len(names)
    again = [k for k, name in enumerate(names) if name.strip() and list(names).count(name) > 1]
    for cells in lines:
        given = [cells[k].strip() if k < len(cells) else "" for k in range(len(names))]
        each = any(a and a == b for a, b in pairwise(given))  # over each column, then gaps have none
        group, found = "", []
        for cell in given:
            group = cell or ("" if each else group)
            found.append(group)
        further = [f"{before} {own}".strip() for before, own in zip(groups, found, strict=True)]
        several = min(Counter(found[k] for k in again).values()) > 1  # columns in each of its groups
        if several and len({groups[k] for k in again}) < len({further[k] for k in again}):
            groups = further
    twice = {groups[k] for k in again}
    whole = zip(groups, names, strict=True)
    return [f"{g} {name.strip()}".strip() if name.strip() and g in twice else name for g, name in whole]


def _made_unique(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return headings of which three or more occur equally often, with "2 " before second ones.

    Several targets side by side may all be headed X, Y, Z; other repeated headings stay.
    """
    counts = {name: n for name, n in Counter(names).items() if name and n > 1}
    if len(counts) < 3 or len({*counts.values()}) > 1:
        return names
    place = {(name, k): i + 1 for name in counts for i, k in enumerate(k for k, n in enumerate(names) if n == name)}
    return tuple(f"{place[n, k]} {n}" if place.get((n, k), 1) > 1 else n for k, n in enumerate(names))


def refuse_repeated_names(names: Iterable[str], source: str) -> None:
    """Check that no two columns have the same name; empty names may repeat. Raises InputError."""
    seen: set[str] = set()
    for name in names:
        if name and name in seen:
            raise InputError(f"{source}: column {name!r} is there twice; keep one")
        seen.add(name)
