"""Initial base and tool frames from measurements, in closed form or with the robot file as prior.

The priors, one sigma each: the tool may differ from the file by 0.1 m, the base by a rotation of
0.3 rad and a shift of 100 m. The errors of a model that is not calibrated yet are about 3 mm and
not independent between poses: more than 30 poses give no more information than 30. Directions that
the measurements determine are freed of these priors in the end.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from casadical.core.basics import Array, ConvergenceError
from casadical.core.levenberg_marquardt import Evaluated, levenberg_marquardt
from casadical.core.statistics import best_of
from casadical.core.transforms import frame, from_xyz, nearest_rotation, to_xyz
from casadical.identification.accuracy import errors, predicted
from casadical.identification.least_squares import LeastSquares, initial_sigmas
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

# Ratio of prior variance to the variance by the measurements above which the priors no longer apply
# to a direction of the frames.
MIN_FREED_VARIANCE_RATIO = 100.0
# Matrix of the cross product, shape (3, 9): for vectors a and t, a x t is
# t @ (a @ _CROSS).reshape(3, 3).
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).reshape(3, 9)


@dataclass(frozen=True, eq=False)
class Readings:
    """Flange poses and the measured positions or distances of the tool point at them.

    p, R : flange positions (n, 3) [m] and orientations (n, 3, 3) in the base frame
    seen : measured positions in the measuring frame, shape (n, 3) [m], or distances to given
        places, shape (n,) [m]
    places : these places in the measuring frame, shape (n, 3) [m]; None for positions
    """

    p: Array
    R: Array
    seen: Array
    places: Array | None = None

    def rows(self, y: Array) -> tuple[Array, Array]:
        """Return residuals (n, k) [m] for tool points at y, and derivatives by y, (n, k, 3).

        Residuals are measured minus computed; derivatives are those of the computed values; k is 3
        for positions and 1 for distances.

        y : in the measuring frame, shape (n, 3) [m]
        """
        if self.places is None:
            return self.seen - y, np.broadcast_to(np.eye(3), (len(y), 3, 3))
        line = y - self.places
        length = np.maximum(np.linalg.norm(line, axis=1), 1e-9)
        return (self.seen - length)[:, None], (line / length[:, None])[:, None]


@dataclass(frozen=True, eq=False)
class FrameEstimate:
    """A base and tool frame, and the cost of this estimate.

    R, p : base orientation (3, 3) and position (3,) [m] in the measuring frame
    t : tool position in the flange frame, shape (3,) [m]
    cost : weighted sum of squared residuals, with the priors; dimensionless
    """

    R: Array
    p: Array
    t: Array
    cost: float = np.inf


class PlacementProblem:
    """The least squares problem of base and tool frames, with the robot file as prior.

    base, tool : base frame, shape (4, 4), and tool position, shape (3,) [m], of the robot file
    tool_fixed : whether the tool is fixed at the file's position
    """

    def __init__(self, readings: Sequence[Readings], base: Array, tool: Array, *, tool_fixed: bool) -> None:
        """Set up the prior about the frames of the robot file; arguments are as of the class."""
        self.readings, self.base, self.tool = readings, base, tool
        # One sigma of the rotation [rad], the shift [m] and the tool [m].
        sigma = np.repeat([0.3, 100.0, 1e-6 if tool_fixed else 0.1], 3)
        self.prior = np.diag(sigma**-2.0)

    def determined(self, at: FrameEstimate) -> bool:
        """Return whether the measurements alone determine base rotation and tool position well.

        That is, with a variance MIN_FREED_VARIANCE_RATIO times smaller than the prior's in every
        direction, with the errors of an uncalibrated model. A fixed tool is not judged.

        at : estimate at which the problem is linearised
        """
        H = self._sums(at)[0]
        own = [0, 1, 2, *(k for k in (6, 7, 8) if self.prior[k, k] < 1e6)]
        rest = [k for k in range(9) if k not in own]
        prior = self.prior[np.ix_(rest, rest)]
        across = H[np.ix_(rest, own)]
        less = H[np.ix_(own, own)] - across.T @ np.linalg.solve(H[np.ix_(rest, rest)] + prior, across)
        unit = np.diag(self.prior)[own] ** -0.5
        return bool(np.linalg.eigvalsh(less * np.outer(unit, unit))[0] > MIN_FREED_VARIANCE_RATIO)

    def best(self, starts: Sequence[FrameEstimate]) -> FrameEstimate:
        """Return the best local optimum from several starts.

        In directions that the measurements determine well, it is refined without the priors.
        """
        lowest = best_of((self._refined(start, self.prior) for start in starts), lambda placed: -placed.cost)
        H, unit = self._sums(lowest)[0], np.diag(self.prior) ** -0.5
        value, V = np.linalg.eigh(H * np.outer(unit, unit))
        fixed = (V * (value < MIN_FREED_VARIANCE_RATIO)) @ V.T / np.outer(unit, unit)
        return self._refined(lowest, fixed)

    def starts(self) -> list[FrameEstimate]:
        """Return initial estimates: the file's frames, and the base rotated by right angles.

        With a rotated base, the mean flange position is at the mean of the measured positions (or
        of the places to which distances were measured). The tool is the file's.
        """
        turns = {tuple(np.round(from_xyz(np.array(a) * np.pi / 2), 6).ravel()) for a in product(range(4), repeat=3)}
        seen = [r.places if r.places is not None else r.seen for r in self.readings]
        middle = np.concatenate(seen).mean(axis=0)
        flange = np.concatenate([r.p for r in self.readings]).mean(axis=0)
        places = [FrameEstimate(self.base[:3, :3], self.base[:3, 3], self.tool)]
        for turn in sorted(turns):
            R = self.base[:3, :3] @ np.reshape(turn, (3, 3))
            places.append(FrameEstimate(R, middle - R @ flange, self.tool))
        return places

    def _off(self, at: FrameEstimate) -> Array:
        """Return base rotation [rad], shift [m] and tool [m] relative to the file's, shape (9,)."""
        turn = to_xyz(at.R @ self.base[:3, :3].T)
        return np.concatenate([turn, at.p - self.base[:3, 3], at.t - self.tool])

    def _sums(self, at: FrameEstimate) -> tuple[Array, Array, float]:
        """Return normal matrix (9, 9), right side (9,) and sum of squares, without the priors.

        The variables are a small rotation in the measuring frame [rad], a shift [m] and the tool
        [m]. Residuals are in units of 3 mm; more than 30 poses have the weight of 30.
        """
        H, g, square = np.zeros((9, 9)), np.zeros(9), 0.0
        total = sum(len(r.p) for r in self.readings)
        weight = min(total, 30) / total / 3e-3**2
        for r in self.readings:
            arm = (r.p + r.R @ at.t) @ at.R.T
            residual, direction = r.rows(arm + at.p)
            # A small turn w moves a point at a by w x a.
            turned = direction @ (arm @ _CROSS).reshape(-1, 3, 3)
            J = np.concatenate([turned, direction, direction @ (at.R @ r.R)], axis=2).reshape(-1, 9)
            H += weight * J.T @ J
            g += weight * J.T @ residual.ravel()
            square += weight * float((residual**2).sum())
        return H, g, square

    def _refined(self, start: FrameEstimate, prior: Array) -> FrameEstimate:
        """Return the local optimum that the Levenberg-Marquardt method finds from a start.

        prior : precision matrix about the file's frames, shape (9, 9), variables as of `_sums`
        """

        def placed(x: Array, cost: float = np.inf) -> FrameEstimate:
            """Return the estimate with R (9), p (3) and t (3) in x, shape (15,), and this cost."""
            return FrameEstimate(x[:9].reshape(3, 3), x[9:12], x[12:], cost)

        def evaluate(x: Array) -> Evaluated:
            """Return the cost at x, shape (1, 15), and a function of its normal equations."""
            at = placed(x[0])
            (H, g, square), off = self._sums(at), self._off(at)
            return np.array([square + float(off @ prior @ off)]), lambda better: (
                (H + prior)[None][better],
                (g - prior @ off)[None][better],
            )

        def move(x: Array, step: Array) -> Array:
            """Return x (1, 15) after a step (1, 9): rotation in the measuring frame, shifts."""
            turned = nearest_rotation(from_xyz(step[0, :3]) @ x[0, :9].reshape(3, 3))
            return np.concatenate([turned.ravel(), x[0, 9:] + step[0, 3:]])[None]

        first = np.concatenate([start.R.ravel(), start.p, start.t])[None]
        *_, end = levenberg_marquardt(evaluate, first, 41, move=move, relative=1e-9, absolute=1e-9)
        return placed(end.point[0], float(end.cost[0]))


