"""Every disturbance: nothing at size zero, a plausible shift at its own size, and what no pair with an effect tells."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from numpy_physics import HH800, disturbances
from numpy_physics.disturbance import Disturbance
from numpy_physics.state import State
from numpy_physics.statics import placed, settle, tool_point
from plants import arm, stops_at
from scipy.integrate import quad
from scipy.optimize import brentq

from casadical.blind_check.mujoco_physics import Plant, perturb
from casadical.blind_check.mujoco_physics.cause import rated_torque
from casadical.blind_check.mujoco_physics.stops import Stops, Warmup, draw_poses, draw_stops

ALL = disturbances.LISTED | disturbances.UNLISTED
NOTHING: dict[str, dict[str, Any]] = {
    "gear_eccentricity": {"size": 0.0, "oval": 0.0},
    "axis_wobble": {"size": 0.0, "shift_m": 0.0},
    "target_shift": {"shift_m": (0.0, 0.0, 0.0)},
    "payload_error": {"size": 0.0, "shift_m": (0.0, 0.0, 0.0)},
    "frame_drift": {"shift_m": 0.0, "turn_rad": 0.0},
    "beam_refraction": {"size": 0.0, "gradient_K_per_m": 0.0},
}


def made(effect: str, joint: int = 5, **sizes: Any) -> Disturbance:
    needed = {f.name for f in fields(ALL[effect])}
    where = {"joint": joint, "source": joint - 1}
    return ALL[effect](**{k: v for k, v in where.items() if k in needed}, **sizes)


def some_stops(plant: Plant, n: int = 60, seed: int = 1) -> Stops:
    q = draw_poses(plant, n, np.random.default_rng(seed), plant.ranges, (1.0, 2.2))
    return draw_stops(q, np.random.SeedSequence(seed).spawn(2), [0.0, plant.payload_kg], Warmup())


def shifts_mm(plant: Plant, stops: Stops, disturbance: Disturbance) -> np.ndarray:
    clean = tool_point(settle(plant, stops))
    xyz = tool_point(settle(plant, stops, [disturbance]), [disturbance])
    return 1e3 * (disturbance.measured(xyz, stops, np.random.default_rng(0)) - clean)


@pytest.fixture(scope="module", params=["arm", "hh800"])
def plant(request: pytest.FixtureRequest) -> Plant:
    return perturb(arm() if request.param == "arm" else Plant.from_dict(HH800), 3)


@pytest.mark.parametrize("effect", ALL)
def test_zero_size_does_nothing(plant: Plant, effect: str) -> None:
    shift = shifts_mm(plant, some_stops(plant), made(effect, **NOTHING.get(effect, {"size": 0.0})))
    assert np.abs(shift).max() < 1e-9


@pytest.mark.parametrize("effect", ALL)
def test_own_size_moves_the_tool_plausibly(plant: Plant, effect: str) -> None:
    length = np.linalg.norm(shifts_mm(plant, some_stops(plant), made(effect, joint=3)), axis=1)
    assert 3e-3 < length.mean() < 0.6
    assert length.max() < (5.0 if effect == "outliers" else 2.0)


@pytest.mark.parametrize("effect", sorted(ALL.keys() - {"outliers"}))
def test_twice_the_size_moves_about_twice(effect: str) -> None:
    """Nothing jumps with the size; the doubled shift is within 15 % of twice, as all sizes here are small."""
    plant, stops = arm(), some_stops(arm())
    default = made(effect)
    sizes = NOTHING.get(effect, {"size": 0.0})
    twice = {k: tuple(2 * x for x in v) if isinstance(v := getattr(default, k), tuple) else 2 * v for k in sizes}
    once, more = shifts_mm(plant, stops, default), shifts_mm(plant, stops, made(effect, **twice))
    assert np.linalg.norm(more - 2 * once) < 0.15 * np.linalg.norm(2 * once)


def rest_of(plant: Plant, q: np.ndarray, payload_kg: float = 100.0) -> State:
    return replace(settle(plant, stops_at(q, payload_kg)), rated=rated_torque(plant))


def test_hardening_spring_obeys_its_cubic() -> None:
    plant = arm()
    q = draw_poses(plant, 20, np.random.default_rng(1), plant.ranges, None)
    rest = rest_of(plant, q)
    spring = disturbances.HardeningSpring(2, size=1e-4, linear=0.15)
    for x, load in zip(spring.twist(rest)[:, 1], rest.load[:, 1] / rest.rated[1], strict=True):
        root = brentq(lambda u, r=load: 0.15 * u + 0.85 * u**3 - r, -2, 2, xtol=1e-14)
        assert x == pytest.approx(1e-4 * root, abs=1e-15)


def test_balancer_torque_is_the_slope_of_the_springs_energy() -> None:
    plant = arm()
    spring = disturbances.SpringBalancer(size=0.3, free_length_m=0.4)
    q = draw_poses(plant, 15, np.random.default_rng(2), plant.ranges, None)
    arm_length = np.linalg.norm(plant.centres[2] - plant.centres[1])
    reach, rated = 0.35 * arm_length, rated_torque(plant)

    def energy(q2: float) -> float:
        """Work against a pull of k (length - free), from the two ends, drawn in the upper arm's plane."""
        lean = q2 + np.pi / 2  # the arm stands at -90 deg
        post, lug = np.array([0.0, reach]), reach * np.array([np.sin(lean), np.cos(lean)])
        k = 0.3 * rated[1] / reach**2
        return float(quad(lambda x: k * (x - 0.4 * reach), 0, float(np.linalg.norm(post - lug)))[0])

    torque = spring.torque(replace(placed(plant, stops_at(q, 0.0), q), rated=rated))[:, 1]
    slope = [(energy(a - 1e-5) - energy(a + 1e-5)) / 2e-5 for a in q[:, 1]]
    np.testing.assert_allclose(torque, slope, rtol=1e-5, atol=1e-3)


def test_warmth_lags_as_newton_cools() -> None:
    """After a sudden step of the surface by 1 K a part with a lag of 10 minutes is at 1 - exp(-t / 10 min)."""
    stops = replace(stops_at(np.zeros((50, 6)), 0.0), warmth_K=np.ones(50))
    np.testing.assert_allclose(stops.warmth_after(10.0), 1 - np.exp(-stops.time_s / 600.0), rtol=1e-12)


def test_every_word_of_the_diagnosis_has_a_disturbance() -> None:
    assert len(disturbances.LISTED) == 18
    assert not disturbances.LISTED.keys() & disturbances.UNLISTED.keys()
