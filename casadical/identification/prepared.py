"""The one way into a question: a robot and what was measured of it, made ready to be identified or diagnosed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

from casadical.core.basics import InputError
from casadical.core.estimated_masses import with_estimated_masses, with_payload, without_masses
from casadical.core.telling.result import Shown
from casadical.core.transforms import frame
from casadical.effects import LinkMasses, PayloadError
from casadical.identification.placement import place_frames
from casadical.identification.plausibility import check_against
from casadical.identification.prior import Prior, carry_over
from casadical.identification.result import Identification, Tried
from casadical.identification.sessions import place_sessions, with_sessions
from casadical.measurements.measurements import Measurements
from casadical.robot.knowledge import Knowledge
from casadical.robot.robot import Robot

Method = Literal["KM", "SKCM"]
METHODS: dict[str, tuple[str, ...]] = {"KM": ("kinematic",), "SKCM": ("kinematic", "compliance")}
# What of the links' masses is in the model: as the file says; and what nobody knows of them; and all of them.
Masses = Literal["declared", "unknown", "free"]


@dataclass(frozen=True, eq=False)
class Prepared(Shown):
    """A robot and its measurements, as identifications and diagnoses start from them (see `prepare`).

    robot : nominal, with all in its model that measurements and prior ask for; knowledge : of the robot as it was given
    free : labels of the effects that were added to the base model: masses, sessions
    prior : of what is known from elsewhere; method : of the paper, None for parameters of one's own
    identification : of the base model, where there is one already
    tried : whether the data carry a compliance that is not declared, where that was tried
    """

    robot: Robot
    sets: tuple[Measurements, ...]
    free: tuple[str, ...] = ()
    prior: Prior = field(default_factory=Prior)
    knowledge: Knowledge = field(default_factory=Knowledge)
    method: Method | None = None
    identification: Identification | None = None
    tried: Tried | None = None

    @property
    def _line(self) -> str:
        return f" {self.robot.name!r} and {sum(map(len, self.sets))} poses"

    @cached_property
    def start(self) -> Robot:
        """The robot with base and tool placed. Raises InputError for what this robot cannot have measured."""
        for m in self.sets:
            check_against(self.robot, m)
        return place_sessions(self.robot, self.sets)

    @property
    def compliant(self) -> Prepared | None:
        """The same with compliance of all turning joints in the model; None where the robot file declares some."""
        if self.identification or not undeclared(self.robot):
            return None
        robot, free = all_compliant(self.robot, self.sets)
        return replace(self, robot=robot, free=(*free, *self.free))


def prepare(
    robot: Robot,
    measurements: Measurements | Sequence[Measurements],
    prior: Robot | Prior | None = None,
    *,
    method: Method | None = None,
    masses: Masses = "declared",
    tool_turns: bool = False,
) -> Prepared:
    """Make a robot and measurements ready: prior, method, masses that nobody knows, sessions, turn of the tool.

    prior : the robot from another campaign, or as of `carry_over`; method : of the paper, which knows about masses
    tool_turns : whether an unknown tool turns freely where orientations were measured
    Raises InputError.
    """
    sets = _sets_of(measurements)
    if isinstance(prior, Robot):
        robot, prior = carry_over(robot, prior)
    known = prior or Prior()
    if known.frozen:
        known.refuse_uncovered(sets)
    knowledge, free = robot.knowledge or Knowledge(), tuple[str, ...]()
    if method is not None:
        robot, free = by_method(robot, method, sets)
    elif masses != "declared":
        robot, free = with_unknown_masses(robot, sets)
        if not free and (masses == "free" or robot.masses == "estimated"):
            robot, free = _with_free_masses(robot)
    robot, sessions = with_sessions(robot, sets)
    robot = _with_turning_tool(robot, sets) if tool_turns else robot
    return Prepared(robot, sets, (*free, *sessions), known, knowledge, method)


def _sets_of(measurements: Measurements | Sequence[Measurements]) -> tuple[Measurements, ...]:
    sets = (measurements,) if isinstance(measurements, Measurements) else tuple(measurements)
    wrong = [type(m).__name__ for m in sets if not isinstance(m, Measurements)]
    if wrong or not sets:
        raise InputError(
            f"measurements are {wrong[0] if wrong else 'an empty list'}; "
            "allowed: one or several Measurements (see from_table, read_measurements)"
        )
    return sets


def by_method(robot: Robot, method: str, sets: Sequence[Measurements]) -> tuple[Robot, tuple[str, ...]]:
    """The robot as a method of the paper takes it, and the labels of effects that it adds. Raises InputError."""
    if method not in METHODS:
        raise InputError(f"method {method!r} is not known; allowed: {', '.join(METHODS)}")
    if method == "KM":  # rigid joints
        return robot.with_values(dict.fromkeys(robot.parameters.select(["compliance"]), 0.0)), ()
    return with_unknown_masses(robot, sets)


def undeclared(robot: Robot) -> bool:
    """Whether the robot file says of no joint that it gives, and there is one that turns."""
    return all(j.compliance is None for j in robot.joints) and bool(robot.revolute)


def all_compliant(robot: Robot, sets: Sequence[Measurements]) -> tuple[Robot, tuple[str, ...]]:
    """The robot with compliance at all joints that turn, and labels as of `with_unknown_masses`."""
    joints = (replace(j, compliance=0.0 if j.kind == "revolute" else None) for j in robot.joints)
    return with_unknown_masses(replace(robot, joints=tuple(joints)), sets)


def with_unknown_masses(robot: Robot, sets: Sequence[Measurements]) -> tuple[Robot, tuple[str, ...]]:
    """The robot with all that is unknown of its masses in the model, and the labels of the effects to be free.

    As it is, and no labels, where its masses are declared, no joint gives, or an earlier fit has found them.
    Compliances are fitted to the torques of estimated masses (`core.estimated_masses`), and what the estimates may be
    off by is fitted with them: mass and mass centre of every link, of a logged payload its mass centre. Gravity then
    deflects each joint as it does (see `gravity`), while its stiffness stays unknown: twice the masses at twice the
    stiffness is the same robot.
    """
    if all(j.compliance is None for j in robot.joints):
        return robot, ()
    if without_masses(robot):
        robot = with_estimated_masses(robot)
    if robot.masses != "estimated" or any(isinstance(e, LinkMasses) for e in robot.effects):
        return robot, ()
    effects = [*LinkMasses.candidates(robot)]
    logged = [m.conditions["payload_kg"] for m in sets if "payload_kg" in m.conditions]
    if robot.payload is None and (mass := max((float(kg.max()) for kg in logged), default=0.0)) > 0:
        robot = with_payload(robot, mass)
        effects += PayloadError.candidates(robot)
    return robot.with_effect(*effects), tuple(e.label for e in effects)


def _with_free_masses(robot: Robot) -> tuple[Robot, tuple[str, ...]]:
    """The robot with masses and mass centres of links in its model, and their label; none where none are declared."""
    if not any(isinstance(e, LinkMasses) for e in robot.effects):
        robot = robot.with_effect(*LinkMasses.candidates(robot))
    return robot, tuple(e.label for e in robot.effects if isinstance(e, LinkMasses))


def _with_turning_tool(robot: Robot, sets: Sequence[Measurements]) -> Robot:
    """The robot with its unknown tool turned as the first orientations say, and free to turn."""
    first = next((m for m in sets if m.orientation is not None), None)
    if first is None or robot.tool.unknown == "none":
        return robot
    robot = replace(robot, tool=replace(robot.tool, unknown="pose"))
    turned = frame(place_frames(robot, first).tool.T[:3, :3], robot.tool.T[:3, 3])
    return replace(robot, tool=replace(robot.tool, T=turned))


def prepared_again(found: Identification, sets: Sequence[Measurements] = ()) -> Prepared:
    """What an identification started from; or with other measurements of its robot, which are still to be fitted."""
    freed = {found.given.parameters[name].group for name in found.names}
    unknown = [e.label for e in found.given.effects if isinstance(e, (LinkMasses, PayloadError))]
    free = tuple(label for label in unknown if label in freed and found.given.masses == "estimated")
    if not sets:
        return Prepared(found.given, found.measurements, free, identification=found)
    prepared = prepare(found.given, sets, tool_turns=True)
    return replace(prepared, free=(*free, *prepared.free))
