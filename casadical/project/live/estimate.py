"""What is known of a robot after few readings: a linear fit with priors, whose two widths the readings themselves tell.

Noise of a coordinate and departure from nominal (as a factor on the robot's own priors) are those of a grid, weighted
by their evidence (MacKay 1992, "Bayesian interpolation", eqs. 2.6 and 4.5): a prediction is as sure as the readings
until now make it, from the fifth on. Base and tool are put where the readings say and are free, and so are the points
that a kind leaves unknown: what is touched, far ends of distances. An angle's noise is the length's times the most
evident of some ratios.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.grid import gain
from casadical.core.linear_gaussian.normal_equations import root_of_inverse
from casadical.core.parameters import Parameter
from casadical.core.statistics import best_of, first_of_best
from casadical.identification.accuracy import predicted
from casadical.identification.least_squares import FRAME_GROUPS, LeastSquares
from casadical.identification.sessions import PREFIX, place_sessions
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.pose_selection.information import MM, scaled_jacobian
from casadical.pose_selection.instruments import without_base
from casadical.robot.robot import Robot

# Readings from which on one is judged by the others.
FEWEST = 5
# Of so few readings each is judged by a fit without it.
FEW = 12
# Squared distance of a reading from its prediction, in units of their covariance, by how many numbers it has: exceeded
# by noise in 1 of 700 000.
LIMITS = {1: 23.3, 2: 27.0, 3: 30.0, 4: 32.7, 5: 35.2, 6: 37.5}
# One sigma of a coordinate [mm], and factors on the priors, whose evidence is compared.
SIGMAS = np.geomspace(0.008, 60.0, 22)
WIDTHS = np.array([0.1, 0.25, 0.6, 1.5])
# One sigma of base, tool and points about where they were put [mm, mrad]: they are not known.
FREE = 1e3
# A reading is not judged where the others predict it with a sigma of more than this [mm].
UNTOLD = 100.0


@dataclass(frozen=True, eq=False)
class Seen:
    """Readings beside the model: measured less computed, shape (n, numbers), and the model's Jacobian by parameters
    and then the points, (n, numbers, p + 3 K) [mm and ratio mrad].

    points : unknown ones by their labels, in the order of the columns, shape (3,) each [m]
    separated : of known distances between points, in units of sigma, shapes (s,) and (s, p + 3 K)
    """

    off: Array
    J: Array
    points: Mapping[str, Array]
    separated: tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Estimate:
    """The robot as some readings tell it.

    robot : with their values; names : of the parameters that were fitted
    points : unknown ones that the readings refer to, by their labels [m]
    covariance : of parameters and points, shape (p + 3 K, p + 3 K), units of scale and mm
    sigma : of a coordinate [m]; ratio : of an angle's to it [mrad/mm]
    m : the readings; left_out : what each would miss the model of the others by, shape (n, lengths) [m], not a number
    where they do not predict it; surprise : the same squared, angles with it, in units of its covariance, shape (n,)
    widened : the limit of surprises over `LIMITS`
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
    def left_out_mm(self) -> Array:
        """How far each reading is from the model of the others, of those that these predict, shape (k,) [mm]."""
        left = np.linalg.norm(self.left_out, axis=1) / MM
        return np.asarray(left[np.isfinite(left)])

    @property
    def limit(self) -> float:
        """Of the surprise of a reading that noise explains."""
        return LIMITS[find_kind(self.m.kind).numbers] * self.widened

    def misses(self, m: Measurements) -> tuple[Array, Array]:
        """What readings miss the prediction by, shape (n, lengths) [m], and its square, angles with it, in units of
        its covariance, shape (n,).

        Where a four-bar cannot close, the latter are infinite; of a point that no reading told both are zero.
        """
        kind, labels = find_kind(m.kind), labels_of(m)
        off, square = np.zeros((len(m), kind.lengths)), np.zeros(len(m))
        rows = np.flatnonzero([name in self.points for name in labels] if labels else np.ones(len(m), dtype=bool))
        if not len(rows):
            return off, square
        seen = observed(self.robot, self.names, replace(m[rows], separations=()), self.ratio, self.points)
        at, p = {name: k for k, name in enumerate(self.points)}, len(self.names)
        column = [p + 3 * at[name] + i for name in seen.points for i in range(3)]
        C = self.covariance[np.ix_([*range(p), *column], [*range(p), *column])]
        off[rows], square[rows] = MM * seen.off[:, : kind.lengths], np.inf
        closed = np.isfinite(seen.off).all(axis=1) & np.isfinite(seen.J).all(axis=(1, 2))
        J, r = seen.J[closed], seen.off[closed]
        C = J @ C @ J.transpose(0, 2, 1) + (self.sigma / MM) ** 2 * np.eye(J.shape[1])
        square[rows[closed]] = np.einsum("ni,ni->n", r, np.linalg.solve(C, r[..., None])[..., 0])
        return off, square

    def expected(self, task: Measurements) -> float:
        """Root mean square error of the robot itself to expect over a task [m].

        Where readings do not tell where the base is, it is where the task has it.
        """
        p, J = len(self.names), scaled_jacobian(self.robot, self.names, task)
        base = [k for k, name in enumerate(self.names) if self.robot.parameters[name].group == "base"]
        if not base or self.covariance[base, base].max() > UNTOLD**2:
            J = without_base(self.robot, J, task)
        return MM * float(np.sqrt(np.einsum("kip,pq,kiq->", J, self.covariance[:p, :p], J, optimize=True) / len(J)))


