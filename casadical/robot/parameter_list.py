"""Every parameter of a robot's model, with its nominal value, bounds and prior, and why some are always held."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from casadical.core.parameters import Parameter
from casadical.core.parts import FourBar, Joint, Placement, parallel

if TYPE_CHECKING:
    from casadical.robot.robot import Robot

NEAR_PARALLELOGRAM = 0.02

SIX = {w: tuple(f"{w}_{c}" for c in ("x", "y", "z", "rx", "ry", "rz")) for w in ("base", "tool")}


def bar_names(number: int) -> dict[str, str]:
    """Parameters of a four-bar's lengths; number : of the loop, from 1."""
    suffix = "" if number == 1 else f"_{number}"
    return {"crank": f"L5{suffix}", "coupler": f"L4{suffix}", "rocker": f"L3{suffix}"}


def parameters_of(robot: Robot) -> Iterable[Parameter]:
    """All parameters, those first that identifiability prefers: placement, rows, loops, compliance, effects."""
    for which, placement in (("base", robot.base), ("tool", robot.tool)):
        yield from _placement(robot, which, placement)
    for i, joint in enumerate(robot.joints, 1):
        yield from _row(robot, i, joint)
    for k, loop in enumerate(robot.loops, 1):
        yield from _loop(robot, k, loop)
    for i, joint in enumerate(robot.joints, 1):
        if joint.compliance is not None:
            yield _compliance(robot, i, joint.compliance)
    for effect in robot.effects:
        for p in effect.parameters():
            yield replace(p, value=robot.effect_values.get(p.name, p.value))


def _number(robot: Robot, name: str, group: str, unit: str, value: float, held: str = "") -> Parameter:
    width = robot.widths[group]
    bound = width.length_bound if unit == "m" else width.angle_bound
    prior = width.length_prior if unit == "m" else width.angle_prior
    return Parameter(name, group, unit, value, 1e-3, value - bound, value + bound, prior, held)


def _placement(robot: Robot, which: str, placement: Placement) -> Iterable[Parameter]:
    count = {"none": 0, "position": 3, "pose": 6}[placement.unknown]
    start = placement.T[:3, 3] if which == "tool" else np.zeros(3)
    for name, value in list(zip(SIX[which], (*start, 0.0, 0.0, 0.0), strict=True))[:count]:
        yield _number(robot, name, which, "rad" if "_r" in name else "m", float(value))


def _row(robot: Robot, i: int, joint: Joint) -> Iterable[Parameter]:
    # A first row with all six numbers is the base frame itself, as in the paper's Table 1.
    group = "base" if i == 1 and joint.b is not None else "geometry"
    yield _number(robot, f"alpha{i - 1}", group, "rad", joint.alpha)
    yield _number(robot, f"a{i - 1}", group, "m", joint.a)
    if joint.beta is not None:
        yield _number(robot, f"beta{i - 1}", group, "rad", joint.beta)
    if joint.b is not None:
        yield _number(robot, f"b{i - 1}", group, "m", joint.b)
    held = ""
    if _slides_together(robot, i):
        held = f"axes {i} and {i + 1} are nearly parallel: d{i} moves the tool as d{i + 1} does"
    elif i > 1 and robot.base.unknown != "none" and all(_slides_together(robot, k) for k in range(1, i)):
        held = f"axes 1 to {i} are nearly parallel: d{i} moves the tool as the base does"
    yield _number(robot, f"d{i}", group, "m", joint.d, held)
    yield _number(robot, f"theta{i}", group, "rad", joint.theta)


def _slides_together(robot: Robot, i: int) -> bool:
    """Whether joints i and i+1 (1-based) turn about nearly parallel axes, so that their d are one."""
    return parallel(robot.joints, i - 1) and all(j.kind == "revolute" for j in robot.joints[i - 1 : i + 1])


def _loop(robot: Robot, k: int, loop: FourBar) -> Iterable[Parameter]:
    names = bar_names(k)
    ground = abs(robot.joints[loop.driven - 1].a)
    parallelogram = (
        abs(loop.crank - loop.rocker) < NEAR_PARALLELOGRAM * loop.rocker
        and abs(loop.coupler - ground) < NEAR_PARALLELOGRAM * ground
    )
    scale = f"only the difference {names['crank']} - {names['rocker']} turns the driven link of a parallelogram"
    for bar, name in names.items():
        held = scale if bar == "rocker" and parallelogram else ""
        yield _number(robot, name, "loop", "m", getattr(loop, bar), held)


def _compliance(robot: Robot, i: int, value: float) -> Parameter:
    width = robot.widths["compliance"]
    rotary = robot.joints[i - 1].kind == "revolute"
    bound, prior = (width.angle_bound, width.angle_prior) if rotary else (width.length_bound, width.length_prior)
    load = _greatest_load(robot, i)
    unit = "rad/(N m)" if rotary else "m/N"
    return Parameter(f"c{i}", "compliance", unit, value, 1e-3 / load, 0.0, value + bound / load, prior / load)


def _greatest_load(robot: Robot, i: int) -> float:
    """Roughly the greatest torque [N m] (or force [N]) at joint i: all weight beyond it at half the reach beyond."""
    beyond = robot.joints[i - 1 :]
    mass = sum(j.body.mass for j in beyond if j.body) + (robot.payload.mass if robot.payload else 0.0)
    reach = sum(abs(j.a) + abs(j.d) for j in beyond) + float(np.linalg.norm(robot.tool.T[:3, 3]))
    lever = 1.0 if robot.joints[i - 1].kind == "prismatic" else max(0.5 * reach, 0.05)
    return max(mass * float(np.linalg.norm(robot.gravity)) * lever, 1e-3)
