"""Open the key, see that it is the one whose hash was published, and count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from casadical.blind_check.answers import Head, read_answers
from casadical.blind_check.figures import Row, bands, confusion, figures, part_figures
from casadical.blind_check.intervals import Figure
from casadical.blind_check.protocol import Key, read_key, read_manifest
from casadical.blind_check.trials import Trial, trial
from casadical.core.errors import InputError


@dataclass(frozen=True, eq=False)
class Score:
    """What a file of answers is worth.

    head : who answered; key : how the campaigns were made; trials : campaigns that count
    """

    head: Head
    key: Key
    trials: tuple[Trial, ...]

    @property
    def unanswered(self) -> list[str]:
        """Campaigns that do not count."""
        return sorted(set(self.key.campaigns) - {t.name for t in self.trials})

    @property
    def figures(self) -> list[Row]:
        return figures(self.trials)

    @property
    def confusion(self) -> dict[str, dict[str, int]]:
        """What was hidden -> what was answered -> how often."""
        return confusion(self.trials)

    def as_json(self) -> dict[str, Any]:
        """All of it as plain data."""
        return {
            "by": self.head.by,
            "versions": self.head.versions,
            "made": {"seed": self.key.seed, "reality": self.key.reality, "versions": self.key.versions},
            "campaigns": len(self.trials),
            "unanswered": self.unanswered,
            "figures": {r.name: {**_plain(r.figure), "target": r.target} for r in self.figures},
            "parts": {
                by: {w: {k: _plain(f) for k, f in part_figures(p).items()} for w, p in parts.items()}
                for by, parts in bands(self.trials).items()
            },
            "confusion": self.confusion,
            "trials": [{k: _short(v) for k, v in t.__dict__.items()} for t in self.trials],
        }


def in_common(scores: Sequence[Score]) -> list[Score]:
    """The same scores on the campaigns that all have answered, so that they can stand side by side.

    Raises InputError: there is no such campaign.
    """
    names = set.intersection(*({t.name for t in s.trials} for s in scores))
    if not names:
        raise InputError(
            "no campaign is answered by all of these files; predict on with each, or score them one by one"
        )
    return [replace(s, trials=tuple(t for t in s.trials if t.name in names)) for s in scores]


def score(folder: str | Path, key: str | Path, answers: str | Path) -> Score:
    """Answers against the key of the campaigns in a folder.

    Raises InputError: the key is not the one that was published, or the answers are to another check.
    """
    folder, path = Path(folder), Path(answers)
    manifest = read_manifest(folder)
    head, found = read_answers(path)
    if head.key_sha256 != manifest.key_sha256:
        raise InputError(f"{path}: answers another check than the one in {folder}; predict that one first")
    opened = read_key(Path(key), manifest)
    trials = tuple(trial(name, s, found[name]) for name, s in opened.campaigns.items() if name in found)
    if not trials:
        raise InputError(f"{path}: answers no campaign of {folder}")
    return Score(head, opened, trials)


def _plain(f: Figure) -> dict[str, Any]:
    return {k: _short(v) for k, v in f.__dict__.items()}


def _short(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.6g}")
    return [_short(v) for v in value] if isinstance(value, Sequence) and not isinstance(value, str) else value
