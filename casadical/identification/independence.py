"""Which parameters of a problem its measurements determine at the start, where exact dependences are exact."""

from dataclasses import replace

import numpy as np

from casadical.identification.identifiability import Identifiability, analyse
from casadical.identification.least_squares import LeastSquares
from casadical.identification.residuals import POINT_SCALE
from casadical.measurements.kinds.registry import find_kind

# More parameters than this, held back by priors, are not all tested for independence.
WIDE = 200

# They move the robot as a whole.
_WHOLE_ROBOT = (
    "alpha0",
    "a0",
    "beta0",
    "b0",
    "d1",
    "theta1",
    *(f"base_{c}" for c in ("x", "y", "z", "rx", "ry", "rz")),
)


def independent_parameters(problem: LeastSquares) -> Identifiability:
    """Which of its names the data determine, by the Jacobian at v = 0, with fixed loads if joints are compliant."""
    robot, names, p = problem.robot, problem.names, len(problem.names)
    loaded = any(j.compliance is not None for j in robot.joints) or bool(robot.effects)
    with_loads = problem if loaded == problem.fixed_loads else replace(problem, fixed_loads=loaded)
    R = with_loads.triangle(np.zeros(problem.size))
    own = [robot.parameters[n] for n in names]
    held = {parameter.name: parameter.held for parameter in own if parameter.held}
    if not any(find_kind(m.kind).at_rest(m.arrays) for m in problem.sets):
        held |= dict.fromkeys(_WHOLE_ROBOT, "nothing at rest was measured: moving the whole robot changes nothing")
    if problem.priors and problem.residual_count <= problem.size:
        # Too few numbers to say what is confounded.
        R = np.concatenate([R, np.diag(np.sqrt(np.diag(problem.prior_matrix)))])
    points = 3 * len(problem.labels)
    of_effects = {e.label for e in robot.effects}
    if problem.priors and p > WIDE:  # what a prior of an effect holds back needs no test of independence
        base = [k for k, parameter in enumerate(own) if parameter.group not in of_effects]
        found = analyse(R[:, [*range(p, problem.size), *base]], [names[k] for k in base], points, held)
        dropped = {u.name for u in found.held}
        return replace(found, independent=tuple(n for n in names if n not in dropped))
    R = np.concatenate([R[:, p:], R[:, :p]], axis=1) if points else R
    found = analyse(R, names, points, held)
    if any(find_kind(m.kind).has_scale or m.separations for m in problem.sets):
        return found
    longest = max(found.independent, key=lambda n: abs(_length(problem, n)), default="")
    if not longest or not _scale_is_free(problem):
        return found
    held[longest] = "contacts without known separations do not determine the scale; this length is its reference"
    return analyse(R, names, points, held)


def _length(problem: LeastSquares, name: str) -> float:
    """Nominal value of a parameter that is a length [m]; zero for others."""
    parameter = problem.robot.parameters[name]
    return parameter.value if parameter.unit == "m" else 0.0


def _scale_is_free(problem: LeastSquares) -> bool:
    """Whether all lengths grow together unseen.

    Contact residuals p - u are then homogeneous in lengths and points, and Euler's theorem says J (lengths, points)
    = residuals. Compliance breaks this by its share in the position, which is no measure: hence one per cent.
    """
    residuals, J = problem.evaluate(np.zeros(problem.size))
    lengths = np.array([_length(problem, n) for n in problem.names]) / problem.scale
    of = {name: find_kind(m.kind) for k, m in enumerate(problem.sets) for name in problem.pose_labels(k)}
    places, origin = zip(problem.labels, problem.points, strict=True), problem.robot.base.T[:3, 3]
    moved = [of[name].grown(point[None], origin).ravel() / POINT_SCALE for name, point in places]
    growth = np.concatenate([lengths, *moved])
    r = np.concatenate([part.ravel() for part in residuals])
    robot_alone = np.linalg.norm(J[:, : lengths.size] @ lengths)
    return bool(robot_alone > 0 and np.linalg.norm(J @ growth - r) < 0.01 * robot_alone)
