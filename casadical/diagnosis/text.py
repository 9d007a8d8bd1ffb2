"""A diagnosis in words, for a terminal: as a page of plain text, and in few lines, the answer first."""

import textwrap
from collections.abc import Iterator, Sequence
from itertools import chain

from rich.console import RenderableType
from rich.text import Text

from casadical.core.telling.blocks import Table, Words, mm
from casadical.core.telling.result import table_lines
from casadical.diagnosis.cause_table import LAYER_COLUMNS, cause_rows, layer_rows
from casadical.diagnosis.details import Details
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.spectrum import COLUMNS, MOST_SUGGESTED, curve_of, curve_rows
from casadical.diagnosis.statements import SUBJECTS, TIED, Statement, floor_of, readings_of, statements

WIDTH = 112
LABEL = 8
# The table of causes, and how wide its columns are.
CAUSE_COLUMNS = ("", "signature", "posterior", "gap if added", "shrinks by, 95 %")
WIDTHS = (2, 62, 9, 16, 18)
# Labels that stand before each of their statements, not only before the first.
EACH = ("CANNOT", "MISSING")
# Of the short answer: things to know, causes that are listed.
THINGS, CAUSES = 3, 6
# Characters of a thing to know: three lines of a terminal.
LONGEST = 290
# Of these only what casts a doubt is told.
_DOUBTS = ("CANNOT", "AFTER", "SET")


def titled(title: str, page: str) -> RenderableType:
    """A page of plain text beneath its title, underlined; to be printed unwrapped."""
    whole = Text(f"{title}\n", style="bold underline", no_wrap=True)
    whole.append(Text(page, style="not bold not underline"))
    return whole


def page_of(d: Diagnosis, more: Details | None = None) -> str:
    """The page as plain text, at most `WIDTH` characters wide.

    more : what `analyse` computed; None: what the diagnosis alone tells

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
            lines += _cause_lines(d, more)
        if s.about == "LAYERS":
            table = Table("", LAYER_COLUMNS, layer_rows(d, floor_of(d, more)), frozenset({1, 2, 3, 4}))
            lines += chain.from_iterable(table_lines(table, indent=LABEL))
        last = s.about
    return "\n".join(lines)


def _wrapped(text: str, first: str, further: str) -> list[str]:
    lines = textwrap.wrap(text, WIDTH, initial_indent=first, subsequent_indent=further, break_on_hyphens=False)
    return [line.replace(TIED, " ") for line in lines]


def _cause_lines(d: Diagnosis, more: Details | None) -> Iterator[str]:
    """The table of causes: a row for each, beneath it its name and its parameters."""
    causes = cause_rows(d)
    rows = [
        (str(k), "\n".join(textwrap.wrap(r.shown, WIDTHS[1])), f"{r.cause.confidence:.2f}", r.gap, r.shrinks)
        for k, r in enumerate(causes, 1)
    ]
    head, *lines = table_lines(Table("", CAUSE_COLUMNS, rows, frozenset({0, 2, 3, 4})), WIDTHS, gap=1)
    yield from head
    for row, own in zip(causes, lines, strict=True):
        yield from own
        yield from _wrapped(row.named, "     ", "     ")
        values = (
            (f"{name} {value} +- {error} {unit}" if error else f"{name} {value} {unit}").rstrip().replace(" ", TIED)
            for name, value, error, unit in row.parameters
        )
        if row.parameters:
            yield from _wrapped(", ".join(values), "     ", "     ")
        if more and more.curves and curve_of([row.cause]):
            curves = Table("", COLUMNS, curve_rows(more.curves), frozenset({0, 1, 2}))
            yield from chain.from_iterable(table_lines(curves, indent=5, most=WIDTH))
            for text in more.curves.suggestions[:MOST_SUGGESTED]:
                yield from _wrapped(text, "     ", "     ")


def brief(title: str, d: Diagnosis, more: Details | None = None) -> Sequence[Words | Table]:
    """Verdict, error before and after, causes, and three things to know: at most 25 lines of 100 columns."""
    sentences = statements(d, more)
    return [
        Words(title, "title"),
        Words(sentences[0].sentence, "verdict"),
        _errors(d, more),
        *_causes(d),
        *(Words(_short(s.sentence), "warning" if s.doubtful else "note") for s in things_to_know(d, sentences)),
    ]


def _errors(d: Diagnosis, more: Details | None) -> Table:
    rows = [("before, outliers in", mm(d.gap.before))] if d.gap.before > d.gap.kept else []
    rows += [("before: calibrated, without causes", mm(d.gap.kept))]
    rows += [("after: with the causes in the model", mm(d.gap.after))] if d.effects() else []
    rows += [("noise alone would leave", mm(floor_of(d, more)))]
    title = f"Mean error on poses held out, of {int(d.case.kept.sum())}{readings_of(d)} [mm]"
    return Table(title, ("model", "mean"), rows, frozenset({1}))


def _causes(d: Diagnosis) -> Iterator[Table | Words]:
    rows = [(r.cause.label, f"{r.cause.confidence:.2f}", r.shrinks, r.shown) for r in cause_rows(d)]
    if rows:
        columns = ("cause", "probability", "error less, 95 %", "what the data show")
        yield Table("", columns, rows[:CAUSES], frozenset({1, 2}))
    if len(rows) > CAUSES:
        yield Words(f"and {len(rows) - CAUSES} more")


def things_to_know(d: Diagnosis, told: Sequence[Statement]) -> list[Statement]:
    """One statement of each kind at most, doubts first, and always what was taken as noise."""
    of_each: dict[str, Statement] = {}
    for s in told:
        known = of_each.get(s.about)
        if s.about in SUBJECTS and (s.doubtful or s.about not in _DOUBTS) and (known is None or s.doubtful):
            of_each[s.about] = known if known and known.doubtful else s
    if d.verdict == "none":
        of_each.pop("WHERE", None)
    first = sorted(of_each.values(), key=lambda s: (not s.doubtful, [*SUBJECTS].index(s.about)))[:THINGS]
    return [*first, *[s for s in told if s.about == "NOISE" and s not in first][:1]]


def _short(text: str) -> str:
    if len(text) <= LONGEST:
        return text
    whole, part, _ = text[:LONGEST].rpartition("; ")
    return f"{whole if part else text[:LONGEST].rpartition(' ')[0]} ..."
