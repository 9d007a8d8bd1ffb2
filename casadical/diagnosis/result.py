"""Result of a diagnosis: verdict, causes, held-out error (gap), and the methods to use them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
import pandas as pd

from casadical.core.basics import Array
from casadical.core.linear_gaussian.marginals import NO_COLUMNS
from casadical.core.reporting.blocks import Table, Words
from casadical.core.reporting.plain import WRITTEN, Key, written
from casadical.core.reporting.result import Result
from casadical.core.statistics import ranked
from casadical.diagnosis.cross_validation import partitioned_errors, residual_of_fit_without
from casadical.diagnosis.laws.candidates import Round
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_account import NoiseAccount
from casadical.diagnosis.noise_floor import Replicates
from casadical.diagnosis.posterior import Ranking
from casadical.diagnosis.settings import SETTINGS
from casadical.effects import Effect
from casadical.identification.identification import METHODS, calibrated, prepared_again
from casadical.identification.pose_errors import ModelErrors, PoseErrors
from casadical.identification.prior import Prior
from casadical.identification.result import Identification, LeftOut
from casadical.measurements.measurements import Noise
from casadical.robot.robot import Robot

# Verdict: noise alone, explained by the causes, several causes fit equally, or an unlisted cause.
Verdict = Literal["none", "explained", "ambiguous", "unknown"]


@dataclass(frozen=True)
class Gap:
    """Mean reported error [m] on held-out poses: distance of measured from computed positions.

    before : that of the base model, outliers included if they are named as a cause, else
        `without_outliers`
    after : that of the model with the causes, on the inlier poses
    floor : that of simulated noise alone under a fit of the base model, at most `after`
    without_outliers : that of the base model on the inlier poses, over the same partitions into fifths
    """

    before: float
    after: float
    floor: float
    without_outliers: float


@dataclass(frozen=True)
class Outlier:
    """A pose that was rejected as an outlier.

    row : row of the pose in the table; distance : error of the model there [m]
    sigmas : Mahalanobis distance of the error, in standard deviations of the noise
    """

    row: int = field(metadata=WRITTEN)
    distance: float = field(metadata=written("distance", "mm", 5))
    sigmas: float = field(metadata=written(digits=2))


def settings_of(effect: Effect) -> dict[str, float]:
    """Return the settings of an effect that are floats (cycles, knee, time of a step), by name.

    Settings that are only tried in addition (metadata `tried`) are omitted while they are zero.
    """
    own = [f for f in fields(effect) if not f.metadata.get("tried") or getattr(effect, f.name)]
    return {f.name: value for f in own if isinstance(value := getattr(effect, f.name), float)}


@dataclass(frozen=True, eq=False)
class Cause:
    """One cause.

    effect : name of the effect; joint : its joint, 1-based; None if it belongs to none
    confidence : its posterior probability, less where more is wrong at its joint
    shrink : fraction, up to 1, by which the held-out gap falls with this cause alone in the model
    shrink_interval : 95 % interval of `shrink`
    indistinguishable : labels (name or name@joint) that the data do not distinguish from its own
    effects : its effects with their most likely settings
    estimates : (value, standard error, unit) [SI] by name of the parameter, "@joint" appended for a
        cause of several joints; None for outliers

    Examples
    --------
    >>> (cause,) = diagnosis.causes
    >>> cause.label, round(cause.confidence, 3), round(cause.shrink, 2)
    ('gear_eccentricity@2', 0.93, 0.55)
    >>> sorted(cause.estimates)
    ['cos1', 'cos2', 'sin1', 'sin2']
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("settings", lambda cause: [settings_of(effect) for effect in cause.effects]),
        Key("parameters"),
    )

    effect: str = field(metadata=WRITTEN)
    joint: int | None = field(metadata=WRITTEN)
    confidence: float = field(metadata=written(digits=4))
    shrink: float = field(metadata=written(digits=4))
    shrink_interval: tuple[float, float] = field(metadata=written(digits=4))
    indistinguishable: tuple[str, ...] = field(metadata=WRITTEN)
    effects: tuple[Effect, ...] = ()
    estimates: dict[str, tuple[float, float, str]] | None = None

    @property
    def parameters(self) -> dict[str, dict[str, float | str]]:
        """Return value, std_error and unit [SI] of each parameter of the cause, by its name."""
        names = ("value", "std_error", "unit")
        return {k: dict(zip(names, each, strict=True)) for k, each in (self.estimates or {}).items()}

    @property
    def label(self) -> str:
        """Return the effect's name, with @joint if it belongs to one, and #2 for a second event."""
        event = self.effects[0].event_suffix if self.effects else ""
        return (self.effect if self.joint is None else f"{self.effect}@{self.joint}") + event

    @property
    def of_instrument(self) -> bool:
        """Return whether it is an error of instrument or target (a drifting wire), not of the robot."""
        return any(e.of_measurement for e in self.effects)


