"""Inverse kinematics of any robot, deflections included: damped Newton, many poses at once.

The damping falls with the error (see `solve_joints`): steps are finite near singular poses and Newton's at the end.

Then the arms that reach a pose: which posture joints are in, and the joints that have a posture and
turns.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.export.c.chord import ORIENTATION_LENGTH_M, residual
from casadical.export.controller.functions import pose_of
from casadical.export.controller.programs.target import Posture
from casadical.robot.inverse_kinematics import solve_joints
from casadical.robot.kinematics import link_frames
from casadical.robot.robot import Robot

SINGULAR_POSE = 0.02  # m/rad: of six directions the weakest is weaker, in a pose that counts as singular


@dataclass(frozen=True, eq=False)
class Inverse:
    """Joints that reach poses.

    q : Array, shape (k, n) [rad or m]
    rest_m : Array, shape (k,) [m]: what remains of the position
    rest_rad : Array, shape (k,) [rad]: what remains of the orientation
    singular : Array, shape (k,): whether the pose is nearly singular: the weakest direction moves
        the tool by less than 0.02 m/rad
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
        return (self.rest_m < 1e-6) & (self.rest_rad < 1e-6)


def inverse_kinematics(robot: Robot, p: Array, R: Array | None, start: Array) -> Inverse:
    """Joints that bring the tool to poses, by Newton's method from a start.

    The model holds compliance, effects that joints and declared payload decide, and the file's base
    and tool.

    A pose that cannot be reached has a rest; look at `Inverse.reached`.

    robot : calibrated robot
    p : shape (k, 3) [m]: positions of the measured point in the measuring frame
    R : shape (k, 3, 3): orientations of the tool frame; None: only the position is to be reached
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
    return Newton(pose_function(robot), R is not None).solved(p, R, start, robot.limits)


def pose_function(robot: Robot) -> ca.Function:
    q = ca.SX.sym("q", robot.n)
    return ca.Function("pose", [q], pose_of(robot, q))


def freedom_of(robot: Robot) -> tuple[int, int]:
    """In how many directions the joints move the tool, and beside that turn it: mostly 3, 3.

    A direction counts where the joints move the tool in it by more than a singular pose's,
    somewhere in their ranges.
    """
    poses = np.random.default_rng(0).uniform(*robot.limits, (50, robot.n))
    J = np.nan_to_num(Newton(pose_function(robot)).evaluated(poses, np.zeros((len(poses), 12)))[1])
    greatest = (np.linalg.svd(part, compute_uv=False).max(axis=0) for part in (J[:, :3], J))
    moved, both = (int((values > SINGULAR_POSE).sum()) for values in greatest)
    return moved, both - moved


class Newton:
    """Newton's method for pose:(q[n])->(p[3] m, R[3x3]); oriented : whether R counts."""

    def __init__(self, pose: ca.Function, oriented: bool = True) -> None:
        self.pose, self.oriented = pose, oriented
        self._function = _residual_and_jacobian(pose, pose.numel_in(0), oriented)

    def solved(self, p: Array, R: Array | None, start: Array, limits: tuple[Array, Array]) -> Inverse:
        k = len(start)
        target = np.hstack([p, np.zeros((k, 9)) if R is None else np.swapaxes(R, 1, 2).reshape(k, 9)])

        def off(q: Array, which: Array) -> tuple[Array, Array]:
            return self.evaluated(q, target[which])

        q = solve_joints(off, start, 60, 0.4, damping=1e-15, of_error=0.1, done=1e-13)
        r, J = self.evaluated(q, target)
        far = np.where(np.isfinite(r), r, np.inf)
        weakest = np.linalg.svd(np.nan_to_num(J[:, : 6 if self.oriented else 3]), compute_uv=False)[:, -1]
        inside = np.asarray(((q >= limits[0] - 1e-12) & (q <= limits[1] + 1e-12)).all(axis=1))
        turned = np.linalg.norm(far[:, 3:], axis=1) / ORIENTATION_LENGTH_M
        return Inverse(q, np.linalg.norm(far[:, :3], axis=1), turned, np.asarray(weakest < SINGULAR_POSE), inside)

    def evaluated(self, q: Array, target: Array) -> tuple[Array, Array]:
        """Residuals (k, 6) [m] and Jacobians (k, 6, n); target : position, columns of R, (k, 12)."""
        r, J = self._function.map(len(q))(q.T, target.T)
        return r.full().T, J.full().reshape(6, *q.shape).transpose(1, 0, 2)


