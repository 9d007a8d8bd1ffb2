"""Identify a robot's parameters from measurements by bounded least squares."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

from casadical.core.errors import InputError
from casadical.identification.least_squares import LeastSquares, first_sigmas
from casadical.identification.plausibility import check_against
from casadical.identification.prior import Prior, carry_over
from casadical.identification.residuals import ALL_LOSSES, AnyLoss
from casadical.identification.result import Identification, learnt_from
from casadical.identification.screening import SCREENINGS, solve_without_outliers
from casadical.identification.sessions import place_sessions, with_sessions
from casadical.identification.solver import Progress
from casadical.identification.unknown_masses import with_unknown_masses
from casadical.identification.variance import variance
from casadical.measurements.measurements import Measurements
from casadical.robot.knowledge import Knowledge
from casadical.robot.robot import Robot

Method = Literal["KM", "SKCM"]
METHODS: dict[str, tuple[str, ...]] = {"KM": ("kinematic",), "SKCM": ("kinematic", "compliance")}


def identify(
    robot: Robot,
    measurements: Measurements | Sequence[Measurements],
    free: Iterable[str] = ("kinematic", "compliance"),
    *,
    method: Method | None = None,
    loss: AnyLoss = "linear",
    priors: bool | Mapping[str, tuple[float, float]] = False,
    prior: Robot | Prior | None = None,
    screen: bool = True,
    progress: Progress | None = None,
) -> Identification:
    """Identify parameters of a robot from measurements.

    Parameters
    ----------
    robot : Robot
        nominal model
    measurements : Measurements | Sequence[Measurements]
        one set, or several of different kinds, each with its own sigma
    free : Iterable[str], optional
        parameters by group (base, geometry, loop, tool, compliance), union (kinematic, placement), name or pattern
    method : {"KM", "SKCM"}, optional
        the paper's KM (kinematics only, joints rigid) or SKCM (with compliance), instead of `free`
    loss : {"linear", "huber", "soft_l1", "auto"}, default "linear"
        the robust ones, huber and soft_l1, leave poses that noise explains once in 100 000 out of a last solve; auto is
        huber where that finds such poses, else linear, as in the command `calibrate`
    priors : bool | Mapping[str, tuple[float, float]], default False
        whether departures from nominal are held back by the robot's prior widths; or name -> (mean, one sigma) [SI]
        of parameters with another prior, the others' being the robot's own
    prior : Robot | Prior, optional
        the same robot from another campaign, whose effects are put into the model and freed, with their values and
        covariance as a prior, and all other parameters held back by the robot's own priors; or as of `carry_over`
    screen : bool, default True
        whether a robust loss leaves far poses out of further solves, or only gives them less weight
    progress : Callable[[int, float], None], optional
        called with iteration number and cost

    Returns
    -------
    Identification
        the result: parameters with standard errors, accuracy, predictions

    Raises
    ------
    InputError
        where the measurements do not fit the robot
    ConvergenceError
        where Ipopt finds no optimum

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
    sets = _as_sets(measurements)
    if loss == "auto":
        free = free if isinstance(free, str) else tuple(free)
        by = partial(identify, robot, sets, free, method=method, priors=priors, prior=prior, progress=progress)
        robust = by(loss="huber", screen=screen)
        return robust if robust.outliers else by(loss="linear")
    if isinstance(prior, Robot):
        robot, prior = carry_over(robot, prior)
    prior = prior or Prior()
    if prior.frozen:
        prior.refuse_uncovered(sets)
    known = robot.knowledge or Knowledge()
    if method is not None:
        robot, free = by_method(robot, method, sets)
    robot, sessions = with_sessions(robot, sets)
    if sessions:
        free = (*([free] if isinstance(free, str) else free), *sessions)
    if prior.free:
        free = (*([free] if isinstance(free, str) else free), *prior.free)
        priors = {**prior.means, **(priors if isinstance(priors, Mapping) else {})}
    if loss not in ALL_LOSSES:
        raise InputError(f"loss {loss!r} is not known; allowed: {', '.join(ALL_LOSSES)}")
    for m in sets:
        check_against(robot, m)
    start = place_sessions(robot, sets)
    names = start.parameters.select(free)
    if not names:
        raise InputError(
            f"free={list(free)} chooses no parameter of {robot.name}; groups: {', '.join(start.parameters.groups)}"
        )
    problem = LeastSquares(start, sets, names, loss, priors, first_sigmas(sets), known=prior.known)
    (reduced, solution, found), outliers = solve_without_outliers(problem, SCREENINGS if screen else 0, progress)
    result = Identification(
        given=replace(robot, effect_values=start.effect_values) if sessions else robot,
        start=start,
        robot=start.with_values(reduced.values(solution.v)),
        measurements=sets,
        method=method or "identify",
        loss=loss,
        identifiability=found,
        problem=reduced,
        solution=solution,
        variance=variance(reduced, solution.v, trimmed=True),
        degrees_of_freedom=reduced.degrees_of_freedom,
        outliers=outliers,
    )
    if not robot.effects:
        return result
    learnt = learnt_from(result, known)
    learnt = prior.knowledge.joined(learnt) if prior.free else learnt
    return replace(result, robot=replace(result.robot, knowledge=learnt))


def _as_sets(measurements: Measurements | Sequence[Measurements]) -> tuple[Measurements, ...]:
    sets = (measurements,) if isinstance(measurements, Measurements) else tuple(measurements)
    wrong = [type(m).__name__ for m in sets if not isinstance(m, Measurements)]
    if wrong or not sets:
        raise InputError(
            f"measurements are {wrong[0] if wrong else 'an empty list'}; "
            "allowed: one or several Measurements (see from_table, read_measurements)"
        )
    return sets


def by_method(robot: Robot, method: str, sets: Sequence[Measurements]) -> tuple[Robot, tuple[str, ...]]:
    """The robot as a method of the paper takes it, and what it identifies, of masses that nobody knows, too.

    Raises InputError for other methods.
    """
    if method not in METHODS:
        raise InputError(f"method {method!r} is not known; allowed: {', '.join(METHODS)}")
    if method == "KM":  # rigid joints
        return robot.with_values(dict.fromkeys(robot.parameters.select(["compliance"]), 0.0)), METHODS[method]
    robot, unknown = with_unknown_masses(robot, sets)
    return robot, (*METHODS[method], *unknown)
