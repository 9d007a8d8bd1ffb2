"""Compose the files of a new problem, check that they can be read, and then write them."""

import tempfile
import tomllib
from pathlib import Path

from casadical.core.errors import InputError
from casadical.core.files import write_together
from casadical.measurements.raw_table import read_table
from casadical.project.new.dh_table import robot_text
from casadical.project.new.synthetic import POSES, synthetic_poses
from casadical.project.new.texts import EXAMPLE_ROBOT, problem_text, readme_text
from casadical.project.problem import Problem, read_problem
from casadical.robot.robot import Robot
from casadical.robot.robot_file import robot_from


def new_problem(
    folder: str | Path,
    *,
    urdf: Path | None = None,
    base_link: str | None = None,
    tip_link: str | None = None,
    dh: Path | None = None,
    convention: str = "modified",
    data: Path | None = None,
    seed: int = 0,
) -> Problem:
    """Write a problem folder that runs, and give it back as it reads.

    urdf, base_link, tip_link : the robot from a URDF; dh, convention : from a table of DH rows (modified, standard);
        neither: an example arm
    data : measured poses; None: poses that the model itself makes up from the seed, marked synthetic everywhere
    Nothing is overwritten. Raises InputError: a file that is there already, or input that does not read.
    """
    folder = Path(folder)
    if urdf and dh:
        raise InputError("--urdf and --dh: both say which robot it is; give one of them")
    if data and not (urdf or dh):
        raise InputError("--data needs the robot that was measured; give --urdf or --dh as well")
    name = folder.resolve().name
    texts, robot = _robot_files(name, urdf, base_link, tip_link, dh, convention)
    given = read_table(data) if data else None
    compliant = any(j.compliance is not None for j in robot.joints)
    links = (base_link, tip_link) if urdf else None
    sets = given is not None and "set" in given.header
    texts |= {
        "poses.csv": given.text if given else synthetic_poses(robot, seed),
        "problem.toml": problem_text(robot.name, bool(data), links, compliant, sets, seed, POSES),
        "README.md": readme_text(name, robot.name, *(path.name if path else None for path in (data, urdf, dh))),
    }
    _refuse_taken(folder, texts)
    with tempfile.TemporaryDirectory() as scratch:
        trial = Path(scratch) / name
        write_together({trial / file: text for file, text in texts.items()})
        _read_on_trial(trial, data)
    write_together({folder / file: text for file, text in texts.items()})
    return read_problem(folder)


def _robot_files(
    name: str, urdf: Path | None, base_link: str | None, tip_link: str | None, dh: Path | None, convention: str
) -> tuple[dict[str, str], Robot]:
    if urdf:
        from casadical.robot.urdf import read_urdf

        return {"robot.urdf": _read(urdf)}, read_urdf(urdf, base_link, tip_link)
    text = robot_text(dh, name, convention) if dh else EXAMPLE_ROBOT
    return {"robot.toml": text}, robot_from(tomllib.loads(text), dh.name if dh else "robot.toml")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8") from None


def _read_on_trial(folder: Path, data: Path | None) -> None:
    """Refuse what would not read, by the name of the file that the user gave."""
    try:
        read_problem(folder)
    except InputError as error:
        text = str(error).replace(f"{folder}/", "")
        raise InputError(text.replace("poses.csv", str(data)) if data else text) from None


def _refuse_taken(folder: Path, texts: dict[str, str]) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; name a folder")
    taken = [file for file in texts if (folder / file).exists()]
    if taken:
        raise InputError(f"{folder}: {', '.join(taken)} is there already; nothing was written: name another folder")
