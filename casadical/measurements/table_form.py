"""Form of a text table: encoding, separator, decimal sign, comments, headings and row of units.

The form is recognised from the text alone, without questions to the user. What the text does not
show (units, meaning of the columns) is decided in `casadical.measurements.proposals`.
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

# Beginnings of lines that are comments.
COMMENTS = ("#", "//", "%", "!")
# Maximum number of lines from which separator (without comments) and decimal sign are recognised.
SAMPLE_LINES = 200
# Pattern of a number with a decimal point.
_POINT_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)
# Pattern of a number with a decimal comma.
_COMMA_NUMBER = re.compile(r"[+-]?(\d*,\d+|\d{1,3}(\.\d{3})+,\d+)(e[+-]?\d+)?", re.IGNORECASE)
# Pattern of a number with commas between thousands.
_THOUSANDS_NUMBER = re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d+)?")

# Number of a line in the file, from 1, and its cells.
Record = tuple[int, list[str]]


@dataclass(frozen=True)
class Form:
    """How a file writes its table.

    encoding, separator, decimal : of the text; encoding may be the kind of another file, "parquet"
    header_line : line of the file with the headings, 0 where there is none
    units : unit of each column, from a row of units below the headings; empty without one
    skipped : lines that are no rows of the table (comments, titles, repeated headings), with their
        text
    sheet : name of a workbook's sheet
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
        """The form as one line of text: encoding, separator, decimal sign, headings."""
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
    """Return the text of a file and its encoding. Raises UnicodeDecodeError: no encoding fits.

    A text that is not Unicode is read in the encoding that finds most recognised words of headings.
    charset-normalizer is not used: it takes "q1 [°]" in cp1252 for big5, because it needs longer
    texts.
    """
    # Byte order mark at the beginning of a file -> its encoding.
    byte_order_marks = {codecs.BOM_UTF8: "utf-8-sig"}
    byte_order_marks |= dict.fromkeys((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE), "utf-32")
    byte_order_marks |= dict.fromkeys((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE), "utf-16")
    name = next((name for mark, name in byte_order_marks.items() if data.startswith(mark)), "utf-8")
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
    """Return line number and cells of every line that is not blank.

    A record with quoted cells may span several lines; its number is that of the first. Raises
    csv.Error, with its row, for a quote that is never closed.
    """
    if separator == " ":
        return [(k, line.split()) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    loose = separator != "\t"  # initial blanks of a cell are skipped, except between tabs
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
    """Return a cell without blanks around it, its digits and signs in ASCII; of ="..." the text."""
    if cell.lstrip().startswith('="'):
        cell = cell.strip()[2:].removesuffix('"')
    return cell.strip() if cell.isascii() else unicodedata.normalize("NFKC", cell).replace("−", "-").strip()


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, with decimal point or comma, or commas at thousands."""
    text = clean(cell)
    return bool(_POINT_NUMBER.fullmatch(text) or _COMMA_NUMBER.fullmatch(text) or _THOUSANDS_NUMBER.fullmatch(text))


def separator_of(text: str) -> str:
    """Return the separator of a text's cells: that which gives the most numbers in equal rows.

    For a text without rows it is the most frequent separator of the first line.
    """
    # Maximum number of characters, with comments, from which the separator is recognised.
    max_sample_characters = 1_000_000
    if len(text) > max_sample_characters:
        text = text[:max_sample_characters].rpartition("\n")[0] or text
    sample = "\n".join(line for line in text.splitlines() if not line.startswith(COMMENTS))
    # A list in one cell is one number, whatever separates its own.
    lines = sample.splitlines()[:SAMPLE_LINES]
    for pattern in (r"[\[(][^\[\]]*[\])]", r"array\([^()]*\)"):
        lines = [re.sub(pattern, "0", line) for line in lines]
    # Separators of cells that are tried, in this order.
    separators_tried = (",", ";", "\t", "|", " ")
    best, most = ",", (0, 0)
    for separator in separators_tried:
        try:
            rows = [cells for _, cells in records_of("\n".join(lines), separator)]
        except csv.Error:
            continue
        numeric = [(len(cells), sum(all(map(is_number, c.split() or [""])) for c in cells)) for cells in rows]
        widths = Counter(width for width, numbers in numeric if width > 1 and numbers > (separator == " "))
        if not widths:
            continue
        width = widths.most_common(1)[0][0]
        count = sum(numbers for w, numbers in numeric if w == width)
        # Blanks also separate words, so they must win clearly; of equally many numbers more cells do.
        if (count, width) > (most[0] * (2 if separator == " " else 1), most[1]):
            best, most = separator, (count, width)
    if not most[0] and lines:
        return max(separators_tried[:4], key=lines[0].count)
    return best


def decimal_of(rows: Sequence[Record]) -> str:
    """Return the decimal sign of the numbers in rows, "," or "."; the other separates thousands."""
    cells = [clean(cell) for _, row in rows[:SAMPLE_LINES] for cell in row if "," in cell]
    commas = [c for c in cells if _COMMA_NUMBER.fullmatch(c)]
    return "," if commas and not any("." in c and _THOUSANDS_NUMBER.fullmatch(c) for c in cells) else "."


def as_plain_number(cell: str, decimal: str) -> str:
    """Return a cell that is a number with a decimal point and no separators; others unchanged.

    decimal : decimal sign of the table, "." or ","
    """
    # Length of a number [characters] from which on it is rounded to a double, as pandas reads
    # longer whole numbers as Python objects.
    max_number_characters = 40
    if len(cell) < max_number_characters and _POINT_NUMBER.fullmatch(cell):
        return cell
    text = clean(cell)
    if decimal == "," and _COMMA_NUMBER.fullmatch(text):
        text = text.replace(".", "").replace(",", ".")
    elif decimal == "." and "," in text and _THOUSANDS_NUMBER.fullmatch(text):
        text = text.replace(",", "")
    elif not _POINT_NUMBER.fullmatch(text):
        return cell
    return text if len(text) < max_number_characters else repr(float(text))


def is_data(cells: Sequence[str]) -> bool:
    """Return whether at least half of a line's filled cells, two or more, are numbers."""
    filled = [cell for cell in cells if cell.strip()]
    return len(filled) > 1 and 2 * sum(map(is_number, filled)) >= len(filled)


def is_units(cells: Sequence[str]) -> bool:
    """Return whether the cells are units and nothing else."""
    filled = [unit_word(cell) for cell in cells if cell.strip()]
    return any(word in UNITS for word in filled) and all(word in UNITS or word in ("", "-") for word in filled)


def unit_word(cell: str) -> str:
    """Return a cell as a key of `UNITS`: without blanks and brackets, in lower case."""
    return clean(cell).strip("[](){}<>【】").strip().casefold()


def commented(cells: Sequence[str]) -> bool:
    """Return whether a record is a comment."""
    return bool(cells) and cells[0].lstrip().startswith(COMMENTS)
