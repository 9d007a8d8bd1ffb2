"""Files from which a result was made, for its provenance."""

from collections.abc import Sequence
from pathlib import Path

from casadical.core.reading import load_toml
from casadical.project.problem import Problem


def problem_files(problem: Problem) -> list[Path]:
    path = problem.folder / "problem.toml"
    names = [problem.robot_file, *(problem.folder / table["file"] for table in problem.tables)]
    return [*([path] if path.is_file() else []), *map(_short, names)]


def campaign_files(source: Path, campaigns: Sequence[Path]) -> list[Path]:
    """What a diagnosis was read from: problem.toml, the campaign's robot, or a robot file; and the campaigns."""
    if source.is_file():
        return [source, *campaigns]
    path = source / "problem.toml"
    file = load_toml(path)
    robot = file.get("campaign_robot", file.get("robot", "robot.toml"))
    return [path, _short(source / robot), *campaigns]


def _short(path: Path) -> Path:
    """Resolved, without ".."; relative to the working directory if it is below it."""
    whole = path.resolve()
    return whole.relative_to(Path.cwd()) if whole.is_relative_to(Path.cwd()) else whole
