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
    assert main(monkeypatch, "export", "model", PLANAR / "robot.toml", "--out", file, "-q") == 0
    assert capfd.readouterr() == ("", "")
    text = file.read_text()
    assert 'xyz="0.4 0.0 0.0"' in text
    assert main(monkeypatch, "export", "model", PLANAR / "robot.toml", "--out", file) == 2
    assert "is there already" in capfd.readouterr().err
    assert file.read_text() == text
    assert main(monkeypatch, "export", "model", PLANAR / "robot.toml", "--out", file, "--overwrite") == 0


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


def test_a_urdf_of_a_rigid_robot_leaves_nothing_out(tmp_path, monkeypatch, capfd):
    assert main(monkeypatch, "export", "model", PLANAR, "--out", tmp_path / "arm.urdf") == 0
    printed = " ".join(capfd.readouterr().out.split())
    assert "nothing is left out" in printed
    assert "this URDF alone 0.025 mm; the whole model 0.025 mm" in printed


WRONG = {
    "no such source": (["export", "model", "none", "--out", "x.xml"], "no such problem folder or robot file"),
    "a loop as a URDF": (
        ["export", "model", HH800 / "robot.toml", "--out", "x.urdf"],
        "casadical export model --to mjcf",
    ),
    "a campaign that is not there": (
        ["export", "model", HH800 / "robot.toml", "--out", "x.xml", "--campaign", "c.csv"],
        "c.csv: no such file",
    ),
    "into without joints": (["export", "model", PLANAR, "--out", "x.xml", "--into", "y.xml"], "belong together"),
    "into without the nominal": (
        ["export", "model", HH800 / "robot.toml", "--out", "x.xml", "--into", "y.xml", "--joints", "a,b"],
        "give --nominal, or the problem folder",
    ),
    "an unknown ending": (["export", "model", PLANAR, "--out", "x.txt"], "give --to mjcf|urdf|actuators|ur|"),
    "effects of no campaign": (
        ["export", "model", PLANAR, "--out", "x.xml", "--effects", "backlash"],
        "give --campaign CSV, too",
    ),
    "a hash of a URDF": (["export", "model", PLANAR, "--out", "x.urdf", "--hash", "a"], "give --to ur"),
    "a campaign of a URDF": (["export", "model", PLANAR, "--out", "x.urdf", "--campaign", "c.csv"], "give --to mjcf"),
    "a driver without its drawing": (["export", "model", PLANAR, "--out", "x.yaml"], "give --nominal"),
    "a replay without a simulator": (
        ["verify", PLANAR, "x.csv", "--seed", "1"],
        "--seed: is for --mujoco or --touches",
    ),
    "a check without poses": (["verify", PLANAR], "which poses?"),
    "no such campaign": (["verify", PLANAR, "none.csv", "--mujoco"], "none.csv: no such file"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_users_mistake_ends_in_a_message_and_2(name, tmp_path, monkeypatch, capfd):
    if name == "no such campaign":
        pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra mujoco)")
    arguments, words = WRONG[name]
    monkeypatch.chdir(tmp_path)
    assert main(monkeypatch, *arguments) == 2
    assert words in capfd.readouterr().err
    assert not list(tmp_path.iterdir())


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


@pytest.mark.slow
def test_a_campaign_is_replayed_and_its_models_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What `export model --campaign` prints is held by docs/cli.md."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra mujoco)")
    campaign = ROOT / "data" / "campaigns" / "practice" / "kr210-P05.csv"
    few = ["--mujoco", "--effects", "payload_error,joint_scale@3"]
    kr210 = ROOT / "problems" / "kr210"
    assert main(monkeypatch, "verify", kr210, campaign, "--out", tmp_path, "--json", tmp_path / "r.json", *few) == 0
    stages = json.loads((tmp_path / "r.json").read_text())["stages"]
    assert [s["model"] for s in stages] == ["nominal", "geometry and stiffness", "payload_error"]
    assert stages[0]["mean_mm"] > 10 * stages[1]["mean_mm"] > 13 * stages[2]["mean_mm"]
    last = ET.parse(tmp_path / "kr210-P05.2.xml").getroot()
    payload = next(node for node in last.iter("body") if node.get("name") == "payload")
    assert float(payload.find("inertial").get("mass")) > 122  # type: ignore[union-attr,arg-type]
