"""Kinematics of the open chain with its loops, and gravity torques.

Actuated joint variables give link frames (paper, eqs. 1-3) and torques (eq. 4).

All bars of a closed four-bar loop lie in one plane, perpendicular to the axis of the joint that
carries the ground bar. Angles count from the x axis of its link at theta + q = 0. Ground bar,
length g, from the carrying joint (origin) to the driven joint; crank, length L5, from the origin;
coupler L4 from the crank's end to the rocker's end; rocker L3 from the driven joint and fixed to
the driven link. With L3 = L5 and L4 = g the loop is a parallelogram and the rocker turns with the
crank (paper, eq. 3).
"""

from collections.abc import Container, Mapping, Sequence

import casadi as ca
import numpy as np

from casadical.core.basics import InputError
from casadical.core.parts import Arm, FourBar
from casadical.core.transforms import Symbolic, apply, product, rot_x, rot_y, rot_z, translate
from casadical.effects import Context
from casadical.robot.parameter_list import bar_names, parameters_of

# Lengths of crank L5, coupler L4, rocker L3 and ground bar g, in this order [m].
Bars = tuple[Symbolic, Symbolic, Symbolic, Symbolic]


def _triangle(crank: Symbolic, ground: Symbolic, lengths: Bars) -> tuple[Symbolic, Symbolic, Symbolic]:
    """Return x, y and length [m] of the diagonal from driven joint to crank end, in its plane.

    crank, ground : directions of crank and ground bar [rad]
    """
    L5, _L4, _L3, g = lengths
    x = L5 * ca.cos(crank) - g * ca.cos(ground)
    y = L5 * ca.sin(crank) - g * ca.sin(ground)
    return x, y, ca.sqrt(x**2 + y**2)


def rocker_angle(crank: Symbolic, ground: Symbolic, lengths: Bars, side: int) -> Symbolic:
    """Return the direction of the rocker [rad] in the loop's plane, continuous with the crank's.

    It follows from the law of cosines in the triangle driven joint - crank end - rocker end; atan2
    keeps the digits near the folded positions. An open loop gives NaN: test `loop_margin` first.

    crank, ground : angles of crank and ground bar [rad]
    lengths : of the bars [m]
    side : +1 or -1, the side of the diagonal on which the rocker is (see `assembly_side`)
    """
    x, y, diagonal = _triangle(crank, ground, lengths)
    _, L4, L3, _ = lengths
    cosine = diagonal**2 + L3**2 - L4**2
    inner = ca.atan2(ca.sqrt((2 * diagonal * L3) ** 2 - cosine**2), cosine)
    # The angle is relative to the crank, so that no branch cut of atan2 is in the working range.
    along = x * ca.cos(crank) + y * ca.sin(crank)
    across = y * ca.cos(crank) - x * ca.sin(crank)
    return crank + ca.atan2(across, along) + side * inner


def loop_margin(crank: Symbolic, ground: Symbolic, lengths: Bars) -> Symbolic:
    """Return the squared sine of the angle between rocker and diagonal, the margin from opening.

    It is 1 where they are perpendicular, 0 at a folded position, negative for an open loop.

    crank, ground : angles of crank and ground bar [rad]; lengths : of the bars [m]
    """
    _, _, diagonal = _triangle(crank, ground, lengths)
    _, L4, L3, _ = lengths
    return 1 - ((diagonal**2 + L3**2 - L4**2) / (2 * diagonal * L3)) ** 2


def assembly_side(crank: float, ground: float, lengths: Bars) -> int:
    """Return the side (+1 or -1, see `rocker_angle`) with the smaller angle of rocker and crank.

    It is that of the uncrossed assembly.

    crank, ground : angles of crank and ground bar [rad]; lengths : of the bars [m]
    """
    candidates = {side: float(rocker_angle(crank, ground, lengths, side)) for side in (1, -1)}
    return min(candidates, key=lambda side: abs(float(ca.remainder(candidates[side] - crank, 2 * ca.pi))))


# Name of a parameter -> its value or symbol [SI].
Values = Mapping[str, Symbolic]

# Minimum `loop_margin` (a squared sine, at most 1); below it the loop counts as folded.
MIN_LOOP_MARGIN = 0.02


