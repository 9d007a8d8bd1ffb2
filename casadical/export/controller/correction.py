"""Correct joint targets, by a model or by the compiled C of an export.

A target is corrected in all joints or in none: unless its status is one of `CORRECTED_STATUSES`, it
remains unchanged.

The joints' error curves are one function that the C calls as a table, in the correction of a
command and alone: a curve of 60 harmonics takes some 600 operations, a table some 30. The model
takes the curves' values as parameters, so that everything else in it (deflections, other effects)
depends on the joint variables without them, as in the robot.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from casadical.core.basics import Array, CasadicalError, InputError
from casadical.core.transforms import Symbolic
from casadical.effects import Effect, JointErrorCurve
from casadical.effects.base import Context
from casadical.export.c.kernel import load
from casadical.export.c.products import Command, NetworkFunction, mapped
from casadical.export.c.reference import Status
from casadical.export.c.reference import correct as reference_correct
from casadical.export.c.tape_program import tape_program
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


# Statuses of targets that are corrected.
CORRECTED_STATUSES = (Status.OK.name, "POSITION_ONLY")

# Reason, in words, why a target with this status is not corrected.
STATUS_MEANINGS = {
    Status.CLAMPED.name: "outside the joint ranges of the model",
    "LEAVES_BOX": "the corrected targets would be outside the joint ranges of the model",
    Status.NOT_CONVERGED.name: "an error above the tolerance would remain",
    Status.LIMITED.name: "the correction would exceed its limit",
    Status.SINGULAR.name: "near a pose in which the tool cannot move in some direction",
    Status.NOT_FINITE.name: "the model has no value there; a four-bar cannot close, for instance",
}


@dataclass(frozen=True, eq=False)
class Corrector:
    """A function that corrects joint targets: the compiled C of an export, or a model.

    joints : number of joints
    correct : function of joint targets, shape (k, joints) [rad or m], that returns corrections to
        add, of the same shape and unit, and a `Status` of each target, shape (k,)
    position : function of joint targets that returns the calibrated tool's positions in the robot's
        own base frame, shape (k, 3) [m]
    fallback : corrector of the position alone, for targets whose pose cannot be corrected; None:
        these targets remain unchanged
    units : "rad" or "m" of each joint's reading; empty: all rad
    nominal, real : CasADi functions q[n] -> (p[3] [m], R[3x3]) of the tool's pose in the robot's
        own base frame, by the nominal and the calibrated robot; None: not known
    """

    joints: int
    correct: Callable[[Array], tuple[Array, Array]]
    position: Callable[[Array], Array]
    fallback: "Corrector | None" = None
    units: tuple[str, ...] = ()
    nominal: ca.Function | None = None
    real: ca.Function | None = None


def kernel_corrector(folder: Path, *, trust: bool = False) -> Corrector:
    """Return the corrector that calls the C in an export folder, which is compiled here.

    trust : whether the C of a folder that was not exported here is compiled and run, as of `load`
    Raises InputError: as of `load`, or the folder holds no correction of a command.
    """
    try:
        kernel = load(folder, trust=trust)
    except InputError:
        raise
    except CasadicalError as error:
        raise InputError(f"{folder}: {error}; or give the robot file in place of the folder") from None
    if "correct" not in kernel.shape.outputs:
        raise InputError(f"{folder}: holds no correction of a command; export with --what command")

    def rows(function: str, q: Array) -> tuple[Array, Array]:
        """Return values of an exported function at joints q as doubles, and statuses."""
        values, status = kernel.rows(function, q)
        return np.asarray(values, dtype=float), status

    shape = kernel.shape
    return Corrector(
        shape.joints,
        lambda q: rows("correct", q),
        lambda q: rows("forward", q)[0][:, :3],
        units=tuple(shape.units),
    )


def model_corrector(command: Command, fallback: Corrector | None = None) -> Corrector:
    """Return the corrector that evaluates a command in NumPy, with the bits of the exported C.

    command : correction of joint commands, evaluated in double
    fallback : as of `Corrector`

    Examples
    --------
    >>> command = casadical.export.command_of(casadical.export.Sources(found.robot, robot))
    >>> corrector = casadical.export.model_corrector(command)
    >>> dq, status = corrector.correct(poses.q[:3])
    >>> dq.shape, status
    ((3, 2), array([0, 0, 5]))
    """
    made = tape_program(command, "double")
    return Corrector(
        made.n,
        lambda q: reference_correct(made, q),
        lambda q: mapped(command.calibrated, q)[:, :3],
        fallback,
        command.units,
    )


def corrected_joints(corrector: Corrector, q: Array) -> tuple[Array, tuple[str, ...]]:
    """Return corrected joint targets, shape (k, n) [rad or m], and the name of each one's status.

    Targets whose status is none of `CORRECTED_STATUSES` are returned unchanged. The names are those
    of `Status`, LEAVES_BOX (corrected joints outside the box) and POSITION_ONLY (by the fallback).

    q : joint targets, shape (k, n) [rad or m]
    """
    dq, status = corrector.correct(q)
    names = [Status(int(s)).name for s in status]
    beyond = corrector.correct(q + dq)[1] == Status.CLAMPED
    names = ["LEAVES_BOX" if b and n == Status.OK.name else n for b, n in zip(beyond, names, strict=True)]
    fine = np.array([n == Status.OK.name for n in names])
    new = np.where(fine[:, None], q + dq, q)
    if corrector.fallback is not None and not fine.all():
        other, reached = corrected_joints(corrector.fallback, q[~fine])
        for k, joints, name in zip(np.flatnonzero(~fine), other, reached, strict=True):
            if name in CORRECTED_STATUSES:
                new[k], names[k] = joints, "POSITION_ONLY"
    return new, tuple(names)


def position_only(status: tuple[str, ...]) -> str:
    """Return a remark on the number of targets corrected in position only; "" if there are none.

    status : name of each target's status
    """
    count = status.count("POSITION_ONLY")
    return f" ({count} in position only, near poses in which the orientation cannot be corrected)" if count else ""
