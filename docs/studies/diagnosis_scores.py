"""How diagnoses of campaigns with a known answer are scored: figures with intervals, targets, theoretical limits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from casadical.diagnosis.case import Case
from casadical.diagnosis.evidence import Evidence, Whitened
from casadical.diagnosis.gap import Noise

FALSE_ALARMS = 0.01
SEEN = 0.35
# Labels on the standard list of a six-axis robot (library.standard_candidates).
CAUSES = 67


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


def whitened(e: Evidence, columns: np.ndarray, noise: Noise) -> Whitened:
    """The base model and some columns, shape (n, 3, columns), in the metric of the true noise."""
    return Evidence(e.r, e.J, e.Jq, e.delta0, e.prior, columns).white(noise.repeatability / noise.sigma)


def visible(e: Evidence, shift: np.ndarray, noise: Noise, beside: Sequence[np.ndarray] = ()) -> float:
    """Root mean square of a shift, shape (n, 3), in units of the noise, that base model and other shifts leave."""
    W = whitened(e, np.stack([shift, *beside], axis=2), noise).E
    left = W[:, 0]
    if beside:
        Q, _ = np.linalg.qr(W[:, 1:])
        left = left - Q @ (Q.T @ left)
    return float(np.sqrt(left @ left / shift.size) / noise.sigma)


def near_rival(case: Case, shift: np.ndarray, noise: Noise, truth: str) -> float:
    """Largest share of a shift's visible squares in the span of a listed cause other than the truth."""
    e, k = case.evidence, case.kept
    W = whitened(e, np.concatenate([shift[k][:, :, None], e.E], axis=2), noise).E
    s, E = W[:, 0] / max(np.linalg.norm(W[:, 0]), 1e-30), W[:, 1:]
    best = 0.0
    for (c, _), group in zip(case.variants, case.groups, strict=True):
        if case.candidates[c].listed and case.candidates[c].label != truth:
            G = E[:, group].T @ E[:, group]
            b = E[:, group].T @ s
            best = max(best, float(b @ np.linalg.pinv(G, rcond=1e-9, hermitian=True) @ b))
    return best


def power(visible: float, poses: int, parameters: int = 3) -> float:
    """Of chi-square tests of every cause that know its signature and the noise, at the false alarms allowed in all."""
    edge = stats.chi2.ppf(1 - FALSE_ALARMS / CAUSES, parameters)
    return float(stats.ncx2.sf(edge, parameters, 3 * poses * visible**2))


def told_apart(t: Trial) -> tuple[float, float]:
    """Of a judge who knows the noise and both signatures and must tell the truth from its nearest rival alone: how
    often right, and mean probability given to the truth. The log odds are normal, of mean d/2 and variance d."""
    d = max(3 * t.poses * t.visible**2 * (1 - t.rival), 1e-9)
    z = stats.norm.ppf((np.arange(400) + 0.5) / 400)
    odds = d / 2 + np.sqrt(d) * z
    return float(np.mean(odds > 0)), float(np.mean(1 / (1 + np.exp(-np.clip(odds, -500, 500)))))


def share(hits: Sequence[bool]) -> str:
    """A share with its 95 % Wilson interval."""
    n = len(hits)
    if n == 0:
        return "-"
    p, z = float(np.mean(hits)), 1.96
    centre, half = (p + z * z / (2 * n)), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    low, high = ((centre + s * half) / (1 + z * z / n) for s in (-1, 1))
    return f"{p:.3f}  ({max(low, 0):.3f} .. {high:.3f}; {sum(hits)} of {n})"


def mean(values: Sequence[float]) -> str:
    """A mean with its 95 % interval."""
    if not len(values):
        return "-"
    middle, half = float(np.mean(values)), 1.96 * float(np.std(values)) / np.sqrt(len(values))
    return f"{middle:.3f}  ({middle - half:.3f} .. {min(middle + half, 1):.3f}; {len(values)})"


def false_alarm(t: Trial) -> bool:
    return t.verdict in ("unknown", "ambiguous") or any(c != "outliers" for c in t.claims)