def _residual_and_jacobian(pose: ca.Function, n: int, oriented: bool) -> ca.Function:
    """newton:(q[n], target[12])->(r[6] m, J[6 x n]); r[3:] is zero for positions alone."""
    q, target = ca.SX.sym("q", n), ca.SX.sym("target", 12)
    p, R = pose(q)
    if oriented:
        r = residual(target, ca.vertcat(p, ca.vec(R)))
        lower = ca.horzcat(*[ORIENTATION_LENGTH_M * _turning(R, ca.jacobian(ca.vec(R), q), i) for i in range(n)])
    else:
        r, lower = ca.vertcat(target[:3] - p, ca.SX.zeros(3)), ca.SX.zeros(3, n)
    return ca.Function("newton", [q, target], [ca.densify(r), ca.densify(ca.vertcat(ca.jacobian(p, q), lower))])


def _turning(R: ca.SX, slope: ca.SX, i: int) -> ca.SX:
    """The rotation vector by which joint i turns the frame, per its own unit: of dR R^T."""
    W = ca.mtimes(ca.reshape(slope[:, i], 3, 3), R.T)
    return 0.5 * ca.vertcat(W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1])


_TURN = 2 * np.pi

Turns = Callable[[Array], tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class Postures:
    """The nominal robot's solutions of a pose of its flange.

    nominal : in its own base frame, its tool being the flange; root : the controller's root frame
        in it, (4, 4) [m]
    """

    nominal: Robot
    root: Array

    @cached_property
    def _newton(self) -> Newton:
        return Newton(pose_function(self.nominal))

    @cached_property
    def why_not(self) -> str:
        """Why this robot has no postures; empty if it has."""
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
        """Behind, bent back, wrist negative at joints q, (k, 6); boolean, shape (k, 3)."""
        x, bend, wrist, _ = self._signs.map(len(q))(q.T).full()
        return np.stack([x < 0, bend < 0, wrist < 0], axis=1)

    @cached_property
    def _signs(self) -> ca.Function:
        """signs:(q[6])->(wrist before axis 1, bend of the elbow, reading 5, miss of the wrist).

        Before axis 1 is the side to which the root frame's x points where joint 1 reads zero.
        """
        q = ca.SX.sym("q", 6)
        values = {p.name: ca.SX(p.value) for p in self.nominal.parameters}
        frames = link_frames(self.nominal, list(ca.vertsplit(q)), values)
        points, axes = [T[:3, 3] for T in frames], [T[:3, 2] for T in frames]
        wrist = points[4] + _nearest(points[4], axes[4], points[3], axes[3]) * axes[4]
        miss = ca.norm_2(ca.cross(axes[3], wrist - points[3])) + ca.norm_2(ca.cross(axes[5], wrist - points[5]))
        forward = about_axis(axes[0], q[0], ca.DM(self.root[:3, 0]))
        upper = _across(points[2] - points[1], axes[1])
        lower = _across(wrist - points[2], axes[2])
        bend = ca.dot(ca.cross(upper, lower), ca.cross(ca.DM(self.root[:3, 2]), forward))
        out = ca.vertcat(ca.dot(wrist - points[0], forward), bend, q[4], miss)
        return ca.Function("signs", [q], [ca.densify(out)])

    @cached_property
    def _box(self) -> tuple[Array, Array]:
        """One turn of each joint within its range, all of a linear joint's."""
        lower, upper = self.nominal.limits
        middle = np.clip(0.0, lower, upper)
        half = np.where(self._turns, np.pi, np.inf)
        return np.maximum(lower, middle - half), np.minimum(upper, middle + half)

    @property
    def _turns(self) -> Array:
        return np.array([j.kind == "revolute" for j in self.nominal.joints])

    @cached_property
    def _samples(self) -> tuple[Array, Array, Array]:
        """Random joints (N, n), flange poses (N, 12), and postures (N, 3), or (N, 0) without."""
        q = np.random.default_rng(1).uniform(*self._box, (20_000, self.nominal.n))
        p, R = self._newton.pose.map(len(q))(q.T)
        T = np.hstack([p.full().T, R.full().reshape(3, len(q), 3).transpose(1, 2, 0).reshape(len(q), 9)])
        fine = np.isfinite(T).all(axis=1)
        return q[fine], T[fine], self.sides(q[fine]) if not self.why_not else np.zeros((int(fine.sum()), 0))

    def solutions(self, T: Array, posture: Posture, turns: Turns, wanted: tuple[int, ...]) -> Array:
        """Joints that bring the flange to T (4, 4) with this posture and turns, (k, n) [rad].

        wanted : what `turns` gives for them, up to rounding
        """
        reached = self._reached(T, self._seeds(T, posture))
        reached = reached[(self.sides(reached) == np.array(posture)).all(axis=1)] if len(reached) else reached
        different: list[Array] = []
        for q in (c for row in reached for c in self._turned(row, turns, wanted)):
            if all(np.abs(q - other).max() > 1e-5 for other in different):  # rad
                different.append(q)
        return np.array(different).reshape(len(different), self.nominal.n)

    def _seeds(self, T: Array, posture: Posture | None) -> Array:
        """The samples whose flange is nearest to a pose, of a given posture; shape (k, n)."""
        q, flange, postures = self._samples
        target = np.concatenate([T[:3, 3], T[:3, :3].T.ravel()])
        weight = np.concatenate([np.ones(3), np.full(9, 0.3)])
        far = np.linalg.norm((flange - target) * weight, axis=1)
        if posture is not None:
            far = np.where((postures == np.array(posture)).all(axis=1), far, np.inf)
        return q[np.argsort(far)[:16]]

    def _reached(self, T: Array, start: Array) -> Array:
        """Joints that Newton's method finds from starts (k, n) and that reach the pose."""
        many = np.broadcast_to(T, (len(start), 4, 4))
        result = self._newton.solved(many[:, :3, 3], many[:, :3, :3], start, self._box)
        return result.q[result.reached]

    def nearest(self, T: Array, near: Array) -> list[Array | None]:
        """Solutions of flange poses (k, 4, 4) nearest to joints (k, n), in range, or None."""
        direct = self._newton.solved(T[:, :3, 3], T[:, :3, :3], near, self._box)
        nearest: list[Array | None] = []
        for pose, q, reached, wanted in zip(T, direct.q, direct.reached, near, strict=True):
            first = self._towards(q[None], wanted) if reached else []
            if not first or np.abs(first[0] - wanted).max() >= 0.3:  # rad: it may be another arm
                first += self._towards(self._reached(pose, self._seeds(pose, None)), wanted)
            nearest.append(first[int(np.argmin(np.linalg.norm(np.array(first) - wanted, axis=1)))] if first else None)
        return nearest

    def _towards(self, arms: Array, near: Array) -> list[Array]:
        """The arms, each joint with the whole turns that bring it nearest to `near`."""
        lower, upper = self.nominal.limits
        most, least = np.floor((upper - arms + 1e-9) / _TURN), np.ceil((lower - arms - 1e-9) / _TURN)
        turned = arms + _TURN * np.clip(np.round((near - arms) / _TURN), least, most)
        inside = (lower - 1e-9 <= arms) & (arms <= upper + 1e-9)
        turned, fits = np.where(self._turns, turned, arms), np.where(self._turns, least <= most, inside)
        return [q for q, fine in zip(turned, np.all(fits, axis=1).tolist(), strict=True) if fine]

    def _turned(self, q: Array, turns: Turns, wanted: tuple[int, ...]) -> list[Array]:
        """The arm with whole turns added to joints, in range, where the turns are wanted."""
        choices = []
        for angle, low, high in zip(q, *self.nominal.limits, strict=True):
            first = angle - _TURN * np.floor((angle - low + 1e-9) / _TURN)
            choices.append(np.arange(first, high + 1e-9, _TURN))

        def fits(q: Array) -> bool:
            # a joint that is as near to where a turn is counted may have either count
            counts = zip(turns(q - 1e-4), turns(q), turns(q + 1e-4), strict=True)
            return all(turn in count for turn, count in zip(wanted, counts, strict=True))

        return [c for c in map(np.array, product(*choices)) if fits(c)]


def _nearest(p: ca.SX, d: ca.SX, other: ca.SX, other_d: ca.SX) -> ca.SX:
    """Where on the line p + t d the other line is nearest: t."""
    c, between = ca.dot(d, other_d), other - p
    return (ca.dot(between, d) - c * ca.dot(between, other_d)) / (1 - c * c)


def _across(v: ca.SX, axis: ca.SX) -> ca.SX:
    return v - ca.dot(v, axis) * axis


def about_axis(axis: ca.SX, angle: ca.SX, v: ca.DM) -> ca.SX:
    """A vector turned about an axis (Rodrigues)."""
    c, s = ca.cos(angle), ca.sin(angle)
    return c * v + s * ca.cross(axis, v) + (1 - c) * ca.dot(axis, v) * axis
