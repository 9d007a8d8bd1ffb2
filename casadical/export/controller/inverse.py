"""Inverse kinematics of any robot, the calibrated one with its deflections included: damped Newton, many poses at once.

The step is J^T (J J^T + lambda^2 I)^-1 r with lambda proportional to the error r (Levenberg and Marquardt; Nakamura
and Hanafusa 1986), so that it stays finite near singular poses and is Newton's at the end. With seven joints it is the
one of least norm: the elbow stays where it was started.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.export.controller.functions import pose_of
from casadical.robot.robot import Robot

LENGTH = 0.3  # m: by which an error of the orientation [rad] is weighted against one of the position
REACHED_M, REACHED_RAD = 1e-6, 1e-6
SINGULAR_POSE = 0.02  # m/rad: of six directions the weakest is weaker, in a pose that counts as singular
_STEPS, _LARGEST_STEP, _DAMPING, _DONE = 60, 0.4, 0.1, 1e-13


@dataclass(frozen=True, eq=False)
class Inverse:
    """Joints that reach poses.

    q : Array, shape (k, n) [rad or m]
    rest_m : Array, shape (k,) [m]: what remains of the position
    rest_rad : Array, shape (k,) [rad]: what remains of the orientation
    singular : Array, shape (k,): whether the pose is nearly singular: the weakest direction moves the tool by less than
        0.02 m/rad
    inside : Array, shape (k,): whether every joint is in its range
    """

    q: Array
    rest_m: Array
    rest_rad: Array
    singular: Array
    inside: Array

    @property
    def reached(self) -> Array:
        """Whether the pose is reached to a micrometre and a microradian, boolean, shape (k,)."""
        return (self.rest_m < REACHED_M) & (self.rest_rad < REACHED_RAD)


def inverse_kinematics(robot: Robot, p: Array, R: Array | None, start: Array) -> Inverse:
    """Joints that bring the robot's tool to poses, by Newton's method from a start such as the nominal solution.

    The model holds compliance, effects that joints and declared payload decide, and the file's base and tool.

    A pose that cannot be reached has a rest; look at `Inverse.reached`.

    robot : calibrated robot
    p : shape (k, 3) [m]: positions of the measured point in the measuring frame
    R : shape (k, 3, 3): orientations of the tool frame; None: only the position is to be reached
    start : joints to start from, shape (k, n) or (n,) [rad or m]; the solution nearest to them, as a rule, is found
    Raises InputError: arrays of other shapes.

    Examples
    --------
    >>> p, _ = casadical.identification.predicted(found.robot, poses)
    >>> flat = casadical.export.inverse_kinematics(found.robot, p[:2], None, start=poses.q[:2] + 0.01)
    >>> flat.q.shape, flat.inside
    ((2, 2), array([ True,  True]))
    """
    p = np.atleast_2d(np.asarray(p, float))
    start = np.broadcast_to(np.asarray(start, float), (len(p), robot.n))
    if p.shape[1] != 3 or (R is not None and np.shape(R) != (len(p), 3, 3)):
        raise InputError(
            f"inverse kinematics: p {p.shape}, R {None if R is None else np.shape(R)}; expected (k, 3) and (k, 3, 3)"
        )
    return Newton(pose_function(robot), R is not None).solved(p, R, start, robot.limits)


def pose_function(robot: Robot) -> ca.Function:
    q = ca.SX.sym("q", robot.n)
    return ca.Function("pose", [q], pose_of(robot, q))


def freedom_of(robot: Robot) -> tuple[int, int]:
    """In how many directions the joints move the tool, and in how many they turn it beside that: 3 and 3 of most arms.

    A direction counts where the joints move the tool in it by more than a singular pose's, somewhere in their ranges.
    """
    poses = np.random.default_rng(0).uniform(*robot.limits, (50, robot.n))
    J = np.nan_to_num(Newton(pose_function(robot)).evaluated(poses, np.zeros((len(poses), 12)))[1])
    greatest = (np.linalg.svd(part, compute_uv=False).max(axis=0) for part in (J[:, :3], J))
    moved, both = (int((values > SINGULAR_POSE).sum()) for values in greatest)
    return moved, both - moved


class Newton:
    """Newton's method for a function pose:(q[n])->(p[3] m, R[3x3]); oriented : whether the orientation counts."""

    def __init__(self, pose: ca.Function, oriented: bool = True) -> None:
        self.oriented = oriented
        self._function = _residual_and_jacobian(pose, pose.numel_in(0), oriented)

    def solved(self, p: Array, R: Array | None, start: Array, limits: tuple[Array, Array]) -> Inverse:
        k, n = start.shape
        target = np.hstack([p, np.zeros((k, 9)) if R is None else np.swapaxes(R, 1, 2).reshape(k, 9)])
        q, r, J = np.array(start, float), np.full((k, 6), np.inf), np.zeros((k, 6, n))
        active = np.arange(k)
        for _ in range(_STEPS):
            r[active], J[active] = self.evaluated(q[active], target[active])
            size = np.linalg.norm(np.nan_to_num(r[active], nan=np.inf), axis=1)
            active = active[(size > _DONE) & np.isfinite(size)]
            if not len(active):
                break
            q[active] += _steps(J[active], r[active])
        r, J = self.evaluated(q, target)
        far = np.where(np.isfinite(r), r, np.inf)
        weakest = np.linalg.svd(np.nan_to_num(J[:, : 6 if self.oriented else 3]), compute_uv=False)[:, -1]
        inside = np.asarray(((q >= limits[0] - 1e-12) & (q <= limits[1] + 1e-12)).all(axis=1))
        turned = np.linalg.norm(far[:, 3:], axis=1) / LENGTH
        return Inverse(q, np.linalg.norm(far[:, :3], axis=1), turned, np.asarray(weakest < SINGULAR_POSE), inside)

    def evaluated(self, q: Array, target: Array) -> tuple[Array, Array]:
        """Residuals, shape (k, 6) [m], and Jacobians, shape (k, 6, n); target : position and columns of R, (k, 12)."""
        r, J = self._function.map(len(q))(q.T, target.T)
        return r.full().T, J.full().reshape(6, *q.shape).transpose(1, 0, 2)


