"""Identification of robot parameters by bounded least squares, and the preparation it needs.

`prepare` brings a robot and its measurements into the form from which identifications and diagnoses
start.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, ClassVar, Literal

import numpy as np

from casadical.core.basics import ConvergenceError, InputError
from casadical.core.parts import Body, lacks_masses, with_estimated_masses
from casadical.core.reporting.result import Shown
from casadical.core.transforms import frame
from casadical.effects import LinkMasses, PayloadError
from casadical.identification.least_squares import LeastSquares, initial_sigmas
from casadical.identification.placement import place_frames
from casadical.identification.plausibility import check_against, gross_errors
from casadical.identification.prediction import redundancies
from casadical.identification.prior import Prior, carry_over, departure_of
from casadical.identification.reduction import (
    MAX_OUTLIER_ROUNDS,
    independent_parameters,
    solve_by_auto,
    solve_without_outliers,
)
from casadical.identification.residuals import ALL_LOSSES, AnyLoss, Loss
from casadical.identification.result import Identification, Tried, learnt_from
from casadical.identification.sessions import place_sessions, with_sessions
from casadical.identification.solver import Progress
from casadical.measurements.measurements import Measurements, without_poses
from casadical.robot.robot import Knowledge, Robot

# Name of a method of the paper: identification of kinematic parameters without (KM) or with (SKCM)
# joint compliance.
Method = Literal["KM", "SKCM"]
# Method of the paper -> the parameter groups that it identifies.
METHODS: dict[str, tuple[str, ...]] = {"KM": ("kinematic",), "SKCM": ("kinematic", "compliance")}
# Choice of priors of an identification: whether the robot's own apply, others by parameter name, as
# (mean, one sigma) [SI], or "auto" (see `identify`).
AnyPriors = bool | Mapping[str, tuple[float, float]] | Literal["auto"]
# Treatment of the links' masses: "declared": as in the robot file; "unknown": errors of masses that
# the file does not declare are identified; "free": those of declared masses, too.
Masses = Literal["declared", "unknown", "free"]


@dataclass(frozen=True, eq=False)
class Prepared(Shown):
    """A robot and its measurements as identifications and diagnoses start from them.

    robot : nominal, with all effects in its model that measurements and prior require (see
        `prepare`)
    sets : the measurements
    free : labels of the effects of masses and sessions whose parameters are to be identified, too
    prior : prior of parameters from another campaign
    knowledge : covariance and ranges of validity of the robot as it was given
    method : of the paper, None for a user's own choice of parameters
    identification : of the base model, where it was made already, else None
    tried : result of the test for a compliance that the robot file does not declare, None where it
        was not made
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
        """The nominal robot with the unknown parts of its base and tool frames fitted to the sets.

        Raises InputError: for measurements that this robot cannot have made.
        """
        for m in self.sets:
            check_against(self.robot, m)
        return place_sessions(self.robot, self.sets)

    @property
    def compliant(self) -> Prepared | None:
        """This problem with compliance of all revolute joints in the model.

        None where the robot file declares a compliance, no joint is revolute, or an identification
        exists.
        """
        if self.identification or not lacks_declared_compliance(self.robot):
            return None
        robot, free = with_all_joints_compliant(self.robot, self.sets)
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
    """Return a robot and its measurements ready for identification, with all needed effects added.

    These are effects of a robot given as prior, errors of unknown masses, and for each session but
    the first what it has of its own: base frame, tool point or joint zeros.

    prior : the robot from another campaign, or a prior as `carry_over` returns it
    method : of the paper (KM: rigid joints); it, not `masses`, determines how masses are treated
    tool_turns : whether the orientation of an unknown tool is free where orientations were measured
    Raises InputError for measurements, a prior or a method that cannot be used.
    """
    sets = (measurements,) if isinstance(measurements, Measurements) else tuple(measurements)
    wrong = [type(m).__name__ for m in sets if not isinstance(m, Measurements)]
    if wrong or not sets:
        raise InputError(
            f"measurements are {wrong[0] if wrong else 'an empty list'}; "
            "allowed: one or several Measurements (see from_table, read_measurements)"
        )
    if isinstance(prior, Robot):
        robot, prior = carry_over(robot, prior)
    given = prior or Prior()
    if given.frozen:
        given.refuse_uncovered(sets)
    knowledge, free = robot.knowledge or Knowledge(), tuple[str, ...]()
    if method is not None:
        robot, free = with_method(robot, method, sets)
    elif masses != "declared":
        robot, free = with_unknown_masses(robot, sets)
        if not free and (masses == "free" or robot.masses == "estimated"):
            if not any(isinstance(e, LinkMasses) for e in robot.effects):
                robot = robot.with_effect(*LinkMasses.candidates(robot))
            free = tuple(e.label for e in robot.effects if isinstance(e, LinkMasses))
    robot, sessions = with_sessions(robot, sets)
    oriented = next((m for m in sets if m.orientation is not None), None)
    if (
        tool_turns and oriented is not None and robot.tool.unknown != "none"
    ):  # its orientation starts as measured, and is free
        robot = robot.with_unknown(tool="pose")
        turned = frame(place_frames(robot, oriented).tool.T[:3, :3], robot.tool.T[:3, 3])
        robot = replace(robot, tool=replace(robot.tool, T=turned))
    return Prepared(robot, sets, (*free, *sessions), given, knowledge, method)


