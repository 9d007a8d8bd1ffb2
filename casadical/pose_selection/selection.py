"""Which poses to measure, and what they would tell: `select_poses` and its result."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pandas as pd

from ..conditions import derive
from ..errors import InputError
from ..identifiability import Unidentifiable
from ..measurements import Measurements
from ..robot import Robot
from ..transforms import Array
from .candidates import Candidates, Circumstances, circumstanced, draw, draw_uniform
from .criteria import Criterion, checked, observability
from .designs import Design, Determinant, Linear, Spectral, inverse
from .exchange import improve, search
from .information import MM, Noise, independent, noise_covariance, scaled_jacobian, whitened
from .order import arranged
from .workspace import Workspace

# Neighbours of every chosen pose, and how far off as a share of the joints' ranges, in each round of refinement.
NEIGHBOURS = 12
REFINEMENTS = (0.2, 0.08, 0.03)
TASK_POSES = 300


@dataclass(frozen=True, eq=False)
class Selection:
    """Poses to measure, in order, and what to expect of them.

    robot : with the values and effects that were planned for
    chosen : readings and circumstances; m : one row a measurement, in order, at the positions that the model gives
    measured : what was measured before and counts as well
    names, held : parameters that will be identified, and the others with the reason
    criterion, noise, task, circumstances : as asked for
    """

    robot: Robot
    chosen: Candidates
    m: Measurements
    measured: Measurements | None
    names: tuple[str, ...]
    held: tuple[Unidentifiable, ...]
    criterion: Criterion
    noise: Noise
    task: Measurements
    circumstances: Circumstances

    def __len__(self) -> int:
        return len(self.m)

    @property
    def q(self) -> Array:
        """Readings in order, shape (n, joints) [rad or m]."""
        return self.m.q

    def ordered(self) -> Selection:
        """The same poses in an order of little travel. Raises InputError where networkx is missing."""
        return replace(self, m=arranged(self.robot, self.chosen, self.circumstances, travel=True))

    @cached_property
    def _sets(self) -> tuple[Measurements, ...]:
        return (self.m,) if self.measured is None else (self.m, self.measured)

    @cached_property
    def jacobian(self) -> Array:
        """Of all poses, measured ones last, shape (n, 3, p) [mm per unit of scale]."""
        return np.concatenate([scaled_jacobian(self.robot, self.names, m) for m in self._sets])

    @cached_property
    def observability(self) -> dict[str, float]:
        """Indices O1 to O5 of all poses."""
        return observability(self.jacobian.reshape(-1, len(self.names)), len(self.jacobian))

    @cached_property
    def _covariance(self) -> Array:
        """Of the parameters in units of scale: J'J inverse, the noise of each pose between."""
        J = self.jacobian
        noise = np.concatenate([noise_covariance(self.robot, m, self.noise) for m in self._sets])
        H = inverse(np.einsum("kip,kiq->pq", J, J))
        return np.asarray(H @ np.einsum("kip,kij,kjq->pq", J, noise, J, optimize=True) @ H)

    @cached_property
    def scale(self) -> Array:
        """The size of each parameter that counts as one, shape (len(names),) [SI]."""
        return np.array([self.robot.parameters[n].scale for n in self.names])

    @property
    def covariance(self) -> Array:
        """Expected, of the parameters, shape (p, p) [SI]."""
        return np.asarray(self._covariance * np.outer(self.scale, self.scale))

    @property
    def standard_errors(self) -> Array:
        """Expected, of the parameters, shape (p,) [SI]."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def expected_error(self, m: Measurements | None = None) -> Array:
        """Root mean square error of the calibrated robot's position to expect from noise, shape (n,) [m].

        m : poses to predict; None: the task
        """
        J = scaled_jacobian(self.robot, self.names, self.task if m is None else m)
        return np.asarray(MM * np.sqrt(np.einsum("kip,pq,kiq->k", J, self._covariance, J, optimize=True)))

    @cached_property
    def accuracy(self) -> float:
        """Root mean square of the expected error over the task [m]."""
        return float(np.sqrt(np.mean(self.expected_error() ** 2)))

    @property
    def parameters(self) -> pd.DataFrame:
        """Expected standard errors in readable units (mm, deg), and what would not be identified and why."""
        rows = [
            (name, p.group, p.readable(error), p.readable_unit, "")
            for name, error in zip(self.names, self.standard_errors, strict=True)
            for p in (self.robot.parameters[name],)
        ]
        rows += [(u.name, self.robot.parameters[u.name].group, np.nan, "", u.reason) for u in self.held]
        return pd.DataFrame(rows, columns=["name", "group", "expected_std_error", "unit", "not_identifiable"])

    @property
    def error_map(self) -> pd.DataFrame:
        """Expected error [mm] at every pose of the task: position, readings, error."""
        assert self.task.position is not None
        table = pd.DataFrame(1e3 * self.task.position, columns=["x_mm", "y_mm", "z_mm"])
        table["expected_error_mm"] = 1e3 * self.expected_error()
        return pd.concat([table, readings_table(self.robot, self.task.q)], axis=1)

    @property
    def table(self) -> pd.DataFrame:
        """What goes to the robot: a row a measurement, with readings, circumstances and where the point will be.

        The columns nominal_x_mm ... are for finding the reflector; they are no measurements.
        """
        assert self.m.position is not None
        table = pd.DataFrame({"pose": np.arange(1, len(self.m) + 1)})
        for name, values in self.m.conditions.items():
            if name == "payload_kg" or name.startswith("approach"):
                table[name] = values if name == "payload_kg" else values.astype(int)
        nominal = pd.DataFrame(1e3 * self.m.position, columns=[f"nominal_{c}_mm" for c in "xyz"])
        return pd.concat([table, readings_table(self.robot, self.m.q), nominal.round(3)], axis=1)


def readings_table(robot: Robot, q: Array) -> pd.DataFrame:
    """Readings as columns q1_deg, q2_mm, ..., to 1e-6 of a degree or millimetre."""
    columns = {}
    for i, joint in enumerate(robot.joints):
        turns = joint.kind == "revolute"
        columns[f"q{i + 1}_{'deg' if turns else 'mm'}"] = np.round(q[:, i] * (180 / np.pi if turns else 1e3), 6)
    return pd.DataFrame(columns)


@dataclass(frozen=True, eq=False)
class Problem:
    """What a search works on.

    names, held, measured, task : as of `Selection`; pool : candidates; open : whether new ones may be drawn near them
    fixed : information of what was measured, shape (p, p); weight : W of linear criteria, shape (p, p)
    """

    robot: Robot
    workspace: Workspace
    circumstances: Circumstances
    noise: Noise
    names: tuple[str, ...]
    held: tuple[Unidentifiable, ...]
    measured: Measurements | None
    task: Measurements
    pool: Candidates
    open: bool
    fixed: Array = field(repr=False)
    weight: Array = field(repr=False)

    def design(self, pool: Candidates, criterion: Criterion, min_distance: float | None) -> Design:
        """The search's state over a pool; see `designs.Design`."""
        lower, upper = self.workspace.ranges(self.robot)
        span = upper - lower
        occupied = np.empty((0, self.robot.n)) if self.measured is None else self.measured.q
        plain = criterion in ("O1", "O2", "O3", "O4", "O5")
        rows = _rows(self.robot, self.names, pool.measurements(self.robot), None if plain else self.noise)
        # Passes repeat the same rows: they count by the root of their number.
        once = rows.reshape(len(pool), pool.size, 3, -1)[:, pool.turn == 0]
        rows = np.sqrt(self.circumstances.repeats) * once.reshape(len(pool), -1, len(self.names))
        fixed = self.fixed
        if plain and self.measured is not None:
            A = _rows(self.robot, self.names, self.measured, None).reshape(-1, len(self.names))
            fixed = A.T @ A
        apart = -1.0 if min_distance is None else min_distance
        common = (rows, fixed, (pool.q - lower) / span, apart, (occupied - lower) / span)
        if criterion in ("D", "O1"):
            return Determinant(*common)
        if criterion in ("A", "V"):
            return Linear(self.weight, *common)
        return Spectral(criterion, *common)


