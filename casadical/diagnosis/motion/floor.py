"""A surface on which the tool comes to rest, and stops of joints, found in logs and replayed.

The surface has one parameter, the height of the tool's point in contact. Where a step would end below, the
smallest upward force that prevents it acts on all joints through the gradient of the height: a
unilateral constraint, stepped implicitly (Moreau 1988), without friction along the surface.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import first_of_best
from casadical.measurements.logs.log import JointLog
from casadical.robot.dynamics import Dynamics

# Fraction of the samples that count as independent, as noise is correlated.
INDEPENDENT_SAMPLE_FRACTION = 0.05
# Residuals beyond this many standard deviations get less weight (pseudo-Huber).
OUTLIER_SIGMAS = 3.0
CONTACT_MARGIN_M = 4e-3  # the tool counts as in contact up to this height above the surface [m]


@dataclass(frozen=True, eq=False)
class Floor:
    """A surface perpendicular to gravity.

    height : height of the tool point in contact above the measuring frame's origin [m]
    """

    dynamics: Dynamics
    height: float = 0.0

    @cached_property
    def function(self) -> ca.Function:
        """Return the function q[n] [rad] -> (height of the tool point [m], gradient[n] [m/rad]).

        The height is that above the measuring frame's origin.
        """
        robot, q = self.dynamics.robot, ca.SX.sym("q", self.dynamics.robot.n)
        z = ca.dot(ca.DM(up_of(self.dynamics)), robot.position(q, robot.parameters.values))
        return ca.Function("height", [q], [z, ca.jacobian(z, q).T])

    def above(self, q: Array) -> Array:
        """Return the height of the tool point above the surface, shape (...) [m].

        q : joint angles, shape (..., n) [rad]
        """
        flat = q.reshape(-1, q.shape[-1])
        z = self.function.map(len(flat))(flat.T)[0]
        return np.asarray(z).reshape(q.shape[:-1]) - self.height

    def contact(self, ends: Callable[[Array], Array], compliance: Array, force: float) -> tuple[Array, float]:
        """Return the joint torques (joints,) [N m] and the force [N] of the contact in one time step.

        Newton's method finds the force with which the step ends on the surface. Both are 0 where
        the step ends above the surface without contact.
        ends : function of joint torques [N m] that returns the angles at the end of the step [rad]
        compliance : derivative of each angle by its own torque in sliding, (joints,) [rad/(N m)]
        force : contact force of the previous step, from which the iteration starts [N]
        """
        torque = np.zeros(len(compliance))
        z, slope = self.function(ends(torque))
        if float(z) >= self.height:
            return torque, 0.0
        # Largest number of Newton steps to the contact force.
        for _ in range(6):
            lever = np.asarray(slope).ravel()
            torque = force * lever
            z, slope = self.function(ends(torque))
            low = float(z) - self.height
            # Largest height error of a converged contact force [m].
            if abs(low) < 1e-5:
                break
            force = max(0.0, force - low / float((lever**2 * compliance).sum()))
        return torque, force


def up_of(dynamics: Dynamics) -> Array:
    """Return the unit vector against gravity in the measuring frame, (3,), zeros without any."""
    gravity = dynamics.robot.base.T[:3, :3] @ dynamics.gravity
    return np.asarray(-gravity / (np.linalg.norm(gravity) + 1e-300))


def floor_of(dynamics: Dynamics, read: Array, replayed: Array) -> Floor | None:
    """Return the surface below which replays go and readings do not; None without clear evidence.

    read, replayed : angles, measured and by a replay without surface, (samples, joints) [rad]
    """
    if not up_of(dynamics).any():
        return None
    floor = Floor(dynamics)
    read_heights, replayed_heights = floor.above(read), floor.above(replayed)
    # From the lower quartile, as many samples may be in contact with a surface.
    # Added to the estimated standard deviation of the tool's height [m].
    sigma = float(np.quantile(np.abs(read_heights - replayed_heights), 0.25)) / 0.3186 + 1e-3

    def cost(heights: Array) -> float:
        """Return the pseudo-Huber cost of replayed heights against those read [nats]."""
        wide = np.sqrt(1 + ((read_heights - heights) / (OUTLIER_SIGMAS * sigma)) ** 2) - 1
        return INDEPENDENT_SAMPLE_FRACTION * OUTLIER_SIGMAS**2 * float(wide.sum())

    # Candidate heights of a surface are up to 60 mm above the tool's lowest one, in steps of 0.5 mm.
    tried = read_heights.min() + np.arange(0.0, 0.06, 5e-4)
    costs = np.array([cost(np.maximum(replayed_heights, height)) for height in tried])
    best = first_of_best(-costs, logs=True)
    # Log evidence [nats] from which a surface is assumed.
    return Floor(dynamics, float(tried[best])) if cost(replayed_heights) - costs[best] > 150.0 else None


@dataclass(frozen=True)
class Stop:
    """An angle at which a joint stops while its commands go on.

    joint : index of the joint, from 0; way : 1 at the upper end, -1 at the lower; angle : [rad]
    beyond : farthest command beyond it [rad]; seconds : time with commands beyond it [s]
    effort : mean absolute torque or current there and elsewhere, None where neither was logged
    """

    joint: int
    way: int
    angle: float
    beyond: float
    seconds: float
    effort: tuple[float, float] | None


def stops_of(dynamics: Dynamics, runs: Sequence[JointLog]) -> list[Stop]:
    """Return the stops that commands and readings of some runs of one arm show.

    While commands are far beyond the joint's extreme reading and differ from each other, the
    reading stays, and the effort, which may lack its sign, is several times that elsewhere. Where
    the tool is as low as in no other part of the runs, it may rest on a surface instead.
    """
    found = []
    runs = [run for run in runs if run.command is not None and run.step]
    heights = [Floor(dynamics).above(np.nan_to_num(run.position)) for run in runs] if up_of(dynamics).any() else []
    low = np.concatenate(heights) < np.min(np.concatenate(heights)) + 4 * CONTACT_MARGIN_M if heights else None
    for j, way in ((j, way) for j in range(len(runs[0].joints) if runs else 0) for way in (-1, 1)):
        c, q = (
            np.concatenate([way * np.asarray(v)[:, j] for v in each])
            for each in ([run.command for run in runs], [run.position for run in runs])
        )
        finite = np.isfinite(c) & np.isfinite(q)
        effort = [run.current if run.torque is None else run.torque for run in runs]
        push = None if any(e is None for e in effort) else np.concatenate([np.abs(np.asarray(e)[:, j]) for e in effort])
        step = np.concatenate([np.full(len(run), run.step) for run in runs])[finite]
        c, q = c[finite], q[finite]
        if not len(q):
            continue
        behind = c > q.max() + 0.05  # stiction leaves an error of less
        stays = behind & (q > q.max() - 0.01)
        if low is not None and stays.any() and low[finite][stays].mean() > 0.5:
            continue
        if step[stays].sum() < 0.3 or stays.sum() < 0.8 * behind.sum() or np.ptp(c[stays]) < 0.05:
            continue
        pushes = None
        if push is not None and np.isfinite(push[finite]).all() and not stays.all():
            pushes = float(push[finite][stays].mean()), float(push[finite][~behind].mean())
            if pushes[0] < 2 * pushes[1]:
                continue
        angle = float(np.median(q[stays]))
        found.append(Stop(j, way, way * angle, float(c.max() - angle), float(step[stays].sum()), pushes))
    return found
