"""A surface under the tool on which an arm comes to rest: found where replays would go through it, kept above in them.

One number, the height of the tool's point as it touches. Where a step would end lower, the least push upwards that
prevents it acts at all joints by the slope of the height over their angles: a unilateral constraint, stepped implicitly
(Moreau 1988), without friction along the surface.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import first_of_best
from casadical.robot.dynamics import Dynamics

# Heights that are tried above the lowest one that was read [m]; noise of a height at least [m].
WITHIN, EVERY, LEAST = 0.06, 5e-4, 1e-3
# A surface gains so much log evidence, as a contact in a log does. Of the samples so many tell something new; residuals
# beyond so many sigma weigh less.
CERTAIN, EFFECTIVE, OUTLIER = 150.0, 0.05, 3.0
# The tool is at the surface while it is less above it [m].
AT = 4e-3
# Steps to the least push; a step may end so much lower [m].
ROUNDS, ENOUGH = 6, 1e-5


@dataclass(frozen=True, eq=False)
class Floor:
    """A surface across gravity. height : of the tool's point at it, over the measuring frame's origin [m]"""

    dynamics: Dynamics
    height: float = 0.0

    @cached_property
    def function(self) -> ca.Function:
        """height:(q[n] rad)->(height of the tool's point [m], its slope over the readings [n])."""
        robot, q = self.dynamics.robot, ca.SX.sym("q", self.dynamics.robot.n)
        z = ca.dot(ca.DM(up_of(self.dynamics)), robot.position(q, robot.parameters.values))
        return ca.Function("height", [q], [z, ca.jacobian(z, q).T])

    def above(self, q: Array) -> Array:
        """How far the tool is above the surface [m], shape (...); q : shape (..., n)."""
        flat = q.reshape(-1, q.shape[-1])
        z = self.function.map(len(flat))(flat.T)[0]
        return np.asarray(z).reshape(q.shape[:-1]) - self.height

    def torque(self, ends: Callable[[Array], Array], give: Array, push: float) -> tuple[Array, float]:
        """What acts at the joints so that a step ends at the surface or above it, (joints,) [N m], and the push [N].

        ends : angles at the end of a step under such torques; give : of these angles to them, sliding, (joints,)
        push : of the step before; it is 0, and no torque acts, where the step ends above anyway
        """
        torque = np.zeros(len(give))
        z, slope = self.function(ends(torque))
        if float(z) >= self.height:
            return torque, 0.0
        for _ in range(ROUNDS):
            lever = np.asarray(slope).ravel()
            torque = push * lever
            z, slope = self.function(ends(torque))
            low = float(z) - self.height
            if abs(low) < ENOUGH:
                break
            push = max(0.0, push - low / float((lever**2 * give).sum()))
        return torque, push


def up_of(dynamics: Dynamics) -> Array:
    """Against gravity, in the measuring frame, shape (3,)."""
    gravity = dynamics.robot.base.T[:3, :3] @ dynamics.gravity
    return np.asarray(-gravity / (np.linalg.norm(gravity) + 1e-300))


def floor_of(dynamics: Dynamics, read: Array, replayed: Array) -> Floor | None:
    """The surface below which replays go and readings do not; None where there is no good sign of one.

    read, replayed : readings, and those of a replay that knows no surface, shape (samples, joints)
    """
    if not up_of(dynamics).any():
        return None
    floor = Floor(dynamics)
    there, said = floor.above(read), floor.above(replayed)
    # Of a quarter of the samples, for many may be at a surface.
    sigma = float(np.quantile(np.abs(there - said), 0.25)) / 0.3186 + LEAST

    def cost(heights: Array) -> float:
        wide = np.sqrt(1 + ((there - heights) / (OUTLIER * sigma)) ** 2) - 1
        return EFFECTIVE * OUTLIER**2 * float(wide.sum())

    tried = there.min() + np.arange(0.0, WITHIN, EVERY)
    costs = np.array([cost(np.maximum(said, height)) for height in tried])
    best = first_of_best(-costs, logs=True)
    return Floor(dynamics, float(tried[best])) if cost(said) - costs[best] > CERTAIN else None
