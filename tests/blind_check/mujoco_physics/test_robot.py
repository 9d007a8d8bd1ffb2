"""The four-bar of the HH800: a real chain of bodies, closed by the engine."""

import numpy as np
import pytest

from casadical.blind_check.mujoco_physics import Stop, mechanism
from casadical.blind_check.mujoco_physics.equilibrium import Engine
from casadical.blind_check.mujoco_physics.robot import start

from .machines import built, drawn

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'casadical[withheld]'")


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
