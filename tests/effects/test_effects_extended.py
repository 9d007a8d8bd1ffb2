"""The rarer effects where no pair with a simulator tells enough: worked out by another way than their expression."""

from dataclasses import replace

import numpy as np
import pytest
from bench import campaign, robot, with_columns

from casadical import identify
from casadical.diagnosis.candidates import extended_candidates
from casadical.diagnosis.settings_search import neighbours
from casadical.effects import Effect, GearMesh, HoseDrag, LoadHysteresis, SmrOffset, TransmissionRipple
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import Measurements

NAME = "ur10e"


def shift(effect: Effect, values: dict[str, float], poses: Measurements, name: str = NAME) -> np.ndarray:
    """What the effect does to the positions, shape (n, 3) [m]."""
    poses = with_columns(poses, [effect])
    whole = robot(name).with_effect(effect).with_values({f"{effect.label}.{k}": v for k, v in values.items()})
    return predicted(whole, poses)[0] - predicted(robot(name), poses)[0]


def turned(joint: int, angle: np.ndarray, poses: Measurements) -> np.ndarray:
    """What a wrong reading of one joint does, the torques being those of the true one; to 1e-3 or so."""
    q = poses.q.copy()
    q[:, joint - 1] += angle
    return predicted(robot(NAME), replace(poses, q=q))[0] - predicted(robot(NAME), poses)[0]


def test_gear_mesh_turns_its_joint_n_and_2n_times_a_turn() -> None:
    poses = campaign(NAME)[:20]
    q = poses.q[:, 2]
    angle = 3e-5 * np.sin(101 * q) - 2e-5 * np.cos(202 * q)
    found = shift(GearMesh(3, 101.0), {"sin1": 3e-5, "cos2": -2e-5}, poses)
    np.testing.assert_allclose(found, turned(3, angle, poses), rtol=0, atol=5e-3 * np.abs(found).max())


def test_load_hysteresis_vanishes_without_load() -> None:
    """Joint 1 stands upright, to within the base's tilt, and has none."""
    idle, lag = (shift(LoadHysteresis(joint), {"half": 5e-5}, campaign(NAME)[::5]) for joint in (1, 2))
    assert np.abs(idle).max() < 0.02 * np.abs(lag).max()


def test_hose_draws_the_load_towards_its_clip() -> None:
    """Under tension alone every wrist joint gives way so that the hose, whatever its slope, does positive work."""
    poses = campaign(NAME)[:40]
    effect = HoseDrag(None, 0.7, 0.0)
    moved = shift(effect, {"tension": 0.1}, poses)
    lengths = []
    r = robot(NAME)
    for q in poses.q:
        T, frames = np.eye(4), []
        for joint, angle in zip(r.joints, q, strict=True):
            T = T @ mdh(joint.alpha, joint.a, joint.theta + angle, joint.d)
            frames.append(T)
        elbow, wrist = frames[2][:3, 3], frames[3][:3, 3]
        end = frames[5][:3, :3] @ r.payload.com + frames[5][:3, 3]
        lengths.append(end - (elbow + 0.7 * (wrist - elbow)))
    # The load sits 0.06 m before the measured point: both move nearly alike.
    work = (moved * np.array(lengths)).sum(axis=1)
    assert np.abs(moved).max() > 1e-5
    assert (work < 0).mean() > 0.9
    stiff = {f"c{i}": 0.0 for i in range(1, 7)}
    rigid = robot(NAME).with_effect(effect).with_values({**stiff, f"{effect.label}.tension": 0.1})
    np.testing.assert_allclose(predicted(rigid, poses)[0], predicted(robot(NAME).with_values(stiff), poses)[0])


def mdh(alpha: float, a: float, theta: float, d: float) -> np.ndarray:
    ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
    return np.array([[ct, -st, 0, a], [st * ca, ct * ca, -sa, -d * sa], [st * sa, ct * sa, ca, d * ca], [0, 0, 0, 1]])


@pytest.mark.parametrize("part", ["along", "across", "above"])
def test_an_offset_of_the_reflector_has_its_length(part: str) -> None:
    off = shift(SmrOffset(None, (4.0, -2.0, 1.0)), {part: 1e-5}, campaign(NAME)[:20])
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), 1e-5, rtol=1e-9)


def test_known_ratio_is_not_refined_away() -> None:
    assert neighbours(GearMesh(3, 171.5), 1.0) == []
    assert neighbours(TransmissionRipple(3, 4.0), 1.0) != []


@pytest.mark.parametrize("effect", [GearMesh(3), HoseDrag(), SmrOffset(), LoadHysteresis(2)], ids=lambda e: e.label)
def test_identify_takes_an_extended_effect(effect: Effect) -> None:
    poses = with_columns(campaign(NAME), [effect])
    found = identify(robot(NAME).with_effect(effect), poses, ("kinematic", "compliance", effect.label), priors=True)
    table = found.parameters.set_index("name")
    for name in effect.sizes():
        assert table.loc[f"{effect.label}.{name}", "status"] == "identified"
        assert np.isfinite(table.loc[f"{effect.label}.{name}", "std_error"])


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
