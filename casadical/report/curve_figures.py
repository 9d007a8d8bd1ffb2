"""Figures of joint error curves: each over a turn with its band, and what single sines explain of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from casadical.diagnosis.spectrum_report import MOST_SHOWN, covered_parts, seen
from casadical.report.style import BLUE, GREY, INK, LINE, MUTED, ORANGE, Figure, new_figure

if TYPE_CHECKING:
    from casadical.diagnosis.spectrum import JointCurve, Spectrum

COLUMNS = 2
# Heights of a row, and of title, axes and legend [px]; space between the rows, as a share of the plot.
ROW, FRAME = 150, 176


def curve_figures(s: Spectrum) -> dict[str, Figure]:
    """The curve of each joint with its 95 % band over a turn, and its spectrum, by name: angles, lines."""
    return {"angles": _curves(s), "lines": _spectra(s)}


def _curves(s: Spectrum) -> Figure:
    figure = _grid(s, "Error of each joint over its own angle", "reading [deg]", "error [urad]", shared_yaxes="all")
    most = 1e6 * max((_reach(c) for c in s.joints if seen(c)), default=1e-4)
    for k, c in enumerate(s.joints):
        angle, value, band, place = np.rad2deg(c.angle), 1e6 * c.value, 1.96e6 * c.error, _place(k)
        tooltip = f"<b>joint {c.joint}</b>, %{{x:.0f}} deg: %{{y:.0f}} ± %{{customdata:.0f}} urad<extra></extra>"
        x, y = [], []
        for low, high in covered_parts(c):
            x += [*np.rad2deg([low, low, high, high]).round(1), None]
            y += [-most, most, most, -most, None]
        figure.add_scatter(
            x=x, y=y, fill="toself", fillcolor=LINE, opacity=0.3, line={"width": 0}, mode="lines", hoverinfo="skip",
            name="angles with readings", legendgroup="readings", showlegend=k == 0, **place,
        )  # fmt: skip
        figure.add_scatter(
            x=np.concatenate([angle, angle[::-1]]).round(1), fill="toself", fillcolor=BLUE, opacity=0.3, mode="lines",
            y=np.clip(np.concatenate([value + band, (value - band)[::-1]]), -most, most).round(1), line={"width": 0},
            hoverinfo="skip", name="95 % band", legendgroup="band", showlegend=k == 0, **place,
        )  # fmt: skip
        figure.add_scatter(
            x=angle.round(1), y=value.round(1), mode="lines", line={"color": BLUE, "width": 1.6}, name="curve",
            customdata=band.round(0), legendgroup="curve", showlegend=k == 0, hovertemplate=tooltip, **place,
        )  # fmt: skip
    figure.update_xaxes(range=[-180, 180], tickvals=[-180, -90, 0, 90, 180], ticktext=["", "-90", "0", "90", ""])
    return figure.update_yaxes(range=[-most, most], nticks=5)


def _reach(c: JointCurve) -> float:
    """How far a curve and its band go where there are readings [rad]."""
    return float((np.abs(c.value) + 1.96 * c.error)[c.covered].max(initial=0.0))


def _spectra(s: Spectrum) -> Figure:
    figure = _grid(s, "Lines of each joint's error", "cycles a turn", "amplitude [urad]")
    highest = max((_highest(c) for c in s.joints if seen(c)), default=1e-6)
    first = next((k for k, c in enumerate(s.joints) if c.lines), -1)
    for k, c in enumerate(s.joints):
        place, found = _place(k), c.scan.amplitude > 0
        needed = np.where(np.isfinite(c.scan.needed), 1e6 * c.scan.needed, np.nan)
        most = 1.3e6 * (_highest(c) if seen(c) else highest)
        x, value, band = c.scan.frequency[found], 1e6 * c.scan.amplitude[found], 1.96e6 * c.scan.error[found]
        figure.add_scatter(
            x=np.concatenate([x, x[::-1]]).round(2), fill="toself", fillcolor=BLUE, opacity=0.25, mode="lines",
            y=np.clip(np.concatenate([value + band, (value - band)[::-1]]), 0, most).round(1), line={"width": 0},
            hoverinfo="skip", name="95 % band", legendgroup="band", showlegend=k == 0, **place,
        )  # fmt: skip
        figure.add_scatter(
            x=c.scan.frequency.round(2), y=np.where(found, 1e6 * c.scan.amplitude, np.nan).round(1), mode="lines",
            line={"color": BLUE, "width": 1.3}, name="one sine alone", legendgroup="scan", showlegend=k == 0, **place,
            hovertemplate="%{x:.1f} cycles a turn: %{y:.0f} urad<extra></extra>",
        )  # fmt: skip
        figure.add_scatter(
            x=c.scan.frequency.round(2), y=np.where(needed < 3 * most, needed, np.nan).round(1), mode="lines",
            line={"color": GREY, "width": 1.2, "dash": "dot"}, name="needed to be named", hoverinfo="skip",
            legendgroup="needed", showlegend=k == 0, **place,
        )  # fmt: skip
        _named(figure, c, k == first, place)
        figure.update_yaxes(range=[0, most], nticks=4, **place)
    top = max((float(c.scan.frequency[-1]) for c in s.joints if len(c.scan.frequency)), default=1.0)
    return figure.update_xaxes(range=[0, top], nticks=6)


def _highest(c: JointCurve) -> float:
    """The greatest amplitude of a joint at which there is a whole cycle over its readings [rad]."""
    whole = c.scan.frequency >= 2 * c.scan.frequency[:1]
    return float(max(*c.scan.amplitude[whole], *(line.amplitude for line in c.lines), 1e-6))


def _named(figure: Figure, c: JointCurve, first: bool, place: dict[str, Any]) -> None:
    """Dots for the lines that are named, the strongest with their cycles."""
    x, y = ([getattr(line, n) for line in c.lines] for n in ("frequency", "amplitude"))
    figure.add_scatter(
        x=np.round(x, 3), y=1e6 * np.array(y), mode="markers+text", name="line", legendgroup="line", showlegend=first,
        marker={"color": ORANGE, "size": 8}, textposition="top center", textfont={"color": INK, "size": 11},
        text=[f"{line.frequency:.1f}" if k < MOST_SHOWN else "" for k, line in enumerate(c.lines)], cliponaxis=False,
        error_y={"type": "data", "array": [1.96e6 * line.amplitude_error for line in c.lines], "color": ORANGE,
                 "thickness": 1.2, "width": 0},
        customdata=[[1e6 * line.amplitude_error, line.frequency_error, line.p] for line in c.lines],
        hovertemplate="<b>%{x:.2f} ± %{customdata[1]:.2f} cycles a turn</b><br>%{y:.0f} ± %{customdata[0]:.0f} urad, "
        "p = %{customdata[2]:.1g}<extra></extra>",
        **place,
    )  # fmt: skip


def _grid(s: Spectrum, title: str, x: str, y: str, **shared: Any) -> Figure:
    """An empty figure with a place for each joint, its name and share above it."""
    rows = -(-len(s.joints) // COLUMNS)
    height = ROW * rows + FRAME
    figure = new_figure(title, height=height)
    axis = {k: v for k, v in figure.layout.xaxis.to_plotly_json().items() if k not in ("title", "showline")}
    titles = [f"joint {c.joint}: {f'{100 * c.share:.0f} %' if seen(c) else 'not seen'}" for c in s.joints]
    figure.set_subplots(
        rows, COLUMNS, subplot_titles=titles, horizontal_spacing=0.1, vertical_spacing=30 / (height - FRAME),
        x_title=x, y_title=y, shared_xaxes="all", **shared,
    )  # fmt: skip
    figure.update_annotations(font={"size": 12, "color": MUTED})
    figure.update_layout(margin={"l": 56, "r": 12, "t": 76, "b": 100})
    return figure.update_xaxes(**axis, showline=True).update_yaxes(**axis)


def _place(k: int) -> dict[str, Any]:
    return {"row": k // COLUMNS + 1, "col": k % COLUMNS + 1}
