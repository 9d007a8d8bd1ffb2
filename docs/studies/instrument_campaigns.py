"""Synthetic campaigns of the engine as instruments other than a tracker measure them, with what they hide known.

The physics says where points of the flange are at given readings. From that are made distances to three places,
full poses (three points of the flange, seen with noise of positions and of angles), mixed sets, and touches: of
sockets, of planes and of balls, whose readings are corrected until the robot as built, with what is hidden in it,
touches them. Every instrument has noise of its own, and the joints do not repeat exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from campaign_robots import machine
from instrument_machines import POINTS, Machine, Model, blank, scaled, visible
from instrument_touches import TOUCHED, touched
from scipy.stats import ncx2
from sessions import UNLISTED, Session

from casadical.blind_check.mujoco_physics import LISTED, Plant, perturb
from casadical.core.basics import Array, ConvergenceError, InputError
from casadical.identification.placement import place_frames
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

NAMES = ("hh800", "kr210", "ur10e")
KINDS = ("distances", "sockets", "poses", "mixed", "distances", "planes", "poses", "mixed", "distances", "balls")
SHARES = {"none": 0.3, "one": 0.55, "unlisted": 0.15}
# What an instrument alone does is not in the robot.
WORDS = [w for w in LISTED if w != "outliers"]
# One sigma of a length [mm] that is drawn, and of an angle [rad] per metre of it.
NOISES, ANGLE = (0.02, 0.05, 0.1), 3.0
REPEATABILITIES = (4.0, 8.0)
SIGNAL = (0.35, 2.5)


@dataclass(frozen=True, eq=False)
class Campaign:
    """Sets as measured, what is hidden, and what a judge with all knowledge but the size could see.

    visible : root of the noncentrality over the numbers that were measured; noncentrality : of the hidden signature
    """

    robot: Robot
    kind: str
    hidden: str
    truth: tuple[str, ...]
    sets: tuple[Measurements, ...]
    visible: float
    noncentrality: float

    def limit(self, alarms: float, causes: int) -> float:
        """Power of a test that knows the signature up to three parameters and the noise."""
        edge = ncx2.ppf(1 - alarms / causes, 3, 0)
        return float(ncx2.sf(edge, 3, self.noncentrality))


def drawn(plant: Plant, poses: int, hidden: str, rng: np.random.Generator) -> tuple[tuple[str, ...], Any]:
    """Labels of what is hidden, and the effect."""
    if hidden == "none":
        return (), None
    word = str(rng.choice(WORDS if hidden == "one" else UNLISTED))
    label, effect = Session(plant, poses, 0).drawn(word, rng)
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
    kind = KINDS[number % len(KINDS)]
    given, nominal = machine(NAMES[int(rng.integers(len(NAMES)))])
    hidden = str(rng.choice([*SHARES], p=[*SHARES.values()]))
    poses, sigma = int(rng.choice([60, 100])), 1e-3 * float(rng.choice(NOISES))
    repeatability = float(rng.choice(REPEATABILITIES))
    plant = perturb(nominal, int(rng.integers(1 << 30)))
    truth, effect = drawn(plant, poses, hidden, rng)
    own = Machine(plant, int(rng.integers(1 << 30)), effect)
    signal = float(np.exp(rng.uniform(*np.log(SIGNAL)))) if effect is not None else 0.0
    # Where the robot and its tool are: as a tracker would have it, for what is touched and what could be seen.
    robot = place_frames(given, blank(given, own.table(None, 40, None, POINTS[0], 0.0)))
    if kind in TOUCHED:
        sets, found = touched(own, robot, kind, poses, sigma, repeatability, signal, rng)
    else:
        sets, found = seen(own, robot, kind, poses, sigma, repeatability, signal, rng)
    numbers = sum(m.residuals for m in sets)
    return Campaign(given, kind, hidden, truth, sets, np.sqrt(found / numbers), found)


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
