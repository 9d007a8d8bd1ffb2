"""Autocorrelated noise, has heavy tails, or comes from one joint: evidence by brute force, and campaigns."""

import re
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cases import case, diagnose, robot, simulated, with_none
from planted import misread, planted
from scipy import stats
from scipy.optimize import brentq
from scipy.signal import lfilter
from scipy.stats import chi2

from casadical.blind_check.mujoco_physics.cause import Cause
from casadical.core.basics import Array
from casadical.core.linear_gaussian.model import MemoryLimits
from casadical.diagnosis.evidence import RHO_GRID, SIGMA_GRID_M, Evidence, NoisePrior
from casadical.diagnosis.noise_evidence import (
    MAX_ESTIMATE_ERROR,
    MIN_ESTIMATED_COLUMNS,
    WHITE_FORM,
    Form,
    Problem,
    prewhitened,
)
from casadical.diagnosis.noise_forms import ar_form, heavy_tailed_form, noise_forms, noisy_joint, unequal_forms
from casadical.diagnosis.settings import SETTINGS
from casadical.diagnosis.structure import _WhitenedResidual
from casadical.diagnosis.text import as_json, page_of
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import Measurements

NONE = np.zeros(0, dtype=np.int64)


def small(poses: int = 14) -> Evidence:
    """A problem of few poses, its base model known well enough to be no more than a covariance."""
    c = case("kr210-P02")
    # Wide priors would make the covariance, by which it is checked, singular in double precision.
    J, prior = c.base.J[c.inliers][:poses], np.minimum(c.base.prior, 1e-4)
    e = replace(
        c.evidence.at(np.arange(poses)), J=J, prior=prior, delta0=0 * prior, noise_prior=NoisePrior(), absorbed=0.0
    )
    return replace(e, E=np.zeros((poses, 3, 1)), cause_prior=None)


def density(e: Evidence, rho: int, sigma: float, correlation: Array, joints: Sequence[float] | Array) -> float:
    """Log density of the residuals by their whole covariance. correlation : of poses, of the instrument's noise"""
    noise = np.kron(correlation, np.eye(3))
    for k, Jq in enumerate(e.Jq):
        at = slice(3 * k, 3 * k + 3)
        noise[at, at] += RHO_GRID[rho] ** 2 * (Jq * np.square(joints)) @ Jq.T
    J = e.J.reshape(e.r.size, -1)
    covariance = sigma**2 * (noise + J @ np.diag((e.prior / e.reference) ** 2) @ J.T)
    r = (e.r - e.J @ e.delta0).ravel()
    return float(stats.multivariate_normal(cov=covariance).logpdf(r))


def problem(e: Evidence, order: Array | None = None, columns: int = 0) -> Problem:
    """A problem with some of its base parameters among the causes; with many, it is judged by its covariance."""
    if not columns:
        return Problem(e, NONE, np.arange(len(e.r)) if order is None else order)
    rng = np.random.default_rng(3)
    E = 2e-5 * rng.standard_normal((len(e.r), 3, columns))
    own = replace(e, E=E, cause_prior=np.full(columns, 0.1))
    return Problem(own, np.arange(columns), np.arange(len(e.r)) if order is None else order)


@pytest.fixture(params=[0, 7, 40], ids=["base model alone", "and 7 columns", "more columns than numbers"])
def columns(request: pytest.FixtureRequest) -> int:
    return int(request.param)


def with_causes(p: Problem) -> Evidence:
    """The problem with its causes' columns in the base model."""
    return replace(p.e.with_base(p.chosen), E=np.zeros((len(p.e.r), 3, 1)), cause_prior=None)


def test_the_evidence_of_noise_that_follows_itself_is_that_of_its_covariance(columns: int) -> None:
    at, order = 16, np.random.default_rng(0).permutation(14)
    p = problem(small(), order, columns)
    e = with_causes(p)
    steps = np.abs(np.subtract.outer(np.argsort(order), np.argsort(order)))
    plain = e.log_base()[0, at] - density(e, 0, SIGMA_GRID_M[at], np.eye(14), np.ones(6))
    assert p.log_likelihood(Form())[0, at] == pytest.approx(e.log_base()[0, at], abs=1e-5)
    for stays in SETTINGS.ar_coefficients:
        found = p.log_likelihood(ar_form(stays, 14))[0, at]
        assert found - density(e, 0, SIGMA_GRID_M[at], stays**steps, np.ones(6)) == pytest.approx(plain, abs=1e-5)


