"""Problems of many parameters or poses, not all tested or kept in memory, and priors that hang together."""

from dataclasses import replace
from pathlib import Path

import arms
import numpy as np
import pytest
from scipy.optimize import lsq_linear

import casadical
from casadical import identify
from casadical.identification import error_bound, least_squares, misfit, reduction, residuals

ARM = arms.six_axis()


@pytest.fixture
def measured():
    built = arms.planted(ARM, 4)
    return replace(arms.positions(built, arms.readings(built, 60, 8), 9), sigma=arms.NOISE)


def five_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (reduction, least_squares):
        monkeypatch.setattr(module, "WIDE", 5)


def test_many_parameters_end_where_few_do(measured, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = identify(ARM, measured, ["kinematic"], priors=True)
    five_are_many(monkeypatch)
    many = identify(ARM, measured, ["kinematic"], priors=True)
    assert many.is_optimal()
    assert many.names == whole.names
    np.testing.assert_allclose(many.estimate, whole.estimate, atol=2e-3 * whole.standard_errors.min())


def test_bounds_hold_with_many(measured, monkeypatch: pytest.MonkeyPatch) -> None:
    narrow = {**ARM.widths, "geometry": replace(ARM.widths["geometry"], length_bound=2e-4)}
    robot = replace(ARM, widths=narrow)
    whole = identify(robot, measured, ["kinematic"], priors=True)
    five_are_many(monkeypatch)
    many = identify(robot, measured, ["kinematic"], priors=True)
    assert many.at_bounds == whole.at_bounds != ()
    # What the Gauss-Newton steps found is an optimum to Ipopt, which begins a little inside the bounds.
    above = [found.solution.history[0] - found.solution.history[-1] for found in (many, whole)]
    assert above[0] < 0.05 * above[1]
    np.testing.assert_allclose(many.estimate, whole.estimate, atol=1e-6)


def test_correlated_priors_are_those_of_the_normal_distribution(measured) -> None:
    """At the optimum the gradient of data and prior together is zero, with the prior's inverse covariance as it is."""
    found = identify(ARM, measured, ["kinematic"], priors=True)
    names = found.names[-3:]
    width = np.array([found.start.parameters[n].prior for n in names])
    C = 1e-4 * np.outer(width, width) * (0.1 * np.eye(3) + 0.9)
    problem = replace(found.problem, known=((names, C),))
    v = problem.solve().v
    residuals, J = problem.evaluate(v)
    r = residuals[0].ravel()
    departure = np.array(list(problem.values(v).values())) - [found.start.parameters[n].value for n in problem.names]
    pull = np.zeros(len(v))
    pull[-3:] = np.linalg.solve(C, departure[-3:]) * problem.scale[-3:]
    others = np.array([found.start.parameters[n].prior for n in problem.names[:-3]])
    pull[:-3] = departure[:-3] / others**2 * problem.scale[:-3]
    total = J.T @ r + pull
    size = np.sqrt(np.diag(J.T @ J))
    assert np.abs(total / size).max() < 1e-3
    assert lsq_linear(J, r).cost <= 0.5 * r @ r


ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def found() -> casadical.Identification:
    return casadical.calibrate(ROOT / "problems" / "ur10e").identification


def test_the_misfit_is_that_of_all_poses(found, monkeypatch) -> None:
    usual = misfit.wide_fit(found)
    monkeypatch.setattr(misfit, "KEPT", 0)
    monkeypatch.setattr(residuals, "CHUNK", 7)
    parts = misfit.wide_fit(found)
    assert max(len(rows.r) for rows in parts.poses) == 7
    assert parts.misfit == pytest.approx(usual.misfit, rel=1e-9)
    assert parts.left == pytest.approx(usual.left, rel=1e-9)
    assert parts.best.log_likelihood == pytest.approx(usual.best.log_likelihood, rel=1e-9)
    assert len(parts.poses) == len(usual.poses) == sum(map(len, found.used))


def test_a_bound_of_some_poses_is_about_that_of_all(found, monkeypatch) -> None:
    usual = error_bound.learn_bound(found)
    monkeypatch.setattr(error_bound, "MOST", (2 * usual.poses) // 3)
    some = error_bound.learn_bound(found)
    assert abs(some.poses - error_bound.MOST) <= 1
    # The noise of a coordinate, times the factor, is most of it.
    assert some.rest * some.times == pytest.approx(usual.rest * usual.times, rel=0.3)
