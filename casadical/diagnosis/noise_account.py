"""What a diagnosis took as noise, beside what was declared and what repeated poses say, and which of them rules."""

from dataclasses import dataclass, field
from enum import StrEnum
from math import floor, log
from typing import ClassVar

import numpy as np
from scipy.special import fdtrc

from casadical.core.basics import Array
from casadical.core.telling.blocks import mm
from casadical.core.telling.plain import WRITTEN, Key, written
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_floor import Replicates, scatter_of_coordinate
from casadical.diagnosis.noise_forms import FOLLOWING, best_following
from casadical.diagnosis.structure import BEFORE, Remainder, Structure, remainder_of
from casadical.measurements.measurements import Noise

# Noise that is so many times what is known of it is not that noise, unless chance alone does it as often as this.
FAR, BY_CHANCE = 1.4, 1e-3


class Rule(StrEnum):
    """What says how large the noise is."""

    REPEATS = "repeats"
    DECLARED = "declared"
    SHEET = "data sheet"
    FIT = "fit"


@dataclass(frozen=True)
class NoiseAccount:
    """What was taken as noise, of a coordinate [m], instrument and joints together.

    taken : as the fit leaves it; sigma, repeatability : what it is made of [m, rad]
    declared : sigma of the instrument, zero for none; sheet : largest error by its data sheet, zero for none
    repeats : scatter of repeated poses, and freedom, their degrees of freedom, zero for none
    rules : which of them says how large the noise is
    excess : of what was taken, beyond that [m]; zero where it agrees
    form : of the noise, where it is another than the usual
    structures : what it follows; like_noise : whether it looks like noise besides
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("declared", lambda noise: noise.declared or None, "mm", 5, if_known=True),
        Key("datasheet", lambda noise: noise.sheet or None, "mm", 5, if_known=True),
        Key("repeats", lambda noise: noise.repeats if noise.freedom else None, "mm", 5, if_known=True),
        Key("repeats_freedom", lambda noise: noise.freedom or None, if_known=True),
        Key("form", lambda noise: noise.form or None, if_known=True),
    )

    taken: float = field(metadata=written("taken", "mm", 5))
    sigma: float
    repeatability: float
    declared: float
    sheet: float
    repeats: float
    freedom: int
    rules: Rule = field(metadata=WRITTEN)
    excess: float = field(metadata=written("excess", "mm", 5))
    form: str
    structures: tuple[Structure, ...] = field(metadata=written("structure"))
    like_noise: bool = field(metadata=WRITTEN)

    @property
    def anchored(self) -> bool:
        """Whether anything but the fit says how large the noise is."""
        return self.rules != Rule.FIT

    @property
    def is_structure(self) -> bool:
        """Whether it is more than noise."""
        return self.excess > 0 or bool(self.structures)

    @property
    def anchor(self) -> float:
        """How large the noise of a coordinate is [m], where anything but the fit says it; else zero."""
        if self.rules == Rule.REPEATS:
            return self.repeats
        return float(np.sqrt(self.taken**2 - self.excess**2)) if self.excess else 0.0

    @property
    def structure(self) -> float:
        """Of a coordinate, what is structure: beyond the anchor, or what follows a driver [m]."""
        share = max((s.share for s in self.structures), default=0.0)
        return max(self.excess, self.taken * float(np.sqrt(share)))

    def in_words(self) -> str:
        """What was taken as noise, declared and repeated, and which rules."""
        joints = f" and joints that repeat to {1e6 * self.repeatability:.3g} urad" if self.repeatability else ""
        said = [f"taken as noise: {mm(self.taken)} mm a coordinate (instrument {mm(self.sigma)}{joints})"]
        said += [self.form] * bool(self.form)
        stated = f"declared: {mm(self.declared)}" if self.declared else "nothing declared"
        said.append(f"data sheet: errors up to {mm(self.sheet)}" if self.sheet else stated)
        if self.freedom:
            said.append(f"repeated poses: {mm(self.repeats)} ({self.freedom} degrees of freedom)")
        else:
            said.append("no repeated poses")
        ruling = {
            Rule.REPEATS: "repeated poses rule",
            Rule.DECLARED: "declared noise rules",
            Rule.SHEET: "data sheet rules",
        }
        if self.anchored:
            said.append(f"the {ruling[self.rules]}")
        elif self.sheet:
            said.append("the fit rules: more than the data sheet allows, and in every way like noise")
        elif self.declared:
            times = self.sigma / self.declared
            how = f"{times:.1f} times too small" if times > 1 else f"{1 / times:.1f} times too large"
            said.append(f"the fit rules, by which the declared noise is {how}")
        else:
            tell = "datasheet_mm in problem.toml, or poses measured twice, would tell"
            said.append(f"the fit rules: noise, or a form that was not tried ({tell})")
        if self.rules == Rule.FIT and not self.like_noise:
            said.append("it has heavier tails than noise has, or is larger in some directions than in others")
        return "; ".join(said)

    def structure_in_words(self) -> str:
        """What of it is structure, and what that follows; empty where nothing is."""
        said = []
        if self.excess:
            anchors = {Rule.REPEATS: "repeated poses say", Rule.SHEET: "the data sheet allows"}
            anchor = anchors.get(self.rules, "was declared")
            said.append(f"{mm(self.excess)} mm a coordinate more than {anchor}: structure without a form")
        said += [
            f"what is left follows {s.over} along {s.along} ({100 * s.share:.0f} % of its square; in noise with a "
            f"chance of 1e{floor(s.log_chance / log(10))})"
            for s in self.structures
        ]
        return "; ".join(said)


def account_of(case: Case, columns: Array, noise: Noise, repeated: Replicates) -> NoiseAccount:
    """The account of a noise beside some causes, whose columns are given, shape (k,)."""
    e, known = case.evidence, case.evidence.known
    taken, left, form = scatter_of_coordinate(e, noise), remainder_of(case, columns, noise), ""
    if any(s.over == BEFORE for s in left.structures):
        # Noise that follows itself is noise all the same, if this is all that it follows.
        form, (following, own, _) = FOLLOWING, best_following(case, columns)
        left = remainder_of(case, columns, own, following)
    freedom = max(e.count - e.absorbed_by_base, 1.0)
    far, rules, anchor = False, Rule.FIT, taken
    if repeated.enough:
        rules, anchor = Rule.REPEATS, repeated.sigma
        far = _far(taken, anchor, freedom, repeated.freedom)
    elif known.stated:
        far, rules, anchor = _by_statement(case, columns, noise, left)
    excess = float(np.sqrt(taken**2 - anchor**2)) if far else 0.0
    stated = [m.datasheet for m in case.observations.sets if m.datasheet]  # known.sheet is in units of the first table
    sheet = min(stated) if known.sheet else 0.0
    scatter = repeated.sigma if repeated.freedom else 0.0
    return NoiseAccount(
        taken, noise.sigma, noise.repeatability, known.declared, sheet, scatter, repeated.freedom, rules, excess,
        form, left.structures, left.like_noise,
    )  # fmt: skip


def _by_statement(case: Case, columns: Array, noise: Noise, left: Remainder) -> tuple[bool, Rule, float]:
    """Whether the noise is far above what is stated of it, which rules, and the noise that is allowed for [m].

    A statement may be wrong by as much as what is left looks like noise in every other way: alike in all directions,
    with the tails of noise, and following nothing. Otherwise it is the model that is wrong. Less noise than a data
    sheet states is as it says.
    """
    e, known = case.evidence, case.evidence.known
    # A declared sigma is the instrument's; joints repeat to this [rad] beside it at most.
    joints, rule = min(noise.repeatability, 15e-6), Rule.DECLARED if known.declared else Rule.SHEET
    taken, allowed = scatter_of_coordinate(e, noise), scatter_of_coordinate(e, Noise(known.stated, joints))
    if _far(taken, allowed, max(e.count - e.absorbed_by_base, 1.0), np.inf) and not (
        left.like_noise and not left.structures
    ):
        return True, rule, allowed
    logs = e.log_base(columns)
    share = np.exp(logs - np.logaddexp.reduce(logs, axis=None)).sum(axis=0)
    below = share[e.sigmas < known.declared / FAR].sum()
    wrong = max(share[e.sigmas > FAR * known.stated].sum(), below)
    # A declared sigma is said to be wrong by that factor where it is from this probability on.
    return (False, Rule.FIT, taken) if wrong > 0.99 else (False, rule, allowed)


def _far(larger: float, smaller: float, above: float, below: float) -> bool:
    """Whether one noise is far above another, not by chance; above, below : their degrees of freedom."""
    if larger <= FAR * smaller:
        return False
    return bool(fdtrc(min(above, 1e6), min(below, 1e6), (larger / smaller) ** 2) < BY_CHANCE)
