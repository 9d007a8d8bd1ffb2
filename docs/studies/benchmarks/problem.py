"""The robot, the measurements and the common start that every contender of the benchmark gets.

The arm has the proportions of a UR10, so axes 2, 3 and 4 are nominally parallel. The true arm differs from the
nominal one by a small rigid motion at each joint, drawn in all six directions: no axis stays parallel to its
neighbour, so a model in modified Denavit-Hartenberg rows needs Hayati's beta there. The base frame (robot to tracker)
and the tool point are unknown. The truth is a plain product of 4 x 4 matrices and knows nothing of anybody's
parameters.
"""

from dataclasses import dataclass, field

import numpy as np

# Modified Denavit-Hartenberg rows (Craig), columns alpha [rad], a [m], theta [rad], d [m].
NOMINAL_DH = np.array(
    [
        [0.0, 0.0, 0.0, 0.118],
        [np.pi / 2, 0.0, np.pi, 0.0],
        [0.0, 0.6127, 0.0, 0.0],
        [0.0, 0.5716, 0.0, 0.1639],
        [-np.pi / 2, 0.0, 0.0, 0.1157],
        [np.pi / 2, 0.0, np.pi, 0.0922],
    ]
)
PARALLEL_ROWS = (2, 3)  # rows (counted from 0) whose axis is nominally parallel to the one before
N_IDENTIFIABLE = 27  # 6 base + 4 x 4 + 2 + 3 tool: four for each of six axes, three for the measured point
SIGMA_M = 0.02e-3  # standard deviation of each measured coordinate
TILT_RAD, SHIFT_M = 1e-3, 0.3e-3  # standard deviations of the true arm's deviation at each joint, per direction
N_HELD_OUT = 1000


@dataclass(frozen=True)
class Data:
    """What a contender may see: the nominal arm, the measured poses, the joint angles of the held-out poses."""

    q: np.ndarray  # shape (n, 6) [rad]
    p: np.ndarray  # shape (n, 3) [m], measured in the tracker's frame, with noise
    q_held_out: np.ndarray  # shape (m, 6) [rad]
    dh: np.ndarray = field(default_factory=NOMINAL_DH.copy)  # shape (6, 4)


def rigid(rotation_vector: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """4 x 4 matrix of a rotation vector [rad] and a translation [m]."""
    T = np.eye(4)
    angle = np.linalg.norm(rotation_vector)
    x, y, z = rotation_vector / angle if angle > 0 else np.zeros(3)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T[:3, :3] += np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    T[:3, 3] = translation
    return T


def placements(dh: np.ndarray) -> np.ndarray:
    """Pose of each joint frame in the one before at joint angle zero, shape (6, 4, 4)."""
    x, z = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    return np.array([rigid(alpha * x, a * x) @ rigid(theta * z, d * z) for alpha, a, theta, d in dh])


def flange_poses(joints: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Pose of the last joint frame, shape (n, 4, 4), for placements (6, 4, 4) and angles q (n, 6) [rad]."""
    T = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for placement, angle in zip(joints, q.T, strict=True):
        turn = np.zeros((len(q), 4, 4))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
        turn[:, 1, 0] = np.sin(angle)
        turn[:, 0, 1] = -turn[:, 1, 0]
        turn[:, 2, 2] = turn[:, 3, 3] = 1
        T = T @ placement @ turn
    return T


def make(n: int, seed: int) -> tuple[Data, np.ndarray]:
    """Data with n measured poses, and the true positions (m, 3) [m] of the held-out ones, which no contender sees.

    The first n poses of a larger campaign with the same seed are the same poses.
    """
    rng = np.random.default_rng([seed, 0])
    tilts, shifts = rng.normal(0, TILT_RAD, (6, 3)), rng.normal(0, SHIFT_M, (6, 3))
    joints = np.array(
        [T @ rigid(tilt, shift) for T, tilt, shift in zip(placements(NOMINAL_DH), tilts, shifts, strict=True)]
    )
    base = rigid(rng.uniform(-1, 1, 3), rng.uniform(-2, 2, 3))
    tool = np.append(rng.uniform(0.03, 0.15, 3), 1.0)

    def true_positions(q: np.ndarray) -> np.ndarray:
        return (base @ flange_poses(joints, q) @ tool)[:, :3]

    q = np.random.default_rng([seed, 1]).uniform(-np.pi, np.pi, (n, 6))
    q_held_out = np.random.default_rng([seed, 2]).uniform(-np.pi, np.pi, (N_HELD_OUT, 6))
    noise = np.random.default_rng([seed, 3]).normal(0, SIGMA_M, (n, 3))
    return Data(q, true_positions(q) + noise, q_held_out), true_positions(q_held_out)


def frames_start(data: Data, rounds: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Base rotation (3, 3), base translation (3,) and tool point (3,) [m] from the nominal arm, in closed form.

    p_i = R_b (o_i + R_i t) + t_b: a rotation fit for R_b and a linear fit for (t, t_b), in turns. For contenders that
    have no start of their own; its time counts as theirs.
    """
    T = flange_poses(placements(data.dh), data.q)
    R, o, tool = T[:, :3, :3], T[:, :3, 3], np.zeros(3)
    for _ in range(rounds):
        source = o + R @ tool
        U, _, Vt = np.linalg.svd((source - source.mean(0)).T @ (data.p - data.p.mean(0)))
        R_base = Vt.T @ np.diag([1, 1, np.linalg.det(Vt.T @ U.T)]) @ U.T
        target = data.p @ R_base - o  # in the robot's frame: R_i t + R_b' t_b
        normal = np.block([[len(o) * np.eye(3), R.sum(0).T], [R.sum(0), len(o) * np.eye(3)]])
        tool, shift = np.split(np.linalg.solve(normal, np.append(np.einsum("nji,nj->i", R, target), target.sum(0))), 2)
    return R_base, R_base @ shift, tool
