"""What to measure next: poses at which the causes in question predict most unlike positions.

Each cause's prediction at a new pose is normal: fitted to the data there are, together with the base model, and as
uncertain as that fit leaves it. Poses are added one by one where they most increase the expected log Bayes factor in
favour of the truth, whichever of the causes that is: the divergence of one cause's data from the other's prediction,
learning from the poses picked before (Box and Hill 1967; where the base is well known, T-optimality of Atkinson and
Fedorov 1975). The truth that is told least so far counts most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd

from ..effects import Effect
from ..errors import InputError
from ..measurements import Measurements
from ..pose_selection.workspace import Workspace
from ..transforms import Array
from .case import Case, widths
from .evidence import KAPPA_WEIGHTS, Evidence, log_sum
from .gap import Noise, covariance, likely_noise
from .pose_pool import Pool, draw_pool, news
from .signatures import signatures

POOL = 1500
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
    case: Case,
    labels: Sequence[str],
    n: int,
    seed: int = 0,
    *,
    workspace: Workspace | None = None,
    payloads: Sequence[float] = (),
    pool: int = POOL,
) -> pd.DataFrame:
    """The next n poses to measure, the most telling first.

    labels : causes to tell apart, as the case's candidates name them; "none" for no cause at all
    workspace : where poses may lie; by default the robot's own ranges, loops as open as they were in the campaign
    payloads : states [kg] that can be mounted; by default none, the declared one and the campaign's
    pool : how many poses are drawn to choose from; the campaign's own are added

    Columns: order; q1_deg ...; payload_kg and approach1 ... where they matter; repeats, the row of the campaign that
    the pose repeats, if any; state, cold or warm, where a cause follows the temperature; new, what the campaign had
    not (a wider range of a joint, another payload, approach or thermal state); separation, the expected log Bayes
    factor in favour of the truth, of this pose and those before it, for the truth that is told least; and, empty, the
    columns to be logged. Raises InputError for fewer than two labels or one that the case does not know.
    """
    causes = _causes(case, labels)
    noise = causes[0].noise
    effects = tuple(dict.fromkeys(e for cause in causes for e in cause.variant))
    drawn = draw_pool(case, effects, pool, seed, workspace, payloads)
    predictions = [(cause.label, _predict(case, cause.variant, noise, drawn.m)) for cause in causes]
    picked, gained = _pick(predictions, _noise_at(case, noise, drawn.m), min(n, len(drawn.m)))
    return _table(case, effects, drawn, picked, gained)


@dataclass(frozen=True)
class _Cause:
    """A label with settings that the data allow, and the noise that these leave."""

    label: str
    variant: tuple[Effect, ...]
    noise: Noise


def _causes(case: Case, labels: Sequence[str]) -> list[_Cause]:
    """Each label with its most likely settings and some others that the data allow as well."""
    if len(set(labels)) < 2:
        raise InputError(f"causes {list(labels)}; give two or more that are to be told apart")
    known = {c.label: c for c in case.candidates}
    found: list[_Cause] = []
    for label in dict.fromkeys(labels):
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
        for k in dict.fromkeys([int(np.argmax(likely)), *spread.tolist()]):
            found.append(_Cause(label, variants[k], likely_noise(grids[k])))
    # The cause that leaves the least noise comes first: its noise is taken for all.
    return sorted(found, key=lambda cause: cause.noise.sigma)


def _predict(case: Case, variant: tuple[Effect, ...], noise: Noise, m: Measurements) -> _Prediction:
    """Mean and spread at new poses of base model and one cause fitted to the case's data."""
    old = case.evidence
    E, J, _ = signatures(case.given, variant, m, case.values)
    columns = case.group(variant) if variant else np.zeros(0, dtype=np.int64)
    A = np.concatenate([old.J, old.E[:, :, columns]], axis=2)
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


class _Duel:
    """One model's predictions against data from another one, given the poses picked so far.

    own : covariance of the model's predictive distribution at each pose, shape (K, 3, 3)
    miss : mean, shape (K, 3), and root of the covariance, shape (K, 3, any), less the pose's own noise, of what the
        truth's data differ from the model's prediction by
    """

    def __init__(self, model: _Prediction, truth: _Prediction, noise: Array) -> None:
        self._spread, self._noise = model.spread, noise
        self._known: Array = np.eye(model.spread.shape[2])
        self.own: Array = model.spread @ model.spread.transpose(0, 2, 1) + noise
        self.miss: tuple[Array, Array] = (truth.mean - model.mean, truth.spread)

    def distance(self) -> Array:
        """Expected squared Mahalanobis distance of the truth's data from the prediction, shape (K,)."""
        mean, root = self.miss
        square = self._noise + root @ root.transpose(0, 2, 1) + mean[:, :, None] * mean[:, None, :]
        return np.asarray(np.trace(np.linalg.solve(self.own, square), axis1=1, axis2=2))

    def volume(self) -> Array:
        """Logarithm of the determinant of the predictive covariance, shape (K,)."""
        return np.asarray(np.linalg.slogdet(self.own)[1])

    def pick(self, pose: int) -> None:
        """Let the model learn from the data at a pose (as a Kalman filter does)."""
        toward = self._known @ self._spread[pose].T
        gain = np.linalg.solve(self.own[pose], (self._spread @ toward).transpose(0, 2, 1)).transpose(0, 2, 1)
        self._known = self._known - toward @ np.linalg.solve(self.own[pose], toward.T)
        self.own = self.own - gain @ self.own[pose] @ gain.transpose(0, 2, 1)
        mean, root = self.miss
        heard = np.linalg.cholesky(self._noise[pose])
        self.miss = (mean - gain @ mean[pose], np.concatenate([root - gain @ root[pose], -gain @ heard], axis=2))


def _pick(predictions: Sequence[tuple[str, _Prediction]], noise: Array, n: int) -> tuple[list[int], list[float]]:
    """Greedy choice of n poses and what they separate, summed as they are added: of the truth told least.

    predictions : with the label of each; of one label, they are not told apart
    """
    rivals = [(p, r) for (a, p), (b, r) in combinations(predictions, 2) if a != b]
    pairs = [(_Duel(p, r, noise), _Duel(r, p, noise)) for p, r in rivals]
    picked: list[int] = []
    gained = np.zeros(2 * len(pairs))
    course = []
    for _ in range(n):
        gains = np.concatenate([_gains(one, other) for one, other in pairs])
        # The truth that is told least so far matters most.
        score = (gains / (1 + gained[:, None])).sum(axis=0)
        score[picked] = -np.inf
        best = int(np.argmax(score))
        gained = gained + gains[:, best]
        picked.append(best)
        course.append(float(gained.min()))
        for one, other in pairs:
            one.pick(best)
            other.pick(best)
    return picked, course


def _gains(one: _Duel, other: _Duel) -> Array:
    """What each pose adds to the expected log Bayes factor in favour of the truth, shape (2, K).

    First where the truth is the other's model, then where it is the one's own: Kullback and Leibler's divergences.
    """
    half = 0.5 * (one.volume() - other.volume())
    return np.stack([0.5 * (one.distance() - 3) + half, 0.5 * (other.distance() - 3) - half])


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
