"""A diagnosis holds results: it loads no analysis, and nothing is computed when it is read."""

import json
import subprocess
import sys

import pytest
from cases import diagnose, practice, robot

from casadical.diagnosis.result import Diagnosis

ANALYSES = {
    "bootstrap", "changes", "components", "conclusion", "details", "held_out_gap", "isolability", "localisation",
    "next_poses", "pose_separation", "refit", "search", "smooth_description", "statements",
}  # fmt: skip


@pytest.mark.slow
def test_the_result_loads_no_analysis() -> None:
    program = "import json, sys, casadical.diagnosis.result; print(json.dumps(sorted(sys.modules)))"
    out = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    room = {name.rpartition(".")[2] for name in json.loads(out) if name.startswith("casadical.diagnosis.")}
    assert "linear_problem" in room
    assert room & ANALYSES == set()


def test_reading_it_computes_nothing() -> None:
    found = diagnose(robot("ur10e"), practice("ur10e-P06"), ["friction_windup@3", "backlash@3"])
    before = {**vars(found)}, set(vars(found.case))
    properties = [name for name in vars(Diagnosis) if isinstance(vars(Diagnosis)[name], property)]
    assert {"in_question", "columns"} <= set(properties)
    for name in properties:
        getattr(found, name)
    found.effects()
    assert vars(found) == before[0]
    assert set(vars(found.case)) == before[1]
