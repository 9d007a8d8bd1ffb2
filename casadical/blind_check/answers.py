"""Answers on disk: a line of JSON with its SHA-256 for each campaign, added when it is answered, never rewritten."""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from casadical.blind_check.protocol import content, label, stored
from casadical.core.errors import InputError
from casadical.core.reading import json_of, read_bytes

_CHECKED = re.compile(rb'(.*),"sha256":"([0-9a-f]{64})"\}')
Rows = tuple[tuple[float, float, float], ...]


class _Loose(BaseModel):
    """What is scored of an answer; its other entries are for people to read."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False, frozen=True)


class Header(_Loose):
    """The first line: which check was answered (by the hash of its key), by what, and with which versions."""

    key_sha256: str
    by: str
    versions: dict[str, str] = {}


class GapMm(_Loose):
    before: float
    after: float


class NamedCause(_Loose):
    effect: str
    joint: int | None = None
    indistinguishable: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        return label(self.effect, self.joint)

    @property
    def alike(self) -> tuple[str, ...]:
        """The others of its set, by the labels of the key."""
        return tuple(relabelled(text) for text in self.indistinguishable)


class UnseenPositions(_Loose):
    """Positions predicted at the unseen poses: by the base model, and with the named causes added."""

    base_mm: Rows
    with_causes_mm: Rows


class Answer(_Loose):
    """One answer, as `casadical diagnose --json` writes it, with what the check adds.

    posterior : probability of every label that has some, none and unknown among them
    """

    campaign: str
    verdict: Literal["none", "explained", "ambiguous", "unknown"]
    gap_mm: GapMm
    causes: tuple[NamedCause, ...] = ()
    posterior: dict[str, float] = {}
    unseen: UnseenPositions

    @property
    def probabilities(self) -> dict[str, float]:
        """The posterior by the labels of the key."""
        by_label: dict[str, float] = {}
        for text, p in self.posterior.items():
            by_label[relabelled(text)] = by_label.get(relabelled(text), 0.0) + p
        return by_label


def relabelled(text: str) -> str:
    """name or name@joint as the key has it: without a joint where the effect belongs to none."""
    name, _, joint = text.partition("@")
    return label(name, int(joint) if joint.isdigit() else None)


def json_line(data: Mapping[str, Any]) -> str:
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return f'{text[:-1]},"sha256":"{_sum(text.encode())}"}}\n'


def _sum(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()


def _intact(line: bytes) -> bool:
    """Whether a line is as it was written; one without a checksum, of an earlier casadical, if it is JSON."""
    found = _CHECKED.fullmatch(line)
    if found:
        return _sum(found[1] + b"}") == found[2].decode()
    try:
        return json_of(line, "a line") is not None
    except InputError:
        return False


def whole_lines(path: Path) -> int:
    """Bytes of the lines that were written to their end; 0 where there is no file. Raises InputError."""
    return read_bytes(path).rfind(b"\n") + 1 if path.exists() else 0


def read_answers(path: Path) -> tuple[Header, dict[str, Answer]]:
    """A file of answers by campaign, without what failed and lines that are damaged. Raises InputError.

    A damaged line (a process was killed, a disk was full) counts as no answer, so that `predict` answers it again.
    Where a file is missing, the one packed by xz beside it is read.
    """
    path = stored(path)
    if not path.exists():
        raise InputError(f"{path}: no such file; make it with `casadical withheld predict`")
    *lines, _cut = content(path).split(b"\n")
    if not lines:
        raise InputError(f"{path}: holds no answers; its first line must say which check they answer")
    head = _read(Header, lines[0], f"{path}: line 1", "predict into another file (--out)")
    # Quotes inside of a text are escaped, so that this can only be the entry.
    answered = [(k, t) for k, t in enumerate(lines[1:], 2) if b'"failed":' not in t and _intact(t)]
    remedy = "delete this line, and run predict again to answer the campaign again"
    answers = [_read(Answer, text, f"{path}: line {k}", remedy) for k, text in answered]
    return head, {a.campaign: a for a in answers}


def _read(schema: Any, text: bytes, place: str, remedy: str) -> Any:
    try:
        return schema.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        entry = ".".join(map(str, first["loc"])) or "the line"
        raise InputError(f"{place}: {entry}: {first['msg']}; {remedy}") from None
