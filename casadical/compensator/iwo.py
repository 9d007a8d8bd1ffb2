"""Invasive weed optimisation with an ask-and-tell interface (Mehrabian and Lucas 2006).

It follows the paper's eqs. 13 and 15-17, with errata: the paper dates the method's source 2016; it
is of 2006. Its eq. 17 multiplies the step by K with elements in [0, 1], so that no child is ever
smaller than its parent in any coordinate and the colony drifts into its upper bounds; the source
uses steps of zero mean. ``dispersal="normal"`` follows the source, ``dispersal="literal"`` the
paper as printed. Eqs. 15-16 divide by zero if all members are equally fit; here every member then
counts as a best one. It trains a network alone, or with refinement.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import isfinite
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from casadical.compensator.network import Task
from casadical.compensator.trainers.base import State, Trainer
from casadical.compensator.trainers.levenberg_marquardt import LevenbergMarquardt
from casadical.core.basics import Array, InputError


@dataclass(frozen=True)
class IwoSettings:
    """Settings of the search; the defaults are the paper's (section 4).

    initial : number of members at the start
    maximum : largest number of members that are selected in a generation
    seeds_min : number of children of the worst member
    seeds_max : number of children of the best member
    exponent : exponent with which the steps shrink, eq. 13
    sigma_initial : standard deviation of steps at the start, eq. 13 [unit of the bounds]
    sigma_final : standard deviation of steps at the end, eq. 13 [unit of the bounds]
    lower, upper : bounds of the coordinates, one number for all or one for each
    dispersal : "normal" for steps N(0, sigma), "literal" for the printed sigma * K with K uniform
        in [0, 1]
    iterations : largest number of generations
    target : loss at or below which the search stops; None: none
    patience : number of generations without a lower loss after which the search stops; None: none

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
        """Return the standard deviation of steps in a generation [unit of the bounds] (eq. 13).

        iteration : number of the generation, 0 to `iterations`
        """
        fraction = (self.iterations - iteration) / self.iterations
        return float(fraction**self.exponent * (self.sigma_initial - self.sigma_final) + self.sigma_final)


def seed_counts(losses: Array, seeds_min: int, seeds_max: int) -> Array:
    """Return the number of children of every member, shape (members,) (eqs. 15-16).

    The number falls linearly from the best to the worst finite loss and is rounded down. If all
    losses are equal, or infinite, all count as best; else one that is infinite has `seeds_min`.

    losses : shape (members,)
    seeds_min, seeds_max : numbers of children of the worst and the best member
    """
    best, worst = losses.min(), losses.max()
    if not isfinite(worst):
        finite = losses[np.isfinite(losses)]
        best, worst = finite.min(initial=np.inf), finite.max(initial=-np.inf)
        losses = np.minimum(losses, worst) if best < worst else losses
    ratio = (worst - losses) / (worst - best) if best < worst else losses == losses.min()
    return np.asarray((seeds_min + (seeds_max - seeds_min) * ratio).astype(np.int64))


@dataclass(frozen=True, eq=False)
class IwoResult:
    """Outcome of a search.

    x : best point, shape (dimension,) [unit of the bounds]
    loss : loss at x
    reasons : why the search stopped, as text
    evaluations : number of evaluated points
    history : by generation the number of points evaluated so far ("evaluations"), the loss of the
        "best" and the "worst" member, and the standard deviation of the steps ("sigma") [unit of
        the bounds]
    """

    x: Array
    loss: float
    reasons: tuple[str, ...]
    evaluations: int
    history: dict[str, tuple[float, ...]] = field(repr=False)


