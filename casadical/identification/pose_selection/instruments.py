"""Low-cost instruments, wires and sockets: the information of their readings about the parameters.

It follows from the Jacobian of the positions. A wire reads the distance to its anchor: the
derivative of the position along the wire. A socket holds the tool's ball at one point: the position
minus that point. Places that were not measured are further columns after those of the parameters,
three coordinates each; they are located relative to the robot, not the other way round.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import comb
from typing import Literal

import numpy as np
import pandas as pd

from casadical.core.basics import M_PER_MM, Array, InputError
from casadical.core.linear_gaussian.noise import whitening_of
from casadical.core.statistics import first_of_best
from casadical.identification.accuracy import predicted
from casadical.identification.pose_selection.candidates import SOCKET_COLUMN, draw, noise_covariance, scaled_jacobian
from casadical.identification.pose_selection.experimental_design import inverse
from casadical.identification.pose_selection.workspace import Workspace
from casadical.measurements.measurements import Measurements, Noise, unmeasured
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Instrument:
    """What is read at every pose, in place of a position.

    kind : "wires" for distances to every place at each pose; "sockets" for the ball of the tool in
        one of the places
    places : approximate positions of the anchors or sockets in the measuring frame, shape (k, 3)
        [m]
    surveyed : whether the places are measured too, so that they are not estimated
    """

    kind: Literal["wires", "sockets"]
    places: Array
    surveyed: bool = False

    @property
    def numbers(self) -> int:
        """Return the number of values read at each pose."""
        return len(self.places) if self.kind == "wires" else 3

    @property
    def extra(self) -> int:
        """Return the number of unknown coordinates of the places; 0 if they are surveyed."""
        return 0 if self.surveyed else self.places.size

    def sets(self, m: Measurements) -> tuple[Measurements, ...]:
        """Return the noise-free measurements of this instrument at poses m with model positions.

        There is one set of distances per wire, or one set of contacts for all sockets, with the
        given distance of the two farthest apart if poses touch both.
        """
        assert m.position is not None
        if self.kind == "sockets":
            label = np.array([f"S{int(k) + 1}" for k in m.conditions[SOCKET_COLUMN]], dtype=object)
            touched = Measurements(m.q, "contact", label=label, conditions=m.conditions)
            if len(self.places) < 2:
                return (touched,)
            i, j = _farthest(self.places)
            apart = float(np.linalg.norm(self.places[i] - self.places[j]))
            both = {f"S{i + 1}", f"S{j + 1}"} <= set(label)
            return (touched.with_separations([(f"S{i + 1}", f"S{j + 1}", apart)]) if both else touched,)
        wires = []
        for place in self.places:
            length, end = np.linalg.norm(m.position - place, axis=1), np.tile(place, (len(m), 1))
            target = end if self.surveyed else None
            wires.append(Measurements(m.q, "distance", distance=length, target=target, conditions=m.conditions))
        return tuple(wires)

    def rows(self, robot: Robot, names: Sequence[str], m: Measurements, noise: Noise) -> Array:
        """Return the whitened Jacobian of readings, shape (n, numbers, len(names) + extra).

        It is in standard deviations of the noise per unit of scale, and for the unknown places per
        millimetre; it is taken at the robot's values.

        m : poses with model positions, for sockets with the column `SOCKET_COLUMN`
        noise : noise of a distance, or of a coordinate in a socket, and of the joints
        """
        J, covariance = scaled_jacobian(robot, names, m), noise_covariance(robot, m, Noise(1e-12, noise.repeatability))
        n, k = len(m), len(self.places)
        if self.kind == "sockets":
            at = np.zeros((n, 3, k, 3))
            at[np.arange(n), :, m.conditions[SOCKET_COLUMN].astype(int)] = -np.eye(3)
            seen, places = J, at.reshape(n, 3, 3 * k)
        else:
            assert m.position is not None
            line = m.position[:, None] - self.places
            beam = line / np.maximum(np.linalg.norm(line, axis=2, keepdims=True), 1e-9)
            seen = np.einsum("nki,nip->nkp", beam, J)
            places = np.zeros((n, k, k, 3))
            places[:, np.arange(k), np.arange(k)] = -beam
            places = places.reshape(n, k, 3 * k)
            covariance = beam @ covariance @ beam.transpose(0, 2, 1)
        whole = seen if self.surveyed else np.concatenate([seen, places], axis=2)
        own = (noise.sigma / M_PER_MM) ** 2 * np.eye(self.numbers)
        return np.asarray(whitening_of(covariance + own)[0] @ whole)

    def table(self, m: Measurements) -> pd.DataFrame:
        """Return a plan's columns at poses m: name of the socket, or nominal wire lengths [mm]."""
        if self.kind == "sockets":
            return pd.DataFrame({"point": [f"S{int(k) + 1}" for k in m.conditions[SOCKET_COLUMN]]})
        assert m.position is not None
        length = 1e3 * np.linalg.norm(m.position[:, None] - self.places, axis=2)
        return pd.DataFrame(length.round(1), columns=[f"nominal_wire{k}_mm" for k in range(1, len(self.places) + 1)])

    def before(self, size: int, noise: Noise) -> Array:
        """Return the information matrix without any pose, shape (size, size).

        It is that of one given distance between the two sockets farthest apart, per squared
        millimetre; for wires and measured places it is zero.

        size : number of all variables, the places' coordinates at the end
        noise : its sigma is that of the distance
        """
        fixed = np.zeros((size, size))
        if self.kind == "wires" or self.surveyed or len(self.places) < 2:
            return fixed
        i, j = _farthest(self.places)
        line = self.places[i] - self.places[j]
        g = np.zeros((len(self.places), 3))
        g[i], g[j] = line / np.linalg.norm(line), -line / np.linalg.norm(line)
        row = np.concatenate([np.zeros(size - g.size), g.ravel()]) * M_PER_MM / noise.sigma
        return np.outer(row, row)


