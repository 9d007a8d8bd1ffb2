"""Score answers: open the key, check that it is the one whose hash was published, count, and tell."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from casadical.blind_check import metrics as counted
from casadical.blind_check.metrics import Estimate, Metric, Outcome, outcome, part_metrics
from casadical.blind_check.protocol import Header, Key, read_answers, read_key, read_manifest
from casadical.core.basics import InputError
from casadical.core.telling.blocks import Block, Table, Words
from casadical.core.telling.result import Result


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

    def blocks(self) -> list[Block]:
        """Metrics beside their targets, the same by parts, and every wrong claim."""
        return [
            Words(_title(self)),
            Table("", ["", self.head.by, "target"], [[m.name, str(m.estimate), m.target] for m in self.metrics]),
            _parts(self),
            *map(Words, wrong_claims(self)),
        ]

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
            "trials": [{k: _short(v) for k, v in t.__dict__.items()} for t in self.outcomes],
        }


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


def wrong_claims(s: Score) -> list[str]:
    lines = ["Wrong claims, and what was hidden:"]
    for t in s.outcomes:
        if t.wrong_claims:
            hidden = ", ".join(t.truth or t.effects) or "nothing"
            lines.append(f"  {t.name}  {t.kind:<8}  {hidden}: claimed {', '.join(t.named)}  (signal {t.signal:.2f})")
    return lines if len(lines) > 1 else ["No wrong claims."]
