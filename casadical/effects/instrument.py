"""Effects of the measurement: motion of the measuring frame or the reflector, and new sessions."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadical.core.parts import Arm
from casadical.core.transforms import Symbolic, small_frame, translate
from casadical.effects.base import Context, Effect, setting


@dataclass(frozen=True)
class FrameDrift(Effect):
    """Drift of the measuring frame relative to the robot's base with the column `progress`.

    shape : exponent of progress; 1: constant rate, below 1: a falling, above 1: a rising one
    """

    shape: float = setting(1.0, (0.5, 1.0, 2.0), steps=True)

    name = "frame_drift"
    on_list = "standard"
    of_measurement = True
    signature = "a measuring frame that creeps with time"
    needs = ("progress",)
    physics = "Tripods settle and floors warm up, by tens of micrometres an hour."
    confused_with = "thermal_growth and thermal_zero_drift while the temperature only rises; a step in time"
    size = dict.fromkeys("xyz", (6e-05, "m")) | {f"r{c}": (25e-6, "rad") for c in "xyz"}

    def course(self, context: Context) -> Symbolic:
        """Return the drift at a pose, divided by that at the end of the campaign, 0 to 1."""
        return (context.conditions["progress"] + 1e-6) ** self.shape

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """Return the point displaced by the drift at a pose, shape (3,) [m].

        point : without the drift, shape (3,) [m]; both are in the measuring frame
        """
        when = self.course(context)
        creep = ca.vertcat(*(self.value(context, c) for c in "xyz"))
        turn = ca.vertcat(*(self.value(context, f"r{c}") for c in "xyz"))
        return point + when * (creep + ca.cross(turn, point))


@dataclass(frozen=True)
class FrameSettling(FrameDrift):
    """Exponential settling of the measuring frame relative to the robot after a campaign's start.

    settles : constant of decay in units of `progress`, which is 0 at the first pose, 1 at the last
    """

    settles: float = 0.1

    name = "frame_settling"
    answers_as = "frame_drift"
    signature = "a measuring frame that moves at the start and comes to rest"
    physics = (
        "An instrument, a tripod or an arm that warms up comes to its temperature exponentially (Newton's law of "
        "cooling); it moves until then."
    )

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return `FrameSettling` for each of four constants of decay."""
        return (cls(None, settles=s) for s in (0.02, 0.05, 0.12, 0.3))

    def course(self, context: Context) -> Symbolic:
        """Return the motion at a pose, divided by the whole motion at infinite progress, 0 to 1."""
        return 1 - ca.exp(-context.conditions["progress"] / self.settles)


# Progress at candidate steps of a frame, 0 at the first pose, 1 at the last. They are few, since a
# step of six parameters also fits data with a step between two of them.
STEP_TIME_GRID = tuple(float(t) for t in np.linspace(0.06, 0.94, 12))


@dataclass(frozen=True)
class FrameStep(Effect):
    """A step of a link's frame, or of the measuring frame, in all six degrees of freedom.

    at : `progress` after which the frame has moved, 0 at the first pose, 1 at the last
    joint : link whose frame moves, 1-based; None: the measuring frame, relative to the robot's base
    """

    at: float = setting(0.5, STEP_TIME_GRID, steps=True)

    name = "frame_step"
    on_list = "extended"
    signature = "a jump of the pedestal, the instrument or one link, in all six degrees of freedom"
    needs = ("progress",)
    physics = "A pedestal slips in its anchors, a tripod is knocked or a bolted flange slips."
    confused_with = "target_shift and joint_zero_step at the same time; frame_drift"
    size = dict.fromkeys("xyz", (6e-5, "m")) | {f"r{c}": (4e-5, "rad") for c in "xyz"}

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return steps of the measuring frame and all links but the last, at twelve values `at`."""
        return (cls(frame, at) for frame in (None, *arm.numbers[:-1]) for at in STEP_TIME_GRID)

    def _six(self, context: Context) -> list[Symbolic]:
        """Return x, y, z [m], rx, ry, rz [rad] of the frame's step at poses after it, else zero."""
        after = context.conditions["progress"] > self.at
        return [self.value(context, name) * after for name in self.size]

    def link(self, number: int, context: Context) -> Symbolic:
        """Return the step of the frame of link `number`, (4, 4) [m], in that frame.

        It is the identity for other links than `joint`. number : 1-based
        """
        return small_frame(*self._six(context)) if number == self.joint else ca.SX.eye(4)

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """Return the point displaced by a step of the measuring frame, shape (3,) [m].

        point : without the step, shape (3,) [m]; both are in the measuring frame
        """
        if self.joint is not None:
            return point
        x, y, z, *turn = self._six(context)
        return point + ca.vertcat(x, y, z) + ca.cross(ca.vertcat(*turn), point)


