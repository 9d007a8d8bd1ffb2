"""The linear problem of a campaign: what the base model and the candidate causes do to a calibrated robot's residuals.

It is a linear-Gaussian model (see `casadical.core.linear_gaussian`). Its blocks are the poses; the base model's
parameters are in the base, the parameters of effects are the columns, and beside the instrument's noise there is one
component: joint repeatability, which reaches the measured point through the derivative by the joint variables.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import EVERY, ArrayColumns, Columns, SerialColumns
from casadical.core.linear_gaussian.fit import Fit
from casadical.core.linear_gaussian.grid import Grid
from casadical.core.linear_gaussian.marginals import NONE, Marginals
from casadical.core.linear_gaussian.model import LinearModel, Memory, Projection
from casadical.core.linear_gaussian.noise import NoiseModel, SerialNoise
from casadical.effects.base import CHOSEN
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
# Where all poses together move by less than the root of this, in sigmas of the noise, by one sigma of the prior, the
# data tell nothing: of a curve at joint angles that no pose has, say.
UNMOVED = 1e-8
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


@dataclass(eq=False)
class Cache:
    """What was computed of a problem: its marginal likelihoods, fits by columns and noise, rankings of a search."""

    marginals: Marginals | None = None
    fits: dict[tuple[bytes, Noise], Fit] = field(default_factory=dict)
    rankings: dict[object, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Residuals of a calibrated robot, what the base model and the candidate causes do to them.

    r : measured less modelled position, shape (n, 3) [m]
    J : base model's Jacobian, shape (n, 3, P); Jq : by joint variables, shape (n, 3, joints)
    delta0 : prior mean of the parameters less their present values, shape (P,); prior : one sigma, shape (P,)
    E : columns of all candidates, in m per unit of size: an array, shape (n, 3, columns), or made when asked for
    reference : sigma at which the priors of what is in the model are as given [m]; they grow with the noise
    held : one sigma of each column's parameter once it is in the model, in sizes, shape (columns,); CHOSEN by default
    near : numbers of the rhos that are looked at; all of them until an effect of many parameters is in the model
    known : what is known of the noise beside these residuals
    sigmas : of the instrument, on a grid [m]
    measured : which of a pose's numbers were measured, shape (n, 3), all by default; of other kinds of measurement than
        positions there are others than three, in units in which their noise is alike
    size : of each number in the error that reports tell [m], shape (n, 3), one by default
    alike : number of the unknown point that each pose shares with others, shape (n,), where there are such
    absorbed : numbers that the base model's parameters take, which tell nothing of the noise; with one number at a
        pose they are a large share, and a cause that follows noise would gain by them (compare REML: Harville 1977)
    turn : of the base parameters, shape (P, k): parameters = turn @ (those of the model, each of one sigma one)
    still : directions of the base parameters that move nothing at these poses, which are not in the model, shape
        (P, P - k): they are their priors, before and after the data
    unsure : numbers of a table so few that they tell badly how its noise compares with the others', two tables at most,
        masks of shape (n, 3); likelihoods are averaged over what it may be
    memory : how much is held at a time
    """

    r: Array
    J: Array
    Jq: Array
    delta0: Array
    prior: Array
    E: Array | Columns
    reference: float = 20e-6
    held: Array | None = None
    near: tuple[int, ...] = tuple(range(len(RHOS)))
    known: KnownNoise = field(default_factory=lambda: KnownNoise())
    sigmas: Array = field(default_factory=lambda: SIGMAS)
    measured: Array | None = None
    size: Array | None = None
    alike: Array | None = None
    absorbed: float = 0.0
    turn: Array | None = None
    still: Array | None = None
    unsure: tuple[Array, ...] = ()
    memory: Memory = field(default_factory=Memory)
    cache: Cache = field(init=False, repr=False, default_factory=Cache)

    @property
    def count(self) -> int:
        """How many numbers were measured."""
        return int(self.r.size if self.measured is None else np.count_nonzero(self.measured))

    @property
    def width(self) -> int:
        """Number of columns of all candidates."""
        return int(self.E.shape[2])

    @cached_property
    def model(self) -> LinearModel:
        """The same without the names of things."""
        base, mean, prior = self.J, self.delta0, self.prior
        if self.turn is not None:
            # As one matrix: products of three rows each take three times as long.
            base = (self.J.reshape(-1, len(self.turn)) @ self.turn).reshape(*self.J.shape[:2], self.turn.shape[1])
            prior = np.ones(self.turn.shape[1])
            units = self.turn / self.prior[:, None]  # these are orthogonal
            mean = units.T @ (self.delta0 / self.prior) / (units**2).sum(axis=0)
        columns = ArrayColumns(self.E) if isinstance(self.E, np.ndarray) else self.E
        held = np.full(self.width, CHOSEN) if self.held is None else self.held
        grid, known = Grid(self.sigmas, {REPEATABILITY: RHOS}, KAPPAS), log_known(self, self.Jq)
        return LinearModel(
            self.r, base, mean, prior, columns, held, self.noise, grid, self.reference, self.count, self.absorbed,
            self.near, known, self.memory,
        )  # fmt: skip

    @property
    def noise(self) -> NoiseModel:
        """How the noise of a pose's numbers is made up."""
        return joint_noise(self.Jq)

    def covariance(self, noise: Noise) -> Array:
        """Of the noise of each pose's numbers, shape (n, 3, 3) [m^2]."""
        return self.noise.covariance({REPEATABILITY: noise.repeatability}, noise.sigma)

    def projection(self, rho: float) -> Projection:
        """What makes rows white and orthogonal to the base model; rho : repeatability over sigma [rad/m]."""
        return self.model.projection({REPEATABILITY: rho})

    def restricted(self) -> Evidence:
        """The problem in which the numbers that the base model takes tell nothing of the noise.

        Nor do the priors of what the data determine, which grow with the noise: how far a robot departs from them would
        pass for noise. Directions of the parameters, in units of their priors, that the data determine get a wide one.
        """
        A = self.J.reshape(self.r.size, -1) * (self.prior / self.reference)
        # Not of A' A, whose round-off beside a wide prior's direction would pass for what moves a pose.
        _, singular, turned = np.linalg.svd(np.linalg.qr(A, mode="r"))
        square, axes = np.append(singular, np.zeros(len(turned) - len(singular)))[::-1] ** 2, turned[::-1].T.copy()
        # Which way an axis points is a processor's choice, and what is drawn by chance would follow it.
        axes *= np.where(np.cos(np.arange(len(axes))) @ axes < 0, -1.0, 1.0)
        axes, moved = self.prior[:, None] * axes, square > UNMOVED
        turn = axes * np.where(square > DETERMINED, WIDER, 1.0)
        more = replace(self, turn=turn[:, moved], still=axes[:, ~moved])
        return replace(more, absorbed=more.model.absorbed_by_base)

    @property
    def everywhere(self) -> Evidence:
        """The problem with all directions of the base parameters in the model, for other poses than these."""
        if self.turn is None or self.still is None:
            return self
        return replace(self, turn=np.concatenate([self.turn, self.still], axis=1), still=None)

    def take(self, columns: Array, poses: Array | slice = EVERY) -> Array:
        """Some of the candidates' columns at some poses, shape (poses, 3, len(columns)) [m per unit of size]."""
        return self.model.take(columns, poses)

    def at(self, poses: Array) -> Evidence:
        """The problem of some poses."""
        E = self.E[poses] if isinstance(self.E, np.ndarray) else self.E.at(poses)
        masks = {name: of[poses] for name in ("measured", "size", "alike") if (of := getattr(self, name)) is not None}
        unsure = tuple(of[poses] for of in self.unsure)
        return replace(self, r=self.r[poses], J=self.J[poses], Jq=self.Jq[poses], E=E, unsure=unsure, **masks)

    def with_base(self, columns: Array) -> Evidence:
        """The problem with these columns moved into the base model, as wide as they are held there."""
        return self.with_known(*self.model.as_base(columns)) if len(columns) else self

    def with_known(self, columns: Array, prior: Array) -> Evidence:
        """The problem with further columns in the base model, shape (n, 3, k), of zero mean; prior : shape (k,)."""
        turn, still, more = self.turn, self.still, len(prior)
        if turn is not None:
            rows, axes = turn.shape
            turn = np.pad(turn, (0, more))
            turn[rows:, axes:] = np.diag(prior)
        if still is not None:
            still = np.pad(still, ((0, more), (0, 0)))
        J, delta0 = np.concatenate([self.J, columns], axis=2), np.pad(self.delta0, (0, more))
        return replace(self, J=J, delta0=delta0, prior=np.append(self.prior, prior), turn=turn, still=still)

    @property
    def marginals(self) -> Marginals:
        """Marginal likelihoods of all groups of columns."""
        if self.cache.marginals is None:
            self.cache.marginals = Marginals(self.model)
        return self.cache.marginals

    def extending(self, known: Evidence) -> Evidence:
        """The problem, which takes over what is known of one with the same poses and the first of the columns."""
        if known.cache.marginals is not None:
            self.cache.marginals = known.cache.marginals.extended(self.model)
        return self

    def moving(self, known: Evidence, lost: Evidence, gained: Evidence) -> Evidence:
        """The problem, which takes over what is known of one with some more (lost) and some fewer poses (gained)."""
        if known.cache.marginals is not None:
            self.cache.marginals = known.cache.marginals.moved(self.model, lost.model, gained.model)
        return self

    def forget(self) -> None:
        """Let go of what takes much memory and would be computed again."""
        self.cache.marginals = None
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
        E = SerialColumns(self.model.columns, every, SerialNoise(np.zeros(len(every)), weight))
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
