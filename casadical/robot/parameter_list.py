"""All parameters of a robot's model: nominal value, bounds, prior, and why some are fixed."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from casadical.core.parameters import Parameter
from casadical.core.parts import Arm, FourBar, Joint, parallel
from casadical.effects import Effect, LinkMasses, PayloadError, Session

# Frame (base or tool) -> names of its six parameters: position x, y, z and rotation rx, ry, rz.
PLACEMENT_PARAMETERS = {w: tuple(f"{w}_{c}" for c in ("x", "y", "z", "rx", "ry", "rz")) for w in ("base", "tool")}


def bar_names(number: int) -> dict[str, str]:
    """Return bar (crank, coupler, rocker) -> parameter name of its length.

    number : of the loop, from 1
    """
    suffix = "" if number == 1 else f"_{number}"
    return {"crank": f"L5{suffix}", "coupler": f"L4{suffix}", "rocker": f"L3{suffix}"}


def parameters_of(
    arm: Arm, effects: Iterable[Effect] = (), effect_values: Mapping[str, float] | None = None
) -> Iterable[Parameter]:
    """Yield all parameters of a robot's model, in the order in which identifiability prefers them.

    That is base, tool and targets, sessions, DH rows, loops, compliances, other effects.

    effect_values : name of an effect's parameter -> value [SI], by default its own
    """
    for which, placement in (("base", arm.base), ("tool", arm.tool)):
        count = {"none": 0, "position": 3, "pose": 6}[placement.unknown]
        start = placement.T[:3, 3] if which == "tool" else np.zeros(3)
        for name, value in list(zip(PLACEMENT_PARAMETERS[which], (*start, 0.0, 0.0, 0.0), strict=True))[:count]:
            yield _length_or_angle(arm, name, which, "rad" if "_r" in name else "m", float(value))
    for target in arm.targets:
        fixed_reason = "" if arm.tool.unknown != "none" else "given as known in the robot file"
        for name, value in zip(target.parameters, target.point, strict=True):
            yield _length_or_angle(arm, name, "tool", "m", float(value), fixed_reason)
    given = tuple(effects)
    # Base and tool of further sessions precede the rows, like those of the first session.
    sessions = tuple(e for e in given if isinstance(e, Session))
    yield from _of_effects(arm, sessions, effect_values or {})
    for i, joint in enumerate(arm.joints, 1):
        yield from _row_parameters(arm, i, joint)
    for k, loop in enumerate(arm.loops, 1):
        yield from _loop_parameters(arm, k, loop)
    for i, joint in enumerate(arm.joints, 1):
        if joint.compliance is not None:
            yield _compliance_parameter(arm, i, joint.compliance)
    yield from _of_effects(arm, (e for e in given if e not in sessions), effect_values or {})


def _of_effects(arm: Arm, effects: Iterable[Effect], values: Mapping[str, float]) -> Iterable[Parameter]:
    """Yield the parameters of effects with their values.

    Errors of estimated masses are marked as guesses, whose priors always apply.

    values : name of a parameter -> value [SI], by default its own
    """
    for effect in effects:
        guess = arm.masses == "estimated" and isinstance(effect, (LinkMasses, PayloadError))
        for p in effect.parameters():
            yield replace(p, value=values.get(p.name, p.value), guess=guess)


def _length_or_angle(arm: Arm, name: str, group: str, unit: str, value: float, fixed_reason: str = "") -> Parameter:
    """Return a length or angle parameter with bounds and prior of its group.

    unit : "m" or "rad"; value : nominal [m or rad]; fixed_reason : why it is fixed, empty if it is not
    """
    width = arm.widths[group]
    bound = width.length_bound if unit == "m" else width.angle_bound
    prior = width.length_prior if unit == "m" else width.angle_prior
    return Parameter(name, group, unit, value, 1e-3, value - bound, value + bound, prior, fixed_reason)


def _row_parameters(arm: Arm, i: int, joint: Joint) -> Iterable[Parameter]:
    """Yield the DH parameters of row i (1-based), with a reason where d is fixed."""
    # A first row with all six numbers is the base frame itself, as in the paper's Table 1.
    group = "base" if i == 1 and joint.b is not None else "geometry"
    yield _length_or_angle(arm, f"alpha{i - 1}", group, "rad", joint.alpha)
    yield _length_or_angle(arm, f"a{i - 1}", group, "m", joint.a)
    if joint.beta is not None:
        yield _length_or_angle(arm, f"beta{i - 1}", group, "rad", joint.beta)
    if joint.b is not None:
        yield _length_or_angle(arm, f"b{i - 1}", group, "m", joint.b)
    fixed_reason = ""
    if _parallel_axes(arm, i):
        fixed_reason = f"axes {i} and {i + 1} are nearly parallel: d{i} moves the tool as d{i + 1} does"
    elif i > 1 and arm.base.unknown != "none" and all(_parallel_axes(arm, k) for k in range(1, i)):
        fixed_reason = f"axes 1 to {i} are nearly parallel: d{i} moves the tool as the base does"
    yield _length_or_angle(arm, f"d{i}", group, "m", joint.d, fixed_reason)
    yield _length_or_angle(arm, f"theta{i}", group, "rad", joint.theta)


def _parallel_axes(arm: Arm, i: int) -> bool:
    """Return whether joints i and i+1 (1-based) are revolute about nearly parallel axes.

    Only the sum of their d is then determined.
    """
    return parallel(arm.joints, i - 1) and all(j.kind == "revolute" for j in arm.joints[i - 1 : i + 1])


def _loop_parameters(arm: Arm, k: int, loop: FourBar) -> Iterable[Parameter]:
    """Yield the parameters of the bar lengths of loop k (1-based).

    A parallelogram's rocker has a reason why it is fixed.
    """
    names = bar_names(k)
    ground = abs(arm.joints[loop.driven - 1].a)
    # Opposite bars of a parallelogram differ by less than 2 %.
    opposite = ((loop.crank, loop.rocker), (loop.coupler, ground))
    parallelogram = all(abs(a - b) < 0.02 * b for a, b in opposite)
    scale = f"only the difference {names['crank']} - {names['rocker']} turns the driven link of a parallelogram"
    for bar, name in names.items():
        fixed_reason = scale if bar == "rocker" and parallelogram else ""
        yield _length_or_angle(arm, name, "loop", "m", getattr(loop, bar), fixed_reason)


def _compliance_parameter(arm: Arm, i: int, value: float) -> Parameter:
    """Return the compliance parameter of joint i (1-based), with prior and bounds by its peak load.

    They are those of the deflection under that load, divided by it.

    value : nominal compliance [rad/(N m) or m/N]
    """
    width = arm.widths["compliance"]
    rotary = arm.joints[i - 1].kind == "revolute"
    bound, prior = (width.angle_bound, width.angle_prior) if rotary else (width.length_bound, width.length_prior)
    # The largest load is roughly that of all weight beyond the joint at half the reach beyond.
    beyond = arm.joints[i - 1 :]
    mass = sum(j.body.mass for j in beyond if j.body) + (arm.payload.mass if arm.payload else 0.0)
    reach = sum(abs(j.a) + abs(j.d) for j in beyond) + float(np.linalg.norm(arm.tool.T[:3, 3]))
    lever = max(0.5 * reach, 0.05) if rotary else 1.0
    load = max(mass * float(np.linalg.norm(arm.gravity)) * lever, 1e-3)  # [N m] or [N]
    unit = "rad/(N m)" if rotary else "m/N"
    # With estimated masses the data determine only their product with compliance: both are guesses.
    guess = arm.masses == "estimated"
    return Parameter(
        f"c{i}", "compliance", unit, value, 1e-3 / load, 0.0, value + bound / load, prior / load, guess=guess
    )
