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
from casadical.core.schema import load_toml
from casadical.project.problem import Problem

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


def problem_files(problem: Problem) -> list[Path]:
    """What a problem was read from: problem.toml, robot and measurements."""
    path = problem.folder / "problem.toml"
    names = [problem.robot_file, *(problem.folder / table["file"] for table in problem.tables)]
    return [*([path] if path.is_file() else []), *(Path(_short(name)) for name in names)]


def campaign_files(source: Path, campaigns: Sequence[Path]) -> list[Path]:
    """What a diagnosis was read from: problem.toml, the campaign's robot, or a robot file; and the campaigns."""
    if source.is_file():
        return [source, *campaigns]
    path = source / "problem.toml"
    file = load_toml(path)
    robot = file.get("campaign_robot", file.get("robot", "robot.toml"))
    return [path, Path(_short(source / robot)), *campaigns]


def _short(path: Path) -> str:
    """Resolved, without ".."; relative to the working directory if it is below it."""
    whole = path.resolve()
    return str(whole.relative_to(Path.cwd()) if whole.is_relative_to(Path.cwd()) else whole)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