def _steps(J: Array, r: Array) -> Array:
    """Damped steps, no joint by more than `_LARGEST_STEP`."""
    damping = _DAMPING * np.sum(r**2, axis=1) + 1e-15
    A = J @ np.swapaxes(J, 1, 2) + damping[:, None, None] * np.eye(6)
    step = (np.swapaxes(J, 1, 2) @ np.linalg.solve(A, r[:, :, None]))[:, :, 0]
    return np.asarray(step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / _LARGEST_STEP))


def _residual_and_jacobian(pose: ca.Function, n: int, oriented: bool) -> ca.Function:
    """newton:(q[n], target[12])->(r[6] m, J[6 x n]); the last three of r are zero where only the position counts."""
    q, target = ca.SX.sym("q", n), ca.SX.sym("target", 12)
    p, R = pose(q)
    wanted = ca.reshape(target[3:], 3, 3)
    if oriented:
        turn = 0.5 * LENGTH * sum((ca.cross(R[:, i], wanted[:, i]) for i in range(3)), ca.SX.zeros(3))
        slope = [LENGTH * _turning(R, ca.jacobian(ca.vec(R), q), i) for i in range(n)]
        lower = ca.horzcat(*slope)
    else:
        turn, lower = ca.SX.zeros(3), ca.SX.zeros(3, n)
    J = ca.vertcat(ca.jacobian(p, q), lower)
    return ca.Function("newton", [q, target], [ca.densify(ca.vertcat(target[:3] - p, turn)), ca.densify(J)])


def _turning(R: ca.SX, slope: ca.SX, i: int) -> ca.SX:
    """The rotation vector by which joint i turns the frame, per its own unit: of dR R^T."""
    W = ca.mtimes(ca.reshape(slope[:, i], 3, 3), R.T)
    return 0.5 * ca.vertcat(W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1])
