"""Changes of joints since a reference log, by the responses identified from both logs.

The identified responses of a log and of its reference differ by noise, by the friction of another
day, and perhaps by a cause. Of each joint, the difference of the logarithms of gain, friction,
damping and inertia (divided by the gain) and delay is Gaussian in each hypothesis, so that each
cause has a closed marginal likelihood. A general change of all five stands for unlisted causes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import ranked
from casadical.core.telling.blocks import Table
from casadical.diagnosis.motion.response import Response, fitted
from casadical.measurements.logs.log import JointLog
from casadical.robot.robot import Robot

# Possible changes of a joint's response: name of the cause, names of causes that a response cannot
# distinguish from it, change of the five logarithms of `Response.log_values` for the size one, and
# prior standard deviation of the size.
HYPOTHESES: tuple[tuple[str, tuple[str, ...], tuple[float, ...], float], ...] = (
    ("servo_stiffness", (), (-1, 1, 1, 1, 0), 0.5),
    ("coulomb_friction", ("load_friction",), (0, 1, 0, 0, 0), 1.0),
    ("viscous_friction", (), (0, 0, 1, 0, 0), 0.7),
    ("reflected_inertia", (), (0, 0, 0, 1, 0), 0.7),
    ("transport_delay", ("lag",), (0, 0, 0, 0, 1), 1.5),
    ("payload", ("link_mass", "spring", "torque_constant"), (-1, 0, 0, 0, 0), 0.5),
)
# Standard deviation of the change of each logarithm from one day to another.
DAILY_SIGMAS = (0.03, 0.15, 0.15, 0.05, 0.1)
SIGMA_UNLISTED = 0.5  # prior standard deviation of each logarithm's change by an unlisted cause
# Standard deviation of an identified delay by sampling, divided by the time between samples.
DELAY_SAMPLE_SHARE = 0.1
# Standard deviation of identified dry friction / gain by the resolution of the readings, divided by
# that resolution.
FRICTION_QUANTUM_SHARE = 0.5
# A response fits a joint if the rms of its replay's error is below this fraction of that of reading
# minus command; otherwise its identification has failed.
MAX_ERROR_SHARE = 0.5
MIN_EVIDENCE = 15.0  # smallest log evidence of a clear change against no change [nats]
MIN_MARGIN = 3.0  # margin [nats] by which a clear change exceeds every other one of its joint
# Description of a change with its factor, by the name of the cause.
WORDS = {
    "servo_stiffness": "servo gain x {:.2f}",
    "coulomb_friction": "dry friction x {:.2f}",
    "viscous_friction": "damping x {:.2f}",
    "reflected_inertia": "inertia x {:.2f}",
    "transport_delay": "delay x {:.1f}",
    "payload": "droop under gravity x {:.2f}",
}


@dataclass(frozen=True)
class Change:
    """The most probable change of a joint since the reference.

    joint : number of the joint, from 1; None: several joints
    effect : name of the cause; alike : causes that such a log does not distinguish from it
    factor : present value of the changed parameter, divided by that of the reference
    evidence : log Bayes factor against no change [nats]; margin : that against the best other cause
        [nats]; unlisted : that against a general change of all five logarithms [nats]
    """

    joint: int | None
    effect: str
    alike: tuple[str, ...]
    factor: float
    evidence: float
    margin: float
    unlisted: float

    @property
    def clear(self) -> bool:
        """Return whether the evidence is large and exceeds that of other and general changes."""
        return self.evidence >= MIN_EVIDENCE and self.margin >= MIN_MARGIN and self.unlisted > 0

    @property
    def words(self) -> str:
        """Return a text of the change: joint, factor, and cause with indistinguishable ones."""
        which = " or ".join(name.replace("_", " ") for name in (self.effect, *self.alike))
        place = "several joints" if self.joint is None else f"joint {self.joint}"
        return f"{place}: {WORDS[self.effect].format(self.factor)} since the reference ({which})"


def changes_since(robot: Robot, log: JointLog, healthy: Robot, reference: JointLog) -> tuple[Change, ...]:
    """Return the most probable change of each joint whose response fits both logs.

    That with the largest evidence is first.
    robot, healthy : robots of the log and of the reference, which differ by their payload only
    Raises InputError: logs without commands, or without a run of two seconds.
    """
    responses = fitted(robot, [log], [reference]) if healthy is robot else [
        *fitted(robot, [log]), *fitted(healthy, [reference]),
    ]  # fmt: skip
    fits = [_fits(r, each) for r, each in zip(responses, (log, reference), strict=True)]
    found = [
        _change(responses, j, max(log.step, reference.step), quantum)
        for j, quantum in enumerate(_quanta(log))
        if all(fit[j] for fit in fits)
    ]
    return tuple(found[k] for k in ranked([change.evidence for change in found]))


def _fits(response: Response, log: JointLog) -> Array:
    """Return the mask of the joints that moved and whose replay fits, shape (joints,)."""
    assert log.command is not None
    error, before = (np.nanmean((log.position - q) ** 2, axis=0) for q in (response.predicted(log), log.command))
    return np.asarray(response.moved & (error < MAX_ERROR_SHARE**2 * before))


def _quanta(log: JointLog) -> list[float]:
    """Return the resolution of each joint's readings [rad]; zero where they never change."""
    steps = np.abs(np.diff(log.position, axis=0))
    smallest = np.where(steps > 1e-6, steps, np.inf).min(axis=0)
    return [float(v) for v in np.where(np.isfinite(smallest), smallest, 0.0)]


