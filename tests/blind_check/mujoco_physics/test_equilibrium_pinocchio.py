"""Rest of the robots against Pinocchio: equilibrium of its gravity torques with the springs."""

import numpy as np
import pinocchio as pin
import pytest

from casadical.blind_check import mujoco_physics as engine
from casadical.blind_check.mujoco_physics.equilibrium import Engine, Stop
from casadical.blind_check.mujoco_physics.robot import start

from .machines import built, drawn, stops
from .oracle import model, rest

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'casadical[withheld]'")


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
