"""The engine that judges causes of a joint log: linear Gaussian rows, whose noise each joint has.

Rows are residuals of torques, and of positions in a simulated replay or by the servo's equation.
They are linear in the parameters of a base, which every arm has, and in those of the causes. The
base has a Gaussian prior: wide without a reference; else the reference's posterior, widened by the
changes from day to day. The noise variance of each joint is unknown, with an inverse-gamma prior;
evidences are computed from Gram matrices with it at its maximum (Student's t), separately for each
hypothesis, so that a cause is not taken for noise.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import gammaln

from casadical.core.basics import Array
from casadical.core.linear_gaussian.marginals import NO_COLUMNS
from casadical.core.linear_gaussian.noise import log_gain_by_size
from casadical.core.linear_gaussian.search import Posterior, stepwise
from casadical.core.statistics import first_of_best, ranked
from casadical.diagnosis.candidates import Candidate
from casadical.diagnosis.evidence import KAPPA_GRID, KAPPA_WEIGHTS
from casadical.diagnosis.motion.view import LogView, Signals
from casadical.diagnosis.posterior import PRIOR_FIRST, PRIOR_FURTHER, prior_weights
from casadical.diagnosis.settings import SETTINGS

# Samples of torques and positions that count as independent in a second, as noise is correlated.
INDEPENDENT_SAMPLES_PER_S = {"torque": 8.0, "position": 3.0}
NOISE_FREEDOM = 20.0  # degrees of freedom of the prior of a joint's noise variance
MIN_SPAN_RAD = 0.2  # a joint that moves less carries no information on its response [rad]
# Causes that never count as fitting: on logs on which the rule was learnt they stood for errors of
# the base.
DOUBTFUL_CAUSES = frozenset(["play", "link_mass"])
# Number of Gaussian bumps of a smooth function, which stands for a cause on no list, by variable.
BUMPS_OF = {"angle": 28, "angle and direction": 20, "angle, one way": 20, "angle, other way": 20}
BUMPS_OF |= {"speed": 14, "load": 10, "time": 28}


@dataclass(frozen=True, eq=False)
class Rows:
    """Residuals of one joint, torques or positions, with their derivatives by the base.

    kind : "torque" or "position"; joint : 0-based; used : mask of the samples, shape (samples,)
    r : residual with all parameters zero, shape (rows,), divided by the peak torque, or [rad]
    J : derivatives, shape (rows, k); own : indices of the base's parameters that they belong to
    sigma : typical standard deviation of the noise
    fold : number of each row's run, or of its third of a single run, shape (rows,)
    rate : rows per second
    H : columns of causes in single precision, shape (rows, m); columns : their indices, rising
    """

    kind: str
    joint: int
    used: Array
    r: Array
    J: Array
    own: Array
    sigma: float
    fold: Array
    rate: float
    H: Array = field(default_factory=lambda: np.zeros((0, 0)))
    columns: Array = field(default_factory=lambda: NO_COLUMNS)

    @property
    def share(self) -> float:
        """Return the fraction of the rows that count as independent."""
        return min(1.0, INDEPENDENT_SAMPLES_PER_S[self.kind] / self.rate)

    @cached_property
    def grams(self) -> tuple[Array, Array, float]:
        """Return J^T J, J^T r and r^T r, each times `share`."""
        return self.share * self.J.T @ self.J, self.share * self.J.T @ self.r, self.share * float(self.r @ self.r)

    @cached_property
    def cause_grams(self) -> tuple[Array, Array]:
        """Return J^T H and H^T r, each times `share`."""
        return self.share * self.J.T @ self.H, self.share * self.H.T @ self.r

    def among(self, rows: Array) -> Rows:
        """Return the rows of a mask, shape (rows,), without columns of causes."""
        return replace(
            self, r=self.r[rows], J=self.J[rows], fold=self.fold[rows], H=np.zeros((0, 0)), columns=NO_COLUMNS
        )

    def with_causes(self, columns: Array, first: int) -> Rows:
        """Return the rows with columns of causes in the base, whose parameters begin at `first`."""
        here = np.flatnonzero(np.isin(self.columns, columns))
        if not len(here):
            return self
        own = np.concatenate([self.own, first + np.searchsorted(columns, self.columns[here])])
        return replace(self, J=np.hstack([self.J, self.H[:, here]]), own=own)


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters of highest posterior density, and the evidence.

    x : parameters; precision : inverse of their covariance; variance : noise variance of each of
        the rows' groups; log_evidence : log marginal likelihood, up to a constant
    """

    x: Array
    precision: Array
    variance: Array
    log_evidence: float


