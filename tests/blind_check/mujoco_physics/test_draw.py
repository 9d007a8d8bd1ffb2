"""Effects by chance, campaigns of several at once, given poses, and clear errors."""

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
from marks import MUJOCO

from casadical.blind_check import mujoco_physics as engine
from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.hidden import cause
from casadical.blind_check.mujoco_physics.plant import motion
from casadical.blind_check.mujoco_physics.stops import Warmup, draw_stops
from casadical.core.basics import InputError

from .machines import ROBOTS, built, nominal, stops

pytestmark = MUJOCO
XYZ = ["x_mm", "y_mm", "z_mm"]


@pytest.mark.parametrize("effect", [*engine.LISTED, *engine.UNLISTED])
def test_an_effect_is_drawn_by_its_name_and_seed(effect):
    machine = built("kr210")
    drawn_twice = [engine.draw_effect(machine, effect, np.random.default_rng(seed)) for seed in (3, 3, 4)]
    assert drawn_twice[0] == drawn_twice[1] != drawn_twice[2]
    assert {h.effect for h in drawn_twice} == {effect}


def test_an_effect_survives_json():
    for effect in (*engine.LISTED, *engine.UNLISTED):
        hidden = engine.draw_effect(built("ur10e"), effect, np.random.default_rng(1))
        back = engine.Hidden(**json.loads(json.dumps(dataclasses.asdict(hidden))))
        assert engine.hidden.cause(back) == engine.hidden.cause(hidden)


@pytest.mark.parametrize("name", ROBOTS)
def test_all_listed_effects_at_once_find_rest_and_hardly_depend_on_each_other(name):
    machine, rng = built(name), np.random.default_rng(3)
    hidden = [engine.draw_effect(machine, effect, rng) for effect in engine.LISTED if effect != "outliers"]
    hidden = [dataclasses.replace(h, joint=None if h.joint is None else 5) for h in hidden]
    hidden = [
        dataclasses.replace(h, size={**h.size, "source": 4}) if h.effect == "joint_coupling" else h for h in hidden
    ]
    exact = {"noise_mm": 0.0, "repeatability_urad": 0.0}
    clean = engine.campaign(machine, (), 8, 2, **exact)[XYZ].to_numpy()
    together = engine.campaign(machine, hidden, 8, 2, **exact)[XYZ].to_numpy() - clean
    alone = sum(engine.campaign(machine, (h,), 8, 2, **exact)[XYZ].to_numpy() - clean for h in hidden)
    assert np.linalg.norm(together - alone) < 0.15 * np.linalg.norm(alone)


def test_given_poses_are_measured_as_in_the_campaign():
    machine = built("kr210")
    hidden = (engine.Hidden("backlash", 3, {"size": 8e-5, "friction": 0.1}),)
    table = engine.campaign(machine, hidden, 6, 5, noise_mm=0.0, repeatability_urad=0.0)
    again = engine.measure(machine, hidden, table.drop(columns=XYZ), noise_mm=0.0, repeatability_urad=0.0, seed=1)
    assert list(again) == list(table)
    np.testing.assert_allclose(again[XYZ], table[XYZ], atol=2e-4)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda m: engine.draw_effect(m, "gremlins", np.random.default_rng(0)), "gear_eccentricity"),
        (lambda m: engine.campaign(m, (engine.Hidden("gremlins", 1, {}),), 1, 0), "gear_eccentricity"),
        (lambda m: cause(Hidden("joint_scale", 7, {"size": 1e-4})), "needs a joint from 1 to 6"),
        (lambda m: cause(Hidden("joint_scale", 0, {"size": 1e-4})), "needs a joint from 1 to 6"),
        (lambda m: engine.campaign(m, (engine.Hidden("joint_scale", None, {"size": 1e-4}),), 1, 0), "from 1 to 6"),
        (lambda m: engine.campaign(m, (engine.Hidden("link_flexure", 2, {}),), 1, 0), "sits in no joint"),
        (lambda m: engine.campaign(m, (engine.Hidden("joint_scale", 1, {"sise": 1e-4}),), 1, 0), "size"),
        (lambda m: engine.campaign(m, (), 0, 0), "at least 1 pose"),
        (lambda m: engine.campaign(m, (), 2, 0, q_deg=np.zeros((1, 6))), "(2, 6)"),
        (lambda m: engine.measure(m, (), pd.DataFrame({"q1_deg": [0.0]}), seed=0), "q2_deg"),
    ],
)
def test_what_is_wrong_is_said(wrong, words):
    with pytest.raises(InputError, match=words.replace("(", r"\(").replace(")", r"\)")):
        wrong(built("ur10e"))


