"""Hand-eye transforms beside other solvers, on scenes of the benchmark kinhec.

    pip install kinhec "opencv-python-headless<5"
    python docs/studies/hand_eye_anchors.py [--runs 12] [--keep FILE --seconds 500]

UR5e and iiwa 7, eye in hand and eye to base, 15, 25 and 40 look-at stations, made and disturbed by kinhec 1.1.0: its
noise along the camera's axes [mm; mrad], or that of pixels through its PnP. Errors are of X_g, the hand-eye transform
in the nominal last row (see camera.py), in mm. Beside ours stand kinhec's solvers of AX = YB and OpenCV's of
AX = XB and AX = YB, all with the nominal arm; "best" is the solver with the least median in a scene.
"""

import argparse

import camera
import cv2
import kept
import numpy as np
from kinhec import config, generator, robots, se3
from kinhec.solvers import axyb

from casadical.core.basics import Array, ConvergenceError, InputError
from casadical.core.parts import Joint, Placement
from casadical.core.transforms import frame
from casadical.identification.identification import identify
from casadical.robot.robot import Robot

# Scene -> error of the arm [m, rad], noise of rotation [rad] and translation [m] or pixels, share of outliers.
SCENES: dict[str, tuple[float, tuple[float, tuple[float, float, float]] | float, float]] = {
    "a right, 1 1 3 mm, 2 mrad": (0.0, (0.002, (0.001, 0.001, 0.003)), 0.0),
    "f right, .3 .3 .9 mm, .6 mrad": (0.0, (0.0006, (0.0003, 0.0003, 0.0009)), 0.0),
    "h right, pnp .25 px": (0.0, 0.25, 0.0),
    "b off, 1 1 3 mm, 2 mrad": (1e-3, (0.002, (0.001, 0.001, 0.003)), 0.0),
    "e off, .3 .3 .9 mm, .6 mrad": (1e-3, (0.0006, (0.0003, 0.0003, 0.0009)), 0.0),
    "g off, pnp .25 px": (1e-3, 0.25, 0.0),
    "c right, 12 % outliers": (0.0, (0.002, (0.001, 0.001, 0.003)), 0.12),
}


def robot_of(model: robots.RobotModel) -> tuple[Robot, Array]:
    """Kinhec's arm in rows of modified DH, and what remains of the last row (4, 4)."""
    shift = model.convention == "standard"
    alpha, a = ((np.roll(v, 1) * (np.arange(model.dof) > 0) if shift else v) for v in (model.alpha, model.a))
    parallel = [i > 0 and abs(np.sin(x)) < 1e-9 for i, x in enumerate(alpha)]
    joints = tuple(
        Joint(
            alpha=float(alpha[i]), a=float(a[i]), d=float(model.d[i]), theta=float(model.theta_offset[i]),
            beta=0.0 if parallel[i] else None, lower=-7.0, upper=7.0,
        )
        for i in range(model.dof)
    )  # fmt: skip
    robot = Robot(model.name, joints, base=Placement(np.eye(4), "pose"), tool=Placement(np.eye(4), "pose"))
    c, s = np.cos(model.alpha[-1]), np.sin(model.alpha[-1])
    end = frame(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), np.array([model.a[-1], 0, 0])) if shift else np.eye(4)
    return robot, end


def last_row(model: robots.RobotModel, dh: dict[str, list[float]]) -> Array:
    """What follows the last joint in kinhec's rows, (4, 4)."""
    rot = lambda axis, angle: se3.make_transform(se3.exp_so3(angle * np.eye(3)[axis]), np.zeros(3))  # noqa: E731
    move = lambda x, z: se3.make_transform(np.eye(3), np.array([x, 0, z]))  # noqa: E731
    turned = rot(2, dh["theta_offset"][-1]) @ move(0, dh["d"][-1])
    return np.asarray(
        turned @ move(dh["a"][-1], 0) @ rot(0, dh["alpha"][-1]) if model.convention == "standard" else turned
    )


