"""Every effect: named, sized, sourced, and nothing at zero."""

import re

import numpy as np
import pytest
from bench import FIRST, batches, campaign, moved_by, robot, with_columns

from casadical.diagnosis.candidates import candidates_of
from casadical.effects import Effect
from casadical.effects.plugins import effects_by_name
from casadical.identification.accuracy import predicted

CLASSES = [kind for kind in effects_by_name().values() if kind.on_list != "unknown"]


def test_every_candidate_has_sizes_also_of_effects_on_no_list() -> None:
    for kind in effects_by_name().values():
        for effect in kind.candidates(robot("hh800")):
            assert all(0 < size <= 0.3 for size, _ in effect.sizes().values()), effect.label  # in SI units


@pytest.mark.parametrize("kind", CLASSES, ids=lambda c: c.__name__)
def test_effect_says_what_it_is(kind: type[Effect]) -> None:
    effect = kind(2) if "joint" in kind.__init__.__annotations__ else kind()
    assert effect.sizes()
    assert all(size > 0 for size, _ in effect.sizes().values())
    assert len(kind.physics) > 40
    assert kind.physics.endswith(".")
    assert kind.confused_with
    assert kind.signature
    assert kind.on_list in ("standard", "extended")
    assert re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower() == kind.name
    for p in effect.parameters():
        assert p.name.startswith(f"{effect.label}.")
        assert p.value == 0
        assert p.prior > 0


def test_every_effect_is_in_a_list() -> None:
    listed = {type(e) for c in candidates_of(robot("ur10e"), "extended") for v in c.variants for e in v}
    # The UR10e has no rigid joint, so nothing can lack there.
    assert {c.__name__ for c in set(CLASSES) - listed} == {"MissingCompliance"}
    standard = {c.name for c in candidates_of(robot("ur10e"), "standard") if c.listed}
    rare = {c.name for c in candidates_of(robot("ur10e"), "extended") if c.listed} - standard
    assert rare == {
        *("load_hysteresis", "gear_mesh", "cross_coupling", "hose_drag"),
        *("tracker_scale", "refraction", "smr_offset", "bearing_play"),
        *("frame_step", "thermal_bend", "friction_memory", "settling_lag"),
    }


@pytest.mark.parametrize("name", FIRST)
def test_zero_means_no_effect(name: str) -> None:
    for effects in batches(name):
        poses = with_columns(campaign(name)[::40], effects)
        count = sum(len(e.parameters()) for e in effects)
        values = np.concatenate([robot(name).parameters.values, np.zeros(count)])
        plain, _ = predicted(robot(name), poses)
        np.testing.assert_allclose(moved_by(name, effects, values[None], poses)[0], plain, atol=1e-13)
