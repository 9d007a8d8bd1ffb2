"""Pages as a PDF of words, tables and scatter plots; a user's text is never interpreted."""

from collections.abc import Sequence
from datetime import UTC, date, datetime
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from casadical.core.basics import InputError, optional
from casadical.core.reporting.blocks import Page, Table, Words
from casadical.core.reporting.drawing import COLOURS
from casadical.core.reporting.figure import Figure

# Only type checkers import fpdf here; it is loaded when a PDF is made.
if TYPE_CHECKING:
    from fpdf import FPDF

    Sheet: TypeAlias = FPDF
else:
    Sheet = Any

# Margin at the left, right and top of an A4 page [mm].
MARGIN_MM = 18.0
# Width of the text on an A4 page [mm].
TEXT_WIDTH_MM = 174.0
# Translation of letters that the built-in Latin-1 fonts of PDF readers lack to their substitutes.
_LATIN1_SUBSTITUTES = str.maketrans(
    {"–": "-", "—": "-", "μ": "µ", "“": '"', "”": '"', "„": '"', "’": "'", "≤": "<=", "≥": ">="}
)


def pdf_of(pages: Sequence[Page], *, language: str = "en", day: date | None = None) -> bytes:
    """Return pages as the bytes of a PDF file, one A4 page each.

    language : code of its language, such as "en"
    day : date of its creation; None: a fixed one, so that files of one result are equal to the byte
    Raises InputError where fpdf2 is not installed, or a page's words have no room on it.
    """
    # The type is made smaller until every page's content fits on it.
    for scale in (1.0, 0.94, 0.88, 0.82, 0.76, 0.7):
        sheet, full = _drawn(pages, scale)
        if full is None:
            break
    else:
        raise InputError(f"page {full}: its words have no room on a page; shorten the longest fields")
    made = datetime(day.year, day.month, day.day, tzinfo=UTC) if day else datetime(2000, 1, 1, tzinfo=UTC)
    sheet.set_creation_date(made)
    sheet.set_lang(language)
    sheet.set_title(_text(pages[0].title))
    sheet.set_producer("casadical")
    return bytes(sheet.output())


def _text(words: str) -> str:
    """Return text in Latin-1, the encoding of the built-in fonts; other letters become escapes.

    White space is reduced to single spaces.
    """
    return (
        " ".join(words.translate(_LATIN1_SUBSTITUTES).split()).encode("latin-1", "backslashreplace").decode("latin-1")
    )


def _drawn(pages: Sequence[Page], scale: float) -> tuple[Sheet, int | None]:
    """Return the drawn pages, and the number of the first that overflows, from 1; None: none does.

    scale : factor on the size of type, distances and figures, not on the footer or figures' type
    """
    missing_fpdf = "a PDF needs fpdf2, which is not installed: pip install 'casadical[certificate]'"
    sheet: Sheet = optional("fpdf", missing_fpdf).FPDF(format="A4")
    sheet.set_auto_page_break(False)
    sheet.set_margins(MARGIN_MM, MARGIN_MM, MARGIN_MM)
    full = None
    for number, page in enumerate(pages, 1):
        sheet.add_page()
        _words(sheet, Words(page.title, "title"), scale)
        _words(sheet, Words(page.subtitle, "note"), scale)
        for section in page.sections:
            sheet.ln(2 * scale)
            _line(sheet, section.title, "B", 10.5 * scale)
            figures = [b for b in section.blocks if isinstance(b, Figure)]
            for block in section.blocks:
                if isinstance(block, Words):
                    _words(sheet, block, scale)
                elif isinstance(block, Table):
                    _table(sheet, block, scale)
            if figures:
                _figures(sheet, figures, scale)
        # Text must end 18 mm above the bottom of the A4 page, which is 297 mm high.
        if sheet.get_y() > 297.0 - 18.0 and full is None:
            full = number
        sheet.set_y(-14.0)  # mm from the bottom of the page
        _line(sheet, " · ".join((*page.badges, f"{number} / {len(pages)}")), "", 7.5, "muted")
    return sheet, full


def _ink(sheet: Sheet, role: str = "ink") -> None:
    """Set the colour of text to that of a role of the palette."""
    sheet.set_text_color(*_rgb(role))


def _rgb(role: str) -> tuple[int, int, int]:
    """Return the light colour of a role of the palette as red, green and blue, 0 to 255."""
    light = COLOURS[role][0]
    return int(light[1:3], 16), int(light[3:5], 16), int(light[5:7], 16)


def _line(sheet: Sheet, text: str, style: str, size: float, role: str = "ink") -> None:
    """Write a paragraph of text at the current position.

    style : "B", "I" or "" for bold, italic or normal; size : of the font [pt]
    """
    sheet.set_font("helvetica", style, size)
    _ink(sheet, role)
    sheet.multi_cell(TEXT_WIDTH_MM, 0.45 * size, _text(text), new_x="LMARGIN", new_y="NEXT", align="L")


