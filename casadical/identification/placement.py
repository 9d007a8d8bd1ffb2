"""A closed-form start for the base and tool frames, from positions or full poses."""

from dataclasses import replace

import numpy as np

from casadical.core.arrays import Array
from casadical.core.transforms import frame, nearest_rotation, to_xyz
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

# Singular values of less than this share of the greatest are noise: the directions stay as they are.
UNDETERMINED = 1e-3
# A start needs no more poses than about so many.
START_POSES = 10_000
# Weight [m^2] of the rotation before, where the points determine none.
TIE = 1e-9


def place_frames(robot: Robot, m: Measurements) -> Robot:
    """The robot with the unknown parts of its base and tool frames put where the measurements say.

    For each pose y = R_B (p + R t) + p_B, with flange p, R in the base frame. Multiplied by M = R_B' it is linear in
    M (9 numbers), M p_B and t: solved by least squares, M made a rotation, then refined by Kabsch's method and t in
    turns. Of several tools, base and tool are placed by the one that was measured most, the others then by the base.
    Only positions and full poses carry this information; other kinds, and robots whose base is known or is
    row 1 of the table, are left as they are. Source: Kabsch (1976) for the rotation.
    """
    used = np.flatnonzero(m.weight > 0)
    used = used[:: max(1, len(used) // START_POSES)]
    m = m if len(used) == len(m) else m[used]
    if robot.base.unknown != "pose" or m.position is None or len(m) < 6:
        return robot
    if robot.targets:
        return _with_targets(robot, m)
    known = None if robot.tool.unknown != "none" else robot.tool.T[:3, 3]
    compliant = robot.gravity_frame == "measuring" and any(j.compliance for j in robot.joints)
    T_M0, t = robot.base.T, robot.tool.T[:3, 3]
    for _ in range(3 if compliant else 1):  # how a compliant arm is deflected depends on gravity in its base frame
        p, R = _flange(robot, m, T_M0)
        T_M0, t = solve_placement(p, R, m.position, known, T_M0, t)
    turn = robot.tool.T[:3, :3]
    if robot.tool.unknown == "pose" and m.orientation is not None:
        turn = nearest_rotation(np.einsum("nji,kj,nkl->il", R, T_M0[:3, :3], m.orientation))
    return replace(robot, base=replace(robot.base, T=T_M0), tool=replace(robot.tool, T=frame(turn, t)))


def _with_targets(robot: Robot, m: Measurements) -> Robot:
    """Base and tools of a robot with several of them."""
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
                points[k] = _point_at(placed, m[rows])
    T = frame(placed.tool.T[:3, :3], points[0])
    targets = tuple(replace(t, point=p) for t, p in zip(robot.targets, points[1:], strict=True))
    return replace(robot, base=placed.base, tool=replace(robot.tool, T=T), targets=targets)


def _point_at(placed: Robot, m: Measurements) -> Array:
    """Where in the last link's frame these positions are, mean over the poses, shape (3,) [m]."""
    assert m.position is not None
    p, R = _flange(placed, m, placed.base.T)
    y = (m.position - placed.base.T[:3, 3]) @ placed.base.T[:3, :3]
    return np.asarray(np.einsum("nji,nj->ni", R, y - p).mean(axis=0))


def _flange(robot: Robot, m: Measurements, T_M0: Array) -> tuple[Array, Array]:
    """Flange positions, shape (n, 3), and orientations, shape (n, 3, 3), in the base frame, with the base at T_M0."""
    turn = np.linalg.inv(robot.base.T) @ T_M0
    values = dict(zip(("base_x", "base_y", "base_z"), turn[:3, 3], strict=True))
    values |= dict(zip(("base_rx", "base_ry", "base_rz"), to_xyz(turn[:3, :3]), strict=True))
    p, R = predicted(robot, m, values)
    # The base's rotation back, then the tool's: one product for all poses, of matrices as rows of nine numbers.
    turned = R.reshape(-1, 9) @ np.kron(T_M0[:3, :3], robot.tool.T[:3, :3].T)
    R = turned.reshape(-1, 3, 3)
    shift = turned @ np.kron(np.eye(3), robot.tool.T[:3, 3:])
    return (p - T_M0[:3, 3]) @ T_M0[:3, :3] - shift, R


def solve_placement(
    p: Array, R: Array, y: Array, known_tool: Array | None, T_M0: Array, t: Array
) -> tuple[Array, Array]:
    """T_M0, shape (4, 4), and tool t, shape (3,); what the poses do not determine stays as in the given ones."""
    n = len(p)
    centre = y.mean(axis=0)
    c = y - centre
    # Sums over the poses, from which all that follows is made: time does not grow with the rounds below.
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
    if known_tool is not None:
        G, h, before = G[:12, :12], h[:12] - G[:12, 12:] @ known_tool, before[:12]
    found = before + _seen_inverse(G) @ (h - G @ before)
    R_B = nearest_rotation(found[:9].reshape(3, 3)).T
    t = found[12:] if known_tool is None else known_tool
    # R t + s = R_B' y - p, with s the base's origin as the base sees it
    yR = (cR + np.multiply.outer(centre, S)).reshape(9, 3)
    G = np.block([[n * np.eye(3), S.T], [S, n * np.eye(3)]])
    inverse, p_sum = _seen_inverse(G), p.sum(axis=0)
    for _ in range(5):
        if known_tool is None:
            e = n * centre @ R_B - p_sum
            before = np.concatenate([t, (e - S @ t) / n])
            t = t + (inverse @ (np.concatenate([R_B.ravel() @ yR - Rp, e]) - G @ before))[:3]
        R_B = nearest_rotation(cp + cR @ t + n * TIE * R_B)
    return frame(R_B, centre - R_B @ (p.mean(axis=0) + S @ t / n)), t


def _seen_inverse(G: Array) -> Array:
    """Inverse of a normal matrix in the directions that it determines; a solution stays as it was in the others."""
    values, V = np.linalg.eigh(G)
    seen = values > UNDETERMINED**2 * values[-1]
    return np.asarray((V[:, seen] / values[seen]) @ V[:, seen].T)
