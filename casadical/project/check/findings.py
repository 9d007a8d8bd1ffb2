"""A finding: its level, its topic, and what to do."""

from dataclasses import dataclass
from typing import Literal

Level = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """level : error (no use to go on), warning (look at it), note (good to know); topic : one word or two"""

    level: Level
    topic: str
    text: str