@dataclass(frozen=True, eq=False)
class LogProblem:
    """Base and candidate causes of a joint log.

    rows : groups of rows; mean, covariance : prior of the base's parameters, shapes (P,), (P, P)
    candidates : possible causes; groups : indices of the columns of each candidate's variants, by
        label and index of the variant
    masks : indices of the columns that are zero but in rows whose noise is another with the cause
    names : kind, joint (0-based, as text, "" for none) and name of each parameter of the base
    """

    rows: tuple[Rows, ...]
    mean: Array
    covariance: Array
    names: tuple[tuple[str, ...], ...] = ()
    candidates: tuple[Candidate, ...] = ()
    groups: Mapping[tuple[str, int], Array] = field(default_factory=dict)
    masks: frozenset[int] = frozenset()

    @cached_property
    def by_label(self) -> dict[str, Candidate]:
        """Return the candidates by label."""
        return {c.label: c for c in self.candidates}

    def with_causes(self, columns: Array, scale: float = 1.0) -> LogProblem:
        """Return the problem with columns of causes in the base.

        columns : their indices, rising; scale : prior standard deviation of their parameters
        """
        P, q = len(self.mean), len(columns)
        covariance = np.zeros((P + q, P + q))
        covariance[:P, :P], covariance[P:, P:] = self.covariance, scale**2 * np.eye(q)
        rows = []
        for r in self.rows:
            own, masks = r.with_causes(columns, P), np.isin(r.columns, [*self.masks & {*columns}])
            inside = (r.H[:, masks] != 0).any(axis=1)
            parts = (inside, ~inside) if masks.any() else ()
            rows += [replace(own.among(k), H=own.H[k], columns=own.columns) for k in parts] or [own]
        mean = np.append(self.mean, np.zeros(q))
        return replace(self, rows=tuple(rows), mean=mean, covariance=covariance)

    def given(self, found: Iterable[Found]) -> LogProblem:
        """Return the problem with causes that were found in its base."""
        groups = [self.groups[f.label, f.variant] for f in found]
        return self.with_causes(np.sort(np.concatenate(groups))) if groups else self

    @cached_property
    def prior_precision(self) -> Array:
        """Return the inverse of the prior covariance, shape (P, P)."""
        return np.asarray(np.linalg.inv(self.covariance))

    @cached_property
    def fit(self) -> Fit:
        """Return the fit of the base."""
        prior, variance = self.prior_precision, np.array([r.sigma**2 for r in self.rows])
        count = np.array([NOISE_FREEDOM + r.share * len(r.r) for r in self.rows])
        # Parameters and noise are estimated in turn, five times.
        for _ in range(5):
            A, b = prior.copy(), prior @ self.mean
            for r, s2 in zip(self.rows, variance, strict=True):
                A[np.ix_(r.own, r.own)] += r.grams[0] / s2
                b[r.own] += r.grams[1] / s2
            x = np.linalg.solve(A, b)
            squares = [q - 2 * x[r.own] @ g + x[r.own] @ G @ x[r.own] for r in self.rows for G, g, q in [r.grams]]
            own = np.array([NOISE_FREEDOM * r.sigma**2 for r in self.rows])
            variance = (own + np.maximum(squares, 0.0)) / count
        aside = x - self.mean
        noise = count @ np.log(count * variance) - NOISE_FREEDOM * np.log(own).sum()
        noise += 2 * (gammaln(NOISE_FREEDOM / 2) - gammaln(count / 2)).sum()
        rest = aside @ prior @ aside + np.linalg.slogdet(A)[1] - np.linalg.slogdet(prior)[1]
        return Fit(x, A, variance, -0.5 * float(noise + rest))

    def residuals(self, x: Array) -> list[Array]:
        """Return the residuals of each group of rows for given parameters of the base."""
        return [r.r - r.J @ x[r.own] for r in self.rows]

    def held_out(self) -> list[Array]:
        """Return the residuals of each group of rows, of each run by a fit to the others.

        Thirds take the place of runs if there is one run.
        """
        out = [np.array(r.r) for r in self.rows]
        for k in np.unique(np.concatenate([r.fold for r in self.rows])):
            x = replace(self, rows=tuple(r.among(r.fold != k) for r in self.rows)).fit.x
            for r, residual in zip(self.rows, out, strict=True):
                residual[r.fold == k] = (r.r - r.J @ x[r.own])[r.fold == k]
        return out

    def _screened(self) -> dict[tuple[str, int], Array]:
        """Return the log evidence [nats] of each of `groups` by prior size, shape (kappas,)."""
        fit, total = self.fit, sum(map(len, self.groups.values()))
        both, right = np.zeros((len(self.mean), total)), np.zeros(total)
        for r, s2 in zip(self.rows, fit.variance, strict=True):
            if len(r.columns):
                cross, own = r.cause_grams
                both[np.ix_(r.own, r.columns)] += cross / s2
                right[r.columns] += (own - cross.T @ fit.x[r.own]) / s2
        absorbed = np.linalg.solve(np.linalg.cholesky(fit.precision), both)
        out = {}
        for key, group in self.groups.items():
            S = -absorbed[:, group].T @ absorbed[:, group]
            for r, s2 in zip(self.rows, fit.variance, strict=True):
                low, high = np.searchsorted(r.columns, [group[0], group[-1] + 1])
                if high > low:
                    at, H = r.columns[low:high] - group[0], r.H[:, low:high].astype(float)
                    S[np.ix_(at, at)] += r.share * H.T @ H / s2
            out[key] = log_gain_by_size(S[None], right[None, group], KAPPA_GRID)[0]
        return out

    def rank(self, skip: frozenset[str] = frozenset()) -> Posterior:
        """Return the posterior over the next cause.

        skip : labels of the causes that are in the base already
        """
        prior = PRIOR_FURTHER if skip else PRIOR_FIRST
        given = prior_weights(self.candidates, prior, skip), prior["none"]
        by_kappa = self._screened()
        log_weights = np.log(KAPPA_WEIGHTS)
        logs = {k: float(np.logaddexp.reduce(own + log_weights)) for k, own in by_kappa.items()}
        first = Posterior.of_variants(logs, *given)
        ordered = [list(first.log_factor)[k] for k in ranked(list(first.log_factor.values()))]
        # The noise of the best twelve listed candidates is estimated again.
        listed = [label for label in ordered if self.by_label[label].listed][:12]
        unlisted = [k for k in ordered if not self.by_label[k].listed]
        tried = {(label, first.variant[label]) for label in (*listed, *unlisted[:3])}
        # What a noise of some rows explains, their columns do not show.
        masked = {key for key, group in self.groups.items() if self.masks.issuperset(group)}
        for key in [k for k in self.groups if k in tried | masked]:
            at = first_of_best(by_kappa[key] + log_weights, logs=True)
            problem = self.with_causes(self.groups[key], KAPPA_GRID[-1 if key in masked else at])
            gain = problem.fit.log_evidence - self.fit.log_evidence
            alike = [k for k in logs if k[0] == key[0]]
            if key not in masked:
                logs |= {k: logs[k] + gain - float(by_kappa[key].max()) for k in alike}
            elif gain > np.logaddexp.reduce([logs[k] for k in alike]):
                logs |= {**dict.fromkeys(alike, -np.inf), key: gain}
        return Posterior.of_variants(logs, *given)


