"""
10. Beside the instrument
=========================

A UR10's real series of a laser tracker, played through ``casadical measure`` row by row, as if it were being measured
now: a slip is said when it is made, the process is killed and nothing is lost, and at the end the folder is calibrated
as if the table had come whole. In the workshop you would open the page; here a program reads it.
"""

import atexit
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import urllib.request
from pathlib import Path

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials
COMMAND = [sys.executable, "-c", "from casadical.cli import main; main()"]
arm = Path(tempfile.mkdtemp()) / "arm"
arm.mkdir()

# %%
# A folder that is fed
# --------------------
# ``casadical new arm --dh dh.csv`` makes one. Ours takes the robot file of a problem; the table need not be there yet.

shutil.copy(ROOT / "problems" / "ur10" / "robot.toml", arm)
(arm / "problem.toml").write_text(
    'casadical = 1\ntitle = "UR10"\n\n[[measurements]]\nfile = "measured.csv"\nkind = "position"\n'
)
series = (ROOT / "data" / "ur10_laser_tracker" / "series_C_random_poses.csv").read_text().splitlines()
tracker = arm / "tracker.csv"
tracker.write_text("\n".join(series[:25]) + "\n")

# %%
# ``casadical measure arm --follow tracker.csv`` prints the address of its page. The page gets all that it shows as one
# event after each reading; a browser draws it, we read it.


def started():
    """The command, and the address that it prints."""
    process = subprocess.Popen(
        [*COMMAND, "measure", str(arm), "--follow", str(tracker), "--program", "urscript"],
        stdout=subprocess.PIPE,
        text=True,
    )
    atexit.register(process.kill)  # also where a step below fails
    for line in process.stdout:
        if line.startswith("open http"):
            return process, line.split()[1]
    raise AssertionError("no address")


def shown(address, ready):
    """What the page shows as soon as `ready` says so."""
    with urllib.request.urlopen(address.replace("/?", "/events?"), timeout=120) as events:
        for line in events:
            if line.startswith(b"data: ") and ready(state := json.loads(line[6:])):
                return state
    raise AssertionError("the page has ended")


def do(address, **command):
    """What a button of the page does."""
    kind = {"Content-Type": "application/json"}
    asked = urllib.request.Request(address.replace("/?", "/do?"), json.dumps(command).encode(), kind)
    with urllib.request.urlopen(asked, timeout=300) as answer:
        return json.load(answer)["said"]


process, address = started()
state = shown(address, lambda s: len(s["readings"]) == 24 and s["known"] and s["next"])
print(len(state["readings"]), "readings;", f"{state['known']['left_out_mean_mm']:.2f} mm, left out one by one")
print("next:", state["next"]["program"])
assert all(r["state"] == "good" for r in state["readings"])
assert 0.3 < state["known"]["left_out_mean_mm"] < 0.9
assert state["next"]["program"].startswith("movej([")

# %%
# A slip
# ------
# The operator exports the next reading with x and y swapped. It is said before the next pose is driven, and left out
# of what is known until it becomes plausible. We strike it out, with the reason, and measure the pose again.

header = series[0].split(",")
x, y = header.index("x_mm"), header.index("y_mm")
right = series[25].split(",")
wrong = right.copy()
wrong[x], wrong[y] = right[y], right[x]
with tracker.open("a") as file:
    file.write(",".join(wrong) + "\n")
last = shown(address, lambda s: len(s["readings"]) == 25)["readings"][-1]
print(last["state"], "-", last["why"])
assert last["state"] == "doubtful"
assert "axes are swapped: x holds y, y holds x" in last["why"]
do(address, do="strike", number=25, why="x and y were exchanged in the export")
assert "leave_out = [26] # 26: x and y were exchanged" in (arm / "problem.toml").read_text()

# %%
# A kill
# ------
# The machine loses its power while the series goes on. The journal has every reading that was answered; started again,
# the command reads from the file what came meanwhile.

process.send_signal(signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
process.wait()
process.stdout.close()
with tracker.open("a") as file:
    file.write("\n".join(series[25:60]) + "\n")
process, address = started()
state = shown(address, lambda s: len(s["readings"]) == 60 and s["next"])
print(sum(r["state"] == "good" for r in state["readings"]), "good,", state["next"]["words"])
assert [r["number"] for r in state["readings"] if r["state"] == "struck"] == [25]

# %%
# The end
# -------
# The last button calibrates the folder; the command ``calibrate`` writes the same files, byte by byte.

told = do(address, do="finish")
print(told)
process.send_signal(signal.SIGINT)
assert process.wait(60) == 0
process.stdout.close()
subprocess.run([*COMMAND, "calibrate", str(arm), "--out", str(arm / "again"), "--quiet"], check=True)
ours = {path.name: path.read_bytes() for path in (arm / "results").iterdir()}
assert ours == {path.name: path.read_bytes() for path in (arm / "again").iterdir()}
assert "SKCM.robot.toml" in ours
