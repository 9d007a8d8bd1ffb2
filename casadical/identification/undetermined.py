"""What some kinds of measurement cannot determine in any number, each with a remedy."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from casadical.core.basics import Array
from casadical.identification.least_squares import LeastSquares
from casadical.identification.sessions import not_shared
from casadical.measurements.kinds.distance import Distance
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot


def undetermined(sets: Sequence[Measurements], where: Mapping[str, Array]) -> Iterator[str]:
    """Yield what sets of these kinds cannot determine, each as the end of "these data cannot ...".

    Of sets with positions only sessions without a common pose are judged.

    where : "set number/point name" -> unknown point, as of `Identification.unknown_points`, shape
        (3,) [m]
    """
    if apart := not_shared(sets):
        yield apart
    if any(m.position is not None for m in sets):
        return
    if not any(find_kind(m.kind).has_scale or m.separations for m in sets):
        gives = "one distance between two of them gives it ([[measurements.separation]])"
        if not any(find_kind(m.kind).places for m in sets):
            gives = "touches of a ball of known radius give it (kind sphere)"
        yield (
            "tell the size of the robot: no distance between touched points is known, and the longest length is taken "
            f"as it is; {gives}"
        )
    if any(m.kind != Distance.name for m in sets):
        return
    ends = [
        m.target
        if m.target is not None
        else np.array([where[f"{k}/{name}"] for name in find_kind(m.kind).point_names(m.arrays)])
        for k, m in enumerate(sets)
    ]
    places = np.unique(np.concatenate(ends).round(4), axis=0)
    if len(places) == 1:
        yield (
            "see errors across the beam of the one instrument, nor a turn of the whole robot about it; distances to a "
            "second and a third place, not in line with it, show them"
        )
        return
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    # Places are collinear if their second singular value is below this share of the first.
    if spread[1] < 0.05 * spread[0]:
        yield (
            f"see a turn of the whole robot about the line in which the {len(places)} places lie that distances are "
            "measured to; distances to one place off that line show it"
        )


def undetermined_at_start(robot: Robot, sets: Sequence[Measurements]) -> Iterator[str]:
    """Yield what these sets cannot determine, before an identification; see `undetermined`.

    Unknown points are estimated from the positions of the robot, whose base and tool are placed.
    """
    problem = LeastSquares(robot, tuple(sets), (), "linear", False, ((1.0, 1.0),) * len(sets))
    yield from undetermined(sets, dict(zip(problem.labels, problem.points, strict=True)))
