"""Tapes, their arithmetic in NumPy against NumPy's own functions, and their interval bounds."""

import inspect
from typing import Any

import casadi as ca
import export_models as models
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from casadical.core.basics import InputError
from casadical.export.c.chord import ORIENTATION_LENGTH_M, residual
from casadical.export.c.products import Command, mapped
from casadical.export.c.reference import NumpyFunctions, run
from casadical.export.c.tape import Node, Tape, tape_of
from casadical.export.c.tape_program import _INTERVAL_RULES, bounds, tape_program, without_needless_guards
from casadical.export.c.write import accuracy
from casadical.export.controller.commands import export_c

REALS = ("float", "double")
TYPE = {"float": np.float32, "double": np.float64}


def operations(function):
    return [node.op for node in tape_of(function).nodes]


@pytest.mark.parametrize("form", ["tansig", "tanh", "one_minus"])
def test_every_way_to_write_a_tansig_is_recognised(form):
    names = operations(models.network(form=form))
    assert names.count("tansig") == 5
    assert "exp" not in names
    q = np.random.default_rng(0).uniform(models.LOWER, models.UPPER, (500, 6))
    values, fine = run(tape_of(models.network(form=form)), q, "double")
    assert fine.all()
    np.testing.assert_allclose(values, np.array(models.network(form=form).map(500)(q.T)).T, atol=1e-13)


@pytest.mark.parametrize("shift", [0.5, 2.0])
def test_what_only_looks_like_a_tansig_keeps_its_value(shift):
    x = ca.SX.sym("x")
    forms = [
        2 / (1 + ca.exp(-x)) - 1,
        1 - 2 / (1 + ca.exp(3 * x)),
        2 / (1 + ca.exp(-2 * x)) - shift,
        2 / (shift + ca.exp(x)) - 1,
        2 / (1 + ca.exp(x)) + 1,
        1 + 2 / (1 + ca.exp(-x)),
        2 / (1 + ca.exp(-2 * x)) + (-1),
    ]
    function = ca.Function("f", [x], [ca.vertcat(*forms)])
    grid = np.linspace(-6, 6, 201)[:, None]
    values, _ = run(tape_of(function), grid, "double")
    np.testing.assert_allclose(values, np.array(function.map(201)(grid.T)).T, atol=2e-14)


def test_equal_operations_are_stored_once_and_sines_share_an_operation():
    x = ca.SX.sym("x", 2)
    function = ca.Function("f", [x], [ca.sin(x[0] * x[1]), ca.cos(x[1] * x[0]), (x[0] * x[1]) ** 2])
    names = operations(function)
    assert names.count("sincos") == 1
    assert names.count("mul") == 2


def test_every_operation_of_the_mirror_agrees_with_casadi():
    x = ca.SX.sym("x", 3)
    a, b, c = x[0], x[1], x[2]
    terms = [a + b, a - b, a * b, a / (2 + b), -a, ca.fabs(a), ca.fmin(a, b), ca.fmax(a, b), ca.sign(a), a**2, a**3]
    terms += [ca.sqrt(1.1 + a), ca.exp(a), ca.tan(a), ca.atan(5 * a), ca.atan2(a, b), ca.asin(a), ca.acos(b), 2 * a]
    terms += [
        ca.if_else(a < b, c, a),
        ca.if_else(a <= 0, b, c),
        ca.hypot(a, b),
        ca.tanh(3 * a),
        1 / (3 + c),
        ca.sin(90 * a),
    ]
    function = ca.Function("f", [x], [ca.vertcat(*terms)])
    grid = np.random.default_rng(1).uniform(-1, 1, (2000, 3))
    values, fine = run(tape_of(function), grid, "double")
    assert fine.all()
    np.testing.assert_allclose(values, np.array(function.map(2000)(grid.T)).T, rtol=1e-13, atol=1e-13)


def test_an_operation_without_c_is_refused_by_name():
    x = ca.SX.sym("x")
    with pytest.raises(InputError, match=r"OP_ERF.*allowed are .*sqrt"):
        tape_of(ca.Function("f", [x], [ca.erf(x)]))


def test_a_function_that_cannot_be_expanded_is_refused():
    table = ca.interpolant("table", "linear", [[0.0, 1.0]], [0.0, 1.0])
    x = ca.MX.sym("x")
    with pytest.raises(InputError, match=r"OP_CALL|scalar operations|does not repeat after 2 pi"):
        tape_of(ca.Function("f", [x], [table(x)]))


@pytest.mark.parametrize("real", REALS)
def test_elementary_functions_are_accurate_to_a_few_units_in_the_last_place(real):
    T, mirror, rng = TYPE[real], NumpyFunctions(real), np.random.default_rng(2)
    wide = np.longdouble
    eps = np.finfo(T).eps
    x = rng.uniform(-1000, 1000, 50_000).astype(T)
    s, c = mirror.sincos(x)
    large = 8 if real == "float" else 2  # |x| of 1000 in float: the reduction's second part is rounded 600 times larger
    assert abs(s - np.sin(x.astype(wide))).max() < large * eps
    assert abs(c - np.cos(x.astype(wide))).max() < large * eps
    x = (x / 100).astype(T)
    s, c = mirror.sincos(x)
    assert max(abs(s - np.sin(x.astype(wide))).max(), abs(c - np.cos(x.astype(wide))).max()) < eps
    a = np.concatenate([rng.uniform(-30, 30, 50_000), rng.normal(size=1000) * 1e-5]).astype(T)
    assert abs(mirror.tansig(a) / np.tanh(a.astype(wide)) - 1).max() < 2.5 * eps
    a = rng.uniform(-43, 43, 50_000).astype(T)
    assert abs(mirror.exp(a) / np.exp(a.astype(wide)) - 1).max() < 1.5 * eps
    a = (10 ** rng.uniform(np.log10(np.finfo(T).tiny), np.log10(np.finfo(T).max), 50_000)).astype(T)
    with np.errstate(over="ignore"):
        assert abs(mirror.sqrt(a) / np.sqrt(a.astype(wide)) - 1).max() < eps
    y, x = rng.normal(size=(2, 50_000)).astype(T)
    assert abs(mirror.atan2(y, x) - np.arctan2(y.astype(wide), x.astype(wide))).max() < 3 * eps


