"""Invasive weed optimisation, ask and tell (paper, eqs. 13 and 15-17; Mehrabian and Lucas 2006).

The paper dates the method's source 2016; it is of 2006. Its eq. 17 multiplies the step by K with elements in [0, 1], so
that no child is ever smaller than its parent in any coordinate and the colony drifts into its upper bounds; the source
uses steps of zero mean. ``dispersal="normal"`` follows the source, ``dispersal="literal"`` the print. Eqs. 15-16 divide
by zero when all members are equally fit; then every member counts as a best one.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import isfinite
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from casadical.core.basics import Array, InputError


@dataclass(frozen=True)
class IwoSettings:
    """Settings of the search; the defaults are the paper's (section 4).

    initial : members at the start
    maximum : members at most
    seeds_min : children of the worst member
    seeds_max : children of the best member
    exponent : of eq. 13
    sigma_initial : of eq. 13, at the start [as of the bounds]
    sigma_final : of eq. 13, at the end [as of the bounds]
    lower, upper : bound of every coordinate, or one a coordinate
    dispersal : "normal" for steps N(0, sigma), "literal" for the printed sigma * K with K uniform in [0, 1]
    iterations : generations at most
    target : loss at which it stops; None: none
    patience : generations in a row without a better loss after which it stops; None: none

    Examples
    --------
    >>> settings = casadical.compensator.IwoSettings(iterations=100)
    >>> settings.sigma(0) > settings.sigma(100)
    True
    """

    initial: int = 10
    maximum: int = 50
    seeds_min: int = 0
    seeds_max: int = 5
    exponent: float = 2.0
    sigma_initial: float = 0.05
    sigma_final: float = 0.0005
    lower: float | tuple[float, ...] = -1.7
    upper: float | tuple[float, ...] = 1.7
    dispersal: Literal["normal", "literal"] = "normal"
    iterations: int = 500
    target: float | None = None
    patience: int | None = None

    def __post_init__(self) -> None:
        if min(self.initial, self.maximum) < 1:
            raise InputError(f"a colony needs at least one member; got {self.initial} and {self.maximum}")
        if not 0 <= self.seeds_min <= self.seeds_max or self.seeds_max < 1:
            raise InputError(f"needs 0 <= seeds_min <= seeds_max and seeds_max >= 1; got {self}")
        if not (self.sigma_initial >= 0 and self.sigma_final >= 0 and self.exponent > 0):
            raise InputError(f"needs sigmas >= 0 and an exponent > 0; got {self}")
        if not np.all(np.asarray(self.lower) <= np.asarray(self.upper)):
            raise InputError(f"lower bounds must not exceed upper ones; got {self.lower} and {self.upper}")
        if self.dispersal not in ("normal", "literal"):
            raise InputError(f"dispersal is 'normal' or 'literal'; got {self.dispersal!r}")
        if self.iterations < 1 or (self.patience is not None and self.patience < 1):
            raise InputError(f"iterations and patience must be at least 1; got {self.iterations}, {self.patience}")

    def sigma(self, iteration: int) -> float:
        """Return the standard deviation of generation ``iteration`` = 0 .. iterations [as of the bounds] (eq. 13)."""
        left = (self.iterations - iteration) / self.iterations
        return float(left**self.exponent * (self.sigma_initial - self.sigma_final) + self.sigma_final)


def seed_counts(losses: Array, seeds_min: int, seeds_max: int) -> Array:
    """Return the number of children of every member (eqs. 15-16); all are best when all losses are equal.

    losses : array, shape (members,). A member whose loss is not finite has the fewest children.
    """
    best, worst = losses.min(), losses.max()
    if not isfinite(worst):
        finite = losses[np.isfinite(losses)]
        best, worst = finite.min(initial=np.inf), finite.max(initial=-np.inf)
        losses = np.minimum(losses, worst) if best < worst else losses
    ratio = (worst - losses) / (worst - best) if best < worst else losses == losses.min()
    return np.asarray((seeds_min + (seeds_max - seeds_min) * ratio).astype(np.int64))


@dataclass(frozen=True)
class IwoHistory:
    """A search's course by generation: evaluations so far, loss of the best and the worst member, step size."""

    evaluations: tuple[int, ...] = ()
    best: tuple[float, ...] = ()
    worst: tuple[float, ...] = ()
    sigma: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class IwoResult:
    """Outcome of a search: best point x, shape (dimension,) [as of the bounds], loss, why it stopped, the course."""

    x: Array
    loss: float
    reasons: tuple[str, ...]
    evaluations: int
    history: IwoHistory = field(repr=False)