class InvasiveWeeds:
    """A search in progress: ``while not search.stop(): search.tell(losses_of(search.ask()))``.

    dimension : number of coordinates
    settings : settings of the search; None: the paper's
    seed : seed of its own random generator
    start : shape (k, dimension): points of the first colony, clipped at the bounds, instead of k of
        its random ones

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
            # A scalar bound stays a scalar, because clipping at it is faster.
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
        """Return the k points to evaluate next, shape (k, dimension) [unit of the bounds].

        They are the first members or the children of the members; they stay the same until `tell`
        is called.
        """
        if self._asked is None and self.iteration < 0:
            missing = max(self.settings.initial - len(self._start), 0)
            random = self._random.uniform(self._lower, self._upper, (missing, self.dimension))
            self._asked = np.concatenate([np.clip(self._start, self._lower, self._upper), random])
        elif self._asked is None:
            self._asked = self._children()
        return self._asked

    def tell(self, losses: ArrayLike) -> None:
        """Record the losses, shape (k,), of the points of `ask`, and select the next members.

        Those of least loss among parents and children are selected; NaN counts as infinite.
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
        """Return the reasons to stop as text; empty as long as the search should continue."""
        reasons, s = [], self.settings
        if self.iteration >= s.iterations:
            reasons.append(f"iterations: all {s.iterations} generations done")
        if s.target is not None and self.losses.min(initial=np.inf) <= s.target:
            reasons.append(f"target: loss {self.losses[0]:.6g} is at or below {s.target:.6g}")
        if s.patience is not None and self._stalled >= s.patience:
            reasons.append(f"patience: no better loss in {self._stalled} generations")
        return tuple(reasons)

    def result(self) -> IwoResult:
        """Return the best point so far with the history.

        Raises InputError: nothing was evaluated yet.
        """
        if self.iteration < 0:
            raise InputError("nothing has been evaluated yet: call ask() and tell() first")
        history = dict(zip(("evaluations", "best", "worst", "sigma"), zip(*self._log, strict=True), strict=True))
        return IwoResult(self.members[0].copy(), float(self.losses[0]), self.stop(), self.evaluations, history)

    def _children(self) -> Array:
        """Return random children of all members, clipped at the bounds, shape (k, dimension)."""
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
    """Return the lowest point of an objective that invasive weed optimisation finds.

    objective : takes points of shape (k, dimension) and returns k losses; with ``vectorised=False``
        one point, shape (dimension,), and returns its loss
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


@dataclass(frozen=True)
class Iwo(Trainer):
    """Invasive weed optimisation of all weights.

    settings : settings of the search
    precision : precision in which the colony's losses are compared, "double" or, in about half the
        time, "single"; weights and all reported losses are double in both
    """

    name: ClassVar[str] = "iwo"
    method: ClassVar[str] = "IWO-NN-SKCM"
    output_scale_mm: ClassVar[float | None] = 1.0  # the paper's

    settings: IwoSettings = field(default_factory=IwoSettings)
    precision: Literal["double", "single"] = "double"

    def __post_init__(self) -> None:
        if self.precision not in ("double", "single"):
            raise InputError(f"precision is 'double' or 'single'; got {self.precision!r}")

    def states(self, task: Task, seed: int) -> Iterator[State]:
        """Yield the state of a search over all weights after each generation."""
        search = InvasiveWeeds(task.layout.count, self.settings, seed=seed)
        kind = np.float32 if self.precision == "single" else np.float64
        compared = Task(task.layout, task.inputs.astype(kind), task.targets.astype(kind), task.scale_mm, task.loss)
        reasons: tuple[str, ...] = ()
        while not reasons:
            search.tell(compared.losses(search.ask().astype(kind, copy=False)))
            reasons = search.stop()
            # The first colony is a generation, too.
            yield State(search.iteration + 1, search.members[0].copy(), reasons)


@dataclass(frozen=True)
class IwoThenLm(Trainer):
    """Invasive weed optimisation followed by Levenberg-Marquardt from its best weights.

    iwo, lm : settings of both parts; ``lm.restarts`` is not used, the ridge is chosen as by `lm`
    """

    name: ClassVar[str] = "iwo-lm"
    method: ClassVar[str] = "IWO-LM-NN-SKCM"

    iwo: Iwo = field(default_factory=Iwo)
    lm: LevenbergMarquardt = field(default_factory=LevenbergMarquardt)

    def states(self, task: Task, seed: int) -> Iterator[State]:
        """Yield the states of the search, and in place of its last one those of the second part."""
        for state in self.iwo.states(task, seed):
            if state.reasons:
                break
            yield state
        for further in self.lm.states(task, seed, starts=state.weights[None]):
            yield further._replace(steps=state.steps + further.steps)
