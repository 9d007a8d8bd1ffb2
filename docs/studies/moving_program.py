"""python docs/studies/moving_program.py > docs/studies/moving_program.txt (two minutes)

Draws docs/images/moving_program.png, the picture of the tutorial "To the controller". A simulated robot runs a
corrected program. The plant is the calibrated HH800 in MuJoCo (its four-bar, joint springs and payload; inertias and
damping are placeholders, so it moves slowly), stepped through time; the controller has the nominal model alone. The
program is a circle of 361 joint targets that the nominal robot reaches, as CSV; `casadical correct` rewrites it. The
controller sends the targets one after the other, with straight lines between them in joint space. The error is the
distance of MuJoCo's tool from the circle, so that a lag along it does not count. "A robot without errors" is the
nominal one in MuJoCo: what the straight lines and the lag leave.
"""

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import mujoco
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

from casadical import calibrate, write_robot
from casadical.export import inverse_kinematics
from casadical.export.mjcf.mjcf import mjcf

ROOT = Path(__file__).parents[2]
RADIUS, TARGETS = 0.4, 361
SETTLE, SECONDS = 4.0, 60.0  # at rest before the start, and for the circle
BEFORE, AFTER, INK, SOFT = "#b3ada2", "#0f766e", "#23262b", "#5c6068"


def robots():
    """The calibrated robot, and the nominal one with base and tool as identified, which are no errors of the robot."""
    calibration = calibrate(ROOT / "problems" / "hh800", method="SKCM")
    real, nominal = calibration.identification.robot, calibration.problem.robot
    placing = {p.name: p.value for p in real.parameters if p.group in ("base", "tool")}
    placed = nominal.with_values(placing)
    rigid = replace(placed, joints=tuple(replace(j, compliance=None) for j in placed.joints))
    return real, nominal, rigid, calibration.problem.sets["report"][0].q[0]


def circle(rigid, middle):
    """Joint targets of the nominal robot, shape (TARGETS, n) [rad], the centre, and two axes of the circle."""
    p, R = (x.full() for x in rigid.pose(middle, rigid.parameters.values))
    across, up = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    angle = np.linspace(0, 2 * np.pi, TARGETS)[:, None]
    points = p[:, 0] + RADIUS * (np.cos(angle) * across + np.sin(angle) * up)
    q = []
    for point in points:
        start = middle if not q else q[-1]
        found = inverse_kinematics(rigid, point, R[None], start=start)
        if not (found.reached.all() and found.inside.all()):
            raise SystemExit(f"the nominal robot does not reach {point}")
        q.append(found.q[0])
    return np.array(q), p[:, 0], across, up


def run(xml, q, centre, across, up):
    """Angle along the circle [deg] and distance from it [mm], at a thousand times of the motion in MuJoCo."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    n, names = q.shape[1], [model.joint(k).name for k in range(model.njnt)]
    for i in range(n):
        data.qpos[names.index(f"joint{i + 1}")] = q[0, i]
    servos = [model.actuator(f"drive{i + 1}").id for i in range(n)]
    tool, kept = [], max(1, round(SECONDS / model.opt.timestep / 1000))
    settle, steps = round(SETTLE / model.opt.timestep), round(SECONDS / model.opt.timestep)
    for k in range(-settle, steps):
        at = max(k, 0) / steps * (len(q) - 1)
        data.ctrl[servos] = [np.interp(at, range(len(q)), q[:, i]) for i in range(n)]
        mujoco.mj_step(model, data)
        if k >= 0 and k % kept == 0:
            tool.append(data.site("measured").xpos.copy())
    from_centre = np.array(tool) - centre
    flat = np.stack([from_centre @ across, from_centre @ up])
    away = from_centre @ np.cross(across, up)
    return np.rad2deg(np.unwrap(np.arctan2(flat[1], flat[0]))), 1e3 * np.hypot(
        np.linalg.norm(flat, axis=0) - RADIUS, away
    )


def corrected(real, nominal, q, folder):
    """The targets of the program after `casadical correct`, and what it printed."""
    header = ",".join(f"q{i + 1}_deg" for i in range(q.shape[1]))
    np.savetxt(folder / "circle.csv", np.rad2deg(q), fmt="%.7f", delimiter=",", header=header, comments="")
    write_robot(real, folder / "real.toml")
    write_robot(nominal, folder / "nominal.toml")
    words = ["correct", folder / "real.toml", folder / "circle.csv", "--nominal", folder / "nominal.toml"]
    run = [sys.executable, "-c", "from casadical.cli import main; main()"]
    command = [*run, *map(str, words), "--out", str(folder / "corrected.csv")]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    table = (folder / "corrected.csv").read_text().splitlines()
    rows = [line.split(",")[: q.shape[1]] for line in table[1:]]
    return np.deg2rad(np.array(rows, dtype=float)), said


def draw(runs, path):
    figure, axes = plt.subplots(figsize=(8, 3.6), layout="constrained", dpi=130)
    styles = ((BEFORE, 1.8, 2, 1.0), (AFTER, 1.4, 2, 0.62), (INK, 0.5, 1, 1.6))
    for (label, (angle, off)), (colour, width, order, at) in zip(runs.items(), styles, strict=True):
        axes.semilogy(angle, off, color=colour, linewidth=width, zorder=order, alpha=1 if order == 2 else 0.5)
        axes.text(363, at * off[-200:].mean(), label, color=colour, va="center", fontsize=9)
    axes.set_xlim(0, 360)
    axes.set_ylim(0.002, 10)
    axes.set_xticks(range(0, 361, 90))
    axes.set_yticks([0.01, 0.1, 1, 10], ["0.01", "0.1", "1", "10 mm"])
    axes.set_xlabel("along the circle [deg]", color=SOFT)
    axes.set_ylabel("tool off the circle", color=SOFT)
    axes.grid(alpha=0.25)
    axes.minorticks_off()
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.set_title("A circle of 0.8 m by the HH800 in MuJoCo", loc="left", fontsize=11, color=INK)
    figure.savefig(path, facecolor="white")


def main():
    real, nominal, rigid, middle = robots()
    q, centre, across, up = circle(rigid, middle)
    with tempfile.TemporaryDirectory() as folder:
        new, said = corrected(real, nominal, q, Path(folder))
    plant, model = mjcf(real).text, mjcf(rigid).text
    runs = {
        "as programmed": run(plant, q, centre, across, up),
        "corrected": run(plant, new, centre, across, up),
        "a robot without errors": run(model, q, centre, across, up),
    }
    print(f"HH800 in MuJoCo, a circle of {2 * RADIUS:g} m in {SECONDS:g} s, {TARGETS} joint targets")
    print(said.split("\n")[0])
    for label, (_, off) in runs.items():
        print(f"{label:24} off the circle by {off.mean():.4f} mm on average, {off.max():.4f} mm at most")
    draw(runs, ROOT / "docs" / "images" / "moving_program.png")


if __name__ == "__main__":
    main()