# Maximum number of poses with positions from which initial frames are computed; they are drawn at
# random, as on a grid every k-th may be similar. Of more distances every k-th is used, 200 to 400.
MAX_START_POSES = 200
# Minimum number of measured values from which initial frames are computed, and of poses that
# determine them without the robot file as prior.
MIN_START_READINGS = 6


def place_frames(robot: Robot, m: Measurements | Sequence[Measurements]) -> Robot:
    """Return the robot with the unknown parts of its base and tool frames set from measurements.

    The first set with positions is used, at most MAX_START_POSES with one tool. For each pose y =
    R_B (p + R t) + p_B, with flange p, R in the base frame. Multiplied by M = R_B' it is linear in
    M (9 numbers), M p_B and t: solved by least squares, M projected to a rotation, then refined by
    Kabsch's method and t in turns. With several tools, base and tool are placed by the one that was
    measured most, then the others given the base. Where the poses determine the base's rotation or
    the tool badly (lines, one orientation, few poses), the robot file is a prior; likewise with
    distances to given points. Other kinds place the tool alone (`_by_unknown_places`). Robots whose
    base is given or is row 1 of the table, and with too few measurements, are returned unchanged.
    Source: Kabsch (1976) for the rotation.
    """
    sets = (m,) if isinstance(m, Measurements) else tuple(m)
    m = next((part for part in sets if part.position is not None), sets[0])
    used = np.flatnonzero(m.weight > 0)
    if not robot.targets and len(used) > MAX_START_POSES:
        used = np.sort(np.random.default_rng(0).choice(used, MAX_START_POSES, replace=False))
    m = m if len(used) == len(m) else m[used]
    if robot.base.unknown != "pose":
        return robot
    if m.position is None:
        informed = [some[some.weight > 0] for some in sets if some.distance is not None and some.target is not None]
        if robot.targets or sum(map(len, informed or sets)) < MIN_START_READINGS:
            return robot
        return _by_distances(robot, informed) if informed else _by_unknown_places(robot, sets)
    if 3 * len(m) < MIN_START_READINGS:
        return robot
    if robot.targets:
        return _with_targets(robot, m)
    tool_position = None if robot.tool.unknown != "none" else robot.tool.T[:3, 3]
    compliant = robot.gravity_frame == "measuring" and any(j.compliance for j in robot.joints)
    T_M0, t = robot.base.T, robot.tool.T[:3, 3]
    for _ in range(
        3 if compliant else 1
    ):  # deflections depend on the direction of gravity in the base frame, so iterate
        p, R = _flange(robot, m, T_M0)
        T_M0, t = _placed(p, R, m.position, tool_position, T_M0, t, robot)
    turn = robot.tool.T[:3, :3]
    if robot.tool.unknown == "pose" and m.orientation is not None:
        turn = nearest_rotation(np.einsum("nji,kj,nkl->il", R, T_M0[:3, :3], m.orientation))
    return replace(robot, base=replace(robot.base, T=T_M0), tool=replace(robot.tool, T=frame(turn, t)))


