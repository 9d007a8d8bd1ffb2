"""Candidate poses, the circumstances of their measurement, and their information.

Circumstances are payload, approach, repeats, time. The information about the parameters is in
scaled Jacobians: millimetres per unit of a parameter's scale (1 mm, 1 mrad, 1 mrad of deflection).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from casadical.core.basics import M_PER_MM, Array, InputError
from casadical.core.linear_gaussian.noise import covariance_of
from casadical.core.parts import GRAVITY_COLUMNS
from casadical.identification.accuracy import predicted
from casadical.identification.identifiability import drop_poor
from casadical.identification.least_squares import LeastSquares
from casadical.identification.pose_selection.workspace import Workspace
from casadical.identification.prior import Prior
from casadical.identification.reduction import independent_parameters
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import SESSION_PREFIX, Measurements, Noise, unmeasured
from casadical.robot.inverse_kinematics import solve_joints
from casadical.robot.robot import Robot

# Pattern of the names of columns with the direction of approach of a joint.
_APPROACH = re.compile(r"approach\d+")
# Column of candidates with the index, from 0, of the socket that holds the tool.
SOCKET_COLUMN = "socket"


@dataclass(frozen=True)
class Circumstances:
    """The circumstances under which poses are measured.

    payloads : masses that can be mounted [kg]; empty: the declared one, and also zero if an effect
        needs the payload
    every_payload : whether each pose is measured with all payloads instead of a random one
    both_approaches : whether each pose is approached twice, with all joints moving in opposite
        directions
    repeats : number of measurements of each pose, in passes over all poses
    seconds : time per measurement [s]
    warmup_K : assumed rise of the temperature in the end, from 20 degC [K]
    warmup_minutes : time constant of the rise [min]

    Examples
    --------
    >>> often = casadical.identification.pose_selection.Circumstances(both_approaches=True, repeats=3)
    >>> often.size(robot), often.states(robot)
    (6, (0.0,))
    """

    payloads: tuple[float, ...] = ()
    every_payload: bool = False
    both_approaches: bool = False
    repeats: int = 1
    seconds: float = 30.0
    warmup_K: float = 5.0
    warmup_minutes: float = 35.0

    def states(self, robot: Robot) -> tuple[float, ...]:
        """Return the payloads with which the robot is measured [kg]; see `payloads`."""
        declared = robot.payload.mass if robot.payload else 0.0
        if self.payloads:
            return self.payloads
        return (0.0, declared) if any("payload_kg" in e.needs for e in robot.effects) else (declared,)

    def size(self, robot: Robot) -> int:
        """Return the number of measurements of each pose."""
        return self.repeats * (1 + self.both_approaches) * (len(self.states(robot)) if self.every_payload else 1)


@dataclass(frozen=True, eq=False)
class Candidates:
    """N poses, each to be measured g times under its own circumstances.

    q : joint variables, shape (N, joints) [rad or m]
    conditions : values of each column of conditions by its name, shape (N, g) each
    turn : index of the pass of each measurement, from 0, shape (g,)
    """

    q: Array
    conditions: Mapping[str, Array] = field(default_factory=dict)
    turn: Array = field(default_factory=lambda: np.zeros(1, dtype=int))

    def __len__(self) -> int:
        return len(self.q)

    @property
    def size(self) -> int:
        """Return the number g of measurements of each pose."""
        return len(self.turn)

    def __getitem__(self, which: Array) -> Candidates:
        return replace(self, q=self.q[which], conditions={n: v[which] for n, v in self.conditions.items()})

    def joined(self, other: Candidates) -> Candidates:
        """Return these candidates followed by others with the same columns."""
        conditions = {n: np.concatenate([v, other.conditions[n]]) for n, v in self.conditions.items()}
        return replace(self, q=np.concatenate([self.q, other.q]), conditions=conditions)

    def measurements(self, robot: Robot, source: str = "candidates") -> Measurements:
        """Return N g measurements at the model's positions, the g of each pose in succession.

        source : name of the table
        """
        conditions = {n: v.ravel() for n, v in self.conditions.items()}
        return expected(robot, np.repeat(self.q, self.size, axis=0), conditions, source)


def expected(robot: Robot, q: Array, conditions: Mapping[str, Array], source: str) -> Measurements:
    """Return measurements of the positions that the model gives at joint variables q.

    q : shape (n, joints) [rad or m]; conditions : columns by name, shape (n,) each
    source : name of the table
    """
    m = unmeasured(q, conditions, source)
    return replace(m, position=predicted(robot, m)[0])


def one_turn(robot: Robot) -> Robot:
    """Return the robot with one turn as the range of joints that have more, nearest to zero."""
    turn, joints = 2 * np.pi, list(robot.joints)
    for k, j in enumerate(joints):
        if j.kind == "revolute" and j.upper - j.lower > turn:
            lower = min(max(j.lower, -np.pi), j.upper - turn)
            joints[k] = replace(j, lower=lower, upper=lower + turn)
    return replace(robot, joints=tuple(joints))


def draw(robot: Robot, count: int, workspace: Workspace, rng: np.random.Generator, *, to_ends: bool = False) -> Array:
    """Return random joint variables that the workspace allows, shape (count, joints) [rad or m].

    Those of coupled joints follow from the others.

    to_ends : whether every other one is drawn with more density near the joints' limits, where good
        poses often are
    Raises InputError where fewer than `count` of 100 times as many are allowed.
    """
    lower, upper = workspace.ranges(robot)
    allowed = np.empty((0, robot.n))
    for _ in range(100):
        share = rng.uniform(size=(count, robot.n))
        if to_ends:
            share[::2] = 0.5 - 0.5 * np.cos(np.pi * share[::2])
        q = robot.coupled(lower + (upper - lower) * share)
        allowed = np.concatenate([allowed, q[workspace.allows(robot, q)]])[:count]
        if len(allowed) == count:
            return allowed
    refused = {reason: int(mask.sum()) for reason, mask in workspace.refusals(robot, q).items()}
    raise InputError(
        f"only {len(allowed)} of {100 * count} readings drawn are allowed; of the last {count} were "
        f"refused: {', '.join(f'{reason} {number}' for reason, number in refused.items())}; widen "
        "the tightest of these"
    )


def candidates_at(robot: Robot, q: Array, circumstances: Circumstances, n: int, rng: np.random.Generator) -> Candidates:
    """Return candidates at poses q with every column of conditions that the robot's model needs.

    Approach, time and, unless all are measured, payload are random; the session is the last one.

    q : joint variables, shape (N, joints) [rad or m]
    n : number of poses of the campaign, which determines its duration
    Raises InputError for a column that cannot be planned.
    """
    g, N = circumstances.size(robot), len(q)
    states = circumstances.states(robot)
    mounted = len(states) if circumstances.every_payload else 1
    counts = (circumstances.repeats, mounted, 1 + circumstances.both_approaches)
    turn, payload, side = np.unravel_index(np.arange(g), counts)
    moment = rng.uniform(size=(N, 1)) * np.ones(g)
    columns: dict[str, Array] = {}
    # Pattern of the names of columns that follow from the time of a measurement.
    timed_column = re.compile(r"progress|time_s|temperature_degC|warmth_\d+s")
    for name in robot.conditions:
        if name == "payload_kg":
            start = 0 if circumstances.every_payload else rng.integers(len(states), size=(N, 1))
            columns[name] = np.array(states)[(start + payload) % len(states)] * np.ones((N, g))
        elif _APPROACH.fullmatch(name):
            columns[name] = rng.choice([-1.0, 1.0], (N, 1)) * np.where(side, -1.0, 1.0)
        elif name.startswith(SESSION_PREFIX):  # poses are planned for the last session
            columns[name] = np.full(
                (N, g), float(name == [c for c in robot.conditions if c.startswith(SESSION_PREFIX)][-1])
            )
        elif name in GRAVITY_COLUMNS:  # the robot is mounted as declared
            columns[name] = np.full((N, g), robot.declared[robot.conditions.index(name)])
        elif not timed_column.fullmatch(name):
            raise InputError(f"column {name!r} is needed by an effect and cannot be planned; leave that effect out")
    if timed := [name for name in robot.conditions if timed_column.fullmatch(name)]:
        columns |= timeline(timed, moment, n * g, circumstances)
        columns["progress"] = moment
    return Candidates(q, columns, np.asarray(turn))


def timeline(names: list[str], progress: Array, n: int, circumstances: Circumstances) -> dict[str, Array]:
    """Return columns that follow from the time alone, by name, each of the shape of `progress`.

    names : columns, such as time_s or temperature_degC
    progress : times divided by the campaign's duration, 0 to 1, any shape
    n : number of measurements of the campaign
    """
    rows = max(n, 2)
    course = np.linspace(0, 1, 200)
    time = circumstances.seconds * rows * course
    warmth = circumstances.warmup_K * -np.expm1(-time / (60 * circumstances.warmup_minutes))
    clock = unmeasured(np.zeros((200, 1)), {"time_s": time, "temperature_degC": 20 + warmth})
    clock, missing = derive(clock, names)
    assert not missing
    return {name: np.interp(progress, course, clock.conditions[name]) for name in names}


def later_poses(
    robot: Robot,
    campaign: Measurements,
    inliers: Array,
    columns: Iterable[str],
    count: int,
    seed: int,
    workspace: Workspace | None = None,
    payloads: Sequence[float] = (),
) -> tuple[Measurements, Array, Array | None]:
    """Return K poses that could be measured after a campaign, in random circumstances.

    They are random ones, up to half of them within the inliers' joint ranges, and the inliers. They
    have their columns of conditions and no measured values. The arrays are the index of the
    campaign's pose that each repeats, -1 for none, shape (K,), and whether the arm is to be warm,
    shape (K,); None without a column warmth_...

    inliers : mask of the campaign's inliers, shape (n,)
    columns : names of the columns of conditions that are needed
    count : number of random poses at most
    workspace : allowed poses, by default within the robot's joint limits; four-bars stay as open as
        in the campaign
    payloads : masses that can be mounted [kg]; empty: zero, the declared one and the campaign's
    """
    rng = np.random.default_rng(seed)
    room = (workspace or Workspace()).as_open_as(robot, campaign.q)
    own = campaign.q[inliers]
    lower, upper = room.ranges(robot)

    def drawn(wanted: int, low: Array, high: Array) -> Array:
        """Return at most `wanted` random poses between limits, which the workspace allows."""
        q = robot.coupled(rng.uniform(low, high, (4 * wanted, robot.n)))
        return np.asarray(q[room.allows(robot, q)][:wanted])

    near = np.empty((0, robot.n))
    narrow = np.maximum(own.min(axis=0), lower), np.minimum(own.max(axis=0), upper)
    if (narrow[0] < narrow[1]).all():
        near = drawn(count // 2, *narrow)
    wide = drawn(count - len(near), lower, upper)
    q = np.concatenate([near, wide, own])
    repeated = np.concatenate([np.full(len(near) + len(wide), -1), np.flatnonzero(inliers)])
    declared = robot.payload.mass if robot.payload else 0.0
    usual = np.unique([*campaign_payloads(robot, campaign), 0.0, declared])
    states = np.array(sorted(payloads)) if payloads else usual
    warm = rng.random(len(q)) < 0.5
    conditions = {name: _later_column(name, campaign.conditions.get(name), warm, states, rng) for name in columns}
    thermal = any(name.startswith("warmth_") for name in conditions)
    return unmeasured(q, conditions), repeated, warm if thermal else None


def campaign_payloads(robot: Robot, campaign: Measurements) -> Array:
    """Return the distinct payloads of a campaign in ascending order, shape (k,) [kg].

    Where none was logged it is the declared payload alone, zero without one.
    """
    declared = robot.payload.mass if robot.payload else 0.0
    return np.unique(campaign.conditions.get("payload_kg", np.array([declared])))


def _later_column(name: str, logged: Array | None, warm: Array, states: Array, rng: np.random.Generator) -> Array:
    """Return a column of conditions at K later poses, shape (K,).

    Payload and approach are random, a column warmth_... is by `warm`, `progress` is 1, gravity is
    the campaign's mean, and others are drawn from the campaign's values.

    name : name of the column; logged : the campaign's values; None: it has none, and zeros are
        returned (but for progress, approach and payload)
    warm : whether the arm is to be warm at each pose, shape (K,); states : payloads [kg]
    """
    if name == "progress":
        return np.ones(len(warm))
    if _APPROACH.fullmatch(name):
        return rng.choice([-1.0, 1.0], len(warm))
    if name == "payload_kg":
        return rng.choice(states, len(warm))
    if logged is None:
        return np.zeros(len(warm))
    if name in GRAVITY_COLUMNS:
        return np.full(len(warm), logged.mean())
    if name.startswith("warmth_"):
        # A warm arm is at least 5 K warmer than the coldest one of the campaign.
        return np.asarray(np.where(warm, max(logged.max(), logged.min() + 5.0), logged.min()))
    return rng.choice(np.unique(logged), len(warm))


def poses_at_places(
    robot: Robot, places: Array, count: int, workspace: Workspace, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return up to about `count` poses with the tool point at given places, and the place of each.

    The joint variables have the shape (n, joints) [rad or m], the indices of the places, from 0 and
    as floats, (n,). Inverse kinematics from random starts finds them to 1e-7 m; places that are
    hardly reachable have few or none.

    places : in the measuring frame, shape (k, 3) [m]
    """
    each = -(-count // len(places))
    readings, which = [], []
    for k, place in enumerate(places):

        def remaining(q: Array, _: Array, place: Array = place) -> tuple[Array, Array]:
            """Return the place minus the tool points at q, (n, 3) [m], and the points' Jacobians."""
            m = unmeasured(q)
            return place - predicted(robot, m)[0], joint_jacobian(robot, m)

        start = draw(robot, 4 * each, workspace, rng)
        q = solve_joints(remaining, start, 40, 0.3, limits=workspace.ranges(robot), coupled=robot.coupled, least=1e-2)
        distance = np.linalg.norm(remaining(q, np.arange(len(q)))[0], axis=1)
        good = np.flatnonzero((distance < 1e-7) & workspace.allows(robot, q))[:each]
        readings.append(q[good])
        which.append(np.full(len(good), float(k)))
    return np.concatenate([np.zeros((0, robot.n)), *readings]), np.concatenate([np.zeros(0), *which])


def reachable_places(robot: Robot, places: Array, count: int, workspace: Workspace, rng: np.random.Generator) -> Array:
    """Return those of the places that the tool point reaches in 4 of 8 attempts, (r, 3) [m].

    places : in the measuring frame, shape (k, 3) [m]; count : number of places that are required
    Raises InputError where they are fewer.
    """
    _, which = poses_at_places(robot, places, 8 * len(places), workspace, rng)
    there = np.bincount(which.astype(int), minlength=len(places)) >= 4
    if there.sum() < count:
        out = int(np.argmin(there))
        text = ", ".join(f"{1e3 * x:.0f}" for x in places[out])
        raise InputError(
            f"{robot.name} reaches {there.sum()} of {len(places)} sockets, and {count} are wanted: "
            f"socket {out + 1} at ({text}) mm, for one, is out of reach or not allowed; give other "
            "places"
        )
    return np.asarray(places[there])


# Largest number of poses whose Jacobians are computed at a time: larger problems would be compiled
# for a single use. As many candidates show which parameters are identifiable.
MAX_POSES_PER_PART = 1000


def scaled_jacobian(robot: Robot, names: Sequence[str], m: Measurements) -> Array:
    """Return the Jacobian of the measured point by p parameters, shape (n, 3, p).

    It is taken at the robot's values, in the measuring frame, in mm per unit of scale.

    names : the p parameters; m : poses, whose measured values do not count
    """
    parts = [
        m[np.arange(start, min(start + MAX_POSES_PER_PART, len(m)))] for start in range(0, len(m), MAX_POSES_PER_PART)
    ]
    problems = (LeastSquares(robot, (part,), tuple(names), "linear", False, ((M_PER_MM, M_PER_MM),)) for part in parts)
    jacobians = [problem.evaluate(np.zeros(len(names)))[1] for problem in problems]
    return np.asarray(np.concatenate(jacobians).reshape(len(m), 3, -1))


@lru_cache(maxsize=16)
def _joint_jacobian(robot: Robot) -> ca.Function:
    """Return the CasADi function (q, w, phi) -> J[3, n]: the point's derivative by joint variables.

    w are conditions of a pose, phi the parameters; J is in m/rad or m/m, in the measuring frame.
    """
    model = robot.model
    J = ca.densify(ca.jacobian(model.p, model.q))
    return ca.Function("by_joints", [model.q, model.w, model.phi], [J], ["q", "w", "phi"], ["J"])


def joint_jacobian(robot: Robot, m: Measurements) -> Array:
    """Return the derivative of the measured point by the joint variables, shape (n, 3, joints).

    It is in the measuring frame [m/rad or m/m].
    """
    w = m.condition_matrix(robot.conditions, robot.declared)
    J = _joint_jacobian(robot).map(len(m))(m.q.T, w.T, robot.parameters.values).full()
    return np.asarray(J.reshape(3, len(m), robot.n).transpose(1, 0, 2))


def noise_covariance(robot: Robot, m: Measurements, noise: Noise) -> Array:
    """Return the noise covariance of each measured point, shape (n, 3, 3) [mm^2].

    It is the sum of the instrument's and of the joint repeatability's, in the measuring frame.
    """
    Jq = joint_jacobian(robot, m) if noise.repeatability else np.zeros((len(m), 3, 0))
    return covariance_of(Jq, noise.repeatability / M_PER_MM, noise.sigma / M_PER_MM)


def independent(
    robot: Robot,
    names: Sequence[str],
    sets: Sequence[Measurements],
    information: Callable[[Sequence[str]], Array],
    prior: Prior | None = None,
) -> tuple[tuple[str, ...], Mapping[str, str]]:
    """Return the parameters that an identification from such poses would keep, and the others.

    The others are given as name -> reason. Dependent parameters are omitted first, then, one by
    one, those that the data would determine less accurately than their own priors (as in
    `reduction.reduce_and_solve`). With the prior of another campaign, which constrains them, the
    second step is omitted.

    names : parameters to choose from
    sets : measurements at some of the poses
    information : function from names of k parameters to their information matrix, shape (k + u,
        k + u), in units of scale; u coordinates of unknown points are at its end
    prior : prior of another campaign
    Raises InputError: no parameter remains.
    """
    problem = LeastSquares(robot, tuple(sets), tuple(names), "linear", False, ((M_PER_MM, M_PER_MM),) * len(sets))
    analysis = independent_parameters(problem)
    identifiable = list(analysis.independent)
    if prior is not None:
        return tuple(identifiable), analysis.unidentifiable
    determined, poor, _ = drop_poor([robot.parameters[n] for n in identifiable], information(identifiable))
    if not determined:
        raise InputError(f"{robot.name}: poses like these determine none of {', '.join(names)}; free other parameters")
    return tuple(identifiable[k] for k in determined), {**analysis.unidentifiable, **poor}


def prior_information(robot: Robot, names: Sequence[str], prior: Prior | None, size: int = 0) -> Array:
    """Return the prior information matrix of parameters, shape (size, size), in units of scale.

    It is that which `identify` uses; rows and columns beyond the parameters are zero.

    names : the parameters; prior : prior of another campaign
    size : number of all variables; less than the number of parameters: that number
    """
    means, covariances = (prior.means, prior.covariances) if prior is not None else (False, ())
    matrix = LeastSquares(robot, (), tuple(names), "linear", means, (), correlated=covariances).prior_matrix
    return np.pad(matrix, (0, max(0, size - len(names))))
