"""How a problem is solved: the parameters that the measurements determine chosen, with the noise that the data show,
and without outliers; parameters are left out where their prior knows better.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from casadical.core.basics import Array, ConvergenceError, InputError
from casadical.core.statistics import best_of, robust_std
from casadical.identification.fit_statistics import redundancies, variance
from casadical.identification.identifiability import (
    MAX_INVISIBLE_SHARE,
    NO_EFFECT_REASON,
    Identifiability,
    Unidentifiable,
    analyse,
    drop_poor,
)
from casadical.identification.least_squares import MANY_PARAMETERS, LeastSquares, Linearised
from casadical.identification.plausibility import undefined
from casadical.identification.residuals import POINT_SCALE
from casadical.identification.solver import Progress, Solution
from casadical.measurements.kinds.registry import find_kind

Solved = tuple[LeastSquares, Solution, Identifiability]
# Optima of earlier problems, by the names of their variables: parameters and points.
Optima = dict[tuple[tuple[str, ...], tuple[str, ...]], Array]

# Noise exceeds the bound of an outlier's normalised residual with this probability.
OUTLIER_CHANCE = 1e-5
LEAST_REDUNDANCY = 0.1
# With a prior that explains nearly all, fewer degrees of freedom do not tell the noise.
TELLING = 10.0
SCREENINGS = 8
SIGMA_ROUNDS = 6
# Sigmas that change by less, as a logarithm, are the last ones.
SAME_SIGMA = 0.03
# Where the data are free of noise, so that nothing is divided by zero.
LEAST_SIGMA = 1e-9


def _solve_with_sigmas(problem: LeastSquares, progress: Progress | None, optima: Optima) -> Solved:
    """Solve; where a sigma matters and was not given, estimate it from the residuals and solve again."""
    first = problem.sets[0]
    several = len(problem.sets) > 1 or find_kind(first.kind).angles > 0 or bool(first.separations)
    matters = problem.loss != "linear" or problem.priors or several or problem.guesses.any()
    for _ in range(SIGMA_ROUNDS):
        solved = reduce_and_solve(problem, progress, optima)
        if not matters:
            break
        sigmas = _estimated_sigmas(*solved[:2])
        change = _change(problem.sigmas, sigmas)
        problem = replace(problem, sigmas=sigmas)
        if change < SAME_SIGMA:
            break
    return solved


def _change(before: Sequence[tuple[float, float]], now: Sequence[tuple[float, float]]) -> float:
    """The greatest of all sigmas' changes, as a logarithm."""
    return float(np.abs(np.log(np.array(now) / np.array(before))).max())


def _with_freedom(problem: LeastSquares, solution: Solution) -> list[tuple[Array, Array]]:
    """Residuals of each set and the degrees of freedom of each, both of shape (n, m)."""
    residuals = problem.residuals(solution.v)
    edges = np.cumsum([r.size for r in residuals])
    shares = np.split(redundancies(problem, solution.v), edges)
    return [(r, share.reshape(r.shape)) for _, r, share in zip(problem.sets, residuals, shares, strict=False)]


def _estimated_sigmas(problem: LeastSquares, solution: Solution) -> tuple[tuple[float, float], ...]:
    """Of each set, from its residuals and their share in the degrees of freedom (Foerstner 1979)."""
    if all(m.sigma and (m.sigma_angle or not find_kind(m.kind).angles) for m in problem.sets):
        return tuple((max(sigma, LEAST_SIGMA), max(angle, LEAST_SIGMA)) for sigma, angle in problem.sigmas)
    sigmas = []
    for m, (sigma, angle), both in zip(problem.sets, problem.sigmas, _with_freedom(problem, solution), strict=True):
        r, freedom = (values[m.weight > 0] for values in both)
        n = find_kind(m.kind).lengths
        if problem.known and freedom.sum() < TELLING:
            sigmas.append((m.sigma or sigma, m.sigma_angle or angle))
            continue
        if n:
            sigma = m.sigma or sigma * _deviation(problem, r[:, :n], freedom[:, :n])
        if n < r.shape[1]:
            angle = m.sigma_angle or angle * _deviation(problem, r[:, n:], freedom[:, n:])
        sigmas.append((max(sigma, LEAST_SIGMA), max(angle, LEAST_SIGMA)))
    return tuple(sigmas)


def _deviation(problem: LeastSquares, r: Array, freedom: Array) -> float:
    """Standard deviation of residuals that have this many degrees of freedom each."""
    square = robust_std(r) ** 2 if problem.loss != "linear" else float(np.mean(r**2))
    return float(np.sqrt(square / max(float(np.mean(freedom)), 1 / r.size)))


