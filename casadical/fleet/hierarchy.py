"""What robots of one type have in common: empirical Bayes on the departures of their parameters from the drawing.

Robot i departs from the drawing by theta_i ~ N(mu, diag(tau^2)), and its campaign tells of theta_i as an `Estimate`
does. The common departure mu and the spread tau are those of greatest probability, by expectation and maximisation
(Dempster, Laird and Rubin 1977, section 4.5; Efron and Morris 1975); lengths, angles, bars, compliances and harmonics
have each a usual spread, which counts as a few robots (Gelman and Hill 2007, chapter 12), so that few robots do not
make a spread of zero. A parameter with a mean far beyond its standard error is a fault of the drawing; the spread, with
the covariance of the mean, is the prior of a robot that is still to be measured.

Drawings: where a parameter stands in a robot file, and types whose drawings are nearly one.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations, islice
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from casadical.core.basics import Array, CasadicalError, InputError
from casadical.core.linear_gaussian.normal_equations import inverse_of
from casadical.core.parameters import Parameter
from casadical.core.reading import load_toml
from casadical.core.telling.plain import WRITTEN, Key, written
from casadical.project.problem import read_problem_robot
from casadical.project.problem_file import problem_file
from casadical.robot.robot import Covariance, Knowledge, Robot

# Robots of a type from which anything is learnt, and most that are used.
LEAST, MOST = 5, 1000
# Robots whose matrices are in memory at a time.
BLOCK = 25
# So many robots the usual spread of the parameters of one group counts for.
POOLED = 4.0
# A common fault is this many standard errors from zero, and this share of the usual size of the parameter (1 mm).
SURE, COUNTS = 5.0, 0.05
# Least spread, in units of the scale: what is learnt of few robots is not exact.
NARROWEST = 1e-3


@dataclass(frozen=True, eq=False)
class Common:
    """What robots of one type share.

    type : word for the drawing
    count : robots it was learnt from
    names : parameters, k of them
    mean : Array, shape (k,): common departure from the drawing, in units of the scale
    std_error : Array, shape (k,): of the mean
    spread : Array, shape (k,): one sigma of single robots about the mean
    scale : Array, shape (k,) [SI]: unit of each parameter
    covariance : Array, shape (k, k): of the mean
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("common_faults", lambda common: [name for name, _, _ in common.faults]),
        Key(
            "parameters",
            lambda common: [
                dict(zip(("name", "mean", "std_error", "spread", "unit"), row, strict=True)) for row in common.rows
            ],
        ),
    )

    type: str = field(metadata=WRITTEN)
    name: str = field(metadata=WRITTEN)
    count: int = field(metadata=written("robots"))
    names: tuple[str, ...]
    mean: Array
    std_error: Array
    spread: Array
    scale: Array
    covariance: Array

    @property
    def faults(self) -> tuple[tuple[str, float, float], ...]:
        """(name, departure, standard error) in units of the scale, of what all robots have in common."""
        far = (np.abs(self.mean) > SURE * self.std_error) & (np.abs(self.mean) > COUNTS)
        return tuple((self.names[k], float(self.mean[k]), float(self.std_error[k])) for k in np.flatnonzero(far))

    def readable(self, name: str, *values: float) -> tuple[Any, ...]:
        """Values of a parameter from units of its scale to those of reports, with the unit."""
        unit = "deg" if name.startswith(("alpha", "beta", "theta")) or "." in name else "mm"
        factor = {"deg": np.rad2deg(1.0), "mm": 1e3}[unit]
        if name.startswith("c") and name[1:].isdigit():
            unit, factor = "urad/(N m)", 1e6
        scale = float(self.scale[self.names.index(name)])
        return (*(v * scale * factor for v in values), unit)

    @property
    def rows(self) -> list[tuple[Any, ...]]:
        """Name, mean, standard error, spread and unit of each parameter, as reported."""
        every = zip(self.names, self.mean, self.std_error, self.spread, strict=True)
        return [(name, *self.readable(name, *figures)) for name, *figures in every]

    def prior_of(self, robot: Robot) -> Robot:
        """A drawn robot with the common departures, their spread as covariance: for `calibrate --prior-effects all`."""
        own = [k for k, n in enumerate(self.names) if n in robot.parameters.names]
        names = tuple(self.names[k] for k in own)
        scale = self.scale[own]
        mean = scale * self.mean[own]
        values = {n: robot.parameters[n].value + d for n, d in zip(names, mean, strict=True)}
        C = self.covariance[np.ix_(own, own)] + np.diag(self.spread[own] ** 2)
        # What the fleet could not determine stays as drawn: the others carry its share.
        held = [p for p in robot.parameters if p.group in ("geometry", "loop", "compliance") and p.name not in names]
        blocks = [Covariance(names, (C + C.T) / 2 * np.outer(scale, scale))]
        blocks += [Covariance((p.name,), np.array([[(NARROWEST * p.scale) ** 2]])) for p in held]
        known = Knowledge(tuple(blocks), f"{self.count} robots of the fleet", robots=self.count)
        return replace(robot.with_values(values), knowledge=known)


