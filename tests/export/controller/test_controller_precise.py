"""The comparison of nominal and real robot in which nothing cancels: float C that is as near as double."""

import sys
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from controller_arms import nominal_path, planted

from casadical import InputError
from casadical.effects import JointErrorCurve
from casadical.export import Sources, Status, command_of, load, write_c
from casadical.export.c.c_language import comparison_inputs, inside
from casadical.export.c.kernel import compilers
from casadical.export.c.language import Label
from casadical.export.c.products import mapped
from casadical.export.c.reference import correct
from casadical.export.c.structured_text import structured_text
from casadical.export.c.tape_program import operations, tape_program
from casadical.export.controller.functions import changed

sys.path.append(str(Path(__file__).parents[1] / "c"))
from structured_text_in_c import Compiled

needs_compiler = pytest.mark.skipif(not compilers(), reason="no C compiler (gcc, clang, cc) on this machine")


def left(command, real, count=1500):
    """Errors after the correction [um] of poses with status OK, by the double model, and the share of these."""
    program = tape_program(command, real)
    q = inside(program, count)
    dq, status = correct(program, q)
    exact, ok = q.astype(float), status == Status.OK
    off = mapped(command.calibrated, exact + dq) - mapped(command.nominal, exact)
    return 1e6 * np.linalg.norm(off[ok, :3], axis=1), ok.mean()


@pytest.mark.parametrize("name", ["ur10", "hh800"])
@pytest.mark.parametrize("orientation", [False, True])
def test_float_is_as_near_as_double(name, orientation):
    sources = Sources(planted(name), nominal_path(name))
    command = command_of(sources, 3, orientation=orientation, precise=True)
    single, share = left(command, "float")
    double, same = left(command, "double")
    assert share == pytest.approx(same, abs=0.01)
    assert np.median(single) < 0.01
    assert np.quantile(single, 0.99) < np.quantile(double, 0.99) + 0.1
    assert np.median(left(replace(command, difference=None), "float")[0]) > 0.05


def test_a_curve_is_in_the_difference():
    robot = planted("ur10").with_effect(JointErrorCurve(None, orders=3))
    robot = robot.with_values({"joint_error_curve.s1_q2": 4e-4, "joint_error_curve.c3_q3": 1e-4})
    command = command_of(Sources(robot, nominal_path("ur10")), 3, precise=True)
    q = np.random.default_rng(2).uniform(-2, 2, (50, 6))
    apart = mapped(command.calibrated, q + 1e-3) - mapped(command.nominal, q)
    assert command.difference is not None
    found = np.array([command.difference(x, np.full(6, 1e-3)).full().ravel() for x in q])
    assert found == pytest.approx(apart, abs=1e-12)


@pytest.mark.parametrize(
    "function",
    [
        lambda x, y: x * y + x / (2 + y) - 1 / (3 + x) + 2 * x - (-y) + x**2,
        lambda x, y: ca.sin(x) * ca.cos(y) + ca.sqrt(1 + x * x) + ca.atan2(x, 1 + y),
        lambda x, y: ca.tanh(x) + ca.exp(y) + ca.fmax(x, y) - ca.fmin(x, 2 * y) + ca.fabs(x - y),
        lambda x, y: ca.if_else(x < y, x, y) + ca.asin(x / 2) + ca.acos(y / 2) + ca.atan(x) + ca.tan(y),
    ],
)
def test_changes_are_differences(function):
    x = ca.SX.sym("x", 2)
    f = ca.Function("f", [x], [function(x[0], x[1])])
    d = ca.SX.sym("d", 2)
    made = ca.Function("made", [x, d], changed(f, [x], [d]))
    rng = np.random.default_rng(0)
    for at, by in zip(rng.uniform(-1, 1, (30, 2)), rng.uniform(-0.3, 0.3, (30, 2)), strict=True):
        assert float(made(at, by)) == pytest.approx(float(f(at + by) - f(at)), abs=1e-14)


def test_a_small_change_keeps_its_digits_in_single_precision():
    """Against the series of sin(2 + d) - sin(2) for d = 1e-6."""
    x, d = ca.SX.sym("x"), ca.SX.sym("d")
    made = ca.Function("made", [x, d], changed(ca.Function("f", [x], [1e3 * ca.sin(x)]), [x], [d]))
    exact = 1e3 * (1e-6 * np.cos(2.0) - 0.5e-12 * np.sin(2.0))
    assert abs(float(made(2.0, 1e-6)) / exact - 1) < 1e-12
    assert abs(1e3 * (np.sin(2.0 + 1e-6) - np.sin(2.0)) / exact - 1) > 1e-12


@needs_compiler
def test_c_and_structured_text_have_the_bits_of_the_reference(tmp_path):
    command = command_of(Sources(planted("ur10"), nominal_path("ur10")), 2, precise=True)
    program = tape_program(command, "float")
    assert operations(program).count["multiplications"] > 900
    q = comparison_inputs(program, 1000)
    dq, status = correct(program, q)
    write_c(command, tmp_path / "c", name="arm", real="float", vectors=300, languages=())
    for found in (
        load(tmp_path / "c").correct(q),
        Compiled(structured_text(program, Label("arm")), tmp_path, compilers()[0], "arm", "correct", "dq").rows(q),
    ):
        assert np.array_equal(found[0], dq)
        assert found[1].tolist() == status.tolist()


def test_robots_whose_tools_are_no_parameters_are_refused():
    robot, nominal = planted("kr210"), planted("kr210", seed=2)
    fixed = [replace(r, tool=replace(r.tool, unknown="none")) for r in (robot, nominal)]
    with pytest.raises(InputError, match="--precise needs"):
        command_of(Sources(*fixed, tool="own"), precise=True)
