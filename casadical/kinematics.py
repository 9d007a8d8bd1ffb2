"""The open chain with its loops: actuated joint variables to link frames (paper, eqs. 1-3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import casadi as ca

from . import fourbar
from .transforms import Symbolic, rot_x, rot_y, rot_z, translate

if TYPE_CHECKING:
    from .robot import FourBar, Robot

Values = Mapping[str, Symbolic]


def row_transform(robot: Robot, i: int, variable: Symbolic, values: Values) -> Symbolic:
    """Frame i in frame i-1 (1-based), shape (4, 4), for the joint's own variable [rad or m]."""
    theta, d = values[f"theta{i}"], values[f"d{i}"]
    if robot.joints[i - 1].kind == "revolute":
        theta = theta + variable
    else:
        d = d + variable
    T = rot_x(values[f"alpha{i - 1}"]) @ translate(values[f"a{i - 1}"], 0, 0)
    if f"beta{i - 1}" in values:
        T = T @ rot_y(values[f"beta{i - 1}"])
    if f"b{i - 1}" in values:
        T = T @ translate(0, values[f"b{i - 1}"], 0)
    return T @ rot_z(theta) @ translate(0, 0, d)


def loop_bars(robot: Robot, number: int, values: Values) -> tuple[Symbolic, Symbolic, Symbolic, Symbolic]:
    """Crank L5, coupler L4, rocker L3 and ground bar of loop `number` (1-based) [m]."""
    loop = robot.loops[number - 1]
    suffix = "" if number == 1 else f"_{number}"
    return (*(values[f"{bar}{suffix}"] for bar in ("L5", "L4", "L3")), values[f"a{loop.driven - 1}"])


def loop_angles(loop: FourBar, actuated: Sequence[Symbolic], values: Values) -> tuple[Symbolic, Symbolic]:
    """Angles of crank and ground bar [rad] in the plane of the loop."""
    crank = actuated[loop.driven - 1] + values[f"theta{loop.driven}"]
    ground = actuated[loop.carrier - 1] + values[f"theta{loop.carrier}"]
    return crank, ground


def loop_margins(robot: Robot, actuated: Sequence[Symbolic], values: Values) -> list[Symbolic]:
    """Feasibility margin of every loop (see `fourbar.margin`)."""
    return [
        fourbar.margin(*loop_angles(loop, actuated, values), loop_bars(robot, k, values))
        for k, loop in enumerate(robot.loops, 1)
    ]


def link_frames(
    robot: Robot, actuated: Sequence[Symbolic], values: Values, link_errors: Sequence[Symbolic] | None = None
) -> tuple[Symbolic, ...]:
    """T_01..T_0n, frames of the links in the robot's base frame, each (4, 4).

    actuated : joint variables, readings with all that is added to them, n of them [rad or m]
    link_errors : transforms behind each link, n of them (4, 4)
    """
    own = _own_variables(robot, actuated, values)
    T = ca.SX.eye(4)
    frames = []
    for i in range(1, robot.n + 1):
        T = T @ row_transform(robot, i, own[i - 1], values)
        if link_errors is not None:
            T = T @ link_errors[i - 1]
        frames.append(T)
    return tuple(frames)


def _own_variables(robot: Robot, actuated: Sequence[Symbolic], values: Values) -> list[Symbolic]:
    """The variable of each row: the actuated one, or what its loop makes of it (paper, eq. 3)."""
    own = list(actuated)
    for k, loop in enumerate(robot.loops, 1):
        crank, ground = loop_angles(loop, actuated, values)
        bars = loop_bars(robot, k, values)
        rocker = fourbar.rocker_angle(crank, ground, bars, _side(robot, k))
        # theta of the driven row turns the crank, not the link: row_transform adds it, so it is taken off here.
        own[loop.driven - 1] = rocker - ground + loop.offset - values[f"theta{loop.driven}"]
    return own


def _side(robot: Robot, number: int) -> int:
    """Assembly of the uncrossed loop, at mid range of its joints' limits."""
    loop = robot.loops[number - 1]
    middle = [0.5 * (j.lower + j.upper) for j in robot.joints]
    nominal = {p.name: p.value for p in robot.parameters}
    crank, ground = loop_angles(loop, middle, nominal)
    return fourbar.assembly_side(float(crank), float(ground), loop_bars(robot, number, nominal))
