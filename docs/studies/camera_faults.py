"""Cameras that measure full poses and fail, in the diagnosis: faults hidden in made campaigns, or in the robot.

    python docs/studies/camera_faults.py [--campaigns 48] [--keep FILE --seconds 500] > docs/studies/camera_faults.txt

Synthetic. A UR10e and a KR 210 with wrong geometry hold a board before a camera (or a camera before a board): half of
the campaigns by kinematics in numpy (below), half by MuJoCo, which moves the robot's MJCF. 60 to 150 poses, noise of
0.05 to 0.2 mm and 0.1 to 0.4 mrad. One of these is hidden, of random size: `hand_eye_step` (what the flange carries is
knocked), `stand_step` (what stands), `lens_scale` (focal length), a step of one joint's zero, nothing. "visible" from
0.35 of the noise on (rms, over positions and angles alike). Rules: those of the package at the commit that is named.
"""

import argparse
from pathlib import Path

import kept
import numpy as np
from scipy.spatial.transform import Rotation

from casadical.core.basics import ConvergenceError, InputError
from casadical.diagnosis.diagnose import diagnose
from casadical.export.mjcf.mjcf import mjcf
from casadical.measurements.measurements import Measurements
from casadical.project.problem import read_campaign_robot
from casadical.robot.robot import Robot

ROOT = Path(__file__).parents[2]
FAULTS = ("hand_eye_step", "stand_step", "lens_scale", "joint_zero_step", "none")
INSTRUMENT = set(FAULTS[:3])
NAMES = ("ur10e", "kr210")
VISIBLE = 0.35


def frame(rotvec, xyz) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), xyz
    return T


def flanges(robot: Robot, q: np.ndarray) -> np.ndarray:
    """T_0n by the rows of the robot, shape (n, 4, 4)."""
    found = []
    for reading in q:
        T = np.eye(4)
        for j, value in zip(robot.joints, reading, strict=True):
            T = T @ frame([j.alpha, 0, 0], [j.a, 0, 0]) @ frame([0, j.beta or 0.0, 0], [0, 0, 0])
            T = T @ frame([0, 0, 0], [0, j.b or 0.0, 0]) @ frame([0, 0, j.theta + value], [0, 0, 0])
            T = T @ frame([0, 0, 0], [0, 0, j.d])
        found.append(T)
    return np.array(found)


