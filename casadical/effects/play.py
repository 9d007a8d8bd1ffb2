"""Effects of backlash in a gear, and of bearings with run-out or play."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as ca

from casadical.core.parts import Arm
from casadical.core.transforms import Symbolic, small_frame, translate
from casadical.effects.base import Context, Counterparts, Effect, setting


@dataclass(frozen=True)
class Backlash(Effect):
    """Backlash of a gear, taken up by the gravity torque or by the direction of approach.

    The gravity torque decides on the flank in contact where it overcomes friction.
    friction : torque below which the direction of approach decides, divided by the joint's peak
        gravity torque
    width : torque over which the contact changes between the flanks, divided by the same
    """

    friction: float = 0.05
    width: float = 0.03

    name = "backlash"
    on_list = "standard"
    signature = "two positions, by the sign of the gravity torque"
    physics = (
        "Gravity or, where it is small, friction of the last motion decides on which flank the "
        "tooth rests (Ruderman, Hoffmann and Bertram 2009)."
    )
    confused_with = "friction_windup where the torque is small; nonlinear_stiffness where it is large"
    together = True
    size = {"half": (50e-6, "rad")}

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return `Backlash` at every joint for each of seven frictions and three widths."""
        frictions = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32)  # shares of the peak gravity torque
        return (cls(j, f, f * w) for j in arm.numbers for f in frictions for w in (0.3, 0.6, 1.2))

    @property
    def conditions(self) -> tuple[str, ...]:
        """Return the name of the column of its joint's direction of approach, in a tuple."""
        return (f"approach{self.joint}",)

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        """Return the shift of the joint towards the flank in contact [rad], by load and approach.

        It lies between plus and minus the parameter `half`. q : variable of the joint, not used
        """
        # Friction holds the link behind its last motion: it opposes the direction of approach.
        push = context.load(self.joint) - self.friction * context.conditions[f"approach{self.joint}"]
        return self.value(context, "half") * ca.tanh(push / self.width)

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        """Return a simulator's counterparts with backlash in the joint's drive.

        v : `half`, half of the backlash [rad]. It is an omission where that is not positive.
        """
        if v["half"] <= 0:
            return simulator.without_sign(self.label)
        limits = f"joint{self.joint}_play with limits of +-{1e6 * v['half']:.1f} urad"
        friction_torque = self.friction * simulator.peak_torque(self.joint)
        return simulator.with_drive(self, limits, play=v["half"], play_friction=friction_torque)


