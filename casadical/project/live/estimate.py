"""Estimate of a robot from few readings: a linear fit with priors whose widths the data choose.

The noise of a coordinate and the factor on the robot's own prior standard deviations are averaged
over grids, weighted by their evidence (MacKay 1992, "Bayesian interpolation", eqs. 2.6 and 4.5);
the uncertainty of a prediction is therefore available from the fifth reading on. Base and tool are
placed by the readings and are free, and so are the points that a kind of measurement leaves
unknown: what is touched, anchors of distances. The noise of an angle is that of a length times the
most probable of some ratios.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import M_PER_MM, Array
from casadical.core.linear_gaussian.normal_equations import joined
from casadical.core.statistics import best_of, first_of_best
from casadical.identification.accuracy import predicted
from casadical.identification.least_squares import FRAME_GROUPS, LeastSquares
from casadical.identification.pose_selection.candidates import scaled_jacobian
from casadical.identification.pose_selection.instruments import without_base
from casadical.identification.sessions import place_sessions
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import SESSION_PREFIX, Measurements
from casadical.robot.robot import Robot

# Minimum number of readings of an estimate; readings are judged by each other once there are more.
MIN_READINGS_OF_FIT = 5
# Maximum number of readings of which each is judged by a refit without it; of more, each is judged
# by its leave-one-out residual of the common fit. From this number on their mean error is reported.
MAX_REFITTED_READINGS = 12
# Maximum standard deviation [mm] of the prediction of a reading that is judged, and of the scaled
# parameters of a base that the readings determine.
MAX_PREDICTION_SIGMA_MM = 100.0


@dataclass(frozen=True, eq=False)
class Estimate:
    """The robot as some readings determine it.

    robot : robot with the estimated values
    names : names of the fitted parameters
    points : unknown points that the readings refer to, by their labels, in the measuring frame [m]
    covariance : covariance of parameters and points, shape (p + 3 K, p + 3 K), in units of scale
        and mm
    sigma : standard deviation of a coordinate [m]
    ratio : standard deviation of an angle over that of a coordinate [mrad/mm]
    m : the readings
    left_out : leave-one-out residuals, shape (n, lengths) [m], NaN where the others do not predict
        the reading
    surprise : squared leave-one-out residuals, angles included, in units of their covariance, shape
        (n,); 0 where the others do not predict the reading
    widened : factor on `limit`, as few readings determine the noise badly
    """

    robot: Robot
    names: tuple[str, ...]
    points: Mapping[str, Array]
    covariance: Array
    sigma: float
    ratio: float
    m: Measurements
    left_out: Array
    surprise: Array
    widened: float

    def __len__(self) -> int:
        return len(self.m)

    @property
    def limit(self) -> float:
        """Return the limit of a reading's `surprise`, above which noise does not explain it."""
        # By the number of scalars observed in a reading, 1 to 6: the quantiles of chi-squared that
        # noise exceeds in 1 of 700 000.
        return (23.3, 27.0, 30.0, 32.7, 35.2, 37.5)[find_kind(self.m.kind).numbers - 1] * self.widened

    def misses(self, m: Measurements) -> tuple[Array, Array]:
        """Return residuals (n, lengths) [m] of other readings from predictions, and surprise (n,).

        The surprise is the squared Mahalanobis distance of a reading, angles included, from its
        prediction. Where a four-bar cannot close it is infinite; for a point that no reading of the
        estimate refers to, residuals and surprise are zero.
        """
        kind, labels = find_kind(m.kind), labels_of(m)
        off, square = np.zeros((len(m), kind.lengths)), np.zeros(len(m))
        rows = np.flatnonzero([name in self.points for name in labels] if labels else np.ones(len(m), dtype=bool))
        if not len(rows):
            return off, square
        some = replace(m[rows], separations=())
        r, J, points, _ = linearised(self.robot, self.names, some, self.ratio, self.points)
        at, p = {name: k for k, name in enumerate(self.points)}, len(self.names)
        column = [p + 3 * at[name] + i for name in points for i in range(3)]
        C = self.covariance[np.ix_([*range(p), *column], [*range(p), *column])]
        off[rows], square[rows] = M_PER_MM * r[:, : kind.lengths], np.inf
        closed = np.isfinite(r).all(axis=1) & np.isfinite(J).all(axis=(1, 2))
        J, r = J[closed], r[closed]
        C = J @ C @ J.transpose(0, 2, 1) + (self.sigma / M_PER_MM) ** 2 * np.eye(J.shape[1])
        square[rows[closed]] = np.einsum("ni,ni->n", r, np.linalg.solve(C, r[..., None])[..., 0])
        return off, square

    def expected(self, task: Measurements) -> float:
        """Return the expected rms position error of the estimated robot over a task's poses [m].

        Where the readings do not determine the base, it is fitted to the task.
        """
        p, J = len(self.names), scaled_jacobian(self.robot, self.names, task)
        base = [k for k, name in enumerate(self.names) if self.robot.parameters[name].group == "base"]
        if not base or self.covariance[base, base].max() > MAX_PREDICTION_SIGMA_MM**2:
            J = without_base(self.robot, J, task)
        return M_PER_MM * float(
            np.sqrt(np.einsum("kip,pq,kiq->", J, self.covariance[:p, :p], J, optimize=True) / len(J))
        )


