"""The physics that makes the campaigns, behind one small seam: a plan goes in, measured tables come out.

Two of them: MuJoCo (`mujoco_physics`), and the project's own independent simulator (`numpy_physics`), which needs no
further package. Neither shares a formula with the effects; neither is ever loaded by `predict`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol, cast

import pandas as pd

from casadical.blind_check.drawing import Plan
from casadical.core.errors import InputError

REALITIES = ("mujoco", "numpy")


@dataclass(frozen=True)
class Act:
    """An effect that is switched on: its word, its 1-based joint or None, and what it is in the engine's words."""

    effect: str
    joint: int | None
    about: str


@dataclass(frozen=True, eq=False)
class Record:
    """A measuring session as it was, and as it would have been with less.

    session : with all that is hidden; its columns are a campaign's, and x_true_mm, y_true_mm, z_true_mm without noise
    clean : without any effect; alone : with each effect by itself; of the same seed, poses and noise
    """

    hidden: tuple[Act, ...]
    session: pd.DataFrame
    clean: pd.DataFrame
    alone: tuple[pd.DataFrame, ...]


class Reality(Protocol):
    """What a module of this package must have to be a reality."""

    def words(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Effects that are on the diagnosis' list, and effects that are on none."""

    def versions(self) -> dict[str, str]:
        """Of what the physics depends on."""

    def record(self, table: Mapping[str, Any], plan: Plan, poses: int) -> Record:
        """The session of a plan with a robot of which `table` is the drawing."""


def reality(name: str) -> Reality:
    """The module of a name. Raises InputError."""
    if name not in REALITIES:
        raise InputError(f"reality {name!r} is not known; allowed: {', '.join(REALITIES)}")
    return cast(Reality, import_module(f"{__package__}.physics_{name}"))
