"""python docs/studies/ur10_months.py > docs/studies/ur10_months.txt

A real UR10 as `casadical compare` sees it: the series A, B and C of Landgraf et al. (2021), measured by a laser
tracker, taken as three months of one robot, and as seven weeks, A and C cut into three parts: every third row, or by
the order of the rows, where the parts of the grid A lie in other regions of the joints. The robot was not calibrated,
repaired or moved between them as far as is known, so that nothing should be found.

Then the same with a change that is put into the real readings of the last month: the zero of joint 3 turned by 0.3 and
by 1 mrad, and positions 100 um/m greater, as if the robot were 4 K warmer. These lines are real data with a planted
change. What the comparison does not see, it should say: the last column of the first table is what would be seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from casadical import Measurements, Robot, read_problem
from casadical.core.telling.result import plain_text
from casadical.fleet.campaigns import other_regions
from casadical.fleet.changes import Comparison
from casadical.fleet.comparison import compare
from casadical.fleet.estimates import Estimate, estimate
from casadical.project.problem import read_campaign

ROOT = Path(__file__).parents[2]
SERIES = {"A": ("ur10_grid", 3), "B": ("ur10_joints", 1), "C": ("ur10", 3)}


def tables() -> tuple[Robot, dict[str, Measurements]]:
    """The nominal robot, and all poses of each series."""
    found = {}
    for letter, (name, _) in SERIES.items():
        folder = ROOT / "problems" / name
        problem = read_problem(folder)
        found[letter] = read_campaign(folder, folder / str(problem.tables[0]["file"]), problem.robot, later=True)
    return problem.robot, found


def weeks(series: Mapping[str, Measurements], *, mixed: bool) -> list[tuple[str, Measurements]]:
    """Seven parts; mixed : every third row, else as the rows follow each other."""
    found = []
    for letter, m in series.items():
        parts, n = SERIES[letter][1], np.arange(len(m))
        rows = [n[k::parts] for k in range(parts)] if mixed else np.array_split(n, parts)
        found += [(f"{letter}{k}", m[row]) for k, row in enumerate(rows, 1)]
    return found


def told(robot: Robot, series: Sequence[tuple[str, Measurements]]) -> list[Estimate]:
    return [estimate((robot, m), label) for label, m in series]


def line(words: str, found: Comparison) -> str:
    changes = []
    for c in found.changes:
        main = max(c.amounts, key=lambda a: abs(a.value) / a.std_error)
        size = f"{main.name} {main.value:+.3g} +/- {main.std_error:.2g} {main.unit}"
        sure = "named" if c.named else "not told from " + " or ".join(r.label for r in c.rivals[1:3])
        changes.append(f"{c.cause.label} ({sure}; {c.course} since {found.campaigns[c.since].label}): {size}")
    return f"{words:40}{'; '.join(changes) or 'nothing changed'} (log odds {found.log_odds:.1f})"


def main() -> None:
    robot, series = tables()
    months = told(robot, [*series.items()])
    print(plain_text(compare(months).blocks()))
    print("\nseven weeks")
    for words, mixed in (("every third row", True), ("by the order of the rows", False)):
        campaigns = told(robot, weeks(series, mixed=mixed))
        print(line(words, compare(campaigns)))
        print("".join(f"  note: {text}\n" for text in other_regions(campaigns)), end="")
    c = series["C"]
    assert c.position is not None
    print("\nplanted in C")
    for size in (3e-4, 1e-3):
        turned = c.q + size * (np.arange(robot.n) == 2)
        planted = estimate((robot, replace(c, q=turned)), "C")
        print(line(f"the zero of joint 3 by {np.rad2deg(size):.4f} deg", compare([*months[:2], planted])))
    warm = estimate((robot, replace(c, position=c.position * (1 + 1e-4))), "C")
    print(line("lengths by 100 um/m", compare([*months[:2], warm])))


if __name__ == "__main__":
    main()
