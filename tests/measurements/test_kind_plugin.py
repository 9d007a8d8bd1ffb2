"""A kind of measurement from another package, found by its entry point alone: no line of casadical knows it."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from plugin_site import installed, run, run_here

from casadical import Joint, Placement, Robot, write_robot
from casadical.core.transforms import frame
from casadical.measurements.kinds.registry import kinds

GROUP = "casadical.measurement_kinds"
MODULE = '''
import numpy as np
from casadical.measurements import MeasurementKind

class Height(MeasurementKind):
    """Height of the measured point above a levelled plate at z = 0, by a dial gauge."""

    name = "height"
    columns = "`height_mm` (or `_m`) above the plate"
    pattern = "height_mm?"
    arrays = ("height",)
    lengths = 1

    def matches(self, names):
        return bool(names & {"height_mm", "height_m"})

    def read(self, columns, q):
        return {"height": columns.si("height", ("_mm", "_m"))}

    def residual(self, pose):
        return pose.p[2] - pose.take("height", 1)

    def errors(self, arrays, p, positions_at):
        return np.abs(p[:, 2] - arrays["height"])

    def unit_fault(self, arrays, p, positions_at, reach):
        return "heights beyond its reach; are they millimetres?" if np.abs(arrays["height"]).max() > 20 * reach else ""
'''
NOISE = 2e-5
ROWS = ((0, 0, 0.4), (np.pi / 2, 0.1, 0), (0, 0.5, 0))
ARM = Robot(
    "arm",
    tuple(Joint(alpha=alpha, a=a, d=d, lower=-2, upper=2) for alpha, a, d in ROWS),
    tool=Placement(frame(np.eye(3), np.array([0.4, 0.1, 0.05])), "position"),
)
TRUTH = ARM.with_values({"a2": 0.5008, "theta2": 0.002, "tool_x": 0.4012, "tool_y": 0.0991})


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as an installer leaves it: a module and its metadata."""
    return installed(tmp_path_factory.mktemp("site"), GROUP, "height = dial_gauge:Height", MODULE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A problem whose table holds readings and heights, made here from an arm as built."""
    made = tmp_path_factory.mktemp("problem") / "gauge"
    made.mkdir()
    rng = np.random.default_rng(5)
    q = rng.uniform(-2, 2, (80, 3))
    z = TRUTH.position.map(80)(q.T, TRUTH.parameters.values).full()[2] + NOISE * rng.normal(size=80)
    table = pd.DataFrame(np.rad2deg(q), columns=[f"q{i}_deg" for i in range(1, 4)]).assign(height_mm=1e3 * z)
    table.to_csv(made / "poses.csv", index=False)
    write_robot(ARM, made / "robot.toml")
    (made / "problem.toml").write_text(
        'casadical = 1\ntitle = "gauge"\nmethods = ["KM"]\n[[measurements]]\nfile = "poses.csv"\n'
    )
    return made


def test_a_plug_in_is_read_fitted_and_reported(site: Path, folder: Path, tmp_path: Path) -> None:
    done = run(site, "calibrate", folder, "--out", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    found = pd.read_csv(tmp_path / "KM.parameters.csv").set_index("name")
    assert {"a2", "theta2", "tool_x", "tool_y"} <= set(found[found.status == "identified"].index)
    for p in TRUTH.parameters:
        row = found.loc[p.name]
        if row.status == "identified":
            assert abs(row.value - p.readable(p.value)) < 4.5 * row.std_error, p.name
    # What no height tells: where the arm stands on the plate, and which way it faces.
    assert {"theta1"} <= set(found[found.status == "not identifiable"].index)
    report = json.loads((tmp_path / "result.json").read_text())["methods"]["KM"]["sets"]["report"]
    assert report["mean_mm"] == pytest.approx(1e3 * NOISE * np.sqrt(2 / np.pi), rel=0.4)  # of a half-normal one
    assert report["before_nominal"]["mean_mm"] > 20 * report["mean_mm"]


def test_a_plug_in_is_checked_before(site: Path, folder: Path) -> None:
    done = run(site, "check", folder, "--strict", "--details")
    assert "56 numbers" in done.stdout
    assert done.returncode == 0, done.stdout


def test_without_the_plug_in_its_column_observes_nothing(folder: Path, tmp_path: Path, monkeypatch) -> None:
    done = run_here(monkeypatch, kinds, tmp_path, "calibrate", folder)
    assert done.returncode == 2
    assert "no observation found" in done.stderr


FAULTY = {
    "not there": (MODULE, "height = dial_gauge:Hight", "cannot be loaded"),
    "of another family": ("Height = 3", "height = dial_gauge:Height", "must be a subclass of"),
    "of another name": (MODULE, "hight = dial_gauge:Height", "both need the same name"),
    "a name that is taken": (MODULE.replace('"height"', '"pose"'), "pose = dial_gauge:Height", "already"),
    "too many numbers": (MODULE.replace("lengths = 1", "lengths = 7"), "height = dial_gauge:Height", "allowed: 1 to 6"),
    "another number": (MODULE.replace("lengths = 1", "lengths = 2"), "height = dial_gauge:Height", "has 1 numbers"),
}


@pytest.mark.parametrize("name", FAULTY)
def test_a_faulty_plug_in_is_named(name: str, folder: Path, tmp_path: Path, monkeypatch) -> None:
    module, point, words = FAULTY[name]
    done = run_here(monkeypatch, kinds, installed(tmp_path, GROUP, point, module), "calibrate", folder)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert point.partition(" ")[0] in done.stderr
