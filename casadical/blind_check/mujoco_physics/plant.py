"""A robot as built: axes, masses and reflector at zero readings, and its random building errors.

The nominal robot comes from plain numbers (modified DH rows, masses, stiffness, an optional
four-bar); after that there are no DH parameters, only frames at zero readings and the axes about
which the bodies turn or along which they slide.

Motions are homogeneous matrices, for one pose or for n at once: they move points from where they
were to where they are, both in one frame, ``move(G, x)``. A four-bar loop is closed by intersecting
two circles; the lever arms follow by the coupler's force.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from casadical.core.basics import InputError
from casadical.core.reporting.result import Shown

# An array of doubles.
Array: TypeAlias = NDArray[np.float64]


def rotation(rotvec: Array) -> Array:
    """Return the matrices, shape (..., 3, 3), of rotation vectors, shape (..., 3) [rad]."""
    shape = np.shape(rotvec)
    R = Rotation.from_rotvec(np.reshape(rotvec, (-1, 3))).as_matrix()
    return np.asarray(R.reshape(*shape[:-1], 3, 3))


def motion(rotvec: Array, shift: Array, about: Array) -> Array:
    """Return transforms, shape (..., 4, 4) [m]: a rotation about a point, then a displacement.

    rotvec : rotation vectors, shape (..., 3) [rad]
    shift : displacements, shape (..., 3) [m]; about : the points, shape (..., 3) [m]
    """
    R = rotation(rotvec)
    G = np.zeros((*R.shape[:-2], 4, 4))
    G[..., :3, :3] = R
    G[..., :3, 3] = about - np.einsum("...ij,...j->...i", R, np.broadcast_to(about, rotvec.shape)) + shift
    G[..., 3, 3] = 1.0
    return G


def turn(axis: Array, point: Array, angle: Array) -> Array:
    """Return the transforms of rotations about a line, shape (n, 4, 4) [m].

    axis : unit vector of the line, shape (3,); point : a point on it, shape (3,) [m]
    angle : angles of rotation, shape (n,) [rad]
    """
    rotvec = np.asarray(angle, float)[..., None] * axis
    return motion(rotvec, np.zeros(3), point)


def slide(shift: Array) -> Array:
    """Return the transforms of displacements, shape (..., 4, 4); shift : shape (..., 3) [m]."""
    return motion(np.zeros_like(np.asarray(shift, float)), shift, np.zeros(3))


def move(G: Array, x: Array) -> Array:
    """Return points x, shape (..., 3) [m], moved by transforms G, shape (..., 4, 4)."""
    return np.asarray(np.einsum("...ij,...j->...i", G[..., :3, :3], x) + G[..., :3, 3])


def rotated(G: Array, v: Array) -> Array:
    """Return directions v, shape (..., 3), rotated by transforms G, shape (..., 4, 4)."""
    return np.asarray(np.einsum("...ij,...j->...i", G[..., :3, :3], v))


def back(G: Array, v: Array) -> Array:
    """Return directions v, shape (..., 3), rotated by the inverse of transforms G, (..., 4, 4)."""
    return np.asarray(np.einsum("...ji,...j->...i", G[..., :3, :3], v))


def random_vector(rng: np.random.Generator, length: float) -> tuple[float, float, float]:
    """Return a vector of this length in a random direction, uniformly distributed."""
    direction = rng.standard_normal(3)
    x, y, z = (float(c) for c in length * direction / np.linalg.norm(direction))
    return x, y, z


@dataclass(frozen=True)
class FourBar:
    """A planar loop that drives a joint: ground bar (the link before it), crank, coupler, rocker.

    crank_m, coupler_m, rocker_m : lengths of the bars [m]
    crank_zero_rad : angle that is added to the crank's coordinate to give its direction [rad]
    passive_offset_rad : angle that is added to the rocker's direction in the link before to give
        the angle of the driven link [rad]
    driven : number of the driven joint, from 1; its crank turns about the axis of the joint before
    """

    crank_m: float
    coupler_m: float
    rocker_m: float
    crank_zero_rad: float = 0.0
    passive_offset_rad: float = -np.pi / 2
    driven: int = 3


@dataclass(frozen=True)
class Plant(Shown):
    """A robot of n axes, described at zero readings, in SI units.

    name : name of the robot
    home : pose of every link in the base frame at zero readings, shape (n, 4, 4) [m]; joint i turns
        about the z axis of link i, or slides along it
    reflector : reflector in the last link's frame, shape (3,) [m]
    mass : masses of the links, shape (n,) [kg]
    com : mass centres in the links' frames, shape (n, 3) [m]
    payload_kg : declared mass of the payload [kg]
    payload_com : mass centre of the payload in the last link's frame, shape (3,) [m]
    stiffness : stiffness of the actuated joints, shape (n,) [N m/rad or N/m]; that of the crank for
        a joint that a four-bar drives
    ranges : lower and upper reading of each joint, shape (n, 2) [rad or m]
    base : pose of the base in the measuring frame, shape (4, 4) [m]
    four_bar : loop that drives a joint; None: there is none
    payload_factor : true mass of the payload divided by the declared one
    slides : numbers of the prismatic joints, from 1
    gravity : acceleration of gravity in the measuring frame, shape (3,) [m/s^2]
    """

    line: ClassVar[str] = " {{ it.name | repr }} of {{ it.home | length }} joints"

    name: str
    home: Array
    reflector: Array
    mass: Array
    com: Array
    payload_kg: float
    payload_com: Array
    stiffness: Array
    ranges: Array
    base: Array
    four_bar: FourBar | None = None
    payload_factor: float = 1.0
    slides: frozenset[int] = frozenset()
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))

    @classmethod
    def from_dict(cls, robot: Mapping[str, Any]) -> Self:
        """Return the nominal robot of a mapping as in data/campaigns/robots, its base at identity.

        Raises InputError: a key or a shape is wrong.
        """
        keys = [
            *("name", "modified_dh", "tool_m", "mass_kg", "com_m", "payload"),
            *("stiffness_Nm_per_rad", "joint_range_deg"),
        ]
        for key in keys:
            if key not in robot:
                raise InputError(f"robot: key {key!r} is missing; needed are {', '.join(keys)}")
        bar, n = robot.get("four_bar"), len(robot["modified_dh"])
        rows = [
            (_radians(r["alpha_deg"]), r["a_m"], 0.0, 0.0, _radians(r.get("theta0_deg", 0.0)), r["d_m"])
            for r in robot["modified_dh"]
        ]
        return cls(
            name=str(robot["name"]),
            home=home_frames(rows),
            reflector=_table(robot, "tool_m", (3,)),
            mass=_table(robot, "mass_kg", (n,)),
            com=_table(robot, "com_m", (n, 3)),
            payload_kg=float(robot["payload"]["mass_kg"]),
            payload_com=np.array(robot["payload"]["com_m"], float),
            stiffness=_table(robot, "stiffness_Nm_per_rad", (n,)),
            ranges=np.deg2rad(_table(robot, "joint_range_deg", (n, 2))),
            base=np.eye(4),
            four_bar=None
            if bar is None
            else FourBar(
                crank_m=float(bar["crank_L5_m"]),
                coupler_m=float(bar["coupler_L4_m"]),
                rocker_m=float(bar["rocker_L3_m"]),
                passive_offset_rad=_radians(bar.get("passive_offset_deg", -90.0)),
            ),
        )

    @property
    def n(self) -> int:
        """Return the number of joints."""
        return len(self.home)

    @property
    def turning(self) -> list[int]:
        """Return the numbers of the revolute joints, from 1."""
        return [j for j in range(1, self.n + 1) if j not in self.slides]

    @property
    def weight(self) -> float:
        """Return the magnitude of the acceleration of gravity [m/s^2]."""
        return float(np.hypot(np.hypot(self.gravity[0], self.gravity[1]), self.gravity[2]))

    @property
    def axes(self) -> Array:
        """Return the unit vectors of the joint axes at zero readings in the robot's base, shape (n, 3)."""
        return self.home[:, :3, 2]

    @property
    def centres(self) -> Array:
        """Return a point on every joint axis at zero readings in the robot's base, shape (n, 3) [m]."""
        return self.home[:, :3, 3]

    def at_home(self, link: int, x: Array) -> Array:
        """Return points of a link in the base frame at zero readings, shape (..., 3) [m].

        link : number of the link, from 1; x : the points in its frame, shape (..., 3) [m]
        """
        return np.asarray(x @ self.home[link - 1, :3, :3].T + self.home[link - 1, :3, 3])

    @property
    def stations(self) -> Array:
        """Return the ends of the links in the base frame at zero readings, shape (n + 2, 3) [m].

        They are the base's origin, the origins of the links' frames and the reflector.
        """
        return np.vstack([np.zeros(3), self.centres, self.at_home(self.n, self.reflector)])

    @property
    def reach(self) -> float:
        """Return the length of all links together [m]."""
        return float(np.linalg.norm(np.diff(self.stations, axis=0), axis=-1).sum())


