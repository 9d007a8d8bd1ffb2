"""Account of the noise: estimate of the fit against declaration, data sheet and repeated poses."""

from dataclasses import dataclass, field, replace
from math import floor, log
from typing import ClassVar, Literal, Self

import numpy as np

from casadical.core.basics import Array
from casadical.core.reporting.blocks import mm
from casadical.core.reporting.plain import WRITTEN, Key, written
from casadical.diagnosis.evidence import MAX_REPEATABILITY_M
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.noise_floor import Replicates, scatter_of_coordinate
from casadical.diagnosis.noise_forms import AR_NOISE, NOISY_JOINT, best_ar_form
from casadical.diagnosis.settings import SETTINGS
from casadical.diagnosis.structure import PREVIOUS_POSE, Structure, remainder_of
from casadical.measurements.measurements import Noise

# Source of the figure that determines the size of the noise: the fit, or one independent of it.
Rule = Literal["repeats", "declared", "data sheet", "fit"]


@dataclass(frozen=True)
class NoiseAccount:
    """The noise that a diagnosis assumed and its independent references, for one coordinate.

    total : rms noise of a coordinate as estimated [m], instrument and joints together
    sigma : that of the instrument alone [m]; repeatability : joint repeatability [rad]
    declared : declared sigma of the instrument [m], zero if none
    sheet : largest error by the data sheet [m], zero if none
    repeats : standard deviation over repeated poses [m]; freedom : its degrees; zero if none
    rules : source that determines how large the noise is
    excess : root of `total` squared minus that source's figure squared [m]; 0 where they agree
    form : label of the form of noise if it is not white; else empty
    structures : dependences found in the residual
    like_noise : whether the residual otherwise has Gaussian tails and is isotropic
    doubt : why what is taken as noise may contain an effect, in words; empty without a reason
    only_size_doubted : whether only the size of the noise is the reason, not its form
    hidden : standard deviation of a coordinate in which the effect in doubt would be [m]: the part of
        the joints where only these are in doubt, else all of the noise
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("declared", lambda noise: noise.declared or None, "mm", 5, omit_none=True),
        Key("datasheet", lambda noise: noise.sheet or None, "mm", 5, omit_none=True),
        Key("repeats", lambda noise: noise.repeats if noise.freedom else None, "mm", 5, omit_none=True),
        Key("repeats_freedom", lambda noise: noise.freedom or None, omit_none=True),
        Key("form", lambda noise: noise.form or None, omit_none=True),
    )

    total: float = field(metadata=written("taken", "mm", 5))
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
    doubt: str = field(default="", metadata=WRITTEN)
    only_size_doubted: bool = False
    hidden: float = 0.0

    @property
    def anchored(self) -> bool:
        """Return whether a source other than the fit determines how large the noise is."""
        return self.rules != "fit"

    @property
    def is_structure(self) -> bool:
        """Return whether the noise estimated by the fit contains unmodelled structure."""
        return self.excess > 0 or bool(self.structures)

    @property
    def anchor(self) -> float:
        """Return the noise sigma of a coordinate independent of the fit [m].

        It is that over repeated poses, or the one exceeded by `excess`; else zero.
        """
        if self.rules == "repeats":
            return self.repeats
        return float(np.sqrt(self.total**2 - self.excess**2)) if self.excess else 0.0

    def unless_small(self, times: float, most: float = SETTINGS.max_hidden) -> Self:
        """Return the account without its doubt if the effect that may hide in it is small.

        It is if its rms is below `most` times that of causes.
        times : error of the base model divided by that with the causes
        """
        explained = self.total * float(np.sqrt(max(times**2 - 1, 0.0)))
        small = self.hidden < most * explained
        return replace(self, doubt="", only_size_doubted=False) if small else self

    @property
    def structure(self) -> float:
        """Return the rms of the structure in a coordinate [m].

        It is the larger of the excess and the part that depends on a driver; zero without both.
        """
        share = max((s.share for s in self.structures), default=0.0)
        return max(self.excess, self.total * float(np.sqrt(share)))

    def in_words(self) -> str:
        """Return a text of all figures of the noise, and which source determines its size."""
        joints = f", joint repeatability {1e6 * self.repeatability:.3g} urad" if self.repeatability else ""
        said = [f"noise: {mm(self.total)} mm per coordinate (instrument {mm(self.sigma)}{joints})"]
        said += [self.form] * bool(self.form)
        stated = f"declared: {mm(self.declared)}" if self.declared else "nothing declared"
        said.append(f"data sheet: errors up to {mm(self.sheet)}" if self.sheet else stated)
        if self.freedom:
            said.append(f"repeated poses: {mm(self.repeats)} ({self.freedom} degrees of freedom)")
        else:
            said.append("no repeated poses")
        ruling = {
            "repeats": "repeated poses",
            "declared": "declaration",
            "data sheet": "data sheet",
        }
        if self.anchored:
            said.append(f"determined by the {ruling[self.rules]}")
        elif self.sheet:
            said.append("estimated from the fit: more than the data sheet allows, but like noise in every way")
        elif self.declared:
            times = self.sigma / self.declared
            how = f"{times:.1f} times too small" if times > 1 else f"{1 / times:.1f} times too large"
            said.append(f"estimated from the fit, by which the declared noise is {how}")
        else:
            tell = "datasheet_mm in problem.toml, or poses measured twice, would tell"
            said.append(f"estimated from the fit: noise, or an effect of a form that was not tried ({tell})")
        if self.rules == "fit" and not self.like_noise:
            said.append("its tails are heavier than those of noise, or its size depends on the direction")
        return "; ".join(said)

    def structure_in_words(self) -> str:
        """Return a text of the residual's structure: excess and dependences; empty without any."""
        said = []
        if self.excess:
            anchors = {"repeats": "repeated poses say", "data sheet": "the data sheet allows"}
            anchor = anchors.get(self.rules, "was declared")
            said.append(f"{mm(self.excess)} mm per coordinate more than {anchor}: structure of unknown form")
        said += [
            f"the residuals depend on {s.over} along {s.along} ({100 * s.share:.0f} % of their square; in noise with a "
            f"chance of 1e{floor(s.log_chance / log(10))})"
            for s in self.structures
        ]
        return "; ".join(said)


