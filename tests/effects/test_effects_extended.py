"""The rarer effects against what their physics says, worked out by another way than their own expression."""

from dataclasses import replace

import numpy as np
import pytest
from bench import campaign, robot, with_columns

from casadical.diagnosis.candidates import extended_candidates
from casadical.effects import (
    CrossCoupling,
    Effect,
    FrameStep,
    FrictionMemory,
    GearMesh,
    HoseDrag,
    LoadHysteresis,
    MissingCompliance,
    Refraction,
    SettlingLag,
    SmrOffset,
    ThermalBend,
    TrackerScale,
)
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


def load(joint: int, poses: Measurements) -> np.ndarray:
    """Gravity torque on a joint as a share of its great torques, shape (n,)."""
    r = robot(NAME)
    tau = r.model.function("torque", ("tau",)).map(len(poses))
    w = poses.condition_matrix(r.conditions, r.declared)
    return tau(poses.q.T, w.T, r.parameters.values).full()[joint - 1] / r.torque_scale[joint - 1]


def test_gear_mesh_turns_its_joint_n_and_2n_times_a_turn() -> None:
    poses = campaign(NAME)[:20]
    q = poses.q[:, 2]
    angle = 3e-5 * np.sin(101 * q) - 2e-5 * np.cos(202 * q)
    found = shift(GearMesh(3, 101.0), {"sin1": 3e-5, "cos2": -2e-5}, poses)
    np.testing.assert_allclose(found, turned(3, angle, poses), rtol=0, atol=5e-3 * np.abs(found).max())


def test_cross_coupling_is_the_other_joints_torque() -> None:
    poses = campaign(NAME)[::5]
    found = shift(CrossCoupling(3, 2), {"k2": 1e-4}, poses)
    expected = turned(3, 1e-4 * load(2, poses), poses)
    np.testing.assert_allclose(found, expected, rtol=0, atol=5e-3 * np.abs(found).max())


def test_missing_compliance_is_the_compliance_that_was_left_out() -> None:
    poses = campaign(NAME)[::5]
    soft = robot(NAME)
    joints = [*soft.joints]
    joints[2] = replace(joints[2], compliance=None)
    stiff = replace(soft, joints=tuple(joints))
    effect = MissingCompliance(3)
    deflection = soft.joints[2].compliance * stiff.torque_scale[2]
    mended = stiff.with_effect(effect).with_values({f"{effect.label}.deflection": deflection})
    whole = np.abs(predicted(stiff, poses)[0] - predicted(soft, poses)[0]).max()
    left = np.abs(predicted(mended, poses)[0] - predicted(soft, poses)[0]).max()
    # What is left: the effect's deflection does not sink the loads with it.
    assert left < 5e-3 * whole


def test_frame_step_moves_all_poses_after_it_as_a_body() -> None:
    poses = campaign(NAME)[::5]
    p, _ = predicted(robot(NAME), poses)
    turn = np.array([3e-5, -2e-5, 4e-5])
    values = dict(zip(("x", "y", "z", "rx", "ry", "rz"), (1e-4, 0.0, -5e-5, *turn), strict=True))
    found = shift(FrameStep(None, 0.5), values, poses)
    progress = np.arange(len(poses)) / (len(poses) - 1)
    expected = (progress > 0.5)[:, None] * (np.array([1e-4, 0.0, -5e-5]) + np.cross(turn, p))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    # Behind joint 3, what turns about its axis is a step of its zero.
    about = shift(FrameStep(3, 0.5), {"rz": 5e-5}, poses)
    np.testing.assert_allclose(
        about, turned(3, 5e-5 * (progress > 0.5), poses), rtol=0, atol=5e-3 * np.abs(about).max()
    )


def test_thermal_bend_tilts_across_the_axis_with_the_warmth() -> None:
    poses = campaign(NAME)[::5]
    warmth = poses.conditions["temperature_degC"] - poses.conditions["temperature_degC"].mean()
    found = shift(ThermalBend(2, 0.0), {"rx": 1e-5}, poses)
    again = shift(ThermalBend(2, 0.0), {"rx": 2e-5}, poses)
    np.testing.assert_allclose(again, 2 * found, atol=1e-9)
    assert np.abs(found[np.abs(warmth) < 0.2]).max() < 0.2 * np.abs(found).max()
    assert np.corrcoef(np.linalg.norm(found, axis=1), np.abs(warmth))[0, 1] > 0.7


