"""Figures that show whether a fit can be trusted: its residuals, the ranges of its poses, and correlated parameters."""

from collections.abc import Iterator, Mapping, Sequence
from statistics import NormalDist
from typing import Any

import numpy as np

from casadical.core.arrays import Array
from casadical.identification.result import Identification
from casadical.measurements.measurements import Measurements
from casadical.report.page import Drawing
from casadical.report.style import BLUE, GREY, GRID, INK, LINE, MUTED, ORANGE, RED, Figure, new_figure, plain
from casadical.robot.robot import Robot

# More residuals than this are drawn by so many of their quantiles; of readings, so many are drawn.
MOST_DRAWN = 600
# Parameters of the pair plot, and the least correlation that is worth one.
MOST_PAIRED, WORTH = 4, 0.5
ROW = 40


def fit_figures(
    result: Identification, sets: Mapping[str, Sequence[Measurements]], residuals: Array | None = None
) -> dict[str, Figure]:
    """Of one fit, by name: residuals, coverage and, where parameters are correlated, pairs.

    sets : poses by what a legend calls them, each in parts of one kind; residuals : in place of the fit's own, [sigma]
    """
    if residuals is None:
        own = np.concatenate([r.ravel() for r in result.problem.residuals(result.solution.v)])
        residuals = own / float(np.sqrt(result.variance))
    found = {"residuals": residual_quantiles(residuals), "coverage": joint_coverage(result.robot, sets)}
    names = most_correlated(result)
    return found | ({"pairs": correlated_pairs(result, names)} if names else {})


def fit_drawings(figures: Mapping[str, Figure]) -> Iterator[Drawing]:
    """The figures of the fit, each with how to read it."""
    captions = {
        "residuals": "Every coordinate of every pose that was used. Noise alone lies on the diagonal, within the band: "
        "ends that bend away are errors that the model does not describe, or bad rows.",
        "coverage": "Where ticks are missing, the model was not tried. Without limits in the robot file, full turns.",
        "pairs": "Joint 95 % regions of the most correlated parameters, in standard errors. A thin ellipse (red: above "
        "0.95) means that the poses determine a combination of both, and neither alone.",
    }
    for kind, caption in captions.items():
        if f"fit/{kind}" in figures:
            yield Drawing(f"fit/{kind}", figures[f"fit/{kind}"], caption)


def residual_quantiles(residuals: Array) -> Figure:
    """Sorted residuals in units of their scatter over the quantiles of a normal distribution, with a 95 % band.

    residuals : of every coordinate of every used pose, any shape [sigma]
    """
    residuals = np.sort(residuals, axis=None)
    n = len(residuals)
    k = np.unique(np.linspace(0, n - 1, min(n, MOST_DRAWN)).round().astype(int))
    normal, share = NormalDist(), (k + 0.5) / n
    expected = np.array([normal.inv_cdf(p) for p in share])
    # Standard error of an order statistic, from the density there.
    band = 1.96 * np.sqrt(share * (1 - share) / n) / np.array([normal.pdf(x) for x in expected])
    figure = new_figure("Residuals: are they noise?", "expected of noise [sigma]", "residual [sigma]", height=380)
    figure.add_scatter(
        x=np.concatenate([expected, expected[::-1]]).round(4), fill="toself", fillcolor=GREY, opacity=0.25,
        y=np.concatenate([expected + band, (expected - band)[::-1]]).round(4), mode="lines", line={"width": 0},
        name="noise, 95 %", hoverinfo="skip",
    )  # fmt: skip
    figure.add_scatter(
        x=expected.round(4), y=residuals[k].round(4), mode="markers", marker={"size": 4.5, "color": BLUE},
        name="residuals", hovertemplate="%{y:.2f} sigma, of noise %{x:.2f}<extra></extra>",
    )  # fmt: skip
    return figure.update_xaxes(zeroline=False, nticks=8)


