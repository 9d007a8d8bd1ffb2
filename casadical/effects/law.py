"""A law given as text: what is added at one place of the robot, as a formula of what is known at a pose.

It is data: a formula is parsed and never executed (see `formula`). `casadical discover` writes such laws.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from casadical.core.arm import Arm
from casadical.core.errors import InputError
from casadical.core.transforms import Symbolic, small_frame, translate
from casadical.effects.base import Context, Effect
from casadical.effects.formula import NUMERIC, Formula, parse, refuse_unknown

# Place -> (components of the formula, unit, whether it needs the number of a joint or link).
SEAMS = {
    "joint": (1, "rad", True),
    "joints": (1, "rad", False),
    "tilt": (3, "rad", True),
    "shift": (3, "m", True),
    "base tilt": (3, "rad", False),
    "base shift": (3, "m", False),
    "tool shift": (3, "m", False),
    "beam": (1, "m", False),
    "payload": (1, "kg/kg", False),
}
# Columns by their name in a formula, where it is another one.
COLUMNS = {"t": "progress", "payload": "payload_kg", "warmth": "warmth_0s"}
COLUMN = re.compile(r"t|payload|warmth|warmth_\d+s|approach\d+|move\d+|memory\d+_\d+mrad")
_OF_POSE = re.compile(r"(q|tau)(\d+)|m(\d+)[xyz]|[gp][xyz]")
_OF_JOINT = re.compile(r"q|tau|approach|move")
_FACTOR = re.compile(r"[a-z]")
ALLOWED = (
    "q1 (reading [rad or m]), tau1 (load, share of the joint's great torque), m1x (moment at a link, share), gx "
    "(gravity in the flange frame, 1 at most), px (flange [m]), t (time, 0 to 1), warmth, warmth_600s [K], payload "
    "[kg], approach1 (-1 or 1), move1 (from the pose before [rad or m]), memory1_300mrad (of motions "
    "so far back, -1 to 1)"
)


@dataclass(frozen=True)
class Law(Effect):
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
        components, _, numbered = SEAMS[self.seam]
        if numbered != (self.joint is not None):
            raise InputError(f"law: joint {'is missing' if numbered else 'does not belong'} at the seam {self.seam!r}")
        names = [name for name, _ in self.factors]
        if not names or len(set(names)) < len(names) or not all(_FACTOR.fullmatch(n) and n not in "tr" for n in names):
            raise InputError(f"law: factors = {names}; allowed are different single letters, not t or r, one at least")
        if not all(0 < size <= 1e3 for _, size in self.factors):
            raise InputError(f"law: factors = {list(self.factors)}; their sizes must be above 0, and 1000 at most")
        found = parse(self.formula)
        if found.components != components:
            raise InputError(f"formula {self.formula!r}: seam {self.seam!r} needs {components} of its components")
        refuse_unknown(found, lambda name: name in names or self._known(name), f"{', '.join(names)}, {ALLOWED}")
        if unused := [name for name in names if name not in found.names]:
            raise InputError(f"formula {self.formula!r}: factor {unused[0]!r} is not in it")
        self._refuse_constant(found, names)

    def _known(self, name: str) -> bool:
        if self.seam == "joints" and _OF_JOINT.fullmatch(name):
            return True
        if self.seam == "beam" and name == "r":
            return True
        if self.seam == "payload" and not name.startswith("q") and not COLUMN.fullmatch(name):
            return False
        return bool(COLUMN.fullmatch(name) or _OF_POSE.fullmatch(name))

    def _refuse_constant(self, formula: Formula, names: list[str]) -> None:
        """Raises InputError for a formula that is not zero without its factors."""
        rng = np.random.default_rng(0)
        at = {n: np.zeros(20) if n in names else rng.uniform(-1, 1, 20) for n in formula.names}
        with np.errstate(all="ignore"):
            values = np.broadcast_arrays(*formula.values(at, NUMERIC))
        if any(np.nan_to_num(v).any() for v in values):
            raise InputError(f"formula {self.formula!r}: it must be zero where {', '.join(names)} are zero")

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """None: laws are searched for (see `casadical.discover`), or given."""
        return ()

    @property
    def of_measurement(self) -> bool:  # type: ignore[override]
        """Whether it acts on what the instrument reports."""
        return self.seam == "beam"

    @property
    def place(self) -> str:
        """Where it acts, in words."""
        words = {"joint": "joint {}", "joints": "every joint", "tilt": "tilt of link {}", "shift": "shift of link {}"}
        return words.get(self.seam, self.seam).format(self.joint)

    @property
    def drivers(self) -> tuple[str, ...]:
        """Names that its formula uses besides the factors."""
        own = {name for name, _ in self.factors}
        return tuple(name for name in parse(self.formula).names if name not in own)

    @property
    def label(self) -> str:
        return f"law at {self.place} by {', '.join(self.drivers)}"

    @property
    def conditions(self) -> tuple[str, ...]:
        names = [n for n in self.drivers if COLUMN.fullmatch(n)]
        if self.seam == "joints":
            names += [f"{n}{j}" for n in self.drivers if n in ("approach", "move") for j in range(1, self.count + 1)]
        needed = ["payload_kg"] if self.seam == "payload" else []
        return tuple(dict.fromkeys([*(COLUMNS.get(n, n) for n in names), *needed]))

    def refuse_joints(self, arm: Arm) -> None:
        super().refuse_joints(arm)
        for name in (*self.drivers, *self.conditions):
            found = re.fullmatch(r"(?:q|tau|m|approach|move|memory)(\d+)(?:[xyz]|_\d+mrad)?", name)
            if found and int(found[1]) not in arm.numbers:
                raise InputError(f"formula {self.formula!r}: {name}; robot {arm.name!r} has joints 1 to {arm.n}")
        if self.seam == "joints" and self.count != arm.n:
            raise InputError(f"law: count = {self.count}; robot {arm.name!r} has {arm.n} joints")
        if self.seam == "payload" and arm.payload is None:
            raise InputError(f"law: seam = 'payload'; robot {arm.name!r} declares no payload")

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        unit = SEAMS[self.seam][1]
        if self.seam != "joints":
            return {name: (size, unit) for name, size in self.factors}
        return {f"{name}{j}": (size, unit) for j in range(1, self.count + 1) for name, size in self.factors}

    def _values(self, context: Context, own: Mapping[str, Symbolic] | None = None) -> list[Symbolic]:
        formula = parse(self.formula)
        given = {name: self.value(context, name) for name, _ in self.factors} if self.seam != "joints" else {}
        given |= own or {}
        return formula.values({n: given[n] if n in given else variable(context, n) for n in formula.names})

    def energy(self, context: Context) -> Symbolic:
        payload = context.arm.payload
        if self.seam != "payload" or payload is None:
            return 0.0
        T = context.frames[-1]
        centre = T[:3, :3] @ ca.DM(payload.com) + T[:3, 3]
        return -self._values(context)[0] * context.conditions["payload_kg"] * ca.dot(context.gravity, centre)

    def joint_angle(self, context: Context) -> Symbolic:
        n = context.arm.n
        moved = ca.SX.zeros(n)
        if self.seam == "joint":
            assert self.joint is not None
            moved[self.joint - 1] = self._values(context)[0]
        for j in range(1, n + 1) if self.seam == "joints" else ():
            of_joint = (name for name in self.drivers if _OF_JOINT.fullmatch(name))
            own = {name: variable(context, f"{name}{j}") for name in of_joint}
            own |= {name: self.value(context, f"{name}{j}") for name, _ in self.factors}
            moved[j - 1] = self._values(context, own)[0]
        return moved

    def link(self, number: int, context: Context) -> Symbolic:
        if self.seam not in ("tilt", "shift") or number != self.joint:
            return ca.SX.eye(4)
        return _moved(self._values(context), turn=self.seam == "tilt")

    def base(self, context: Context) -> Symbolic:
        if not self.seam.startswith("base"):
            return ca.SX.eye(4)
        return _moved(self._values(context), turn=self.seam == "base tilt")

    def tool(self, context: Context) -> Symbolic:
        return _moved(self._values(context), turn=False) if self.seam == "tool shift" else ca.SX.eye(4)

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        if self.seam != "beam":
            return point
        beam = point - ca.DM(self.station)
        r = ca.sqrt(ca.sumsqr(beam) + 1e-12)
        return point + beam / r * self._values(context, {"r": r})[0]


def _moved(values: list[Any], *, turn: bool) -> Symbolic:
    return small_frame(0, 0, 0, *values) if turn else translate(*values)


def variable(context: Context, name: str) -> Symbolic:
    """The value of a name in a formula (see ALLOWED). Raises KeyError for a column that is not there."""
    if COLUMN.fullmatch(name):
        return context.conditions[COLUMNS.get(name, name)]
    axis = "xyz".find(name[-1])
    if name[0] == "g":
        g = ca.DM(context.arm.gravity)
        return (context.frames[-1][:3, :3].T @ context.gravity)[axis] / float(ca.norm_2(g))
    if name[0] == "p":
        return context.frames[-1][axis, 3]
    if name[0] == "m":
        link = int(name[1:-1])
        turn = context.frames[link - 1][:3, :3].T
        return (turn @ context.moment(link))[axis] / context.great_moment
    number = int(name.removeprefix("tau").removeprefix("q"))
    return context.load(number) if name.startswith("tau") else context.q[number - 1]
