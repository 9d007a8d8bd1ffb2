"""Touches of sockets, planes and balls: readings are corrected until the robot as built touches them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from instrument_machines import POINTS, Machine, Model, blank, scaled, visible

from casadical.blind_check.mujoco_physics import Plant
from casadical.blind_check.mujoco_physics.fourbar import crank_distance, unfolded
from casadical.core.basics import Array, InputError
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

SOCKETS, PLANES, BALLS, RADIUS = 6, 3, 4, 0.05
# Rounds in which readings are corrected until the nominal robot touches, then until the robot as built does.
NOMINAL, BUILT, STEP = 25, 3, 0.3
# A reading must move the point so much [m/rad], or it cannot be corrected.
LEAST_ARM = 0.1


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