def table(parts: dict[str, list[Trial]]) -> str:
    """Figure, value, target, theoretical limit: a line each, and what was claimed wrongly."""
    rows: list[tuple[str, str, str, str]] = []
    for part, trials in parts.items():
        rows += _SCORES[part](trials) if trials else []
    lines = [f"{'figure':<52} {'value (95 % interval; of)':<42} {'target':<14} limit"]
    lines += [f"{a:<52} {b:<42} {c:<14} {d}" for a, b, c, d in rows]
    every = [t for trials in parts.values() for t in trials]
    lines += ["", f"{len(every)} synthetic campaigns; diagnosis, median: {np.median([t.seconds for t in every]):.2f} s"]
    return "\n".join([*lines, "", "Wrong claims:", *(w for t in every for w in _wrong(t))])


def _wrong(t: Trial) -> list[str]:
    wrong = [c for c in t.claims if c not in t.truth and (t.part != "none" or c != "outliers")]
    if t.verdict != "explained" or not wrong:
        return []
    return [f"  {t.part:<9} {t.hidden or '-':<46} claimed {', '.join(wrong)}  (visible {t.visible:.2f})"]


def _detection(trials: Sequence[Trial]) -> list[tuple[str, str, str, str]]:
    at = trials[0].part
    target = {"at .5": ".99", "at .35": ".90"}[at]
    limit = np.mean([power(t.visible, t.poses) for t in trials])
    return [
        (f"detection, visible rms/noise {at[3:]}", share([t.verdict != "none" for t in trials]), target, _number(limit))
    ]


def _number(limit: float) -> str:
    return f"{limit:.3f}"


def _nothing(trials: Sequence[Trial]) -> list[tuple[str, str, str, str]]:
    return [("false alarms; half the campaigns with outliers", share([*map(false_alarm, trials)]), "<= .01", "")]


def _isolation(trials: Sequence[Trial]) -> list[tuple[str, str, str, str]]:
    seen = [t for t in trials if t.visible >= SEEN]
    claimed = [t for t in trials if t.verdict == "explained"]
    errors = np.abs([t.predicted_shrink - t.true_shrink for t in trials if t.claims])
    sets = [t.truth[0] in (t.claims[0], *t.alike) for t in trials if t.claims]
    n = f"{trials[0].poses} poses"
    return [
        (
            f"FIA: probability of the true cause, {n}",
            mean([t.posterior for t in seen]),
            ">= .92",
            _number(np.mean([told_apart(t)[1] for t in seen])),
        ),
        (
            f"first cause right, where one is named, {n}",
            share([t.claims[0] == t.truth[0] for t in trials if t.claims]),
            "",
            _number(np.mean([told_apart(t)[0] for t in seen])),
        ),
        (f"claims right, {n}", share([t.claims[0] == t.truth[0] for t in claimed]), ">= .98", ""),
        (f"claims made, {n}", share([t.verdict == "explained" for t in seen]), ">= .65", ""),
        (f"sets contain the truth, {n}", share(sets), ".93 - .97", ""),
        (
            f"|predicted - true shrink|, median / 90 %, {n}",
            f"{np.median(errors):.3f} / {np.quantile(errors, 0.9):.3f}  ({len(errors)})",
            ".04 / .12",
            "",
        ),
    ]


def _foreign(trials: Sequence[Trial]) -> list[tuple[str, str, str, str]]:
    return [
        ("on no standard list, claimed as standard", share([t.verdict == "explained" for t in trials]), "<= .02", ""),
        (
            "  of those visible",
            share([t.verdict == "explained" for t in trials if t.visible >= SEEN]),
            "",
            "",
        ),
        (
            "  all, without the rarer effects as rivals",
            share([t.without_rivals == "explained" for t in trials]),
            "",
            "",
        ),
    ]


def _several(trials: Sequence[Trial]) -> list[tuple[str, str, str, str]]:
    causes = [(c in t.claims, v) for t in trials for c, v in zip(t.truth, t.beside, strict=True)]
    limit = np.mean([power(v, trials[0].poses) for _hit, v in causes if v >= SEEN])
    return [
        (
            "two at once: recall, visible beside the other",
            share([h for h, v in causes if v >= SEEN]),
            ">= .93",
            _number(limit),
        ),
        ("  of those of visible rms/noise >= .5", share([h for h, v in causes if v >= 0.5]), "", ""),
        ("two at once: precision", share([c in t.truth for t in trials for c in t.claims]), ">= .90", ""),
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