def with_method(robot: Robot, method: str, sets: Sequence[Measurements]) -> tuple[Robot, tuple[str, ...]]:
    """Return the robot as a method of the paper models it, and the labels of effects to identify.

    KM sets all compliances to zero; SKCM adds the errors of estimated masses
    (`with_unknown_masses`). Raises InputError for another method.
    """
    if method not in METHODS:
        raise InputError(f"method {method!r} is unknown; allowed: {', '.join(METHODS)}")
    if method != "KM":
        return with_unknown_masses(robot, sets)
    return robot.with_values(dict.fromkeys(robot.parameters.select(["compliance"]), 0.0)), ()  # rigid joints


def lacks_declared_compliance(robot: Robot) -> bool:
    """Return whether the robot file declares no compliance though a joint is revolute."""
    return all(j.compliance is None for j in robot.joints) and bool(robot.revolute)


def with_all_joints_compliant(robot: Robot, sets: Sequence[Measurements]) -> tuple[Robot, tuple[str, ...]]:
    """Return the robot with compliance (nominally zero) at all revolute joints, and effect labels.

    The labels are those of added mass errors, which are to be identified too
    (`with_unknown_masses`).
    """
    joints = (replace(j, compliance=0.0 if j.kind == "revolute" else None) for j in robot.joints)
    return with_unknown_masses(replace(robot, joints=tuple(joints)), sets)


def with_unknown_masses(robot: Robot, sets: Sequence[Measurements]) -> tuple[Robot, tuple[str, ...]]:
    """Return the robot with errors of its estimated masses as effects, and the effects' labels.

    The labels name groups of parameters to be identified. No effect is added, and there are no
    labels, where masses are declared, no joint is compliant, or the robot has such effects already.
    Missing masses are estimated (`parts.with_estimated_masses`). Compliances are to be identified
    together with the errors of these estimates, those of links and of a logged payload. The
    deflection of each joint under gravity is then determined (see `gravity`), while its stiffness
    is not: twice the masses at twice the stiffness give the same deflections.
    """
    if all(j.compliance is None for j in robot.joints):
        return robot, ()
    if lacks_masses(robot):
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
    """Return the prepared problem of an identification's nominal robot, for its or other sets.

    sets : other measurements, still to be fitted; without any, the identification itself is part of
        the prepared problem
    """
    freed = {found.given.parameters[name].group for name in found.names}
    unknown = [e.label for e in found.given.effects if isinstance(e, (LinkMasses, PayloadError))]
    free = tuple(label for label in unknown if label in freed and found.given.masses == "estimated")
    if not sets:
        return Prepared(found.given, found.measurements, free, identification=found)
    prepared = prepare(found.given, sets, tool_turns=True)
    return replace(prepared, free=(*free, *prepared.free))


