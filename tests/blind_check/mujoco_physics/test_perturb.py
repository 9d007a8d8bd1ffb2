"""Perturbed robots: errors of the stated size in all six directions of every link, the base and the reflector."""

import numpy as np
from scipy.spatial.transform import Rotation

from casadical.blind_check.mujoco_physics import Plant, perturb

from .machines import HH800, nominal

ARM = nominal("kr210")


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