def row_elements(kind: str, i: int, names: Container[str]) -> tuple[list[tuple[bool, int, str]], int]:
    """Return the elementary transforms of row i (1-based), and the index of that with its variable.

    Each has whether it rotates, its axis (0 to 2), and the name of its parameter.

    kind : of the row's joint; names : of all parameters, with beta and b where the row has them
    """
    about_x = (True, 0, f"alpha{i - 1}"), (False, 0, f"a{i - 1}")
    about_y = (True, 1, f"beta{i - 1}"), (False, 1, f"b{i - 1}")
    about_z = (True, 2, f"theta{i}"), (False, 2, f"d{i}")
    row = [*about_x, *(e for e in about_y if e[2] in names), *about_z]
    return row, len(row) - (2 if kind == "revolute" else 1)


def row_factors(arm: Arm, i: int, variable: Symbolic, values: Values) -> list[Symbolic]:
    """Return the elementary transforms whose product is frame i (1-based) in frame i-1.

    variable : joint variable of the row, added to theta or d [rad or m]; values : parameters [SI]
    """
    row, driven = row_elements(arm.joints[i - 1].kind, i, values)
    factors = []
    for k, (rotates, axis, name) in enumerate(row):
        value = values[name] + variable if k == driven else values[name]
        shift = [*[0] * axis, value, *[0] * (2 - axis)]
        factors.append((rot_x, rot_y, rot_z)[axis](value) if rotates else translate(*shift))
    return factors


def loop_bars(arm: Arm, number: int, values: Values) -> Bars:
    """Return crank, coupler, rocker and ground lengths of loop `number` (1-based) [m]."""
    crank, coupler, rocker = (values[name] for name in bar_names(number).values())
    return crank, coupler, rocker, values[f"a{arm.loops[number - 1].driven - 1}"]


def loop_angles(
    loop: FourBar, actuated: Sequence[Symbolic], own: Sequence[Symbolic], values: Values
) -> tuple[Symbolic, Symbolic]:
    """Return the angles of crank and ground bar [rad] in the loop's plane.

    actuated : variables of the actuated joints; own : those of the DH rows (`own_variables`), at
        least up to the carrier's [rad or m]; values : parameters [SI]
    """
    crank = actuated[loop.driven - 1] + values[f"theta{loop.driven}"]
    ground = own[loop.carrier - 1] + values[f"theta{loop.carrier}"]
    return crank, ground


def loop_margins(arm: Arm, actuated: Sequence[Symbolic], values: Values) -> list[Symbolic]:
    """Return `loop_margin` of every four-bar: 1 perpendicular, 0 folded, below 0 open.

    actuated : variables of the actuated joints, shape (n,) [rad or m]
    """
    own = own_variables(arm, actuated, values)
    return [
        loop_margin(*loop_angles(loop, actuated, own, values), loop_bars(arm, k, values))
        for k, loop in enumerate(arm.loops, 1)
    ]


def chain_factors(arm: Arm, actuated: Sequence[Symbolic], values: Values) -> list[list[Symbolic]]:
    """Return for each row the elementary transforms whose product it is.

    actuated : actuated joint variables with all that is added to them, n of them [rad or m]
    """
    own = own_variables(arm, actuated, values)
    return [row_factors(arm, i, own[i - 1], values) for i in range(1, arm.n + 1)]


def link_frames(arm: Arm, actuated: Sequence[Symbolic], values: Values) -> tuple[Symbolic, ...]:
    """Return T_01..T_0n, frames of the links in the robot's base frame, each (4, 4) [m].

    actuated : as of `chain_factors`
    """
    T, frames = ca.SX.eye(4), []
    for row in chain_factors(arm, actuated, values):
        T = T @ product(row)
        frames.append(T)
    return tuple(frames)


def own_variables(arm: Arm, actuated: Sequence[Symbolic], values: Values) -> list[Symbolic]:
    """Return the joint variable of each DH row [rad or m], shape (n,) (paper, eq. 3).

    It is the actuated one or, for a joint that a four-bar drives, follows from its crank.

    actuated : variables of the actuated joints, shape (n,) [rad or m]
    """
    own = list(actuated)
    sides = assembly_sides(arm)
    for k in sorted(range(1, len(arm.loops) + 1), key=lambda k: arm.loops[k - 1].driven):
        angles = loop_angles(arm.loops[k - 1], actuated, own, values)
        own[arm.loops[k - 1].driven - 1] = _driven(arm, k, angles, sides[k], values)
    return own


