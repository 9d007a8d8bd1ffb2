"""Search for the poses to measure, their number, and places of wire anchors or sockets.

`select_poses` exchanges candidates and, if new ones may be drawn, their neighbours. `forecast` adds
poses one by one and gives the expected accuracy against their number, which tells when to stop.
`select_with_places` chooses places and poses in turn.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
import pandas as pd

from casadical.core.basics import M_PER_MM, Array, InputError
from casadical.core.reporting.result import Shown
from casadical.identification.pose_selection.candidates import Circumstances, candidates_at, reachable_places
from casadical.identification.pose_selection.design_problem import prepare
from casadical.identification.pose_selection.experimental_design import improve, inverse, search
from casadical.identification.pose_selection.instruments import Instrument, best_places
from casadical.identification.pose_selection.selection import Selection, in_measuring_order
from casadical.identification.pose_selection.workspace import Workspace
from casadical.identification.prior import Prior
from casadical.measurements.measurements import Measurements, Noise
from casadical.robot.robot import Robot


def select_poses(
    robot: Robot,
    among: Array | tuple[Array, Array] | Workspace | None,
    n: int,
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
    """Return n poses to measure that give a small mean position variance over the task.

    robot : robot model; Jacobians are taken at its parameter values, so give the calibrated one
        when continuing; the parameters of its effects (`with_effect`) count like any other
    among : joint variables to choose from, shape (N, joints) [rad or m]; or limits between which
        they are drawn, and then refined in the neighbourhood of the best: a tuple (lower, upper),
        shape (joints,) each [rad or m], or a workspace; None: the robot's own ranges
    n : number of poses to choose
    workspace : which poses can be measured; None: all within the joint ranges
    circumstances : payloads, approaches and repeats of the poses; None: those of `Circumstances()`
    measured : poses already measured: the choice adds to them and keeps `min_distance` from them
    free : parameters to identify, as of `identify`; by default geometry, frames, compliance and all
        effects
    interest : parameters (names, groups or labels, patterns) that matter most: their weight, in
        units of their priors, is that of the task
    task : joint variables at which it is to be accurate, shape (T, joints) [rad or m]; None: 300
        random poses in the workspace
    noise : standard deviations of measured coordinates and of joints; None: those of `Noise()`
    min_distance : smallest distance between any two poses, in the joint that differs most, as a
        fraction of its range; None: a pose may be chosen more than once
    pool : number of candidates to draw, at least 3 n
    restarts : number of searches, of which the best result is taken; the first starts from no pose,
        the others from random ones
    seed : seed of the random generator
    instrument : what is measured in place of positions: distances to anchors, or the tool in
        sockets; `noise.sigma` is then the instrument's; None: positions
    prior : posterior of another campaign, as of `identify` and with its values in the robot (see
        `carry_over`); fewer poses are needed then
    Returns the poses by pass, time and payload, not by short travel (see `Selection.ordered`), and
    the position accuracy [m] to expect of them
    Raises InputError: no n poses can be chosen, or they cannot determine the parameters.

    References: Mitchell (1974); Atkinson, Donev and Tobias (2007).

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
        robot,
        n,
        pool=max(pool, 3 * n),
        rng=rng,
        candidates=candidates,
        workspace=workspace,
        circumstances=circumstances,
        measured=measured,
        free=free,
        interest=interest,
        task=task,
        noise=noise,
        instrument=instrument,
        prior=prior,
    )
    design = problem.design(problem.pool, min_distance)
    chosen = problem.pool[search(design, n, restarts, seed)]
    lower, upper = workspace.ranges(robot)
    # Neighbours of every chosen pose are tried at decreasing distances, in fractions of the ranges.
    for size in (0.2, 0.08, 0.03) if problem.open else ():
        steps = size * (upper - lower) * rng.normal(size=(12, n, robot.n))
        q = robot.coupled(np.clip(chosen.q + steps, lower, upper).reshape(-1, robot.n))
        q = q[workspace.allows(robot, q)]
        nearby = chosen.joined(candidates_at(robot, q, problem.circumstances, n, rng)) if len(q) else chosen
        design = problem.design(nearby, min_distance)
        design.start(list(range(n)))
        improve(design)
        chosen = nearby[np.array(design.chosen)]
    m = in_measuring_order(robot, chosen, problem.circumstances, travel=False)
    return Selection(**vars(problem), chosen=chosen, m=m)