def _change(responses: Sequence[Response], j: int, step: float, quantum: float) -> Change:
    """Return the most probable change of joint j (0-based) between two responses.

    responses : of the log, then of the reference
    step : time between samples [s]; quantum : resolution of the joint's readings [rad]
    """
    difference, covariance = np.zeros(5), np.diag(np.square(DAILY_SIGMAS))
    for sign, r in zip((1, -1), responses, strict=True):
        assert r.log_values is not None
        assert r.log_covariance is not None
        difference = difference + sign * r.log_values[j]
        covariance = covariance + r.log_covariance[j]
        covariance[4, 4] += (DELAY_SAMPLE_SHARE * step / r.delay[j]) ** 2
        covariance[1, 1] += (FRICTION_QUANTUM_SHARE * quantum * r.gain[j] / r.friction[j]) ** 2
    precision = np.linalg.inv(covariance)
    evidence, sizes = [], []
    for _, _, way, sigma in HYPOTHESES:
        direction = np.array(way, dtype=float)
        information, score = direction @ precision @ direction + sigma**-2, direction @ precision @ difference
        sizes.append(float(score / information))
        evidence.append(float(score**2 / information - np.log(information * sigma**2)) / 2)
    wide = covariance + SIGMA_UNLISTED**2 * np.eye(5)
    general = difference @ (precision - np.linalg.inv(wide)) @ difference
    unlisted = float(general + np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(wide)[1]) / 2
    best, second = ranked(evidence)[:2]
    effect, alike, way, _ = HYPOTHESES[best]
    factor = float(np.exp(-sizes[best] if way[0] else sizes[best]))
    if effect == "payload":
        factor = 1 / factor
    return Change(
        j + 1, effect, alike, factor, evidence[best], evidence[best] - evidence[second], evidence[best] - unlisted
    )


def clear_changes(changes: Sequence[Change]) -> Iterator[Change]:
    """Yield the clear changes; that of a payload or a delay at several joints is one change."""
    clear = [change for change in changes if change.clear]
    for effect, alike in (("payload", ("link_mass",)), ("transport_delay", ("lag",))):
        own = [change for change in clear if change.effect == effect]
        if len(own) > 1 and (effect == "payload" or len(own) == len(changes)):
            first = own[0]
            clear = [change for change in clear if change.effect != effect]
            yield Change(None, effect, alike, first.factor, first.evidence, first.margin, first.unlisted)
    yield from clear


def change_table(joints: Sequence[str], changes: Sequence[Change]) -> Table:
    """Return the table of the most probable change of each joint with positive evidence.

    joints : names of the joints
    """
    rows = [
        (joints[change.joint - 1], WORDS[change.effect].format(change.factor), f"{change.evidence:.0f}",
         f"{change.margin:.0f}", f"{change.unlisted:.0f}")
        for change in changes
        if change.joint and change.evidence > 0
    ]  # fmt: skip
    title = "Changed since the reference: log evidence against none, the next cause, and what is on no list [nats]"
    return Table(title, ("joint", "change", "none", "next", "no list"), rows, frozenset({2, 3, 4}))
