"""Identify a robot's parameters by bounded least squares, from a robot and measurements that are made ready first.

`prepare` is the one way into a question: to be identified or diagnosed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.special import fdtrc

from casadical.core.basics import ConvergenceError, InputError
from casadical.core.parts import Body, with_estimated_masses, without_masses
from casadical.core.telling.result import Shown
from casadical.core.transforms import frame
from casadical.effects import LinkMasses, PayloadError
from casadical.identification.fit_statistics import redundancies, variance
from casadical.identification.least_squares import LeastSquares, first_sigmas
from casadical.identification.placement import place_frames
from casadical.identification.plausibility import check_against
from casadical.identification.prior import Prior, carry_over
from casadical.identification.reduction import SCREENINGS, solve_by_auto, solve_without_outliers
from casadical.identification.residuals import ALL_LOSSES, AnyLoss, Loss
from casadical.identification.result import Identification, Tried, learnt_from, without_poses
from casadical.identification.sessions import place_sessions, with_sessions
from casadical.identification.solver import Progress
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Knowledge, Robot

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

    line: ClassVar[str] = " {{ it.robot.name | repr }} and {{ it.sets | map('length') | sum }} poses"

    robot: Robot
    sets: tuple[Measurements, ...]
    free: tuple[str, ...] = ()
    prior: Prior = field(default_factory=Prior)
    knowledge: Knowledge = field(default_factory=Knowledge)
    method: Method | None = None
    identification: Identification | None = None
    tried: Tried | None = None

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
            if not any(isinstance(e, LinkMasses) for e in robot.effects):
                robot = robot.with_effect(*LinkMasses.candidates(robot))
            free = tuple(e.label for e in robot.effects if isinstance(e, LinkMasses))
    robot, sessions = with_sessions(robot, sets)
    oriented = next((m for m in sets if m.orientation is not None), None)
    if tool_turns and oriented is not None and robot.tool.unknown != "none":  # turned as first seen, and free to turn
        robot = replace(robot, tool=replace(robot.tool, unknown="pose"))
        turned = frame(place_frames(robot, oriented).tool.T[:3, :3], robot.tool.T[:3, 3])
        robot = replace(robot, tool=replace(robot.tool, T=turned))
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
    Compliances are fitted to the torques of estimated masses (`parts.with_estimated_masses`), and what the estimates
    may be off by is fitted with them: mass and mass centre of every link, of a logged payload its mass centre. Gravity
    then deflects each joint as it does (see `gravity`), while its stiffness stays unknown: twice the masses at
    twice the stiffness is the same robot.
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
        robot = replace(robot, payload=Body(mass, robot.tool.T[:3, 3] / 2))  # between flange and measured point
        effects += PayloadError.candidates(robot)
    return robot.with_effect(*effects), tuple(e.label for e in effects)


def prepared_again(found: Identification, sets: Sequence[Measurements] = ()) -> Prepared:
    """What an identification started from; or with other measurements of its robot, which are still to be fitted."""
    freed = {found.given.parameters[name].group for name in found.names}
    unknown = [e.label for e in found.given.effects if isinstance(e, (LinkMasses, PayloadError))]
    free = tuple(label for label in unknown if label in freed and found.given.masses == "estimated")
    if not sets:
        return Prepared(found.given, found.measurements, free, identification=found)
    prepared = prepare(found.given, sets, tool_turns=True)
    return replace(prepared, free=(*free, *prepared.free))


# Of a set with more poses, so many are enough to see it.
MOST_TRIED = 1_000


def identify(
    robot: Robot,
    measurements: Measurements | Sequence[Measurements],
    free: Iterable[str] = ("kinematic", "compliance"),
    *,
    method: Method | None = None,
    loss: AnyLoss = "auto",
    priors: bool | Mapping[str, tuple[float, float]] = False,
    prior: Robot | Prior | None = None,
    screen: bool = True,
    progress: Progress | None = None,
) -> Identification:
    """Identify parameters of a robot from measurements.

    robot : nominal model
    measurements : one set, or several of different kinds, each with its own sigma
    free : parameters by group (base, geometry, loop, tool, compliance), union (kinematic, placement), name or pattern
    method : the paper's KM (kinematics only, joints rigid) or SKCM (with compliance, also where the robot file declares
        none, if the measurements carry it), instead of `free`
    loss : the robust ones, huber and soft_l1, leave poses that noise explains once in 100 000 out of a last solve; auto
        is huber where that finds such poses, else linear, as in the command `calibrate`
    priors : whether departures from nominal are held back by the robot's prior widths; or name -> (mean, one sigma)
        [SI] of parameters with another prior, the others' being the robot's own
    prior : the same robot from another campaign, whose effects are put into the model and freed, with their values and
        covariance as a prior, and all other parameters held back by the robot's own priors; or as of `carry_over`
    screen : whether a robust loss leaves far poses out of further solves, or only gives them less weight
    progress : called with iteration number and cost
    Raises InputError: where the measurements do not fit the robot.
    Raises ConvergenceError: where Ipopt finds no optimum.

    References
    ----------
    paper, section 3; Hollerbach, Khalil and Gautier, Springer Handbook of Robotics (2016), chapter 8.

    Examples
    --------
    >>> found = casadical.identify(robot, poses, method="KM")
    >>> print(found.verdict)
    KM: 9 parameters identified from 40 poses, 3 not identifiable. Ipopt found an optimum.
    >>> print(f"a1 = {1e3 * found.robot.parameters['a1'].value:.3f} mm")
    a1 = 400.601 mm
    """
    prepared = prepare(robot, measurements, prior, method=method)
    by = partial(calibrated, loss=loss, priors=priors, screen=screen, progress=progress)
    if method is None:
        return by(prepared, free)
    tried = compliance_tried(prepared, progress)
    if method == "SKCM":
        return by(tried)
    if tried.tried is None or not tried.tried.kept:
        return by(prepared)
    if screen and loss != "linear":
        outliers = tried.tried.outliers
        if outliers is None:
            outliers = by(replace(tried, method="SKCM")).outliers
        by = partial(judged, outliers=outliers, loss=loss, priors=priors, progress=progress)
    return replace(by(prepared), tried=tried.tried)


def judged(
    prepared: Prepared, outliers: tuple[tuple[int, int], ...], loss: AnyLoss = "auto", **options: Any
) -> Identification:
    """Identify without rows that another model, which explains more, calls outliers.

    outliers : (set, pose) indices; options : of `calibrated`
    """
    if loss == "auto":
        loss = "huber" if outliers else "linear"
    kept = replace(prepared, sets=without_poses(prepared.sets, outliers))
    result = calibrated(kept, loss=loss, screen=False, **options)
    return replace(result, measurements=prepared.sets, outliers=outliers)


def compliance_tried(prepared: Prepared, progress: Progress | None = None) -> Prepared:
    """The same, with compliance in the model where the robot file declares none and the measurements carry it.

    They do where it leaves visibly less, BIC prefers the compliant model (Schwarz 1978), with the degrees of freedom
    of the rigid one in the place of the numbers, and so much less is left by chance (F-test) with a probability below
    1e-3, which few numbers need; the parameters are counted that the data determine, and both models are held back
    by the robot's priors. Outliers are those of the compliant model: what a rigid one leaves of a robot that sags is
    no wrong row. Of more than MOST_TRIED poses of a set, as many are drawn by chance.
    """
    wider = prepared.compliant
    if wider is None:
        return prepared
    rng = np.random.default_rng(0)
    sets = tuple(
        m if len(m) <= MOST_TRIED else m[np.sort(rng.choice(len(m), MOST_TRIED, replace=False))] for m in prepared.sets
    )
    by = partial(calibrated, free=METHODS["SKCM"], loss="huber", priors=True, progress=progress)
    try:
        full = by(replace(wider, method=None, sets=sets))
        kept = without_poses(sets, full.outliers)
        rigid = by(replace(prepared, method=None, sets=kept), screen=False)
    except (InputError, ConvergenceError):  # too few poses for one of them
        return prepared
    sigmas, squares, freedom = full.problem.sigmas, [], []
    for start in (rigid, full):
        problem, v = replace(start.problem, sigmas=sigmas), start.solution.v
        squares.append(problem.square(v) + problem.prior_square(v, counted=True))
        freedom.append(max(float(redundancies(problem, v).sum()), 1.0))
    more, ratio = max(freedom[0] - freedom[1], 1.0), max(squares[0], 1e-300) / max(squares[1], 1e-300)
    chance = fdtrc(more, freedom[1], max(ratio - 1, 0.0) * freedom[1] / more)
    # A compliance is visible where less than this share of the scatter is left with it, and so much
    # by chance so rarely.
    carried = freedom[0] * math.log(ratio) > more * math.log(freedom[0]) and chance < 1e-3
    left, least = (sigmas[0][0] * math.sqrt(square / f) for square, f in zip(squares, freedom, strict=True))
    whole = all(len(a) == len(b) for a, b in zip(sets, prepared.sets, strict=True))
    tried = Tried(left, least, carried and least < 0.99 * left, full.outliers if whole else None)
    return replace(wider if tried.kept else prepared, tried=tried)


def calibrated(
    prepared: Prepared,
    free: Iterable[str] = (),
    *,
    loss: AnyLoss = "linear",
    priors: bool | Mapping[str, tuple[float, float]] = False,
    screen: bool = True,
    weighed: bool = False,
    progress: Progress | None = None,
) -> Identification:
    """Identify what was prepared; arguments as of `identify`, a method brings its own parameters.

    weighed : see `LeastSquares`
    Raises InputError, ConvergenceError.
    """
    robot, sets, prior = prepared.robot, prepared.sets, prepared.prior
    free = (free,) if isinstance(free, str) else tuple(free)
    if loss not in ALL_LOSSES:
        raise InputError(f"loss {loss!r} is not known; allowed: {', '.join(ALL_LOSSES)}")
    if prior.free:
        priors = {**prior.means, **(priors if isinstance(priors, Mapping) else {})}
    wanted = (*(METHODS[prepared.method] if prepared.method else free), *prepared.free, *prior.free)
    start = prepared.start
    names = start.parameters.select(wanted)
    if not names:
        raise InputError(
            f"free={list(wanted)} chooses no parameter of {robot.name}; groups: {', '.join(start.parameters.groups)}"
        )
    plain: Loss = "linear" if loss == "auto" else loss
    problem = LeastSquares(start, sets, names, plain, priors, first_sigmas(sets), known=prior.known, weighed=weighed)
    solve = solve_by_auto if loss == "auto" else solve_without_outliers
    (reduced, solution, judged), outliers = solve(problem, SCREENINGS if screen else 0, progress)
    placed = start.effect_values != robot.effect_values  # base and tool of further sessions
    result = Identification(
        given=replace(robot, effect_values=start.effect_values) if placed else robot,
        start=start,
        robot=start.with_values(reduced.values(solution.v)),
        measurements=sets,
        method=prepared.method or "identify",
        loss=reduced.loss,
        identifiability=judged,
        problem=reduced,
        solution=solution,
        variance=variance(reduced, solution.v, trimmed=True),
        degrees_of_freedom=reduced.degrees_of_freedom,
        outliers=outliers,
        tried=prepared.tried,
    )
    if not robot.effects:
        return result
    learnt = learnt_from(result, prepared.knowledge)
    learnt = prior.knowledge.joined(learnt) if prior.free else learnt
    return replace(result, robot=replace(result.robot, knowledge=learnt))


def base_calibrated(prepared: Prepared, free: Iterable[str] = ("kinematic", "compliance")) -> Identification:
    """As a diagnosis starts: gross errors have little weight, but stay, and priors hold back what nobody measured.

    A foot that stands aslant loads the joints as a cause might: its turns are sought even where no reading shows them.
    Raises InputError, ConvergenceError.
    """
    return calibrated(prepared, free, loss="huber", priors=True, screen=False, weighed=True)