def test_friction_memory_and_settling_follow_the_ways_between_the_poses() -> None:
    poses = campaign(NAME)[:30]
    order = np.argsort(poses.conditions["time_s"])
    moves = np.diff(poses.q[order, 3], prepend=poses.q[order[0], 3])
    found = shift(SettlingLag(4), {"share": 1e-5}, poses)[order]
    np.testing.assert_allclose(
        found, turned(4, -1e-5 * moves[np.argsort(order)], poses)[order], rtol=0, atol=5e-3 * np.abs(found).max()
    )
    # Dahl's differential equation, ds = (sign - s) |dq| / way, in small steps.
    state, states = 0.0, []
    for move in moves:
        for _ in range(2000):
            state += (np.sign(move) - state) * abs(move) / 2000 / 0.3
        states.append(state)
    remembered = shift(FrictionMemory(4, 300), {"half": 5e-5}, poses)
    expected = turned(4, -5e-5 * np.array(states)[np.argsort(order)], poses)
    np.testing.assert_allclose(remembered, expected, rtol=0, atol=1e-2 * np.abs(expected).max())


def test_load_hysteresis_turns_over_with_the_approach_and_vanishes_without_load() -> None:
    poses = campaign(NAME)[::5]
    one, other = (
        replace(poses, conditions={**poses.conditions, "approach2": sign * np.ones(len(poses))}) for sign in (1, -1)
    )
    lag = shift(LoadHysteresis(2), {"half": 5e-5}, one)
    np.testing.assert_allclose(shift(LoadHysteresis(2), {"half": 5e-5}, other), -lag, atol=1e-8)
    # Joint 1 stands upright, to within the base's tilt, and has no load.
    idle = shift(LoadHysteresis(1), {"half": 5e-5}, poses)
    assert np.abs(idle).max() < 0.02 * np.abs(lag).max()
    squared = shift(LoadHysteresis(2, power=2), {"half": 5e-5}, one)
    share = np.linalg.norm(squared, axis=1) / np.linalg.norm(lag, axis=1)
    np.testing.assert_allclose(share, np.abs(load(2, one)), atol=5e-3)
    assert share.std() > 0.1


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


def test_instrument_effects() -> None:
    poses = campaign(NAME)[:20]
    p, _ = predicted(robot(NAME), poses)
    np.testing.assert_allclose(shift(TrackerScale(), {"k": 1e-5}, poses), 1e-5 * p, atol=1e-15)
    bent = shift(Refraction(), {"bend": 1e-6, "slope_y": 2e-6}, poses)
    np.testing.assert_allclose(bent[:, 2], 1e-6 * (p[:, :2] ** 2).sum(axis=1) + 2e-6 * p[:, 1], atol=1e-15)
    assert np.abs(bent[:, :2]).max() == 0
    station = (4.0, -2.0, 1.0)
    beam = p - np.array(station)
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    np.testing.assert_allclose(shift(SmrOffset(None, station), {"along": 1e-5}, poses), 1e-5 * beam, atol=1e-14)
    for part in ("across", "above"):
        off = shift(SmrOffset(None, station), {part: 1e-5}, poses)
        np.testing.assert_allclose(np.linalg.norm(off, axis=1), 1e-5, rtol=1e-9)
        np.testing.assert_allclose((off * beam).sum(axis=1), 0, atol=1e-16)


def test_known_ratio_is_not_refined_away() -> None:
    from casadical.diagnosis.settings_search import neighbours
    from casadical.effects import TransmissionRipple

    assert neighbours(GearMesh(3, 171.5), 1.0) == []
    assert neighbours(TransmissionRipple(3, 4.0), 1.0) != []


@pytest.mark.parametrize("effect", [GearMesh(3), HoseDrag(), SmrOffset(), LoadHysteresis(2)], ids=lambda e: e.label)
def test_identify_takes_an_extended_effect(effect: Effect) -> None:
    from casadical import identify

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