def names_of(robot: Robot, m: Measurements) -> tuple[str, ...]:
    """What is estimated: geometry, compliance, tool, and the base where readings see something at rest."""
    held = () if find_kind(m.kind).at_rest(m.arrays) else ("base",)
    sessions = (n for n in robot.parameters.names if n.startswith(PREFIX))
    names = (*robot.parameters.select(("kinematic", "compliance")), *sessions)
    return tuple(name for name in names if robot.parameters[name].group not in held)


def _is_frame(p: Parameter) -> bool:
    """Whether a parameter says where base or tool are, in some session."""
    return p.group in FRAME_GROUPS or (p.name.startswith(PREFIX) and ".zero" not in p.name)


def labels_of(m: Measurements) -> list[str]:
    """The label of each reading's unknown point; none where its kind has none."""
    return list(find_kind(m.kind).point_names(m.arrays))


def observed(
    robot: Robot, names: tuple[str, ...], m: Measurements, ratio: float = 1.0,
    points: Mapping[str, Array] | None = None,
) -> Seen:  # fmt: skip
    """Readings beside the model; points : where unknown ones are, None: where the readings put them."""
    problem = LeastSquares(robot, (m,), names, "linear", False, ((MM, MM * ratio),))
    labels = list(dict.fromkeys(labels_of(m)))
    if points is not None:
        problem = problem.from_points(np.array([points[name] for name in labels]).reshape(-1, 3))
    (r, *apart), J = problem.evaluate(np.zeros(problem.size))
    if (turn := m.arrays.get("orientation", m.arrays.get("turn"))) is not None:
        R = predicted(robot, m)[1]
        R = R if m.other is None else predicted(robot, replace(m, q=m.other))[1].transpose(0, 2, 1) @ R
        turned = np.einsum("nij,nij->n", R, turn) < 1.0  # a residual that is the sine does not see half a turn
        r = np.where(turned[:, None] & (np.arange(r.shape[1]) >= 3), np.pi / (MM * ratio), r)
    separated = (-apart[0].ravel() if apart else np.zeros(0), J[r.size :])
    return Seen(-r, J[: r.size].reshape(*r.shape, -1), dict(zip(labels, problem.points, strict=True)), separated)


def estimate(robot: Robot, m: Measurements, placed: Robot | None = None) -> Estimate:
    """The robot as these readings tell it; robot : nominal; placed : with its frames where they stand, if known."""
    placed, kind = placed or place_sessions(robot, (m,)), find_kind(m.kind)
    names = names_of(placed, m)
    own = [placed.parameters[name] for name in names]
    scale, value, lower, upper = (
        np.array([getattr(p, what) for p in own]) for what in ("scale", "value", "lower", "upper")
    )
    # An angle's sigma over a coordinate's [mrad/mm].
    now, ratios = placed, np.geomspace(0.3, 30.0, 7) if kind.angles else np.ones(1)
    seen = observed(now, names, m)
    points = start = seen.points
    free = np.concatenate([[FREE * MM / p.scale if _is_frame(p) else 0.0 for p in own], np.full(3 * len(start), FREE)])
    width = np.append(np.array([p.prior for p in own]) / scale, np.ones(3 * len(start)))
    x, p, angles = np.zeros(len(free)), len(names), np.arange(kind.numbers) >= kind.lengths
    for step in range(15):  # three, unless unknown points still move by more than 0.1 mm
        seen = observed(now, names, m, points=points) if step else seen
        y, apart = seen.off + seen.J @ x, (seen.separated[0] + seen.separated[1] @ x, seen.separated[1])
        fits = [(*_by_evidence(seen.J, y, np.where(angles, 1 / r, 1.0), free, width, apart), float(r)) for r in ratios]
        _, sigma, C, b, ratio = best_of(fits, lambda fit: fit[0], logs=True)
        ratios = np.array([ratio])
        before, x = x, C @ b
        values = np.clip(value + scale * x[:p], lower, upper)
        x[:p], now = (values - value) / scale, placed.with_values(dict(zip(names, values, strict=True)))
        points = dict(zip(start, [*start.values()] + MM * x[p:].reshape(-1, 3), strict=True)) if start else start
        if step >= 2 and np.abs(x[p:] - before[p:]).max(initial=0.0) < 0.1:
            break
    r = observed(now, names, m, ratio, points).off
    J = seen.J * np.where(angles, 1 / ratio, 1.0)[:, None]
    redundant = np.eye(kind.numbers) - J @ C @ J.transpose(0, 2, 1) / sigma**2
    fixed = np.linalg.eigvalsh(redundant)[:, 0] > (sigma / UNTOLD) ** 2
    redundant[~fixed] = np.eye(kind.numbers)
    off = np.where(fixed[:, None], np.linalg.solve(redundant, r[..., None])[..., 0], np.nan)
    # Of a noise that few numbers tell the limit is wider, about as Fisher's F is.
    freedom = max(float(np.trace(redundant, axis1=1, axis2=2).sum()), 1.0)
    return Estimate(
        now, names, points, C, MM * sigma, ratio, m, MM * off[:, : kind.lengths],
        np.nan_to_num(np.einsum("ni,ni->n", off, r)) / sigma**2, 1 + 20.0 / freedom,
    )  # fmt: skip