@dataclass(frozen=True)
class Found:
    """A cause in the model.

    label : label of the candidate; listed : whether it is listed
    ranking : posterior over the next cause from which it was taken
    probability : posterior of it and its twins, given that there is a cause, listed or not
    twins : labels of causes that these data do not distinguish from it, itself first
    rival : log evidence of the best unlisted cause, of a smooth function `Settings.smooth_share`
        of it [nats]
    usual : whether it is no larger than in a healthy arm
    """

    ranking: Posterior
    label: str
    listed: bool
    probability: float
    twins: tuple[str, ...]
    rival: float
    usual: bool = False

    @property
    def variant(self) -> int:
        """Return the index of the candidate's most likely variant."""
        return self.ranking.variant[self.label]

    @property
    def gain(self) -> float:
        """Return the log evidence [nats]."""
        return self.ranking.log_factor[self.label]

    @property
    def fits(self) -> bool:
        """Return whether it fits: listed, not doubtful or usual, with enough evidence and probability."""
        name = self.label.partition("@")[0]
        # Smallest posterior of a cause that fits, in sum with its twins.
        return (
            self.listed
            and name not in DOUBTFUL_CAUSES
            and not self.usual
            and self.gain >= max(SETTINGS.min_log_evidence["torque"], self.rival)
            and self.gain >= SETTINGS.healthy_margin * SETTINGS.healthy_log_evidence.get(name, 0.0)
            and self.probability >= 0.95
        )


