"""The compensator as a whole: it helps where it can, refuses where it cannot, and survives a file."""

import dataclasses
import os

import numpy as np
import pytest

from casadical.compensator import (
    Backprop,
    Compensator,
    Iwo,
    IwoSettings,
    IwoThenLm,
    Layout,
    LevenbergMarquardt,
    load_compensator,
    save_compensator,
)
from casadical.compensator.compensator import BeforeAfter, Errors
from casadical.compensator.trainers.registry import trainers_by_name
from casadical.core.basics import InputError
from problems import smooth

QUICK = LevenbergMarquardt(restarts=2, iterations=30, ridges=(0.1, 0.01, 0.001), folds=3, fold_starts=2)


@pytest.fixture(scope="module")
def helping():
    return Compensator.fit(*smooth(50, 0), validate=smooth(300, 1), trainer=QUICK)


@pytest.fixture(scope="module")
def refused():
    q, residual = smooth(50, 0)
    assert not Compensator.fit(q, 0 * residual, trainer=Backprop(steps=20)).helps  # nothing is divided by zero
    return Compensator.fit(q, np.random.default_rng(5).normal(0, 0.1, residual.shape), trainer=QUICK)


def test_helps_on_a_smooth_residual_and_its_figures_are_true(helping):
    assert helping.helps
    for data, row in ((smooth(50, 0), helping.training), (smooth(300, 1), helping.validation)):
        length = np.linalg.norm(data[1] - helping.correction_mm(data[0]), axis=1)
        figures = (row.after.mean_mm, row.after.max_mm, row.after.std_mm)
        assert figures == pytest.approx((length.mean(), length.max(), length.std(ddof=1)), rel=1e-12)
    assert helping.validation.after.mean_mm < 0.6 * helping.validation.before.mean_mm


def test_cross_validation_agrees_with_fresh_poses(helping):
    """The cross-validated error is an estimate of the held-out one: within a factor that luck would not reach."""
    assert 0.7 < helping.choice.after.mean_mm / helping.validation.after.mean_mm < 2


def test_refuses_noise_in_words_and_corrects_nothing(refused):
    assert not refused.helps
    assert refused.network is None
    assert refused.verdict.startswith("The network does not help here, nothing is corrected")
    np.testing.assert_array_equal(refused.correction_mm(smooth(4, 0)[0]), np.zeros((4, 3)))
    np.testing.assert_array_equal(refused.correction_mm(np.zeros(6)), np.zeros(3))
    function = refused.function()
    assert (function.name(), function.name_in(), function.name_out()) == ("network", ["q"], ["dp"])
    np.testing.assert_array_equal(np.asarray(function(np.ones(6))).ravel(), np.zeros(3))


@pytest.mark.slow
def test_noise_is_seldom_taken_for_a_residual():
    """Of 20 data sets of pure noise at most 5 pass (with the margin of one standard error, 16 % if it were exact)."""
    q, residual = smooth(30, 0)
    random, passed = np.random.default_rng(6), 0
    trainer = LevenbergMarquardt(restarts=1, iterations=20, ridges=(0.1, 0.01), folds=3, fold_starts=1)
    for _ in range(20):
        passed += Compensator.fit(q, random.normal(size=residual.shape), trainer=trainer, folds=3).helps
    assert passed <= 5


def test_refusal_follows_the_margin():
    q, residual = smooth(50, 0)
    trainer = Backprop(steps=150)
    choice = Compensator.fit(q, residual, trainer=trainer).choice
    above = choice.gain / choice.gain_error + 0.1
    said = f"(gain {100 * choice.gain:.1f} % +/- {100 * choice.gain_error:.1f} %)"
    assert said in Compensator.fit(q, residual, trainer=trainer).verdict
    assert not Compensator.fit(q, residual, trainer=trainer, margin=above).helps
    assert Compensator.fit(q, residual, trainer=trainer, margin=above - 0.2).helps


def test_a_set_of_its_own_may_decide():
    q, residual = smooth(50, 0)
    good = Compensator.fit(q, residual, choose=smooth(50, 2), trainer=QUICK)
    other_q, other = smooth(50, 2)
    bad = Compensator.fit(q, residual, choose=(other_q, -other), trainer=QUICK)
    assert good.helps
    assert good.choice.before.poses == 50
    assert "of its own" in good.verdict
    assert not bad.helps
    # the deciding poses were not trained on: both are the same network
    assert good.training == bad.training


def test_validation_has_no_part_in_the_choice():
    q, residual = smooth(50, 0)
    other_q, other = smooth(50, 2)
    with_lie = Compensator.fit(q, residual, validate=(other_q, -other), trainer=QUICK)
    assert with_lie.helps
    assert with_lie.validation.gain < 0


def test_growing_maximum_is_said(helping):
    before, after = np.zeros((2, 4, 3))
    before[:, 0], after[3, 0] = 1, 1.5
    worse = dataclasses.replace(helping, choice=BeforeAfter.compare(before, after))
    assert "largest error grows: 1 -> 1.5 mm" in worse.verdict