def home_frames(rows: Sequence[tuple[float, float, float, float, float, float]]) -> Array:
    """Return the pose of each link in the base frame at zero readings, shape (n, 4, 4) [m].

    rows : modified DH rows alpha, a, beta, b, theta, d [rad, m], one per joint, each of which is
        Rot_x(alpha) Trans_x(a) Rot_y(beta) Trans_y(b) Rot_z(theta) Trans_z(d)
    """
    T, frames, (x, y, z), nowhere = np.eye(4), [], np.eye(3), np.zeros(3)
    for alpha, a, beta, b, theta, d in rows:
        if beta or b:
            T = T @ motion(alpha * x, nowhere, nowhere) @ motion(beta * y, np.array([a, 0.0, 0.0]), nowhere)
            T = T @ motion(theta * z, np.array([0.0, b, d]), nowhere)
        else:
            T = T @ motion(alpha * x, nowhere, nowhere)
            T = T @ motion(theta * z, np.array([a, 0.0, d], float), nowhere)
        frames.append(T)
    return np.array(frames)


def _radians(degrees: Any) -> float:
    """Return an angle [rad] that a file has in degrees."""
    return float(np.deg2rad(float(degrees)))


def _table(robot: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> Array:
    """Return the numbers at a key of a robot's data as an array of a required shape."""
    table = np.array(robot[key], float)
    if table.shape != shape or not np.isfinite(table).all():
        raise InputError(f"robot: {key} has shape {table.shape}; it must be finite numbers of shape {shape}")
    return table


def perturb(
    plant: Plant,
    seed: int,
    *,
    length_mm: float = 0.3,
    angle_mrad: float = 0.3,
    base: tuple[float, float] = (0.03, 2.0),
    tool_mm: float = 1.0,
    stiffness_spread: float = 0.4,
    base_shift: bool = True,
    base_turn: bool = True,
    mass_spread: float = 0.0,
) -> Plant:
    """Return the robot with random building errors: six of every link, and those of the arguments.

    plant : nominal robot; seed : seed of all errors
    length_mm, angle_mrad : standard deviation of each coordinate [mm] and angle [mrad] of a link's
        error; also those of the lengths of crank and coupler and of the crank's zero
    base : largest displacement [m] and rotation [deg] of the robot's base in the measuring frame
    tool_mm : standard deviation of each coordinate of the reflector's error [mm]
    stiffness_spread : standard deviation of the logarithm of the joint stiffnesses
    base_shift, base_turn : whether the base is shifted and turned in the measuring frame, with the
        first link
    mass_spread : standard deviation of the logarithm of the links' masses
    """
    links, bars, place, tool, spring = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5))
    turns, shifts = links.normal(0, angle_mrad * 1e-3, (plant.n, 3)), links.normal(0, length_mm * 1e-3, (plant.n, 3))
    turns[0] *= base_turn
    shifts[0] *= base_shift
    bar = plant.four_bar
    if bar is not None:
        crank, coupler, zero = bars.normal(0, [length_mm, length_mm, angle_mrad]) * 1e-3
        lengths = {"crank_m": bar.crank_m + crank, "coupler_m": bar.coupler_m + coupler}
        bar = replace(bar, **lengths, crank_zero_rad=bar.crank_zero_rad + zero)
    turned = base_turn * np.deg2rad(base[1]) * _in_ball(place)
    shifted = base_shift * base[0] * _in_ball(place)
    before, frame, home = np.eye(4), np.eye(4), []
    for nominal, error in zip(plant.home, motion(turns, shifts, np.zeros(3)), strict=True):
        frame = frame @ np.linalg.solve(before, nominal) @ error  # by its error, in the link's own axes
        before = nominal
        home.append(frame)
    return replace(
        plant,
        home=np.array(home),
        base=plant.base @ motion(turned, shifted, np.zeros(3)),
        reflector=plant.reflector + tool.normal(0, tool_mm * 1e-3, 3),
        stiffness=plant.stiffness * np.exp(spring.normal(0, stiffness_spread, plant.n)),
        mass=plant.mass * np.exp(mass_spread * spring.normal(0, 1.0, plant.n)),
        four_bar=bar,
    )


