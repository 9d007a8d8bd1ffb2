"""The closed four-bar loop that drives a joint from a crank: closed form, feasibility margin.

All bars lie in one plane, perpendicular to the axis of the joint that carries the ground bar.
Angles count from the x axis of its link at theta + q = 0. Ground bar, length g, from the carrying
joint (origin) to the driven joint; crank, length L5, from the origin; coupler L4 from the crank's
end to the rocker's end; rocker L3 from the driven joint and fixed to the driven link. With L3 = L5
and L4 = g the loop is a parallelogram and the rocker turns with the crank (paper, eq. 3).
"""

import casadi as ca

from casadical.core.transforms import Symbolic

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
    keeps the digits near the folded positions. An open loop gives NaN: test `margin` first.

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


def margin(crank: Symbolic, ground: Symbolic, lengths: Bars) -> Symbolic:
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