def common_of(rows: Iterable[Mapping[str, Any]]) -> Common:
    """What robots of one type share, from their rows in a store. Raises InputError where they are too few."""
    H, b = [], []
    first: dict[str, Any] = {}
    identified: Counter[str] = Counter()
    for row in islice(rows, MOST):
        first = first or {k: row[k] for k in ("type", "type_name", "names", "spread", "scale")}
        place = {n: k for k, n in enumerate(row["names"])}
        order = [place[n] for n in first["names"]]
        lower = _numbers(len(order))[np.ix_(order, order)][np.tril_indices(len(order))]
        H.append(np.asarray(row["information"])[lower])
        b.append(np.asarray(row["score"])[order])
        identified.update(row["identified"])
    if len(H) < LEAST:
        raise InputError(f"{len(H)} robots of one type; {LEAST} are needed to learn what they have in common")
    # Of parameters that few robots identified, the drawing's value is kept: others carry their share.
    kept = [k for k, n in enumerate(first["names"]) if "." in n or identified[n] > len(H) / 2]
    own = tuple(str(first["names"][k]) for k in kept)
    spread, scale = (np.asarray(first[column])[kept] for column in ("spread", "scale"))
    at = _numbers(len(first["names"]))[np.ix_(kept, kept)]
    mean, C, tau = learnt(H, np.array(b)[:, kept], np.minimum(spread, 3.0), at, [_group(n) for n in own])
    return Common(str(first["type"]), str(first["type_name"]), len(H), own, mean, np.sqrt(np.diag(C)), tau, scale, C)


def _numbers(k: int) -> Array:
    """Which number of a packed lower triangle stands where in the symmetric matrix, shape (k, k)."""
    numbers = np.zeros((k, k), dtype=int)
    rows, columns = np.tril_indices(k)
    numbers[rows, columns] = numbers[columns, rows] = np.arange(len(rows))
    return numbers


def _group(name: str) -> str:
    """Parameters with a common usual spread: harmonics of one order, angles, bars, compliances, lengths."""
    if "." in name:
        return f"harmonic {name.rsplit('.', 1)[1][1:].split('_')[0]}"
    if name.startswith(("alpha", "beta", "theta")):
        return "angle"
    return name[0] if name[0] in "cL" else "length"


def learnt(
    H: Sequence[Array], b: Array, spread: Array, at: Array | None = None, groups: Sequence[str] | None = None
) -> tuple[Array, Array, Array]:
    """Mean, shape (k,), its covariance, and spread, (k,), of n robots.

    H : information of each robot, its lower triangle packed; b : their scores, (n, k); at : which packed number stands
    where in the matrix, (k, k); None: of the whole triangle
    spread : to begin with, and one sigma of the mean before the data; groups : of parameters with a usual spread, else
    each has its own
    """
    mean, tau2 = np.zeros(len(spread)), spread**2
    wide = spread**-2.0
    C = np.zeros((len(spread), len(spread)))
    _, group = np.unique(np.arange(len(spread)) if groups is None else groups, return_inverse=True)
    at = _numbers(len(spread)) if at is None else at
    for _ in range(300):
        w = 1 / tau2
        whole, informed, squares = np.zeros_like(C), np.zeros_like(mean), np.zeros_like(mean)
        for some in (slice(k, k + BLOCK) for k in range(0, len(H), BLOCK)):
            V = np.array([inverse_of(own[at] + np.diag(w)) for own in H[some]])
            whole += V.sum(axis=0)
            informed += np.einsum("nij,nj->i", V, b[some])
            m = np.einsum("nij,nj->ni", V, b[some] + mean * w)
            own = np.diagonal(V, axis1=1, axis2=2)
            # The last term: robots move the mean towards themselves, five of them by a tenth of their spread.
            squares += np.sum((m - mean) ** 2 + own + (1 - own * w) ** 2 * np.diag(C), axis=0)
        # The mean of greatest likelihood: theta_i integrated, each robot tells P - P V P of it, P = diag(w).
        C = inverse_of(np.diag(len(H) * w + wide) - np.outer(w, w) * whole)
        mean = C @ (w * informed)
        usual = (np.bincount(group, squares) / np.bincount(group))[group]
        before, tau2 = tau2, np.maximum((squares + POOLED * usual / len(H)) / (len(H) + POOLED), NARROWEST**2)
        # The spread of a parameter does not change by more in the last round.
        if np.abs(np.log(tau2 / before)).max() < 1e-3:
            break
    return mean, C, np.sqrt(tau2)


# Key of a number in a row of a robot file; the first four belong to the row after the number in their name.
_KEYS = {"alpha": "alpha_deg", "a": "a_mm", "beta": "beta_deg", "b": "b_mm", "theta": "theta_deg", "d": "d_mm"}
_BARS = {"L5": "crank_mm", "L4": "coupler_mm", "L3": "rocker_mm"}