def scene(name: str, which: str, in_hand: bool, n: int, seed: int):
    """Kinhec's model, readings, reported flange poses, measured poses of the target and X_g."""
    off, noise, outliers = SCENES[name]
    made = config.SequenceConfig(
        "one", "made", name, seed, robot=which, configuration="eye_in_hand" if in_hand else "eye_to_hand",
        family="lookat", family_params={"n_waypoints": n}, target="checker_9x6_25mm" if in_hand else "marker_3x3_30mm",
    )  # fmt: skip
    made.sampling |= {"mode": "stations", "n_stations": n}
    made.robot_noise |= {"models": ["dh_error"] if off else ["none"], "dh_len_std_m": off, "dh_ang_std_rad": off}
    pixels = isinstance(noise, float)
    made.camera_noise |= (
        {"model": "pnp", "pixel_std": noise}
        if pixels
        else {"rot_std_rad": [noise[0]] * 3, "trans_std_m": list(noise[1])}
    )
    made.outliers |= {"fraction": outliers}
    record = generator.generate_sequence(made)
    arm, seen = record.robot_table.to_pandas(), record.camera_table.to_pandas()
    parts = [f"cam_target_meas_{c}" for c in generator.POSE_COMPONENTS]
    good = np.isfinite(seen[parts].to_numpy()).all(axis=1)
    q = np.stack(arm["q_meas"])[good]
    T, A = (
        se3.pq_to_pose(table[[f"{stem}_{c}" for c in generator.POSE_COMPONENTS]].to_numpy()[good])
        for table, stem in ((seen, "cam_target_meas"), (arm, "base_ee_meas"))
    )
    X = se3.pq_to_pose(np.array([[record.manifest[f"X_{c}"] for c in generator.POSE_COMPONENTS]]))[0]
    model = robots.get_robot(which)
    nominal = {k: getattr(model, k) for k in ("a", "d", "alpha", "theta_offset")}
    X_g = np.linalg.inv(last_row(model, nominal)) @ last_row(model, record.extra.get("true_dh", nominal)) @ X
    return model, q, A, T, X_g


def judged(entry: tuple[str, str, bool, int, int]) -> kept.Row:
    """Errors [mm] of X_g by every solver."""
    in_hand = entry[2]
    model, q, A, T, X_g = scene(*entry)
    robot, end = robot_of(model)
    m = camera.measured(q * model.sign, T, in_hand)
    row: kept.Row = {"poses": len(q), "ours": float("nan")}
    try:
        found = identify(robot, m, ["kinematic"]).robot
        X = np.linalg.inv(end) @ camera.in_last_row(robot, found, found.tool.T)
        row["ours"] = 1e3 * float(np.linalg.norm(X[:3, 3] - X_g[:3, 3]))
    except (InputError, ConvergenceError) as error:
        row["refused"] = str(error)
    B = np.linalg.inv(T) if in_hand else T
    solved = {"kinhec Shah": axyb.shah(A, B)[0], "kinhec Li": axyb.li_kronecker(A, B)[0]}
    solved["kinhec LM"] = axyb.refine_lm_axyb(A, B, *axyb.shah(A, B))[0]
    flange = A if in_hand else np.linalg.inv(A)
    for solver in ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS") if in_hand else ():
        try:
            R, t = cv2.calibrateHandEye(
                list(flange[:, :3, :3]), list(flange[:, :3, 3]), list(T[:, :3, :3]), list(T[:, :3, 3]),
                method=getattr(cv2, f"CALIB_HAND_EYE_{solver}"),
            )  # fmt: skip
        except cv2.error:  # it finds no rotation
            continue
        solved[f"OpenCV {solver}"] = frame(np.asarray(R), np.asarray(t).ravel())
    return row | {k: 1e3 * float(np.linalg.norm(X[:3, 3] - X_g[:3, 3])) for k, X in solved.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--first", type=int, default=0)
    kept.add_options(parser, "hand_eye_anchors")
    given = parser.parse_args()
    arms, places, counts = ("ur5e", "iiwa7"), (True, False), (15, 25, 40)
    todo = kept.named(
        (name, arms[run % 2], places[run // 2 % 2], counts[run % 3], 1000 + run)
        for run in range(given.first, given.first + given.runs)
        for name in SCENES
    )
    rows = kept.rows_of(todo, judged, given)
    print(f"{'scene':32s}{'runs':>5s}  X_g median / 95 % [mm]")
    for name in SCENES:
        own = [row for row in rows if row["name"].startswith(f"{name}/")]
        if not own:
            continue
        each = {
            k: np.array([row.get(k, np.nan) for row in own])
            for row in own
            for k in row
            if k[:4] in ("ours", "kinh", "Open")
        }
        words = {k: f"{k} {np.nanmedian(e):.3f} / {np.nanquantile(e, 0.95):.3f}" for k, e in each.items()}
        refused = sum("refused" in row for row in own)
        others = sorted((np.nanmedian(e), k) for k, e in each.items() if not k.startswith("ours"))
        refusals = f"; {refused} refused" if refused else ""
        print(f"{name:32s}{len(own):5d}  {words['ours']}; best {words[others[0][1]]}{refusals}")


if __name__ == "__main__":
    main()
