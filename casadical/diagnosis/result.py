"""What a diagnosis found: verdict, causes, the gap before and after."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
import pandas as pd

from casadical.core.basics import Array
from casadical.core.linear_gaussian.marginals import NO_COLUMNS
from casadical.core.statistics import ranked
from casadical.core.telling.blocks import Table, Words
from casadical.core.telling.plain import WRITTEN, Key, written
from casadical.core.telling.result import Result
from casadical.diagnosis.cross_validation import fitted_without, partitioned_errors
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_account import NoiseAccount
from casadical.diagnosis.noise_floor import Replicates
from casadical.diagnosis.posterior import Ranking
from casadical.diagnosis.settings import SETTINGS
from casadical.effects import Effect
from casadical.identification.pose_errors import ModelErrors, PoseErrors
from casadical.identification.prior import Prior
from casadical.identification.result import Identification, LeftOut
from casadical.measurements.measurements import Noise
from casadical.robot.robot import Robot

if TYPE_CHECKING:
    from casadical.diagnosis.laws.problem import Round

Verdict = Literal["none", "explained", "ambiguous", "unknown"]


@dataclass(frozen=True)
class Gap:
    """Mean distance [m] of measured from computed positions on poses held out from the fit.

    A page shows kept, after and floor.

    before : of the base model, the outliers counted where they are named as a cause; else the same as kept
    after : with the causes, of the same poses
    floor : what noise alone would leave
    kept : of the base model, outliers left out, over the same partitions into fifths
    """

    before: float
    after: float
    floor: float
    kept: float


@dataclass(frozen=True)
class Outlier:
    """A pose that was left out: line of the source, distance from the model [m], and in sigmas of the noise."""

    row: int = field(metadata=WRITTEN)
    distance: float = field(metadata=written("distance", "mm", 5))
    sigmas: float = field(metadata=written(digits=2))


def settings_of(effect: Effect) -> dict[str, float]:
    """Values of an effect in which it is not linear (cycles, knee, lag, time of a step)."""
    own = [f for f in fields(effect) if not f.metadata.get("tried") or getattr(effect, f.name)]
    return {f.name: value for f in own if isinstance(value := getattr(effect, f.name), float)}


@dataclass(frozen=True, eq=False)
class Cause:
    """One cause.

    effect : name of the effect
    joint : its joint, 1-based; None where it belongs to none
    confidence : its posterior probability
    shrink : share by which the held-out gap falls when it is added
    shrink_interval : of `shrink`, 95 %
    indistinguishable : labels (name or name@joint) that this data cannot tell from it
    effects : the symbolic effects with their most likely settings
    estimates : parameter -> (value, standard error, unit) [SI]

    Examples
    --------
    >>> (cause,) = diagnosis.causes
    >>> cause.label, round(cause.confidence, 3), round(cause.shrink, 2)
    ('gear_eccentricity@2', 1.0, 0.55)
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
        """Return the estimates as plain data [SI]."""
        names = ("value", "std_error", "unit")
        return {k: dict(zip(names, each, strict=True)) for k, each in (self.estimates or {}).items()}

    @property
    def label(self) -> str:
        """The effect's name, with @joint where it belongs to one."""
        return self.effect if self.joint is None else f"{self.effect}@{self.joint}"

    @property
    def of_instrument(self) -> bool:
        """Whether it is a fault of what measures, such as a wire that drifts, and none of the robot."""
        return any(e.from_kind for e in self.effects)