def names_of(robot: Robot, m: Measurements) -> tuple[str, ...]:
    """Return the names of the parameters to estimate: geometry, compliance, tool and sessions.

    Those of the base are included where the readings refer to something at rest.
    """
    excluded = () if find_kind(m.kind).at_rest(m.arrays) else ("base",)
    sessions = (n for n in robot.parameters.names if n.startswith(SESSION_PREFIX))
    names = (*robot.parameters.select(("kinematic", "compliance")), *sessions)
    return tuple(name for name in names if robot.parameters[name].group not in excluded)


def labels_of(m: Measurements) -> list[str]:
    """Return the label of each reading's unknown point; [] where its kind has none."""
    return list(find_kind(m.kind).point_names(m.arrays))


def linearised(
    robot: Robot,
    names: tuple[str, ...],
    m: Measurements,
    ratio: float = 1.0,
    points: Mapping[str, Array] | None = None,
) -> tuple[Array, Array, Mapping[str, Array], tuple[Array, Array]]:
    """Return readings linearised at a robot's values.

    These are residuals, measured minus computed, shape (n, numbers) [mm, angles in `ratio` mrad];
    the Jacobian of computed values by the scaled parameters and then the coordinates [mm] of the
    points, shape (n, numbers, p + 3 K); these unknown points by their labels, in the order of the
    columns, in the measuring frame, shape (3,) each [m]; residuals of given distances between
    points, and their Jacobian, in units of sigma, shapes (s,) and (s, p + 3 K).

    names : parameters of the Jacobian; ratio : unit of an angle's residual [mrad]
    points : unknown points by label [m]; None: as estimated from the robot's positions
    """
    problem = LeastSquares(robot, (m,), names, "linear", False, ((M_PER_MM, M_PER_MM * ratio),))
    labels = list(dict.fromkeys(labels_of(m)))
    if points is not None:
        problem = problem.from_points(np.array([points[name] for name in labels]).reshape(-1, 3))
    (r, *apart), J = problem.evaluate(np.zeros(problem.size))
    if (turn := m.arrays.get("orientation", m.arrays.get("turn"))) is not None:
        R = predicted(robot, m)[1]
        R = R if m.other is None else predicted(robot, replace(m, q=m.other))[1].transpose(0, 2, 1) @ R
        turned = np.einsum("nij,nij->n", R, turn) < 1.0  # the sine is blind to half a turn
        r = np.where(turned[:, None] & (np.arange(r.shape[1]) >= 3), np.pi / (M_PER_MM * ratio), r)
    separated = (-apart[0].ravel() if apart else np.zeros(0), J[r.size :])
    located = dict(zip(labels, problem.points, strict=True))
    return -r, J[: r.size].reshape(*r.shape, -1), located, separated