def identify(
    robot: Robot,
    measurements: Measurements | Sequence[Measurements],
    free: Iterable[str] = ("kinematic", "compliance"),
    *,
    method: Method | None = None,
    loss: AnyLoss = "auto",
    priors: AnyPriors = "auto",
    prior: Robot | Prior | None = None,
    screen: bool = True,
    progress: Progress | None = None,
) -> Identification:
    """Identify parameters of a robot from measurements.

    robot : nominal model
    measurements : one set, or several of different kinds, each with its own sigma
    free : parameters by group (base, geometry, loop, tool, compliance), union (kinematic,
        placement), name or pattern
    method : the paper's KM (kinematics only, joints rigid) or SKCM (with compliance, also where the
        robot file declares none, if the measurements support it; then KM has the outliers of this
        compliant model), instead of `free`
    loss : linear, or a robust loss, huber or soft_l1, with which poses beyond what noise reaches
        once in 100 000 are outliers; auto is huber where that excludes outliers, else linear
    priors : auto solves without any, and again with a prior on the geometry where the poses leave
        it open, as wide as this arm's departures are (see `departure`); or whether the robot's own
        prior widths constrain departures from nominal; or name -> (mean, one sigma) [SI] of
        parameters with another prior, the others having the robot's own
    prior : the same robot from another campaign, whose effects are put into the model and freed,
        with their values and covariance as a prior, while the robot's own priors constrain all
        other parameters; or as of `carry_over`
    screen : True leaves outliers out of further solves, with a robust loss; False leaves out none:
        huber and soft_l1 give them less weight, auto is linear
    progress : called with iteration number and cost
    Raises InputError: where measurements or arguments do not fit the robot.
    Raises ConvergenceError: where Ipopt finds no optimum.

    References
    ----------
    paper, section 3; Hollerbach, Khalil and Gautier, Springer Handbook of Robotics (2016), chapter
    8.

    Examples
    --------
    >>> found = casadical.identify(robot, poses, method="KM")
    >>> print(found.verdict)
    KM: 9 parameters identified from 40 poses, 3 not identifiable. The solver found an optimum.
    >>> print(f"a1 = {1e3 * found.robot.parameters['a1'].value:.3f} mm")
    a1 = 400.601 mm
    """
    prepared = prepare(robot, measurements, prior, method=method)
    by = partial(calibrated, loss=loss, priors=priors, screen=screen, progress=progress)
    if method is None:
        return by(prepared, free)
    tried = with_compliance_if_supported(prepared, progress)
    if method == "SKCM":
        return by(tried)
    if tried.tried is None or not tried.tried.kept:
        return by(prepared)
    if screen and loss != "linear":
        outliers = tried.tried.outliers
        if outliers is None:
            outliers = by(replace(tried, method="SKCM")).outliers
        by = partial(calibrated_without_outliers, outliers=outliers, loss=loss, priors=priors, progress=progress)
    return replace(by(prepared), tried=tried.tried)


def calibrated_without_outliers(
    prepared: Prepared, outliers: tuple[tuple[int, int], ...], loss: AnyLoss = "auto", **options: Any
) -> Identification:
    """Identify without the given outliers, which the result lists as its own.

    outliers : (set, pose) indices, as a more complete model found them
    loss : auto is huber where there are outliers, else linear; options : of `calibrated`
    """
    if loss == "auto":
        loss = "huber" if outliers else "linear"
    inliers = replace(prepared, sets=without_poses(prepared.sets, outliers))
    result = calibrated(inliers, loss=loss, screen=False, **options)
    return replace(result, measurements=prepared.sets, outliers=outliers)


def with_compliance_if_supported(prepared: Prepared, progress: Progress | None = None) -> Prepared:
    """Return the problem with compliance of all revolute joints if its measurements support it.

    Only compliance that the robot file does not declare is tested; the result is in `tried`, None
    where a fit fails or leaves no degree of freedom. It is supported where the residuals' standard
    deviation is over 1 % smaller and an F-test gives such a reduction by chance a probability below
    1e-3. BIC would be stricter with all joints compliant at once, though every arm gives way under
    gravity. Only parameters that the data determine count; the robot's priors constrain both
    models. The outliers of the compliant model are left out of both: large residuals of a rigid
    model are no gross errors. At most 1000 random poses of a set are used.
    """
    wider = prepared.compliant
    if wider is None:
        return prepared
    from scipy.special import fdtrc

    rng = np.random.default_rng(0)
    most = 1_000  # to save time
    sets = tuple(m if len(m) <= most else m[np.sort(rng.choice(len(m), most, replace=False))] for m in prepared.sets)
    by = partial(calibrated, free=METHODS["SKCM"], loss="huber", priors=True, progress=progress)
    try:
        full = by(replace(wider, method=None, sets=sets))
        inliers = without_poses(sets, full.outliers)
        rigid = by(replace(prepared, method=None, sets=inliers), screen=False)
    except (InputError, ConvergenceError):  # too few poses for one of them
        return prepared
    sigmas, squares, freedom = full.problem.sigmas, [], []
    for start in (rigid, full):
        problem, v = replace(start.problem, sigmas=sigmas), start.solution.v
        squares.append(problem.square(v) + problem.prior_square(v, counted=True))
        freedom.append(float(redundancies(problem, v).sum()))
    if freedom[1] < 1:  # compliant joints explain every number, whatever it is
        return prepared
    more, ratio = max(freedom[0] - freedom[1], 1.0), max(squares[0], 1e-300) / max(squares[1], 1e-300)
    chance = fdtrc(more, freedom[1], max(ratio - 1, 0.0) * freedom[1] / more)
    rigid_sigma, compliant_sigma = (
        sigmas[0][0] * math.sqrt(square / f) for square, f in zip(squares, freedom, strict=True)
    )
    whole = all(len(a) == len(b) for a, b in zip(sets, prepared.sets, strict=True))
    supported = chance < 1e-3 and compliant_sigma < 0.99 * rigid_sigma
    tried = Tried(rigid_sigma, compliant_sigma, supported, full.outliers if whole else None)
    return replace(wider if tried.kept else prepared, tried=tried)