@dataclass(frozen=True, eq=False)
class CauseSet:
    """The set of all named causes.

    probability : of exactly these, among all sets that differ from it by one cause
    one_more : probability of a further cause beside them; members : of each cause, by label, whatever the others are
    others : the most probable other sets, forms on no list among them, each with its probability
    names : of a cause that these data do not tell from one or two others: each label with its probability, by the first
    further : listed names of one more cause, where one is there that is not claimed: each label with its probability
    further_gap : error on poses held out with the best of them beside the named ones [m]
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("others", lambda s: [{"causes": labels, "probability": p} for labels, p in s.others], digits=4),
        Key("names", lambda s: s.names or None, digits=4, if_known=True),
        Key("further", lambda s: s.further or None, digits=4, if_known=True),
        Key("further_gap", lambda s: s.further_gap if s.further else None, "mm", 5, if_known=True),
    )

    probability: float = field(metadata=written(digits=4))
    one_more: float = field(metadata=written(digits=4))
    members: Mapping[str, float] = field(metadata=written(digits=4))
    others: tuple[tuple[tuple[str, ...], float], ...] = ()
    names: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    further: Mapping[str, float] = field(default_factory=dict)
    further_gap: float = 0.0


@dataclass(frozen=True)
class Change:
    """One effect, or its part in one joint; probability : that its parameters are no longer those of the prior"""

    effect: str = field(metadata=WRITTEN)
    joint: int | None = field(metadata=WRITTEN)
    probability: float = field(metadata=written(digits=4))


@dataclass(frozen=True, eq=False)
class Unlisted:
    """Forms that describe the unknown (see `describe_unlisted`); they name no cause.

    labels, effects : what the forms are, of listed effects too, and the same as effects of the model
    before, after : mean held-out gap with the named causes, and with these forms too [m]
    shrink, shrink_interval : share by which it falls, and 95 % of it; beside : what is most probable beside these forms
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
    beside: Ranking | None = None


