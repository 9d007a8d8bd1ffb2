"""Campaigns: the columns, determinism, noise of the stated size, limits, and messages for arguments not usable."""

import numpy as np
import pandas as pd
import pytest
from planted import campaign, planted
from scipy.spatial.transform import Rotation

from casadical.blind_check.mujoco_physics import Plant, Warmup, perturb
from casadical.blind_check.mujoco_physics.cause import settle
from casadical.blind_check.mujoco_physics.plant import crank_distance
from casadical.core.basics import ConvergenceError, InputError

from .machines import HH800, KR210, nominal, stops

ARM = nominal("kr210")

COLUMNS = [
    *("pose", "time_s", "temperature_degC", "payload_kg"),
    *(f"approach{j}" for j in range(1, 7)),
    *(f"q{j}_deg" for j in range(1, 7)),
    *("x_mm", "y_mm", "z_mm"),
]
XYZ, TRUE = ["x_mm", "y_mm", "z_mm"], ["x_true_mm", "y_true_mm", "z_true_mm"]


def test_columns_and_rounding() -> None:
    table = campaign(ARM, 40, 1)
    assert list(table.columns) == COLUMNS
    assert table["pose"].tolist() == list(range(1, 41))
    assert set(table["payload_kg"]) == {0.0, KR210["payload"]["mass_kg"]}
    assert table["payload_kg"].diff().ne(0).sum() == 4  # four blocks
    assert set(np.unique(table[[f"approach{j}" for j in range(1, 7)]])) == {-1, 1}
    assert table["time_s"].diff().dropna().between(19.9, 40.1).all()
    for name, digits in (("time_s", 1), ("temperature_degC", 2), ("q1_deg", 6), ("x_mm", 4)):
        assert (table[name] == table[name].round(digits)).all()


def test_same_seed_same_table() -> None:
    plant = perturb(ARM, 1)
    parts = [planted("outliers", share=0.1, size=1e-3), planted("backlash", 2, size=60e-6)]
    pd.testing.assert_frame_equal(campaign(plant, 30, 5, parts), campaign(perturb(ARM, 1), 30, 5, parts))
    assert not campaign(plant, 30, 5).equals(campaign(plant, 30, 6))
    assert not campaign(perturb(ARM, 2), 30, 5).equals(campaign(plant, 30, 5))


def test_effects_leave_poses_and_noise_alone() -> None:
    plant = perturb(ARM, 1)
    clean, disturbed = (
        campaign(plant, 200, 5, hidden, truth=True) for hidden in ((), [planted("gear_eccentricity", 2)])
    )
    others = [c for c in COLUMNS if c not in XYZ]
    pd.testing.assert_frame_equal(clean[others], disturbed[others])
    noise = [table[XYZ].to_numpy() - table[TRUE].to_numpy() for table in (clean, disturbed)]
    np.testing.assert_allclose(noise[0], noise[1], atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("noise_mm", "urad"), [(0.05, 0.0), (0.0, 20.0)])
def test_noise_has_the_stated_size(noise_mm: float, urad: float) -> None:
    table = campaign(ARM, 2000, 7, noise_mm=noise_mm, repeatability_urad=urad, truth=True)
    rms = np.sqrt(np.mean((table[XYZ].to_numpy() - table[TRUE].to_numpy()) ** 2))
    if noise_mm:
        assert rms == pytest.approx(noise_mm, rel=0.03)
    else:  # six joints at about 0.3-2.5 m from the reflector
        assert 0.01 < rms < 0.05


def test_loop_and_ranges_are_kept() -> None:
    plant = perturb(Plant.from_dict(HH800), 1)
    table = campaign(plant, 300, 2)
    q = np.deg2rad(table[[f"q{j}_deg" for j in range(1, 7)]].to_numpy())
    low, high = (edge for edge in plant.ranges.T)
    assert ((q >= low - 1e-9) & (q <= high + 1e-9)).all()
    distance = crank_distance(plant, q)
    assert distance.min() > 0.99
    assert distance.max() < 2.21
    narrow = campaign(plant, 50, 2, crank_distance_m=(1.5, 1.6))
    assert np.ptp(crank_distance(plant, np.deg2rad(narrow[[f"q{j}_deg" for j in range(1, 7)]].to_numpy()))) < 0.1


