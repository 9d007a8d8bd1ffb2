"""Figures of a fleet and of a robot's life: accuracies, what campaigns leave, what robots of one type share."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
import pandas as pd

from casadical.core.telling.blocks import Table
from casadical.core.telling.figure import Axis, Figure, Note, Series
from casadical.fleet.changes import left_figure
from casadical.fleet.estimates import date_text
from casadical.fleet.hierarchy import Common
from casadical.fleet.store import records

# Robots whose course is drawn; robots whose names stand on the axis of the map.
COURSES, NAMED = 60, 30
# Names in a figure, and how far apart they are, as a share of its height.
LABELS, APART = 12, 0.07
_MAP = (
    "Mean error of held-out poses, a point a robot, on a logarithmic axis: grey before, blue after calibration, orange "
    "where it stands out from its type (four scaled median absolute deviations); the worst of these are named."
)
_TREND = (
    "What nothing explains in each campaign of a robot, of one coordinate; orange where something changed. Of many "
    "robots those are named that changed or whose last campaign leaves more than those before; point at a line to see "
    "which it is. Beside campaigns with a day, one without is not drawn."
)
_COMMON = (
    "How far all robots of the type are from the drawing, in standard errors, over the size of the departure; of "
    "compliances, what they yield under the joint's greatest torque. Red: a fault of the drawing, or of the "
    "instrument's set-up; the surest are named."
)


def accuracy_map(good: pd.DataFrame, outliers: Collection[str]) -> Figure:
    """Mean errors before and after of every robot, by type; good : rows of robots that were calibrated."""
    good = good.sort_values(["type_name", "after_mm"])
    x, names = np.arange(len(good)), [str(name) for name in good["robot"]]
    after = ["orange" if name in outliers else "blue" for name in names]
    series = [
        Series(
            "points", x, good[f"{state}_mm"], name=state, size=size, colour=colour, facts=names,
            tip="<b>%{customdata}</b><br>%{y:.4f} mm",
        )
        for state, colour, size in (("before", "grey", 4), ("after", after, 7))
    ]  # fmt: skip
    axis, marks = Axis("robot, by type and error"), []
    if len(good) <= NAMED:
        axis = Axis("robot, by type and error", ticks=x, labels=names)
    else:  # names do not fit on the axis
        far = good.assign(x=x)[good["robot"].isin(outliers).to_numpy()].nlargest(LABELS, "after_mm")
        rows = zip(far["robot"], far["x"], far["after_mm"], strict=True)
        marks = [Note(name, at, error, side="left", gap=8, colour="muted", size=12.5) for name, at, error in rows]
    return Figure("map", "Every robot", series, axis, Axis("mean error [mm]", log=True), 380, _MAP, marks=marks)


def trends(good: pd.DataFrame, grown: Collection[str]) -> Figure:
    """What each campaign of each robot leaves; grown : robots of which the last one leaves more than those before."""
    several = good[good["campaigns"] > 1]
    striking = (several["changes"] != "") | several["robot"].isin(list(grown))
    several = several.assign(striking=striking).sort_values("striking", ascending=False, kind="stable").head(COURSES)
    dated = any(np.isfinite(days).sum() > 1 for days in several["days"])
    lives: list[tuple[str, list[object], list[float], bool]] = []
    for r in records(several):  # by day or, where no robot has days, by number: not both on one axis
        points = zip([date_text(day) if dated else k + 1 for k, day in enumerate(r["days"])], r["left_mm"], strict=True)
        drawn = [(x, left) for x, left in points if x]
        lives.append((r["robot"], [x for x, _ in drawn], [left for _, left in drawn], bool(r["changes"])))
    named = [life for life in lives if life[2] and np.isfinite(life[2][-1])]
    if len(named) > LABELS:
        named = [life for life in named if life[3] or life[0] in grown]
    first = sorted(named, key=lambda life: (not life[3], -life[2][-1]))[:LABELS]
    named = sorted(first, key=lambda life: -life[2][-1])
    most = max((v for _, _, left, _ in lives for v in left if np.isfinite(v)), default=1.0)
    heights = _apart([life[2][-1] for life in named], APART * most)
    notes = [
        Note(name, 1, y, "x", colour="red" if changed else "muted", size=12.5)
        for (name, _, _, changed), y in zip(named, heights, strict=True)
    ]
    right = 12 + 8 * max((min(len(life[0]), 20) for life in named), default=0)
    by_change = sorted(lives, key=lambda life: life[3])  # what changed is on top
    return left_figure("trends", by_change, height=340, caption=_TREND, marks=notes, right=right)


def _apart(heights: Sequence[float], gap: float) -> list[float]:
    """Heights of labels, given from the top down, moved down so far that none covers the next one."""
    moved: list[float] = []
    for y in heights:
        moved.append(min(y, moved[-1] - gap) if moved else y)
    # Those that came below the axis push the others up.
    for k in range(len(moved) - 1, -1, -1):
        moved[k] = max(moved[k], moved[k + 1] + gap if k + 1 < len(moved) else 0.0)
    return moved


def common_departures(c: Common) -> Figure:
    """How far all robots of a type are from its drawing, and how surely."""
    sure = np.abs(c.mean) / np.maximum(c.std_error, 1e-12)
    bad = {name for name, _, _ in c.faults}
    named = sorted(bad, key=lambda name: -sure[c.names.index(name)])[:LABELS]
    words = []
    for k, name in enumerate(c.names):
        mean, error, unit = c.readable(name, c.mean[k], c.std_error[k])
        words.append([name, f"{mean:+.4g} {unit} +/- {error:.1g}"])
    compliant = [n.startswith("c") and n[1:].isdigit() for n in c.names]
    dots = Series(
        "points", c.mean * np.where(compliant, 1.0, 1e3 * c.scale), sure, size=8,
        colour=["red" if n in bad else "grey" for n in c.names], text=[n if n in named else "" for n in c.names],
        facts=words, tip="<b>%{customdata[0]}</b><br>%{customdata[1]} from the drawing",
    )  # fmt: skip
    x, y = Axis("common departure [mm or mrad]"), Axis("in standard errors")
    return Figure(f"common/{c.type}", f"{c.name}: {c.count} robots", [dots], x, y, caption=_COMMON)


def common_table(c: Common) -> Table:
    """All parameters of a type: common departure, its standard error, and the spread of the robots."""
    rows = []
    for k, name in enumerate(c.names):
        mean, error, spread, unit = c.readable(name, c.mean[k], c.std_error[k], c.spread[k])
        rows.append((name, f"{mean:+.4f}", f"{error:.2g}", f"{spread:.3g}", unit))
    strong = frozenset(k for k, n in enumerate(c.names) if n in {name for name, _, _ in c.faults})
    head = ("parameter", "common", "std error", "spread", "unit")
    return Table(f"{c.name}, drawing {c.type}", head, rows, frozenset({1, 2, 3}), strong, folded=True)
