"""`casadical export c` and `casadical correct` as a user meets them: files, words, exit codes."""

import csv
import hashlib
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import FEW
from command_line import main as run
from controller_arms import nominal_path, planted, poses, positions, rigid_motion

from casadical import InputError, Joint, Robot
from casadical.compensator import Compensator, save_compensator
from casadical.export import Sources, command_of, load, model_corrector, write_c
from casadical.export.c.kernel import compilers
from casadical.export.controller.commands import _source_name, prefix_of
from casadical.export.controller.correction import kernel_corrector
from casadical.export.controller.programs.program import _moved, read_target_program
from casadical.export.controller.programs.target import Given
from casadical.robot.robot_file import read_robot

needs_compiler = pytest.mark.skipif(not compilers(), reason="no C compiler (gcc, clang, cc) on this machine")


@pytest.fixture(scope="module")
def exported(files, tmp_path_factory):
    """The hh800's export and what the command printed."""
    if not compilers():
        pytest.skip("no C compiler (gcc, clang, cc) on this machine")
    out = tmp_path_factory.mktemp("out") / "c"
    with pytest.MonkeyPatch.context() as patch:
        given = ("export", "c", files / "hh800.toml", "--nominal", nominal_path("hh800"), "--out", out)
        code = run(patch, *given)
    assert code == 0
    return out


def program(path, q, unit="deg"):
    """A program with columns of other things around the targets."""
    values = np.rad2deg(q) if unit == "deg" else q
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["name", *(f"q{i}_{unit}" for i in range(1, q.shape[1] + 1)), "speed", "remark"])
        for k, row in enumerate(values):
            writer.writerow([f"P{k:03d}", *map(repr, map(float, row)), "0250", "weld, then wait"])
    return path


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def targets(rows):
    return np.deg2rad([[float(row[f"q{i}_deg"]) for i in range(1, 7)] for row in rows])


@needs_compiler
def test_what_is_printed_and_what_the_manifest_holds(files, tmp_path, monkeypatch, capfd):
    out = tmp_path / "c"
    arguments = ("export", "c", files / "ur10.toml", "--nominal", nominal_path("ur10"), "--out", out, "--name", "arm")
    assert run(monkeypatch, *arguments, "--real", "float", "--steps", 1, "--details") == 0
    printed = " ".join(capfd.readouterr().out.split())
    for part in (
        "verified: compiled",
        "rest_um_worst",
        "nominal: ",
        "tool: shared",
        "own base frame",
        "absolute-accuracy",
    ):
        assert part in printed
    assert "cycle 4 ms, rate 0.5 rad/s, ramp 1 s: switched on in 250 calls of the step function" in printed
    assert "Operations of correct, the same in every call: " in printed
    assert "the compensator was refused" not in printed
    for option, words in (
        (("--cycle", 2000), "a cycle of 2000 ms; allowed: 0.01 to 1000 ms"),
        (("--what", "curves", "--cycle", 2), "--cycle: is for --what command, not for --what curves"),
    ):
        assert run(monkeypatch, *(arguments if "curves" not in option else arguments[:3] + arguments[5:]), *option) == 2
        assert words in " ".join(capfd.readouterr().err.split())
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["model_sha256"] == hashlib.sha256((files / "ur10.toml").read_bytes()).hexdigest()
    assert manifest["verified"] is True
    assert {c["vectors"] for c in manifest["comparisons"] if c["function"] != "self_test"} == {FEW}
    (out / "arm.c").write_text("mine")
    assert run(monkeypatch, *arguments) == 2
    assert "--overwrite" in capfd.readouterr().err
    assert (out / "arm.c").read_text() == "mine"


