"""The files that are kept of a diagnosis."""

from pathlib import Path

from casadical.core.files import json_text
from casadical.diagnosis.details import Details
from casadical.diagnosis.json_answer import as_json
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.statements import headline
from casadical.diagnosis.text import page_of
from casadical.robot.robot_file import to_toml


def diagnosis_files(
    folder: str | Path, found: Diagnosis, more: Details, name: str, *, unlisted: bool = False
) -> dict[Path, str]:
    """What `casadical diagnose --out` writes, by file: the robot with its causes, all figures, and the page.

    more : what `analyse` computed; name : of the campaign
    unlisted : whether the description of the unknown, where there is one, is in the robot's model, too
    Raises ConvergenceError.
    """
    folder = Path(folder)
    refit = found.refit(unlisted=more.unlisted if unlisted else None)
    comment = f"Diagnosed by casadical from {name}.\n{headline(found)}\n{refit.verdict}"
    kinds = [type(effect) for effect in refit.robot.effects]
    return {
        folder / "diagnosed.robot.toml": to_toml(refit.robot, comment, kinds),
        folder / "diagnosis.json": json_text(as_json(found, name, more)),
        folder / "diagnosis.txt": page_of(found, more) + "\n",
    }
