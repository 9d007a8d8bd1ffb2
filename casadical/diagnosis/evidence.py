"""Linear-Gaussian model of the calibration residuals: base model, candidate effects and noise.

See `casadical.core.linear_gaussian` for the equations. The blocks are the poses; the base model's
parameters form the base, the parameters of the effects are the columns. The noise is the
instrument's white noise plus one component, joint repeatability, which reaches the measured point
through the Jacobian by the joint variables.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import array_columns, serial_columns
from casadical.core.linear_gaussian.marginals import NO_COLUMNS, marginals_of
from casadical.core.linear_gaussian.model import LinearModel
from casadical.core.linear_gaussian.noise import SerialNoise, covariance_of
from casadical.measurements.measurements import Noise

# Grid of the instrument's standard deviation of one coordinate for likelihoods [m].
SIGMA_GRID_M = np.geomspace(3e-6, 300e-6, 33)
# The same grid extended from 1 um to 11 mm [m], for finer or coarser instruments.
WIDE_SIGMA_GRID_M = SIGMA_GRID_M[0] * (SIGMA_GRID_M[-1] / SIGMA_GRID_M[0]) ** (
    np.arange(-8, 58) / (len(SIGMA_GRID_M) - 1)
)
# Grid of the ratio of joint repeatability to the instrument's standard deviation for likelihoods
# [rad/m].
RHO_GRID = np.array([0.0, 0.1, 0.2, 0.4, 0.8, 1.6])
# Grid of kappa, the prior standard deviation of an effect's parameters divided by their typical
# size, over which the likelihood of a candidate is averaged.
KAPPA_GRID = np.array([0.35, 0.7, 1.4, 2.8, 5.6])
# Prior probability of each point of `KAPPA_GRID`.
KAPPA_WEIGHTS = np.array([0.15, 0.25, 0.3, 0.2, 0.1])
# Standard deviation of a coordinate of the tool by joints that repeat to 0.1 mm (ISO 9283), the largest
# figure of common data sheets: the mean plus three standard deviations of the distance are 3.62 of it.
MAX_REPEATABILITY_M = 1e-4 / 3.62


@dataclass(frozen=True)
class NoisePrior:
    """Prior information on the noise of one coordinate, independent of the fit.

    declared : declared standard deviation of the instrument [m], zero if none
    sheet : largest error that the instrument's data sheet states [m], zero if none
    repeats : standard deviation over repeated poses, of instrument and joints together [m]
    freedom : degrees of freedom of `repeats`, zero without repeated poses
    lever : standard deviation of a coordinate by joints that repeat to 1 rad, rms over the poses
        [m]; zero: unknown
    """

    declared: float = 0.0
    sheet: float = 0.0
    repeats: float = 0.0
    freedom: int = 0
    lever: float = 0.0

    @property
    def stated(self) -> float:
        """Return the instrument's declared sigma, else half its data sheet's limit, else 0 [m]."""
        return self.declared or self.sheet / 2


@dataclass(frozen=True, eq=False)
class Evidence(LinearModel):
    """Linear-Gaussian model of a measurement campaign; see `LinearModel` for the other fields.

    Blocks are poses; r is measured minus modelled position [m]; E is in m per typical size of each
    parameter. For other kinds of measurement than positions, 3 stands for the numbers of a pose
    (see `observations`). Grids have the axes rhos (`RHO_GRID`), sigmas and kappas (`KAPPA_GRID`).
    log_noise : log prior of the noise on the grid, shape (rhos, sigmas)
    reference : noise standard deviation at which the prior standard deviations hold [m]; they are
        proportional to the noise
    Jq : Jacobian by the joint variables, the sources of shared noise, shape (n, 3, joints) [m per rad
        or m]
    noise_prior : prior information on the noise
    sigmas : grid of the instrument's standard deviation [m]
    size : factors from residuals to the reported error, (n, 3), zero for angles; None: ones
    stop : index of the robot's stop at which each pose was measured, shape (n,), where several
        targets were measured at one; None where each pose has a stop of its own
    alike : index of the unknown points at which each pose was measured, (n,); None without any
    unsure : masks, shape (n, 3), of the numbers of small tables (two at most) whose noise relative
        to the other tables is uncertain; likelihoods are averaged over it
    near : indices of the points of `RHO_GRID` that are evaluated; all of them until an effect of
        many parameters is in the model
    """

    log_noise: Array | float = field(init=False, default=0.0)
    reference: float = 20e-6
    near: tuple[int, ...] = tuple(range(len(RHO_GRID)))
    Jq: Array = field(kw_only=True)
    noise_prior: NoisePrior = field(kw_only=True, default_factory=lambda: NoisePrior())
    sigmas: Array = field(kw_only=True, default_factory=lambda: SIGMA_GRID_M)
    ratios: Array = field(kw_only=True, default_factory=lambda: RHO_GRID)
    kappas: Array = field(kw_only=True, default_factory=lambda: KAPPA_GRID)
    size: Array | None = field(kw_only=True, default=None)
    stop: Array | None = field(kw_only=True, default=None)
    alike: Array | None = field(kw_only=True, default=None)
    unsure: tuple[Array, ...] = field(kw_only=True, default=())

    BY_BLOCK: ClassVar[tuple[str, ...]] = ("r", "J", "Jq", "measured", "size", "stop", "alike")

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "log_noise", log_noise_prior(self, self.Jq))

    @property
    def poses_per_stop(self) -> float:
        """Return the mean number of poses that share a stop of the robot, 1 without such stops.

        They share the joints' errors there, so that their evidence is that of so many times fewer.
        """
        return 1.0 if self.stop is None else len(self.stop) / len(np.unique(self.stop))

    def covariance(self, noise: Noise) -> Array:
        """Return the noise covariance of each pose's numbers, shape (n, 3, 3) [m^2].

        It includes the instrument's noise and joint repeatability.
        """
        return covariance_of(self.Jq, noise.repeatability, noise.sigma)

    def at(self, blocks: Array) -> Self:
        """Return the model restricted to the poses with these indices."""
        return replace(super().at(blocks), unsure=tuple(mask[blocks] for mask in self.unsure))

    def with_causes_alone(self, columns: Array) -> Self:
        """Return the model with these columns in the base and without candidates.

        The noise ratios of the tables are those assumed (`unsure` is empty).
        """
        alone = self.with_base(columns)
        return replace(alone, E=array_columns(np.zeros((*self.r.shape, 1))), cause_prior=None, unsure=())

    def forget(self) -> None:
        """Delete the large cached results, which are computed again when they are needed."""
        self.cache.pop("marginals", None)
        self.__dict__.pop("at_other_ratios", None)

    @cached_property
    def at_other_ratios(self) -> tuple[tuple[float, Evidence], ...]:
        """Return (log weight, model) at the outer Gauss-Hermite nodes of uncertain noise ratios.

        The nodes are those of a normal density of the log of a small table's noise ratio about its
        assumed value, with the relative error of a sigma estimated from the table alone. Weights
        are divided by it: `averaged` integrates the likelihood under a flat prior. () without any.
        """
        more = []
        for mask in self.unsure:
            numbers = int(mask.sum())
            spread = 1 / np.sqrt(2 * max(numbers * (1 - self.absorbed / max(self.count, 1)), 1.0))
            for aside in (-(3**0.5), 3**0.5):  # outer nodes, each of weight 1/6
                log_times, log_weight = float(aside * spread), float(np.log(1 / 6) + 1.5)
                weight = np.where(mask, 1 / float(np.exp(log_times)), 1.0)
                E = serial_columns(self.E, np.arange(len(self.r)), SerialNoise(np.zeros(len(self.r)), weight))
                r, J, Jq = self.r * weight, self.J * weight[:, :, None], self.Jq * weight[:, :, None]
                more.append((log_weight - numbers * log_times, replace(self, r=r, J=J, Jq=Jq, E=E, unsure=())))
        return tuple(more)

    def averaged(self, own: Array, others: Iterable[Array]) -> Array:
        """Return log likelihoods averaged over the uncertain noise ratios of small tables.

        own : log likelihoods at the assumed ratios, any shape
        others : the same at each model of `at_other_ratios`, in order
        """
        if not self.unsure:
            return own
        weighed = [a + weight for (weight, _), a in zip(self.at_other_ratios, others, strict=True)]
        return np.asarray(np.logaddexp.reduce([own + np.log(1 - len(self.unsure) / 3), *weighed]))

    def log_base(self, also: Array | None = None) -> Array:
        """Return the log of likelihood and noise prior without an additional cause, (rhos, sigmas).

        also : columns of causes that are in the model already; they are marginalised
        """
        own = marginals_of(self).log_base(NO_COLUMNS if also is None else also)
        return self.averaged(own, (other.log_base(also) for _, other in self.at_other_ratios))

    def log_grids(self, groups: Sequence[Array], also: Array | None = None) -> Array:
        """Return the log likelihood with each group of columns as an additional cause.

        Its shape is (groups, rhos, sigmas, kappas); the noise prior is included.
        groups : indices of the columns of each group
        also : columns of causes that are in the model already, marginalised like the base model
        """
        own = marginals_of(self).log_grids(groups, NO_COLUMNS if also is None else also)
        return self.averaged(own, (other.log_grids(groups, also) for _, other in self.at_other_ratios))

    def look_ahead(self, chosen: Sequence[Array], groups: Sequence[Array]) -> None:
        """Cache the products that `log_grids` needs for all groups given each chosen group."""
        for e in (self, *(other for _, other in self.at_other_ratios)):
            marginals_of(e).look_ahead(chosen, groups)


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The base model's P parameters and the k combinations of them that an `Evidence` contains.

    J : Jacobian of the measured numbers by the parameters, shape (n, 3, P)
    delta0 : prior mean minus present value of the parameters, shape (P,) [SI]
    prior : prior standard deviation of the parameters, shape (P,) [SI]
    units : parameters = units @ combinations of prior standard deviation one, shape (P, k)
    still : directions of the parameters that change no measured number and are excluded, shape (P,
        P - k); their posterior is their prior
    """

    J: Array
    delta0: Array
    prior: Array
    units: Array
    still: Array

    def with_all_combinations(self, e: Evidence, poses: Array) -> tuple[Evidence, Array]:
        """Return a model whose base has all P combinations, and these as columns, (P, P) [SI].

        Those that move no pose follow the k that `e` has, a model of the poses `poses` of J.
        """
        still = self.J[poses] @ self.still
        k = self.units.shape[1]
        J = np.concatenate([e.J[:, :, :k], still, e.J[:, :, k:]], axis=2)
        delta0 = np.concatenate([e.delta0[:k], self._mean(self.still), e.delta0[k:]])
        prior = np.concatenate([e.prior[:k], np.ones(still.shape[2]), e.prior[k:]])
        return replace(e, J=J, delta0=delta0, prior=prior), np.concatenate([self.units, self.still], axis=1)

    def _mean(self, units: Array) -> Array:
        """Return the prior mean of k combinations of base parameters, the columns of `units`, (k,).

        The columns are orthogonal after division by the parameters' prior standard deviations.
        """
        own = units / self.prior[:, None]
        return np.asarray(own.T @ (self.delta0 / self.prior) / (own**2).sum(axis=0))

    @classmethod
    def restricted(cls, e: Evidence) -> tuple[Evidence, BaseParameters]:
        """Return the restricted-likelihood (REML) form of a model, and its base parameters.

        Degrees of freedom that the base model absorbs carry no information on the noise. Directions
        of the parameters that the data determine get a wider prior, because priors scale with the
        noise: a robot's departure from them would otherwise count as noise.
        """
        A = e.J.reshape(e.r.size, -1) * (e.prior / e.reference)
        # The singular values are taken of A, not of A' A, whose round-off along a direction with a
        # wide prior would be taken for one that moves a pose.
        _, singular, turned = np.linalg.svd(np.linalg.qr(A, mode="r"))
        square, axes = np.append(singular, np.zeros(len(turned) - len(singular)))[::-1] ** 2, turned[::-1].T.copy()
        # The sign of an axis depends on the processor; fixing it makes random draws reproducible.
        axes *= np.where(np.cos(np.arange(len(axes))) @ axes < 0, -1.0, 1.0)
        # A direction whose prior standard deviation moves all poses together by less than 1e-4
        # noise sigmas is unobservable: a curve at joint angles that no pose has, for example.
        axes, moved = e.prior[:, None] * axes, square > 1e-8
        # The data determine a direction if they carry 100 times the information of its prior, whose
        # standard deviation is then 100 times wider.
        units = (axes * np.where(square > 100.0, 100.0, 1.0))[:, moved]
        base = cls(e.J, e.delta0, e.prior, units, axes[:, ~moved])
        # One matrix product is three times as fast as a product for each pose.
        J = (e.J.reshape(-1, len(units)) @ units).reshape(*e.J.shape[:2], units.shape[1])
        own = replace(e, J=J, delta0=base._mean(units), prior=np.ones(units.shape[1]))
        return replace(own, absorbed=own.absorbed_by_base), base


