"""How far the gap shrinks: course, nonlinear refit, robots with causes applied, replicates, networks."""

from dataclasses import replace

import numpy as np
import pytest
from cases import case, diagnose, diagnosed, practice, robot, simulated
from planted import planted

from casadical import InputError
from casadical.compensator import LevenbergMarquardt
from casadical.diagnosis.cross_validation import held_out_errors, random_folds
from casadical.diagnosis.diagnose import Diagnosis
from casadical.diagnosis.evidence import SIGMA_GRID_M
from casadical.diagnosis.held_out_gap import check_refit, course, depends_on_time, network_gap, time_blocks
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_floor import replicates
from casadical.diagnosis.refit import refit
from casadical.effects import FrameDrift, FrictionWindup, ThermalGrowth
from casadical.identification.accuracy import errors, predicted
from casadical.identification.identification import identify
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements, Noise

FEW = ["friction_windup", "backlash"]
NOTHING = np.zeros(0, dtype=np.int64)


@pytest.fixture(scope="module")
def half() -> tuple[Diagnosis, Measurements]:
    """A diagnosis of 100 poses of a robot with friction in joint 2, and 60 poses that it never saw."""
    m = simulated("ur10e", 12, planted("friction_windup", 2, size=90e-6), n=160)
    m, _ = derive(m, [f"approach{i}" for i in range(1, 7)])
    return diagnose(robot("ur10e"), m[:100], FEW), m[100:]


def test_course_begins_and_ends_with_the_gap(half: tuple[Diagnosis, Measurements]) -> None:
    d, _ = half
    assert list(d.course["model"]) == ["base", "+ friction_windup@2"]
    assert d.course["gap_mm"].tolist() == pytest.approx([1e3 * d.gap.before, 1e3 * d.gap.after])
    assert (d.course["low_mm"] < d.course["gap_mm"]).all()
    assert (d.course["gap_mm"] < d.course["high_mm"]).all()
    np.testing.assert_allclose(d.course["loo_mm"], d.course["gap_mm"], rtol=0.1)
    assert (d.course["blocks_mm"] > 0.9 * d.course["gap_mm"]).all()


def doctored(signal: float, seed: int) -> tuple[Case, float]:
    """White noise of 20 um beside a signal that no base parameter can take over, and its rms [mm]."""
    c = case("ur10e-P09", "joint_scale@2")
    rng = np.random.default_rng(seed)
    wild = signal * rng.choice([-1.0, 1.0], (len(c.m), 3))
    r = wild + 20e-6 * rng.standard_normal((len(c.m), 3))
    whole = replace(c.whole, r=r, delta0=0 * c.whole.delta0)
    return replace(c, whole=whole, inliers=np.ones(len(c.m), dtype=bool)), 1e3 * signal * np.sqrt(3)


def test_noise_is_taken_off() -> None:
    noise = Noise(20e-6, 0.0)
    for signal in (60e-6, 120e-6):
        c, rms = doctored(signal, 0)
        folds = [random_folds(len(c.m), 0)]
        row = course(c, [("base", NOTHING, noise)], folds, noise, 0).iloc[0]
        # The wild signal pulls at the base a little: 40 parameters for 360 readings.
        assert row["model_mm"] == pytest.approx(rms, rel=0.15)
        assert row["model_low_mm"] <= row["model_mm"] <= row["model_high_mm"]
    c, _ = doctored(0.0, 1)
    row = course(c, [("base", NOTHING, noise)], [random_folds(len(c.m), 0)], noise, 0).iloc[0]
    assert row["model_mm"] < 0.5 * row["gap_mm"]


def test_blocks_are_contiguous_fifths_of_the_time() -> None:
    c = case("ur10e-P09", "joint_scale@2")
    time = c.m.conditions["time_s"][c.inliers]
    blocks = time_blocks(c)
    assert np.ptp(np.bincount(blocks)) <= 1
    assert all(time[blocks == k].max() < time[blocks == k + 1].min() for k in range(4))
    assert depends_on_time([FrameDrift()])
    assert depends_on_time([ThermalGrowth(None, 600.0)])
    assert not depends_on_time([FrictionWindup(2)])


