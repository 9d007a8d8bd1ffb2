"""The uncertainty budget of a robot's accuracy over the space in which it was measured (GUM).

The measurand is E, the rms distance between the modelled and the actual position of the tool over
the space that the poses represent, with the base placed as well as can be. With held-out errors e_i
at n poses, to which k numbers were fitted, t of them not the base's (JCGM 100:2008, sections 4 and
5):

    E^2 = (3n + t) / (3n - k) mean(e_i^2) - 3 (s_n^2 + s_r^2) + R^2 (u_s^2 + u_t^2)

Elsewhere the base may be placed again, but the tool stays as these n poses determined it.

s_n, s_r : noise of the instrument and repeatability, of a coordinate
R : rms distance of the poses from their centre
u_s : relative uncertainty of the instrument's scale
u_t : relative growth of the robot with temperature

The last two cannot be seen in residuals: an instrument whose scale is wrong leaves none. u(E) =
u(E^2) / (2 E), and U = k u(E) with the quantile of Student's t for 95.45 % at the effective degrees
of freedom (Welch and Satterthwaite), which is 2 where they are many.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from scipy.special import stdtrit

from casadical.core.basics import Array, InputError
from casadical.core.reporting.blocks import mm
from casadical.core.reporting.plain import WRITTEN, Key, written
from casadical.identification.accuracy import errors, residual_mm
from casadical.identification.identification import calibrated, prepare
from casadical.identification.remaining_errors import residuals_and_jacobian
from casadical.measurements.measurements import STANDSTILL_TOLERANCE, Measurements, same_readings, unmeasured
from casadical.robot.robot import Knowledge, Robot

# Number of degrees of freedom that stands for infinitely many.
INFINITE_FREEDOM = 1e6


@dataclass(frozen=True)
class Contribution:
    """One line of the uncertainty budget.

    source : instrument, repeatability, model, frames, temperature or sampling
    kind : A, evaluated from readings, or B, from other knowledge
    square : contribution to E^2 [m^2]
    u : standard uncertainty of E^2 from this source [m^2]
    freedom : degrees of freedom of u
    stated : whether anything was stated about the source
    """

    source: str = field(metadata=WRITTEN)
    kind: str = field(metadata=written("type"))
    square: float = field(metadata=written("adds", "mm2"))
    u: float = field(metadata=written(unit="mm2"))
    freedom: float = field(default=INFINITE_FREEDOM, metadata=WRITTEN)
    stated: bool = field(default=True, metadata=WRITTEN)


@dataclass(frozen=True, eq=False)
class Budget:
    """The rms position error E of a robot's model with its uncertainty.

    errors : held-out errors as the instrument reads them, shape (n,) [m]
    lines : contributions to E^2 and its uncertainty
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("error", unit="mm"),
        Key("U", "expanded", "mm"),
        Key("k", "factor"),
        Key("freedom"),
        Key("resolved"),
        Key("poses", "n"),
        Key("rms", unit="mm"),
        Key("worst", unit="mm"),
        Key("budget", "lines"),
    )

    errors: Array
    lines: tuple[Contribution, ...]

    @property
    def n(self) -> int:
        """Return the number of held-out poses."""
        return len(self.errors)

    @property
    def rms(self) -> float:
        """Return the rms of the held-out errors [m]."""
        return float(np.sqrt(np.mean(self.errors**2)))

    @property
    def worst(self) -> float:
        """Return the greatest held-out error [m]."""
        return float(self.errors.max())

    @property
    def square(self) -> float:
        """Return E^2 [m^2]; it is below zero where the errors are smaller than the stated noise."""
        return self.rms**2 + sum(line.square for line in self.lines)

    @property
    def error(self) -> float:
        """Return the rms position error E [m]; 0 where E^2 is below zero."""
        return float(np.sqrt(max(self.square, 0.0)))

    @property
    def u_square(self) -> float:
        """Return the standard uncertainty of E^2 [m^2]."""
        return float(np.sqrt(sum(line.u**2 for line in self.lines)))

    @property
    def freedom(self) -> float:
        """Return the effective degrees of freedom of u(E^2) (Welch and Satterthwaite)."""
        weighted = sum(line.u**4 / line.freedom for line in self.lines)
        return float(self.u_square**4 / weighted) if weighted else INFINITE_FREEDOM

    @property
    def factor(self) -> float:
        """Return the coverage factor k of U = k u(E), for 95.45 % by Student's t distribution."""
        # The quantile for a coverage of 95.45 %: k = 2 with many degrees of freedom.
        return float(stdtrit(max(1, int(min(self.freedom, INFINITE_FREEDOM))), 0.97725))

    @property
    def resolved(self) -> bool:
        """Return whether E^2 exceeds its expanded uncertainty; if not, E has a limit only."""
        return self.square > self.factor * self.u_square

    @property
    def stated(self) -> str:
        """Return the text "E ± U mm", or "<= limit mm" where E is not resolved."""
        if self.resolved:
            return f"{mm(self.error)} ± {mm(self.expanded)} mm"
        return f"<= {mm(self.error + self.expanded)} mm"

    def u(self, line: Contribution | None = None) -> float:
        """Return the standard uncertainty of E, or the contribution of one line to it [m].

        Contributions add in squares. It is NaN where E is not resolved.
        """
        size = self.u_square if line is None else line.u
        return size / (2 * self.error) if self.resolved else float("nan")

    @property
    def expanded(self) -> float:
        """Return the expanded uncertainty U [m], for E +- U.

        Where E is not resolved, E + U is its upper limit.
        """
        if self.resolved:
            return self.factor * self.u()
        return float(np.sqrt(max(self.square + self.factor * self.u_square, 0.0))) - self.error


