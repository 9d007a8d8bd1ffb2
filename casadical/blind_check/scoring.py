"""Score answers: open the key, check that it is the one whose hash was published, and count."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from casadical.blind_check.answers import Header, read_answers
from casadical.blind_check.metrics import Estimate, Metric, breakdown, confusion, metrics, part_metrics
from casadical.blind_check.outcomes import Outcome, outcome
from casadical.blind_check.protocol import Key, read_key, read_manifest
from casadical.core.errors import InputError


@dataclass(frozen=True, eq=False)
class Score:
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
        return metrics(self.outcomes)

    @property
    def parts(self) -> dict[str, dict[str, list[Outcome]]]:
        """Outcomes by poses, signal, column that was not logged, robot, and effect."""
        return breakdown(self.outcomes)

    @property
    def confusion(self) -> dict[str, dict[str, int]]:
        """How often what was answered first, by what was hidden."""
        return confusion(self.outcomes)

    def to_json(self) -> dict[str, Any]:
        """All of it as plain data."""
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
    head, found = read_answers(path)
    if head.key_sha256 != manifest.key_sha256:
        raise InputError(f"{path}: answers another check than the one in {folder}; predict that one first")
    opened = read_key(Path(key), manifest)
    outcomes = tuple(outcome(name, s, found[name]) for name, s in opened.campaigns.items() if name in found)
    if not outcomes:
        raise InputError(f"{path}: answers no campaign of {folder}")
    return Score(head, opened, outcomes)


def _plain(f: Estimate) -> dict[str, Any]:
    return {k: _short(v) for k, v in f.__dict__.items()}


def _short(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.6g}")
    return [_short(v) for v in value] if isinstance(value, Sequence) and not isinstance(value, str) else value
