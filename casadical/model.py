"""The symbolic model: chain, loops, gravity torques, compliance and effects composed into CasADi functions.

The deflection is added to the joint variables inside the kinematics, not through the linearised J dtheta of the
paper's eq. 5. Torques are those of the robot that has sunk once under its own: what is left to equilibrium falls with
the cube of the compliance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import casadi as ca

from .effects import Context
from .kinematics import Values, link_frames, loop_margins
from .statics import deflections, gravity_energy, gravity_torques
from .transforms import Symbolic, rot_x, rot_y, rot_z, small_frame, translate

if TYPE_CHECKING:
    from .robot import Robot


@dataclass(frozen=True, eq=False)
class Model:
    """Symbols and expressions of one robot; functions are made from them.

    q : joint readings (n,) [rad or m]; w : conditions (k,); phi : parameters (P,) [SI]
    p, R : position (3,) [m] and orientation (3, 3) of the tool frame in the measuring frame
    tau : gravity torques (n,) [N m or N]; margin : of each loop
    """

    robot: Robot
    q: ca.SX
    w: ca.SX
    phi: ca.SX
    p: ca.SX
    R: ca.SX
    tau: ca.SX
    margin: ca.SX

    def function(self, name: str, outputs: tuple[str, ...]) -> ca.Function:
        """name:(q, w, phi)->outputs, out of p, R, tau, margin."""
        return ca.Function(
            name, [self.q, self.w, self.phi], [getattr(self, o) for o in outputs], ["q", "w", "phi"], list(outputs)
        )

    def at_declared(self, name: str, outputs: tuple[str, ...]) -> ca.Function:
        """name:(q, phi)->outputs, every logged condition at its declared value."""
        results = self.function(name, outputs).call([self.q, ca.DM(self.robot.declared), self.phi])
        return ca.Function(name, [self.q, self.phi], results, ["q", "phi"], list(outputs))


def build(robot: Robot, *, fixed_loads: bool = False) -> Model:
    """Compose the model of a robot from its parts.

    fixed_loads : whether gravity torques are those of the nominal geometry. Strictly, a longer last link also carries
        its load farther out; the masses are not known well enough to tell the link from the tool by that.
    """
    q = ca.SX.sym("q", robot.n)
    w = ca.SX.sym("w", len(robot.conditions))
    phi = ca.SX.sym("phi", len(robot.parameters))
    values: dict[str, Symbolic] = dict(zip(robot.parameters.names, ca.vertsplit(phi), strict=True))
    conditions = dict(zip(robot.conditions, ca.vertsplit(w) if robot.conditions else [], strict=True))

    T_M0 = base_frame(robot, values)
    readings = ca.vertsplit(q)
    at = dict(zip(robot.parameters.names, robot.parameters.values, strict=True)) if fixed_loads else values
    gravity = gravity_in_base(robot, base_frame(robot, at))
    rigid = link_frames(robot, readings, at)
    unloaded = Context(robot, q, conditions, values, rigid, gravity)
    energy = gravity_energy(robot, rigid, gravity, conditions.get("payload_kg", 0.0))
    energy = energy + sum(e.energy(unloaded) for e in robot.effects)
    tau = gravity_torques(ca.SX(energy), q)
    tau = ca.substitute(tau, q, q + deflections(robot, tau, values))
    loaded = replace(unloaded, torque=tau)
    T_ME = _tool_frame(robot, T_M0, loaded)
    point = T_ME[:3, 3]
    for effect in robot.effects:
        point = effect.measurement(point, loaded)
    margin = ca.vertcat(*loop_margins(robot, readings, values)) if robot.loops else ca.SX.zeros(0)
    return Model(robot, q, w, phi, ca.SX(point), ca.SX(T_ME[:3, :3]), ca.SX(tau), ca.SX(margin))


def gravity_in_base(robot: Robot, T_M0: Symbolic) -> Symbolic:
    """Gravity in the robot's base frame, shape (3,) [m/s^2]."""
    gravity = ca.DM(robot.gravity)
    return T_M0[:3, :3].T @ gravity if robot.gravity_frame == "measuring" else gravity


def base_frame(robot: Robot, values: Values) -> Symbolic:
    """T_M0, the robot's base in the measuring frame, shape (4, 4)."""
    T = ca.DM(robot.base.T)
    if robot.base.unknown == "none":
        return T
    return T @ small_frame(*(values.get(f"base_{c}", 0.0) for c in ("x", "y", "z", "rx", "ry", "rz")))


def _tool_frame(robot: Robot, T_M0: Symbolic, context: Context) -> Symbolic:
    """T_ME: readings, effects and deflections through the chain, then flange effects and tool."""
    values = context.values
    moved = context.q + deflections(robot, context.torque, values)
    for effect in robot.effects:
        moved = moved + effect.joint_angle(context)
    errors = None
    if robot.effects:
        errors = []
        for i in range(1, robot.n + 1):
            error = ca.SX.eye(4)
            for effect in robot.effects:
                error = error @ effect.link(i, context)
            errors.append(error)
    T = T_M0
    for effect in robot.effects:
        T = T @ effect.base(context)
    T = T @ link_frames(robot, ca.vertsplit(moved), values, errors)[-1]
    for effect in robot.effects:
        T = T @ effect.tool(context)
    return T @ _tool(robot, values)


def _tool(robot: Robot, values: Values) -> Symbolic:
    nominal = robot.tool.T
    x, y, z = (values.get(f"tool_{c}", nominal[k, 3]) for k, c in enumerate("xyz"))
    turn = ca.DM(nominal)
    turn[:3, 3] = 0
    T = translate(x, y, z) @ turn
    for make, c in ((rot_x, "rx"), (rot_y, "ry"), (rot_z, "rz")):
        if f"tool_{c}" in values:
            T = T @ make(values[f"tool_{c}"])
    return T