def test_applied_causes_keep_their_promise_on_unseen_poses(half: tuple[Diagnosis, Measurements]) -> None:
    d, unseen = half
    base, better = (errors(r, unseen).mean() for r in (d.identification.robot, d.apply()))
    assert better < 0.6 * base
    assert better == pytest.approx(d.gap.after, rel=0.3)
    assert base == pytest.approx(d.gap.before, rel=0.3)
    assert errors(d.apply(top=0), unseen).mean() == pytest.approx(base, rel=0.1)


def test_refit_agrees_with_the_linearised_and_has_standard_errors(half: tuple[Diagnosis, Measurements]) -> None:
    d, _ = half
    seen: list[str] = []
    check = check_refit(d, seen.append)
    assert seen[-1] == "refits without a fifth each"
    assert check.agree
    assert check.refit == pytest.approx(check.linearised, rel=0.02)
    assert check.linearised == pytest.approx(d.gap.after, rel=0.05)
    table = d.refit().parameters.set_index("name")
    for name, (value, error, _) in d.causes[0].estimates.items():
        row = table.loc[f"friction_windup@2.{name}"]
        assert np.deg2rad(row["value"]) == pytest.approx(value, abs=2 * error)
        assert 0 < np.deg2rad(row["std_error"]) < 3 * error


def test_one_function_takes_robot_or_identification(half: tuple[Diagnosis, Measurements]) -> None:
    d, unseen = half
    seen: list[str] = []
    again = diagnose(d.identification, effects=FEW, show=seen.append)
    assert [s.split(":")[0] for s in seen if s.startswith("cause")] == ["cause 1", "cause 2"]
    assert [c.label for c in again.causes] == ["friction_windup@2"]
    assert again.gap == d.gap
    other = diagnose(d.identification, unseen, FEW)
    assert len(other.case.m) == 60
    with pytest.raises(InputError, match="measurements are missing"):
        diagnose(robot("ur10e"))


def rougher(m: Measurements, sigma: float) -> Measurements:
    assert m.position is not None
    return replace(m, position=m.position + sigma * np.random.default_rng(0).standard_normal(m.position.shape))


def scatter(d: Diagnosis) -> float:
    """Of a coordinate, instrument and joints together [m]."""
    return float(np.sqrt(np.trace(d.case.evidence.covariance(d.noise), axis1=1, axis2=2).mean() / 3))


def test_coarse_instrument_is_diagnosed_on_a_wider_grid() -> None:
    usual = diagnose(robot("ur10e"), practice("ur10e-P03"), FEW)
    assert len(usual.case.whole.sigmas) == len(SIGMA_GRID_M)
    rough = diagnose(robot("ur10e"), rougher(practice("ur10e-P03"), 6e-4), FEW)
    assert rough.verdict == "none"
    np.testing.assert_allclose(scatter(rough), 6e-4, rtol=0.1)
    np.testing.assert_allclose(rough.gap.floor, rough.gap.before, rtol=0.1)


def repeated(m: Measurements, times: int, sigma: float) -> Measurements:
    """The first twenty poses of a campaign measured again, with a noise of their own."""
    rng = np.random.default_rng(0)
    which = np.concatenate([np.arange(len(m)), *([np.arange(20)] * times)])
    again = m[which]
    position = again.position.copy()
    position[len(m) :] += sigma * rng.standard_normal((20 * times, 3))
    return replace(again, position=position, row=np.arange(len(again)) + 2)


