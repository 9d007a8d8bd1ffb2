"""The arms that reach a pose: which posture joints are in, and the joints that have a posture and turns."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.export.controller.inverse import Newton, pose_function
from casadical.export.controller.programs.target import Posture
from casadical.robot.kinematics import link_frames
from casadical.robot.robot import Robot

SPHERICAL = 1e-4  # m: axes 4, 5 and 6 that miss each other by less have a common point
_SAMPLES, _SEEDS = 20000, 16
_TURN = 2 * np.pi
_ROUNDING = 1e-4  # rad: a joint this near to where a turn is counted may have either count
_SAME = 1e-5  # rad
_CLOSE = 0.3  # rad: another arm is farther from the joints asked for

Turns = Callable[[Array], tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class Postures:
    """The nominal robot's solutions of a pose of its flange.

    nominal : in its own base frame, its tool being the flange; root : the controller's root frame in it, (4, 4) [m]
    """

    nominal: Robot
    root: Array

    @cached_property
    def _pose(self) -> ca.Function:
        return pose_function(self.nominal)

    @cached_property
    def _newton(self) -> Newton:
        return Newton(self._pose)

    @cached_property
    def why_not(self) -> str:
        """Why this robot has no postures; empty if it has."""
        if self.nominal.n != 6 or len(self.nominal.revolute) != 6:
            return f"a configuration is defined for six turning joints; this robot has {len(self.nominal.revolute)}"
        q = np.random.default_rng(0).uniform(*self._box, (20, 6))
        off = self._signs.map(len(q))(q.T).full()[3]
        if np.nanmax(off) > SPHERICAL:
            return (
                f"axes 4, 5 and 6 of the nominal robot miss each other by {1e3 * np.nanmax(off):.3g} mm; a "
                "configuration is defined for a common point"
            )
        return ""

    def sides(self, q: Array) -> Array:
        """Postures of joints q, shape (k, 6): behind, bent back, wrist negative; boolean, shape (k, 3)."""
        x, bend, wrist, _ = self._signs.map(len(q))(q.T).full()
        return np.stack([x < 0, bend < 0, wrist < 0], axis=1)

    @cached_property
    def _signs(self) -> ca.Function:
        """signs:(q[6])->(x of the wrist before axis 1, bend of the elbow, reading 5, how far the wrist's axes miss).

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
        return (
            np.where(self._turns, np.maximum(lower, middle - np.pi), lower),
            np.where(self._turns, np.minimum(upper, middle + np.pi), upper),
        )

    @property
    def _turns(self) -> Array:
        return np.array([j.kind == "revolute" for j in self.nominal.joints])

    @cached_property
    def _samples(self) -> tuple[Array, Array, Array]:
        """Random joints (N, n), their flange poses (N, 12), and postures (N, 3), or (N, 0) where there are none."""
        q = np.random.default_rng(1).uniform(*self._box, (_SAMPLES, self.nominal.n))
        p, R = self._pose.map(len(q))(q.T)
        T = np.hstack([p.full().T, R.full().reshape(3, len(q), 3).transpose(1, 2, 0).reshape(len(q), 9)])
        fine = np.isfinite(T).all(axis=1)
        return q[fine], T[fine], self.sides(q[fine]) if not self.why_not else np.zeros((int(fine.sum()), 0))

    def solutions(self, T: Array, posture: Posture, turns: Turns, wanted: tuple[int, ...]) -> Array:
        """All joints found that bring the flange to T (4, 4), with this posture and turns; shape (k, n) [rad].

        wanted : what `turns` gives for them, up to rounding
        """
        reached = self._reached(T, self._seeds(T, posture))
        reached = reached[(self.sides(reached) == np.array(posture)).all(axis=1)] if len(reached) else reached
        return _different([c for row in reached for c in self._turned(row, turns, wanted)], self.nominal.n)

    def _seeds(self, T: Array, posture: Posture | None) -> Array:
        """The samples whose flange is nearest to a pose, of one posture if it is given; shape (k, n)."""
        q, flange, postures = self._samples
        target = np.concatenate([T[:3, 3], T[:3, :3].T.ravel()])
        weight = np.concatenate([np.ones(3), np.full(9, 0.3)])
        far = np.linalg.norm((flange - target) * weight, axis=1)
        if posture is not None:
            far = np.where((postures == np.array(posture)).all(axis=1), far, np.inf)
        return q[np.argsort(far)[:_SEEDS]]

    def _reached(self, T: Array, start: Array) -> Array:
        """Joints that Newton's method finds from several starts (k, n), those that reach the pose."""
        many = np.broadcast_to(T, (len(start), 4, 4))
        result = self._newton.solved(many[:, :3, 3], many[:, :3, :3], start, self._box)
        return result.q[result.reached]

    def nearest(self, T: Array, near: Array) -> list[Array | None]:
        """The solutions nearest to joints (k, n) of flange poses (k, 4, 4), in their ranges, or None where there is
        none.
        """
        direct = self._newton.solved(T[:, :3, 3], T[:, :3, :3], near, self._box)
        found: list[Array | None] = []
        for pose, q, reached, wanted in zip(T, direct.q, direct.reached, near, strict=True):
            first = self._towards(q[None], wanted) if reached else []
            if not first or np.abs(first[0] - wanted).max() >= _CLOSE:
                first += self._towards(self._reached(pose, self._seeds(pose, None)), wanted)
            found.append(first[int(np.argmin(np.linalg.norm(np.array(first) - wanted, axis=1)))] if first else None)
        return found

    def _towards(self, found: Array, near: Array) -> list[Array]:
        """The same arms, each joint with the whole turns that bring it nearest to `near` in its range."""
        lower, upper = self.nominal.limits
        most, least = np.floor((upper - found + 1e-9) / _TURN), np.ceil((lower - found - 1e-9) / _TURN)
        turned = found + _TURN * np.clip(np.round((near - found) / _TURN), least, most)
        inside = (lower - 1e-9 <= found) & (found <= upper + 1e-9)
        turned, fits = np.where(self._turns, turned, found), np.where(self._turns, least <= most, inside)
        return [q for q, fine in zip(turned, np.all(fits, axis=1).tolist(), strict=True) if fine]

    def _turned(self, q: Array, turns: Turns, wanted: tuple[int, ...]) -> list[Array]:
        """The same arm with whole turns added to joints, in their ranges, where the turns are the wanted ones."""
        choices = []
        for angle, low, high in zip(q, *self.nominal.limits, strict=True):
            first = angle - _TURN * np.floor((angle - low + 1e-9) / _TURN)
            choices.append(np.arange(first, high + 1e-9, _TURN))
        return [c for c in map(np.array, product(*choices)) if _has_turns(c, turns, wanted)]


def _has_turns(q: Array, turns: Turns, wanted: tuple[int, ...]) -> bool:
    counts: Iterable[tuple[int, ...]] = zip(turns(q - _ROUNDING), turns(q), turns(q + _ROUNDING), wanted, strict=True)
    return all(w in (a, b, c) for a, b, c, w in counts)


def _different(found: list[Array], n: int) -> Array:
    kept: list[Array] = []
    for q in found:
        if all(np.abs(q - other).max() > _SAME for other in kept):
            kept.append(q)
    return np.array(kept).reshape(len(kept), n)


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
