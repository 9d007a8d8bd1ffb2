"""
11. A certificate
=================

An auditor asks for a figure with its uncertainty, a budget, and a rule by which a tolerance was decided. Here the
certificate data of a planar arm are made (its readings are made up, and the page says so), and the budget is checked
by hand.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials
COMMAND = [sys.executable, "-c", "from casadical.cli import main; main()"]
folder = Path(tempfile.mkdtemp())
problem = ROOT / "problems" / "planar"


def casadical(*words):
    """A command as in a shell, in the folder; its exit code."""
    done = subprocess.run([*COMMAND, *map(str, words)], cwd=folder, capture_output=True, text=True, check=False)
    print(done.stdout or done.stderr)
    return done.returncode


assert casadical("calibrate", problem, "--out", "results") == 0

# %%
# What only the operator knows
# ----------------------------
# The instrument, its noise and scale, the temperature, the tolerance. What is missing is said on the page.

details = folder / "certificate.toml"
details.write_text("""casadical = 1
issuer = "Example <b>GmbH</b>"
[instrument]
name = "laser tracker"
noise_mm = 0.01
scale_um_per_m = 3
[conditions]
temperature_degC = 21
range_K = 2
[decision]
tolerance_mm = 0.05
""")
words = ("results", "--problem", problem, "--details", "certificate.toml", "--out", "cert.pdf", "--json", "cert.json")
assert casadical("certificate", *words) == 0
found = json.loads((folder / "cert.json").read_text())

# %%
# The budget adds up
# ------------------
# E is the rms error over the space that the held-out poses stand for; the noise is taken out, what hides is put in.

after = found["after"]
for line in after["budget"]:
    print(f"{line['source']:14} {line['adds_mm2']:+.2e} mm^2, u {line['u_mm2']:.1e} mm^2, type {line['type']}")
added = sum(line["adds_mm2"] for line in after["budget"])
assert np.isclose(after["error_mm"] ** 2, after["rms_mm"] ** 2 + added)
u_square = np.sqrt(sum(line["u_mm2"] ** 2 for line in after["budget"]))
assert np.isclose(after["U_mm"], after["k"] * u_square / (2 * after["error_mm"]), rtol=0.05)
print(f"E = {after['error_mm']:.4f} mm, U = {after['U_mm']:.4f} mm, k = {after['k']:.2f}")

# %%
# The decision is guarded
# -----------------------
# E + U is within 0.05 mm, so the robot conforms; the chance that this is wrong is 2.5 % at most.

assert found["decision"] == "conforms"
assert after["error_mm"] + after["U_mm"] < 0.05

# %%
# Two pages
# ---------
# Markup in a field of the details is text.

assert (folder / "cert.pdf").read_bytes().startswith(b"%PDF")
