"""Hierarchical model of the robots of one type: empirical Bayes on deviations from the drawing.

Robot i deviates from the drawing by theta_i ~ N(mu, diag(tau^2)), and its campaign gives
information on theta_i as an `Estimate` does. The mean deviation mu and the spread tau are the most
probable ones, by expectation and maximisation (Dempster, Laird and Rubin 1977, section 4.5; Efron
and Morris 1975). Parameters of one group (lengths, angles, bars, compliances, harmonics) have a
usual spread, which counts as much as a few robots (Gelman and Hill 2007, chapter 12), so that few
robots do not give a spread of zero. A parameter whose mean is far beyond its standard error is a
fault of the drawing. The spread, with the covariance of the mean, is the prior of a robot that is
still to be measured.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from casadical.core.basics import Array, CasadicalError, InputError
from casadical.core.linear_gaussian.normal_equations import inverse_of
from casadical.core.reading import load_toml
from casadical.core.reporting.plain import WRITTEN, Key, written
from casadical.project.problem import read_problem_robot
from casadical.project.problem_file import problem_file
from casadical.robot.robot import Covariance, Knowledge, Robot

# Smallest number of robots of a type from which their common deviations are estimated.
MIN_ROBOTS_PER_TYPE = 5
# Smallest standard deviation of a parameter between robots, in units of its scale: a few robots
# cannot show that a parameter is exactly the same in all. It is the prior standard deviation, too,
# of parameters that the fleet did not determine.
MIN_SPREAD = 1e-3


@dataclass(frozen=True, eq=False)
class Common:
    """What the robots of one type have in common.

    type : key of the type, as of `run.type_of`
    name : name of the type
    count : number of robots from which it was estimated
    names : names of the k parameters
    mean : mean deviation of the robots from the drawing, shape (k,), in units of `scale`
    std_error : standard error of the mean, shape (k,), in units of `scale`
    spread : standard deviation of single robots about the mean, shape (k,), in units of `scale`
    scale : unit of each parameter, shape (k,) [SI]
    covariance : covariance of the mean, shape (k, k), in units of `scale`
    sliding : names of the compliances of prismatic joints
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
    sliding: frozenset[str] = frozenset()

    @property
    def faults(self) -> tuple[tuple[str, float, float], ...]:
        """Return (name, mean deviation, std error) [scale] of parameters wrong in the drawing."""
        # A fault exceeds five standard errors, and 0.05 of the scale, for example 1 mm or 1 mrad.
        far = (np.abs(self.mean) > 5.0 * self.std_error) & (np.abs(self.mean) > 0.05)
        return tuple((self.names[k], float(self.mean[k]), float(self.std_error[k])) for k in np.flatnonzero(far))

    def readable(self, name: str, *values: float) -> tuple[Any, ...]:
        """Return values of a parameter in the unit of reports, then that unit.

        The unit is deg, mm, or urad/(N m) for a compliance, um/N for that of a prismatic joint.

        values : in units of the parameter's scale
        """
        unit = "deg" if name.startswith(("alpha", "beta", "theta")) or "." in name else "mm"
        factor = {"deg": np.rad2deg(1.0), "mm": 1e3}[unit]
        if name.startswith("c") and name[1:].isdigit():
            unit, factor = "um/N" if name in self.sliding else "urad/(N m)", 1e6
        scale = float(self.scale[self.names.index(name)])
        return (*(v * scale * factor for v in values), unit)

    @property
    def rows(self) -> list[tuple[Any, ...]]:
        """Return (name, mean, standard error, spread, unit) of each parameter, as of `readable`."""
        every = zip(self.names, self.mean, self.std_error, self.spread, strict=True)
        return [(name, *self.readable(name, *figures)) for name, *figures in every]

    def prior_of(self, robot: Robot) -> Robot:
        """Return the expected robot of the type, as the prior of `calibrate --prior-effects all`.

        Its values are those of the drawing plus the mean deviations; its covariance is that of the
        mean plus the variance between robots. Geometry, bars and compliances that the fleet did not
        determine stay as drawn, with a standard deviation of `MIN_SPREAD` times their scale.

        robot : robot as drawn, with the nominal values of the type
        """
        own = [k for k, n in enumerate(self.names) if n in robot.parameters.names]
        names = tuple(self.names[k] for k in own)
        scale = self.scale[own]
        mean = scale * self.mean[own]
        values = {n: robot.parameters[n].value + d for n, d in zip(names, mean, strict=True)}
        C = self.covariance[np.ix_(own, own)] + np.diag(self.spread[own] ** 2)
        # Parameters that the fleet could not determine stay as drawn: others include their effect.
        fixed = [p for p in robot.parameters if p.group in ("geometry", "loop", "compliance") and p.name not in names]
        blocks = [Covariance(names, (C + C.T) / 2 * np.outer(scale, scale))]
        blocks += [Covariance((p.name,), np.array([[(MIN_SPREAD * p.scale) ** 2]])) for p in fixed]
        knowledge = Knowledge(tuple(blocks), f"{self.count} robots of the fleet", robots=self.count)
        return replace(robot.with_values(values), knowledge=knowledge)