@pytest.mark.parametrize("real", REALS)
def test_bounds_hold_for_random_inputs_and_are_not_vacuous(real):
    function = models.network()
    tape = tape_of(function)
    found = bounds(tape, models.LOWER, models.UPPER, real)
    q = np.random.default_rng(3).uniform(models.LOWER, models.UPPER, (20_000, 6)).astype(TYPE[real])
    values, _ = run(tape, q, real)
    for k, output in enumerate(tape.outputs):
        low, high = found[output]
        assert low <= values[:, k].min()
        assert values[:, k].max() <= high
        assert high - low < 4 * np.ptp(values[:, k])


@pytest.mark.parametrize("real", REALS)
def test_bounds_hold_for_what_rounding_adds(real):
    """A tenth added up two hundred times at the edge of the box: the roundings add up beyond the exact sum."""
    x = ca.SX.sym("x")
    total = ca.SX(0)
    for k in range(200):
        total = total + x * (1 + k * 0.1)
    tape = tape_of(ca.Function("f", [x], [total]))
    for edge in np.linspace(0.05, 0.15, 41).astype(TYPE[real]):
        low, high = bounds(tape, np.array([edge]), np.array([edge]), real)[tape.outputs[0]]
        values, _ = run(tape, np.array([[edge]]), real)
        assert low <= values[0, 0] <= high
        assert high - low < 1e-3 * abs(values[0, 0])


def test_needless_guards_go_and_needed_ones_stay():
    x = ca.SX.sym("x")
    tape = tape_of(ca.Function("f", [x], [ca.sqrt(x) + ca.sin(x)]))
    safe = without_needless_guards(tape, np.array([0.1]), np.array([3.0]), "double")
    assert not [n for n in safe.nodes if n.op.startswith("guard")]
    wide = without_needless_guards(tape, np.array([-0.1]), np.array([5000.0]), "double")
    assert [n.op for n in wide.nodes if n.op.startswith("guard")] == ["guard_min", "guard_max"]
    values, fine = run(wide, np.array([[-0.05], [0.5], [4000.0]]), "double")
    assert fine.tolist() == [False, True, False]
    assert np.isfinite(values).all()
    divided = tape_of(ca.Function("f", [x], [ca.sqrt(1 / x)]))
    assert [n.op for n in without_needless_guards(divided, np.array([-1.0]), np.array([1.0]), "float").nodes].count(
        "guard_min"
    )


def test_matrices_are_mapped_column_by_column():
    q = ca.SX.sym("q", 2)
    function = ca.Function("f", [q], [3 * q, ca.blockcat([[q[0], 10 * q[0]], [q[1], 10 * q[1]]])])
    rows = np.array([[1.0, 2.0], [3.0, 5.0], [7.0, 11.0]])
    assert np.array_equal(mapped(function, rows), [[3 * a, 3 * b, a, b, 10 * a, 10 * b] for a, b in rows])


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


def test_the_forward_error_is_in_micrometres(command: Command) -> None:
    """Of single precision: a metre has an error of about a ten-millionth."""
    figures = accuracy(tape_program(command, "float"), 200)
    assert 0.01 < figures["forward_error_um"] < 10


def test_the_residual_of_a_pose_is_the_way_and_the_turn_to_it() -> None:
    p, turn, R = np.array([1e-6, -2e-6, 3e-6]), np.array([4e-6, 5e-6, -6e-6]), Rotation.random(random_state=0)
    now = np.concatenate([np.zeros(3), R.as_matrix().ravel(order="F")])
    target = np.concatenate([p, (Rotation.from_rotvec(turn) * R).as_matrix().ravel(order="F")])
    found = ca.Function("r", [], [residual(ca.SX(target), ca.SX(now))])()["o0"].full().ravel()
    np.testing.assert_allclose(found, [*p, *(ORIENTATION_LENGTH_M * turn)], rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "of"),
    [("add", np.add), ("sub", np.subtract), ("div", np.divide), ("fmin", np.minimum), ("fmax", np.maximum)],
)
def test_an_interval_is_that_of_its_corners(name: str, of: Any) -> None:
    rng = np.random.default_rng(0)
    for _ in range(40):
        a, b = np.sort(rng.normal(size=2)), np.sort(rng.uniform(0.5, 2.0, 2))
        corners = of(a[:, None], b)
        assert _INTERVAL_RULES[name](tuple(a), tuple(b)) == pytest.approx((corners.min(), corners.max()))


def test_a_correction_has_as_many_steps_as_the_command_writes() -> None:
    command = Command(models.nominal(), models.calibrated(), models.LOWER, models.UPPER)
    assert command.steps == inspect.signature(export_c).parameters["steps"].default


def test_a_function_of_matrices_has_the_tape_of_its_scalars() -> None:
    x, y = ca.SX.sym("x", 2), ca.MX.sym("y", 2)
    scalar, whole = ca.Function("f", [x], [ca.sin(x) * 2]), ca.Function("f", [y], [ca.sin(y) * 2])
    at = np.array([[0.3, -0.7]])
    for function in (scalar, whole):
        np.testing.assert_allclose(run(tape_of(function), at, "double")[0], 2 * np.sin(at), atol=1e-15)
