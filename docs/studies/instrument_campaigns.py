"""Synthetic campaigns of both physics as instruments other than a tracker measure them, with what they hide known.

The physics says where points of the flange are at given readings. From that are made distances to three places,
full poses (three points of the flange, seen with noise of positions and of angles), mixed sets, and touches: of
sockets, of planes and of balls, whose readings are corrected until the robot as built, with what is hidden in it,
touches them. Every instrument has noise of its own, and the joints do not repeat exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from open_world import UNLISTED, Session, machine
from scipy.stats import ncx2

from casadical.blind_check import mujoco_physics, numpy_physics
from casadical.blind_check.numpy_physics import Plant, disturbances, perturb
from casadical.blind_check.signal_size import column_space
from casadical.blind_check.synthetic.campaigns import MEASURED
from casadical.blind_check.synthetic.fourbar import crank_distance, unfolded
from casadical.core.arrays import Array
from casadical.core.errors import ConvergenceError, InputError
from casadical.diagnosis.linearisation import signatures
from casadical.identification.accuracy import predicted
from casadical.identification.placement import place_frames
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table
from casadical.robot.robot import Robot

NAMES = ("hh800", "kr210", "ur10e")
KINDS = ("distances", "sockets", "poses", "mixed", "distances", "planes", "poses", "mixed", "distances", "balls")
SHARES = {"none": 0.3, "one": 0.55, "unlisted": 0.15}
# What an instrument alone does is not in the robot.
WORDS = [w for w in disturbances.LISTED if w != "outliers"]
# One sigma of a length [mm] that is drawn, and of an angle [rad] per metre of it.
NOISES, ANGLE = (0.02, 0.05, 0.1), 3.0
REPEATABILITIES = (4.0, 8.0)
SIGNAL = (0.35, 2.5)
# Points of the flange that tell its orientation [m].
POINTS = np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0], [0.0, 0.15, 0.0]])
SOCKETS, PLANES, BALLS, RADIUS = 6, 3, 4, 0.05
# Rounds in which readings are corrected until the nominal robot touches, then until the robot as built does.
NOMINAL, BUILT, STEP = 25, 3, 0.3
# A reading must move the point so much [m/rad], or it cannot be corrected.
LEAST_ARM = 0.1


@dataclass(frozen=True, eq=False)
class Campaign:
    """Sets as measured, what is hidden, and what a judge with all knowledge but the size could see.

    visible : root of the noncentrality over the numbers that were measured; noncentrality : of the hidden signature
    """

    robot: Robot
    kind: str
    physics: str
    hidden: str
    truth: tuple[str, ...]
    sets: tuple[Measurements, ...]
    visible: float
    noncentrality: float

    def limit(self, alarms: float, causes: int) -> float:
        """Power of a test that knows the signature up to three parameters and the noise."""
        edge = ncx2.ppf(1 - alarms / causes, 3, 0)
        return float(ncx2.sf(edge, 3, self.noncentrality))


@dataclass(frozen=True, eq=False)
class Machine:
    """A robot as built in one of the physics, at any readings; a hidden effect acts by a factor on what it shifts."""

    physics: str
    plant: Plant
    seed: int
    hidden: Any = None
    factor: float = 0.0

    def table(self, q: Array | None, n: int, hidden: Any, point: Array, repeatability: float) -> pd.DataFrame:
        make: Any = mujoco_physics.campaign if self.physics == "mujoco" else numpy_physics.campaign
        acting = () if hidden is None else (hidden,)
        given = {"disturbances": acting} if self.physics == "numpy" else {"hidden": acting}
        readings = None if q is None else np.rad2deg(q)
        plant = replace(self.plant, reflector=self.plant.reflector + point)
        return make(
            plant, n=n, seed=self.seed, noise_mm=0.0, repeatability_urad=repeatability, q_deg=readings, **given
        )  # fmt: skip

    def positions(self, q: Array, point: Array = POINTS[0], repeatability: float = 0.0) -> tuple[Array, Array]:
        """Where a point of the flange is [m], and by how much a hidden effect alone shifts it, shapes (n, 3)."""
        still = self.table(q, len(q), None, point, repeatability)[MEASURED].to_numpy(float) * 1e-3
        if self.hidden is None:
            return still, np.zeros_like(still)
        moved = self.table(q, len(q), self.hidden, point, repeatability)[MEASURED].to_numpy(float) * 1e-3
        return still, moved - still

    def at(self, q: Array) -> Array:
        """Where the first point is with the hidden effect, shape (n, 3) [m]."""
        still, shift = self.positions(q)
        return still + self.factor * shift


@dataclass(frozen=True, eq=False)
class Model:
    """The nominal robot at poses: position, its derivatives by parameters and joints."""

    p: Array
    J: Array
    Jq: Array

    @staticmethod
    def of(robot: Robot, m: Measurements) -> Model:
        _, J, Jq = signatures(robot, (), m, robot.parameters.values)
        return Model(predicted(robot, m)[0], J, Jq)


def blank(robot: Robot, table: pd.DataFrame) -> Measurements:
    return from_table(table, [j.kind for j in robot.joints], "position")


def visible(rows: Array, base: Array, joints: Array, sigma: Array, repeatability: float) -> float:
    """Noncentrality of a signature; rows : shape (n, k), base : (n, k, P), joints : (n, k, joints), sigma : (k,)."""
    C = np.eye(rows.shape[1]) * sigma**2 + repeatability**2 * joints @ joints.transpose(0, 2, 1)
    W = np.linalg.inv(np.linalg.cholesky(C))
    white, A = (W @ rows[:, :, None]).ravel(), (W @ base).reshape(rows.size, -1)
    Q = column_space(A[:, np.linalg.norm(A, axis=0) > 0])
    return float(np.sum((white - Q @ (Q.T @ white)) ** 2))


def drawn(physics: str, plant: Plant, poses: int, hidden: str, rng: np.random.Generator) -> tuple[tuple[str, ...], Any]:
    """Labels of what is hidden, and the effect."""
    if hidden == "none":
        return (), None
    of_physics = [word for where, word in UNLISTED if where == physics]
    word = str(rng.choice(WORDS if hidden == "one" else of_physics))
    label, effect = Session(physics, plant, poses, 0).drawn(word, rng)
    return (label,) if hidden == "one" else (), effect


def campaign(number: int, seed: int) -> Campaign:
    """A campaign by its number; drawn again where the robot as built finds no equilibrium there."""
    for again in range(5):
        try:
            return _campaign(number, np.random.default_rng([seed, number, again]))
        except (ConvergenceError, InputError):
            continue
    raise ConvergenceError(f"campaign {number} was drawn five times in vain")


def _campaign(number: int, rng: np.random.Generator) -> Campaign:
    kind, physics = KINDS[number % len(KINDS)], ("numpy", "mujoco")[number // len(KINDS) % 2]
    given, nominal = machine(NAMES[int(rng.integers(len(NAMES)))])
    hidden = str(rng.choice([*SHARES], p=[*SHARES.values()]))
    poses, sigma = int(rng.choice([60, 100])), 1e-3 * float(rng.choice(NOISES))
    repeatability = float(rng.choice(REPEATABILITIES))
    plant = perturb(nominal, int(rng.integers(1 << 30)))
    truth, effect = drawn(physics, plant, poses, hidden, rng)
    own = Machine(physics, plant, int(rng.integers(1 << 30)), effect)
    signal = float(np.exp(rng.uniform(*np.log(SIGNAL)))) if effect is not None else 0.0
    # Where the robot and its tool are: as a tracker would have it, for what is touched and what could be seen.
    robot = place_frames(given, blank(given, own.table(None, 40, None, POINTS[0], 0.0)))
    if kind in TOUCHED:
        sets, found = touched(own, robot, kind, poses, sigma, repeatability, signal, rng)
    else:
        sets, found = seen(own, robot, kind, poses, sigma, repeatability, signal, rng)
    numbers = sum(m.residuals for m in sets)
    return Campaign(given, kind, physics, hidden, truth, sets, np.sqrt(found / numbers), found)


def scaled(noncentrality: float, numbers: int, signal: float) -> float:
    """By what a signature is multiplied for a signal; what the base model absorbs altogether stays small."""
    return float(min(signal / max(np.sqrt(noncentrality / numbers), 1e-12), 8.0))


def places(robot: Robot, rng: np.random.Generator) -> Array:
    """Three places about the robot, shape (3, 3) [m]."""
    turn = rng.uniform(0, 2 * np.pi) + np.array([0, 2, 4]) * np.pi / 3
    out, height = 1.6 * robot.reach, robot.reach * rng.permutation([0.0, 0.4, 0.9])
    return robot.base.T[:3, 3] + np.column_stack([out * np.cos(turn), out * np.sin(turn), height])


def turned(points: Array) -> Array:
    """Orientations of the flange, shape (n, 3, 3), from where its three points are, shape (3, n, 3)."""
    x, y = points[1] - points[0], points[2] - points[0]
    x = x / np.linalg.norm(x, axis=1)[:, None]
    z = np.cross(x, y)
    z = z / np.linalg.norm(z, axis=1)[:, None]
    return np.stack([x, np.cross(z, x), z], axis=2)


def seen(
    own: Machine, robot: Robot, kind: str, poses: int, sigma: float, repeatability: float, signal: float,
    rng: np.random.Generator,
) -> tuple[tuple[Measurements, ...], float]:  # fmt: skip
    """Distances, full poses or both positions and distances, and the noncentrality of what is hidden."""
    table = own.table(None, poses, None, POINTS[0], repeatability)
    m = blank(robot, table)
    still, shift = own.positions(m.q, POINTS[0], repeatability)
    model, factor = Model.of(robot, m), 0.0
    to = places(robot, rng)
    beam = np.stack([(still - place) / np.linalg.norm(still - place, axis=1)[:, None] for place in to], axis=1)
    if kind == "poses":
        return full_poses(own, robot, m, sigma, repeatability, signal, rng)
    known = bool(rng.random() < 0.5)
    ends = np.zeros((poses, 3, 0 if known else 9))
    for k in () if known else range(3):
        ends[:, k, 3 * k : 3 * k + 3] = -beam[:, k]
    rows = beam if kind == "distances" else np.concatenate([beam, np.broadcast_to(np.eye(3), beam.shape)], axis=1)
    ends = np.concatenate([ends, np.zeros((poses, rows.shape[1] - 3, ends.shape[2]))], axis=1)
    scatter = np.array([sigma] * 3 + [3 * sigma] * (rows.shape[1] - 3))
    base = np.concatenate([rows @ model.J, ends], axis=2)
    signature = (rows @ shift[:, :, None])[:, :, 0]
    found = visible(signature, base, rows @ model.Jq, scatter, 1e-6 * repeatability)
    if signal:
        factor = scaled(found, signature.size, signal)
    position = still + factor * shift
    sets = []
    for k, place in enumerate(to, 1):
        d = np.linalg.norm(position - place, axis=1) + rng.normal(0, sigma, poses)
        target = np.tile(place, (poses, 1)) if known else None
        sets.append(
            Measurements(m.q, "distance", distance=d, target=target, conditions=m.conditions, source=f"wire {k}")
        )
    if kind == "mixed":
        read = position + rng.normal(0, 3 * sigma, position.shape)
        tracker = Measurements(m.q, "position", position=read, conditions=m.conditions, source="tracker")
        sets.append(tracker[np.flatnonzero(rng.random(poses) < 0.5)])
    return tuple(sets), factor**2 * found


def full_poses(
    own: Machine, robot: Robot, m: Measurements, sigma: float, repeatability: float, signal: float,
    rng: np.random.Generator,
) -> tuple[tuple[Measurements, ...], float]:  # fmt: skip
    each = [own.positions(m.q, point, repeatability) for point in POINTS]
    still, shift = (np.stack(part) for part in zip(*each, strict=True))
    tool = robot.tool.T.copy()
    models = []
    for point in POINTS:
        T = tool.copy()
        T[:3, 3] += T[:3, :3] @ point
        models.append(Model.of(replace(robot, tool=replace(robot.tool, T=T)), m))
    R = turned(still)

    def angles(moved: Array) -> Array:
        """The small rotation by which three points moved, shape (n, 3, ...), moved : shape (3, n, 3, ...)."""
        x, y = (moved[k] - moved[0] for k in (1, 2))
        ex, ey, ez = (R[:, :, k] for k in range(3))
        long = np.linalg.norm(POINTS[1])
        about = [np.einsum("ni,ni...->n...", ez, y) / long, -np.einsum("ni,ni...->n...", ez, x) / long]
        about.append(np.einsum("ni,ni...->n...", ey, x) / long)
        return sum(np.einsum("ni,n...->ni...", e, a) for e, a in zip((ex, ey, ez), about, strict=True))

    angle = ANGLE * sigma
    J, Jq = (np.stack([getattr(model, name) for model in models]) for name in ("J", "Jq"))
    rows = np.concatenate([shift[0], angles(shift)], axis=1)
    base, joints = np.concatenate([J[0], angles(J)], axis=1), np.concatenate([Jq[0], angles(Jq)], axis=1)
    found = visible(rows, base, joints, np.array([sigma] * 3 + [angle] * 3), 1e-6 * repeatability)
    factor = scaled(found, rows.size, signal) if signal else 0.0
    points = still + factor * shift
    a = rng.normal(0, angle, (len(m), 3))
    noisy = np.stack([_turn(v) for v in a]) @ turned(points)
    read = points[0] + rng.normal(0, sigma, points[0].shape)
    whole = Measurements(m.q, "pose", position=read, orientation=noisy, conditions=m.conditions, source="camera")
    return (whole,), factor**2 * found


def _turn(v: Array) -> Array:
    K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    U, _, V = np.linalg.svd(np.eye(3) + K)
    return np.asarray(U @ V)


@dataclass(frozen=True, eq=False)
class Things:
    """What is touched: which thing each pose touches, and how far a point is off, along which directions.

    columns : labels, points and directions -> what unknown places of the things do to the readings
    """

    label: Array
    off: Callable[[Array], Array]
    along: Callable[[Array], Array]
    columns: Callable[[Array, Array, Array], Array]
    measured: Callable[[Array, Measurements], Measurements]


def _sockets(p: Array, rng: np.random.Generator) -> Things:
    centre = p[rng.choice(len(p), SOCKETS, replace=False)]
    label = np.argmin(np.linalg.norm(p[:, None] - centre, axis=2), axis=1)

    def measured(label: Array, m: Measurements) -> Measurements:
        names = np.array([f"S{k}" for k in label], dtype=object)
        touched = Measurements(m.q, "contact", label=names, conditions=m.conditions, source="sockets")
        a, b = (int(k) for k in np.unique(label)[:2])
        return touched.with_separations([(f"S{a}", f"S{b}", float(np.linalg.norm(centre[a] - centre[b])))])

    def columns(label: Array, p: Array, _toward: Array) -> Array:
        out = _each(label, np.broadcast_to(-np.eye(3), (len(p), 3, 3)), SOCKETS)
        # One distance between two sockets is known.
        a, b = (int(k) for k in np.unique(label)[:2])
        line = np.zeros(3 * SOCKETS)
        toward = (centre[a] - centre[b]) / np.linalg.norm(centre[a] - centre[b])
        line[3 * a : 3 * a + 3], line[3 * b : 3 * b + 3] = toward, -toward
        free = np.linalg.svd(line[None])[2][1:]
        return out @ free.T

    return Things(
        label, lambda x: x - centre[label], lambda x: np.broadcast_to(np.eye(3), (len(x), 3, 3)), columns, measured
    )


def _planes(p: Array, rng: np.random.Generator) -> Things:
    middle = np.quantile(p, rng.uniform(0.35, 0.65, 3), axis=0).diagonal()
    normal = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    d = normal @ middle + rng.uniform(-0.1, 0.1, PLANES)
    label = np.argmin(np.abs(p @ normal.T - d), axis=1)

    def measured(label: Array, m: Measurements) -> Measurements:
        names = np.array([f"P{k}" for k in label], dtype=object)
        return Measurements(m.q, "plane", label=names, conditions=m.conditions, source="planes")

    def columns(label: Array, p: Array, _toward: Array) -> Array:
        return _each(label, np.concatenate([p, np.ones((len(p), 1))], axis=1)[:, None], PLANES)

    return Things(
        label,
        lambda x: ((x * normal[label]).sum(axis=1) - d[label])[:, None],
        lambda _x: normal[label][:, None],
        columns,
        measured,
    )


def _balls(p: Array, rng: np.random.Generator) -> Things:
    centre = p[rng.choice(len(p), BALLS, replace=False)] + rng.uniform(-RADIUS, RADIUS, 3)
    label = np.argmin(np.linalg.norm(p[:, None] - centre, axis=2), axis=1)

    def measured(label: Array, m: Measurements) -> Measurements:
        names = np.array([f"B{k}" for k in label], dtype=object)
        radius = np.full(len(label), RADIUS)
        return Measurements(m.q, "sphere", label=names, distance=radius, conditions=m.conditions, source="balls")

    def columns(label: Array, _p: Array, toward: Array) -> Array:
        return _each(label, -toward, BALLS)

    def off(x: Array) -> Array:
        return np.asarray(np.linalg.norm(x - centre[label], axis=1) - RADIUS)[:, None]

    def along(x: Array) -> Array:
        line = x - centre[label]
        return (line / np.linalg.norm(line, axis=1)[:, None])[:, None]

    return Things(label, off, along, columns, measured)


TOUCHED = {"sockets": _sockets, "planes": _planes, "balls": _balls}


def _each(label: Array, rows: Array, count: int) -> Array:
    """Rows, shape (n, k, w), in the columns of each pose's own thing, shape (n, k, w count)."""
    n, k, w = rows.shape
    out = np.zeros((n, k, count, w))
    out[np.arange(n), :, label] = rows
    return out.reshape(n, k, -1)


