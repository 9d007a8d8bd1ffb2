"""What a simulator has in place of joint compliances and effects: springs, play, dry friction, ratios; plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import Body

# Of a rigid joint [N m/rad or N/m]: 10 kN m turn it by 1e-8 rad.
RIGID = 1e12


@dataclass(frozen=True)
class Drive:
    """What stands between a joint's command and its link.

    compliance : of its spring [rad/(N m)], 0 for none
    k1, k3 : of a spring k1 d + k3 d^3 in its place [N m/rad, N m/rad^3]
    give, give_stiffness : half range [rad] and stiffness [N m/rad] of a second spring in series that ends at stops
    ratio : turn of the joint per turn commanded; play : half of it [rad]; play_friction, friction : dry [N m]
    """

    compliance: float = 0.0
    k1: float = 0.0
    k3: float = 0.0
    give: float = 0.0
    give_stiffness: float = 0.0
    ratio: float = 1.0
    play: float = 0.0
    play_friction: float = 0.0
    friction: float = 0.0

    @property
    def stiffness(self) -> float:
        """Of the actuator [N m/rad]; a joint that hardens has its spring beside the actuator."""
        return RIGID if self.k1 or not self.compliance else 1 / self.compliance


@dataclass(frozen=True)
class Balancer:
    """A spring between a link and the one before it.

    joint : 1-based; anchor : in levers; phase : reading at which all lie in line [rad]
    swing : torque of the spring [N m] at its greatest; ahead : by how much its phase is ahead [rad]
    pull : torque of the constant pull [N m], as the effect's preload
    """

    joint: int
    anchor: float
    phase: float
    swing: float
    ahead: float
    pull: float


@dataclass(frozen=True)
class Omission:
    """An effect that has no counterpart, and why; parts : short names of the parameters that have none, empty: all."""

    label: str
    why: str
    parts: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.label}: {self.why}"


@dataclass(frozen=True, eq=False)
class Counterparts:
    """A robot's compliances and effects as a simulator knows them.

    drives : of each joint; torque_scale, mean_load : great torque of each joint [N m or N], mean one as a share of it
    great_moment : the greatest on a turning joint [N m]
    base : stiffness about the base frame's x and y [N m/rad], infinite where it is rigid
    flexures : of a link (1-based), stiffness [N m/rad] about its axes of the whole link as a beam
    balancers : springs between a link and the one before it
    bodies : of the links, the true ones; payload : the true one
    payload_factor : its mass as a multiple of the declared one
    written : what became of each effect, in words; left_out : why others have none
    """

    drives: tuple[Drive, ...]
    torque_scale: Array
    mean_load: Array
    great_moment: float
    bodies: tuple[Body | None, ...] = ()
    payload: Body | None = None
    payload_factor: float = 1.0
    base: tuple[float, float] = (np.inf, np.inf)
    flexures: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
    balancers: tuple[Balancer, ...] = ()
    written: tuple[str, ...] = ()
    left_out: tuple[Omission, ...] = ()

    def drive(self, joint: int | None) -> Drive:
        """Of a joint (1-based)."""
        assert joint is not None
        return self.drives[joint - 1]

    def great(self, joint: int | None) -> float:
        """The great torque on a joint (1-based) [N m or N]; of None the greatest moment."""
        return float(self.torque_scale[joint - 1] if joint else self.great_moment)

    def with_drive(self, joint: int | None, **change: object) -> Counterparts:
        """With one joint's drive changed."""
        drives = list(self.drives)
        drives[(joint or 0) - 1] = replace(self.drive(joint), **change)  # type: ignore[arg-type]
        return replace(self, drives=tuple(drives))

    def with_springs(self, label: str, sizes: Mapping[str, float], link: int) -> Counterparts:
        """With hinges of the foot (link 0) or of a link; an axis that came out negative stays rigid.

        sizes : turn about each axis under the greatest torque [rad]
        """
        made, great = self, self.great(None)
        k = tuple(great / size if size > 0 else np.inf for size in sizes.values())
        wrong = tuple(name for name, size in sizes.items() if size < 0)
        if wrong:
            made = made.without(label, f"{', '.join(wrong)} came out negative: rigid there", wrong)
        if all(np.isinf(k)):
            return made
        stiff = ", ".join(f"{s:.4g}" for s in k)
        if not link:
            made = replace(made, base=k)  # type: ignore[arg-type]
            return made.noted(f"{label}: hinges of the foot, {stiff} N m/rad")
        made = replace(made, flexures={**made.flexures, link: k})  # type: ignore[dict-item]
        return made.noted(f"{label}: link {link} in three pieces between hinges, {stiff} N m/rad in all")

    def noted(self, text: str) -> Counterparts:
        """With a line on what became of an effect."""
        return replace(self, written=(*self.written, text))

    def without(self, label: str, why: str, parts: tuple[str, ...] = ()) -> Counterparts:
        """With an effect that has no counterpart (see `Omission`)."""
        return replace(self, left_out=(*self.left_out, Omission(label, why, parts)))

    def without_sign(self, label: str) -> Counterparts:
        """With the line on an effect whose counterpart would need a negative stiffness."""
        return self.without(label, "no counterpart, for its value or its spring has the wrong sign")