def _placed(
    p: Array, R: Array, y: Array, tool_position: Array | None, T_M0: Array, t: Array, robot: Robot
) -> tuple[Array, Array]:
    """Return base frame T_M0 (4, 4) and tool position (3,) [m] that fit measured positions.

    Where these do not determine them, the robot file is a prior.

    p, R : flange positions (n, 3) [m] and orientations (n, 3, 3) in the base frame
    y : measured positions in the measuring frame, shape (n, 3) [m]
    tool_position : fixed tool position in the flange frame, shape (3,) [m]; None: it is found
    T_M0, t : initial base frame (4, 4) and tool position (3,) [m]
    """
    file = robot.tool.T[:3, 3]
    placement = PlacementProblem([Readings(p, R, y)], robot.base.T, file, tool_fixed=tool_position is not None)
    starts = []
    if len(p) >= MIN_START_READINGS:
        T, tool = solve_placement(p, R, y, tool_position, T_M0, t)
        starts.append(FrameEstimate(T[:3, :3], T[:3, 3], tool))
        if placement.determined(starts[0]):
            return T, tool
    T, _ = solve_placement(p, R, y, file, robot.base.T, file)
    starts += [FrameEstimate(T[:3, :3], T[:3, 3], file), FrameEstimate(robot.base.T[:3, :3], robot.base.T[:3, 3], file)]
    best = placement.best(starts)
    return frame(best.R, best.p), best.t