def common_of(rows: Iterable[Mapping[str, Any]]) -> Common:
    """Return what robots of one type have in common, from their rows in a store.

    It is about the parameters that more than half of the robots identified, and about all those of
    effects and harmonics; of more than 1000 robots the first 1000 count.

    Raises InputError: fewer than `MIN_ROBOTS_PER_TYPE` robots.
    """
    H, b = [], []
    first: dict[str, Any] = {}
    identified: Counter[str] = Counter()
    # The first 1000 robots of a type are used; the others in the store are ignored.
    for row in islice(rows, 1000):
        first = first or {k: row[k] for k in ("type", "type_name", "names", "spread", "scale")}
        place = {n: k for k, n in enumerate(row["names"])}
        order = [place[n] for n in first["names"]]
        lower = _packed_places(len(order))[np.ix_(order, order)][np.tril_indices(len(order))]
        H.append(np.asarray(row["information"])[lower])
        b.append(np.asarray(row["score"])[order])
        identified.update(row["identified"])
    if len(H) < MIN_ROBOTS_PER_TYPE:
        raise InputError(
            f"{len(H)} robots of one type; {MIN_ROBOTS_PER_TYPE} are needed to learn what they have in common"
        )
    # Parameters that few robots identified keep the drawing's value: others include their effect.
    used = [k for k, n in enumerate(first["names"]) if "." in n or identified[n] > len(H) / 2]
    own = tuple(str(first["names"][k]) for k in used)
    spread, scale = (np.asarray(first[column])[used] for column in ("spread", "scale"))
    at = _packed_places(len(first["names"]))[np.ix_(used, used)]
    mean, C, tau = population_of(H, np.array(b)[:, used], np.minimum(spread, 3.0), at, [_spread_group(n) for n in own])
    return Common(str(first["type"]), str(first["type_name"]), len(H), own, mean, np.sqrt(np.diag(C)), tau, scale, C)


def _packed_places(k: int) -> Array:
    """Return the place of each entry of a symmetric k x k matrix in its packed form, shape (k, k).

    The packed form is the lower triangle row by row, k (k + 1) / 2 numbers.
    """
    numbers = np.zeros((k, k), dtype=int)
    rows, columns = np.tril_indices(k)
    numbers[rows, columns] = numbers[columns, rows] = np.arange(len(rows))
    return numbers


def _spread_group(name: str) -> str:
    """Return the group of a parameter; the spreads of one group are pulled towards their mean.

    The groups are "harmonic N" for each order N, "angle", "L" (bars of four-bars), "c"
    (compliances) and "length". Other parameters of effects have a group "harmonic", too.
    """
    if "." in name:
        return f"harmonic {name.rsplit('.', 1)[1][1:].split('_')[0]}"
    if name.startswith(("alpha", "beta", "theta")):
        return "angle"
    return name[0] if name[0] in "cL" else "length"


