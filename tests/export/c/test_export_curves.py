"""Periodic functions as tables: against sums of sines in NumPy, as bits in C, and as structured text."""

import casadi as ca
import export_models as models
import export_targets as targets
import numpy as np
import pytest
from structured_text_in_c import Compiled

from casadical.core.basics import InputError
from casadical.export import load, write_c
from casadical.export.c.c_source import inside
from casadical.export.c.coefficients import MAX_TABLE_ERROR, _table, spline_errors
from casadical.export.c.products import CurveFunction
from casadical.export.c.reference import network as reference
from casadical.export.c.reference import run
from casadical.export.c.structured_text import structured_text
from casadical.export.c.tape import tape_of
from casadical.export.c.tape_program import tape_program, without_needless_guards

STILL = 3  # a joint that did not move: all its coefficients are zero


def coefficients(orders=60, seed=4):
    """Sines and cosines [rad] of six joints, shape (2, 6, orders), in the sizes of `joint_error_curve`."""
    size = 60e-6 * np.minimum(1, 17 / np.arange(1, orders + 1))
    found = np.random.default_rng(seed).normal(size=(2, 6, orders)) * size
    found[:, STILL] = 0
    return found


def summed(q, values):
    """The curves in NumPy: a sine and a cosine of every multiple of every angle; q : (k, 6) [rad]."""
    orders = np.arange(1, values.shape[2] + 1)
    angles = q[:, :, None] * orders
    return (values[0] * np.sin(angles) + values[1] * np.cos(angles)).sum(axis=2)


def curve_function(values):
    """curves:(q[6])->(dq[6]) that calls the sum of sines as one function."""
    q = ca.SX.sym("q", 6)
    rows = [
        sum(
            (a * ca.sin(k * q[j]) + b * ca.cos(k * q[j]) for k, (a, b) in enumerate(values[:, j].T, 1) if a or b),
            ca.SX(0),
        )
        for j in range(6)
    ]
    inner = ca.Function("joint_curves", [q], [ca.densify(ca.vertcat(*rows))], {"never_inline": True})
    return ca.Function("curves", [q], [inner(q)])


@pytest.fixture(scope="module")
def curves():
    return CurveFunction(curve_function(coefficients()), models.LOWER, models.UPPER)


@pytest.mark.parametrize("real", ["float", "double"])
def test_tables_are_the_sum_of_sines_within_their_bound(curves, real):
    q = np.random.default_rng(0).uniform(-7, 7, (20_000, 6)).astype(targets.TYPE[real])
    tape = tape_of(curves.function)
    values, fine = run(tape, q, real)
    exact = summed(q.astype(float), coefficients())
    bound = max(node.value for node in tape.nodes if node.table)
    error = abs(values - exact).max()
    assert fine.all()
    assert abs(exact).max() > 500e-6
    assert error <= bound + 1e-9  # rounding in float
    assert error > bound / 20  # a bound that is of use


def test_the_bound_of_one_harmonic_is_its_error():
    values = np.zeros((2, 6, 60))
    values[0, 0, 59] = 1e-4
    tape = tape_of(curve_function(values))
    (node,) = [node for node in tape.nodes if node.table]
    q = np.linspace(0, 2 * np.pi, 20_001)[:, None] * np.ones(6)
    assert abs(run(tape, q, "double")[0] - summed(q, values)).max() == pytest.approx(node.value, rel=0.02)


def test_a_smooth_curve_has_a_small_table_and_a_joint_without_curve_none():
    def sizes(values):
        return [len(node.table) - 3 for node in tape_of(curve_function(values)).nodes if node.table]

    assert sizes(coefficients(60)) == [1024] * 5
    assert sizes(coefficients(1)) == [64] * 5
    assert sizes(np.zeros((2, 6, 3))) == []


