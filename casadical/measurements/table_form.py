"""How a text file writes its table: encoding, separator, decimal sign, comments, line of the headings, row of units.

Nothing is asked of the user here. What the text does not show (units, meaning of the columns) is left to
`casadical.measurements.headings`.
"""

import codecs
import csv
import io
import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from casadical.measurements.vocabulary import UNITS, hits

SEPARATORS = (",", ";", "\t", "|", " ")
COMMENTS = ("#", "//", "%", "!")
_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
# A number of more characters is cut to those of a double; a whole one would else be no number of an array.
MOST_FIGURES = 40
# So many lines are looked at to tell how a table is written, within so many characters, comments included.
SAMPLE, MOST_LOOKED = 200, 1_000_000
_POINT = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)
_COMMA = re.compile(r"[+-]?(\d*,\d+|\d{1,3}(\.\d{3})+,\d+)(e[+-]?\d+)?", re.IGNORECASE)
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d+)?")

Record = tuple[int, list[str]]


@dataclass(frozen=True)
class Form:
    """How a table is written.

    encoding, separator, decimal : of the text; header_line : line of the file with the headings, 0 where there is none
    units : of each column, from a row of units below the headings; empty without one
    skipped : lines that are no rows of the table (comments, titles, repeated headings), with their text
    sheet : of a workbook
    """

    encoding: str = "utf-8"
    separator: str = ","
    decimal: str = "."
    header_line: int = 1
    units: tuple[str, ...] = ()
    skipped: tuple[tuple[int, str], ...] = ()
    sheet: str = ""

    @property
    def words(self) -> str:
        """In one line."""
        separators = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks", "|": "vertical bars"}
        parts = [f"sheet {self.sheet!r}"] if self.sheet else [self.encoding, separators[self.separator]]
        if not self.sheet:
            parts.append("decimal commas" if self.decimal == "," else "decimal points")
        parts.append(f"headings in line {self.header_line}" if self.header_line else "no headings")
        if self.units:
            parts.append("a row of units")
        if self.skipped:
            parts.append(f"{len(self.skipped)} other line{'s' if len(self.skipped) > 1 else ''} skipped")
        return ", ".join(parts)


def decoded(data: bytes) -> tuple[str, str]:
    """Return the text of a file and its encoding. Raises UnicodeDecodeError where none fits.

    A text that is not Unicode is read in the encoding that finds most known headings. (charset-normalizer
    takes "q1 [°]" in cp1252 for big5: it needs longer texts than headings are.)
    """
    name = next((name for mark, name in _MARKS.items() if data.startswith(mark)), "utf-8")
    if name == "utf-8" and b"\0" in data[:1000]:
        name = "utf-16-le" if data[1:1000:2].count(0) > data[0:1000:2].count(0) else "utf-16-be"
    try:
        return data.decode(name), name.removesuffix("-sig")
    except UnicodeDecodeError:
        heads = {}
        others = ("cp1252", "cp932", "gb18030", "big5", "euc_jp", "cp1250")
        for other in others if name == "utf-8" else ():
            with suppress(UnicodeDecodeError):
                heads[other] = data.decode(other)[:20_000]
        if not heads:
            raise
    name = max(heads, key=lambda name: hits(heads[name]))
    return data.decode(name), name


def records_of(text: str, separator: str) -> list[Record]:
    """Cells of every line that is not blank, with its number; a quoted cell may go over several lines.

    Raises csv.Error, with its row, for a quote that is never closed.
    """
    if separator == " ":
        return [(k, line.split()) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    loose = separator != "\t"  # csv counts tabs as blanks
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=separator, skipinitialspace=loose)
    records, line = [], 1
    try:
        for cells in reader:
            if len(cells) > 1 or any(cell.strip() for cell in cells):
                records.append((line, cells))
            line = reader.line_num + 1
    except csv.Error as error:
        raise csv.Error(f"row {line}: {error}; correct its quotes, and where its cells end") from None
    return records


def clean(cell: str) -> str:
    """A cell without blanks around it, its digits and signs as in ASCII."""
    return cell.strip() if cell.isascii() else unicodedata.normalize("NFKC", cell).replace("−", "-").strip()


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or a decimal comma."""
    text = clean(cell)
    return bool(_POINT.fullmatch(text) or _COMMA.fullmatch(text) or _THOUSANDS.fullmatch(text))


def separator_of(text: str) -> str:
    """The separator with which most cells are numbers in rows of one width; of a text without rows, of its headings."""
    if len(text) > MOST_LOOKED:
        text = text[:MOST_LOOKED].rpartition("\n")[0] or text
    sample = "\n".join(line for line in text.splitlines() if not line.startswith(COMMENTS))
    lines = sample.splitlines()[:SAMPLE]
    best, most = ",", 0
    for separator in SEPARATORS:
        try:
            rows = [cells for _, cells in records_of("\n".join(lines), separator)]
        except csv.Error:
            continue
        numeric = [(len(cells), sum(map(is_number, cells))) for cells in rows]
        widths = Counter(width for width, numbers in numeric if width > 1 and numbers > 1)
        if not widths:
            continue
        width = widths.most_common(1)[0][0]
        count = sum(numbers for w, numbers in numeric if w == width)
        # Blanks stand in words too.
        if count > most * (2 if separator == " " else 1):
            best, most = separator, count
    if not most and lines:
        return max(SEPARATORS[:4], key=lines[0].count)
    return best


def decimal_of(rows: Sequence[Record]) -> str:
    """ "," where numbers have decimal commas, else "."; thousands may be set off by the other one."""
    cells = [clean(cell) for _, row in rows[:SAMPLE] for cell in row if "," in cell]
    commas = [c for c in cells if _COMMA.fullmatch(c)]
    return "," if commas and not any("." in c and _THOUSANDS.fullmatch(c) for c in cells) else "."


def as_plain_number(cell: str, decimal: str) -> str:
    """A number with a decimal point and nothing else; a cell that is no number as it stands."""
    if len(cell) < MOST_FIGURES and _POINT.fullmatch(cell):
        return cell
    text = clean(cell)
    if decimal == "," and _COMMA.fullmatch(text):
        text = text.replace(".", "").replace(",", ".")
    elif decimal == "." and "," in text and _THOUSANDS.fullmatch(text):
        text = text.replace(",", "")
    elif not _POINT.fullmatch(text):
        return cell
    return text if len(text) < MOST_FIGURES else repr(float(text))


def is_data(cells: Sequence[str]) -> bool:
    """Whether at least half of the cells that are filled are numbers."""
    filled = [cell for cell in cells if cell.strip()]
    return len(filled) > 1 and 2 * sum(map(is_number, filled)) >= len(filled)


def is_units(cells: Sequence[str]) -> bool:
    """Whether the cells are units and nothing else."""
    filled = [unit_word(cell) for cell in cells if cell.strip()]
    return any(word in UNITS for word in filled) and all(word in UNITS or word in ("", "-") for word in filled)


def unit_word(cell: str) -> str:
    """A unit without brackets, in lower case."""
    return clean(cell).strip("[](){}<>【】").strip().casefold()


def commented(cells: Sequence[str]) -> bool:
    """Whether a record is a comment."""
    return bool(cells) and cells[0].lstrip().startswith(COMMENTS)
