"""What is known of a robot after few readings: a linear fit with priors, whose two widths the readings themselves tell.

Noise of a coordinate and departure from nominal (as a factor on the robot's own priors) are those of a grid, weighted
by their evidence (MacKay 1992, "Bayesian interpolation", eqs. 2.6 and 4.5): a prediction is as sure as the readings
until now make it, from the fifth on. Base and tool are put where the readings say and are free. Readings are of any
kind without unknown points: positions, full poses (an angle's noise is the length's times the most evident of some
ratios), distances to known places.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadical.core.arrays import Array
from casadical.identification.accuracy import predicted
from casadical.identification.least_squares import FRAMES, LeastSquares
from casadical.identification.placement import place_frames
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.pose_selection.information import MM, scaled_jacobian
from casadical.robot.robot import Robot

# Readings from which on one is judged by the others.
FEWEST = 5
# Of so few readings each is judged by a fit without it.
FEW = 12
# Squared distance of a reading from its prediction, in units of their covariance, by how many numbers it has: exceeded
# by noise in 1 of 700 000.
LIMITS = {1: 23.3, 2: 27.0, 3: 30.0, 4: 32.7, 5: 35.2, 6: 37.5}
# Of a noise that few numbers tell it is greater by (1 + this over their degrees of freedom), about as Fisher's F is.
UNSURE = 20.0
# One sigma of a coordinate [mm], and factors on the priors, whose evidence is compared.
SIGMAS = np.geomspace(0.008, 60.0, 22)
WIDTHS = np.array([0.1, 0.25, 0.6, 1.5])
# An angle's sigma over a coordinate's [mrad/mm].
RATIOS = np.geomspace(0.3, 30.0, 7)
# One sigma of base and tool about where they were put, in units of scale (m, rad): they are not known.
FREE = 1e3
# One sigma of a coordinate, and of base and tool in units of scale, before readings tell them.
NOISE, STANDS_IN = 5e-5, 30.0
STEPS = 3


@dataclass(frozen=True, eq=False)
class Estimate:
    """The robot as some readings tell it.

    robot : with their values; names : of the parameters that were fitted; covariance : shape (p, p), units of scale
    sigma : of a coordinate [m]; ratio : of an angle's to it [mrad/mm]
    m : the readings; left_out : what each would miss the model of the others by, shape (n, lengths) [m]; surprise : the
    same squared, angles with it, in units of its covariance, shape (n,); widened : the limit of surprises over `LIMITS`
    """

    robot: Robot
    names: tuple[str, ...]
    covariance: Array
    sigma: float
    ratio: float
    m: Measurements
    left_out: Array
    surprise: Array
    widened: float

    def __len__(self) -> int:
        return len(self.m)

    @property
    def known(self) -> tuple[tuple[str, ...], Array, float]:
        """Names, their information in units of scale, and the noise [m]."""
        return self.names, np.linalg.inv(self.covariance), self.sigma

    @property
    def limit(self) -> float:
        """Of the surprise of a reading that noise explains."""
        return LIMITS[find_kind(self.m.kind).numbers] * self.widened

    def misses(self, m: Measurements) -> tuple[Array, Array]:
        """What readings miss the prediction by, shape (n, lengths) [m], and its square, angles with it, in units of
        its covariance, shape (n,).

        Where a four-bar cannot close, the latter are infinite.
        """
        off, J = observed(self.robot, self.names, m, self.ratio)
        square, closed = np.full(len(m), np.inf), np.isfinite(off).all(axis=1) & np.isfinite(J).all(axis=(1, 2))
        J, r = J[closed], off[closed]
        C = J @ self.covariance @ J.transpose(0, 2, 1) + (self.sigma / MM) ** 2 * np.eye(J.shape[1])
        square[closed] = np.einsum("ni,ni->n", r, np.linalg.solve(C, r[..., None])[..., 0])
        return MM * off[:, : find_kind(m.kind).lengths], square

    def expected(self, task: Measurements) -> float:
        """Root mean square error of the robot itself to expect over a task [m]."""
        J = scaled_jacobian(self.robot, self.names, task)
        return float(MM * np.sqrt(np.einsum("kip,pq,kiq->", J, self.covariance, J, optimize=True) / len(J)))


def names_of(robot: Robot) -> tuple[str, ...]:
    """What is estimated: geometry, frames, compliance."""
    return tuple(robot.parameters.select(("kinematic", "compliance")))


def observed(robot: Robot, names: tuple[str, ...], m: Measurements, ratio: float = 1.0) -> tuple[Array, Array]:
    """Measured less computed, shape (n, numbers), and the model's Jacobian, (n, numbers, p) [mm and ratio mrad]."""
    (r,), J = LeastSquares(robot, (m,), names, "linear", False, ((MM, MM * ratio),)).evaluate(np.zeros(len(names)))
    if m.orientation is not None:  # a residual that is the sine of the angle does not see half a turn
        turned = np.einsum("nij,nij->n", predicted(robot, m)[1], m.orientation) < 1.0
        r = np.where(turned[:, None] & (np.arange(r.shape[1]) >= 3), np.pi / (MM * ratio), r)
    return -r, J.reshape(*r.shape, len(names))


def known_at_first(robot: Robot, m: Measurements | None) -> tuple[tuple[str, ...], Array, float]:
    """As `Estimate.known` of readings that are too few for one: by the robot's own priors."""
    names = names_of(robot)
    own = [robot.parameters[name] for name in names]
    width = np.array([STANDS_IN if p.group in FRAMES else p.prior / p.scale for p in own])
    J = np.zeros((0, len(names))) if m is None else observed(robot, names, m)[1].reshape(-1, len(names))
    return names, J.T @ J / (NOISE / MM) ** 2 + np.diag(width**-2), NOISE