@dataclass(frozen=True, eq=False)
class CauseSet:
    """The set of all named causes and its posterior probabilities.

    probability : that of exactly this set, among all sets that differ from it by at most one cause
        and the sets with an effect that was not tried
    untried : probability that an effect that was not tried takes part (see `Settings.untried`)
    one_more : that of an additional cause given the set
    members : that of each cause, by label, summed over these sets
    others : (labels, probability) of the most probable other sets, unlisted forms included
    names : by the label of a cause with indistinguishable ones: the probability of each label
    further : by listed label of one additional cause that is detected but not claimed: the
        probability of each label
    further_gap : mean held-out error with the most probable of these in addition to the named
        causes [m]; 0 without one
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("others", lambda s: [{"causes": labels, "probability": p} for labels, p in s.others], digits=4),
        Key("names", lambda s: s.names or None, digits=4, omit_none=True),
        Key("further", lambda s: s.further or None, digits=4, omit_none=True),
        Key("further_gap", lambda s: s.further_gap if s.further else None, "mm", 5, omit_none=True),
    )

    probability: float = field(metadata=written(digits=4))
    one_more: float = field(metadata=written(digits=4))
    members: Mapping[str, float] = field(metadata=written(digits=4))
    others: tuple[tuple[tuple[str, ...], float], ...] = ()
    names: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    further: Mapping[str, float] = field(default_factory=dict)
    further_gap: float = 0.0
    untried: float = field(default=0.0, metadata=written(digits=4))


@dataclass(frozen=True)
class Change:
    """Change of an effect since the earlier campaign that gave its prior.

    effect : label of the effect; joint : joint of its part that was tested, 1-based, or None
    probability : posterior probability that its parameters are no longer those of the prior
    """

    effect: str = field(metadata=WRITTEN)
    joint: int | None = field(metadata=WRITTEN)
    probability: float = field(metadata=written(digits=4))


@dataclass(frozen=True, eq=False)
class Unlisted:
    """Forms that describe an unlisted cause without naming it (see `describe_unlisted`).

    labels : labels of the forms, which may include listed effects; effects : theirs in the model
    before, after : mean held-out error with the named causes, and with these forms in addition [m]
    shrink, shrink_interval : fraction by which it falls, and its 95 % interval
    further : ranking of an additional cause given the named causes and these forms
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("gap", lambda forms: {"before": forms.before, "after": forms.after}, "mm", 5),
    )

    labels: tuple[str, ...] = field(metadata=written("forms"))
    effects: tuple[Effect, ...]
    before: float
    after: float
    shrink: float
    shrink_interval: tuple[float, float] = field(metadata=written(digits=4))
    further: Ranking | None = None


