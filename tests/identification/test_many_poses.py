"""What is told of an identification from many poses, which are not all kept in memory."""

from pathlib import Path

import pytest

import casadical
from casadical.identification import error_bound, misfit, residuals

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
