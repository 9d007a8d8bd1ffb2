"""The reader of CSV files: the content of a file, checked for its form only, not for the meaning of its columns."""

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from casadical.core.errors import InputError


@dataclass(frozen=True, eq=False)
class RawTable:
    """A table as it stands in a file.

    path : of the file; text : all of it
    header : names of the columns, without blanks around them
    cells : of each row, as text; line : of the file at which each row begins, the header being line 1
    """

    path: Path
    text: str
    header: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]
    line: tuple[int, ...]

    def frame(self) -> pd.DataFrame:
        """The rows as a pandas table: numbers where a column holds nothing else, columns named as in `header`."""
        rows = io.StringIO(newline="")
        csv.writer(rows).writerows([self.header, *self.cells])
        rows.seek(0)
        return pd.read_csv(rows)


def read_table(path: str | Path) -> RawTable:
    """A CSV file in UTF-8 with commas, decimal points and a header; blank lines are skipped.

    Raises InputError that names the file, and the row where one is wrong: no such file, not a text file, other
    separators, a name twice in the header, no rows, or a row with more cells than the header.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8-sig")
        records = _records(text)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: not a readable CSV table: {getattr(error, 'strerror', None) or error}") from None
    if not records:
        raise InputError(f"{path}: not a readable CSV table: it is empty; a header and at least one row are needed")
    header = tuple(name.strip() for name in records[0][1])
    if len(header) == 1 and (";" in header[0] or "\t" in header[0]):
        raise InputError(f"{path}: its columns are separated by ';' or tabs; allowed: commas, with decimal points")
    refuse_repeated_names(header, str(path))
    for line, cells in records[1:]:
        if len(cells) > len(header):
            sizes = f"row {line} has {len(cells)} cells, the header {len(header)}"
            raise InputError(f"{path}: not a readable CSV table: {sizes}; correct the row")
    if len(records) == 1:
        raise InputError(f"{path}: a header but no rows; at least one row is needed")
    return RawTable(
        path, text, header, tuple(tuple(cells) for _, cells in records[1:]), tuple(line for line, _ in records[1:])
    )


def _records(text: str) -> list[tuple[int, list[str]]]:
    """Cells of every line that is not blank, with its number; a quoted cell may go over several lines."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    found, line = [], 1
    for cells in reader:
        if len(cells) > 1 or any(cell.strip() for cell in cells):
            found.append((line, cells))
        line = reader.line_num + 1
    return found


def refuse_repeated_names(names: Iterable[str], source: str) -> None:
    """Raises InputError where two columns have the same name; those without one are left out."""
    seen: set[str] = set()
    for name in names:
        if name and name in seen:
            raise InputError(f"{source}: column {name!r} is there twice; keep one")
        seen.add(name)
