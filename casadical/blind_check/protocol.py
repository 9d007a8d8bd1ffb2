"""The check on disk: the public folder, and the key whose hash is in that folder.

The folder holds withheld.json, the nominal robots, and for each campaign NAME.csv (measured poses) and NAME.unseen.csv
(further readings, without positions). The key is one file, key.json; its first entry is a salt, so its SHA-256 reveals
nothing of its content, and `sha256sum key.json` is all that a sceptical reader needs.

Answers are a line of JSON with its SHA-256 for each campaign, added when it is answered, never rewritten.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from casadical.core.basics import InputError
from casadical.core.reading import json_of, load_json, read_bytes
from casadical.core.schema import check
from casadical.measurements.raw_table import read_table as read_csv

MANIFEST = "withheld.json"
KEY = "key.json"
ROBOTS = "robots"
Kind = Literal["none", "one", "several", "unlisted"]

# Effects that belong to no joint, so that an answer need not name one.
JOINTLESS = frozenset((
    "thermal_growth", "target_shift", "payload_error", "gravity_compensator", "link_flexure", "base_compliance",
    "frame_drift", "outliers", "none", "unknown",
))  # fmt: skip


def label(effect: str, joint: int | None) -> str:
    """By what an effect at a joint is compared: name, or name@joint."""
    return effect if joint is None or effect in JOINTLESS else f"{effect}@{joint}"


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


class CampaignEntry(_Strict):
    """The public part of a campaign: which robot it is of."""

    robot: str


class Manifest(_Strict):
    """withheld.json: the campaigns, and the hash of the key that was written with them."""

    format: Literal["casadical withheld 1"] = "casadical withheld 1"
    key_sha256: str = Field(pattern="^[0-9a-f]{64}$")
    campaigns: dict[str, CampaignEntry] = Field(min_length=1)


class HiddenEffect(_Strict):
    """One effect that was switched on; visible : rms [m] of a coordinate that the base model cannot absorb of it."""

    effect: str
    joint: int | None
    about: str
    visible: float

    @property
    def label(self) -> str:
        return label(self.effect, self.joint)


class Secret(_Strict):
    """What a campaign hides.

    noise : standard deviation of a measured coordinate [m]; repeatability : of a joint [rad]
    visible : rms of a coordinate [m] that all effects together add and the base model cannot absorb
    missing : the column that was struck out, or None
    measured_mm, true_mm : positions at the unseen poses, with and without noise, each three numbers a pose
    """

    robot: str
    kind: Kind
    hidden: tuple[HiddenEffect, ...]
    poses: int
    missing: str | None
    noise: float
    repeatability: float
    visible: float
    measured_mm: tuple[tuple[float, float, float], ...]
    true_mm: tuple[tuple[float, float, float], ...]

    @property
    def truth(self) -> tuple[str, ...]:
        """Labels that a right answer names; none for what is on no list."""
        return () if self.kind == "unlisted" else tuple(h.label for h in self.hidden)


class Key(_Strict):
    """key.json: salt, how it was made (seed, physics, versions), and every campaign's secret."""

    salt: str
    seed: int
    reality: str
    versions: dict[str, str]
    campaigns: dict[str, Secret]

    def text(self) -> str:
        """The file's text, a line for each campaign; the same key gives the same text."""
        head = self.model_dump(exclude={"campaigns"})
        lines = [f"  {json.dumps(n)}: {json.dumps(s.model_dump())}" for n, s in self.campaigns.items()]
        return json.dumps(head, indent=1)[:-2] + ',\n "campaigns": {\n' + ",\n".join(lines) + "\n }\n}\n"


def read_manifest(folder: Path) -> Manifest:
    """What a folder made by `make` holds. Raises InputError."""
    path = folder / MANIFEST
    if not path.is_file():
        raise InputError(f"{folder}: holds no {MANIFEST}; name the folder that `casadical withheld make` wrote")
    return check(Manifest, load_json(path), str(path))


def read_key(folder: Path, manifest: Manifest) -> Key:
    """The key, after its hash was found to be the published one. Raises InputError if it is another or was changed."""
    path = folder / KEY if folder.is_dir() else folder
    if not path.is_file():
        raise InputError(f"{path}: no such key; name the folder that `make --key` wrote, or its {KEY}")
    data = read_bytes(path)
    digest = sha256(data)
    if digest != manifest.key_sha256:
        raise InputError(
            f"{path}: its SHA-256 is {digest}, but {manifest.key_sha256} was published with the campaigns; "
            "the key was changed after it was made, or belongs to other campaigns: nothing is scored"
        )
    key = check(Key, json_of(data, str(path)), str(path))
    if key.campaigns.keys() != manifest.campaigns.keys():
        raise InputError(f"{path}: its campaigns are not those of {MANIFEST}")
    return key


def read_table(folder: Path, name: str) -> pd.DataFrame:
    """A campaign's table, or with `.unseen` behind the name its further readings. Raises InputError."""
    path = folder / f"{name}.csv"
    if not path.is_file():
        raise InputError(f"{path}: is missing, though {MANIFEST} names it; take the folder whole")
    return read_csv(path).frame


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
    return f'{text[:-1]},"sha256":"{sha256(text.encode())}"}}\n'


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _intact(line: bytes) -> bool:
    """Whether a line is as it was written; one without a checksum, of an earlier casadical, if it is JSON."""
    checked = _CHECKED.fullmatch(line)
    if checked:
        return sha256(checked[1] + b"}") == checked[2].decode()
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
    """
    if not path.exists():
        raise InputError(f"{path}: no such file; make it with `casadical withheld predict`")
    *lines, _cut = read_bytes(path).split(b"\n")
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
