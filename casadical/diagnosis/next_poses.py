"""Design of experiments: next poses at which rival causes predict different positions.

Each cause's prediction at a new pose is normal: base model and cause are fitted to the present
data, with the posterior covariance of that fit. Poses are added one by one where they most increase
the expected log Bayes factor in favour of the truth, whichever of the causes that is: the
divergence of one cause's data from the other's prediction, given the data at the poses chosen
before (Box and Hill 1967; T-optimality of Atkinson and Fedorov 1975 if the base model is well
determined). The truth with the smallest factor so far has the largest weight.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from math import log, sqrt
from typing import NamedTuple

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.noise import covariance_of
from casadical.core.linear_gaussian.search import log_factors
from casadical.core.statistics import best_of, first_of_best
from casadical.diagnosis.cross_validation import likely_noise, new_fit
from casadical.diagnosis.evidence import KAPPA_WEIGHTS
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import Linearisation, linearise
from casadical.diagnosis.result import Diagnosis
from casadical.effects import Effect
from casadical.identification.pose_selection.candidates import campaign_payloads, later_poses
from casadical.identification.pose_selection.workspace import Workspace
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements, Noise, unmeasured


def predict_cause(case: Case, variant: tuple[Effect, ...], noise: Noise, poses: Linearisation) -> tuple[Array, Array]:
    """Return the prediction at K new poses of base model and one cause fitted to the case's data.

    It is the predicted residual, shape (K, 3) [m], and a root of its covariance root @ root.T,
    shape (K, 3, parameters) [m].
    variant : effects of the cause; poses : linearisation of the base model at the new poses
    """
    old, combinations = case.base.with_all_combinations(case.evidence, np.flatnonzero(case.inliers))
    E = poses.columns(variant)
    # Predictions do not depend on the campaign's unknown points.
    points = np.zeros((*poses.J.shape[:2], len(case.base.prior) - poses.J.shape[2]))
    J = np.concatenate([poses.J, points], axis=2)
    for units in (case.units, combinations):
        J = J if units is None else J @ units
    new = np.concatenate([J, E * [size for e in variant for size, _ in e.sizes().values()]], axis=2)
    # The prior standard deviation of a cause's parameters is two sizes.
    fit = new_fit(replace(old, cause_prior=np.full(old.width, 2.0)), case.group(variant), noise, combined=False)
    return new @ fit.x, new @ fit.root.T


class Predictive:
    """A cause's predictive distribution at K poses, updated with future data at chosen poses.

    mean, root : prediction before these data (see `predict_cause`)
    noise : covariance of the noise at each pose, shape (K, 3, 3) [m^2]
    own : covariance of the data at each pose, given those chosen so far, shape (K, 3, 3) [m^2]
    inverse, volume : inverse of `own`, shape (K, 3, 3), and its log determinant, shape (K,)
    """

    def __init__(self, mean: Array, root: Array, noise: Array) -> None:
        self.mean, self.root, self.noise = mean, root, noise
        self._covariance: Array = np.eye(root.shape[2])
        self._set(root @ root.transpose(0, 2, 1) + noise)

    def _set(self, own: Array) -> None:
        """Store the covariance of the data, its inverse and its log determinant."""
        self.own, self.inverse = own, np.linalg.inv(own)
        self.volume: Array = np.linalg.slogdet(own)[1]

    def learn(self, pose: int) -> Array:
        """Condition the prediction on data at a pose (index); return the Kalman gain, (K, 3, 3)."""
        toward = self._covariance @ self.root[pose].T
        gain = np.asarray((self.root.reshape(-1, len(toward)) @ toward).reshape(-1, 3, 3) @ self.inverse[pose])
        self._covariance = self._covariance - toward @ self.inverse[pose] @ toward.T
        self._set(self.own - gain @ self.own[pose] @ gain.transpose(0, 2, 1))
        return gain


class Comparison:
    """Difference at K poses between the data that a true cause generates and a model's prediction.

    mean : expected difference, shape (K, 3) [m]
    root : root of its covariance without the pose's own noise, shape (K, 3, any) [m]
    """

    def __init__(self, model: Predictive, truth: Predictive) -> None:
        self.model, self.truth = model, truth
        self.mean: Array = truth.mean - model.mean
        self.root: Array = truth.root

    def gains(self) -> Array:
        """Return the increase of the expected log Bayes factor for the truth by each pose, (K,)."""
        square = self.model.noise + self.root @ self.root.transpose(0, 2, 1)
        square += self.mean[:, :, None] * self.mean[:, None, :]
        far = (self.model.inverse * square).sum(axis=(1, 2)) - 3
        return np.asarray(0.5 * (far + self.model.volume - self.truth.volume))

    def follow(self, pose: int, gain: Array) -> None:
        """Update this difference for a model that was conditioned on data at a pose.

        pose : index of the pose; gain : Kalman gain of the update, shape (K, 3, 3)
        """
        own = np.linalg.cholesky(self.model.noise[pose])
        self.mean = self.mean - gain @ self.mean[pose]
        self.root = np.concatenate([self.root - gain @ self.root[pose], -gain @ own], axis=2)


# Pairs of causes to distinguish, by their predictive distributions.
Pairs = Sequence[tuple[Predictive, Predictive]]


def choose_poses(asked: Pairs, also: Pairs, n: int) -> tuple[list[int], list[float]]:
    """Return the indices of n poses chosen greedily, and the separation after each [nats].

    The separation is the cumulative expected log Bayes factor for the true cause, the smallest over
    the causes that may be true.
    asked, also : pairs of causes to distinguish; only the former count in the separation
    """
    pairs = [*asked, *also]
    comparisons = [d for a, b in pairs for d in (Comparison(a, b), Comparison(b, a))]
    models = list(dict.fromkeys(m for pair in pairs for m in pair))
    picked, course, gained = list[int](), list[float](), np.zeros(len(comparisons))
    for _ in range(n):
        gains = np.stack([d.gains() for d in comparisons])
        # The truth with the smallest sum so far has the largest weight.
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


# Label that stands for no cause at all among the causes to distinguish.
NO_CAUSE = "none"


def next_poses(
    found: Diagnosis | Case,
    n: int,
    labels: Sequence[str] = (),
    seed: int = 0,
    *,
    against: Sequence[str] | None = None,
    workspace: Workspace | None = None,
    payloads: Sequence[float] = (),
    pool: int = 800,
) -> pd.DataFrame:
    """Return a table of the next n poses to measure (at most those drawn), most informative first.

    Columns: order; q1_deg ...; payload_kg and approach1 ... where they matter; repeats, the row of
    the campaign that the pose repeats, if any; state, cold or warm, where a cause depends on the
    temperature; new, what the campaign did not contain (a wider range of a joint, another payload,
    approach or thermal state); separation, the expected log Bayes factor in favour of the truth
    among the labels, by this pose and those before it, the smallest over all truths; and, empty,
    the columns to be logged, including those of the campaign's own kinds of measurement.
    found : a diagnosis, or the case of one; n : number of poses to choose
    labels : labels of the causes to distinguish; "none" for no cause at all; by default those that
        the diagnosis has in question (`Diagnosis.in_question`); an empty table if it has none
    seed : seed of the drawn poses
    against : other labels from which each of these is to be distinguished as well, but not from each
        other; by default "none", and with the default labels the most probable other cause
    workspace : region of the poses; by default the robot's ranges, loops open as in the campaign
    payloads : masses [kg] that can be mounted; by default none, the declared one and the campaign's
    pool : number of poses that are drawn to choose from; the campaign's own are added
    Raises InputError: fewer than two labels or one that the case does not know.

    Examples
    --------
    >>> rivals = ["gear_eccentricity@1", "gear_eccentricity@2"]
    >>> casadical.next_poses(diagnosis, 3, rivals, pool=40)[["order", "q1_deg", "q2_deg"]].shape
    (3, 3)
    """
    case = found.case if isinstance(found, Diagnosis) else found
    others: tuple[str, ...] = ()
    if isinstance(found, Diagnosis) and not labels:
        labels = found.in_question
        if len(labels) < 2:
            return pd.DataFrame()
        candidate_labels = {c.label for c in case.candidates}
        others = tuple(k for k in found.rankings[-1].order if k in candidate_labels and k not in labels)[:1]
    causes = causes_in_question(case, labels, (NO_CAUSE, *others) if against is None else against)
    noise = causes[0].noise
    effects = tuple(dict.fromkeys(e for cause in causes for e in cause.variant))
    columns = dict.fromkeys((*case.robot.conditions, *(c for e in effects for c in e.conditions)))
    drawn, repeated, warm = later_poses(case.robot, case.m, case.inliers, columns, pool, seed, workspace, payloads)
    poses = linearise(case.given, drawn, case.values)
    noise_there = covariance_of(poses.Jq, noise.repeatability, noise.sigma)
    models = [(c.label, Predictive(*predict_cause(case, c.variant, noise, poses), noise_there)) for c in causes]
    rivals = [(a in labels, b in labels, p, r) for (a, p), (b, r) in combinations(models, 2) if a != b]
    asked = [(p, r) for first, second, p, r in rivals if first and second]
    also = [(p, r) for first, second, p, r in rivals if first != second]
    picked, gained = choose_poses(asked, also, min(n, len(drawn)))
    chosen = np.array(picked, dtype=np.int64)
    states = None if warm is None else warm[chosen]
    return table_of(case, effects, drawn[chosen], repeated[chosen], states, gained)


class _Cause(NamedTuple):
    """A cause to distinguish, with settings that are likely in the data.

    label : label of the candidate; variant : its effects with these settings
    noise : most likely noise with these effects in the model
    """

    label: str
    variant: tuple[Effect, ...]
    noise: Noise


def causes_in_question(case: Case, labels: Sequence[str], against: Sequence[str] = ()) -> list[_Cause]:
    """Return the causes of some labels, each with its most likely and up to two other settings.

    The others are likely, too; each setting is an item, that with the least noise first.
    labels : causes to distinguish, two or more; `NO_CAUSE` for none
    against : other labels, with their most likely settings only
    Raises InputError: fewer than two labels, or one that is no candidate.
    """
    if len(set(labels)) < 2:
        raise InputError(f"causes {list(labels)}; give two or more to distinguish")
    by_label = {c.label: c for c in case.candidates}
    causes: list[_Cause] = []
    for label in dict.fromkeys((*labels, *against)):
        if label == NO_CAUSE:
            causes.append(_Cause(NO_CAUSE, (), likely_noise(case.evidence.log_base(), case.evidence.sigmas)))
            continue
        if label not in by_label:
            raise InputError(f"cause {label!r} is no candidate of this case; there are none, {', '.join(by_label)}")
        variants = by_label[label].variants
        own = case.evidence.log_grids([case.group(v) for v in variants])
        likely, grids = log_factors(own, case.evidence.log_base(), KAPPA_WEIGHTS)
        # Settings less likely than the best ones by 4 nats are not compared.
        allowed = np.flatnonzero(likely > likely.max() - 4.0)
        # Two settings are compared in addition to the most likely ones.
        spread = allowed[np.linspace(0, len(allowed) - 1, 2).astype(int)]
        others = spread.tolist() if label in labels else []
        for k in dict.fromkeys([first_of_best(likely, logs=True), *others]):
            causes.append(_Cause(label, variants[k], likely_noise(grids[k], case.evidence.sigmas)))
    # The cause that leaves the least noise comes first, because its noise is used for all.
    return sorted(causes, key=lambda cause: cause.noise.sigma)


def table_of(
    case: Case,
    effects: tuple[Effect, ...],
    rows: Measurements,
    repeated: Array,
    warm: Array | None,
    gained: list[float],
) -> pd.DataFrame:
    """Return the table of the chosen poses (see `next_poses`).

    effects : effects of the causes to distinguish
    rows, repeated, warm : of the chosen poses, as of `later_poses`
    gained : separation after each [nats]
    """
    table = pd.DataFrame({"order": np.arange(1, len(rows) + 1)})
    for (name, unit), q in zip(case.robot.reading_units.items(), case.robot.readings_of(rows.q).T, strict=True):
        table[name] = np.round(q / unit, 4)
    needed = {c for e in effects for c in e.conditions}
    if "payload_kg" in rows.conditions:
        table["payload_kg"] = rows.conditions["payload_kg"]
    for name in sorted(c for c in needed if c.startswith("approach")):
        table[name] = rows.conditions[name].astype(int)
    if warm is not None:
        table["state"] = np.where(warm, "warm", "cold")
    table["repeats"] = [f"row {case.m.row[k]}" if k >= 0 else "" for k in repeated]
    table["new"] = _new(case, rows)
    table["separation"] = np.round(gained, 3)
    sets = (case.m,) if case.observations.plain else case.observations.sets
    for name in dict.fromkeys(("time_s", "temperature_degC", *(c for m in sets for c in find_kind(m.kind).fill))):
        table[name] = np.nan
    return table


def _new(case: Case, rows: Measurements) -> list[str]:
    """Return a text for each chosen pose of what the campaign did not contain; "" for nothing."""
    own = case.m.conditions
    # Readings beyond the campaign's range by less than this are not new [rad or m].
    lower, upper = case.m.q.min(axis=0) - 0.02, case.m.q.max(axis=0) + 0.02
    payloads = campaign_payloads(case.robot, case.m)
    words = []
    for k in range(len(rows)):
        said = [f"q{j + 1}" for j in np.flatnonzero((rows.q[k] < lower) | (rows.q[k] > upper))]
        parts = [f"range of {' '.join(said)}"] if said else []
        for name, column in rows.conditions.items():
            value = float(column[k])
            if name == "payload_kg" and np.abs(payloads - value).min() > 1e-9:
                parts.append(f"payload {value:g} kg")
            if name.startswith("approach") and name in own and value not in own[name]:
                parts.append(f"{name} {value:+.0f}")
            if name.startswith("warmth_") and value > own[name].max() + 0.5:
                parts.append(f"arm warmed up by {value - own[name].min():.0f} K")
        words.append("; ".join(dict.fromkeys(parts)))
    return words


def discrimination_probability(found: Diagnosis, poses: pd.DataFrame) -> tuple[float, float]:
    """Return the probabilities of a right decision now and after measuring poses.

    The decision is between the first two causes in question. After these poses the log odds are
    normal about their expected gain D with variance 2 D, whichever cause is true.
    poses : table as of `next_poses`
    """
    first, second = found.in_question[:2]
    ranking = best_of(found.rankings, lambda r: r.probability.get(first, 0) + r.probability.get(second, 0))
    a, b = (max(ranking.probability.get(k, 0.0), 1e-12) for k in (first, second))
    share = a / (a + b)
    return probability_after(share, 0.0), probability_after(share, float(poses["separation"].iloc[-1]))


def probability_after(share: float, gain: float) -> float:
    """Return the probability of a right choice between two causes after more data.

    share : present probability of the first cause
    gain : expected log Bayes factor for the true cause by the data [nats]
    """
    from scipy.special import ndtr

    if gain <= 0:
        return max(share, 1 - share)
    odds, width = log(share / (1 - share)), sqrt(2 * gain)
    return float(share * ndtr((gain + odds) / width) + (1 - share) * ndtr((gain - odds) / width))


def kinds_of_poses(case: Case, poses: pd.DataFrame) -> str:
    """Return a text of how many poses repeat others, and by payload, approach, warmth, range, load.

    poses : table as of `next_poses`
    """
    kinds = []
    if repeats := int((poses["repeats"] != "").sum()):
        kinds.append(f"{repeats} repeat earlier ones in other circumstances")
    masses, counts = np.unique(poses.get("payload_kg", []), return_counts=True)
    if len(masses) > 1:
        kinds.append(", ".join(f"{n} with {mass:g} kg" for mass, n in zip(masses, counts, strict=True)))
    for name in (c for c in map(str, poses) if c.startswith("approach")):
        rising = int((poses[name] > 0).sum())
        kinds.append(f"joint {name[8:]} approached rising in {rising}, falling in {len(poses) - rising}")
    if "state" in poses:
        kinds.append(f"{int((poses['state'] == 'warm').sum())} warm, {int((poses['state'] == 'cold').sum())} cold")
    if wider := int(poses["new"].str.contains("range of").sum()):
        kinds.append(f"{wider} beyond the ranges so far")
    return "; ".join([*kinds, *_idle(case, poses)])


def _idle(case: Case, poses: pd.DataFrame) -> list[str]:
    """Return phrases on at most two joints near zero torque more often than in the campaign.

    Near zero is below 15 % of the peak gravity torque; more often is above twice the campaign's
    fraction of poses, or above it by 0.3.
    """
    units = case.given.reading_units
    q = case.given.variables_of(poses[[*units]].to_numpy() * [*units.values()])
    new = unmeasured(q, {"payload_kg": poses["payload_kg"].to_numpy()} if "payload_kg" in poses else {})
    idle, usual = ((np.abs(case.torques(m)) < 0.15 * case.given.torque_scale).mean(axis=0) for m in (new, case.m))
    more = np.flatnonzero(idle > np.minimum(2 * usual, usual + 0.3))
    return [f"{round(idle[j] * len(q))} with joint {j + 1} near zero torque" for j in more[:2]]