def estimate(robot: Robot, m: Measurements) -> Estimate:
    """The robot as these readings tell it; robot : nominal."""
    placed, kind = place_frames(robot, m), find_kind(m.kind)
    names = names_of(placed)
    own = [placed.parameters[name] for name in names]
    frames = np.array([p.group in FRAMES for p in own])
    scale, value, lower, upper = (
        np.array([getattr(p, what) for p in own]) for what in ("scale", "value", "lower", "upper")
    )
    width = np.array([p.prior for p in own]) / scale
    x, now, ratios = np.zeros(len(names)), placed, RATIOS if kind.angles else np.ones(1)
    angles = np.arange(kind.numbers) >= kind.lengths
    for _ in range(STEPS):
        r, J = observed(now, names, m)
        y = r + J @ x
        fits = [(*_by_evidence(J, y, np.where(angles, 1 / each, 1.0), frames, width), float(each)) for each in ratios]
        _, sigma, C, b, ratio = max(fits, key=lambda fit: fit[0])
        ratios = np.array([ratio])
        values = np.clip(value + scale * (C @ b), lower, upper)
        x, now = (values - value) / scale, placed.with_values(dict(zip(names, values, strict=True)))
    r, J = observed(now, names, m, ratio)[0], J * np.where(angles, 1 / ratio, 1.0)[:, None]
    free = np.eye(kind.numbers) - J @ C @ J.transpose(0, 2, 1) / sigma**2
    off = np.linalg.solve(free, r[..., None])[..., 0]
    freedom = max(float(np.trace(free, axis1=1, axis2=2).sum()), 1.0)
    return Estimate(
        now, names, C, MM * sigma, ratio, m, MM * off[:, : kind.lengths],
        np.einsum("ni,ni->n", off, r) / sigma**2, 1 + UNSURE / freedom,
    )  # fmt: skip


def _by_evidence(J: Array, y: Array, weight: Array, frames: Array, width: Array) -> tuple[float, float, Array, Array]:
    """Of y = J x + noise, shapes (n, numbers, p) and (n, numbers): logarithm of the evidence, noise [mm], covariance,
    shape (p, p), and J'y over the noise's square, (p,).

    weight : of the numbers of a reading, shape (numbers,)
    """
    told = len(y) * float(np.log(weight).sum())
    J, y = (J * weight[:, None]).reshape(-1, J.shape[2]), (y * weight).ravel()
    G, b, square = J.T @ J, J.T @ y, float(y @ y)
    logs, precisions = np.empty((len(WIDTHS), len(SIGMAS))), []
    for i, factor in enumerate(WIDTHS):
        P = np.where(frames, FREE**-2, (factor * width) ** -2)
        precisions.append(P)
        root = 1 / np.sqrt(P)
        values, V = np.linalg.eigh(root[:, None] * G * root)
        along, values = (V.T @ (root * b)) ** 2, np.maximum(values, 0.0)
        for k, s in enumerate(SIGMAS):
            ratio = values / s**2
            quadratic = square / s**2 - float((along / s**4 / (1 + ratio)).sum())
            logs[i, k] = -0.5 * quadratic - len(y) * np.log(s) - 0.5 * float(np.log1p(ratio).sum())
    weights = np.exp(logs - logs.max())
    evidence = told + float(logs.max() + np.log(weights.sum()))
    weights /= weights.sum()
    sigma = float(np.sqrt((weights.sum(axis=0) * SIGMAS**2).sum()))
    variance = (weights.sum(axis=1)[:, None] / np.array(precisions)).sum(axis=0)
    return evidence, sigma, np.linalg.inv(G / sigma**2 + np.diag(1 / variance)), b / sigma**2


def counted(robot: Robot, m: Measurements, doubtful: Array) -> tuple[Estimate | None, Array, Array]:
    """The estimate without readings that it contradicts; which these are, and how far each reading is off.

    doubtful : mask of those that were, shape (n,)
    Returns the estimate, None of too few readings, the mask, shape (n,), and what each misses, shape (n, lengths) [m].
    """
    out, lengths = doubtful.copy(), find_kind(m.kind).lengths
    if len(m) < FEWEST:
        return None, np.zeros(len(m), dtype=bool), np.zeros((len(m), lengths))
    if (~out).sum() < FEWEST:  # the first are judged by each other, the others by them
        out[:FEW] = False
    for _ in range(3 + len(m) // 10):
        inside = np.flatnonzero(~out)
        found = estimate(robot, m[inside])
        surprise, off = np.zeros(len(m)), np.zeros((len(m), lengths))
        off[inside], surprise[inside] = found.left_out, found.surprise
        if FEWEST < len(inside) <= FEW:
            surprise[inside] = [_without(robot, m, inside, k) for k in range(len(inside))]
        if out.any():
            off[out], surprise[out] = found.misses(m[np.flatnonzero(out)])
        worst = int(inside[np.argmax(surprise[inside])])
        if surprise[worst] > found.limit and len(inside) > FEWEST:
            out[worst] = True
        elif (back := out & (surprise <= found.limit)).any():
            out[back] = False
        else:
            break
    return found, out, off


def _without(robot: Robot, m: Measurements, inside: Array, k: int) -> float:
    """Surprise of the k-th reading to a fit of the others."""
    return float(estimate(robot, m[np.delete(inside, k)]).misses(m[inside[[k]]])[1][0])
