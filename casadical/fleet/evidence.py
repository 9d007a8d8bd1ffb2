"""Evidence of changes between campaigns in a linear-Gaussian model, and their candidates.

The parameters of campaign i are theta_i = theta + sum_j s_ij E_j a_j: the robot's theta, and
changes of amplitude a_j along columns E_j with a course s_ij over the campaigns (a jump, a drift, a
season). With information H_i and score b_i of each campaign, the model is linear and Gaussian.
theta is marginalised; for amplitudes a ~ N(0, (kappa size)^2) the evidence has a closed form, with
kappa on a grid.

The evidence of a change, averaged over candidates, courses and onsets with weights that are fixed
before the data, is a martingale over the campaigns as long as nothing changes: the probability that
it ever reaches 1 / p is at most p (Ville 1939).

A candidate is something that may change in a robot between two campaigns, as columns of the
parameters that change together.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.noise import gain
from casadical.core.linear_gaussian.normal_equations import inverse_of, root_of_inverse
from casadical.core.parameters import Parameter
from casadical.core.statistics import first_of_best
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
# Kinds of change that may drift; all kinds may jump.
GRADUAL_KINDS = frozenset({"joint_zero", "joint_stiffness", "joint_curve", "lengths", "foot"})
# Kinds of change that may follow the seasons.
SEASONAL_KINDS = frozenset({"lengths"})


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

    robot : robot with the harmonics of its joints as its last effect
    """
    chosen = [robot.parameters[n] for n in names]
    effects = [
        _candidate("effect", effect.joint, [p.name for p in effect.parameters()], chosen, effect.label)
        for effect in robot.effects[:-1]
    ]
    candidates = [*_joint_candidates(robot, chosen), *_robot_candidates(chosen), *effects]
    return tuple(c for c in candidates if c.names)


def daily(candidates: Sequence[Candidate]) -> tuple[Array, Array]:
    """Return columns, (p, m), and standard deviations, (m,), of day-to-day differences.

    They are those of the candidates whose kinds `DAILY_SIGMAS` lists; see `Candidate`.
    """
    own = [c for c in candidates if c.kind in DAILY_SIGMAS]
    usual = {"lengths": USUAL_GROWTH, "tool": USUAL_MOUNTING_CHANGE, "foot": USUAL_MOUNTING_CHANGE}
    sizes = [c.sizes * DAILY_SIGMAS[c.kind] / usual[c.kind] for c in own]
    return np.concatenate([c.columns for c in own], axis=1), np.concatenate(sizes)


def _candidate(
    kind: str, joint: int | None, names: Iterable[str], all_: Sequence[Parameter], effect: str = ""
) -> Candidate:
    """Return a candidate whose parameters change independently, each along a column of its own.

    kind, joint, effect : as of `Candidate`
    names : parameters that change; those not in `all_` are dropped
    all_ : the p shared parameters
    """
    place = {p.name: k for k, p in enumerate(all_)}
    own = tuple(n for n in names if n in place)
    E = np.zeros((len(all_), len(own)))
    E[[place[n] for n in own], range(len(own))] = 1.0
    sizes = np.array([_usual_size(kind, all_[place[n]]) / all_[place[n]].scale for n in own])
    return Candidate(kind, joint, own, E, sizes, effect)


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


def _joint_candidates(robot: Robot, chosen: Sequence[Parameter]) -> Iterable[Candidate]:
    """Yield the candidates of each joint and four-bar; some of them may have no parameters.

    chosen : the p shared parameters
    """
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
        if j > 1 or robot.base.unknown == "none":  # else the first row is part of the base's pose
            yield _candidate("link", j, geometry, chosen)
    for k in range(1, len(robot.loops) + 1):
        tail = "" if k == 1 else f"_{k}"
        yield _candidate("loop", k, [f"L{n}{tail}" for n in (3, 4, 5)], chosen)


def _robot_candidates(chosen: Sequence[Parameter]) -> Iterable[Candidate]:
    """Yield the candidates of the whole robot: lengths, tool, foot (the base), another robot.

    chosen : the p shared parameters
    """
    lengths = [(k, p) for k, p in enumerate(chosen) if p.unit == "m" and p.group in ("geometry", "loop", "tool")]
    E = np.zeros((len(chosen), 1))
    for k, p in lengths:
        E[k] = p.value / p.scale
    yield Candidate("lengths", None, tuple(p.name for _, p in lengths if p.value), E, np.array([USUAL_GROWTH]))
    yield _candidate("tool", None, [p.name for p in chosen if p.group == "tool"], chosen)
    yield _candidate("foot", None, [p.name for p in chosen if p.group == "base"], chosen)
    yield _candidate(ANOTHER_ROBOT, None, [p.name for p in chosen], chosen)


# Grid of the ratio of a change's prior standard deviation to its usual size.
KAPPAS = np.array([0.1, 0.3, 1.0, 3.0, 10.0])


