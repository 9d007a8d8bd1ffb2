"""Inverse kinematics of any robot, deflections included: damped Newton, many poses at once.

The damping decreases with the error (see `solve_joints`): steps are finite near singular poses, and
Newton's at the end.

The solutions are then classified: which posture joints are in, and which joints have a given
posture and turns.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.export.c.chord import ORIENTATION_LENGTH_M, residual
from casadical.export.controller.correction import pose_of, variables_of
from casadical.export.controller.programs.target import Posture
from casadical.robot.inverse_kinematics import solve_joints
from casadical.robot.kinematics import link_frames
from casadical.robot.robot import Robot

# Smallest singular value of the Jacobian of a pose that is not singular [m/rad]: in position and
# scaled orientation, or in position alone where only that counts.
SINGULAR_BELOW_M_PER_RAD = 0.02


@dataclass(frozen=True, eq=False)
class Inverse:
    """Solution of the inverse kinematics for many poses.

    q : joints as the pose function takes them: controller's readings, shape (k, n) [rad or m]
    rest_m : remaining position error, shape (k,) [m]
    rest_rad : remaining orientation error, shape (k,) [rad]; 0 where it does not count
    singular : whether the pose is nearly singular, shape (k,): in the weakest direction the joints
        move the tool by less than `SINGULAR_BELOW_M_PER_RAD`
    inside : whether every joint is within its limits, shape (k,)
    """

    q: Array
    rest_m: Array
    rest_rad: Array
    singular: Array
    inside: Array

    @property
    def reached(self) -> Array:
        """Return whether errors are below 1e-6 m and 1e-6 rad, whatever the limits, shape (k,)."""
        return (self.rest_m < 1e-6) & (self.rest_rad < 1e-6)


def inverse_kinematics(robot: Robot, p: Array, R: Array | None, start: Array) -> Inverse:
    """Return the joints that bring the tool to k poses, by Newton's method from a start.

    The model has compliance, effects at declared payload and conditions, and the file's base and
    tool; joints are controller's readings. For a pose that cannot be reached an error remains.

    robot : calibrated robot
    p : shape (k, 3) [m]: positions of the measured point in the measuring frame
    R : shape (k, 3, 3): orientations of the tool frame in the measuring frame; None: only the
        position is to be reached
    start : joints to start from, shape (k, n) or (n,) [rad or m]; the solution nearest to them, as
        a rule, is found
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
    return Newton(pose_function(robot), R is not None).solved(p, R, start, robot.reading_limits)


def pose_function(robot: Robot) -> ca.Function:
    """Return the CasADi function q[n] -> (p[3] [m], R[3x3]) of the tool's pose, see `pose_of`."""
    q = ca.SX.sym("q", robot.n)
    return ca.Function("pose", [q], pose_of(robot, q))


def freedom_of(robot: Robot) -> tuple[int, int]:
    """Return the numbers of directions in which joints move, and about which they rotate, the tool.

    The rotations are those at a constant position; most robots have (3, 3). A direction counts if,
    at any of 50 random poses, its singular value exceeds `SINGULAR_BELOW_M_PER_RAD`.
    """
    poses = np.random.default_rng(0).uniform(*robot.reading_limits, (50, robot.n))
    J = np.nan_to_num(Newton(pose_function(robot)).evaluated(poses, np.zeros((len(poses), 12)))[1])
    greatest = (np.linalg.svd(part, compute_uv=False).max(axis=0) for part in (J[:, :3], J))
    moved, both = (int((values > SINGULAR_BELOW_M_PER_RAD).sum()) for values in greatest)
    return moved, both - moved


