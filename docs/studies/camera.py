"""Poses of a board in a camera: errors of the hand-eye transform by the camera's own noise and by equal weights.

    python docs/studies/camera.py [--runs 24] [--keep FILE --seconds 500] [--corners]

Simulated UR5e and iiwa 7 arms, eye in hand and eye to base, 15, 25 and 40 stations at which the target is in the
image. Scenes: "right" arms have their nominal geometry, "off" ones are off by normal errors of 1 mm and 1 mrad in every
parameter; the noise of the camera is normal in its own axes (lateral, lateral, depth [mm]; angles about them [mrad]),
or that of pixels through a PnP fit ("pnp": 0.25 px, a board of 10 x 7 corners whose origin is a corner). "outliers":
12 % of the poses are wrong by decimetres. The hand-eye transform is compared with the true one in the nominal last row
(the offset and zero of the last joint are not separable from it): X_g, in mm. "Chosen" frees the geometry as calibrate
does, "equal weights" too, but as if it were not known that a camera measured.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import kept
import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from casadical.core.basics import Array, ConvergenceError, InputError
from casadical.core.parts import Joint, Placement
from casadical.core.transforms import frame
from casadical.identification.accuracy import predicted
from casadical.identification.identification import identify
from casadical.measurements.measurements import Measurements
from casadical.project.calibration import calibrate
from casadical.robot.robot import Robot
from casadical.robot.robot_file import robot_files

SPARE = 200  # stations that are drawn besides
# Name of a scene -> errors of the geometry [mm, mrad], camera noise or pixels, share of outliers.
SCENES: dict[str, tuple[float, Array | float, float]] = {
    "a right, 1 1 3 mm": (0.0, np.array([1, 1, 3, 2, 2, 0.7]), 0.0),
    "f right, .3 mm": (0.0, np.array([0.3, 0.3, 0.9, 0.6, 0.6, 0.2]), 0.0),
    "h right, pnp": (0.0, 0.25, 0.0),
    "b off, 1 1 3 mm": (1.0, np.array([1, 1, 3, 2, 2, 0.7]), 0.0),
    "e off, .3 mm": (1.0, np.array([0.3, 0.3, 0.9, 0.6, 0.6, 0.2]), 0.0),
    "g off, pnp": (1.0, 0.25, 0.0),
    "c right, outliers": (0.0, np.array([1, 1, 3, 2, 2, 0.7]), 0.12),
}
# Arm -> multiples of a right angle alpha, and a and d [m], of its rows in modified DH.
ARMS = {
    "UR5e": ((0, 0, 0.1625), (1, 0, 0), (0, -0.425, 0), (0, -0.3922, 0.1333), (1, 0, 0.0997), (-1, 0, 0.0996)),
    "iiwa7": ((0, 0, 0.34), (-1, 0, 0), (1, 0, 0.4), (1, 0, 0), (-1, 0, 0.4), (-1, 0, 0), (1, 0, 0.126)),
}
# Focal length of the simulated camera [px].
FOCAL_PX = 800.0


def arm(name: str, limit: float = 2.9) -> Robot:
    """The arm as its data sheet has it; base and tool are unknown."""
    parallel = (2, 3) if name == "UR5e" else ()
    joints = tuple(
        Joint(alpha=alpha * np.pi / 2, a=a, d=d, beta=0.0 if i in parallel else None, lower=-limit, upper=limit)
        for i, (alpha, a, d) in enumerate(ARMS[name])
    )
    return Robot(name, joints, base=Placement(np.eye(4), "pose"), tool=Placement(np.eye(4), "pose"))


def as_built(robot: Robot, size: float, rng: np.random.Generator) -> Robot:
    """The arm with normal errors of one size [mm, mrad] in all of its geometry."""
    return robot.with_values(
        {p.name: p.value + 1e-3 * size * rng.normal() for p in robot.parameters if p.group == "geometry"}
    )


def poses_of(robot: Robot, q: Array) -> Array:
    """Poses of the tool in the measuring frame, shape (n, 4, 4) [m]."""
    p, R = predicted(robot, Measurements(q, "position", position=np.zeros((len(q), 3))))
    T = np.tile(np.eye(4), (len(q), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, p
    return T


def visible(T_ct: Array, near: float, far: float) -> Array:
    """Mask of the poses of a target in the camera, (n, 4, 4), at which it is in the image and seen from the front."""
    x, y, z = T_ct[:, :3, 3].T
    line = T_ct[:, :3, 3] / np.linalg.norm(T_ct[:, :3, 3], axis=1)[:, None]
    frontal = -(line * T_ct[:, :3, 2]).sum(axis=1) > np.cos(np.deg2rad(55))
    return np.asarray((z > near) & (z < far) & (np.abs(x) < 0.3 * z) & (np.abs(y) < 0.22 * z) & frontal)


def stations(built: Robot, X: Array, in_hand: bool, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Readings (n, joints) at which the target is visible, and its poses in the camera, (n, 4, 4)."""
    low, high = built.limits
    while True:
        q0 = rng.uniform(0.6 * low, 0.6 * high)
        q = np.clip(q0 + 0.5 * rng.normal(size=(20_000, built.n)), low, high)
        q[:, -1] = rng.uniform(low[-1], high[-1], len(q))
        T = poses_of(replace(built, tool=replace(built.tool, T=X)), np.vstack([q0, q]))
        away = frame(np.diag([1.0, -1, -1]), np.array([0, 0, rng.uniform(0.45, 0.65) if in_hand else 1.1]))
        turned = frame(Rotation.from_rotvec(rng.normal(0, 0.2, 3)).as_matrix(), np.zeros(3))
        seen = np.linalg.inv(T[1:]) @ (T[0] @ away @ turned) if in_hand else away @ turned @ np.linalg.inv(T[0]) @ T[1:]
        good = np.flatnonzero(visible(seen, *((0.3, 0.9) if in_hand else (0.6, 1.7))))
        if len(good) >= n and T[1:, 2, 3][good].min() > -0.5:
            return q[good[:n]], seen[good[:n]]


