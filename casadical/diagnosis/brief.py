"""A diagnosis in few lines, the answer first."""

from collections.abc import Iterator, Sequence

from casadical.core.telling.blocks import Table, Words, mm
from casadical.diagnosis.cause_table import cause_rows
from casadical.diagnosis.details import Details
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.statements import TIED, Statement, readings_of, statements

THINGS, CAUSES = 3, 6
# Characters of a thing to know: three lines of a terminal.
LONGEST = 290
# Of these only what casts a doubt is told.
_DOUBTS = ("CANNOT", "AFTER")
# What a reader must know besides the verdict, the most important first, in words where a sentence needs its subject.
_ABOUT = {
    "CHECK": "", "PRIOR": "Prior: ", "CANNOT": "These data cannot ", "UNKNOWN": "Left: ", "LAW": "Law: ", "AFTER": "",
    "OUT": "",
    "WHERE": "Where: ", "RULED": "Ruled ", "NEXT": "Next: ", "MISSING": "", "GRAVITY": "In the model: ",
    "ASSUMED": "Assumed: ",
}  # fmt: skip


def brief(title: str, d: Diagnosis, more: Details | None = None) -> Sequence[Words | Table]:
    """Verdict, error before and after, causes, and three things to know: at most 25 lines of 100 columns."""
    told = statements(d, more)
    verdict = next(s.text for s in told if s.about == "VERDICT")
    return [
        Words(title, "title"),
        Words(_sentence(verdict), "verdict"),
        _errors(d),
        *_causes(d),
        *(Words(_short(s), "warning" if s.doubtful else "note") for s in _things(d, told)),
    ]


def _errors(d: Diagnosis) -> Table:
    steps = any(c.effects for c in d.causes)
    rows = [("before: calibrated, without causes", mm(d.gap.before))]
    rows += [("after: with the causes in the model", mm(d.gap.after))] if steps else []
    rows += [("noise alone would leave", mm(d.gap.floor))]
    title = f"Mean error on poses held out, of {int(d.case.kept.sum())}{readings_of(d)} [mm]"
    return Table(title, ("model", "mean"), rows, frozenset({1}))


def _causes(d: Diagnosis) -> Iterator[Table | Words]:
    rows = [(r.cause.label, f"{r.cause.confidence:.2f}", r.shrinks, r.shown) for r in cause_rows(d)]
    if rows:
        columns = ("cause", "probability", "error less, 95 %", "what the data show")
        yield Table("", columns, rows[:CAUSES], frozenset({1, 2}))
    if len(rows) > CAUSES:
        yield Words(f"and {len(rows) - CAUSES} more")


def _things(d: Diagnosis, told: Sequence[Statement]) -> list[Statement]:
    """One statement of each kind at most, doubts first."""
    of_each: dict[str, Statement] = {}
    for s in told:
        known = of_each.get(s.about)
        if s.about in _ABOUT and (s.doubtful or s.about not in _DOUBTS) and (known is None or s.doubtful):
            of_each[s.about] = known if known and known.doubtful else s
    if d.verdict == "none":
        of_each.pop("WHERE", None)
    return sorted(of_each.values(), key=lambda s: (not s.doubtful, [*_ABOUT].index(s.about)))[:THINGS]


def _short(s: Statement) -> str:
    text = _sentence(_ABOUT[s.about] + " ".join(s.text.replace(TIED, " ").split()))
    if len(text) <= LONGEST:
        return text
    whole, part, _ = text[:LONGEST].rpartition("; ")
    return f"{whole if part else text[:LONGEST].rpartition(' ')[0]} ..."


def _sentence(text: str) -> str:
    text = text.replace(TIED, " ")
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", ")")) else f"{text}."