@dataclass(frozen=True)
class SmrOffset(Effect):
    """Offset of the optical centre of a reflector from the centre of its sphere.

    station : position of the instrument in the measuring frame [m]; most have their origin there
    """

    station: tuple[float, float, float] = (0.0, 0.0, 0.0)

    name = "smr_offset"
    on_list = "extended"
    of_measurement = True
    signature = "an offset of the reflector that is constant with respect to the beam"
    physics = (
        "A reflector is turned in its nest to face the instrument: its centre offset follows the beam (ISO 10360-10)."
    )
    confused_with = "tracker_scale; refraction"
    size = {"along": (10e-6, "m"), "across": (10e-6, "m"), "above": (10e-6, "m")}

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """Return the point displaced along, across and above the beam, shape (3,) [m].

        point : without the offset, shape (3,) [m]; both are in the measuring frame, whose third
            axis is taken as vertical: across is horizontal
        """
        beam = point - ca.DM(self.station)
        along = beam / ca.sqrt(ca.sumsqr(beam) + 1e-12)
        across = ca.vertcat(-along[1], along[0], 0) / ca.sqrt(along[0] ** 2 + along[1] ** 2 + 1e-12)
        axes = ca.horzcat(along, across, ca.cross(along, across))
        return point + axes @ ca.vertcat(*(self.value(context, n) for n in self.sizes()))


@dataclass(frozen=True)
class Session(Effect):
    """Differences of a later session from the first: base frame, tool point and joint zero offsets.

    which : name of the session in the column `session`
    base_too, tool_too : whether the session has a base frame and a tool point of its own
    zeros : joints 1 to `zeros` have zero offsets of their own in the session
    """

    which: str = setting("", given=True)
    base_too: bool = setting(True, given=True)
    tool_too: bool = setting(True, given=True)
    zeros: int = setting(0, given=True)

    name = "session"
    on_list = "unknown"
    of_measurement = True
    prior_sigma = 1.0
    signature = "another session: instrument, pedestal and target were set up again"

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return no candidates: sessions are declared, not searched for."""
        return ()

    @property
    def label(self) -> str:
        """Return the identifier of the effect: session_NAME OF THE SESSION."""
        return f"{self.name}_{self.which}"

    @property
    def column(self) -> str:
        """Return the name of the column that is 1 in this session, else 0."""
        return f"session_{self.which}"

    @property
    def conditions(self) -> tuple[str, ...]:
        """Return the name of the column that is 1 at the session's poses, in a tuple."""
        return (self.column,)

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return prior standard deviation and unit of each difference from the first session.

        Names are x, y, z, rx, ry, rz of the base frame, tool_x, tool_y, tool_z, zero1, zero2, ...
        """
        base = dict.fromkeys(("x", "y", "z"), (1.0, "m")) | dict.fromkeys(("rx", "ry", "rz"), (0.5, "rad"))
        tool = {f"tool_{c}": (0.05, "m") for c in "xyz"}
        zeros = {f"zero{i}": (1e-3, "rad") for i in range(1, self.zeros + 1)}
        return (base if self.base_too else {}) | (tool if self.tool_too else {}) | zeros

    def _now(self, context: Context, name: str) -> Symbolic:
        """Return the value of a parameter at a pose of this session, and zero at all others."""
        return self.value(context, name) * context.conditions[self.column]

    def joint_angle(self, context: Context) -> Symbolic:
        """Return the differences of the joint zero offsets, shape (n,) [rad or m].

        They are zero at poses of other sessions.
        """
        moved = ca.SX.zeros(context.arm.n)
        for i in range(self.zeros):
            moved[i] = self._now(context, f"zero{i + 1}")
        return moved

    def base(self, context: Context) -> Symbolic:
        """Return the session's base frame in the base frame of the first, a transform (4, 4) [m].

        It is the identity at poses of other sessions.
        """
        if not self.base_too:
            return ca.SX.eye(4)
        return small_frame(*(self._now(context, name) for name in ("x", "y", "z", "rx", "ry", "rz")))

    def tool(self, context: Context) -> Symbolic:
        """Return the tool point's shift from the first session, (4, 4) [m] in the flange frame.

        It is the identity at poses of other sessions.
        """
        return translate(*(self._now(context, f"tool_{c}") for c in "xyz")) if self.tool_too else ca.SX.eye(4)
