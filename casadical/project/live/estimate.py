"""What is known of a robot after few readings: a linear fit with priors, whose two widths the readings themselves tell.

Noise of a coordinate and departure from nominal (as a factor on the robot's own priors) are those of a grid, weighted
by their evidence (MacKay 1992, "Bayesian interpolation", eqs. 2.6 and 4.5): a prediction is as sure as the readings
until now make it, from the fifth on. Base and tool are put where the readings say and are free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadical.core.arrays import Array
from casadical.identification.accuracy import predicted, residual_mm
from casadical.identification.least_squares import FRAMES
from casadical.identification.placement import place_frames
from casadical.identification.prior import Prior
from casadical.measurements.measurements import Measurements
from casadical.pose_selection.information import MM, scaled_jacobian
from casadical.robot.robot import Robot

# Readings from which on one is judged by the others.
FEWEST = 5
# Of so few readings each is judged by a fit without it.
FEW = 12
# Squared distance of a position from its prediction, in units of their covariance: exceeded by noise in 1 of 700 000.
LIMIT = 30.0
# Of a noise that few numbers tell it is greater by (1 + this over their degrees of freedom), about as Fisher's F is.
UNSURE = 20.0
# One sigma of a coordinate [mm], and factors on the priors, whose evidence is compared.
SIGMAS = np.geomspace(0.008, 60.0, 22)
WIDTHS = np.array([0.1, 0.25, 0.6, 1.5])
# One sigma of base and tool about where they were put, in units of scale (m, rad): they are not known.
FREE = 1e3
STEPS = 3


@dataclass(frozen=True, eq=False)
class Estimate:
    """The robot as some readings tell it.

    robot : with their values; names : of the parameters that were fitted; covariance : shape (p, p), units of scale
    sigma : of a coordinate [m]; limit : of the surprise of a reading that noise explains
    prior : that the readings tell of departures from nominal; m : the readings
    left_out : what each would miss the model of the others by, shape (n, 3) [m]; surprise : the same squared, in units
    of its covariance, shape (n,)
    """

    robot: Robot
    names: tuple[str, ...]
    covariance: Array
    sigma: float
    limit: float
    prior: Prior
    m: Measurements
    left_out: Array
    surprise: Array

    def __len__(self) -> int:
        return len(self.m)

    def covariances(self, m: Measurements) -> Array:
        """Of predicted readings, noise included, shape (n, 3, 3) [m^2]."""
        J = scaled_jacobian(self.robot, self.names, m)
        return np.asarray(MM**2 * (J @ self.covariance @ J.transpose(0, 2, 1)) + self.sigma**2 * np.eye(3))

    def misses(self, m: Measurements, position: Array) -> tuple[Array, Array]:
        """Positions less predictions, shape (n, 3) [m], and their squares in units of their covariance, shape (n,).

        Where a four-bar cannot close, the latter are infinite.
        """
        off = position - predicted(self.robot, m)[0]
        if not (closed := np.isfinite(off).all(axis=1)).all():
            square = np.full(len(m), np.inf)
            if closed.any():
                square[closed] = self.misses(m[np.flatnonzero(closed)], position[closed])[1]
            return off, square
        return off, np.einsum("ni,ni->n", off, np.linalg.solve(self.covariances(m), off[..., None])[..., 0])

    def expected(self, task: Measurements) -> float:
        """Root mean square error of the robot itself to expect over a task [m]."""
        J = scaled_jacobian(self.robot, self.names, task)
        return float(MM * np.sqrt(np.einsum("kip,pq,kiq->", J, self.covariance, J, optimize=True) / len(J)))


def names_of(robot: Robot) -> tuple[str, ...]:
    """What is estimated: geometry, frames, compliance."""
    return tuple(robot.parameters.select(("kinematic", "compliance")))


def estimate(robot: Robot, m: Measurements) -> Estimate:
    """The robot as these readings of positions tell it; robot : nominal."""
    placed = place_frames(robot, m)
    names = names_of(placed)
    own = [placed.parameters[name] for name in names]
    frames = np.array([p.group in FRAMES for p in own])
    scale, value, lower, upper = (
        np.array([getattr(p, what) for p in own]) for what in ("scale", "value", "lower", "upper")
    )
    width = np.array([p.prior for p in own]) / scale
    x, now = np.zeros(len(names)), placed
    for _ in range(STEPS):
        J, r = scaled_jacobian(now, names, m), residual_mm(now, m)
        rows, y = J.reshape(-1, len(names)), r.ravel() + J.reshape(-1, len(names)) @ x
        sigma, variance, C = _by_evidence(rows, y, frames, width)
        values = np.clip(value + scale * (C @ (rows.T @ y)) / sigma**2, lower, upper)
        x, now = (values - value) / scale, placed.with_values(dict(zip(names, values, strict=True)))
    r = residual_mm(now, m)
    free = np.eye(3) - J @ C @ J.transpose(0, 2, 1) / sigma**2
    off = np.linalg.solve(free, r[..., None])[..., 0]
    freedom = max(float(np.trace(free, axis1=1, axis2=2).sum()), 1.0)
    limit = LIMIT * (1 + UNSURE / freedom)
    spread = scale * np.sqrt(variance)
    held = {name: (p.value, float(s)) for name, p, s, f in zip(names, own, spread, frames, strict=True) if not f}
    return Estimate(
        now, names, C, MM * sigma, limit, Prior(means=held), m, MM * off, np.einsum("ni,ni->n", off, r) / sigma**2
    )


def _by_evidence(J: Array, y: Array, frames: Array, width: Array) -> tuple[float, Array, Array]:
    """Noise [mm], variances of the prior, shape (p,), and covariance, (p, p), by the evidence of y = J x + noise."""
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
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    sigma = float(np.sqrt((weight.sum(axis=0) * SIGMAS**2).sum()))
    variance = (weight.sum(axis=1)[:, None] / np.array(precisions)).sum(axis=0)
    return sigma, variance, np.linalg.inv(G / sigma**2 + np.diag(1 / variance))


def counted(robot: Robot, m: Measurements, doubtful: Array) -> tuple[Estimate | None, Array, Array]:
    """The estimate without readings that it contradicts; which these are, and how far each reading is off.

    doubtful : mask of those that were, shape (n,)
    Returns the estimate, None of too few readings, the mask, shape (n,), and what each misses, shape (n, 3) [m].
    """
    out = doubtful.copy()
    if len(m) < FEWEST:
        return None, np.zeros(len(m), dtype=bool), np.zeros((len(m), 3))
    if (~out).sum() < FEWEST:  # the first are judged by each other, the others by them
        out[:FEW] = False
    assert m.position is not None
    for _ in range(3 + len(m) // 10):
        inside = np.flatnonzero(~out)
        found = estimate(robot, m[inside])
        surprise, off = np.zeros(len(m)), np.zeros((len(m), 3))
        off[inside], surprise[inside] = found.left_out, found.surprise
        if FEWEST < len(inside) <= FEW:
            surprise[inside] = [_without(robot, m, inside, k) for k in range(len(inside))]
        if out.any():
            off[out], surprise[out] = found.misses(m[np.flatnonzero(out)], m.position[out])
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
    assert m.position is not None
    one = inside[[k]]
    return float(estimate(robot, m[np.delete(inside, k)]).misses(m[one], m.position[one])[1][0])
