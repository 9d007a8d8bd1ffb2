"""
14. Arm or camera? Hand-eye calibration of a real arm
=====================================================

A camera on the hand of a Franka Research 3 sees a board (ChArUco) at 114 stations; ``solvePnP`` gave the pose of the
board in the camera. Where is the camera on the flange (hand-eye, eye in hand), which of the two is wrong, arm or
camera, by how much, and how many stations would have been enough? Ten minutes, most of them to read. Data: the example
of robotkinecal, MIT licence (data/fr3_camera).
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials
folder = Path(tempfile.mkdtemp())


def casadical(*words):
    """A command as in a shell."""
    command = [sys.executable, "-c", "from casadical.cli import main; main()", *map(str, words)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    print(done.stdout or done.stderr)
    return done.returncode


# %%
# What ``solvePnP`` gives
# -----------------------
# A row a station: the joints, and ``rvec`` and ``tvec``, the board in the camera. (The published table has the camera
# in the board's frame; here it is turned back to what a script around OpenCV writes.) Nothing has to be inverted by
# hand: ``new`` compares the poses with the robot and says how it reads them.

m = pd.read_csv(ROOT / "data/fr3_camera/fr3_114.csv")
R = m[[f"R{i}{j}" for i in range(3) for j in range(3)]].to_numpy().reshape(-1, 3, 3)
in_camera = Rotation.from_matrix(R).inv()
table = m[[c for c in m if c.startswith("q")]].copy()
table[["tvec_x", "tvec_y", "tvec_z"]] = -in_camera.apply(m[["x_m", "y_m", "z_m"]].to_numpy())
table[["rvec_x", "rvec_y", "rvec_z"]] = in_camera.as_rotvec()
table.to_csv(folder / "poses.csv", index=False)

dh = "joint,alpha_deg,a_mm,theta_deg,d_mm\n1,0,0,0,333\n2,-90,0,0,0\n3,90,0,0,316\n4,90,82.5,0,0\n5,-90,-82.5,0,384\n"
(folder / "dh.csv").write_text(dh + "6,90,0,0,0\n7,90,88,0,0\n")
assert casadical("new", "arm", "--dh", "dh.csv", "--data", "poses.csv", "--eye-in-hand", "--yes") == 0

# %%
# Arm or camera?
# --------------
# The calibration weighs every pose by the camera's own noise (depth and tilts are worst), frees the arm's geometry as
# far as the stations tell it, and compares it with what a camera can have wrong: focal length, scale of the board,
# distortion. Both shares have an interval. A camera that was knocked is named with the rows between which it moved.

assert casadical("calibrate", "arm", "--out", "results") == 0
result = json.loads((folder / "results/result.json").read_text())
answer = result["arm_or_camera"]
print(answer["in_words"])
assert answer["arm"]["probability"] > 0.9
assert answer["arm"]["low_mm"] > 2 * answer["camera"]["high_mm"]

# %%
# Hand-eye, twice
# ---------------
# With the calibrated arm, and for a controller or a URDF that keeps the nominal one: ``hand_eye.calib`` and
# ``hand_eye_nominal.calib`` are files of easy_handeye2, with the line of ``static_transform_publisher``. They differ by
# millimetres, because a nominal arm hides its errors in the hand-eye transform.

print((folder / "results/hand_eye_nominal.calib").read_text())
calibrated, nominal = (np.array(result[key]["xyz_mm"]) for key in ("hand_eye", "hand_eye_nominal"))
assert 2 < np.linalg.norm(calibrated - nominal) < 12

# %%
# How many stations?
# ------------------
# ``plan --camera`` knows from these stations where the board is and how the camera sees it. Twenty chosen stations are
# as good as the eighty that were measured.

assert casadical("plan", "arm", "--camera", "-n", 20, "--out", "stations.csv", "--json", "plan.json") == 0
forecast = pd.DataFrame(json.loads((folder / "plan.json").read_text())["forecast"])
measured, chosen = forecast.iloc[0], forecast.iloc[1:]
assert chosen.set_index("stations")["hand_eye_mm"][25] < measured["hand_eye_mm"]

fig, ax = plt.subplots(figsize=(6, 3.2), layout="constrained")
ax.plot(chosen["stations"], chosen["hand_eye_mm"], "o-", label="hand-eye, chosen stations")
ax.plot(chosen["stations"], chosen["place_mm"], "s--", label="place of the board, chosen stations")
ax.plot(measured["stations"], measured["hand_eye_mm"], "x", label=f"hand-eye, the {measured['stations']:.0f} measured")
ax.set(xlabel="stations", ylabel="expected error [mm]", ylim=(0, None))
ax.legend(frameon=False)