def estimate(robot: Robot, m: Measurements, placed: Robot | None = None) -> Estimate:
    """Return the robot as these readings determine it, by a linear fit that is iterated.

    robot : nominal robot
    placed : robot with initial base and tool frames; None: they are fitted to the readings
    """
    placed, kind = placed or place_sessions(robot, (m,)), find_kind(m.kind)
    names = names_of(placed, m)
    own = [placed.parameters[name] for name in names]
    scale, value, lower, upper = (
        np.array([getattr(p, what) for p in own]) for what in ("scale", "value", "lower", "upper")
    )
    # Candidate ratios of an angle's sigma to that of a coordinate [mrad/mm].
    now, ratios = placed, np.geomspace(0.3, 30.0, 7) if kind.angles else np.ones(1)
    off, J, start, separated = linearised(now, names, m)
    points = start
    # Prior standard deviation of base, tool and points about where they were placed [mm, mrad]; it
    # is wide enough to leave them free.
    free_sigma = 1e3
    frames = [p.group in FRAME_GROUPS or (p.name.startswith(SESSION_PREFIX) and ".zero" not in p.name) for p in own]
    free = np.concatenate([np.where(frames, free_sigma * M_PER_MM / scale, 0.0), np.full(3 * len(start), free_sigma)])
    width = np.append(np.array([p.prior for p in own]) / scale, np.ones(3 * len(start)))
    x, p, angles = np.zeros(len(free)), len(names), np.arange(kind.numbers) >= kind.lengths
    for step in range(15):  # three, and more while points move by 0.1 mm
        if step:
            off, J, _, separated = linearised(now, names, m, points=points)
        y, apart = off + J @ x, (separated[0] + separated[1] @ x, separated[1])
        fits = [(*_by_evidence(J, y, np.where(angles, 1 / r, 1.0), free, width, apart), float(r)) for r in ratios]
        _, sigma, C, b, ratio = best_of(fits, lambda fit: fit[0], logs=True)
        ratios = np.array([ratio])
        before, x = x, C @ b
        values = np.clip(value + scale * x[:p], lower, upper)
        x[:p], now = (values - value) / scale, placed.with_values(dict(zip(names, values, strict=True)))
        points = dict(zip(start, [*start.values()] + M_PER_MM * x[p:].reshape(-1, 3), strict=True)) if start else start
        if step >= 2 and np.abs(x[p:] - before[p:]).max(initial=0.0) < 0.1:
            break
    r = linearised(now, names, m, ratio, points)[0]
    J = J * np.where(angles, 1 / ratio, 1.0)[:, None]
    redundant = np.eye(kind.numbers) - J @ C @ J.transpose(0, 2, 1) / sigma**2
    fixed = np.linalg.eigvalsh(redundant)[:, 0] > (sigma / MAX_PREDICTION_SIGMA_MM) ** 2
    redundant[~fixed] = np.eye(kind.numbers)
    off = np.where(fixed[:, None], np.linalg.solve(redundant, r[..., None])[..., 0], np.nan)
    # A noise that few readings determine widens the limit, about as the F distribution does.
    freedom = max(float(np.trace(redundant, axis1=1, axis2=2).sum()), 1.0)
    left_out = M_PER_MM * off[:, : kind.lengths]
    surprise = np.nan_to_num(np.einsum("ni,ni->n", off, r)) / sigma**2
    widened = 1 + 20.0 / freedom
    return Estimate(now, names, points, C, M_PER_MM * sigma, ratio, m, left_out, surprise, widened)