def solve_without_outliers(
    problem: LeastSquares, rounds: int, progress: Progress | None
) -> tuple[Solved, tuple[tuple[int, int], ...]]:
    """Solve; with a robust loss, leave outliers out and solve again until there are no more of them.

    In rounds, because outliers widen the spread by which they are judged. A pose that the last solution explains after
    all, because others drew an earlier one away from it, is taken back.
    """
    optima: Optima = {}
    solved = _solve_with_sigmas(problem, progress, optima)
    if problem.loss == "linear":
        return solved, ()
    kept = [np.arange(len(m)) for m in problem.sets]
    taken_back = [np.zeros(len(m), dtype=bool) for m in problem.sets]
    for _ in range(rounds):
        masks = zip(outlier_masks(solved[0], solved[1]), taken_back, kept, strict=True)
        far = [mask & ~back[index] for mask, back, index in masks]
        if any(mask.any() for mask in far):
            kept = [index[~mask] for index, mask in zip(kept, far, strict=True)]
        else:
            again = [np.setdiff1d(back, index) for back, index in zip(explained(problem, solved), kept, strict=True)]
            if not any(map(len, again)):
                break
            for k, back in enumerate(again):
                taken_back[k][back] = True
            kept = [np.union1d(index, back) for index, back in zip(kept, again, strict=True)]
        sets = tuple(m[index] for m, index in zip(problem.sets, kept, strict=True))
        solved = _solve_with_sigmas(replace(problem, sets=sets, sigmas=solved[0].sigmas), progress, optima)
    out = [np.setdiff1d(np.arange(len(m)), index) for m, index in zip(problem.sets, kept, strict=True)]
    return solved, tuple((k, int(i)) for k, left in enumerate(out) for i in left)


def solve_by_auto(
    problem: LeastSquares, rounds: int, progress: Progress | None
) -> tuple[Solved, tuple[tuple[int, int], ...]]:
    """Solve with the loss huber where that finds outliers, else with the linear one of the problem."""
    try:
        plain = _solve_with_sigmas(problem, progress, {})
    except (ConvergenceError, InputError):  # outliers may be the cause
        plain = None
    if plain is not None and _surely_without_outliers(*plain[:2]):
        return plain, ()
    try:
        robust = solve_without_outliers(problem.with_loss("huber"), rounds, progress)
    except ConvergenceError:  # it creeps on few rows, where all that it is for are outliers
        robust = None
    if robust is not None and robust[1]:
        return robust
    return plain or _solve_with_sigmas(problem, progress, {}), ()


def _surely_without_outliers(problem: LeastSquares, solution: Solution) -> bool:
    """Whether the huber loss would find no outliers, by residuals that are linear in v about the fit without it.

    Not where that fit has few numbers, stands at a bound or leaves more than a model may: the other loss may have
    another optimum.
    """
    v, (lower, upper) = solution.v, problem.bounds
    # Share of the bound of outliers up to which poses are surely none; of fewer numbers a variable
    # a fit hides some.
    few = problem.residual_count < 3 * problem.size
    # Square of a residual, in units of their spread, with which a pose is an outlier at a glance.
    far = any(((r**2).sum(axis=1) > 100.0 * robust_std(r) ** 2).any() for r in problem.residuals(v))
    if far or few or problem.at_bounds(v).any() or not _misfit(problem, v) < POOR_FIT * problem.robot.reach:
        return False
    robust = Linearised.about(problem, v, "huber")
    for k in range(SIGMA_ROUNDS):
        sigmas = _estimated_sigmas(robust, replace(solution, v=v))
        if k and _change(robust.sigmas, sigmas) < SAME_SIGMA:
            break
        robust = robust.with_sigmas(sigmas)
        v = robust.settled(v)
    inside = bool((lower < v).all() and (v < upper).all())
    return inside and not any(far.any() for far in outlier_masks(robust, replace(solution, v=v), 0.9))


def outlier_masks(problem: LeastSquares, solution: Solution, share: float = 1.0) -> list[Array]:
    """Masks of the poses whose residuals noise of their spread would exceed once in 100 000; share : of that bound."""
    masks = []
    for r, freedom in _with_freedom(problem, solution):
        # A pose that draws the fit towards itself shows little of its error.
        z = r / np.sqrt(np.maximum(freedom, LEAST_REDUNDANCY))
        masks.append((z**2).sum(axis=1) > share * chdtri(r.shape[1], OUTLIER_CHANCE) * robust_std(z) ** 2)
    return masks


def explained(problem: LeastSquares, solved: Solved) -> list[Array]:
    """Of every set the poses, also those left out, at which a solution leaves no more than noise of its spread.

    problem : with all poses. What was left out has no part in the solution, and its full error shows.
    """
    fitted, solution, _ = solved
    whole = replace(fitted, sets=problem.sets)
    x, u = fitted.separate(solution.v)
    known = dict(zip(fitted.labels, fitted.points + POINT_SCALE * u, strict=True))
    places = [known.get(name, start) for name, start in zip(whole.labels, whole.points, strict=True)]
    v = np.concatenate([x, ((np.array(places).reshape(-1, 3) - whole.points) / POINT_SCALE).ravel()])
    spread = [robust_std(r / np.sqrt(np.maximum(f, LEAST_REDUNDANCY))) for r, f in _with_freedom(fitted, solution)]
    return [
        np.flatnonzero((r**2).sum(axis=1) <= chdtri(r.shape[1], OUTLIER_CHANCE) * own**2)
        for r, own in zip(whole.residuals(v), spread, strict=False)
    ]


