"""What to measure next: poses at which the causes in question predict most unlike positions.

Each cause's prediction at a new pose is normal: fitted to the data there are, together with the base model, and as
uncertain as that fit leaves it. Poses are added one by one where they most increase the expected squared Mahalanobis
distance of one cause's data from the other's prediction, both ways (the symmetric form of Box and Hill 1967; where the
base is well known, T-optimality of Atkinson and Fedorov 1975).
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
from ..transforms import Array
from .case import Case, widths
from .evidence import CHOSEN, KAPPA_WEIGHTS, Evidence
from .gap import Noise, covariance, likely_noise
from .signatures import signatures

POOL = 1500
NONE = "none"


@dataclass(frozen=True, eq=False)
class _Prediction:
    """What one cause predicts at all poses of the pool.

    mean : shape (K, 3) [m]; spread : square root of its covariance, shape (K, 3, parameters): spread spread'
    """

    mean: Array
    spread: Array


@dataclass(frozen=True, eq=False)
class _Pool:
    """Poses to choose from; conditions hold every column that the causes need."""

    m: Measurements
    repeated: Array
    warm: Array | None


def next_poses(case: Case, labels: Sequence[str], n: int, seed: int = 0, *, pool: int = POOL) -> pd.DataFrame:
    """The next n poses to measure, the most telling first.

    labels : causes to tell apart, as the case's candidates name them; "none" for no cause at all
    pool : how many poses are drawn to choose from, within the ranges that the campaign used; its own are added

    Columns: order; q1_deg ...; payload_kg and approach1 ... where they matter; repeats, the row of the campaign that
    the pose repeats, if any; state, cold or warm, where a cause follows the temperature; separation, the expected
    log Bayes factor in favour of the truth, of this pose and those before it (least pair); and, empty, the columns to
    be logged. Raises InputError for fewer than two labels or one that the case does not know.
    """
    causes = _causes(case, labels)
    noise = causes[0][1]
    effects = tuple(dict.fromkeys(e for variant, _ in causes for e in variant))
    drawn = _draw(case, effects, pool, seed)
    predictions = [_predict(case, variant, noise, drawn.m) for variant, _ in causes]
    noise_there = _noise_at(case, noise, drawn.m)
    picked, gained = _pick(predictions, noise_there, min(n, len(drawn.m)))
    return _table(case, effects, drawn, picked, gained)


def _causes(case: Case, labels: Sequence[str]) -> list[tuple[tuple[Effect, ...], Noise]]:
    """Most likely settings of each cause, and the noise that it leaves."""
    if len(set(labels)) < 2:
        raise InputError(f"causes {list(labels)}; give two or more that are to be told apart")
    known = {c.label: c for c in case.candidates}
    found: list[tuple[tuple[Effect, ...], Noise]] = []
    for label in dict.fromkeys(labels):
        if label == NONE:
            found.append(((), likely_noise(case.evidence.log_base())))
            continue
        if label not in known:
            raise InputError(f"cause {label!r} is no candidate of this case; there are none, {', '.join(known)}")
        variants = known[label].variants
        grids = case.evidence.log_grids([case.group(v) for v in variants]) + np.log(KAPPA_WEIGHTS)
        best = int(np.argmax(grids.reshape(len(variants), -1).max(axis=1)))
        found.append((variants[best], likely_noise(grids[best])))
    # The cause that leaves the least noise comes first: its noise is taken for all.
    return sorted(found, key=lambda cause: cause[1].sigma)


def _draw(case: Case, effects: tuple[Effect, ...], pool: int, seed: int) -> _Pool:
    """Random poses within the campaign's ranges and loop margins, and the campaign's own, under every circumstance."""
    rng = np.random.default_rng(seed)
    own = case.m
    lower, upper = own.q.min(axis=0), own.q.max(axis=0)
    q = rng.uniform(lower, upper, (4 * pool, own.q.shape[1]))
    if case.robot.loops:
        margin = case.robot.model.at_declared("loop", ("margin",))
        values = case.robot.parameters.values
        least = margin.map(len(own))(own.q.T, values).full().min(axis=1)
        open_ = margin.map(len(q))(q.T, values).full()
        q = q[(open_ >= least[:, None]).all(axis=0)]
    q = q[:pool]
    repeated = np.concatenate([np.full(len(q), -1), np.flatnonzero(case.kept)])
    q = np.concatenate([q, own.q[case.kept]])
    conditions: dict[str, Array] = {}
    warm = rng.random(len(q)) < 0.5
    for name in dict.fromkeys((*case.robot.conditions, *(c for e in effects for c in e.conditions))):
        conditions[name] = _circumstance(case, name, len(q), warm, rng)
    if "payload_kg" not in conditions and "payload_kg" in own.conditions:
        conditions["payload_kg"] = rng.choice(np.unique(own.conditions["payload_kg"]), len(q))
    timed = any(c.startswith("warmth_") for c in conditions)
    m = Measurements(q=q, kind="position", position=np.zeros((len(q), 3)), conditions=conditions)
    return _Pool(m, repeated, warm if timed else None)


def _circumstance(case: Case, name: str, count: int, warm: Array, rng: np.random.Generator) -> Array:
    """A condition at the new poses: what can be chosen is drawn, what cannot is that of a later day."""
    logged = case.m.conditions.get(name)
    if name == "progress":
        return np.ones(count)
    if name.startswith("approach"):
        return rng.choice([-1.0, 1.0], count)
    if logged is None:
        payload = case.robot.payload
        return np.full(count, payload.mass if name == "payload_kg" and payload else 0.0)
    if name.startswith("warmth_"):
        return np.asarray(np.where(warm, logged.max(), logged.min()))
    return rng.choice(np.unique(logged), count)


def _predict(case: Case, variant: tuple[Effect, ...], noise: Noise, m: Measurements) -> _Prediction:
    """Mean and spread at new poses of base model and one cause fitted to the case's data."""
    old = case.evidence
    E, J, _ = signatures(case.given, variant, m, case.values)
    columns = case.group(variant) if variant else np.zeros(0, dtype=np.int64)
    A = np.concatenate([old.J, old.E[:, :, columns]], axis=2)
    new = np.concatenate([J, E * widths(variant)], axis=2)
    prior = np.concatenate([old.prior, np.full(len(columns), CHOSEN)])
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


