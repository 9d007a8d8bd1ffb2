"""A score as text: metrics beside their targets, the same by parts, the confusion matrix, and every wrong claim."""

import io
from collections.abc import Sequence
from pathlib import Path

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from casadical.blind_check.metrics import part_metrics, sign_tests
from casadical.blind_check.scoring import Score
from casadical.core.errors import InputError, optional
from casadical.core.files import write_together

_LAST = ("at another joint", "unknown", "none")


def report(scores: Sequence[Score]) -> RenderableType:
    """The first score in full, the metrics of the others beside it."""
    first = scores[0]
    parts: list[RenderableType] = [Text(_title(first)), Text(), _metrics(scores), Text()]
    if len(scores) > 1:
        parts += [Text("Right on the same campaign: the first alone : the other alone"), _sign_tests(scores), Text()]
    parts += [_parts(first), Text()]
    parts += [Text("Hidden (rows) and answered first (columns), at most one effect"), _confusion(first), Text()]
    parts += [Text(line) for line in wrong_claims(first)]
    return Group(*parts)


def _title(s: Score) -> str:
    made = ", ".join(f"{name} {number}" for name, number in s.key.versions.items())
    missing = f"; {len(s.unanswered)} more have no answer and do not count" if s.unanswered else ""
    return (
        f"{len(s.outcomes)} campaigns whose effect was withheld (engine: {s.key.reality}, seed {s.key.seed}; {made})"
        f"{missing}\nkey as published: sha256 {s.head.key_sha256}"
    )


def _table(*columns: str) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    for column in columns:
        table.add_column(column, no_wrap=True)
    return table


def _metrics(scores: Sequence[Score]) -> Table:
    """Every metric of every score: value (95 % interval; n), and the target."""
    table = _table("", *(s.head.by for s in scores), "target")
    for rows in zip(*(s.metrics for s in scores), strict=True):
        table.add_row(rows[0].name, *(str(r.estimate) for r in rows), rows[0].target)
    return table


def _sign_tests(scores: Sequence[Score]) -> Table:
    """Every further score against the first, campaign by campaign."""
    first, *others = scores
    found = [sign_tests(first.outcomes, s.outcomes) for s in others]
    table = _table("", *(f"{first.head.by} : {s.head.by}" for s in others))
    for rows in zip(*found, strict=True):
        table.add_row(rows[0].name, *map(str, rows))
    return table


def _parts(s: Score) -> Table:
    table = _table("by", "", "n", *part_metrics(s.outcomes))
    for by, parts in s.parts.items():
        for k, (word, part) in enumerate(parts.items()):
            found = part_metrics(part).values()
            cells = ["-" if f.value is None else f"{f.value:.3f} [{f.low:.2f}, {f.high:.2f}]" for f in found]
            table.add_row(by if k == 0 else "", word, str(len(part)), *cells)
    return table


def ordered(s: Score) -> tuple[list[str], list[str]]:
    """Rows and columns of the confusion matrix: listed effects on the diagonal, none and unknown last."""
    rows = sorted(s.confusion, key=lambda w: (w == "none", w))
    words = {w for row in s.confusion.values() for w in row}
    effects = [w for w in rows if w in words and w not in _LAST]
    return rows, [*effects, *sorted(words - {*rows, *_LAST}), *(w for w in _LAST if w in words)]


def _confusion(s: Score) -> Table:
    rows, columns = ordered(s)
    table = _table("", *(w.replace("_", " ").replace(" ", "\n") for w in columns))
    for word in rows:
        counts = [s.confusion[word].get(c, 0) for c in columns]
        table.add_row(word, *(str(n) if n else "." for n in counts))
    return table


def wrong_claims(s: Score) -> list[str]:
    """A line for each answer that claims a cause that is not there."""
    lines = ["Wrong claims, and what was hidden:"]
    for t in s.outcomes:
        if t.wrong_claims:
            hidden = ", ".join(t.truth or t.effects) or "nothing"
            lines.append(f"  {t.name}  {t.kind:<8}  {hidden}: claimed {', '.join(t.named)}  (signal {t.signal:.2f})")
    return lines if len(lines) > 1 else ["No wrong claims."]


def draw_confusion(s: Score, path: Path) -> None:
    """The confusion matrix as a picture. Raises InputError without matplotlib."""
    rows, columns = ordered(s)
    counts = [[s.confusion[r].get(c, 0) for c in columns] for r in rows]
    shares = [[n / sum(row) for n in row] for row in counts]
    figure = optional("matplotlib.figure", "--figure needs matplotlib: pip install 'casadical[plots]'")
    canvas = figure.Figure(figsize=(1.5 + 0.36 * len(columns), 1.5 + 0.32 * len(rows)), layout="constrained")
    axes = canvas.add_subplot()
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for i, row in enumerate(counts):
        for j, n in enumerate(row):
            if n:
                axes.text(j, i, str(n), ha="center", va="center", color="white" if shares[i][j] > 0.5 else "black")
    axes.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=60, ha="right")
    axes.set_yticks(range(len(rows)), [f"{r.replace('_', ' ')} ({sum(n)})" for r, n in zip(rows, counts, strict=True)])
    axes.set_xlabel("answered first")
    axes.set_ylabel("hidden (campaigns)")
    drawn = io.BytesIO()
    try:
        canvas.savefig(drawn, dpi=120, format=path.suffix[1:] or "png")
    except ValueError as error:
        raise InputError(f"{path}: no such kind of picture: {error}") from None
    write_together({path: drawn.getvalue()})
