"""The bound of the error that remains: in C, in structured text, in `correct`, and where it is not known."""

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import main as run
from controller_arms import nominal_path, planted, poses, positions, rigid_motion

from casadical import InputError, write_robot
from casadical.compensator import Compensator
from casadical.export import Sources, Status, command_of, load, write_c
from casadical.export.c.c_language import comparison_inputs
from casadical.export.c.kernel import compilers
from casadical.export.c.language import Label
from casadical.export.c.reference import bound, correct
from casadical.export.c.structured_text import structured_text
from casadical.export.c.tape_program import operations, tape_program
from casadical.export.controller.commands import bound_of
from casadical.export.controller.programs.correction import Cell, corrected_targets
from casadical.export.controller.programs.program import read_target_program
from casadical.export.controller.programs.target import Given
from casadical.robot.robot import ErrorBound
from casadical.robot.robot_file import read_robot

sys.path.append(str(Path(__file__).parents[1] / "c"))
from structured_text_in_c import Compiled

LIMIT, LEFT = 0.7, 0.02  # mm; what the steps alone may leave
needs_compiler = pytest.mark.skipif(not compilers(), reason="no C compiler (gcc, clang, cc) on this machine")


@pytest.fixture(scope="module")
def robot():
    """The UR10 with planted errors and a bound: two parameters doubted together, one joint's error alone."""
    names = ("a2", "theta3", "joint_error_curve.s1_q2")
    factor = np.array([[2e-4, 0.0], [-1e-4, 2e-4], [0.0, 3e-4]])
    return replace(planted("ur10"), bound=ErrorBound(names, factor, 2e-4, 1.7, 100))


@pytest.fixture(scope="module")
def file(robot, tmp_path_factory):
    write_robot(robot, path := tmp_path_factory.mktemp("bound") / "ur10.toml")
    return path


def sources(source, tcp_mm=0.0, **changes):
    return Sources(source, nominal_path("ur10"), tcp_mm=tcp_mm, **changes)


def by_differences(robot, q):
    """The bound [mm] from differences of positions, one column of the factor at a time; but torques follow the turn."""
    moved = np.zeros(len(q))
    for column in robot.bound.factor.T:
        ends = []
        for sign in (1, -1):
            change = dict(zip(robot.bound.names, sign * column, strict=True))
            turn = change.pop("joint_error_curve.s1_q2")
            there = robot.with_values({n: robot.parameters[n].value + d for n, d in change.items()})
            turned = q + np.outer(turn * np.sin(q[:, 1]), np.eye(6)[1])
            ends.append(positions(there, turned))
        moved += np.sum((ends[0] - ends[1]) ** 2, axis=1) / 4
    return 1e3 * robot.bound.times * np.sqrt(robot.bound.rest**2 + moved)


def test_it_is_the_spread_of_positions_and_says_where_the_limit_is_passed(robot) -> None:
    program = tape_program(command_of(sources(robot), limit_mm=LIMIT), "double")
    q = poses(robot, 200)
    mm, status = bound(program, q)
    np.testing.assert_allclose(mm[:, 0], by_differences(robot, q), rtol=1e-3)
    assert (status == Status.OK).all()
    assert operations(program).count["sqrt"] == 1  # of the bound alone
    free = correct(tape_program(command_of(sources(robot)), "double"), q)
    held = correct(program, q)
    assert (held[0] == free[0]).all()
    above = (free[1] == Status.OK) & (mm[:, 0] > LIMIT - LEFT)
    assert (held[1] == np.where(above, Status.ABOVE_LIMIT, free[1])).all()
    assert 0.1 < above.mean() < 0.9


