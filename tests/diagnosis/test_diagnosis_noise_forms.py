"""Noise that follows itself, has heavy tails, or comes from one joint: evidence by brute force, and campaigns."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from cases import case, robot, simulated
from scipy import stats
from scipy.signal import lfilter

from casadical.blind_check.numpy_physics import Disturbance, disturbances
from casadical.blind_check.synthetic.stops import Stops, only
from casadical.core.arrays import Array
from casadical.diagnosis.diagnose import diagnose
from casadical.diagnosis.evidence import RHOS, SIGMAS, Evidence
from casadical.diagnosis.json_answer import as_json
from casadical.diagnosis.noise_forms import (
    FOLLOWS,
    SCATTERS,
    SHARE,
    TIMES,
    _following,
    _scattering,
    _tails,
    noise_forms,
)
from casadical.diagnosis.text import page_of

NONE = np.zeros(0, dtype=np.int64)


def small(poses: int = 14) -> Evidence:
    """A problem of few poses, its base model known well enough to be no more than a covariance."""
    e = case("kr210-P02").evidence.at(np.arange(poses))
    # Wide priors would make the covariance, by which it is checked, singular in double precision.
    prior = np.minimum(e.prior, 1e-4)
    return replace(e, E=np.zeros((poses, 3, 1)), held=None, repeats=(0.0, 0), prior=prior, delta0=0 * prior)


def density(e: Evidence, rho: int, sigma: float, correlation: Array, joints: Sequence[float] | Array) -> float:
    """Log density of the residuals by their whole covariance. correlation : of poses, of the instrument's noise"""
    noise = np.kron(correlation, np.eye(3))
    for k, Jq in enumerate(e.Jq):
        at = slice(3 * k, 3 * k + 3)
        noise[at, at] += RHOS[rho] ** 2 * (Jq * np.square(joints)) @ Jq.T
    J = e.J.reshape(e.r.size, -1)
    covariance = sigma**2 * (noise + J @ np.diag((e.prior / e.reference) ** 2) @ J.T)
    r = (e.r - e.J @ e.delta0).ravel()
    return float(stats.multivariate_normal(cov=covariance).logpdf(r))


def test_the_evidence_of_noise_that_follows_itself_is_that_of_its_covariance() -> None:
    e, at, order = small(), 16, np.random.default_rng(0).permutation(14)
    steps = np.abs(np.subtract.outer(np.argsort(order), np.argsort(order)))
    plain = e.log_base()[0, at] - density(e, 0, SIGMAS[at], np.eye(14), np.ones(6))
    for stays, (form, weight) in zip(FOLLOWS, _following(e, order), strict=True):
        found = form.log_base()[0, at] + weight - density(e, 0, SIGMAS[at], stays**steps, np.ones(6))
        assert found == pytest.approx(plain, abs=1e-5)


def test_the_evidence_of_a_scattering_joint_is_that_of_its_covariance() -> None:
    e, at, rho = small(), 16, 3
    plain = e.log_base()[0, at] - density(e, 0, SIGMAS[at], np.eye(14), np.ones(6))
    worse = np.where(np.arange(6) == 2, SCATTERS, 1.0)
    found = _scattering(e, 2).log_base()[rho, at] - density(e, rho, SIGMAS[at], np.eye(14), worse)
    assert found == pytest.approx(plain, abs=1e-5)


def test_poses_far_out_are_weighed_down_and_paid_for() -> None:
    e, at = small(40), 12
    rng = np.random.default_rng(1)
    r = SIGMAS[at] * rng.standard_normal((40, 3))
    assert _tails(replace(e, r=r)) is None
    r[[5, 20]] += 6 * SIGMAS[at]
    far = replace(e, r=r)
    found = _tails(far)
    assert found is not None
    times = np.where(np.isin(np.arange(40), (5, 20)), TIMES, 1.0)
    shares = 2 * np.log(SHARE) + 38 * np.log(1 - SHARE)
    plain = far.log_base()[0, at] - density(far, 0, SIGMAS[at], np.eye(40), np.ones(6))
    exact = density(far, 0, SIGMAS[at], np.diag(times**2), np.ones(6)) + shares
    assert found[0].log_base()[0, at] + found[1] - exact == pytest.approx(plain, abs=1e-5)


@dataclass(frozen=True)
class Scatter(Disturbance):
    """One joint repeats worse than the others, by `size` [rad]."""

    joint: int
    size: float

    def misread(self, stops: Stops) -> Array:
        return only(self.joint, self.size * np.random.default_rng(0).standard_normal(len(stops)))


def test_a_joint_that_scatters_is_no_cause() -> None:
    d = diagnose(robot("ur10e"), simulated("ur10e", 4, Scatter(2, 80e-6), n=60))
    assert (d.verdict, d.causes) == ("unknown", ())
    assert d.rankings[0].order[0] == "scatter of joint 2"
    assert "most like scatter of joint 2" in " ".join(page_of(d).split())
    found = {f.label: f.log_factor for f in noise_forms(d.case, NONE)}
    assert max(found, key=lambda k: found[k]) == "scatter of joint 2"


def test_beside_a_cause_a_joint_that_scatters_is_on_no_list() -> None:
    hidden = disturbances.GearEccentricity(4, 600e-6)
    d = diagnose(robot("ur10e"), simulated("ur10e", 4, hidden, Scatter(2, 60e-6), n=60))
    assert [c.label for c in d.causes] == ["gear_eccentricity@4"]
    assert d.verdict != "explained"
    assert d.rankings[-1].order[0] == "scatter of joint 2"


def test_beside_a_cause_noise_that_follows_itself_is_no_further_one() -> None:
    m = simulated("ur10e", 5, disturbances.GearEccentricity(4, 150e-6), n=60, noise_mm=0.002)
    white = np.random.default_rng(2).standard_normal((90, 3))
    noise = 2e-5 * lfilter([np.sqrt(1 - 0.8**2)], [1, -0.8], white, axis=0)[30:]
    assert m.position is not None
    d = diagnose(robot("ur10e"), replace(m, position=m.position + noise))
    assert (d.verdict, [c.label for c in d.causes]) == ("explained", ["gear_eccentricity@4"])
    assert d.rankings[-1].noise_form == "noise that follows itself"
    assert d.rankings[-1].none > 0.5
    assert as_json(d, "campaign")["noise"]["form"] == "noise that follows itself"
    assert "more like noise that follows itself than" in " ".join(page_of(d).split())
