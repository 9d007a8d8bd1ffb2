"""
4. Train the compensator and put it on a controller
===================================================

From a calibrated HH800 to C that a controller calls: train a network on the remaining error, export the whole
correction as C99, compile it with gcc, call it through ctypes, and send the corrected commands to the (simulated)
robot to check them. It needs gcc.
"""

import ctypes
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from casadical import calibrate, from_table, write_robot
from casadical.compensator import Compensator, Taught, save_compensator
from casadical.export import Sources, Status, command_of, load, model_corrector, write_c
from casadical.identification import predicted, residual_mm

ROOT = Path(sys.argv[0]).resolve().parents[2]
folder = Path(tempfile.mkdtemp())

# %%
# Calibrate, then train
# ---------------------
# The network learns the measured minus the computed position from 50 poses; 50 others decide whether it is kept. The
# verdict comes first.

calibration = calibrate(ROOT / "problems/hh800", method="SKCM")
problem, calibrated = calibration.problem, calibration.identification
train, choose, report = (problem.sets[name][0] for name in ("train", "choose", "report"))
compensator = Compensator.fit(
    train.q,
    residual_mm(calibrated.robot, train),
    choose=(choose.q, residual_mm(calibrated.robot, choose)),
    validate=(report.q, residual_mm(calibrated.robot, report)),
    trainer=Taught(),
    seed=0,
)
print(compensator)
assert compensator.helps
assert compensator.validation.gain > 0.15

# %%
# Export
# ------
# `command_of` makes one CasADi function: forward kinematics with the identified values, deflection under gravity, the
# network, and two damped least-squares steps from the nominal to the real robot. `write_c` emits C from it, compiles
# it, compares it with its reference on many joint vectors, bit for bit, and only then writes the files. (`casadical
# export c` does the same from files.)

write_robot(calibrated.robot, folder / "calibrated.toml")
save_compensator(compensator, folder / "network.json")
sources = Sources(folder / "calibrated.toml", ROOT / "problems/hh800/robot.toml", folder / "network.json")
export = write_c(command_of(sources), folder / "c", name="hh800", vectors=20_000)
print(*(block.text for block in export.blocks()), sep="\n")
assert export.verified

# %%
# Compile it as in your own build
# -------------------------------
# Two files, no library, not even libm. `-ffp-contract=off`, because fused multiply-adds change the last bits; the
# self-test would detect it.

library = folder / "hh800.so"
command = "gcc -std=c99 -O2 -ffp-contract=off -Wall -Wextra -Werror -shared -fPIC hh800.c hh800_self_test.c -o"
subprocess.run([*command.split(), str(library)], cwd=folder / "c", check=True)
c = ctypes.CDLL(str(library))
assert c.hh800_self_test() == Status.OK


def correction(q):
    """One call of the C: joint corrections [rad] and the status."""
    dq = np.zeros(6)
    pointer = ctypes.POINTER(ctypes.c_double)
    status = c.hh800_correct(np.ascontiguousarray(q).ctypes.data_as(pointer), dq.ctypes.data_as(pointer))
    return dq, Status(status)


dq, status = correction(report.q[0])
print("corrections of the first pose [mrad]:", np.round(1e3 * dq, 3), status.name)

# %%
# Bad input gives a status and zeros, never a crash or a wrong command.

dq, status = correction(np.array([np.nan, 0, 0, 0, 0, 0]))
assert (status, np.abs(dq).max()) == (Status.NOT_FINITE, 0)
_, status = correction(report.q[0] + [9, 0, 0, 0, 0, 0])
assert status != Status.OK
print("joint 1 far out of its range:", status.name)

# %%
# Does the real tool reach the target?
# ------------------------------------
# The controller commands joints q and assumes that the tool is at the position of the *nominal* robot. Where the real
# tool is at q was measured; how far a correction of some milliradians moves it, the calibrated model says to some
# thousandths of that. So we know where it is with q + dq, for the calibration alone and with the network. Some poses
# are outside the joint angles of the 50 training poses of the network; there the C returns CLAMPED, and such a pose
# should keep its command. We compare the others.


def real_tool(joints):
    """Where the real robot's reflector is near the poses that were measured, shape (n, 3) [m]."""
    return measured + model(joints) - model(q[fine])


def model(joints):
    return predicted(calibrated.robot, from_table(_as_table(joints), 6, "position"))[0]


def nominal_tool(q):
    """Where the nominal robot has it, with base and tool as identified, for these are no errors of the robot."""
    placing = {p.name: p.value for p in calibrated.robot.parameters if p.group in ("base", "tool")}
    robot = problem.robot.with_values(placing)
    rigid = robot.with_values(dict.fromkeys(robot.parameters.select(["compliance"]), 0.0))
    return predicted(rigid, from_table(_as_table(q), 6, "position"))[0]


def _as_table(q):
    table = pd.DataFrame(np.rad2deg(q), columns=[f"q{i}_deg" for i in range(1, 7)])
    return table.assign(x_mm=0.0, y_mm=0.0, z_mm=0.0)


q = np.vstack([report.q, choose.q])
network = [correction(row) for row in q]
fine = np.array([status == Status.OK for _, status in network])
plain, plain_status = model_corrector(command_of(Sources(sources.robot, sources.nominal))).correct(q)
fine &= plain_status == Status.OK
print(Counter(status.name for _, status in network))
assert fine.sum() >= 75

goal = nominal_tool(q)[fine]
measured = np.vstack([report.position, choose.position])[fine]
sent = {
    "as commanded": q[fine],
    "corrected, calibration": (q + plain)[fine],
    "corrected, and network": (q + np.array([dq for dq, _ in network]))[fine],
}
error = {name: 1e3 * np.linalg.norm(real_tool(joints) - goal, axis=1) for name, joints in sent.items()}
for name, e in error.items():
    print(f"{name:24s} the real tool misses by {e.mean():.3f} mm (mean), {e.max():.3f} mm (max)")
first, second, third = (e.mean() for e in error.values())
assert second < 0.2 * first
assert third < 0.9 * second

figure, ax = plt.subplots(figsize=(8, 3.5), layout="constrained")
for name, e in error.items():
    ax.semilogy(np.sort(e), label=name)
ax.set(xlabel="poses, the best first", ylabel="the real tool misses by [mm]")
ax.legend()
plt.show()

# %%
# Corrections for the cyclic task
# -------------------------------
# A controller calls `hh800_step` every 4 ms instead. It ramps the correction in and limits its rate; `enable` = 0
# ramps it out. `load` compiles the same folder and calls it in cycles.

time, pose = 0.004 * np.arange(500), np.tile(report.q[0], (500, 1))
outputs, status = load(folder / "c").steps(pose, np.ones(len(time)))
dq, _ = correction(report.q[0])
assert status[-1] == Status.OK
assert np.allclose(outputs[-1], dq, rtol=0, atol=1e-12)  # ramped in, a step gives what the function gives
assert np.abs(np.diff(outputs, axis=0)).max() <= 0.5 * 0.004 * 1.001  # and never moves faster than 0.5 rad/s

figure, ax = plt.subplots(figsize=(8, 3.2), layout="constrained")
ax.plot(time, 1e3 * outputs, label=[f"joint {i}" for i in range(1, 7)])
ax.set(xlabel="time [s]", ylabel="correction [mrad]")
ax.legend(ncols=3, fontsize="small")
plt.show()

# %%
# Before you switch it on
# -----------------------
# The controller's own absolute-accuracy option must be off, otherwise errors are corrected twice. Run the self-test on
# the target, then a few poses at low speed. :doc:`/export` has more.