@needs_compiler
@pytest.mark.parametrize("real", ["float", "double"])
def test_c_and_structured_text_have_the_bits_of_the_reference(robot, tmp_path, real) -> None:
    command = command_of(sources(robot), limit_mm=LIMIT)
    written = write_c(command, tmp_path / "c", name="arm", real=real, vectors=2000, languages=["structured_text"])
    assert written.verified
    assert written.figures["share_ok"] < 0.9 < written.figures["share_converged"]
    assert written.operations.count["multiplications"] > 100
    program = tape_program(command, real)
    q = comparison_inputs(program, 500)
    kernel = load(tmp_path / "c")
    assert kernel.bound(q)[0].tobytes() == bound(program, q)[0].tobytes()
    assert set(kernel.correct(q)[1]) >= {Status.OK, Status.CLAMPED, Status.NOT_FINITE, Status.ABOVE_LIMIT}
    text = structured_text(program, Label("arm"))
    for block, out, outputs in (("bound", "bound_mm", 1), ("correct", "dq", 6)):
        found = Compiled(text, tmp_path, compilers()[0], "arm", block, out, outputs=outputs).rows(q)
        expected = getattr(kernel, block)(q)
        assert found[0].tobytes() == expected[0].tobytes()
        assert found[1].tolist() == expected[1].tolist()