def test_the_evidence_of_a_scattering_joint_is_that_of_its_covariance(columns: int) -> None:
    at, p = 16, problem(small(), columns=columns)
    e = with_causes(p)
    plain = e.log_base()[0, at] - density(e, 0, SIGMA_GRID_M[at], np.eye(14), np.ones(6))
    worse = np.where(np.arange(6) == 2, SETTINGS.noisy_joint_factor, 1.0)
    found = p.log_likelihood(Form(joint=2, repeatability_factor=SETTINGS.noisy_joint_factor))
    for rho in (0, 3):
        assert found[rho, at] - density(e, rho, SIGMA_GRID_M[at], np.eye(14), worse) == pytest.approx(plain, abs=1e-5)


def test_poses_far_out_are_weighed_down_and_paid_for(columns: int) -> None:
    at, e = 12, small(40)
    rng = np.random.default_rng(1)
    r = SIGMA_GRID_M[at] * rng.standard_normal((40, 3))
    assert heavy_tailed_form(problem(replace(e, r=r))) is None
    r[[5, 20]] += 6 * SIGMA_GRID_M[at]
    p = problem(replace(e, r=r), columns=3 * columns)
    far = with_causes(p)
    found = heavy_tailed_form(p)
    assert found is not None
    times = np.where(np.isin(np.arange(40), (5, 20)), SETTINGS.tail_noise_factor, 1.0)
    assert found.scale == pytest.approx(times)
    shares = 2 * np.log(SETTINGS.tail_share) + 38 * np.log(1 - SETTINGS.tail_share)
    plain = far.log_base()[0, at] - density(far, 0, SIGMA_GRID_M[at], np.eye(40), np.ones(6))
    exact = density(far, 0, SIGMA_GRID_M[at], np.diag(times**2), np.ones(6)) + shares
    assert p.log_likelihood(found)[0, at] - exact == pytest.approx(plain, abs=1e-5)


AXES = {"x, y and z": 0, "fixed axes": 1, "line of sight": 2}


@pytest.mark.parametrize("which", AXES.values(), ids=AXES)
def test_noise_that_is_unequal_along_some_axes_is_judged_by_its_covariance(which: int, columns: int) -> None:
    at, e, times, rng = 12, small(40), np.array([4.0, 0.5, 0.5]), np.random.default_rng(1)
    places = rng.uniform(1, 3, (40, 3)) * rng.choice([-1, 1], (40, 3))
    sight = places / np.linalg.norm(places, axis=1, keepdims=True)
    first = (np.eye(3)[:1], np.array([[0.6, 0.0, 0.8]]), sight)[which]  # along which it is worse
    white = SIGMA_GRID_M[at] * times[1] * rng.standard_normal((40, 3))
    r = white + (times[0] / times[1] - 1) * (white * first).sum(axis=1, keepdims=True) * first
    p = problem(replace(e, r=r), columns=columns)
    far, every = with_causes(p), unequal_forms(p, places)
    found = every[which]
    if columns == 40:  # a fit with as many columns as numbers leaves no residual to be unequal
        return
    assert found is not None
    assert found.scale is not None
    own = found.scale[0]
    R = np.tile(np.eye(3), (40, 1, 1)) if found.axes is None else found.axes
    assert (np.abs((R[:, own.argmax()] * first).sum(axis=1)) > 0.95).all()  # the worst axis is the true one
    assert own.max() / np.sort(own)[1] > 0.5 * times[0] / times[1]
    logs = [-np.inf if f is None else p.log_likelihood(f).max() for f in every]
    assert np.argmax(logs) == which
    turned = replace(far, r=np.einsum("nij,nj->ni", R, far.r), J=R @ far.J, Jq=R @ far.Jq)
    scaled = replace(turned, r=turned.r / own, J=turned.J / own[:, None], Jq=turned.Jq / own[:, None])
    plain = far.log_base()[3, at] - density(far, 3, SIGMA_GRID_M[at], np.eye(40), np.ones(6))
    paid = 40 * np.log(own).sum() + 0.5 * (2, 5, 2)[which] * np.log(40)
    exact = density(scaled, 3, SIGMA_GRID_M[at], np.eye(40), np.ones(6)) - paid
    assert p.log_likelihood(found)[3, at] - exact == pytest.approx(plain, abs=1e-5)


