"""Input of a pose search: candidates, independent parameters, prior information, weights."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.noise import whitening_of
from casadical.identification.pose_selection.candidates import (
    MAX_POSES_PER_PART,
    SOCKET_COLUMN,
    Candidates,
    Circumstances,
    candidates_at,
    draw,
    independent,
    noise_covariance,
    poses_at_places,
    prior_information,
    reachable_places,
    scaled_jacobian,
)
from casadical.identification.pose_selection.experimental_design import Design, inverse
from casadical.identification.pose_selection.instruments import Instrument, without_base
from casadical.identification.pose_selection.workspace import Workspace
from casadical.identification.prior import Prior
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements, Noise
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """The input of a pose search.

    robot : robot with the values at which Jacobians are taken, and with the effects to identify
    workspace : which poses can be measured
    circumstances : payloads, approaches and repeats of the poses
    noise : assumed noise of the instrument and the joints
    names : parameters that will be identified
    unidentifiable : the reason of each other requested parameter, by name
    measured : poses measured before, which count as well
    task : poses at which the robot is to be accurate
    pool : candidate poses
    open : whether additional candidates may be drawn near those of the pool
    fixed : information from measured poses and priors, shape (p, p), in units of scale; the p
        variables are those of names, then the unknown coordinates of the instrument's places
    weight : W of the mean variance trace(W C), shape (p, p) [mm^2]; normalised, without unit, if
        there are parameters of interest
    instrument : what is read in place of positions; None: positions
    prior : prior of another campaign, which is included in `fixed`
    """

    robot: Robot
    workspace: Workspace
    circumstances: Circumstances
    noise: Noise
    names: tuple[str, ...]
    unidentifiable: Mapping[str, str]
    measured: Measurements | None
    task: Measurements
    pool: Candidates
    open: bool
    fixed: Array = field(repr=False)
    weight: Array = field(repr=False)
    instrument: Instrument | None = None
    prior: Prior | None = None

    def design(self, pool: Candidates, min_distance: float | None) -> Design:
        """Return the initial state of a search over a pool, with no candidate chosen.

        min_distance : smallest distance between two poses, also measured ones, as a fraction of the
            range of the joint that differs most; None: a pose may be chosen more than once
        """
        lower, upper = self.workspace.ranges(self.robot)
        span = upper - lower
        occupied = np.empty((0, self.robot.n)) if self.measured is None else self.measured.q
        rows = _rows(self.robot, self.names, pool.measurements(self.robot), self.noise, self.instrument)
        # n passes repeat the same rows, which equals the rows of one pass times the root of n.
        once = rows.reshape(len(pool), pool.size, *rows.shape[1:])[:, pool.turn == 0]
        rows = np.sqrt(self.circumstances.repeats) * once.reshape(len(pool), -1, rows.shape[2])
        apart = -1.0 if min_distance is None else min_distance
        places, measured_at = (pool.q - lower) / span, (occupied - lower) / span
        return Design(self.weight, rows, self.fixed, places, apart, measured_at)


def _rows(
    robot: Robot, names: Sequence[str], m: Measurements, noise: Noise, instrument: Instrument | None = None
) -> Array:
    """Return the whitened Jacobian of n poses, shape (n, numbers, p + unknowns).

    It is in standard deviations of the noise per unit of scale. `numbers` are read at each pose, 3
    without an instrument; the unknowns are the coordinates of its places.
    """
    if instrument is not None:
        return instrument.rows(robot, names, m, noise)
    J = scaled_jacobian(robot, names, m)
    return np.asarray(whitening_of(noise_covariance(robot, m, noise))[0] @ J)


def prepare(
    robot: Robot,
    n: int,
    *,
    pool: int,
    rng: np.random.Generator,
    candidates: Array | None = None,
    workspace: Workspace | None = None,
    circumstances: Circumstances | None = None,
    measured: Measurements | None = None,
    free: Iterable[str] | None = None,
    interest: Iterable[str] = (),
    task: Array | None = None,
    noise: Noise | None = None,
    instrument: Instrument | None = None,
    prior: Prior | None = None,
) -> DesignProblem:
    """Return the input of a pose search: candidates, independent parameters, weights.

    n : number of poses that will be chosen
    pool : number of candidates to draw; rng : their random generator
    candidates : joint variables to choose from, shape (N, joints) [rad or m]; None: drawn ones
    workspace, circumstances, measured, free, interest, task, noise, instrument, prior : as of
        `select_poses`
    Raises InputError: unusable arguments, or fewer numbers than unknowns.
    """
    workspace, circumstances, noise = workspace or Workspace(), circumstances or Circumstances(), noise or Noise()
    words = ("kinematic", "compliance", *(e.label for e in robot.effects)) if free is None else tuple(free)
    wanted = robot.parameters.select(words)
    if instrument is not None and measured is not None:
        raise InputError(
            f"poses measured before are counted with positions alone, not with {instrument.kind}: "
            "plan with the robot file that calibrate --out wrote"
        )
    if instrument is not None and instrument.kind == "sockets":
        if candidates is not None:
            raise InputError(
                "sockets: poses that hold the tool in them are computed, and are no candidates to be given"
            )
        if instrument.surveyed:
            raise InputError("sockets are identified together with the robot; only wires may have measured places")
    q, conditions_at = _readings(robot, candidates, workspace, pool, rng, instrument)
    ready = candidates_at(robot, q, circumstances, n, rng)
    conditions_at = {name: which[:, None] * np.ones(ready.size) for name, which in conditions_at.items()}
    ready = replace(ready, conditions={**ready.conditions, **conditions_at})
    m, measured = ready.measurements(robot), None if measured is None else _with_columns(robot, measured)
    total = n * ready.size + (0 if measured is None else len(measured))
    some = m[np.arange(min(MAX_POSES_PER_PART, len(m)))]
    extra, numbers = (instrument.extra, instrument.numbers) if instrument else (0, 3)

    def before(identified: Sequence[str]) -> Array:
        """Return the information matrix of some parameters and the unknown places without poses."""
        size = len(identified) + extra
        prior_matrix = prior_information(robot, identified, prior, size)
        return prior_matrix + (instrument.before(size, noise) if instrument else 0.0)

    def information(identified: Sequence[str]) -> Array:
        """Return the information matrix of as many random poses as are planned, priors included."""
        A = _rows(robot, identified, m, noise, instrument)
        A = A.reshape(-1, A.shape[2])
        return A.T @ A * (total / len(m)) + before(identified)

    names, undetermined = independent(
        robot, wanted, instrument.sets(some) if instrument else (some,), information, prior
    )
    if prior is None and numbers * total < (unknowns := len(names) + extra):
        raise InputError(
            f"{total} poses give {numbers * total} numbers, but {len(names)} parameters are to be "
            f"identified{f' and {extra} coordinates of places' if extra else ''}; at least "
            f"{-(-unknowns // numbers)} poses are needed, and some more to estimate their accuracy"
        )
    task_q = draw(robot, 300, workspace, rng) if task is None else np.atleast_2d(task)
    one = replace(circumstances, every_payload=False, both_approaches=False, repeats=1)
    goal = candidates_at(robot, task_q, one, n, rng).measurements(robot, "task")
    p, fixed = len(names), before(names)
    if measured is not None:
        A = _rows(robot, names, measured, noise).reshape(-1, p)
        fixed = fixed + A.T @ A
    weight = np.zeros((p + extra, p + extra))
    J = jacobian_of(robot, names, goal, instrument)
    # The task's mean J'J and, with equal weight, the parameters of interest, both normalised by
    # the covariance from as many random poses.
    words = tuple(interest)
    hit = robot.parameters.select(words) if words else ()
    lost = [n for n in hit if n not in names]
    if lost and len(lost) == len(hit):
        raise InputError(f"no poses would determine {', '.join(lost)}: see what it is confounded with")
    parameters = [robot.parameters[n] for n in names]
    chosen = np.array([(p.scale / p.prior) ** 2 if p.name in hit else 0.0 for p in parameters])
    C = inverse(information(names))[:p, :p]
    weight[:p, :p] = np.einsum("kip,kiq->pq", J, J) / len(J)
    if chosen.any():
        of_task, of_interest = weight[:p, :p], np.diag(chosen)
        weight[:p, :p] = of_task / np.sum(of_task * C) + of_interest / np.sum(of_interest * C)
    return DesignProblem(
        robot,
        workspace,
        circumstances,
        noise,
        names,
        undetermined,
        measured,
        goal,
        ready,
        candidates is None and SOCKET_COLUMN not in ready.conditions,
        fixed,
        weight,
        instrument,
        prior,
    )


def jacobian_of(robot: Robot, names: Sequence[str], m: Measurements, instrument: Instrument | None) -> Array:
    """Return the Jacobian of positions at a task's poses, shape (n, 3, p) [mm per unit of scale].

    Where the places of an instrument are unknown, the base is assumed to be fitted again at these
    poses, and its part is removed.

    names : the p parameters; m : the poses
    """
    J = scaled_jacobian(robot, names, m)
    return J if instrument is None or instrument.surveyed else without_base(robot, J, m)


def _readings(
    robot: Robot,
    given: Array | None,
    workspace: Workspace,
    pool: int,
    rng: np.random.Generator,
    instrument: Instrument | None,
) -> tuple[Array, dict[str, Array]]:
    """Return the candidates' joint variables, (N, joints) [rad or m], and their columns by name.

    They are the given ones that the workspace allows, drawn ones, or poses that hold the tool in
    sockets; only the latter have a column, the index of the socket, shape (N,).

    given : joint variables to choose from; None: they are drawn
    pool : number of candidates to draw
    instrument : what is read in place of positions; None: positions
    """
    if instrument is not None and instrument.kind == "sockets":
        q, which = poses_at_places(robot, instrument.places, pool, workspace, rng)
        if len(np.unique(which)) < len(instrument.places):
            reachable_places(robot, instrument.places, len(instrument.places), workspace, rng)
        return q, {SOCKET_COLUMN: which}
    if given is None:
        return draw(robot, pool, workspace, rng, to_ends=True), {}
    return _allowed(robot, given, workspace), {}


def _allowed(robot: Robot, given: Array, workspace: Workspace) -> Array:
    """Return the given joint variables that the workspace allows, shape (k, joints) [rad or m].

    Raises InputError: another shape, or none is allowed.
    """
    q = np.atleast_2d(np.asarray(given, dtype=float))
    if q.ndim != 2 or q.shape[1] != robot.n or not np.isfinite(q).all():
        raise InputError(f"candidates of shape {q.shape}; allowed: (poses, {robot.n}) finite readings [rad or m]")
    allowed = q[workspace.allows(robot, q)]
    if not len(allowed):
        refused = {reason: int(mask.sum()) for reason, mask in workspace.refusals(robot, q).items()}
        raise InputError(f"none of the {len(q)} candidates is allowed: {refused}; widen the workspace")
    return allowed


def _with_columns(robot: Robot, measured: Measurements) -> Measurements:
    """Return measured positions with every column that the robot's effects need.

    Raises InputError: no positions, another number of joints, or a missing column but the payload.
    """
    if measured.position is None or measured.q.shape[1] != robot.n:
        raise InputError(f"{measured.source}: measured poses must be positions of {robot.name}'s {robot.n} joints")
    derived, missing = derive(measured, robot.conditions, robot.loads)
    lost = [name for name in missing if name != "payload_kg"]
    if lost:
        raise InputError(f"{measured.source}: column {lost[0]!r} is missing, which {robot.name}'s effects need")
    return derived.positions_alone()
