"""A law given as text: what is added at one place of the robot, as a formula of what is known at a pose.

It is data: a formula is parsed and never executed (see `formula`). `casadical diagnose --laws` writes such laws.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.arm import Arm
from casadical.core.basics import InputError
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect
from casadical.effects.formula import Formula, parse
from casadical.effects.formula_effect import (
    FAR,
    OF_JOINT,
    SEAMS,
    FormulaEffect,
    check_formula,
    check_values,
    columns_of,
    variable,
)

_FACTOR = re.compile(r"[a-z]")


@dataclass(frozen=True)
class Law(FormulaEffect):
    """seam : where it acts, one of SEAMS; joint : number of the joint or link there

    formula : what is added there [rad, m or kg/kg]; of the seam `joints` with q, tau, approach, move of each joint
    factors : names of its parameters, single letters, and their realistic sizes; without them it must be zero
    station : where the instrument stands, in the measuring frame [m], for the seam `beam`, there with r, the range [m]
    count : number of joints, for the seam `joints`
    """

    seam: str = "joint"
    formula: str = ""
    factors: tuple[tuple[str, float], ...] = (("a", 30e-6),)
    station: tuple[float, float, float] = (0.0, 0.0, 0.0)
    count: int = 6

    name: ClassVar[str] = "law"
    on_list: ClassVar[str] = "unknown"
    signature: ClassVar[str] = "a law found in the data"

    def __post_init__(self) -> None:
        if self.seam not in SEAMS:
            raise InputError(f"law: seam = {self.seam!r}; allowed: {', '.join(SEAMS)}")
        numbered = SEAMS[self.seam].numbered
        if numbered != (self.joint is not None):
            raise InputError(f"law: joint {'is missing' if numbered else 'does not belong'} at the seam {self.seam!r}")
        names = [name for name, _ in self.factors]
        if not names or len(set(names)) < len(names) or not all(_FACTOR.fullmatch(n) and n not in "tr" for n in names):
            raise InputError(f"law: factors = {names}; allowed are different single letters, not t or r, one at least")
        if not all(0 < size <= 1e3 for _, size in self.factors):
            raise InputError(f"law: factors = {list(self.factors)}; their sizes must be above 0, and 1000 at most")
        formula = check_formula(self.formula, self.seam, names)
        if unused := [name for name in names if name not in formula.names]:
            raise InputError(f"formula {self.formula!r}: factor {unused[0]!r} is not in it")
        check_values(formula, names, {})

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """None: laws are searched for (see `casadical.discover`), or given."""
        return ()

    @property
    def of_measurement(self) -> bool:  # type: ignore[override]
        """Whether it acts on what the instrument reports."""
        return self.seam in ("beam", "distance", "point")

    @property
    def formulas(self) -> Mapping[str, Formula]:
        return {self.seam: parse(self.formula)}

    @property
    def place(self) -> str:
        """Where it acts, in words."""
        words = {"joint": "joint {}", "joints": "every joint", "tilt": "tilt of link {}", "shift": "shift of link {}"}
        words |= {"torque": "torque of joint {}", "response": "response of joint {}"}
        return words.get(self.seam, self.seam).format(self.joint)

    @property
    def drivers(self) -> tuple[str, ...]:
        own = {name for name, _ in self.factors}
        return tuple(name for name in parse(self.formula).names if name not in own)

    @property
    def label(self) -> str:
        return f"law at {self.place} by {', '.join(self.drivers)}"

    @property
    def conditions(self) -> tuple[str, ...]:
        names = columns_of(self.drivers)
        if self.seam == "joints":
            names += [f"{n}{j}" for n in self.drivers if n in ("approach", "move") for j in range(1, self.count + 1)]
        needed = ["payload_kg"] if self.seam.startswith("payload") else list(FAR) if self.seam == "distance" else []
        return tuple(dict.fromkeys([*names, *needed]))

    def refuse_joints(self, arm: Arm) -> None:
        super().refuse_joints(arm)
        if self.seam == "joints" and self.count != arm.n:
            raise InputError(f"law: count = {self.count}; robot {arm.name!r} has {arm.n} joints")

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        unit = SEAMS[self.seam].unit
        if self.seam != "joints":
            return {name: (size, unit) for name, size in self.factors}
        return {f"{name}{j}": (size, unit) for j in range(1, self.count + 1) for name, size in self.factors}

    def own_names(self, context: Context) -> dict[str, Symbolic]:
        return {name: self.value(context, name) for name, _ in self.factors} if self.seam != "joints" else {}

    def joint_angle(self, context: Context) -> Symbolic:
        moved = super().joint_angle(context)
        for j in range(1, context.arm.n + 1) if self.seam == "joints" else ():
            own = {name: variable(context, f"{name}{j}") for name in self.drivers if OF_JOINT.fullmatch(name)}
            own |= {name: self.value(context, f"{name}{j}") for name, _ in self.factors}
            moved[j - 1] = self.values_at("joints", context, own)[0]
        return moved