def _in_ball(rng: np.random.Generator) -> Array:
    """Return a random point, uniformly distributed in the unit ball, shape (3,)."""
    direction = rng.standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction) * rng.random() ** (1 / 3))


@dataclass(frozen=True)
class ClosedLoop:
    """A closed four-bar loop at n poses, in the plane of the link before the driven joint.

    The origin is on the axis of the joint before the driven one, the first axis along its link's x.

    crank_end : joint between crank and coupler, shape (n, 2) [m]
    coupler_end : joint between coupler and rocker, shape (n, 2) [m]
    pivot : the driven joint's axis, shape (2,) [m]
    passive : angle of the driven link, shape (n,) [rad]
    """

    crank_end: Array
    coupler_end: Array
    pivot: Array
    passive: Array

    @property
    def lever(self) -> Array:
        """Return the ratio of the crank's torque to that on the driven link in equilibrium, shape (n,).

        It follows from the coupler's force, which is along the coupler.
        """
        along = self.crank_end - self.coupler_end
        return _cross(self.crank_end, along) / _cross(self.coupler_end - self.pivot, along)


def pivot(plant: Plant) -> Array:
    """Return the driven joint's axis in the plane of the link before it, shape (2,) [m].

    The origin is on the axis of that link's joint, the first coordinate along its x axis.
    """
    k = _bar(plant).driven - 1
    R, p = plant.home[k - 1, :3, :3], plant.home[k, :3, 3] - plant.home[k - 1, :3, 3]
    return np.asarray((R.T @ p)[:2])


