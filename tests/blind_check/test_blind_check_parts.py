"""Parts of the simulator and of the protocol by hand: levers, links, draws, circumstances, refusals."""

from pathlib import Path
from time import sleep

import numpy as np
import plants
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from casadical.blind_check import mujoco_physics, worker_pool
from casadical.blind_check.generation import unabsorbed_rms
from casadical.blind_check.mujoco_physics.cause import placed
from casadical.blind_check.mujoco_physics.causes_load import greatest_torque
from casadical.blind_check.mujoco_physics.hidden import Hidden, cause
from casadical.blind_check.mujoco_physics.plant import home_with_errors
from casadical.blind_check.mujoco_physics.robot import mechanism
from casadical.blind_check.mujoco_physics.stops import Warmup, draw_stops
from casadical.blind_check.protocol import read_table
from casadical.core.basics import InputError

ARM = plants.arm()
Q = np.random.default_rng(0).uniform(-0.5, 0.5, (4, 6))


def test_what_the_base_model_does_not_absorb() -> None:
    J = np.zeros((2, 3, 1))
    J[0, 0] = J[1, 0] = 1.0
    shift = np.array([[1.0, 3, 0], [3.0, 0, 0]])
    assert unabsorbed_rms(J, shift) == pytest.approx(np.sqrt((1 + 1 + 9) / 6))


def test_weights_hang_at_the_mass_centres_of_their_links() -> None:
    state = placed(ARM, plants.stops_at(np.zeros((1, 6)), 80.0), np.zeros((1, 6)))
    mass, centre = state.weights()
    assert mass[:, 0].tolist() == [*ARM.mass, 80.0]
    for i in range(6):
        expected = ARM.home[i, :3, :3] @ ARM.com[i] + ARM.home[i, :3, 3]
        np.testing.assert_allclose(centre[i, 0], expected, atol=1e-12)
    np.testing.assert_allclose(centre[6, 0], ARM.home[5, :3, :3] @ ARM.payload_com + ARM.home[5, :3, 3], atol=1e-12)


def test_errors_of_the_links_add_up_along_the_chain() -> None:
    assert home_with_errors(ARM, np.tile(np.eye(4), (6, 1, 1))) == pytest.approx(ARM.home, abs=1e-12)
    wrong = np.tile(np.eye(4), (6, 1, 1))
    wrong[1, :3, :3] = Rotation.from_rotvec([0.01, 0, 0.02]).as_matrix()
    found = home_with_errors(ARM, wrong)
    np.testing.assert_allclose(found[0], ARM.home[0], atol=1e-12)
    at = ARM.home[1]
    for k in range(1, 6):  # all beyond link 2 turn about its frame
        np.testing.assert_allclose(found[k], at @ wrong[1] @ np.linalg.inv(at) @ ARM.home[k], atol=1e-12)


def test_approaches_follow_from_the_order() -> None:
    q = np.array([[0.0] * 6, [0.5] * 6, [0.2] * 6, [0.2, 0.9, 0.1, 0.3, -1, 0.2]])
    stops = draw_stops(q, np.random.SeedSequence(0).spawn(4), [0.0], Warmup(), "motion")
    assert stops.approach[1:].tolist() == [[1.0] * 6, [-1.0] * 6, [1, 1, -1, 1, -1, 1]]
    chance = draw_stops(np.zeros((20, 6)), np.random.SeedSequence(0).spawn(4), [0.0], Warmup()).approach
    assert {*chance.ravel()} == {-1.0, 1.0}


def test_drawn_sizes_lie_in_their_ranges() -> None:
    rng = np.random.default_rng(0)
    drawn = [mujoco_physics.draw_effect(ARM, "gear_eccentricity", rng).size for _ in range(300)]
    ovals = [size["oval"] / size["size"] for size in drawn]
    assert 0.2 <= min(ovals) < 0.225
    assert 0.775 < max(ovals) <= 0.8
    assert np.mean(np.log([size["size"] / 40e-6 for size in drawn])) == pytest.approx(0.2, abs=0.1)
    loads = np.array([mujoco_physics.draw_effect(ARM, "payload_error", rng).size["size"] for _ in range(300)])
    assert np.median(loads[loads > 0]) == pytest.approx(-np.median(loads[loads < 0]), rel=0.3)
    drifts = [mujoco_physics.draw_effect(ARM, "frame_drift", rng).size for _ in range(20)]
    shift, turn = (np.array([np.linalg.norm(size[k]) for size in drifts]) for k in ("shift_m", "turn_rad"))
    np.testing.assert_allclose(shift / turn, shift[0] / turn[0])  # both as many times as great as they usually are


@pytest.mark.parametrize("joint", [0, 7, None])
def test_an_effect_sits_in_a_joint_that_there_is(joint: int | None) -> None:
    with pytest.raises(InputError, match="needs a joint from 1 to 6"):
        cause(Hidden("joint_scale", joint, {"size": 1e-5}))
    assert cause(Hidden("joint_scale", 6, {"size": 1e-5}))


def test_a_crack_and_a_beam_are_cut_where_they_say() -> None:
    whole = mechanism(ARM)
    link = np.array(ARM.centres[2] - ARM.centres[1])
    cracked = cause(Hidden("cracked_link", None, {"link": 2, "size": 1e-4, "towards": 0.3})).built(whole, ARM)
    place = cracked.body("beyond_crack").place
    assert place.shape == (4, 4)
    assert np.linalg.norm(place[:3, 3]) == pytest.approx(0.3 * np.linalg.norm(link))
    beam = cause(Hidden("link_flexure", None, {"link": 2, "size": 1e-4, "torsion": 0.5})).built(whole, ARM)
    middle, own = beam.body("link2a"), whole.body("link2")
    assert (middle.mass, beam.body("link2").mass) == (own.mass, 0.0)
    np.testing.assert_allclose(middle.place[:3, 3] + middle.com, own.com)  # its mass centre stays
    for name, share in (("link2a", 0.25), ("link2b", 0.5)):  # the second is seen from the first
        place = beam.body(name).place
        assert place.shape == (4, 4)
        assert np.linalg.norm(place[:3, 3]) == pytest.approx(share * np.linalg.norm(link))


@pytest.mark.parametrize("post", [0.6, 1.4])
def test_the_greatest_torque_of_a_balancer_is_the_slope_of_its_energy(post: float) -> None:
    lever, rest = 0.3, 0.1
    found = greatest_torque(lever, post, rest)

    def slope(angle: float) -> float:
        def energy(a: float) -> float:
            end = np.array([post * lever - lever * np.cos(a), lever * np.sin(a)])
            return 0.5 * float((np.linalg.norm(end) - rest) ** 2)

        return (energy(angle + 1e-6) - energy(angle - 1e-6)) / 2e-6

    greatest = -minimize_scalar(lambda a: -slope(a), bounds=(0, np.pi), method="bounded").fun
    assert found == pytest.approx(greatest, rel=1e-3)


def test_a_campaign_that_is_missing_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("q1_deg,x_mm\n1.0,2.0\n")
    assert read_table(tmp_path, "a")["x_mm"].tolist() == [2.0]
    with pytest.raises(InputError, match=r"b\.csv: is missing, though"):
        read_table(tmp_path, "b")


def test_workers_are_left_at_once_where_the_work_fails() -> None:
    tasks = []

    def interrupted() -> None:
        with worker_pool.workers(None, 1) as pool:
            tasks.append(pool.submit(sleep, 3))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not tasks[0].done()
    with worker_pool.workers(None, 1) as pool:
        task = pool.submit(sleep, 0.1)
    assert task.done()