@dataclass(frozen=True, eq=False)
class Diagnosis(Result):
    """The answer to: why is there still a gap?

    What costs more is asked for by name: `refit` and `apply` below, and in `casadical.diagnosis` `analyse`, `localise`,
    `isolability`, `describe_unlisted`, `check_refit`, `network_gaps` and `next_poses`.

    verdict : none, explained, ambiguous, unknown
    causes : the largest shrink first
    gap : held-out, before and after the causes
    noise : instrument and joint repeatability
    account : how large that is of a coordinate, beside what was declared and what repeated poses say, and what it
        follows
    unknown_rest : share of the gap that is there to be explained and that no named cause explains
    course : how far the gap falls with each cause added (see `held_out_gap.course`)
    replicates : scatter of repeated poses, of which there may be none
    rankings : what each step saw
    outliers : poses that were left out; joint_of_outliers : along whose motion they err, or None
    missing : label -> columns that would be needed to judge it
    case : the linear problem that it was computed from
    identification : of the base model
    seed : of everything random
    p_nothing : how often noise alone would look as much like some cause; None without a bootstrap
    prior : what another campaign told, before these data, or None
    changes : what of it changed
    cause_set : probability of the causes as a set; None where none is named
    law : the law that was claimed beside nothing, with its rivals; None where none was, or none was to compare

    Examples
    --------
    >>> gap = diagnosis.gap
    >>> [round(1e3 * value, 3) for value in (gap.kept, gap.after, gap.floor)]  # mm
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
        "{{ it.causes | map(attribute='label') | join(', ') or 'no cause named' }}; gap {{ it.gap.kept | mm }}"
        " -> {{ it.gap.after | mm }} mm, noise alone {{ it.gap.floor | mm }} mm"
    )

    derived: ClassVar[tuple[Key, ...]] = (
        Key("in_part_only", lambda d: (d.verdict == "explained" and d.has_rest) or None, if_known=True),
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
        """The verdict and the causes; `casadical.diagnosis.page_of` has all that was found."""
        rows = [
            (c.label, f"{c.confidence:.3f}", " to ".join(f"{100 * v:.0f} %" for v in c.shrink_interval),
             ", ".join(c.indistinguishable))
            for c in self.causes
        ]  # fmt: skip
        head = ("cause", "probability", "gap shrinks by, 95 %", "indistinguishable from")
        table = [Table("Causes", head, rows, frozenset({1, 2}))] if rows else []
        return [Words(f"{self.verdict}: {', '.join(c.label for c in self.causes) or 'no cause named'}"), *table]

    def bars(self) -> list[tuple[str, float]]:
        """Mean errors on held-out poses."""
        return [("gap, held out", self.gap.kept), ("with the causes", self.gap.after), ("noise alone", self.gap.floor)]

    @property
    def in_question(self) -> tuple[str, ...]:
        """Labels that further poses should distinguish: a set of similar causes, of one more, or the first two."""
        known = {c.label for c in self.case.candidates}
        for cause in self.causes:
            if cause.indistinguishable and cause.label in known:
                return (cause.label, *cause.indistinguishable)
        further = self.cause_set.further if self.cause_set else {}
        if len(names := [k for k in further if k in known]) > 1:
            return tuple(names[k] for k in ranked([further[k] for k in names]))
        last = self.rankings[-1].probability
        order = [k for k in self.rankings[-1].order if k in known]
        # Two forms are not in question where one has this share of what both have.
        certain = len(order) > 1 and last[order[0]] > 0.99 * (last[order[0]] + last[order[1]])
        return tuple(order[:2]) if self.verdict in ("ambiguous", "unknown") and not certain else ()

    def effects(self, top: int | None = None, unlisted: Unlisted | None = None) -> tuple[Effect, ...]:
        """Effects of the first `top` causes (all by default), with their most likely settings."""
        named = tuple(e for c in self.causes[:top] for e in c.effects)
        return (*named, *unlisted.effects) if unlisted else named

    def refit(self, top: int | None = None, unlisted: Unlisted | None = None) -> Identification:
        """Base model and these effects identified together by Ipopt, with standard errors.

        Raises ConvergenceError: Ipopt finds no optimum.
        """
        from casadical.diagnosis.refit import refit

        return refit(self.case, self.effects(top, unlisted), self.noise)

    def apply(self, top: int | None = None, unlisted: Unlisted | None = None) -> Robot:
        """The calibrated robot with these effects in its model (see `refit`): it predicts, and is exported, as any.

        Raises ConvergenceError: Ipopt finds no optimum.
        """
        return self.refit(top, unlisted).robot

    @property
    def columns(self) -> Array:
        """Columns of all causes in the case's evidence, shape (k,), as whole numbers without unit; see `case`."""
        return np.unique(self.case.group(self.effects()))

    @property
    def remains(self) -> float:
        """How probable it is that more than noise is left.

        It is certain where more is seen than is passed over: something further, a rest above the floor, structure. Else
        it is what the data leave for a further cause beside named ones; without any, zero.
        """
        none = self.rankings[-1].none
        if none <= SETTINGS.max_p_nothing_further or self.has_rest or self.account.is_structure:
            return 1.0
        return 1 - none if self.effects() else 0.0

    @property
    def has_rest(self) -> bool:
        """Whether more is left above the noise floor than can be passed over."""
        # From this share of the gap on, what lies above the noise floor and has no named cause is reported.
        return self.verdict != "none" and self.unknown_rest > 0.05

    @cached_property
    def held_out(self) -> PoseErrors:
        """Held-out error of every pose that is no outlier: base model, and with the causes in it."""
        e = self.case.evidence
        lengths = [partitioned_errors(e, NO_COLUMNS, self.rankings[0].noise[""], self.seed)]
        if self.columns.size:
            lengths.append(partitioned_errors(e, self.columns, self.noise, self.seed))
        models = map(ModelErrors, ("base model", "with causes"), lengths)
        return self._pose_errors("Held-out poses", tuple(models))

    @cached_property
    def left(self) -> Array:
        """What a fit of base model and causes to all poses leaves at each, shape (kept, numbers) [m]."""
        kept = self.case.kept
        if not self.columns.size:
            return self.case.evidence.r
        return fitted_without(self.case.whole, self.columns, self.noise, ~kept)[kept]

    @cached_property
    def fitted(self) -> PoseErrors:
        """What a fit to all poses leaves at each, as vectors: base model, and with the causes in it."""
        base, vectors, size = self.case.lengths, self.case.vectors, self.case.evidence.size
        models = [ModelErrors("base model", np.linalg.norm(base, axis=1), vectors)]
        if self.columns.size:
            length = np.linalg.norm(self.left if size is None else self.left * size, axis=1)
            models.append(ModelErrors("with causes", length, None if vectors is None else self.left[:, :3]))
        return self._pose_errors("All poses fitted", tuple(models))

    def _pose_errors(self, name: str, models: tuple[ModelErrors, ...]) -> PoseErrors:
        m, k = self.case.m, self.case.kept
        out = tuple(LeftOut(m.source, o.row, o.distance) for o in self.outliers)
        position = self.case.positions[k]
        return PoseErrors(name, name.startswith("Held"), m.row[k], m.q[k], position, models, m.source, out)