def _rows(robot: Robot, names: Sequence[str], m: Measurements, noise: Noise | None) -> Array:
    """Scaled Jacobian, in units of sigma if noise is given, shape (n, 3, p)."""
    J = scaled_jacobian(robot, names, m)
    return J if noise is None else whitened(J, noise_covariance(robot, m, noise))


def prepare(
    robot: Robot,
    n: int,
    criterion: Criterion,
    *,
    candidates: Array | None,
    workspace: Workspace,
    circumstances: Circumstances,
    measured: Measurements | None,
    free: Iterable[str] | None,
    interest: Iterable[str],
    task: Array | None,
    noise: Noise,
    pool: int,
    rng: np.random.Generator,
) -> Problem:
    """Candidates, independent parameters and weights; arguments as of `select_poses`. Raises InputError."""
    criterion = checked(criterion)
    words = ("kinematic", "compliance", *(e.label for e in robot.effects)) if free is None else tuple(free)
    wanted = robot.parameters.select(words)
    q = draw(robot, pool, workspace, rng) if candidates is None else _allowed(robot, candidates, workspace)
    ready = circumstanced(robot, q, circumstances, n, rng)
    m = ready.measurements(robot)
    if measured is not None:
        measured = _with_columns(robot, measured)
    total = n * ready.size + (0 if measured is None else len(measured))
    names, held = independent(robot, wanted, m, total, noise)
    if 3 * total < len(names):
        raise InputError(
            f"{total} poses give {3 * total} numbers, but {len(names)} parameters are to be identified; "
            f"at least {-(-len(names) // 3)} poses are needed, and some more tell how good they are"
        )
    task_q = draw_uniform(robot, TASK_POSES, workspace, rng) if task is None else np.atleast_2d(task)
    one = replace(circumstances, every_payload=False, both_approaches=False, repeats=1)
    goal = circumstanced(robot, task_q, one, n, rng).measurements(robot, "task")
    p = len(names)
    fixed = np.zeros((p, p))
    if measured is not None:
        A = _rows(robot, names, measured, noise).reshape(-1, p)
        fixed = A.T @ A
    chosen = _chosen(robot, interest, names)
    J = scaled_jacobian(robot, names, goal)
    A = _rows(robot, names, m, noise).reshape(-1, p)
    weight = _weight(criterion, J, chosen, inverse(A.T @ A * total / len(m)))
    return Problem(
        robot, workspace, circumstances, noise, names, held, measured, goal, ready, candidates is None, fixed, weight
    )