def test_own_readings_payloads_and_temperature() -> None:
    q = np.random.default_rng(0).uniform(-60, 60, (25, 6))
    table = campaign(
        ARM, 25, 1, q_deg=q, payload_states=[40.0], warmup=Warmup(30.0, 0.0, sensor_K=0.0), approach="motion"
    )
    np.testing.assert_allclose(table[[f"q{j}_deg" for j in range(1, 7)]], q, atol=1e-6)
    assert (table["payload_kg"] == 40.0).all()
    assert (table["temperature_degC"] == 30.0).all()
    assert (table["approach3"].to_numpy()[1:] == np.sign(np.diff(q[:, 2]))).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n": 0}, "n is 0"),
        ({"noise_mm": -1.0}, "noise_mm is -1.0"),
        ({"q_deg": np.zeros((3, 6))}, r"q_deg has shape \(3, 6\)"),
        ({"ranges_deg": np.zeros((5, 2))}, r"ranges_deg has shape \(5, 2\)"),
        ({"payload_states": []}, "payload_states is empty"),
    ],
)
def test_unusable_arguments(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        campaign(ARM, **({"n": 5, "seed": 1} | arguments))


def test_unusable_loop_limits() -> None:
    with pytest.raises(InputError, match="only 0 of 5 poses"):
        campaign(Plant.from_dict(HH800), 5, 1, crank_distance_m=(3.0, 4.0))


def test_unusable_robots() -> None:
    with pytest.raises(InputError, match="'com_m' is missing"):
        Plant.from_dict({k: v for k, v in KR210.items() if k != "com_m"})
    with pytest.raises(InputError, match=r"mass_kg has shape \(2,\)"):
        Plant.from_dict(KR210 | {"mass_kg": [1.0, 2.0]})
    with pytest.raises(InputError, match=r"mass_kg has shape \(6,\); it must be finite numbers of shape \(5,\)"):
        Plant.from_dict(KR210 | {"modified_dh": KR210["modified_dh"][:5]})


def test_a_robot_too_soft_does_not_come_to_rest() -> None:
    soft = Plant.from_dict(KR210 | {"stiffness_Nm_per_rad": [10.0] * 6})
    with pytest.raises(ConvergenceError, match="too soft"):
        settle(soft, stops(np.full((3, 6), 0.5), 100.0))


def link_errors(nominal: Plant, plant: Plant) -> np.ndarray:
    """Errors (6, 6) of the links: rotation vector [mrad] and shift [mm] of each, in its own end frame."""
    errors = []
    for i in range(6):
        links = [np.linalg.solve(p.home[i - 1] if i else np.eye(4), p.home[i]) for p in (nominal, plant)]
        wrong = np.linalg.solve(*links)
        errors.append([*Rotation.from_matrix(wrong[:3, :3]).as_rotvec() * 1e3, *wrong[:3, 3] * 1e3])
    return np.array(errors)


def test_every_direction_of_every_link_is_wrong_by_the_stated_size() -> None:
    draws = np.array([link_errors(ARM, perturb(ARM, s, length_mm=0.4, angle_mrad=0.2)) for s in range(400)])
    spread = draws.std(0)
    np.testing.assert_allclose(spread[:, :3], 0.2, rtol=0.15)
    np.testing.assert_allclose(spread[:, 3:], 0.4, rtol=0.15)
    np.testing.assert_allclose(draws.mean(0), 0.0, atol=0.08)


def test_base_reflector_and_stiffness() -> None:
    many = [perturb(ARM, s) for s in range(300)]
    shift = [np.linalg.norm(p.base[:3, 3]) for p in many]
    turn = [np.rad2deg(Rotation.from_matrix(p.base[:3, :3]).magnitude()) for p in many]
    assert 0.025 < max(shift) <= 0.03
    assert 1.7 < max(turn) <= 2.0
    assert abs(np.std([p.reflector for p in many] - ARM.reflector) - 1e-3) < 1e-4
    assert abs(np.std([np.log(p.stiffness / ARM.stiffness) for p in many]) - 0.4) < 0.03


def test_bars_and_crank_are_wrong_too_but_not_the_rocker() -> None:
    nominal = Plant.from_dict(HH800).four_bar
    bar = perturb(Plant.from_dict(HH800), 1).four_bar
    assert nominal is not None
    assert bar is not None
    assert bar.rocker_m == nominal.rocker_m  # it sets the loop's scale
    for name in ("crank_m", "coupler_m", "crank_zero_rad"):
        assert 0 < abs(getattr(bar, name) - getattr(nominal, name)) < 2e-3


def test_zero_errors_leave_the_robot() -> None:
    same = perturb(ARM, 1, length_mm=0, angle_mrad=0, base=(0, 0), tool_mm=0, stiffness_spread=0)
    for name in ("home", "base", "reflector", "stiffness"):
        np.testing.assert_allclose(getattr(same, name), getattr(ARM, name), atol=1e-15)
