"""Noise of poses that a camera measured, in the camera's own axes.

A fit of a target's pose to its image (PnP) errs along the line of sight (depth) and in the two tilts more than across
it (lateral) and in the roll about it, and the more, the farther the target is.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from casadical.core.basics import Array
from casadical.core.reporting.plain import WRITTEN
from casadical.core.reporting.result import Shown
from casadical.measurements.corners import CameraErrors, Images

# Where a camera is: on the robot ("in hand") or fixed ("to base"); empty where it is unknown.
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
    pixel : where corners in images were measured, standard deviations [m] and [rad] that one of a pixel makes
    """

    line: ClassVar[str] = " at {{ it.distance | f('.2g') }} m"

    ratios: tuple[float, float, float, float] = field(default=(1.0, 1.0, 1.0, 1.0), metadata=WRITTEN)
    growth: tuple[float, float, float, float] = field(default=(0.0, 0.0, 0.0, 0.0), metadata=WRITTEN)
    distance: float = field(default=1.0, metadata=WRITTEN)
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pixel: tuple[float, float] = (1.0, 1.0)

    def relative(self, away: Array) -> Array:
        """Return each residual's standard deviation over its sigma, shape (n, 6); away : distances, shape (n,) [m]."""
        each = np.array(self.ratios) * (away[:, None] / self.distance) ** np.array(self.growth)
        return np.repeat(each, [c.stop - c.start for c in COMPONENTS], axis=1)


class View(NamedTuple):
    """What a camera saw of its target at n stations.

    t : places of the target in the camera's frame, shape (n, 3) [m]; R : its orientations, shape (n, 3, 3)
    camera : where the camera is
    images : corners of the target, by which its poses were found; None where poses were given
    """

    t: Array
    R: Array
    camera: Camera
    images: Images | None = None

    @property
    def T(self) -> Array:
        """Return the poses of the target in the camera's frame, shape (n, 4, 4) [m]."""
        T = np.tile(np.eye(4), (len(self.t), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = self.R, self.t
        return T


def crossing(a: Array) -> Array:
    """Return matrices M, shape (n, 3, 3), with M b = a x b for vectors a, shape (n, 3)."""
    zero = np.zeros(len(a))
    x, y, z = a.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def lines_of_sight(view: View, noise: CameraNoise) -> tuple[Array, Array]:
    """Return axes of the camera's noise, shape (n, 3, 3), and distances to the target's point, shape (n,) [m].

    Rows of the axes are in the camera's frame: two across the line of sight, and the line of sight.
    """
    t = view.t + view.R @ np.array(noise.point)
    away = np.linalg.norm(t, axis=1)
    line = t / away[:, None]
    first = np.cross(np.where(np.abs(line[:, 1:2]) < 0.9, [[0.0, 1, 0]], [[1.0, 0, 0]]), line)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(line, first), line], axis=1), away


def to_camera_axes(view: View) -> Array:
    """Return the matrices, shape (n, 6, 6), that turn residuals of kind pose into the camera's axes.

    The residuals are of the tool's position and orientation, in the measuring frame and the axes of the measured
    orientation; those of the target's place [m] and rotation [rad] in the camera follow, to first order.
    """
    t, R, camera, _ = view
    W = np.zeros((len(t), 6, 6))
    if camera == "in hand":
        W[:, :3, :3], W[:, :3, 3:], W[:, 3:, 3:] = -R, crossing(t), -np.eye(3)
    else:
        W[:, :3, :3], W[:, 3:, 3:] = np.eye(3), R
    return W


def whitening(view: View, noise: CameraNoise) -> Array:
    """Return the matrices, (n, 6, 6), that whiten residuals of kind pose by a camera's noise.

    The result is three lengths and three angles along the axes of the line of sight (`COMPONENTS`), of one sigma each
    for lengths and angles. With corners in images, their weighted square sum is that of the reprojection errors.
    """
    W = to_camera_axes(view)
    W[:, :3] -= crossing(view.R @ np.array(noise.point)) @ W[:, 3:]
    if view.images is not None:
        unit = np.repeat(noise.pixel, 3)[:, None]
        return unit * np.linalg.solve(_spread_of_pixels(view, view.images, noise), W)
    axes, away = lines_of_sight(view, noise)
    return np.concatenate([axes @ W[:, :3], axes @ W[:, 3:]], axis=1) / noise.relative(away)[:, :, None]


def moved_by_errors(view: View, point: Array) -> Array:
    """Return derivatives of the target's poses by `CameraErrors`, shape (n, 6, 4) [m, rad].

    point : middle of the board in its own frame, shape (3,) [m]; not used with corners in images
    """
    t, R, _, images = view
    if images is not None:
        A, B, _, _ = images.reduced(view.T)
        return np.linalg.solve(A, B)
    lever = R @ point
    middle, normal = t + lever, R[:, :, 2]
    line = middle / np.linalg.norm(middle, axis=1)[:, None]
    zero, axis = np.zeros((len(t), 3)), np.array([0.0, 0, 1])
    # A wrong focal length is a wrong distance; it also turns an oblique board, as far as its perspective shows.
    tilt = np.cross(normal, line) / (normal * line).sum(axis=1)[:, None]
    slope = (middle[:, :2] ** 2).sum(axis=1) / middle[:, 2] ** 2
    moved = [
        np.hstack([middle[:, 2:] * axis, zero]),
        np.hstack([np.cross(lever, tilt), tilt]),
        np.hstack([t, zero]),
        np.hstack([middle * (1 - axis) * slope[:, None], zero]),
    ]
    return np.stack(moved, axis=2)


