"""What is drawn, what is shown, and what is kept apart."""

import hashlib
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from checks import ROOT, Here, N

from casadical.blind_check import generation, mujoco_physics
from casadical.blind_check.generation import campaign_of, draw_plans, make
from casadical.blind_check.own_robot import subject_of
from casadical.blind_check.protocol import Manifest, read_key, read_manifest
from casadical.core.basics import ConvergenceError, InputError
from casadical.diagnosis.linearisation import unabsorbed_rms
from casadical.project.problem import read_campaign_robot

WORDS = (["a", "b", "c", "d"], ["x", "y"])


def test_the_mix_is_as_told() -> None:
    drawn = draw_plans(300, 11, WORDS)
    assert Counter(p.kind for p in drawn) == {"none": 75, "one": 135, "several": 45, "unlisted": 45}
    assert Counter(p.poses for p in drawn) == {40: 100, 100: 100, 200: 100}
    assert Counter(p.robot for p in drawn) == {"hh800": 100, "kr210": 100, "ur10e": 100}
    assert Counter(p.missing for p in drawn) == {
        None: 200, "temperature": 25, "payload": 25, "approach": 25, "time": 25,
    }  # fmt: skip
    assert {len(p.effects) for p in drawn if p.kind == "several"} == {2, 3}
    assert all(len(set(p.effects)) == len(p.effects) for p in drawn)
    assert Counter(p.effects[0] for p in drawn if p.kind == "unlisted").keys() == {"x", "y"}


def test_a_robot_that_can_have_one_effect_only_has_no_two() -> None:
    assert {p.effects for p in draw_plans(20, 1, (["a"], ["x"])) if p.kind == "several"} == {("a",)}


@pytest.mark.slow
def test_a_seed_gives_the_same_check_to_the_byte(small, tmp_path) -> None:
    make(tmp_path / "a", tmp_path / "b", N, 5, poses=[20], project=ROOT, executor=Here())
    again = {p.relative_to(tmp_path / "a"): p.read_bytes() for p in (tmp_path / "a").rglob("*.*") if p.is_file()}
    first = {p.relative_to(small.folder): p.read_bytes() for p in small.folder.rglob("*.*") if p.is_file()}
    assert again == first
    assert (tmp_path / "b" / "key.json").read_bytes() == (small.key / "key.json").read_bytes()


@pytest.mark.slow
def test_without_a_seed_each_check_is_another_and_none_is_left_half_written(tmp_path) -> None:
    hashes = set()

    def also(made: Manifest) -> dict[Path, str]:
        hashes.add(made.key_sha256)
        return {tmp_path / ("x" * 300): "a name that no file can have"}

    for k in range(2):
        with pytest.raises(InputError, match="nothing was written"):
            make(
                *(tmp_path / f"{k}", tmp_path / f"{k}-key", N),
                poses=[20], project=ROOT, executor=Here(), also=also,
            )  # fmt: skip
    assert len(hashes) == 2
    assert list(tmp_path.iterdir()) == []


def test_columns_that_depend_on_others_absorb_no_more() -> None:
    rng = np.random.default_rng(0)
    J, shift = rng.normal(size=(40, 3, 20)), rng.normal(size=(40, 3))
    A = J.reshape(120, 20)
    expected = np.sqrt(np.mean((shift.ravel() - A @ np.linalg.lstsq(A, shift.ravel())[0]) ** 2))
    twice = np.concatenate([J, 1e-3 * J[:, :, :5], J[:, :, 5:10] + J[:, :, 10:15]], axis=2)
    assert unabsorbed_rms(J, shift) == pytest.approx(expected)
    assert unabsorbed_rms(twice, shift) == pytest.approx(expected)


def test_a_session_without_rest_is_drawn_again(monkeypatch) -> None:
    seeds: list[int] = []

    def restless(plant, hidden, poses, seed, **options) -> pd.DataFrame:
        seeds.append(seed)
        if len(seeds) < 3:
            raise ConvergenceError("no rest")
        return mujoco_physics.campaign(plant, hidden, poses, seed, **options)

    monkeypatch.setattr(generation, "campaign", restless)
    subject, _ = subject_of(read_campaign_robot(ROOT / "problems" / "planar"))
    plan = replace(draw_plans(4, 1, (["joint_scale"], ["encoder_pit"]), (20,))[0], kind="one", effects=("joint_scale",))
    _, _, secret = campaign_of(subject, plan)
    assert len(set(seeds[:3])) == 3
    assert [h.effect for h in secret.hidden] == ["joint_scale"]


def test_the_published_hash_is_that_of_the_file(small) -> None:
    data = (small.key / "key.json").read_bytes()
    assert read_manifest(small.folder).key_sha256 == hashlib.sha256(data).hexdigest()
    assert len(json.loads(data)["salt"]) == 64


def test_the_folder_tells_nothing_of_what_is_hidden(small) -> None:
    key = read_key(small.key, read_manifest(small.folder))
    texts = "".join(p.read_text() + p.name for p in small.folder.rglob("*.*"))
    for secret in key.campaigns.values():
        assert not any(h.effect in texts for h in secret.hidden)
    assert str(key.salt) not in texts


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n": 3}, "n is 3; a blind check needs at least 4"),
        ({"poses": [5]}, "a campaign needs at least 20"),
        ({"project": "nowhere"}, "no such robot; name the project's folder"),
    ],
)
def test_bad_input_is_named(tmp_path, change, message) -> None:
    given = {"n": 4, "seed": 1, "project": ROOT, "executor": Here()} | change
    with pytest.raises(InputError, match=message):
        make(tmp_path / "a", tmp_path / "b", **given)
    assert not any(tmp_path.rglob("*.csv"))


def test_the_key_may_not_lie_with_the_campaigns(tmp_path, small) -> None:
    for key in (tmp_path / "a", tmp_path / "a" / "inside"):
        with pytest.raises(InputError, match="must lie apart"):
            make(tmp_path / "a", key, 4, 1, project=ROOT)
    with pytest.raises(InputError, match="is there already"):
        make(small.folder, tmp_path / "key", 4, 1, project=ROOT)