# Pairs of effects that one log may not distinguish; those without masses only at the same joint.
TWIN_EFFECTS = ({"transport_delay", "lag"}, {"payload", "link_mass"}, {"servo_stiffness", "torque_constant"})


def joint_of(label: str) -> str:
    """Return the number of the joint in a candidate's label, "" without one."""
    return label.partition("@")[2] or label.partition(" of joint ")[2].partition(" ")[0]


def twins_of(label: str, ranking: Posterior) -> tuple[str, ...]:
    """Return a cause's label and those of its `TWIN_EFFECTS` at most 5 nats below its evidence."""
    name, _, joint = label.partition("@")
    near = [k for k in ranking.order if ranking.log_factor[k] > ranking.log_factor[label] - 5.0 and k != label]
    alike = [k for k in near if any({name, k.partition("@")[0]} <= pair for pair in TWIN_EFFECTS)]
    return label, *(k for k in alike if name in ("payload", "link_mass") or k.partition("@")[2] in ("", joint))


def search(problem: LogProblem) -> tuple[tuple[Found, ...], tuple[Posterior, ...]]:
    """Return the causes of a log, added one by one until no additional one is detected.

    The second item is the posterior over the next cause in each step.
    It also ends below `Settings.min_log_evidence`, after a second unlisted or a third cause.
    """
    least = min(SETTINGS.min_log_evidence[r.kind] for r in problem.rows)

    def next_given(found: Sequence[Found]) -> Found:
        """Return the most probable cause in addition to some."""
        best = next_cause(problem, problem.given(found).rank(frozenset(f.label for f in found)))
        return replace(best, usual=is_usual_ripple(problem, best))

    def is_cause(best: Found, found: Sequence[Found]) -> bool:
        """Return whether a cause is added to some."""
        # A cause is detected if the posterior of no cause is at most 0.02.
        detected = best.ranking.none <= 0.02 and best.gain >= least
        return detected and sum(not f.listed for f in found) < 2

    found, last = stepwise(next_given, is_cause, 3)
    return tuple(found), tuple(f.ranking for f in (*found, last))


def is_usual_ripple(problem: LogProblem, found: Found) -> bool:
    """Return whether a cause is a ripple with an amplitude of at most `Settings.usual_ripple_share`.

    Without torques it is unknown, and False is returned.
    """
    name, _, joint = found.label.partition("@")
    rows = [r for r in problem.rows if r.kind == "torque" and str(r.joint + 1) == joint]
    if name != "ripple" or not rows:
        return False
    columns = problem.groups[found.label, found.variant]
    x, here = problem.with_causes(columns).fit.x, np.isin(rows[0].columns, columns)
    amplitude = np.sqrt(2) * (rows[0].H[:, here] @ x[len(problem.mean) :]).std()
    dry = abs(x[problem.names.index(("torque", str(rows[0].joint), "slip"))])
    return bool(amplitude < SETTINGS.usual_ripple_share * dry)


