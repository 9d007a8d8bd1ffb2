"""CasADi functions of a robot for its correction: joint error curves, tool pose, deflections.

The error curves are one function that the C calls as a table, in the correction of a command and
alone: a curve of 60 harmonics takes some 600 operations, a table some 30. The model takes the
curves' values as parameters, so that everything else in it (deflections, other effects) depends on
the joint variables without them, as in the robot.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.transforms import Symbolic
from casadical.effects import Effect, JointErrorCurve
from casadical.effects.base import Context
from casadical.export.c.products import NetworkFunction
from casadical.robot.robot import Robot


@dataclass(frozen=True)
class GivenAngles(Effect):
    """Effect that adds a parameter of its own to each joint's angle: `z1`, `z2`, .. [rad].

    joints : number of joints
    """

    joints: int = 6

    name = "given_angles"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return (typical size, SI unit) of each parameter, by its name."""
        return {f"z{joint}": (1.0, "rad") for joint in range(1, self.joints + 1)}

    def joint_angle(self, context: Context) -> Symbolic:
        """Return the parameters as additions to the joint angles, shape (joints,) [rad]."""
        return ca.vertcat(*[self.value(context, name) for name in self.sizes()])


def joint_curves(robot: Robot) -> ca.Function | None:
    """Return the CasADi function of the joints' error curves, q[n] -> dq[n] [rad].

    q are the variables of the DH rows, dq true angles less q, 0 for a joint without coefficients.
    The function is called and not inlined, so that the C makes tables of it. None is returned for a
    robot without curves.
    """
    curves = [e for e in robot.effects if isinstance(e, JointErrorCurve)]
    if not curves:
        return None
    values = {p.name: p.value for p in robot.parameters}
    q = ca.SX.sym("q", robot.n)
    context = Context(robot, np.zeros(robot.n), q, {}, values, (), None)
    moved = sum((e.joint_angle(context) for e in curves), ca.SX.zeros(robot.n))
    return ca.Function("joint_curves", [q], [ca.densify(moved)], {"never_inline": True})


def without_curves(robot: Robot) -> Robot:
    """Return the robot without its joint error curves."""
    return robot.with_only(e for e in robot.effects if not isinstance(e, JointErrorCurve))


def variables_of(robot: Robot, q: ca.SX) -> ca.SX:
    """Return the variable of each DH row, shape (n,), at the controller's readings q[n] [rad or m].

    Readings of coupled and locked joints are replaced by those that follow from the others.
    """
    led = {i: joint.coupling for i, joint in enumerate(robot.joints) if joint.coupling}
    if led:
        q = ca.vertcat(
            *(led[i].at + sum(k * q[j - 1] for j, k in led[i].follows) if i in led else q[i] for i in range(robot.n))
        )
    A, b = robot.reading_map
    return ca.SX(ca.sparsify(ca.DM(A)) @ q + ca.sparsify(ca.DM(b))) if robot.counts_otherwise else q


def pose_of(robot: Robot, q: ca.SX) -> list[ca.SX]:
    """Return the tool's symbolic p[3] [m] and rotation R[3x3] at the controller's readings q[n].

    They are in the frame of the robot's model: the measuring frame, or the base frame where the
    base is the identity; other conditions than joints have their declared values. Error curves are
    a function call, see `joint_curves`.
    """
    curves = joint_curves(robot)
    values, q = robot.parameters.values, variables_of(robot, q)
    if curves is None:
        return list(robot.pose.call([q, ca.DM(values)]))
    given = GivenAngles(None, robot.n)
    model = without_curves(robot).with_effect(given)
    names = [f"{given.label}.{name}" for name in given.sizes()]
    phi = ca.SX(model.parameters.values)
    phi[[model.parameters.index_of(name) for name in names]] = curves(q)
    return list(model.pose.call([q, phi]))


def tool_function(
    robot: Robot, name: str, orientation: bool, turn: Array | None = None, network: NetworkFunction | None = None
) -> ca.Function:
    """Return the CasADi function NAME: q[n] [rad or m] -> p[3] [m], or -> (p[3] [m], R[3x3]).

    q are controller's readings, p and R the tool's pose in the model's frame, as of `pose_of`.

    orientation : whether R is an output
    turn : rotation from the measuring frame, in which the network was trained, into the robot's
        base frame, shape (3, 3); None: none
    network : network whose position correction is added; None: none
    """
    q = ca.SX.sym("q", robot.n)
    p, R = pose_of(robot, q)
    if network is not None:
        seen = network.function(variables_of(robot, q))
        p = p + 1e-3 * ca.mtimes(ca.DM(np.eye(3) if turn is None else turn), seen)
    return ca.Function(name, [q], [p, R] if orientation else [p], ["q"], ["p", "R"] if orientation else ["p"])


def deflected_function(robot: Robot) -> ca.Function:
    """Return the CasADi function of the controller's readings deflected under gravity.

    bent:(q[n])->(q + compliance times torque of each joint, in readings, n numbers) [rad or m]
    """
    q = ca.SX.sym("q", robot.n)
    soft = ca.DM([j.compliance or 0.0 for j in robot.joints])
    bent = soft * robot.torque(variables_of(robot, q), ca.DM(robot.parameters.values))
    if robot.counts_otherwise:
        bent = ca.sparsify(ca.DM(np.linalg.inv(robot.reading_map[0]))) @ bent
    return ca.Function("bent", [q], [q + bent], ["q"], ["bent"])
