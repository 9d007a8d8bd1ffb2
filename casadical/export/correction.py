"""Kinematics and network together: corrected positions, and joint targets that bring the tool where it was meant to be.

The joint target solves  compensated(q') = nominal(q)  by damped least squares along a chord: the Jacobian is factored
once a round, as in Levenberg (1944) and Wampler (1986), with every step clamped.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadical.compensator import Compensator
from casadical.core.errors import InputError
from casadical.core.transforms import Array
from casadical.identification.accuracy import predicted
from casadical.identification.identification import Identification
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

DAMPING = 0.01  # lambda, beside singular values of the Jacobian in m/rad; its square is the usual 1e-4
LARGEST_STEP = 0.05  # of one joint in one step [rad or m]
STEPS, ROUNDS = 4, 5  # chord steps with one Jacobian; Jacobians at most
TOLERANCE = 1e-6  # of what may remain [m], and of the turn at a lever of 1 m [rad]
SINGULAR = 3 * DAMPING  # smallest singular value under which a pose counts as near singular


@dataclass(frozen=True, eq=False)
class JointTargets:
    """Joint targets and what they leave.

    q : shape (n, joints) [rad or m]; change : q less what was asked for
    left : distance [m], left_angle : turn [rad] between the compensated and the nominal tool, each of shape (n,);
    left_angle is zero where only the position was asked for
    near_singular : shape (n,), poses where some direction hardly answers to the joints: damping holds the joints back
    inside : shape (n,), whether the network was trained on such angles, joint by joint
    """

    q: Array
    change: Array
    left: Array
    left_angle: Array
    near_singular: NDArray[np.bool_]
    inside: NDArray[np.bool_]

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Whether no more than a micrometre and a microradian are left, boolean, shape (n,)."""
        return np.asarray((self.left < TOLERANCE) & (self.left_angle < TOLERANCE))

    @property
    def verdict(self) -> str:
        """The result in one sentence."""
        text = f"{int(self.converged.sum())} of {len(self.q)} joint targets reach the pose within 1 um and 1 urad"
        missed = ~self.converged
        if missed.any():
            worst = int(np.argmax(np.where(missed, self.left, -1)))
            text += (
                f"; {int((missed & self.near_singular).sum())} of the {int(missed.sum())} others stand near a singular "
                f"pose; most is left at row {worst}: {1e3 * self.left[worst]:.3g} mm"
            )
            text += f" and {1e3 * self.left_angle[worst]:.3g} mrad" if self.left_angle.any() else ""
        outside = int((~self.inside).sum())
        return text + (f"; {outside} outside of what the network was trained on" if outside else "") + "."


