"""Robots with error curves of their joints: in the correction of a command, and the curves alone."""

import json

import numpy as np
import pytest
from command_line import main as run
from controller_arms import nominal_path, planted, poses, positions, rigid_motion

from casadical.core.basics import InputError
from casadical.effects import GearEccentricity, JointErrorCurve
from casadical.export import load
from casadical.export.c.kernel import compilers
from casadical.export.c.products import mapped
from casadical.export.controller.commands import Sources, command_of, curves_of
from casadical.export.controller.correction import model_corrector
from casadical.robot.robot_file import read_robot, write_robot

STILL = 4  # a joint that did not move: its coefficients are zero
EFFECT = JointErrorCurve()


@pytest.fixture(scope="module")
def robot():
    """The ur10 with compliance, an eccentric gear and curves of some 0.3 mrad in all joints but one."""
    rng = np.random.default_rng(6)
    values = {
        f"{EFFECT.label}.{name}": size * rng.normal() * (not name.endswith(f"_q{STILL}"))
        for name, (size, _) in EFFECT.sizes().items()
    }
    found = planted("ur10").with_effect(GearEccentricity(3)).with_effect(EFFECT)
    return found.with_values(values | {"gear_eccentricity@3.sin1": 3e-4})


@pytest.fixture(scope="module")
def nominal():
    return read_robot(nominal_path("ur10"))


def summed(robot, q):
    """The curves in NumPy from the robot's parameters, shape (k, 6) [rad]."""
    orders = np.arange(1, EFFECT.orders + 1)
    found = np.zeros_like(q)
    for j in range(6):
        for wave, shape in (("s", np.sin), ("c", np.cos)):
            names = [f"{EFFECT.label}.{wave}{k}_q{j + 1}" for k in orders]
            values = np.array([robot.parameters[name].value for name in names])
            found[:, j] += shape(q[:, j, None] * orders) @ values
    return found


def test_the_curves_alone_are_those_of_the_robot(robot):
    q = poses(robot, 500)
    exact = summed(robot, q)
    assert abs(exact).max() > 300e-6
    assert (exact[:, STILL - 1] == 0).all()
    assert abs(mapped(curves_of(Sources(robot)).function, q) - exact).max() < 1e-12


def test_correction_takes_the_curves_away(robot, nominal):
    sources = Sources(robot, nominal)
    command = command_of(sources, 3)
    q = poses(robot, 300)
    dq, status = model_corrector(command).correct(q)
    fine = status == 0
    assert fine.mean() > 0.9
    rest = mapped(command.calibrated, q + dq)[:, :3] - mapped(command.nominal, q)[:, :3]
    assert np.median(np.linalg.norm(rest[fine], axis=1)) < 0.1e-6
    wanted = mapped(command.nominal, q)[:, :3]
    assert np.median(rigid_motion(wanted[fine], positions(robot, q + dq)[fine])[2]) < 0.1e-6


def test_a_robot_file_becomes_curves_in_c(robot, tmp_path, monkeypatch, capfd):
    if not compilers():
        pytest.skip("no C compiler (gcc, clang, cc) on this machine")
    file, out = tmp_path / "robot.toml", tmp_path / "c"
    write_robot(robot, file)
    assert run(monkeypatch, "export", "c", file, "--what", "curves", "--real", "float", "--out", out, "--details") == 0
    said = " ".join(capfd.readouterr().out.split())
    assert "verified: compiled, and the same bits" in said
    assert "command q - dq(q)" in said
    manifest = json.loads((out / "manifest.json").read_text())
    assert (manifest["product"], manifest["kernel"]["outputs"]) == ("curves", {"curves": 6})
    figures = manifest["figures"]
    assert figures["curves_error_urad"] <= figures["table_error_urad_at_most"] + 1e-3 <= 0.051
    assert figures["rest_twice_urad"] < 0.1 * figures["rest_once_urad"] < 5
    kernel = load(out)
    q = poses(robot, 100).astype(np.float32)
    dq, status = kernel.curves(q)
    assert (status == 0).all()
    assert abs(dq - summed(robot, q.astype(float))).max() < 0.05e-6
    program = tmp_path / "program.csv"
    program.write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n5,-80,80,-60,-80,10\n")
    assert run(monkeypatch, "correct", out, program, "--out", tmp_path / "new.csv") == 2
    assert "--what command" in capfd.readouterr().err


def test_bad_input_is_refused_with_the_reason(robot, nominal, tmp_path, monkeypatch, capfd):
    with pytest.raises(InputError, match="it has no joint_error_curve; there is nothing to export"):
        curves_of(Sources(nominal))
    with pytest.raises(InputError, match=r"joint_error_curve\.s3_q2 is nan; it must be"):
        curves_of(Sources(robot.with_values({"joint_error_curve.s3_q2": np.nan})))
    write_robot(robot, tmp_path / "robot.toml")
    given = ["export", "c", tmp_path / "robot.toml", "--what", "curves", "--out", tmp_path / "c"]
    assert run(monkeypatch, *given, "--nominal", nominal_path("ur10")) == 2
    assert "--nominal: is for --what command, not for --what curves" in capfd.readouterr().err
    text = (tmp_path / "robot.toml").read_text()
    line = next(line for line in text.splitlines() if line.startswith("s3_q2"))
    (tmp_path / "robot.toml").write_text(text.replace(line, "s3_q2 = nan"))
    assert run(monkeypatch, *given) == 2
    assert "s3_q2" in capfd.readouterr().err
    assert not (tmp_path / "c").exists()