def measured(q: Array, T: Array, in_hand: bool) -> Measurements:
    """Poses of the target in the camera, (n, 4, 4), as casadical has them."""
    where = "in hand" if in_hand else "to base"
    m = Measurements(q, "pose", position=T[:, :3, 3], orientation=T[:, :3, :3], camera=where)
    return m.inverse() if in_hand else m


def first_corner(in_hand: bool) -> Array:
    """The frame of the board's first corner in that of its centre; squares are of 25 or 40 mm."""
    return frame(np.eye(3), (0.025 if in_hand else 0.04) * np.array([-4.5, -3, 0]))


def through_pixels(T: Array, pixels: float, in_hand: bool, rng: np.random.Generator, focal: float = 1.0) -> Array:
    """Poses, (n, 4, 4), that a PnP fit finds of the noisy corners of a board whose origin is its first corner.

    focal : focal length with which poses are fitted over the true one
    """
    grid = np.stack(np.meshgrid(np.arange(10), np.arange(7), indexing="ij"), axis=-1).reshape(-1, 2)
    corners = (1 - grid / [4.5, 3]) @ np.eye(2, 3) * first_corner(in_hand)[:3, 3]

    def image(T: Array) -> tuple[Array, Array]:
        c = T[:, None, :3, 3] + np.einsum("nij,kj->nki", T[:, :3, :3], corners)
        return FOCAL_PX * c[:, :, :2] / c[:, :, 2:], c

    seen = image(T)[0] / focal + rng.normal(0, pixels, (len(T), len(corners), 2))
    for _ in range(6):
        uv, c = image(T)
        J = np.zeros((*c.shape[:2], 2, 6))
        J[..., 0, 0] = J[..., 1, 1] = FOCAL_PX / c[..., 2]
        J[..., 2] = -uv / c[..., 2:]
        lever = c - T[:, None, :3, 3]
        J[..., 3:] = np.cross(lever[:, :, None, :], J[..., :3])
        flat, r = J.reshape(len(T), -1, 6), (seen - uv).reshape(len(T), -1)
        normal, right = np.einsum("nki,nkj->nij", flat, flat), np.einsum("nki,nk->ni", flat, r)
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        T = T.copy()
        T[:, :3, :3] = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ T[:, :3, :3]
        T[:, :3, 3] += step[:, :3]
    return T @ first_corner(in_hand)


def scene(name: str, which: str, in_hand: bool, n: int, seed: int) -> tuple[Robot, Measurements, Array]:
    """Nominal arm, measured poses, and the true X_g (4, 4)."""
    size, noise, outliers = SCENES[name]
    rng, robot = np.random.default_rng(seed), arm(which)
    built = as_built(robot, size, rng)
    tilt = Rotation.from_rotvec([*rng.normal(0, 0.3, 2), 0]) * Rotation.from_rotvec([0, 0, rng.uniform(-3, 3)])
    X = frame(tilt.as_matrix(), np.array([*rng.uniform(-0.07, 0.07, 2), rng.uniform(0.02, 0.1)]))
    q, T = stations(built, X, in_hand, n + SPARE, rng)
    q, seen = q[:n], T[:n].copy()
    if isinstance(noise, float):
        seen = through_pixels(seen, noise, in_hand, rng)
    else:
        e = 1e-3 * noise * rng.normal(size=(n, 6))
        seen[:, :3, :3] = Rotation.from_rotvec(e[:, 3:]).as_matrix() @ seen[:, :3, :3]
        seen[:, :3, 3] += e[:, :3]
    wrong = rng.choice(n, round(outliers * n), replace=False)
    seen[wrong, :3, :3] = Rotation.random(len(wrong), rng=rng).as_matrix() if len(wrong) else seen[wrong, :3, :3]
    seen[wrong, :3, 3] += rng.normal(0, 0.1, (len(wrong), 3))
    m = measured(q, seen, in_hand)
    if not in_hand and isinstance(noise, float):  # the tool is the board's frame
        X = X @ first_corner(in_hand)
    return robot, m, in_last_row(robot, built, X)


