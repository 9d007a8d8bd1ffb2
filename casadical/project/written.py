"""What `casadical calibrate --out` wrote, found again."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

from casadical.core.errors import InputError, shown


def result_in(folder: Path) -> Path:
    """The robot file of the method that counts in a folder of results. Raises InputError."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        methods = list(json.loads((folder / "result.json").read_text(encoding="utf-8"))["methods"])
        return folder / f"{methods[-1]}.robot.toml"
    files = sorted(folder.glob("*.robot.toml"))
    if len(files) == 1:
        return files[0]
    raise InputError(
        f"{shown(folder)}: no result.json of a calibration is in it, and {len(files)} robot files: give a robot file"
    )
