"""The report of a comparison of campaigns: what changed, and its course over the life of the robot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from casadical.core.blocks import Words, mm
from casadical.fleet.changes import HOW, Change, Comparison
from casadical.report.page import Drawing, Part, Section, Tile, report_html
from casadical.report.provenance import provenance_of
from casadical.report.style import BLUE, GREY, ORANGE, RED, Figure, new_figure, plain

_COURSE = (
    "Change since the first campaign, as each campaign alone shows it, with its 95 % interval. Of several parameters "
    "the one that moved most surely is drawn; the others move with it. Shaded: where it began, with 95 % probability."
)
AXES = {
    "joint_zero": "zero of joint {joint}", "joint_stiffness": "compliance of joint {joint}", "lengths": "all lengths",
}  # fmt: skip
_LEFT = "What nothing explains, of one coordinate. A campaign that stands out was measured or prepared differently."


def comparison_figures(found: Comparison) -> dict[str, Figure]:
    """Figures of a life, by name: change/CAUSE for each change, and left, the scatter of each campaign.

    Parameters
    ----------
    found : Comparison
        of `casadical.fleet.compare`

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
    >>> sorted(casadical.report.comparison_figures(comparison))
    ['change/lengths', 'left']
    """
    figures = {f"change/{c.cause.label}": _course(found, c) for c in found.changes}
    if any(c.sigma is not None for c in found.campaigns):
        figures["left"] = _left(found)
    return figures


def comparison_report(found: Comparison, files: Sequence[Path] = (), command: Sequence[str] = ()) -> str:
    """One HTML file of a comparison.

    Parameters
    ----------
    found : Comparison
        of `casadical.fleet.compare`
    files : Sequence[Path], default ()
        what was read
    command : Sequence[str], default ()
        as it was typed

    Returns
    -------
    str
        HTML

    Raises
    ------
    InputError
        plotly or jinja2 is not installed, or a file is gone

    Examples
    --------
    >>> casadical.report.comparison_report(comparison)[:15]
    '<!doctype html>'
    """
    figures = comparison_figures(found)
    blocks = list(found.blocks())
    end = next(k for k, b in enumerate(blocks) if not isinstance(b, Words) and b.title == "Campaigns")
    drawn = [Drawing(name, f, _COURSE) for name, f in figures.items() if name.startswith("change/")]
    sections = [
        Section("What changed", blocks[:end]),
        Section("Over the life of the robot", drawn),
        Section("Campaigns", [*(Drawing("left", f, _LEFT) for n, f in figures.items() if n == "left"), *blocks[end:]]),
    ]
    kind = found.campaigns[0].robot.name
    part = Part(found.name or kind, f"{kind}: {found.span}", sections, [*_tiles(found)])
    return report_html(f"{part.title}: what changed", [part], provenance_of([f for f in files if f.is_file()], command))


def _tiles(found: Comparison) -> Iterator[Tile]:
    yield Tile("Changes", str(len(found.changes)), "", ", ".join(c.cause.label for c in found.changes) or "none")
    last = found.campaigns[-1]
    if last.sigma is not None:
        yield Tile("Left, last campaign", mm(last.sigma), "mm", "of one coordinate")


def _places(found: Comparison) -> list[Any]:
    """Where each campaign stands on the axis: its day, or its number, from 1, where not all have a day."""
    return [c.date if found.dated else k for k, c in enumerate(found.campaigns, 1)]


def _course(found: Comparison, change: Change) -> Figure:
    x = _places(found)
    main = change.amounts[change.main]
    size, error = main.value * change.course_of[:, 0], abs(main.value) * change.course_of[:, 1]
    title = f"{change.cause.label}: {HOW[change.course]} {found.campaigns[change.since].label}"
    what = AXES.get(change.cause.kind, main.name).format(joint=change.cause.joint)
    figure = _in_order(new_figure(plain(title), "campaign", plain(f"{what} [{main.unit}]")), found)
    figure.add_scatter(
        x=x,
        y=size,
        mode="lines+markers",
        line={"color": BLUE, "width": 1, "shape": "hvh" if change.course == "jump" else "linear"},
        marker={"size": 8, "color": BLUE},
        error_y={"type": "data", "array": 1.96 * error, "color": GREY, "thickness": 1.5, "width": 0},
        text=[plain(c.label) for c in found.campaigns],
        hovertemplate="<b>%{text}</b><br>%{y:.3g} " + main.unit + "<extra></extra>",
        showlegend=False,
    )
    first, last = change.between
    if change.course != "season":
        figure.add_vrect(x0=x[max(first - 1, 0)], x1=x[last], fillcolor=ORANGE, opacity=0.2, line_width=0)
    return figure


def _left(found: Comparison) -> Figure:
    left = [None if c.sigma is None else 1e3 * c.sigma for c in found.campaigns]
    figure = left_figure([(found.campaigns[0].robot.name, _places(found), left, False)], height=260)
    return _in_order(figure, found)


def _in_order(figure: Figure, found: Comparison) -> Figure:
    """With whole numbers on the axis where campaigns are counted."""
    return figure if found.dated else figure.update_xaxes(tick0=1, dtick=1 + len(found.campaigns) // 12)


def left_figure(lives: Iterable[tuple[str, Sequence[Any] | None, Sequence[float | None], bool]], height: int) -> Figure:
    """What nothing explains in each campaign of robots: (name, places on the axis, scatter [mm], changed) of each."""
    figure = new_figure("Left in each campaign", "campaign", "one sigma [mm]", height=height)
    for name, x, left, changed in lives:
        figure.add_scatter(
            x=x,
            y=list(left),
            mode="lines+markers",
            line={"color": RED if changed else GREY, "width": 2 if changed else 1},
            text=[plain(name)] * len(left),
            hovertemplate="<b>%{text}</b>, %{x}<br>%{y:.4f} mm<extra></extra>",
            showlegend=False,
        )
    return figure.update_yaxes(rangemode="tozero")