def test_an_estimated_gain_is_near_that_of_the_likelihood_and_hardly_below() -> None:
    e, rng = small(40), np.random.default_rng(4)
    turned = np.linalg.qr(rng.standard_normal((40, 3, 3)))[0]
    for form in (
        *(ar_form(share, 40) for share in (0.3, 0.6)),
        *(Form(joint=j, repeatability_factor=SETTINGS.noisy_joint_factor) for j in range(6)),
        Form(scale=np.where(np.arange(40) < 5, 4.0, 1.0), log_weight=-2.0),
        Form(axes=turned, scale=np.tile([1.5, 1.0, 0.7], (40, 1))),
        Form(lags=1e-3 * rng.standard_normal((40, 3))),
    ):
        p = problem(replace(e, r=SIGMA_GRID_M[12] * rng.standard_normal((40, 3))), columns=7)
        exact, white = (np.logaddexp.reduce(p.log_likelihood(f), axis=None) for f in (form, WHITE_FORM))
        estimate, gain = p.estimated_gain(form), exact - white
        assert gain < estimate + MAX_ESTIMATE_ERROR * abs(estimate) + 1.0
        assert form.ar_coefficient or estimate == pytest.approx(gain, abs=2.0, rel=0.6)
        assert p.may_gain(form, np.inf)  # few columns are not estimated
    assert p.estimated_gain(WHITE_FORM) == 0.0


def test_forms_that_a_cause_outweighs_are_no_rivals() -> None:
    c = case("kr210-P02", "joint_error_curve", "backlash")
    chosen = c.group(next(own for own in c.candidates if own.label == "joint_error_curve").variants[0])
    assert len(chosen) > MIN_ESTIMATED_COLUMNS  # fewer are not estimated
    assert noise_forms(c, chosen)
    assert not noise_forms(c, chosen, lead=1e6)


def test_noise_of_one_size_is_unequal_along_no_axes() -> None:
    e, rng = small(40), np.random.default_rng(2)
    r = SIGMA_GRID_M[12] * rng.standard_normal((40, 3))
    assert unequal_forms(problem(replace(e, r=r)), rng.uniform(1, 3, (40, 3))) == [None, None, None]


def test_sums_in_parts_are_those_of_all_poses() -> None:
    e = replace(case("kr210-P02").evidence, near=(1, 2))
    form = [
        ar_form(0.6, len(e.r)),
        Form(joint=1, repeatability_factor=SETTINGS.noisy_joint_factor),
        Form(scale=1.0 + (np.arange(len(e.r)) % 9 == 0)),
    ]
    order = np.random.default_rng(0).permutation(len(e.r))
    whole, parts = (
        Problem(e, NONE, order),
        Problem(replace(e, memory=MemoryLimits(cache_bytes=0, part_bytes=1)), NONE, order),
    )
    for f in form:
        assert parts.log_likelihood(f)[1:3] == pytest.approx(whole.log_likelihood(f)[1:3], abs=1e-6)
        assert parts.residual(f, 1) == pytest.approx(whole.residual(f, 1), abs=1e-12)


def scatter(joint: int, size_rad: float) -> Cause:
    """Return one joint that repeats worse than the others."""
    return misread(joint, lambda stops: size_rad * np.random.default_rng(0).standard_normal(len(stops)))


