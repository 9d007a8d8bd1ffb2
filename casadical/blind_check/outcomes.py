"""The outcome of one campaign: what was hidden beside what was answered, reduced to what the metrics count."""

from dataclasses import dataclass

import numpy as np

from casadical.blind_check.answers import Answer
from casadical.blind_check.protocol import Kind, Secret
from casadical.core.arrays import Array

# A coordinate farther from the truth than so many robust standard deviations is an outlier of the instrument.
FAR = 8.0
SET_SIZE = 3


@dataclass(frozen=True)
class Outcome:
    """One campaign.

    kind : none, one, several, unlisted; effects : names of what is hidden; truth : labels that a right answer names
    signal, signals : rms that the base model cannot absorb over the noise, of all effects and of each alone
    verdict, named : the answer, its causes by label; alike : the set of the first cause, itself included
    probability : given to the truth (the mean, where there are several)
    predicted, realised : share by which the gap shrinks, as the answer says and at the unseen poses
    before, after : mean error at the unseen poses [m], by the base model and with the named causes
    """

    name: str
    robot: str
    kind: Kind
    poses: int
    missing: str | None
    effects: tuple[str, ...]
    truth: tuple[str, ...]
    signal: float
    signals: tuple[float, ...]
    verdict: str
    named: tuple[str, ...]
    alike: tuple[str, ...]
    probability: float
    predicted: float
    realised: float
    before: float
    after: float

    @property
    def detected(self) -> bool:
        return self.verdict != "none"

    @property
    def alarmed(self) -> bool:
        """Whether it reports something that is not there: a cause, or one that it does not know."""
        return self.verdict in ("ambiguous", "unknown") or any(text not in self.truth for text in self.named)

    @property
    def claimed(self) -> bool:
        return self.verdict == "explained"

    @property
    def wrong_claims(self) -> tuple[str, ...]:
        return tuple(text for text in self.named if text not in self.truth) if self.claimed else ()

    @property
    def share_left(self) -> float:
        """Share of the gap that is left at the unseen poses."""
        return self.after / self.before

    @property
    def first_right(self) -> bool:
        """Whether the causes named first are those that are hidden, in name and joint, in any order."""
        return bool(self.truth) and set(self.truth) <= set(self.named[: len(self.truth)])


def outcome(name: str, secret: Secret, answer: Answer) -> Outcome:
    named = tuple(dict.fromkeys(c.label for c in answer.causes))
    before, after = unseen_errors(secret, answer, "outliers" in named)
    wanted = secret.truth or ("none" if secret.kind == "none" else "unknown",)
    probability = answer.probabilities
    return Outcome(
        name=name,
        robot=secret.robot,
        kind=secret.kind,
        poses=secret.poses,
        missing=secret.missing,
        effects=tuple(h.effect for h in secret.hidden),
        truth=secret.truth,
        signal=secret.visible / secret.noise,
        signals=tuple(h.visible / secret.noise for h in secret.hidden),
        verdict=answer.verdict,
        named=named,
        alike=(named[0], *answer.causes[0].alike)[:SET_SIZE] if named else (),
        probability=float(np.mean([probability.get(text, 0.0) for text in wanted])),
        predicted=1 - answer.gap_mm.after / answer.gap_mm.before,
        realised=1 - after / before,
        before=before,
        after=after,
    )


def unseen_errors(secret: Secret, answer: Answer, outliers_named: bool) -> tuple[float, float]:
    """Mean error at the unseen poses [m], by the base model and with the named causes.

    Where the answer names outliers, those of the instrument are left out of the second: they are no error of the robot.
    """
    measured, true = np.array(secret.measured_mm), np.array(secret.true_mm)
    base, better = np.array(answer.unseen.base_mm), np.array(answer.unseen.with_causes_mm)
    used = ~outlying(measured - true) if outliers_named else np.ones(len(measured), dtype=bool)
    after = np.linalg.norm(measured - better, axis=1)[used]
    return 1e-3 * float(np.linalg.norm(measured - base, axis=1).mean()), 1e-3 * float(after.mean())


def outlying(noise: Array) -> Array:
    """Mask, shape (n,), of the poses whose noise, shape (n, 3), is far beyond its robust standard deviation."""
    spread = 1.4826 * float(np.median(np.abs(noise)))
    return np.asarray(np.abs(noise).max(axis=1) > FAR * spread)
