"""Knowledge of a robot besides its values: covariances, the range of the data, a bound of the error that remains."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby

import numpy as np

from casadical.core.basics import Array, InputError

# Parameters whose covariances are kept in one block; of more, those of each effect have their own.
ONE_BLOCK = 120
# What rounding may make of a least eigenvalue of zero, in correlations.
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Covariance:
    """Of parameters with these names, matrix of shape (k, k) [SI]; uncorrelated with all others.

    Raises InputError for a matrix that is not symmetric and positive semidefinite.
    """

    names: tuple[str, ...]
    matrix: Array

    def __post_init__(self) -> None:
        k, C = len(self.names), self.matrix
        some = f"covariance of {', '.join(self.names[:3])}{', ...' if k > 3 else ''}"
        if C.shape != (k, k) or not np.isfinite(C).all():
            raise InputError(f"{some}: shape {C.shape} for {k} names; a finite matrix of shape ({k}, {k}) is allowed")
        if len(set(self.names)) < k:
            raise InputError(f"{some}: {next(n for n in self.names if self.names.count(n) > 1)} is named twice")
        for name, variance in zip(self.names, np.diag(C), strict=True):
            if variance < 0:
                raise InputError(f"{some}: the variance of {name} is {variance:.6g}; it must be zero or more")
        scale = np.sqrt(np.diag(C))
        correlation = C / np.outer(*[np.where(scale > 0, scale, 1.0)] * 2)
        if not np.allclose(correlation, correlation.T, rtol=0, atol=ROUNDING):
            raise InputError(f"{some}: it is not symmetric")
        least = float(np.linalg.eigvalsh(correlation)[0]) if k else 0.0
        if least < -ROUNDING * k:
            raise InputError(
                f"{some}: the least eigenvalue of its correlations is {least:.3g}; a covariance has none below zero"
            )

    def only(self, names: Iterable[str]) -> Covariance:
        """Of some of the parameters, the others unknown."""
        wanted = set(names)
        which = [k for k, name in enumerate(self.names) if name in wanted]
        return Covariance(tuple(self.names[k] for k in which), self.matrix[np.ix_(which, which)])


@dataclass(frozen=True, eq=False)
class Knowledge:
    """How well a robot's values are known, and where they were learnt.

    covariance : blocks, which share no parameter; campaign : name of the measurements; poses : how many were used
    readings : least and greatest reading of each joint, shape (n, 2) [rad or m]; shape (0, 2) where it is not known
    conditions : least and greatest value of logged and derived columns, by name
    misfit : how many times greater the variances are, seen as what may differ in another campaign (see
        `casadical.identification.misfit`)
    robots : how many robots of one type it was learnt from: the values are theirs in common, the covariance is how they
        differ; 0: from this very robot
    Raises InputError for a parameter in two blocks and for ranges the wrong way round.
    """

    covariance: tuple[Covariance, ...] = ()
    campaign: str = ""
    poses: int = 0
    readings: Array = field(default_factory=lambda: np.zeros((0, 2)))
    conditions: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    misfit: float = 1.0
    robots: int = 0

    def __post_init__(self) -> None:
        names = [name for block in self.covariance for name in block.names]
        if len(set(names)) < len(names):
            twice = next(n for n in names if names.count(n) > 1)
            raise InputError(f"covariance: {twice} is in two blocks; one is allowed")
        ranges = {f"q{i}": r for i, r in enumerate(self.readings, 1)} | dict(self.conditions)
        for name, (low, high) in ranges.items():
            if not low <= high:
                raise InputError(f"range of {name}: [{low:.6g}, {high:.6g}]; the lower one must come first")

    @cached_property
    def std_errors(self) -> dict[str, float]:
        """Standard errors of the parameters that have a covariance [SI]."""
        return {
            name: float(np.sqrt(variance))
            for block in self.covariance
            for name, variance in zip(block.names, np.diag(block.matrix), strict=True)
        }

    def without(self, names: Iterable[str]) -> Knowledge:
        """The same, nothing known of the covariance of these parameters."""
        gone = set(names)
        blocks = (block.only(set(block.names) - gone) for block in self.covariance)
        return replace(self, covariance=tuple(block for block in blocks if block.names))

    def joined(self, later: Knowledge) -> Knowledge:
        """What a later campaign left of the covariance, learnt on the ranges of both."""
        if not (len(self.readings) and len(later.readings)):
            return later
        both = np.stack([self.readings, later.readings])
        readings = np.column_stack([both[:, :, 0].min(axis=0), both[:, :, 1].max(axis=0)])
        conditions = {**self.conditions, **later.conditions}
        for name in set(self.conditions) & set(later.conditions):
            (low, high), (least, most) = self.conditions[name], later.conditions[name]
            conditions[name] = min(low, least), max(high, most)
        campaign = ", ".join(filter(None, (self.campaign, later.campaign)))
        return Knowledge(later.covariance, campaign, self.poses + later.poses, readings, conditions)


@dataclass(frozen=True, eq=False)
class ErrorBound:
    """Of the distance between the measured point of the real and of the calibrated robot; see `robot.error_bound`.

    names : parameters of `doubted(robot)`; factor : root of their second moment M, shape (k, r) [SI], M = F F'
    rest : root mean square of the distance that no parameter explains [m]
    times : the 95 % quantile of distance / sqrt(rest^2 + tr(J M J')) at held-out poses
    poses : how many there were

    Raises InputError for numbers that are not finite, sizes that are not positive, and shapes that do not fit.
    """

    names: tuple[str, ...]
    factor: Array
    rest: float
    times: float
    poses: int

    def __post_init__(self) -> None:
        shape = self.factor.shape
        if len(shape) != 2 or shape[0] != len(self.names) or not np.isfinite(self.factor).all():
            raise InputError(f"bound: factor of shape {shape}; it must have a row of finite numbers for each name")
        for name in ("rest", "times"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"bound: {name} = {value}; it must be a positive number")


def blocks(names: Sequence[str], owners: Sequence[str], matrix: Array) -> tuple[Covariance, ...]:
    """A covariance, shape (k, k) [SI], as one block, or as one for each owner where that would be large.

    owners : of each parameter, the label of its effect, or "" of the base model
    A parameter without a variance (NaN, as at a bound) is left out.
    """
    known = [k for k, variance in enumerate(np.diag(matrix)) if np.isfinite(variance)]
    parts = [known]
    if len(known) > ONE_BLOCK:
        parts = [list(part) for _, part in groupby(sorted(known, key=owners.__getitem__), key=owners.__getitem__)]
    symmetric = (matrix + matrix.T) / 2
    return tuple(Covariance(tuple(names[k] for k in p), symmetric[np.ix_(p, p)]) for p in parts if len(p))