class Newton:
    """Newton's method for a pose function q[n] -> (p[3] [m], R[3x3]).

    pose : CasADi function of the tool's pose; oriented : whether the orientation is to be reached
    """

    def __init__(self, pose: ca.Function, oriented: bool = True) -> None:
        self.pose, self.oriented = pose, oriented
        # The CasADi function (q[n], target[12]) -> (r[6] [m], J[6 x n]) of Newton's method.
        n = pose.numel_in(0)
        q, target = ca.SX.sym("q", n), ca.SX.sym("target", 12)
        p, R = pose(q)
        if oriented:
            r = residual(target, ca.vertcat(p, ca.vec(R)))
            lower = ca.horzcat(*[ORIENTATION_LENGTH_M * _turning(R, ca.jacobian(ca.vec(R), q), i) for i in range(n)])
        else:
            r, lower = ca.vertcat(target[:3] - p, ca.SX.zeros(3)), ca.SX.zeros(3, n)
        self._function = ca.Function(
            "newton", [q, target], [ca.densify(r), ca.densify(ca.vertcat(ca.jacobian(p, q), lower))]
        )

    def solved(self, p: Array, R: Array | None, start: Array, limits: tuple[Array, Array]) -> Inverse:
        """Return the joints that reach k poses, iterated from `start`.

        p : positions in the frame of the pose function, shape (k, 3) [m]
        R : orientations there, shape (k, 3, 3); None: positions only
        start : joints to start from, shape (k, n) [rad or m]
        limits : lower and upper joint limits, (n,) [rad or m], which are checked but not enforced
        """
        k = len(start)
        target = np.hstack([p, np.zeros((k, 9)) if R is None else np.swapaxes(R, 1, 2).reshape(k, 9)])

        def off(q: Array, which: Array) -> tuple[Array, Array]:
            """Return residuals and Jacobians of the poses of these indices at joints q."""
            return self.evaluated(q, target[which])

        q = solve_joints(off, start, 60, 0.4, damping=1e-15, of_error=0.1, done=1e-13)
        r, J = self.evaluated(q, target)
        far = np.where(np.isfinite(r), r, np.inf)
        weakest = np.linalg.svd(np.nan_to_num(J[:, : 6 if self.oriented else 3]), compute_uv=False)[:, -1]
        inside = np.asarray(((q >= limits[0] - 1e-12) & (q <= limits[1] + 1e-12)).all(axis=1))
        turned = np.linalg.norm(far[:, 3:], axis=1) / ORIENTATION_LENGTH_M
        return Inverse(
            q, np.linalg.norm(far[:, :3], axis=1), turned, np.asarray(weakest < SINGULAR_BELOW_M_PER_RAD), inside
        )

    def evaluated(self, q: Array, target: Array) -> tuple[Array, Array]:
        """Return residuals, (k, 6) [m], and Jacobians, (k, 6, n) [m/rad or m/m], at joints q.

        The last three residuals are a rotation vector times `ORIENTATION_LENGTH_M`.

        q : shape (k, n) [rad or m]; target : position and columns of R, shape (k, 12)
        """
        r, J = self._function.map(len(q))(q.T, target.T)
        return r.full().T, J.full().reshape(6, *q.shape).transpose(1, 0, 2)


def _turning(R: ca.SX, slope: ca.SX, i: int) -> ca.SX:
    """Return the rotation vector per unit of joint i, from 0, by which it rotates R: dR R^T, (3,).

    slope : Jacobian of the columns of R by the joints, shape (9, n)
    """
    W = ca.mtimes(ca.reshape(slope[:, i], 3, 3), R.T)
    return 0.5 * ca.vertcat(W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1])


# One turn of a joint [rad].
_FULL_TURN_RAD = 2 * np.pi

