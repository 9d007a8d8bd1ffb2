"""The linear problem of a campaign: what the base model and the candidate causes do to a calibrated robot's residuals.

It is a linear-Gaussian model (see `casadical.core.linear_gaussian`). Its blocks are the poses; the base model's
parameters are in the base, the parameters of effects are the columns, and beside the instrument's noise there is one
component: joint repeatability, which reaches the measured point through the derivative by the joint variables.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import ArrayColumns, SerialColumns
from casadical.core.linear_gaussian.grid import Grid
from casadical.core.linear_gaussian.marginals import NONE
from casadical.core.linear_gaussian.model import LinearModel, Projection
from casadical.core.linear_gaussian.noise import NoiseModel, SerialNoise
from casadical.measurements.measurements import Noise

SIGMAS = np.geomspace(3e-6, 300e-6, 33)
# The same steps from 1 um to 11 mm, for instruments that are finer or coarser.
ALL_SIGMAS = SIGMAS[0] * (SIGMAS[-1] / SIGMAS[0]) ** (np.arange(-8, 58) / (len(SIGMAS) - 1))
# Joint repeatability over the instrument's sigma [rad/m].
RHOS = np.array([0.0, 0.1, 0.2, 0.4, 0.8, 1.6])
KAPPAS = np.array([0.35, 0.7, 1.4, 2.8, 5.6])
KAPPA_WEIGHTS = np.array([0.15, 0.25, 0.3, 0.2, 0.1])
# The noise component of the joints.
REPEATABILITY = "repeatability"


# A declared sigma is off by this in its logarithm, or by far more: Student's t with so many degrees of freedom, so that
# one that is wrong by three costs 4 nats and is overruled by a few dozen numbers.
DECLARED, DECLARED_TAIL = 0.2, 2.0
# The same of half the largest error that a data sheet states: makers leave themselves room, each his own.
SHEET = 0.5


# The data determine a direction of the base where its prior tells less of it than one part in so many; the prior is
# then made so many times wider.
DETERMINED, WIDER = 100.0, 100.0
# How much noisier than assumed a table is, over the others, is a normal distribution of its logarithm, of which three
# points stand for all: its middle, and so many sigmas to both sides, each with this weight (Gauss and Hermite).
ASIDE, WEIGHT_ASIDE = 3.0**0.5, 1 / 6


@dataclass(frozen=True)
class KnownNoise:
    """What is known of the noise of a coordinate beside the fit.

    declared : sigma of the instrument [m], zero for none
    sheet : largest error that its data sheet states [m], zero for none
    repeats : scatter over repeated poses [m]; freedom : its degrees of freedom, zero for none
    """

    declared: float = 0.0
    sheet: float = 0.0
    repeats: float = 0.0
    freedom: int = 0

    @property
    def stated(self) -> float:
        """Sigma of the instrument as it is declared, or as its data sheet has it: of a limit, half."""
        return self.declared or self.sheet / 2


@dataclass(frozen=True, eq=False)
class Evidence(LinearModel):
    """The linear-Gaussian model of a campaign: residuals of a calibrated robot, the base model and the candidates.

    Blocks are poses; r is measured less modelled position [m], E in m per unit of size.

    Jq : derivative by the joint variables, shape (n, 3, joints)
    known : what is known of the noise beside these residuals
    sigmas : of the instrument, on a grid [m]
    size : of each number in the error that reports tell [m], shape (n, 3), one by default
    alike : number of the unknown point that each pose shares with others, shape (n,), where there are such
    unsure : numbers of a table so few that they tell badly how its noise compares with the others', two tables at most,
        masks of shape (n, 3); likelihoods are averaged over what it may be
    near : numbers of the rhos that are looked at; all of them until an effect of many parameters is in the model
    """

    noise: NoiseModel = field(init=False)
    grid: Grid = field(init=False)
    log_noise: Array | float = field(init=False, default=0.0)
    reference: float = 20e-6
    near: tuple[int, ...] = tuple(range(len(RHOS)))
    Jq: Array = field(kw_only=True)
    known: KnownNoise = field(kw_only=True, default_factory=lambda: KnownNoise())
    sigmas: Array = field(kw_only=True, default_factory=lambda: SIGMAS)
    size: Array | None = field(kw_only=True, default=None)
    alike: Array | None = field(kw_only=True, default=None)
    unsure: tuple[Array, ...] = field(kw_only=True, default=())

    BY_BLOCK: ClassVar[tuple[str, ...]] = ("r", "J", "Jq", "measured", "size", "alike")

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "noise", joint_noise(self.Jq))
        object.__setattr__(self, "grid", Grid(self.sigmas, {REPEATABILITY: RHOS}, KAPPAS))
        object.__setattr__(self, "log_noise", log_known(self, self.Jq))

    def covariance(self, noise: Noise) -> Array:
        """Of the noise of each pose's numbers, shape (n, 3, 3) [m^2]."""
        return self.noise.covariance({REPEATABILITY: noise.repeatability}, noise.sigma)

    def projected(self, rho: float) -> Projection:
        """What makes rows white and orthogonal to the base model; rho : repeatability over sigma [rad/m]."""
        return self.projection({REPEATABILITY: rho})

    def at(self, blocks: Array) -> Self:
        """The problem of some poses."""
        return replace(super().at(blocks), unsure=tuple(mask[blocks] for mask in self.unsure))

    def with_causes_alone(self, columns: Array) -> Self:
        """The problem with these columns in the base model and no others, its numbers' noise as it is assumed."""
        alone = self.with_base(columns)
        return replace(alone, E=ArrayColumns(np.zeros((*self.r.shape, 1))), held=None, unsure=())

    def forget(self) -> None:
        """Let go of what takes much memory and would be computed again."""
        self.cache.pop("marginals", None)
        self.__dict__.pop("at_other_ratios", None)

    @cached_property
    def at_other_ratios(self) -> tuple[tuple[float, Evidence], ...]:
        """The problem where tables are finer or noisier over the others than assumed, with the log weight of each.

        The weights make up for the middle's share of the posterior, so that where this is the distribution of
        `ASIDE` the average is the integral (see `averaged`).
        """
        more = []
        for mask in self.unsure:
            numbers = int(mask.sum())
            spread = 1 / np.sqrt(2 * max(numbers * (1 - self.absorbed / max(self.count, 1)), 1.0))
            for aside in (-ASIDE, ASIDE):
                log_times, log_weight = float(aside * spread), float(np.log(WEIGHT_ASIDE) + ASIDE**2 / 2)
                more.append((log_weight - numbers * log_times, self._where_noisier(mask, float(np.exp(log_times)))))
        return tuple(more)

    def _where_noisier(self, mask: Array, times: float) -> Evidence:
        """The problem of numbers that are as noisy as the others once they are divided by this."""
        weight, every = np.where(mask, 1 / times, 1.0), np.arange(len(self.r))
        E = SerialColumns(self.E, every, SerialNoise(np.zeros(len(every)), weight))
        r, J, Jq = self.r * weight, self.J * weight[:, :, None], self.Jq * weight[:, :, None]
        return replace(self, r=r, J=J, Jq=Jq, E=E, unsure=())

    def averaged(self, own: Array, others: Iterable[Array]) -> Array:
        """Log likelihoods averaged over what tables' noise may be over the others'.

        own : at the assumed ratios; others : the same at the other ones, of any one shape
        """
        if not self.unsure:
            return own
        weighed = [a + weight for (weight, _), a in zip(self.at_other_ratios, others, strict=True)]
        return np.asarray(np.logaddexp.reduce([own + np.log(1 - 2 * WEIGHT_ASIDE * len(self.unsure)), *weighed]))

    def log_base(self, also: Array | None = None) -> Array:
        """Log likelihood without a further cause, shape (rhos, sigmas); also : columns that are in the model."""
        own = self.marginals.log_base(NONE if also is None else also)
        return self.averaged(own, (other.log_base(also) for _, other in self.at_other_ratios))

    def log_grids(self, groups: Sequence[Array], also: Array | None = None) -> Array:
        """Log likelihood of each group of columns as a cause, shape (groups, rhos, sigmas, kappas).

        also : columns of causes that are in the model already; they are treated like the base model
        """
        own = self.marginals.log_grids(groups, NONE if also is None else also)
        return self.averaged(own, (other.log_grids(groups, also) for _, other in self.at_other_ratios))

    def look_ahead(self, chosen: Sequence[Array], groups: Sequence[Array]) -> None:
        """Make ready what the groups need when they are judged beside each of the chosen ones."""
        for e in (self, *(other for _, other in self.at_other_ratios)):
            e.marginals.look_ahead(chosen, groups)


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The base model's parameters, and their independent combinations that are in an `Evidence`.

    J, delta0, prior : derivative of the numbers, prior mean less present values and one sigma, shapes (n, 3, P), (P,)
    units : parameters = units @ (combinations, each of one sigma one), shape (P, k)
    still : combinations that move nothing at these poses and are in no problem, shape (P, P - k): they are their
        priors, before and after the data
    """

    J: Array
    delta0: Array
    prior: Array
    units: Array
    still: Array

    def everywhere(self, e: Evidence, poses: Array) -> tuple[Evidence, Array]:
        """A problem of some of the poses with all combinations in it, for other poses than these; and these units."""
        still = self.J[poses] @ self.still
        k = self.units.shape[1]
        J = np.concatenate([e.J[:, :, :k], still, e.J[:, :, k:]], axis=2)
        delta0 = np.concatenate([e.delta0[:k], self._mean(self.still), e.delta0[k:]])
        prior = np.concatenate([e.prior[:k], np.ones(still.shape[2]), e.prior[k:]])
        return replace(e, J=J, delta0=delta0, prior=prior), np.concatenate([self.units, self.still], axis=1)

    def _mean(self, units: Array) -> Array:
        """Prior mean of combinations, which are orthogonal in units of the priors."""
        own = units / self.prior[:, None]
        return np.asarray(own.T @ (self.delta0 / self.prior) / (own**2).sum(axis=0))

    @classmethod
    def restricted(cls, e: Evidence) -> tuple[Evidence, BaseParameters]:
        """The problem in which the numbers that the base model takes tell nothing of the noise, and its parameters.

        Nor do the priors of what the data determine, which grow with the noise: how far a robot departs from them would
        pass for noise. Directions of the parameters, in units of their priors, that the data determine get a wide one.
        """
        A = e.J.reshape(e.r.size, -1) * (e.prior / e.reference)
        # Not of A' A, whose round-off beside a wide prior's direction would pass for what moves a pose.
        _, singular, turned = np.linalg.svd(np.linalg.qr(A, mode="r"))
        square, axes = np.append(singular, np.zeros(len(turned) - len(singular)))[::-1] ** 2, turned[::-1].T.copy()
        # Which way an axis points is a processor's choice, and what is drawn by chance would follow it.
        axes *= np.where(np.cos(np.arange(len(axes))) @ axes < 0, -1.0, 1.0)
        # Where all poses together move by less than the root of this, in sigmas of the noise, by
        # one sigma of the prior, the data tell nothing: of a curve at joint angles that no pose
        # has, say.
        axes, moved = e.prior[:, None] * axes, square > 1e-8
        units = (axes * np.where(square > DETERMINED, WIDER, 1.0))[:, moved]
        base = cls(e.J, e.delta0, e.prior, units, axes[:, ~moved])
        # As one matrix: products of three rows each take three times as long.
        J = (e.J.reshape(-1, len(units)) @ units).reshape(*e.J.shape[:2], units.shape[1])
        own = replace(e, J=J, delta0=base._mean(units), prior=np.ones(units.shape[1]))
        return replace(own, absorbed=own.absorbed_by_base), base


def joint_noise(Jq: Array) -> NoiseModel:
    """White noise, and joints that repeat alike; Jq : by the joint variables, shape (n, 3, joints)."""
    return NoiseModel((Jq.shape[0], Jq.shape[1]), {REPEATABILITY: Jq})


def log_known(e: Evidence, Jq: Array) -> Array:
    """What is known of the noise beside the residuals, as a logarithm, shape (rhos, sigmas).

    What is stated is the instrument's; repeated poses scatter by instrument and joints, which repeat as in Jq.
    """
    scatter, freedom = e.known.repeats, e.known.freedom
    noise = joint_noise(Jq)
    mean = np.array([noise.mean_variance({REPEATABILITY: float(rho)}, max(e.count, 1)) for rho in RHOS])
    total = mean[:, None] * e.sigmas**2
    log = -0.5 * freedom * (np.log(total / e.sigmas[-1] ** 2) + scatter**2 / total)
    if e.known.stated:
        off = np.log(e.sigmas / e.known.stated) / (DECLARED if e.known.declared else SHEET)
        log = log - 0.5 * (DECLARED_TAIL + 1) * np.log1p(off**2 / DECLARED_TAIL)
    return np.asarray(log)