def joint_coverage(robot: Robot, sets: Mapping[str, Sequence[Measurements]]) -> Figure:
    """Readings of each joint within its limits, in % of its range; a set is a line of ticks."""
    figure = new_figure("Readings of each joint within its limits", "from the lower to the upper limit [%]",
                        height=120 + ROW * robot.n)  # fmt: skip
    lower, upper = (np.array([getattr(j, end) for j in robot.joints]) for end in ("lower", "upper"))
    figure.add_bar(
        x=[100] * robot.n, y=list(range(robot.n)), orientation="h", width=0.7, marker={"color": LINE}, opacity=0.4,
        hoverinfo="skip", showlegend=False,
    )  # fmt: skip
    units = [(key.split("_")[1], factor) for key, factor in robot.reading_units.items()]
    for k, ((words, parts), colour) in enumerate(zip(sets.items(), (BLUE, ORANGE, MUTED, INK), strict=False)):
        q = np.concatenate([m.q for m in parts])
        q = q[np.unique(np.linspace(0, len(q) - 1, min(len(q), MOST_DRAWN)).round().astype(int))]
        places = np.arange(robot.n) + 0.36 * ((k + 0.5) * 2 / len(sets) - 1)
        text = [[f"{v / f:.4g} {unit}" for v, (unit, f) in zip(row, units, strict=True)] for row in q]
        figure.add_scatter(
            x=(100 * (q - lower) / (upper - lower)).ravel().round(2), y=np.tile(places, len(q)).round(3),
            mode="markers", name=plain(words), customdata=np.array(text).ravel(),
            marker={"symbol": "line-ns-open", "size": 22 / len(sets), "color": colour, "line": {"width": 1}},
            hovertemplate=f"%{{customdata}}, {plain(words)}<extra></extra>",
        )  # fmt: skip
    ticks = [f"q{i} [{unit}]" for i, (unit, _) in enumerate(units, 1)]
    figure.update_yaxes(tickvals=list(range(robot.n)), ticktext=ticks, range=[robot.n - 0.4, -0.6], showgrid=False)
    return figure.update_xaxes(range=[-1, 101], tickvals=[0, 25, 50, 75, 100])


def most_correlated(result: Identification) -> tuple[str, ...]:
    """Parameters of the strongest correlations, the strongest first; () where none is worth a figure."""
    pairs = result.correlations(WORTH)
    pairs = pairs[pairs[["parameter", "with"]].isin(result.start.shown).all(axis=1)]
    names = dict.fromkeys(name for row in pairs[["parameter", "with"]].itertuples(index=False) for name in row)
    return tuple(names)[:MOST_PAIRED]


def correlated_pairs(result: Identification, names: Sequence[str]) -> Figure:
    """The joint 95 % region of every two of some parameters, in standard errors from their values.

    An ellipse that reaches 2.45 standard errors along each axis, so that its shape is the correlation.
    """
    n = len(names) - 1
    place = [result.names.index(name) for name in names]
    error = result.standard_errors[place]
    C = result.covariance[np.ix_(place, place)] / np.outer(error, error)
    figure = new_figure("Correlated parameters", height=110 + 130 * n)
    axis = {k: v for k, v in figure.layout.xaxis.to_plotly_json().items() if k not in ("title", "showline")}
    figure.set_subplots(n, n, horizontal_spacing=0.04, vertical_spacing=0.04, shared_xaxes=True, shared_yaxes=True)
    angle = np.linspace(0, 2 * np.pi, 73)
    radius = float(np.sqrt(-2 * np.log(0.05)))
    for i in range(n):
        for j in range(i + 1):
            r = float(np.clip(C[i + 1, j], -1, 1))
            x, y = radius * np.cos(angle), radius * (r * np.cos(angle) + np.sqrt(1 - r * r) * np.sin(angle))
            at: dict[str, Any] = {"row": i + 1, "col": j + 1}
            figure.add_scatter(
                x=x.round(3), y=y.round(3), mode="lines", fill="toself", fillcolor=GRID, showlegend=False,
                line={"color": RED if abs(r) > 0.95 else BLUE, "width": 1.5},
                hovertemplate=f"{plain(names[j])}, {plain(names[i + 1])}: correlation {r:+.3f}<extra></extra>", **at,
            )  # fmt: skip
            ref = "" if i * n + j == 0 else str(i * n + j + 1)
            side: dict[str, Any] = {"x": 0.03, "xanchor": "left"} if r > 0 else {"x": 0.97, "xanchor": "right"}
            figure.add_annotation(
                text=f"{r:+.2f}", y=1, yanchor="top", xref=f"x{ref} domain", yref=f"y{ref} domain", showarrow=False,
                font={"size": 11, "color": INK}, **side,
            )  # fmt: skip
    figure.update_xaxes(**axis, range=[-3.3, 3.3], tickvals=[-2, 0, 2], showline=True)
    figure.update_yaxes(**axis, range=[-3.3, 3.3], tickvals=[-2, 0, 2])
    for k in range(n):
        figure.update_xaxes(title={"text": plain(names[k]), "font": {"size": 12}}, row=n, col=k + 1)
        figure.update_yaxes(title={"text": plain(names[k + 1]), "font": {"size": 12}}, row=k + 1, col=1)
    return figure
