"""Effects move the tool as their counterparts in the engine MuJoCo do, which share no formula with them.

The pairs, with what each parameter means in both worlds, are those of docs/studies/effects_and_physics.py.
"""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from marks import MUJOCO

from casadical.effects import registry

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "studies"))

import counterpart_pairs
import effects_and_physics as study
from pairs_of_effects import tendon

pytestmark = MUJOCO
CASES = {case.name: case for case in study.CASES}
# On one robot, one of each place in the engine: motors, springs, mechanism, settings, measurement.
FAST = ("gear_eccentricity", "friction_windup", "payload_error", "axis_wobble", "refraction")
bench = cache(counterpart_pairs.bench)


@cache
def pair(name: str, robot: str):
    """An effect and its counterpart, which is simulated once."""
    return CASES[name].make(bench(robot, 16))


@pytest.mark.parametrize(
    ("name", "robot"),
    [
        pytest.param(name, robot, marks=() if name in FAST and robot == "kr210" else pytest.mark.slow)
        for name, case in CASES.items()
        for robot in case.robots
    ],
)
def test_as_in_the_engine(name: str, robot: str) -> None:
    apart, moved = pair(name, robot).apart()
    assert moved > 5e-7
    assert apart < CASES[name].limit


@pytest.mark.parametrize("name", [n if n in FAST else pytest.param(n, marks=pytest.mark.slow) for n in CASES])
def test_another_formula_does_not_pass(name: str) -> None:
    """The wrong sign, and one parameter of several wrong by half, are out of every limit."""
    true, limit = pair(name, "kr210"), CASES[name].limit
    assert _apart(true, {label: -value for label, value in true.values.items()}) > 2 * limit
    great = sorted(true.values, key=lambda label: -abs(true.values[label]))[:8]
    strong = max(great, key=lambda label: _alone(true, label))
    assert _apart(true, {**true.values, strong: 0.5 * true.values[strong]}) > limit


def _apart(true, values) -> float:
    return replace(true, values=values).apart(true.there)[0]


def _alone(true, label: str) -> float:
    """How far one parameter alone moves the tool."""
    others = dict.fromkeys(true.values, 0.0)
    return float(np.linalg.norm(replace(true, values={**others, label: true.values[label]}).moved()))


def test_a_balancer_hangs_on_the_link_not_on_its_reading() -> None:
    """The same robot, whose second joint reads 0.3 rad less at the same place."""
    b = bench("kr210", 16)
    joints, q = list(b.robot.joints), b.stops.q.copy()
    old = joints[1]
    joints[1] = replace(old, theta=old.theta + 0.3, lower=old.lower - 0.3, upper=old.upper - 0.3)
    q[:, 1] -= 0.3
    other = replace(b, robot=replace(b.robot, joints=tuple(joints)), stops=replace(b.stops, q=q))
    balanced = tendon(b)
    np.testing.assert_allclose(replace(balanced, bench=other).moved(), balanced.moved(), atol=1e-10)


def test_a_balancer_is_looked_for_at_the_shoulder_alone() -> None:
    kind = type(tendon(bench("kr210", 4)).effects[0])
    assert {effect.joint for effect in kind.candidates(bench("kr210", 4).robot)} == {2}


def test_every_listed_effect_has_a_counterpart() -> None:
    compared = {effect.name for case in study.CASES for effect in case.make(bench("kr210", 4)).effects}
    kinds = [kind for kind in vars(registry).values() if isinstance(kind, type)]
    # The engine measures positions.
    listed = {k.name for k in kinds if getattr(k, "on_list", "") in ("standard", "extended") and not k.from_kind}
    assert listed - compared == set()