def in_last_row(robot: Robot, other: Robot, X: Array) -> Array:
    """The tool frame of another arm in the nominal frame of the last link."""
    row = []
    for r in (robot, other):
        d, theta = (r.parameters[f"{name}{r.n}"].value for name in ("d", "theta"))
        row.append(frame(Rotation.from_rotvec([0, 0, theta]).as_matrix(), np.array([0, 0, d])))
    return np.asarray(np.linalg.inv(row[0]) @ row[1] @ X)


def judged(what: tuple[str, str, bool, int, int]) -> kept.Row:
    """Errors [mm] of one scene; what : scene, arm, whether in hand, stations, seed."""
    robot, fit, truth = scene(*what)
    row: kept.Row = {}
    for name, m in {"chosen": fit, "equal weights": replace(fit, camera="")}.items():
        try:
            found = identify(robot, m, ["kinematic"])
        except (ConvergenceError, InputError) as error:
            row |= {name: float("nan"), f"{name} refused": str(error)}
            continue
        X = in_last_row(robot, found.robot, found.robot.tool.T)
        row[name] = 1e3 * float(np.linalg.norm(X[:3, 3] - truth[:3, 3]))
    return row


def corners(runs: int) -> None:
    """Print errors of X_g [mm] by `calibrate`, of 40 images of 500 corners with a wrong focal length."""
    grid = np.stack(np.meshgrid(np.arange(25), np.arange(20), [0], indexing="ij"), axis=-1).reshape(-1, 3)
    board = 0.01 * (grid - [12, 9.5, 0])
    for run in range(runs):
        rng, robot = np.random.default_rng([9, run]), arm("UR5e")
        built = as_built(robot, 1.0, rng)
        turn = Rotation.from_rotvec(rng.normal(0, 0.2, 3)).as_matrix()
        X = frame(turn, np.array([*rng.uniform(-0.07, 0.07, 2), 0.06]))
        q, T = stations(built, X, True, 40, rng)
        c = board @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
        uv = FOCAL_PX * c[..., :2] / c[..., 2:] + [640, 480] + rng.normal(0, 0.25, (40, 500, 2))
        columns = {f"q{k + 1}_rad": np.repeat(q[:, k], 500) for k in range(6)}
        columns |= {"u_px": uv[..., 0].ravel(), "v_px": uv[..., 1].ravel()}
        columns |= {f"board_{axis}_mm": np.tile(1e3 * board[:, k], 40) for k, axis in enumerate("xy")}
        with TemporaryDirectory() as name:
            folder = Path(name)
            pd.DataFrame(columns).to_csv(folder / "corners.csv", index=False)
            for path, text in robot_files(folder / "robot.toml", robot, "an arm", reproducible=True).items():
                path.write_text(str(text))
            f = 1.006 * FOCAL_PX
            (folder / "problem.toml").write_text(
                'casadical = 1\ntitle = "corners"\nmethods = ["KM"]\n[[measurements]]\nfile = "corners.csv"\n'
                f"intrinsics = {{ fx = {f}, fy = {f}, cx = 640.0, cy = 480.0 }}\n[sets]\nidentify = 1\n"
            )
            result = calibrate(folder)
        truth, answer = in_last_row(robot, built, X), result.arm_or_camera
        assert answer is not None
        focal = answer.errors[0]
        X = in_last_row(robot, result.robot, result.robot.tool.T)
        off = 1e3 * np.linalg.norm(X[:3, 3] - truth[:3, 3])
        print(
            f"corners, run {run}: X_g {off:.3f} mm, wrong: {answer.wrong or '-'}, "
            f"focal length {100 * focal.value:+.2f} % ({100 * focal.low:+.2f} to {100 * focal.high:+.2f})",
            flush=True,
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scenes", default="abcefgh", help="first letters of their names")
    parser.add_argument("--corners", action="store_true", help="only corners in images, focal length wrong by 0.6 %%")
    kept.add_options(parser, "camera")
    given = parser.parse_args()
    if given.corners:
        corners(given.runs)
        return
    scenes = [name for name in SCENES if name[0] in given.scenes]
    arms, places, counts = list(ARMS), (True, False), (15, 25, 40)
    todo = kept.named(
        (name, arms[run % 2], places[run // 2 % 2], counts[run % 3], given.seed + run)
        for run in range(given.runs)
        for name in scenes
    )
    rows = kept.rows_of(todo, judged, given)
    print(f"{'scene':20s}{'runs':>5s}  X_g median / 95 % [mm]")
    for name in SCENES:
        own = [row for row in rows if row["name"].startswith(f"{name}/")]
        if own:
            words = [f"{name:20s}{len(own):5d}"]
            for solver in ("chosen", "equal weights"):
                e = np.array([row[solver] for row in own])
                good = e[np.isfinite(e)]
                words.append(f" {solver} {np.median(good):.3f} / {np.quantile(good, 0.95):.3f}")
                words[-1] += f" [{len(e) - len(good)} refused]" if len(good) < len(e) else ""
            print(";".join(words))


if __name__ == "__main__":
    main()