def test_approaches_follow_from_the_order():
    q = np.array([[0.0] * 6, [0.5] * 6, [0.2] * 6, [0.2, 0.9, 0.1, 0.3, -1, 0.2]])
    stops = draw_stops(q, np.random.SeedSequence(0).spawn(4), [0.0], Warmup(), "motion")
    assert stops.approach[1:].tolist() == [[1.0] * 6, [-1.0] * 6, [1, 1, -1, 1, -1, 1]]
    chance = draw_stops(np.zeros((20, 6)), np.random.SeedSequence(0).spawn(4), [0.0], Warmup()).approach
    assert {*chance.ravel()} == {-1.0, 1.0}


def test_drawn_sizes_lie_in_their_ranges():
    machine = nominal("kr210")
    rng = np.random.default_rng(0)
    drawn = [engine.draw_effect(machine, "gear_eccentricity", rng).size for _ in range(300)]
    ovals = [size["oval"] / size["size"] for size in drawn]
    assert 0.2 <= min(ovals) < 0.225
    assert 0.775 < max(ovals) <= 0.8
    assert np.mean(np.log([size["size"] / 40e-6 for size in drawn])) == pytest.approx(0.2, abs=0.1)
    loads = np.array([engine.draw_effect(machine, "payload_error", rng).size["size"] for _ in range(300)])
    assert np.median(loads[loads > 0]) == pytest.approx(-np.median(loads[loads < 0]), rel=0.3)
    drifts = [engine.draw_effect(machine, "frame_drift", rng).size for _ in range(20)]
    shift, turn = (np.array([np.linalg.norm(size[k]) for size in drifts]) for k in ("shift_m", "turn_rad"))
    np.testing.assert_allclose(shift / turn, shift[0] / turn[0])  # both as many times as great as they usually are


def test_a_crack_and_a_beam_are_cut_where_they_say():
    machine = nominal("kr210")
    whole = engine.mechanism(machine)
    link = np.array(machine.centres[2] - machine.centres[1])
    cracked = cause(Hidden("cracked_link", None, {"link": 2, "size": 1e-4, "towards": 0.3})).built(whole, machine)
    place = cracked.body("beyond_crack").place
    assert place.shape == (4, 4)
    assert np.linalg.norm(place[:3, 3]) == pytest.approx(0.3 * np.linalg.norm(link))
    beam = cause(Hidden("link_flexure", None, {"link": 2, "size": 1e-4, "torsion": 0.5})).built(whole, machine)
    middle, own = beam.body("link2a"), whole.body("link2")
    assert (middle.mass, beam.body("link2").mass) == (own.mass, 0.0)
    np.testing.assert_allclose(middle.place[:3, 3] + middle.com, own.com)  # its mass centre stays
    for name, share in (("link2a", 0.25), ("link2b", 0.5)):  # the second is seen from the first
        place = beam.body(name).place
        assert place.shape == (4, 4)
        assert np.linalg.norm(place[:3, 3]) == pytest.approx(share * np.linalg.norm(link))


def test_a_weight_is_the_length_of_gravity():
    assert dataclasses.replace(nominal("kr210"), gravity=np.array([2.0, 3.0, -6.0])).weight == pytest.approx(7.0)


def test_a_part_that_lags_follows_a_steady_surface_exponentially():
    at = stops(np.zeros((20, 6)), 0.0, time_s=60.0 * np.cumsum(np.arange(1, 21)), warmth_K=4.0)
    np.testing.assert_allclose(at.warmth_after(25.0), 4 * (1 - np.exp(-at.time_s / 60 / 25)))


def test_a_joint_is_coupled_to_another_one_of_the_wrist():
    machine, rng = nominal("ur10e"), np.random.default_rng(0)
    drawn = [engine.draw_effect(machine, "joint_coupling", rng) for _ in range(40)]
    assert {hidden.joint for hidden in drawn} == {4, 5, 6}
    assert all(hidden.size["source"] in {4, 5, 6} - {hidden.joint} for hidden in drawn)


@pytest.mark.parametrize("effect", ["tight_cable", "joint_coupling", "gear_eccentricity", "encoder_pit"])
def test_errors_of_joints_are_fractions_of_a_milliradian(effect: str) -> None:
    machine, rng = nominal("ur10e"), np.random.default_rng(0)
    sizes = [abs(engine.draw_effect(machine, effect, rng).size["size"]) for _ in range(30)]
    assert 1e-5 < np.median(sizes) < 1e-3


def test_a_turn_about_a_point_leaves_it_where_it_is():
    rng = np.random.default_rng(0)
    turn, about, shift = rng.normal(size=(3, 5, 3))
    G = motion(turn, shift, about)
    moved = (G @ np.concatenate([about, np.ones((5, 1))], axis=1)[..., None])[:, :3, 0]
    np.testing.assert_allclose(moved, about + shift, atol=1e-12)