@dataclass(frozen=True)
class BacklashByLoad(Backlash):
    """Backlash taken up by the gravity torque alone, a candidate where the approach was not logged.

    Without friction the direction of approach has no influence (see `Backlash`).
    """

    friction: float = 0.0

    name = "backlash_by_load"
    answers_as = "backlash"
    conditions = ()

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return `BacklashByLoad` at every joint for each of five widths, from 0.003 to 0.3."""
        return (cls(j, 0.0, width) for j in arm.numbers for width in (0.003, 0.01, 0.03, 0.1, 0.3))

    @property
    def only_without(self) -> tuple[str, ...]:
        """Return the name of the joint's column of approach, in a tuple.

        Where it was logged, `Backlash` is the candidate instead.
        """
        return (f"approach{self.joint}",)

    def angle(self, context: Context, q: Symbolic) -> Symbolic:
        """Return the shift of the joint towards the flank to which gravity pushes it [rad].

        It lies between plus and minus the parameter `half`. q : variable of the joint, not used
        """
        return self.value(context, "half") * ca.tanh(context.load(self.joint) / self.width)


@dataclass(frozen=True)
class AxisWobble(Effect):
    """Run-out of a bearing: a joint's axis tilts and shifts periodically as it turns.

    cycles : periods per revolution of the joint, 1 or 2
    still : whether tilt and shift are about axes fixed in the link before the joint rather than in
        the one behind it, in whose frame they then have one cycle fewer and one more
    """

    cycles: int = setting(1, (1, 2))
    still: bool = setting(False, (False, True))

    name = "axis_wobble"
    on_list = "standard"
    acts_at = "turning joints"
    signature = "an axis that tilts and shifts as it turns (bearing, eccentric flange)"
    physics = "Bearing run-out: the axis of rotation tilts and translates periodically (ISO 230-7)."
    confused_with = "base_compliance for joint 1; gear_eccentricity of neighbours"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of each amplitude of an axis' two tilts and two shifts.

        Names are rx_sin, rx_cos (tilt about x), ry_..., x_... (shift along x), y_...
        """
        parts = [f"{c}_{f}" for c in ("rx", "ry", "x", "y") for f in ("sin", "cos")]
        return {p: (25e-6, "rad") if p[0] == "r" else (20e-6, "m") for p in parts}

    def link(self, number: int, context: Context) -> Symbolic:
        """Return tilt and shift of the joint's axis as a transform (4, 4) [m] in its link's frame.

        It is the identity where `number`, the link (1-based), is not that of the effect's joint.
        """
        if number != self.joint:
            return ca.SX.eye(4)
        q = context.turned(number)
        rx, ry, x, y = (
            self.value(context, f"{c}_sin") * ca.sin(self.cycles * q)
            + self.value(context, f"{c}_cos") * ca.cos(self.cycles * q)
            for c in ("rx", "ry", "x", "y")
        )
        if self.still:
            (rx, ry), (x, y) = _turned_back(rx, ry, q), _turned_back(x, y, q)
        return small_frame(x, y, 0, rx, ry, 0)


def _turned_back(x: Symbolic, y: Symbolic, q: Symbolic) -> tuple[Symbolic, Symbolic]:
    """Return components x, y of a vector in axes that are rotated about z by q [rad]."""
    return ca.cos(q) * x + ca.sin(q) * y, ca.cos(q) * y - ca.sin(q) * x


@dataclass(frozen=True)
class BearingPlay(Effect):
    """Play of a bearing, which tilts under the moment of weight and moves along the load.

    soft : moment at which the play is taken up, divided by the larger peak gravity torque of the
        joint and the one before it; above 1 it acts as a spring
    The bearing of the last joint includes the tool flange.
    """

    soft: float = setting(0.3, (0.1, 0.3))

    name = "bearing_play"
    on_list = "extended"
    acts_at = "joints"
    signature = "a bearing or flange that rocks under the weight beyond it"
    physics = (
        "A bearing or bolted flange resists tilting by its stiffness, after play; its inner "
        "ring drops by the radial play (ISO 5753-1)."
    )
    confused_with = "link_flexure of the adjacent links; axis_wobble; payload_error at the flange"
    size = {"rock": (60e-6, "rad"), "drop": (30e-6, "m")}

    def link(self, number: int, context: Context) -> Symbolic:
        """Return tilt and drop of the joint's bearing as a transform (4, 4) [m].

        It is in the frame of link `number` (1-based), and the identity for other joints' links.
        """
        if number != self.joint:
            return ca.SX.eye(4)
        turn = context.frames[number - 1][:3, :3].T
        # Moments across the axis are scaled by the larger of the peak gravity torques of this
        # joint and the one before.
        moment = turn @ context.moment(number) / context.greatest(max(number - 1, 1), number)
        size = ca.sqrt(moment[0] ** 2 + moment[1] ** 2 + 1e-8)
        share = self.value(context, "rock") * ca.tanh(size / self.soft) / ca.tanh(1 / self.soft) / size
        down = turn @ context.gravity / 9.81
        across = ca.vertcat(down[0], down[1], 0)
        drop = self.value(context, "drop") * across / ca.sqrt(ca.sumsqr(across) + 0.01)
        return translate(*ca.vertsplit(drop)) @ small_frame(0, 0, 0, share * moment[0], share * moment[1], 0)