@pytest.mark.slow
@pytest.mark.parametrize("size", [250e-6, 600e-6], ids=["smaller than the scatter", "larger"])
def test_beside_a_cause_a_joint_that_scatters_is_on_no_list(size: float) -> None:
    """The smaller cause is seen only with the scatter in the noise; else the scatter leads and ends the search."""
    hidden = planted("gear_eccentricity", 4, size=size)
    d = diagnose(robot("ur10e"), simulated("ur10e", 4, hidden, scatter(2, 60e-6), n=60))
    assert (d.verdict, [c.label for c in d.causes]) == ("unknown", ["gear_eccentricity@4"])
    assert d.rankings[-1].order[0] == "poor repeatability of joint 2"
    assert "most like poor repeatability of joint 2" in " ".join(page_of(d).split())
    np.testing.assert_array_equal(d.case.whole.Jq, d.case.observations.Jq)


def test_a_joint_scatters_in_a_ranking_where_its_scatter_leads_and_something_is_there() -> None:
    d = diagnose(robot("ur10e"), simulated("ur10e", 4, scatter(2, 80e-6), n=60), ["backlash"])
    assert noisy_joint(d.case, d.rankings[0]) == 2
    assert noisy_joint(d.case, with_none(d.rankings[0], 0.5)) is None


def test_noise_that_follows_itself_is_judged_again_without_the_last_pose() -> None:
    """No further pose follows another one then than before."""
    known = case("ur10e-P03").with_form(ar_form(0.6, int(case("ur10e-P03").inliers.sum())))
    assert np.isfinite(known.judged.log_base()).all()
    kept = known.inliers.copy()
    kept[np.flatnonzero(kept)[known.order[-1]]] = False
    fewer = known.with_inliers(kept)
    fresh = prewhitened(fewer.evidence, fewer.form, fewer.order)
    np.testing.assert_allclose(fewer.judged.log_base(), fresh.log_base(), rtol=1e-9)


@pytest.mark.slow
def test_autocorrelated_noise_given_a_cause_is_no_additional_one_but_in_doubt() -> None:
    m = simulated("ur10e", 5, planted("gear_eccentricity", 4, size=150e-6), n=60, noise_mm=0.002)
    white = np.random.default_rng(2).standard_normal((90, 3))
    noise = 2e-5 * lfilter([np.sqrt(1 - 0.8**2)], [1, -0.8], white, axis=0)[30:]
    assert m.position is not None
    d = diagnose(robot("ur10e"), replace(m, position=m.position + noise))
    # Only the fit knows this form of noise: it may be an effect that was not tried.
    assert (d.verdict, [c.label for c in d.causes]) == ("unknown", ["gear_eccentricity@4"])
    assert d.account.doubt
    assert d.causes[0].confidence > 0.92
    assert d.rankings[-1].noise_form == "autocorrelated noise"
    assert d.rankings[-1].none > 0.5
    assert as_json(d, "campaign")["noise"]["form"] == "autocorrelated noise"
    assert "more like autocorrelated noise than" in " ".join(page_of(d).split())


def path(amplitude: float, poses: int = 300) -> Measurements:
    """A path of poses close to each other; noise of which .75 stays; an error of joint 2 at 50 cycles a turn [rad]."""
    arm, rng, t = robot("ur10e"), np.random.default_rng(8), np.linspace(0, 1, poses)
    middle = np.array([(j.lower + j.upper) / 2 for j in arm.joints])
    q = middle + np.stack([1.2 * np.sin(2 * np.pi * (f * t + p)) for f, p in rng.uniform(0.5, 2.2, (6, 2))], axis=1)
    empty = Measurements(q, "position", np.zeros_like(q[:, :3]), conditions={"pose": np.arange(poses, dtype=float)})
    values = arm.parameters.values + 0.5 * rng.standard_normal(len(arm.parameters)) * [p.prior for p in arm.parameters]
    error = np.zeros_like(q)
    error[:, 1] = amplitude * np.sin(50 * q[:, 1] + 1)
    (p,) = arm.model.evaluate(("p",), q + error, empty.condition_matrix(arm.conditions, arm.declared), values)
    white = rng.standard_normal((poses + 50, 3))
    noise = 3e-5 * lfilter([np.sqrt(1 - 0.75**2)], [1, -0.75], white, axis=0)[50:]
    return replace(empty, position=p.T + noise)