def repeats_of(robot: Robot, sets: Sequence[Measurements]) -> tuple[float, float]:
    """Return the standard deviation of a coordinate at repeated poses [m], and degrees of freedom.

    Both are zero without repeats.

    robot : robot by which the small differences between the readings are removed
    """
    square = freedom = 0.0
    for m in sets:
        if m.position is None:
            continue
        reading, residual = same_readings(m.q, STANDSTILL_TOLERANCE), 1e-3 * residual_mm(robot, m)
        counts = np.bincount(reading)
        means = np.stack([np.bincount(reading, residual[:, i]) for i in range(3)], axis=1) / counts[:, None]
        square += float(((residual - means[reading]) ** 2).sum())
        freedom += 3.0 * float((counts - 1).sum())
    return (float(np.sqrt(square / freedom)), freedom) if freedom else (0.0, 0.0)


def budget_of(
    robot: Robot,
    held_out: Sequence[Measurements],
    repeats: tuple[float, float] = (0.0, 0.0),
    groups: Sequence[str] = ("base",),
    *,
    noise: float = 0.0,
    scale: float = 0.0,
    repeatability: float = 0.0,
    growth: float = 0.0,
) -> Budget:
    """Return the budget of a robot's rms error E at held-out positions, and of its uncertainty.

    robot : robot that is judged
    held_out : measured positions that the calibration has not used
    repeats : standard deviation [m] and degrees of freedom, as of `repeats_of`
    groups : groups of parameters that are fitted to these poses first, as far as the robot has them

    Standard uncertainties that the readings do not show; zero: not stated:

    noise : noise of the instrument, of a coordinate [m]
    scale : relative uncertainty of the instrument's lengths [1]
    repeatability : repeatability of the robot, of a coordinate [m]; used where the table has no
        repeated readings
    growth : relative growth of the robot's lengths over the temperatures in which the result is to
        hold [1]
    Raises InputError: fewer than eight poses, or no positions.
    """
    sets = [m.positions_alone() for m in held_out]
    n = sum(map(len, sets))
    if n < 8:
        raise InputError(f"{n} held-out poses; a statement of uncertainty needs 8 or more: [sets] report")
    # A tool that is not fitted keeps its place, which `prepare` would else change.
    own_tool = robot if "tool" in groups else robot.with_unknown(tool="none")
    prepared = prepare(own_tool, sets)
    placed, k, t = prepared.robot, 0, 0
    if own := [g for g in groups if g in robot.parameters.groups]:
        fitted = calibrated(prepared, own, loss="linear")
        placed, k = fitted.robot, len(fitted.names)
        t = sum(robot.parameters[name].group != "base" for name in fitted.names)
    e = np.concatenate([errors(placed, m) for m in prepared.sets])
    p = np.concatenate([m.position for m in prepared.sets if m.position is not None])
    fit_correction = (3 * n + t) / max(3 * n - k, 1)
    whole, mean = fit_correction * float(np.std(e**2, ddof=1)) / np.sqrt(n), fit_correction * float(np.mean(e**2))
    spread = float(np.mean(((p - p.mean(axis=0)) ** 2).sum(axis=1)))
    (s, freedom), own_noise = repeats, noise
    # Degrees of freedom of a stated noise, uncertain by 25 % (JCGM 100:2008, G.4.2).
    stated_noise_freedom = 8.0
    if freedom:  # the scatter of repeats includes the instrument's noise
        own_noise = 0.0
    else:
        s, freedom = repeatability, stated_noise_freedom
    by_noise = [3 * v**2 for v in (own_noise, s)]
    random = sum(by_noise) / 3
    # The part of the variance of mean(e^2) that is due to noise; the rest is due to the space.
    own_part = (6 * random**2 + 4 * random * max(mean - 3 * random, 0.0)) / n
    lines = (
        Contribution(
            "instrument",
            "B",
            -by_noise[0] + scale**2 * spread,
            float(np.hypot(by_noise[0] * np.sqrt(2 / stated_noise_freedom), np.sqrt(2) * scale**2 * spread)),
            stated_noise_freedom if by_noise[0] else INFINITE_FREEDOM,
            noise > 0 or scale > 0,
        ),
        Contribution(
            "repeatability",
            "A" if repeats[1] else "B",
            -by_noise[1],
            float(np.hypot(by_noise[1] * np.sqrt(2 / freedom), np.sqrt(min(own_part, whole**2)))),
            freedom if by_noise[1] else n - 1.0,
            s > 0,
        ),
        Contribution("model", "B", 0.0, _interpolation_uncertainty(robot, sets)),
        Contribution("frames", "A", mean - mean / fit_correction, mean / 3 * np.sqrt(2 * k) / n, 3.0 * n - k),
        Contribution("temperature", "B", growth**2 * spread, np.sqrt(2) * growth**2 * spread, stated=growth > 0),
        Contribution("sampling", "A", 0.0, float(np.sqrt(max(whole**2 - own_part, 0.0))), n - 1.0),
    )
    return Budget(e, lines)


