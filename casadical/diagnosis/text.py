"""The statements of a diagnosis as a page of plain text, for a terminal."""

import textwrap
from collections.abc import Iterator
from itertools import chain

from rich.console import RenderableType
from rich.text import Text

from casadical.core.telling.blocks import Table
from casadical.core.telling.terminal import table_lines
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
# The table of causes, and how wide its columns are.
CAUSES = ("", "signature", "posterior", "gap if added", "shrinks by, 95 %")
WIDTHS = (2, 62, 9, 16, 18)
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
            table = Table("", COLUMNS_OF_LAYERS, layer_rows(d), frozenset({1, 2, 3, 4}))
            lines += chain.from_iterable(table_lines(table, indent=LABEL))
        last = s.about
    return "\n".join(lines)


def _wrapped(text: str, first: str, further: str) -> list[str]:
    lines = textwrap.wrap(text, WIDTH, initial_indent=first, subsequent_indent=further, break_on_hyphens=False)
    return [line.replace(TIED, " ") for line in lines]


def _causes(d: Diagnosis, more: Details | None) -> Iterator[str]:
    """The table of causes: a row for each, beneath it its name and its parameters."""
    causes = cause_rows(d)
    rows = [
        (str(k), "\n".join(textwrap.wrap(r.shown, WIDTHS[1])), f"{r.cause.confidence:.2f}", r.gap, r.shrinks)
        for k, r in enumerate(causes, 1)
    ]
    head, *lines = table_lines(Table("", CAUSES, rows, frozenset({0, 2, 3, 4})), WIDTHS, gap=1)
    yield from head
    for row, own in zip(causes, lines, strict=True):
        yield from own
        yield from _wrapped(row.named, "     ", "     ")
        values = (
            (f"{name} {value} +- {error} {unit}" if error else f"{name} {value} {unit}").rstrip()
            for name, value, error, unit in row.parameters
        )
        if row.parameters:
            yield from _wrapped(", ".join(v.replace(" ", TIED) for v in values), "     ", "     ")
        if more and more.curves and curve_of([row.cause]):
            yield from _curves(more.curves)


def _curves(s: Spectrum) -> Iterator[str]:
    """The table of joint error curves, a row a joint, and what their lines suggest."""
    table = Table("", COLUMNS, curve_rows(s), frozenset({0, 1, 2}))
    yield from chain.from_iterable(table_lines(table, indent=5, most=WIDTH))
    for text in s.suggestions[:MOST_SUGGESTED]:
        yield from _wrapped(text, "     ", "     ")
