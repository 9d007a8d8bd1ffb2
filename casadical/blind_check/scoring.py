"""Score answers: open the key, check that it is the one whose hash was published, count, and tell."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from casadical.blind_check import metrics as counted
from casadical.blind_check.metrics import Estimate, Metric, Outcome, outcome, part_metrics, sign_tests
from casadical.blind_check.protocol import Header, Key, read_answers, read_key, read_manifest
from casadical.core.basics import InputError, optional
from casadical.core.files import write_together
from casadical.core.telling.blocks import Block, Table, Words
from casadical.core.telling.result import Result

_LAST = ("at another joint", "unknown", "none")


@dataclass(frozen=True, eq=False)
class Score(Result):
    """A file of answers against the key.

    head : the method that answered; key : how the campaigns were made; outcomes : of campaigns that were answered
    """

    head: Header
    key: Key
    outcomes: tuple[Outcome, ...]

    @property
    def unanswered(self) -> list[str]:
        """Campaigns without an answer; they do not count."""
        return sorted(set(self.key.campaigns) - {t.name for t in self.outcomes})

    @property
    def metrics(self) -> list[Metric]:
        return counted.metrics(self.outcomes)

    @property
    def parts(self) -> dict[str, dict[str, list[Outcome]]]:
        """Outcomes by poses, signal, column that was not logged, robot, and effect."""
        return counted.breakdown(self.outcomes)

    @property
    def confusion(self) -> dict[str, dict[str, int]]:
        return counted.confusion(self.outcomes)

    def blocks(self) -> list[Block]:
        """Metrics beside their targets, the same by parts, the confusion matrix, and every wrong claim."""
        return side_by_side([self])

    def to_json(self) -> dict[str, Any]:
        return {
            "by": self.head.by,
            "versions": self.head.versions,
            "made": {"seed": self.key.seed, "reality": self.key.reality, "versions": self.key.versions},
            "campaigns": len(self.outcomes),
            "unanswered": self.unanswered,
            "figures": {r.name: {**_plain(r.estimate), "target": r.target} for r in self.metrics},
            "parts": {
                by: {w: {k: _plain(f) for k, f in part_metrics(p).items()} for w, p in parts.items()}
                for by, parts in self.parts.items()
            },
            "confusion": self.confusion,
            "trials": [{k: _short(v) for k, v in t.__dict__.items()} for t in self.outcomes],
        }


def in_common(scores: Sequence[Score]) -> list[Score]:
    """The same scores on the campaigns that all of them answer, to be compared. Raises InputError: there is none."""
    names = set.intersection(*({t.name for t in s.outcomes} for s in scores))
    if not names:
        raise InputError("no campaign is answered by all of these files; predict more, or score them one by one")
    return [replace(s, outcomes=tuple(t for t in s.outcomes if t.name in names)) for s in scores]


def score(folder: str | Path, key: str | Path, answers: str | Path) -> Score:
    """Answers against the key of the campaigns in a folder.

    Raises InputError where the key is not the one that was published, or the answers are to another check.
    """
    folder, path = Path(folder), Path(answers)
    manifest = read_manifest(folder)
    head, answered = read_answers(path)
    if head.key_sha256 != manifest.key_sha256:
        raise InputError(f"{path}: answers another check than the one in {folder}; predict that one first")
    opened = read_key(Path(key), manifest)
    outcomes = tuple(outcome(name, s, answered[name]) for name, s in opened.campaigns.items() if name in answered)
    if not outcomes:
        raise InputError(f"{path}: answers no campaign of {folder}")
    return Score(head, opened, outcomes)


def _plain(f: Estimate) -> dict[str, Any]:
    return {k: _short(v) for k, v in f.__dict__.items()}


def _short(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.6g}")
    return [_short(v) for v in value] if isinstance(value, Sequence) and not isinstance(value, str) else value


def side_by_side(scores: Sequence[Score]) -> list[Block]:
    """The first score in full, the metrics of the others beside it."""
    first, *others = scores
    beside = []
    if others:
        by = [f"{first.head.by} : {s.head.by}" for s in others]
        rows = zip(*(sign_tests(first.outcomes, s.outcomes) for s in others), strict=True)
        title = "Right on the same campaign: the first alone : the other alone"
        beside = [Table(title, ["", *by], [[r[0].name, *map(str, r)] for r in rows])]
    every = zip(*(s.metrics for s in scores), strict=True)
    lines = [[r[0].name, *(str(m.estimate) for m in r), r[0].target] for r in every]
    return [
        Words(_title(first)),
        Table("", ["", *(s.head.by for s in scores), "target"], lines),
        *beside,
        _parts(first),
        _confusion(first),
        *map(Words, wrong_claims(first)),
    ]


def _title(s: Score) -> str:
    made = ", ".join(f"{name} {number}" for name, number in s.key.versions.items())
    missing = f"; {len(s.unanswered)} more have no answer and do not count" if s.unanswered else ""
    return (
        f"{len(s.outcomes)} campaigns whose effect was withheld (engine: {s.key.reality}, seed {s.key.seed}; {made})"
        f"{missing}\nkey as published: sha256 {s.head.key_sha256}"
    )


def _parts(s: Score) -> Table:
    rows = []
    for by, parts in s.parts.items():
        for k, (word, part) in enumerate(parts.items()):
            figures = part_metrics(part).values()
            cells = ["-" if f.value is None else f"{f.value:.3f} [{f.low:.2f}, {f.high:.2f}]" for f in figures]
            rows.append([by if k == 0 else "", word, str(len(part)), *cells])
    return Table("", ["by", "", "n", *part_metrics(s.outcomes)], rows)


def ordered(s: Score) -> tuple[list[str], list[str]]:
    """Rows and columns of the confusion matrix: listed effects on the diagonal, none and unknown last."""
    rows = sorted(s.confusion, key=lambda w: (w == "none", w))
    words = {w for row in s.confusion.values() for w in row}
    effects = [w for w in rows if w in words and w not in _LAST]
    return rows, [*effects, *sorted(words - {*rows, *_LAST}), *(w for w in _LAST if w in words)]


def _confusion(s: Score) -> Table:
    rows, columns = ordered(s)
    return Table(
        "Hidden (rows) and answered first (columns), at most one effect",
        ["", *(w.replace("_", "\n").replace(" ", "\n") for w in columns)],
        [[word, *(str(s.confusion[word].get(c, 0) or ".") for c in columns)] for word in rows],
    )


def wrong_claims(s: Score) -> list[str]:
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
