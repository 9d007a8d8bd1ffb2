"""Which causes and how sure: what the data say of each candidate, and how far the gap shrinks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..diagnosis.answer import SIGNATURES
from .look import BLUE, GREEN, GREY, INK, MUTED, ORANGE, new_figure, plain
from .share_figures import intervals

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from ..diagnosis.diagnosis import Diagnosis

MOST_SHOWN = 8
ROW = 30


def posteriors(d: Diagnosis, step: int = 0) -> go.Figure:
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
        customdata=[[plain(label), SIGNATURES.get(label.split("@")[0], "")] for label, _, _ in rows],
        hovertemplate="<b>%{customdata[0]}</b>: %{x:.3g}<br>%{customdata[1]}<extra></extra>",
        showlegend=False,
    )
    figure.update_xaxes(range=[0, 1.14], tickvals=[0, 0.25, 0.5, 0.75, 1])
    return figure.update_yaxes(
        tickvals=list(range(len(rows))), ticktext=[plain(r[0]) for r in rows], range=[len(rows) - 0.4, -0.6],
        showgrid=False,
    )  # fmt: skip


def _probability(p: float) -> str:
    return f"{p:.3f}" if 0.001 <= p <= 0.999 else ("< 0.001" if p < 0.001 else "> 0.999")


def gap_ladder(d: Diagnosis) -> go.Figure:
    """Mean position error on held-out poses [mm]: base model, with the causes in it, and what noise alone leaves."""
    words = "with the causes in the model" if d.causes else "no cause added"
    rows = [("base model", d.gap.before, GREY), (words, d.gap.after, BLUE), ("noise alone", d.gap.floor, GREEN)]
    figure = new_figure("Gap on held-out poses", "mean position error [mm]", height=220)
    figure.add_bar(
        x=[1e3 * v for _, v, _ in rows],
        y=[0, 1, 2],
        orientation="h",
        width=0.6,
        marker={"color": [colour for _, _, colour in rows], "line": {"width": 0}},
        text=[f"{1e3 * v:.3f} mm" for _, v, _ in rows],
        textposition="outside",
        textfont={"color": INK, "size": 12},
        cliponaxis=False,
        customdata=[name for name, _, _ in rows],
        hovertemplate="%{customdata}: %{x:.4f} mm<extra></extra>",
        showlegend=False,
    )
    figure.update_xaxes(range=[0, 1.25e3 * max(v for _, v, _ in rows)])
    return figure.update_yaxes(
        tickvals=[0, 1, 2], ticktext=[r[0] for r in rows], range=[2.6, -0.6], showgrid=False, color=MUTED
    )


def shrinks(d: Diagnosis) -> go.Figure:
    """By how much the held-out gap shrinks with each cause alone [%], with 95 % intervals."""
    share = [100 * c.shrink for c in d.causes]
    low, high = ([100 * c.shrink_interval[k] for c in d.causes] for k in (0, 1))
    notes = [f"probability {c.confidence:.3f}" for c in d.causes]
    figure = intervals(
        "Gap shrinks by, each cause alone", "share of the held-out gap [%]", [c.label for c in d.causes], share, low, high,
        notes, "%{x:.0f} %",
    )  # fmt: skip
    return figure.update_xaxes(range=[min(0.0, *low), 100])
