"""Figures of the causes: probability of each candidate, and how far the gap shrinks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from casadical.effects.plugins import signature_of
from casadical.report.share_figures import intervals
from casadical.report.style import BLUE, GREEN, GREY, INK, ORANGE, Figure, new_figure, plain

if TYPE_CHECKING:
    from casadical.diagnosis.held_out_gap import NetworkGap
    from casadical.diagnosis.result import Diagnosis

MOST_SHOWN = 8
ROW = 30


def posteriors(d: Diagnosis, step: int = 0) -> Figure:
    """Probability of each candidate for the next cause, at one step of the search (0: the first).

    Those of the unknown are summed up as one; "nothing" stands beside them.
    """
    ranking = d.rankings[step]
    listed = {c.label for c in d.case.candidates if c.listed}
    rows = [(label, ranking.probability[label], BLUE) for label in ranking.order if label in listed][:MOST_SHOWN]
    unknown = sum(p for label, p in ranking.probability.items() if label not in listed)
    rows += [("something on no list", unknown, ORANGE), ("nothing", ranking.none, GREY)]
    title = "Probability of each cause" if step == 0 else f"Probability of a further cause, step {step + 1}"
    figure = new_figure(title, "probability", height=110 + ROW * len(rows))
    figure.add_bar(
        x=[p for _, p, _ in rows],
        y=list(range(len(rows))),
        orientation="h",
        width=0.62,
        marker={"color": [colour for _, _, colour in rows], "line": {"width": 0}},
        text=[_probability(p) for _, p, _ in rows],
        textposition="outside",
        textfont={"color": INK, "size": 12},
        cliponaxis=False,
        customdata=[[plain(label), signature_of(label.split("@")[0])] for label, _, _ in rows],
        hovertemplate="<b>%{customdata[0]}</b>: %{x:.3g}<br>%{customdata[1]}<extra></extra>",
        showlegend=False,
    )
    figure.update_layout(margin_r=64)
    figure.update_xaxes(range=[0, 1], tickvals=[0, 0.25, 0.5, 0.75, 1])
    return figure.update_yaxes(
        tickvals=list(range(len(rows))), ticktext=[plain(r[0]) for r in rows], range=[len(rows) - 0.4, -0.6],
        showgrid=False,
    )  # fmt: skip


def _probability(p: float) -> str:
    return f"{p:.3f}" if 0.001 <= p <= 0.999 else ("< 0.001" if p < 0.001 else "> 0.999")


def gap_course(d: Diagnosis, networks: Sequence[NetworkGap] | None = None) -> Figure:
    """Mean position error on held-out poses [mm] as causes are added, beside what noise alone leaves.

    The intervals are of 95 %, over poses; outliers are left out. networks : instead of the causes, and after them.
    """
    rows = [
        ("base model" if r.model == "base" else str(r.model), r.gap_mm, r.low_mm, r.high_mm, GREY if k == 0 else BLUE)
        for k, r in enumerate(d.course.itertuples())
    ]
    words = ("network instead", "network on the rest") if d.effects() else ("network",)
    for name, net in zip(words, networks or (), strict=False):
        note = ", refused" if net.refused else ""
        # Tried on one partition: drawn by its ratio there, beside the gap of all partitions.
        alone = 1e3 * (d.gap.after if name.endswith("rest") else d.gap.kept) * net.used / net.before
        rows.append((name + note, alone, alone, alone, ORANGE))
    floor = 1e3 * d.gap.floor
    rows.append(("noise alone", floor, floor, floor, GREEN))
    names, values, low, high, colours = zip(*rows, strict=True)
    figure = new_figure("Gap on held-out poses", "mean position error [mm]", height=112 + 36 * len(rows))
    figure.add_bar(
        x=values,
        y=list(range(len(rows))),
        orientation="h",
        width=0.6,
        marker={"color": colours, "line": {"width": 0}},
        error_x={
            "type": "data",
            "symmetric": False,
            "array": [h - v for h, v in zip(high, values, strict=True)],
            "arrayminus": [v - lo for lo, v in zip(low, values, strict=True)],
            "color": INK,
            "thickness": 1.4,
            "width": 4,
        },
        customdata=[[plain(n), lo, hi] for n, lo, hi in zip(names, low, high, strict=True)],
        hovertemplate="<b>%{customdata[0]}</b><br>%{x:.4f} mm, 95 %: %{customdata[1]:.4f} to %{customdata[2]:.4f}"
        "<extra></extra>",
        showlegend=False,
    )
    for place, value in enumerate(values):
        figure.add_annotation(x=high[place], y=place, text=f"{value:.3f} mm", xanchor="left", xshift=8, showarrow=False,
                              font={"color": INK, "size": 12})  # fmt: skip
    figure.update_layout(margin_r=76)
    figure.update_xaxes(range=[0, max(high)])
    return figure.update_yaxes(
        tickvals=list(range(len(rows))), ticktext=[plain(n) for n in names], range=[len(rows) - 0.4, -0.6],
        showgrid=False,
    )  # fmt: skip


def shrinks(d: Diagnosis) -> Figure:
    """By how much the held-out gap shrinks with each cause alone [%], with 95 % intervals."""
    causes = [c for c in d.causes if c.effects]
    share = [100 * c.shrink for c in causes]
    low, high = ([100 * c.shrink_interval[k] for c in causes] for k in (0, 1))
    notes = [f"probability {c.confidence:.3f}" for c in causes]
    labels = [c.label for c in causes]
    title, x = "Gap shrinks by, each cause alone", "share of the held-out gap [%]"
    figure = intervals(title, x, labels, share, low, high, notes, "%{x:.0f} %")
    return figure.update_xaxes(range=[min(0.0, *low), 100])
