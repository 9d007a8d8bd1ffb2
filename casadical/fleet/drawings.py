"""Drawings of a fleet's types: where a parameter stands in a robot file, and types whose drawings are nearly one."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd

from casadical.core.errors import CasadicalError
from casadical.core.parameters import Parameter
from casadical.core.reading import load_toml
from casadical.fleet.hierarchy import COUNTS, SURE, Common
from casadical.project.problem import read_problem_robot
from casadical.project.problem_file import problem_file
from casadical.robot.robot import Robot

# Two drawings are nearly one where so many nominal values differ at most, each by so many sigma of its prior.
FEW, NEAR = 3, 5.0
# Types whose drawings are read, the largest first.
READ = 100
# Key of a number in a row of a robot file; the first four belong to the row after the number in their name.
_KEYS = {"alpha": "alpha_deg", "a": "a_mm", "beta": "beta_deg", "b": "b_mm", "theta": "theta_deg", "d": "d_mm"}
_BARS = {"L5": "crank_mm", "L4": "coupler_mm", "L3": "rocker_mm"}


@dataclass(frozen=True, eq=False)
class Drawing:
    """A robot as drawn; standard : whether its file has standard DH rows, None where it has none (URDF)."""

    name: str
    count: int
    robot: Robot
    standard: bool | None

    @property
    def robots(self) -> str:
        """How many there are, in words."""
        return f"{self.count} robot{'s' * (self.count > 1)}"

    def correction(self, common: Common, name: str, near: Sequence[Drawing] = ()) -> str:
        """What to write for a parameter, and where, as "[[joint]] 4: d_mm = 1199.7 (drawn 1200)"; or nothing.

        near : drawings that are nearly this one; the value of one that would be no fault is taken, so that all are one
        """
        if self.standard is None or name not in self.robot.parameters.names:
            return ""
        drawn, k = self.robot.parameters[name].value, common.names.index(name)
        new = drawn + common.mean[k] * common.scale[k]
        good = max(SURE * common.std_error[k], COUNTS) * common.scale[k]
        taken = next((other for other in near if abs(other.robot.parameters[name].value - new) <= good), None)
        new, said = (taken.robot.parameters[name].value, f"; {taken.robots} so") if taken else (new, "")
        found = re.fullmatch(r"(L[345])(?:_(\d+))?|([a-z]+)(\d+)", name)
        if not found or (found[3] == "beta" and self.standard):
            return ""
        if found[3] == "c":
            key = (
                "stiffness_Nm_per_rad"
                if self.robot.joints[int(found[4]) - 1].kind == "revolute"
                else "stiffness_N_per_m"
            )
            given = f"{1 / drawn:.6g}" if drawn else "no number"
            number = f"{1 / new:.12g}" if taken else f"{float(f'{1 / new:.3g}'):.0f}"
            return f"[[joint]] {found[4]}: {key} = {number} (drawn {given}{said})" if new > 0 else ""
        if found[1]:
            key, where = _BARS[found[1]], f"[[four_bar]] {found[2] or 1}"
        else:
            key = _KEYS[found[3]]
            where = f"[[joint]] {int(found[4]) + (found[3] in ('alpha', 'a', 'beta', 'b') and not self.standard)}"
        factor = 1e3 if key.endswith("mm") else np.rad2deg(1.0)
        digits = max(0, int(np.ceil(-np.log10(common.std_error[k] * common.scale[k] * factor))))
        number = f"{factor * new:.12g}" if taken else f"{factor * new:.{min(digits, 6)}f}"
        return f"{where}: {key} = {number} (drawn {factor * drawn:.9g}{said})"


def drawings_of(good: pd.DataFrame) -> dict[str, Drawing]:
    """Drawings by the word for their type, of the types of which there are most robots; those that can be read."""
    drawings = {}
    for kind, count in good["type"].value_counts().head(READ).items():
        row = good[good["type"] == kind].iloc[0]
        with suppress(CasadicalError, OSError):
            path = Path(row["folder"]) / problem_file(Path(row["folder"])).robot
            rows = None if path.suffix == ".urdf" else load_toml(path)
            standard = None if rows is None else rows.get("convention") == "standard"
            robot = read_problem_robot(row["folder"])
            drawings[str(kind)] = Drawing(str(row["type_name"]), int(count), robot, standard)
    return drawings


def near(drawings: Mapping[str, Drawing], kind: str) -> list[Drawing]:
    """Drawings that are nearly that of a type, of which there are most robots first."""
    return [other for other in drawings.values() if _differences(drawings[kind], other)]


def nearly_one(drawings: Mapping[str, Drawing]) -> Iterator[str]:
    """In words, types whose drawings differ in few values, as where they are corrected one robot at a time."""
    for (first, one), (second, other) in combinations(drawings.items(), 2):
        if pairs := _differences(one, other):
            words = ", ".join(
                f"{p.name} ({p.readable(p.value):.9g} and {p.readable(q.value):.9g} {p.readable_unit})"
                for p, q in pairs
            )
            names = " and ".join(
                f"{d.name}, drawing {kind} ({d.robots})," for kind, d in ((first, one), (second, other))
            )
            yield f"types {names} differ only in {words}: corrected one by one? Then correct all of them"


def _differences(one: Drawing, other: Drawing) -> list[tuple[Parameter, Parameter]]:
    """In which parameters two drawings that are nearly one differ; none where they are others, or the same."""
    first, second = ([p for p in d.robot.parameters if p.group not in ("base", "tool")] for d in (one, other))
    if [p.name for p in first] != [p.name for p in second]:
        return []
    pairs = [(p, q) for p, q in zip(first, second, strict=True) if f"{p.value:.9g}" != f"{q.value:.9g}"]
    return pairs if len(pairs) <= FEW and all(abs(q.value - p.value) <= NEAR * p.prior for p, q in pairs) else []