@dataclass(frozen=True, eq=False)
class Compensated:
    """A calibrated robot with its compensator; made by `compensated`.

    robot : calibrated; nominal : the model that the controller has, in the same measuring frame; None where not known
    """

    robot: Robot
    compensator: Compensator
    nominal: Robot | None = None

    def position(self, q: Array, conditions: dict[str, Array] | None = None) -> Array:
        """Corrected positions of the measured point, shape (n, 3) [m].

        q : joint readings, shape (n, joints) [rad or m]; conditions : logged columns by name, each of shape (n,);
        default: as declared. Raises InputError.
        """
        rows = _rows(q, self.robot)
        zero = np.zeros((len(rows), 3))
        m = Measurements(q=rows, kind="position", position=zero, conditions=dict(conditions or {}))
        return np.asarray(predicted(self.robot, m)[0] + 1e-3 * self.compensator.correction_mm(rows))

    @cached_property
    def function(self) -> ca.Function:
        """compensated:(q[n] rad)->(p[3] m, R[3x3]): kinematics and network, declared payload."""
        q = ca.SX.sym("q", self.robot.n)
        return ca.Function("compensated", [q], list(self._pose(q)), ["q"], ["p", "R"])

    def correction(self, *, orientation: bool = True, steps: int = STEPS) -> ca.Function:
        """correct_joints:(q[n])->(q_target[n], left[3 or 6]): one round of `steps` chord steps, for export.

        left : position [m], then rotation vector [rad], that remain. orientation : whether it is to be reached too.
        Raises InputError where the nominal model is not known.
        """
        q = ca.SX.sym("q", self.robot.n)
        target, left, _ = self._round(orientation, steps)(q, self._goal(q))
        return ca.Function("correct_joints", [q], [target, left], ["q"], ["q_target", "left"])

    def correct_joints(self, q: Array, *, orientation: bool | None = None) -> JointTargets:
        """Joint targets that bring the tool where the nominal model says it is at q.

        q : joint angles asked for, shape (n, joints) or (joints,) [rad or m]
        orientation : whether the tool is to keep its nominal orientation too; default: where there are six joints or
        more. Without it the change of the joints is the smallest one that reaches the position.

        The targets are for the declared payload. A pose that is not reached is not an error: see `JointTargets`.
        Raises InputError for arrays of wrong shape, and where the nominal model is not known.
        """
        rows = _rows(q, self.robot)
        whole = self.robot.n >= 6 if orientation is None else orientation
        goal = self._goals.map(len(rows))(rows.T).full()
        chord = self._round(whole, STEPS).map(len(rows))
        target, left, J = (out.full() for out in chord(rows.T, goal))
        least = np.linalg.svd(_stacked(J, len(rows)), compute_uv=False)[:, -1]
        for _ in range(ROUNDS - 1):
            if np.abs(left).max() < 0.1 * TOLERANCE:
                break
            target, left, _ = (out.full() for out in chord(target, goal))
        target, left = target.T, left.T
        return JointTargets(
            q=target,
            change=target - rows,
            left=np.linalg.norm(left[:, :3], axis=1),
            left_angle=np.linalg.norm(left[:, 3:], axis=1),
            near_singular=np.asarray(least < SINGULAR),
            inside=self.compensator.inside(target),
        )

    def _pose(self, q: Any) -> tuple[Any, Any]:
        """Compensated position [m] and orientation at q."""
        p, R = self.robot.pose(q, self.robot.parameters.values)
        return p + 1e-3 * self.compensator.function()(q), R

    def _goal(self, q: Any) -> Any:
        """Nominal position and orientation at q, shape (12,), column by column."""
        if self.nominal is None:
            raise InputError(
                "the nominal model is not known: give compensated() an Identification, or name it with nominal="
            )
        p, R = self.nominal.pose(q, self.nominal.parameters.values)
        return ca.vertcat(p, ca.reshape(R, 9, 1))

    @cached_property
    def _goals(self) -> ca.Function:
        q = ca.SX.sym("q", self.robot.n)
        return ca.Function("nominal", [q], [self._goal(q)], ["q"], ["goal"])

    def _round(self, orientation: bool, steps: int) -> ca.Function:
        """chord:(start[n], goal[12])->(target[n], left, J): one Jacobian, factored once, and steps with it."""
        start, goal = ca.SX.sym("start", self.robot.n), ca.SX.sym("goal", 12)
        results = self._chord(start, goal, orientation, steps)
        return ca.Function("chord", [start, goal], list(results), ["start", "goal"], ["target", "left", "J"])

    def _chord(self, start: Any, goal: Any, orientation: bool, steps: int) -> tuple[Any, Any, Any]:
        """Joint target, what is left, and the Jacobian at the start."""
        q = ca.SX.sym("at", self.robot.n)
        left = ca.Function("left", [q, goal], [self._left(q, goal, orientation)])
        J = ca.substitute(-ca.jacobian(left(q, goal), q), q, start)
        # The smaller of the two normal matrices: its damping alone makes it regular.
        square = (J @ J.T if J.shape[0] <= J.shape[1] else J.T @ J) + DAMPING**2 * ca.SX.eye(min(J.shape))
        D, LT, order = ca.ldl(square)
        target = start
        for _ in range(steps):
            e = left(target, goal)
            if J.shape[0] <= J.shape[1]:
                step = J.T @ ca.ldl_solve(e, D, LT, order)
            else:
                step = ca.ldl_solve(J.T @ e, D, LT, order)
            target = target + step * ca.fmin(1, LARGEST_STEP / ca.fmax(ca.norm_inf(step), LARGEST_STEP))
        return target, left(target, goal), J

    def _left(self, q: Any, goal: Any, orientation: bool) -> Any:
        """From the compensated pose at q to the goal: position [m] and, if asked for, rotation vector [rad]."""
        p, R = self._pose(q)
        aim = ca.reshape(goal[3:], 3, 3)
        turn = 0.5 * sum(ca.cross(R[:, k], aim[:, k]) for k in range(3))
        return ca.vertcat(goal[:3] - p, turn) if orientation else goal[:3] - p


def compensated(
    robot: Robot | Identification, compensator: Compensator, *, nominal: Robot | None = None
) -> Compensated:
    """A calibrated robot together with the compensator that was trained on what its calibration left.

    robot : calibrated, or the identification itself, which also knows the nominal model
    nominal : what the controller takes the robot for, in the measuring frame of the calibrated one; default: of an
    identification, its given robot with base and tool fitted

    Raises InputError where the compensator has another number of joints or does not correct three coordinates.
    """
    if isinstance(robot, Identification):
        nominal = nominal or robot.placed
        robot = robot.robot
    layout = compensator.layout
    if (layout.joints, layout.outputs) != (robot.n, 3):
        raise InputError(
            f"the compensator takes {layout.joints} joints and corrects {layout.outputs} coordinates; "
            f"{robot.name} has {robot.n} joints and 3 coordinates: it belongs to another robot"
        )
    if nominal is not None and nominal.n != robot.n:
        raise InputError(f"nominal: {nominal.name} has {nominal.n} joints, {robot.name} has {robot.n}")
    return Compensated(robot, compensator, nominal)


def _rows(q: Array, robot: Robot) -> Array:
    rows: Array = np.asarray(q, dtype=np.float64)
    rows = rows[None] if rows.ndim == 1 else rows
    if rows.ndim != 2 or rows.shape[1] != robot.n or not len(rows):
        raise InputError(f"q must have shape (n, {robot.n}) [rad or m]; its shape is {np.shape(q)}")
    bad = np.argwhere(~np.isfinite(rows))
    if len(bad):
        raise InputError(f"q[{bad[0][0]}, {bad[0][1]}] is {rows[tuple(bad[0])]}; joint angles must be finite")
    return rows


def _stacked(J: Array, n: int) -> Array:
    """Jacobians side by side, shape (m, n * joints), as an array of shape (n, m, joints)."""
    return J.reshape(len(J), n, -1).transpose(1, 0, 2)
