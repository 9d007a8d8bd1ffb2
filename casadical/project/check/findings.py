"""What a check finds, and columns whose names may be mistaken."""

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

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
