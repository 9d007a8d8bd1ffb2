"""Scoring of answers: the key is opened, checked against its published hash, and compared."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from casadical.blind_check import metrics as counted
from casadical.blind_check.metrics import Estimate, Outcome, outcome
from casadical.blind_check.protocol import Header, Key, read_answers, read_key, read_manifest
from casadical.core.basics import InputError
from casadical.core.reporting.blocks import Block, Table, Words
from casadical.core.reporting.result import Result


@dataclass(frozen=True, eq=False)
class Score(Result):
    """A file of answers compared with the key.

    head : header of the file of answers: the method that answered, and its versions
    key : what was hidden, and how the campaigns were made
    outcomes : comparisons of the campaigns that were answered
    """

    head: Header
    key: Key
    outcomes: tuple[Outcome, ...]

    @property
    def unanswered(self) -> list[str]:
        """Return the names of campaigns without an answer, sorted; they do not count."""
        return sorted(set(self.key.campaigns) - {t.name for t in self.outcomes})

    @property
    def metrics(self) -> dict[str, tuple[Estimate, str]]:
        """Return the metrics over all outcomes by name, each with its target as text; "" for none."""
        return counted.metrics(self.outcomes)

    def blocks(self) -> list[Block]:
        """Return the report: metrics with targets, and every wrong claim."""
        made = ", ".join(f"{name} {number}" for name, number in self.key.versions.items())
        missing = f"; {len(self.unanswered)} more have no answer and do not count" if self.unanswered else ""
        wrong = ["Wrong claims, and what was hidden:"]
        for t in (t for t in self.outcomes if t.wrong_claims):
            hidden = ", ".join(t.truth or t.effects) or "nothing"
            wrong.append(f"  {t.name}  {t.kind:<8}  {hidden}: claimed {', '.join(t.named)}  (signal {t.signal:.2f})")
        return [
            Words(
                f"{len(self.outcomes)} campaigns whose effect was withheld (engine: {self.key.reality}, "
                f"seed {self.key.seed}; {made}){missing}\nkey as published: sha256 {self.head.key_sha256}"
            ),
            Table("", ["", self.head.by, "target"], [[n, str(e), aim] for n, (e, aim) in self.metrics.items()]),
            *map(Words, wrong if len(wrong) > 1 else ["No wrong claims."]),
        ]

    def to_json(self) -> dict[str, Any]:
        """Return the score as plain data for the JSON file."""
        return {
            "by": self.head.by,
            "versions": self.head.versions,
            "made": {"seed": self.key.seed, "reality": self.key.reality, "versions": self.key.versions},
            "campaigns": len(self.outcomes),
            "unanswered": self.unanswered,
            "figures": {name: {**_plain(e), "target": aim} for name, (e, aim) in self.metrics.items()},
            "trials": [{k: _short(v) for k, v in t.__dict__.items()} for t in self.outcomes],
        }


def score(folder: str | Path, key: str | Path, answers: str | Path) -> Score:
    """Return the score of answers to the campaigns in a folder, by their key.

    folder : campaigns that `make` wrote
    key : folder of the key, or its file
    answers : file of answers that `predict` wrote
    Raises InputError if the key is not the published one, or the answers are to another check.
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
    """Return the fields of an estimate by name, rounded by `_short`."""
    return {k: _short(v) for k, v in f.__dict__.items()}


def _short(value: Any) -> Any:
    """Return plain data with floats rounded to six significant digits."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    return [_short(v) for v in value] if isinstance(value, Sequence) and not isinstance(value, str) else value