def _words(sheet: Sheet, block: Words, scale: float) -> None:
    """Write a block of words at the current position in the font of its kind.

    scale : factor on the size of the font
    """
    bold = {"title": 15, "verdict": 10, "warning": 8.5, "error": 8.5}  # size of type [pt]
    style = "B" if block.kind in bold else "I" if block.kind == "note" else ""
    points = bold.get(block.kind, 8 if style else 8.5)
    role = "muted" if block.kind == "note" else "ink"
    _line(sheet, f"{block.mark} {block.text}".strip(), style, points * scale, role)
    sheet.ln(0.6 * scale)


def _table(sheet: Sheet, table: Table, scale: float) -> None:
    """Draw a table at the current position; columns are as wide as their longest cells, or wrap.

    scale : factor on the size of the font
    """
    sheet.ln(0.5 * scale)
    if table.title:
        _line(sheet, table.title, "B", 8.5 * scale)
    sheet.set_font("helvetica", "B", 8 * scale)
    rows = [table.columns, *table.rows] if any(table.columns) else [*table.rows]
    longest = [max(sheet.get_string_width(_text(str(row[k]))) for row in rows) + 3 for k in range(len(rows[0]))]
    over = sum(longest) - TEXT_WIDTH_MM
    if over > 0:
        widest = int(np.argmax(longest))
        longest[widest] = max(longest[widest] - over, 25.0)
        longest = [TEXT_WIDTH_MM * w / sum(longest) for w in longest]
    sheet.set_font("helvetica", "", 8 * scale)
    _ink(sheet)
    sheet.set_draw_color(*_rgb("line"))
    sheet.set_fill_color(*_rgb("paper"))
    align = tuple("RIGHT" if k in table.numbers else "LEFT" for k in range(len(longest)))
    with sheet.table(
        col_widths=tuple(longest),
        width=sum(longest),
        align="LEFT",
        text_align=align,
        line_height=3.9 * scale,
        first_row_as_headings=any(table.columns),
        borders_layout="HORIZONTAL_LINES",
        padding=0.4,
        markdown=False,
    ) as grid:
        for row in rows:
            line = grid.row()
            for cell in row:
                line.cell(_text(str(cell)))


def _figures(sheet: Sheet, figures: Sequence[Figure], scale: float) -> None:
    """Draw figures side by side at the current position, and their captions beneath.

    scale : factor on the figures' height, which is 62 mm at 1, and on the type of the captions
    """
    wide, top = (TEXT_WIDTH_MM - 6 * (len(figures) - 1)) / len(figures), sheet.get_y() + 2
    high = 62.0 * scale
    for k, figure in enumerate(figures):
        _figure(sheet, figure, MARGIN_MM + k * (wide + 6), top, wide, high)
    sheet.set_xy(MARGIN_MM, top + high + 2)
    for caption in dict.fromkeys(f.caption for f in figures if f.caption):
        _words(sheet, Words(caption, "note"), scale)


def _figure(sheet: Sheet, figure: Figure, left: float, top: float, wide: float, high: float) -> None:
    """Draw the points of a figure over two axes of equal scale.

    left, top, wide, high : place and size of the figure on the page [mm]
    """
    sheet.set_font("helvetica", "B", 8)
    _ink(sheet)
    sheet.set_xy(left, top)
    sheet.cell(wide, 4, _text(figure.title))
    x0, y0, w, h = left + 11, top + 5, wide - 12, high - 13
    x, y = (np.concatenate([np.asarray(getattr(s, axis), dtype=float) for s in figure.series]) for axis in "xy")
    scale = min(w / max(np.ptp(x), 1e-9), h / max(np.ptp(y), 1e-9)) * 0.94
    middle = (x.max() + x.min()) / 2, (y.max() + y.min()) / 2
    sheet.set_draw_color(*_rgb("line"))
    sheet.rect(x0, y0, w, h)
    for s in figure.series:
        roles = [s.colour] * len(s.x) if isinstance(s.colour, str) else s.colour
        for u, v, role in zip(s.x, s.y, roles, strict=True):
            sheet.set_fill_color(*_rgb(role))
            at = x0 + w / 2 + (u - middle[0]) * scale, y0 + h / 2 - (v - middle[1]) * scale
            sheet.circle(x=at[0], y=at[1], radius=0.55, style="F")
    sheet.set_font("helvetica", "", 6.5)
    _ink(sheet, "muted")
    for value, across in ((x.min(), True), (x.max(), True), (y.min(), False), (y.max(), False)):
        if across:
            sheet.set_xy(x0 + w / 2 + (value - middle[0]) * scale - 8, y0 + h + 0.5)
        else:
            sheet.set_xy(left - 5, y0 + h / 2 - (value - middle[1]) * scale - 1.5)
        sheet.cell(16, 3, f"{value:.0f}", align="C" if across else "R")
    sheet.set_xy(x0, y0 + h + 3.5)
    sheet.cell(w, 3, _text(f"{figure.x.title}; {figure.y.title}"), align="C")
