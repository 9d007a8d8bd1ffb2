"""Combinations of a curve's columns against the columns themselves: fewer numbers, the same answers."""

from dataclasses import replace

import numpy as np
import pytest
from cases import case

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import Factors, combined, directions_of
from casadical.diagnosis.cross_validation import fit_of, fold_errors, new_fit, random_folds
from casadical.diagnosis.evidence import Evidence
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import EffectColumns
from casadical.diagnosis.noise_evidence import Form, Problem
from casadical.diagnosis.settings_search import learnt_sizes
from casadical.measurements.measurements import Noise

NOISE = Noise(2e-5, 4e-6)


@pytest.fixture(scope="module")
def known() -> Case:
    return case("kr210-P02", "joint_error_curve", "backlash")


@pytest.fixture(scope="module")
def curve(known: Case) -> Array:
    return known.group(next(c for c in known.candidates if c.label == "joint_error_curve").variants[0])


@pytest.fixture(scope="module")
def backlash(known: Case) -> list[Array]:
    return [known.group(c.variants[0]) for c in known.candidates if c.name == "backlash"]


@pytest.fixture(scope="module")
def apart(known: Case) -> Evidence:
    """The same problem without combinations."""
    e = known.evidence
    assert isinstance(e.E, EffectColumns)
    return replace(e, E=replace(e.E, directions=()))


def test_a_curve_over_a_part_of_a_turn_has_few_directions(known: Case, curve: Array, apart: Evidence) -> None:
    every = known.evidence.combined(curve)
    assert len(curve) == 720
    assert every.width < 450
    assert apart.combined(curve).width == 720


def test_the_evidence_is_that_of_the_columns(known: Case, curve: Array, backlash: list[Array], apart: Evidence) -> None:
    with_curve = np.union1d(curve, backlash[0])
    for beside, groups in ((None, [curve, *backlash]), (curve, backlash), (with_curve, backlash[1:])):
        found, expected = (e.log_grids(groups, beside).max(axis=(1, 2, 3)) for e in (known.evidence, apart))
        assert found == pytest.approx(expected, abs=1e-4)
        assert known.evidence.log_base(beside) == pytest.approx(apart.log_base(beside), abs=1e-4)


def test_sums_by_another_set_of_poses_are_combined_alike(known: Case, curve: Array, backlash: list[Array]) -> None:
    known.evidence.log_grids([curve, *backlash])
    kept = known.inliers.copy()
    kept[[3, 11]] = False
    fewer = known.with_inliers(kept)
    anew = known.whole.at(np.flatnonzero(kept))
    for beside in (None, curve):
        found, expected = (e.log_grids(backlash, beside).max(axis=(1, 2, 3)) for e in (fewer.evidence, anew))
        assert found == pytest.approx(expected, abs=1e-4)


def test_other_forms_of_noise_are_judged_alike(known, curve, backlash, apart):
    chosen = np.union1d(curve, backlash[0])
    for form in (Form(), Form(joint=1, repeatability_factor=8.0), Form(ar_coefficient=0.6)):
        found, expected = (
            Problem(e, chosen, np.arange(len(e.r))).log_likelihood(form) for e in (known.evidence, apart)
        )
        assert found == pytest.approx(expected, abs=1e-4)


def test_fits_predict_and_estimate_alike(known: Case, curve: Array, backlash: list[Array], apart: Evidence) -> None:
    chosen = np.union1d(curve, backlash[0])
    folds = random_folds(len(apart.r), 0)
    few, all_ = (new_fit(e, chosen, NOISE) for e in (known.evidence, apart))
    assert len(few.x) < len(all_.x) == len(few.mean) - len(few.x) + len(all_.mean)
    assert fold_errors(apart, few, folds) == pytest.approx(fold_errors(apart, all_, folds), abs=1e-10)
    fits = (fit_of(e, chosen, NOISE).causes for e in (known.evidence, apart))
    for one, other in zip(*fits, strict=True):
        assert one == pytest.approx(other, abs=1e-5)


def test_sizes_are_learnt_alike(known: Case, curve: Array, backlash: list[Array], apart: Evidence) -> None:
    parts = next(c for c in known.candidates if c.label == "joint_error_curve").variants[0][0].parts
    for beside in (backlash[0][:0], backlash[0]):
        found, expected = (learnt_sizes(e, curve, parts, beside, NOISE) for e in (known.evidence, apart))
        assert found[0] == pytest.approx(expected[0], rel=1e-5)
        assert found[1].sigma == pytest.approx(expected[1].sigma, rel=1e-6)


def test_columns_stay_as_they_are_unless_a_whole_part_is_there() -> None:
    part, V = np.arange(4, 8), np.linalg.qr(np.random.default_rng(0).standard_normal((4, 2)))[0]
    every = combined(np.arange(2, 10), [(part, V)])
    assert every.width == 6
    x = np.arange(8.0)
    assert every.combine(x) == pytest.approx(np.concatenate([x[:2], V.T @ x[2:6], x[6:]]))
    assert every.values(every.combine(x)) == pytest.approx(np.concatenate([x[:2], V @ V.T @ x[2:6], x[6:]]))
    assert every.places(np.arange(1, 6)).tolist() == [1, 2, 3]
    assert every.per_combination(np.repeat([1.0, 5.0, 2.0], [2, 4, 2])).tolist() == [1, 1, 5, 5, 2, 2]
    assert every.sum_over_dropped(np.repeat([1.0, 5.0, 2.0], [2, 4, 2])) == 10.0
    assert combined(np.array([4, 5, 6]), [(part, V)]).width == 3
    assert combined(np.zeros(0, dtype=np.int64), [(part, V)]).width == 0


def test_directions_that_move_nothing_are_left_out() -> None:
    C = np.diag([1e-3, 1e-6, 1e-9, 0.0])
    assert np.abs(directions_of(C @ C, 3e-9)).max(axis=1).tolist() == pytest.approx([1, 1, 0, 0])


def test_a_joint_that_moves_no_pose_has_no_combinations() -> None:
    """As the last joint of a robot whose measured point lies on its axis."""
    idle, other = np.arange(4), np.arange(4, 6)
    every = combined(np.arange(6), [(idle, np.zeros((4, 0))), (other, np.eye(2))])
    rng = np.random.default_rng(0)
    factors = Factors(((0, idle, rng.normal(size=(4, 5))), (1, other, rng.normal(size=(2, 5)))), 6)
    S = rng.normal(size=(5, 3, 2))
    assert factors.combined(every).columns_at(S) == pytest.approx(factors.columns_at(S)[:, :, 4:])
    assert every.places(idle).tolist() == []
    assert every.values(np.array([7.0, 8.0])).tolist() == [0, 0, 0, 0, 7, 8]
    assert combined(idle, [(idle, np.zeros((4, 0)))]).combine(np.ones(4)).shape == (0,)
