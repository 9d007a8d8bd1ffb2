"""Signatures, which jump from seam to seam, against finite differences of the whole model with the effect in it.

The model takes gravity torques of the robot that has sunk once under its own, and so do the signatures: they agree to
the differences' own round-off, effects that load the joints included.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from bench import batches, campaign, moved_by, robot, with_columns
from marks import slow

from casadical.blind_check.mujoco_physics import Plant
from casadical.blind_check.mujoco_physics.cause import link_angles
from casadical.core.transforms import Symbolic, small_frame
from casadical.diagnosis.linearisation import signatures
from casadical.effects import AxisWobble, Effect, PayloadError
from casadical.effects.base import Context
from casadical.identification.accuracy import predicted

ROBOTS = Path(__file__).parents[2] / "data" / "campaigns" / "robots"
ROUND_OFF = 3e-16 * 5  # m, of a position some metres away


def compare(name: str, effects: list[Effect]) -> None:
    poses = with_columns(campaign(name)[::17], effects)
    base = robot(name).parameters.values
    E, J, Jq = signatures(robot(name), effects, poses, base)
    assert J.shape == (len(poses), 3, len(base))
    assert Jq.shape == (len(poses), 3, 6)
    parameters = [p for e in effects for p in e.parameters()]
    assert E.shape == (len(poses), 3, len(parameters))
    size = np.array([p.scale for p in parameters])
    step = np.hstack([np.zeros((len(size), len(base))), np.diag(size)])
    start = np.concatenate([base, np.zeros(len(size))])
    up, down = (moved_by(name, effects, start + sign * step, poses) for sign in (1, -1))
    expected = (up - down) / 2
    found = (E * size).transpose(2, 0, 1)
    scale = np.abs(expected).max(axis=(1, 2))
    miss = np.abs(found - expected).max(axis=(1, 2))
    wrong = {p.name: (m, s) for p, m, s in zip(parameters, miss, scale, strict=True) if m > 1e-5 * s + 10 * ROUND_OFF}
    assert wrong == {}


@pytest.mark.parametrize("name", ["kr210", *slow("hh800", "ur10e")])
def test_signature_is_the_models_derivative(name: str) -> None:
    for effects in batches(name):
        compare(name, effects)


@pytest.mark.slow
def test_signature_of_the_unknown_is_the_models_derivative() -> None:
    for effects in batches("ur10e", listed=False):
        compare("ur10e", effects)


def test_payload_error_acts_where_the_payload_is() -> None:
    poses = with_columns(campaign("kr210"), [PayloadError()])
    E, _, _ = signatures(robot("kr210"), [PayloadError()], poses, robot("kr210").parameters.values)
    carried = poses.conditions["payload_kg"] > 0
    assert 0 < carried.sum() < len(poses)
    assert np.abs(E[~carried]).max() == 0
    assert np.abs(E[carried] * 0.06).max(axis=(0, 1))[0] > 1e-5


def test_base_columns_are_the_robots_own_derivative() -> None:
    poses = campaign("hh800")[::17]
    r = robot("hh800")
    _, J, Jq = signatures(r, (), poses, r.parameters.values)
    w = poses.condition_matrix(r.conditions, r.declared)
    f = r.model.function("position", ("p",)).map(len(poses))
    for k in (0, 7, len(r.parameters) - 1):
        h = 1e-3 * r.parameters[r.parameters.names[k]].prior
        step = np.zeros(len(r.parameters))
        step[k] = h
        up, down = (f(poses.q.T, w.T, r.parameters.values + s * step).full().T for s in (1, -1))
        np.testing.assert_allclose(J[:, :, k], (up - down) / (2 * h), atol=1e-8 + 1e-6 * np.abs(J[:, :, k]).max())
    # A joint variable moves the arm as its zero does; nothing here depends on the joint's deflection but the loads.
    zero = r.parameters.names.index("theta6")
    np.testing.assert_allclose(Jq[:, :, 5], J[:, :, zero], rtol=1e-3, atol=1e-3 * np.abs(Jq[:, :, 5]).max())


def test_a_wave_of_the_ring_that_stands_still_has_one_cycle_more_on_the_link() -> None:
    """Seen from the link, a vector a (cos q, -sin q) of the ring before it is a (cos 2q, -sin 2q)."""
    poses = campaign("ur10e")[::40]
    moved = []
    for effect in (AxisWobble(4, 1, still=True), AxisWobble(4, 2)):
        wave = {"x_cos": 1e-4, "y_sin": -1e-4, "rx_cos": 2e-4, "ry_sin": -2e-4}
        theta = [wave.get(name, 0.0) for name in effect.sizes()]
        moved.append(moved_by("ur10e", (effect,), np.array([[*robot("ur10e").parameters.values, *theta]]), poses)[0])
    assert np.ptp(moved[0] - predicted(robot("ur10e"), poses)[0], axis=0).min() > 1e-5
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-12)


@dataclass(frozen=True)
class Twist(Effect):
    """Turns link 3 about its own axis, by as much everywhere or as it turns in its bearing."""

    growing: bool = False
    name = "twist"
    size = {"k": (1e-4, "rad")}  # noqa: RUF012 (as effects give it)

    def link(self, number: int, context: Context) -> Symbolic:
        turn = context.turned(3) if self.growing else 1.0
        return small_frame(0, 0, 0, 0, 0, self.value(context, "k") * turn) if number == 3 else ca.SX.eye(4)


@pytest.mark.parametrize("name", ["hh800", "ur10e"])
def test_a_bearing_turns_with_its_link_where_a_four_bar_drives_it(name: str) -> None:
    """The other physics close their loop by circles that meet."""
    poses = campaign(name)[::2]
    plant = Plant.from_dict(json.loads((ROBOTS / f"{name}.json").read_text()))
    E = [signatures(robot(name), [Twist(None, g)], poses, robot(name).parameters.values)[0] for g in (True, False)]
    moving = np.linalg.norm(E[1], axis=(1, 2)) > 1e-3
    turned = ((E[0] * E[1]).sum(axis=(1, 2)) / (E[1] ** 2).sum(axis=(1, 2)))[moving]
    off = np.exp(1j * (turned - link_angles(plant, poses.q)[moving, 2]))
    assert len(off) > 10
    assert np.ptp(turned) > 0.3
    assert np.abs(off - off[0]).max() < 1e-9
