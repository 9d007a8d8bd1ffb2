"""JSON files with their own sha256, written atomically and refused if anything in them was changed.

The checksum protects from damage and careless edits, not from someone who computes a new one.
"""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

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


def write_checksummed(path: str | os.PathLike[str], kind: str, version: int, body: dict[str, Any]) -> None:
    """Write the file of `checksummed` atomically. Raises InputError where it cannot be written."""
    write_whole(Path(path), checksummed(kind, version, body))


def read_checksummed(path: str | os.PathLike[str], kind: str, version: int) -> dict[str, Any]:
    """Return the fields of a file that `write_checksummed` wrote, without the checksum.

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