@dataclass(frozen=True, eq=False)
class Diagnosis(Result):
    """Result of a diagnosis: why the calibrated model still differs from the robot.

    More expensive results are computed on request: `refit` and `apply` below, and in
    `casadical.diagnosis` `analyse`, `localise`, `isolability`, `describe_unlisted`, `check_refit`,
    `network_gaps` and `next_poses`.
    verdict : none (noise alone), explained (by the causes), ambiguous or unknown
    causes : named causes, the largest shrink first
    gap : held-out error before and after the causes
    noise : estimated noise of instrument and joint repeatability
    account : size and structure of the noise against declaration, data sheet and repeated poses
    unknown_rest : (gap.after - gap.floor) / gap.before, at least 0: the fraction of the gap that
        neither named causes nor noise explain
    course : held-out error as causes are added (see `held_out_gap.course`)
    replicates : standard deviation over repeated poses, of which there may be none
    rankings : posterior over the next cause at each step of the search
    outliers : rejected poses; joint_of_outliers : joint (1-based) along which they deviate, or None
    missing : columns that were not logged, by label of the effect that needs them
    case : linear model from which the diagnosis was computed
    identification : identification of the base model; seed : seed of all random numbers
    p_nothing : bootstrap p-value of "no cause"; None without a bootstrap
    prior : prior from another campaign, or None
    changes : probability of change of each part of this prior
    cause_set : probability of the causes as a set; None if none is named
    law : the claimed expression of an unlisted effect with its rivals; None without one

    Examples
    --------
    >>> gap = diagnosis.gap
    >>> [round(1e3 * value, 3) for value in (gap.without_outliers, gap.after, gap.floor)]  # mm
    [0.081, 0.037, 0.033]
    >>> [effect.label for effect in diagnosis.effects(top=1)]
    ['gear_eccentricity@2']
    >>> refitted = diagnosis.refit()
    >>> refitted.is_optimal()
    True
    >>> value, error, unit = diagnosis.causes[0].estimates["sin1"]
    >>> f"{1e3 * value:.2f} +- {1e3 * error:.2f} m{unit}"  # 0.44 was put in
    '0.42 +- 0.02 mrad'
    >>> diagnosis.apply().effects_in_words[:19]
    'gear_eccentricity@2'
    """

    line: ClassVar[str] = (
        " of {{ it.identification.given.name | repr }}: {{ it.verdict }}; "
        "{{ it.causes | map(attribute='label') | join(', ') or 'no cause named' }}; gap "
        "{{ it.gap.without_outliers | mm }} -> {{ it.gap.after | mm }} mm, noise alone {{ it.gap.floor | mm }} mm"
    )

    derived: ClassVar[tuple[Key, ...]] = (
        Key("in_part_only", lambda d: (d.verdict == "explained" and d.has_rest) or None, omit_none=True),
        Key("gap", lambda d: {k: getattr(d.gap, k) for k in ("before", "after", "floor")}, "mm", 5),
    )

    verdict: Verdict = field(metadata=WRITTEN)
    causes: tuple[Cause, ...] = field(metadata=WRITTEN)
    gap: Gap
    noise: Noise
    account: NoiseAccount
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
    prior: Prior | None = None
    changes: tuple[Change, ...] = ()
    cause_set: CauseSet | None = None
    law: Round | None = None
    joint_of_outliers: int | None = None

    def blocks(self) -> list[Words | Table]:
        """Return the short report, verdict and causes, as blocks; `page_of` has the full report."""
        rows = [
            (
                c.label,
                f"{c.confidence:.3f}",
                " to ".join(f"{100 * v:.0f} %" for v in c.shrink_interval),
                ", ".join(c.indistinguishable),
            )
            for c in self.causes
        ]
        head = ("cause", "probability", "gap shrinks by, 95 %", "indistinguishable from")
        table = [Table("Causes", head, rows, frozenset({1, 2}))] if rows else []
        return [Words(f"{self.verdict}: {', '.join(c.label for c in self.causes) or 'no cause named'}"), *table]

    def bars(self) -> list[tuple[str, float]]:
        """Return (name, mean held-out error [m]) of base model, model with causes, and noise."""
        return [
            ("gap, held out", self.gap.without_outliers),
            ("with the causes", self.gap.after),
            ("noise alone", self.gap.floor),
        ]

    @property
    def in_question(self) -> tuple[str, ...]:
        """Return the labels of causes that additional poses should distinguish; () if none.

        They are those of an ambiguous cause, else of a possible additional one, else the two most
        probable of the last ranking where the verdict is ambiguous or unknown and none is certain.
        """
        labels = {c.label for c in self.case.candidates}
        for cause in self.causes:
            if cause.indistinguishable and cause.label in labels:
                return (cause.label, *cause.indistinguishable)
        further = self.cause_set.further if self.cause_set else {}
        if len(names := [k for k in further if k in labels]) > 1:
            return tuple(names[k] for k in ranked([further[k] for k in names]))
        last = self.rankings[-1].probability
        there = self.verdict == "ambiguous" or self.rankings[-1].none <= SETTINGS.max_p_nothing
        order = [k for k in self.rankings[-1].order if k in labels and there]
        # Two labels are not in question if one has more than 0.99 of their common probability.
        certain = len(order) > 1 and last[order[0]] > 0.99 * (last[order[0]] + last[order[1]])
        return tuple(order[:2]) if self.verdict in ("ambiguous", "unknown") and not certain else ()

    def effects(self, top: int | None = None, unlisted: Unlisted | None = None) -> tuple[Effect, ...]:
        """Return the effects of the first `top` causes (default: all), with most likely settings.

        unlisted : description whose effects are appended
        """
        named = tuple(e for c in self.causes[:top] for e in c.effects)
        return (*named, *unlisted.effects) if unlisted else named

    def refit(self, top: int | None = None, unlisted: Unlisted | None = None) -> Identification:
        """Return the identification by Ipopt of base model and effects (see `effects`) together.

        Raises ConvergenceError: Ipopt finds no optimum.
        """
        if top is None and unlisted is None:
            return self._refit_of_all
        from casadical.diagnosis.refit import refit

        return refit(self.case, self.effects(top, unlisted), self.noise)

    @cached_property
    def _refit_of_all(self) -> Identification:
        """Return the refit with all named causes, cached for the report and the result files."""
        from casadical.diagnosis.refit import refit

        return refit(self.case, self.effects(), self.noise)

    def apply(self, top: int | None = None, unlisted: Unlisted | None = None) -> Robot:
        """Return the calibrated robot with the effects in its model (see `refit`).

        Raises ConvergenceError: Ipopt finds no optimum.
        """
        return self.refit(top, unlisted).robot

    @cached_property
    def gravity(self) -> Identification:
        """Return the fit that determines the deflections under gravity of estimated masses.

        It is that of `calibrate`, without outliers; with declared masses, that of the base model.
        """
        found = self.identification
        if found.given.masses != "estimated" or not found.problem.weighed:  # by the caller
            return found
        again = replace(prepared_again(found), identification=None)
        return calibrated(again, METHODS["SKCM"], loss="auto", priors="auto")

    @property
    def columns(self) -> Array:
        """Return the indices of all causes' columns in the linear model, shape (k,); see `case`."""
        return np.unique(self.case.group(self.effects()))

    @property
    def remains(self) -> float:
        """Return the probability that the causes leave more than noise.

        It is one if an additional cause is detected, if more than 5 % of the gap is unexplained
        (`has_rest`), or if the noise has structure. Else it is the probability of an additional
        cause given the named ones; without these, zero.
        """
        none = self.rankings[-1].none
        if none <= SETTINGS.max_p_nothing_further or self.has_rest or self.account.is_structure:
            return 1.0
        return 1 - none if self.effects() else 0.0

    @property
    def has_rest(self) -> bool:
        """Return whether more than 5 % of the gap is unexplained; False for the verdict none."""
        return self.verdict != "none" and self.unknown_rest > 0.05

    @cached_property
    def held_out(self) -> PoseErrors:
        """Return the inliers' held-out errors by the base model and, if any, with the causes."""
        e = self.case.evidence
        lengths = [partitioned_errors(e, NO_COLUMNS, self.rankings[0].noise[""], self.seed)]
        if self.columns.size:
            lengths.append(partitioned_errors(e, self.columns, self.noise, self.seed))
        models = map(ModelErrors, ("base model", "with causes"), lengths)
        return self._pose_errors("Held-out poses", tuple(models))

    @cached_property
    def residual(self) -> Array:
        """Return the inliers' residuals of a fit with the causes, shape (n_inliers, numbers) [m].

        Lengths and angles are scaled to equal noise. Without causes it is the base model's.
        """
        inliers = self.case.inliers
        if not self.columns.size:
            return self.case.evidence.r
        return residual_of_fit_without(self.case.whole, self.columns, self.noise, ~inliers)[inliers]

    @cached_property
    def fitted(self) -> PoseErrors:
        """Return the inliers' errors after a fit of the base model and, if any, of the causes."""
        base, vectors, size = self.case.lengths, self.case.vectors, self.case.evidence.size
        models = [ModelErrors("base model", np.linalg.norm(base, axis=1), vectors)]
        if self.columns.size:
            length = np.linalg.norm(self.residual if size is None else self.residual * size, axis=1)
            models.append(ModelErrors("with causes", length, None if vectors is None else self.residual[:, :3]))
        return self._pose_errors("All poses fitted", tuple(models))

    def _pose_errors(self, name: str, models: tuple[ModelErrors, ...]) -> PoseErrors:
        """Return the errors of models at the inlier poses, with the outliers listed.

        name : title; it begins with "Held" for held-out errors
        """
        m, k = self.case.m, self.case.inliers
        out = tuple(LeftOut(m.source, o.row, o.distance) for o in self.outliers)
        position = self.case.positions[k]
        return PoseErrors(name, name.startswith("Held"), m.row[k], m.q[k], position, models, m.source, out)
