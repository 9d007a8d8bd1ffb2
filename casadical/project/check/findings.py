"""What a check finds; and every fault of a measurement table at once, where reading stops at the first of several."""

import difflib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from casadical.core.errors import InputError
from casadical.core.reading import load_toml
from casadical.measurements.headings import understand
from casadical.measurements.raw_table import RawTable, read_table

Level = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """level : error (no use to go on), warning (look at it), note (good to know); topic : one word or two"""

    level: Level
    topic: str
    text: str


# Columns that the model or an effect may ask for, besides readings and observations.
KNOWN = ("payload_kg", "temperature_degC", "time_s", "warmth_K", "weight", "set", "point", "pose", "other_pose")


# A height is no weight (0.83); a temperature_C may be meant as temperature_degC.
CLOSE = 0.84


def table_faults(folder: Path, joints: int | None, tables: Sequence[str | Path] = ()) -> list[Finding]:
    """Missing joint columns and cells that are no numbers, in every table that problem.toml names, or in these.

    joints : how many readings a row must have; None where the robot could not be read
    """
    found: list[Finding] = []
    given: Sequence[Mapping[str, Any]] = [{"file": str(Path(t).resolve())} for t in tables]
    for data in given or _tables(folder):
        path = folder / str(data.get("file", ""))
        try:
            table = read_table(path)
        except InputError:
            continue  # read_problem has reported it
        named = list(dict(data.get("columns", {})))
        known = understand(table, ["revolute"] * (joints or 0), named).sources
        found += _missing([*table.header, *named, *known], joints, path.name)
        found += _not_numbers(table, set(data.get("leave_out", [])))
    return found


def _tables(folder: Path) -> Sequence[Mapping[str, Any]]:
    listed = load_toml(folder / "problem.toml").get("measurements", [])
    return [d for d in listed if isinstance(d, Mapping)] if isinstance(listed, list) else []


def _missing(header: Sequence[str], joints: int | None, source: str) -> list[Finding]:
    stems = {name.rsplit("_", 1)[0] for name in header}
    lost = [f"q{i}" for i in range(1, (joints or 0) + 1) if f"q{i}" not in stems]
    if not lost:
        return []
    text = f"{source}: no column for {', '.join(lost)}; name them {lost[0]}_deg (or _rad, _mm, _m), or map them by "
    return [Finding("error", "columns", text + "`columns` in problem.toml")]


def _not_numbers(table: RawTable, left_out: Collection[int]) -> list[Finding]:
    found = []
    out = np.isin(table.line, list(left_out))
    for name, cells in table.frame().items():
        bad = np.flatnonzero(~np.isfinite(pd.to_numeric(cells, errors="coerce").to_numpy(dtype=float)) & ~out)
        if 0 < len(bad) <= len(cells) // 2:
            rows = ", ".join(str(table.line[k]) for k in bad[:8]) + (" ..." if len(bad) > 8 else "")
            found.append(Finding("error", "cells", f"{table.path.name}: column {name!r} holds no number in row {rows}"))
    return found


def unknown_columns(conditions: Sequence[str], source: str) -> list[Finding]:
    """Columns that are almost a name that something asks for, and those that are kept."""
    found = []
    for name in conditions:
        near = [known for known in KNOWN if known.startswith(f"{name}_")]
        near = near or difflib.get_close_matches(name, KNOWN, 1, CLOSE)
        if name not in KNOWN and near and not name.startswith(("warmth_", "approach")):
            text = f"{source}: column {name!r} is no name that anything asks for; is {near[0]!r} meant?"
            found.append(Finding("warning", "columns", text))
    return found