def without_base(robot: Robot, J: Array, m: Measurements) -> Array:
    """Return a Jacobian of positions orthogonal to that of the base's pose, shape (n, 3, p).

    What another base frame would compensate at these poses is removed. The Jacobian is returned
    unchanged if the robot's base is not identified.

    J : Jacobian of positions, shape (n, 3, p) [mm per unit of scale]; m : the poses
    """
    names = robot.parameters.select(["base_*"]) if robot.base.unknown != "none" else ()
    if not names:
        return J
    base = scaled_jacobian(robot, names, m).reshape(-1, len(names))
    flat = J.reshape(-1, J.shape[2])
    return np.asarray((flat - base @ np.linalg.lstsq(base, flat, rcond=None)[0]).reshape(J.shape))


def best_places(
    robot: Robot, every: Instrument, count: int, names: Sequence[str], m: Measurements, noise: Noise, weight: Array
) -> Array:
    """Return the rising indices of `count` places with least mean variance, shape (count,).

    All subsets are tried if there are at most 20 000, else exchanges of single places.

    every : instrument with all candidate places
    names : parameters to identify, p of them
    m : poses with model positions, for sockets the poses in all of the places
    weight : W of the mean variance trace(W C) of their covariance C, shape (p, p)
    Raises InputError where there are too few places.
    """
    number = len(every.places)
    if count > number:
        raise InputError(f"{count} places are wanted of {number}; give more candidates, or ask for fewer")
    each = []
    for k, place in enumerate(every.places):
        some = m
        if every.kind == "sockets":
            some = m[np.flatnonzero(m.conditions[SOCKET_COLUMN] == k)]
            some = replace(some, conditions={**some.conditions, SOCKET_COLUMN: np.zeros(len(some))})
        rows = replace(every, places=place[None]).rows(robot, names, some, noise)
        rows = rows.reshape(-1, rows.shape[2])
        each.append(rows.T @ rows)

    def variance(which: Iterable[int]) -> float:
        """Return the mean variance trace(W C) of the parameters, with these places alone.

        The information of each place has the parameters and its own coordinates.
        """
        chosen, p = list(which), len(weight)
        some = replace(every, places=every.places[chosen])
        M = np.zeros((p + some.extra,) * 2)
        for k, one in enumerate(each[place] for place in chosen):
            at = np.r_[:p, p + 3 * k : p + 3 * k + len(one) - p]
            M[np.ix_(at, at)] += one
        M += some.before(len(M), noise) + 1e-9 * np.diag(np.diag(M))
        return float(np.sum(weight * inverse(M)[:p, :p]))

    if comb(number, count) <= 20_000:
        sets = list(combinations(range(number), count))
        return np.array(sets[first_of_best([-variance(some) for some in sets])])
    # The best pair is extended by the best additional ones, then single places are exchanged as
    # long as this reduces the variance by more than 0.1 %.
    pairs = list(combinations(range(number), min(count, 2)))
    chosen = list(pairs[first_of_best([-variance(pair) for pair in pairs])])
    while len(chosen) < count:
        unchosen = [k for k in range(number) if k not in chosen]
        chosen.append(unchosen[first_of_best([-variance([*chosen, k]) for k in unchosen])])
    value = variance(chosen)
    while True:
        free = [k for k in range(number) if k not in chosen]
        others = [[*chosen[:i], k, *chosen[i + 1 :]] for i in range(count) for k in free]
        variances = [variance(other) for other in others]
        best = first_of_best(np.negative(variances))
        if variances[best] > 0.999 * value:
            return np.array(sorted(chosen))
        chosen, value = others[best], variances[best]


def usual_places(robot: Robot, kind: Literal["wires", "sockets"]) -> Array:
    """Return default candidate places of an instrument, shape (K, 3) [m], in the measuring frame.

    They are on circles about the base's z axis: 48 anchors of wires at 1.5 times the reach and four
    heights up to that; 32 sockets at 0.45 and 0.7 times the reach, at a tenth and half of it above
    the base. The reach is the tool's largest horizontal distance in 2000 random poses.
    """
    radii, heights, turns = ((1.5,), (0.0, 0.5, 1.0, 1.5), 12) if kind == "wires" else ((0.45, 0.7), (0.1, 0.5), 8)
    turn = np.arange(turns) * 2 * np.pi / turns
    local = [(r * np.cos(a), r * np.sin(a), h) for r in radii for h in heights for a in turn]
    q = draw(robot, 2000, Workspace(), np.random.default_rng(0))
    tool, T = predicted(robot, unmeasured(q))[0], robot.base.T
    reach = np.linalg.norm(((tool - T[:3, 3]) @ T[:3, :3])[:, :2], axis=1).max()
    return np.asarray(reach * np.array(local) @ T[:3, :3].T + T[:3, 3])


def _farthest(places: Array) -> tuple[int, int]:
    """Return the rising indices of the two farthest places, (k, 3) [m]; (0, 0) for one place."""
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    i, j = np.unravel_index(first_of_best(apart), apart.shape)
    return int(min(i, j)), int(max(i, j))
