"""Noise of poses that a camera measured, in the camera's own axes.

A fit of a target's pose to its image (PnP) errs along the line of sight (depth) and in the two tilts more than across
it (lateral) and in the roll about it, and the more, the farther the target is.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from casadical.core.basics import Array
from casadical.core.reporting.plain import WRITTEN
from casadical.core.reporting.result import Shown

if TYPE_CHECKING:
    from casadical.measurements.measurements import Measurements

# Where a camera is: on the robot ("in hand") or fixed ("to base"); empty where it is not known.
Camera = Literal["", "in hand", "to base"]
# Columns of the whitened residual of a pose with one standard deviation: two lateral, depth, two tilts, roll.
COMPONENTS = (slice(0, 2), slice(2, 3), slice(3, 5), slice(5, 6))


@dataclass(frozen=True)
class CameraNoise(Shown):
    """Ratios of the noise components of a camera's poses; those of one set with its two sigmas.

    ratios : standard deviations across the line of sight, along it (each of the length sigma), of the two tilts and of
        the roll about it (each of the angle sigma), at `distance`
    growth : exponents with which they grow with the distance
    distance : from the camera to `point` at which the ratios hold [m]
    point : of the target, in its own frame [m], whose place has errors that are independent of those of its orientation
    """

    line: ClassVar[str] = " at {{ it.distance | f('.2g') }} m"

    ratios: tuple[float, float, float, float] = field(default=(1.0, 1.0, 1.0, 1.0), metadata=WRITTEN)
    growth: tuple[float, float, float, float] = field(default=(0.0, 0.0, 0.0, 0.0), metadata=WRITTEN)
    distance: float = field(default=1.0, metadata=WRITTEN)
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def relative(self, away: Array) -> Array:
        """Return each residual's standard deviation over its sigma, shape (n, 6); away : distances, shape (n,) [m]."""
        each = np.array(self.ratios) * (away[:, None] / self.distance) ** np.array(self.growth)
        return np.repeat(each, [c.stop - c.start for c in COMPONENTS], axis=1)


def target_in_camera(m: Measurements) -> tuple[Array, Array]:
    """Return positions (n, 3) [m] and orientations (n, 3, 3) of the target in the camera's frame."""
    seen = m.inverse() if m.camera == "in hand" else m
    assert seen.position is not None
    assert seen.orientation is not None
    return seen.position, seen.orientation


def crossing(a: Array) -> Array:
    """Return the matrices, shape (n, 3, 3), with which the vectors a, shape (n, 3), are crossed with others."""
    zero = np.zeros(len(a))
    x, y, z = a.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def lines_of_sight(m: Measurements, noise: CameraNoise) -> tuple[Array, Array]:
    """Return axes of the camera's noise, shape (n, 3, 3), and distances to the target's point, shape (n,) [m].

    Rows of the axes are in the camera's frame: two across the line of sight, and the line of sight.
    """
    t, R = target_in_camera(m)
    t = t + R @ np.array(noise.point)
    away = np.linalg.norm(t, axis=1)
    line = t / away[:, None]
    first = np.cross(np.where(np.abs(line[:, 1:2]) < 0.9, [[0.0, 1, 0]], [[1.0, 0, 0]]), line)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(line, first), line], axis=1), away


def to_camera_axes(m: Measurements) -> Array:
    """Return the matrices, shape (n, 6, 6), that turn residuals of kind pose into the camera's axes.

    The residuals are of the tool's position and orientation, in the measuring frame and the axes of the measured
    orientation; those of the target's place [m] and rotation [rad] in the camera follow, to first order.
    """
    t, R = target_in_camera(m)
    W = np.zeros((len(m), 6, 6))
    if m.camera == "in hand":
        W[:, :3, :3], W[:, :3, 3:], W[:, 3:, 3:] = -R, crossing(t), -np.eye(3)
    else:
        W[:, :3, :3], W[:, 3:, 3:] = np.eye(3), R
    return W


