"""How diagnoses of campaigns with a known answer are scored: figures, targets, theoretical limits.

Figures and intervals are those of the blind check (casadical.blind_check); limits are its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from casadical.blind_check import metrics
from casadical.blind_check.metrics import Estimate, quantile, share
from casadical.diagnosis.evidence import Evidence
from casadical.diagnosis.linear_problem import Case
from casadical.measurements.measurements import Noise

# Name, value, target, theoretical limit.
Row = tuple[str, Estimate, str, str]

FALSE_ALARMS = 0.01
KINDS = {"none": "none", "unlisted": "unlisted", "two": "several"}
# Labels on the standard list of a six-axis robot (library.standard_candidates).
CAUSES = 69
# A rival has at most so many numbers.
FEW = 6


@dataclass(frozen=True)
class Trial:
    """What was hidden and what was answered.

    truth : labels that a right answer names; hidden : what was there, in words
    visible : rms of a coordinate that the base model cannot absorb, over the true noise (instrument and joints)
    beside : the same of each of several effects beside the others
    rival : share of the visible squares that the nearest rival reproduces
    posterior : probability given to the first true cause; without_rivals : verdict without the rarer effects as rivals
    """

    part: str
    truth: tuple[str, ...]
    hidden: str
    poses: int
    visible: float
    beside: tuple[float, ...]
    rival: float
    verdict: str
    claims: tuple[str, ...]
    posterior: float
    alike: tuple[str, ...]
    predicted_shrink: float
    true_shrink: float
    without_rivals: str
    seconds: float

    @property
    def counted(self) -> metrics.Outcome:
        """The same as a trial of the blind check; signals are over all noise, and shrinks over the base model's gap."""
        return metrics.Outcome(
            name=self.hidden,
            robot="",
            kind=KINDS.get(self.part, "one"),
            poses=self.poses,
            missing=None,
            effects=tuple(word.partition("@")[0] for word in self.hidden.split(", ") if word),
            truth=self.truth,
            signal=self.visible,
            signals=self.beside or (self.visible,),
            verdict=self.verdict,
            named=self.claims,
            alike=(self.claims[0], *self.alike)[: metrics.SET_SIZE] if self.claims else (),
            probability=self.posterior,
            predicted=self.predicted_shrink,
            realised=self.true_shrink,
            before=1.0,
            after=1.0 - self.true_shrink,
        )


def whitened(e: Evidence, columns: np.ndarray, noise: Noise) -> np.ndarray:
    """The base model and some columns, shape (n, 3, columns), in the metric of the true noise."""
    return e.projection(noise.repeatability / noise.sigma).columns(columns)


def visible(e: Evidence, shift: np.ndarray, noise: Noise, beside: Sequence[np.ndarray] = ()) -> float:
    """Root mean square of a shift, shape (n, 3), in units of the noise, that base model and other shifts leave."""
    W = whitened(e, np.stack([shift, *beside], axis=2), noise)
    left = W[:, 0]
    if beside:
        Q, _ = np.linalg.qr(W[:, 1:])
        left = left - Q @ (Q.T @ left)
    return float(np.sqrt(left @ left / shift.size) / noise.sigma)


def near_rival(case: Case, shift: np.ndarray, noise: Noise, truth: str) -> float:
    """Largest share of a shift's visible squares in the span of a listed cause other than the truth.

    Causes of many numbers (curves of all joints, masses of all links) come near to everything and are left out.
    """
    e, k = case.evidence, case.kept
    W = whitened(e, np.concatenate([shift[k][:, :, None], e.take(np.arange(e.width))], axis=2), noise)
    s, E = W[:, 0] / max(np.linalg.norm(W[:, 0]), 1e-30), W[:, 1:]
    best = 0.0
    for (c, _), group in zip(case.variants, case.groups, strict=True):
        rival = case.candidates[c].listed and case.candidates[c].label != truth
        if rival and len(group) <= FEW:
            G = E[:, group].T @ E[:, group]
            b = E[:, group].T @ s
            best = max(best, float(b @ np.linalg.pinv(G, rcond=1e-9, hermitian=True) @ b))
    return best


def power(visible: float, poses: int, parameters: int = 3) -> float:
    """Of chi-square tests of every cause that know its signature and the noise, at the false alarms allowed in all."""
    edge = stats.chi2.ppf(1 - FALSE_ALARMS / CAUSES, parameters)
    return float(stats.ncx2.sf(edge, parameters, 3 * poses * visible**2))


