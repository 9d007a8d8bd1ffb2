"""Where the gap lies: planted causes are found at their joint, in their direction, time, payload and approach."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from cases import case, diagnosed, robot, simulated
from planted import planted

from casadical.blind_check.mujoco_physics import Hidden
from casadical.core.parts import Coupling
from casadical.diagnosis.candidates import candidates_of
from casadical.diagnosis.diagnose import diagnose
from casadical.diagnosis.linear_problem import Case, make_case
from casadical.diagnosis.localisation import (
    BIN_COLUMNS,
    DIRECTION_COLUMNS,
    PART_COLUMNS,
    Localisation,
    group_variances,
    localise,
    localise_residual,
    products_of_rows,
)
from casadical.identification.identification import identify
from casadical.measurements.measurements import Noise

NOISE = Noise(15e-6, 6e-6)
NONE = np.zeros(0, dtype=np.int64)


def localised(name: str, seed: int, *causes: Hidden) -> Localisation:
    r = robot(name)
    found = identify(r, simulated(name, seed, *causes), loss="huber", priors=True, screen=False)
    return localise_residual(make_case(found, candidates_of(r, ["joint_scale"])), NOISE, NONE)


def share(table: pd.DataFrame, part: str) -> float:
    return float(table.set_index("part").loc[part, "share"])


PLACES = [
    ("kr210", 11, planted("gear_eccentricity", 4, size=200e-6), "joint 4"),
    ("ur10e", 12, planted("friction_windup", 2, size=90e-6), "joint 2"),
    ("ur10e", 14, planted("joint_zero_step", 3, size=150e-6), "joint 3"),
    ("ur10e", 3, planted("transmission_ripple", 3, size=80e-6, cycles=7), "joint 3"),
    ("kr210", 13, planted("frame_drift"), "base"),
]


@pytest.mark.parametrize(("name", "seed", "cause", "place"), PLACES, ids=lambda v: getattr(v, "__class__", v).__name__)
def test_gap_is_found_where_it_was_planted(name: str, seed: int, cause: Hidden, place: str) -> None:
    w = localised(name, seed, cause)
    table = w.joints if place.startswith("joint") else w.links
    assert share(table, place) > 0.7
    assert table["part"][table["share"].argmax()] == place
    row = table.set_index("part").loc[place]
    assert row["low"] <= row["share"] <= row["high"]
    # What the data cannot exclude is in the intervals of the other parts, too.
    assert table["high"].min() > 1e-4


@pytest.mark.slow
def test_what_causes_explain_goes_to_their_joints_and_no_further() -> None:
    """Error curves of all joints hid in base and links before, as 28 % of the base on a real UR10."""
    ripples = [planted("transmission_ripple", j, size=120e-6, cycles=c) for j, c in ((2, 9), (3, 17), (2, 4), (3, 6))]
    found = diagnose(robot("ur10e"), simulated("ur10e", 3, *ripples), ["joint_error_curve"], laws=False)
    assert [c.label for c in found.causes] == ["joint_error_curve"]
    where = localise(found)
    table = where.joints.set_index("part")
    assert table.loc[["joint 2", "joint 3"], "share"].sum() > 0.9
    assert table["low"].loc["joint 3"] > 0.1 < table["low"].loc["joint 2"]
    assert where.links["share"][:-1].max() < 0.05
    assert max(where.joints["rms_mm"].max(), where.links["rms_mm"].max()) < 1e3 * found.gap.before


def test_tables_have_stable_columns_and_sum_to_one() -> None:
    w = localise(diagnosed("ur10e-P06"))
    assert list(w.joints) == list(w.links) == list(PART_COLUMNS)
    assert list(w.directions) == list(DIRECTION_COLUMNS)
    assert w.joints["share"].sum() == pytest.approx(1)
    assert w.links["share"].sum() == pytest.approx(1)
    np.testing.assert_allclose(w.directions.groupby("frame")["share"].sum(), 1)
    for name in ("regions", "payload", "temperature", "time", "approach"):
        table = getattr(w, name)
        assert list(table) == list(BIN_COLUMNS)
        np.testing.assert_allclose(table.groupby("by")["share"].sum(), 1)
        assert (table["low"] <= table["share"] + 1e-12).all()
        assert (table["share"] <= table["high"] + 1e-12).all()
        assert (table.groupby("by")["poses"].sum() == int(diagnosed("ur10e-P06").case.inliers.sum())).all()
    assert set(w.payload["part"]) == {"0 kg", "10 kg"}
    assert list(w.time["part"]) == [f"quarter {k} of 4" for k in (1, 2, 3, 4)]


def doctored(change: np.ndarray) -> Case:
    """A case whose residual is given."""
    c = case("ur10e-P09", "joint_scale@2")
    return replace(c, whole=replace(c.whole, r=change), inliers=np.ones(len(c.m), dtype=bool))


@pytest.fixture(scope="module")
def any_case() -> Case:
    return case("ur10e-P09", "joint_scale@2")


def test_direction_of_a_vertical_error(any_case: Case) -> None:
    up = any_case.robot.base.T[:3, 2]
    c = doctored(1e-4 * np.random.default_rng(0).standard_normal((len(any_case.m), 1)) * up)
    shares = localise_residual(c, NOISE, NONE).directions.set_index(["frame", "part"])["share"]
    assert shares[("base", "z")] == pytest.approx(1)
    assert shares[("axis", "vertical")] == pytest.approx(1)
    assert shares[("tool", "z")] < 0.8


@pytest.mark.parametrize("named", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_rms_is_in_mm_however_much_the_joints_scatter(any_case: Case, named: bool) -> None:
    """Of noise in the joints a long lever hides more; what is there is as large (48 um passed for 11 before)."""
    scale = any_case.group(next(k for k in any_case.candidates if k.label == "joint_scale@2").variants[0])
    c = doctored(20 * any_case.whole.take(scale)[:, :, 0] + 5e-6 * np.random.default_rng(0).normal(size=(120, 3)))
    sizes = [
        localise_residual(c, Noise(5e-6, rho * 5e-6), scale if named else NONE, remains=0.0 if named else 1.0)
        .joints.set_index("part")
        .loc["joint 2", "rms_mm"]
        for rho in (0.0, 1.6)
    ]
    assert sizes[1] == pytest.approx(sizes[0], rel=0.1)


@pytest.mark.parametrize(
    ("remains", "least", "most"), [(0.0, 0.0, 1e-12), (0.02, 0.0, 1e-12), (0.1, 1e-4, 0.1), (1.0, 0.01, 0.3)]
)
def test_what_may_be_left_beside_a_cause_is_in_its_interval(
    any_case: Case, remains: float, least: float, most: float
) -> None:
    """Beside noise alone, other parts have as much as is probable (100 % with the interval 100 to 100 before)."""
    scale = any_case.group(next(k for k in any_case.candidates if k.label == "joint_scale@2").variants[0])
    noise = 2e-5 * np.random.default_rng(3).normal(size=(120, 3))
    c = doctored(6 * any_case.whole.take(scale)[:, :, 0] + noise)
    row = localise_residual(c, Noise(2e-5, 0.0), scale, remains=remains).joints.set_index("part").loc["joint 2"]
    assert least <= 1 - row["low"] <= most
    assert 1 - row["share"] <= remains * most


def test_what_priors_of_the_base_cost_is_no_error_of_a_pose(any_case: Case) -> None:
    """A base parameter that its prior lets take up half of an effect leaves the other half (71 % was told before)."""
    (scale,) = any_case.group(next(k for k in any_case.candidates if k.label == "joint_scale@2").variants[0])
    moved = 20 * any_case.whole.take(np.array([scale]))[:, :, 0]
    c, e = doctored(moved), any_case.whole
    J, prior = np.zeros_like(e.J), e.prior.copy()
    J[:, :, 0], prior[0] = moved, e.reference / np.linalg.norm(moved)
    c = replace(c, whole=replace(c.whole, J=J, prior=prior, delta0=0 * e.delta0))
    table = localise_residual(c, Noise(5e-6, 0.0), np.array([scale]), remains=0.0).joints.set_index("part")
    assert table.loc["joint 2", "rms_mm"] == pytest.approx(500 * np.sqrt(np.mean(moved**2)), rel=0.05)


@pytest.mark.parametrize("edge", [0.0, 22.5, -7.5])
def test_names_of_regions_do_not_follow_round_off(any_case: Case, edge: float) -> None:
    """ "-170 .. 0 deg" was "-170 .. -0 deg" where readings moved by 1e-12."""
    names = []
    for moved in (-1e-12, 1e-12):
        q = any_case.m.q.copy()
        q[:, 4] = np.linspace(-2, 2, 120)
        q[:, 4][q[:, 4] > -0.7] = np.deg2rad(edge) + moved
        q[-40:, 4] += 1.0
        c = replace(any_case, m=replace(any_case.m, q=q))
        names.append(localise_residual(c, NOISE, NONE, remains=0.0).regions["part"].tolist())
    assert names[0] == names[1]
    assert f" .. {round(edge):.0f} deg" in " ".join(names[0])


def test_regions_are_those_of_the_controllers_readings(any_case: Case) -> None:
    joints = [replace(any_case.robot.joints[0], readings=Coupling(((1, -1.0),), 0.5)), *any_case.robot.joints[1:]]
    c = replace(any_case, robot=replace(any_case.robot, joints=tuple(joints)))
    ranges = localise_residual(c, NOISE, NONE, remains=0.0).regions.set_index("by").loc["q1", "part"]
    assert float(ranges.iloc[0].split(" .. ")[0]) == pytest.approx(np.rad2deg(0.5 - any_case.m.q[:, 0].max()), abs=1)


def test_part_of_the_data_that_is_worse_is_named(any_case: Case) -> None:
    """Errors twice as large with payload, and thrice as large where joint 2 rose, are the worst parts."""
    rng, m = np.random.default_rng(1), any_case.m
    factor = np.where(m.conditions["payload_kg"] > 5, 2.0, 1.0) * np.where(m.conditions["approach2"] > 0, 3.0, 1.0)
    w = localise_residual(doctored(2e-5 * factor[:, None] * rng.standard_normal((len(m), 3))), NOISE, NONE)
    assert tuple(w.worst.loc[0, ["by", "part"]]) == ("approach of joint 2", "rising")
    assert "10 kg" in set(w.worst["part"])
    rms = w.payload.set_index("part")["rms_mm"]
    assert rms["10 kg"] / rms["0 kg"] == pytest.approx(2, rel=0.25)


def test_sizes_of_parts_are_those_of_a_dense_inverse() -> None:
    """Of many rows and little noise, where an inverse by halves lost all digits (it said 1,300 mm of a real UR10)."""
    rng, sigma = np.random.default_rng(0), 1e-3
    groups = [rng.normal(size=(700, width)) * np.geomspace(1, 1e-3, width) for width in (30, 60)]
    y = groups[0] @ rng.normal(size=30) + sigma * rng.normal(size=700)
    size, noise = group_variances(y, groups, products_of_rows(groups), sigma)
    assert 0.3 < size[0] < 3.0
    assert size[1] < 1e-3 * size[0]
    assert noise == pytest.approx(sigma, rel=0.2)
