"""Problems of many parameters, not all tested for independence, and priors that hang together."""

from dataclasses import replace

import arms
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from casadical import identify
from casadical.identification import reduction

ARM = arms.six_axis()


@pytest.fixture
def measured():
    built = arms.planted(ARM, 4)
    return replace(arms.positions(built, arms.readings(built, 60, 8), 9), sigma=arms.NOISE)


def test_many_parameters_end_where_few_do(measured, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = identify(ARM, measured, ["kinematic"], priors=True)
    monkeypatch.setattr(reduction, "WIDE", 5)
    many = identify(ARM, measured, ["kinematic"], priors=True)
    assert many.is_optimal()
    assert many.names == whole.names
    np.testing.assert_allclose(many.estimate, whole.estimate, atol=2e-3 * whole.standard_errors.min())


def test_bounds_hold_with_many(measured, monkeypatch: pytest.MonkeyPatch) -> None:
    narrow = {**ARM.widths, "geometry": replace(ARM.widths["geometry"], length_bound=2e-4)}
    robot = replace(ARM, widths=narrow)
    whole = identify(robot, measured, ["kinematic"], priors=True)
    monkeypatch.setattr(reduction, "WIDE", 5)
    many = identify(robot, measured, ["kinematic"], priors=True)
    assert many.at_bounds == whole.at_bounds != ()
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