def account_of(
    case: Case, columns: Array, noise: Noise, repeated: Replicates, likely_form: str = "", of_form: Noise | None = None
) -> NoiseAccount:
    """Return the account of the noise that remains with some causes in the model.

    columns : indices of the causes' columns, shape (k,); noise : most likely with these causes
    repeated : standard deviation over repeated poses
    likely_form : label of the form of noise that is more probable than white noise, or empty
    of_form : the most likely noise of that form; None: `noise`
    """
    e, noise_prior = case.evidence, case.evidence.noise_prior
    taken, form = scatter_of_coordinate(e, noise), ""
    structures, like = remainder_of(case, columns, noise)
    if any(s.over == PREVIOUS_POSE for s in structures):
        # Autocorrelated noise is still noise, if the residual shows no dependence under it.
        form, (ar_form, own, _) = AR_NOISE, best_ar_form(case, columns)
        structures, like = remainder_of(case, columns, own, ar_form)
    freedom = max(e.count - e.absorbed_by_base, 1.0)
    rules: Rule = "fit"
    far, anchor = False, taken
    if repeated.enough:
        rules, anchor = "repeats", repeated.sigma
        far = exceeds(taken, anchor, freedom, repeated.freedom)
    elif noise_prior.stated:
        far, rules, anchor = _by_statement(case, noise, like_noise=like and not structures)
    excess = float(np.sqrt(taken**2 - anchor**2)) if far else 0.0
    # The limits are read from the sets, because noise_prior.sheet is scaled to the first set's
    # noise.
    stated = [m.datasheet for m in case.observations.sets if m.datasheet]
    sheet = min(stated) if noise_prior.sheet else 0.0
    sizes = (taken, noise.sigma, noise.repeatability, noise_prior.declared, sheet, repeated.sigma)
    found = NoiseAccount(*sizes, repeated.freedom, rules, excess, form, structures, like)
    # The residuals of a fit with more columns than poses (error curves) are unequal in any case.
    judged = replace(found, like_noise=found.like_noise or len(columns) > len(e.r))
    lever = e.noise_prior.lever
    doubt = doubt_of(judged, lever, form or likely_form)
    white = replace(judged, excess=0.0, structures=(), like_noise=True)
    of_size, of_joints = doubt_of(white, lever, ""), doubt_of(white, lever, form or likely_form)
    joints = doubt == of_joints and (likely_form.startswith(NOISY_JOINT) or lever * noise.repeatability > noise.sigma)
    # What scatters at a single joint is not in the equal repeatability of all.
    sigma = (of_form if of_form and likely_form.startswith(NOISY_JOINT) else noise).sigma
    hidden = float(np.sqrt(max(taken**2 - sigma**2, 0.0))) if joints else taken
    return replace(found, doubt=doubt, only_size_doubted=doubt == of_size != "", hidden=hidden)