class InvasiveWeeds:
    """A search in progress: ``while not search.stop(): search.tell(losses_of(search.ask()))``.

    dimension : number of coordinates
    settings : of the search; None: the paper's
    seed : of its own random generator
    start : shape (k, dimension): members to begin with instead of some of the random ones

    Examples
    --------
    >>> from casadical.compensator import InvasiveWeeds, IwoSettings
    >>> search = InvasiveWeeds(2, IwoSettings(iterations=30))
    >>> while not search.stop():
    ...     search.tell((search.ask() ** 2).sum(axis=1))
    >>> search.result().loss < 1e-2
    True
    """

    def __init__(
        self, dimension: int, settings: IwoSettings | None = None, *, seed: int = 0, start: ArrayLike | None = None
    ):
        self.settings = settings if settings is not None else IwoSettings()
        self.dimension = dimension
        self._random = np.random.default_rng(seed)
        try:
            # One number for all is clipped at faster than an array of them.
            self._lower, self._upper = (np.asarray(b, float) for b in (self.settings.lower, self.settings.upper))
            np.broadcast_to(self._lower + self._upper, (dimension,))
        except ValueError:
            raise InputError(f"bounds must be one number or {dimension}; got {self.settings}") from None
        self.members = np.empty((0, dimension))
        self.losses = np.empty(0)
        self.iteration = -1  # the first colony counts as generation 0
        self.evaluations = 0
        self._stalled = 0
        self._log: list[tuple[int, float, float, float]] = []
        self._asked: Array | None = None
        self._start = np.empty((0, dimension)) if start is None else np.atleast_2d(np.asarray(start, dtype=float))
        if self._start.shape[1] != dimension:
            raise InputError(f"start must have shape (k, {dimension}); its shape is {self._start.shape}")

    def ask(self) -> Array:
        """Return the points to evaluate next, shape (k, dimension) [as of the bounds]; the same ones until told."""
        if self._asked is None and self.iteration < 0:
            missing = max(self.settings.initial - len(self._start), 0)
            random = self._random.uniform(self._lower, self._upper, (missing, self.dimension))
            self._asked = np.concatenate([np.clip(self._start, self._lower, self._upper), random])
        elif self._asked is None:
            self._asked = self._children()
        return self._asked

    def tell(self, losses: ArrayLike) -> None:
        """Take the losses, shape (k,), of the asked points; parents compete. A NaN counts as an infinite loss.

        Raises InputError: no ask() before, or another number of losses.
        """
        if self._asked is None:
            raise InputError("tell() without ask(): call ask() first and tell the losses of its rows")
        new = np.array(losses, dtype=np.float64)
        if new.shape != (len(self._asked),):
            raise InputError(f"one loss for each of the {len(self._asked)} points is needed; got shape {new.shape}")
        if np.isnan(new.sum()):
            new[np.isnan(new)] = np.inf
        before = self.losses[0] if len(self.losses) else np.inf
        merged = np.concatenate([self.losses, new])
        order = merged.argsort(kind="stable")[: self.settings.maximum]
        self.members = np.concatenate([self.members, self._asked])[order]
        self.losses = merged[order]
        sigma = self.settings.sigma(max(self.iteration, 0))
        self.iteration += 1
        self.evaluations += len(new)
        self._stalled = 0 if self.losses[0] < before else self._stalled + 1
        self._log.append((self.evaluations, float(self.losses[0]), float(self.losses[-1]), sigma))
        self._asked = None

    def stop(self) -> tuple[str, ...]:
        """Return the reasons to stop; empty while the search should go on."""
        reasons, s = [], self.settings
        if self.iteration >= s.iterations:
            reasons.append(f"iterations: all {s.iterations} generations done")
        if s.target is not None and self.losses.min(initial=np.inf) <= s.target:
            reasons.append(f"target: loss {self.losses[0]:.6g} is at or below {s.target:.6g}")
        if s.patience is not None and self._stalled >= s.patience:
            reasons.append(f"patience: no better loss in {self._stalled} generations")
        return tuple(reasons)

    def result(self) -> IwoResult:
        """Return the best point so far with the history. Raises InputError: nothing was evaluated yet."""
        if self.iteration < 0:
            raise InputError("nothing has been evaluated yet: call ask() and tell() first")
        history = IwoHistory(*(tuple(column) for column in zip(*self._log, strict=True)))
        return IwoResult(self.members[0].copy(), float(self.losses[0]), self.stop(), self.evaluations, history)

    def _children(self) -> Array:
        s = self.settings
        counts = seed_counts(self.losses, s.seeds_min, s.seeds_max)
        children = self.members.repeat(counts, axis=0)
        draw = self._random.standard_normal if s.dispersal == "normal" else self._random.random
        steps = draw(children.shape)
        steps *= s.sigma(self.iteration)
        children += steps
        np.maximum(children, self._lower, out=children)
        np.minimum(children, self._upper, out=children)
        return children


def iwo_minimise(
    objective: Callable[[Array], ArrayLike],
    dimension: int,
    settings: IwoSettings | None = None,
    *,
    seed: int = 0,
    vectorised: bool = True,
    start: ArrayLike | None = None,
) -> IwoResult:
    """Minimise any objective by invasive weed optimisation; units are those of the objective.

    objective : takes points of shape (k, dimension) and returns k losses; with ``vectorised=False`` one point, shape
        (dimension,), and returns its loss
    dimension, settings, seed, start : as of `InvasiveWeeds`
    vectorised : whether the objective takes all points at once

    Examples
    --------
    >>> found = casadical.compensator.iwo_minimise(lambda x: (x**2).sum(axis=1), 2, seed=1)
    >>> found.loss < 0.1
    True
    """
    search = InvasiveWeeds(dimension, settings, seed=seed, start=start)
    while not search.stop():
        points = search.ask()
        search.tell(objective(points) if vectorised else [objective(point) for point in points])  # type: ignore[arg-type]
    return search.result()