def _sources(
    among: Array | tuple[Array, Array] | Workspace | None, workspace: Workspace | None
) -> tuple[Array | None, Workspace]:
    """Return the given candidates, shape (N, joints), and the workspace with the given limits.

    The candidates are None where they are to be drawn. among : as of `select_poses`
    """
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


@dataclass(frozen=True, eq=False)
class Forecast(Shown):
    """Expected position error of the calibrated robot against the number of measured poses.

    poses : rising numbers of poses, poses measured before included, shape (k,)
    error : expected rms position error over the task with each number, shape (k,) [m]
    """

    line: ClassVar[str] = (
        ": {{ it.error[0] | mm }} mm from {{ it.poses[0] }} to {{ it.error[-1] | mm }} mm from {{ it.poses[-1] }} poses"
    )

    poses: Array
    error: Array

    def enough(self, target: float) -> int | None:
        """Return the smallest number of poses with an expected rms error of at most `target` [m].

        None is returned where no number of `poses` reaches it.
        """
        good = np.flatnonzero(self.error <= target)
        return int(self.poses[good[0]]) if len(good) else None

    def stop(self, gain: float = 0.1, ahead: int = 10) -> int | None:
        """Return the smallest number of poses from which additional ones hardly reduce the error.

        None is returned where there is no such number.

        gain : relative reduction of the error below which additional poses are not worth it
        ahead : number of additional entries of `poses` over which it is taken
        """
        small = np.flatnonzero(1 - self.error[ahead:] / self.error[:-ahead] < gain)
        return int(self.poses[small[0]]) if len(small) else None

    @property
    def table(self) -> pd.DataFrame:
        """Return a table with the columns poses, their number, and expected_error_mm."""
        return pd.DataFrame({"poses": self.poses, "expected_error_mm": 1e3 * self.error})