# Type of a function that counts the turns of joints q, shape (n,) [rad], as a language does.
Turns = Callable[[Array], tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class Postures:
    """The nominal robot's inverse kinematics at its flange, by posture and joint turns.

    nominal : nominal robot in its own base frame, with the controller's flange as its tool
    root : pose of the controller's root frame in that base frame, shape (4, 4) [m]
    """

    nominal: Robot
    root: Array

    @cached_property
    def _newton(self) -> Newton:
        """Return Newton's method for the flange pose of the nominal robot."""
        return Newton(pose_function(self.nominal))

    @cached_property
    def why_not(self) -> str:
        """Return why postures (arm configurations) are undefined for this robot, else ""."""
        if self.nominal.n != 6 or len(self.nominal.revolute) != 6:
            return f"a configuration is defined for six turning joints; this robot has {len(self.nominal.revolute)}"
        q = np.random.default_rng(0).uniform(*self._box, (20, 6))
        off = self._signs.map(len(q))(q.T).full()[3]
        if np.nanmax(off) > 1e-4:  # m
            return (
                "axes 4, 5 and 6 of the nominal robot miss each other by "
                f"{1e3 * np.nanmax(off):.3g} mm; a configuration is defined for a common point"
            )
        return ""

    def sides(self, q: Array) -> Array:
        """Return the posture at joints q as booleans, shape (k, 3), in the order of `Posture`.

        q : shape (k, 6) [rad]
        """
        x, bend, wrist, _ = self._signs.map(len(q))(q.T).full()
        return np.stack([x < 0, bend < 0, wrist < 0], axis=1)

    @cached_property
    def _signs(self) -> ca.Function:
        """Return the function of the numbers whose signs define a posture.

        signs:(q[6])->(distance of the wrist before axis 1 [m], bend of the elbow [m^2], reading of
        joint 5 [rad], summed distance of axes 4 and 6 from the wrist's centre [m]). Before axis 1
        is the side to which the root frame's x axis points where joint 1 reads zero.
        """
        q = ca.SX.sym("q", 6)
        values = {p.name: ca.SX(p.value) for p in self.nominal.parameters}
        variables = variables_of(self.nominal, q)
        frames = link_frames(self.nominal, list(ca.vertsplit(variables)), values)
        points, axes = [T[:3, 3] for T in frames], [T[:3, 2] for T in frames]
        wrist = points[4] + _nearest(points[4], axes[4], points[3], axes[3]) * axes[4]
        miss = ca.norm_2(ca.cross(axes[3], wrist - points[3])) + ca.norm_2(ca.cross(axes[5], wrist - points[5]))
        turned = variables[0] - float(self.nominal.variables_of(np.zeros((1, 6)))[0, 0])
        x, axis, cosine = ca.DM(self.root[:3, 0]), axes[0], ca.cos(turned)  # x rotated about the axis (Rodrigues)
        forward = cosine * x + ca.sin(turned) * ca.cross(axis, x) + (1 - cosine) * ca.dot(axis, x) * axis
        upper = _perpendicular_part(points[2] - points[1], axes[1])
        lower = _perpendicular_part(wrist - points[2], axes[2])
        bend = ca.dot(ca.cross(upper, lower), ca.cross(ca.DM(self.root[:3, 2]), forward))
        out = ca.vertcat(ca.dot(wrist - points[0], forward), bend, q[4], miss)
        return ca.Function("signs", [q], [ca.densify(out)])

    @cached_property
    def _box(self) -> tuple[Array, Array]:
        """Return joint limits (lower, upper), each (n,) [rad or m], of at most one turn per joint.

        The turn is centred at zero or at the limit nearest to zero.
        """
        lower, upper = self.nominal.reading_limits
        middle = np.clip(0.0, lower, upper)
        half = np.where(self._turns, np.pi, np.inf)
        return np.maximum(lower, middle - half), np.minimum(upper, middle + half)

    @property
    def _turns(self) -> Array:
        """Return a mask of the revolute joints, which can make whole turns, shape (n,)."""
        return np.array([j.kind == "revolute" for j in self.nominal.joints])

    @cached_property
    def _samples(self) -> tuple[Array, Array, Array]:
        """Return random joints, (N, n) [rad or m], flange poses, (N, 12), and postures, (N, 3).

        A pose is its position [m] in the base frame and the columns of its rotation. Postures have
        the shape (N, 0) where they are undefined for this robot.
        """
        q = np.random.default_rng(1).uniform(*self._box, (20_000, self.nominal.n))
        p, R = self._newton.pose.map(len(q))(q.T)
        T = np.hstack([p.full().T, R.full().reshape(3, len(q), 3).transpose(1, 2, 0).reshape(len(q), 9)])
        fine = np.isfinite(T).all(axis=1)
        return q[fine], T[fine], self.sides(q[fine]) if not self.why_not else np.zeros((int(fine.sum()), 0))

    def solutions(self, T: Array, posture: Posture, turns: Turns, wanted: tuple[int, ...]) -> Array:
        """Return all joints found that bring the flange to a pose with a posture, (k, n) [rad].

        They are within the limits; solutions within 1e-5 rad of each other count once.

        T : pose of the flange in the robot's own base frame, shape (4, 4) [m]
        turns : function that counts the turns of joints
        wanted : its value for the solutions, up to rounding
        """
        reached = self._reached(T, self._seeds(T, posture))
        reached = reached[(self.sides(reached) == np.array(posture)).all(axis=1)] if len(reached) else reached
        different: list[Array] = []
        for q in (c for row in reached for c in self._with_turns(row, turns, wanted)):
            if all(np.abs(q - other).max() > 1e-5 for other in different):  # rad
                different.append(q)
        return np.array(different).reshape(len(different), self.nominal.n)

    def _seeds(self, T: Array, posture: Posture | None) -> Array:
        """Return the joints of the 16 samples nearest to a flange pose, shape (16, n) [rad or m].

        T : pose in the base frame, shape (4, 4) [m]
        posture : posture of the samples; None: any
        """
        q, flange, postures = self._samples
        target = np.concatenate([T[:3, 3], T[:3, :3].T.ravel()])
        weight = np.concatenate([np.ones(3), np.full(9, 0.3)])
        far = np.linalg.norm((flange - target) * weight, axis=1)
        if posture is not None:
            far = np.where((postures == np.array(posture)).all(axis=1), far, np.inf)
        return q[np.argsort(far)[:16]]

    def _reached(self, T: Array, start: Array) -> Array:
        """Return the joints that reach a flange pose by Newton's method, shape (r, n) [rad or m].

        T : pose in the base frame, shape (4, 4) [m]; start : starts, shape (k, n) [rad or m]
        """
        many = np.broadcast_to(T, (len(start), 4, 4))
        result = self._newton.solved(many[:, :3, 3], many[:, :3, :3], start, self._box)
        return result.q[result.reached]

    def nearest(self, T: Array, near: Array) -> list[Array | None]:
        """Return for each flange pose the nominal robot's solution nearest to given joints.

        A solution has the shape (n,) [rad or m] and is within the joint limits; None stands for a
        pose for which none was found. Distances are Euclidean, in joint values.

        T : poses in the robot's own base frame, shape (k, 4, 4) [m]
        near : joints, shape (k, n) [rad or m]
        """
        direct = self._newton.solved(T[:, :3, 3], T[:, :3, :3], near, self._box)
        nearest: list[Array | None] = []
        for pose, q, reached, wanted in zip(T, direct.q, direct.reached, near, strict=True):
            first = self._towards(q[None], wanted) if reached else []
            if not first or np.abs(first[0] - wanted).max() >= 0.3:  # rad: it may be another arm
                first += self._towards(self._reached(pose, self._seeds(pose, None)), wanted)
            nearest.append(first[int(np.argmin(np.linalg.norm(np.array(first) - wanted, axis=1)))] if first else None)
        return nearest

    def _towards(self, arms: Array, near: Array) -> list[Array]:
        """Return joints with whole turns added that bring each joint nearest to `near`.

        Those that cannot be brought within the joint limits are dropped.

        arms : solutions, shape (k, n) [rad or m]; near : shape (n,) [rad or m]
        """
        lower, upper = self.nominal.reading_limits
        max_turns, min_turns = (
            np.floor((upper - arms + 1e-9) / _FULL_TURN_RAD),
            np.ceil((lower - arms - 1e-9) / _FULL_TURN_RAD),
        )
        turned = arms + _FULL_TURN_RAD * np.clip(np.round((near - arms) / _FULL_TURN_RAD), min_turns, max_turns)
        inside = (lower - 1e-9 <= arms) & (arms <= upper + 1e-9)
        turned, fits = np.where(self._turns, turned, arms), np.where(self._turns, min_turns <= max_turns, inside)
        return [q for q, fine in zip(turned, np.all(fits, axis=1).tolist(), strict=True) if fine]

    def _with_turns(self, q: Array, turns: Turns, wanted: tuple[int, ...]) -> list[Array]:
        """Return joints q with whole turns added that are within limits and count as `wanted`, or [].

        Of several, which differ by whole turns of joints that are not counted, it is the one nearest
        to zero: no arm has them where its range is less than a turn, as a file without limits says.

        q : shape (n,) [rad]; turns, wanted : as of `solutions`
        """
        choices = []
        for angle, low, high in zip(q, *self.nominal.reading_limits, strict=True):
            first = angle - _FULL_TURN_RAD * np.floor((angle - low + 1e-9) / _FULL_TURN_RAD)
            choices.append(np.arange(first, high + 1e-9, _FULL_TURN_RAD))

        def fits(q: Array) -> bool:
            """Return whether the turns of joints q are counted as `wanted`, up to rounding."""
            # A joint this close to an angle at which the count changes may have either count.
            counts = zip(turns(q - 1e-4), turns(q), turns(q + 1e-4), strict=True)
            return all(turn in count for turn, count in zip(wanted, counts, strict=True))

        return sorted(filter(fits, map(np.array, product(*choices))), key=lambda c: float(np.abs(c).sum()))[:1]


def _nearest(p: ca.SX, d: ca.SX, other: ca.SX, other_d: ca.SX) -> ca.SX:
    """Return t of the point p + t d [m] of a line that is nearest to another line."""
    c, between = ca.dot(d, other_d), other - p
    return (ca.dot(between, d) - c * ca.dot(between, other_d)) / (1 - c * c)


def _perpendicular_part(v: ca.SX, axis: ca.SX) -> ca.SX:
    """Return the part of a vector v, (3,), that is perpendicular to a unit vector."""
    return v - ca.dot(v, axis) * axis
