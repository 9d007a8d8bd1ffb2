"""Where the engine comes to rest, against Pinocchio and the work of the motors."""

import numpy as np
import pinocchio as pin
import pytest

from casadical.blind_check import mujoco_physics as engine
from casadical.blind_check.mujoco_physics import mechanism
from casadical.blind_check.mujoco_physics.equilibrium import Engine, Stop
from casadical.blind_check.mujoco_physics.robot import start

from .machines import ROBOTS, built, drawn, stops
from .oracle import model, rest

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'casadical[withheld]'")
TRUE = ["x_true_mm", "y_true_mm", "z_true_mm"]


@pytest.mark.parametrize("name", ROBOTS)
def test_the_same_rest_is_reached_by_a_simulated_move(name):
    machine = built(name)
    idle = engine.Hidden("friction_windup", 2, {"size": 1e-12, "load_share": 0.0})
    moved, still = (engine.campaign(machine, h, 8, 4, truth=True) for h in ((idle,), ()))
    assert np.abs(moved[TRUE] - still[TRUE]).to_numpy().max() < 1e-5


# The engine's loop is not rigid: its coupler gives as much as would a joint 10,000 times stiffer than joint 3.
@pytest.mark.parametrize(("name", "within_um"), [("hh800", 0.2), ("kr210", 0.05), ("ur10e", 0.05)])
def test_without_effects_the_engine_rests_where_pinocchios_weights_and_the_springs_are_in_balance(name, within_um):
    machine = built(name)
    q = drawn(machine, 4)
    for payload in (0.0, machine.payload_kg):
        ours = engine.positions(machine, (), stops(q, payload))
        theirs = np.array([rest(machine, payload, angles) for angles in q])
        assert np.linalg.norm(ours - theirs, axis=1).max() < 1e-6 * within_um


def test_the_springs_of_the_engine_carry_pinocchios_weights():
    machine = built("kr210")
    moving = Engine(engine.mechanism(machine))
    for q in drawn(machine, 5):
        moving.rest(Stop(q, np.ones(6), start(machine, q), machine.payload_kg))
        angles = np.array([moving.coordinate(f"joint{j}") for j in range(1, 7)])
        tree = model(machine, machine.payload_kg)
        weights = pin.computeGeneralizedGravity(tree, tree.createData(), angles)
        np.testing.assert_allclose(machine.stiffness * (angles - q), -weights, atol=1e-5 * np.abs(weights).max())


def test_the_loop_closes_within_a_tenth_of_a_micrometre_under_full_load():
    machine = built("hh800")
    moving = Engine(mechanism(machine))
    for q in drawn(machine, 12):
        moving.rest(Stop(q, np.ones(6), start(machine, q), machine.payload_kg))
        ends = [moving.data.site(name).xpos for name in ("coupler_end", "rocker_end")]
        assert np.linalg.norm(ends[0] - ends[1]) < 1e-7


def test_the_motors_work_is_the_change_of_the_engines_energy():
    """Turning a motor a little costs its torque times the angle: weights, springs and the coupler are in balance."""
    machine = built("hh800")
    moving = Engine(mechanism(machine))
    moving.model.opt.enableflags |= int(moving.mujoco.mjtEnableBit.mjENBL_ENERGY)

    def energy(angles: np.ndarray) -> tuple[float, np.ndarray]:
        moving.rest(Stop(angles, np.ones(6), start(machine, angles), machine.payload_kg))
        at = np.array([moving.coordinate(f"joint{j}") for j in range(1, 7)])
        return float(moving.data.energy[0]), machine.stiffness * (angles - at)

    step = 1e-3
    for q in drawn(machine, 3, seed=3):
        torque = energy(q)[1]
        for motor in range(6):
            above, below = (energy(q + sign * step * np.eye(6)[motor])[0] for sign in (1, -1))
            assert (above - below) / (2 * step) == pytest.approx(torque[motor], abs=1e-4 * np.abs(torque).max())