def forecast(
    robot: Robot,
    most: int = 100,
    *,
    workspace: Workspace | None = None,
    circumstances: Circumstances | None = None,
    measured: Measurements | None = None,
    free: Iterable[str] | None = None,
    task: Array | None = None,
    noise: Noise | None = None,
    pool: int = 1000,
    seed: int = 0,
    instrument: Instrument | None = None,
    prior: Prior | None = None,
) -> Forecast:
    """Return the expected error as poses are added one by one, each the best additional one.

    It starts with the measured poses or, if these are fewer, with as many as give a fifth more
    numbers than there are unknowns (parameters without a prior of another campaign, coordinates of
    places).

    most : largest number of poses, measured ones included
    workspace, circumstances, measured, free, noise, pool, instrument, prior : as of `select_poses`
    task : as of `select_poses`, shape (T, joints) [rad or m]
    seed : seed of all random numbers
    Raises InputError: nothing can be chosen.

    Examples
    --------
    >>> ahead = casadical.identification.pose_selection.forecast(robot, 12, pool=100)
    >>> bool(ahead.error[-1] < ahead.error[0])
    True
    """
    before = 0 if measured is None else len(measured)
    if most <= before:
        raise InputError(f"{before} poses were measured already; most is {most} and must be greater")
    problem = prepare(
        robot,
        most - before,
        pool=pool,
        rng=np.random.default_rng(seed),
        workspace=workspace,
        circumstances=circumstances,
        measured=measured,
        free=free,
        task=task,
        noise=noise,
        instrument=instrument,
        prior=prior,
    )
    design = problem.design(problem.pool, 0.0)
    each, numbers = problem.pool.size, instrument.numbers if instrument else 3
    with_prior = {*prior.means, *(name for names, _ in prior.covariances for name in names)} if prior else set()
    p = len(problem.weight) - sum(name in with_prior for name in problem.names)
    # Measurements of one pose have nearly the same information: only the first of them counts here.
    if numbers * before < 1.2 * p:
        first = min(-(-(int(1.2 * p) - numbers * before) // numbers), (most - before) // each)
        design.start(search(design, first, 1, seed).tolist())
    poses, error = [], []
    while True:
        poses.append(before + each * len(design.chosen))
        error.append(M_PER_MM * float(np.sqrt(np.sum(problem.weight * inverse(design.M)))))
        k = design.best_to_add()
        if k is None or poses[-1] + each > most:
            return Forecast(np.array(poses), np.array(error))
        design.add(k)


def place_instrument(
    robot: Robot,
    kind: Literal["wires", "sockets"],
    places: Array,
    count: int,
    *,
    surveyed: bool = False,
    workspace: Workspace | None = None,
    q: Array | None = None,
    free: Iterable[str] | None = None,
    task: Array | None = None,
    noise: Noise | None = None,
    seed: int = 0,
) -> Instrument:
    """Return the instrument at those of the places from which readings determine the robot best.

    robot : robot with approximate base and tool frames
    kind : as of `Instrument`
    places : candidates for the places, in the measuring frame, shape (K, 3) [m]
    count : required number of places
    surveyed : whether the places will be measured, too, so that they are not estimated
    workspace : which poses can be measured
    q : poses that will be measured by wires, shape (n, joints) [rad or m]; None: random ones
    free : as of `select_poses`
    task : as of `select_poses`, shape (T, joints) [rad or m]
    noise : noise of a distance, or of a coordinate in a socket; None: as of `select_poses`
    seed : seed of the random generator
    Raises InputError: too few candidates, or a socket out of reach.

    Examples
    --------
    >>> corners = np.array([[1.0, 1.0, 0.5], [-1.0, 1.0, 0.0], [1.0, -1.0, 0.0]])
    >>> casadical.identification.pose_selection.place_instrument(robot, "wires", corners, 2).places.shape
    (2, 3)
    """
    room, rng = workspace or Workspace(), np.random.default_rng(seed)
    if kind == "sockets":
        places = reachable_places(robot, places, count, room, rng)
    noise, every = noise or Noise(), Instrument(kind, places, surveyed)
    size = max(300, 4 * len(places))
    given: dict[str, Any] = {"workspace": room, "free": free, "task": task, "noise": noise}
    problem = prepare(robot, size, pool=size, rng=rng, candidates=q, instrument=every, **given)
    p, m = len(problem.names), problem.pool.measurements(robot)
    best = best_places(robot, every, count, problem.names, m, noise, problem.weight[:p, :p])
    return Instrument(kind, places[best], surveyed)


def select_with_places(
    robot: Robot,
    n: int,
    kind: Literal["wires", "sockets"],
    places: Array,
    count: int,
    *,
    surveyed: bool = False,
    workspace: Workspace | None = None,
    free: Iterable[str] | None = None,
    noise: Noise | None = None,
    seed: int = 0,
    **options: Any,
) -> Selection:
    """Return n poses and, with its chosen places, the instrument that is read at them.

    Places and poses are chosen in turn, at most three times, until the places do not change or the
    expected error does not decrease; for sockets each are chosen once.

    n : number of poses to choose
    """
    best: Selection | None = None
    q = None
    for _ in range(3):
        instrument = place_instrument(
            robot, kind, places, count, surveyed=surveyed, workspace=workspace, q=q, free=free, noise=noise, seed=seed
        )
        if best is not None and best.instrument and np.array_equal(best.instrument.places, instrument.places):
            break
        chosen = select_poses(
            robot, None, n, workspace=workspace, free=free, noise=noise, seed=seed, instrument=instrument, **options
        )
        if best is not None and chosen.accuracy >= best.accuracy:
            break
        best = chosen
        if kind == "sockets":
            break
        q = chosen.q
    assert best is not None
    return best
