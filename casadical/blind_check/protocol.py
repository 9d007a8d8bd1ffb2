"""Files of a blind check: the public folder, the key whose hash is in that folder, and the answers.

The folder holds withheld.json, the nominal robots, and for each campaign the table NAME.csv. The
key is one file, key.json; its first entry is a salt, so its SHA-256 reveals nothing of its content,
and `sha256sum key.json` suffices to verify it.

Each answer is one line of JSON with its SHA-256, appended when it is given and never rewritten.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from casadical.core.basics import InputError
from casadical.core.reading import json_of, load_json, read_bytes
from casadical.core.schema import check
from casadical.measurements.raw_table import read_table as read_csv

# Name of the manifest in the public folder.
MANIFEST_FILE = "withheld.json"
# Name of the key in its folder.
KEY_FILE = "key.json"
# Name of the folder of the nominal robots in the public folder.
ROBOTS_FOLDER = "robots"
# Kind of a campaign: number of listed effects that it hides, or "unlisted" for one effect that the
# diagnosis does not know.
Kind = Literal["none", "one", "several", "unlisted"]


def label(effect: str, joint: int | None) -> str:
    """Return the label by which effects are compared: EFFECT@JOINT, or EFFECT for `jointless`."""
    # Names of effects that belong to no joint, so that answers are compared without a joint.
    jointless = {
        *("thermal_growth", "target_shift", "payload_error", "gravity_compensator"),
        *("link_flexure", "base_compliance", "frame_drift", "outliers", "none", "unknown"),
    }
    return effect if joint is None or effect in jointless else f"{effect}@{joint}"


class _Strict(BaseModel):
    """Base of the schemas of manifest and key: no other entries, finite numbers."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


# The public part of a campaign: its robot.
Public = Annotated[dict[Literal["robot"], str], Field(min_length=1)]


class Manifest(_Strict):
    """Content of withheld.json: the campaigns, and the hash of their key.

    format : name and version of the format
    key_sha256 : SHA-256 of key.json
    campaigns : public part of each campaign by its name
    """

    format: Literal["casadical withheld 1"] = "casadical withheld 1"
    key_sha256: str = Field(pattern="^[0-9a-f]{64}$")
    campaigns: dict[str, Public] = Field(min_length=1)


class HiddenEffect(_Strict):
    """One effect that was switched on.

    effect : name of the effect
    joint : its joint, from 1; None: it belongs to none
    about : its sizes as text
    visible : rms of a coordinate that it adds and the base model cannot absorb [m]
    """

    effect: str
    joint: int | None
    about: str
    visible: float

    @property
    def label(self) -> str:
        """Return the label by which the effect is compared."""
        return label(self.effect, self.joint)


class Secret(_Strict):
    """What a campaign hides.

    robot, kind, poses : name of the robot, kind of the campaign, number of its measured poses
    hidden : its effects
    missing : quantities that were not logged, separated by commas; None: all were
    noise : standard deviation of a measured coordinate [m]
    repeatability : standard deviation of a joint about its reading [rad]
    visible : rms of a coordinate that all effects together add and the base model cannot absorb [m]
    """

    robot: str
    kind: Kind
    hidden: tuple[HiddenEffect, ...]
    poses: int
    missing: str | None
    noise: float
    repeatability: float
    visible: float

    @property
    def truth(self) -> tuple[str, ...]:
        """Return the labels that a right answer names; () if no listed effect is hidden."""
        return () if self.kind == "unlisted" else tuple(h.label for h in self.hidden)


class Key(_Strict):
    """Content of key.json: how the campaigns were made, and every campaign's secret.

    salt : hash that makes the key's SHA-256 unpredictable
    seed : seed of everything drawn
    reality : name of the engine
    versions : versions of packages by name
    campaigns : secret of each campaign by its name
    """

    salt: str
    seed: int
    reality: str
    versions: dict[str, str]
    campaigns: dict[str, Secret]

    def text(self) -> str:
        """Return the file's text, one line for each campaign; equal keys give equal texts."""
        head = self.model_dump(exclude={"campaigns"})
        lines = [f"  {json.dumps(n)}: {json.dumps(s.model_dump())}" for n, s in self.campaigns.items()]
        return json.dumps(head, indent=1)[:-2] + ',\n "campaigns": {\n' + ",\n".join(lines) + "\n }\n}\n"


def read_manifest(folder: Path) -> Manifest:
    """Return the manifest of a folder that `make` wrote. Raises InputError."""
    path = folder / MANIFEST_FILE
    if not path.is_file():
        raise InputError(f"{folder}: holds no {MANIFEST_FILE}; name the folder that `casadical withheld make` wrote")
    return check(Manifest, load_json(path), str(path))


