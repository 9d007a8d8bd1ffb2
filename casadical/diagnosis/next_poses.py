"""What to measure next: poses at which the causes in question predict most unlike positions.

Each cause's prediction at a new pose is normal: fitted to the data there are, together with the base model, and as
uncertain as that fit leaves it. Poses are added one by one where they most increase the expected log Bayes factor in
favour of the truth, whichever of the causes that is: the divergence of one cause's data from the other's prediction,
learning from the poses picked before (Box and Hill 1967; where the base is well known, T-optimality of Atkinson and
Fedorov 1975). The truth that is told least so far counts most.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import erf, log, sqrt

import numpy as np
import pandas as pd

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.diagnosis.cross_validation import covariance, likely_noise
from casadical.diagnosis.evidence import KAPPA_WEIGHTS, Evidence, log_sum
from casadical.diagnosis.linear_problem import Case, widths
from casadical.diagnosis.linearisation import signatures
from casadical.diagnosis.pose_pool import Pool, draw_pool, news
from casadical.diagnosis.result import Diagnosis
from casadical.effects import Effect
from casadical.measurements.measurements import Measurements
from casadical.measurements.noise import Noise
from casadical.pose_selection.workspace import Workspace

POOL = 800
# One sigma, in sizes, of a cause's parameters before the data.
WIDE = 2.0
# Settings of a cause that are looked at, and by how much their log likelihood may be less than the best one's.
MOST_VARIANTS, LIKELY = 2, 4.0
NONE = "none"


@dataclass(frozen=True, eq=False)
class _Prediction:
    """What one cause predicts at all poses of the pool.

    mean : shape (K, 3) [m]; spread : square root of its covariance, shape (K, 3, parameters): spread spread'
    """

    mean: Array
    spread: Array


def next_poses(
    found: Diagnosis | Case,
    n: int,
    labels: Sequence[str] = (),
    seed: int = 0,
    *,
    beside: Sequence[str] | None = None,
    workspace: Workspace | None = None,
    payloads: Sequence[float] = (),
    pool: int = POOL,
) -> pd.DataFrame:
    """The next n poses to measure, the most informative first.

    found : a diagnosis, or the case of one
    labels : causes to distinguish, as the case's candidates name them; "none" for no cause at all; by default those
        that the diagnosis has in question (`Diagnosis.in_question`), and an empty table where there are none
    beside : others from which each of them is to be distinguished as well, but not from each other; by default "none",
        and with the default labels the most probable other cause
    workspace : where poses may lie; by default the robot's own ranges, loops as open as they were in the campaign
    payloads : states [kg] that can be mounted; by default none, the declared one and the campaign's
    pool : how many poses are drawn to choose from; the campaign's own are added

    Columns: order; q1_deg ...; payload_kg and approach1 ... where they matter; repeats, the row of the campaign that
    the pose repeats, if any; state, cold or warm, where a cause follows the temperature; new, what the campaign had
    not (a wider range of a joint, another payload, approach or thermal state); separation, the expected log Bayes
    factor in favour of the truth among the labels, of this pose and those before it, for the truth that is told least;
    and, empty, the columns to be logged. Raises InputError for fewer than two labels or one that the case does not
    know.
    """
    case = found.case if isinstance(found, Diagnosis) else found
    others: tuple[str, ...] = ()
    if isinstance(found, Diagnosis) and not labels:
        labels = found.in_question
        if len(labels) < 2:
            return pd.DataFrame()
        known = {c.label for c in case.candidates}
        others = tuple(k for k in found.rankings[-1].order if k in known and k not in labels)[:1]
    causes = _causes(case, labels, (NONE, *others) if beside is None else beside)
    noise = causes[0].noise
    effects = tuple(dict.fromkeys(e for cause in causes for e in cause.variant))
    drawn = draw_pool(case, effects, pool, seed, workspace, payloads)
    noise_there = _noise_at(case, noise, drawn.m)
    models = [(c.label, _Model(_predict(case, c.variant, noise, drawn.m), noise_there)) for c in causes]
    rivals = [(a in labels, b in labels, p, r) for (a, p), (b, r) in combinations(models, 2) if a != b]
    asked = [(p, r) for first, second, p, r in rivals if first and second]
    also = [(p, r) for first, second, p, r in rivals if first != second]
    picked, gained = _pick(asked, also, min(n, len(drawn.m)))
    return _table(case, effects, drawn, picked, gained)


@dataclass(frozen=True)
class _Cause:
    """A label with settings that the data allow, and the noise that these leave."""

    label: str
    variant: tuple[Effect, ...]
    noise: Noise


def _causes(case: Case, labels: Sequence[str], beside: Sequence[str] = ()) -> list[_Cause]:
    """Each label with its most likely settings and another that the data allow as well; of those beside, one each."""
    if len(set(labels)) < 2:
        raise InputError(f"causes {list(labels)}; give two or more to distinguish")
    known = {c.label: c for c in case.candidates}
    found: list[_Cause] = []
    for label in dict.fromkeys((*labels, *beside)):
        if label == NONE:
            found.append(_Cause(NONE, (), likely_noise(case.evidence.log_base())))
            continue
        if label not in known:
            raise InputError(f"cause {label!r} is no candidate of this case; there are none, {', '.join(known)}")
        variants = known[label].variants
        grids = case.evidence.log_grids([case.group(v) for v in variants]) + np.log(KAPPA_WEIGHTS)
        likely = log_sum(grids.reshape(len(variants), -1), axis=1)
        allowed = np.flatnonzero(likely > likely.max() - LIKELY)
        spread = allowed[np.linspace(0, len(allowed) - 1, MOST_VARIANTS).astype(int)]
        others = spread.tolist() if label in labels else []
        for k in dict.fromkeys([int(np.argmax(likely)), *others]):
            found.append(_Cause(label, variants[k], likely_noise(grids[k])))
    # The cause that leaves the least noise comes first: its noise is taken for all.
    return sorted(found, key=lambda cause: cause.noise.sigma)


def _predict(case: Case, variant: tuple[Effect, ...], noise: Noise, m: Measurements) -> _Prediction:
    """Mean and spread at new poses of base model and one cause fitted to the case's data."""
    old = case.evidence
    E, J, _ = signatures(case.given, variant, m, case.values)
    J = J if case.units is None else J @ case.units
    columns = case.group(variant) if variant else np.zeros(0, dtype=np.int64)
    A = np.concatenate([old.J, old.take(columns)], axis=2)
    new = np.concatenate([J, E * widths(variant)], axis=2)
    prior = np.concatenate([old.prior, np.full(len(columns), WIDE)])
    mean = np.concatenate([old.delta0, np.zeros(len(columns))])
    # Scaled by the prior, the normal matrix is at least the identity.
    A, new, mean = A * prior, new * prior, mean / prior
    AW = np.einsum("nip,nij->npj", A, np.linalg.inv(covariance(old, noise)))
    normal = (AW @ A).sum(axis=0) + np.eye(len(prior))
    right = np.einsum("npj,nj->p", AW, old.r) + mean
    L = np.linalg.cholesky(normal)
    fitted = np.linalg.solve(L.T, np.linalg.solve(L, right))
    spread = np.linalg.solve(L, new.reshape(-1, len(prior)).T).T.reshape(new.shape)
    return _Prediction(new @ fitted, spread)


