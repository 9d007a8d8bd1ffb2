"""How far apart the predictions of causes are: the expected log Bayes factor that each further pose gives.

Each cause's prediction at a new pose is normal: fitted to the data there are, together with the base model, and as
uncertain as that fit leaves it. Poses are added one by one where they most increase the expected log Bayes factor in
favour of the truth, whichever of the causes that is: the divergence of one cause's data from the other's prediction,
learning from the poses picked before (Box and Hill 1967; where the base is well known, T-optimality of Atkinson and
Fedorov 1975). The truth with the smallest factor so far has the largest weight.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.statistics import first_of_best
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.evidence import REPEATABILITY, joint_noise
from casadical.diagnosis.linear_problem import Case, widths
from casadical.diagnosis.linearisation import Linearisation
from casadical.effects import Effect
from casadical.measurements.noise import Noise

# One sigma, in sizes, of a cause's parameters before the data.
WIDE = 2.0


@dataclass(frozen=True, eq=False)
class Prediction:
    """What one cause predicts at all poses of the pool.

    mean : shape (K, 3) [m]; spread : square root of its covariance, shape (K, 3, parameters): spread spread'
    """

    mean: Array
    spread: Array


def predict_cause(case: Case, variant: tuple[Effect, ...], noise: Noise, poses: Linearisation) -> Prediction:
    """Mean and spread at new poses of base model and one cause fitted to the case's data."""
    old, E = case.evidence, poses.columns(variant)
    # Unknown points of the campaign, which new poses do not see.
    points = np.zeros((*poses.J.shape[:2], old.J.shape[2] - poses.J.shape[2]))
    J = np.concatenate([poses.J, points], axis=2)
    for units in (case.units, old.turn):
        J = J if units is None else J @ units
    columns = case.group(variant) if variant else np.zeros(0, dtype=np.int64)
    new = np.concatenate([J, E * widths(variant)], axis=2)
    fit = new_fit(replace(old, held=np.full(old.width, WIDE)), columns, noise, combined=False)
    return Prediction(new @ fit.x, new @ fit.root.T)


def noise_at(noise: Noise, poses: Linearisation) -> Array:
    """Covariance of the noise at new poses, shape (K, 3, 3) [m^2]."""
    return joint_noise(poses.Jq).covariance({REPEATABILITY: noise.repeatability}, noise.sigma)


class Predictive:
    """A cause's predictive distribution at all poses, as it learns from the data at those picked.

    own : covariance of the data at each pose, shape (K, 3, 3); inverse, volume : of it, and log determinant
    """

    def __init__(self, prediction: Prediction, noise: Array) -> None:
        self.first, self.noise = prediction, noise
        self._known: Array = np.eye(prediction.spread.shape[2])
        self._set(prediction.spread @ prediction.spread.transpose(0, 2, 1) + noise)

    def _set(self, own: Array) -> None:
        self.own, self.inverse = own, np.linalg.inv(own)
        self.volume: Array = np.linalg.slogdet(own)[1]

    def learn(self, pose: int) -> Array:
        """Take in the data at a pose, as a Kalman filter does; its gain at all poses, shape (K, 3, 3)."""
        spread = self.first.spread
        toward = self._known @ spread[pose].T
        gain = np.asarray((spread.reshape(-1, len(toward)) @ toward).reshape(-1, 3, 3) @ self.inverse[pose])
        self._known = self._known - toward @ self.inverse[pose] @ toward.T
        self._set(self.own - gain @ self.own[pose] @ gain.transpose(0, 2, 1))
        return gain


class Comparison:
    """What the data of a truth differ by from a model's prediction: mean, shape (K, 3), and root of the covariance less
    the pose's own noise, shape (K, 3, any)."""

    def __init__(self, model: Predictive, truth: Predictive) -> None:
        self.model, self.truth = model, truth
        self.mean: Array = truth.first.mean - model.first.mean
        self.root: Array = truth.first.spread

    def gains(self) -> Array:
        """What each pose adds to the expected log Bayes factor in favour of the truth, shape (K,): a divergence."""
        square = self.model.noise + self.root @ self.root.transpose(0, 2, 1)
        square += self.mean[:, :, None] * self.mean[:, None, :]
        far = (self.model.inverse * square).sum(axis=(1, 2)) - 3
        return np.asarray(0.5 * (far + self.model.volume - self.truth.volume))

    def follow(self, pose: int, gain: Array) -> None:
        """The model has learnt at a pose, with this gain."""
        own = np.linalg.cholesky(self.model.noise[pose])
        self.mean = self.mean - gain @ self.mean[pose]
        self.root = np.concatenate([self.root - gain @ self.root[pose], -gain @ own], axis=2)


Pairs = Sequence[tuple[Predictive, Predictive]]


def pick(asked: Pairs, also: Pairs, n: int) -> tuple[list[int], list[float]]:
    """Greedy choice of n poses and what they separate, summed as they are added: of the truth with the smallest sum.

    asked, also : pairs to distinguish; only the former count as what is separated
    """
    pairs = [*asked, *also]
    comparisons = [d for a, b in pairs for d in (Comparison(a, b), Comparison(b, a))]
    models = list(dict.fromkeys(m for pair in pairs for m in pair))
    picked: list[int] = []
    gained = np.zeros(len(comparisons))
    course = []
    for _ in range(n):
        gains = np.stack([d.gains() for d in comparisons])
        # The truth with the smallest sum so far matters most.
        score = (gains / (1 + gained[:, None])).sum(axis=0)
        score[picked] = -np.inf
        best = first_of_best(score)
        gained = gained + gains[:, best]
        picked.append(best)
        course.append(float(gained[: 2 * len(asked)].min()))
        learnt = {m: m.learn(best) for m in models}
        for comparison in comparisons:
            comparison.follow(best, learnt[comparison.model])
    return picked, course
