"""What a diagnosis found: verdict, causes, the gap before and after, and what follows from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import pandas as pd

from casadical.compensator import Trainer
from casadical.core.transforms import Array
from casadical.diagnosis.cross_validation import Noise, held_out_errors, random_folds
from casadical.diagnosis.isolability import Isolability, isolability_of
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.localisation import Where, where
from casadical.diagnosis.network import NetworkGap, network_gap
from casadical.diagnosis.next_poses import next_poses
from casadical.diagnosis.posterior import Ranking
from casadical.diagnosis.refit import Check, held_out_refit, refit
from casadical.diagnosis.replicates import Replicates
from casadical.diagnosis.smooth_description import Unlisted, unlisted_forms
from casadical.effects import Effect
from casadical.identification.identification import Identification
from casadical.pose_selection.workspace import Workspace
from casadical.robot.robot import Robot

# Two forms are not in question where one has this share of what both have.
CERTAIN = 0.99
Verdict = Literal["none", "explained", "ambiguous", "unknown"]


@dataclass(frozen=True)
class Gap:
    """Mean position error on poses held out from the fit [m]: base model, with the causes, and the noise floor."""

    before: float
    after: float
    floor: float


@dataclass(frozen=True)
class Outlier:
    """A pose that was left out: line of the source, distance from the model [m], and in sigmas of the noise."""

    row: int
    distance: float
    sigmas: float


@dataclass(frozen=True, eq=False)
class Cause:
    """One cause.

    effect, joint : its name and 1-based joint or None; confidence : its posterior probability
    shrink, shrink_interval : share by which the held-out gap falls when it is added, with a 95 % interval
    indistinguishable : labels (name or name@joint) that this data cannot tell from it
    effects : the symbolic effects with their most likely settings
    estimates : parameter -> (value, standard error, unit) [SI]
    """

    effect: str
    joint: int | None
    confidence: float
    shrink: float
    shrink_interval: tuple[float, float]
    indistinguishable: tuple[str, ...]
    effects: tuple[Effect, ...] = ()
    estimates: dict[str, tuple[float, float, str]] | None = None

    @property
    def label(self) -> str:
        return self.effect if self.joint is None else f"{self.effect}@{self.joint}"


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The answer to: why is there still a gap?

    verdict : none, explained, ambiguous, unknown; causes : the largest shrink first
    gap : held-out, before and after the causes; noise : instrument and joint repeatability
    unknown_rest : share of the gap that is there to be explained and that no named cause explains
    course : how far the gap falls with each cause added (see `how_far.course`)
    replicates : scatter of repeated poses, of which there may be none
    rankings : what each step saw; outliers : poses that were left out
    missing : label -> columns that would be needed to speak about it
    case, identification : what it was computed from; seed : of all chance
    p_nothing : how often noise alone would look as much like some cause; None without a bootstrap
    """

    verdict: Verdict
    causes: tuple[Cause, ...]
    gap: Gap
    noise: Noise
    unknown_rest: float
    course: pd.DataFrame
    replicates: Replicates
    rankings: tuple[Ranking, ...]
    outliers: tuple[Outlier, ...]
    missing: dict[str, tuple[str, ...]]
    case: Case
    identification: Identification
    seed: int = 0
    p_nothing: float | None = None

    @cached_property
    def unlisted(self) -> Unlisted | None:
        """What the rest is most like, and the gap with that in the model; None unless the verdict is unknown."""
        if self.verdict != "unknown":
            return None
        named = self.columns, frozenset(c.label for c in self.causes)
        noise = self.noise if self.effects() else self.rankings[0].noise[""]
        return unlisted_forms(self.case, self.rankings[-1], named, noise, self.seed)

    @cached_property
    def where(self) -> Where:
        """Where the gap of the base model lies: by joint, link, direction, region and circumstances (see `where`)."""
        return where(self.case, self.noise, self.seed)

    @cached_property
    def isolability(self) -> Isolability:
        """What these poses could have shown: what the base absorbs of each effect, what looks alike, at this noise."""
        return isolability_of(self.case, self.noise)

    @property
    def in_question(self) -> tuple[str, ...]:
        """Labels that further poses should distinguish: a set of similar causes, or the two leading ones."""
        for cause in self.causes:
            if cause.indistinguishable and cause.label in self.rankings[0].probability:
                return (cause.label, *cause.indistinguishable)
        last = self.rankings[-1].probability
        order = [k for k in self.rankings[-1].order if k in self.rankings[0].probability]
        certain = len(order) > 1 and last[order[0]] > CERTAIN * (last[order[0]] + last[order[1]])
        return tuple(order[:2]) if self.verdict in ("ambiguous", "unknown") and not certain else ()

    def next_poses(
        self, n: int, seed: int = 0, *, workspace: Workspace | None = None, payloads: Sequence[float] = ()
    ) -> pd.DataFrame:
        """The n poses that best distinguish what these data cannot (see `next_poses.next_poses`); may be empty.

        workspace : where poses may lie; payloads : states [kg] that can be mounted
        """
        labels = self.in_question
        if len(labels) < 2:
            return pd.DataFrame()
        known = {c.label for c in self.case.candidates}
        others = [k for k in self.rankings[-1].order if k in known and k not in labels]
        beside = ("none", *others[:1])
        return next_poses(self.case, labels, n, seed, beside=beside, workspace=workspace, payloads=payloads)

    def effects(self, top: int | None = None, unlisted: bool = False) -> tuple[Effect, ...]:
        """Effects of the first `top` causes (all by default), with their most likely settings.

        unlisted : also the forms of the unknown, which name no cause but describe what is left
        """
        named = tuple(e for c in self.causes[:top] for e in c.effects)
        return (*named, *self.unlisted.effects) if unlisted and self.unlisted else named

    def refit(self, top: int | None = None, unlisted: bool = False) -> Identification:
        """Base model and these effects identified together by Ipopt, with standard errors (see `effects`, `refit`)."""
        return refit(self.case, self.effects(top, unlisted), self.noise)

    def apply(self, top: int | None = None, unlisted: bool = False) -> Robot:
        """The calibrated robot with these effects in its model: it predicts, and is exported, as any other."""
        return self.refit(top, unlisted).robot

    def check_refit(self, show: Callable[[str], None] = lambda _text: None) -> Check:
        """Held-out gap of the nonlinear refit beside that of the linearised model, on the same fifths."""
        errors = held_out_refit(self.case, self.effects(), self.noise, self.seed, show)
        folds = random_folds(len(errors), self.seed)
        linear = held_out_errors(self.case.evidence, self.columns, self.noise, folds)
        return Check(float(errors.mean()), float(linear.mean()))

    def with_network(
        self, trainer: Trainer | str = "lm", show: Callable[[str], None] = lambda _text: None
    ) -> tuple[NetworkGap, NetworkGap]:
        """The gap when the paper's network is used instead of the causes, and on what the causes leave."""
        before = self.rankings[0].noise[""]
        columns = (np.zeros(0, dtype=np.int64), before), (self.columns, self.noise)
        first, second = (network_gap(self.case, c, noise, self.seed, trainer, show) for c, noise in columns)
        return first, second

    @property
    def columns(self) -> Array:
        """Columns of all causes in the case's evidence, shape (k,), as whole numbers without unit; see `case`."""
        effects = self.effects()
        return np.unique(self.case.group(effects)) if effects else np.zeros(0, dtype=np.int64)
