"""What a design can tell: against projections written out, and against the confusions that theory names."""

from functools import cache

import numpy as np
import pandas as pd
import pytest
from cases import practice, robot

from casadical.core.reporting.result import plain_text
from casadical.diagnosis.isolability import Isolability, isolability
from casadical.diagnosis.linear_problem import base_prior_sigmas
from casadical.diagnosis.linearisation import signatures
from casadical.effects import Backlash, BaseCompliance, FrictionWindup
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Noise

FIRST = {"hh800": "hh800-P01", "kr210": "kr210-P02", "ur10e": "ur10e-P03"}
WHITE = Noise(20e-6, 0.0)


@cache
def designed(name: str, whole: bool = False) -> Isolability:
    return isolability(robot(name), practice(FIRST[name]), "extended", whole=whole)


@pytest.fixture(scope="module")
def alike() -> dict[str, pd.DataFrame]:
    return {name: designed(name).alike for name in FIRST}


@pytest.fixture(scope="module")
def whole() -> dict[str, pd.DataFrame]:
    return {name: designed(name, whole=True).alike for name in FIRST}


def test_absorbed_and_visible_are_those_of_a_projection() -> None:
    """With the base's priors as extra rows, a pseudo-inverse gives the same shares."""
    effects = [BaseCompliance(), Backlash(3), FrictionWindup(3)]
    r = robot("kr210")
    found = isolability(r, practice("kr210-P02"), effects, noise=WHITE)
    m, _ = derive(practice("kr210-P02"), [c for e in effects for c in e.conditions])
    E, J, _ = signatures(r, effects, m, r.parameters.values)
    E = E.reshape(3 * len(m), -1) * [size for e in effects for size, _ in e.sizes().values()]
    scale = base_prior_sigmas(r)
    A = np.vstack([J.reshape(3 * len(m), -1) * scale, WHITE.sigma * np.eye(len(scale))])
    tall = np.vstack([E, np.zeros((len(scale), E.shape[1]))])
    rest = tall - A @ np.linalg.lstsq(A, tall, rcond=None)[0]
    own = {"base_compliance": [0, 1], "backlash@3": [2], "friction_windup@3": [3, 4]}
    for label, columns in own.items():
        row = found.effects.loc[label]
        size, left = (E[:, columns] ** 2).sum(), (rest[:, columns] ** 2).sum()
        assert row["size_mm"] == pytest.approx(1e3 * np.sqrt(size / len(m)))
        assert row["absorbed"] == pytest.approx(1 - left / size, rel=1e-6)
        assert row["visible_mm"] == pytest.approx(1e3 * np.sqrt(left / len(m)), rel=1e-6)
        assert row["visible_to_noise"] == pytest.approx(np.sqrt(left / (3 * len(m))) / WHITE.sigma, rel=1e-6)
        for rival, theirs in own.items():
            B = rest[:, theirs]
            reproduced = B @ np.linalg.lstsq(B, rest[:, columns], rcond=None)[0]
            assert found.alike.loc[label, rival] == pytest.approx((reproduced**2).sum() / left, abs=1e-6)


@pytest.mark.parametrize("name", ["hh800", *(pytest.param(n, marks=pytest.mark.slow) for n in ("kr210", "ur10e"))])
def test_what_no_position_can_show(name: str) -> None:
    """A wrong scale is longer links; joint 1 stands upright and has no torque."""
    table = designed(name).effects
    assert table.loc["tracker_scale", "absorbed"] > 0.999
    assert table.loc["tracker_scale", "findable_from"] > 100
    (row,) = (row for row in designed(name).blocks()[0].rows if row[0] == "tracker_scale")
    assert "never" in row
    assert table.loc["nonlinear_stiffness@1", "visible_mm"] < 1e-3
    assert table["absorbed"].between(0, 1).all()
    assert (table["visible_mm"] <= table["size_mm"] * (1 + 1e-9)).all()


def test_known_confusions(alike: dict[str, pd.DataFrame], whole: dict[str, pd.DataFrame]) -> None:
    for name in FIRST:
        assert alike[name].loc["gravity_compensator@2", "gear_eccentricity@2"] > 0.97
        assert whole[name].loc["joint_scale", "gear_eccentricity"] > 0.9
        assert whole[name].loc["load_hysteresis", "friction_windup"] > 0.85
        assert 0.2 < whole[name].loc["nonlinear_stiffness", "backlash"] < 0.7
        assert 0.3 < whole[name].loc["thermal_zero_drift", "frame_drift"] < 0.7
        # Not the other way round: an eccentricity on a full turn is no scale error.
        assert whole[name].loc["gear_eccentricity", "joint_scale"] < 0.6
    assert whole["hh800"].loc["link_flexure", "cross_coupling"] > 0.7
    assert whole["hh800"].loc["base_compliance", "axis_wobble"] == pytest.approx(0.67, abs=0.1)
    assert whole["hh800"].loc["thermal_growth", "thermal_zero_drift"] > 0.6


def test_poses_that_are_measured_many_times_show_the_same_errors() -> None:
    """The size of an error at a pose does not depend on how many poses there are."""
    m = practice("hh800-P01")
    tenfold = m[np.tile(np.arange(len(m)), 10)]
    once, often = (isolability(robot("hh800"), k, ["transmission_ripple"]).effects for k in (m, tenfold))
    np.testing.assert_allclose(often["size_mm"], once["size_mm"], rtol=1e-6)
    assert (often["findable_from"] < once["findable_from"]).all()


def test_missing_columns_are_named() -> None:
    from dataclasses import replace

    m = replace(practice("ur10e-P03"), conditions={})
    found = isolability(robot("ur10e"), m, ["thermal_growth", "backlash@2"])
    assert set(found.missing) == {"thermal_growth"}
    assert list(found.effects.index) == ["backlash@2"]


def test_page_and_json() -> None:
    found = isolability(robot("ur10e"), practice("ur10e-P03"), ["joint_scale@3", "gear_eccentricity@3"])
    text = plain_text(found.blocks(), 120)
    assert "joint_scale@3" in text
    assert f"gear_eccentricity@3 {found.alike.loc['joint_scale@3', 'gear_eccentricity@3']:.2f}" in text
    data = found.to_json("design")
    assert set(data) == {"campaign", "effects", "alike", "missing"}
    assert data["alike"]["joint_scale@3"]["gear_eccentricity@3"] > 0.9


def test_effects_that_look_equally_alike_stand_in_their_order() -> None:
    """Rounding of the shares had put either of two first, on one processor or another."""
    names = ["a", "b", "c"]
    for k in (1, -1):
        alike = pd.DataFrame([[1.0, 0.62, 0.62 + k * 1e-13]] * 3, index=names, columns=names)
        assert list(Isolability(pd.DataFrame(index=names), lambda _, alike=alike: alike, {}).rivals("a")) == ["b", "c"]