def population_of(
    H: Sequence[Array], b: Array, spread: Array, at: Array | None = None, groups: Sequence[str] | None = None
) -> tuple[Array, Array, Array]:
    """Return the mean, (k,), its covariance, (k, k), and the spread, (k,), of n robots' parameters.

    The spread is the standard deviation of single robots about the mean. All are in units of scale.

    H : for each robot the packed lower triangle of its information matrix about the nominal values
    b : scores of the robots at the nominal values, shape (n, k)
    spread : start of the iteration, and prior standard deviation of the mean, shape (k,)
    at : index in the packed triangle of each entry of the k parameters' matrix, shape (k, k); None:
        the triangle is that of the k parameters alone
    groups : name of each parameter's group, see `_spread_group`; None: each is a group of its own
    """
    mean, tau2 = np.zeros(len(spread)), spread**2
    wide = spread**-2.0
    C = np.zeros((len(spread), len(spread)))
    _, group = np.unique(np.arange(len(spread)) if groups is None else groups, return_inverse=True)
    at = _packed_places(len(spread)) if at is None else at
    # Number of robots whose information matrices are inverted and in memory at a time.
    robots_per_block = 25
    # Weight, as a number of robots, of the mean variance of a parameter's group (see
    # `_spread_group`) in the estimate of that parameter's own variance between robots.
    robots_in_usual_spread = 4.0
    for _ in range(300):
        w = 1 / tau2
        whole, informed, squares = np.zeros_like(C), np.zeros_like(mean), np.zeros_like(mean)
        for some in (slice(k, k + robots_per_block) for k in range(0, len(H), robots_per_block)):
            V = np.array([inverse_of(own[at] + np.diag(w)) for own in H[some]])
            whole += V.sum(axis=0)
            informed += np.einsum("nij,nj->i", V, b[some])
            m = np.einsum("nij,nj->ni", V, b[some] + mean * w)
            own = np.diagonal(V, axis1=1, axis2=2)
            # The last term corrects that each robot moves the mean towards itself, which shrinks
            # the spread of five robots by a tenth.
            squares += np.sum((m - mean) ** 2 + own + (1 - own * w) ** 2 * np.diag(C), axis=0)
        # With theta_i marginalised, each robot has the information P - P V P on the mean, P =
        # diag(w).
        C = inverse_of(np.diag(len(H) * w + wide) - np.outer(w, w) * whole)
        mean = C @ (w * informed)
        usual = (np.bincount(group, squares) / np.bincount(group))[group]
        before, tau2 = (
            tau2,
            np.maximum(
                (squares + robots_in_usual_spread * usual / len(H)) / (len(H) + robots_in_usual_spread), MIN_SPREAD**2
            ),
        )
        # Iteration ends when no variance between robots changes by more, relatively.
        if np.abs(np.log(tau2 / before)).max() < 1e-3:
            break
    return mean, C, np.sqrt(tau2)


def correction(common: Common, name: str, robot: Robot, standard: bool | None) -> str:
    """Return the text of a parameter's correction: place in the robot file, key, new value.

    An example is "[[joint]] 4: d_mm = 1199.7 (drawn 1200)"; the text is empty if the file has
    no key for the parameter.

    common : what the robots of this type have in common; name : parameter
    robot, standard : nominal robot of the type, and its rows, as of `drawings_of`
    """
    if standard is None or name not in robot.parameters.names:
        return ""
    drawn, k = robot.parameters[name].value, common.names.index(name)
    new = drawn + common.mean[k] * common.scale[k]
    place = re.fullmatch(r"(L[345])(?:_(\d+))?|([a-z]+)(\d+)", name)
    if not place or (place[3] == "beta" and standard):
        return ""
    if place[3] == "c":
        turning = robot.joints[int(place[4]) - 1].kind == "revolute"
        key = "stiffness_Nm_per_rad" if turning else "stiffness_N_per_m"
        given = f"{1 / drawn:.6g}" if drawn else "no number"
        number = f"{float(f'{1 / new:.3g}'):.0f}"
        return f"[[joint]] {place[4]}: {key} = {number} (drawn {given})" if new > 0 else ""
    # Keys of DH parameters in a joint's table of a robot file. Unless the file has standard DH
    # rows, the first four belong to the row after the number in the parameter's name.
    row_keys = {
        "alpha": "alpha_deg",
        "a": "a_mm",
        "beta": "beta_deg",
        "b": "b_mm",
        "theta": "theta_deg",
        "d": "d_mm",
    }
    # Keys of the lengths of a four-bar in a robot file.
    bar_keys = {"L5": "crank_mm", "L4": "coupler_mm", "L3": "rocker_mm"}
    if place[1]:
        key, where = bar_keys[place[1]], f"[[four_bar]] {place[2] or 1}"
    else:
        key = row_keys[place[3]]
        where = f"[[joint]] {int(place[4]) + (place[3] in ('alpha', 'a', 'beta', 'b') and not standard)}"
    factor = 1e3 if key.endswith("mm") else np.rad2deg(1.0)
    digits = max(0, int(np.ceil(-np.log10(common.std_error[k] * common.scale[k] * factor))))
    number = f"{factor * new:.{min(digits, 6)}f}"
    return f"{where}: {key} = {number} (drawn {factor * drawn:.9g})"


def drawings_of(good: pd.DataFrame) -> dict[str, tuple[Robot, bool | None]]:
    """Return the nominal robots of the hundred most frequent types that can be read, by type.

    Each comes with whether its file has standard DH rows; None if it has no rows (URDF).

    good : rows of robots that were calibrated, as of a store
    """
    drawings = {}
    # The drawings of the hundred largest types are read.
    for kind in good["type"].value_counts().head(100).index:
        row = good[good["type"] == kind].iloc[0]
        with suppress(CasadicalError, OSError):
            path = Path(row["folder"]) / problem_file(Path(row["folder"])).robot
            rows = None if path.suffix == ".urdf" else load_toml(path)
            standard = None if rows is None else rows.get("convention") == "standard"
            drawings[str(kind)] = read_problem_robot(row["folder"]), standard
    return drawings