def calibrated(
    prepared: Prepared,
    free: Iterable[str] = (),
    *,
    loss: AnyLoss = "linear",
    priors: AnyPriors = False,
    screen: bool = True,
    weighed: bool = False,
    in_camera: bool = True,
    progress: Progress | None = None,
) -> Identification:
    """Identify the parameters of a prepared problem; arguments as of `identify`, other defaults.

    The parameters of `prepared.method`, where there is one, take the place of `free`; those of
    `prepared.free` and of the prior are identified, too.

    weighed : whether the tilt of the pedestal is identified by the weight of the links alone, where
        nothing at rest was measured
    in_camera : whether the noise of a camera's poses may differ between the camera's axes
    Raises InputError, ConvergenceError.
    """
    robot, sets, prior = prepared.robot, prepared.sets, prepared.prior
    free = (free,) if isinstance(free, str) else tuple(free)
    if loss not in ALL_LOSSES:
        raise InputError(f"loss {loss!r} is unknown; allowed: {', '.join(ALL_LOSSES)}")
    by_departure = priors == "auto" and not prior.free
    if priors == "auto":
        priors = False
    if prior.free:
        priors = {**prior.means, **(priors if isinstance(priors, Mapping) else {})}
    wanted = (*(METHODS[prepared.method] if prepared.method else free), *prepared.free, *prior.free)
    start = prepared.start
    names = start.parameters.select(wanted)
    if not names:
        raise InputError(
            f"free={list(wanted)} chooses no parameter of {robot.name}; groups: {', '.join(start.parameters.groups)}"
        )
    if screen and loss != "linear" and (far := gross_errors(robot, sets)):
        rest = replace(prepared, sets=without_poses(sets, far))
        options: Any = {
            "loss": loss,
            "priors": "auto" if by_departure else priors,
            "weighed": weighed,
            "in_camera": in_camera,
        }
        result = calibrated(rest, free, progress=progress, **options)
        inliers = [[i for i in range(len(m)) if (k, i) not in far] for k, m in enumerate(sets)]
        outliers = tuple(sorted((*far, *((k, inliers[k][i]) for k, i in result.outliers))))
        return replace(result, measurements=sets, outliers=outliers)
    plain: Loss = "linear" if loss == "auto" else loss
    seen = tuple(m.in_camera_axes() for m in sets) if in_camera else sets
    sigmas, correlated = initial_sigmas(sets), prior.covariances
    problem = LeastSquares(start, seen, names, plain, priors, sigmas, correlated=correlated, weighed=weighed)
    solve = solve_by_auto if loss == "auto" else solve_without_outliers
    (reduced, solution, judged), outliers = solve(problem, MAX_OUTLIER_ROUNDS if screen else 0, progress)
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
        variance=reduced.variance(solution.v, trimmed=True),
        degrees_of_freedom=reduced.degrees_of_freedom,
        outliers=outliers,
        tried=prepared.tried,
    )
    if by_departure:
        found = problem.cache.once("independent", lambda: independent_parameters(problem)).independent
        named = [name for name in problem.names if name in found or name in result.names]
        departure = departure_of(result.problem, solution.v, result.variance, result.names)
        if departure and departure.prior is not None:  # then with the parameters that the free fit excluded
            departure = departure_of(result.problem, solution.v, result.variance, named)
        result = replace(result, departure=departure)
        if departure and (given := departure.priors(start)):
            shrunk = calibrated_without_outliers(
                replace(prepared, method=None, free=()),
                result.outliers,
                result.loss,
                free=named,
                priors=given,
                weighed=weighed,
                in_camera=in_camera,
                progress=progress,
            )
            others = {name: why for name, why in judged.unidentifiable.items() if name not in named}
            own = shrunk.identifiability
            judged = replace(own, unidentifiable={**own.unidentifiable, **others})
            result = replace(shrunk, method=result.method, identifiability=judged, departure=departure)
    if not robot.effects:
        return result
    learnt = learnt_from(result, prepared.knowledge)
    learnt = prior.knowledge.joined(learnt) if prior.free else learnt
    return replace(result, robot=replace(result.robot, knowledge=learnt))


def calibrate_base_model(prepared: Prepared) -> Identification:
    """Identify the base model, without additional causes, from which a diagnosis starts.

    The loss is huber, no outlier is excluded, and the robot's own priors apply. A tilted
    pedestal loads the joints as a cause might: its tilt is identified even where no measurement at
    rest shows it.

    Raises InputError, ConvergenceError.
    """
    free = ("kinematic", "compliance")
    return calibrated(prepared, free, loss="huber", priors=True, screen=False, weighed=True, in_camera=False)