def _pick(predictions: Sequence[_Prediction], noise: Array, n: int) -> tuple[list[int], list[float]]:
    """Greedy choice of n poses and what they separate, summed as they are added: the least of all pairs."""
    pairs = list(combinations(range(len(predictions)), 2))
    picked: list[int] = []
    gained = np.zeros(len(pairs))
    course = []
    for _ in range(n):
        gains = np.stack([_gain(predictions[a], predictions[b], noise, picked) for a, b in pairs])
        # The pair that is told apart least so far matters most.
        weight = 1 / (1 + gained)
        score = (weight[:, None] * gains).sum(axis=0)
        score[picked] = -np.inf
        best = int(np.argmax(score))
        gained = gained + gains[:, best]
        picked.append(best)
        course.append(float(gained.min()))
    return picked, course


def _gain(a: _Prediction, b: _Prediction, noise: Array, picked: list[int]) -> Array:
    """What each pose adds to the expected log Bayes factor (mean of both truths), given those picked, shape (K,)."""
    d = a.mean - b.mean
    return 0.25 * (_distance(a, b, d, noise, picked) + _distance(b, a, d, noise, picked))


def _distance(model: _Prediction, truth: _Prediction, d: Array, noise: Array, picked: list[int]) -> Array:
    """Expected squared Mahalanobis distance of the truth's data from the model's prediction, beyond the model's own."""
    own, other = ((p.spread @ p.spread.transpose(0, 2, 1)) + noise for p in (model, truth))
    miss = other + d[:, :, None] * d[:, None, :]
    if picked:
        X = 3 * len(picked)
        S = [_between(p, p.spread[picked].reshape(X, -1)) for p in (model, truth)]
        known = [_joint(p, noise, picked) for p in (model, truth)]
        far = d[picked].ravel()
        cross = S[1] + d[:, :, None] * far
        G = np.linalg.solve(known[0], S[0].transpose(0, 2, 1)).transpose(0, 2, 1)
        own = own - G @ S[0].transpose(0, 2, 1)
        turned = G @ cross.transpose(0, 2, 1)
        whole = known[1] + np.outer(far, far)
        miss = miss - turned - turned.transpose(0, 2, 1) + G @ whole @ G.transpose(0, 2, 1)
    return np.asarray(np.trace(np.linalg.solve(own, miss), axis1=1, axis2=2) - 3)


def _between(p: _Prediction, rows: Array) -> Array:
    """Covariance of all poses with those picked, shape (K, 3, X)."""
    return np.asarray(p.spread @ rows.T)


def _joint(p: _Prediction, noise: Array, picked: list[int]) -> Array:
    """Covariance of the picked poses' data, shape (X, X)."""
    rows = p.spread[picked].reshape(3 * len(picked), -1)
    S = rows @ rows.T
    for k, pose in enumerate(picked):
        S[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += noise[pose]
    return np.asarray(S)


def _table(
    case: Case, effects: tuple[Effect, ...], drawn: _Pool, picked: list[int], gained: list[float]
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
    table["separation"] = np.round(gained, 3)
    for name in ("time_s", "temperature_degC", "x_mm", "y_mm", "z_mm"):
        table[name] = np.nan
    return table
