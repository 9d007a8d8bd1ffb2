"""Formulas as text: what they compute, and what is refused before anything is computed."""

import casadi as ca
import numpy as np
import pytest

from casadical.core.basics import InputError
from casadical.effects.formula import NUMERIC_FUNCTIONS, bounds, parse
from casadical.effects.formula_effect import Law

X = np.linspace(-2.0, 2.0, 9)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a * max(0, abs(x) - 0.3)", 3.0 * np.clip(np.abs(X) - 0.3, 0.0, None)),
        ("-a*x**3 + 2/4", -3.0 * X * X * X + 0.5),
        ("a * (sin(2*x) - cos(x))", 3.0 * (2 * np.sin(X) * np.cos(X) - np.cos(X))),
        ("step(x) * a", np.where(X > 0, 3.0, 0.0)),
        ("a * tanh(x) + min(x, 1) * sign(x) * exp(-x) * sqrt(4)", None),
    ],
)
def test_a_formula_is_computed_alike_with_numbers_and_symbols(text: str, expected: np.ndarray | None) -> None:
    formula = parse(text)
    (numbers,) = formula.values({"a": 3.0, "x": X}, NUMERIC_FUNCTIONS)
    a, x = ca.SX.sym("a"), ca.SX.sym("x")
    (symbol,) = formula.values({"a": a, "x": x})
    f = ca.Function("f", [a, x], [symbol])
    np.testing.assert_allclose([float(f(3.0, v)) for v in X], numbers, rtol=1e-14, atol=1e-14)
    if expected is not None:
        np.testing.assert_allclose(numbers, expected, rtol=1e-14, atol=1e-14)


def test_three_components() -> None:
    formula = parse("[a, b, 0] * x - [0, 0, x] / 2")
    assert formula.components == 3
    assert formula.names == ("a", "b", "x")
    assert formula.values({"a": 2.0, "b": 3.0, "x": 4.0}, NUMERIC_FUNCTIONS) == [8.0, 12.0, -2.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it is empty"),
        ("a * foo(x)", "column 5: unknown function 'foo'; allowed are sin, cos"),
        ("__import__('os')", 'column 12: character "\'"'),
        ("[a, b, 0] * [x, x, x]", "column 1: three components can be multiplied"),
        ("a.real * x", "column 1: attribute is not allowed"),
        ("a * x ** y", "column 10: a power must be a whole number from 1 to 6"),
        ("9**9**9", "column 7: a power must be"),
        ("a * 1e999", "column 5: number out of range"),
        ("True * a", "column 1: True is no number"),
        ("a * 2j", "column 5: 2j is no number"),
        ("a * max(x)", "column 5: max takes 2 arguments"),
        ("max * a", "column 1: max is a function"),
        ("[a, b] * x", "column 1: brackets hold three components"),
        ("[a, b, 0] + x", "column 1: one side has three components"),
        ("sin([a, b, 0])", "column 1: sin takes no three components"),
        ("a b", "it cannot be read"),
        ("[x for x in a]", "column 1: listcomp is not allowed"),
        ("(" * 250 + "a" + ")" * 250, "it has 501 characters"),
        ("-" * 60 + "a", "nested more than 20 levels deep"),
        ("+".join(["a"] * 19), "^$"),
        ("(" + "+".join(["a*x"] * 18) + ")*(" + "+".join(["a*x"] * 18) + ")", "at most 120 are allowed"),
    ],
)
def test_what_is_no_formula_is_refused(text: str, message: str) -> None:
    if message == "^$":
        assert parse(text).names == ("a",)
        return
    with pytest.raises(InputError, match=message.replace("(", r"\(").replace("*", r"\*")):
        parse(text)


RANGES = {"a": (-4.0, 4.0), "x": (-2.0, 3.0), "y": (1.0, 2.0)}


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("x*x", 0, 9),
        ("x**3", -8, 27),
        ("x*y - 1", -5, 5),
        ("x/y", -2, 3),
        ("-x + abs(x)", -3, 5),
        ("exp(x) * step(a)", 0, np.exp(3)),
        ("sqrt(x*x + 1)", 1, np.sqrt(10)),
        ("min(x, y)", -2, 2),
        ("max(x, y)", 1, 3),
        ("[sin(x), 2*cos(a), tanh(x) * sign(a)]", -2, 2),
    ],
)
def test_bounds_hold_every_value(text: str, low: float, high: float) -> None:
    formula = parse(text)
    assert bounds(formula, RANGES.__getitem__) == pytest.approx((low, high))
    rng = np.random.default_rng(0)
    values = formula.values({name: rng.uniform(*ends, 1000) for name, ends in RANGES.items()}, NUMERIC_FUNCTIONS)
    assert low <= np.min(values) <= np.max(values) <= high


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a / 0", "column 5: may be zero; divide by what never is"),
        ("a / x", "column 5: may be zero"),
        ("a * exp(exp(exp(x)))", "column 5: may become greater than 1e\\+100"),
        ("a * ((((x)**6)**6)**6)**6", "may become greater"),
        ("a * sqrt(0 - y)", "column 5: is the root of a negative number"),
        ("a * exp(1 / (x * x + 1e-3))", "may become greater"),
    ],
)
def test_values_on_the_way_have_bounds(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        bounds(parse(text), RANGES.__getitem__)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a/(q1-q1)", "may be zero"),
        ("a*sqrt(q1)", "it is no number where"),
        ("a + 1", "it must be zero where a are zero"),
    ],
)
def test_a_law_is_a_number_everywhere(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Law(joint=1, formula=text)
    assert Law(joint=1, formula="a*sqrt(t)*exp(0-payload)/(1+q1**2)").drivers == ("t", "payload", "q1")


def test_a_number_that_runs_into_a_word_is_refused_without_a_warning() -> None:
    with pytest.raises(InputError, match="it cannot be read"):
        parse("a * (1or q)")
