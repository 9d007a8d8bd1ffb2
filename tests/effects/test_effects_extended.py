"""The rarer effects where no pair with a simulator tells enough: worked out by another way than their expression."""

import numpy as np
import pytest
from bench import campaign, robot, with_columns

from casadical.diagnosis.candidates import extended_candidates
from casadical.diagnosis.settings_search import neighbours
from casadical.effects import Effect, GearMesh, SmrOffset, TransmissionRipple
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import Measurements

NAME = "ur10e"


def shift(effect: Effect, values: dict[str, float], poses: Measurements, name: str = NAME) -> np.ndarray:
    """What the effect does to the positions, shape (n, 3) [m]."""
    poses = with_columns(poses, [effect])
    whole = robot(name).with_effect(effect).with_values({f"{effect.label}.{k}": v for k, v in values.items()})
    return predicted(whole, poses)[0] - predicted(robot(name), poses)[0]


@pytest.mark.parametrize("part", ["along", "across", "above"])
def test_an_offset_of_the_reflector_has_its_length(part: str) -> None:
    off = shift(SmrOffset(None, (4.0, -2.0, 1.0)), {part: 1e-5}, campaign(NAME)[:20])
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), 1e-5, rtol=1e-9)


def test_known_ratio_is_not_refined_away() -> None:
    assert neighbours(GearMesh(3, 171.5), 1.0) == []
    assert neighbours(TransmissionRipple(3, 4.0), 1.0) != []


def test_a_reflector_straight_above_the_instrument_or_in_it_has_a_position() -> None:
    """Across the beam has no direction there; the offset is left out, and nothing is NaN."""
    poses = campaign(NAME)
    seen = predicted(robot(NAME), poses)[0][0]
    for station in (seen, seen - [0.0, 0.0, 1.5]):
        effect = SmrOffset(None, tuple(float(x) for x in station))
        moved = shift(effect, dict.fromkeys(effect.sizes(), 1e-5), poses)[0]
        assert np.isfinite(moved).all()
        assert np.linalg.norm(moved) < 2e-5


def test_steps_are_looked_for_within_the_campaign_only() -> None:
    """What moves at once at a share of the campaign: no candidate at or beyond its ends, and none twice."""
    steps = [e for c in extended_candidates(robot(NAME)) for v in c.variants for e in v if hasattr(e, "at")]
    for kind in {type(e) for e in steps}:
        times = {e.at for e in steps if type(e) is kind}
        assert len(times) > 5
        assert 0 < min(times) < 0.1
        assert 0.9 < max(times) < 1
