"""The simulator by which the diagnosis is judged knows nothing of it, in a fresh process."""

import json
import subprocess
import sys


def test_simulator_loads_nothing_of_what_it_judges() -> None:
    program = "import json, sys, casadical.blind_check.numpy_physics; print(json.dumps([*sys.modules]))"
    out = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    loaded = set(json.loads(out))
    assert "casadical.blind_check.numpy_physics.disturbances_load" in loaded
    judged = ("casadical.effects", "casadical.diagnosis", "casadical.measurements", "casadical.robot", "casadi")
    assert {m for m in loaded if m in judged or m.startswith(tuple(f"{j}." for j in judged))} == set()
