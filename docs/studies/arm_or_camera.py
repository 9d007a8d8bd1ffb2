"""Whether the arm or the camera is wrong: simulated cells in which one, both or neither is.

    python docs/studies/arm_or_camera.py [--cells 60] [--keep FILE --seconds 500]

UR5e and iiwa 7 arms, eye in hand and to base, 12 to 50 stations, pixels of 0.15 to 0.5 px through a PnP fit. A wrong
arm is off by normal errors of 0.2 to 1.5 mm and mrad in every parameter, a wrong camera has a focal length that is off
by 0.3 to 2 %. The true contributions are errors of the target's place in the camera without noise, of either alone,
with base and tool fitted by the weights that were found. A side is wrong in truth where its contribution exceeds a
quarter of the noise; "share" is the camera's part of both root mean squares.
"""

import argparse
from dataclasses import replace

import camera
import kept
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from casadical.core.basics import Array
from casadical.core.transforms import frame
from casadical.identification.arm_or_camera import ArmOrCamera, arm_or_camera
from casadical.identification.identification import identify
from casadical.measurements.camera_noise import whitening
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot


def left(robot: Robot, m: Measurements, found: ArmOrCamera, in_hand: bool) -> float:
    """Rms error [mm] of the target's place in the camera with base and tool fitted by scipy, weighed by a noise."""
    start = identify(robot, replace(m, camera=""), ["placement"], loss="linear").robot
    W = whitening(m.view, found.ratios) / np.repeat(found.sigmas, 3)[:, None]
    middle = np.array(found.ratios.point)

    def moved(x: Array) -> Array:
        near, far = (frame(Rotation.from_rotvec(v[3:]).as_matrix(), v[:3]) for v in x.reshape(2, 6))
        return np.asarray(near @ camera.poses_of(start, m.q) @ far)

    def residual(x: Array) -> Array:
        T = moved(x)
        turn = Rotation.from_matrix(m.orientation.transpose(0, 2, 1) @ T[:, :3, :3]).as_rotvec()
        return np.asarray(W @ np.column_stack([T[:, :3, 3] - m.position, turn])[:, :, None]).ravel()

    T = moved(least_squares(residual, np.zeros(12), x_scale=1e-3).x)
    model, seen = (np.linalg.inv(T) if in_hand else T), m.view
    off = model[:, :3, 3] + model[:, :3, :3] @ middle - seen.t - seen.R @ middle
    return 1e3 * float(np.sqrt((off**2).sum(axis=1).mean()))


def judged(cell: int) -> kept.Row:
    """Truth and answer of one cell."""
    rng = np.random.default_rng([58, cell])
    which, in_hand, n = list(camera.ARMS)[cell % 2], bool(rng.integers(2)), int(rng.integers(12, 51))
    wrong_arm, wrong_camera = bool(cell // 2 % 2), bool(cell // 4 % 2)
    size = float(np.exp(rng.uniform(np.log(0.2), np.log(1.5)))) * wrong_arm
    focal = 1 + float(np.exp(rng.uniform(np.log(3e-3), np.log(2e-2)))) * rng.choice([-1, 1]) * wrong_camera
    pixels, robot = rng.uniform(0.15, 0.5), camera.arm(which)
    built = camera.as_built(robot, size, rng)
    X = frame(np.eye(3), np.array([*rng.uniform(-0.07, 0.07, 2), 0.06]))
    q, T = camera.stations(built, X, in_hand, n, rng)
    fit, exact, no_camera = (
        camera.measured(q, camera.through_pixels(T, px, in_hand, rng, f), in_hand)
        for px, f in ((pixels, focal), (0.0, focal), (0.0, 1.0))
    )
    found = arm_or_camera(identify(robot, fit, ["kinematic"]))
    assert found is not None
    true_camera = left(built, exact, found, in_hand)
    true_arm = left(robot, no_camera, found, in_hand)
    return {
        "arm": true_arm, "camera": true_camera, "noise": 1e3 * found.noise, "n": n, "size": size, "focal": focal - 1,
        "wrong": found.wrong, "found arm": 1e3 * found.arm.size, "found camera": 1e3 * found.camera.size,
        "p arm": found.arm.probability, "p camera": found.camera.probability,
        "low": 1e3 * found.camera.low, "high": 1e3 * found.camera.high,
        "arm low": 1e3 * found.arm.low, "arm high": 1e3 * found.arm.high, "says": found.in_words(),
    }  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    kept.add_options(parser, "arm_or_camera")
    given = parser.parse_args()
    rows = kept.rows_of([(str(k), k) for k in range(given.first, given.first + given.cells)], judged, given)
    right = wrong = told = near = covered = 0
    for row in rows:
        limit = row["noise"] / 4
        truth = {(0, 0): "neither", (1, 0): "arm", (0, 1): "camera", (1, 1): "both"}[
            (int(row["arm"] > limit), int(row["camera"] > limit))
        ]
        told += row["wrong"] != ""
        right += row["wrong"] == truth
        sides = [("arm", row["p arm"]), ("camera", row["p camera"])]
        wrong += any(((p >= 0.9) and row[side] <= limit) or ((p <= 0.1) and row[side] > limit) for side, p in sides)
        share, true = (row[f"{a}camera"] / max(row[f"{a}camera"] + row[f"{a}arm"], 1e-9) for a in ("found ", ""))
        near += abs(share - true) < 0.1
        sides = [(row[side], row[f"{low}low"], row[f"{low}high"]) for side, low in (("camera", ""), ("arm", "arm "))]
        covered += all(low - 0.01 <= true <= high + 0.01 for true, low, high in sides)
        print(
            f"{row['name']:>3s} n {row['n']:2d} truth {truth:8s} arm {row['arm']:.3f} camera {row['camera']:.3f} mm; "
            f"said {row['wrong'] or '-':8s} arm {row['found arm']:.3f} camera {row['found camera']:.3f} mm "
            f"noise {row['noise']:.3f}, p {row['p arm']:.2f} {row['p camera']:.2f}"
        )
    print(
        f"{len(rows)} cells: told {told}, right {right}, a side wrong at 0.9 {wrong}, share within 0.1 {near}, "
        f"both intervals hold the truth within 0.01 mm {covered}"
    )


if __name__ == "__main__":
    main()