def crank_end(bar: FourBar, crank: Array) -> Array:
    """Return the end of the crank in the plane of the link before, shape (n, 2) [m].

    crank : angle of the crank as of `crank_angle`, shape (n,) [rad]
    """
    angle = crank + bar.crank_zero_rad
    return bar.crank_m * np.stack([np.cos(angle), np.sin(angle)], -1)


def crank_angle(plant: Plant, angles: Array) -> Array:
    """Return the angle of the crank relative to the link before the driven joint, shape (n,) [rad].

    angles : coordinates of the motors, shape (n, joints) [rad or m]
    """
    k = _bar(plant).driven - 1
    return np.asarray(angles[:, k] - angles[:, k - 1])


def crank_distance(plant: Plant, q: Array) -> Array:
    """Return the distance of the crank's end from the driven joint's axis, shape (n,) [m].

    q : readings, shape (n, joints) [rad or m]
    """
    bar = _bar(plant)
    return np.asarray(np.linalg.norm(crank_end(bar, crank_angle(plant, q)) - pivot(plant), axis=-1))


def unfolded(plant: Plant) -> tuple[float, float] | None:
    """Return lower and upper limit of `crank_distance` [m] that avoid singular poses of the loop.

    They are a quarter of the rocker's length away from the folded and the stretched loop. None is
    returned for a robot without a loop.
    """
    bar = plant.four_bar
    if bar is None:
        return None
    short, long = sorted((bar.coupler_m, bar.rocker_m))
    return long - short + bar.rocker_m / 4, long + short - bar.rocker_m / 4


def close_loop(plant: Plant, crank: Array) -> ClosedLoop:
    """Return the four-bar loop, closed without crossing, at n crank angles.

    crank : angle of the crank as of `crank_angle`, shape (n,) [rad]
    Raises InputError at the first pose where it cannot be closed.
    """
    bar, P, C = _bar(plant), pivot(plant), crank_end(_bar(plant), crank)
    reach = C - P
    d = np.linalg.norm(reach, axis=-1)
    along = (bar.rocker_m**2 - bar.coupler_m**2 + d**2) / (2 * d)
    aside_2 = bar.rocker_m**2 - along**2
    if (aside_2 < 0).any():
        row = int(np.argmax(aside_2 < 0))
        raise InputError(
            f"pose {row + 1}: the four-bar is open, crank end and joint {bar.driven} are "
            f"{d[row]:.4f} m apart; coupler and rocker reach "
            f"{abs(bar.coupler_m - bar.rocker_m):.4f} to {bar.coupler_m + bar.rocker_m:.4f} m; "
            "drop the pose"
        )
    unit = reach / d[:, None]
    normal = np.stack([-unit[:, 1], unit[:, 0]], -1)
    D = P + along[:, None] * unit - np.sqrt(aside_2)[:, None] * normal
    passive = np.arctan2(D[:, 1] - P[1], D[:, 0] - P[0]) + bar.passive_offset_rad
    return ClosedLoop(C, D, P, passive)


def _bar(plant: Plant) -> FourBar:
    """Return the robot's four-bar. Raises InputError if there is none."""
    if plant.four_bar is None:
        raise InputError(f"robot {plant.name!r} has no four-bar")
    return plant.four_bar


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of plane vectors, shape (...); a, b : shape (..., 2)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
