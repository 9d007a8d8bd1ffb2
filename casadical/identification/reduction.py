"""The parameters that the measurements determine: chosen, solved for, and left out where their prior knows better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array, ConvergenceError, InputError
from casadical.identification.identifiability import (
    INVISIBLE,
    NO_EFFECT,
    Identifiability,
    Unidentifiable,
    analyse,
    drop_poor,
)
from casadical.identification.least_squares import LeastSquares
from casadical.identification.residuals import POINT_SCALE
from casadical.identification.solver import Progress, Solution
from casadical.measurements.kinds.registry import find_kind

# Residuals of this share of the reach are no measuring error.
POOR_FIT = 0.005
# Parameters that a message names.
TOLD = 6


# Optima of earlier problems, by the names of their variables: parameters and points.
Optima = dict[tuple[tuple[str, ...], tuple[str, ...]], Array]


def reduce_and_solve(
    problem: LeastSquares, progress: Progress | None, optima: Optima
) -> tuple[LeastSquares, Solution, Identifiability]:
    """Choose the independent parameters, solve, and leave out those that the data determine worse than their prior.

    optima : of the same robot with other sigmas or fewer poses, where a solve starts; those found here are added

    Independence is decided at the start, where exact dependences are exact; what has no effect there, but one where the
    solve ends, is added: the compliance of an upright first axis, once the base is found to be tilted. Raises
    InputError where the data determine no parameter at all, or are no more numbers than there are unknowns.
    """
    analysis = independent_parameters(problem)
    reduced = problem.with_names(analysis.independent)
    if not problem.priors and reduced.degrees_of_freedom <= 0:
        raise InputError(
            f"{problem.sets[0].source}: {problem.residual_count} numbers were measured, but at least "
            f"{reduced.size} are unknown; measure more poses, free fewer parameters "
            "(free=['placement', ...]), or use priors"
        )
    poor: list[Unidentifiable] = []
    left = 0.0
    while reduced.names:
        variables = reduced.names, reduced.labels
        try:
            solution = reduced.solve(progress, optima.get(variables))
        except ConvergenceError:
            if problem.priors or not (worse := _poor_at_start(reduced)):
                raise
        else:
            optima[variables] = solution.v
            left = left or _misfit(reduced, solution.v)
            worse = [] if problem.priors else _poor(reduced, solution.v, reduced.variance(solution.v))
            if not worse:
                more = _with_visible(reduced, solution.v, analysis, problem.names)
                if more is None:
                    return reduced, solution, replace(analysis, independent=reduced.names, held=(*analysis.held, *poor))
                reduced, start = more
                analysis = replace(analysis, held=tuple(u for u in analysis.held if u.name not in reduced.names))
                optima.setdefault((reduced.names, reduced.labels), start)
        poor += worse
        gone = {u.name for u in worse}
        reduced = reduced.with_names([n for n in reduced.names if n not in gone])
    if left > POOR_FIT * problem.robot.reach:
        frames = (("base", problem.robot.base), ("tool", problem.robot.tool))
        known = " and ".join(name for name, frame in frames if frame.unknown == "none")
        frames_known = f'; known here: {known}; unknown = "pose" or "position" has them fitted (robot file, Placement)'
        raise InputError(
            f"{problem.sets[0].source}: the model does not fit: {1e3 * left:.3g} mm a coordinate are left after the "
            "best fit; check the signs and zeros of the joints, their order, units and the DH convention"
            f"{known and frames_known}"
        )
    held = (*poor, *analysis.held)
    reasons = "; ".join(f"{u.name}: {u.reason}" for u in held[:TOLD]) + (
        f"; and {len(held) - TOLD} more" if len(held) > TOLD else ""
    )
    raise InputError(
        f"{problem.sets[0].source}: these measurements determine none of the parameters to be identified. {reasons}"
    )


def _with_visible(
    problem: LeastSquares, v: Array, found: Identifiability, order: Sequence[str]
) -> tuple[LeastSquares, Array] | None:
    """The problem with those parameters that had no effect at the start and that its optimum v lets the data determine.

    order : of all parameters. Returns the point in the wider problem, too; None where there is no such parameter.
    """
    hidden = {u.name for u in found.held if u.reason == NO_EFFECT}
    if not hidden:
        return None
    wider, at = _widened(problem, v, hidden, order)
    seen = np.sqrt(np.diag(wider.information(at))[: len(wider.names)])
    visible = {n for n, length in zip(wider.names, seen, strict=True) if length > INVISIBLE * seen.max()} & hidden
    if not visible:
        return None
    if visible != hidden:
        wider, at = _widened(problem, v, visible, order)
    # The noise as one step would leave it: what these parameters explain is none.
    left = max(0.0, 1 - wider.decrement(at) / max(wider.cost(at), 1e-300))
    worse = {u.name for u in _poor(wider, at, left * problem.variance(v))}
    if not visible & worse:
        return wider, at
    return None if visible <= worse else _widened(problem, v, visible - worse, order)


def _widened(problem: LeastSquares, v: Array, more: set[str], order: Sequence[str]) -> tuple[LeastSquares, Array]:
    """The problem with more parameters, at their nominal values, and where it stands then."""
    names = [n for n in order if n in more or n in problem.names]
    own = np.zeros(len(names))
    own[[names.index(n) for n in problem.names]] = v[: len(problem.names)]
    return problem.with_names(names), np.concatenate([own, v[len(problem.names) :]])


def _misfit(problem: LeastSquares, v: Array) -> float:
    """Standard deviation of a coordinate that a fit leaves, the greatest of all sets [m]."""
    return float(np.sqrt(problem.variance(v))) * max(sigma for sigma, _ in problem.sigmas)


def _poor(problem: LeastSquares, v: Array, variance: float) -> list[Unidentifiable]:
    """Parameters that the data determine worse than their prior; variance : of a residual in units of sigma."""
    _, H = problem.gradient(v)
    return drop_poor([problem.robot.parameters[n] for n in problem.names], H, variance)[1]


def _poor_at_start(problem: LeastSquares) -> list[Unidentifiable]:
    """Those by which a solve wanders off: by the sigmas, and if these excuse none, by the misfit of the start."""
    v = np.zeros(problem.size)
    return _poor(problem, v, 1.0) or _poor(problem, v, problem.variance(v))


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
    own = [robot.parameters[n] for n in names]
    held = {parameter.name: parameter.held for parameter in own if parameter.held}
    if not any(find_kind(m.kind).at_rest(m.arrays) for m in problem.sets):
        held |= dict.fromkeys(_WHOLE_ROBOT, "nothing at rest was measured: moving the whole robot changes nothing")
    of_effects = {e.label for e in robot.effects}
    wide = bool(problem.priors) and p > WIDE  # what a prior of an effect holds back needs no test of independence
    asked = [k for k, parameter in enumerate(own) if not (wide and parameter.group in of_effects)]
    columns = [*range(p, problem.size), *asked]
    zero = np.zeros(problem.size)
    R = with_loads.triangle(zero, columns) if wide else with_loads.triangle(zero)[:, columns]
    if problem.priors and problem.residual_count <= problem.size:
        # Too few numbers to say what is confounded.
        R = np.concatenate([R, np.diag(np.sqrt(np.diag(problem.prior_matrix)))[:, columns]])
    points = 3 * len(problem.labels)
    analysis = analyse(R, [names[k] for k in asked], points, held)
    if wide:
        dropped = {u.name for u in analysis.held}
        return replace(analysis, independent=tuple(n for n in names if n not in dropped))
    if any(find_kind(m.kind).has_scale or m.separations for m in problem.sets):
        return analysis
    longest = max(analysis.independent, key=lambda n: abs(_length(problem, n)), default="")
    if not longest or not _scale_is_free(problem):
        return analysis
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