def test_gain_error_against_the_bootstrap():
    random = np.random.default_rng(0)
    before = random.normal(size=(400, 3))
    after = 0.6 * before + 0.3 * random.normal(size=(400, 3))
    row = BeforeAfter.compare(before, after)
    was, now = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
    draws = random.integers(0, 400, (2000, 400))
    spread = (1 - now[draws].mean(axis=1) / was[draws].mean(axis=1)).std()
    assert row.gain == pytest.approx(1 - now.mean() / was.mean())
    assert row.gain_error == pytest.approx(spread, rel=0.1)


def test_errors_by_hand():
    errors = Errors.summarise(np.array([[3.0, 4, 0], [0, 0, 1]]))
    assert errors == Errors(2, 3.0, 5.0, 8**0.5)


@pytest.mark.parametrize("name", trainers_by_name())
def test_every_trainer_by_name(name):
    trainer = {"iwo": Iwo(IwoSettings(iterations=150)), "lm": QUICK, "iwo-lm": IwoThenLm(lm=QUICK)}.get(name, name)
    compensator = Compensator.fit(*smooth(40, 0), trainer=trainer, folds=2)
    assert compensator.trainer == name
    assert compensator.helps


def test_inside_the_trained_box(helping):
    low, high = np.array(helping.trained_box.lower), np.array(helping.trained_box.upper)
    q = np.array([low, high, high + 1e-9, low - 1e-9])
    np.testing.assert_array_equal(helping.inside(q), [True, True, False, False])


def test_seven_joints_and_periodic_inputs():
    q, residual = smooth(60, 0)
    q = np.hstack([q, np.random.default_rng(0).uniform(-np.pi, np.pi, (60, 1))])
    layout = Layout(joints=7, hidden=(4, 3), periodic=(6,))
    compensator = Compensator.fit(q, residual, layout=layout, trainer=QUICK, folds=2)
    turned = q + np.array([0, 0, 0, 0, 0, 0, 2 * np.pi])
    np.testing.assert_allclose(compensator.correction_mm(turned), compensator.correction_mm(q), atol=1e-12)


@pytest.mark.parametrize("which", ["helping", "refused"])
def test_file_gives_back_every_bit(which, request, tmp_path):
    compensator = request.getfixturevalue(which)
    save_compensator(compensator, tmp_path / "c.json")
    loaded = load_compensator(tmp_path / "c.json")
    assert str(loaded) == str(compensator)
    assert loaded.helps == compensator.helps
    q = smooth(20, 8)[0]
    assert loaded.correction_mm(q).tobytes() == compensator.correction_mm(q).tobytes()
    save_compensator(loaded, tmp_path / "d.json")
    assert (tmp_path / "d.json").read_bytes() == (tmp_path / "c.json").read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["c.json", "d.json"]


def test_every_truncation_and_every_changed_number_is_refused(helping, tmp_path):
    path = tmp_path / "c.json"
    save_compensator(helping, path)
    text = path.read_text()
    for stop in range(0, len(text) - 2, max(1, len(text) // 150)):
        path.write_text(text[:stop])
        with pytest.raises(InputError, match="truncated"):
            load_compensator(path)
    digits = [i for i, character in enumerate(text) if character.isdigit()]
    for at in digits[:: max(1, len(digits) // 300)]:
        path.write_text(text[:at] + str((int(text[at]) + 1) % 10) + text[at + 1 :])
        with pytest.raises(InputError):
            load_compensator(path)


@pytest.mark.parametrize(
    "text", ["[]", "null", '{"format": "casadical-compensator", "version": 1, "x": NaN}', "[" * 99999]
)
def test_strange_files_are_refused(text, tmp_path):
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(InputError):
        load_compensator(tmp_path / "c.json")


def test_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.json"):
        load_compensator(tmp_path / "nothing.json")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros((50, 5))}, "6"),
        ({"residual_mm": np.zeros((49, 3))}, r"\(50, 3\)"),
        ({"residual_mm": np.full((50, 3), np.nan)}, r"residual_mm\[0, 0\] is nan"),
        ({"q": np.zeros((9, 6)), "residual_mm": np.zeros((9, 3))}, "too few"),
        ({"q": [["a"] * 6] * 50}, "numbers"),
        ({"residual_mm": np.zeros(50), "layout": None}, r"its shape is \(50,\)"),
        ({"residual_mm": 0.5, "layout": None}, r"shape \(50, outputs\) \[mm\].*its shape is \(\)"),
        ({"q": 0.5, "layout": None}, r"shape \(n, joints\) \[rad\]; its shape is \(\)"),
        ({"folds": 1}, "folds"),
        ({"margin": -1.0}, "margin"),
        ({"trainer": "adam"}, "backprop, iwo, lm, iwo-lm"),
        ({"validate": (np.zeros((3, 6)), np.zeros((2, 3)))}, r"\(3, 3\)"),
        ({"output_scale_mm": 0.0}, "output_scale_mm"),
    ],
)
def test_wrong_input_is_named(change, message):
    q, residual = smooth(50, 0)
    arguments = {"q": q, "residual_mm": residual, "layout": Layout(), "trainer": Backprop(steps=1)} | change
    with pytest.raises(InputError, match=message):
        Compensator.fit(**arguments)
