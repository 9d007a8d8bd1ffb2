"""Parts of an export to C against other ways to the same number: intervals, splines, limits, figures, versions."""

from typing import Any

import casadi as ca
import numpy as np
import pytest

from casadical.export.c.chord import residual_size
from casadical.export.c.coefficients import spline_errors, spline_table
from casadical.export.c.products import Command, Limits
from casadical.export.c.reference import NumpyFunctions
from casadical.export.c.tape import Node, Tape, tape_of
from casadical.export.c.tape_program import bounds, tape_program
from casadical.export.c.write import accuracy

X = ca.SX.sym("x", 2)


def bound_of(expression: Any, lower: list[float], upper: list[float], real: Any = "double") -> tuple[float, float]:
    tape = tape_of(ca.Function("f", [X], [expression]))
    return bounds(tape, np.array(lower), np.array(upper), real)[tape.outputs[0]]


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        (X[0] - X[1], (-5.5, 5.0)),
        (X[0] * X[1], (-6.0, 8.0)),
        (X[0] * X[0], (0.0, 4.0)),
        (X[1] * X[1], (0.0, 16.0)),
        (ca.fabs(X[1]), (0.0, 4.0)),
        (ca.fabs(X[0] - 3), (1.0, 4.5)),
        (-X[0], (-2.0, 1.5)),
        (X[0] / (X[1] + 5), (-0.75, 1.0)),
        (ca.sqrt(X[1] + 5), (np.sqrt(2), 3.0)),
        (X[0] / ca.fmin(X[1], 0), (-np.inf, np.inf)),
        (X[0] / ca.fmax(X[1], 0), (-np.inf, np.inf)),
    ],
)
def test_bounds_are_those_of_the_ends(expression: Any, expected: tuple[float, float]) -> None:
    """x0 in [-1.5, 2], x1 in [-3, 4]; widened by rounding alone."""
    found = bound_of(expression, [-1.5, -3.0], [2.0, 4.0])
    assert found == pytest.approx(expected, abs=1e-13)
    assert found[0] <= expected[0]
    assert found[1] >= expected[1]


def test_what_may_overflow_is_bounded_by_nothing() -> None:
    for lower, upper in (([-1e30, 1e20], [-1e20, 1e30]), ([1e20, 1e20], [1e30, 1e30])):
        assert bound_of(X[0] * X[1], lower, upper, "float") == (-np.inf, np.inf)
        assert np.isfinite(bound_of(X[0] * X[1], lower, upper, "double")).all()


def test_a_guard_bounds_what_comes_behind_it() -> None:
    nodes = (Node("input"), Node("guard_min", (0,), 0.5), Node("guard_max", (1,), 0.75), Node("div", (0, 1)))
    tape = Tape(nodes, 1, (3,))
    found = bounds(tape, np.array([-1.0]), np.array([2.0]), "double")
    assert found[1] == pytest.approx((0.5, 2.0))
    assert found[2] == pytest.approx((0.5, 0.75))
    assert found[3] == pytest.approx((-2.0, 4.0))


def test_a_table_bounds_its_spline_by_a_thousandth_of_its_range() -> None:
    table = spline_table(np.array([0.0, 1.0, 2.0, 1.0]))
    tape = Tape((Node("input"), Node("periodic", (0,), 0.1, table)), 1, (1,))
    low, high = bounds(tape, np.array([0.0]), np.array([1.0]), "double")[1]
    least, most = 6 * min(table), 6 * max(table)
    assert (low, high) == pytest.approx((least - 1e-3 * (most - least), most + 1e-3 * (most - least)), rel=1e-9)


@pytest.mark.parametrize("order", [1, 3])
def test_the_error_of_a_spline_is_that_of_its_worst_place(order: int) -> None:
    points, phases = 16, np.linspace(0, 2 * np.pi, 40, endpoint=False)
    t, worst = np.linspace(0.0, 1.0, 51), 0.0
    for phase in phases:
        wave = np.cos(order * 2 * np.pi * np.arange(points) / points + phase)
        c = 6 * np.array(spline_table(wave))
        for i in range(points):
            cubic = (c[i] * (1 - t) ** 3 + c[i + 1] * (3 * t**3 - 6 * t**2 + 4)
                     + c[i + 2] * (-3 * t**3 + 3 * t**2 + 3 * t + 1) + c[i + 3] * t**3) / 6  # fmt: skip
            exact = np.cos(order * 2 * np.pi * (i + t) / points + phase)
            worst = max(worst, np.abs(cubic - exact).max())
    assert spline_errors(points)[order - 1] == pytest.approx(worst, rel=0.05)


def test_limits_become_numbers_of_a_cycle() -> None:
    limits = Limits(damping=0.02, singular_m_per_rad=0.03, cycle_s=0.002, rate_rad_s=0.4, ramp_s=0.5, tolerance_mm=0.1)
    found = limits.numbers
    assert found["weakness"] == pytest.approx(1 / (0.02**2 + 0.03**2))
    assert [found[key] for key in ("change", "ramp", "tolerance2")] == pytest.approx((8e-4, 0.004, 1e-8))


def test_a_position_has_three_residuals_and_a_pose_six(command: Command) -> None:
    assert residual_size(command) == 3
    q = ca.SX.sym("q", 6)
    p = command.calibrated(q)
    pose = ca.Function("pose", [q], [p, ca.SX.eye(3)])
    both: Any = type("Of", (), {"calibrated": pose})
    assert residual_size(both) == 6
    wide: Any = type("Of", (), {"calibrated": ca.Function("pose", [q], [ca.vertcat(p, p)])})
    assert residual_size(wide) == 6


def test_the_forward_error_is_in_micrometres(command: Command) -> None:
    """Of single precision: a metre has an error of about a ten-millionth."""
    figures = accuracy(tape_program(command, "float"), 200)
    assert 0.01 < figures["forward_error_um"] < 10


@pytest.mark.parametrize(("real", "kind"), [("float", np.float32), ("double", np.float64)])
def test_roots_are_exact_to_the_last_digits(real: Any, kind: Any) -> None:
    x = np.geomspace(1e-30, 1e30, 4001).astype(kind)
    with np.errstate(over="ignore"):  # of the branch that is not taken
        found = NumpyFunctions(real).sqrt(x)
    assert np.abs(found / np.sqrt(x.astype(np.float64)) - 1).max() < 2 * np.finfo(kind).eps
