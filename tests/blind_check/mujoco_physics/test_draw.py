"""Effects by chance, campaigns of several at once, given poses, and clear errors."""

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest

from casadical.blind_check import mujoco_physics as engine
from casadical.core.basics import InputError

from .machines import ROBOTS, built, drawn

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'casadical[withheld]'")
XYZ = ["x_mm", "y_mm", "z_mm"]


@pytest.mark.parametrize("effect", [*engine.LISTED, *engine.UNLISTED])
def test_an_effect_is_drawn_by_its_name_and_seed(effect):
    machine = built("kr210")
    drawn_twice = [engine.draw_effect(machine, effect, np.random.default_rng(seed)) for seed in (3, 3, 4)]
    assert drawn_twice[0] == drawn_twice[1] != drawn_twice[2]
    assert {h.effect for h in drawn_twice} == {effect}


def test_directions_are_drawn_all_round():
    machine = built("kr210")
    sizes = [engine.draw_effect(machine, "gear_eccentricity", np.random.default_rng(k)).size for k in range(40)]
    for name in ("towards", "oval_towards"):
        quarters = {int(size[name] // (np.pi / 2)) for size in sizes}
        assert quarters == {0, 1, 2, 3}


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


def test_poses_circumstances_and_noise_do_not_depend_on_what_is_hidden():
    machine = built("ur10e")
    hidden = (engine.Hidden("joint_zero_step", 1, {"size": 1e-4, "at_s": 1e9}),)
    with_, without = (engine.campaign(machine, h, 20, 7) for h in (hidden, ()))
    pd.testing.assert_frame_equal(with_, without)


def test_given_poses_are_measured_as_in_the_campaign():
    machine = built("kr210")
    hidden = (engine.Hidden("backlash", 3, {"size": 8e-5, "friction": 0.1}),)
    table = engine.campaign(machine, hidden, 6, 5, noise_mm=0.0, repeatability_urad=0.0)
    again = engine.measure(machine, hidden, table.drop(columns=XYZ), noise_mm=0.0, repeatability_urad=0.0, seed=1)
    assert list(again) == list(table)
    np.testing.assert_allclose(again[XYZ], table[XYZ], atol=2e-4)


def test_bare_readings_are_measured_with_the_payload_on():
    machine = built("kr210")
    q = np.rad2deg(drawn(machine, 3))
    bare = pd.DataFrame(q, columns=[f"q{j}_deg" for j in range(1, 7)])
    first, second, noisier = (
        engine.measure(machine, (), bare, seed=s, noise_mm=e) for s, e in ((1, 0.02), (1, 0.02), (1, 1.0))
    )
    assert (first["payload_kg"] == machine.payload_kg).all()
    assert first["time_s"].tolist() == [30.0, 60.0, 90.0]
    pd.testing.assert_frame_equal(first, second)
    assert np.abs(noisier[XYZ] - first[XYZ]).to_numpy().max() > 0.3


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda m: engine.draw_effect(m, "gremlins", np.random.default_rng(0)), "gear_eccentricity"),
        (lambda m: engine.campaign(m, (engine.Hidden("gremlins", 1, {}),), 1, 0), "gear_eccentricity"),
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
