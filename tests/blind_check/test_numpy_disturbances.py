"""Every disturbance: nothing at size zero, a plausible shift at its own size, and the physics that it claims."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from numpy_physics import HH800, disturbances
from numpy_physics.disturbance import Disturbance
from numpy_physics.state import GRAVITY, State
from numpy_physics.statics import placed, settle, tool_point
from plants import arm, stops_at
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

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


def test_play_follows_the_load_and_friction_the_approach() -> None:
    plant = arm()
    rest = rest_of(plant, draw_poses(plant, 80, np.random.default_rng(1), plant.ranges, None))
    back = replace(rest, stops=replace(rest.stops, approach=-rest.stops.approach))
    play, heavy = disturbances.Backlash(5), np.abs(rest.load[:, 4]) > 0.25 * rest.rated[4]
    twist = play.twist(rest)[:, 4]
    assert heavy.sum() > 10
    np.testing.assert_allclose(twist[heavy], 60e-6 * np.sign(rest.load[heavy, 4]), rtol=1e-2)
    idle = replace(rest, load=np.zeros_like(rest.load))
    assert (play.twist(idle)[:, 4] < -40e-6).all()  # stopped upwards, nothing pulls: it hangs behind
    friction = disturbances.FrictionWindup(5)
    np.testing.assert_allclose(friction.twist(rest), -friction.twist(back))
    assert friction.twist(rest)[heavy, 4].mean() < friction.twist(idle)[:, 4].mean() < 0


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


def test_flexure_is_a_cantilever() -> None:
    """A weight at the end of the last link, far from the joint: F L^3 / 3 EI and the slope F L^2 / 2 EI."""
    plant = replace(arm(), mass=np.full(6, 1e-9), payload_com=arm().reflector)
    q = np.zeros((1, 6))
    beam = disturbances.LinkFlexure(3, size=1e-4)
    rest = placed(plant, stops_at(q, 100.0), q)
    D = beam.outboard(3, rest)
    assert D is not None
    root, tip, end = plant.stations[3], plant.stations[4], plant.at_home(6, plant.reflector)
    e, length = (tip - root) / np.linalg.norm(tip - root), float(np.linalg.norm(tip - root))
    force = np.array([0, 0, -GRAVITY * 100.0])
    steps = np.linalg.norm(np.diff(plant.stations, axis=0), axis=-1)
    stiffness = GRAVITY * 100 * (steps[4:6].sum() + np.linalg.norm(plant.reflector)) * length / 1e-4

    def bent(s: float) -> np.ndarray:
        """Curvature at s from the root, by the moment of the weight there; the twist is the torque over GJ."""
        moment = np.cross(end - (root + s * e), force) / stiffness
        along = (moment @ e) * e
        return moment - along + along / 0.8

    slope = [quad(lambda s, k=k: bent(s)[k], 0, length)[0] for k in range(3)]
    sag = [quad(lambda s, k=k: np.cross(bent(s), (length - s) * e)[k], 0, length)[0] for k in range(3)]
    np.testing.assert_allclose(Rotation.from_matrix(D[0, :3, :3]).as_rotvec(), slope, atol=1e-12)
    np.testing.assert_allclose(D[0, :3, :3] @ tip + D[0, :3, 3] - tip, sag, atol=1e-12)


def test_links_grow_by_their_length() -> None:
    """Every link at the surface's warmth: the arm is the same shape, larger; the tool stays 30 % of it."""
    plant = replace(arm(), stiffness=np.full(6, 1e15), reflector=np.zeros(3))
    q = draw_poses(plant, 20, np.random.default_rng(3), plant.ranges, None)
    hot = replace(stops_at(q, 0.0), warmth_K=np.full(20, 10.0))
    grown = tool_point(settle(plant, hot, [disturbances.ThermalGrowth(size=1e-5, lag_minutes=1e-9)]))
    np.testing.assert_allclose(grown, tool_point(settle(plant, hot)) * (1 + 1e-4), atol=1e-9)


def test_wobble_and_tilt_leave_the_links_rigid() -> None:
    plant, stops = arm(), some_stops(arm(), 20)
    for effect, joint in (("axis_wobble", 4), ("base_compliance", 0), ("loose_flange", 0), ("bearing_sag", 3)):
        bodies = settle(plant, stops, [made(effect, joint)]).bodies
        R = bodies[..., :3, :3]
        np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-13)


def test_a_step_comes_once_and_the_frame_creeps() -> None:
    plant = arm()
    stops = some_stops(plant, 40)
    for effect in ("joint_zero_step", "target_shift"):
        length = np.linalg.norm(shifts_mm(plant, stops, made(effect)), axis=1)
        assert (length[:20] == 0).all()
        assert (length[20:] > 0).all()
    still = replace(stops, q=np.repeat(stops.q[:1], 40, 0), payload_kg=np.zeros(40))
    crept = np.linalg.norm(shifts_mm(plant, still, made("frame_drift")), axis=1)
    assert (np.diff(crept) > 0).all()


def test_warmth_lags_as_newton_cools() -> None:
    """After a sudden step of the surface by 1 K a part with a lag of 10 minutes is at 1 - exp(-t / 10 min)."""
    stops = replace(stops_at(np.zeros((50, 6)), 0.0), warmth_K=np.ones(50))
    np.testing.assert_allclose(stops.warmth_after(10.0), 1 - np.exp(-stops.time_s / 600.0), rtol=1e-12)


def test_every_word_of_the_diagnosis_has_a_disturbance() -> None:
    assert len(disturbances.LISTED) == 18
    assert not disturbances.LISTED.keys() & disturbances.UNLISTED.keys()
