"""Loose cargo, a tight cable, lost bits, a rubber coupling and a wrong range do what their physics demands."""

from dataclasses import replace

import numpy as np
import pytest
from marks import MUJOCO

from casadical.blind_check import mujoco_physics as engine
from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.cause import placed, rated_torque, reflector, settle

from .machines import angle_about, built, drawn, shift, stops

pytestmark = MUJOCO
ODD = {
    "loose_cargo": (None, {}),
    "tight_cable": (2, {"free": 0.4}),
    "lost_bits": (2, {"at_rad": 0.3}),
    "rubber_coupling": (2, {"lag_minutes": 2.0}),
    "range_offset": (None, {"stand_m": (4.0, 1.0, 1.0)}),
}


@pytest.mark.parametrize("effect", ODD)
def test_without_size_there_is_no_effect(effect):
    joint, more = ODD[effect]
    for name in ("hh800", "ur10e"):
        machine = built(name)
        at = stops(drawn(machine, 5), machine.payload_kg)
        assert np.abs(shift(machine, Hidden(effect, joint, {"size": 1e-9, **more}), at)).max() < 2e-8


@pytest.mark.slow
@pytest.mark.parametrize("effect", ODD)
def test_in_a_campaign_it_is_a_matter_of_some_tens_of_micrometres(effect):
    machine, seen = built("kr210"), []
    clean = engine.campaign(machine, (), 25, 4, truth=True).filter(like="true").to_numpy()
    for seed in range(9):
        hidden = engine.draw_effect(machine, effect, np.random.default_rng(seed))
        moved = engine.campaign(machine, (hidden,), 25, 4, truth=True).filter(like="true").to_numpy() - clean
        seen.append(1e3 * np.sqrt(np.mean(np.sum(moved**2, axis=1))))
    assert 10 < np.median(seen) < 250
    assert 1 < min(seen) <= max(seen) < 800


@pytest.mark.parametrize("name", ["hh800", "kr210"])
def test_loose_cargo_lies_against_the_lower_walls(name):
    machine, size = built(name), 90e-6
    at = stops(drawn(machine, 12), machine.payload_kg)
    slide = size * machine.stiffness[4] / (9.81 * machine.payload_kg)
    down = -(settle(machine, at).bodies[5, :, :3, :3] @ machine.home[5, :3, :3])[:, 2]
    lies = slide * np.clip(10 * down, -1, 1)
    assert (np.abs(lies) == slide).mean() > 0.7
    expected = [
        (reflector(settle(replace(machine, payload_com=machine.payload_com + x), at)) - reflector(settle(machine, at)))[
            k
        ]
        for k, x in enumerate(lies)
    ]
    moved = shift(machine, Hidden("loose_cargo", None, {"size": size}), at)
    assert np.linalg.norm(moved - expected) < 0.01 * np.linalg.norm(moved)
    empty = stops(at.q, 0.0)
    assert np.abs(shift(machine, Hidden("loose_cargo", None, {"size": size}), empty)).max() < 1e-9


@pytest.mark.parametrize(("name", "joint"), [("ur10e", 1), ("kr210", 6), ("hh800", 3)])
def test_a_tight_cable_holds_the_joint_back_towards_its_ends_alone(name, joint):
    machine = built(name)
    at = stops(drawn(machine, 40), 0.0)
    low, high = machine.ranges[joint - 1]
    moved = shift(machine, Hidden("tight_cable", joint, {"size": 1e-4, "free": 0.4}), at)
    way = (at.q[:, joint - 1] - (low + high) / 2) / (high - low) * 2
    held = 1e-4 * np.sign(way) * np.clip((np.abs(way) - 0.4) / 0.6, 0, None)
    assert 5 < (held == 0).sum() < 35
    assert np.abs(moved[held == 0]).max() < 1e-9
    turned = replace(at, q=at.q - held[:, None] * np.eye(6)[joint - 1])
    expected = reflector(settle(machine, turned)) - reflector(settle(machine, at))
    assert np.linalg.norm(moved - expected) < 0.01 * np.linalg.norm(moved)


def test_an_encoder_without_its_low_bits_stops_on_a_grid():
    machine, step = built("ur10e"), 2e-4
    at = stops(drawn(machine, 40), 0.0)
    off, left = angle_about(machine, at, 1, shift(machine, Hidden("lost_bits", 1, {"size": step, "at_rad": 0.3}), at))
    assert left.max() < 1e-7
    assert np.abs(off).max() < 0.501 * step
    assert 0.2 * step < off.std() < 0.4 * step
    cells = (at.q[:, 0] + off - 0.3) / step
    assert np.abs(cells - np.round(cells)).max() < 1e-2


def test_a_rubber_coupling_sums_up_the_loads_of_the_past():
    machine, size, lag = built("kr210"), 1e-4, 90.0
    at = stops(drawn(machine, 15), machine.payload_kg)
    hidden = Hidden("rubber_coupling", 3, {"size": size, "lag_minutes": lag / 60})

    def energy(q3):
        q = at.q.copy()
        q[:, 2] += q3
        mass, centre = placed(machine, at, q).weights()
        return 9.81 * np.sum(mass * centre[..., 2], axis=0)

    load = -(energy(1e-4) - energy(-1e-4)) / 2e-4 / rated_torque(machine)[2]
    since = np.concatenate([[0.0], at.time_s])
    kernel = np.exp(-(at.time_s[:, None] - since[None, :]) / lag)
    given = size * np.tril(kernel[:, 1:] - kernel[:, :-1]) @ load
    angle, left = angle_about(machine, at, 3, shift(machine, hidden, at))
    np.testing.assert_allclose(angle, given, atol=0.03 * np.abs(given).max())
    assert left.max() < 0.1 * np.abs(shift(machine, hidden, at)).max()


def test_a_range_offset_lengthens_every_distance_from_the_tracker_and_turns_no_sight():
    machine, stand = built("hh800"), np.array([6.0, -3.0, 1.2])
    at = stops(drawn(machine, 8), 0.0)
    clean = engine.positions(machine, (), at)
    moved = shift(machine, Hidden("range_offset", None, {"size": -2e-4, "stand_m": tuple(stand)}), at)
    sight = np.linalg.norm(clean - stand, axis=1)
    np.testing.assert_allclose(np.linalg.norm(clean + moved - stand, axis=1) - sight, -2e-4, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 2e-4, atol=1e-9)
