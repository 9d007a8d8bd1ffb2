"""Four-bar loop: closed by intersecting two circles, with lever arms by the coupler's force."""

from dataclasses import dataclass

import numpy as np

from casadical.blind_check.mujoco_physics.plant import Array, FourBar, Plant
from casadical.core.basics import InputError


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