def _weight(criterion: Criterion, J: Array, chosen: Array, C: Array) -> Array:
    """W: the task's mean J'J, the identity, and the parameters of interest, each as important as the other.

    C : covariance from as many poses taken by chance, which says what counts as important
    """
    of_interest = np.diag(chosen)
    if criterion == "A":
        return of_interest if chosen.any() else np.eye(len(C))
    of_task = np.einsum("kip,kiq->pq", J, J) / len(J)
    if chosen.any():
        return np.asarray(of_task / np.sum(of_task * C) + of_interest / np.sum(of_interest * C))
    return np.asarray(of_task)


def _chosen(robot: Robot, interest: Iterable[str], names: Sequence[str]) -> Array:
    """One over the square of the prior, in units of scale, of the parameters of interest; zero of others."""
    words = tuple(interest)
    hit = robot.parameters.select(words) if words else ()
    lost = [n for n in hit if n not in names]
    if lost and len(lost) == len(hit):
        raise InputError(f"no poses would tell anything of {', '.join(lost)}: see what it is confounded with")
    parameters = [robot.parameters[n] for n in names]
    return np.array([(p.scale / p.prior) ** 2 if p.name in hit else 0.0 for p in parameters])


def _allowed(robot: Robot, q: Array, workspace: Workspace) -> Array:
    q = np.atleast_2d(np.asarray(q, dtype=float))
    if q.ndim != 2 or q.shape[1] != robot.n or not np.isfinite(q).all():
        raise InputError(f"candidates of shape {q.shape}; allowed: (poses, {robot.n}) finite readings [rad or m]")
    kept = q[workspace.allows(robot, q)]
    if not len(kept):
        refused = {reason: int(mask.sum()) for reason, mask in workspace.refusals(robot, q).items()}
        raise InputError(f"none of the {len(q)} candidates is allowed: {refused}; widen the workspace")
    return np.asarray(kept)