def whitening(m: Measurements, noise: CameraNoise) -> Array:
    """Return the matrices, shape (n, 6, 6), that make the residuals of kind pose a camera's, of equal sigmas.

    Three lengths and three angles along the line of sight's axes follow, in the order of `COMPONENTS`.
    """
    W, (_, R) = to_camera_axes(m), target_in_camera(m)
    W[:, :3] -= crossing(R @ np.array(noise.point)) @ W[:, 3:]
    axes, away = lines_of_sight(m, noise)
    return np.concatenate([axes @ W[:, :3], axes @ W[:, 3:]], axis=1) / noise.relative(away)[:, :, None]


def refined(
    m: Measurements, r: Array, freedom: Array, sigmas: tuple[float, float]
) -> tuple[CameraNoise, tuple[float, float]]:
    """Return the noise that whitened residuals show, and the sigmas of lengths [m] and angles [rad].

    The components' variances are residual squares over redundancies (restricted maximum likelihood;
    Foerstner 1979); exponents of the distance are the most probable of a grid, those of a prior 1 +- 1.

    m : with the noise by which they are whitened; sigmas : of lengths [m] and angles [rad] with it
    r, freedom : residuals in units of sigma and their redundancy numbers, shape (n, 6)
    """
    noise = m.noise
    assert noise is not None
    axes, away = lines_of_sight(m, noise)
    distance = float(np.median(away))
    log_away, exponents = np.log(away / distance), np.arange(0.0, 2.51, 0.25)
    found, growth = [], []
    for c, ratio, old in zip(COMPONENTS, noise.ratios, noise.growth, strict=True):
        square, f = (r[:, c] ** 2).sum(axis=1), np.maximum(freedom[:, c].sum(axis=1), 1e-3)
        variance = np.exp(-2 * np.outer(exponents - old, log_away)) @ square / f.sum()
        gain = -0.5 * f.sum() * np.log(np.maximum(variance, 1e-30)) - (exponents - old) * (f @ log_away)
        k = int(np.argmax(gain - 0.5 * (exponents - 1.0) ** 2))
        growth.append(float(exponents[k]))
        found.append(ratio * np.sqrt(max(float(variance[k]), 1e-12)) * (distance / noise.distance) ** old)
    point = _independent_point(m, noise, axes, r * noise.relative(away) * np.repeat(sigmas, 3))
    lateral, depth, tilt, roll = found
    length, angle = (float(np.sqrt((2 * a**2 + b**2) / 3)) for a, b in ((lateral, depth), (tilt, roll)))
    ratios = (lateral / length, depth / length, tilt / angle, roll / angle)
    made = CameraNoise(ratios, (growth[0], growth[1], growth[2], growth[3]), distance, point)
    return made, (sigmas[0] * length, sigmas[1] * angle)


def _independent_point(m: Measurements, noise: CameraNoise, axes: Array, e: Array) -> tuple[float, float, float]:
    """Return the point of the target whose place errs independently of its orientation [m].

    It is the target's origin unless the residuals clearly show another one, such as the middle of a
    board whose origin is its first corner.

    axes : as of `lines_of_sight`; e : residuals along them, shape (n, 6) [m, rad]
    """
    before, R = np.array(noise.point), target_in_camera(m)[1]
    # A rotation by w moves a point that is further by b by w x b.
    unit = noise.relative(np.full(len(m), noise.distance))[:, :3].ravel()
    J = (axes @ crossing(np.einsum("nji,nj->ni", axes, e[:, 3:])) @ R).reshape(-1, 3) / unit[:, None]
    y = e[:, :3].ravel() / unit
    origin = y - J @ before
    b = -np.linalg.lstsq(J, origin, rcond=None)[0]
    # By the likelihood ratio of three more parameters, with a probability of 0.1 % by chance.
    gain = len(y) * np.log(max(float(origin @ origin), 1e-30) / max(float((origin + J @ b) @ (origin + J @ b)), 1e-30))
    return (float(b[0]), float(b[1]), float(b[2])) if gain > 16.3 else (0.0, 0.0, 0.0)
