"""Rigid motions as homogeneous matrices, for one pose or for n at once; the simulator's only geometry.

A motion moves points from where they were to where they are, both seen from one frame: ``move(G, x)``.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]


def rotation(rotvec: Array) -> Array:
    """Rotation matrices, shape (..., 3, 3), that turn about ``rotvec`` (..., 3) by its length [rad] (Rodrigues)."""
    rotvec = np.asarray(rotvec, float)
    angle = np.linalg.norm(rotvec, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(rotvec, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*rotvec.shape[:-1], 3, 3)
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    turned: Array = np.eye(3) + first * cross + second * (cross @ cross)
    return turned


def motion(rotvec: Array, shift: Array, about: Array) -> Array:
    """Motions (..., 4, 4): turn about the point ``about`` by ``rotvec`` [rad], then shift [m]."""
    R = rotation(rotvec)
    G = np.zeros((*R.shape[:-2], 4, 4))
    G[..., :3, :3] = R
    G[..., :3, 3] = about - np.einsum("...ij,...j->...i", R, np.broadcast_to(about, rotvec.shape)) + shift
    G[..., 3, 3] = 1.0
    return G


def turn(axis: Array, point: Array, angle: Array) -> Array:
    """Motions (n, 4, 4) about the line through ``point`` along the unit vector ``axis`` by ``angle`` (n,) [rad]."""
    rotvec = np.asarray(angle, float)[..., None] * axis
    return motion(rotvec, np.zeros(3), point)


def slide(shift: Array) -> Array:
    """Motions (..., 4, 4) that only shift by ``shift`` (..., 3) [m]."""
    return motion(np.zeros_like(np.asarray(shift, float)), shift, np.zeros(3))


def move(G: Array, x: Array) -> Array:
    """Where the points ``x`` (..., 3) are after the motions ``G`` (..., 4, 4)."""
    moved: Array = np.einsum("...ij,...j->...i", G[..., :3, :3], x) + G[..., :3, 3]
    return moved


def point(G: Array, v: Array) -> Array:
    """The directions ``v`` (..., 3) after the motions ``G``."""
    turned: Array = np.einsum("...ij,...j->...i", G[..., :3, :3], v)
    return turned


def back(G: Array, v: Array) -> Array:
    """The directions ``v`` (..., 3) brought back to before the motions ``G``."""
    turned: Array = np.einsum("...ji,...j->...i", G[..., :3, :3], v)
    return turned


def random_vector(rng: np.random.Generator, length: float) -> tuple[float, float, float]:
    """A vector of the length, in any direction with equal probability."""
    direction = rng.standard_normal(3)
    x, y, z = (float(c) for c in length * direction / np.linalg.norm(direction))
    return x, y, z