def next_cause(problem: LogProblem, ranking: Posterior) -> Found:
    """Return the most probable listed cause with its twins, or the unlisted one if that is more probable.

    Unlisted causes have the prior odds `Settings.unlisted_odds`, a quarter for rivals by name, the
    rest for smooth functions, of whose largest evidence `Settings.smooth_share` counts.
    """
    listed = [k for k in ranking.order if problem.by_label[k].listed]
    mass = {}  # log evidence of each unlisted cause that counts, with its prior
    for k, factor in ranking.log_factor.items():
        if not (candidate := problem.by_label[k]).listed:
            smooth = candidate.name == "unknown"
            counts = SETTINGS.smooth_share * factor if smooth and factor > 0 else factor
            mass[k] = counts + float(np.log(SETTINGS.unlisted_odds * (0.75 if smooth else 0.25)))
    top, twins = listed[0], twins_of(listed[0], ranking)
    best = list(mass)[first_of_best(list(mass.values()), logs=True)] if mass else top
    kinds = {problem.by_label[k].name == "unknown": v for k, v in sorted(mass.items(), key=lambda item: item[1])}
    logs = np.array([*(ranking.log_factor[k] for k in listed), *kinds.values()])
    p = np.exp(logs - np.logaddexp.reduce(logs))
    own, other = sum(float(p[listed.index(k)]) for k in twins), float(p[len(listed) :].sum())
    if other > own:
        return Found(ranking, best, False, other, (best,), mass[best])
    return Found(ranking, top, True, min(1.0, own), twins, max(mass.get(best, 0.0), 0.0))


def smooth_functions(view: LogView, rows: Iterable[Rows], variance: Array) -> Iterator[tuple[Candidate, list[Signals]]]:
    """Yield candidates for causes on no list: smooth functions of one variable for some rows.

    variance : noise variance of each of the groups of rows
    """
    m = view.motion
    for r, s2 in zip(rows, variance, strict=True):
        j, v = r.joint, m.v[:, r.joint]
        drivers = {name: m.q[:, j] for name in BUMPS_OF if name.startswith("angle")}
        drivers |= {"speed": v, "load": view.variables["load"][:, j], "time": m.time}
        for name, values in drivers.items():
            ends = np.quantile(values[r.used], [0.005, 0.995]) if r.used.any() else np.zeros(2)
            if ends[1] - ends[0] < 1e-6 or np.ptp(m.q[:, j]) < MIN_SPAN_RAD:
                continue
            centres = np.linspace(ends[0], ends[1], BUMPS_OF[name])
            ways = {"angle and direction": np.sign(v), "angle, one way": v > 0, "angle, other way": v < 0}
            # Typical size of a bump in units of the row's noise.
            size = 2.0 * np.sqrt(s2) * ways.get(name, 1.0)
            width = centres[1] - centres[0]
            label = f"smooth {r.kind} of joint {j + 1} by {name}"
            bumps: list[Signals] = [{(r.kind, j): size * np.exp(-0.5 * ((values - c) / width) ** 2)} for c in centres]
            yield Candidate(label, "unknown", None, ((),), listed=False), bumps


def with_candidates(problem: LogProblem, made: Iterable[tuple[Candidate, list[Signals]]]) -> LogProblem:
    """Return the problem with candidates.

    made : variants of candidates, with the columns of their parameters at all samples, if any
    """
    candidates: dict[str, Candidate] = {}
    groups, width = dict[tuple[str, int], Array](), 0
    used: dict[tuple[str, int], Array] = {(r.kind, r.joint): r.used for r in problem.rows}
    columns: dict[tuple[str, int], list[tuple[int, Array]]] = {key: [] for key in used}
    for candidate, signals in made:
        if not signals:
            continue
        merged = candidates.setdefault(candidate.label, replace(candidate, variants=()))
        groups[candidate.label, len(merged.variants)] = width + np.arange(len(signals))
        candidates[candidate.label] = replace(merged, variants=(*merged.variants, *candidate.variants))
        for signal in signals:
            for key, values in signal.items():
                if key in columns:
                    columns[key].append((width, values[used[key]].astype(np.float32)))
            width += 1
    rows = []
    for r in problem.rows:
        own = columns.pop((r.kind, r.joint))
        H = np.stack([v for _, v in own], axis=1) if own else np.zeros((len(r.r), 0))
        rows.append(replace(r, H=H, columns=np.array([k for k, _ in own], dtype=np.int64)))
    return replace(problem, rows=tuple(rows), candidates=tuple(candidates.values()), groups=groups)