def _with_columns(robot: Robot, measured: Measurements) -> Measurements:
    if measured.kind not in ("position", "pose") or measured.q.shape[1] != robot.n:
        raise InputError(f"{measured.source}: measured poses must be positions of {robot.name}'s {robot.n} joints")
    derived, missing = derive(measured, robot.conditions)
    lost = [name for name in missing if name != "payload_kg"]
    if lost:
        raise InputError(f"{measured.source}: column {lost[0]!r} is missing, which {robot.name}'s effects need")
    return replace(derived, kind="position", orientation=None)


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
) -> Selection:
    """Choose n readings to measure, by an exchange of candidates.

    robot : its values are what the Jacobians are taken at, so give the calibrated one when continuing; its effects
        (`with_effect`) are parameters like any other
    among : readings to choose from, shape (N, joints) [rad or m]; or limits between which they are drawn, and then
        refined in the neighbourhood of the best: a tuple (lower, upper), shape (joints,) each [rad or m], or a
        workspace; None: the robot's own ranges
    criterion : V (the mean variance of the position over the task), D or O1, A, O2 to O5; see `criteria`
    workspace, circumstances : what else keeps a pose from being measured; payloads, approaches, repeats
    measured : poses that were measured already: the choice adds to them and keeps its distance
    free : what will be identified, as of `identify`; by default geometry, frames, compliance and all effects
    interest : parameters (names, groups or labels, patterns) that matter most: A then regards only these, V weighs
        them, in units of their priors, as much as the task
    task : readings at which the robot is to be accurate, shape (T, joints) [rad or m]; None: all that is allowed
    noise : of coordinates and joints; min_distance : between any two poses, in the joint that differs most, as a share
        of its range, None where a pose may be chosen more than once; pool : candidates to draw; restarts : searches, of
        which the best counts; seed : of all chance

    Raises InputError where nothing can be chosen. Source: Mitchell (1974); Sun and Hollerbach (2008).
    """
    if n < 1:
        raise InputError(f"n is {n}; at least one pose must be chosen")
    candidates, workspace = _sources(among, workspace)
    rng = np.random.default_rng(seed)
    problem = prepare(
        robot, n, criterion, candidates=candidates, workspace=workspace,
        circumstances=circumstances or Circumstances(), measured=measured, free=free, interest=interest, task=task,
        noise=noise or Noise(), pool=max(pool, 3 * n), rng=rng,
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
    room = workspace or Workspace()
    if isinstance(among, tuple):
        if len(among) != 2:
            raise InputError(f"limits of {len(among)} parts; allowed: (lower, upper), one reading a joint each")
        lower, upper = (np.asarray(side, dtype=float) for side in among)
        return None, replace(room, lower=lower, upper=upper)
    if among is not None and np.asarray(among).ndim == 0:
        raise InputError(f"poses chosen among {among!r}; allowed: candidates, (lower, upper), a Workspace, None")
    return among, room


def selection(problem: Problem, chosen: Candidates, criterion: Criterion) -> Selection:
    """The result of a search."""
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
    )


def _refined(
    problem: Problem,
    chosen: Candidates,
    criterion: Criterion,
    min_distance: float | None,
    size: float,
    rng: np.random.Generator,
) -> Candidates:
    """Exchange the chosen ones with new candidates near them."""
    robot, workspace = problem.robot, problem.workspace
    lower, upper = workspace.ranges(robot)
    steps = size * (upper - lower) * rng.normal(size=(NEIGHBOURS, len(chosen), robot.n))
    q = np.clip(chosen.q + steps, lower, upper).reshape(-1, robot.n)
    q = q[workspace.allows(robot, q)]
    pool = chosen.joined(circumstanced(robot, q, problem.circumstances, len(chosen), rng)) if len(q) else chosen
    design = problem.design(pool, criterion, min_distance)
    design.start(list(range(len(chosen))))
    improve(design)
    return pool[np.array(design.chosen)]
