"""Candidates for changes between campaigns, and the linear model by which they are judged.

The parameters of campaign i are theta_i = theta + sum_j s_ij E_j a_j: the robot's theta, and
changes of amplitude a_j along columns E_j with a course s_ij over the campaigns (a jump, a drift, a
season). With information H_i and score b_i of each campaign they form a `LinearModel`: a campaign is
a block, theta the base, and the amplitudes a ~ N(0, (kappa size)^2) are columns with kappa on a grid.

The evidence of a change, averaged over candidates, courses and onsets with weights that are fixed
before the data, is a martingale over the campaigns as long as nothing changes: the probability that
it ever reaches 1 / p is at most p (Ville 1939).

A candidate is something that may change in a robot between two campaigns, as columns of the
parameters that change together.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import Factors, MemoryLimits, factor_columns
from casadical.core.linear_gaussian.model import LinearModel
from casadical.core.parameters import Parameter
from casadical.identification.misfit import MAX_COMPARED_HARMONIC
from casadical.robot.robot import Robot, with_joint_harmonics

# Usual size of a common change of all lengths, divided by the length.
USUAL_GROWTH = 1e-4
# Usual size of a change of one coordinate of the tool's or the base's pose [m or rad].
USUAL_MOUNTING_CHANGE = 1e-3
# Standard deviations of day-to-day differences of a robot that does not change, by kind of change:
# relative growth of all lengths (2 K), pose of the tool on the flange and of the base in a
# measuring frame that is established again each time [m or rad].
DAILY_SIGMAS = {"lengths": 2.4e-5, "tool": 1e-5, "foot": 2e-5}
# Relative frequency of each kind of change, of which only ratios count; the candidates of a kind,
# such as the joints, have equal shares of its frequency.
RELATIVE_FREQUENCY = {
    "joint_zero": 4,
    "joint_stiffness": 2,
    "joint_curve": 2,
    "gear": 1,
    "link": 1,
    "loop": 1,
    "lengths": 1,
    "tool": 2,
    "foot": 2,
    "effect": 1,
    "another_robot": 1,
}
# Kind of change for measurements of another robot of the type: all parameters change.
ANOTHER_ROBOT = "another_robot"
# Course of a change over the campaigns: from one on, growing from one on, periodic with a year, or
# in a single one.
Course = Literal["jump", "drift", "season", "once"]


@dataclass(frozen=True, eq=False)
class Candidate:
    """Something that may change in a robot, along m columns of its parameters.

    kind : joint_zero, joint_stiffness, joint_curve, gear, link, loop, lengths, tool, foot, effect
        or another_robot; `touch_model` adds crash and unknown
    joint : number of a joint or four-bar, from 1, or of an effect's joint; None without one
    names : names of the parameters that change
    columns : directions of the change in the p shared parameters, shape (p, m), in units of the
        parameters' scale
    sizes : usual sizes (prior standard deviations) of the amplitudes of the columns, shape (m,)
    effect : label of the effect of the robot file that changes; "" for other kinds
    """

    kind: str
    joint: int | None
    names: tuple[str, ...]
    columns: Array
    sizes: Array
    effect: str = ""

    @property
    def label(self) -> str:
        """Return the label of the effect; without one the kind, or KIND@JOINT such as joint_zero@3."""
        return self.effect or (self.kind if self.joint is None else f"{self.kind}@{self.joint}")


def shared_names(robot: Robot, names: Sequence[str], *, same_tool: bool, same_frame: bool) -> tuple[str, ...]:
    """Return those of some parameters that are compared between campaigns, in the given order.

    Harmonics above `MAX_COMPARED_HARMONIC` are excluded, as each campaign fits its own.

    names : parameters that all campaigns have
    same_tool, same_frame : whether the parameters of the tool and of the base are compared
    """
    gone = {*(() if same_tool else ("tool",)), *(() if same_frame else ("base",))}
    low = with_joint_harmonics(robot, MAX_COMPARED_HARMONIC).parameters
    return tuple(n for n in names if n in low.names and low[n].group not in gone)


def candidates_of(robot: Robot, names: Sequence[str]) -> tuple[Candidate, ...]:
    """Return the candidates for changes that move at least one of the p parameters `names`.

    Those of joints and four-bars come first, then lengths, tool, foot (the base) and another robot,
    then effects. But for the lengths, which have one column, parameters change independently.

    robot : robot with the harmonics of its joints as its last effect
    """
    chosen = [robot.parameters[n] for n in names]
    place = {p.name: k for k, p in enumerate(chosen)}
    found: list[Candidate] = []

    def add(kind: str, joint: int | None, names: Iterable[str], effect: str = "") -> None:
        """Add the candidate whose parameters are those of `names` that are shared, unless none is."""
        if own := tuple(n for n in names if n in place):
            at = [place[n] for n in own]
            sizes = np.array([_usual_size(kind, chosen[k]) / chosen[k].scale for k in at])
            found.append(Candidate(kind, joint, own, np.eye(len(chosen))[:, at], sizes, effect))

    for j, joint in enumerate(robot.joints, 1):
        zero = f"theta{j}" if joint.kind == "revolute" else f"d{j}"
        curve = [f"joint_error_curve.{w}{k}_q{j}" for k in range(1, MAX_COMPARED_HARMONIC + 1) for w in "sc"]
        row = {f"alpha{j - 1}", f"a{j - 1}", f"beta{j - 1}", f"b{j - 1}", f"d{j}", f"theta{j}"} - {zero}
        add("joint_zero", j, [zero])
        add("joint_stiffness", j, [f"c{j}"])
        add("joint_curve", j, curve)
        if joint.compliance is not None:
            add("gear", j, [zero, f"c{j}", *curve])
        if j > 1 or robot.base.unknown == "none":  # else the first row is part of the base's pose
            add("link", j, [p.name for p in chosen if p.name in row and p.group == "geometry"])
    for k in range(1, len(robot.loops) + 1):
        add("loop", k, [f"L{n}{'' if k == 1 else f'_{k}'}" for n in (3, 4, 5)])
    lengths = [p.unit == "m" and p.group in ("geometry", "loop", "tool") for p in chosen]
    growth = np.array([[p.value / p.scale * own] for p, own in zip(chosen, lengths, strict=True)])
    if growth.any():
        grown = tuple(p.name for p, own in zip(chosen, growth[:, 0], strict=True) if own)
        found.append(Candidate("lengths", None, grown, growth, np.array([USUAL_GROWTH])))
    add("tool", None, [p.name for p in chosen if p.group == "tool"])
    add("foot", None, [p.name for p in chosen if p.group == "base"])
    add(ANOTHER_ROBOT, None, names)
    for effect in robot.effects[:-1]:
        add("effect", effect.joint, [p.name for p in effect.parameters()], effect.label)
    return tuple(found)


def daily(candidates: Sequence[Candidate]) -> Array:
    """Return the root D of the covariance D D' of day-to-day differences, shape (p, m).

    They are those of the candidates whose kinds `DAILY_SIGMAS` lists; see `Candidate`.
    """
    usual = {"lengths": USUAL_GROWTH, "tool": USUAL_MOUNTING_CHANGE, "foot": USUAL_MOUNTING_CHANGE}
    own = [c for c in candidates if c.kind in DAILY_SIGMAS]
    roots = [c.columns * c.sizes * (DAILY_SIGMAS[c.kind] / usual[c.kind]) for c in own]
    return np.hstack([candidates[0].columns[:, :0], *roots])


def _usual_size(kind: str, p: Parameter) -> float:
    """Return the usual size of a parameter's change [SI]; kind : that of a `Candidate`."""
    if p.group == "compliance":
        # It is 30 % of the compliance, and at least a tenth of the prior standard deviation.
        return max(0.3 * abs(p.value), 0.1 * p.prior)
    if p.group == "joint_error_curve":
        # Usual size of a change of one harmonic's coefficient of a joint's error curve [rad].
        return 5e-5
    # Parameter groups of a robot without effects; parameters of other groups belong to effects.
    if kind == "effect" or (
        kind == ANOTHER_ROBOT and p.group not in ("geometry", "loop", "compliance", "tool", "base")
    ):
        return p.prior
    if kind in ("tool", "foot") or (kind == ANOTHER_ROBOT and p.group in ("tool", "base")):
        return USUAL_MOUNTING_CHANGE
    # The usual size of a change is the prior standard deviation of its amplitude, up to a factor
    # kappa on the grid `KAPPAS`. Tool, base, harmonics, compliances and effects have sizes of their
    # own; these are of one length or angle of geometry or loops.
    usual_length_change_m = 3e-4
    usual_angle_change_rad = 3e-4
    return usual_length_change_m if p.unit == "m" else usual_angle_change_rad


