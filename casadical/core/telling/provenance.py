"""Provenance of a report: files with SHA-256, versions, command, date."""

import hashlib
import platform
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from casadical.core.errors import InputError

PACKAGES = ("casadical", "casadi", "numpy", "pandas", "plotly")


@dataclass(frozen=True)
class Provenance:
    """files : (path, SHA-256) of what was read; versions : (name, version); command : as typed; date : UTC."""

    files: tuple[tuple[str, str], ...]
    versions: tuple[tuple[str, str], ...]
    command: str
    date: str


def provenance_of(files: Iterable[Path], command: Sequence[str] = (), now: datetime | None = None) -> Provenance:
    """Of files, read now; now : instead of the clock. Raises InputError where a file cannot be read."""
    return Provenance(
        files=tuple((str(path), sha256(path)) for path in dict.fromkeys(files)),
        versions=(
            *((name, _version(name)) for name in PACKAGES),
            ("Python", platform.python_version()),
            ("platform", f"{platform.system()} {platform.machine()}"),
        ),
        command=shlex.join(command),
        date=(now or datetime.now(UTC)).strftime("%Y-%m-%d %H:%M UTC"),
    )


def sha256(path: Path) -> str:
    """Of a file's bytes. Raises InputError."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