def test_correct_refuses_what_is_above_the_limit_and_reports_the_bound(robot, file, tmp_path, monkeypatch, capfd):
    q = poses(robot, 12)
    with (tmp_path / "job.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([[f"q{i}_deg" for i in range(1, 7)], *np.rad2deg(q).tolist()])
    out, facts = tmp_path / "new.csv", tmp_path / "new.json"
    common = ("correct", file, tmp_path / "job.csv", "--nominal", nominal_path("ur10"), "--tcp-error", 0)
    assert run(monkeypatch, *common, "--out", out, "--limit", LIMIT, "--json", facts) == 0
    printed = capfd.readouterr().out
    assert "ABOVE_LIMIT, the bound of the error that remains is above the limit that was asked for" in printed
    assert "95 % of the errors that remain are below" in printed
    with out.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    expected = by_differences(robot, q)
    for row, mm in zip(rows, expected, strict=True):
        if row["correction_status"] != "SINGULAR":
            assert row["correction_status"] == ("OK" if mm <= LIMIT - LEFT else "ABOVE_LIMIT")
        assert float(row["correction_bound_mm"] or mm) == pytest.approx(mm, rel=1e-3)
        assert bool(row["correction_bound_mm"]) == (row["correction_status"] == "OK")
    said = json.loads(facts.read_text())["bound_mm"]
    assert said["max"] == pytest.approx(expected[expected <= LIMIT - LEFT].max(), rel=1e-3)


def test_a_program_of_a_controller_has_a_bound_for_each_target_with_its_own_tool(robot, tmp_path) -> None:
    text = "def job():\n  set_tcp(p[0, 0, 0.5, 0, 0, 0])\n  movej([0.4, -1.2, 1.5, -0.4, 0.6, 0.1])\nend\n"
    (tmp_path / "job.script").write_text(text)
    read = read_target_program(tmp_path / "job.script", Given({}, {}, {}), 6)
    (found,) = corrected_targets(read.language, list(read.targets), Cell(sources(robot)))
    q = np.array([[0.4, -1.2, 1.5, -0.4, 0.6, 0.1]])
    assert found.bound_mm == pytest.approx(by_differences(_with_tool(robot, (0, 0, 0.5)), q)[0], rel=1e-3)


def test_what_reflectors_do_not_tell_of_the_tool_is_in_the_bound(robot, file, tmp_path, monkeypatch, capfd) -> None:
    """Where the flange is; not where the measured point is the tool's centre, or its place was known."""
    q = np.array([[0.4, -1.2, 1.5, -0.4, 0.6, 0.1]])
    known = replace(robot, tool=replace(robot.tool, unknown="none"))

    def mm(source, **given):
        return float(bound_of(Sources(source, nominal_path("ur10"), **given))[0](q[0]))

    bare = mm(robot, tcp_mm=0.0)
    assert mm(robot) == pytest.approx(bare + 1)
    assert mm(robot, tcp_mm=0.3) == pytest.approx(bare + 0.3)
    assert mm(robot, tool="own") == mm(known) == bare
    (tmp_path / "job.script").write_text(f"set_tcp(p[0, 0, 0.2, 0, 0, 0])\nmovej({q[0].tolist()})\n")
    given = (
        "correct",
        file,
        tmp_path / "job.script",
        "--nominal",
        nominal_path("ur10"),
        "--out",
        tmp_path / "a.script",
    )
    assert run(monkeypatch, *given, "--limit", LIMIT) == 2
    assert "must be above 1.02 mm, for the tool's centre may be 1 mm from" in " ".join(capfd.readouterr().err.split())
    assert run(monkeypatch, *given) == 0
    assert "within 1 mm of where the controller has it (--tcp-error)" in " ".join(capfd.readouterr().out.split())
    (row,) = csv.DictReader((tmp_path / "a.script.correction.csv").read_text().splitlines())
    assert float(row["bound_mm"]) == pytest.approx(1 + mm(_with_tool(robot, (0, 0, 0.2)), tcp_mm=0.0), rel=1e-3)


def _with_tool(robot, point):
    T = np.array(robot.tool.T)
    T[:3, 3] = point
    return replace(robot, tool=replace(robot.tool, T=T))


def test_a_measured_tool_centre_is_taken_in_a_program(robot) -> None:
    """With --tool own the real tool stays where it was measured, and the nominal one is that of the program."""
    held = np.array(robot.tool.T)
    held[:3, 3] += (0.0008, -0.0005, 0.0006)
    q = poses(robot, 30)
    cell = Cell(Sources(robot, nominal_path("ur10"), tool="own"), steps=3)
    dq, status = cell.with_tool(held).corrector.correct(q)
    fine = status == Status.OK
    nominal = _with_tool(read_robot(nominal_path("ur10")), held[:3, 3])
    wanted = positions(replace(nominal, joints=tuple(replace(j, compliance=None) for j in nominal.joints)), q)
    assert rigid_motion(wanted[fine], positions(robot, q + dq)[fine])[2].max() < 20e-6
    shared = Cell(Sources(robot, nominal_path("ur10")), steps=3).with_tool(held).corrector
    assert rigid_motion(wanted[fine], positions(robot, q + shared.correct(q)[0])[fine])[2].mean() > 5e-4


@pytest.mark.parametrize("case", ["none", "network"])
def test_without_a_bound_it_is_said_why_and_a_limit_is_refused(robot, case) -> None:
    q = poses(robot, 60)
    net = Compensator.fit(q, 0.3 * np.sin(q[:, :3]), folds=2) if case == "network" else None
    given = sources(replace(robot, bound=None) if case == "none" else robot, compensator=net)
    function, why = bound_of(given)
    assert function is None
    assert {"none": "has no [bound]", "network": "without the compensator"}[case] in why
    with pytest.raises(InputError, match=r"a limit of 0.7 mm needs the bound of the error that remains"):
        command_of(given, limit_mm=LIMIT)


def test_an_unknown_tool_centre_is_of_a_bound_alone(robot) -> None:
    with pytest.raises(InputError, match="--tcp-error is of the bound, which --no-bound leaves out"):
        sources(robot, tcp_mm=0.3, bound=False)
    assert not sources(robot, tcp_mm=None, bound=False).bound


@pytest.mark.parametrize("limit", [0.02, -1.0, float("nan")])
def test_a_limit_below_what_the_steps_may_leave_is_refused(robot, limit) -> None:
    with pytest.raises(InputError, match=r"must be above 0.02 mm, which the steps alone may leave"):
        command_of(sources(robot), limit_mm=limit)


def test_the_commands_say_that_a_robot_has_no_bound(files, tmp_path, monkeypatch, capfd) -> None:
    (tmp_path / "job.csv").write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n10,-60,80,-20,30,5\n")
    common = ("correct", files / "ur10.toml", tmp_path / "job.csv", "--nominal", nominal_path("ur10"))
    assert run(monkeypatch, *common, "--out", tmp_path / "new.csv") == 0
    assert "NO BOUND of the error that remains" in capfd.readouterr().out
    assert run(monkeypatch, *common, "--out", tmp_path / "other.csv", "--limit", 1) == 2
    assert "a limit of 1 mm needs the bound" in capfd.readouterr().err
