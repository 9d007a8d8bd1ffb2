"""Problems of many parameters or poses, not all tested or kept in memory, and priors that hang together."""

from dataclasses import replace
from pathlib import Path

import arms
import numpy as np
import pytest
from scipy.optimize import lsq_linear

import casadical
from casadical import identify
from casadical.effects.joint_error_curve import TYPICAL_HARMONIC_RAD, JointErrorCurve
from casadical.identification.least_squares import MANY_PARAMETERS
from casadical.identification.misfit import wide_fit
from casadical.identification.remaining_errors import learn_remaining

ARM = arms.six_axis()


@pytest.fixture
def measured():
    built = arms.planted(ARM, 4)
    return replace(arms.positions(built, arms.readings(built, 60, 8), 9), sigma=arms.NOISE)


@pytest.mark.parametrize("narrow", [False, True], ids=["free", "at bounds"])
def test_many_parameters_end_at_the_optimum(narrow: bool) -> None:
    """Data and prior pull at each parameter alike; at a bound they pull outwards."""
    arm = arms.planar()
    m = replace(arms.positions(built := arms.planted(arm, 4), arms.readings(built, 60, 8), 9), sigma=arms.NOISE)
    width = replace(arm.widths["geometry"], **({"length_bound": 2e-4} if narrow else {}))
    arm = replace(arm, widths={**arm.widths, "geometry": width}).with_effect(
        JointErrorCurve(None, (TYPICAL_HARMONIC_RAD, TYPICAL_HARMONIC_RAD))
    )
    found = identify(arm, m, ["kinematic", "joint_error_curve"], loss="linear", priors=True)
    assert found.is_optimal()
    assert len(found.names) > MANY_PARAMETERS
    own = [found.start.parameters[n] for n in found.names]
    residuals, J = found.problem.evaluate(found.solution.v)
    scale, prior = (np.array([getattr(p, name) for p in own]) for name in ("scale", "prior"))
    departure = (found.estimate - [p.value for p in own]) / scale
    pull = (J.T @ residuals[0].ravel() + departure * (scale / prior) ** 2) / np.linalg.norm(J, axis=0)
    held = np.isin(found.names, found.at_bounds)
    assert held.any() == narrow
    assert np.abs(pull[~held]).max() < 1e-3
    assert np.all((pull * departure)[held] < 0)
    if narrow:  # the search begins where Gauss-Newton steps lead, which is an optimum to Ipopt but for the bounds
        start = found.problem.cost(np.zeros(len(own)))
        assert found.solution.history[0] - found.solution.history[-1] < 0.1 * (start - found.solution.history[-1])


def test_correlated_priors_are_those_of_the_normal_distribution(measured) -> None:
    """At the optimum the gradient of data and prior together is zero, with the prior's inverse covariance as it is."""
    found = identify(ARM, measured, ["kinematic"], priors=True)
    names = found.names[-3:]
    width = np.array([found.start.parameters[n].prior for n in names])
    C = 1e-4 * np.outer(width, width) * (0.1 * np.eye(3) + 0.9)
    problem = replace(found.problem, correlated=((names, C),))
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


def test_the_misfit_is_that_of_all_poses(measured) -> None:
    """As they were measured at once, and in parts whose rows are not kept."""
    usual = wide_fit(identify(ARM, measured, ["kinematic"], priors=True))
    parts = wide_fit(identify(ARM, [measured[:7], measured[7:]], ["kinematic"], priors=True), max_cached=0)
    assert [len(r) for r, *_ in parts.poses] == [7, 53]
    assert parts.misfit == pytest.approx(usual.misfit, rel=1e-9)
    assert parts.coordinate_sigma == pytest.approx(usual.coordinate_sigma, rel=1e-9)
    assert parts.best.log_likelihood == pytest.approx(usual.best.log_likelihood, rel=1e-9)
    assert len(parts.poses) == len(usual.poses) == 60


def test_remaining_errors_of_some_poses_are_about_those_of_all(found) -> None:
    usual = learn_remaining(found)
    most = (2 * usual.poses) // 3
    some = learn_remaining(found, most)
    assert abs(some.poses - most) <= 1
    assert some.rest == pytest.approx(usual.rest, rel=0.3)
