"""Effects move the tool as their counterparts in the simulators do, which share no formula with them.

The pairs, with what each parameter means in both worlds, are those of docs/studies/effects_and_physics.py.
"""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from casadical.effects import registry

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "studies"))

import effects_and_physics as study
from pairs_of_joints import balancer


@cache
def bench(robot: str, poses: int):
    return study.bench(robot, poses)


def pairs(cases):
    return [pytest.param(case, robot, id=f"{case.name}-{robot}") for case in cases for robot in case.robots]


@pytest.mark.parametrize(("case", "robot"), pairs(study.NUMPY))
def test_as_the_simulator_in_numpy(case, robot: str) -> None:
    apart, moved = case.make(bench(robot, 200)).apart("numpy")
    assert moved > 5e-7
    assert apart < case.limit


@pytest.mark.parametrize(("case", "robot"), pairs(study.MUJOCO))
def test_as_the_simulator_in_mujoco(case, robot: str) -> None:
    """At fewer poses: the study takes 200."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra mujoco)")
    apart, moved = case.make(bench(robot, 16)).apart("MuJoCo")
    assert moved > 5e-7
    assert apart < case.limit


@pytest.mark.parametrize("case", study.NUMPY, ids=lambda case: case.name)
def test_another_formula_does_not_pass(case) -> None:
    """The wrong sign, and one parameter of several wrong by half, are out of every limit."""
    pair = case.make(bench("kr210", 60))
    assert (
        replace(pair, values={name: -value for name, value in pair.values.items()}).apart("numpy")[0] > 2 * case.limit
    )
    great = sorted(pair.values, key=lambda name: -abs(pair.values[name]))[:8]
    strong = max(great, key=lambda name: _alone(pair, name))
    wrong = {**pair.values, strong: 0.5 * pair.values[strong]}
    assert replace(pair, values=wrong).apart("numpy")[0] > case.limit


def _alone(pair, name: str) -> float:
    """How far one parameter alone moves the tool."""
    others = dict.fromkeys(pair.values, 0.0)
    return float(np.linalg.norm(replace(pair, values={**others, name: pair.values[name]}).moved()))


def test_a_balancer_hangs_on_the_link_not_on_its_reading() -> None:
    """The same robot, whose second joint reads 0.3 rad less at the same place."""
    b = bench("kr210", 20)
    joints, q = list(b.robot.joints), b.stops.q.copy()
    old = joints[1]
    joints[1] = replace(old, theta=old.theta + 0.3, lower=old.lower - 0.3, upper=old.upper - 0.3)
    q[:, 1] -= 0.3
    other = replace(b, robot=replace(b.robot, joints=tuple(joints)), stops=replace(b.stops, q=q))
    pair = balancer(b)
    np.testing.assert_allclose(replace(pair, bench=other).moved(), pair.moved(), atol=1e-10)


def test_a_balancer_is_looked_for_at_the_shoulder_alone() -> None:
    kind = type(next(e for e in balancer(bench("kr210", 4)).effects))
    assert {effect.joint for effect in kind.candidates(bench("kr210", 4).robot)} == {2}


def test_every_listed_effect_has_a_counterpart() -> None:
    compared = {effect.name for case in study.NUMPY for effect in case.make(bench("kr210", 4)).effects}
    kinds = [kind for kind in vars(registry).values() if isinstance(kind, type)]
    # Simulators measure positions.
    listed = {k.name for k in kinds if getattr(k, "on_list", "") in ("standard", "extended") and not k.from_kind}
    assert listed - compared == set()
