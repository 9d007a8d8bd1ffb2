"""Evidence that something changed between campaigns: Gaussian changes of realistic size, all else integrated.

Campaign i tells of its parameters theta_i = theta + sum of s_ji E_j a_j: what the robot is, and changes of size a_j
along columns E_j with a course s_ji over the campaigns (a jump, a drift, a season). With information H_i and score b_i
of each campaign, all is linear and Gaussian. Integrating theta projects it out, where the data determine it, and the
amplitudes a ~ N(0, (kappa size)^2) have closed form; kappa is on a grid.

The evidence of a change, averaged over candidates, courses and times by weights that were fixed before the data, is a
martingale as campaigns come in while nothing changes: it ever reaches 1 / p with probability p at most (Ville 1939).

What may change in a robot between two campaigns, as columns of the parameters that move together.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.grid import gain
from casadical.core.linear_gaussian.normal_equations import inverse_of, root_of_inverse
from casadical.core.parameters import Parameter
from casadical.core.statistics import first_of_best
from casadical.identification.misfit import MAX_COMPARED_HARMONIC
from casadical.robot.remaining_errors import doubted
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
    low = doubted(robot, MAX_COMPARED_HARMONIC).parameters
    return tuple(n for n in names if n in low.names and low[n].group not in gone)


def candidates_of(robot: Robot, names: Sequence[str]) -> tuple[Candidate, ...]:
    """Everything that may change, by the shared parameters of a robot with harmonics as its last effect."""
    chosen = [robot.parameters[n] for n in names]
    effects = [
        _candidate("effect", effect.joint, [p.name for p in effect.parameters()], chosen, effect.label)
        for effect in robot.effects[:-1]
    ]
    candidates = [*_joints(robot, chosen), *_whole(chosen), *effects]
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
        curve = [f"joint_error_curve.{w}{k}_q{j}" for k in range(1, MAX_COMPARED_HARMONIC + 1) for w in "sc"]
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


# Sizes of a change in units of its usual one.
KAPPAS = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
# A change is not searched where its direction is seen less than this, in squared units of its size.
UNSEEN = 1e-6


@dataclass(frozen=True, eq=False)
class SharedInformation:
    """Campaigns about common values, in units of the scale: what they tell of p parameters that they share.

    information : shape (n, p, p); score : shape (n, p); precision : of theta before the data, shape (p,)
    """

    information: Array
    score: Array
    precision: Array

    def with_jitter(self, columns: Array, sizes: Array) -> SharedInformation:
        """With what comes and goes in each campaign alone; columns : shape (p, m); sizes : one sigma of each."""
        HD = self.information @ columns
        inner = np.array([inverse_of(own) for own in columns.T @ HD + np.diag(sizes**-2.0)])
        lost = HD @ inner
        b = self.score - (lost @ (self.score @ columns)[:, :, None])[:, :, 0]
        return SharedInformation(self.information - lost @ HD.transpose(0, 2, 1), b, self.precision)


@dataclass(frozen=True, eq=False)
class Model:
    """Theta and known changes, solved for: what is left for a further change.

    columns : of the known changes over all campaigns, shape (n, p, m)
    root : R of the covariance R'R of u = (theta, known amplitudes); turned : R times the score of u
    """

    shared: SharedInformation
    columns: Array
    root: Array = field(repr=False)
    turned: Array = field(repr=False)

    @property
    def inverse(self) -> Array:
        return self.root.T @ self.root

    @property
    def mean(self) -> Array:
        """Of u."""
        return self.root.T @ self.turned

    @property
    def p(self) -> int:
        return int(self.shared.score.shape[1])


def solve(told: SharedInformation, columns: Array, sizes: Array) -> Model:
    """Theta and known changes, given all campaigns; columns : as of `Model`; sizes : of the changes, shape (m,)."""
    n, p = told.score.shape
    X = np.concatenate([np.broadcast_to(np.eye(p), (n, p, p)), columns], axis=2)
    HX = told.information @ X
    Lambda = np.tensordot(X, HX, axes=([0, 1], [0, 1]))
    Lambda += np.diag(np.concatenate([told.precision, sizes**-2.0]))
    root = root_of_inverse(Lambda)
    return Model(told, columns, root, root @ np.einsum("npi,np->i", X, told.score))


def visible(model: Model, E: Array, courses: Array) -> tuple[Array, Array]:
    """Information and score of a change along columns E with each of several courses.

    E : shape (p, m); courses : shape (c, n, k), of each campaign k factors. Returns shapes (c, km, km) and (c, km).
    """
    information = model.shared
    (c, n, k), m = courses.shape, E.shape[1]
    HE = information.information @ E
    flat = courses.transpose(0, 2, 1).reshape(c * k, n)
    squares = (courses[:, :, :, None] * courses[:, :, None, :]).transpose(0, 2, 3, 1).reshape(c * k * k, n)
    H = (squares @ (E.T @ HE).reshape(n, m * m)).reshape(c, k, k, m, m).transpose(0, 1, 3, 2, 4)
    H = H.reshape(c, k * m, k * m)
    HEu = np.concatenate([HE, model.columns.transpose(0, 2, 1) @ HE], axis=1)
    C = (flat @ HEu.reshape(n, -1)).reshape(c, k, -1, m).transpose(0, 2, 1, 3).reshape(c, -1, k * m)
    b = (flat @ (information.score @ E)).reshape(c, k * m)
    # A change along known ones is the small difference of large numbers: squares of the root keep twice the digits that
    # products with the inverse do.
    C = model.root @ C
    return H - C.transpose(0, 2, 1) @ C, b - model.turned @ C


def log_evidence(H: Array, b: Array, sizes: Array) -> Array:
    """Log of how many times more probable the data are with changes than without, shape (c, kappas).

    H, b : as of `visible`; sizes : usual one of each column, shape (m,)
    """
    values, V = np.linalg.eigh(sizes[:, None] * H * sizes)
    values = np.maximum(values, 0.0)
    turned = (V.transpose(0, 2, 1) @ (sizes * b)[:, :, None])[:, :, 0] ** 2
    return gain(KAPPAS**-2.0, 1.0, values, turned)


def averaged(logs: Array) -> Array:
    """Mean evidence over the sizes, as a logarithm; logs : shape (..., kappas)."""
    return np.asarray(np.logaddexp.reduce(logs, axis=-1) - np.log(len(KAPPAS)))


def amplitude(H: Array, b: Array, sizes: Array, logs: Array) -> tuple[Array, Array, float]:
    """Mean, shape (m,), and covariance of one change's amplitudes, at its most probable size, which is returned too."""
    kappa = float(KAPPAS[first_of_best(logs, logs=True)])
    C = inverse_of(H + np.diag((kappa * sizes) ** -2.0))
    return C @ b, C, kappa


def jumps(n: int) -> Array:
    """Courses of a change at each campaign but the first, shape (n - 1, n, 1)."""
    return (np.arange(n) >= np.arange(1, n)[:, None]).astype(float)[:, :, None]


def drifts(times: Sequence[float] | Array) -> Array:
    """Courses of a drift that begins after each campaign but the last, shape (n - 1, n, 1), a unit of time one."""
    t = np.asarray(times, dtype=float)
    return np.asarray(np.maximum(0.0, t - t[:-1, None])[:, :, None])


def season(times: Sequence[float] | Array) -> Array:
    """Course of what comes again every unit of time, shape (1, n, 2)."""
    turn = 2 * np.pi * np.asarray(times, dtype=float)
    return np.stack([np.sin(turn), np.cos(turn)], axis=-1)[None]
