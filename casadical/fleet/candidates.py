"""What may change in a robot between two campaigns, as columns of the parameters that move together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from casadical.core.basics import Array
from casadical.core.parameters import Parameter
from casadical.identification.misfit import ORDERS
from casadical.robot.error_bound import doubted
from casadical.robot.robot import Robot

# Usual sizes: of a length, of an angle, of a harmonic of a joint's error; of a compliance as a share; of all lengths.
LENGTH, ANGLE, HARMONIC, SHARE, THERMAL = 3e-4, 3e-4, 5e-5, 0.3, 1e-4
# Tool and foot are moved by more.
MOVED = 1e-3
# Groups of parameters of a robot without effects.
BARE = ("geometry", "loop", "compliance", "tool", "base")
# What differs between campaigns of a robot that does not change, one sigma: lengths, by 2 K; where the tool sits and
# how well one frame is found again [m or rad].
DAILY = {"lengths": 2.4e-5, "tool": 1e-5, "foot": 2e-5}
# How often each kind of change is met, relative to the others; the joints share it.
FREQUENCY = {
    "joint_zero": 4, "joint_stiffness": 2, "joint_curve": 2, "gear": 1, "link": 1, "loop": 1, "lengths": 1, "tool": 2,
    "foot": 2, "effect": 1, "another_robot": 1,
}  # fmt: skip
# A table of another robot of the type: everything changes, in all later campaigns or in one alone.
ROBOT = "another_robot"
# How a change goes on.
Course = Literal["jump", "drift", "season", "once"]
# What a robot does gradually, and what comes and goes with the seasons; all may jump.
GRADUAL = frozenset({"joint_zero", "joint_stiffness", "joint_curve", "lengths", "foot"})
SEASONAL = frozenset({"lengths"})


@dataclass(frozen=True, eq=False)
class Candidate:
    """One thing that may change in a robot.

    kind : joint_zero, joint_stiffness, joint_curve, gear, link, loop, lengths, tool, foot, effect or another_robot
    joint : of a joint or four-bar, 1-based
    names : parameters that change
    columns : Array, shape (p, m): how they move the p shared parameters, in units of their scale
    sizes : Array, shape (m,): usual sizes of the columns
    effect : label of an effect of the robot file
    """

    kind: str
    joint: int | None
    names: tuple[str, ...]
    columns: Array
    sizes: Array
    effect: str = ""

    @property
    def label(self) -> str:
        """kind, or kind@joint."""
        return self.effect or (self.kind if self.joint is None else f"{self.kind}@{self.joint}")


def shared_names(robot: Robot, names: Sequence[str], *, same_tool: bool, same_frame: bool) -> tuple[str, ...]:
    """Those parameters that two campaigns share: without high harmonics, tool and base unless these are the same."""
    gone = {*(() if same_tool else ("tool",)), *(() if same_frame else ("base",))}
    low = doubted(robot, ORDERS).parameters
    return tuple(n for n in names if n in low.names and low[n].group not in gone)


def candidates_of(robot: Robot, names: Sequence[str]) -> tuple[Candidate, ...]:
    """Everything that may change, by the shared parameters of a robot with harmonics as its last effect."""
    chosen = [robot.parameters[n] for n in names]
    candidates = [*_joints(robot, chosen), *_whole(chosen), *_effects(robot, chosen)]
    return tuple(c for c in candidates if c.names)


def daily(candidates: Sequence[Candidate]) -> tuple[Array, Array]:
    """Columns, shape (p, m), of what differs in every campaign, and sizes, shape (m,)."""
    own = [c for c in candidates if c.kind in DAILY]
    usual = {"lengths": THERMAL, "tool": MOVED, "foot": MOVED}
    sizes = [c.sizes * DAILY[c.kind] / usual[c.kind] for c in own]
    return np.concatenate([c.columns for c in own], axis=1), np.concatenate(sizes)


def _candidate(
    kind: str, joint: int | None, names: Iterable[str], all_: Sequence[Parameter], effect: str = ""
) -> Candidate:
    """Of parameters that change independently of each other."""
    place = {p.name: k for k, p in enumerate(all_)}
    own = tuple(n for n in names if n in place)
    E = np.zeros((len(all_), len(own)))
    E[[place[n] for n in own], range(len(own))] = 1.0
    sizes = np.array([_size(kind, all_[place[n]]) / all_[place[n]].scale for n in own])
    return Candidate(kind, joint, own, E, sizes, effect)


def _size(kind: str, p: Parameter) -> float:
    if p.group == "compliance":
        return max(SHARE * abs(p.value), 0.1 * p.prior)
    if p.group == "joint_error_curve":
        return HARMONIC
    if kind == "effect" or (kind == ROBOT and p.group not in BARE):
        return p.prior
    if kind in ("tool", "foot") or (kind == ROBOT and p.group in ("tool", "base")):
        return MOVED
    return LENGTH if p.unit == "m" else ANGLE


def _joints(robot: Robot, chosen: Sequence[Parameter]) -> Iterable[Candidate]:
    for j, joint in enumerate(robot.joints, 1):
        zero = f"theta{j}" if joint.kind == "revolute" else f"d{j}"
        curve = [f"joint_error_curve.{w}{k}_q{j}" for k in range(1, ORDERS + 1) for w in "sc"]
        row = {f"alpha{j - 1}", f"a{j - 1}", f"beta{j - 1}", f"b{j - 1}", f"d{j}", f"theta{j}"} - {zero}
        yield _candidate("joint_zero", j, [zero], chosen)
        yield _candidate("joint_stiffness", j, [f"c{j}"], chosen)
        yield _candidate("joint_curve", j, curve, chosen)
        if joint.compliance is not None:
            yield _candidate("gear", j, [zero, f"c{j}", *curve], chosen)
        geometry = [p.name for p in chosen if p.name in row and p.group == "geometry"]
        if j > 1 or robot.base.unknown == "none":  # the first row is where the foot stands
            yield _candidate("link", j, geometry, chosen)
    for k in range(1, len(robot.loops) + 1):
        tail = "" if k == 1 else f"_{k}"
        yield _candidate("loop", k, [f"L{n}{tail}" for n in (3, 4, 5)], chosen)


def _whole(chosen: Sequence[Parameter]) -> Iterable[Candidate]:
    lengths = [(k, p) for k, p in enumerate(chosen) if p.unit == "m" and p.group in ("geometry", "loop", "tool")]
    E = np.zeros((len(chosen), 1))
    for k, p in lengths:
        E[k] = p.value / p.scale
    yield Candidate("lengths", None, tuple(p.name for _, p in lengths if p.value), E, np.array([THERMAL]))
    yield _candidate("tool", None, [p.name for p in chosen if p.group == "tool"], chosen)
    yield _candidate("foot", None, [p.name for p in chosen if p.group == "base"], chosen)
    yield _candidate(ROBOT, None, [p.name for p in chosen], chosen)


def _effects(robot: Robot, chosen: Sequence[Parameter]) -> Iterable[Candidate]:
    for effect in robot.effects[:-1]:
        yield _candidate("effect", effect.joint, [p.name for p in effect.parameters()], chosen, effect.label)