def one(entry: tuple[int, str, str, str]) -> kept.Row:
    k, fault, name, physics = entry
    rng = np.random.default_rng([26, k])
    robot = read_campaign_robot(ROOT / "problems" / name)
    names = [p.name for p in robot.parameters if p.name.startswith(("theta", "d", "a")) and p.group == "geometry"]
    wrong = {n: robot.parameters[n].value + rng.normal(0, 3e-4) for n in names}
    real = robot.with_values(wrong)
    poses, noise = int(rng.choice([60, 100, 150])), float(rng.choice([0.05, 0.1, 0.2])) * 1e-3
    turn_noise = 2 * noise
    lower, upper = np.array([(max(j.lower, -2.0), min(j.upper, 2.0)) for j in robot.joints]).T
    q = lower + (upper - lower) * (0.5 + rng.uniform(-0.2, 0.2, (poses, robot.n)))
    late = np.arange(poses) >= int(poses * rng.uniform(0.25, 0.75))
    size = noise * float(rng.choice([1.0, 2.0, 4.0, 8.0]))
    moved, joint = q.copy(), int(rng.integers(robot.n))
    if fault == "joint_zero_step":
        moved[:, joint] += late * size / (0.4 * robot.reach)
    T = flanges(real, moved) if physics == "numpy" else by_mujoco(real, moved)
    stands = frame(rng.normal(0, 0.8, 3), [0.0, 0.0, 1.8 * robot.reach])
    hand = frame(rng.normal(0, 0.3, 3), rng.uniform(0.03, 0.12, 3))
    clean = stands @ T @ hand
    shift, turn = rng.standard_normal(3), rng.standard_normal(3)
    knock = frame(turn * size / 0.3, shift * size)
    made = clean.copy()
    if fault == "hand_eye_step":
        made[late] = clean[late] @ knock
    if fault == "stand_step":
        made[late] = frame(turn * size / robot.reach, shift * size) @ clean[late]
    if fault == "lens_scale":
        made[:, 2, 3] *= 1 + size / (0.3 * robot.reach)
    there = np.concatenate([(made - clean)[:, :3, 3] / noise, (made - clean)[:, :3, 0] / turn_noise], axis=1)
    there -= there.mean(axis=0)
    p = made[:, :3, 3] + rng.normal(0, noise, (poses, 3))
    R = made[:, :3, :3] @ Rotation.from_rotvec(rng.normal(0, turn_noise, (poses, 3))).as_matrix()
    try:
        found = diagnose(robot, Measurements(q, "pose", position=p, orientation=R))
    except (InputError, ConvergenceError) as error:
        return {"fault": fault, "physics": physics, "error": str(error)}
    named = sorted({c.label for c in found.causes if c.effects})
    visible = fault != "none" and (fault == "joint_zero_step" or float(np.sqrt(np.mean(there**2))) >= VISIBLE)
    truth = f"joint_zero_step@{joint + 1}" if fault == "joint_zero_step" else fault
    return {
        "fault": fault, "physics": physics, "verdict": found.verdict, "named": named, "visible": visible,
        "right": named == [truth], "robot": found.verdict == "explained" and bool({*named} - INSTRUMENT),
        "instrument": found.verdict == "explained" and bool({*named} & INSTRUMENT),
    }  # fmt: skip


def by_mujoco(robot: Robot, q: np.ndarray) -> np.ndarray:
    """T_0n of the robot's MJCF, shape (n, 4, 4); joint zeros and rows are in its bodies."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mjcf(robot).text)
    data, found = mujoco.MjData(model), []
    at = [model.joint(f"joint{i}").qposadr[0] for i in robot.numbers]
    for reading in q:
        data.qpos[at] = reading
        mujoco.mj_kinematics(model, data)
        last = data.body(f"link{robot.n}")
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = last.xmat.reshape(3, 3), last.xpos
        found.append(T)
    return np.array(found)


def todo(campaigns: int) -> list[tuple[str, tuple[int, str, str, str]]]:
    entries = []
    for k in range(campaigns):
        fault, name = FAULTS[k % len(FAULTS)], NAMES[(k // len(FAULTS)) % 2]
        physics = "mujoco" if (k // (2 * len(FAULTS))) % 2 else "numpy"
        entries.append((f"{k}/{fault}/{name}/{physics}", (k, fault, name, physics)))
    return entries


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--campaigns", type=int, default=48)
    kept.add_options(parser, "camera_faults")
    given = parser.parse_args()
    rows = kept.rows_of(todo(given.campaigns), one, given)
    print(f"{len(rows)} campaigns\n")
    print("fault            physics  campaigns  visible  named  a cause in the robot claimed  in the camera  failed")
    for fault in FAULTS:
        for physics in ("numpy", "mujoco"):
            own = [r for r in rows if r["fault"] == fault and r["physics"] == physics]
            good = [r for r in own if "error" not in r]
            sums = [sum(r[c] for r in good) for c in ("visible", "robot", "instrument")]
            named = sum(r["visible"] and r["right"] for r in good)
            print(
                f"{fault:16s} {physics:8s} {len(own):9d} {sums[0]:8d} {named:6d} {sums[1]:29d} {sums[2]:14d} "
                f"{len(own) - len(good):7d}"
            )
    for r in rows:
        if "error" in r or (r["visible"] and not r["right"]):
            print(f"  {r['name']}: {r.get('verdict', 'failed')} {r.get('named', r.get('error'))}")


if __name__ == "__main__":
    main()
