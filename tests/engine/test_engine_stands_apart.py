"""The engine shares no code with the model, the effects or the diagnosis."""

import json
import subprocess
import sys


def test_importing_the_engine_loads_the_simulation_and_nothing_else_of_casadical():
    program = "import json, sys, casadical.engine; print(json.dumps([*sys.modules]))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = set(json.loads(done.stdout))
    ours = {m.split(".")[1] for m in loaded if m.startswith("casadical.")}
    assert ours == {"engine", "simulation", "errors"}
    assert not {"casadi", "mujoco"} & loaded