def _by_evidence(
    J: Array, y: Array, weight: Array, free: Array, width: Array, apart: tuple[Array, Array]
) -> tuple[float, float, Array, Array]:
    """Of y = J x + noise, shapes (n, numbers, x) and (n, numbers): logarithm of the evidence, noise [mm], covariance,
    shape (x, x), and what it makes x of, (x,).

    weight : of the numbers of a reading, shape (numbers,); free : one sigma of what has no prior, else zero, shape (x,)
    apart : further y and J that are known with a sigma of one, shapes (s,) and (s, x)
    """
    normal = len(y) * float(np.log(weight).sum())
    J, y = (J * weight[:, None]).reshape(-1, J.shape[2]), (y * weight).ravel()
    G, b, square = J.T @ J, J.T @ y, float(y @ y)
    known, of_known = apart[1].T @ apart[1], apart[1].T @ apart[0]
    logs, precisions = np.empty((len(WIDTHS), len(SIGMAS))), []
    for i, factor in enumerate(WIDTHS):
        P = np.where(free > 0, free, factor * width) ** -2
        precisions.append(P)
        at = np.linalg.solve(np.diag(P) + known, of_known)  # mean before the readings
        root = root_of_inverse(np.diag(P) + known)
        values, V = np.linalg.eigh(root @ G @ root.T)
        along = (V.T @ (root @ (b - G @ at))) ** 2
        left = square - 2 * float(at @ b) + float(at @ G @ at)
        logs[i] = -0.5 * left / SIGMAS**2 - len(y) * np.log(SIGMAS)
        logs[i] += gain(SIGMAS**2, SIGMAS, np.maximum(values, 0.0)[None], along[None])[0]
    weights = np.exp(logs - logs.max())
    evidence = normal + float(logs.max() + np.log(weights.sum()))
    weights /= weights.sum()
    sigma = float(np.sqrt((weights.sum(axis=0) * SIGMAS**2).sum()))
    variance = (weights.sum(axis=1)[:, None] / np.array(precisions)).sum(axis=0)
    C = np.linalg.inv(G / sigma**2 + np.diag(1 / variance) + known)
    return evidence, sigma, C, b / sigma**2 + of_known


def counted(robot: Robot, m: Measurements, doubtful: Array) -> tuple[Estimate | None, Array, Array]:
    """The estimate without readings that it contradicts; which these are, and how far each reading is off.

    doubtful : mask of those that were, shape (n,)
    Returns the estimate, None of too few readings, the mask, shape (n,), and what each misses, shape (n, lengths) [m].
    """
    out, lengths, labels = doubtful.copy(), find_kind(m.kind).lengths, np.array(labels_of(m))
    if len(m) < FEWEST:
        return None, np.zeros(len(m), dtype=bool), np.zeros((len(m), lengths))
    if (~out).sum() < FEWEST:  # the first are judged by each other, the others by them
        out[:FEW] = False
    named = [flag > 0 for name, flag in m.conditions.items() if name.startswith((PREFIX, "tool_"))]
    for own in (*(labels == name for name in set(labels)), *named):
        out[own] &= 2 * out[own].sum() < own.sum()  # and so are those of a point, where as many are doubted as not
    # Where nothing says where the point is, placing takes a search that outliers do not mislead.
    placed = place_sessions(robot, (m,)) if m.position is None and m.target is None else None
    for _ in range(3 + len(m) // 10):
        inside = np.flatnonzero(~out)
        estimated = estimate(robot, m[inside], placed)
        surprise, off = np.zeros(len(m)), np.zeros((len(m), lengths))
        off[inside], surprise[inside] = estimated.left_out, estimated.surprise
        if FEWEST < len(inside) <= FEW:
            without = (estimate(robot, m[np.delete(inside, k)], placed) for k in range(len(inside)))
            surprise[inside] = [each.misses(m[inside[[k]]])[1][0] for k, each in enumerate(without)]
        if out.any():
            off[out], surprise[out] = estimated.misses(m[np.flatnonzero(out)])
        worst = int(inside[first_of_best(surprise[inside])])
        if surprise[worst] > estimated.limit and len(inside) > FEWEST:
            out[worst] = True
        elif (back := out & (surprise <= estimated.limit)).any():
            out[back] = False
        else:
            break
    return estimated, out, off