def _driven(arm: Arm, k: int, angles: tuple[Symbolic, Symbolic], side: int, values: Values) -> Symbolic:
    """Return the joint variable [rad] of the DH row that loop k (1-based) drives.

    angles : of crank and ground bar in the loop's plane [rad]; side : of the assembly, +1 or -1
    """
    loop = arm.loops[k - 1]
    rocker = rocker_angle(*angles, loop_bars(arm, k, values), side)
    # theta of the driven row rotates the crank, not the link: row_factors adds it again.
    return rocker - angles[1] + loop.offset - values[f"theta{loop.driven}"]


def assembly_sides(arm: Arm) -> dict[int, int]:
    """Return the side (+1 or -1) of each loop's uncrossed assembly, by number of the loop from 1.

    It is decided at mid range of the joints with nominal bars. Raises InputError where a loop has
    less than `MIN_LOOP_MARGIN` there.
    """
    if not arm.loops:
        return {}
    middle = [0.5 * (j.lower + j.upper) for j in arm.joints]
    nominal = {p.name: p.value for p in parameters_of(arm)}
    own, sides = list(middle), {}
    for k in sorted(range(1, len(arm.loops) + 1), key=lambda k: arm.loops[k - 1].driven):
        loop, bars = arm.loops[k - 1], loop_bars(arm, k, nominal)
        crank, ground = angles = loop_angles(loop, middle, own, nominal)
        if not float(loop_margin(ca.DM(crank), ca.DM(ground), bars)) > MIN_LOOP_MARGIN:
            raise InputError(
                f"{arm.name}: four_bar[{k}] cannot be assembled at the middle of its joints' "
                f"ranges, crank at {np.rad2deg(crank):.1f} deg and ground bar at "
                f"{np.rad2deg(ground):.1f} deg; give limits_deg of joints {loop.carrier} and "
                f"{loop.driven} in whose middle it stands open, or correct the bars"
            )
        sides[k] = assembly_side(float(crank), float(ground), bars)
        own[loop.driven - 1] = float(_driven(arm, k, angles, sides[k], nominal))
    return sides


def gravity_energy(arm: Arm, frames: Sequence[Symbolic], gravity: Symbolic, payload_kg: Symbolic) -> Symbolic:
    """Return the potential energy [J] of all links' bodies and of the payload.

    frames : T_01..T_0n in the robot's base frame; gravity : shape (3,) [m/s^2] in the same frame
    payload_kg : mass on the flange at this pose, its centre as declared; ignored without payload
    """
    loads = [(j.body.mass, j.body.com, T) for j, T in zip(arm.joints, frames, strict=True) if j.body]
    if arm.payload:
        loads.append((payload_kg, arm.payload.com, frames[-1]))
    energy: Symbolic = 0.0
    for mass, com, T in loads:
        energy = energy - mass * ca.dot(gravity, apply(T, ca.DM(com)))
    return energy


def gravity_torques(context: Context, added: Symbolic = 0.0) -> Symbolic:
    """Return tau = -dV/dq on the actuated joints, shape (n,) [N m or N].

    It is the torque of gravity, not that of the motors against it. It holds for closed loops too,
    and is evaluated at the pose after one deflection step.

    added : potential energy of effects [J]
    """
    arm, q = context.arm, context.q
    energy = gravity_energy(arm, context.frames, context.gravity, context.conditions.get("payload_kg", 0.0))
    tau = -ca.gradient(ca.SX(energy + added), q)
    return ca.substitute(tau, q, q + deflections(arm, tau, context.values))


def deflections(arm: Arm, torque: Symbolic, values: Values) -> Symbolic:
    """Return the joint deflections c_i tau_i, shape (n,) [rad or m] (paper, eq. 4).

    torque : of gravity on each joint, shape (n,) [N m or N]; values : parameters, with compliances
        c_i [rad/(N m) or m/N], zero where a joint has none
    """
    return ca.vertcat(*(values.get(f"c{i}", 0.0) * torque[i - 1] for i in range(1, arm.n + 1)))