def log_noise_prior(e: Evidence, Jq: Array) -> Array:
    """Return the log prior density of the noise, up to a constant, shape (rhos, sigmas).

    A declared sigma or data sheet concerns the instrument alone; the standard deviation over
    repeated poses that of the instrument and the joints together. Data sheets of robots state a
    repeatability of 0.01 to 0.1 mm at the tool (ISO 9283, mean plus three standard deviations of
    the distance): the joints' part of a coordinate has a half-normal prior, of which
    `MAX_REPEATABILITY_M`, that of 0.1 mm, is two standard deviations.
    Jq : Jacobian by the joint variables, shape (n, 3, joints)
    """
    scatter, freedom = e.noise_prior.repeats, e.noise_prior.freedom
    # Mean noise variance of the measured rows in units of sigma^2.
    mean = 1 + RHO_GRID**2 * float((Jq**2).sum()) / max(e.count, 1)
    total = mean[:, None] * e.sigmas**2
    joints = e.noise_prior.lever * RHO_GRID[:, None] * e.sigmas
    log = -2.0 * (joints / MAX_REPEATABILITY_M) ** 2
    log = log - 0.5 * freedom * (np.log(total / e.sigmas[-1] ** 2) + scatter**2 / total)
    if e.noise_prior.stated:
        # log(true / declared sigma) has a Student's t prior of scale 0.2: a declaration that is
        # wrong by a factor of three costs 4 nats and is overruled by a few dozen measured numbers.
        # The scale is 0.5 where sigma is half the largest error of a data sheet, because the margin
        # that makers leave differs.
        off = np.log(e.sigmas / e.noise_prior.stated) / (0.2 if e.noise_prior.declared else 0.5)
        # The heavy tails of two degrees of freedom allow for a wrong declaration.
        log = log - 1.5 * np.log1p(off**2 / 2)
    return np.asarray(log)