def touched(
    own: Machine, robot: Robot, kind: str, poses: int, sigma: float, repeatability: float, signal: float,
    rng: np.random.Generator,
) -> tuple[tuple[Measurements, ...], float]:  # fmt: skip
    """Touches of sockets, planes or balls, and the noncentrality of what is hidden."""
    start = blank(robot, own.table(None, 3 * poses, None, POINTS[0], 0.0))
    things = TOUCHED[kind](predicted(robot, start)[0], rng)
    q = start.q.copy()
    for _ in range(NOMINAL):
        q = q - _steps(robot, replace(start, q=q), things)
    model = Model.of(robot, replace(start, q=q))
    off = np.linalg.norm(things.off(model.p), axis=1)
    arm = np.linalg.svd(things.along(model.p) @ model.Jq, compute_uv=False)[:, -1]
    good = np.flatnonzero((off < 1e-6) & (arm > LEAST_ARM) & _possible(own.plant, q))[:poses]
    if len(good) < 0.8 * poses:
        raise InputError("too few poses reach")
    label = things.label[good]
    fewest = {"sockets": 2, "planes": 4, "balls": 5}[kind]
    counted = np.bincount(label, minlength=SOCKETS)
    good = good[counted[label] >= fewest]
    label, n = things.label[good], len(good)
    some = _only(things, good)
    table = own.table(q[good], n, None, POINTS[0], 0.0)
    m = blank(robot, table)
    still, shift = own.positions(m.q)
    model = Model.of(robot, m)
    toward = some.along(still)
    signature = (toward @ shift[:, :, None])[:, :, 0]
    base = np.concatenate([toward @ model.J, some.columns(label, still, toward)], axis=2)
    scatter = np.full(signature.shape[1], sigma)
    found = visible(signature, base, toward @ model.Jq, scatter, 1e-6 * repeatability)
    factor = scaled(found, signature.size, signal) if signal else 0.0
    built = replace(own, factor=factor)
    # A seat is off by its noise, and the joints stand beside their readings: the readings are what is wrong.
    wrong = rng.normal(0, sigma, signature.shape)
    wrong = wrong - np.einsum("nki,nij,nj->nk", toward, model.Jq, rng.normal(0, 1e-6 * repeatability, m.q.shape))
    for _ in range(BUILT):
        p = built.at(m.q)
        rows = some.along(p) @ model.Jq
        change = np.linalg.pinv(rows) @ (some.off(p) - wrong)[:, :, None]
        m = blank(robot, own.table(m.q - change[:, :, 0], n, None, POINTS[0], 0.0))
    rest = np.abs(some.off(built.at(m.q)) - wrong).max()
    if rest > 0.2 * sigma:
        raise InputError(f"the robot as built does not touch: {rest:.1e} m are left")
    return (some.measured(label, m),), factor**2 * found