def discrimination(t: Trial) -> tuple[float, float]:
    """Of a judge who knows the noise and both signatures and must tell the truth from its nearest rival alone: how
    often right, and mean probability given to the truth. The log odds are normal, of mean d/2 and variance d."""
    d = max(3 * t.poses * t.visible**2 * (1 - t.rival), 1e-9)
    z = stats.norm.ppf((np.arange(400) + 0.5) / 400)
    odds = d / 2 + np.sqrt(d) * z
    return float(np.mean(odds > 0)), float(np.mean(1 / (1 + np.exp(-np.clip(odds, -500, 500)))))


def table(parts: dict[str, list[Trial]]) -> str:
    """Figure, value, target, theoretical limit: a line each, and what was claimed wrongly."""
    rows: list[Row] = []
    for part, trials in parts.items():
        rows += _SCORES[part](trials) if trials else []
    lines = [f"{'figure':<52} {'value (95 % interval; of)':<42} {'target':<14} limit"]
    lines += [f"{a:<52} {b!s:<42} {c:<14} {d}" for a, b, c, d in rows]
    every = [t for trials in parts.values() for t in trials]
    lines += ["", f"{len(every)} synthetic campaigns; diagnosis, median: {np.median([t.seconds for t in every]):.2f} s"]
    return "\n".join([*lines, "", "Wrong claims:", *(_wrong(t) for t in every if t.counted.wrong_claims)])


def _wrong(t: Trial) -> str:
    wrong = ", ".join(t.counted.wrong_claims)
    return f"  {t.part:<9} {t.hidden or '-':<46} claimed {wrong}  (visible {t.visible:.2f})"


def _counted(trials: Sequence[Trial]) -> list[metrics.Outcome]:
    return [t.counted for t in trials]


def _limit(values: Sequence[float]) -> str:
    return f"{np.mean(values):.3f}"


def _detection(trials: Sequence[Trial]) -> list[Row]:
    at = trials[0].part
    # All of them were scaled to this signal.
    found = metrics.detection(_counted(trials), 0.0)
    limit = _limit([power(t.visible, t.poses) for t in trials])
    return [(f"detection, visible rms/noise {at[3:]}", found, {"at .5": ".99", "at .35": ".90"}[at], limit)]


def _nothing(trials: Sequence[Trial]) -> list[Row]:
    return [("false alarms; half the campaigns with outliers", metrics.false_alarms(_counted(trials)), "<= .01", "")]


def _isolation(trials: Sequence[Trial]) -> list[Row]:
    every = _counted(trials)
    seen, errors = metrics.detectable(every), metrics.shrink_errors(every)
    told = np.mean([discrimination(t) for t in trials if t.visible >= metrics.DETECTABLE], axis=0)
    n = f"{trials[0].poses} poses"
    return [
        (f"FIA: probability of the true cause, {n}", metrics.isolation(seen), ">= .92", _limit(told[1])),
        (
            f"first cause right, where one is named, {n}",
            share([t.first_right for t in every if t.named]),
            "",
            _limit(told[0]),
        ),
        (f"claims right, {n}", metrics.claims_right(every), ">= .98", ""),
        (f"claims made, {n}", metrics.claims_made(seen), ">= .65", ""),
        (f"sets contain the truth, {n}", metrics.sets_right(every), ".93 - .97", ""),
        (f"|predicted - true shrink|, median, {n}", quantile(errors, 0.5), "<= .04", ""),
        (f"|predicted - true shrink|, 90 %, {n}", quantile(errors, 0.9), "<= .12", ""),
    ]


def _foreign(trials: Sequence[Trial]) -> list[Row]:
    every = _counted(trials)
    without = share([t.without_rivals == "explained" for t in trials])
    return [
        ("on no standard list, claimed as standard", metrics.claims_made(every), "<= .02", ""),
        ("  of those visible", metrics.claims_made(metrics.detectable(every)), "", ""),
        ("  all, without the rarer effects as rivals", without, "", ""),
    ]


def _several(trials: Sequence[Trial]) -> list[Row]:
    every = _counted(trials)
    limit = _limit([power(v, t.poses) for t in trials for v in t.beside if v >= metrics.DETECTABLE])
    return [
        ("two at once: recall, visible beside the other", metrics.recall(every), ">= .93", limit),
        ("  of those of visible rms/noise >= .5", metrics.recall(every, metrics.STRONG), "", ""),
        ("two at once: precision", metrics.precision(every), ">= .90", ""),
    ]


_SCORES = {
    "one": _isolation,
    "none": _nothing,
    "unlisted": _foreign,
    "two": _several,
    "forty": _isolation,
    "at .5": _detection,
    "at .35": _detection,
}