def test_without_a_compiler_the_export_is_written_and_called_unverified(files, tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("PATH", str(tmp_path))
    arguments = ("export", "c", files / "ur10.toml", "--nominal", nominal_path("ur10"), "--out", tmp_path / "c")
    assert run(monkeypatch, *arguments) == 0
    printed = capfd.readouterr().out
    assert "UNVERIFIED: no C compiler found" in printed
    job = program(tmp_path / "job.csv", poses(planted("ur10"), 3))
    assert run(monkeypatch, "correct", tmp_path / "c", job, "--out", tmp_path / "new.csv") == 2
    message = capfd.readouterr().err
    assert "no C compiler" in message
    assert "give the robot file" in message


def test_a_network_alone_is_exported_and_corrects_no_program(files, tmp_path, monkeypatch, capfd):
    q = poses(planted("hh800"), 50)
    made = Compensator.fit(q, 0.3 * np.sin(q[:, :3]), folds=2)
    save_compensator(made, tmp_path / "net.json")
    arguments = ("export", "c", files / "hh800.toml", "--what", "network", "--compensator", tmp_path / "net.json")
    assert run(monkeypatch, *arguments, "--real", "float", "--out", tmp_path / "c") == 0
    manifest = json.loads((tmp_path / "c" / "manifest.json").read_text())
    assert manifest["data_sha256"] == hashlib.sha256((tmp_path / "net.json").read_bytes()).hexdigest()
    assert (manifest["product"], manifest["kernel"]["outputs"]) == ("network", {"network": 3})
    if not compilers():
        pytest.skip("written; not called, for want of a C compiler (gcc, clang, cc)")
    values, status = load(tmp_path / "c").network(q)
    assert (status == 0).all()
    assert values == pytest.approx(made.correction_mm(q), abs=1e-4)
    capfd.readouterr()
    job = program(tmp_path / "job.csv", q[:3])
    assert run(monkeypatch, "correct", tmp_path / "c", job, "--out", tmp_path / "new.csv") == 2
    assert "--what command" in capfd.readouterr().err


def test_a_corrected_program_keeps_all_but_its_targets(files, exported, tmp_path, monkeypatch, capfd):
    robot = read_robot(files / "hh800.toml")
    q = poses(robot, 120, seed=3)
    q[7, 0] = np.deg2rad(121)  # outside of the range
    q[9, 5] = robot.joints[5].upper
    q[20] = q[21]  # a repeated target is no mistake
    job, new = program(tmp_path / "job.csv", q), tmp_path / "new.csv"
    assert run(monkeypatch, "correct", exported, job, "--out", new, "--details") == 0
    printed = capfd.readouterr().out
    before, after = table(job), table(new)
    assert list(after[0]) == [*before[0], "correction_status"]
    for old, row in zip(before, after, strict=True):
        assert (row["name"], row["speed"], row["remark"]) == (old["name"], "0250", "weld, then wait")
        if row["correction_status"] != "OK":
            assert {k: row[k] for k in old} == old
    refused = [k for k, row in enumerate(after) if row["correction_status"] != "OK"]
    assert after[7]["correction_status"] == "CLAMPED"
    assert f"{120 - len(refused)} of 120 targets corrected, {len(refused)} LEFT" in printed
    assert "row 9: CLAMPED" in printed  # line of the file
    fine = [k for k in range(120) if k not in refused]
    nominal = read_robot(nominal_path("hh800")).with_values(
        {f"tool_{c}": v for c, v in zip("xyz", robot.tool.T[:3, 3], strict=True)}
    )
    new_q = targets(after)
    rest = rigid_motion(positions(nominal, q)[fine], positions(robot, new_q)[fine])[2]
    stated = json.loads((exported / "manifest.json").read_text())["figures"]["rest_um_worst"]
    assert np.median(rest) < 2e-7
    assert rest.max() < max(stated, 50) * 1e-6
    change = np.rad2deg(abs(new_q - q))[fine]
    words = {line.split("[")[0].strip(): line.split()[-2:] for line in printed.splitlines() if "[" in line}
    for i in range(6):
        assert float(words[f"joint {i + 1}"][0]) == pytest.approx(change[:, i].mean(), abs=1e-4)
        assert float(words[f"joint {i + 1}"][1]) == pytest.approx(change[:, i].max(), abs=1e-4)
    tool = 1e3 * np.linalg.norm(positions(robot, new_q) - positions(robot, q), axis=1)[fine]
    assert float(words["tool"][0]) == pytest.approx(tool.mean(), abs=1e-3)
    assert float(words["tool"][1]) == pytest.approx(tool.max(), abs=1e-3)


def test_the_robot_file_corrects_as_its_export_does(files, exported, tmp_path, monkeypatch, capfd):
    job = program(tmp_path / "job.csv", poses(planted("hh800"), 50), "rad")
    assert run(monkeypatch, "correct", exported, job, "--out", tmp_path / "a.csv") == 0
    model = ("correct", files / "hh800.toml", "--nominal", nominal_path("hh800"))
    given = (*model, job, "--out", tmp_path / "b.csv", "--details")
    assert run(monkeypatch, *given) == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert "the real tool off the nominal one, by the model" in " ".join(capfd.readouterr().out.split())
    assert run(monkeypatch, *given) == 2
    assert "is there already" in capfd.readouterr().err
    head, *rows = job.read_text().splitlines(keepends=True)
    for heading in ("Joint {} [rad]", "J{} (rad)", "Target axis {} in rad"):
        head = "name," + ",".join(map(heading.format, range(1, 7))) + ",speed,remark"
        job.write_text("".join([head + "\n", *rows]))
        assert run(monkeypatch, *model, job, "--out", tmp_path / "b.csv", "--overwrite") == 0
        ours, theirs = ((tmp_path / name).read_text().splitlines() for name in ("a.csv", "b.csv"))
        assert theirs == [head + ",correction_status", *ours[1:]]


def test_what_a_correction_leaves_is_printed_in_um_and_mdeg() -> None:
    left, _ = _moved([SimpleNamespace(q=None, moved_mm=1.0, off_mm=(2.0, 3e-3), off_deg=(0.5, 4e-3))], ())
    assert [float(row[1]) for row in left.rows] == [2.0, 3.0, 500.0, 4.0]


HEAD = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg"
BAD = {
    "no number": (f"{HEAD}\n1,90,180,0,0,0\n1,90,x,0,0,0\n", ["row 3", "'q3_deg'", "'x' is not a finite number"]),
    "missing joint": ("q1_deg,q2_deg\n1,2\n", ["q3_deg or q3_rad is missing"]),
    "joint twice": (f"{HEAD},q1_rad\n1,90,180,0,0,0,0\n", ["columns q1_deg and q1_rad say the same"]),
    "seventh joint": (f"{HEAD},q7_deg\n1,90,180,0,0,0,0\n", ["'q7_deg': this robot has only 6 joints"]),
    "wrong unit": ("q1_mm\n1\n", ["q1_deg or q1_rad is missing; there are q1_mm; name it so"]),
    "no angle or unit": ("J1 speed [deg],J1 [mrad],J1\ndeg,,deg\n1,90,2\n", ["q1_deg or q1_rad is missing"]),
    "two headings": ("J1 [deg],Actual J1 [deg]\n1,90\n", ["'J1 [deg]', 'Actual J1 [deg]' say the same"]),
    "corrected before": (f"{HEAD},correction_status\n1,90,180,0,0,0,OK\n", ["corrected before"]),
    "semicolons": (HEAD.replace(",", ";") + "\n1;90;180;0;0;0\n", ["separated by ';'"]),
}


def test_a_bad_program_is_refused_with_its_place(tmp_path):
    path = tmp_path / "job.csv"
    for text, parts in BAD.values():
        path.write_text(text)
        with pytest.raises(InputError) as error:
            read_target_program(path, Given(), 6)
        assert all(part in str(error.value) for part in ("job.csv", *parts))


def test_prefixes_are_c_names():
    assert prefix_of("Hyundai HH800") == "hyundai_hh800"
    assert prefix_of("Universal Robots UR10 (CB series)") == "universal_robots_ur10_cb"
    assert prefix_of("7 axes") == "robot_7_axes"
    assert prefix_of("机器人") == "robot"


@needs_compiler
@pytest.mark.slow
def test_the_c_of_full_poses_says_what_remains_of_both(files, tmp_path):
    command = command_of(Sources(files / "ur10.toml", nominal_path("ur10")), 3, orientation=True)
    written = write_c(command, tmp_path / "c", name="arm", vectors=500, languages=())
    assert written.verified
    assert written.figures["rest_um_worst"] < 20
    assert written.figures["rest_urad_worst"] < 67  # 0.02 mm of the weighted error at 0.3 m
    assert 0.05 < written.figures["share_singular"] < 0.5
    corrector = kernel_corrector(tmp_path / "c")
    q = poses(read_robot(files / "ur10.toml"), 5)
    assert np.array_equal(corrector.correct(q)[0], model_corrector(command).correct(q)[0])
    assert np.allclose(corrector.position(q), model_corrector(command).position(q), atol=1e-9)


def test_a_source_is_named_by_its_file_its_robot_or_its_kind() -> None:
    sources = (Path("a", "robot.toml"), Robot("arm", (Joint(),)), object.__new__(Compensator))
    assert [_source_name(one) for one in sources] == [str(Path("a", "robot.toml")), "arm", "the compensator"]
