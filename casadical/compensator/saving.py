"""Compensators as files: versioned JSON with full precision and a sha256; no pickles.

Files are written atomically and refused if anything in them was changed. The checksum protects from
damage and careless edits, not from someone who computes a new one.
"""

import hashlib
import json
import os
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from casadical.compensator.compensator import Compensator
from casadical.compensator.layout import JointBox
from casadical.compensator.network import Network
from casadical.core.basics import InputError
from casadical.core.files import json_text, write_whole
from casadical.core.reading import MAX_JSON_BYTES, json_of, read_text


def digest(body: dict[str, Any]) -> str:
    """Return the SHA-256 of plain data in canonical JSON, as 64 hexadecimal digits.

    Keys are sorted, there are no spaces, and numbers are Python's shortest exact decimals.

    Raises ValueError for NaN and infinity.
    """
    text = json.dumps(body, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def checksummed(kind: str, version: int, body: dict[str, Any]) -> str:
    """Return the JSON text of a file with format, version, the fields of `body` and their sha256.

    kind : name of the format; version : version of the format
    """
    document = {"format": kind, "version": version, **body}
    return json_text(document | {"sha256": digest(document)})


def read_checksummed(path: str | os.PathLike[str], kind: str, version: int) -> dict[str, Any]:
    """Return the fields of a file of `checksummed`, without the checksum.

    format and version are among them.

    Raises InputError: it is missing, truncated, changed, or of another kind or version.
    """
    try:
        text = read_text(Path(path), MAX_JSON_BYTES)
        document = json_of(text, str(path), object)
    except InputError as error:
        raise InputError(f"{path} is truncated or not JSON ({error}); take an undamaged copy") from None
    if not isinstance(document, dict) or document.get("format") != kind:
        raise InputError(f"{path} is not a {kind} file")
    found = document.get("version")
    if type(found) is not int or found != version:
        raise InputError(f"{path} has version {found!r} of {kind}; this casadical reads version {version}")
    if not _intact(document, text):
        raise InputError(f"{path} was changed after it was written (its sha256 does not match); take an undamaged copy")
    return {name: value for name, value in document.items() if name != "sha256"}


def _intact(document: dict[str, Any], text: str) -> bool:
    """Return whether a document has its own checksum and `text` is its JSON to the last digit."""
    try:
        body = {name: value for name, value in document.items() if name != "sha256"}
        return document.get("sha256") == digest(body) and json_text(document) == text
    except ValueError:  # NaN or Infinity, which such a file never holds
        return False


# Name of the file format, which is in each file.
FILE_FORMAT = "casadical-compensator"
# Version of the file format, which is in each file.
FORMAT_VERSION = 1
# Type of each field of a compensator that is saved under its own name, as pydantic takes it.
_SAVED_FIELDS: dict[str, Any] = {
    f.name: (f.type, ...) for f in fields(Compensator) if f.name not in ("network", "trained_box", "trained", "history")
}


class _SavedNetwork(BaseModel):
    """Schema of a `Network` in a file, without its layout."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)

    box_rad: JointBox
    output_scale_mm: float = Field(gt=0)
    weights: list[float]


# Schema of a saved compensator.
_Saved: Any = create_model(
    "_Saved",
    __config__=_SavedNetwork.model_config,
    network=(_SavedNetwork | None, ...),
    trained_box_rad=(JointBox, ...),
    verdict=(str, ...),
    **_SAVED_FIELDS,
)


def save_compensator(compensator: Compensator, path: str | os.PathLike[str]) -> None:
    """Write a compensator to a JSON file; an older file is replaced atomically.

    compensator : compensator of a fit; its fields `trained` and `history` are not saved
    path : JSON file

    Examples
    --------
    >>> net = casadical.Compensator.fit(poses.q[:30], residual_mm[:30], choose=(poses.q[30:], residual_mm[30:]))
    >>> casadical.compensator.save_compensator(net, "net.json")
    """
    write_whole(Path(path), checksummed(FILE_FORMAT, FORMAT_VERSION, _body(compensator)))


def compensator_text(compensator: Compensator) -> str:
    """Return the JSON text that `save_compensator` writes, for writing it with other files."""
    return checksummed(FILE_FORMAT, FORMAT_VERSION, _body(compensator))


def _body(compensator: Compensator) -> dict[str, Any]:
    """Return a compensator as plain data, the fields of `_Saved`, for a checksummed JSON file."""
    net = compensator.network
    network = None
    if net is not None:
        network = {"box_rad": asdict(net.box), "output_scale_mm": net.output_scale_mm, "weights": net.weights.tolist()}
    plain = asdict(replace(compensator, network=None, trained=None))
    body = {name: plain[name] for name in _SAVED_FIELDS}
    return body | {"trained_box_rad": plain["trained_box"], "network": network, "verdict": compensator.verdict}


def load_compensator(path: str | os.PathLike[str]) -> Compensator:
    """Return the compensator in a file that `save_compensator` wrote, without its training history.

    path : JSON file
    Raises InputError: the file is missing, truncated, changed, of another kind or version,
    inconsistent, or has a network of too large corrections (see `_refuse_large`).

    Examples
    --------
    >>> net = casadical.Compensator.fit(poses.q[:30], residual_mm[:30], choose=(poses.q[30:], residual_mm[30:]))
    >>> casadical.compensator.save_compensator(net, "net.json")
    >>> casadical.compensator.load_compensator("net.json").helps == net.helps
    True
    """
    document = read_checksummed(path, FILE_FORMAT, FORMAT_VERSION)
    body = {name: value for name, value in document.items() if name not in ("format", "version")}
    try:
        saved = _Saved.model_validate_json(json.dumps(body))
        network = None
        if (net := saved.network) is not None:
            network = Network(saved.layout, net.box_rad, np.array(net.weights), net.output_scale_mm)
        compensator = Compensator(
            network=network,
            trained_box=saved.trained_box_rad,
            **{name: getattr(saved, name) for name in _SAVED_FIELDS},
        )
        _refuse_large(compensator)
        return compensator
    except ValidationError as error:
        fault = error.errors()[0]
        place = ".".join(map(str, fault["loc"]))
        raise InputError(f"{path} does not hold a usable compensator: {place}: {fault['msg']}") from None
    except InputError as error:
        raise InputError(f"{path} does not hold a usable compensator: {error}") from None


def _refuse_large(found: Compensator) -> None:
    """Refuse a network whose corrections in its training box exceed ten times the errors there.

    The largest correction at 1000 random joint angles in the box is compared with ten times the
    largest training error without the network. Raises InputError.
    """
    if found.network is None:
        return
    lower, upper = np.array(found.trained_box.lower), np.array(found.trained_box.upper)
    q = np.random.default_rng(0).uniform(lower, upper, (1000, len(lower)))
    with np.errstate(all="ignore"):
        size = float(np.linalg.norm(found.network.output_mm(q), axis=1).max())
    most = 10 * found.training.before.max_mm
    if not size <= most:
        raise InputError(
            f"its network corrects by up to {size:.3g} mm in the box of its training, where errors "
            f"were {found.training.before.max_mm:.3g} mm at most; allowed: 10 times that; train it "
            "again"
        )