def _noise_at(case: Case, noise: Noise, m: Measurements) -> Array:
    """Covariance of the noise at new poses, shape (K, 3, 3) [m^2]."""
    _, J, Jq = signatures(case.given, (), m, case.values)
    empty = np.zeros((len(m), 3, 0))
    return covariance(Evidence(np.zeros((len(m), 3)), J, Jq, np.zeros(0), np.ones(0), empty), noise)


class _Model:
    """A cause's predictive distribution at all poses, as it learns from the data at those picked.

    own : covariance of the data at each pose, shape (K, 3, 3); inverse, volume : of it, and log determinant
    """

    def __init__(self, prediction: _Prediction, noise: Array) -> None:
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


class _Duel:
    """What the data of a truth differ by from a model's prediction: mean, shape (K, 3), and root of the covariance less
    the pose's own noise, shape (K, 3, any)."""

    def __init__(self, model: _Model, truth: _Model) -> None:
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
        heard = np.linalg.cholesky(self.model.noise[pose])
        self.mean = self.mean - gain @ self.mean[pose]
        self.root = np.concatenate([self.root - gain @ self.root[pose], -gain @ heard], axis=2)


_Pairs = Sequence[tuple[_Model, _Model]]


def _pick(asked: _Pairs, also: _Pairs, n: int) -> tuple[list[int], list[float]]:
    """Greedy choice of n poses and what they separate, summed as they are added: of the truth told least.

    asked, also : pairs to distinguish; only the former count as what is separated
    """
    pairs = [*asked, *also]
    duels = [d for a, b in pairs for d in (_Duel(a, b), _Duel(b, a))]
    models = list(dict.fromkeys(m for pair in pairs for m in pair))
    picked: list[int] = []
    gained = np.zeros(len(duels))
    course = []
    for _ in range(n):
        gains = np.stack([d.gains() for d in duels])
        # The truth that is told least so far matters most.
        score = (gains / (1 + gained[:, None])).sum(axis=0)
        score[picked] = -np.inf
        best = int(np.argmax(score))
        gained = gained + gains[:, best]
        picked.append(best)
        course.append(float(gained[: 2 * len(asked)].min()))
        learnt = {m: m.learn(best) for m in models}
        for duel in duels:
            duel.follow(best, learnt[duel.model])
    return picked, course