# Grid of the ratio of a change's prior standard deviation to its usual size.
KAPPAS = np.array([0.1, 0.3, 1.0, 3.0, 10.0])


def model_of_campaigns(
    H: Array,
    b: Array,
    spread: Array,
    candidates: Sequence[Candidate],
    courses: Iterable[tuple[Candidate, Array]],
) -> tuple[LinearModel, list[Array]]:
    """Return the linear model of n campaigns, and the indices of each change's columns in it.

    Each block has p rows, those of a root of the campaign's information; day-to-day differences are
    noise of these rows.

    H, b : information, (n, p, p), and score, (n, p), of the p shared parameters in units of scale
    spread : prior standard deviations of the parameters, shape (p,), in units of scale
    candidates : candidates whose usual day-to-day differences are assumed (see `daily`)
    courses : candidate and factors, shape (c, n, k), of c changes each
    """
    n, p = b.shape
    scale = np.sqrt(np.maximum(np.diagonal(H, axis1=1, axis2=2), 1e-30))
    value, vector = np.linalg.eigh(H / (scale[:, :, None] * scale[:, None, :]))
    # Directions of which a campaign knows nothing have eigenvalues of round-off.
    root = np.sqrt(np.where(value > 1e-14, value, 0.0))
    turned = (vector.transpose(0, 2, 1) @ (b / scale)[:, :, None])[:, :, 0]
    r = np.divide(turned, root, out=np.zeros_like(turned), where=root > 0)
    R = root[:, :, None] * vector.transpose(0, 2, 1) * scale[:, None, :]
    groups, width = list[Array](), 0
    # Indices of the columns that change each parameter, and their factors.
    acting, made = [[np.zeros(0, dtype=np.int64)] for _ in range(p)], [[np.zeros((0, n))] for _ in range(p)]
    for candidate, factors in courses:
        (c, _, k), m = factors.shape, len(candidate.sizes)
        own = width + np.arange(c * k * m).reshape(c, k, m)
        groups += list(own.reshape(c, k * m))
        width += own.size
        for parameter, sizes in enumerate(candidate.columns * candidate.sizes):
            some = np.flatnonzero(sizes)
            each = factors.transpose(0, 2, 1)[:, :, None] * sizes[some][:, None]
            acting[parameter].append(own[:, :, some].ravel())
            made[parameter].append(each.reshape(-1, n))
    parts = [(k, np.concatenate(acting[k]), np.concatenate(made[k])) for k in range(p)]
    E = factor_columns(Factors(tuple(part for part in parts if len(part[1])), width), R)
    # Many campaigns have tens of thousands of columns, so that few blocks are added up at a time.
    memory = MemoryLimits(column_bytes=16_000_000, min_blocks=1)
    grid = np.ones(1), np.ones(1), KAPPAS
    model = LinearModel(r, R, np.zeros(p), spread, E, R @ daily(candidates), *grid, reference=1.0, memory=memory)
    return model, groups


def jumps(n: int) -> Array:
    """Return the factors of jumps, one at each campaign but the first, shape (n - 1, n, 1).

    A factor is 0 before the jump and 1 from its campaign on.
    """
    return (np.arange(n) >= np.arange(1, n)[:, None]).astype(float)[:, :, None]


def drifts(times: Sequence[float] | Array) -> Array:
    """Return the factors of drifts, one after each campaign but the last, shape (n - 1, n, 1).

    A factor is 0 up to that campaign and then the time since it, in the unit of `times`; the next
    campaign is the first that shows the drift.

    times : time of each campaign, shape (n,)
    """
    t = np.asarray(times, dtype=float)
    return np.asarray(np.maximum(0.0, t - t[:-1, None])[:, :, None])


def season(times: Sequence[float] | Array) -> Array:
    """Return the factors of a change with a period of one year, sine and cosine, shape (1, n, 2).

    times : time of each campaign, shape (n,) [years]
    """
    turn = 2 * np.pi * np.asarray(times, dtype=float)
    return np.stack([np.sin(turn), np.cos(turn)], axis=-1)[None]