def without_errors(view: View, errors: CameraErrors, point: Array) -> View:
    """Return the view of a camera without these errors; point : as of `moved_by_errors`."""
    from scipy.spatial.transform import Rotation

    if view.images is not None:
        T, images = view.images.corrected(errors).posed()
        return View(T[:, :3, 3], T[:, :3, :3], view.camera, images)
    seen = view
    for _ in range(3):  # the error is that at the true pose
        moved = moved_by_errors(seen, point) @ np.array(errors)
        turned = Rotation.from_rotvec(-moved[:, 3:]).as_matrix() @ view.R
        seen = view._replace(t=view.t - moved[:, :3], R=turned)
    return seen


def spread_of_place(view: View, noise: CameraNoise) -> Array:
    """Return roots S of the covariances of the target point's positions, shape (n, 3, 3).

    Unit: sigma of lengths; axes: the line of sight, with corners in images the camera.
    """
    if view.images is not None:
        return _spread_of_pixels(view, view.images, noise)[:, :3, :3] / noise.pixel[0]
    return noise.relative(lines_of_sight(view, noise)[1])[:, :3, None] * np.eye(3)


def _spread_of_pixels(view: View, images: Images, noise: CameraNoise) -> Array:
    """Return roots, (n, 6, 6), of the covariances of position and rotation for 1 px of noise."""
    root = np.linalg.inv(images.root)
    root[:, :3] -= crossing(view.R @ np.array(noise.point)) @ root[:, 3:]
    return np.linalg.cholesky(root @ root.transpose(0, 2, 1))


def initial_noise(view: View) -> CameraNoise:
    """Return the initial noise: all ratios are one, or follow from corners in images."""
    if view.images is None:
        return CameraNoise()
    noise = CameraNoise(point=tuple(view.images.middle))
    axes, away = lines_of_sight(view, noise)
    root = _spread_of_pixels(view, view.images, noise)
    variance = np.concatenate([((axes @ root[:, part]) ** 2).sum(axis=2) for part in (slice(3), slice(3, 6))], axis=1)
    lateral, _, depth, tilt, _, roll = np.sqrt(np.median(variance, axis=0)).tolist()
    length, angle = (float(np.sqrt((2 * a**2 + b**2) / 3)) for a, b in ((lateral, depth), (tilt, roll)))
    ratios = (lateral / length, depth / length, tilt / angle, roll / angle)
    # They grow with the distance as images of a board shrink.
    return CameraNoise(ratios, (1.0, 2.0, 2.0, 1.0), float(np.median(away)), noise.point, (length, angle))


def refined(
    view: View, noise: CameraNoise, r: Array, freedom: Array, sigmas: tuple[float, float]
) -> tuple[CameraNoise, tuple[float, float]]:
    """Return the noise by whitened residuals, and sigmas of lengths [m] and angles [rad].

    The components' variances are residual squares over redundancies (restricted maximum likelihood;
    Foerstner 1979); exponents of the distance are the most probable of a grid, of a prior 1 +- 1.
    With corners in images only the sigmas are estimated, by one standard deviation of a pixel.

    noise : by which they are whitened; sigmas : of lengths [m] and angles [rad] with it
    r, freedom : residuals in units of sigma and their redundancy numbers, shape (n, 6)
    """
    if view.images is not None:  # one standard deviation of a pixel explains all
        unit = np.repeat(np.array(sigmas) / noise.pixel, 3)
        pixel = float(np.sqrt(((r * unit) ** 2).sum() / max(float(freedom.sum()), 1e-3)))
        return noise, (pixel * noise.pixel[0], pixel * noise.pixel[1])
    axes, away = lines_of_sight(view, noise)
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
    e = r * noise.relative(away) * np.repeat(sigmas, 3)
    before = np.array(noise.point)
    # A rotation by w moves a point that is further by b by w x b.
    unit = noise.relative(np.full(len(view.R), noise.distance))[:, :3].ravel()
    turned = np.einsum("nji,nj->ni", axes, e[:, 3:])
    J = (axes @ crossing(turned) @ view.R).reshape(-1, 3) / unit[:, None]
    y = e[:, :3].ravel() / unit
    origin = y - J @ before
    b = -np.linalg.lstsq(J, origin, rcond=None)[0]
    # By the likelihood ratio of three more parameters, with a probability of 0.1 % by chance.
    gain = len(y) * np.log(max(float(origin @ origin), 1e-30) / max(float((origin + J @ b) @ (origin + J @ b)), 1e-30))
    point = (float(b[0]), float(b[1]), float(b[2])) if gain > 16.3 else (0.0, 0.0, 0.0)
    lateral, depth, tilt, roll = found
    length, angle = (float(np.sqrt((2 * a**2 + b**2) / 3)) for a, b in ((lateral, depth), (tilt, roll)))
    ratios = (lateral / length, depth / length, tilt / angle, roll / angle)
    made = CameraNoise(ratios, (growth[0], growth[1], growth[2], growth[3]), distance, point)
    return made, (sigmas[0] * length, sigmas[1] * angle)