def read_key(folder: Path, manifest: Manifest) -> Key:
    """Return the key in a folder or file, after a check that its hash is the published one.

    Raises InputError if it is another one or was changed.
    """
    path = folder / KEY_FILE if folder.is_dir() else folder
    if not path.is_file():
        raise InputError(f"{path}: no such key; name the folder that `make --key` wrote, or its {KEY_FILE}")
    data = read_bytes(path)
    digest = sha256(data)
    if digest != manifest.key_sha256:
        raise InputError(
            f"{path}: its SHA-256 is {digest}, but {manifest.key_sha256} was published with the "
            "campaigns; the key was changed after it was made, or belongs to other campaigns: "
            "nothing is scored"
        )
    key = check(Key, json_of(data, str(path)), str(path))
    if key.campaigns.keys() != manifest.campaigns.keys():
        raise InputError(f"{path}: its campaigns are not those of {MANIFEST_FILE}")
    return key


def read_table(folder: Path, name: str) -> pd.DataFrame:
    """Return the table NAME.csv of a folder. Raises InputError."""
    path = folder / f"{name}.csv"
    if not path.is_file():
        raise InputError(f"{path}: is missing, though {MANIFEST_FILE} names it; take the folder whole")
    return read_csv(path).frame


class _Loose(BaseModel):
    """Base of the schemas of answers, of which a part is scored: other entries are allowed."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False, frozen=True)


class Header(_Loose):
    """The first line of answers: which check they answer, and by what.

    key_sha256 : SHA-256 of the key of the check
    by : name of the method; versions : versions of packages by name
    """

    key_sha256: str
    by: str
    versions: dict[str, str] = {}


class NamedCause(_Loose):
    """A cause that an answer names.

    effect, joint : name of the effect, and its joint, from 1; None: it belongs to none
    indistinguishable : labels of causes that the answer cannot distinguish from it
    """

    effect: str
    joint: int | None = None
    indistinguishable: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Return the label by which the cause is compared."""
        return label(self.effect, self.joint)

    @property
    def alike(self) -> tuple[str, ...]:
        """Return the labels, as of the key, of the other causes of its set."""
        return tuple(relabelled(text) for text in self.indistinguishable)


class Answer(_Loose):
    """One answer, as `casadical diagnose --json` writes it, with the additions of the check.

    campaign : name of the campaign
    verdict : verdict of the diagnosis; none: no cause was found
    causes : named causes in the order of the answer
    posterior : probability of every label that has some, "none" and "unknown" included
    """

    campaign: str
    verdict: Literal["none", "explained", "ambiguous", "unknown"]
    causes: tuple[NamedCause, ...] = ()
    posterior: dict[str, float] = {}

    @property
    def probabilities(self) -> dict[str, float]:
        """Return the posterior probability by label, with the labels of the key."""
        by_label: dict[str, float] = {}
        for text, p in self.posterior.items():
            by_label[relabelled(text)] = by_label.get(relabelled(text), 0.0) + p
        return by_label


def relabelled(text: str) -> str:
    """Return a label EFFECT or EFFECT@JOINT of the diagnosis in the form of the key.

    There some effects have no joint.
    """
    name, _, joint = text.partition("@")
    return label(name, int(joint) if joint.isdigit() else None)


def json_line(data: Mapping[str, Any]) -> str:
    """Return data as a line of JSON with the SHA-256 of its text as an additional entry, sha256."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return f'{text[:-1]},"sha256":"{sha256(text.encode())}"}}\n'


def sha256(content: bytes) -> str:
    """Return the SHA-256 of bytes as hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def _intact(line: bytes) -> bool:
    """Return whether a line of answers is intact: by its checksum, else as valid JSON.

    Earlier versions of casadical wrote lines without checksums.
    """
    # Pattern of a line of answers with its checksum.
    checksummed_line = re.compile(rb'(.*),"sha256":"([0-9a-f]{64})"\}')
    checked = checksummed_line.fullmatch(line)
    if checked:
        return sha256(checked[1] + b"}") == checked[2].decode()
    try:
        return json_of(line, "a line") is not None
    except InputError:
        return False


def whole_lines(path: Path) -> int:
    """Return the number of bytes of a file's complete lines; 0 if there is no file.

    Raises InputError.
    """
    return read_bytes(path).rfind(b"\n") + 1 if path.exists() else 0


def read_answers(path: Path) -> tuple[Header, dict[str, Answer]]:
    """Return the header and the answers by campaign, without failed and damaged ones.

    A damaged line (a process was killed, a disk was full) counts as no answer, so that `predict`
    answers it again.

    Raises InputError.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file; make it with `casadical withheld predict`")
    *lines, _cut = read_bytes(path).split(b"\n")
    if not lines:
        raise InputError(f"{path}: holds no answers; its first line must say which check they answer")
    head = _read(Header, lines[0], f"{path}: line 1", "predict into another file (--out)")
    # Quotes inside texts are escaped, so this can only be the entry itself.
    answered = [(k, t) for k, t in enumerate(lines[1:], 2) if b'"failed":' not in t and _intact(t)]
    remedy = "delete this line, and run predict again to answer the campaign again"
    answers = [_read(Answer, text, f"{path}: line {k}", remedy) for k, text in answered]
    return head, {a.campaign: a for a in answers}


def _read(schema: Any, text: bytes, place: str, remedy: str) -> Any:
    """Return a line of JSON as an instance of a schema."""
    try:
        return schema.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        entry = ".".join(map(str, first["loc"])) or "the line"
        raise InputError(f"{place}: {entry}: {first['msg']}; {remedy}") from None