@pytest.mark.slow
def test_a_line_is_found_beneath_noise_that_follows_itself() -> None:
    """The noise is thirty times as large as what the line leaves in the positions at its frequency."""
    effects = ["transmission_ripple", "frame_drift"]
    nothing, d = (diagnose(robot("ur10e"), path(a), effects) for a in (0.0, 3e-5))
    assert not nothing.causes
    assert [c.label for c in d.causes] == ["transmission_ripple@2"]
    assert d.causes[0].effects[0].cycles == pytest.approx(50, abs=0.3)  # type: ignore[attr-defined]
    assert d.case.form.ar_coefficient == pytest.approx(0.75, abs=0.2)
    assert d.rankings[0].none < 0.01


@pytest.mark.slow
def test_a_curve_of_many_harmonics_does_not_take_what_is_a_line_and_such_noise() -> None:
    """The curve follows both; the noise has its turn before it."""
    d = diagnose(robot("ur10e"), path(1e-4), ["transmission_ripple", "joint_error_curve"])
    assert [c.label for c in d.causes] == ["transmission_ripple@2"]
    assert d.case.form.ar_coefficient == pytest.approx(0.75, abs=0.2)


@pytest.mark.parametrize("lag", [8e-4, 0.0])
def test_readings_that_lag_by_one_random_size_a_stop_are_noise_along_the_last_move(lag: float) -> None:
    """The model that is identified from them is right at the true angles, which no reading had."""
    r, rng = robot("ur10e"), np.random.default_rng(3)
    q = np.array([0, -1.6, 0, 0, 0, 0]) + np.array([2.3, 1.2, 2.3, 2.3, 2.3, 2.3]) * rng.uniform(-1, 1, (150, 6))
    read = q + lag * rng.standard_normal((150, 1)) * np.diff(q, axis=0, prepend=q[:1])
    true = r.with_values({"theta2": r.parameters["theta2"].value + 1e-3, "a3": r.parameters["a3"].value + 5e-4})
    p, _ = predicted(true, Measurements(q, "position", position=np.zeros((150, 3))))
    position = p + rng.normal(0, 2e-5, p.shape)
    found = diagnose(r, Measurements(read, "position", position=position), ["backlash", "settling_lag"])
    said = [text for text in found.case.assumed if "lag behind its last motion" in text]
    assert (len(said), len(found.causes)) == (lag > 0, 0)
    at_true_angles, _ = predicted(found.apply(), Measurements(q, "position", position=p))
    assert np.linalg.norm(at_true_angles - p, axis=1).mean() < 3e-5
    for text in said:
        assert float(re.search(r"it, ([\d.]+) mrad per rad", text)[1]) == pytest.approx(1e3 * lag, rel=0.2)  # type: ignore[index]


@pytest.mark.parametrize(("square", "isotropic"), [(0.0, True), (27.7, True), (28.0, False)])
def test_isotropy_is_judged_by_mauchlys_test_at_a_ten_thousandth(square: float, isotropic: bool) -> None:
    """Of 300 residuals whose covariance is exactly diag(1, 1, c); the statistic has six degrees of freedom."""
    assert (chi2.sf(square, 6) > 1e-4) == isotropic
    statistic = lambda c: (300 - 1 - 17 / 18) * np.log(((2 + c) / 3) ** 3 / c) - square  # noqa: E731
    c = brentq(statistic, 1.0, 9.0) if square else 1.0
    whole = np.sqrt(300) * np.linalg.qr(np.random.default_rng(0).normal(size=(300, 3)))[0]
    y, frames = whole * [1.0, 1.0, np.sqrt(c)], {"x, y, z": np.tile(np.eye(3), (300, 1, 1))}
    residual = SimpleNamespace(squares=y**2, y=y, _frames=frames, _form=SimpleNamespace(ar_coefficient=0.0))
    residual.e = SimpleNamespace(poses_per_stop=1.0)
    assert _WhitenedResidual._isotropic(residual) is isotropic
