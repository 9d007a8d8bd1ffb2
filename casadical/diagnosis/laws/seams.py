"""Seams of laws: places of the robot where an error may be added, and what it does to the measured point there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.laws.drivers import Driver
from casadical.diagnosis.linearisation import Linearisation
from casadical.effects.formula_effect import SEAMS
from casadical.effects.law import Law
from casadical.robot.robot import Robot

# Realistic size of a law, one sigma: where a form varies by one.
ANGLE, LENGTH, SHARE = 30e-6, 30e-6, 0.03
# The same in joint logs, in shares of the great torque and rad.
IN_LOGS = {"torque": 0.05, "response": 1e-3}
# Where instruments stand: so many directions around the robot, at these distances from it, in reaches.
DIRECTIONS, DISTANCES = 8, (1.5, 2.5, 4.0)
LETTERS = "abcdefghijklmnopqsuvwxyz"


@dataclass(frozen=True, eq=False)
class Seam:
    """A place; law : with a constant formula there, columns : of its factors, shape (n, 3, d) [m per unit]."""

    law: Law
    columns: Array

    @property
    def size(self) -> float:
        """One sigma of its factors."""
        return IN_LOGS.get(self.law.seam) or {"rad": ANGLE, "m": LENGTH}.get(SEAMS[self.law.seam][1], SHARE)

    def takes(self, driver: Driver) -> bool:
        """Whether a driver may act there: the payload's energy follows logged columns alone."""
        return self.law.seam != "payload" or driver.columns_only

    def with_formula(self, parts: Sequence[str], scales: Sequence[float]) -> Law:
        """The law of these parts, each with factors of its own. scales : how much each part varies."""
        d = SEAMS[self.law.seam][0]
        terms, factors = [], []
        for k, (part, scale) in enumerate(zip(parts, scales, strict=True)):
            names = LETTERS[k * d : (k + 1) * d]
            terms.append((names if d == 1 else f"[{', '.join(names)}]") + f"*{part}")
            factors += [(name, float(f"{self.size / scale:.3g}")) for name in names]
        law = self.law
        return Law(law.joint, law.seam, " + ".join(terms), tuple(factors), law.station, law.count)


def seams_at(robot: Robot) -> list[Law]:
    """Laws with a constant formula at every place that all drivers may act at."""
    vector = (("a", 1e-5), ("b", 1e-5), ("c", 1e-5))
    found = [Law(j, "joint", "a") for j in robot.numbers]
    found += [Law(j, seam, "[a, b, c]", vector) for seam in ("tilt", "shift") for j in robot.numbers]
    # The last link's shift is the tool's, and the foot's is the measuring frame's.
    found = [law for law in found if (law.seam, law.joint) != ("shift", robot.n)]
    found += [Law(None, seam, "[a, b, c]", vector) for seam in ("base tilt", "base shift", "tool shift")]
    return [*found, *([Law(None, "payload", "a", (("a", 0.01),))] if robot.payload else [])]


def stations(robot: Robot) -> list[Law]:
    """Constant laws along the beam of instruments that stand around the robot, and of one at the frame's origin."""
    middle, reach = robot.base.T[:3, 3], robot.reach
    found = [np.zeros(3)]
    for far in DISTANCES:
        for turn in 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
            found.append(middle + reach * np.array([far * np.cos(turn), far * np.sin(turn), 0.5]))
    return [Law(None, "beam", "a", station=_rounded(at)) for at in found]


def _rounded(at: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 3) for v in at)
    return x, y, z


def with_columns(linear: Linearisation, laws: Sequence[Law]) -> list[Seam]:
    """The places with what they do to the measured point."""
    columns = linear.columns(laws)
    edges = np.cumsum([0, *(len(law.sizes()) for law in laws)])
    return [Seam(law, columns[:, :, a:b]) for law, a, b in zip(laws, edges[:-1], edges[1:], strict=True)]
