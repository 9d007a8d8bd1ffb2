"""A start for base and tool where readings do not determine them alone: held by what the robot file says of them.

The tool may be elsewhere than the file says by TOOL, the base turned by TURN and shifted by SHIFT, one sigma each. A
model that is not calibrated yet is wrong by MODEL at a pose, and not by chance: more than ENOUGH poses tell no more
than so many. What the readings determine is freed of these priors in the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from casadical.core.basics import Array
from casadical.core.transforms import from_xyz, nearest_rotation, to_xyz

TOOL, TURN, SHIFT = 0.1, 0.3, 100.0
MODEL, ENOUGH = 3e-3, 30
# A direction that readings determine so many times better than the priors, as a ratio of variances, is freed of them.
FREE = 100.0
# Of Gauss-Newton; a step that lowers the cost by less than this share is the last.
STEPS, SAME = 40, 1e-9
# (a @ _CROSS).reshape(3, 3) is the matrix that takes t to a x t from the right.
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).reshape(3, 9)


@dataclass(frozen=True, eq=False)
class Readings:
    """Where the flange was, p (n, 3) and R (n, 3, 3) in the base frame, and what was measured of the point at its tool.

    seen : its positions, shape (n, 3), or its distances to places that are known, shape (n,) [m]; places : (n, 3)
    """

    p: Array
    R: Array
    seen: Array
    places: Array | None = None

    def rows(self, y: Array) -> tuple[Array, Array]:
        """What was read less what a point at y, shape (n, 3), gives, shape (n, k), and directions of it (n, k, 3)."""
        if self.places is None:
            return self.seen - y, np.broadcast_to(np.eye(3), (len(y), 3, 3))
        line = y - self.places
        length = np.maximum(np.linalg.norm(line, axis=1), 1e-9)
        return (self.seen - length)[:, None], (line / length[:, None])[:, None]


@dataclass(frozen=True, eq=False)
class Placed:
    """Base rotation (3, 3) and position (3,), tool (3,), and the cost of this start."""

    R: Array
    p: Array
    t: Array
    cost: float = np.inf


class Held:
    """The problem of all readings; base, tool : as in the robot file, shapes (4, 4) and (3,)."""

    def __init__(self, readings: Sequence[Readings], base: Array, tool: Array, *, tool_known: bool) -> None:
        self.readings, self.base, self.tool = readings, base, tool
        # One sigma of the turn, the shift and the tool.
        sigma = np.repeat([TURN, SHIFT, 1e-6 if tool_known else TOOL], 3)
        self.prior = np.diag(sigma**-2.0)

    def determined(self, at: Placed) -> bool:
        """Whether the readings determine the base's rotation and the tool well, with the model as wrong as it is."""
        H = self._sums(at)[0]
        own = [0, 1, 2, *(k for k in (6, 7, 8) if self.prior[k, k] < 1e6)]
        rest = [k for k in range(9) if k not in own]
        prior = self.prior[np.ix_(rest, rest)]
        across = H[np.ix_(rest, own)]
        less = H[np.ix_(own, own)] - across.T @ np.linalg.solve(H[np.ix_(rest, rest)] + prior, across)
        unit = np.diag(self.prior)[own] ** -0.5
        return bool(np.linalg.eigvalsh(less * np.outer(unit, unit))[0] > FREE)

    def best(self, starts: Sequence[Placed]) -> Placed:
        """The best optimum that is found from several starts, freed of the priors where the readings tell enough."""
        lowest = min((self._refined(start, self.prior) for start in starts), key=lambda placed: placed.cost)
        H, unit = self._sums(lowest)[0], np.diag(self.prior) ** -0.5
        value, V = np.linalg.eigh(H * np.outer(unit, unit))
        kept = (V * (value < FREE)) @ V.T / np.outer(unit, unit)
        return self._refined(lowest, kept)

    def starts(self) -> list[Placed]:
        """The base as in the file, and turned every way by right angles about its axes and the places' middle."""
        turns = {tuple(np.round(from_xyz(np.array(a) * np.pi / 2), 6).ravel()) for a in product(range(4), repeat=3)}
        seen = [r.places if r.places is not None else r.seen for r in self.readings]
        middle = np.concatenate(seen).mean(axis=0)
        flange = np.concatenate([r.p for r in self.readings]).mean(axis=0)
        places = [Placed(self.base[:3, :3], self.base[:3, 3], self.tool)]
        for turn in sorted(turns):
            R = self.base[:3, :3] @ np.reshape(turn, (3, 3))
            places.append(Placed(R, middle - R @ flange, self.tool))
        return places

    def _off(self, at: Placed) -> Array:
        """Departure from the robot file: turn, shift and tool, shape (9,)."""
        turn = to_xyz(at.R @ self.base[:3, :3].T)
        return np.concatenate([turn, at.p - self.base[:3, 3], at.t - self.tool])

    def _sums(self, at: Placed) -> tuple[Array, Array, float]:
        """Normal matrix and right side for a turn in the measuring frame, a shift and the tool; sum of squares."""
        H, g, square = np.zeros((9, 9)), np.zeros(9), 0.0
        total = sum(len(r.p) for r in self.readings)
        weight = min(total, ENOUGH) / total / MODEL**2
        for r in self.readings:
            arm = (r.p + r.R @ at.t) @ at.R.T
            left, toward = r.rows(arm + at.p)
            # A small turn w moves a point at a by w x a.
            turned = toward @ (arm @ _CROSS).reshape(-1, 3, 3)
            J = np.concatenate([turned, toward, toward @ (at.R @ r.R)], axis=2).reshape(-1, 9)
            H += weight * J.T @ J
            g += weight * J.T @ left.ravel()
            square += weight * float((left**2).sum())
        return H, g, square

    def _cost(self, at: Placed, prior: Array) -> float:
        off = self._off(at)
        return self._sums(at)[2] + float(off @ prior @ off)

    def _refined(self, at: Placed, prior: Array) -> Placed:
        """Levenberg and Marquardt from a start."""
        cost, damping = self._cost(at, prior), 1e-6
        for _ in range(STEPS):
            H, g, _ = self._sums(at)
            normal = H + prior
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), g - prior @ self._off(at))
            turned = nearest_rotation(from_xyz(step[:3]) @ at.R)
            tried = Placed(turned, at.p + step[3:6], at.t + step[6:])
            lower = self._cost(tried, prior)
            if lower >= cost:
                damping *= 10
                if damping > 1e6:
                    break
                continue
            at, gained, cost, damping = tried, cost - lower, lower, damping / 3
            if gained < SAME * (cost + 1):
                break
        return Placed(at.R, at.p, at.t, cost)