def covariance_root(knowledge: Knowledge, names: Sequence[str]) -> Array:
    """Return F, shape (k, k) [SI], with F F' the covariance of parameters in a robot file.

    knowledge : covariance blocks and misfit, as the robot file states them from its calibration
    names : parameters, in the order of rows and columns
    """
    root = np.zeros((len(names), len(names)))
    for block in knowledge.covariance:
        own = block.only(names)
        at = [names.index(n) for n in own.names]
        values, V = np.linalg.eigh(own.matrix)
        root[np.ix_(at, at)] = V * np.sqrt(np.maximum(values, 0.0) * knowledge.misfit)
    return root


def _interpolation_uncertainty(robot: Robot, sets: Sequence[Measurements]) -> float:
    """Return the standard uncertainty of E^2 due to interpolation between the poses [m^2].

    It is zero without a covariance in the robot file.

    The robot file's covariance gives the variance at new poses between the measured ones; its
    difference from that at the measured ones is the half-width of a rectangular distribution.
    """
    if robot.knowledge is None or not (blocks := robot.knowledge.covariance):
        return 0.0
    names = tuple(n for b in blocks for n in b.names if robot.parameters[n].group != "base")
    factor = covariance_root(robot.knowledge, names)
    q = np.concatenate([m.q for m in sets])
    rng = np.random.default_rng(0)
    # New poses are drawn between each of 300 poses and one of its five nearest neighbours.
    some = q[rng.permutation(len(q))[:300]]
    far = np.stack([np.linalg.norm(q - one, axis=1) for one in some])
    near = np.argsort(far, axis=1)[np.arange(len(some)), rng.integers(1, 6, len(some))]
    drawn = some + rng.uniform(size=(len(some), 1)) * (q[near] - some)
    scale = np.array([robot.parameters[n].scale for n in names])[:, None]

    def mean_square(some: Measurements) -> float:
        """Return the mean position variance over poses due to the parameters' covariance [m^2]."""
        J = 1e-3 * residuals_and_jacobian(robot, [some], names)[1]
        J = J[np.isfinite(J).all(axis=(1, 2))]
        return float(((J @ (factor / scale)) ** 2).sum() / max(len(J), 1))

    own: Array = np.array([mean_square(m) * len(m) for m in sets])
    return float(abs(mean_square(unmeasured(drawn)) - float(own.sum()) / len(q)) / np.sqrt(3))
