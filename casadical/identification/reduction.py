"""Solving an identification problem: choice of parameters, estimation of noise, and outliers.

Without priors, parameters that the data determine less accurately than their prior are omitted.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from casadical.core.basics import M_PER_MM, Array, ConvergenceError, InputError
from casadical.core.statistics import best_of, robust_std
from casadical.identification.identifiability import (
    MAX_INVISIBLE_LENGTH_RATIO,
    NO_EFFECT_REASON,
    Identifiability,
    analyse,
    drop_poor,
)
from casadical.identification.least_squares import MANY_PARAMETERS, LeastSquares, Linearised
from casadical.identification.plausibility import undefined
from casadical.identification.prediction import redundancies
from casadical.identification.solver import Progress, Solution
from casadical.measurements.camera_noise import refined
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements

# The problem reduced to its identifiable parameters, its solution, and the verdict on each
# parameter.
Solved = tuple[LeastSquares, Solution, Identifiability]
# (names of parameters, names of points) -> optimum v of an earlier problem with these variables,
# from which later solves start.
Optima = dict[tuple[tuple[str, ...], tuple[str, ...]], Array]

# Probability that noise alone makes a given pose an outlier (significance level of the test).
OUTLIER_PROBABILITY = 1e-5
# Lower limit of the redundancy number (one minus leverage) by which a residual is normalised.
MIN_REDUNDANCY = 0.1
# Minimum number of degrees of freedom from which the noise is estimated; a correlated prior may
# explain nearly all residuals and leave fewer.
MIN_NOISE_FREEDOM = 10.0
# Maximum number of rounds in which outliers are excluded and the problem is solved again.
MAX_OUTLIER_ROUNDS = 8
# Maximum number of rounds in which the noise sigmas are estimated and the problem is solved again.
MAX_SIGMA_ROUNDS = 6
# Noise sigmas have converged if the logarithm of none changes by more than this in a round.
SIGMA_LOG_TOLERANCE = 0.03
# Lower limit of an estimated or declared noise sigma [m or rad], for data without noise.
MIN_SIGMA = 1e-9


def _solve_with_sigmas(problem: LeastSquares, progress: Progress | None, optima: Optima) -> Solved:
    """Reduce and solve a problem, with noise sigmas estimated in turns where they matter.

    Sigmas matter with a robust loss, priors, or numbers of several accuracies; those that the
    measurements declare are used as declared. Returns as `reduce_and_solve`.
    """
    first = problem.sets[0]
    several = len(problem.sets) > 1 or find_kind(first.kind).angles > 0 or bool(first.separations)
    matters = problem.loss != "linear" or problem.priors or several or problem.guesses.any()
    for _ in range(MAX_SIGMA_ROUNDS):
        solved = reduce_and_solve(problem, progress, optima)
        if not matters:
            break
        sets, sigmas = _in_camera(*solved[:2], _estimated_sigmas(*solved[:2]))
        change = _largest_log_change(problem.sigmas, sigmas)
        if any(m.noise for m in sets):
            change += _largest_log_change(*([m.noise.ratios for m in s if m.noise] for s in (problem.sets, sets)))
        problem = replace(problem, sets=sets, sigmas=sigmas)
        if change < SIGMA_LOG_TOLERANCE:
            break
    return solved


def _in_camera(
    problem: LeastSquares, solution: Solution, sigmas: tuple[tuple[float, float], ...]
) -> tuple[tuple[Measurements, ...], tuple[tuple[float, float], ...]]:
    """Return the sets and their sigmas with the noise of camera poses estimated from residuals.

    Sets without such noise, or with too few degrees of freedom, are unchanged.
    """
    sets, result = list(problem.sets), list(sigmas)
    for k, (m, (r, freedom)) in enumerate(
        zip(sets, _residuals_with_redundancies(problem, solution) if any(m.noise for m in sets) else (), strict=False)
    ):
        some = np.flatnonzero(m.weight > 0)
        if problem.loss != "linear":
            some = np.setdiff1d(some, np.flatnonzero(_outliers(r, freedom)))
        # With less freedom there are too few numbers to tell the components apart.
        if m.noise and freedom[some].sum() > 2 * MIN_NOISE_FREEDOM:
            noise, own = refined(m[some].view, m.noise, r[some], freedom[some], problem.sigmas[k])
            length, angle = (max(sigma, MIN_SIGMA) for sigma in own)
            sets[k], result[k] = replace(m, noise=noise), (m.sigma or length, m.sigma_angle or angle)
    return tuple(sets), tuple(result)


def _largest_log_change(before: Sequence[tuple[float, ...]], now: Sequence[tuple[float, ...]]) -> float:
    """Return the largest absolute change of the logarithms between two lists of sigmas or ratios."""
    return float(np.abs(np.log(np.array(now) / np.array(before))).max())


def _residuals_with_redundancies(problem: LeastSquares, solution: Solution) -> list[tuple[Array, Array]]:
    """Return residuals [sigma] and redundancy numbers (0 to 1) of each set, both shape (n, m)."""
    residuals = problem.residuals(solution.v)
    edges = np.cumsum([r.size for r in residuals])
    shares = np.split(redundancies(problem, solution.v), edges)
    return [(r, share.reshape(r.shape)) for _, r, share in zip(problem.sets, residuals, shares, strict=False)]


def _estimated_sigmas(problem: LeastSquares, solution: Solution) -> tuple[tuple[float, float], ...]:
    """Return the noise sigmas of each set, of a coordinate [m] and of an angle [rad].

    They are the declared ones, or follow from residuals and their redundancies; those of the
    problem are kept where a correlated prior leaves fewer than MIN_NOISE_FREEDOM.
    Source: variance component estimation, Foerstner 1979.
    """
    if all(m.sigma and (m.sigma_angle or not find_kind(m.kind).angles) for m in problem.sets):
        return tuple((max(sigma, MIN_SIGMA), max(angle, MIN_SIGMA)) for sigma, angle in problem.sigmas)
    sigmas = []
    for m, (sigma, angle), both in zip(
        problem.sets, problem.sigmas, _residuals_with_redundancies(problem, solution), strict=True
    ):
        r, freedom = (values[m.weight > 0] for values in both)
        n = find_kind(m.kind).lengths
        if problem.correlated and freedom.sum() < MIN_NOISE_FREEDOM:
            sigmas.append((m.sigma or sigma, m.sigma_angle or angle))
            continue
        if n:
            sigma = m.sigma or sigma * _deviation(problem, r[:, :n], freedom[:, :n])
        if n < r.shape[1]:
            angle = m.sigma_angle or angle * _deviation(problem, r[:, n:], freedom[:, n:])
        sigmas.append((max(sigma, MIN_SIGMA), max(angle, MIN_SIGMA)))
    return tuple(sigmas)


def _deviation(problem: LeastSquares, r: Array, freedom: Array) -> float:
    """Return the factor on the sigmas at which these residuals have the variance that is expected.

    It is the rms residual over the root of the mean redundancy; with a robust loss of the problem a
    robust scatter takes the place of the rms.

    r, freedom : residuals [sigma] and their redundancy numbers, equal shapes
    """
    square = robust_std(r) ** 2 if problem.loss != "linear" else float(np.mean(r**2))
    return float(np.sqrt(square / max(float(np.mean(freedom)), 1 / r.size)))


def solve_without_outliers(
    problem: LeastSquares, rounds: int, progress: Progress | None
) -> tuple[Solved, tuple[tuple[int, int], ...]]:
    """Solve; with a robust loss, leave outliers out and solve again until there are none.

    Several rounds are needed because outliers enlarge the scatter by which they are judged. A pose
    that the last solution explains after all, because others distorted an earlier one, is taken
    back for good. Returns as `reduce_and_solve`, and the outliers as (set, pose) indices.

    rounds : maximum number of rounds; 0 leaves out no pose, as the linear loss
    """
    optima: Optima = {}
    solved = _solve_with_sigmas(problem, progress, optima)
    if problem.loss == "linear":
        return solved, ()
    inliers = [np.arange(len(m)) for m in problem.sets]
    taken_back = [np.zeros(len(m), dtype=bool) for m in problem.sets]
    for _ in range(rounds):
        masks = zip(outlier_masks(solved[0], solved[1]), taken_back, inliers, strict=True)
        far = [mask & ~back[index] for mask, back, index in masks]
        if any(mask.any() for mask in far):
            inliers = [index[~mask] for index, mask in zip(inliers, far, strict=True)]
        else:
            again = [np.setdiff1d(back, index) for back, index in zip(explained(problem, solved), inliers, strict=True)]
            if not any(map(len, again)):
                break
            for k, back in enumerate(again):
                taken_back[k][back] = True
            inliers = [np.union1d(index, back) for index, back in zip(inliers, again, strict=True)]
        sets = _with_noise_of(solved[0], [m[index] for m, index in zip(problem.sets, inliers, strict=True)])
        solved = _solve_with_sigmas(replace(problem, sets=sets, sigmas=solved[0].sigmas), progress, optima)
    out = [np.setdiff1d(np.arange(len(m)), index) for m, index in zip(problem.sets, inliers, strict=True)]
    return solved, tuple((k, int(i)) for k, left in enumerate(out) for i in left)


def _with_noise_of(fitted: LeastSquares, sets: Sequence[Measurements]) -> tuple[Measurements, ...]:
    """Return the sets with the noise of cameras that a fit of a part of their poses has found."""
    return tuple(replace(m, noise=own.noise) if own.noise else m for m, own in zip(sets, fitted.sets, strict=True))


def solve_by_auto(
    problem: LeastSquares, rounds: int, progress: Progress | None
) -> tuple[Solved, tuple[tuple[int, int], ...]]:
    """Solve with the huber loss where that finds outliers, else with the problem's linear loss.

    Returns what `reduce_and_solve` returns, and the outliers as (set, pose) indices.
    rounds : maximum number of rounds in which outliers are excluded; 0: the loss stays linear
    """
    try:
        plain = _solve_with_sigmas(problem, progress, {})
    except (ConvergenceError, InputError):  # outliers may be the cause
        plain = None
    if plain is not None and _surely_without_outliers(*plain[:2]):
        return plain, ()
    try:
        robust = solve_without_outliers(problem.with_loss("huber"), rounds, progress)
    except ConvergenceError:  # its convergence is slow with few poses; it serves outliers only
        robust = None
    if robust is not None and robust[1]:
        return robust
    return plain or _solve_with_sigmas(problem, progress, {}), ()


def _surely_without_outliers(problem: LeastSquares, solution: Solution) -> bool:
    """Return whether the huber loss would surely find no outliers, without solving with it.

    Residuals are linearised about the fit with the linear loss. False where that fit has few data,
    is at a bound, or has a residual or a scatter that is too large: the huber loss may then have
    another optimum.
    """
    v, (lower, upper) = solution.v, problem.bounds
    # With fewer residuals per variable a fit hides outliers.
    few = problem.residual_count < 3 * problem.size
    # A residual beyond ten standard deviations is an outlier without further computation.
    far = any(((r**2).sum(axis=1) > 100.0 * robust_std(r) ** 2).any() for r in problem.residuals(v))
    if (
        far
        or few
        or problem.at_bounds(v).any()
        or not _largest_residual_sigma(problem, v) < MAX_RESIDUAL_OF_REACH * problem.robot.reach
    ):
        return False
    robust = Linearised.about(problem, v, "huber")
    for k in range(MAX_SIGMA_ROUNDS):
        sigmas = _estimated_sigmas(robust, replace(solution, v=v))
        if k and _largest_log_change(robust.sigmas, sigmas) < SIGMA_LOG_TOLERANCE:
            break
        robust = robust.with_sigmas(sigmas)
        v = robust.settled(v)
    # The bound is tightened by 10 %, for the linearisation is not exact.
    inside = bool((lower < v).all() and (v < upper).all())
    return inside and not any(far.any() for far in outlier_masks(robust, replace(solution, v=v), 0.9))


def outlier_masks(problem: LeastSquares, solution: Solution, share: float = 1.0) -> list[Array]:
    """Return for each set the mask of the poses that are outliers, shape (n,).

    A pose is one if the squared norm of its residuals, normalised by redundancy and robust scatter,
    exceeds the bound that noise alone exceeds with OUTLIER_PROBABILITY.

    share : factor on that bound of the squared norm
    """
    return [_outliers(*both, share) for both in _residuals_with_redundancies(problem, solution)]


def _outliers(r: Array, freedom: Array, share: float = 1.0) -> Array:
    """Return the mask of the poses of one set that are outliers, shape (n,); see `outlier_masks`.

    r, freedom : residuals [sigma] and their redundancy numbers, equal shapes
    """
    from scipy.special import chdtri

    # A pose with high leverage shows little of its error.
    z = r / np.sqrt(np.maximum(freedom, MIN_REDUNDANCY))
    return np.asarray((z**2).sum(axis=1) > share * chdtri(r.shape[1], OUTLIER_PROBABILITY) * robust_std(z) ** 2)


def explained(problem: LeastSquares, solved: Solved) -> list[Array]:
    """Return for each set the indices of the poses whose residuals are no larger than noise.

    The bound is that of `outlier_masks`, for residuals that are not normalised by redundancy: poses
    that were excluded, for which it is meant, show their full errors.

    problem : with all poses; solved : of a part of these poses
    """
    from scipy.special import chdtri

    fitted, solution, _ = solved
    whole = replace(fitted, sets=_with_noise_of(fitted, problem.sets))
    x, u = fitted.separate(solution.v)
    fitted_points = dict(zip(fitted.labels, fitted.points + M_PER_MM * u, strict=True))
    places = [fitted_points.get(name, start) for name, start in zip(whole.labels, whole.points, strict=True)]
    v = np.concatenate([x, ((np.array(places).reshape(-1, 3) - whole.points) / M_PER_MM).ravel()])
    spread = [
        robust_std(r / np.sqrt(np.maximum(f, MIN_REDUNDANCY)))
        for r, f in _residuals_with_redundancies(fitted, solution)
    ]
    return [
        np.flatnonzero((r**2).sum(axis=1) <= chdtri(r.shape[1], OUTLIER_PROBABILITY) * own**2)
        for r, own in zip(whole.residuals(v), spread, strict=False)
    ]


# Standard deviation of a coordinate's residual, as a share of the robot's reach, above which the
# model is wrong: no measuring error is as large.
MAX_RESIDUAL_OF_REACH = 0.005


def reduce_and_solve(
    problem: LeastSquares, progress: Progress | None, optima: Optima
) -> tuple[LeastSquares, Solution, Identifiability]:
    """Choose the independent parameters, solve, and leave out those that the data determine badly.

    These are the ones with an uncertainty larger than their prior; with `priors` none is left out.
    Independence is decided at the start, where exact dependences are exact. A parameter without
    effect there is added if it has one at the optimum: the compliance of a vertical first axis,
    once the base is found to be tilted; and, if `weighed`, the tilt of a robot without measurements
    at rest, which the weight of its links shows.
    Returns the reduced problem, its solution, and the verdict on each parameter.
    Raises InputError where the data determine no parameter at all, or, without priors, are no more
    than the unknowns; ConvergenceError as of `LeastSquares.solve`.

    optima : start points, from the same robot with other sigmas or fewer poses; those found here
        are added
    """
    analysis = problem.cache.once("independent", lambda: independent_parameters(problem))
    reduced = problem.with_names(analysis.independent)
    if not problem.priors and reduced.degrees_of_freedom <= 0:
        raise InputError(
            f"{problem.sets[0].source}: {problem.residual_count} numbers were measured, but at least "
            f"{reduced.size} are unknown; measure more poses, free fewer parameters "
            "(free=['placement', ...]), or use priors"
        )
    poor: dict[str, str] = {}
    largest_sigma = 0.0
    while reduced.names:
        variables = reduced.names, reduced.labels
        try:
            poor_at = None if problem.priors else lambda own, v: _poorly_determined(own, v, own.variance(v))
            solution = reduced.solve(progress, optima.get(variables), poor_at)
        except ConvergenceError:
            if problem.priors:
                raise
            # Poorly determined parameters make a solve diverge. They are judged by the sigmas or,
            # if these show none, by the residuals at the start.
            at = np.zeros(reduced.size)
            worse = _poorly_determined(reduced, at, 1.0) or _poorly_determined(reduced, at, reduced.variance(at))
            if not worse:
                raise
        else:
            optima[variables] = solution.v
            largest_sigma = largest_sigma or _largest_residual_sigma(reduced, solution.v)
            worse = {} if problem.priors else _poorly_determined(reduced, solution.v, reduced.variance(solution.v))
            if not worse:
                more = _with_visible(reduced, solution.v, analysis, problem.names)
                if more is None:
                    others = {**analysis.unidentifiable, **poor}
                    return reduced, solution, replace(analysis, independent=reduced.names, unidentifiable=others)
                reduced, start = more
                others = {n: why for n, why in analysis.unidentifiable.items() if n not in reduced.names}
                analysis = replace(analysis, unidentifiable=others)
                optima.setdefault((reduced.names, reduced.labels), start)
        poor |= worse
        reduced = reduced.with_names([n for n in reduced.names if n not in worse])
    if largest_sigma > MAX_RESIDUAL_OF_REACH * problem.robot.reach:
        frames = (("base", problem.robot.base), ("tool", problem.robot.tool))
        fixed_frames = " and ".join(name for name, frame in frames if frame.unknown == "none")
        fixed_frame_remedy = (
            f'; known here: {fixed_frames}; unknown = "pose" or "position" has them fitted (robot file, Placement)'
        )
        raise InputError(
            f"{problem.sets[0].source}: the model does not fit: {1e3 * largest_sigma:.3g} mm per coordinate remain "
            "after the best fit; check the signs and zeros of the joints, their order, units and the DH convention"
            f"{fixed_frames and fixed_frame_remedy}"
        )
    fixed = [f"{name}: {why}" for name, why in {**poor, **analysis.unidentifiable}.items()]
    reasons = "; ".join(fixed[:6]) + (f"; and {len(fixed) - 6} more" if len(fixed) > 6 else "")
    raise InputError(
        f"{problem.sets[0].source}: these measurements determine none of the parameters to be identified. {reasons}"
    )


def _with_visible(
    problem: LeastSquares, v: Array, found: Identifiability, order: Sequence[str]
) -> tuple[LeastSquares, Array] | None:
    """Return the problem extended by parameters that have an effect only at its optimum v.

    They had none at the start, or tilt the pedestal of a robot that is `weighed`. The point v in
    the extended problem is returned too; None if there is no such parameter.
    """
    robot, tilts = problem.robot, set[str]()
    if problem.weighed and robot.gravity_frame == "measuring" and any(j.compliance is not None for j in robot.joints):
        # A tilt of the pedestal also changes the effect of gravity on the joints.
        tilts = {n for n in ("base_rx", "base_ry", "base_rz") if found.unidentifiable.get(n) == GAUGE_REASON}
    hidden = {n for n, why in found.unidentifiable.items() if why == NO_EFFECT_REASON} | tilts
    if not hidden:
        return None
    wider, at = _with_added_parameters(problem, v, hidden, order)
    seen = np.sqrt(np.diag(wider.information(at))[: len(wider.names)])
    visible = {
        n for n, length in zip(wider.names, seen, strict=True) if length > MAX_INVISIBLE_LENGTH_RATIO * seen.max()
    } & hidden
    if not visible:
        return None
    if visible != hidden:
        wider, at = _with_added_parameters(problem, v, visible, order)
    # The variance is that after one step: what the added parameters explain is not noise.
    cost_ratio = max(0.0, 1 - wider.decrement(at) / max(wider.cost(at), 1e-300))
    worse = {*_poorly_determined(wider, at, cost_ratio * problem.variance(v), tilts)}
    if not visible & worse:
        return wider, at
    return None if visible <= worse else _with_added_parameters(problem, v, visible - worse, order)


def _with_added_parameters(
    problem: LeastSquares, v: Array, more: set[str], order: Sequence[str]
) -> tuple[LeastSquares, Array]:
    """Return the problem with additional free parameters, and the point v in it."""
    names = [n for n in order if n in more or n in problem.names]
    own = np.zeros(len(names))
    own[[names.index(n) for n in problem.names]] = v[: len(problem.names)]
    return problem.with_names(names), np.concatenate([own, v[len(problem.names) :]])


def _largest_residual_sigma(problem: LeastSquares, v: Array) -> float:
    """Return the residual standard deviation of a coordinate at v, the largest of all sets [m]."""
    return float(np.sqrt(problem.variance(v))) * max(sigma for sigma, _ in problem.sigmas)


def _poorly_determined(
    problem: LeastSquares, v: Array, variance: float, of_data: Collection[str] = ()
) -> dict[str, str]:
    """Return the reasons, by name, of parameters with a standard error at v above their prior's.

    variance : of a residual in units of sigma squared
    """
    H = problem.gradient(v)[1].copy()
    at = [k for k, name in enumerate(problem.names) if name in of_data]
    H[at, at] -= np.diag(problem.prior_matrix)[at]
    return drop_poor([problem.robot.parameters[n] for n in problem.names], H, variance)[1]


# The reason given for parameters that move the robot as a whole.
GAUGE_REASON = "nothing at rest was measured: moving the whole robot changes nothing"


def independent_parameters(problem: LeastSquares) -> Identifiability:
    """Return which parameters the data determine, by the Jacobian at v = 0 (nominal values).

    Gravity torques are those of the nominal geometry where joints are compliant or the robot has
    effects. Where nothing determines the scale, the longest length is fixed as its reference. With
    priors on more than MANY_PARAMETERS, those of effects are not tested: they count as independent.
    Raises InputError, with the row, where the Jacobian is not finite.
    """
    robot, names, p = problem.robot, problem.names, len(problem.names)
    loaded = any(j.compliance is not None for j in robot.joints) or bool(robot.effects)
    own = [robot.parameters[n] for n in names]
    fixed = {parameter.name: parameter.fixed_reason for parameter in own if parameter.fixed_reason}
    # Names of the parameters that move the robot as a whole relative to the measuring frame.
    whole = ("alpha0", "a0", "beta0", "b0", "d1", "theta1", *(f"base_{c}" for c in ("x", "y", "z", "rx", "ry", "rz")))
    if not any(find_kind(m.kind).at_rest(m.arrays) for m in problem.sets):
        fixed |= dict.fromkeys(whole, GAUGE_REASON)
    of_effects = {e.label for e in robot.effects}
    wide = bool(problem.priors) and p > MANY_PARAMETERS  # effects with priors need no test of independence
    asked = [k for k, parameter in enumerate(own) if not (wide and parameter.group in of_effects)]
    columns = [*range(p, problem.size), *asked]
    with_loads = problem
    if wide or loaded != problem.fixed_loads:
        with_loads = replace(problem, names=tuple(names[k] for k in asked), fixed_loads=loaded)
    zero = np.zeros(with_loads.size)
    R = with_loads.triangle(zero)[:, [*range(len(asked), with_loads.size), *range(len(asked))]]
    if not np.isfinite(R).all() and (found := with_loads.undefined(zero)):
        raise undefined(robot, *found)
    if problem.priors and problem.residual_count <= problem.size:
        # There are too few data to find confounded parameters without the priors.
        R = np.concatenate([R, np.diag(np.sqrt(np.diag(problem.prior_matrix)))[:, columns]])
    points = 3 * len(problem.labels)
    analysis = analyse(R, [names[k] for k in asked], points, fixed)
    if wide:
        return replace(analysis, independent=tuple(n for n in names if n not in analysis.unidentifiable))
    if any(find_kind(m.kind).has_scale or m.separations for m in problem.sets):
        return analysis
    determined = analysis.independent
    longest = best_of(determined, lambda n: abs(_length(problem, n))) if determined else ""
    if not longest or not _scale_is_free(problem):
        return analysis
    fixed[longest] = "contacts without known separations do not determine the scale; this length is its reference"
    return analyse(R, names, points, fixed)


def _length(problem: LeastSquares, name: str) -> float:
    """Return the nominal value of a parameter that is a length [m]; zero for others."""
    parameter = problem.robot.parameters[name]
    return parameter.value if parameter.unit == "m" else 0.0


def _scale_is_free(problem: LeastSquares) -> bool:
    """Return whether a common factor on all lengths and points only scales the residuals by it.

    Contact residuals p - u are then homogeneous in lengths and points, and by Euler's theorem J
    (lengths, points) = residuals. Compliance violates this by its share of the position, which
    provides no scale: hence the tolerance of 1 %.
    """
    residuals, J = problem.evaluate(np.zeros(problem.size))
    lengths = np.array([_length(problem, n) for n in problem.names]) / problem.scale
    of = {name: find_kind(m.kind) for k, m in enumerate(problem.sets) for name in problem.pose_labels(k)}
    places, origin = zip(problem.labels, problem.points, strict=True), problem.robot.base.T[:3, 3]
    moved = [of[name].grown(point[None], origin).ravel() / M_PER_MM for name, point in places]
    growth = np.concatenate([lengths, *moved])
    r = np.concatenate([part.ravel() for part in residuals])
    robot_alone = np.linalg.norm(J[:, : lengths.size] @ lengths)
    return bool(robot_alone > 0 and np.linalg.norm(J @ growth - r) < 0.01 * robot_alone)