# Residuals of this share of the reach are no measuring error.
POOR_FIT = 0.005
# Parameters that a message names.
TOLD = 6


def reduce_and_solve(
    problem: LeastSquares, progress: Progress | None, optima: Optima
) -> tuple[LeastSquares, Solution, Identifiability]:
    """Choose the independent parameters, solve, and leave out those that the data determine worse than their prior.

    optima : of the same robot with other sigmas or fewer poses, where a solve starts; those found here are added

    Independence is decided at the start, where exact dependences are exact; what has no effect there, but one where the
    solve ends, is added: the compliance of an upright first axis, once the base is found to be tilted; and where that
    is sought the tilt of a robot with nothing at rest about it, which the weight of its links shows.
    Raises InputError where the data determine no parameter at all, or are no more numbers than there are unknowns.
    """
    analysis = problem.kept.once("independent", lambda: independent_parameters(problem))
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
            if problem.priors:
                raise
            # By which the solve wanders off: by the sigmas or, if these excuse none, by the misfit of the start.
            at = np.zeros(reduced.size)
            worse = _poor(reduced, at, 1.0) or _poor(reduced, at, variance(reduced, at))
            if not worse:
                raise
        else:
            optima[variables] = solution.v
            left = left or _misfit(reduced, solution.v)
            worse = [] if problem.priors else _poor(reduced, solution.v, variance(reduced, solution.v))
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
    robot, tilts = problem.robot, set[str]()
    if problem.weighed and robot.gravity_frame == "measuring" and any(j.compliance is not None for j in robot.joints):
        tilts = {u.name for u in found.held if u.reason == GAUGE and u.name in _TURNS}
    hidden = {u.name for u in found.held if u.reason == NO_EFFECT_REASON} | tilts
    if not hidden:
        return None
    wider, at = _widened(problem, v, hidden, order)
    seen = np.sqrt(np.diag(wider.information(at))[: len(wider.names)])
    visible = {
        n for n, length in zip(wider.names, seen, strict=True) if length > MAX_INVISIBLE_SHARE * seen.max()
    } & hidden
    if not visible:
        return None
    if visible != hidden:
        wider, at = _widened(problem, v, visible, order)
    # The noise as one step would leave it: what these parameters explain is none.
    left = max(0.0, 1 - wider.decrement(at) / max(wider.cost(at), 1e-300))
    worse = {u.name for u in _poor(wider, at, left * variance(problem, v), tilts)}
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
    return float(np.sqrt(variance(problem, v))) * max(sigma for sigma, _ in problem.sigmas)


def _poor(problem: LeastSquares, v: Array, variance: float, of_data: Collection[str] = ()) -> list[Unidentifiable]:
    """Parameters that the data determine worse than their prior; variance : of a residual in units of sigma.

    of_data : names whose own priors do not count as data
    """
    H = problem.gradient(v)[1].copy()
    at = [k for k, name in enumerate(problem.names) if name in of_data]
    H[at, at] -= np.diag(problem.prior_matrix)[at]
    return drop_poor([problem.robot.parameters[n] for n in problem.names], H, variance)[1]


# They move the robot as a whole; turns of the foot change what the weight of its links does, too.
GAUGE = "nothing at rest was measured: moving the whole robot changes nothing"
_TURNS = ("base_rx", "base_ry", "base_rz")
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
    """Which of its names the data determine, by the Jacobian at v = 0, with fixed loads if joints are compliant.

    Raises InputError, with the row, where that is no finite number.
    """
    robot, names, p = problem.robot, problem.names, len(problem.names)
    loaded = any(j.compliance is not None for j in robot.joints) or bool(robot.effects)
    with_loads = problem if loaded == problem.fixed_loads else replace(problem, fixed_loads=loaded)
    own = [robot.parameters[n] for n in names]
    held = {parameter.name: parameter.held for parameter in own if parameter.held}
    if not any(find_kind(m.kind).at_rest(m.arrays) for m in problem.sets):
        held |= dict.fromkeys(_WHOLE_ROBOT, GAUGE)
    of_effects = {e.label for e in robot.effects}
    wide = (
        bool(problem.priors) and p > MANY_PARAMETERS
    )  # what a prior of an effect holds back needs no test of independence
    asked = [k for k, parameter in enumerate(own) if not (wide and parameter.group in of_effects)]
    columns = [*range(p, problem.size), *asked]
    zero = np.zeros(problem.size)
    R = with_loads.triangle(zero, columns) if wide else with_loads.triangle(zero)[:, columns]
    if not np.isfinite(R).all() and (found := with_loads.undefined(zero)):
        raise undefined(robot, *found)
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
    known = analysis.independent
    longest = best_of(known, lambda n: abs(_length(problem, n))) if known else ""
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