def _only(things: Things, poses: Array) -> Things:
    """The same for some of the poses."""

    def of(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
        def some(x: Array) -> Array:
            whole = np.zeros((len(things.label), 3))
            whole[poses] = x
            return function(whole)[poses]

        return some

    return replace(things, label=things.label[poses], off=of(things.off), along=of(things.along))


def _steps(robot: Robot, m: Measurements, things: Things) -> Array:
    """Changes of the readings that bring the nominal robot to what it is to touch, shape (n, joints)."""
    model = Model.of(robot, m)
    rows = things.along(model.p) @ model.Jq
    change = (np.linalg.pinv(rows) @ things.off(model.p)[:, :, None])[:, :, 0]
    size = np.abs(change).max(axis=1, keepdims=True)
    return np.asarray(change * np.minimum(1.0, STEP / np.maximum(size, 1e-12)))


def _possible(plant: Plant, q: Array) -> Array:
    """Whether readings are within the joints' limits and the loop is far from folding, shape (n,)."""
    lower, upper = plant.ranges.T
    inside = ((q >= lower) & (q <= upper)).all(axis=1)
    limits = unfolded(plant)
    if limits is None:
        return inside
    apart = crank_distance(plant, q)
    return np.asarray(inside & (apart > limits[0]) & (apart < limits[1]))


def sources(sets: Sequence[Measurements]) -> str:
    return ", ".join(f"{m.source} {len(m)}" for m in sets)