@dataclass(frozen=True, eq=False)
class SharedInformation:
    """Information of n campaigns on the p parameters that they share, in units of the scale.

    information : information matrix of each campaign, shape (n, p, p)
    score : gradient of each campaign's log likelihood at common values, those of the first
        campaign, shape (n, p)
    precision : prior precision (inverse variance) of theta about these values, shape (p,)
    """

    information: Array
    score: Array
    precision: Array

    def with_jitter(self, columns: Array, sizes: Array) -> SharedInformation:
        """Return the information with independent differences in each campaign marginalised.

        columns : directions of the differences in the parameters, shape (p, m)
        sizes : standard deviations of their amplitudes, shape (m,)
        """
        HD = self.information @ columns
        inner = np.array([inverse_of(own) for own in columns.T @ HD + np.diag(sizes**-2.0)])
        lost = HD @ inner
        b = self.score - (lost @ (self.score @ columns)[:, :, None])[:, :, 0]
        return SharedInformation(self.information - lost @ HD.transpose(0, 2, 1), b, self.precision)


@dataclass(frozen=True, eq=False)
class Model:
    """Posterior of theta and the amplitudes of accepted changes, before an additional change.

    Its variables are u = (theta, the m amplitudes of the accepted changes), in units of scale.

    shared : information of the n campaigns on the p parameters
    columns : directions of these changes times their factors in each campaign, shape (n, p, m)
    root : R of the posterior covariance R'R of u, shape (p + m, p + m)
    turned : R times the score of u, shape (p + m,)
    """

    shared: SharedInformation
    columns: Array
    root: Array = field(repr=False)
    turned: Array = field(repr=False)

    @property
    def inverse(self) -> Array:
        """Return the posterior covariance of u, shape (p + m, p + m)."""
        return self.root.T @ self.root

    @property
    def mean(self) -> Array:
        """Return the posterior mean of u, shape (p + m,); theta is relative to the first campaign."""
        return self.root.T @ self.turned

    @property
    def p(self) -> int:
        """Return the number of shared parameters."""
        return int(self.shared.score.shape[1])


def solve(shared: SharedInformation, columns: Array, sizes: Array) -> Model:
    """Return the posterior of theta and the amplitudes of accepted changes, given all campaigns.

    columns : directions of the changes times their factors in each campaign, shape (n, p, m)
    sizes : prior standard deviations of the amplitudes, shape (m,)
    """
    n, p = shared.score.shape
    X = np.concatenate([np.broadcast_to(np.eye(p), (n, p, p)), columns], axis=2)
    HX = shared.information @ X
    Lambda = np.tensordot(X, HX, axes=([0, 1], [0, 1]))
    Lambda += np.diag(np.concatenate([shared.precision, sizes**-2.0]))
    root = root_of_inverse(Lambda)
    return Model(shared, columns, root, root @ np.einsum("npi,np->i", X, shared.score))


def marginal_information(model: Model, E: Array, courses: Array) -> tuple[Array, Array]:
    """Return information and score of an additional change's amplitudes, for each of c courses.

    Theta and the amplitudes of accepted changes are marginalised. The shapes are (c, km, km) and
    (c, km); amplitudes of the first factor come first.

    E : directions of the change in the parameters, shape (p, m)
    courses : k factors of the change in each of n campaigns, shape (c, n, k)
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
    # A change along accepted ones is a small difference of large numbers: squares of the root keep
    # twice the digits of products with the inverse.
    C = model.root @ C
    return H - C.transpose(0, 2, 1) @ C, b - model.turned @ C


def log_evidence(H: Array, b: Array, sizes: Array) -> Array:
    """Return the log Bayes factor of each change against none for all `KAPPAS`, (c, kappas).

    H, b : information, (c, m, m), and score, (c, m), of the changes' m amplitudes
    sizes : usual size of each amplitude, shape (m,)
    """
    values, V = np.linalg.eigh(sizes[:, None] * H * sizes)
    values = np.maximum(values, 0.0)
    turned = (V.transpose(0, 2, 1) @ (sizes * b)[:, :, None])[:, :, 0] ** 2
    return gain(KAPPAS**-2.0, 1.0, values, turned)


def averaged(logs: Array) -> Array:
    """Return the logarithm of the mean evidence over the sizes, shape (...).

    logs : log evidence for each size on the grid `KAPPAS`, shape (..., kappas)
    """
    return np.asarray(np.logaddexp.reduce(logs, axis=-1) - np.log(len(KAPPAS)))


def amplitude(H: Array, b: Array, sizes: Array, logs: Array) -> tuple[Array, Array, float]:
    """Return posterior mean, (m,), and covariance, (m, m), of a change's amplitudes, and kappa.

    Kappa is the most probable ratio, on the grid `KAPPAS`, of the change's prior standard deviation
    to its usual size; mean and covariance are in units of the columns.

    H, b : information, (m, m), and score, (m,), of the amplitudes
    sizes : usual size of each amplitude, shape (m,)
    logs : log evidence for each kappa, shape (kappas,)
    """
    kappa = float(KAPPAS[first_of_best(logs, logs=True)])
    C = inverse_of(H + np.diag((kappa * sizes) ** -2.0))
    return C @ b, C, kappa


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
