"""The functions of the joints that a correction is made of: the tool of a robot, and how far two robots are apart."""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.export.c.differences import changed
from casadical.export.c.products import NetworkFunction, mapped
from casadical.export.controller.curves import GivenAngles, joint_curves, pose_of, without_curves
from casadical.robot.robot import Robot

ROUNDING = 1e-9  # m or rad


def tool_function(
    robot: Robot, name: str, orientation: bool, turn: Array | None = None, network: NetworkFunction | None = None
) -> ca.Function:
    """NAME:(q[n] rad or m)->(p[3] m) or (p[3] m, R[3x3]).

    turn : rotation from the measuring frame, in which the network learned, into the robot's, shape (3, 3); None: none
    """
    q = ca.SX.sym("q", robot.n)
    p, R = pose_of(robot, q)
    if network is not None:
        p = p + 1e-3 * ca.mtimes(ca.DM(np.eye(3) if turn is None else turn), network.function(q))
    return ca.Function(name, [q], [p, R] if orientation else [p], ["q"], ["p", "R"] if orientation else ["p"])


def bent_function(robot: Robot) -> ca.Function:
    """bent:(q[n])->(joints with their deflections [rad or m])."""
    q = ca.SX.sym("q", robot.n)
    soft = ca.DM([j.compliance or 0.0 for j in robot.joints])
    return ca.Function("bent", [q], [q + soft * robot.torque(q, ca.DM(robot.parameters.values))], ["q"], ["bent"])


def difference_function(
    real: Robot, nominal: Robot, orientation: bool, turn: Array, network: NetworkFunction | None
) -> ca.Function:
    """difference:(q[n], dq[n])->(dp[3] m) or (dp, dR[3x3]): the real robot at q + dq less the nominal one at q.

    Nothing cancels (`export.c.differences`): one model, whose parameters and joints change from nominal to real.
    turn, network : as of `tool_function`. Raises InputError where the real robot's model cannot be the nominal one's.
    """
    q, dq = ca.SX.sym("q", real.n), ca.SX.sym("dq", real.n)
    curves = joint_curves(real)
    given = GivenAngles(None, real.n)
    model = real if curves is None else without_curves(real).with_effect(given)
    nominal_values = {p.name: p.value for p in nominal.parameters}
    before = np.array([nominal_values.get(name, 0.0) for name in model.parameters.names])
    _refuse_other(model, before, nominal)
    change = ca.SX(model.parameters.values - before)
    if curves is not None:
        change[[model.parameters.index_of(f"{given.label}.{name}") for name in given.sizes()]] = curves(q + dq)
    dp, dR = changed(model.pose, [q, ca.SX(before)], [dq, change])
    if network is not None:
        dp = dp + 1e-3 * ca.mtimes(ca.DM(turn), network.function(q + dq))
    out = [ca.densify(part) for part in ([dp, dR] if orientation else [dp])]
    return ca.Function("difference", [q, dq], out, ["q", "dq"], ["dp", "dR"][: len(out)])


def _refuse_other(model: Robot, before: Array, nominal: Robot) -> None:
    """Raises InputError where the model with nominal parameters is not the nominal robot."""
    q = ca.SX.sym("q", model.n)
    poses = np.random.default_rng(0).uniform(*nominal.limits, (50, model.n))
    mine, theirs = (
        mapped(ca.Function("pose", [q], pose), poses)
        for pose in (list(model.pose.call([q, ca.DM(before)])), pose_of(nominal, q))
    )
    off = abs(mine - theirs)[np.isfinite(theirs).all(axis=1)]
    if not np.all(off < ROUNDING):
        raise InputError(
            f"{model.name}: its model does not become that of {nominal.name} by its parameters (off by "
            f"{1e3 * np.max(off):.3g} mm), which --precise needs: leave it out, or give --tool shared"
        )
