"""The statements of a diagnosis as a page of plain text, for a terminal."""

import textwrap
from collections.abc import Iterator

from rich.console import RenderableType
from rich.text import Text

from casadical.diagnosis.cause_table import cause_rows
from casadical.diagnosis.details import Details
from casadical.diagnosis.layers import COLUMNS as COLUMNS_OF_LAYERS
from casadical.diagnosis.layers import layer_rows
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.spectrum import Spectrum, curve_of
from casadical.diagnosis.spectrum_report import COLUMNS, MOST_SUGGESTED, curve_rows
from casadical.diagnosis.statements import TIED, statements

WIDTH = 112
LABEL = 8
# Of a signature in the table of causes.
COLUMN = 62
# Labels that stand before each of their statements, not only before the first.
EACH = ("CANNOT", "MISSING")


def titled(title: str, page: str) -> RenderableType:
    """A page of plain text beneath its title, underlined; to be printed unwrapped."""
    whole = Text(f"{title}\n", style="bold underline", no_wrap=True)
    whole.append(Text(page, style="not bold not underline"))
    return whole


def page_of(d: Diagnosis, more: Details | None = None) -> str:
    """The page as plain text, at most `WIDTH` characters wide.

    Parameters
    ----------
    d : Diagnosis
        a diagnosis
    more : Details, optional
        what `analyse` computed; None: what the diagnosis alone tells

    Returns
    -------
    str
        lines of text

    Examples
    --------
    >>> print(casadical.diagnosis.page_of(diagnosis).splitlines()[0])
    VERDICT explained: gear_eccentricity@2; 0.081 -> 0.037 mm, noise alone would leave 0.033
    """
    lines: list[str] = []
    last = ""
    for s in statements(d, more):
        label = s.about if s.about != last or s.about in EACH else ""
        lines += _wrapped(s.text, f"{label:<{LABEL}}", " " * LABEL)
        if s.about == "WHICH" and d.causes:
            lines += _causes(d, more)
        if s.about == "LAYERS":
            lines += _layers(d)
        last = s.about
    return "\n".join(lines)


def _wrapped(text: str, first: str, further: str) -> list[str]:
    lines = textwrap.wrap(text, WIDTH, initial_indent=first, subsequent_indent=further, break_on_hyphens=False)
    return [line.replace(TIED, " ") for line in lines]


def _causes(d: Diagnosis, more: Details | None) -> Iterator[str]:
    """The table of causes: a row for each, beneath it its name and its parameters."""
    yield f"   {'signature':<{COLUMN}} {'posterior':>9} {'gap if added':>16} {'shrinks by, 95 %':>18}"
    for k, row in enumerate(cause_rows(d), 1):
        first, *rest = textwrap.wrap(row.shown, COLUMN)
        yield f"{k:>2} {first:<{COLUMN}} {row.cause.confidence:>9.2f} {row.gap:>16} {row.shrinks:>18}"
        yield from (f"   {line}" for line in rest)
        yield from _wrapped(row.named, "     ", "     ")
        values = (
            (f"{name} {value} +- {error} {unit}" if error else f"{name} {value} {unit}").rstrip()
            for name, value, error, unit in row.parameters
        )
        if row.parameters:
            yield from _wrapped(", ".join(v.replace(" ", TIED) for v in values), "     ", "     ")
        if more and more.curves and curve_of([row.cause]):
            yield from _curves(more.curves)


def _layers(d: Diagnosis) -> Iterator[str]:
    """The table of layers."""
    rows = [COLUMNS_OF_LAYERS, *layer_rows(d)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        figures = "  ".join(f"{cell:>{w}}" for cell, w in zip(row[1:], widths[1:], strict=True))
        yield f"{'':{LABEL}}{row[0]:<{widths[0]}}  {figures}".rstrip()


def _curves(s: Spectrum) -> Iterator[str]:
    """The table of joint error curves, a row a joint, and what their lines suggest."""
    rows = [COLUMNS, *curve_rows(s)]
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    for row in rows:
        first = "     " + "  ".join(f"{cell:>{w}}" for cell, w in zip(row, widths, strict=False)) + "  "
        yield from _wrapped(first + row[3], "", " " * len(first))
    for text in s.suggestions[:MOST_SUGGESTED]:
        yield from _wrapped(text, "     ", "     ")
