"""Drawings of a fleet's types: where a parameter stands in a robot file, and types whose drawings are nearly one."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd

from casadical.core.errors import CasadicalError
from casadical.core.files import read_bytes
from casadical.fleet.hierarchy import Common
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

    def correction(self, common: Common, name: str) -> str:
        """What to write for a parameter, and where, as "[[joint]] 4: d_mm = 1199.7 (drawn 1200)"; or nothing."""
        if self.standard is None or name not in self.robot.parameters.names:
            return ""
        drawn, k = self.robot.parameters[name].value, common.names.index(name)
        new = drawn + common.mean[k] * common.scale[k]
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
            return f"[[joint]] {found[4]}: {key} = {float(f'{1 / new:.3g}'):.0f} (drawn {given})" if new > 0 else ""
        if found[1]:
            key, where = _BARS[found[1]], f"[[four_bar]] {found[2] or 1}"
        else:
            key = _KEYS[found[3]]
            where = f"[[joint]] {int(found[4]) + (found[3] in ('alpha', 'a', 'beta', 'b') and not self.standard)}"
        factor = 1e3 if key.endswith("mm") else np.rad2deg(1.0)
        digits = max(0, int(np.ceil(-np.log10(common.std_error[k] * common.scale[k] * factor))))
        return f"{where}: {key} = {factor * new:.{min(digits, 6)}f} (drawn {factor * drawn:.9g})"


def drawings_of(good: pd.DataFrame) -> dict[str, Drawing]:
    """Drawings by the word for their type, of the types of which there are most robots; those that can be read."""
    found = {}
    for kind, count in good["type"].value_counts().head(READ).items():
        row = good[good["type"] == kind].iloc[0]
        with suppress(CasadicalError, OSError):
            path = Path(row["folder"]) / problem_file(Path(row["folder"])).robot
            rows = None if path.suffix == ".urdf" else tomllib.loads(read_bytes(path).decode())
            standard = None if rows is None else rows.get("convention") == "standard"
            robot = read_problem_robot(row["folder"])
            found[str(kind)] = Drawing(str(row["type_name"]), int(count), robot, standard)
    return found


def nearly_one(drawings: Mapping[str, Drawing]) -> Iterator[str]:
    """In words, types whose drawings differ in few values, as where they are corrected one robot at a time."""
    own = {
        kind: [p for p in drawing.robot.parameters if p.group not in ("base", "tool")]
        for kind, drawing in drawings.items()
    }
    for first, second in combinations(drawings, 2):
        if [p.name for p in own[first]] != [p.name for p in own[second]]:
            continue
        pairs = [(p, q) for p, q in zip(own[first], own[second], strict=True) if f"{p.value:.9g}" != f"{q.value:.9g}"]
        if len(pairs) <= FEW and all(abs(q.value - p.value) <= NEAR * p.prior for p, q in pairs):
            words = ", ".join(
                f"{p.name} ({p.readable(p.value):.9g} and {p.readable(q.value):.9g} {p.readable_unit})"
                for p, q in pairs
            )
            names = " and ".join(
                f"{drawings[kind].name}, drawing {kind} ({drawings[kind].count} robots),".replace(
                    "(1 robots)", "(1 robot)"
                )
                for kind in (first, second)
            )
            yield f"types {names} differ only in {words}: corrected one by one? Then correct all of them"