def _table(
    case: Case, effects: tuple[Effect, ...], drawn: Pool, picked: list[int], gained: list[float]
) -> pd.DataFrame:
    rows = drawn.m[np.array(picked, dtype=np.int64)]
    table = pd.DataFrame({"order": np.arange(1, len(picked) + 1)})
    for j, joint in enumerate(case.robot.joints, 1):
        unit, factor = ("deg", 180 / np.pi) if joint.kind == "revolute" else ("mm", 1e3)
        table[f"q{j}_{unit}"] = np.round(factor * rows.q[:, j - 1], 4)
    needed = {c for e in effects for c in e.conditions}
    if "payload_kg" in rows.conditions:
        table["payload_kg"] = rows.conditions["payload_kg"]
    for name in sorted(c for c in needed if c.startswith("approach")):
        table[name] = rows.conditions[name].astype(int)
    if drawn.warm is not None:
        table["state"] = np.where(drawn.warm[picked], "warm", "cold")
    source = drawn.repeated[picked]
    table["repeats"] = [f"row {case.m.row[k]}" if k >= 0 else "" for k in source]
    table["new"] = news(case, drawn, picked)
    table["separation"] = np.round(gained, 3)
    for name in ("time_s", "temperature_degC", "x_mm", "y_mm", "z_mm"):
        table[name] = np.nan
    return table


def discrimination_probability(found: Diagnosis, poses: pd.DataFrame) -> tuple[float, float]:
    """Probability that the more probable of the two most similar causes is true: now, and after these poses.

    poses : of `next_poses`. After them the log odds are normal about their expected gain D with variance 2 D, whichever
    cause is true.
    """
    first, second = found.in_question[:2]
    ranking = max(found.rankings, key=lambda r: r.probability.get(first, 0) + r.probability.get(second, 0))
    a, b = (max(ranking.probability.get(k, 0.0), 1e-12) for k in (first, second))
    share = a / (a + b)
    return probability_after(share, 0.0), probability_after(share, float(poses["separation"].iloc[-1]))


def probability_after(share: float, gain: float) -> float:
    """Probability of a right choice between two causes, of which one has this share, after an expected log factor."""
    if gain <= 0:
        return max(share, 1 - share)
    odds, width = log(share / (1 - share)), sqrt(2 * gain)
    return share * _normal((gain + odds) / width) + (1 - share) * _normal((gain - odds) / width)


def _normal(x: float) -> float:
    return 0.5 * (1 + erf(x / sqrt(2)))