def doubt_of(found: NoiseAccount, lever: float, form: str) -> str:
    """Return why what is taken as noise may contain an effect, in words; empty without a reason.

    A form of noise that only the fit knows may be an effect that was not tried. Noise that repeated
    poses or a declaration confirm is in doubt only where it exceeds them or depends on a driver.
    lever : see `NoisePrior`; form : label of the form of noise, empty for white noise
    """
    if found.is_structure:
        return found.structure_in_words()
    if found.rules in ("repeats", "declared"):
        return ""
    if form:
        return f"the noise is more like {form} than like independent noise of one size"
    if not found.like_noise:
        return "the noise has heavier tails than Gaussian noise, or its size depends on the direction"
    if lever * found.repeatability > MAX_REPEATABILITY_M:
        return f"joints that repeat to {1e6 * found.repeatability:.3g} urad scatter the tool by more than 0.1 mm"
    if found.declared and found.sigma > found.declared:
        return "the noise is larger than declared"
    return ""


def _by_statement(case: Case, noise: Noise, *, like_noise: bool) -> tuple[bool, Rule, float]:
    """Return whether the noise exceeds its declaration or data sheet, the source, and its figure.

    The figure is the standard deviation of a coordinate [m] by the source that determines the size
    of the noise. A statement that is exceeded is overruled only if the residual is like noise in
    every other way: equal in all directions, with Gaussian tails, and independent of every driver;
    else the model is wrong. Less noise overrules a declared sigma, but not a data sheet's limit.
    """
    e, noise_prior = case.evidence, case.evidence.noise_prior
    # A declared sigma is the instrument's; at most 15 urad of joint repeatability are added to it.
    joints = min(noise.repeatability, 15e-6)
    rule: Rule = "declared" if noise_prior.declared else "data sheet"
    taken, allowed = scatter_of_coordinate(e, noise), scatter_of_coordinate(e, Noise(noise_prior.stated, joints))
    freedom = max(e.count - e.absorbed_by_base, 1.0)
    above = exceeds(taken, allowed, freedom, np.inf)
    if above and not like_noise:
        return True, rule, allowed
    # Otherwise the fit rules where it differs significantly from what is stated.
    differs = above or (noise_prior.declared and exceeds(allowed, taken, np.inf, freedom))
    return (False, "fit", taken) if differs else (False, rule, allowed)


def exceeds(larger: float, smaller: float, above: float, below: float) -> bool:
    """Return whether one standard deviation exceeds another significantly (F test at 0.1 %).

    A tenth is allowed for figures that were rounded.
    above, below : degrees of freedom of the larger and of the smaller one
    """
    from scipy.special import fdtrc

    ratio = larger / (1.1 * smaller)
    return ratio > 1 and bool(fdtrc(min(above, 1e6), min(below, 1e6), ratio**2) < 1e-3)