def _by_distances(robot: Robot, sets: Sequence[Measurements]) -> Robot:
    """Return the robot with base and tool frames that fit distances to given points."""
    step = max(1, sum(map(len, sets)) // MAX_START_POSES)
    T, tool = robot.base.T, robot.tool.T[:3, 3]
    readings = []
    for m in sets:
        some = m[::step]
        assert some.distance is not None
        readings.append(Readings(*_flange(robot, some, T), some.distance, some.target))
    placement = PlacementProblem(readings, T, tool, tool_fixed=robot.tool.unknown == "none")
    best = placement.best(placement.starts())
    T_E = frame(robot.tool.T[:3, :3], best.t)
    return replace(robot, base=replace(robot.base, T=frame(best.R, best.p)), tool=replace(robot.tool, T=T_E))


def _by_unknown_places(robot: Robot, sets: Sequence[Measurements]) -> Robot:
    """Return the robot with the tool position that fits distances or contacts at unknown places.

    The rest of the robot stays nominal, all of it where the tool is given, the data are too few, or
    the solver finds no optimum. A tool point on the last axis, as in a file without a tool,
    is no start: there parameters are confounded or without effect that a point off the axis
    distinguishes.
    """
    position = ("tool_x", "tool_y", "tool_z")
    names = tuple(robot.parameters.select(position)) if robot.tool.unknown != "none" else ()
    problem = LeastSquares(robot, tuple(sets), names, "huber", False, initial_sigmas(sets))
    if not names or problem.residual_count <= problem.size:
        return robot
    try:
        values = problem.values(problem.solve().v)
    except ConvergenceError:
        return robot
    point = [values.get(name, value) for name, value in zip(position, robot.tool.T[:3, 3], strict=True)]
    return replace(robot, tool=replace(robot.tool, T=frame(robot.tool.T[:3, :3], np.array(point))))


def _with_targets(robot: Robot, m: Measurements) -> Robot:
    """Return the robot with base and all tool points fitted to measured positions.

    The base is placed by the tool point that was measured most, the others given that base.
    """
    assert m.position is not None
    logged = m.condition_matrix([t.column for t in robot.targets], np.zeros(len(robot.targets)))
    at = np.where(logged.any(axis=1), 1 + np.argmax(logged, axis=1), 0)
    points = [robot.tool.T[:3, 3], *(t.point for t in robot.targets)]
    most = int(np.argmax(np.bincount(at, minlength=len(points))))
    turn = robot.tool.T[:3, :3]
    alone = replace(robot, tool=replace(robot.tool, T=frame(turn, points[most])), targets=(), tool_name="")
    placed = place_frames(alone, m[np.flatnonzero(at == most)])
    points[most] = placed.tool.T[:3, 3]
    if robot.tool.unknown != "none":
        for k in set(range(len(points))) - {most}:
            if (rows := np.flatnonzero(at == k)).size:
                # Mean over the poses of where the measured positions are in the last link's frame.
                seen = m.position[rows]
                p, R = _flange(placed, m[rows], placed.base.T)
                y = (seen - placed.base.T[:3, 3]) @ placed.base.T[:3, :3]
                points[k] = np.einsum("nji,nj->ni", R, y - p).mean(axis=0)
    T = frame(placed.tool.T[:3, :3], points[0])
    targets = tuple(replace(t, point=p) for t, p in zip(robot.targets, points[1:], strict=True))
    return replace(robot, base=placed.base, tool=replace(robot.tool, T=T), targets=targets)


def _flange(robot: Robot, m: Measurements, T_M0: Array) -> tuple[Array, Array]:
    """Return flange positions (n, 3) [m] and orientations (n, 3, 3) of the model in the base frame."""
    turn = np.linalg.inv(robot.base.T) @ T_M0
    values = dict(zip(("base_x", "base_y", "base_z"), turn[:3, 3], strict=True))
    values |= dict(zip(("base_rx", "base_ry", "base_rz"), to_xyz(turn[:3, :3]), strict=True))
    p, R = predicted(robot, m, values)
    R = T_M0[:3, :3].T @ R @ robot.tool.T[:3, :3].T
    return (p - T_M0[:3, 3]) @ T_M0[:3, :3] - R @ robot.tool.T[:3, 3], R


def rigid(robot: Robot) -> Robot:
    """Return the robot with rigid joints, unknown base pose and unknown tool position.

    It serves to find gross mistakes: deflections are millimetres, mistakes decimetres.
    """
    rigid = tuple(replace(j, compliance=None) for j in robot.joints)
    return replace(robot.with_unknown(base="pose", tool="position"), joints=rigid, knowledge=None)


def median_error(robot: Robot, m: Measurements) -> float:
    """Return the median error [m] over the poses after base and tool are fitted to them.

    It is infinite where the model cannot be evaluated. Gross errors have no part in the fit.
    """
    with np.errstate(all="ignore"):
        try:
            e = errors(place_frames(robot, m), m)
            near = np.flatnonzero(e <= 5 * np.median(e))
            if 12 <= len(near) < len(e):  # gross errors distort base and tool
                e = errors(place_frames(robot, m[near]), m)
        except np.linalg.LinAlgError:
            return np.inf
    # The median ignores a few outliers, which are not a mistake of the model.
    return float(np.median(e)) if np.isfinite(e).all() else np.inf


def solve_placement(
    p: Array, R: Array, y: Array, fixed_tool: Array | None, T_M0: Array, t: Array
) -> tuple[Array, Array]:
    """Return base frame T_M0 (4, 4) and tool t, shape (3,) [m], from positions in closed form.

    What the poses do not determine stays as in the initial frames T_M0, t.

    p, R : flange positions (n, 3) [m] and orientations (n, 3, 3) in the base frame
    y : measured positions in the measuring frame, shape (n, 3) [m]
    fixed_tool : fixed tool position, shape (3,) [m]; None: it is found
    """
    n = len(p)
    centre = y.mean(axis=0)
    c = y - centre
    # All that follows uses these sums, so that the rounds below do not depend on the number of
    # poses.
    cp, S, Rp = c.T @ p, R.sum(axis=0), p.ravel() @ R.reshape(-1, 3)
    cR = (c.T @ R.reshape(n, 9)).reshape(3, 3, 3)
    R_B = T_M0[:3, :3]
    G, h = np.zeros((15, 15)), np.concatenate([cp.T.ravel(), p.sum(axis=0), -Rp])
    for i in range(3):
        at = slice(3 * i, 3 * i + 3)
        G[at, at], G[at, 12:], G[9 + i, 12:] = c.T @ c, -cR[:, i], -S[i]
    G[12:, :12] = G[:12, 12:].T
    G[9:, 9:] += np.diag([n] * 6)
    before = np.concatenate([R_B.T.ravel(), R_B.T @ (centre - T_M0[:3, 3]), t])
    if fixed_tool is not None:
        G, h, before = G[:12, :12], h[:12] - G[:12, 12:] @ fixed_tool, before[:12]
    placed = before + _truncated_inverse(G) @ (h - G @ before)
    R_B = nearest_rotation(placed[:9].reshape(3, 3)).T
    t = placed[12:] if fixed_tool is None else fixed_tool
    # R t + s = R_B' y - p, with s = R_B' p_B the measuring frame's offset in the base frame
    yR = (cR + np.multiply.outer(centre, S)).reshape(9, 3)
    G = np.block([[n * np.eye(3), S.T], [S, n * np.eye(3)]])
    inverse, p_sum = _truncated_inverse(G), p.sum(axis=0)
    # Kabsch's method and the tool alternate; three rounds suffice.
    for _ in range(3):
        if fixed_tool is None:
            e = n * centre @ R_B - p_sum
            before = np.concatenate([t, (e - S @ t) / n])
            t = t + (inverse @ (np.concatenate([R_B.ravel() @ yR - Rp, e]) - G @ before))[:3]
        # The small weight [m^2] keeps the previous rotation where the points determine none.
        R_B = nearest_rotation(cp + cR @ t + n * 1e-9 * R_B)
    return frame(R_B, centre - R_B @ (p.mean(axis=0) + S @ t / n)), t


def _truncated_inverse(G: Array) -> Array:
    """Return the pseudoinverse of a normal matrix G = A'A in the directions it determines, (k, k).

    Directions in which the singular value of A is below a thousandth of the largest one get zero: a
    step computed with the inverse does not move along them.
    """
    values, V = np.linalg.eigh(G)
    # Eigenvalues of G are squares of singular values of A; those below this share are noise.
    determined = values > 1e-3**2 * values[-1]
    return np.asarray((V[:, determined] / values[determined]) @ V[:, determined].T)
