"""casadical export model, verify --mujoco: what they write, print and refuse."""

import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from command_line import main, run

from casadical.project.calibration import calibrate

ROOT = Path(__file__).parents[2]
PLANAR = ROOT / "problems" / "planar"
KR210 = ROOT / "problems" / "kr210"
HH800 = ROOT / "problems" / "hh800"


def test_a_problem_is_calibrated_and_written(tmp_path: Path) -> None:
    file, kept = tmp_path / "arm.xml", tmp_path / "arm.json"
    done = run("export", "model", "problems/planar", "--out", file, "--json", kept)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Planar arm of two links, 2 joints" in done.stdout
    root = ET.parse(file).getroot()
    link2 = next(node for node in root.iter("body") if node.get("name") == "link2")
    assert float(link2.get("pos", "").split()[0]) == pytest.approx(0.4006, abs=2e-5)  # as built, not as drawn
    assert json.loads(kept.read_text())["left_out"] == []


def test_a_robot_file_is_written_as_it_is_and_nothing_is_overwritten(tmp_path, monkeypatch, capfd):
    file = tmp_path / "arm.urdf"
    assert main(monkeypatch, "export", "model", PLANAR / "robot.toml", "--out", file) == 0
    assert "2 joints\n" in capfd.readouterr().out
    text = file.read_text()
    assert 'xyz="0.4 0.0 0.0"' in text
    assert main(monkeypatch, "export", "model", PLANAR / "robot.toml", "--out", file) == 2
    assert "is there already" in capfd.readouterr().err
    assert file.read_text() == text
    assert main(monkeypatch, "export", "model", PLANAR / "robot.toml", "--out", file, "--overwrite", "-q") == 0
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_a_urdf_says_in_millimetres_what_it_cannot_hold(tmp_path, monkeypatch, capfd):
    """The figure of the URDF alone is that of pinocchio, which reads the file, at the measured poses."""
    pinocchio = pytest.importorskip("pinocchio")
    file, kept = tmp_path / "arm.urdf", tmp_path / "arm.json"
    assert main(monkeypatch, "export", "model", KR210, "--out", file, "--json", kept) == 0
    printed = " ".join(capfd.readouterr().out.split())
    figures = json.loads(kept.read_text())["mean_errors"]
    calibration = calibrate(KR210, method="SKCM")
    (m,) = calibration.problem.sets["report"]
    model = pinocchio.buildModelFromUrdf(str(file))
    data = model.createData()
    p = []
    for q in m.q:
        pinocchio.framesForwardKinematics(model, data, q)
        p.append(calibration.robot.base.T @ data.oMf[model.getFrameId("measured")].homogeneous[:, 3])
    error = 1e3 * np.linalg.norm(np.array(p)[:, :3] - m.position, axis=1).mean()
    assert figures["geometry_mm"] == pytest.approx(error, rel=1e-6)
    assert figures["model_mm"] < 0.05 < 1 < figures["nominal_mm"]
    assert f"this URDF alone {error:.3f} mm; the whole model {figures['model_mm']:.3f} mm" in printed
    assert "LEFT OUT compliance of joints 1, 2, 3, 4, 5, 6" in printed


def test_a_users_own_model_is_taken_and_given_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra mujoco)")
    nominal, mine, out = ROOT / "problems" / "ur10e" / "robot.toml", tmp_path / "mine.xml", tmp_path / "new.xml"
    assert main(monkeypatch, "export", "model", nominal, "--out", mine, "-q") == 0  # stands for a user's model
    joints = ",".join(f"joint{i}" for i in range(1, 7))
    changed = tmp_path / "calibrated.toml"
    changed.write_text(nominal.read_text().replace("a_mm = -612.7", "a_mm = -613.2"))
    given = ["--into", mine, "--joints", joints, "--nominal", nominal]
    assert main(monkeypatch, "export", "model", changed, "--out", out, "-q", *given) == 0
    before, after = (mujoco.MjModel.from_xml_path(str(path)) for path in (mine, out))
    assert before.nq == after.nq
    moved = [abs(after.body(f"link{i}").pos - before.body(f"link{i}").pos).max() for i in range(1, 7)]
    assert moved == pytest.approx([0, 0, 5e-4, 0, 0, 0], abs=1e-9)


def test_without_mujoco_replay_says_what_to_install(monkeypatch, capfd):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert main(monkeypatch, "verify", PLANAR, "x.csv", "--mujoco") == 2
    assert "pip install 'casadical[mujoco]'" in capfd.readouterr().err