def test_noise_of_repeated_poses() -> None:
    m = repeated(simulated("ur10e", 12), 3, 30e-6)
    r = m.position - m.position[np.concatenate([np.arange(100), *([np.arange(20)] * 3)])]
    everyone = np.ones(len(m), dtype=bool)
    found = replicates(m, r, everyone)
    assert (found.poses, found.groups, found.freedom) == (80, 20, 180)
    # One of the four has no noise here: three quarters of the variance, plus its mean's share.
    assert found.sigma == pytest.approx(30e-6 * np.sqrt(0.75), rel=0.15)
    assert found.enough
    loaded = replace(m, conditions={**m.conditions, "payload_kg": np.arange(len(m)) % 7.0})
    assert replicates(loaded, r, everyone).freedom <= 60
    assert not replicates(simulated("ur10e", 12), r[:100], everyone[:100]).enough


@pytest.mark.slow
def test_floor_is_that_of_repeated_poses() -> None:
    m = simulated("ur10e", 12, planted("friction_windup", 2, size=90e-6))
    once = diagnose(robot("ur10e"), repeated(m, 3, 5e-6), ["joint_scale@5"])
    assert once.replicates.enough
    assert once.gap.floor < 0.5 * diagnose(robot("ur10e"), m, ["joint_scale@5"]).gap.floor


@pytest.mark.slow
def test_network_is_refused_on_noise_and_used_on_a_smooth_error() -> None:
    quick = LevenbergMarquardt(restarts=1, iterations=60, ridges=(0.01,))
    c, _ = doctored(0.0, 2)
    found = network_gap(c, NOTHING, Noise(20e-6, 0.0), 0, quick)
    assert found.refused >= 4
    assert found.used == pytest.approx(found.before, rel=0.02)
    assert found.forced > found.before
    folds = random_folds(len(c.m), 0)
    assert found.before == pytest.approx(held_out_errors(c.evidence, NOTHING, Noise(20e-6, 0.0), folds).mean())
    bent = replace(c, whole=replace(c.whole, r=c.whole.r + 5e-4 * np.sin(3 * c.m.q[:, [1]])))
    found = network_gap(bent, NOTHING, Noise(1e-4, 0.0), 0, quick)
    assert found.refused == 0
    assert found.used < 0.7 * found.before


def test_refit_has_the_priors_of_the_evidence() -> None:
    """The optimum's gradient, from the data and from the robot that was given, by differences of our own."""
    found = diagnosed("ur10e-P03")
    fit = found.refit()
    given = found.case.given
    assert "c5" in fit.names
    at_optimum = fit.robot

    def cost(values: dict[str, float]) -> float:
        moved = at_optimum.with_values(values)
        m = fit.measurements[0]
        total = ((predicted(moved, m)[0] - m.position) ** 2).sum() / found.noise.sigma**2
        for p, sigma in zip(given.parameters, found.case.base.prior, strict=True):
            if p.name in fit.names and not p.name.startswith("base_"):
                total += ((moved.parameters[p.name].value - p.value) / sigma) ** 2
        return float(total) / 2

    for name in ("c2", "c5", "theta5", "d4"):
        k = fit.names.index(name)
        value, error = fit.estimate[k], fit.standard_errors[k]
        up, down = (cost({name: value + step * error}) for step in (0.5, -0.5))
        # At an optimum of this cost, steps of half a standard error cost alike either way.
        assert up > cost({}) < down
        assert abs(up - down) < 0.02 * (up + down - 2 * cost({}))
    wide = identify(found.case.robot.with_effect(*found.effects()), fit.measurements[0], fit.names, priors=True)
    assert wide.standard_errors[wide.names.index("c5")] > fit.standard_errors[fit.names.index("c5")]


def test_refit_leaves_out_outliers() -> None:
    found = diagnosed("ur10e-P06")
    kept = np.arange(len(found.case.m)) != 3
    case = replace(found.case, inliers=found.case.inliers & kept)
    wild = replace(case.m, position=case.m.position + np.where(kept, 0.0, 0.01)[:, None])
    first, second = (refit(replace(case, m=m), found.effects(), found.noise).robot for m in (case.m, wild))
    assert first.parameters.values == pytest.approx(second.parameters.values, abs=1e-12)