def test_the_c_gives_the_curves_and_their_bounds(curves, compiler, tmp_path):
    export = write_c(curves, tmp_path, name="arm", languages=(), vectors=1_000)
    assert export.verified
    assert export.figures["table_error_urad_at_most"] <= 1e6 * MAX_TABLE_ERROR
    q = np.random.default_rng(1).uniform(models.LOWER, models.UPPER, (500, 6))
    q[0, 2], q[1, 1] = np.nan, 9.0
    values, status = load(tmp_path).curves(q)
    assert status[:3].tolist() == [6, 1, 0]
    assert abs(values[2:] - summed(q[2:], coefficients())).max() < MAX_TABLE_ERROR
    low, high = np.array(tape_program(curves, "double").network_bounds).T
    assert (values >= low).all()
    assert (values <= high).all()
    assert (high < 2 * abs(values).max() + 1e-12).all()
    assert (low[STILL], high[STILL]) == (0, 0)
    header = (tmp_path / "arm.h").read_text()
    assert "arm_curves(const arm_real q[ARM_JOINTS], arm_real dq[6])" in header


@pytest.mark.parametrize("real", [pytest.param("float", marks=pytest.mark.slow), "double"])
def test_structured_text_gives_the_curves(curves, compiler, tmp_path, real):
    program = tape_program(curves, real)
    compiled = Compiled(structured_text(program), tmp_path, compiler, "arm", "curves", "dq")
    q = inside(program, 300)
    dq, status = compiled.rows(q)
    expected = reference(program, q)
    assert (dq == expected[0]).all()
    assert (status == expected[1]).all()
    assert dq == pytest.approx(summed(q.astype(float), coefficients()), abs=MAX_TABLE_ERROR)
    assert compiled.rows(np.full((1, 6), np.nan))[1] == 6


def test_an_angle_beyond_the_table_is_not_fine(curves):
    tape = without_needless_guards(tape_of(curves.function), np.full(6, -1000.0), np.full(6, 1000.0), "float")
    q = np.zeros((3, 6), np.float32)
    q[1, 0], q[2, 5] = 127.9, 128.5
    values, fine = run(tape, q, "float")
    assert fine.tolist() == [True, True, False]
    assert abs(values[1] - summed(q[1:2].astype(float), coefficients())[0]).max() < MAX_TABLE_ERROR


def test_what_cannot_be_a_table_is_refused_with_the_reason():
    def exported(dq, q):
        inner = ca.Function("joint_curves", [q], [ca.densify(dq)], {"never_inline": True})
        return tape_of(ca.Function("f", [q], [inner(q)]))

    q = ca.SX.sym("q", 2)
    with pytest.raises(InputError, match="no finite value for joint 2"):
        exported(ca.vertcat(ca.sin(q[0]), np.nan * ca.cos(q[1])), q)
    with pytest.raises(InputError, match="follows another angle"):
        exported(ca.vertcat(ca.sin(q[1]), ca.sin(q[0])), q)
    with pytest.raises(InputError, match="does not repeat"):
        exported(ca.vertcat(1e-3 * ca.sin(q[0] / 2), 0), q)
    with pytest.raises(InputError, match=r"harmonics up to 300: are its"):
        exported(ca.vertcat(0, 1e-3 * (ca.sin(q[1]) + ca.sin(300 * q[1]))), q)
    one, two = (
        ca.Function(name, [q], [ca.densify(1e-4 * ca.sin(q))], {"never_inline": True}) for name in ("one", "two")
    )
    with pytest.raises(InputError, match="only one can become a table"):
        tape_of(ca.Function("f", [q], [one(q) + two(q)]))
    with pytest.raises(InputError, match="takes 3 vectors"):
        tape_of(ca.Function("f", [q], [ca.densify(ca.jacobian(one(q), q))]))


@pytest.mark.parametrize("entries", [128, 256, 512])
def test_a_table_has_the_least_number_of_points_that_is_accurate_enough(entries: int) -> None:
    turn = 2 * np.pi * np.arange(8192) / 8192
    size = 2 * MAX_TABLE_ERROR / spline_errors(entries // 2)[2]  # of the third harmonic
    table, bound = _table(ca.Function("f", [ca.SX.sym("q")], [0]), 0, size * np.sin(3 * turn))
    assert len(table) == entries + 3  # a spline over one turn needs three more
    assert bound == pytest.approx(size * spline_errors(entries)[2])