@dataclass(frozen=True, eq=False)
class Drawing:
    """A robot as drawn; standard : whether its file has standard DH rows, None where it has none (URDF)."""

    name: str
    count: int
    robot: Robot
    standard: bool | None

    @property
    def robots(self) -> str:
        """How many there are, in words."""
        return f"{self.count} robot{'s' * (self.count > 1)}"

    def correction(self, common: Common, name: str, near: Sequence[Drawing] = ()) -> str:
        """What to write for a parameter, and where, as "[[joint]] 4: d_mm = 1199.7 (drawn 1200)"; or nothing.

        near : drawings that are nearly this one; the value of one that would be no fault is taken, so that all are one
        """
        if self.standard is None or name not in self.robot.parameters.names:
            return ""
        drawn, k = self.robot.parameters[name].value, common.names.index(name)
        new = drawn + common.mean[k] * common.scale[k]
        good = max(SURE * common.std_error[k], COUNTS) * common.scale[k]
        taken = next((other for other in near if abs(other.robot.parameters[name].value - new) <= good), None)
        new, said = (taken.robot.parameters[name].value, f"; {taken.robots} so") if taken else (new, "")
        place = re.fullmatch(r"(L[345])(?:_(\d+))?|([a-z]+)(\d+)", name)
        if not place or (place[3] == "beta" and self.standard):
            return ""
        if place[3] == "c":
            turning = self.robot.joints[int(place[4]) - 1].kind == "revolute"
            key = "stiffness_Nm_per_rad" if turning else "stiffness_N_per_m"
            given = f"{1 / drawn:.6g}" if drawn else "no number"
            number = f"{1 / new:.12g}" if taken else f"{float(f'{1 / new:.3g}'):.0f}"
            return f"[[joint]] {place[4]}: {key} = {number} (drawn {given}{said})" if new > 0 else ""
        if place[1]:
            key, where = _BARS[place[1]], f"[[four_bar]] {place[2] or 1}"
        else:
            key = _KEYS[place[3]]
            where = f"[[joint]] {int(place[4]) + (place[3] in ('alpha', 'a', 'beta', 'b') and not self.standard)}"
        factor = 1e3 if key.endswith("mm") else np.rad2deg(1.0)
        digits = max(0, int(np.ceil(-np.log10(common.std_error[k] * common.scale[k] * factor))))
        number = f"{factor * new:.12g}" if taken else f"{factor * new:.{min(digits, 6)}f}"
        return f"{where}: {key} = {number} (drawn {factor * drawn:.9g}{said})"


def drawings_of(good: pd.DataFrame) -> dict[str, Drawing]:
    """Drawings by the word for their type, of the types of which there are most robots; those that can be read."""
    drawings = {}
    # Types whose drawings are read, the largest first.
    for kind, count in good["type"].value_counts().head(100).items():
        row = good[good["type"] == kind].iloc[0]
        with suppress(CasadicalError, OSError):
            path = Path(row["folder"]) / problem_file(Path(row["folder"])).robot
            rows = None if path.suffix == ".urdf" else load_toml(path)
            standard = None if rows is None else rows.get("convention") == "standard"
            robot = read_problem_robot(row["folder"])
            drawings[str(kind)] = Drawing(str(row["type_name"]), int(count), robot, standard)
    return drawings


def near(drawings: Mapping[str, Drawing], kind: str) -> list[Drawing]:
    """Drawings that are nearly that of a type, of which there are most robots first."""
    return [other for other in drawings.values() if _differences(drawings[kind], other)]


def nearly_one(drawings: Mapping[str, Drawing]) -> Iterator[str]:
    """In words, types whose drawings differ in few values, as where they are corrected one robot at a time."""
    for (first, one), (second, other) in combinations(drawings.items(), 2):
        if pairs := _differences(one, other):
            both = ((p, f"{p.readable(p.value):.9g} and {p.readable(q.value):.9g}") for p, q in pairs)
            words = ", ".join(f"{p.name} ({values} {p.readable_unit})" for p, values in both)
            names = (f"{d.name}, drawing {kind} ({d.robots})," for kind, d in ((first, one), (second, other)))
            yield f"types {' and '.join(names)} differ only in {words}: corrected one by one? Then correct all of them"


def _differences(one: Drawing, other: Drawing) -> list[tuple[Parameter, Parameter]]:
    """In which parameters two drawings that are nearly one differ; none where they are others, or the same."""
    first, second = ([p for p in d.robot.parameters if p.group not in ("base", "tool")] for d in (one, other))
    if [p.name for p in first] != [p.name for p in second]:
        return []
    pairs = [(p, q) for p, q in zip(first, second, strict=True) if f"{p.value:.9g}" != f"{q.value:.9g}"]
    # Two drawings are nearly one where so many nominal values differ at most, each by so many sigma
    # of its prior.
    return pairs if len(pairs) <= 3 and all(abs(q.value - p.value) <= 5.0 * p.prior for p, q in pairs) else []
