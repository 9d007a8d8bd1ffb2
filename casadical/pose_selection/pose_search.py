"""Which poses to measure: `select_poses` exchanges candidates and, if new ones may be drawn, their neighbours."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.identification.prior import Prior
from casadical.measurements.measurements import Measurements
from casadical.measurements.noise import Noise
from casadical.pose_selection.candidates import Candidates, Circumstances, candidates_at
from casadical.pose_selection.design_problem import DesignProblem, prepare
from casadical.pose_selection.experimental_design import improve, search
from casadical.pose_selection.information import Criterion
from casadical.pose_selection.instruments import Instrument
from casadical.pose_selection.pose_order import arranged
from casadical.pose_selection.selection import Selection
from casadical.pose_selection.workspace import Workspace
from casadical.robot.robot import Robot

# Number of neighbours of every chosen pose, and their distances as shares of the joints' ranges, round by round.
NEIGHBOURS = 12
REFINEMENTS = (0.2, 0.08, 0.03)


def select_poses(
    robot: Robot,
    among: Array | tuple[Array, Array] | Workspace | None,
    n: int,
    criterion: Criterion = "V",
    *,
    workspace: Workspace | None = None,
    circumstances: Circumstances | None = None,
    measured: Measurements | None = None,
    free: Iterable[str] | None = None,
    interest: Iterable[str] = (),
    task: Array | None = None,
    noise: Noise | None = None,
    min_distance: float | None = 0.0,
    pool: int = 1000,
    restarts: int = 2,
    seed: int = 0,
    instrument: Instrument | None = None,
    prior: Prior | None = None,
) -> Selection:
    """Choose n readings to measure, by an exchange of candidates.

    robot : Jacobians are taken at its values, so give the calibrated one when continuing; its effects (`with_effect`)
        are parameters like any other
    among : shape (N, joints) [rad or m]: readings to choose from; or limits between which they are drawn, and then
        refined in the neighbourhood of the best: a tuple (lower, upper), shape (joints,) each [rad or m], or a
        workspace; None: the robot's own ranges
    n : number of readings to choose
    criterion : V (the mean variance of the position over the task), D or O1, A, O2 to O5; see `criteria`
    workspace : which poses can be measured
    circumstances : payloads, approaches, repeats
    measured : poses already measured: the choice adds to them and keeps its distance from them
    free : parameters to identify, as of `identify`; by default geometry, frames, compliance and all effects
    interest : parameters (names, groups or labels, patterns) that matter most: A then regards only these, V weights
        them, in units of their priors, as much as the task
    task : shape (T, joints) [rad or m]: readings at which the robot is to be accurate; None: all that is allowed
    noise : of coordinates and joints
    min_distance : between any two poses, in the joint that differs most, as a share of its range, None if a pose may be
        chosen more than once
    pool : number of candidates to draw
    restarts : number of searches, of which the best counts
    seed : of the random generator
    instrument : what is read in place of positions: distances to anchors, or the tool in sockets; `noise.sigma` is its
        own
    prior : what is known of the robot, as of `identify` and with its values in the robot (see `carry_over`): fewer
        poses are needed then
    Returns the poses in order, and the accuracy to expect of them
    Raises InputError: where nothing can be chosen.
    References: Mitchell (1974); Sun and Hollerbach (2008).

    Examples
    --------
    >>> plan = casadical.select_poses(robot, None, 12, pool=200, restarts=1)
    >>> plan.q.shape, bool(plan.accuracy < 1e-4)
    ((12, 2), True)
    """
    if n < 1:
        raise InputError(f"n is {n}; at least one pose must be chosen")
    candidates, workspace = _sources(among, workspace)
    rng = np.random.default_rng(seed)
    problem = prepare(
        robot, n, criterion, candidates=candidates, workspace=workspace,
        circumstances=circumstances or Circumstances(), measured=measured, free=free, interest=interest, task=task,
        noise=noise or Noise(), pool=max(pool, 3 * n), rng=rng, instrument=instrument,
        prior=prior,
    )  # fmt: skip
    design = problem.design(problem.pool, criterion, min_distance)
    chosen = problem.pool[search(design, n, restarts, seed)]
    if problem.open:
        for size in REFINEMENTS:
            chosen = _refined(problem, chosen, criterion, min_distance, size, rng)
    return selection(problem, chosen, criterion)


def _sources(
    among: Array | tuple[Array, Array] | Workspace | None, workspace: Workspace | None
) -> tuple[Array | None, Workspace]:
    """Candidates, if any were given, and the workspace with the limits that were given."""
    if isinstance(among, Workspace):
        if workspace is not None:
            raise InputError("two workspaces were given; give one of them, or limits as a tuple (lower, upper)")
        return None, among
    given = workspace or Workspace()
    if isinstance(among, tuple):
        if len(among) != 2:
            raise InputError(f"limits of {len(among)} parts; allowed: (lower, upper), one reading per joint each")
        lower, upper = (np.asarray(side, dtype=float) for side in among)
        return None, replace(given, lower=lower, upper=upper)
    if among is not None and np.asarray(among).ndim == 0:
        raise InputError(f"poses chosen among {among!r}; allowed: candidates, (lower, upper), a Workspace, None")
    return among, given


def selection(problem: DesignProblem, chosen: Candidates, criterion: Criterion) -> Selection:
    return Selection(
        robot=problem.robot,
        chosen=chosen,
        m=arranged(problem.robot, chosen, problem.circumstances, travel=False),
        measured=problem.measured,
        names=problem.names,
        held=problem.held,
        criterion=criterion,
        noise=problem.noise,
        task=problem.task,
        circumstances=problem.circumstances,
        instrument=problem.instrument,
        prior=problem.prior,
    )


def _refined(
    problem: DesignProblem,
    chosen: Candidates,
    criterion: Criterion,
    min_distance: float | None,
    size: float,
    rng: np.random.Generator,
) -> Candidates:
    robot, workspace = problem.robot, problem.workspace
    lower, upper = workspace.ranges(robot)
    steps = size * (upper - lower) * rng.normal(size=(NEIGHBOURS, len(chosen), robot.n))
    q = np.clip(chosen.q + steps, lower, upper).reshape(-1, robot.n)
    q = q[workspace.allows(robot, q)]
    pool = chosen.joined(candidates_at(robot, q, problem.circumstances, len(chosen), rng)) if len(q) else chosen
    design = problem.design(pool, criterion, min_distance)
    design.start(list(range(len(chosen))))
    improve(design)
    return pool[np.array(design.chosen)]
