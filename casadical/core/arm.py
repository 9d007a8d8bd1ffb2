"""A robot as plain data: rows, closed loops, frames, payload and gravity; no model and no parameters."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from casadical.core import parts
from casadical.core.basics import Array, InputError
from casadical.core.drive import Drive

STANDARD_GRAVITY = 9.80665
# Columns of the direction of gravity in the robot's base frame, where it was logged at every pose.
GRAVITY = ("gravity_x", "gravity_y", "gravity_z")


@dataclass(frozen=True, eq=False)
class Arm:
    """A serial robot's structure, with closed four-bar loops where it has them.

    joints : the rows, from base to flange
    base : T_M0, robot base in the measuring frame; tool : T_nE, measured point in the last link's frame
    gravity : shape (3,) [m/s^2], given in `gravity_frame`; where that is "logged", in the base frame while nothing
        was logged, and its size counts
    payload : declared mass and mass centre in the last link's frame; poses may carry another mass (column payload_kg)
    tool_name : of the measured point, where there are several; targets : the others, named in the column `tool`
    widths : how far the parameters of each group may be off; body_width : masses and mass centres of the links
    sessions : what is found again in each session that a column `session` names
    drive : what is known of its drives
    masses : of the links; estimated ones tell where gravity deflects joints and by how much, but no stiffness
    Raises InputError for a structure that cannot be built.
    """

    name: str
    joints: tuple[parts.Joint, ...]
    base: parts.Placement = field(default_factory=lambda: parts.Placement(np.eye(4)))
    tool: parts.Placement = field(default_factory=lambda: parts.Placement(np.eye(4)))
    loops: tuple[parts.FourBar, ...] = ()
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -STANDARD_GRAVITY]))
    gravity_frame: Literal["measuring", "base", "logged"] = "measuring"
    payload: parts.Body | None = None
    widths: Mapping[str, parts.Width] = field(default_factory=lambda: dict(parts.WIDTHS))
    body_width: parts.BodyWidth = field(default_factory=parts.BodyWidth)
    tool_name: str = ""
    targets: tuple[parts.Target, ...] = ()
    masses: Literal["declared", "estimated"] = "declared"
    drive: Drive | None = None
    sessions: parts.Sessions = field(default_factory=parts.Sessions)

    def __post_init__(self) -> None:
        if not self.joints:
            raise InputError(f"robot {self.name!r} has no joints; at least one row is needed")
        for i, joint in enumerate(self.joints, 1):
            parts.refuse_joint(self.name, i, joint)
        object.__setattr__(self, "joints", parts.with_hayati(self.joints))
        _refuse_couplings(self)
        for k, loop in enumerate(self.loops, 1):
            _refuse_unbuildable(self, k, loop)
        if self.drive:
            self.drive.refuse_other(self.n)
        names = [self.tool_name, *(t.name for t in self.targets)]
        if self.targets and (len(set(names)) < len(names) or not all(names)):
            raise InputError(f"tool: names {', '.join(map(repr, names))}; each tool needs a name of its own")

    @property
    def n(self) -> int:
        return len(self.joints)

    @property
    def numbers(self) -> range:
        return range(1, self.n + 1)

    @property
    def revolute(self) -> tuple[int, ...]:
        return tuple(i for i in self.numbers if self.joints[i - 1].kind == "revolute")

    @property
    def units(self) -> tuple[str, ...]:
        return tuple("rad" if j.kind == "revolute" else "m" for j in self.joints)

    @property
    def reading_units(self) -> dict[str, float]:
        """Key of each joint's reading, as columns of measurements are named (q1_deg, q2_mm), and its factor to SI."""
        units = {"revolute": ("deg", np.pi / 180), "prismatic": ("mm", 1e-3)}
        return {f"q{i}_{units[j.kind][0]}": units[j.kind][1] for i, j in enumerate(self.joints, 1)}

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper ends of the joints' ranges, each shape (n,) [rad or m]."""
        lower, upper = np.array([(j.lower, j.upper) for j in self.joints]).T
        return lower, upper

    def coupled(self, q: Array) -> Array:
        """Readings, shape (n, joints) [rad or m], with those of coupled and locked joints as they follow."""
        made = np.array(q, dtype=float)
        for i, joint in enumerate(self.joints):
            if joint.coupling is not None:
                made[:, i] = joint.coupling.at + sum(k * made[:, j - 1] for j, k in joint.coupling.follows)
        return made

    def near(self, joint: int) -> tuple[int, ...]:
        """Numbers of the joints whose motors can move this one: those right before it and behind it."""
        return tuple(i for i in (joint - 2, joint - 1, joint + 1, joint + 2) if i in self.numbers)

    @cached_property
    def reach(self) -> float:
        """Sum of all link lengths and the tool [m]; no point can lie farther from the base."""
        links = sum(
            abs(j.a) + abs(j.d) + max(map(abs, (j.lower, j.upper))) * (j.kind == "prismatic") for j in self.joints
        )
        return float(links + np.linalg.norm(self.tool.T[:3, 3]))


def _refuse_couplings(arm: Arm) -> None:
    """A coupled joint follows joints that have readings of their own."""
    for i, joint in enumerate(arm.joints, 1):
        for other, _ in joint.coupling.follows if joint.coupling else ():
            if other not in arm.numbers or other == i or arm.joints[other - 1].coupling is not None:
                own = [str(k) for k, j in enumerate(arm.joints, 1) if j.coupling is None and k != i]
                raise InputError(f"joint[{i}].follows: joint {other}; allowed: {', '.join(own)}, which are not coupled")


def _refuse_unbuildable(arm: Arm, number: int, loop: parts.FourBar) -> None:
    """A four-bar drives one joint from the one before it, both turning about parallel axes a ground bar apart."""
    where = f"four_bar[{number}]: carrier = {loop.carrier}, driven = {loop.driven}"
    if not 1 <= loop.carrier < loop.driven <= arm.n or loop.driven - loop.carrier != 1:
        raise InputError(
            f"{where}: must be two neighbouring joints of this robot, the carrier before the driven one (1..{arm.n})"
        )
    joint = arm.joints[loop.driven - 1]
    if not parts.parallel(arm.joints, loop.carrier - 1) or not joint.a:
        raise InputError(
            f"{where}: their axes must be parallel and apart; row {loop.driven} has "
            f"alpha_deg = {np.rad2deg(joint.alpha):.6g}, a_mm = {1e3 * joint.a:.6g}"
        )
    if {arm.joints[loop.carrier - 1].kind, joint.kind} != {"revolute"}:
        raise InputError(f"{where}: both must be revolute joints")
    if [other.driven for other in arm.loops].count(loop.driven) > 1:
        raise InputError(f"{where}: joint {loop.driven} is driven by two loops; keep one")
