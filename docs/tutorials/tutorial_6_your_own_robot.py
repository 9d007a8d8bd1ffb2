"""
6. Your own robot
=================

From a URDF, or a printed DH table, and a CSV of measurements to a problem folder for ``casadical calibrate``. The robot
is a UR10 again, but this time nothing is prepared: we write every file here. The readings are real (1495 joint
configurations, laser tracker).
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

import casadical

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials
folder = Path(tempfile.mkdtemp()) / "my_ur10"
folder.mkdir()

# %%
# Start from a URDF
# -----------------
# Only the joints with their axes and ranges are required; masses, if given, define the gravity torques. Meshes are not
# needed. The last link is the measured point: here a probe about 185 mm in front of the flange, measured with a ruler.

LINKS = ["base_link", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3", "probe"]
JOINTS = (  # name, where it sits on the link before [m], turned by [rad], axis
    ("pan", (0, 0, 0.1273), (0, 0, 0), (0, 0, 1)),
    ("lift", (0, 0.220941, 0), (0, np.pi / 2, 0), (0, 1, 0)),
    ("elbow", (0, -0.1719, 0.612), (0, 0, 0), (0, 1, 0)),
    ("w1", (0, 0, 0.5723), (0, np.pi / 2, 0), (0, 1, 0)),
    ("w2", (0, 0.1149, 0), (0, 0, 0), (0, 0, 1)),
    ("w3", (0, 0, 0.1157), (0, 0, 0), (0, 1, 0)),
)


def numbers(values):
    return " ".join(f"{v:.10g}" for v in values)


parts = [f'<link name="{name}"/>' for name in LINKS]
for (name, xyz, rpy, axis), parent, child in zip(JOINTS, LINKS, LINKS[1:], strict=False):
    parts.append(
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{numbers(xyz)}" rpy="{numbers(rpy)}"/><axis xyz="{numbers(axis)}"/>'
        '<limit lower="-6.2832" upper="6.2832" effort="100" velocity="2"/></joint>'
    )
parts.append(
    '<joint name="mount" type="fixed"><parent link="wrist_3"/><child link="probe"/>'
    f'<origin xyz="0 {0.0922 + 0.185} 0" rpy="{numbers((-np.pi / 2, 0, 0))}"/></joint>'
)
(folder / "arm.urdf").write_text('<?xml version="1.0"?>\n<robot name="my_ur10">\n' + "\n".join(parts) + "\n</robot>\n")

robot = casadical.read_urdf(folder / "arm.urdf")
print(f"{robot.name}: {robot.n} joints;", "; ".join(robot.notes))

# %%
# Start from a DH table
# ---------------------
# The maker gives the table in the standard convention: theta, d, a, alpha. A robot file is the same with units in the
# keys. Missing keys have their default.

DH = """\
casadical = 1
name = "UR10 from the maker's table"
convention = "standard"

[base]
unknown = "pose"            # its pose in the tracker's frame: identified

[tool]
xyz_mm = [0, 0, 185]        # roughly; identified
unknown = "position"
"""
for d_mm, a_mm, alpha_deg in (
    (127.3, 0, 90),
    (0, -612, 0),
    (0, -572.3, 0),
    (163.941, 0, 90),
    (115.7, 0, -90),
    (92.2, 0, 0),
):
    DH += f"\n[[joint]]\nd_mm = {d_mm}\na_mm = {a_mm}\nalpha_deg = {alpha_deg}\nlimits_deg = [-360, 360]\n"
(folder / "robot.toml").write_text(DH)
from_table = casadical.read_robot(folder / "robot.toml")

# %%
# Both must be the same robot. Their base frames may differ (this URDF's base is rotated by half a turn against the
# table's), so we compare distances between tool positions at random readings, which do not depend on the frame.


def distances(robot, readings):
    p = np.array([robot.position(q, robot.parameters.values).full().ravel() for q in readings])
    return np.linalg.norm(p[1:] - p[:-1], axis=1)


readings = np.random.default_rng(0).uniform(-3, 3, (50, 6))
apart = np.abs(distances(robot, readings) - distances(from_table, readings)).max()
print(f"largest difference of a distance between the two models: {1e6 * apart:.3f} um")
assert apart < 1e-8

# %%
# Your CSV
# --------
# Your file has its own format. Here: other joint names, degrees, tracker columns ``X Y Z`` in millimetres. Nothing has
# to be renamed in the file: ``problem.toml`` maps the columns. Our names include the unit, and this declares the unit.

source = pd.read_csv(ROOT / "data/ur10_laser_tracker/series_B_joint_configurations.csv")
mine = pd.DataFrame({f"Axis {i}": np.rad2deg(source[f"q{i}_rad"]) for i in range(1, 7)})
mine[["X", "Y", "Z"]] = source[["x_mm", "y_mm", "z_mm"]]
mine.to_csv(folder / "poses.csv", index=False)
print(mine.head(3).round(2).to_string())

columns = ", ".join([f'q{i}_deg = "Axis {i}"' for i in range(1, 7)] + [f'{v}_mm = "{v.upper()}"' for v in "xyz"])
PROBLEM = f"""\
casadical = 1
title = "My UR10"
data = "real"
robot = "ROBOT"
methods = ["KM"]
loss = "huber"              # in case some rows are outliers

[[measurements]]
file = "poses.csv"
columns = {{ {columns} }}

[sets]
identify = 400
report = 800
"""

# %%
# Run it
# ------
# From a shell: ``casadical calibrate my_ur10 --out results``.

casadical_command = Path(sys.executable).with_name("casadical")


def calibrate(robot_file):
    """Run the command on the folder with one of the two robot files: what it prints, and its figures."""
    (folder / "problem.toml").write_text(PROBLEM.replace("ROBOT", robot_file))
    command = [casadical_command, "calibrate", folder, "--json", folder / "out.json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done, json.loads((folder / "out.json").read_text()) if done.returncode == 0 else {}


runs = {name: calibrate(name) for name in ("arm.urdf", "robot.toml")}
print(runs["robot.toml"][0].stdout)

# %%
# The two descriptions give the same accuracy on the 800 held-out poses, as expected.

means = {name: run["methods"]["KM"]["sets"]["report"]["mean_mm"] for name, (_, run) in runs.items()}
print({name: f"{mean:.4f} mm" for name, mean in means.items()})
assert 0.3 < means["robot.toml"] < 0.5
assert abs(means["arm.urdf"] - means["robot.toml"]) < 0.01

# %%
# When it does not run
# --------------------
# Most first attempts fail because of a unit or a sign. An implausible unit is refused before anything is computed; the
# message says where it is.

PROBLEM = PROBLEM.replace("_deg", "_rad")
refused, _ = calibrate("robot.toml")
print(refused.returncode, refused.stderr)
assert refused.returncode == 2
assert "poses.csv" in refused.stderr

# %%
# The wrong sign of a joint is not visible in a single row, but in the fit.

PROBLEM = PROBLEM.replace("_rad", "_deg")
mine["Axis 3"] *= -1
mine.to_csv(folder / "poses.csv", index=False)
backwards, _ = calibrate("robot.toml")
print(backwards.returncode, backwards.stderr)
assert backwards.returncode == 2
assert "the model does not fit" in backwards.stderr

# %%
# What to do next
# ---------------
# - Masses and mass centres (``body`` in the robot file) make joint compliance identifiable: :doc:`/robot-file`.
# - Other kinds of data, full poses, distances, sockets: :doc:`/measurements`.
# - Which poses to measure: :doc:`/plan`.
