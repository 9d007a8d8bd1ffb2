"""Solve with the noise that the data show, and without outliers: the rounds around one least squares problem."""

from dataclasses import replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import robust_std
from casadical.identification.identifiability import Identifiability
from casadical.identification.least_squares import LeastSquares
from casadical.identification.reduction import Optima, reduce_and_solve
from casadical.identification.residuals import POINT_SCALE
from casadical.identification.solver import Progress, Solution
from casadical.measurements.kinds.registry import find_kind

Solved = tuple[LeastSquares, Solution, Identifiability]

# Quantiles of chi-squared at 1 - 1e-5, by degrees of freedom.
OUTLIER_CHI2 = {1: 19.51, 2: 23.03, 3: 25.90, 4: 28.47, 5: 30.86, 6: 33.11}
LEAST_REDUNDANCY = 0.1
# With a prior that explains nearly all, fewer degrees of freedom do not tell the noise.
TELLING = 10.0
SCREENINGS = 8
SIGMA_ROUNDS = 6
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
        change = np.abs(np.log(np.array(sigmas) / np.array(problem.sigmas))).max()
        problem = replace(problem, sigmas=sigmas)
        if change < 0.03:
            break
    return solved


def _with_freedom(problem: LeastSquares, solution: Solution) -> list[tuple[Array, Array]]:
    """Residuals of each set and the degrees of freedom of each, both of shape (n, m)."""
    residuals = problem.residuals(solution.v)
    edges = np.cumsum([r.size for r in residuals])
    shares = np.split(problem.redundancies(solution.v), edges)
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


def outlier_masks(problem: LeastSquares, solution: Solution) -> list[Array]:
    """Masks of the poses whose residuals noise of their spread would exceed once in 100 000."""
    masks = []
    for r, freedom in _with_freedom(problem, solution):
        # A pose that draws the fit towards itself shows little of its error.
        z = r / np.sqrt(np.maximum(freedom, LEAST_REDUNDANCY))
        masks.append((z**2).sum(axis=1) > OUTLIER_CHI2[r.shape[1]] * robust_std(z) ** 2)
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
        np.flatnonzero((r**2).sum(axis=1) <= OUTLIER_CHI2[r.shape[1]] * own**2)
        for r, own in zip(whole.residuals(v), spread, strict=False)
    ]
