"""Corners of a board in images, and what they tell of the board's pose and of the camera.

The reprojection errors of all corners of a station are reduced to six residuals of the board's pose and a triangular
factor: to second order in the noise, their sum of squares is that of all reprojection errors less a constant. The
model of the lens is OpenCV's, of five coefficients; the reduction is that of bundle adjustment (Triggs et al. 2000).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from casadical.core.basics import Array
from casadical.core.levenberg_marquardt import Evaluated, levenberg_marquardt
from casadical.core.transforms import frame

# Columns of the camera's intrinsics: focal lengths and principal point [px], and the coefficients of distortion.
INTRINSICS = ("fx_px", "fy_px", "cx_px", "cy_px", "lens_k1", "lens_k2", "lens_p1", "lens_p2", "lens_k3")
# Numbers of a corner: pixel u, v, place on the board x, y, z [m], and 1 where it was seen, else 0.
CORNER_NUMBERS = 6
# Minimum number of corners of a station; of four, two poses are nearly equally probable.
MIN_CORNERS = 6


class CameraErrors(NamedTuple):
    """Errors of a camera: of what is given, over the truth; of distortion, the truth less what is given.

    focal : relative error of the focal length; board : of the scale of the board; distortion : of coefficient k1
    tilt : error of the focal length as the tilts of given poses show it; not of corners in images
    """

    focal: float = 0.0
    tilt: float = 0.0
    board: float = 0.0
    distortion: float = 0.0


class Images(NamedTuple):
    """Corners of n stations, each in one image.

    corners : shape (n, N, CORNER_NUMBERS); intrinsics : shape (n, 9), as named by INTRINSICS
    root : triangular factor A of `reduced`, at the poses of least reprojection error, shape (n, 6, 6)
    """

    corners: Array
    intrinsics: Array
    root: Array

    @property
    def seen(self) -> Array:
        """Mask of the corners that were seen, shape (n, N)."""
        return np.asarray(self.corners[:, :, 5] > 0)

    @property
    def middle(self) -> Array:
        """Mean place of the seen corners on the board, shape (3,) [m]."""
        return np.asarray(self.corners[self.seen][:, 2:5].mean(axis=0))

    def corrected(self, errors: CameraErrors) -> Images:
        """Return corners with corrected intrinsics and board coordinates; `root` is not updated."""
        corners, intrinsics, root = self.corners.copy(), self.intrinsics.copy(), self.root
        corners[:, :, 2:5] /= 1 + errors.board
        intrinsics[:, :2] /= 1 + errors.focal
        intrinsics[:, 4] += errors.distortion
        return Images(corners, intrinsics, root)

    def residuals(self, T: Array) -> tuple[Array, Array]:
        """Return reprojection errors (n, 2 N) [px], measured less projected, and the projections' derivatives.

        The derivatives, shape (n, 2 N, 10), are by shift [m] and rotation [rad] of the board in the axes of the
        camera, and by `CameraErrors`; all numbers of corners that were not seen are zero.

        T : poses of the board in the camera, shape (n, 4, 4) [m]
        """
        lever = self.corners[:, :, 2:5] @ T[:, :3, :3].transpose(0, 2, 1)
        (lx, ly, lz), (cx, cy, cz) = np.moveaxis(lever, 2, 0), np.moveaxis(lever + T[:, None, :3, 3], 2, 0)
        x, y = cx / cz, cy / cz
        fx, fy, u0, v0, k1, k2, p1, p2, k3 = (each[:, None] for each in self.intrinsics.T)
        r2 = x * x + y * y
        radial, slope = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
        bent = (
            fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)),
            fy * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y),
        )
        mixed = slope * x * y + 2 * p1 * x + 2 * p2 * y
        by_xy = (
            (radial + slope * x * x + 2 * p1 * y + 6 * p2 * x, mixed),
            (mixed, radial + slope * y * y + 6 * p1 * y + 2 * p2 * x),
        )
        J, r = np.zeros((*x.shape, 2, 10)), np.zeros((*x.shape, 2))
        for i, (f, centre, at, (by_x, by_y), slant) in enumerate(
            zip((fx, fy), (u0, v0), bent, by_xy, (x, y), strict=True)
        ):
            dx, dy = f * by_x / cz, f * by_y / cz
            dz = -(dx * x + dy * y)
            by_camera = (-at, np.zeros_like(at), -(dx * lx + dy * ly + dz * lz), f * r2 * slant)
            by_pose = (dx, dy, dz, ly * dz - lz * dy, lz * dx - lx * dz, lx * dy - ly * dx)
            J[:, :, i] = np.stack([*by_pose, *by_camera], axis=2)
            r[:, :, i] = self.corners[:, :, i] - at - centre
        r[~self.seen], J[~self.seen] = 0.0, 0.0
        return r.reshape(len(T), -1), J.reshape(len(T), -1, 10)

    def posed(self) -> tuple[Array, Images]:
        """Return the board's poses of least reprojection error, (n, 4, 4) [m], and their images.

        They start from a homography, and from its mirror image about the line of sight (Schweighofer and Pinz 2006).
        """
        from scipy.spatial.transform import Rotation

        first = np.stack([self._start(k) for k in range(len(self.corners))])
        place = first[:, :3, 3] + first[:, :3, :3] @ self.middle
        line = place / np.linalg.norm(place, axis=1)[:, None]
        normal = first[:, :3, 2]
        # Two rotations by the angle from the normal to the line make the mirror image.
        toward = line * np.sign((line * normal).sum(axis=1))[:, None]
        axis = np.cross(normal, toward)
        sine = np.linalg.norm(axis, axis=1)
        angle = 2 * np.arctan2(sine, (normal * toward).sum(axis=1))
        axis /= np.maximum(sine, 1e-9)[:, None]
        turn = Rotation.from_rotvec(axis * angle[:, None]).as_matrix()
        mirrored = first.copy()
        mirrored[:, :3, :3] = turn @ first[:, :3, :3]
        mirrored[:, :3, 3] = place - mirrored[:, :3, :3] @ self.middle
        starts = [self._fitted(first, 6), self._fitted(mirrored, 6)]
        cost = [(self.residuals(T)[0] ** 2).sum(axis=1) for T in starts]
        T = self._fitted(np.where((cost[0] <= cost[1])[:, None, None], *starts), 30)
        return T, self._replace(root=self.reduced(T)[0])

    def _fitted(self, T: Array, steps: int) -> Array:
        """Return the poses, (n, 4, 4), that at most so many Levenberg-Marquardt steps reach from T."""

        def evaluate(flat: Array) -> Evaluated:
            r, J = self.residuals(flat.reshape(-1, 4, 4))
            J = J[..., :6]
            return (r**2).sum(axis=1), lambda k: (J[k].transpose(0, 2, 1) @ J[k], (r[k, None] @ J[k])[:, 0])

        move = lambda flat, step: _moved(flat.reshape(-1, 4, 4), step).reshape(flat.shape)  # noqa: E731
        start = T.reshape(-1, 16)
        *_, end = levenberg_marquardt(evaluate, start, steps + 1, move=move, absolute=1e-12)
        return end.point.reshape(T.shape)

    def _start(self, k: int) -> Array:
        """Return the pose of the board in the camera, (4, 4), by the homography of its corners at station k."""
        seen, (fx, fy, cx, cy) = self.corners[k][self.seen[k]], self.intrinsics[k, :4]
        given = (seen[:, :2] - [cx, cy]) / [fx, fy]
        ray, (k1, k2, p1, p2, k3) = given.copy(), self.intrinsics[k, 4:]
        for _ in range(20):  # fixed-point iterations, as OpenCV's undistortPoints has them
            (x, y), r2 = ray.T, (ray**2).sum(axis=1)
            shift = np.stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], axis=1)
            ray = (given - shift) / (1 + r2 * (k1 + r2 * (k2 + r2 * k3)))[:, None]
        middle, size = seen[:, 2:4].mean(axis=0), float(np.ptp(seen[:, 2:4]))
        board = np.column_stack([(seen[:, 2:4] - middle) / size, np.ones(len(seen))])
        A = np.zeros((2 * len(seen), 9))
        A[::2, :3] = A[1::2, 3:6] = board
        A[::2, 6:], A[1::2, 6:] = -ray[:, :1] * board, -ray[:, 1:] * board
        H = np.linalg.svd(A, full_matrices=False)[2][-1].reshape(3, 3)
        H *= np.sign(H[2, 2]) * 2 / (np.linalg.norm(H[:, 0]) + np.linalg.norm(H[:, 1])) * size
        U, _, V = np.linalg.svd(np.column_stack([H[:, :2] / size, np.cross(H[:, 0], H[:, 1]) / size**2]))
        R = U @ np.diag([1, 1, np.linalg.det(U @ V)]) @ V
        return frame(R, H[:, 2] - R @ [*middle, seen[0, 4]])

    def reduced(self, T: Array) -> tuple[Array, Array, Array, Array]:
        """Return triangular factors of the reprojection errors [px]: A of the pose, B of pose by camera, C and c.

        With a pose that is off by e (shift, rotation) and errors s of the camera, the sum of squares is a constant and
        |A e + B s|^2 + |C s - c|^2. Shapes are (n, 6, 6), (n, 6, 4), (4, 4) and (4,).

        T : poses of least reprojection error, shape (n, 4, 4) [m]
        """
        r, J = self.residuals(T)
        factor = np.asarray(np.linalg.qr(np.dstack([J, r]), mode="r"))
        C = np.asarray(np.linalg.qr(factor[:, 6:, 6:].reshape(-1, 5), mode="r"))
        return factor[:, :6, :6], factor[:, :6, 6:10], C[:4, :4], C[:4, 4]


def _moved(T: Array, step: Array) -> Array:
    """Return the poses, (n, 4, 4), shifted and rotated by a step, (n, 6) [m, rad], in the axes of the camera."""
    from scipy.spatial.transform import Rotation

    moved = T.copy()
    moved[:, :3, :3] = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ T[:, :3, :3]
    moved[:, :3, 3] += step[:, :3]
    return moved