def _by_evidence(
    J: Array, y: Array, weight: Array, free: Array, width: Array, apart: tuple[Array, Array]
) -> tuple[float, float, Array, Array]:
    """Fit y = J x + noise, with noise and prior width averaged over grids by their evidence.

    J, y : shapes (n, numbers, x) and (n, numbers) [mm]
    weight : weights of the numbers of a reading, shape (numbers,)
    free : prior standard deviation of the free unknowns, zero for the others, shape (x,)
    width : prior standard deviations that the factor scales, shape (x,)
    apart : y and J of observations with a sigma of one, shapes (s,) and (s, x)
    Returns the logarithm of the evidence, the noise [mm], the covariance (x, x), and the right-hand
    side (x,), which times the covariance is the estimate
    """
    normal = len(y) * float(np.log(weight).sum())
    J, y = (J * weight[:, None]).reshape(-1, J.shape[2]), (y * weight).ravel()
    G, b, square = J.T @ J, J.T @ y, float(y @ y)
    prior_information, prior_rhs = apart[1].T @ apart[1], apart[1].T @ apart[0]
    # Grid of one sigma of a coordinate [mm] over which the evidence is computed.
    noise_grid_mm = np.geomspace(0.008, 60.0, 22)
    # Grid of the factor on the robot's prior standard deviations, the other hyperparameter.
    precisions = np.where(free > 0, free, np.array([0.1, 0.25, 0.6, 1.5])[:, None] * width) ** -2
    logs = np.empty((len(precisions), len(noise_grid_mm)))
    for i, P in enumerate(precisions):
        prior = np.diag(P) + prior_information
        before = joined(prior, prior_rhs, 0.0, 0.0)
        for j, s in enumerate(noise_grid_mm):
            fit = joined(prior + G / s**2, prior_rhs + b / s**2, square / s**2 - before.square, -before.log_norm)
            logs[i, j] = fit.log_norm - 0.5 * fit.square - len(y) * np.log(s)
    weights = np.exp(logs - logs.max())
    evidence = normal + float(logs.max() + np.log(weights.sum()))
    weights /= weights.sum()
    sigma = float(np.sqrt((weights.sum(axis=0) * noise_grid_mm**2).sum()))
    variance = (weights.sum(axis=1)[:, None] / precisions).sum(axis=0)
    C = np.linalg.inv(G / sigma**2 + np.diag(1 / variance) + prior_information)
    return evidence, sigma, C, b / sigma**2 + prior_rhs


def robust_estimate(robot: Robot, m: Measurements, doubtful: Array) -> tuple[Estimate | None, Array, Array]:
    """Return the estimate without contradicted readings, a mask of these, and all residuals.

    A reading is contradicted if its surprise exceeds the limit.

    doubtful : mask of the readings that were contradicted before, shape (n,)
    Returns the estimate, None of too few readings, the mask of contradicted readings, shape (n,),
    and residuals, shape (n, lengths) [m].
    """
    out, lengths, labels = doubtful.copy(), find_kind(m.kind).lengths, np.array(labels_of(m))
    if len(m) < MIN_READINGS_OF_FIT:
        return None, np.zeros(len(m), dtype=bool), np.zeros((len(m), lengths))
    if (~out).sum() < MIN_READINGS_OF_FIT:  # the first ones judge each other
        out[:MAX_REFITTED_READINGS] = False
    named = [flag > 0 for name, flag in m.conditions.items() if name.startswith((SESSION_PREFIX, "tool_"))]
    for own in (*(labels == name for name in set(labels)), *named):
        # Likewise the readings of a point of which half are doubted.
        out[own] &= 2 * out[own].sum() < own.sum()
    # Without positions or given anchors, placing is a search that outliers do not mislead.
    placed = place_sessions(robot, (m,)) if m.position is None and m.target is None else None
    for _ in range(3 + len(m) // 10):
        inside = np.flatnonzero(~out)
        estimated = estimate(robot, m[inside], placed)
        surprise, off = np.zeros(len(m)), np.zeros((len(m), lengths))
        off[inside], surprise[inside] = estimated.left_out, estimated.surprise
        if MIN_READINGS_OF_FIT < len(inside) <= MAX_REFITTED_READINGS:
            without = (estimate(robot, m[np.delete(inside, k)], placed) for k in range(len(inside)))
            surprise[inside] = [each.misses(m[inside[[k]]])[1][0] for k, each in enumerate(without)]
        if out.any():
            off[out], surprise[out] = estimated.misses(m[np.flatnonzero(out)])
        worst = int(inside[first_of_best(surprise[inside])])
        if surprise[worst] > estimated.limit and len(inside) > MIN_READINGS_OF_FIT:
            out[worst] = True
        elif (back := out & (surprise <= estimated.limit)).any():
            out[back] = False
        else:
            break
    return estimated, out, off
