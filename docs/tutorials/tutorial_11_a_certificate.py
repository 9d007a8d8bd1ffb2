"""
11. A certificate
=================

An auditor asks for a figure with its uncertainty, a budget, and a rule by which a tolerance was decided. Here the
certificate data of a planar arm are made (its readings are made up, and the page says so), and the budget is checked
by hand.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from casadical import calibrate
from casadical.project.certificate import certificate

ROOT = Path(sys.argv[0]).resolve().parents[2]  # this file lies in docs/tutorials
folder = Path(tempfile.mkdtemp())
problem = ROOT / "problems" / "planar"
calibrate(problem).write(folder / "results")

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
found = certificate(folder / "results", details, problem=problem)
print(found)
assert found.missing == ["traceability", "calibrated"]

# %%
# The budget adds up
# ------------------
# E is the rms error over the space that the held-out poses stand for; the noise is taken out, what hides is put in.

after = found.after
for line in after.lines:
    print(f"{line.source:14} {1e6 * line.square:+.2e} mm^2, u {1e6 * line.u:.1e} mm^2, type {line.kind}")
assert np.isclose(after.square, after.rms**2 + sum(line.square for line in after.lines))
assert np.isclose(after.u_square, np.sqrt(sum(line.u**2 for line in after.lines)))
assert np.isclose(after.expanded, after.factor * after.u())
print(f"E = {1e3 * after.error:.4f} mm, U = {1e3 * after.expanded:.4f} mm, k = {after.factor:.2f}")

# %%
# The decision is guarded
# -----------------------
# E + U is within 0.05 mm, so the robot conforms; the chance that this is wrong is 2.5 % at most.

assert found.decision == "conforms"
assert after.error + after.expanded < 5e-5

# %%
# Two pages
# ---------
# From a shell: ``casadical certificate results --details certificate.toml --out cert.pdf``. Markup in a field is text.

pdf = found.pdf()
(folder / "cert.pdf").write_bytes(pdf)
assert pdf.startswith(b"%PDF")
