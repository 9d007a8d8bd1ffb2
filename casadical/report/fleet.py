"""The page of a fleet: what to check first, a map of accuracies, outliers, trends, and what a type has in common."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from casadical.core.blocks import Table, Words
from casadical.fleet.estimates import date_text
from casadical.fleet.hierarchy import Common
from casadical.fleet.result import Fleet, short
from casadical.fleet.store import records
from casadical.report.life import left_figure
from casadical.report.page import Block, Drawing, Part, Section, Tile, report_html
from casadical.report.provenance import provenance_of
from casadical.report.style import BLUE, GREY, MUTED, ORANGE, RED, Figure, log_ticks, new_figure, plain

# Rows of the table, and robots whose course is drawn.
MOST, COURSES = 2000, 60
# Robots whose names stand on the axis of the map.
NAMED = 30
_MAP = (
    "Mean error of held-out poses, a point a robot, on a logarithmic axis: grey before, blue after calibration, orange "
    "where it stands out from its type (four scaled median absolute deviations); the worst of these are named."
)
_TREND = (
    "What nothing explains in each campaign of a robot, of one coordinate; orange where something changed. Of many "
    "robots those are named that changed or whose last campaign leaves more than those before; point at a line to see "
    "which it is. Beside campaigns with a day, one without is not drawn."
)
# Names in a figure, and how far apart they are, as a share of its height; letters of an error beside the figures.
LABELS, APART, LETTERS = 12, 0.07, 60
_COMMON = (
    "How far all robots of the type are from the drawing, in standard errors, over the size of the departure; of "
    "compliances, what they yield under the joint's greatest torque. Red: a fault of the drawing, or of the "
    "instrument's set-up; the surest are named."
)


def fleet_figures(found: Fleet) -> dict[str, Figure]:
    """Figures of a fleet, by name: map of accuracies, trends, and common/TYPE.

    Parameters
    ----------
    found : Fleet
        of `casadical.fleet.run_fleet`

    Returns
    -------
    dict[str, Figure]
        name -> figure of plotly

    Raises
    ------
    InputError
        where plotly is not installed

    Examples
    --------
    >>> fleet = casadical.fleet.run_fleet(["problems/planar"], "fleet.parquet", workers=1, with_diagnosis=False)
    >>> list(casadical.report.fleet_figures(fleet))
    ['map']
    """
    figures: dict[str, Figure] = {}
    if len(found.good):
        figures["map"] = _map(found)
    if (found.good["campaigns"] > 1).any():
        figures["trends"] = _trends(found)
    return figures | {f"common/{c.type}": _common(c) for c in found.commons}


def fleet_report(found: Fleet, command: Sequence[str] = ()) -> str:
    """One HTML file of a fleet.

    Parameters
    ----------
    found : Fleet
        of `casadical.fleet.run_fleet`
    command : Sequence[str], default ()
        as it was typed

    Returns
    -------
    str
        HTML

    Raises
    ------
    InputError
        plotly or jinja2 is not installed

    Examples
    --------
    >>> fleet = casadical.fleet.run_fleet(["problems/planar"], "fleet.parquet", workers=1, with_diagnosis=False)
    >>> casadical.report.fleet_report(fleet)[:15]
    '<!doctype html>'
    """
    figures = fleet_figures(found)
    sections = [
        Section("What to check first", found.blocks()),
        Section("Map of accuracies", [Drawing("map", f, _MAP) for n, f in figures.items() if n == "map"]),
        Section("Trends", [Drawing(n, f, _TREND) for n, f in figures.items() if n == "trends"]),
        Section("What robots of one type have in common", [*_commons(found, figures)]),
        Section("All robots", [_all(found.robots)]),
    ]
    part = Part("Fleet", f"{len(found.robots)} robots", sections, [*_tiles(found)])
    return report_html("Fleet", [part], provenance_of([], command))


def _tiles(found: Fleet) -> Iterator[Tile]:
    good = found.good
    yield Tile("Calibrated", str(len(good)), "", f"of {len(found.robots)} robots")
    if len(good):
        yield Tile(
            "After, median", f"{good['after_mm'].median():.3f}", "mm", f"{good['before_mm'].median():.3f} before"
        )
    yield Tile("Changed", str(int((found.robots["changes"] != "").sum())), "", "robots")
    yield Tile("Stand out", str(len(found.outliers)), "", "robots")


def _all(robots: pd.DataFrame) -> Table:
    rows = []
    for r in records(robots.head(MOST)):
        errors = (f"{v:.4f}" if np.isfinite(v) else "" for v in (r["before_mm"], r["after_mm"]))
        figures = (short(r["error"], LETTERS), *errors, str(r["poses"]), str(r["campaigns"]))
        verdict = " ".join(filter(None, (r["verdict"], r["causes"])))
        rows.append((r["robot"], r["type_name"], r["status"], *figures, verdict, r["changes"]))
    head = ("robot", "type", "status", "error", "before", "after", "poses", "campaigns", "diagnosis", "changed")
    title = f"Mean errors of held-out poses [mm]{f'; the first {MOST}' if len(robots) > MOST else ''}"
    return Table(title, head, rows, frozenset({4, 5, 6, 7}), folded=len(rows) > 50)


def _map(found: Fleet) -> Figure:
    good = found.good.sort_values(["type_name", "after_mm"])
    colour = [ORANGE if name in found.outliers else BLUE for name in good["robot"]]
    figure = new_figure("Every robot", "robot, by type and error", "mean error [mm]", height=380)
    x = np.arange(len(good))
    for column, colours, size in (("before_mm", GREY, 4), ("after_mm", colour, 7)):
        figure.add_scatter(
            x=x,
            y=good[column],
            mode="markers",
            marker={"size": size, "color": colours},
            name=column.removesuffix("_mm"),
            text=[plain(n) for n in good["robot"]],
            hovertemplate="<b>%{text}</b><br>%{y:.4f} mm<extra></extra>",
        )
    if len(good) <= NAMED:
        figure.update_xaxes(tickvals=x, ticktext=[plain(n) for n in good["robot"]])
    else:  # names do not fit on the axis
        far = good.assign(x=x)[good["robot"].isin(found.outliers).to_numpy()].nlargest(LABELS, "after_mm")
        for name, at, after in zip(far["robot"], far["x"], far["after_mm"], strict=True):
            figure.add_annotation(
                x=at, y=np.log10(after), text=plain(name), showarrow=False, xanchor="right", xshift=-8
            )
    return figure.update_yaxes(log_ticks())


def _trends(found: Fleet) -> Figure:
    grown, several = found.grown, found.good[found.good["campaigns"] > 1]
    striking = (several["changes"] != "") | several["robot"].isin(list(grown))
    several = several.assign(striking=striking).sort_values("striking", ascending=False, kind="stable").head(COURSES)
    dated = any(np.isfinite(days).sum() > 1 for days in several["days"])
    lives: list[tuple[str, list[object], list[float], bool]] = []
    for r in records(several):  # by day or, where no robot has days, by number: not both on one axis
        points = zip([date_text(day) if dated else k + 1 for k, day in enumerate(r["days"])], r["left_mm"], strict=True)
        drawn = [(x, left) for x, left in points if x]
        lives.append((r["robot"], [x for x, _ in drawn], [left for _, left in drawn], bool(r["changes"])))
    figure = left_figure(sorted(lives, key=lambda life: life[3]), height=340)  # what changed is on top
    named = [life for life in lives if life[2] and np.isfinite(life[2][-1])]
    if len(named) > LABELS:
        named = [life for life in named if life[3] or life[0] in grown]
    first = sorted(named, key=lambda life: (not life[3], -life[2][-1]))[:LABELS]
    named = sorted(first, key=lambda life: -life[2][-1])
    most = max((v for _, _, left, _ in lives for v in left if np.isfinite(v)), default=1.0)
    for (name, _, _, changed), y in zip(named, _apart([life[2][-1] for life in named], APART * most), strict=True):
        figure.add_annotation(
            x=1,
            xref="paper",
            xanchor="left",
            y=y,
            text=plain(name),
            showarrow=False,
            font_color=RED if changed else MUTED,
        )
    return figure.update_layout(margin_r=12 + 8 * max((min(len(life[0]), 20) for life in named), default=0))


def _apart(heights: Sequence[float], gap: float) -> list[float]:
    """Heights of labels, given from the top down, moved down so far that none covers the next one."""
    found: list[float] = []
    for y in heights:
        found.append(min(y, found[-1] - gap) if found else y)
    # Those that came below the axis push the others up.
    for k in range(len(found) - 1, -1, -1):
        found[k] = max(found[k], found[k + 1] + gap if k + 1 < len(found) else 0.0)
    return found


def _common(c: Common) -> Figure:
    sure = np.abs(c.mean) / np.maximum(c.std_error, 1e-12)
    bad = {name for name, _, _ in c.faults}
    named = sorted(bad, key=lambda name: -sure[c.names.index(name)])[:LABELS]
    words = []
    for k, name in enumerate(c.names):
        mean, error, unit = c.readable(name, c.mean[k], c.std_error[k])
        words.append(f"<b>{plain(name)}</b><br>{mean:+.4g} {unit} +/- {error:.1g} from the drawing")
    title = f"{plain(c.name)}: {c.count} robots"
    figure = new_figure(title, "common departure [mm or mrad]", "in standard errors")
    figure.add_scatter(
        x=c.mean * np.where([n.startswith("c") and n[1:].isdigit() for n in c.names], 1.0, 1e3 * c.scale),
        y=sure,
        mode="markers+text",
        marker={"size": 8, "color": [RED if n in bad else GREY for n in c.names]},
        text=[plain(n) if n in named else "" for n in c.names],
        textposition="top center",
        cliponaxis=False,
        customdata=words,
        hovertemplate="%{customdata}<extra></extra>",
        showlegend=False,
    )
    return figure


def _commons(found: Fleet, figures: dict[str, Figure]) -> Iterator[Block]:
    for c in found.commons:
        yield Drawing(f"common/{c.type}", figures[f"common/{c.type}"], _COMMON)
        rows = []
        for k, name in enumerate(c.names):
            mean, error, spread, unit = c.readable(name, c.mean[k], c.std_error[k], c.spread[k])
            rows.append((name, f"{mean:+.4f}", f"{error:.2g}", f"{spread:.3g}", unit))
        strong = frozenset(k for k, n in enumerate(c.names) if n in {name for name, _, _ in c.faults})
        head = ("parameter", "common", "std error", "spread", "unit")
        yield Table(f"{c.name}, drawing {c.type}", head, rows, frozenset({1, 2, 3}), strong, folded=True)
    if not found.commons:
        yield Words("Five robots of one type are needed to learn what they have in common.", "note")
