"""The four-bar in closed form against a numeric solve of its closure, over the feasible range."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numeric_arm import hh800, pose, readings, rocker_angle, vector

from casadical.core.basics import InputError
from casadical.identification.plausibility import check_against
from casadical.measurements.reading import from_table
from casadical.robot import kinematics

PARALLELOGRAM = (0.8, 1.6, 0.8, 1.6)  # L5, L4, L3, ground
BARS = {"parallelogram": PARALLELOGRAM, "nearly": (0.803, 1.596, 0.798, 1.601), "other": (0.7, 1.65, 0.9, 1.5)}


def diagonal_end(crank, ground, bars):
    L5, _, _, g = bars
    return L5 * np.exp(1j * crank) - g * np.exp(1j * ground)


def closes(crank, ground, bars):
    """Whether some rocker angle brings its end to the coupler's, found by looking all the way round."""
    angles = np.linspace(0, 2 * np.pi, 20001)
    lengths = np.abs(diagonal_end(crank, ground, bars) - bars[2] * np.exp(1j * angles))
    return lengths.min() <= bars[1] <= lengths.max()


@pytest.mark.parametrize("name", BARS)
def test_closed_form_is_the_numeric_root_over_the_feasible_range(name):
    bars, compared = BARS[name], 0
    for ground in np.deg2rad(np.arange(30, 150, 8.0)):
        for between in np.deg2rad(np.arange(4, 177, 4.0)):
            crank = ground + between
            if kinematics.loop_margin(crank, ground, bars) < 1e-3:
                continue
            side = kinematics.assembly_side(np.deg2rad(180), np.deg2rad(90), bars)
            found = float(kinematics.rocker_angle(crank, ground, bars, side))
            expected = rocker_angle(crank, ground, bars, found)
            assert expected == pytest.approx(found, abs=1e-11)
            compared += 1
    assert compared > 400


def test_parallelogram_turns_the_rocker_with_the_crank():
    arm = hh800(compliance=False)
    for q in readings(arm, np.random.default_rng(0), 20):
        crank, ground = q[2], q[1]
        if kinematics.loop_margin(crank, ground, PARALLELOGRAM) < 1e-2:
            continue
        side = kinematics.assembly_side(np.pi, np.pi / 2, PARALLELOGRAM)
        assert kinematics.rocker_angle(crank, ground, PARALLELOGRAM, side) == pytest.approx(crank, abs=1e-12)
        # The same robot without loop, told the passive angle theta3 - theta2 - 90 deg.
        open_chain, told = replace(arm, loops=()), q.copy()
        told[2] = q[2] - q[1] - np.pi / 2
        closed = vector(arm.position, q, arm.parameters.values)
        np.testing.assert_allclose(closed, pose(open_chain, told)[:3, 3], rtol=0, atol=1e-11)


@settings(deadline=None, max_examples=100, derandomize=True)
@given(st.tuples(*[st.floats(0.3, 2.0)] * 4), st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi))
def test_margin_is_negative_exactly_where_the_loop_is_open(bars, crank, ground):
    assume(abs(diagonal_end(crank, ground, bars)) > 1e-3)
    margin = float(kinematics.loop_margin(crank, ground, bars))
    assume(abs(margin) > 1e-5)
    assert (margin > 0) == closes(crank, ground, bars)
    angle = float(kinematics.rocker_angle(crank, ground, bars, 1))
    assert np.isnan(angle) == (margin < 0)


@settings(deadline=None, max_examples=100, derandomize=True)
@given(
    st.tuples(*[st.floats(0.3, 2.0)] * 3),
    st.floats(-np.pi, np.pi),
    st.floats(-np.pi, np.pi),
    st.floats(-9, -1),
    st.sampled_from([1, -1]),
    st.sampled_from(["stretched", "folded"]),
)
def test_loop_closes_to_the_last_digits_next_to_its_ends(lengths, crank, ground, digits, side, end):
    # The coupler is chosen so that the loop stands next to where it opens.
    L5, L3, g = lengths
    diagonal = abs(diagonal_end(crank, ground, (L5, 0, L3, g)))
    L4 = diagonal + L3 - 10**digits if end == "stretched" else abs(diagonal - L3) + 10**digits
    assume(diagonal > 0.05 and diagonal + L3 > L4)
    bars = (L5, L4, L3, g)
    assert 0 < kinematics.loop_margin(crank, ground, bars) <= 1 + 1e-12
    rocker = float(kinematics.rocker_angle(crank, ground, bars, side))
    coupler = abs(diagonal_end(crank, ground, bars) - L3 * np.exp(1j * rocker))
    assert coupler == pytest.approx(L4, abs=1e-13)


def test_margin_is_one_where_rocker_and_diagonal_are_square():
    # diagonal 0.6, rocker 0.8: the coupler is 1.
    assert kinematics.loop_margin(0.3, 0.3, (1.6, 1.0, 0.8, 1.0)) == pytest.approx(1)
    assert kinematics.loop_margin(0.3, 0.3, (1.6, 1.4, 0.8, 1.0)) == pytest.approx(0)


@pytest.mark.parametrize("name", BARS)
def test_no_jump_along_the_range_of_the_joints(name):
    bars = BARS[name]
    side = kinematics.assembly_side(np.pi, np.pi / 2, bars)
    crank = np.linspace(np.deg2rad(135), np.deg2rad(225), 400)
    for ground in np.deg2rad([75, 90, 105, 120]):
        angles = np.array([float(kinematics.rocker_angle(c, ground, bars, side)) for c in crank])
        angles = angles[~np.isnan(angles)]
        assert len(angles) > 300
        assert np.abs(np.diff(angles)).max() < 0.05
        assert np.abs(angles - crank[: len(angles)]).max() < np.pi / 2


def test_measurements_at_open_loops_are_refused():
    # At q2 = q3 the crank's end, 1.6 m out, lies on joint 3: the rocker may point anywhere.
    arm = hh800(bars=(1.6, 0.8, 0.8))
    joints = tuple(replace(j, lower=np.deg2rad(50)) if i == 2 else j for i, j in enumerate(arm.joints))
    q = np.deg2rad([[0, 60, 60, 0, 30, 0], [0, 90, 120, 0, 30, 0]])
    table = pd.DataFrame(
        {f"q{i + 1}_rad": q[:, i] for i in range(6)} | {key: [1.0, 2.0] for key in ("x_m", "y_m", "z_m")}
    )
    with pytest.raises(InputError, match="row 2: the four-bar cannot close there"):
        check_against(replace(arm, joints=joints), from_table(table, joints=6))


def test_open_loop_gives_nan_and_a_negative_margin_in_the_model():
    arm = hh800(bars=(0.8, 1.2, 0.8))
    margin = arm.model.at_declared("loop", ("margin",))
    q = np.deg2rad([0, 60, 225, 0, 30, 0])  # crank end 2.37 m from joint 3: more than 1.2 + 0.8
    assert float(margin(q, arm.parameters.values)) < 0
    assert np.isnan(vector(arm.position, q, arm.parameters.values)).all()
    q = np.deg2rad([0, 90, 170, 0, 30, 0])
    assert 0 < float(margin(q, arm.parameters.values)) <= 1
    assert np.isfinite(vector(arm.position, q, arm.parameters.values)).all()
