"""Walk one of the ways of docs/architecture.md and print which functions of the package were entered, in order of the
first call: python walked.py WAY FOLDER. A process of its own, so that nothing is cached from another test.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).parents[2]
PACKAGE = f"{ROOT / 'casadical'}/"
PROBLEMS, CAMPAIGNS = ROOT / "problems", ROOT / "data" / "campaigns" / "practice"


def command(*words: object) -> None:
    """A command, in this process."""
    from casadical.cli import main

    sys.argv = ["casadical", *map(str, words)]
    try:
        main()
    except SystemExit as stop:
        if stop.code:
            raise


def calibrate(_folder: Path) -> None:
    command("calibrate", PROBLEMS / "planar", "--details", "--quiet")


def diagnose(folder: Path) -> None:
    campaign = CAMPAIGNS / "kr210-P05.csv"
    answer = folder / "answer.json"
    command("diagnose", PROBLEMS / "kr210", campaign, "--effects", "payload_error,backlash", "--json", answer, "-q")


def effect(folder: Path) -> None:
    import casadical
    from casadical.export import Sources, command_of, write_c
    from casadical.export.mjcf.mjcf import mjcf

    robot = casadical.read_campaign_robot(PROBLEMS / "kr210")
    campaign = casadical.read_measurements(CAMPAIGNS / "kr210-P05.csv", robot.n)
    found = casadical.diagnose(robot, campaign, ["payload_error", "backlash"], laws=False)
    casadical.write_robot(found.apply(), folder / "found.toml")
    kept = casadical.read_robot(folder / "found.toml")
    assert "payload_error" in mjcf(kept).text
    write_c(command_of(Sources(kept, robot)), folder / "c", name="arm", vectors=200)


def entered(way: Callable[[Path], None], folder: Path) -> list[str]:
    """Functions of the package in order of their first call, as FILE:FUNCTION."""
    seen: dict[str, None] = {}

    def note(frame: FrameType, event: str, _argument: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(PACKAGE):
            seen.setdefault(f"{code.co_filename.removeprefix(PACKAGE)}:{code.co_qualname}")

    sys.setprofile(note)
    try:
        way(folder)
    finally:
        sys.setprofile(None)
    return list(seen)


if __name__ == "__main__":
    print(json.dumps(entered(globals()[sys.argv[1]], Path(sys.argv[2]))))
